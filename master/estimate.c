#include "master/estimate.h"

#include "common/sumtree.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EPSILON          0.01   /* relMSE's, in the denominator */
#define KNOWN_ENOUGH     0.0225 /* squared relative noise at which a pixel can stand alone */
#define LIGHT_SHARE      (1.0 / 16)
#define ERROR_SHARE      0.25
#define UNKNOWN_SHARE    0.1
#define FEWEST_VALUES    10.0
#define TOO_MUCH_FOR_TWO 0.001 /* relMSE, with two replicates */
#define BLOCK_SIZE       8
#define BLOCKS_ACROSS    (TILE_SIZE / BLOCK_SIZE)
#define BLOCKS           (BLOCKS_ACROSS * BLOCKS_ACROSS)
#define WINDOWS          3 /* radius 0, 1, 2 */

/* What one of the two measures, MSE or relMSE, adds up. */
struct measure {
    double sum;            /* squared errors, over pixels and channels */
    double unknown_sum;    /* the part of unknown tiles */
    double squares;        /* of the pixels' squared errors */
    double trace2;         /* tr(C^2) over the blocks */
    double trace2_squares; /* of each block's, squared */
};

struct estimate {
    struct measure mse, relmse;
    double relmse_alone, relmse_plain; /* see struct work */
    double light;
    uint64_t pixels, unknown_pixels, empty_pixels;
    uint32_t replicates;
    bool nonfinite;

    uint32_t capacity; /* replicates the scratch below has room for */
    double *scratch;
};

/* What the denominators of one channel are made of, each pixel over its own window. */
struct denominator {
    double *sum;      /* [k]: of the replicate's means */
    double *total;    /* of those over k */
    double *scale;    /* turns the sum over a window and a pair's other replicates into a mean */
    double *variance; /* of that mean */
};

/* One tile's scratch: TILE_PIXELS doubles each, times K where it says [k]. */
struct work {
    double *mean, *s2;     /* over replicates, one channel */
    double *area[WINDOWS]; /* pixels in the window */
    double *s2_box[WINDOWS];
    double *box[WINDOWS];             /* [k]: window sums of the means */
    struct denominator chosen, alone; /* over each pixel's window; of the pixel itself */
    double *weight[3];                /* per channel: the mean 1 / (r^2 + epsilon) */
    double *absolute, *relative;      /* squared errors, over channels */
    double *relative_alone, *plain;   /* without windows; without taking the bias off */
    double *dot, *relative_dot, *row; /* for a moment */
};
#define WORK_ARRAYS(k) (4 * (k) + 24)

static double *take(double **next, uint32_t arrays)
{
    double *taken = *next;
    *next += (size_t)arrays * TILE_PIXELS;
    return taken;
}

static struct denominator take_denominator(double **next, uint32_t replicates)
{
    return (struct denominator){ .sum = take(next, replicates),
                                 .total = take(next, 1),
                                 .scale = take(next, 1),
                                 .variance = take(next, 1) };
}

static struct work work_in(double *scratch, uint32_t replicates)
{
    double *next = scratch;
    struct work work = { .mean = take(&next, 1),
                         .s2 = take(&next, 1),
                         .chosen = take_denominator(&next, replicates),
                         .alone = take_denominator(&next, 0),
                         .absolute = take(&next, 1),
                         .relative = take(&next, 1),
                         .relative_alone = take(&next, 1),
                         .plain = take(&next, 1),
                         .dot = take(&next, 1),
                         .relative_dot = take(&next, 1),
                         .row = take(&next, 1) };
    for (unsigned radius = 0; radius < WINDOWS; radius++) {
        work.area[radius] = take(&next, 1);
        work.s2_box[radius] = take(&next, 1);
        work.box[radius] = take(&next, replicates);
    }
    for (unsigned c = 0; c < 3; c++)
        work.weight[c] = take(&next, 1);
    assert(next == scratch + (size_t)WORK_ARRAYS(replicates) * TILE_PIXELS);
    return work;
}

struct estimate *estimate_new(void)
{
    return calloc(1, sizeof(struct estimate));
}

void estimate_free(struct estimate *estimate)
{
    if (estimate == NULL)
        return;
    free(estimate->scratch);
    free(estimate);
}

bool estimate_begin(struct estimate *estimate, uint32_t replicates)
{
    double *scratch = estimate->scratch;
    uint32_t capacity = estimate->capacity;
    if (capacity < replicates) {
        scratch = realloc(scratch, sizeof(*scratch) * TILE_PIXELS * WORK_ARRAYS(replicates));
        if (scratch == NULL)
            return false;
        capacity = replicates;
    }
    *estimate = (struct estimate){ .capacity = capacity,
                                   .scratch = scratch,
                                   .replicates = replicates };
    return true;
}

static double sum_of(const double *values, uint32_t count)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++)
        sum += values[i];
    return sum;
}

/* Sums over the window of `radius` around each pixel, cut at the tile's edges. */
static void box_sum(const double *in, uint32_t width, uint32_t height, uint32_t radius, double *row,
                    double *out)
{
    for (uint32_t y = 0; y < height; y++) {
        const double *from = in + y * width;
        double *to = row + y * width;
        memcpy(to, from, width * sizeof(*to));
        for (uint32_t d = 1; d <= radius && d < width; d++) {
            for (uint32_t x = 0; x < width - d; x++)
                to[x] += from[x + d];
            for (uint32_t x = d; x < width; x++)
                to[x] += from[x - d];
        }
    }
    memcpy(out, row, (size_t)width * height * sizeof(*out));
    for (uint32_t d = 1; d <= radius && d < height; d++) {
        uint32_t shift = d * width, count = (height - d) * width;
        for (uint32_t i = 0; i < count; i++)
            out[i] += row[i + shift];
        for (uint32_t i = 0; i < count; i++)
            out[i + shift] += row[i];
    }
}

/* s2 of the K values at stride, per pixel. */
static void variance_of_means(const double *means, size_t stride, uint32_t replicates,
                              uint32_t pixels, double *mean, double *s2)
{
    memset(mean, 0, pixels * sizeof(*mean));
    memset(s2, 0, pixels * sizeof(*s2));
    for (uint32_t k = 0; k < replicates; k++)
        for (uint32_t p = 0; p < pixels; p++)
            mean[p] += means[k * stride + p];
    for (uint32_t p = 0; p < pixels; p++)
        mean[p] /= replicates;
    for (uint32_t k = 0; k < replicates; k++)
        for (uint32_t p = 0; p < pixels; p++) {
            double distance = means[k * stride + p] - mean[p];
            s2[p] += distance * distance;
        }
    for (uint32_t p = 0; p < pixels; p++)
        s2[p] /= replicates - 1;
}

/*
 * The noise of a mean adds f''/2 * variance to the expectation of f(mean) = 1 / (mean^2 + epsilon).
 * That is taken off, in a form that stays between 0 and 1 / epsilon.
 */
static inline double without_bias(double f, double mean, double variance)
{
    double bias = (3 * mean * mean - EPSILON) * f * f * variance; /* relative to f */
    double more = bias > 0 ? bias : 0, less = bias < 0 ? bias : 0;
    double unbiased = f * (1 - less) / (1 + more);
    return unbiased < 1 / EPSILON ? unbiased : 1 / EPSILON;
}

/* How many replicates a pair's denominator is the mean of. */
static uint32_t denominator_replicates(uint32_t replicates)
{
    return replicates > 2 ? replicates - 2 : 2;
}

/* Sums over one window size of everything a denominator is made of. */
static void fill_window(const struct tile_means *tile, const double *means, size_t stride,
                        uint32_t radius, struct work *work)
{
    uint32_t pixels = tile->width * tile->height;
    for (uint32_t k = 0; k < tile->replicates; k++)
        box_sum(means + k * stride, tile->width, tile->height, radius, work->row,
                work->box[radius] + (size_t)k * pixels);
    box_sum(work->s2, tile->width, tile->height, radius, work->row, work->s2_box[radius]);
}

/*
 * The variance of a pair's denominator is that of the window's mean. The pixel's own s2 is part of
 * it and goes along with the pair's squared difference (E s2^2 = (1 + 2 / dof) sigma^4), which the
 * last factor makes up for.
 */
static inline double denominator_variance(double s2_sum, double area, double scale,
                                          uint32_t replicates)
{
    return s2_sum / area * scale / (1 + 2 / (area * (replicates - 1)));
}

static void stand_alone(struct work *work, uint32_t pixels, uint32_t replicates)
{
    struct denominator *to = &work->alone;
    double scale = 1.0 / denominator_replicates(replicates);
    to->sum = work->box[0];
    for (uint32_t p = 0; p < pixels; p++) {
        to->total[p] = work->mean[p] * replicates;
        to->scale[p] = scale;
        to->variance[p] = denominator_variance(work->s2[p], 1, scale, replicates);
    }
}

/*
 * Choose each pixel's window, by the relative variance of its surroundings: what pixels next to an
 * edge have in common is their relative noise. False when every pixel can stand alone.
 */
static bool choose_windows(const struct tile_means *tile, const double *means, size_t stride,
                           struct work *work)
{
    uint32_t pixels = tile->width * tile->height, replicates = tile->replicates;
    double others = denominator_replicates(replicates);
    fill_window(tile, means, stride, 0, work);
    stand_alone(work, pixels, replicates);

    double *noise = work->dot, *pooled = work->relative_dot, worst = 0;
    for (uint32_t p = 0; p < pixels; p++)
        noise[p] = work->s2[p] / (work->mean[p] * work->mean[p] + EPSILON);
    box_sum(noise, tile->width, tile->height, 2, work->row, pooled);
    for (uint32_t p = 0; p < pixels; p++) {
        pooled[p] /= work->area[2][p] * others;
        worst = pooled[p] > worst ? pooled[p] : worst;
    }
    if (worst <= KNOWN_ENOUGH)
        return false;

    struct denominator *to = &work->chosen;
    fill_window(tile, means, stride, 1, work);
    fill_window(tile, means, stride, 2, work);
    for (uint32_t p = 0; p < pixels; p++) {
        uint32_t radius = 0;
        while (radius < WINDOWS - 1 && pooled[p] > KNOWN_ENOUGH * work->area[radius][p])
            radius++;
        double area = work->area[radius][p], scale = 1 / (area * others);
        to->scale[p] = scale;
        to->variance[p] = denominator_variance(work->s2_box[radius][p], area, scale, replicates);
        to->total[p] = 0;
        for (uint32_t k = 0; k < replicates; k++) {
            size_t at = (size_t)k * pixels + p;
            to->total[p] += to->sum[at] = work->box[radius][at];
        }
    }
    return true;
}

/* Squared differences over the squared denominators of the pair, added per pixel. */
static void divide_pair(const struct denominator *by, const double *restrict squared, uint32_t i,
                        uint32_t j, uint32_t pixels, double left_out, double *restrict relative,
                        double *restrict plain, double *restrict weight)
{
    const double *restrict bi = by->sum + (size_t)i * pixels;
    const double *restrict bj = by->sum + (size_t)j * pixels;
    const double *restrict total = by->total, *restrict scale = by->scale;
    const double *restrict variance = by->variance;
    for (uint32_t p = 0; p < pixels; p++) {
        double mean = (total[p] - left_out * (bi[p] + bj[p])) * scale[p];
        double f = 1 / (mean * mean + EPSILON);
        double unbiased = without_bias(f, mean, variance[p]);
        relative[p] += squared[p] * unbiased;
        plain[p] += squared[p] * f;
        weight[p] += unbiased;
    }
}

/* Add what the pair (i, j) of replicates says about one channel; `share` is 1 / (2 K pairs). */
static void add_pair(const struct tile_means *tile, const double *means, size_t stride, uint32_t i,
                     uint32_t j, double share, bool windows, struct work *work, double *weight)
{
    uint32_t pixels = tile->width * tile->height;
    double left_out = tile->replicates > 2 ? 1 : 0;
    const double *mi = means + i * stride, *mj = means + j * stride;
    double *squared = work->row;
    for (uint32_t p = 0; p < pixels; p++)
        squared[p] = (mi[p] - mj[p]) * (mi[p] - mj[p]) * share;
    divide_pair(windows ? &work->chosen : &work->alone, squared, i, j, pixels, left_out,
                work->relative, work->plain, weight);
    if (windows)
        divide_pair(&work->alone, squared, i, j, pixels, left_out, work->relative_alone, work->dot,
                    work->relative_dot);
}

/*
 * All pairs up to K = 5; beyond, each replicate with the next and the one after, in a ring, which
 * costs K steps in place of K^2 and a fifth of the degrees of freedom at most.
 */
static void add_pairs(const struct tile_means *tile, const double *means, size_t stride,
                      bool windows, struct work *work, double *weight)
{
    uint32_t k = tile->replicates, pixels = tile->width * tile->height;
    uint32_t pairs = k <= 5 ? k * (k - 1) / 2 : 2 * k;
    double share = 1 / (2.0 * k * pairs);
    memset(weight, 0, pixels * sizeof(*weight));
    if (k <= 5) {
        for (uint32_t i = 0; i < k; i++)
            for (uint32_t j = i + 1; j < k; j++)
                add_pair(tile, means, stride, i, j, share, windows, work, weight);
    } else {
        for (uint32_t i = 0; i < k; i++)
            for (uint32_t step = 1; step <= 2; step++)
                add_pair(tile, means, stride, i, (i + step) % k, share, windows, work, weight);
    }
    for (uint32_t p = 0; p < pixels; p++)
        weight[p] /= pairs;
}

static void measure_trace2(struct measure *measure, double trace2)
{
    measure->trace2 += trace2;
    measure->trace2_squares += trace2 * trace2;
}

/* tr(C^2) of each block from products of differences of disjoint pairs (see the header). */
static void add_blocks(struct estimate *estimate, const struct tile_means *tile,
                       const struct work *work)
{
    uint32_t k = tile->replicates, pixels = tile->width * tile->height, quads = k / 4;
    size_t stride = (size_t)3 * pixels;
    double trace2[BLOCKS] = { 0 }, relative_trace2[BLOCKS] = { 0 };
    static const uint8_t split[3][4] = { { 0, 1, 2, 3 }, { 0, 2, 1, 3 }, { 0, 3, 1, 2 } };

    for (uint32_t quad = 0; quad < quads; quad++)
        for (uint32_t s = 0; s < 3; s++) {
            const double *of[4];
            for (uint32_t i = 0; i < 4; i++)
                of[i] = tile->means + (4 * quad + split[s][i]) * stride;
            memset(work->dot, 0, pixels * sizeof(double));
            memset(work->relative_dot, 0, pixels * sizeof(double));
            for (uint32_t c = 0; c < 3; c++) {
                const double *weight = work->weight[c];
                for (uint32_t p = 0; p < pixels; p++) {
                    size_t at = (size_t)c * pixels + p;
                    double product = (of[0][at] - of[1][at]) * (of[2][at] - of[3][at]);
                    work->dot[p] += product;
                    work->relative_dot[p] += product * weight[p];
                }
            }
            double dot[BLOCKS] = { 0 }, relative_dot[BLOCKS] = { 0 };
            for (uint32_t y = 0, p = 0; y < tile->height; y++)
                for (uint32_t x = 0; x < tile->width; x++, p++) {
                    uint32_t block = y / BLOCK_SIZE * BLOCKS_ACROSS + x / BLOCK_SIZE;
                    dot[block] += work->dot[p];
                    relative_dot[block] += work->relative_dot[p];
                }
            for (uint32_t block = 0; block < BLOCKS; block++) {
                trace2[block] += dot[block] * dot[block];
                relative_trace2[block] += relative_dot[block] * relative_dot[block];
            }
        }

    /* 4 from the differences, k^2 since C is the covariance of the mean over replicates */
    double scale = 1 / (4.0 * 3 * quads * (double)k * k);
    for (uint32_t block = 0; block < BLOCKS; block++) {
        measure_trace2(&estimate->mse, trace2[block] * scale);
        measure_trace2(&estimate->relmse, relative_trace2[block] * scale);
    }
}

/* The bound for two or three replicates: one normal value per pixel, all channels alike. */
static void add_pixels(struct estimate *estimate, const struct tile_means *tile,
                       const struct work *work)
{
    double factor = 1 / (1 + 2.0 / (tile->replicates - 1));
    for (uint32_t p = 0; p < tile->width * tile->height; p++) {
        measure_trace2(&estimate->mse, work->absolute[p] * work->absolute[p] * factor);
        measure_trace2(&estimate->relmse, work->relative[p] * work->relative[p] * factor);
    }
}

/* Squared error of the pixels' luminance, over the tile. */
static double luminance_error(const struct tile_means *tile, struct work *work)
{
    uint32_t pixels = tile->width * tile->height;
    size_t stride = (size_t)3 * pixels;
    double *luminance = work->chosen.sum;
    for (uint32_t k = 0; k < tile->replicates; k++) {
        const double *rgb = tile->means + k * stride;
        for (uint32_t p = 0; p < pixels; p++)
            luminance[(size_t)k * pixels + p] = 0.2126 * rgb[p] + 0.7152 * rgb[pixels + p] +
                                                0.0722 * rgb[2 * pixels + p];
    }
    variance_of_means(luminance, pixels, tile->replicates, pixels, work->mean, work->s2);
    return sum_of(work->s2, pixels) / tile->replicates;
}

/* Whether one sample holds so much of the tile that its variance cannot be trusted. */
static bool rests_on_one_sample(const struct tile_means *tile, struct work *work)
{
    if (tile->largest > LIGHT_SHARE * tile->luminance)
        return true;
    double alone = tile->largest / (double)tile->samples;
    double error = luminance_error(tile, work);
    return error > 0 && alone * alone > ERROR_SHARE * error;
}

static uint32_t failed_pixels(const struct tile_means *tile)
{
    uint32_t count = 0;
    for (uint32_t p = 0; p < tile->width * tile->height; p++)
        count += tile->failed[p / 32] >> p % 32 & 1;
    return count;
}

void estimate_tile(struct estimate *estimate, const struct tile_means *tile)
{
    assert(tile->replicates <= estimate->capacity);
    uint32_t pixels = tile->width * tile->height, failed = failed_pixels(tile);
    estimate->pixels += pixels;
    estimate->light += tile->luminance;
    estimate->nonfinite = estimate->nonfinite || failed > 0;
    if (tile->replicates < estimate->replicates)
        estimate->replicates = tile->replicates;
    if (tile->replicates < 2) {
        estimate->unknown_pixels += pixels;
        estimate->empty_pixels += pixels;
        return;
    }

    struct work work = work_in(estimate->scratch, estimate->capacity);
    size_t stride = (size_t)3 * pixels;
    for (uint32_t p = 0; p < pixels; p++)
        work.dot[p] = 1;
    for (uint32_t radius = 0; radius < WINDOWS; radius++)
        box_sum(work.dot, tile->width, tile->height, radius, work.row, work.area[radius]);
    memset(work.absolute, 0, pixels * sizeof(double));
    memset(work.relative, 0, pixels * sizeof(double));
    memset(work.plain, 0, pixels * sizeof(double));

    double relative_alone = 0;
    for (uint32_t c = 0; c < 3; c++) {
        const double *means = tile->means + (size_t)c * pixels;
        variance_of_means(means, stride, tile->replicates, pixels, work.mean, work.s2);
        for (uint32_t p = 0; p < pixels; p++)
            work.absolute[p] += work.s2[p] / tile->replicates;

        double before = sum_of(work.relative, pixels);
        memset(work.relative_alone, 0, pixels * sizeof(double));
        bool windows = choose_windows(tile, means, stride, &work);
        add_pairs(tile, means, stride, windows, &work, work.weight[c]);
        relative_alone += windows ? sum_of(work.relative_alone, pixels)
                                  : sum_of(work.relative, pixels) - before;
    }
    if (tile->replicates >= 4)
        add_blocks(estimate, tile, &work);
    else
        add_pixels(estimate, tile, &work);

    for (uint32_t p = 0; p < pixels; p++) {
        estimate->mse.squares += work.absolute[p] * work.absolute[p];
        estimate->relmse.squares += work.relative[p] * work.relative[p];
    }
    double absolute = sum_of(work.absolute, pixels), relative = sum_of(work.relative, pixels);
    estimate->mse.sum += absolute;
    estimate->relmse.sum += relative;
    estimate->relmse_alone += relative_alone;
    estimate->relmse_plain += sum_of(work.plain, pixels);
    if (rests_on_one_sample(tile, &work)) {
        estimate->unknown_pixels += pixels;
        estimate->mse.unknown_sum += absolute;
        estimate->relmse.unknown_sum += relative;
    } else {
        estimate->unknown_pixels += failed;
    }
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

/*
 * Whether the error rests on a few pixels. The differences of disjoint pairs cannot see an outlier
 * of a single replicate, so the pixels' own shares are looked at too.
 */
static bool rests_on_few(const struct measure *measure)
{
    return effective_values(measure) < FEWEST_VALUES ||
           measure->sum * measure->sum < FEWEST_VALUES * measure->squares;
}

/* The 95 % interval of a measure, as factors of its estimate. */
static struct interval factors95(const struct measure *measure, uint32_t replicates)
{
    if (!(measure->trace2 > 0))
        return (struct interval){ 1, 1 };
    double n = effective_values(measure);
    double blocks = measure->trace2 * measure->trace2 / measure->trace2_squares;
    double kept = replicates <= 5 ? 1 : 0.8; /* of the degrees of freedom, see add_pairs */
    return estimate_f95(n, n * kept * (replicates - 1), estimate_student(blocks));
}

static enum accuracy_verdict verdict_of(const struct estimate *estimate)
{
    if (estimate->replicates < 2)
        return ACCURACY_NO_REPLICATES;
    if (estimate->nonfinite)
        return ACCURACY_NONFINITE;
    if (!(estimate->light > 0))
        return ACCURACY_BLACK;
    double values = 3 * (double)(estimate->pixels - estimate->empty_pixels);
    if (estimate->replicates == 2 && estimate->relmse.sum > TOO_MUCH_FOR_TWO * values)
        return ACCURACY_TWO_REPLICATES;
    if (estimate->mse.unknown_sum > UNKNOWN_SHARE * estimate->mse.sum ||
        estimate->relmse.unknown_sum > UNKNOWN_SHARE * estimate->relmse.sum)
        return ACCURACY_FEW_SAMPLES;
    if (rests_on_few(&estimate->mse) || rests_on_few(&estimate->relmse))
        return ACCURACY_FEW_PIXELS;
    return ACCURACY_KNOWN;
}

struct accuracy estimate_result(const struct estimate *estimate)
{
    struct accuracy out = { .verdict = verdict_of(estimate), .replicates = estimate->replicates };
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

    double bias = (fabs(estimate->relmse.sum - estimate->relmse_alone) +
                   fabs(estimate->relmse.sum - estimate->relmse_plain)) /
                  values;
    factors = factors95(&estimate->relmse, estimate->replicates);
    out.relmse95.low = out.relmse * factors.low - bias;
    if (out.relmse95.low < 0)
        out.relmse95.low = 0;
    out.relmse95.high = out.relmse * factors.high + bias;
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
