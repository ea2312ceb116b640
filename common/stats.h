/*
 * The few distributions that error estimates and statistical tests need. Built on common/elem.h,
 * so that a decision taken from them is the same on every machine. Relative errors are below 1e-9
 * where the result is above 1e-100 (for Student's t with more than 1e5 dof: 1e-6). Pure; any
 * thread. Arguments outside the domain give NaN.
 */
#ifndef COMMON_STATS_H
#define COMMON_STATS_H

/* Of a standard normal Z: P(Z > z), and z with P(Z <= z) = p, infinite for p = 0 and 1 */
double stats_normal_survival(double z);
double stats_normal_quantile(double p);

/* P(X > x) of a chi-square variable, dof > 0 */
double stats_chi_square_survival(double x, double dof);

/* Student's t, dof > 0, also not whole (Welch) */
double stats_student_survival(double t, double dof); /* P(T > t) */
double stats_student_quantile(double p, double dof); /* t with P(T <= t) = p */

/* Pearson's statistic of counts against `total * share[i]`; expected counts of 0 must be empty,
 * else the result is infinite. share == NULL: all equal. */
double stats_chi_square(const unsigned long long *counts, const double *share, int bins);

#endif
