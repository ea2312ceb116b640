#include "master/estimate.h"

#include "common/sumtree.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EPSILON          0.01 /* relMSE's, in the denominator */
#define LIGHT_SHARE      (1.0 / 16)
#define ERROR_SHARE      0.25
#define UNKNOWN_SHARE    0.1
#define FEWEST_VALUES    10.0
#define TOO_MUCH_FOR_TWO 0.001 /* relMSE, with two replicates */
#define NOISY            0.1   /* relMSE of a value that a few samples may hold */
#define DOUBT            4.0   /* how far that may be wrong, see estimate_result */
#define DOUBT_MOST       0.75  /* of the estimate */
#define UNKNOWN_NOISE    0.3   /* relMSE of a pixel that is not known */
#define PAIRS            6     /* of channels, each with itself and the others */

/* What one of the two measures, MSE or relMSE, adds up. */
struct measure {
    double sum;            /* squared errors, over pixels and channels */
    double unknown_sum;    /* the part of unknown tiles */
    double squares;        /* of the pixels' squared errors */
    double trace2;         /* tr(C^2) over the pixels */
    double trace2_squares; /* of each pixel's, squared */
};

/* One tile's scratch: a value per pixel. Variances are those of the mean over replicates. */
struct work {
    double distance[3][TILE_PIXELS]; /* of one replicate's mean from that over all */
    double mean[3][TILE_PIXELS];
    double third[3][TILE_PIXELS]; /* sums of the cubes of distances */
    double covariance[PAIRS][TILE_PIXELS];
    double weight[3][TILE_PIXELS];                       /* 1 / (r^2 + epsilon) */
    double absolute[TILE_PIXELS], relative[TILE_PIXELS]; /* squared errors, over channels */
};

struct estimate {
    struct measure mse, relmse;
    double noisy; /* squares of the relMSE of values above NOISY */
    double light;
    uint64_t pixels, unknown_pixels, empty_pixels;
    uint32_t replicates;
    bool nonfinite;
    struct work *work;
};

/* The channels of each pair, those of a channel with itself first. */
static const uint8_t pair[PAIRS][2] = {
    { 0, 0 }, { 1, 1 }, { 2, 2 }, { 0, 1 }, { 0, 2 }, { 1, 2 }
};

struct estimate *estimate_new(void)
{
    struct estimate *estimate = calloc(1, sizeof(*estimate));
    if (estimate == NULL)
        return NULL;
    estimate->work = calloc(1, sizeof(*estimate->work));
    if (estimate->work == NULL) {
        free(estimate);
        return NULL;
    }
    return estimate;
}

void estimate_free(struct estimate *estimate)
{
    if (estimate == NULL)
        return;
    free(estimate->work);
    free(estimate);
}

void estimate_begin(struct estimate *estimate, uint32_t replicates)
{
    *estimate = (struct estimate){ .work = estimate->work, .replicates = replicates };
}

/* Means over the replicates, and how the replicates scatter about them. */
static void scatter(const struct tile_means *tile, struct work *work)
{
    uint32_t pixels = tile->width * tile->height, k_count = tile->replicates;
    memset(work->mean, 0, sizeof(work->mean));
    memset(work->third, 0, sizeof(work->third));
    memset(work->covariance, 0, sizeof(work->covariance));
    for (uint32_t c = 0; c < 3; c++) {
        for (uint32_t k = 0; k < k_count; k++)
            for (uint32_t p = 0; p < pixels; p++)
                work->mean[c][p] += tile->means[((size_t)k * 3 + c) * pixels + p];
        for (uint32_t p = 0; p < pixels; p++)
            work->mean[c][p] /= k_count;
    }
    for (uint32_t k = 0; k < k_count; k++) {
        for (uint32_t c = 0; c < 3; c++) {
            const double *means = tile->means + ((size_t)k * 3 + c) * pixels;
            for (uint32_t p = 0; p < pixels; p++) {
                double distance = means[p] - work->mean[c][p];
                work->distance[c][p] = distance;
                work->third[c][p] += distance * distance * distance;
            }
        }
        for (uint32_t i = 0; i < PAIRS; i++) {
            const double *a = work->distance[pair[i][0]], *b = work->distance[pair[i][1]];
            for (uint32_t p = 0; p < pixels; p++)
                work->covariance[i][p] += a[p] * b[p];
        }
    }
    double scale = 1 / ((double)k_count * (k_count - 1));
    for (uint32_t i = 0; i < PAIRS; i++)
        for (uint32_t p = 0; p < pixels; p++)
            work->covariance[i][p] *= scale;
}

/*
 * What s^2 / K must be multiplied with to give relMSE. The noise of the mean adds f'' / 2 times its
 * variance to the expectation of f(mean) = 1 / (mean^2 + epsilon), and f' times its covariance with
 * s^2, which is the third central moment of the replicates over K, where noise is skewed. Both are
 * taken off, in a form that stays between 0 and 4 f.
 */
static void weigh(const struct tile_means *tile, uint32_t channel, struct work *work)
{
    double k_count = tile->replicates;
    const double *mean = work->mean[channel], *variance = work->covariance[channel];
    const double *third = work->third[channel];
    double fourth_scale = (k_count - 1) / (k_count + 1); /* E s^4 = sigma^4 / this, if normal */
    double third_scale = k_count > 2 ? 1 / (k_count * (k_count - 1) * (k_count - 2)) : 0;
    double *weight = work->weight[channel];
    for (uint32_t p = 0; p < tile->width * tile->height; p++) {
        double f = 1 / (mean[p] * mean[p] + EPSILON);
        double bias = (3 * mean[p] * mean[p] - EPSILON) * f * f * variance[p] * fourth_scale;
        if (variance[p] > 0)
            bias -= 2 * mean[p] * f * third[p] * third_scale / variance[p];
        weight[p] = bias > 0 ? f / (1 + bias) : f * (bias > -3 ? 1 - bias : 4);
    }
}

/*
 * tr(C^2) of one pixel's covariance matrix of the mean from its estimate S with dof degrees of
 * freedom, normal means taken for granted: E tr(S^2) = tr(C^2) (1 + 1 / dof) + tr(C)^2 / dof. With
 * a single one, channels that are all alike are taken for granted, too.
 */
static double unbiased_trace2(double trace, double trace2, double dof)
{
    if (dof < 2)
        return trace2 / 3;
    double unbiased = dof * (dof * trace2 - trace * trace) / ((dof - 1) * (dof + 2));
    return unbiased > 0 ? unbiased : 0;
}

static void measure_pixel(struct measure *measure, double trace, double trace2, double pairs,
                          double dof)
{
    double unbiased = unbiased_trace2(trace, trace2, dof);
    if (dof >= 3)
        unbiased = (unbiased + pairs) / 2;
    measure->sum += trace;
    measure->squares += trace * trace;
    measure->trace2 += unbiased;
    measure->trace2_squares += unbiased * unbiased;
}

/* What the mean over the replicates may be wrong by in one pixel. */
struct pixel_error {
    double absolute, relative, luminance;  /* squared, over channels; of the luminance */
    double absolute2, relative2;           /* tr(S^2) */
    double absolute_pairs, relative_pairs; /* tr(C^2) from disjoint pairs, with K >= 4 */
};

static const double luminance_share[3] = { 0.2126, 0.7152, 0.0722 };

static struct pixel_error pixel_error(const struct work *work, uint32_t p)
{
    struct pixel_error e = { 0 };
    for (uint32_t i = 0; i < PAIRS; i++) {
        uint32_t a = pair[i][0], b = pair[i][1];
        double times = i < 3 ? 1 : 2, s = work->covariance[i][p];
        e.absolute2 += times * s * s;
        e.relative2 += times * s * s * work->weight[a][p] * work->weight[b][p];
        e.luminance += times * s * luminance_share[a] * luminance_share[b];
    }
    for (uint32_t c = 0; c < 3; c++) {
        e.absolute += work->covariance[c][p];
        e.relative += work->covariance[c][p] * work->weight[c][p];
    }
    return e;
}

/*
 * tr(C^2) without taking anything for granted: differences d of disjoint pairs of replicates are
 * independent, and E <d_ab, d_cd>^2 = 4 tr(C^2), C that of one replicate. All three ways to make
 * two pairs of four, for every four replicates.
 */
static void add_pairs(const struct tile_means *tile, const struct work *work, uint32_t p,
                      struct pixel_error *e)
{
    static const uint8_t split[3][4] = { { 0, 1, 2, 3 }, { 0, 2, 1, 3 }, { 0, 3, 1, 2 } };
    uint32_t quads = tile->replicates / 4;
    size_t pixels = (size_t)tile->width * tile->height, stride = 3 * pixels;
    for (uint32_t quad = 0; quad < quads; quad++)
        for (uint32_t s = 0; s < 3; s++) {
            double absolute = 0, relative = 0;
            for (uint32_t c = 0; c < 3; c++) {
                const double *m = tile->means + 4 * quad * stride + c * pixels + p;
                double product = (m[split[s][0] * stride] - m[split[s][1] * stride]) *
                                 (m[split[s][2] * stride] - m[split[s][3] * stride]);
                absolute += product;
                relative += product * work->weight[c][p];
            }
            e->absolute_pairs += absolute * absolute;
            e->relative_pairs += relative * relative;
        }
    double k_count = tile->replicates, scale = 1 / (4.0 * 3 * quads * k_count * k_count);
    e->absolute_pairs *= scale;
    e->relative_pairs *= scale;
}

static void measure_tile(const struct tile_means *tile, struct estimate *estimate,
                         double *luminance_error)
{
    const struct work *work = estimate->work;
    double dof = tile->replicates - 1;
    for (uint32_t p = 0; p < tile->width * tile->height; p++) {
        struct pixel_error e = pixel_error(work, p);
        if (tile->replicates >= 4)
            add_pairs(tile, work, p, &e);
        measure_pixel(&estimate->mse, e.absolute, e.absolute2, e.absolute_pairs, dof);
        measure_pixel(&estimate->relmse, e.relative, e.relative2, e.relative_pairs, dof);
        *luminance_error += e.luminance;
        for (uint32_t c = 0; c < 3; c++) {
            double error = work->covariance[c][p] * work->weight[c][p];
            if (error > NOISY)
                estimate->noisy += error * error;
        }
    }
}

/* Whether one sample holds so much of the tile that its variance cannot be trusted. */
static bool rests_on_one_sample(const struct tile_means *tile, double luminance_error)
{
    if (tile->largest > LIGHT_SHARE * tile->luminance)
        return true;
    double alone = tile->largest / (double)tile->samples;
    return luminance_error > 0 && alone * alone > ERROR_SHARE * luminance_error;
}

/* Pixels that lost samples, are hardly known, or may be what one sample makes a tile rest on. */
static uint32_t unknown_pixels(const struct tile_means *tile, const struct work *work, bool one)
{
    double alone = tile->largest / (double)tile->samples;
    uint32_t count = 0;
    for (uint32_t p = 0; p < tile->width * tile->height; p++) {
        struct pixel_error e = pixel_error(work, p);
        count += (tile->failed[p / 32] >> p % 32 & 1) != 0 || e.relative > 3 * UNKNOWN_NOISE ||
                 (one && e.luminance > ERROR_SHARE * alone * alone);
    }
    return count;
}

static uint32_t failed_pixels(const struct tile_means *tile)
{
    uint32_t count = 0;
    for (uint32_t p = 0; p < tile->width * tile->height; p++)
        count += tile->failed[p / 32] >> p % 32 & 1;
    return count;
}

bool estimate_tile(struct estimate *estimate, const struct tile_means *tile)
{
    uint32_t pixels = tile->width * tile->height, failed = failed_pixels(tile);
    assert(pixels <= TILE_PIXELS);
    estimate->pixels += pixels;
    estimate->light += tile->luminance;
    estimate->nonfinite = estimate->nonfinite || failed > 0;
    if (tile->replicates < estimate->replicates)
        estimate->replicates = tile->replicates;
    if (tile->replicates < 2) {
        estimate->unknown_pixels += pixels;
        estimate->empty_pixels += pixels;
        return false;
    }

    double absolute = estimate->mse.sum, relative = estimate->relmse.sum, luminance_error = 0;
    scatter(tile, estimate->work);
    for (uint32_t c = 0; c < 3; c++)
        weigh(tile, c, estimate->work);
    measure_tile(tile, estimate, &luminance_error);
    bool one = rests_on_one_sample(tile, luminance_error);
    if (one) {
        estimate->mse.unknown_sum += estimate->mse.sum - absolute;
        estimate->relmse.unknown_sum += estimate->relmse.sum - relative;
    }
    estimate->unknown_pixels += unknown_pixels(tile, estimate->work, one);
    return !one;
}

double estimate_student(double dof)
{
    static const double table[] = { 12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646,
                                    2.3060,  2.2622, 2.2281, 2.2010, 2.1788, 2.1604, 2.1448,
                                    2.1314,  2.1199, 2.1098, 2.1009, 2.0930, 2.0860 };
    const double last = sizeof(table) / sizeof(*table), z = 1.959964;
    if (!(dof > 1))
        return table[0];
    if (dof >= last) /* the first two terms of the expansion in 1 / dof */
        return z + (z * z * z + z) / (4 * dof) +
               (5 * z * z * z * z * z + 16 * z * z * z + 3 * z) / (96 * dof * dof);
    unsigned below = (unsigned)dof;
    double part = dof - below;
    return table[below - 1] + part * (table[below] - table[below - 1]);
}

static double cube(double x)
{
    return x * x * x;
}

struct interval estimate_f95(double n, double m, double z)
{
    double a = 2 / (9 * n), b = 2 / (9 * m);
    double bottom = (1 - b) * (1 - b) - b * z * z;
    double middle = (1 - a) * (1 - b);
    double spread2 = a * (1 - b) * (1 - b) + b * (1 - a) * (1 - a) - a * b * z * z;
    if (bottom <= 0 || spread2 < 0)
        return (struct interval){ 0, INFINITY };
    double spread = z * sqrt(spread2);
    double low = (middle - spread) / bottom;
    return (struct interval){ low > 0 ? cube(low) : 0, cube((middle + spread) / bottom) };
}

static double effective_values(const struct measure *measure)
{
    return measure->trace2 > 0 ? measure->sum * measure->sum / measure->trace2 : INFINITY;
}

/* Whether the error rests on a few pixels, by the values that hold it and by their shares. */
static bool rests_on_few(const struct measure *measure)
{
    return effective_values(measure) < FEWEST_VALUES ||
           measure->sum * measure->sum < FEWEST_VALUES * measure->squares;
}

/*
 * The 95 % interval of a measure, as factors of its estimate. n is an estimate, too, and the fewer
 * pixels hold it the less it is known: hence Student's t.
 */
static struct interval factors95(const struct measure *measure, uint32_t replicates)
{
    if (!(measure->trace2 > 0))
        return (struct interval){ 1, 1 };
    double n = effective_values(measure);
    double pixels = measure->trace2 * measure->trace2 / measure->trace2_squares;
    return estimate_f95(n, n * (replicates - 1), estimate_student(pixels));
}

static enum accuracy_verdict verdict_of(const struct estimate *estimate,
                                        const struct measure *measure)
{
    if (estimate->replicates < 2)
        return ACCURACY_NO_REPLICATES;
    if (estimate->nonfinite)
        return ACCURACY_NONFINITE;
    if (!(estimate->light > 0))
        return ACCURACY_BLACK;
    double values = 3 * (double)(estimate->pixels - estimate->empty_pixels);
    if (estimate->replicates == 2 && measure == &estimate->relmse &&
        measure->sum > TOO_MUCH_FOR_TWO * values)
        return ACCURACY_TWO_REPLICATES;
    if (measure->unknown_sum > UNKNOWN_SHARE * measure->sum ||
        (measure == &estimate->relmse && DOUBT * estimate->noisy > DOUBT_MOST * measure->sum))
        return ACCURACY_FEW_SAMPLES;
    if (rests_on_few(measure))
        return ACCURACY_FEW_PIXELS;
    return ACCURACY_KNOWN;
}

struct accuracy estimate_result(const struct estimate *estimate)
{
    struct accuracy out = { .verdict = verdict_of(estimate, &estimate->relmse),
                            .mse_verdict = verdict_of(estimate, &estimate->mse),
                            .replicates = estimate->replicates };
    if (estimate->pixels > 0)
        out.unknown_share = (double)estimate->unknown_pixels / (double)estimate->pixels;
    out.mse95.high = out.rmse95.high = out.relmse95.high = INFINITY;
    if (estimate->replicates < 2 || estimate->empty_pixels == estimate->pixels)
        return out;

    double values = 3 * (double)(estimate->pixels - estimate->empty_pixels);
    out.mse = estimate->mse.sum / values;
    out.rmse = sqrt(out.mse);
    out.relmse = estimate->relmse.sum / values;
    out.effective_values = effective_values(&estimate->relmse);

    struct interval factors = factors95(&estimate->mse, estimate->replicates);
    out.mse95 = (struct interval){ out.mse * factors.low, out.mse * factors.high };
    out.rmse95 = (struct interval){ sqrt(out.mse95.low), sqrt(out.mse95.high) };

    factors = factors95(&estimate->relmse, estimate->replicates);
    out.relmse95.low = out.relmse * factors.low;
    out.relmse95.high = out.relmse * factors.high + DOUBT * estimate->noisy / values;
    return out;
}

const char *estimate_verdict_text(enum accuracy_verdict verdict)
{
    switch (verdict) {
#define X(name, text)     \
    case ACCURACY_##name: \
        return text;
        ACCURACY_MAP(X)
#undef X
    }
    return "unknown";
}
