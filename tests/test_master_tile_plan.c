/*
 * The plan of samples per tile: rounds of the job and rounds of pairs fit together whatever the
 * factors, and the factors are worth having and stay within their limits.
 */
#include "common/hash.h"
#include "common/job.h"
#include "common/scene.h"
#include "master/tile_plan.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#define ACROSS 8
#define TILES  (ACROSS * ACROSS)
#define LEAVES 16 /* of a main sequence, with a factor of 1 */

/* A plan of 8x8 tiles, not made yet; the pilot has one round, the job 16 more. */
static struct tile_plan new_plan(void)
{
    struct scene scene = { .settings = {
                               .width = 256, .height = 256, .crop = { 0, 256, 0, 256 } } };
    struct job_spec spec = { .replicates = 4, .leaf_samples = 4 };
    assert_true(job_shape_pilot(4 * 4 * LEAVES, &spec));
    assert_int_equal(spec.pilot_rounds, 1);
    struct tile_plan plan;
    assert_true(tile_plan_open(&plan, &scene, &spec));
    assert_int_equal(plan.tiles, TILES);
    for (uint32_t tile = 0; tile < TILES; tile++)
        plan.looks[tile] = (struct tile_look){ .pixels = 1024, .error = 1, .work = 1000 };
    return plan;
}

static unsigned rounds_of_job(void)
{
    return 1 + round_reaching(LEAVES) + 1;
}

static double random_of(uint64_t key)
{
    return ((double)(hash64_3(key, 1, 2) >> 11) + 0.5) * 0x1p-53;
}

static void without_a_pilot_a_round_is_a_round(void **state)
{
    (void)state;
    struct tile_plan plan = tile_plan_uniform(5, 3);
    assert_int_equal(tile_plan_sequences(&plan), 3);
    for (unsigned round = 0; round < ROUND_COUNT; round++) {
        struct node_id node = { .tile = 4, .replicate = 2 };
        unsigned found = 1000;
        round_node(round, &node.level, &node.index);
        assert_true(tile_plan_job_round(&plan, &node, &found));
        assert_int_equal(found, round);
        assert_int_equal(tile_plan_pair_rounds(&plan, 4, 2, round), round);
        assert_int_equal(tile_plan_units(&plan, round), 15);
        assert_int_equal(tile_plan_leaves(&plan, round + 1), 15 * round_end(round));
    }
    unsigned round;
    const struct node_id wrong[] = {
        { 5, 0, 0, 0 }, { 0, 3, 0, 0 }, { 0, 0, 1, 1 }, { 0, 0, 0, UINT64_MAX }
    };
    for (size_t i = 0; i < sizeof(wrong) / sizeof(*wrong); i++)
        assert_false(tile_plan_job_round(&plan, &wrong[i], &round));
}

/* Every factor, in turn */
static void set_all_octaves(struct tile_plan *plan)
{
    const int count = TILE_PLAN_OCTAVE_MAX - TILE_PLAN_OCTAVE_MIN + 1;
    for (uint32_t tile = 0; tile < TILES; tile++)
        plan->octaves[tile] = (int8_t)(TILE_PLAN_OCTAVE_MIN + (int)tile % count);
    plan->made = true;
}

static void rounds_of_pairs_lie_in_the_rounds_of_the_job(void **state)
{
    (void)state;
    struct tile_plan plan = new_plan();
    set_all_octaves(&plan);
    for (unsigned round = 0; round < 70; round++) {
        uint64_t units = 0, leaves = 0;
        for (uint32_t tile = 0; tile < TILES; tile++)
            for (uint32_t s = 0; s < tile_plan_sequences(&plan); s++) {
                unsigned from = tile_plan_pair_rounds(&plan, tile, s, round);
                unsigned to = tile_plan_pair_rounds(&plan, tile, s, round + 1);
                assert_true(from <= to);
                units += to - from;
                leaves += to == 0 ? 0 : round_end(to - 1);
                for (unsigned own = from; own < to; own++) {
                    struct node_id node = { .tile = tile, .replicate = s };
                    unsigned found;
                    round_node(own, &node.level, &node.index);
                    assert_true(tile_plan_job_round(&plan, &node, &found));
                    assert_int_equal(found, round);
                }
                /* The pilot has the first round to itself, and no other */
                assert_true(s < 4 ? round > 0 || to == 0 : to == 1);
                assert_true(s >= 4 || round < 1 || to >= 1);
            }
        assert_int_equal(tile_plan_units(&plan, round), units);
        assert_int_equal(tile_plan_leaves(&plan, round + 1), leaves);
    }
    /* A factor is exact once a quarter of the leaves is a whole number of them */
    for (uint32_t tile = 0; tile < TILES; tile++) {
        unsigned own = tile_plan_pair_rounds(&plan, tile, 0, rounds_of_job());
        assert_true((double)round_end(own - 1) == LEAVES * tile_plan_factor(&plan, tile));
    }
    struct node_id beyond = { .tile = 0, .replicate = 4, .index = 1 };
    unsigned round;
    assert_false(tile_plan_job_round(&plan, &beyond, &round));
    tile_plan_close(&plan);
}

static void nothing_but_the_pilot_is_planned_at_first(void **state)
{
    (void)state;
    struct tile_plan plan = new_plan();
    struct node_id pilot = { .replicate = 7 }, main = { .replicate = 3 };
    unsigned round;
    assert_true(tile_plan_job_round(&plan, &pilot, &round));
    assert_false(tile_plan_job_round(&plan, &main, &round));
    assert_true(tile_plan_make(&plan, rounds_of_job()));
    assert_true(tile_plan_job_round(&plan, &main, &round));
    assert_int_equal(round, 1);
    tile_plan_close(&plan);
}

static double work_of(const struct tile_plan *plan)
{
    double work = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        work += plan->looks[tile].work *
                (double)round_end(tile_plan_pair_rounds(plan, tile, 0, rounds_of_job()) - 1);
    return work;
}

static double error_of(const struct tile_plan *plan)
{
    double error = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        error += plan->looks[tile].error /
                 (double)round_end(tile_plan_pair_rounds(plan, tile, 0, rounds_of_job()) - 1);
    return error;
}

static void known_errors_give_most_of_the_possible_gain(void **state)
{
    (void)state;
    for (uint64_t trial = 0; trial < 20; trial++) {
        struct tile_plan plan = new_plan();
        double error = 0, work = 0, both = 0;
        for (uint32_t tile = 0; tile < TILES; tile++) {
            struct tile_look *look = &plan.looks[tile];
            double u = random_of(100 * trial + tile), v = random_of(7777 * trial + tile);
            look->error = 1 / (u + 0.02);
            look->work = 500 + 1000 * v;
            error += look->error;
            work += look->work;
            both += sqrt(look->error * look->work);
        }
        assert_true(tile_plan_make(&plan, rounds_of_job()));
        double possible = error * work / (both * both);
        double gain = error / LEAVES * work * LEAVES / (error_of(&plan) * work_of(&plan));
        assert_true(work_of(&plan) <= work * LEAVES * (1 + 1e-9));
        assert_true(work_of(&plan) >= 0.95 * work * LEAVES);
        if (!(possible > 1.1 && gain > 0.9 * possible && gain > 1))
            fail_msg("trial %d: %g of %g", (int)trial, gain, possible);
        /* The pilot costs a sixteenth, and is known to */
        assert_true(plan.predicted_gain < gain && plan.predicted_gain > 0.94 * gain);
        tile_plan_close(&plan);
    }
}

static void equal_tiles_have_equal_factors(void **state)
{
    (void)state;
    for (int black = 0; black < 2; black++) {
        struct tile_plan plan = new_plan();
        for (uint32_t tile = 0; tile < TILES; tile++)
            plan.looks[tile].error = black ? 0 : 1 + 0.4 * random_of(tile);
        assert_true(tile_plan_make(&plan, rounds_of_job()));
        for (uint32_t tile = 0; tile < TILES; tile++)
            assert_true(tile_plan_factor(&plan, tile) == 1);
        assert_true(plan.predicted_gain > 0.94 && plan.predicted_gain <= 1);
        tile_plan_close(&plan);
    }
}

static void factors_have_limits_and_neighbours_count(void **state)
{
    (void)state;
    struct tile_plan plan = new_plan();
    const uint32_t hot = 3 * ACROSS + 3, corner = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        plan.looks[tile].error = 1e-4;
    plan.looks[hot].error = 1000;
    assert_true(tile_plan_make(&plan, rounds_of_job()));
    assert_true(tile_plan_factor(&plan, hot) == 8);
    assert_true(tile_plan_factor(&plan, corner) >= 0.25);
    for (uint32_t tile = 0; tile < TILES; tile++) {
        uint32_t x = tile % ACROSS, y = tile / ACROSS;
        if (tile != hot && x >= 2 && x <= 4 && y >= 2 && y <= 4)
            assert_true(tile_plan_factor(&plan, tile) > tile_plan_factor(&plan, corner));
    }
    assert_true(work_of(&plan) >= 0.95 * TILES * 1000 * LEAVES); /* what is left is not lost */
    tile_plan_close(&plan);
}

static void a_single_sample_does_not_draw_all_others(void **state)
{
    (void)state;
    const uint32_t hot = 5 * ACROSS + 2;
    double factors[2];
    for (int one = 0; one < 2; one++) {
        struct tile_plan plan = new_plan();
        plan.looks[hot].error = 100;
        plan.looks[hot].one_sample = one == 1;
        assert_true(tile_plan_make(&plan, rounds_of_job()));
        factors[one] = tile_plan_factor(&plan, hot);
        tile_plan_close(&plan);
    }
    assert_true(factors[0] == 8 && factors[1] == 1);
}

static void an_open_end_is_planned_for_a_long_time(void **state)
{
    (void)state;
    struct tile_plan plan = new_plan();
    plan.pilot_weight = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        plan.looks[tile].error = tile < 8 ? 16 : 1;
    assert_true(tile_plan_make(&plan, 0));
    assert_true(tile_plan_factor(&plan, 1) >= 2 && tile_plan_factor(&plan, TILES - 1) <= 1);
    double work = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        work += tile_plan_factor(&plan, tile);
    assert_true(work <= TILES && work >= 0.95 * TILES);
    tile_plan_close(&plan);
}

static void a_pilot_is_a_sixteenth_at_most(void **state)
{
    (void)state;
    struct job_spec spec = { .replicates = 4, .leaf_samples = 4 };
    assert_false(job_shape_pilot(255, &spec));
    assert_int_equal(job_sequences(&spec), 4);
    static const uint64_t spp[] = { 256, 300, 511, 512, 1000, 4096, (uint64_t)1 << 30 };
    for (size_t i = 0; i < sizeof(spp) / sizeof(*spp); i++) {
        assert_true(job_shape_pilot(spp[i], &spec));
        uint64_t leaves = round_end(spec.pilot_rounds - 1);
        assert_true((leaves & (leaves - 1)) == 0 && 16 * leaves <= spp[i] / 16);
        assert_true(job_pilot_weight(&spec) > 0 && job_pilot_weight(&spec) < 1.0 / 64);
        assert_true(job_samples(&spec, job_rounds(&spec, spp[i])) >= spp[i]);
        assert_int_equal(job_samples(&spec, spec.pilot_rounds), 0);
    }
    assert_int_equal(job_sequences(&spec), 8);
    assert_true(job_shape_pilot(0, &spec)); /* by time: what decides is not shown */
    assert_true(spec.pilot_rounds == 1 && job_pilot_weight(&spec) == 0);
    spec.replicates = 1;
    assert_false(job_shape_pilot(4096, &spec));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(without_a_pilot_a_round_is_a_round),
        cmocka_unit_test(rounds_of_pairs_lie_in_the_rounds_of_the_job),
        cmocka_unit_test(nothing_but_the_pilot_is_planned_at_first),
        cmocka_unit_test(known_errors_give_most_of_the_possible_gain),
        cmocka_unit_test(equal_tiles_have_equal_factors),
        cmocka_unit_test(factors_have_limits_and_neighbours_count),
        cmocka_unit_test(a_single_sample_does_not_draw_all_others),
        cmocka_unit_test(an_open_end_is_planned_for_a_long_time),
        cmocka_unit_test(a_pilot_is_a_sixteenth_at_most),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
