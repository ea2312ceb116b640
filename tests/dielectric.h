/*
 * The interface of two dielectrics in double, for random walks that are checked against: what is
 * reflected, and Smith's function of rough ones.
 */
#ifndef TESTS_DIELECTRIC_H
#define TESTS_DIELECTRIC_H

#include <math.h>

/* From cosine c; n is the far side's index over the near one's */
static inline double dielectric_fresnel(double c, double n)
{
    double s2 = (1 - c * c) / (n * n);
    if (s2 >= 1)
        return 1;
    double t = sqrt(1 - s2), p = (n * c - t) / (n * c + t), s = (c - n * t) / (c + n * t);
    return (p * p + s * s) / 2;
}

/* Of GGX, at cosine z */
static inline double dielectric_lambda(double z, double alpha)
{
    return (sqrt(1 + alpha * alpha * (1 / (z * z) - 1)) - 1) / 2;
}

#endif
