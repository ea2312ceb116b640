/*
 * For statistical tests of samplers: random lanes with fixed seeds, and the chi-square test of
 * sampled directions against the density they claim.
 *
 * A density is integrated numerically over a grid of directions around an axis. Cells in theta are
 * spaced by a power, so that narrow lobes around the axis are resolved. Two things are then asked:
 * that the counts fit the integrals (Pearson, cells of less than five pooled), and that the whole
 * integral is the share of samples that came back valid. The first sees a wrong shape, the second a
 * wrong scale.
 */
#ifndef TESTS_CHI2_H
#define TESTS_CHI2_H

#include "common/hash.h"
#include "common/lane.h"
#include "common/stats.h"
#include "tests/expect.h"
#include "worker/kernel/frame.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* One test fails by chance with this probability; a planted bug must do worse than CHI2_CAUGHT */
#define CHI2_ALPHA  1e-5
#define CHI2_CAUGHT 1e-8

struct random_lanes {
    uint64_t seed, next;
};

static inline double random_double(struct random_lanes *r)
{
    return (double)(hash64(r->next++, r->seed) >> 11) * 0x1p-53;
}

/* In [0, 1 - 2^-24], as the samplers give them */
static inline f8 random_f8(struct random_lanes *r)
{
    f8 u;
    for (int lane = 0; lane < LANES; lane++)
        u[lane] = (float)(hash64(r->next++, r->seed) >> 40) * 0x1p-24f;
    return u;
}

static inline struct vec3x8 random_direction(struct random_lanes *r)
{
    struct vec3x8 w;
    for (int lane = 0; lane < LANES; lane++) {
        double z = 2 * random_double(r) - 1, phi = 6.283185307179586 * random_double(r);
        double across = sqrt(1 - z * z);
        w.x[lane] = (float)(across * cos(phi));
        w.y[lane] = (float)(across * sin(phi));
        w.z[lane] = (float)z;
    }
    return w;
}

/* ---- mean and standard error of a stream */

struct tally {
    double n, sum, squares;
};

static inline void tally_add(struct tally *t, double x)
{
    t->n += 1;
    t->sum += x;
    t->squares += x * x;
}

static inline double tally_mean(const struct tally *t)
{
    return t->sum / t->n;
}

static inline double tally_variance(const struct tally *t)
{
    double mean = tally_mean(t);
    return fmax(t->squares / t->n - mean * mean, 0) * t->n / (t->n - 1);
}

/* Standard errors between the mean and `want`; rounding counts as 1e-5 of it */
static inline double tally_z(const struct tally *t, double want)
{
    double noise = sqrt(tally_variance(t) / t->n) + 1e-5 * fabs(want) + 1e-30;
    return fabs(tally_mean(t) - want) / noise;
}

/* ---- chi-square over the sphere of directions */

#define CHI2_ROWS    40
#define CHI2_COLUMNS 24
#define CHI2_CELLS   (CHI2_ROWS * CHI2_COLUMNS)
#define CHI2_FINE    16 /* midpoints along each side of a cell */

struct chi2_case {
    void *self;
    float axis[3];
    double power; /* theta = pi t^power: 1 for broad densities, 3 or 4 for narrow lobes */
    unsigned samples;
    uint64_t seed;
    /* The density at w, and samples with the lanes that are valid and not delta events */
    void (*pdf)(void *self, const struct vec3x8 *w, f8 *pdf);
    void (*sample)(void *self, struct random_lanes *random, struct vec3x8 *w, i8 *valid);
};

struct chi2_result {
    double p;                   /* of Pearson's statistic */
    double integral;            /* of the density over the sphere */
    double share;               /* of samples that were valid */
    unsigned long long outside; /* samples where the density is zero all around */
};

static inline void chi2_integrate(const struct chi2_case *c, const struct frame8 *frame,
                                  double mass[CHI2_CELLS])
{
    for (int row = 0; row < CHI2_ROWS; row++)
        for (int i = 0; i < CHI2_FINE; i++) {
            double t = (row + (i + 0.5) / CHI2_FINE) / CHI2_ROWS;
            double theta = M_PI * pow(t, c->power);
            double dtheta = M_PI * c->power * pow(t, c->power - 1) / (CHI2_ROWS * CHI2_FINE);
            for (int j = 0; j < CHI2_COLUMNS * CHI2_FINE; j += LANES) {
                struct vec3x8 local = vec3x8_all(0, 0, (float)cos(theta));
                for (int lane = 0; lane < LANES; lane++) {
                    double phi = 2 * M_PI * (j + lane + 0.5) / (CHI2_COLUMNS * CHI2_FINE);
                    local.x[lane] = (float)(sin(theta) * cos(phi));
                    local.y[lane] = (float)(sin(theta) * sin(phi));
                }
                struct vec3x8 w = frame_to_world(frame, local);
                f8 pdf;
                c->pdf(c->self, &w, &pdf);
                double sum = 0;
                for (int lane = 0; lane < LANES; lane++)
                    sum += (double)pdf[lane];
                mass[row * CHI2_COLUMNS + j / CHI2_FINE] += sum * sin(theta) * dtheta * 2 * M_PI /
                                                            (CHI2_COLUMNS * CHI2_FINE);
            }
        }
}

static inline int chi2_cell(const struct chi2_case *c, const struct frame8 *frame,
                            const struct vec3x8 *w, int lane)
{
    struct vec3x8 local = frame_to_local(frame, *w);
    double x = (double)local.x[lane], y = (double)local.y[lane], z = (double)local.z[lane];
    double t = pow(atan2(hypot(x, y), z) / M_PI, 1 / c->power);
    double turn = atan2(y, x) / (2 * M_PI);
    int row = (int)(t * CHI2_ROWS), column = (int)((turn < 0 ? turn + 1 : turn) * CHI2_COLUMNS);
    row = row < CHI2_ROWS ? row : CHI2_ROWS - 1;
    column = column < CHI2_COLUMNS ? column : CHI2_COLUMNS - 1;
    return row * CHI2_COLUMNS + column;
}

static inline int chi2_by_mass(const void *a, const void *b)
{
    const double *x = a, *y = b;
    return (x[0] > y[0]) - (x[0] < y[0]);
}

/* Pearson's test after pooling cells that expect fewer than five, smallest first */
static inline double chi2_pooled(const double *mass, const unsigned long long *counts, int cells,
                                 double samples)
{
    double(*sorted)[2] = malloc((size_t)cells * sizeof(*sorted));
    double total = 0, statistic = 0, expected = 0, counted = 0;
    int bins = 0;
    for (int i = 0; i < cells; i++) {
        sorted[i][0] = mass[i] * samples;
        sorted[i][1] = (double)counts[i];
        total += (double)counts[i];
    }
    qsort(sorted, (size_t)cells, sizeof(*sorted), chi2_by_mass);
    double integral = 0;
    for (int i = 0; i < cells; i++)
        integral += sorted[i][0];
    /* The scale is tested elsewhere; here the shape alone */
    double scale = total / integral;
    for (int i = 0; i < cells; i++) {
        expected += sorted[i][0] * scale;
        counted += sorted[i][1];
        if (expected >= 5) {
            statistic += (counted - expected) * (counted - expected) / expected;
            expected = counted = 0;
            bins++;
        }
    }
    free(sorted);
    return bins < 2 ? 1 : stats_chi_square_survival(statistic, bins - 1);
}

static inline struct chi2_result chi2_run(const struct chi2_case *c)
{
    static double mass[CHI2_CELLS];
    static unsigned long long counts[CHI2_CELLS];
    memset(mass, 0, sizeof(mass));
    memset(counts, 0, sizeof(counts));
    struct frame8 frame = frame_around(vec3x8_unit(vec3x8_all(c->axis[0], c->axis[1], c->axis[2])));
    chi2_integrate(c, &frame, mass);

    struct random_lanes random = { c->seed, 0 };
    unsigned long long valid_count = 0;
    for (unsigned i = 0; i < c->samples; i += LANES) {
        struct vec3x8 w;
        i8 valid;
        c->sample(c->self, &random, &w, &valid);
        for (unsigned todo = i8_bits(valid); todo != 0; todo &= todo - 1) {
            counts[chi2_cell(c, &frame, &w, __builtin_ctz(todo))]++;
            valid_count++;
        }
    }

    struct chi2_result result = { .share = (double)valid_count / c->samples };
    for (int i = 0; i < CHI2_CELLS; i++) {
        result.integral += mass[i];
        if (mass[i] <= 0)
            result.outside += counts[i];
    }
    result.p = chi2_pooled(mass, counts, CHI2_CELLS, c->samples);
    return result;
}

/* Does the density have the scale that the samples have? `slack` is what the quadrature may err */
static inline bool chi2_scale_right(const struct chi2_result *r, unsigned samples, double slack)
{
    double sigma = sqrt(r->share * (1 - r->share) / samples);
    return fabs(r->integral - r->share) <= 4.5 * sigma + slack;
}

#endif
