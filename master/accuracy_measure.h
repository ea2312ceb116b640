/*
 * How far a way of rendering is from the truth, told from several pictures of it with seeds of
 * their own and a reference that shares no seed with any. `pathfarm accuracy` measures with it.
 *
 * Squared errors are relative: (x - r)^2 / (r^2 + ACCURACY_EPSILON), averaged over channels and
 * pixels. Of S pictures x_s of the truth t, seen through a reference r = t + noise,
 *     relmse   = mean of (x_s - r)^2, minus the reference's own variance
 *     variance = mean of the sample variance of x_s over s
 *     bias2    = relmse - variance, which is the mean of (x_s - r)(x_u - r) over pairs s != u
 *                minus the reference's variance: zero on average when nothing is wrong, and
 *                therefore negative about every other time.
 * Pixels have numbers of their own, so errors of means follow from the pixels: of relmse from how
 * each pixel's squared error differs between the pictures, of bias2 from how the pixels differ.
 *
 * Pure; any thread.
 */
#ifndef MASTER_ACCURACY_MEASURE_H
#define MASTER_ACCURACY_MEASURE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct image;

#define ACCURACY_EPSILON 0.01
#define ACCURACY_BAND    1.96 /* standard errors to either side: 95 % */

struct accuracy_point {
    double relmse,
        relmse_error; /* standard errors; NaN with a single picture, as is what follows */
    double variance;
    double bias2, bias2_error;
    uint64_t pixels;  /* that count */
    uint64_t skipped; /* not finite in some picture or the reference */
};

/*
 * Measure pictures of the same window as the reference, by channels R, G and B. ERR_ARGUMENT when
 * sizes differ or a channel is missing.
 */
bool accuracy_measure_pictures(const struct image *const *pictures, size_t count,
                               const struct image *reference, struct accuracy_point *out,
                               struct err *err);

/*
 * The reference's own relative variance, by its channels stderr.R, .G and .B: what was subtracted.
 * NaN when it has none, or they do not say: then nothing was.
 */
double accuracy_measure_reference(const struct image *reference);

#endif
