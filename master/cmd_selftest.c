#include "master/cmd_selftest.h"

#include "common/elem.h"
#include "common/err.h"
#include "common/hash.h"
#include "common/sampler.h"
#include "common/scene.h"
#include "common/sumtree.h"
#include "proto/digest.h"

#include <getopt.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A check says what it found; the text is for the line that is printed. */
typedef bool (*check_fn)(char *text, size_t capacity);

/* Compare the first 8 bytes of a digest with what every machine should find. */
static bool expect_digest(struct digest_stream *stream, const char *want, char *text,
                          size_t capacity)
{
    struct digest digest = digest_end(stream);
    char hex[DIGEST_HEX_SIZE];
    digest_hex(&digest, hex);
    hex[16] = '\0';
    bool same = strcmp(hex, want) == 0;
    snprintf(text, capacity, same ? "%s" : "%s, should be %s", hex, want);
    return same;
}

/* Evenly spread over [low, high); a function of i alone. */
static double spread(uint64_t i, double low, double high)
{
    return low + (high - low) * hash64_unit(hash64_mix(i));
}

/* What the compiler and the floating-point unit must not do to us. */
static bool check_arithmetic(char *text, size_t capacity)
{
    volatile double one_and_a_bit = 1 + 0x1p-52, third = 3, zero = 0;
    volatile float large = 0x1p24f, one = 1, half = 0.5f;
    const char *wrong = NULL;
    double square = one_and_a_bit * one_and_a_bit;
    if (one_and_a_bit * one_and_a_bit - square != 0)
        wrong = "products are fused into sums";
    else if (large + one != large || large + one + one != large || large + (one + one) == large)
        wrong = "sums are reordered or kept in excess precision";
    else if (large + half + half != large)
        wrong = "rounding is not to nearest";
    else if (1 / third * third != 1 || 1 / third == 0x1.5555555555556p-2)
        wrong = "division is not IEEE division";
    else if (!(zero / zero != zero / zero))
        wrong = "NaN is not unordered";
    snprintf(text, capacity, "%s", wrong != NULL ? wrong : "IEEE, nearest, nothing fused");
    return wrong == NULL;
}

static bool check_functions(char *text, size_t capacity)
{
    struct digest_stream *stream = digest_begin();
    for (uint64_t i = 0; i < 4096; i++) {
        const double angle = spread(7 * i, -1000, 1000), wide = spread(7 * i + 1, -50, 50);
        const double positive = spread(7 * i + 2, 1e-9, 100), unit = spread(7 * i + 3, -1, 1);
        const double results[] = {
            elem_sin(angle),
            elem_cos(angle),
            elem_exp(wide),
            elem_log(positive),
            elem_pow(positive, spread(7 * i + 4, -5, 5)),
            elem_atan2(wide, angle),
            elem_acos(unit),
            elem_asin(unit),
            elem_erf(wide / 10),
            elem_erfinv(unit),
        };
        digest_add(stream, results, sizeof(results));

        f8 a, b, s, c;
        for (int lane = 0; lane < LANES; lane++) {
            a[lane] = (float)spread(8 * i + (uint64_t)lane, -1, 1);
            b[lane] = (float)spread(~(8 * i + (uint64_t)lane), 1e-3, 20);
        }
        f8_sincos(b, &s, &c);
        const f8 lanes[] = { s,          c,          f8_exp(a * 20), f8_log(b), f8_pow(b, a * 3),
                             f8_acos(a), f8_asin(a), f8_atan2(a, b) };
        digest_add(stream, lanes, sizeof(lanes));
    }
    return expect_digest(stream, "0fc6c643a82c75bf", text, capacity);
}

static bool check_samplers(char *text, size_t capacity)
{
    struct digest_stream *stream = digest_begin();
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler sampler;
        struct err err = { 0 };
        if (!sampler_init(&sampler, kind, 64, &err)) {
            digest_end(stream);
            snprintf(text, capacity, "%s", err.text);
            return false;
        }
        for (uint64_t i = 0; i < 512; i++) {
            struct sample_key8 key = { 0 };
            for (int lane = 0; lane < LANES; lane++)
                sampler_key_lane(&key, lane, 7, (uint32_t)(i % 4), 1000 + i / 16,
                                 8 * i + (uint64_t)lane);
            f8 u, v;
            sampler_2d(&sampler, 1, &key, sample_dimension(0, U8((uint32_t)i % 9), SAMPLE_LENS), &u,
                       &v);
            f8 w = sampler_1d(&sampler, 1, &key,
                              sample_dimension(0, U8((uint32_t)i % 9), SAMPLE_ROULETTE));
            digest_add(stream, &u, sizeof(u));
            digest_add(stream, &v, sizeof(v));
            digest_add(stream, &w, sizeof(w));
        }
    }
    return expect_digest(stream, "0521bfbac996833c", text, capacity);
}

/* Leaf `leaf` of a made-up tile: numbers of very different sizes, so that order would show. */
static struct node_sums *made_up_leaf(uint64_t leaf)
{
    struct node_sums *sums = node_sums_new(64, 3);
    if (sums == NULL)
        return NULL;
    for (uint32_t i = 0; i < 64 * 3; i++)
        sums->values[i] = (float)elem_exp(spread(hash64(leaf, i), -10, 10));
    sums->stats.samples = 64;
    return sums;
}

/* A node of 64 leaves, its leaves coming in an order of their own; NULL without memory. */
static struct node_sums *fold_in_order(uint64_t stride)
{
    struct fold *fold = fold_new(6, 3);
    struct node_sums *total = NULL;
    if (fold == NULL)
        return NULL;
    for (uint64_t i = 0; i < 64; i++) {
        uint64_t leaf = 3 * 64 + i * stride % 64;
        struct node_sums *sums = made_up_leaf(leaf);
        if (sums == NULL || fold_add(fold, 0, leaf, sums) != FOLD_ADDED) {
            node_sums_free(sums);
            goto done;
        }
    }
    total = fold_take(fold);
done:
    fold_free(fold);
    return total;
}

static bool check_sum_tree(char *text, size_t capacity)
{
    struct node_sums *straight = fold_in_order(1), *shuffled = fold_in_order(37);
    bool same = false;
    if (straight == NULL || shuffled == NULL) {
        snprintf(text, capacity, "out of memory");
    } else if (memcmp(straight->values, shuffled->values, 64 * 3 * sizeof(float)) != 0) {
        snprintf(text, capacity, "the order of arrival changes the sums");
    } else {
        struct digest_stream *stream = digest_begin();
        digest_add(stream, straight->values, 64 * 3 * sizeof(float));
        same = expect_digest(stream, "6efd8a264c6cdadc", text, capacity);
    }
    node_sums_free(straight);
    node_sums_free(shuffled);
    return same;
}

/* FIPS 180-2's first example */
static bool check_digest(char *text, size_t capacity)
{
    struct digest_stream *stream = digest_begin();
    digest_add(stream, "abc", 3);
    return expect_digest(stream, "ba7816bf8f01cfea", text, capacity);
}

int cmd_selftest(int argc, char **argv)
{
    static const struct option known[] = { { "help", no_argument, NULL, 'h' }, { 0 } };
    static const struct {
        const char *name;
        check_fn run;
    } checks[] = {
        { "arithmetic", check_arithmetic },
        { "digest", check_digest },
        { "elementary functions", check_functions },
        { "samplers", check_samplers },
        { "sum tree", check_sum_tree },
    };
    optind = 1;
    for (int option; (option = getopt_long(argc, argv, "h", known, NULL)) != -1;) {
        FILE *out = option == 'h' ? stdout : stderr;
        fputs("Usage: pathfarm selftest\n"
              "\n"
              "Checks that this machine computes the bits that every other one does. Exit status:\n"
              "0 when it does, 1 when not, with the check that failed.\n",
              out);
        return option == 'h' ? 0 : 2;
    }
    if (argc != optind) {
        fprintf(stderr, "pathfarm selftest: takes no arguments\n");
        return 2;
    }

    unsigned failures = 0;
    for (size_t i = 0; i < sizeof(checks) / sizeof(checks[0]); i++) {
        char text[256];
        bool fine = checks[i].run(text, sizeof(text));
        failures += !fine;
        fprintf(fine ? stdout : stderr, "%-22s %s: %s\n", checks[i].name, fine ? "fine" : "FAILED",
                text);
    }
    return failures == 0 ? 0 : 1;
}
