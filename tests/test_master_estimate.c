/*
 * The error estimate on synthetic samples whose truth is known: its intervals hold in 95 % of all
 * pictures whatever the noise looks like, and wrong arithmetic would be noticed.
 */
#include "common/elem.h"
#include "common/hash.h"
#include "common/sumtree.h"
#include "master/estimate.h"
#include "tests/random_stream.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define REPLICATES 4
#define SAMPLES    16 /* of a replicate */
#define TRIALS     200

/* Samples of mean 1 */
enum noise { NORMAL, EXPONENTIAL, LOGNORMAL, HIT_OR_MISS, FIREFLIES, NOISE_COUNT };
static const char *const noise_names[] = { "normal", "exponential", "lognormal", "hit or miss",
                                           "fireflies" };

static double sample(enum noise noise, uint64_t *random)
{
    switch (noise) {
    case NORMAL:
        return 1 + 0.5 * random_normal(random);
    case EXPONENTIAL:
        return -elem_log(random_uniform(random));
    case LOGNORMAL:
        return elem_exp(random_normal(random) - 0.5);
    case HIT_OR_MISS:
        return random_uniform(random) < 0.4 ? 2.5 : 0;
    default:
        return random_uniform(random) < 0.002 ? 250.5 : 0.5;
    }
}

struct picture {
    double means[REPLICATES * 3 * TILE_PIXELS];
    double mse, relmse; /* in truth */
    struct tile_means tile;
};

static void make_picture(enum noise noise, uint64_t *random, struct picture *picture)
{
    static const uint32_t failed[TILE_PIXELS / 32];
    *picture = (struct picture){ .tile = { .width = TILE_SIZE,
                                           .height = TILE_SIZE,
                                           .replicates = REPLICATES,
                                           .samples = REPLICATES * SAMPLES,
                                           .failed = failed } };
    picture->tile.means = picture->means;
    for (uint32_t p = 0; p < TILE_PIXELS; p++) {
        double truth = 0.2 + 0.05 * (p % TILE_SIZE), mean = 0;
        for (uint32_t k = 0; k < REPLICATES; k++) {
            double sum = 0;
            for (uint32_t i = 0; i < SAMPLES; i++) {
                double x = truth * sample(noise, random);
                sum += x;
                picture->tile.luminance += x;
                picture->tile.largest = fmax(picture->tile.largest, x);
            }
            for (uint32_t c = 0; c < 3; c++) /* all channels alike: the hard case */
                picture->means[(k * 3 + c) * TILE_PIXELS + p] = sum / SAMPLES;
            mean += sum / SAMPLES / REPLICATES;
        }
        double squared = (mean - truth) * (mean - truth);
        picture->mse += squared / TILE_PIXELS;
        picture->relmse += squared / (truth * truth + 0.01) / TILE_PIXELS;
    }
}

static bool holds(struct interval interval, double factor, double truth)
{
    return factor * interval.low <= truth && truth <= factor * interval.high;
}

/* Pictures, of those whose error is known, in which the intervals hold */
struct coverage {
    unsigned mse, mse_known, relmse, relmse_known;
};

/* With a planted bug: the interval scaled by `factor`, or `copies` of replicates being others' */
static struct coverage cover(enum noise noise, double factor, unsigned copies)
{
    static struct picture picture;
    struct estimate *estimate = estimate_new();
    assert_non_null(estimate);
    struct coverage out = { 0 };
    uint64_t random = 7 + noise;
    for (unsigned t = 0; t < TRIALS; t++) {
        make_picture(noise, &random, &picture);
        for (unsigned k = 0; k < copies; k++)
            memcpy(picture.means + (REPLICATES - 1 - k) * 3 * TILE_PIXELS,
                   picture.means + k * 3 * TILE_PIXELS, 3 * TILE_PIXELS * sizeof(double));
        estimate_begin(estimate, REPLICATES);
        estimate_tile(estimate, &picture.tile);
        struct accuracy a = estimate_result(estimate);
        out.mse_known += a.mse_verdict == ACCURACY_KNOWN;
        out.relmse_known += a.verdict == ACCURACY_KNOWN;
        out.mse += a.mse_verdict == ACCURACY_KNOWN && holds(a.mse95, factor, picture.mse);
        out.relmse += a.verdict == ACCURACY_KNOWN && holds(a.relmse95, factor, picture.relmse);
    }
    estimate_free(estimate);
    return out;
}

static void the_intervals_hold_whatever_the_noise_looks_like(void **state)
{
    (void)state;
    struct coverage all = { 0 };
    for (enum noise noise = NORMAL; noise <= HIT_OR_MISS; noise++) {
        struct coverage c = cover(noise, 1, 0);
        print_message("%-12s MSE %u of %u, relMSE %u of %u\n", noise_names[noise], c.mse,
                      c.mse_known, c.relmse, c.relmse_known);
        assert_int_equal(c.mse_known, TRIALS);
        assert_int_equal(c.relmse_known, TRIALS);
        assert_in_range(c.mse, 0.91 * TRIALS, TRIALS); /* standard error 1.5 % */
        assert_in_range(c.relmse, 0.91 * TRIALS, TRIALS);
        all.mse += c.mse;
        all.relmse += c.relmse;
    }
    assert_in_range(all.mse, 0.93 * 4 * TRIALS, 0.975 * 4 * TRIALS);
    assert_in_range(all.relmse, 0.93 * 4 * TRIALS, 0.975 * 4 * TRIALS);
}

static void a_wrong_divisor_and_replicates_that_are_copies_are_noticed(void **state)
{
    (void)state;
    struct coverage divisor = cover(NORMAL, (REPLICATES - 1.0) / (REPLICATES + 1.0), 0);
    assert_true(divisor.mse < 0.1 * TRIALS && divisor.relmse < 0.1 * TRIALS);
    divisor = cover(EXPONENTIAL, (REPLICATES - 1.0) / REPLICATES, 0);
    assert_true(divisor.mse < 0.5 * TRIALS && divisor.relmse < 0.5 * TRIALS);
    struct coverage copies = cover(NORMAL, 1, 2); /* their mean is off by more than they say */
    assert_true(copies.mse < 0.1 * TRIALS && copies.relmse < 0.1 * TRIALS);
}

static void fireflies_make_the_relative_error_unknown(void **state)
{
    (void)state;
    struct coverage c = cover(FIREFLIES, 1, 0);
    print_message("%-12s MSE %u of %u, relMSE %u of %u\n", noise_names[FIREFLIES], c.mse,
                  c.mse_known, c.relmse, c.relmse_known);
    assert_true(c.relmse_known < 0.1 * TRIALS);
    assert_true(c.mse >= 0.9 * c.mse_known);
}

static void large_means_do_not_drown_small_differences(void **state)
{
    (void)state;
    static struct picture picture;
    uint64_t random = 3;
    make_picture(NORMAL, &random, &picture);
    struct estimate *estimate = estimate_new();
    estimate_begin(estimate, REPLICATES);
    estimate_tile(estimate, &picture.tile);
    double near_zero = estimate_result(estimate).mse, squares = 0;

    for (size_t i = 0; i < REPLICATES * 3 * TILE_PIXELS; i++)
        picture.means[i] = 1e7 + 1e-3 * picture.means[i];
    estimate_begin(estimate, REPLICATES);
    estimate_tile(estimate, &picture.tile);
    assert_true(fabs(estimate_result(estimate).mse / (1e-6 * near_zero) - 1) < 1e-5);

    /* The planted bug, sums of squares, would be off by more */
    for (uint32_t p = 0; p < TILE_PIXELS; p++) {
        double sum = 0, sum2 = 0;
        for (uint32_t k = 0; k < REPLICATES; k++) {
            double x = picture.means[k * 3 * TILE_PIXELS + p];
            sum += x;
            sum2 += x * x;
        }
        squares += (sum2 - sum * sum / REPLICATES) /
                   (REPLICATES * (REPLICATES - 1.0) * TILE_PIXELS);
    }
    assert_true(fabs(squares / (1e-6 * near_zero) - 1) > 0.1);
    estimate_free(estimate);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_intervals_hold_whatever_the_noise_looks_like),
        cmocka_unit_test(a_wrong_divisor_and_replicates_that_are_copies_are_noticed),
        cmocka_unit_test(fireflies_make_the_relative_error_unknown),
        cmocka_unit_test(large_means_do_not_drown_small_differences),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
