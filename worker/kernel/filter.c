#include "worker/kernel/filter.h"

#include "common/elem.h"

#include <string.h>

#define FINE 65536 /* steps of the numeric integrals */

/* One axis of the filter at x in [-1, 1] times its radius; pbrt-v4, section 8.8 */
static double filter_axis(const struct filter_spec *spec, double radius, double x)
{
    double a = x < 0 ? -x : x;
    switch ((enum filter_kind)spec->kind) {
    case FILTER_TRIANGLE:
        return 1 - a;
    case FILTER_GAUSSIAN: {
        double s = 2 * (double)spec->sigma * (double)spec->sigma;
        double edge = elem_exp(-radius * radius / s);
        double value = elem_exp(-a * a * radius * radius / s) - edge;
        return value > 0 ? value : 0;
    }
    case FILTER_MITCHELL: {
        double b = (double)spec->b, c = (double)spec->c;
        double y = 2 * a;
        if (y > 2)
            return 0;
        if (y > 1)
            return ((-b - 6 * c) * y * y * y + (6 * b + 30 * c) * y * y + (-12 * b - 48 * c) * y +
                    (8 * b + 24 * c)) /
                   6;
        return ((12 - 9 * b - 6 * c) * y * y * y + (-18 + 12 * b + 6 * c) * y * y + (6 - 2 * b)) /
               6;
    }
    case FILTER_BOX:
        break;
    }
    return 1;
}

/*
 * Invert the cumulative integral of max(sign f, 0) over x in [0, 1]; returns that integral. The
 * half axis is enough, as filters are symmetric, and it keeps a lobe in one piece.
 */
static double invert(const struct filter_spec *spec, double radius, double sign,
                     float table[FILTER_TABLE_LEN + 1])
{
    double total = 0;
    for (int i = 0; i < FINE; i++) {
        double value = sign * filter_axis(spec, radius, (i + 0.5) / FINE);
        total += value > 0 ? value : 0;
    }
    double sum = 0;
    int next = 1;
    table[0] = 0;
    for (int i = 0; i < FINE && total > 0; i++) {
        double value = sign * filter_axis(spec, radius, (i + 0.5) / FINE);
        value = value > 0 ? value : 0;
        if (sum <= 0) /* the lobe has not begun */
            table[0] = (float)((double)i / FINE);
        while (next < FILTER_TABLE_LEN && sum + value >= total * next / FILTER_TABLE_LEN) {
            double part = value > 0 ? (total * next / FILTER_TABLE_LEN - sum) / value : 0;
            table[next++] = (float)((i + part) / FINE);
        }
        sum += value;
        if (value > 0)
            table[FILTER_TABLE_LEN] = (float)((i + 1.0) / FINE);
    }
    while (next < FILTER_TABLE_LEN)
        table[next++] = table[FILTER_TABLE_LEN];
    return total / FINE;
}

void filter_table_make(struct filter_table *table, const struct filter_spec *spec)
{
    memset(table, 0, sizeof(*table));
    table->kind = spec->kind;
    table->radius[0] = spec->radius[0];
    table->radius[1] = spec->radius[1];
    table->weight_positive = 1;
    table->both_positive = 1;
    if (spec->kind == FILTER_BOX)
        return;

    double positive = 0, negative = 0;
    for (int axis = 0; axis < 2; axis++) {
        positive = invert(spec, (double)spec->radius[axis], 1, table->positive[axis]);
        negative = invert(spec, (double)spec->radius[axis], -1, table->negative[axis]);
    }
    if (spec->kind != FILTER_MITCHELL || negative <= 0)
        return;
    /* Both axes of a Mitchell filter have the same shape */
    double whole = (positive - negative) * (positive - negative);
    double pp = positive * positive / whole, nn = negative * negative / whole;
    table->has_negative = 1;
    table->both_positive = (float)(pp / (pp + nn));
    table->weight_positive = (float)((pp + nn) * 4 / 3);
    /* -4 pn but for rounding, taken so that three of the one and one of the other make four */
    table->weight_negative = (float)(4 - 3 * (double)table->weight_positive);
}
