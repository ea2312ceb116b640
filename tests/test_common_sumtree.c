/* The sum tree gives the same bits whatever comes when; rounds and job shapes are exact. */
#include "common/job.h"
#include "common/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PIXELS   5
#define CHANNELS 3

static uint64_t hash(uint64_t x)
{
    x = (x ^ x >> 32) * 0xd6e8feb86659fd93u;
    x = (x ^ x >> 32) * 0xd6e8feb86659fd93u;
    return x ^ x >> 32;
}

/* Values of very different sizes and both signs: any other order of additions shows. */
static struct node_sums *leaf_sums(uint64_t leaf)
{
    struct node_sums *sums = node_sums_new(PIXELS, CHANNELS);
    assert_non_null(sums);
    for (unsigned i = 0; i < PIXELS * CHANNELS; i++) {
        uint64_t bits = hash(leaf * 64 + i);
        float scale = (float)((uint64_t)1 << bits % 24);
        sums->values[i] = ((float)(bits >> 40) * 0x1p-24f - 0.5f) * scale;
    }
    sums->stats = (struct node_stats){ .samples = 4 * PIXELS,
                                       .rays_closest = leaf % 7,
                                       .rays_shadow = leaf % 5,
                                       .events = leaf,
                                       .nonfinite = { leaf % 2, leaf % 3, 1 },
                                       .truncated_paths = leaf % 11,
                                       .truncated_energy = (double)(hash(leaf) % 1000) / 7,
                                       .largest = (float)(hash(leaf) % 1009) };
    sums->failed[leaf / 32 % (TILE_PIXELS / 32)] = 1u << leaf % 32;
    return sums;
}

/* A node by its definition. */
static struct node_sums *node_by_definition(uint32_t level, uint64_t index)
{
    if (level == 0)
        return leaf_sums(index);
    struct node_sums *left = node_by_definition(level - 1, 2 * index);
    struct node_sums *right = node_by_definition(level - 1, 2 * index + 1);
    node_sums_add(left, right);
    node_sums_free(right);
    return left;
}

static void assert_same_sums(const struct node_sums *a, const struct node_sums *b)
{
    assert_memory_equal(&a->stats, &b->stats, sizeof(a->stats));
    assert_memory_equal(a->failed, b->failed, sizeof(a->failed));
    assert_memory_equal(a->values, b->values, PIXELS * CHANNELS * sizeof(float));
}

static void rounds_tile_the_leaf_axis_up_to_2_to_the_40(void **state)
{
    (void)state;
    uint64_t end = 0;
    for (unsigned round = 0; round < ROUND_COUNT; round++) {
        uint32_t level;
        uint64_t index;
        round_node(round, &level, &index);
        assert_true(index << level == end); /* starts where the last one ended, aligned */
        end = (index + 1) << level;
        assert_true(round_end(round) == end);
        assert_true(__builtin_popcountll(end) <= 4);
        assert_int_equal(round_reaching(end), round);
        assert_int_equal(round_reaching((index << level) + 1), round);
        if (round + 1 < ROUND_COUNT)
            assert_int_equal(round_reaching(end + 1), round + 1);
        if (end >= 8) { /* 2^m (8 + j) / 8 */
            unsigned m = 63 - (unsigned)__builtin_clzll(end);
            assert_int_equal(end & (((uint64_t)1 << (m - 3)) - 1), 0);
        }
    }
    assert_true(end == (uint64_t)1 << 40);
}

static void the_round_that_reaches_a_count_is_the_first(void **state)
{
    (void)state;
    unsigned round = 0;
    for (uint64_t leaves = 0; leaves <= 20000; leaves++) {
        while (round_end(round) < leaves)
            round++;
        assert_int_equal(round_reaching(leaves), round);
    }
}

static void a_node_lies_in_a_round_or_crosses_its_end(void **state)
{
    (void)state;
    for (uint32_t level = 0; level < 8; level++)
        for (uint64_t index = 0; index < 300; index++) {
            uint64_t first = index << level, last = (index + 1) << level;
            unsigned want = round_reaching(first + 1), got;
            bool inside = last <= round_end(want);
            assert_int_equal(round_holding(level, index, &got), inside);
            if (inside)
                assert_int_equal(got, want);
        }
}

static void leaves_near_2_to_the_32_and_40_are_told_apart(void **state) /* H51 */
{
    (void)state;
    unsigned round;
    for (int bits = 31; bits <= 39; bits++) {
        uint64_t power = (uint64_t)1 << bits;
        unsigned before = 0, after = 0;
        assert_true(round_holding(0, power - 1, &before) && round_holding(0, power, &after));
        assert_int_equal(after, before + 1);
        assert_true(round_end(before) == power);
    }
    assert_true(round_holding(0, ((uint64_t)1 << 40) - 1, &round) && round == ROUND_COUNT - 1);
    assert_false(round_holding(0, (uint64_t)1 << 40, &round));
    assert_false(round_holding(40, 0, &round)); /* the whole axis is no round */
    assert_false(round_holding(41, 0, &round));
    assert_false(round_holding(UINT32_MAX, UINT64_MAX, &round));

    struct fold *fold = fold_new(3, ((uint64_t)1 << 37) - 1); /* the last eight leaves */
    uint64_t first = ((uint64_t)1 << 40) - 8;
    for (uint64_t leaf = first; leaf < first + 8; leaf++)
        assert_int_equal(fold_add(fold, 0, leaf, leaf_sums(leaf)), FOLD_ADDED);
    struct node_sums *got = fold_take(fold), *want = node_by_definition(3, first >> 3);
    assert_same_sums(got, want);
    node_sums_free(got);
    node_sums_free(want);
    fold_free(fold);
}

struct piece {
    uint32_t level;
    uint64_t index;
};

/* Cut a node into random pieces, appended to `pieces`. */
static size_t cut(uint32_t level, uint64_t index, uint64_t *random, struct piece *pieces)
{
    *random = hash(*random + 1);
    if (level == 0 || *random % 3 == 0) {
        *pieces = (struct piece){ level, index };
        return 1;
    }
    size_t left = cut(level - 1, 2 * index, random, pieces);
    return left + cut(level - 1, 2 * index + 1, random, pieces + left);
}

static void shuffle(struct piece *pieces, size_t count, uint64_t *random)
{
    for (size_t i = count; i > 1; i--) {
        *random = hash(*random + 1);
        size_t j = *random % i;
        struct piece swapped = pieces[i - 1];
        pieces[i - 1] = pieces[j];
        pieces[j] = swapped;
    }
}

static void any_pieces_in_any_order_give_the_node_by_definition(void **state) /* H59 */
{
    (void)state;
    uint64_t random = 7;
    for (int trial = 0; trial < 200; trial++) {
        uint32_t level = (uint32_t)trial % 7;
        uint64_t index = 8 + (uint64_t)trial % 8;
        struct node_sums *want = node_by_definition(level, index);
        struct piece pieces[64];
        size_t count = cut(level, index, &random, pieces);
        shuffle(pieces, count, &random);

        struct fold *fold = fold_new(level, index);
        for (size_t i = 0; i < count; i++) {
            assert_null(fold_take(fold));
            assert_int_equal(fold_add(fold, pieces[i].level, pieces[i].index,
                                      node_by_definition(pieces[i].level, pieces[i].index)),
                             FOLD_ADDED);
        }
        struct node_sums *got = fold_take(fold);
        assert_non_null(got);
        assert_same_sums(got, want);
        assert_int_equal(fold_waiting(fold), 0);
        node_sums_free(got);
        node_sums_free(want);
        fold_free(fold);
    }
}

static void in_order_a_fold_holds_no_more_than_its_depth(void **state)
{
    (void)state;
    struct fold *fold = fold_new(8, 8);
    for (uint64_t leaf = 0; leaf < 256; leaf++) {
        assert_int_equal(fold_add(fold, 0, 8 * 256 + leaf, leaf_sums(leaf)), FOLD_ADDED);
        assert_int_equal(fold_waiting(fold), __builtin_popcountll(leaf + 1));
    }
    fold_free(fold); /* with the sums in it */
}

static void what_is_covered_or_elsewhere_is_refused(void **state)
{
    (void)state;
    struct fold *fold = fold_new(3, 9); /* leaves 72..79 */
    struct node_sums *spare = leaf_sums(0);
    assert_int_equal(fold_add(fold, 1, 37, leaf_sums(1)), FOLD_ADDED); /* 74, 75 */
    static const struct {
        const char *what;
        uint32_t level;
        uint64_t index;
        enum fold_result want;
    } rows[] = {
        { "the same node again", 1, 37, FOLD_DUPLICATE },
        { "its left half", 0, 74, FOLD_DUPLICATE },
        { "its right half", 0, 75, FOLD_DUPLICATE },
        { "its parent", 2, 18, FOLD_DUPLICATE },
        { "the target with a part of it here", 3, 9, FOLD_DUPLICATE },
        { "the leaf before the target", 0, 71, FOLD_FOREIGN },
        { "the leaf after the target", 0, 80, FOLD_FOREIGN },
        { "a node above the target", 4, 4, FOLD_FOREIGN },
        { "the target's sibling", 3, 8, FOLD_FOREIGN },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++) {
        if (fold_add(fold, rows[i].level, rows[i].index, spare) != rows[i].want)
            fail_msg("%s", rows[i].what);
        assert_int_equal(fold_waiting(fold), 1);
    }
    node_sums_free(spare);
    fold_free(fold);
}

/* Push rounds [from, to), each cut into pieces that arrive shuffled. */
static void push_rounds(struct sum_stack *stack, unsigned from, unsigned to, uint64_t *random)
{
    for (unsigned round = from; round < to; round++) {
        uint32_t level;
        uint64_t index;
        round_node(round, &level, &index);
        struct piece pieces[64];
        size_t count = cut(level, index, random, pieces);
        shuffle(pieces, count, random);
        struct fold *fold = fold_new(level, index);
        for (size_t i = 0; i < count; i++)
            fold_add(fold, pieces[i].level, pieces[i].index,
                     node_by_definition(pieces[i].level, pieces[i].index));
        sum_stack_push(stack, level, fold_take(fold));
        fold_free(fold);

        int held = 0;
        for (unsigned l = 0; l <= NODE_LEVEL_MAX; l++)
            held += stack->sums[l] != NULL;
        assert_true(held <= 4);
        assert_true(stack->leaves == round_end(round));
    }
}

static void a_64_spp_job_extended_to_256_is_a_256_spp_job(void **state)
{
    (void)state;
    struct job_spec spec = { 0 }, straight = { 0 };
    assert_int_equal(job_shape(64, 0, &spec), 64);
    assert_int_equal(job_shape(256, 0, &straight), 256);
    assert_memory_equal(&spec, &straight, sizeof(spec)); /* same K and B */
    unsigned first = job_rounds(&spec, 64), all = job_rounds(&spec, 256);
    assert_int_equal(job_samples(&spec, first), 64);
    assert_int_equal(job_samples(&spec, all), 256);

    uint64_t random = 1;
    struct sum_stack extended = { 0 }, at_once = { 0 };
    struct node_sums *total = node_sums_new(PIXELS, CHANNELS);
    struct node_sums *want = node_sums_new(PIXELS, CHANNELS);
    push_rounds(&extended, 0, first, &random);
    sum_stack_total(&extended, total); /* looked at in between, which leaves no trace */
    push_rounds(&extended, first, all, &random);
    push_rounds(&at_once, 0, all, &random);
    sum_stack_total(&extended, total);
    sum_stack_total(&at_once, want);
    assert_same_sums(total, want);

    push_rounds(&at_once, all, 40, &random); /* and on to four sums */
    sum_stack_clear(&extended);
    sum_stack_total(&extended, total);
    assert_int_equal(total->stats.samples, 0);
    sum_stack_clear(&at_once);
    node_sums_free(total);
    node_sums_free(want);
}

/* A running float32 sum of tenths stops at 2^21; the tree's partial sums have about the same size
 */
static void ten_million_samples_do_not_stagnate(void **state) /* H57 */
{
    (void)state;
    const uint64_t leaves = 1 << 18;
    const unsigned per_leaf = 128; /* together 2^25 samples */
    struct sum_stack stack = { 0 };
    struct node_sums *total = node_sums_new(1, 1);
    double leaf = 0;
    float naive = 0;
    for (unsigned i = 0; i < per_leaf; i++)
        leaf += (double)0.1f; /* a leaf adds its samples in double */
    for (uint64_t i = 0; i < leaves; i++) {
        struct node_sums *sums = node_sums_new(1, 1);
        assert_non_null(sums);
        sums->values[0] = (float)leaf;
        sum_stack_push(&stack, 0, sums);
        for (unsigned k = 0; k < per_leaf; k++)
            naive += 0.1f;
    }
    sum_stack_total(&stack, total);
    double samples = (double)leaves * per_leaf;
    assert_true(fabs((double)total->values[0] / samples - 0.1) < 1e-7);
    assert_true((double)naive / samples < 0.07); /* what the test is there to catch */
    sum_stack_clear(&stack);
    node_sums_free(total);
}

static void an_unfinished_counter_is_folded_smallest_node_first(void **state)
{
    (void)state;
    struct sum_stack stack = { 0 };
    for (uint64_t leaf = 0; leaf < 13; leaf++) /* 8 + 4 + 1 */
        sum_stack_push(&stack, 0, leaf_sums(leaf));
    struct node_sums *want = leaf_sums(12);
    struct node_sums *four = node_by_definition(2, 2), *eight = node_by_definition(3, 0);
    node_sums_add(want, four);
    node_sums_add(want, eight);
    struct node_sums *got = node_sums_new(PIXELS, CHANNELS);
    sum_stack_total(&stack, got);
    assert_same_sums(got, want);
    node_sums_free(got);
    node_sums_free(want);
    node_sums_free(four);
    node_sums_free(eight);
    sum_stack_clear(&stack);
}

static void counters_add_failures_join_and_the_largest_wins(void **state)
{
    (void)state;
    struct node_sums *a = node_sums_new(1, 1), *b = node_sums_new(1, 1);
    a->values[0] = 1;
    b->values[0] = 2;
    a->stats.largest = 5;
    b->stats.largest = 3;
    a->failed[0] = 1;
    b->failed[31] = 2;
    a->stats.rays_closest = b->stats.rays_closest = (uint64_t)1 << 40;
    b->stats.truncated_energy = 0.25;
    node_sums_add(a, b);
    assert_true(a->values[0] == 3 && a->stats.largest == 5 && a->stats.truncated_energy == 0.25);
    assert_true(a->failed[0] == 1 && a->failed[31] == 2);
    assert_true(a->stats.rays_closest == (uint64_t)1 << 41);
    node_sums_free(a);
    node_sums_free(b);
}

static void a_job_takes_the_shape_its_samples_allow(void **state)
{
    (void)state;
    static const struct {
        uint64_t spp;
        uint32_t replicates, want_k, want_b;
        uint64_t want_spp;
    } rows[] = {
        { 0, 0, 1, 1, 1 },       { 1, 0, 1, 1, 1 },     { 2, 0, 1, 2, 2 },
        { 3, 0, 1, 2, 4 },       { 4, 0, 2, 2, 4 },     { 7, 0, 3, 2, 12 },
        { 8, 0, 4, 2, 8 },       { 15, 0, 4, 2, 16 },   { 16, 0, 4, 4, 16 },
        { 17, 0, 4, 4, 32 },     { 64, 0, 4, 4, 64 },   { 100, 0, 4, 4, 112 },
        { 256, 0, 4, 4, 256 },   { 257, 0, 4, 4, 288 }, { 64, 32, 32, 2, 64 },
        { 128, 32, 32, 4, 128 }, { 64, 1, 1, 4, 64 },   { 1000, 0, 4, 4, 1024 },
        { 4096, 8, 8, 4, 4096 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++) {
        struct job_spec spec = { 0 };
        uint64_t spp = job_shape(rows[i].spp, rows[i].replicates, &spec);
        if (spec.replicates != rows[i].want_k || spec.leaf_samples != rows[i].want_b ||
            spp != rows[i].want_spp)
            fail_msg("%d spp: K %u, B %u, %d spp", (int)rows[i].spp, spec.replicates,
                     spec.leaf_samples, (int)spp);
        if (spp >= 4 * (rows[i].replicates == 0 ? 4 : rows[i].replicates)) /* whole rounds stay */
            assert_int_equal(job_shape(spp, rows[i].replicates, &spec), spp);
    }
    struct job_spec spec = { 0 };
    assert_true(job_shape(UINT64_MAX, 0, &spec) == (uint64_t)1 << 44); /* 2^40 leaves */
}

static void filters_with_negative_lobes_get_samples_in_fours(void **state)
{
    (void)state;
    for (uint64_t spp = 0; spp < 200; spp++)
        for (uint32_t k = 0; k < 9; k++) {
            struct job_spec spec = { 0 };
            uint64_t rounded = job_shape_in_fours(spp, k, &spec);
            assert_int_equal(spec.leaf_samples, 4);
            assert_true(rounded >= spp && rounded >= 4 && rounded % (4 * spec.replicates) == 0);
        }
    assert_true(job_in_fours(&(struct filter_spec){ .kind = FILTER_MITCHELL, .c = 1.f / 3 }));
    assert_false(job_in_fours(&(struct filter_spec){ .kind = FILTER_MITCHELL, .b = 1 }));
    assert_false(job_in_fours(&(struct filter_spec){ .kind = FILTER_GAUSSIAN, .c = 1 }));
    assert_true(job_in_fours(&(struct filter_spec){ .kind = FILTER_SINC, .radius = { 1, 4 } }));
    assert_false(job_in_fours(&(struct filter_spec){ .kind = FILTER_SINC, .radius = { 1, 1 } }));
}

static void tiles_cover_the_crop_window_once(void **state)
{
    (void)state;
    enum { WIDTH = 200, HEIGHT = 100 };
    static const uint32_t crops[][4] = {
        { 0, 200, 0, 100 }, { 13, 14, 7, 8 }, { 1, 97, 3, 35 }, { 5, 70, 50, 100 }
    };
    for (size_t i = 0; i < sizeof(crops) / sizeof(*crops); i++) {
        struct scene scene = { .settings = { .width = WIDTH, .height = HEIGHT } };
        memcpy(scene.settings.crop, crops[i], sizeof(crops[i]));
        static uint8_t seen[WIDTH * HEIGHT];
        memset(seen, 0, sizeof(seen));
        for (uint32_t tile = 0; tile < tile_count(&scene); tile++) {
            struct tile_rect rect = tile_rect(&scene, tile);
            assert_in_range(rect.width, 1, TILE_SIZE);
            assert_in_range(rect.height, 1, TILE_SIZE);
            for (uint32_t y = 0; y < rect.height; y++)
                for (uint32_t x = 0; x < rect.width; x++)
                    seen[(rect.y + y) * WIDTH + rect.x + x]++;
        }
        const uint32_t *crop = crops[i];
        for (uint32_t y = 0; y < HEIGHT; y++)
            for (uint32_t x = 0; x < WIDTH; x++)
                assert_int_equal(seen[y * WIDTH + x],
                                 x >= crop[0] && x < crop[1] && y >= crop[2] && y < crop[3]);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rounds_tile_the_leaf_axis_up_to_2_to_the_40),
        cmocka_unit_test(the_round_that_reaches_a_count_is_the_first),
        cmocka_unit_test(a_node_lies_in_a_round_or_crosses_its_end),
        cmocka_unit_test(leaves_near_2_to_the_32_and_40_are_told_apart),
        cmocka_unit_test(any_pieces_in_any_order_give_the_node_by_definition),
        cmocka_unit_test(in_order_a_fold_holds_no_more_than_its_depth),
        cmocka_unit_test(what_is_covered_or_elsewhere_is_refused),
        cmocka_unit_test(a_64_spp_job_extended_to_256_is_a_256_spp_job),
        cmocka_unit_test(ten_million_samples_do_not_stagnate),
        cmocka_unit_test(an_unfinished_counter_is_folded_smallest_node_first),
        cmocka_unit_test(counters_add_failures_join_and_the_largest_wins),
        cmocka_unit_test(a_job_takes_the_shape_its_samples_allow),
        cmocka_unit_test(filters_with_negative_lobes_get_samples_in_fours),
        cmocka_unit_test(tiles_cover_the_crop_window_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
