#include "common/stats.h"

#include "common/elem.h"

#include <math.h> /* constants, fabs and sqrt only */
#include <stddef.h>

#define TINY 1e-300 /* keeps continued fractions from dividing by zero */

/* ln Gamma(x), x > 0: Stirling's series where it is exact enough, after stepping up to there */
static double log_gamma(double x)
{
    double product = 1;
    while (x < 15) {
        product *= x;
        x += 1;
    }
    double r = 1 / (x * x);
    double series = 1.0 / 12 - r * (1.0 / 360 - r * (1.0 / 1260 - r * (1.0 / 1680 - r / 1188)));
    return (x - 0.5) * elem_log(x) - x + 0.91893853320467274178 + series / x - elem_log(product);
}

/* The upper regularised incomplete gamma function Q(a, x) */
static double gamma_upper(double a, double x)
{
    double front = elem_exp(a * elem_log(x) - x - log_gamma(a));
    if (x < a + 1) {
        /* The series of the lower one */
        double term = 1 / a, sum = term;
        for (double k = 1; term > sum * 1e-17; k++) {
            term *= x / (a + k);
            sum += term;
        }
        return 1 - front * sum;
    }

    /* Lentz's continued fraction */
    double b = x + 1 - a, c = 1 / TINY, d = 1 / b, fraction = d;
    for (double k = 1; k < 1e6; k++) {
        double numerator = -k * (k - a);
        b += 2;
        d = numerator * d + b;
        c = b + numerator / c;
        d = 1 / (fabs(d) < TINY ? TINY : d);
        c = fabs(c) < TINY ? TINY : c;
        fraction *= d * c;
        if (fabs(d * c - 1) < 1e-16)
            break;
    }
    return front * fraction;
}

/* The regularised incomplete beta function I_x(a, b), given both x and y = 1 - x */
static double beta_lower(double a, double b, double x, double y)
{
    if (x <= 0)
        return 0;
    if (y <= 0)
        return 1;
    if (x > (a + 1) / (a + b + 2)) /* there the fraction of the other tail converges */
        return 1 - beta_lower(b, a, y, x);

    double front = elem_exp(log_gamma(a + b) - log_gamma(a) - log_gamma(b) + a * elem_log(x) +
                            b * elem_log(y)) /
                   a;
    double c = 1, d = 1 - (a + b) * x / (a + 1);
    d = 1 / (fabs(d) < TINY ? TINY : d);
    double fraction = d;
    for (double m = 1; m < 1e6; m++) {
        double factors[2] = {
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        };
        double change = 1;
        for (int i = 0; i < 2; i++) {
            d = 1 + factors[i] * d;
            c = 1 + factors[i] / c;
            d = 1 / (fabs(d) < TINY ? TINY : d);
            c = fabs(c) < TINY ? TINY : c;
            change *= d * c;
        }
        fraction *= change;
        if (fabs(change - 1) < 1e-16)
            break;
    }
    return front * fraction;
}

double stats_normal_survival(double z)
{
    if (isnan(z))
        return z;
    /* A chi-square variable of one degree of freedom is a normal one squared */
    double two_sided = stats_chi_square_survival(z * z, 1);
    return z > 0 ? 0.5 * two_sided : 1 - 0.5 * two_sided;
}

double stats_normal_quantile(double p)
{
    if (!(p >= 0 && p <= 1))
        return NAN;
    if (p > 0 && p < 1e-3) {
        /* Where 2p - 1 loses digits: Newton on the logarithm of the tail, which is nearly a
         * parabola */
        double z = sqrt(-2 * elem_log(p));
        for (int step = 0; step < 30; step++) {
            double tail = stats_normal_survival(z);
            double density = 0.39894228040143267794 * elem_exp(-0.5 * z * z);
            double change = elem_log(tail / p) * tail / density;
            z += change;
            if (fabs(change) < 1e-14 * z)
                break;
        }
        return -z;
    }
    return 1.41421356237309504880 * elem_erfinv(2 * p - 1);
}

double stats_chi_square_survival(double x, double dof)
{
    if (!(dof > 0) || isnan(x))
        return NAN;
    if (x <= 0)
        return 1;
    return x == INFINITY ? 0 : gamma_upper(0.5 * dof, 0.5 * x);
}

double stats_student_survival(double t, double dof)
{
    if (!(dof > 0) || isnan(t))
        return NAN;
    double square = t * t;
    if (square == INFINITY)
        return t > 0 ? 0 : 1;
    double tail = 0.5 * beta_lower(0.5 * dof, 0.5, dof / (dof + square), square / (dof + square));
    return t > 0 ? tail : 1 - tail;
}

double stats_student_quantile(double p, double dof)
{
    if (!(dof > 0) || !(p >= 0 && p <= 1))
        return NAN;
    if (p == 0.5)
        return 0;
    if (p == 0 || p == 1)
        return p == 0 ? -INFINITY : INFINITY;
    if (p > 0.5)
        return -stats_student_quantile(1 - p, dof); /* exact: p is at least a half */

    /* Bisect for the t whose upper tail is p: first for its power of two, then within */
    double low = 0, high = 1;
    while (high < 1e300 && stats_student_survival(high, dof) > p) {
        low = high;
        high *= 2;
    }
    for (int step = 0; step < 200; step++) {
        double middle = 0.5 * (low + high);
        if (middle == low || middle == high)
            break;
        if (stats_student_survival(middle, dof) > p)
            low = middle;
        else
            high = middle;
    }
    return -0.5 * (low + high);
}

double stats_chi_square(const unsigned long long *counts, const double *share, int bins)
{
    double total = 0, sum = 0;
    for (int i = 0; i < bins; i++)
        total += (double)counts[i];
    for (int i = 0; i < bins; i++) {
        double expected = share ? total * share[i] : total / bins;
        double excess = (double)counts[i] - expected;
        if (expected > 0)
            sum += excess * excess / expected;
        else if (counts[i] > 0)
            return INFINITY;
    }
    return sum;
}
