/* The bulk of a RESULT: every bit comes back, and nothing a worker sends wrong gets through. */
#include "common/err.h"
#include "proto/limits.h"
#include "proto/node_wire.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PIXELS   37 /* an odd number, so that the last word of failed bits is not full */
#define CHANNELS 5

/* Offsets in the bulk, as the header of node_wire.h has them */
#define AT_FLAGS     8
#define AT_ZERO      12
#define AT_SAMPLES   16
#define AT_NONFINITE 48
#define AT_TRUNCATED 72
#define AT_ENERGY    80
#define AT_LARGEST   88
#define AT_FAILED    92

static struct node_sums *some_sums(void)
{
    struct node_sums *sums = node_sums_new(PIXELS, CHANNELS);
    sums->stats = (struct node_stats){ .samples = 1000,
                                       .rays_closest = 5000,
                                       .rays_shadow = 4000,
                                       .events = 3000,
                                       .nonfinite = { 1, 2, 3 },
                                       .truncated_paths = 4,
                                       .truncated_energy = 0.1,
                                       .largest = 12.5f };
    for (uint32_t i = 0; i < PIXELS * CHANNELS; i++)
        sums->values[i] = ldexpf((float)(i + 1) / 3, (int)i - 100) * (i % 2 != 0 ? -1 : 1);
    sums->values[0] = -0.0f;
    sums->values[1] = INFINITY; /* a sum may overflow; what that means is for the merger to say */
    return sums;
}

static uint8_t *encoded(const struct node_sums *sums, size_t *size)
{
    *size = node_wire_size(sums);
    uint8_t *bulk = malloc(*size);
    assert_true(node_wire_encode(sums, bulk, *size));
    return bulk;
}

static void expect_same(const struct node_sums *a, const struct node_sums *b)
{
    assert_memory_equal(&a->stats.samples, &b->stats.samples,
                        offsetof(struct node_stats, largest) + sizeof(float));
    assert_memory_equal(a->failed, b->failed, sizeof(a->failed));
    assert_memory_equal(a->values, b->values, PIXELS * CHANNELS * sizeof(float));
}

static void sums_come_back_bit_for_bit(void **state)
{
    (void)state;
    for (int failed = 0; failed < 2; failed++) {
        struct node_sums *sums = some_sums();
        if (failed)
            sums->failed[1] = 1u << 4; /* the last pixel */
        size_t size;
        uint8_t *bulk = encoded(sums, &size);
        struct node_sums *back = node_wire_decode(bulk, size, PIXELS, CHANNELS, NULL);
        assert_non_null(back);
        expect_same(sums, back);
        free(bulk);
        node_sums_free(back);
        node_sums_free(sums);
    }
}

static void failed_bits_cross_only_when_there_are_any(void **state)
{
    (void)state;
    struct node_sums *sums = some_sums();
    size_t without = node_wire_size(sums);
    sums->failed[0] = 1;
    assert_int_equal(node_wire_size(sums), without + 8);
    assert_int_equal(node_wire_size(sums), node_wire_size_max(PIXELS, CHANNELS));
    assert_true(node_wire_size_max(TILE_PIXELS, LIMIT_CHANNELS) <= LIMIT_NODE_BULK);
    node_sums_free(sums);
}

static void a_buffer_of_another_size_is_not_written_as_if_it_fit(void **state)
{
    (void)state;
    struct node_sums *sums = some_sums();
    size_t size = node_wire_size(sums);
    uint8_t *bulk = malloc(size + 1);
    assert_false(node_wire_encode(sums, bulk, size - 1));
    assert_false(node_wire_encode(sums, bulk, size + 1));
    free(bulk);
    node_sums_free(sums);
}

static void put(uint8_t *bulk, size_t at, const void *value, size_t size)
{
    memcpy(bulk + at, value, size);
}

static void bad_bulks_are_refused_with_a_reason(void **state)
{
    (void)state;
    const uint32_t two = 2, big = 1u << 5, none = 0;
    const uint64_t many = 1001;
    const double nan = NAN, negative = -1, infinite = INFINITY;
    const float nan_f = NAN, negative_f = -1;
    const struct {
        const char *says;
        bool failed; /* start from sums with a failed pixel */
        long resize; /* bytes more or less */
        size_t at;
        const void *value;
        size_t size;
    } cases[] = {
        { "length", false, -1, 0, NULL, 0 },
        { "length", false, 1, 0, NULL, 0 },
        { "length", false, -4, 0, NULL, 0 },
        { "length", true, -8, 0, NULL, 0 },
        { "ends early", false, -1000000, 0, NULL, 0 },
        { "2 pixels in 5 channels where 37 in 5", false, 0, 0, &two, 4 },
        { "37 pixels in 2 channels where 37 in 5", false, 0, 4, &two, 4 },
        { "unknown flags", false, 0, AT_FLAGS, &two, 4 },
        { "unknown flags", false, 0, AT_ZERO, &two, 4 },
        { "more paths cut", false, 0, AT_TRUNCATED, &many, 8 },
        { "more samples left out", false, 0, AT_NONFINITE + 8, &many, 8 },
        { "energy", false, 0, AT_ENERGY, &nan, 8 },
        { "energy", false, 0, AT_ENERGY, &negative, 8 },
        { "energy", false, 0, AT_ENERGY, &infinite, 8 },
        { "largest", false, 0, AT_LARGEST, &nan_f, 4 },
        { "largest", false, 0, AT_LARGEST, &negative_f, 4 },
        { "outside the tile", true, 0, AT_FAILED + 4, &big, 4 },
        { "without any failed", true, 0, AT_FAILED, &none, 4 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct node_sums *sums = some_sums();
        struct err err = { 0 };
        size_t size;
        sums->failed[0] = cases[i].failed;
        uint8_t *bulk = encoded(sums, &size);
        long new_size = (long)size + cases[i].resize;
        uint8_t *bad = calloc(1, size + 16);
        memcpy(bad, bulk, size);
        if (cases[i].value != NULL)
            put(bad, cases[i].at, cases[i].value, cases[i].size);
        assert_null(
            node_wire_decode(bad, new_size < 0 ? 0 : (size_t)new_size, PIXELS, CHANNELS, &err));
        assert_int_equal(err.code, ERR_MESSAGE);
        if (strstr(err.text, cases[i].says) == NULL)
            fail_msg("case %zu: \"%s\" does not say \"%s\"", i, err.text, cases[i].says);
        free(bad);
        free(bulk);
        node_sums_free(sums);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sums_come_back_bit_for_bit),
        cmocka_unit_test(failed_bits_cross_only_when_there_are_any),
        cmocka_unit_test(a_buffer_of_another_size_is_not_written_as_if_it_fit),
        cmocka_unit_test(bad_bulks_are_refused_with_a_reason),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
