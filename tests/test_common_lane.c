/* Goal: lane operations are the scalar IEEE operations, whatever the mates, the compiler and the
 * instruction set. The last test holds a digest of every function that image bits are made of:
 * all builds must reproduce it, with and without AVX2. */
#include "common/elem.h"
#include "common/hash.h"
#include "common/lane.h"
#include "common/sampler.h"
#include "common/scene.h"
#include "common/stats.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TRIES 20000

static uint32_t random_word(uint64_t i)
{
    return (uint32_t)hash64(0x6c616e65, i);
}

/* Any bit pattern, with the interesting ones often: zeros, infinities, NaN, subnormals, halves */
static float random_float(uint64_t i)
{
    static const float odd[] = { 0.0f,   -0.0f,   INFINITY, -INFINITY, NAN,  1,
                                 -1,     0.5f,    -0.5f,    1.5f,      2.5f, -2.5f,
                                 1e-40f, -1e-40f, 3.4e38f,  0x1p-126f };
    uint32_t bits = random_word(2 * i);
    uint32_t kind = random_word(2 * i + 1);
    if (kind % 4 == 0)
        return odd[kind / 4 % 16];
    if (kind % 4 == 1)
        return (float)(int32_t)bits * 0x1p-12f;
    float x;
    memcpy(&x, &bits, sizeof(x));
    return x;
}

static f8 random_floats(uint64_t i)
{
    f8 x;
    for (int lane = 0; lane < LANES; lane++)
        x[lane] = random_float(LANES * i + (uint64_t)lane);
    return x;
}

static u8 random_words(uint64_t i)
{
    u8 x;
    for (int lane = 0; lane < LANES; lane++)
        x[lane] = random_word(LANES * i + (uint64_t)lane);
    return x;
}

static uint32_t float_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof(bits));
    return isnan(x) ? 0x7fc00000u : bits; /* a NaN's sign and payload are nobody's business */
}

#define EXPECT_LANES(vector, scalar)                                      \
    do {                                                                  \
        f8 vector_ = (vector);                                            \
        for (int l = 0; l < LANES; l++)                                   \
            assert_int_equal(float_bits(vector_[l]), float_bits(scalar)); \
    } while (0)

static void float_lanes_are_scalar_floats(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < TRIES; i++) {
        f8 a = random_floats(3 * i), b = random_floats(3 * i + 1), c = random_floats(3 * i + 2);
        EXPECT_LANES(a + b, a[l] + b[l]);
        EXPECT_LANES(a - b, a[l] - b[l]);
        EXPECT_LANES(a * b, a[l] * b[l]);
        EXPECT_LANES(a / b, a[l] / b[l]);
        EXPECT_LANES(a * b + c, (float)(a[l] * b[l]) + c[l]);
        EXPECT_LANES(f8_sqrt(a), sqrtf(a[l]));
        EXPECT_LANES(f8_min(a, b), a[l] < b[l] ? a[l] : b[l]);
        EXPECT_LANES(f8_max(a, b), a[l] > b[l] ? a[l] : b[l]);
        EXPECT_LANES(f8_abs(a), fabsf(a[l]));
        EXPECT_LANES(f8_copysign(a, b), copysignf(a[l], b[l]));
        EXPECT_LANES(f8_mulsign(a, b), signbit(b[l]) ? -a[l] : a[l]);
        EXPECT_LANES(f8_select(a < b, a, c), a[l] < b[l] ? a[l] : c[l]);
        f8 small = f8_select(f8_abs(a) < 0x1p22f, a, F8(0.5f));
        EXPECT_LANES(f8_round(small), nearbyintf(small[l]) + 0.0f);
        EXPECT_LANES(f8_from_i8(i8_from_f8(small)), (float)(int32_t)small[l]);
        EXPECT_LANES(f8_from_i8((i8)a), (float)((i8)a)[l]);
    }
}

static void masks_and_bits_agree(void **state)
{
    (void)state;
    for (unsigned bits = 0; bits < 256; bits++) {
        i8 mask = i8_from_bits(bits);
        assert_int_equal(i8_bits(mask), bits);
        assert_int_equal(i8_any(mask), bits != 0);
        u8 a = random_words(2 * bits), b = random_words(2 * bits + 1);
        u8 chosen = u8_select(mask, a, b);
        i8 same = i8_select(mask, (i8)a, (i8)b);
        for (int lane = 0; lane < LANES; lane++) {
            assert_int_equal(mask[lane], bits >> lane & 1 ? -1 : 0);
            assert_int_equal(chosen[lane], bits >> lane & 1 ? a[lane] : b[lane]);
            assert_int_equal((uint32_t)same[lane], chosen[lane]);
        }
    }
}

static void integer_lanes_are_scalar_integers(void **state)
{
    (void)state;
    float table[256];
    for (int i = 0; i < 256; i++)
        table[i] = random_float((uint64_t)i);
    for (uint64_t i = 0; i < TRIES; i++) {
        u8 a = random_words(2 * i), b = random_words(2 * i + 1);
        u8 product = a * b, shifted = a >> (b & 31u), hashed = u8_hash(a);
        u8 reversed = sampler_reverse(a);
        i8 arithmetic = (i8)a >> 7;
        f8 gathered = f8_gather(table, (i8)(b & 255u));
        f8 unit = f8_from_hash(a), stored;
        i8 words = i8_gather(table, (i8)(b & 255u)), from = (i8)(b & 7u);
        u8 permuted = u8_permute(a, from);
        f8 permuted_floats = f8_permute(gathered, from);
        f8_store(&stored, gathered);
        stored = f8_load(&stored);
        for (int l = 0; l < LANES; l++) {
            assert_int_equal(product[l], a[l] * b[l]);
            assert_int_equal(permuted[l], a[b[l] & 7]);
            assert_int_equal(float_bits(permuted_floats[l]), float_bits(gathered[b[l] & 7]));
            assert_int_equal(shifted[l], a[l] >> (b[l] & 31));
            assert_int_equal(arithmetic[l], (int32_t)a[l] >> 7);
            assert_int_equal(hashed[l], hash32_mix(a[l]));
            assert_int_equal(reversed[l], sampler_reverse32(a[l]));
            assert_int_equal(float_bits(gathered[l]), float_bits(table[b[l] & 255]));
            int32_t word;
            memcpy(&word, &table[b[l] & 255], sizeof(word));
            assert_int_equal(words[l], word);
            assert_int_equal(float_bits(stored[l]), float_bits(gathered[l]));
            assert_true(unit[l] == (float)(a[l] >> 8) * 0x1p-24f);
        }
    }
    for (int bit = 0; bit < 32; bit++) /* reversal itself, bit by bit */
        assert_int_equal(sampler_reverse32(1u << bit), 1u << (31 - bit));
}

/* --- the digest ---------------------------------------------------------------------------- */

struct digest {
    uint64_t word;
};

static void digest_f8(struct digest *d, f8 x)
{
    for (int lane = 0; lane < LANES; lane++)
        d->word = hash64(d->word, float_bits(x[lane]));
}

static void digest_double(struct digest *d, double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof(bits));
    d->word = hash64(d->word, isnan(x) ? 0x7ff8000000000000u : bits);
}

/* All lane functions at these eight points */
static void digest_lane_functions(struct digest *d, f8 x, f8 y)
{
    f8 s, c;
    f8 magnitude = f8_min(F8(1e20f), f8_abs(x)); /* of a NaN: NaN */
    f8 fraction = f8_from_hash((u8)x);
    f8_sincos_turns(fraction, &s, &c);
    digest_f8(d, s);
    digest_f8(d, c);
    f8_sincos(f8_clamp(x, -12000, 12000), &s, &c);
    digest_f8(d, s);
    digest_f8(d, c);
    digest_f8(d, f8_exp(x));
    digest_f8(d, f8_log(x));
    digest_f8(d, f8_pow(x, y));
    digest_f8(d, f8_pow(fraction, y));
    digest_f8(d, f8_acos(x));
    digest_f8(d, f8_asin(2 * fraction - 1));
    digest_f8(d, f8_atan(x));
    digest_f8(d, f8_atan2(magnitude, f8_clamp(y, -1e20f, 1e20f)));

    struct vec3x8 a = { s, c, fraction }, b = { fraction, s * c, c };
    struct vec3x8 n = vec3x8_unit(vec3x8_cross(a, b));
    digest_f8(d, n.x);
    digest_f8(d, vec3x8_dot(n, b) + vec3x8_max(a) + vec3x8_luminance(b));
}

static void digest_scalar_functions(struct digest *d, double x, double y)
{
    static double (*const functions[])(double) = {
        elem_sin,  elem_cos,  elem_tan,  elem_exp, elem_log,
        elem_atan, elem_acos, elem_asin, elem_erf, elem_erfinv,
    };
    for (size_t i = 0; i < sizeof(functions) / sizeof(functions[0]); i++) {
        digest_double(d, functions[i](x));
        digest_double(d, functions[i](y));
    }
    digest_double(d, elem_pow(fabs(x), y));
    digest_double(d, elem_atan2(y, x));
}

static void digest_samples(struct digest *d, uint64_t i)
{
    static const uint64_t highs[] = { 0, 1, (uint64_t)1 << 32, (uint64_t)1 << 40 };
    struct sample_key8 key = { 0 };
    for (int lane = 0; lane < LANES; lane++)
        sampler_key_lane(&key, lane, i, (uint32_t)i & 3, random_word(i) + (uint64_t)lane,
                         highs[i & 3] + i / 4);
    for (unsigned kind = 0; kind < SAMPLER_COUNT; kind++) {
        struct sampler s;
        f8 u, v;
        assert_true(sampler_init(&s, kind, 1 + i % 300, NULL));
        u8 dimension = sample_dimension(SAMPLE_FROM_CAMERA, random_words(i) & 7u, i % 16);
        sampler_2d(&s, 1, &key, dimension, &u, &v);
        digest_f8(d, u);
        digest_f8(d, v);
        digest_f8(d, sampler_1d(&s, 1, &key, dimension));
    }
}

static void every_build_computes_the_same_bits(void **state)
{
    (void)state;
    struct digest lanes = { 0 }, scalars = { 0 }, samples = { 0 };
    for (uint64_t i = 0; i < TRIES; i++) {
        digest_lane_functions(&lanes, random_floats(2 * i), random_floats(2 * i + 1));
        digest_scalar_functions(&scalars, ldexp(random_float(2 * i) * 0x1p-100f, 100),
                                hash64_unit(hash64(1, i)) * 3 - 1);
    }
    for (uint64_t i = 0; i < TRIES / 8; i++)
        digest_samples(&samples, i);
    for (int i = 1; i < 200; i++) {
        digest_double(&scalars, stats_chi_square_survival(i, 20));
        digest_double(&scalars, stats_student_quantile(i / 200.0, 3));
        digest_double(&scalars, stats_normal_quantile(i / 200.0));
    }

    /* What these functions computed when they were written. A change here is a change of every
     * image: it needs a new numeric profile. */
    assert_int_equal(lanes.word, 0x29fd1645667ad150u);
    assert_int_equal(scalars.word, 0x6c24efd25673018fu);
    assert_int_equal(samples.word, 0xf6b11cca69c5579au);
}

static void a_lane_does_not_see_its_mates(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < TRIES / 8; i++) {
        f8 x = random_floats(2 * i), y = random_floats(2 * i + 1);
        int lane = (int)(i % LANES);
        struct digest alone = { 0 }, mixed = { 0 };
        f8 other_x = F8(x[lane]), other_y = F8(y[lane]);
        f8 mates[] = { f8_pow(x, y), f8_exp(x), f8_log(x), f8_acos(x), f8_atan2(x, y) };
        f8 copies[] = { f8_pow(other_x, other_y), f8_exp(other_x), f8_log(other_x),
                        f8_acos(other_x), f8_atan2(other_x, other_y) };
        for (int f = 0; f < 5; f++) {
            digest_f8(&mixed, F8(mates[f][lane]));
            digest_f8(&alone, F8(copies[f][(lane + 3) % LANES]));
        }
        assert_int_equal(alone.word, mixed.word);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(float_lanes_are_scalar_floats),
        cmocka_unit_test(masks_and_bits_agree),
        cmocka_unit_test(integer_lanes_are_scalar_integers),
        cmocka_unit_test(a_lane_does_not_see_its_mates),
        cmocka_unit_test(every_build_computes_the_same_bits),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
