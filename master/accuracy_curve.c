#include "master/accuracy_curve.h"

#include <math.h>

#define KNOWN_TO (1.0 / 3) /* relative error above which a rung tells nothing of the slope */

static const struct accuracy_value unknown = { NAN, NAN };

const struct accuracy_rung *accuracy_curve_last(const struct accuracy_curve *curve)
{
    return curve->count == 0 ? NULL : &curve->rungs[curve->count - 1];
}

double accuracy_curve_ttuv(const struct accuracy_rung *rung)
{
    return rung->point.variance * rung->facts.core_s;
}

static double relative_error(const struct accuracy_rung *rung)
{
    return rung->point.relmse_error / rung->point.relmse;
}

/* Can its logarithms be taken? Below the reference's noise an error may come out negative. */
static bool is_positive(const struct accuracy_rung *rung)
{
    return rung->point.relmse > 0 && rung->facts.core_s > 0 && rung->point.relmse_error > 0;
}

static bool is_known(const struct accuracy_rung *rung)
{
    return is_positive(rung) && relative_error(rung) < KNOWN_TO;
}

static struct accuracy_value fitted_slope(const struct accuracy_curve *curve)
{
    double x[ACCURACY_RUNGS_MAX], y[ACCURACY_RUNGS_MAX], error[ACCURACY_RUNGS_MAX];
    size_t count = 0;
    for (size_t i = 0; i < curve->count; i++) {
        const struct accuracy_rung *rung = &curve->rungs[i];
        if (!is_known(rung) ||
            rung->facts.replicates != accuracy_curve_last(curve)->facts.replicates)
            continue;
        x[count] = rung->facts.core_s;
        y[count] = rung->point.relmse;
        error[count++] = relative_error(rung);
    }
    if (count < 3)
        return unknown;
    struct fit_line line = fit_power(x, y, error, count);
    /* Points that are further from the line than their errors say make the slope less sure */
    double excess = line.chi_square / (double)(count - 2);
    return (struct accuracy_value){ line.slope, line.slope_error * sqrt(fmax(excess, 1)) };
}

/*
 * Where the line between two neighbouring rungs has the value `x`, logarithmic in both; the error
 * is that of relMSE there, seen along the line when times are asked for.
 */
static struct accuracy_value between(const struct accuracy_rung *a, const struct accuracy_rung *b,
                                     double value, bool time)
{
    double t[2] = { log(a->facts.core_s), log(b->facts.core_s) };
    double e[2] = { log(a->point.relmse), log(b->point.relmse) };
    const double *from = time ? e : t, *to = time ? t : e;
    double share = from[1] != from[0] ? (log(value) - from[0]) / (from[1] - from[0]) : 0;
    double found = exp(to[0] + share * (to[1] - to[0]));
    double noise = hypot((1 - share) * relative_error(a), share * relative_error(b));
    if (time)
        noise *= fabs((t[1] - t[0]) / (e[1] - e[0]));
    return (struct accuracy_value){ found, found * noise };
}

static bool lies_between(double value, double a, double b)
{
    return (a <= value && value <= b) || (b <= value && value <= a);
}

static struct accuracy_value look_up(const struct accuracy_curve *curve, double value, bool time)
{
    for (size_t i = 1; i < curve->count; i++) {
        const struct accuracy_rung *a = &curve->rungs[i - 1], *b = &curve->rungs[i];
        if (time ? !is_known(a) || !is_known(b) : !is_positive(a) || !is_positive(b))
            continue;
        if (time ? lies_between(value, a->point.relmse, b->point.relmse)
                 : lies_between(value, a->facts.core_s, b->facts.core_s))
            return between(a, b, value, time);
    }
    return unknown;
}

struct accuracy_value accuracy_curve_time(const struct accuracy_curve *curve, double relmse)
{
    return look_up(curve, relmse, true);
}

struct accuracy_value accuracy_curve_error(const struct accuracy_curve *curve, double core_s)
{
    return look_up(curve, core_s, false);
}

/* The smallest error of its rungs */
static double best(const struct accuracy_curve *curve)
{
    double least = INFINITY;
    for (size_t i = 0; i < curve->count; i++)
        if (is_known(&curve->rungs[i]))
            least = fmin(least, curve->rungs[i].point.relmse);
    return least;
}

/* The smallest error that its rungs may have: the ends of their bands */
static double at_least(const struct accuracy_curve *curve)
{
    double least = INFINITY;
    for (size_t i = 0; i < curve->count; i++) {
        const struct accuracy_point *p = &curve->rungs[i].point;
        least = fmin(least, p->relmse - ACCURACY_BAND * p->relmse_error);
    }
    return least;
}

/* What speedup_below says: surely, so with both at the unlucky ends of their bands */
static double speed_limit(const struct accuracy_curve *curve, const struct accuracy_curve *base)
{
    size_t first = 0;
    while (first < base->count && !is_known(&base->rungs[first]))
        first++;
    if (first == base->count || curve->count == 0)
        return NAN;
    const struct accuracy_point *p = &base->rungs[first].point;
    if (!(at_least(curve) > p->relmse + ACCURACY_BAND * p->relmse_error))
        return NAN;
    return base->rungs[first].facts.core_s / accuracy_curve_last(curve)->facts.core_s;
}

void accuracy_curve_finish(struct accuracy_curve *curve, const struct accuracy_curve *base)
{
    curve->slope = curve->count > 0 ? fitted_slope(curve) : unknown;
    curve->at_relmse = fmax(best(curve), best(base));
    curve->speedup = unknown;
    curve->speedup_below = speed_limit(curve, base);
    struct accuracy_value mine = accuracy_curve_time(curve, curve->at_relmse);
    struct accuracy_value theirs = accuracy_curve_time(base, curve->at_relmse);
    if (!isfinite(mine.value) || !isfinite(theirs.value))
        return;
    double ratio = theirs.value / mine.value;
    double noise = hypot(mine.error / mine.value, theirs.error / theirs.value);
    curve->speedup = (struct accuracy_value){ ratio, curve == base ? 0 : ratio * noise };
}
