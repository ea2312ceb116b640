/*
 * Slides on Russian roulette: in a furnace, where everything is known, and in a picture; and what a
 * largest depth does instead.
 */
#ifndef MASTER_LECTURE_ROULETTE_H
#define MASTER_LECTURE_ROULETTE_H

#include "master/lecture.h"

/*
 * The furnace: a closed room whose walls emit 1 and reflect `albedo` of what arrives. A path adds 1
 * at every wall; it goes on with probability q, and is then weighted by albedo / q.
 */
struct lecture_furnace {
    double mean, variance; /* of a path's sum */
    double walls;          /* hit by a path */
};

/* The closed form; the variance is infinite where albedo^2 >= q */
struct lecture_furnace lecture_roulette_theory(double albedo, double q);

/* Measured on n paths; *error: standard error of the mean */
struct lecture_furnace lecture_roulette_measure(double albedo, double q, uint64_t n,
                                                struct lecture_dice dice, double *error);

void lecture_roulette_write(struct lecture *lecture);

#endif
