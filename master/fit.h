/*
 * Straight lines through points that are known with errors; with both axes logarithmic, the order
 * of convergence and how sure it is. Pure; any thread; the same bits everywhere.
 */
#ifndef MASTER_FIT_H
#define MASTER_FIT_H

#include <stddef.h>

#define FIT_MAX 64 /* points of fit_power; more are left out */

struct fit_line {
    double slope, at_zero; /* y = at_zero + slope x; NaN below two different x */
    double slope_error;    /* standard error, from the errors of the points */
    double chi_square;     /* of the residuals; with points - 2 degrees of freedom */
};

/* Weighted least squares; error[i] > 0 is the standard error of y[i]. */
struct fit_line fit_line(const double *x, const double *y, const double *error, size_t count);

/* y = scale x^slope through points above 0, by a line through their logarithms; at_zero is
 * ln scale. relative_error[i]: of y[i], small against 1. */
struct fit_line fit_power(const double *x, const double *y, const double *relative_error,
                          size_t count);

#endif
