/*
 * Asking for an error, a time or a budget: the rows of the accuracy ledger, what they predict, when
 * a job ends, and what is expected to be spent until then.
 */
#include "common/elem.h"
#include "common/scene.h"
#include "master/ledger.h"
#include "master/limits.h"
#include "master/predict.h"
#include "master/spending.h"
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

/* ---- rows ---- */

static void a_row_has_the_figures_of_its_round(void **state)
{
    (void)state;
    struct node_stats stats = { .samples = 1000, .truncated_energy = 5, .nonfinite = { 1, 2, 3 } };
    struct accuracy accuracy = { .relmse = 0.5 };
    struct ledger_row row = ledger_row_of(3, 64, 2, 7, &accuracy, &stats);
    assert_true(row.round == 3 && row.spp == 64 && row.wall_s == 2 && row.core_s == 7);
    assert_true(row.truncated_energy == 0.005);
    assert_int_equal(row.nonfinite[NONFINITE_NEGATIVE], 3);
}

static void the_csv_has_a_line_a_round_and_no_number_for_an_unknown_error(void **state)
{
    (void)state;
    const struct ledger_row rows[2] = {
        { .round = 0,
          .spp = 16,
          .core_s = 0.5,
          .wall_s = 1,
          .samples = 100,
          .nonfinite = { 1, 2, 3 },
          .accuracy = { .verdict = ACCURACY_FEW_SAMPLES,
                        .mse_verdict = ACCURACY_FEW_SAMPLES,
                        .rmse = 0.5,
                        .unknown_share = 0.25 } },
        { .round = 1,
          .spp = 32,
          .core_s = 1,
          .wall_s = 1.5,
          .accuracy = { .rmse = 0.25,
                        .rmse95 = { 0.125, 0.5 },
                        .relmse = 0.0625,
                        .relmse95 = { 0.03125, INFINITY } } },
    };
    char *text = ledger_csv(rows, 2);
    assert_non_null(text);
    char *first = strchr(text, '\n') + 1;
    assert_memory_equal(text, "round,spp,core_seconds,wall_seconds,rmse,", 41);
    assert_string_equal(first,
                        "0,16,0.5,1,,,,,,,a few samples hold the sum,0.25,100,0,0,0,0,1,2,3\n"
                        "1,32,1,1.5,0.25,0.125,0.5,0.0625,0.03125,inf,,0,0,0,0,0,0,0,0,0\n");
    unsigned commas[3] = { 0 }, line = 0;
    for (const char *c = text; *c != '\0'; c++) {
        line += *c == '\n';
        if (*c == ',')
            commas[line]++;
    }
    assert_true(line == 3 && commas[0] == commas[1] && commas[0] == commas[2]);
    free(text);
}

/* ---- limits ---- */

static void each_limit_forbids_the_round_that_exceeds_it(void **state)
{
    (void)state;
    const struct outlook fits = {
        .rounds = 8, .elapsed_s = 50, .left_s = 40, .spent_core_s = 100, .left_core_s = 80
    };
    struct limits limits = { .rounds = 8 };
    assert_false(limits_are_open(&limits));
    assert_int_equal(limits_against(&limits, &fits), LIMIT_NONE);
    limits.rounds = 7;
    assert_int_equal(limits_against(&limits, &fits), LIMIT_SPP);
    limits = (struct limits){ .rounds = ROUND_COUNT, .time_s = 100 };
    assert_true(limits_are_open(&limits));
    assert_int_equal(limits_against(&limits, &fits), LIMIT_NONE);
    limits.time_s =
        90; /* 92 by a cautious prediction: a second late is better than a tenth early */
    assert_int_equal(limits_against(&limits, &fits), LIMIT_TIME);
    limits.time_s = 91.5;
    assert_int_equal(limits_against(&limits, &fits), LIMIT_NONE);
    limits = (struct limits){ .rounds = ROUND_COUNT, .core_s = 180 };
    assert_int_equal(limits_against(&limits, &fits), LIMIT_NONE);
    limits.core_s = 179;
    assert_int_equal(limits_against(&limits, &fits), LIMIT_BUDGET);

    struct outlook unknown = fits;
    unknown.left_s = unknown.left_core_s = INFINITY;
    assert_int_equal(limits_against(&limits, &unknown), LIMIT_BUDGET);
    limits = (struct limits){ .rounds = ROUND_COUNT, .relmse = 1e-3 };
    assert_int_equal(limits_against(&limits, &unknown), LIMIT_NONE);
}

static void a_target_is_met_by_a_known_error_only(void **state)
{
    (void)state;
    struct limits limits = { .rounds = ROUND_COUNT, .relmse = 1e-3 };
    struct ledger_row row = { .accuracy = { .relmse = 1e-3 } };
    assert_true(limits_met(&limits, &row));
    row.accuracy.relmse = 1.0001e-3;
    assert_false(limits_met(&limits, &row));
    row.accuracy = (struct accuracy){ .verdict = ACCURACY_FEW_SAMPLES, .relmse = 1e-6 };
    assert_false(limits_met(&limits, &row));
    row.accuracy = (struct accuracy){ .relmse = 0 };
    assert_true(limits_met(&limits, &row)); /* every sample the same */
    limits.relmse = 0;
    assert_false(limits_met(&limits, &row));
}

/* ---- spending ---- */

static void what_is_left_follows_from_whole_rounds(void **state)
{
    (void)state;
    static struct spending s;
    spending_begin(&s, 1000);
    assert_true(isinf(spending_left(&s, 0, 1, 0)));
    spending_take(&s, 0, 3);
    assert_true(fabs(spending_left(&s, 0, 2, 0.5) - (3 + 6)) < 1e-9); /* half a leaf cost 3 */
    spending_take(&s, 0, 1);
    assert_true(fabs(spending_left(&s, 1, 2, 1) - 4) < 1e-9); /* a round of 4, and another */
    spending_take(&s, 1, 3);
    assert_true(fabs(spending_left(&s, 1, 3, 1.9) - (1 + 4)) < 1e-9);
    spending_take(&s, 1, 2); /* dearer than thought: nothing is left, not less than that */
    assert_true(fabs(spending_left(&s, 1, 2, 2)) < 1e-9);
    assert_true(fabs(spending_until(&s, 2) - 9) < 1e-9);
    assert_true(fabs(spending_left(&s, 2, 9, 2) - 4.5 * 7) < 1e-9); /* leaves 3 to 9 */
}

static void the_pace_is_the_present_one_and_leaves_the_start_out(void **state)
{
    (void)state;
    static struct spending s;
    spending_begin(&s, 0);
    uint64_t now = 0;
    for (; now < 5000; now += 100)
        spending_tick(&s, now); /* workers load the scene */
    assert_true(spending_pace(&s) == 0);
    for (; now < 8000; now += 100) {
        spending_add(&s, 0.2);
        spending_tick(&s, now);
    }
    assert_true(fabs(spending_pace(&s) - 2) < 0.1);
    for (; now < 68000; now += 100) { /* six more cores */
        spending_add(&s, 0.8);
        spending_tick(&s, now);
    }
    assert_true(fabs(spending_pace(&s) - 8) < 0.1);
}

/* ---- predictions ---- */

#define VALUES 60 /* that hold the error */
#define K      4

/*
 * A job whose samples are independent: VALUES differences of replicates as random walks, their mean
 * square the estimate. Two core-seconds and half a second of wall time a sample.
 */
static size_t play_job(struct ledger_row *rows, size_t capacity, uint64_t seed)
{
    const struct job_spec spec = { .replicates = K, .leaf_samples = 4 };
    double walks[VALUES * (K - 1)] = { 0 }, before = 0;
    for (size_t i = 0; i < capacity; i++) {
        double spp = (double)job_samples(&spec, (unsigned)i + 1), sum = 0;
        for (int v = 0; v < VALUES * (K - 1); v++) {
            walks[v] += sqrt(spp - before) * random_normal(&seed);
            sum += walks[v] * walks[v] / (spp * spp);
        }
        before = spp;
        rows[i] = (struct ledger_row){
            .round = (unsigned)i,
            .spp = (uint64_t)spp,
            .core_s = 2 * spp,
            .wall_s = 3 + 0.5 * spp,
            .accuracy = { .replicates = K,
                          .effective_values = VALUES,
                          .relmse = sum / (VALUES * (K - 1)) },
        };
    }
    return capacity;
}

static struct predict_job job_for(double relmse)
{
    return (struct predict_job){ .spec = { .replicates = K, .leaf_samples = 4 },
                                 .sampler = SAMPLER_INDEPENDENT,
                                 .relmse = relmse };
}

static void a_prediction_comes_with_the_second_doubling_of_known_samples(void **state)
{
    (void)state;
    struct ledger_row rows[20];
    struct prediction p;
    play_job(rows, 20, 1);
    struct predict_job job = job_for(rows[0].accuracy.relmse / 16);
    assert_false(predict_end(&job, rows, 0, &p));
    assert_false(predict_end(&job, rows, 3, &p));
    assert_true(predict_end(&job, rows, 4, &p));
    rows[0].accuracy.verdict = rows[1].accuracy.verdict = ACCURACY_FEW_SAMPLES;
    assert_false(predict_end(&job, rows, 11, &p)); /* the first known error is at 48 */
    assert_true(predict_end(&job, rows, 12, &p));
    job.relmse = 1e-30;
    assert_false(predict_end(&job, rows, 12, &p)); /* beyond all rounds */
    rows[4].accuracy.relmse = 0;
    job.relmse = 1e-4;
    assert_true(predict_end(&job, rows, 12, &p)); /* logarithms survive */
}

static void a_clear_case_is_predicted_to_the_round(void **state)
{
    (void)state;
    struct ledger_row rows[12];
    for (unsigned i = 0; i < 12; i++)
        rows[i] = (struct ledger_row){
            .round = i,
            .spp = 16 * (i + 1),
            .core_s = 32 * (i + 1),
            .wall_s = 3 + 8 * (i + 1),
            .accuracy = { .replicates = K, .effective_values = 1e9, .relmse = 0.01 / (i + 1) }
        };
    struct predict_job job = job_for(0.99 * 0.01 / 16); /* 16.2 times 16 samples: 18 */
    struct prediction p;
    assert_true(predict_end(&job, rows, 12, &p));
    assert_true(p.spp.mid == 18 * 16);
    assert_true(p.spp.low >= 16 * 16 && p.spp.high <= 20 * 16);
    assert_true(fabs(p.core_s.mid - 2 * p.spp.mid) < 1e-6);
    assert_true(fabs(p.wall_s.mid - (3 + p.spp.mid / 2)) < 1e-6);
    assert_true(p.core_s.low < 2 * p.spp.low && p.core_s.high > 2 * p.spp.high);
    assert_true(fabs(p.slope + 1) < 1e-3 && p.slope_stderr < 0.03);
    assert_true(predict_chance(&job, rows, 12, 14) < 0.01);
    assert_true(predict_chance(&job, rows, 12, 20) > 0.99);
    assert_true(isnan(predict_chance(&job, rows, 0, 20)));

    char text[160];
    assert_memory_equal(predict_text(&p, &rows[11], job.relmse, text, sizeof(text)), "0.00061875",
                        10);
    assert_non_null(strstr(text, " samples per pixel, "));
    assert_string_equal(predict_text(&p, &rows[11], job.relmse, text, 5), "0.00");
}

/* Of many played jobs the share whose end lies in the band, for targets so many times below. */
static double coverage(double times)
{
    static struct ledger_row rows[120];
    unsigned covered = 0, trials = 0;
    for (uint64_t seed = 0; seed < 400; seed++) {
        play_job(rows, 120, 77 * seed + 1);
        struct predict_job job = job_for(rows[3].accuracy.relmse / times);
        struct limits limits = { .rounds = ROUND_COUNT, .relmse = job.relmse };
        struct prediction p;
        size_t end = 4;
        while (end < 120 && !limits_met(&limits, &rows[end]))
            end++;
        if (end == 120 || !predict_end(&job, rows, 4, &p))
            fail_msg("seed %u does not end", (unsigned)seed);
        trials++;
        covered += rows[end].core_s >= p.core_s.low && rows[end].core_s <= p.core_s.high;
    }
    return (double)covered / trials;
}

static void the_bands_hold_nine_ends_of_ten(void **state)
{
    (void)state;
    for (double times = 4; times <= 64; times *= 4) {
        double share = coverage(times);
        if (share < 0.85 || share > 0.95)
            fail_msg("targets %g times below: %g of the bands", times, share);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_row_has_the_figures_of_its_round),
        cmocka_unit_test(the_csv_has_a_line_a_round_and_no_number_for_an_unknown_error),
        cmocka_unit_test(each_limit_forbids_the_round_that_exceeds_it),
        cmocka_unit_test(a_target_is_met_by_a_known_error_only),
        cmocka_unit_test(what_is_left_follows_from_whole_rounds),
        cmocka_unit_test(the_pace_is_the_present_one_and_leaves_the_start_out),
        cmocka_unit_test(a_prediction_comes_with_the_second_doubling_of_known_samples),
        cmocka_unit_test(a_clear_case_is_predicted_to_the_round),
        cmocka_unit_test(the_bands_hold_nine_ends_of_ten),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
