/*
 * Samples as pure functions: the number a path uses depends on (seed, replicate, pixel, sample
 * index, subpath, event, purpose) and on nothing else, so that a leaf has the same bits wherever
 * and in whatever order it is rendered, and removing an effect never shifts another's numbers.
 *
 * Three steps, from once per job to once per number:
 *   struct sampler       which point set, and what it needs to know of the job
 *   struct sample_key8   eight camera paths; made per path by sampler_key_lane
 *   sampler_2d, _1d      the numbers of one dimension, for all eight lanes
 *
 * A dimension is numbered by sample_dimension. It is a pair of numbers (sampler_2d) or one
 * (sampler_1d); use a purpose in one of the two ways. There is no last dimension.
 *
 * Every point set is randomised by the whole 64-bit key, so pixels and replicates are independent
 * of each other, and so are (but for halton and hammersley) dimensions. Numbers are multiples of
 * 2^-24 in [0, 1 - 2^-24]: never 1, so floor(u * n) < n for n up to 1e5.
 *
 * No function here allocates, locks or fails, but for sampler_init. A struct sampler is read-only
 * after sampler_init and shared by all threads.
 */
#ifndef COMMON_SAMPLER_H
#define COMMON_SAMPLER_H

#include "common/hash.h"
#include "common/lane.h"

#include <stdbool.h>
#include <stdint.h>

struct err;

struct sampler {
    uint32_t kind;     /* enum sampler_kind of common/scene.h */
    uint32_t strata_x; /* stratified: the near-square factors of planned_samples */
    uint32_t strata_y;
    uint32_t reserved;
    uint64_t planned_samples; /* per pixel of one replicate; 0 where the sampler needs none */
};

/*
 * stratified and hammersley need the number of samples per pixel of one replicate and are refused
 * (ERR_ARGUMENT) without it or with more than 2^32; the others take and ignore 0. Samples beyond
 * the plan start an independent set of the same size. Also refuses an unknown kind.
 */
bool sampler_init(struct sampler *s, unsigned kind, uint64_t planned_samples, struct err *err);

/* Whether this kind's point set depends on the number of samples (no --time, no extension). */
bool sampler_needs_plan(unsigned kind);

/* What a number is for. Part of the identity of every image: append, never renumber. Below 32. */
enum sample_purpose {
    SAMPLE_PIXEL = 0,           /* 2-D: the place in the pixel, or the filter's sample */
    SAMPLE_LENS = 1,            /* 2-D */
    SAMPLE_TIME = 2,            /* 1-D */
    SAMPLE_FILTER = 3,          /* 1-D: which lobe of a filter */
    SAMPLE_WAVELENGTH = 4,      /* 1-D */
    SAMPLE_LIGHT_PICK = 5,      /* 1-D: which light */
    SAMPLE_LIGHT_POINT = 6,     /* 2-D: where on it */
    SAMPLE_BSDF_LOBE = 7,       /* 1-D */
    SAMPLE_BSDF_DIRECTION = 8,  /* 2-D */
    SAMPLE_ROULETTE = 9,        /* 1-D */
    SAMPLE_MIX = 10,            /* 1-D: which material of a mix */
    SAMPLE_ALPHA = 11,          /* 1-D */
    SAMPLE_DISTANCE = 12,       /* 2-D: colour, and free flight in a medium */
    SAMPLE_PHASE = 13,          /* 2-D: direction from a phase function */
    SAMPLE_EMIT_POINT = 14,     /* 2-D: start of a light subpath */
    SAMPLE_EMIT_DIRECTION = 15, /* 2-D */
};

enum sample_subpath { SAMPLE_FROM_CAMERA = 0, SAMPLE_FROM_LIGHT = 1 };

/*
 * The number of a dimension: injective for purposes below 32 and events below 2^26. Event 0 is the
 * camera (or the light a subpath starts on), 1 the first vertex: halton and hammersley give their
 * small bases by that.
 */
LANE_FN u8 sample_dimension(unsigned subpath, u8 event, unsigned purpose)
{
    return (event << 6) | (uint32_t)(subpath << 5 | purpose);
}

/* Eight camera paths, one per lane. Copy and select lanes freely; look inside only here. */
struct sample_key8 {
    u8 lo, hi;   /* the 64-bit key of (seed, replicate, pixel, index >> 32) */
    u8 reversed; /* low 32 bits of the sample index, lowest bit first: as the Sobol code wants it */
};

LANE_FN uint32_t sampler_reverse32(uint32_t x)
{
    x = __builtin_bswap32(x);
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
}

/*
 * The key of one pixel's samples with the same index >> 32. No two pixels below 2^40 of the
 * replicates below 2^24 share one: it is a bijection of the packed word. Keys of different seeds or
 * different index >> 32 meet as rarely as random 64-bit words do.
 */
LANE_FN uint64_t sampler_key(uint64_t seed, uint32_t replicate, uint64_t pixel, uint32_t index_high)
{
    uint64_t packed = pixel ^ ((uint64_t)replicate << 40 | replicate >> 24);
    return hash64(packed, hash64(seed, index_high));
}

/* Start the camera path of sample `index` of `pixel` (its number in the full image: y * width + x)
 * in `lane`; other lanes stay as they are. */
LANE_FN void sampler_key_lane(struct sample_key8 *key, int lane, uint64_t seed, uint32_t replicate,
                              uint64_t pixel, uint64_t index)
{
    uint64_t word = sampler_key(seed, replicate, pixel, (uint32_t)(index >> 32));
    key->lo[lane] = (uint32_t)word;
    key->hi[lane] = (uint32_t)(word >> 32);
    key->reversed[lane] = sampler_reverse32((uint32_t)index);
}

/* Lanes of a where the mask is set, of b elsewhere */
LANE_FN struct sample_key8 sampler_key_select(i8 mask, struct sample_key8 a, struct sample_key8 b)
{
    return (struct sample_key8){ u8_select(mask, a.lo, b.lo), u8_select(mask, a.hi, b.hi),
                                 u8_select(mask, a.reversed, b.reversed) };
}

/*
 * The numbers of one dimension. `any` is a compile-time constant: 0 where the job is known to use
 * the Sobol sampler (then `s` is not read and may be NULL), 1 elsewhere.
 */
LANE_FN void sampler_2d(const struct sampler *s, int any, const struct sample_key8 *key,
                        u8 dimension, f8 *u, f8 *v);
LANE_FN f8 sampler_1d(const struct sampler *s, int any, const struct sample_key8 *key,
                      u8 dimension);

/* --- What follows is how ------------------------------------------------------------------ */

/* The four other point sets, lane by lane. Vectors go by address: callers are compiled for another
 * instruction set, whose calling convention differs. v may be NULL: then a 1-D number is made. */
void sampler_other(const struct sampler *s, const struct sample_key8 *key, const u8 *dimension,
                   f8 *u, f8 *v);

LANE_FN u8 sampler_reverse(u8 x)
{
#if defined(__AVX2__)
    /* Reverse the bytes, then the bits of each by two tables of nibbles */
    const __m256i bytes = _mm256_setr_epi8(3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12, 3,
                                           2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12);
    const __m256i high = _mm256_setr_epi8(0x00, -0x80, 0x40, -0x40, 0x20, -0x60, 0x60, -0x20, 0x10,
                                          -0x70, 0x50, -0x30, 0x30, -0x50, 0x70, -0x10, 0x00, -0x80,
                                          0x40, -0x40, 0x20, -0x60, 0x60, -0x20, 0x10, -0x70, 0x50,
                                          -0x30, 0x30, -0x50, 0x70, -0x10);
    const __m256i low = _mm256_setr_epi8(0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15, 0, 8,
                                         4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15);
    const __m256i nibble = _mm256_set1_epi8(0x0f);
    __m256i b = _mm256_shuffle_epi8((__m256i)x, bytes);
    __m256i from_low = _mm256_shuffle_epi8(high, _mm256_and_si256(b, nibble));
    __m256i from_high = _mm256_shuffle_epi8(low, _mm256_and_si256(_mm256_srli_epi32(b, 4), nibble));
    return (u8)_mm256_or_si256(from_low, from_high);
#else
    x = (x >> 16) | (x << 16);
    x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
#endif
}

/*
 * Owen's nested uniform scramble of a binary fraction whose first digit is the lowest bit: every
 * step moves bits only upwards, so a digit is flipped by a hash of the digits before it (Laine and
 * Karras 2011; constants by N. Vegdahl). `seed` must be well mixed in all its bits.
 */
LANE_FN u8 sampler_scramble(u8 x, u8 seed)
{
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16) | 1;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

/* The second Sobol dimension, first digit lowest: digit j is the sum of the index digits k that
 * have all bits of j set (Pascal's triangle mod 2). */
LANE_FN u8 sampler_pascal(u8 index)
{
    u8 y = index;
    y ^= y >> 16;
    y ^= (y >> 8) & 0x00ff00ffu;
    y ^= (y >> 4) & 0x0f0f0f0fu;
    y ^= (y >> 2) & 0x33333333u;
    y ^= (y >> 1) & 0x55555555u;
    return y;
}

/*
 * Padded Owen-scrambled Sobol: each dimension shuffles the sample index by a nested scramble (so
 * aligned blocks of 2^m samples stay such blocks) and scrambles the digits of both Sobol numbers.
 * Both words of the key enter all three seeds: pixels that share one word share nothing.
 */
struct sampler_seeds {
    u8 order, u, v;
};

LANE_FN struct sampler_seeds sampler_seeds(const struct sample_key8 *key, u8 dimension)
{
    u8 a = u8_hash(key->lo ^ dimension * 0x9e3779b9u);
    u8 b = u8_hash(a ^ key->hi);
    u8 c = b * 0x2c1b3c6du;
    return (struct sampler_seeds){ a + key->hi, b, c ^ (c >> 16) };
}

LANE_FN void sampler_sobol_2d(const struct sample_key8 *key, u8 dimension, f8 *u, f8 *v)
{
    struct sampler_seeds seed = sampler_seeds(key, dimension);
    u8 index = sampler_reverse(sampler_scramble(key->reversed, seed.order));
    *u = f8_from_hash(sampler_reverse(sampler_scramble(index, seed.u)));
    *v = f8_from_hash(sampler_reverse(sampler_scramble(sampler_pascal(index), seed.v)));
}

LANE_FN f8 sampler_sobol_1d(const struct sample_key8 *key, u8 dimension)
{
    struct sampler_seeds seed = sampler_seeds(key, dimension);
    u8 index = sampler_reverse(sampler_scramble(key->reversed, seed.order));
    return f8_from_hash(sampler_reverse(sampler_scramble(index, seed.u)));
}

LANE_FN void sampler_2d(const struct sampler *s, int any, const struct sample_key8 *key,
                        u8 dimension, f8 *u, f8 *v)
{
    if (any && s->kind != 0) /* SAMPLER_SOBOL */
        sampler_other(s, key, &dimension, u, v);
    else
        sampler_sobol_2d(key, dimension, u, v);
}

LANE_FN f8 sampler_1d(const struct sampler *s, int any, const struct sample_key8 *key, u8 dimension)
{
    if (!any || s->kind == 0) /* SAMPLER_SOBOL */
        return sampler_sobol_1d(key, dimension);
    f8 u;
    sampler_other(s, key, &dimension, &u, NULL);
    return u;
}

#endif
