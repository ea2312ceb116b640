/* Goal: samples are uniform, unbiased, as well stratified as their names say, and independent
 * between pixels, replicates and dimensions, also far out. Everything is deterministic: a test that
 * passes once passes always. Each statistical check is shown to catch a planted bug. */
#include "common/err.h"
#include "common/sampler.h"
#include "common/scene.h"
#include "common/stats.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

/* A p-value below this fails: about 1e-3 for all of this file's checks together */
#define UNLIKELY 1e-6

static const char *const names[] = {
#define X(name, number, text) [number] = text,
    SAMPLER_MAP(X)
#undef X
};

/* Which samples, but for the index */
struct place {
    uint64_t seed;
    uint32_t replicate;
    uint64_t pixel;
    uint32_t dimension;
};

struct point {
    float u, v;
};

static struct sampler make_sampler(unsigned kind, uint64_t planned)
{
    struct sampler s;
    struct err err;
    assert_true(sampler_init(&s, kind, planned, &err));
    return s;
}

static uint32_t dimension_of(unsigned subpath, uint32_t event, unsigned purpose)
{
    return sample_dimension(subpath, U8(event), purpose)[0];
}

/* Samples first, first + 1, ... of one place */
static void points_at(const struct sampler *s, struct place at, uint64_t first, int count,
                      struct point *out)
{
    for (int i = 0; i < count; i += LANES) {
        struct sample_key8 key = { 0 };
        f8 u, v;
        for (int lane = 0; lane < LANES; lane++)
            sampler_key_lane(&key, lane, at.seed, at.replicate, at.pixel,
                             first + (uint64_t)(i + lane));
        sampler_2d(s, 1, &key, U8(at.dimension), &u, &v);
        for (int lane = 0; lane < LANES && i + lane < count; lane++)
            out[i + lane] = (struct point){ u[lane], v[lane] };
    }
}

/* The same sample of eight places */
static void points_of(const struct sampler *s, const struct place at[LANES],
                      const uint64_t index[LANES], struct point *out)
{
    struct sample_key8 key = { 0 };
    u8 dimension = { 0 };
    f8 u, v;
    for (int lane = 0; lane < LANES; lane++) {
        sampler_key_lane(&key, lane, at[lane].seed, at[lane].replicate, at[lane].pixel,
                         index[lane]);
        dimension[lane] = at[lane].dimension;
    }
    sampler_2d(s, 1, &key, dimension, &u, &v);
    for (int lane = 0; lane < LANES; lane++)
        out[lane] = (struct point){ u[lane], v[lane] };
}

static void numbers_at(const struct sampler *s, struct place at, uint64_t first, int count,
                       float *out)
{
    for (int i = 0; i < count; i += LANES) {
        struct sample_key8 key = { 0 };
        for (int lane = 0; lane < LANES; lane++)
            sampler_key_lane(&key, lane, at.seed, at.replicate, at.pixel,
                             first + (uint64_t)(i + lane));
        f8 u = sampler_1d(s, 1, &key, U8(at.dimension));
        for (int lane = 0; lane < LANES && i + lane < count; lane++)
            out[i + lane] = u[lane];
    }
}

/* --- stratification ------------------------------------------------------------------------ */

/* Whether each of columns x rows boxes holds one of the columns * rows points */
static bool one_point_per_box(const struct point *points, int columns, int rows)
{
    bool taken[4096] = { false };
    assert_true(columns * rows <= 4096);
    for (int i = 0; i < columns * rows; i++) {
        int box = (int)((double)points[i].u * columns) +
                  (int)((double)points[i].v * rows) * columns;
        if (taken[box])
            return false;
        taken[box] = true;
    }
    return true;
}

/* Every elementary interval of every aligned block of 2^m points, m <= log_count */
static bool is_a_net(const struct point *points, int log_count)
{
    for (int m = 0; m <= log_count; m++)
        for (int start = 0; start < 1 << log_count; start += 1 << m)
            for (int split = 0; split <= m; split++)
                if (!one_point_per_box(points + start, 1 << split, 1 << (m - split)))
                    return false;
    return true;
}

static const uint64_t far_indices[] = { 0, 4096, ((uint64_t)1 << 32) - 512, (uint64_t)1 << 32,
                                        ((uint64_t)1 << 40) + 512 };

static void sobol_blocks_have_one_point_per_elementary_interval(void **state)
{
    (void)state;
    struct sampler s = make_sampler(SAMPLER_SOBOL, 0);
    struct point points[512];
    for (uint64_t i = 0; i < 200; i++) {
        struct place at = { i / 8, (uint32_t)i % 4, hash64(1, i) % 2073600,
                            dimension_of((unsigned)i & 1, (uint32_t)(i * i), i % 16) };
        points_at(&s, at, far_indices[i % 5], 512, points);
        if (!is_a_net(points, 9))
            fail_msg("not a net: pixel %lu, dimension %u", (unsigned long)at.pixel, at.dimension);
    }

    /* Planted: blocks that are not aligned, a shift of one point, and random points */
    struct place at = { 1, 0, 7, 9 };
    points_at(&s, at, 3, 512, points);
    assert_false(is_a_net(points, 9));
    points_at(&s, at, 0, 512, points);
    assert_true(is_a_net(points, 9));
    points[100].u = fmodf(points[100].u + 1.0f / 512, 1);
    assert_false(is_a_net(points, 9));
    s = make_sampler(SAMPLER_INDEPENDENT, 0);
    points_at(&s, at, 0, 512, points);
    assert_false(is_a_net(points, 2));
}

static void one_number_samples_are_stratified_too(void **state)
{
    (void)state;
    float numbers[512];
    struct point points[512];
    struct sampler sobol = make_sampler(SAMPLER_SOBOL, 0);
    for (uint64_t i = 0; i < 100; i++) {
        struct place at = { 3, 0, i, dimension_of(0, (uint32_t)i, SAMPLE_ROULETTE) };
        uint64_t first = far_indices[i % 5];
        numbers_at(&sobol, at, first, 512, numbers);
        points_at(&sobol, at, first, 512, points);
        for (int j = 0; j < 512; j++)
            assert_true(numbers[j] == points[j].u);
        for (int size = 1; size <= 512; size *= 2)
            for (int start = 0; start < 512; start += size)
                assert_true(one_point_per_box(points + start, size, 1));
    }
}

static void the_other_point_sets_are_what_their_names_say(void **state)
{
    (void)state;
    struct point points[1024];
    float numbers[1024];

    /* Stratified: one in each of the near-square strata, in the planned set and in the next */
    static const struct {
        int count, x, y;
    } plans[] = {
        { 1, 1, 1 },   { 2, 1, 2 },   { 12, 3, 4 },    { 16, 4, 4 },
        { 44, 4, 11 }, { 13, 1, 13 }, { 100, 10, 10 }, { 1024, 32, 32 },
    };
    for (size_t i = 0; i < sizeof(plans) / sizeof(plans[0]); i++) {
        int n = plans[i].count;
        struct sampler s = make_sampler(SAMPLER_STRATIFIED, (uint64_t)n);
        for (uint64_t pixel = 0; pixel < 20; pixel++) {
            struct place at = { 5, 1, pixel, dimension_of(0, (uint32_t)pixel, SAMPLE_LENS) };
            uint64_t first = (pixel % 3) * (uint64_t)n;
            points_at(&s, at, first, n, points);
            assert_true(one_point_per_box(points, plans[i].x, plans[i].y));
            numbers_at(&s, at, first, n, numbers);
            for (int j = 0; j < n; j++)
                points[j].u = numbers[j];
            assert_true(one_point_per_box(points, n, 1));
        }
    }

    /* Halton: b^k points from a multiple of it fill the b^k strata of base b, pairs together */
    struct sampler halton = make_sampler(SAMPLER_HALTON, 0);
    struct sampler hammersley = make_sampler(SAMPLER_HAMMERSLEY, 729);
    for (uint64_t pixel = 0; pixel < 20; pixel++) {
        struct place at = { 5, 1, pixel, dimension_of(0, 0, SAMPLE_PIXEL) };
        points_at(&halton, at, 5 * 16 * 27, 16 * 27, points);
        assert_true(one_point_per_box(points, 16, 27));
        points_at(&halton, at, 77 * 8 * 9, 8 * 9, points);
        assert_true(one_point_per_box(points, 8, 9));
        at.dimension = dimension_of(0, 1, SAMPLE_LIGHT_POINT);
        points_at(&halton, at, 25 * 7, 25 * 7, points);
        assert_true(one_point_per_box(points, 25, 7));

        /* Hammersley: first i/N, so that consecutive points are 1/N apart; then base 2, 3, ... */
        at.dimension = dimension_of(0, 0, SAMPLE_PIXEL);
        points_at(&hammersley, at, 0, 729, points);
        for (int i = 1; i < 729; i++) {
            float step = points[i].u - points[i - 1].u;
            assert_float_equal(step < 0 ? step + 1 : step, 1.0f / 729, 1e-6f);
        }
        for (int i = 0; i < 512; i++)
            points[i].u = 0;
        assert_true(one_point_per_box(points, 1, 512));
        at.dimension = dimension_of(0, 1, SAMPLE_LIGHT_POINT);
        points_at(&hammersley, at, 0, 27 * 25, points);
        assert_true(one_point_per_box(points, 27, 25));
    }
}

static void strata_are_visited_in_random_order(void **state)
{
    (void)state;
    /* The strata of the first two samples: all ordered pairs equally often */
    static const int sizes[] = { 2, 3, 4, 5, 6, 8, 13, 16 };
    for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
        int n = sizes[i];
        struct sampler s = make_sampler(SAMPLER_STRATIFIED, (uint64_t)n);
        unsigned long long counts[256] = { 0 }, pairs[256];
        for (uint64_t pixel = 0; pixel < 20000; pixel++) {
            float u[LANES];
            numbers_at(&s, (struct place){ 11, 0, pixel, 3 }, 0, 2, u);
            counts[(int)(u[0] * n) * n + (int)(u[1] * n)]++;
        }
        int kept = 0;
        for (int j = 0; j < n * n; j++) {
            if (j / n != j % n)
                pairs[kept++] = counts[j];
            else
                assert_true(counts[j] == 0);
        }
        double p = stats_chi_square_survival(stats_chi_square(pairs, NULL, kept), kept - 1);
        if (kept > 1 && !(p > UNLIKELY))
            fail_msg("%d strata: pairs are not equally likely, p = %g", n, p);
    }
}

/* --- uniformity and independence ------------------------------------------------------------ */

#define BINS  16
#define TRIES 20480

/* The p-value of pairs of numbers in [0, 1) being uniform in the square */
static double uniform_p(const struct point *points, int count)
{
    unsigned long long counts[BINS * BINS] = { 0 };
    for (int i = 0; i < count; i++) {
        assert_true(points[i].u >= 0 && points[i].u < 1 && points[i].v >= 0 && points[i].v < 1);
        counts[(int)(points[i].u * BINS) * BINS + (int)(points[i].v * BINS)]++;
    }
    return stats_chi_square_survival(stats_chi_square(counts, NULL, BINS * BINS), BINS * BINS - 1);
}

/* Low bits matter as well: stretch the numbers so that their 8th and later digits are binned */
static void low_digits(struct point *points, int count)
{
    for (int i = 0; i < count; i++) {
        points[i].u = fmodf(points[i].u * 256, 1);
        points[i].v = fmodf(points[i].v * 256, 1);
    }
}

static void expect_uniform(const char *what, const char *sampler, struct point *points, int count)
{
    double p = uniform_p(points, count);
    if (!(p > UNLIKELY))
        fail_msg("%s: %s are not uniform, p = %g", sampler, what, p);
    low_digits(points, count);
    p = uniform_p(points, count);
    if (!(p > UNLIKELY))
        fail_msg("%s: low digits of %s are not uniform, p = %g", sampler, what, p);
}

static const uint32_t far_events[] = { 0, 1, 5, 2000, 65535, (1u << 26) - 1 };
static const uint64_t some_indices[] = {
    0, 1, 5, 1000, ((uint64_t)1 << 32) - 1, ((uint64_t)1 << 32) + 3, ((uint64_t)1 << 40) + 77
};

/* Sample `index` of many pixels: whatever the point set, pixels are independent */
static void every_sample_is_uniform_over_pixels(void **state)
{
    (void)state;
    static struct point points[TRIES];
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, 144);
        for (int d = 0; d < 6; d++) {
            static const unsigned purposes[] = { SAMPLE_PIXEL, SAMPLE_LIGHT_POINT };
            for (int i = 0; i < 7; i += 1 + (d > 0)) {
                uint32_t dimension = dimension_of(0, far_events[d], purposes[d > 0]);
                for (uint64_t pixel = 0; pixel < TRIES; pixel += LANES) {
                    struct place at[LANES];
                    uint64_t index[LANES];
                    for (uint64_t lane = 0; lane < LANES; lane++) {
                        at[lane] = (struct place){ 42, 1, pixel + lane, dimension };
                        index[lane] = some_indices[i];
                    }
                    points_of(&s, at, index, points + pixel);
                }
                expect_uniform("samples of different pixels", names[kind], points, TRIES);
            }
        }
    }
    /* Planted: 5 % of the square is out of reach; low digits are lost */
    struct sampler s = make_sampler(SAMPLER_INDEPENDENT, 0);
    points_at(&s, (struct place){ 1, 0, 0, 0 }, 0, TRIES, points);
    for (int i = 0; i < TRIES; i++)
        points[i].u *= 0.95f;
    assert_true(uniform_p(points, TRIES) < UNLIKELY);
    points_at(&s, (struct place){ 1, 0, 0, 0 }, 0, TRIES, points);
    for (int i = 0; i < TRIES; i++)
        points[i].v = floorf(points[i].v * 1024) / 1024;
    low_digits(points, TRIES);
    assert_true(uniform_p(points, TRIES) < UNLIKELY);
}

/* The sequence of one pixel is uniform in its long run, also from far-out indices */
static void every_sequence_is_uniform(void **state)
{
    (void)state;
    static struct point points[TRIES];
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, TRIES);
        for (int i = 0; i < 7; i++) {
            struct place at = { 1, 0, 99, dimension_of(0, far_events[i % 6], SAMPLE_LIGHT_POINT) };
            points_at(&s, at, some_indices[i], TRIES, points);
            double p = uniform_p(points, TRIES); /* too even is no fault here */
            if (!(p > UNLIKELY))
                fail_msg("%s: its sequence is not uniform, p = %g", names[kind], p);
        }
    }
}

/* How the second number of a pair differs from the first */
enum other {
    OTHER_PIXEL,
    OTHER_ROW,
    OTHER_REPLICATE,
    OTHER_SEED,
    OTHER_DIMENSION,
    OTHER_EVENT,
    OTHER_BLOCK,
    OTHER_COUNT
};

static const char *const other_names[] = {
    "neighbours in a row",    "neighbours in a column", "replicates", "seeds", "purposes", "events",
    "blocks of 2^32 samples",
};

static void pair_of_places(enum other other, uint64_t i, struct place *a, struct place *b,
                           uint64_t *index_b)
{
    /* Each i has places of its own, or the pairs would not be independent of each other */
    *a = (struct place){ 7, 0, 2 * i, dimension_of(0, 1, SAMPLE_LIGHT_POINT) };
    *b = *a;
    switch (other) {
    case OTHER_PIXEL:
        b->pixel = a->pixel + 1;
        break;
    case OTHER_ROW:
        a->pixel = i / 1920 * 3840 + i % 1920;
        b->pixel = a->pixel + 1920;
        break;
    case OTHER_REPLICATE:
        b->replicate = 1;
        break;
    case OTHER_SEED:
        b->seed = 8;
        break;
    case OTHER_DIMENSION:
        b->dimension = dimension_of(0, 1, SAMPLE_BSDF_DIRECTION);
        break;
    case OTHER_EVENT:
        b->dimension = dimension_of(0, 2, SAMPLE_LIGHT_POINT);
        break;
    case OTHER_BLOCK:
        *index_b += (uint64_t)1 << 32;
        break;
    default:
        break;
    }
}

static void pixels_replicates_seeds_and_dimensions_are_independent(void **state)
{
    (void)state;
    static struct point uu[TRIES], uv[TRIES];
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, 64);
        for (unsigned other = 0; other < OTHER_COUNT; other++) {
            for (uint64_t i = 0; i < TRIES; i += LANES) {
                struct place a[LANES], b[LANES];
                uint64_t index_a[LANES], index_b[LANES];
                struct point one[LANES], two[LANES];
                for (uint64_t lane = 0; lane < LANES; lane++) {
                    index_a[lane] = index_b[lane] = 5;
                    pair_of_places((enum other)other, i + lane, &a[lane], &b[lane], &index_b[lane]);
                }
                points_of(&s, a, index_a, one);
                points_of(&s, b, index_b, two);
                for (int lane = 0; lane < LANES; lane++) {
                    uu[i + (uint64_t)lane] = (struct point){ one[lane].u, two[lane].u };
                    uv[i + (uint64_t)lane] = (struct point){ one[lane].v, two[lane].u };
                }
            }
            expect_uniform(other_names[other], names[kind], uu, TRIES);
            expect_uniform(other_names[other], names[kind], uv, TRIES);
        }
    }
    /* Planted: a key that ignores where it is; numbers that agree in one sample of eight */
    for (int i = 0; i < TRIES; i++)
        if (i % 8 == 0)
            uu[i].v = uu[i].u;
    assert_true(uniform_p(uu, TRIES) < UNLIKELY);
}

/*
 * Sums over the samples of a pixel. A padded sampler shuffles: numbers of two dimensions, or two
 * pixels, are paired at random, and their products average to 1/4 with an error of random pairs.
 */
static double product_z_score(const struct sampler *s, enum other other, bool broken)
{
    enum { SAMPLES = 64, PIXELS = 1000 };
    double sum = 0, squares = 0;
    for (uint64_t i = 0; i < PIXELS; i++) {
        struct place a, b;
        struct point one[SAMPLES], two[SAMPLES];
        uint64_t first_b = 0;
        pair_of_places(other, i, &a, &b, &first_b);
        points_at(s, a, 0, SAMPLES, one);
        points_at(s, broken ? a : b, first_b, SAMPLES, two);
        double mean = 0;
        for (int j = 0; j < SAMPLES; j++)
            mean += (one[j].u - 0.5) * (two[j].u - 0.5) / SAMPLES;
        sum += mean;
        squares += mean * mean;
    }
    return sum / sqrt(squares);
}

static void sequences_are_not_correlated(void **state)
{
    (void)state;
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, 64);
        for (unsigned other = 0; other < OTHER_COUNT; other++) {
            double z = product_z_score(&s, (enum other)other, false);
            if (!(fabs(z) < 5))
                fail_msg("%s: %s are correlated, z = %g", names[kind], other_names[other], z);
        }
        assert_true(fabs(product_z_score(&s, OTHER_PIXEL, true)) > 5);
    }
}

/* Pixels whose keys share one word must not share samples: half a key would collide 500 times in
 * a full HD image. */
static void both_words_of_the_key_count(void **state)
{
    (void)state;
    static struct point points[2][TRIES];
    for (int shared = 0; shared < 2; shared++) {
        for (uint32_t i = 0; i < TRIES; i++) {
            u8 word = U8(hash32_mix(i)), other = { 0 };
            for (int lane = 0; lane < LANES; lane++)
                other[lane] = hash32_mix(i * LANES + (uint32_t)lane + 0x10000000u);
            struct sample_key8 key = { shared ? word : other, shared ? other : word, U8(0) };
            f8 u, v;
            sampler_2d(NULL, 0, &key, U8(5), &u, &v);
            points[0][i] = (struct point){ u[0], u[1] };
            points[1][i] = (struct point){ v[2], v[3] };
        }
        expect_uniform("pixels that share half a key", "sobol", points[0], TRIES);
        expect_uniform("pixels that share half a key", "sobol", points[1], TRIES);
    }
}

/* --- estimates ------------------------------------------------------------------------------ */

#define SEEDS 2500

static double smooth(struct point p)
{
    return exp((double)p.u + p.v);
}

static double edge(struct point p)
{
    return (double)p.u * p.u + (double)p.v * p.v < 1;
}

static const struct integrand {
    const char *name;
    double (*value)(struct point);
    double integral;
} integrands[] = {
    { "smooth", smooth, (M_E - 1) * (M_E - 1) },
    { "edge", edge, M_PI_4 },
};

/* Mean and variance, over seeds, of the estimate from the first `count` samples */
static void estimate(const struct sampler *s, const struct integrand *f, int count, float shift,
                     double *mean, double *variance)
{
    double sum = 0, squares = 0;
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        struct point points[64];
        struct place at = { seed, 0, 12345, dimension_of(0, 1, SAMPLE_LIGHT_POINT) };
        points_at(s, at, 0, count, points);
        double value = 0;
        for (int i = 0; i < count; i++) {
            points[i].u *= 1 - shift; /* the planted bug */
            value += f->value(points[i]) / count;
        }
        sum += value - f->integral;
        squares += (value - f->integral) * (value - f->integral);
    }
    *mean = f->integral + sum / SEEDS;
    *variance = (squares - sum * sum / SEEDS) / (SEEDS - 1);
}

static void estimates_are_unbiased_and_better_than_independent_ones(void **state)
{
    (void)state;
    /* Variance at 64 samples, in that of independent ones: at most this (smooth, edge) */
    static const double limits[SAMPLER_COUNT][2] = {
        [SAMPLER_SOBOL] = { 0.01, 0.2 },      [SAMPLER_INDEPENDENT] = { 1.1, 1.1 },
        [SAMPLER_STRATIFIED] = { 0.05, 0.3 }, [SAMPLER_HALTON] = { 0.05, 0.4 },
        [SAMPLER_HAMMERSLEY] = { 0.05, 0.4 },
    };
    static const int counts[] = { 1, 3, 16, 64 };
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, 64);
        struct sampler reference = make_sampler(SAMPLER_INDEPENDENT, 0);
        for (int f = 0; f < 2; f++) {
            double mean, variance, independent;
            for (int i = 0; i < 4; i++) {
                estimate(&s, &integrands[f], counts[i], 0, &mean, &variance);
                double z = (mean - integrands[f].integral) / sqrt(variance / SEEDS);
                if (!(fabs(z) < 5))
                    fail_msg("%s is biased on %s with %d samples: %g, not %g, z = %g", names[kind],
                             integrands[f].name, counts[i], mean, integrands[f].integral, z);
            }
            estimate(&reference, &integrands[f], 64, 0, &mean, &independent);
            if (!(variance <= limits[kind][f] * independent))
                fail_msg("%s on %s: variance is %g of independent samples'", names[kind],
                         integrands[f].name, variance / independent);

            /* Planted: numbers 2 % too small */
            estimate(&s, &integrands[f], 64, 0.02f, &mean, &variance);
            assert_true(fabs(mean - integrands[f].integral) / sqrt(variance / SEEDS) > 5);
        }
    }
}

/* --- ranges, keys, lanes -------------------------------------------------------------------- */

static void numbers_stay_below_one(void **state)
{
    (void)state;
    const float last = 1 - 0x1p-24f;
    f8 top = f8_from_hash(
        (u8){ 0xffffffffu, 0xffffff80u, 0xffffff00u, 0xfffffeffu, 0, 1, 255, 256 });
    assert_true(top[0] == last && top[1] == last && top[2] == last && top[3] < last);
    assert_true(top[4] == 0 && top[6] == 0 && top[7] == 0x1p-24f);
    assert_true(hash64_unit(UINT64_MAX) < 1 && hash64_unit(0) == 0);
    volatile float planted = (float)0xffffff80u * 0x1p-32f; /* the usual way to make one */
    assert_true(planted == 1);

    for (int n = 1; n <= 100000; n++) {
        volatile float product = last * (float)n;
        assert_true((int)product < n);
    }

    /* Hunt for the largest number of each kind: fine strata end closest to 1 */
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        static struct point points[TRIES];
        float most = 0, least = 1;
        for (int shift = 10; shift <= 32; shift += 11) {
            struct sampler s = make_sampler(kind, (uint64_t)1 << shift);
            struct place at = { 0, 0, 0, dimension_of(0, 0, SAMPLE_PIXEL) };
            points_at(&s, at, ((uint64_t)1 << 32) - TRIES, TRIES, points);
            for (int i = 0; i < TRIES; i++) {
                most = fmaxf(most, fmaxf(points[i].u, points[i].v));
                least = fminf(least, fminf(points[i].u, points[i].v));
                assert_true(ldexpf(points[i].u, 24) == floorf(ldexpf(points[i].u, 24)));
            }
        }
        assert_true(least >= 0 && most <= last);
    }
}

static int compare_words(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static size_t count_repeats(uint64_t *words, size_t count)
{
    size_t repeats = 0;
    qsort(words, count, sizeof(*words), compare_words);
    for (size_t i = 1; i < count; i++)
        repeats += words[i] == words[i - 1];
    return repeats;
}

static void no_two_pixels_of_an_image_share_a_key(void **state)
{
    (void)state;
    enum { PIXELS = 1920 * 1080 };
    uint64_t *keys = malloc(2 * PIXELS * sizeof(*keys));
    assert_non_null(keys);
    for (uint64_t i = 0; i < PIXELS; i++) {
        keys[2 * i] = sampler_key(1, 0, i, 0);
        keys[2 * i + 1] = sampler_key(1, 3, i, 0);
    }
    assert_int_equal(count_repeats(keys, 2 * PIXELS), 0);

    /* Everything else in the key: a few pixels, replicates, blocks and seeds, near and far */
    size_t count = 0;
    for (uint64_t pixel = 0; pixel < 64; pixel++)
        for (uint32_t replicate = 0; replicate < 64; replicate++)
            for (uint32_t block = 0; block < 16; block++)
                for (uint64_t seed = 0; seed < 4; seed++)
                    keys[count++] = sampler_key(
                        seed << (seed * 20), replicate << (replicate & 1) * 16,
                        pixel << (pixel & 1) * 20, block << (block & 1) * 8);
    assert_int_equal(count_repeats(keys, count), 0);

    /* Planted: half a key */
    for (uint64_t i = 0; i < PIXELS; i++)
        keys[i] = (uint32_t)sampler_key(1, 0, i, 0);
    assert_true(count_repeats(keys, PIXELS) > 100);
    free(keys);
}

static void dimensions_have_numbers_of_their_own(void **state)
{
    (void)state;
    enum { EVENTS = 1000 };
    static uint64_t numbers[2 * EVENTS * 32];
    size_t count = 0;
    for (unsigned subpath = 0; subpath < 2; subpath++)
        for (uint32_t event = 0; event < EVENTS; event++)
            for (unsigned purpose = 0; purpose < 32; purpose++)
                numbers[count++] = dimension_of(subpath, event, purpose);
    assert_int_equal(count_repeats(numbers, count), 0);
}

static void lanes_do_not_see_each_other(void **state)
{
    (void)state;
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s = make_sampler(kind, 100);
        for (uint64_t i = 0; i < 200; i++) {
            struct sample_key8 key = { 0 };
            u8 dimension = { 0 };
            uint64_t indices[LANES];
            f8 u, v;
            for (int lane = 0; lane < LANES; lane++) {
                uint64_t n = LANES * i + (uint64_t)lane;
                indices[lane] = hash64(3, n) >> (n % 60);
                dimension[lane] = dimension_of(n & 1, (uint32_t)(n % 5), SAMPLE_MIX);
                sampler_key_lane(&key, lane, i, (uint32_t)lane, n, indices[lane]);
            }
            sampler_2d(&s, 1, &key, dimension, &u, &v);
            f8 w = sampler_1d(&s, 1, &key, dimension);
            for (int lane = 0; lane < LANES; lane++) {
                struct place at = { i, (uint32_t)lane, LANES * i + (uint64_t)lane,
                                    dimension[lane] };
                struct point point;
                float number;
                points_at(&s, at, indices[lane], 1, &point);
                numbers_at(&s, at, indices[lane], 1, &number);
                assert_true(point.u == u[lane] && point.v == v[lane] && number == w[lane]);
            }

            /* Sobol without asking for the kind; keys chosen lane by lane */
            f8 fast_u, fast_v;
            sampler_2d(NULL, 0, &key, dimension, &fast_u, &fast_v);
            if (kind == SAMPLER_SOBOL)
                assert_int_equal(i8_bits((fast_u == u) & (fast_v == v)), 255);
            struct sample_key8 none = { 0 };
            struct sample_key8 half = sampler_key_select(i8_from_bits(0x5a), key, none);
            assert_true(half.lo[1] == key.lo[1] && half.hi[0] == 0 && half.reversed[2] == 0);
        }
    }
}

static void a_sampler_that_needs_a_plan_asks_for_it(void **state)
{
    (void)state;
    struct sampler s;
    struct err err = { 0 };
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        bool needs = kind == SAMPLER_STRATIFIED || kind == SAMPLER_HAMMERSLEY;
        assert_int_equal(sampler_needs_plan(kind), needs);
        assert_int_equal(sampler_init(&s, kind, 0, &err), !needs);
        assert_int_equal(sampler_init(&s, kind, ((uint64_t)1 << 32) + 1, &err), !needs);
        assert_true(sampler_init(&s, kind, (uint64_t)1 << 32, &err));
        assert_true(s.kind == kind);
    }
    assert_false(sampler_init(&s, SAMPLER_HAMMERSLEY, 0, &err));
    assert_int_equal(err.code, ERR_ARGUMENT);
    assert_non_null(strstr(err.text, "hammersley"));
    assert_false(sampler_init(&s, SAMPLER_COUNT, 1, &err));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sobol_blocks_have_one_point_per_elementary_interval),
        cmocka_unit_test(one_number_samples_are_stratified_too),
        cmocka_unit_test(the_other_point_sets_are_what_their_names_say),
        cmocka_unit_test(strata_are_visited_in_random_order),
        cmocka_unit_test(every_sample_is_uniform_over_pixels),
        cmocka_unit_test(every_sequence_is_uniform),
        cmocka_unit_test(pixels_replicates_seeds_and_dimensions_are_independent),
        cmocka_unit_test(sequences_are_not_correlated),
        cmocka_unit_test(both_words_of_the_key_count),
        cmocka_unit_test(estimates_are_unbiased_and_better_than_independent_ones),
        cmocka_unit_test(numbers_stay_below_one),
        cmocka_unit_test(no_two_pixels_of_an_image_share_a_key),
        cmocka_unit_test(dimensions_have_numbers_of_their_own),
        cmocka_unit_test(lanes_do_not_see_each_other),
        cmocka_unit_test(a_sampler_that_needs_a_plan_asks_for_it),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
