/*
 * No bias from stopping: a picture that is rendered until its own estimate of its error meets a
 * target is on average the picture that was looked for. The noise here is exponential, so that the
 * pixels that seem to be known well are those that are too dark.
 *
 * Planted bug: every pixel stops on its own samples.
 */
#include "common/elem.h"
#include "common/sumtree.h"
#include "master/estimate.h"
#include "master/ledger.h"
#include "master/limits.h"
#include "tests/random_stream.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define SIDE     16
#define PIXELS   (SIDE * SIDE)
#define K        4
#define B        4 /* samples of a leaf */
#define TRIALS   2000
#define ROUNDS   24
#define TARGET   0.0065 /* relMSE; met after ten leaves or so */
#define OF_PIXEL 0.1    /* standard error at which a pixel stops by itself, of what it should be */

static double truth(int p)
{
    return 0.5 + p % SIDE / (double)SIDE;
}

/* What one trial has seen so far */
struct trial {
    double sums[K][PIXELS];
    double luminance, largest;
    uint64_t leaves;
};

static void add_leaf(struct trial *trial, uint64_t *random)
{
    for (int k = 0; k < K; k++)
        for (int p = 0; p < PIXELS; p++)
            for (int s = 0; s < B; s++) {
                double value = -truth(p) * elem_log(random_uniform(random));
                trial->sums[k][p] += value;
                trial->luminance += value;
                trial->largest = value > trial->largest ? value : trial->largest;
            }
    trial->leaves++;
}

static struct accuracy accuracy_of(const struct trial *trial, struct estimate *estimate)
{
    static double means[K * 3 * PIXELS];
    static const uint32_t failed[TILE_PIXELS / 32];
    for (int k = 0; k < K; k++)
        for (int c = 0; c < 3; c++)
            for (int p = 0; p < PIXELS; p++)
                means[(k * 3 + c) * PIXELS + p] = trial->sums[k][p] / (double)(trial->leaves * B);
    struct tile_means tile = { .width = SIDE,
                               .height = SIDE,
                               .replicates = K,
                               .means = means,
                               .samples = trial->leaves * B * K,
                               .failed = failed,
                               .luminance = trial->luminance,
                               .largest = trial->largest };
    estimate_begin(estimate, K);
    estimate_tile(estimate, &tile);
    return estimate_result(estimate);
}

/* Standard error of a pixel, as it would tell itself */
static double alone(const struct trial *trial, int p)
{
    double mean = 0, squares = 0;
    for (int k = 0; k < K; k++)
        mean += trial->sums[k][p] / K;
    for (int k = 0; k < K; k++)
        squares += (trial->sums[k][p] - mean) * (trial->sums[k][p] - mean);
    return sqrt(squares / (K * (K - 1))) / (double)(trial->leaves * B);
}

/* Sums over the trials, of the difference from the truth and of its square; the last entry is the
 * mean of the picture. */
struct drift {
    double sum[PIXELS + 1], squares[PIXELS + 1];
    double rounds;
};

static void add_difference(struct drift *drift, int at, double difference)
{
    drift->sum[at] += difference;
    drift->squares[at] += difference * difference;
}

static void add_picture(struct drift *drift, const double picture[PIXELS])
{
    double mean = 0;
    for (int p = 0; p < PIXELS; p++) {
        double difference = picture[p] / truth(p) - 1;
        add_difference(drift, p, difference);
        mean += difference / PIXELS;
    }
    add_difference(drift, PIXELS, mean);
}

/* Standard errors that the mean over all trials is off */
static double off(const struct drift *drift, int at)
{
    double mean = drift->sum[at] / TRIALS;
    double variance = drift->squares[at] / TRIALS - mean * mean;
    return mean / sqrt(variance / (TRIALS - 1));
}

static void render_until(struct drift *whole, struct drift *naive)
{
    const struct limits limits = { .rounds = ROUND_COUNT, .relmse = TARGET };
    static struct trial trial;
    struct estimate *estimate = estimate_new();
    uint64_t random = 7;
    for (int i = 0; i < TRIALS; i++) {
        double picture[PIXELS], by_pixel[PIXELS];
        bool met = false, stopped[PIXELS] = { false };
        memset(&trial, 0, sizeof(trial));
        for (unsigned round = 0; round < ROUNDS && !met; round++) {
            while (trial.leaves < round_end(round))
                add_leaf(&trial, &random);
            double scale = 1 / (double)(trial.leaves * B * K);
            for (int p = 0; p < PIXELS; p++) {
                picture[p] = 0;
                for (int k = 0; k < K; k++)
                    picture[p] += scale * trial.sums[k][p];
                if (!stopped[p])
                    by_pixel[p] = picture[p];
                stopped[p] = stopped[p] || alone(&trial, p) < OF_PIXEL * truth(p);
            }
            struct ledger_row row = { .accuracy = accuracy_of(&trial, estimate) };
            met = limits_met(&limits, &row);
            whole->rounds += 1.0 / TRIALS;
        }
        assert_true(met);
        add_picture(whole, picture);
        add_picture(naive, by_pixel);
    }
    estimate_free(estimate);
}

static void stopping_at_an_error_is_no_bias_and_stopping_by_pixels_is(void **state)
{
    (void)state;
    static struct drift whole, naive;
    render_until(&whole, &naive);
    printf("%.1f rounds; the mean of the picture is off by %.1f standard errors, %.1f if pixels "
           "stop by themselves\n",
           whole.rounds, off(&whole, PIXELS), off(&naive, PIXELS));
    assert_true(whole.rounds > 6 && whole.rounds < 16);
    assert_true(fabs(off(&whole, PIXELS)) < 4);
    assert_true(off(&naive, PIXELS) < -10);
    double squares = 0;
    for (int p = 0; p < PIXELS; p++) {
        double z = off(&whole, p);
        squares += z * z / PIXELS;
        if (fabs(z) > 4.5) /* of 256 pixels the farthest is about 3 off */
            fail_msg("pixel %d is off by %.2f standard errors", p, z);
    }
    assert_true(fabs(squares - 1) < 4 * sqrt(2.0 / PIXELS));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(stopping_at_an_error_is_no_bias_and_stopping_by_pixels_is),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
