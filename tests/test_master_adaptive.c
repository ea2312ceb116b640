/*
 * Adaptive jobs in the master: a pilot, then samples as planned. Whatever the order and the pieces,
 * the bits are the same; the scheduler hands out the pilot first and then exactly what is planned;
 * and no picture is biased by what the pilot decided.
 */
#include "common/err.h"
#include "common/hash.h"
#include "common/scene.h"
#include "master/film.h"
#include "master/image.h"
#include "master/intake.h"
#include "master/scheduler.h"
#include "master/tile_plan.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define WIDTH  96 /* three tiles of a single row */
#define HEIGHT 1
#define TILES  3

static struct scene row_of_tiles(void)
{
    return (struct scene){
        .settings = { .width = WIDTH, .height = HEIGHT, .crop = { 0, WIDTH, 0, HEIGHT } }
    };
}

static struct job_spec spec_of(uint64_t seed)
{
    return (struct job_spec){ .seed = seed,
                              .replicates = 2,
                              .leaf_samples = 1,
                              .channel_count = 3,
                              .pilot_rounds = 2,
                              .pilot_weight = 65536 / 8 };
}
#define ROUNDS (2 + 12)

static double uniform(uint64_t seed, const struct node_id *leaf, uint64_t what)
{
    uint64_t key = hash64_4(seed, leaf->tile, leaf->replicate, leaf->index);
    return ((double)(hash64_3(key, what, 5) >> 11) + 0.5) * 0x1p-53;
}

/* One sample of every pixel: the first tile flashes as a whole, the second hardly varies, the third
 * does so with each pixel. All have the mean 1. */
static double value_of(uint64_t seed, const struct node_id *leaf, uint32_t pixel)
{
    if (leaf->tile == 0)
        return uniform(seed, leaf, 0) < 0.1 ? 10 : 0;
    if (leaf->tile == 1)
        return 0.95 + 0.1 * uniform(seed, leaf, pixel);
    double u = 2 * uniform(seed, leaf, pixel);
    return 0.5 * u + 0.5 * 1.5 * u * u / 2;
}

static struct node_sums *leaf_of(uint64_t seed, const struct node_id *leaf)
{
    struct node_sums *sums = node_sums_new(32, 3);
    assert_non_null(sums);
    for (uint32_t i = 0; i < 3 * 32; i++)
        sums->values[i] = (float)value_of(seed, leaf, i % 32);
    sums->stats.samples = 32;
    sums->stats.rays_closest = 64;
    sums->stats.largest = sums->values[0];
    return sums;
}

static struct node_sums *node_of(uint64_t seed, struct node_id id)
{
    if (id.level == 0)
        return leaf_of(seed, &id);
    id.level--;
    id.index *= 2;
    struct node_sums *left = node_of(seed, id);
    id.index++;
    struct node_sums *right = node_of(seed, id);
    node_sums_add(left, right);
    node_sums_free(right);
    return left;
}

static struct film *new_film(const struct job_spec *spec)
{
    struct scene scene = row_of_tiles();
    struct err err = { 0 };
    struct film *film = film_new(&scene, spec, ROUNDS, 0, &err);
    if (film == NULL)
        fail_msg("%s", err.text);
    return film;
}

/* The round nodes of rounds [from, to) of the job */
static size_t list_units(const struct film *film, unsigned from, unsigned to, struct node_id *nodes)
{
    const struct tile_plan *plan = film_plan(film);
    size_t count = 0;
    for (uint32_t tile = 0; tile < TILES; tile++)
        for (uint32_t s = 0; s < tile_plan_sequences(plan); s++)
            for (unsigned own = tile_plan_pair_rounds(plan, tile, s, from);
                 own < tile_plan_pair_rounds(plan, tile, s, to); own++) {
                nodes[count] = (struct node_id){ .tile = tile, .replicate = s };
                round_node(own, &nodes[count].level, &nodes[count].index);
                count++;
            }
    return count;
}

static void accept(struct film *film, uint64_t seed, struct node_id node, bool cut)
{
    if (cut && node.level > 0) {
        struct node_id half = { node.tile, node.replicate, node.level - 1, 2 * node.index + 1 };
        accept(film, seed, half, true);
        half.index--;
        accept(film, seed, half, false);
        return;
    }
    enum film_result result = film_accept(film, &node, node_of(seed, node));
    assert_true(result == FILM_ADDED || result == FILM_SEALED);
}

static void fill(struct film *film, uint64_t seed, unsigned from, unsigned to, bool shuffled)
{
    struct node_id nodes[2000];
    size_t count = list_units(film, from, to, nodes);
    assert_true(count < 2000);
    for (size_t i = count; shuffled && i > 1; i--) {
        size_t j = hash64_3(seed, i, 9) % i;
        struct node_id other = nodes[i - 1];
        nodes[i - 1] = nodes[j];
        nodes[j] = other;
    }
    for (size_t i = 0; i < count; i++)
        accept(film, seed, nodes[i], shuffled);
}

static void plan_rest(struct film *film, unsigned rounds)
{
    struct err err = { 0 };
    assert_int_equal(film_rounds(film), film_plan(film)->pilot_rounds);
    if (!film_make_plan(film, rounds, &err))
        fail_msg("%s", err.text);
}

static struct image *image_of(const struct film *film)
{
    struct err err = { 0 };
    struct image *image = image_new(WIDTH, HEIGHT);
    if (!film_image(film, image, NULL, &err))
        fail_msg("%s", err.text);
    return image;
}

static void assert_same_images(const struct film *a, const struct film *b)
{
    struct image *one = image_of(a), *other = image_of(b);
    assert_int_equal(one->channel_count, 7);
    for (uint32_t c = 0; c < one->channel_count; c++)
        assert_memory_equal(one->channels[c].values, other->channels[c].values,
                            WIDTH * HEIGHT * sizeof(float));
    image_free(one);
    image_free(other);
}

/* ---- sentences */

static void any_order_and_any_pieces_give_the_same_picture(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(1);
    struct film *films[2];
    for (int shuffled = 0; shuffled < 2; shuffled++) {
        struct film *film = films[shuffled] = new_film(&spec);
        fill(film, 1, 0, 2, shuffled == 1);
        assert_false(film_has_picture(film));
        assert_int_equal(film_spp(film), 0);
        plan_rest(film, ROUNDS);
        fill(film, 1, 2, ROUNDS, shuffled == 1);
        assert_int_equal(film_rounds(film), ROUNDS);
        assert_int_equal(film_held(film), 0);
        assert_true(film_has_picture(film));
    }
    const struct tile_plan *plan = film_plan(films[0]);
    assert_memory_equal(plan->octaves, film_plan(films[1])->octaves, TILES);
    assert_true(plan->octaves[2] > plan->octaves[1]);
    assert_same_images(films[0], films[1]);

    /* What a pixel is, by hand: tile 0, pixel 0 */
    struct image *image = image_of(films[0]);
    double mean = 0;
    uint64_t leaves = round_end(tile_plan_pair_rounds(plan, 0, 0, ROUNDS) - 1);
    for (uint32_t k = 0; k < 2; k++) {
        double pilot = 0, main = 0;
        for (uint64_t leaf = 0; leaf < 2; leaf++)
            pilot += value_of(1, &(struct node_id){ 0, 2 + k, 0, leaf }, 0);
        for (uint64_t leaf = 0; leaf < leaves; leaf++)
            main += value_of(1, &(struct node_id){ 0, k, 0, leaf }, 0);
        mean += (0.125 * pilot / 2 + 0.875 * main / (double)leaves) / 2;
    }
    assert_true(fabs((double)image_channel(image, "R")[0] - mean) < 1e-6);
    assert_true(image_channel(image, "samples")[0] == (float)(2 * leaves));
    double samples = 0;
    for (uint32_t p = 0; p < WIDTH; p++)
        samples += (double)image_channel(image, "samples")[p] / WIDTH;
    assert_int_equal(film_spp(films[0]), (uint64_t)samples);
    image_free(image);
    film_free(films[0]);
    film_free(films[1]);
}

static void before_the_plan_only_the_pilot_belongs_to_the_job(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(2);
    struct film *film = new_film(&spec);
    struct node_id main = { .replicate = 1 }, pilot = { .replicate = 3 };
    struct node_id more = { .replicate = 3, .index = 2 }, none = { .replicate = 4 };
    assert_int_equal(film_check(film, &main), FILM_FOREIGN);
    assert_int_equal(film_check(film, &pilot), FILM_ADDED);
    assert_int_equal(film_check(film, &more), FILM_FOREIGN);
    assert_int_equal(film_check(film, &none), FILM_FOREIGN);
    fill(film, 2, 0, 2, false);
    plan_rest(film, ROUNDS);
    assert_int_equal(film_check(film, &main), FILM_ADDED);
    assert_int_equal(film_check(film, &pilot), FILM_DUPLICATE);
    assert_int_equal(film_check(film, &more), FILM_FOREIGN);
    film_free(film);
}

static void equal_factors_and_no_weight_are_a_job_without_a_pilot(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(3), plain = spec_of(3);
    spec.pilot_weight = 0;
    plain.pilot_rounds = plain.pilot_weight = 0;
    struct film *adaptive = new_film(&spec), *uniform = new_film(&plain);
    /* Sums of zero in the pilot: no error anywhere, so that all tiles are alike */
    for (uint32_t tile = 0; tile < TILES; tile++)
        for (uint32_t s = 2; s < 4; s++)
            for (uint64_t leaf = 0; leaf < 2; leaf++) {
                struct node_id id = { tile, s, 0, leaf };
                struct node_sums *sums = leaf_of(3, &id);
                memset(sums->values, 0, 3 * 32 * sizeof(float));
                film_accept(adaptive, &id, sums);
            }
    plan_rest(adaptive, 2 + 9);
    fill(adaptive, 3, 2, 2 + 9, true);
    fill(uniform, 3, 0, 9, false);
    assert_int_equal(film_spp(adaptive), film_spp(uniform));
    assert_same_images(adaptive, uniform);
    film_free(adaptive);
    film_free(uniform);
}

/* A worker that renders leases until there are none. */
static uint64_t work_off(struct scheduler *s, struct sched_worker *worker, struct film *film)
{
    struct lease_order order;
    uint64_t now_ms = 0, leaves = 0;
    while (scheduler_lease(s, worker, ++now_ms, &order))
        for (uint32_t i = 0; i < order.node_count; i++) {
            uint8_t digest[CHECKSUM_SIZE] = { 0 };
            struct node_id node = order.nodes[i];
            assert_int_equal(scheduler_result(s, worker, &node, digest, now_ms), RESULT_ACCEPTED);
            accept(film, 4, node, false);
            leaves += (uint64_t)1 << node.level;
        }
    return leaves;
}

static void the_scheduler_hands_out_the_pilot_and_then_what_is_planned(void **state)
{
    (void)state;
    for (int tiny = 0; tiny < 2; tiny++) {
        struct job_spec spec = spec_of(4);
        struct film *film = new_film(&spec);
        const struct tile_plan *plan = film_plan(film);
        struct scheduler_settings settings = scheduler_defaults();
        settings.tiles = TILES;
        settings.replicates = job_sequences(&spec);
        settings.plan = plan;
        if (tiny)
            settings.lease_leaves_max = 1;
        struct scheduler *s = scheduler_new(&settings, 0);
        struct sched_worker *worker = scheduler_worker_joined(s, 1, 2, 100, NULL, 0);
        scheduler_allow_rounds(s, 2);
        assert_int_equal(work_off(s, worker, film), TILES * 2 * 2);
        assert_true(scheduler_done(s));
        assert_int_equal(scheduler_sealed(s), 2);

        plan_rest(film, ROUNDS);
        scheduler_allow_rounds(s, ROUNDS);
        assert_false(scheduler_done(s));
        assert_int_equal(pieces_leaves_unleased(scheduler_pieces(s)),
                         tile_plan_leaves(plan, ROUNDS) - TILES * 2 * 2);
        work_off(s, worker, film);
        assert_true(scheduler_done(s));
        assert_int_equal(scheduler_sealed(s), ROUNDS);
        assert_int_equal(pieces_leaves_done(scheduler_pieces(s)), tile_plan_leaves(plan, ROUNDS));
        assert_int_equal(film_rounds(film), ROUNDS);

        uint8_t digest[CHECKSUM_SIZE] = { 0 };
        struct node_id pilot = { .replicate = 2, .index = 1 }, main = { .replicate = 0 };
        struct node_id beyond = { .replicate = 2, .index = 2 };
        assert_int_equal(scheduler_result(s, worker, &pilot, digest, 0), RESULT_LATE);
        assert_int_equal(scheduler_result(s, worker, &main, digest, 0), RESULT_LATE);
        assert_int_equal(scheduler_result(s, worker, &beyond, digest, 0), RESULT_REFUSED);
        scheduler_free(s);
        film_free(film);
    }
}

struct taking {
    struct film *film;
    struct intake *intake;
    unsigned ended;
};

static void on_round(void *owner, unsigned round)
{
    struct taking *t = owner;
    struct err err;
    assert_int_equal(round, t->ended);
    t->ended++;
    assert_true(intake_end_round(t->intake, 1, 1, &err));
    assert_true((intake_picture(t->intake) != NULL) == (round >= 2));
    if (round == 1)
        plan_rest(t->film, ROUNDS);
}

static void rows_begin_when_every_tile_has_samples(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(5);
    struct taking t = { .film = new_film(&spec) };
    t.intake = intake_new(&spec, t.film, on_round, &t);
    struct err err = { 0 };
    for (int part = 0; part < 2; part++) {
        struct node_id nodes[2000];
        size_t count = list_units(t.film, part == 0 ? 0 : 2, part == 0 ? 2 : ROUNDS, nodes);
        for (size_t i = 0; i < count; i++) { /* tile by tile, so that most come early */
            struct node_sums *sums = node_of(5, nodes[i]);
            assert_true(intake_check(t.intake, &nodes[i], sums, &err));
            assert_true(intake_add(t.intake, &nodes[i], sums, &err));
        }
    }
    size_t rows;
    const struct ledger_row *ledger = intake_ledger(t.intake, &rows);
    assert_int_equal(t.ended, ROUNDS);
    assert_int_equal(rows, ROUNDS - 2);
    assert_int_equal(ledger[0].round, 2);
    assert_true(ledger[0].spp >= 2);
    for (size_t i = 1; i < rows; i++)
        assert_true(ledger[i].spp >= ledger[i - 1].spp);
    intake_free(t.intake);
    film_free(t.film);
}

static void samples_do_not_decide_their_own_fate(void **state) /* no bias, and the planted bug */
{
    (void)state;
    enum { RENDERS = 2000 };
    double sum[TILES] = { 0 }, squares[TILES] = { 0 }, naive[TILES] = { 0 };
    double naive_squares[TILES] = { 0 };
    unsigned distinct = 0;
    for (uint64_t seed = 0; seed < RENDERS; seed++) {
        struct job_spec spec = spec_of(seed);
        struct film *film = new_film(&spec);
        fill(film, seed, 0, 2, false);
        plan_rest(film, ROUNDS);
        fill(film, seed, 2, ROUNDS, false);
        struct image *image = image_of(film);
        for (uint32_t tile = 0; tile < TILES; tile++) {
            double value = (double)image_channel(image, "R")[32 * tile];
            sum[tile] += value / RENDERS;
            squares[tile] += value * value / RENDERS;
            /* Planted: each sample counts alike, as if nobody had looked at the pilot's */
            uint64_t leaves = round_end(tile_plan_pair_rounds(film_plan(film), tile, 0, ROUNDS) -
                                        1);
            double all = 0;
            for (uint32_t s = 0; s < 4; s++)
                for (uint64_t leaf = 0; leaf < (s < 2 ? leaves : 2); leaf++)
                    all += value_of(seed, &(struct node_id){ tile, s, 0, leaf }, 0);
            all /= (double)(2 * leaves + 4);
            naive[tile] += all / RENDERS;
            naive_squares[tile] += all * all / RENDERS;
        }
        distinct |= 1u << (film_plan(film)->octaves[0] - TILE_PLAN_OCTAVE_MIN);
        image_free(image);
        film_free(film);
    }
    assert_true(__builtin_popcount(distinct) >= 3); /* the plans differ, or this means nothing */
    for (uint32_t tile = 0; tile < TILES; tile++) {
        double stderror = sqrt((squares[tile] - sum[tile] * sum[tile]) / RENDERS);
        if (!(fabs(sum[tile] - 1) < 4 * stderror))
            fail_msg("tile %u: %g +- %g", tile, sum[tile], stderror);
    }
    double stderror = sqrt((naive_squares[0] - naive[0] * naive[0]) / RENDERS);
    if (!(fabs(naive[0] - 1) > 4 * stderror))
        fail_msg("the planted bias is not seen: %g +- %g", naive[0], stderror);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(any_order_and_any_pieces_give_the_same_picture),
        cmocka_unit_test(before_the_plan_only_the_pilot_belongs_to_the_job),
        cmocka_unit_test(equal_factors_and_no_weight_are_a_job_without_a_pilot),
        cmocka_unit_test(the_scheduler_hands_out_the_pilot_and_then_what_is_planned),
        cmocka_unit_test(rows_begin_when_every_tile_has_samples),
        cmocka_unit_test(samples_do_not_decide_their_own_fate),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
