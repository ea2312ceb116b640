/*
 * Slides on Monte Carlo integration: the die, the integral of 5x^4 with uniform samples and with
 * its own density, that of e^sin(3x^2) with and without strata, and pi by hit and miss.
 */
#ifndef MASTER_LECTURE_INTEGRALS_H
#define MASTER_LECTURE_INTEGRALS_H

#include "master/lecture.h"

struct moments;

/* A function of one variable over an interval: the `self` of the next two */
struct lecture_integrand {
    double (*f)(double x);
    double low, high;
};

double lecture_integrals_5x4(double x);
double lecture_integrals_wave(double x); /* e^sin(3x^2) */

/* Uniform samples over the interval, or one of them in each of n equal strata */
lecture_estimate lecture_integrals_random, lecture_integrals_stratified;

/* n values of 5x^4 / p(x), the x drawn from p(x) = 5x^4 by its inverse distribution */
struct moments lecture_integrals_importance(uint64_t n, struct lecture_dice *dice);

/* What the wave's numbers should be, by Simpson's rule */
struct lecture_wave {
    double integral;
    double sigma;            /* standard deviation of f: RMSE of random samples is sigma n^-1/2 */
    double stratified_scale; /* sqrt(integral of f'^2 / 12): with strata it is this n^-3/2 */
};
struct lecture_wave lecture_integrals_wave_theory(void);

/* pi from points in the square of side 2: n random ones, or one in each of n square cells (n is
 * made a square number, rounding down). `self` is not used. */
lecture_estimate lecture_integrals_pi_random, lecture_integrals_pi_stratified;
/* The integral of e^(x + y) over the unit square, (e - 1)^2, with the same cells: smooth, in 2-D */
lecture_estimate lecture_integrals_smooth_stratified;

/* How many of the largest outputs of rand() does (float)r / (float)RAND_MAX turn into 1? For a
 * RAND_MAX of 2^31 - 1. */
unsigned lecture_integrals_rand_ones(void);

void lecture_integrals_write(struct lecture *lecture);

#endif
