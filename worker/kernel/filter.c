#include "worker/kernel/filter.h"

#include "common/elem.h"

#include <math.h>
#include <string.h>

#define PI   3.14159265358979323846
#define FINE 65536 /* steps of the numeric integrals */

/* One axis of the filter at x in [-1, 1] times its radius, but not at 0; pbrt-v4, section 8.8 */
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
    case FILTER_SINC: {
        double y = PI * a * radius, window = y / (double)spec->tau;
        return elem_sin(y) / y * (elem_sin(window) / window);
    }
    case FILTER_BOX:
        break;
    }
    return 1;
}

/* A run of one sign; in steps of the numeric integral */
struct lobe {
    int begin, end;
    double mass;
};

static double value_at(const struct filter_spec *spec, double radius, double sign, int step)
{
    double value = sign * filter_axis(spec, radius, (step + 0.5) / FINE);
    return value > 0 ? value : 0;
}

/* Into len equal shares of the lobe's mass */
static void invert_lobe(const struct filter_spec *spec, double radius, double sign,
                        const struct lobe *lobe, int len, float *table)
{
    double sum = 0;
    int next = 1;
    table[0] = (float)((double)lobe->begin / FINE);
    for (int i = lobe->begin; i < lobe->end; i++) {
        double value = value_at(spec, radius, sign, i);
        while (next < len && sum + value >= lobe->mass * next / len) {
            double part = value > 0 ? (lobe->mass * next / len - sum) / value : 0;
            table[next++] = (float)((i + part) / FINE);
        }
        sum += value;
    }
    while (next <= len)
        table[next++] = (float)((double)lobe->end / FINE);
}

/*
 * Invert the cumulative integral of max(sign f, 0) over x in [0, 1]; returns that integral. Half an
 * axis is enough, as filters are symmetric, and it keeps the lobe in the middle in one piece.
 */
static double invert(const struct filter_spec *spec, double radius, double sign,
                     struct filter_part *part)
{
    struct lobe lobes[FILTER_LOBES];
    double total = 0, before = 0;
    bool inside = false;
    for (int i = 0; i < FINE; i++) {
        double value = value_at(spec, radius, sign, i);
        if (value > 0 && !inside && part->lobes < FILTER_LOBES)
            lobes[part->lobes++] = (struct lobe){ .begin = i };
        inside = value > 0;
        if (inside) {
            lobes[part->lobes - 1].end = i + 1;
            lobes[part->lobes - 1].mass += value;
            total += value;
        }
    }
    int len = part->lobes > 0 ? (FILTER_TABLE_LEN + 1) / part->lobes - 1 : 0;
    for (int i = 0; i < part->lobes; i++) {
        const struct lobe *lobe = &lobes[i];
        part->begin[i] = (float)(before / total);
        part->first[i] = (float)(i * (len + 1));
        part->step[i] = (float)(len * total / lobe->mass);
        invert_lobe(spec, radius, sign, lobe, len, part->table + (size_t)i * (size_t)(len + 1));
        before += lobe->mass;
    }
    for (int i = part->lobes * (len + 1); part->lobes > 0 && i < FILTER_TABLE_LEN + 2; i++)
        part->table[i] = part->table[i - 1];
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

    double positive[2], negative[2];
    for (int axis = 0; axis < 2; axis++) {
        positive[axis] = invert(spec, (double)spec->radius[axis], 1, &table->positive[axis]);
        negative[axis] = invert(spec, (double)spec->radius[axis], -1, &table->negative[axis]);
    }
    if (!(negative[0] > 0 || negative[1] > 0))
        return;
    double whole = (positive[0] - negative[0]) * (positive[1] - negative[1]);
    double pp = positive[0] * positive[1] / whole, nn = negative[0] * negative[1] / whole;
    double np = negative[0] * positive[1] / whole, pn = positive[0] * negative[1] / whole;
    table->has_negative = 1;
    table->both_positive = (float)(pp / (pp + nn));
    table->only_x = (float)(np / (np + pn));
    /* The other weight is -4 (np + pn) but for rounding, taken so that three of the one and one of
     * the other make four; which is a float, if that of large weights has bits to spare */
    double weight = (pp + nn) * 4 / 3;
    if (weight > 2.5)
        weight = rint(weight * 0x1p16) * 0x1p-16;
    table->weight_positive = (float)weight;
    table->weight_negative = (float)(4 - 3 * (double)table->weight_positive);
}
