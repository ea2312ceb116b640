#include "common/sampler.h"

#include "common/err.h"
#include "common/scene.h"

#include <stddef.h>

_Static_assert(SAMPLER_SOBOL == 0, "sampler.h tests for Sobol without knowing scene.h");

/* Halton's bases, in the order of the slots below */
static const uint16_t primes[] = {
    2,   3,   5,   7,   11,  13,  17,  19,  23,  29,  31,  37,  41,  43,  47,  53,
    59,  61,  67,  71,  73,  79,  83,  89,  97,  101, 103, 107, 109, 113, 127, 131,
    137, 139, 149, 151, 157, 163, 167, 173, 179, 181, 191, 193, 197, 199, 211, 223,
    227, 229, 233, 239, 241, 251, 257, 263, 269, 271, 277, 281, 283, 293, 307,
};

#define SLOT_COUNT  (sizeof(primes) / sizeof(primes[0]))
#define EVENT_SLOTS 8

/*
 * Which base a dimension of a camera path gets: small ones where they matter most. Slots of the
 * first event it occurs in (0 for the camera's purposes, 1, the first vertex, for the others) and
 * of event 2; each later event is EVENT_SLOTS further on. One more than the slot: 0 means none.
 */
static const uint8_t slots[32][2] = {
    [SAMPLE_PIXEL] = { 1, 0 },
    [SAMPLE_LIGHT_POINT] = { 3, 16 },
    [SAMPLE_BSDF_DIRECTION] = { 5, 18 },
    [SAMPLE_LENS] = { 7, 0 },
    [SAMPLE_TIME] = { 9, 0 },
    [SAMPLE_FILTER] = { 10, 0 },
    [SAMPLE_WAVELENGTH] = { 11, 0 },
    [SAMPLE_LIGHT_PICK] = { 12, 20 },
    [SAMPLE_BSDF_LOBE] = { 13, 21 },
    [SAMPLE_ROULETTE] = { 14, 22 },
    [SAMPLE_MIX] = { 15, 23 },
};

/* The slot of a dimension's first number, or SLOT_COUNT where it has none */
static size_t dimension_slot(uint32_t dimension)
{
    uint32_t event = dimension >> 6;
    unsigned purpose = dimension & 31;
    bool of_camera = slots[purpose][1] == 0;
    if ((dimension >> 5 & 1) != SAMPLE_FROM_CAMERA || slots[purpose][0] == 0 ||
        of_camera != (event == 0))
        return SLOT_COUNT;
    size_t slot = slots[purpose][event > 1] - 1u;
    if (event > 2)
        slot += (size_t)EVENT_SLOTS * (event - 2);
    return slot + 1 < SLOT_COUNT ? slot : SLOT_COUNT; /* room for a pair */
}

/* Cut to 24 bits, so that nothing rounds up to 1 */
static float unit_float(double u)
{
    uint32_t cut = (uint32_t)(u * 0x1p24);
    return (float)(cut < 0xffffffu ? cut : 0xffffffu) * 0x1p-24f;
}

static float hash_float(uint64_t hash)
{
    return (float)(hash >> 40) * 0x1p-24f;
}

/*
 * The radical inverse with nested random digit permutations (Owen's scramble in any base).
 * `node` hashes the digits so far. A digit goes to factor * digit + shift modulo the prime base:
 * such maps take any two digits to any other two equally often, which is all that a variance can
 * see of a permutation. The endless zeros after the last digit go to a uniform tail, of which the
 * leading digit is the shift: hence zero needs no hash, and the loop ends with the index.
 */
static double radical_inverse(uint64_t node, uint32_t base, uint32_t index)
{
    uint64_t digits = 0, scale = 1; /* below 2^32 * base */
    uint32_t tail = (uint32_t)(node >> 32);
    while (index > 0) {
        uint32_t digit = index % base;
        uint64_t shifted = (uint64_t)tail * base;
        uint32_t factor = 1 + (uint32_t)(((node & 0xffffffffu) * (base - 1)) >> 32);
        digits = digits * base + (factor * digit + (uint32_t)(shifted >> 32)) % base;
        scale *= base;
        node = hash64(node, digit);
        tail = digit == 0 ? (uint32_t)shifted : (uint32_t)(node >> 32);
        index /= base;
    }
    return ((double)digits + (double)tail * 0x1p-32) / (double)scale;
}

/* A keyed permutation of [0, count), count <= 2^32: permute the next power of two until the result
 * is inside. Multiplying moves bits up, shifting moves them down; ten rounds make all pairs equally
 * likely even for three or four. */
static uint32_t permute(uint32_t x, uint64_t count, uint64_t seed)
{
    if (count < 2)
        return 0;
    unsigned bits = 64 - (unsigned)__builtin_clzll(count - 1);
    uint32_t mask = 0xffffffffu >> (32 - bits);
    do {
        uint64_t round_key = seed;
        for (int round = 0; round < 10; round++) {
            round_key = hash64_mix(round_key);
            x = (x * ((uint32_t)round_key | 1) + (uint32_t)(round_key >> 32)) & mask;
            x ^= x >> ((bits + 1) / 2);
        }
    } while (x >= count);
    return x;
}

static void independent(uint64_t node, uint32_t index, float *u, float *v)
{
    uint64_t hash = hash64(node, index);
    *u = hash_float(hash);
    *v = hash_float(hash << 24);
}

static void stratified(const struct sampler *s, uint64_t node, uint32_t index, bool pair, float *u,
                       float *v)
{
    /* Beyond the plan another set begins, with strata of its own */
    uint64_t count = s->planned_samples;
    node = hash64(node, index / count);
    uint32_t place = (uint32_t)(index % count);
    uint32_t stratum = permute(place, count, node);
    uint64_t jitter = hash64_3(node, 1, place);
    double jitter_u = hash_float(jitter), jitter_v = hash_float(jitter << 24);
    if (pair) {
        *u = unit_float((stratum % s->strata_x + jitter_u) / s->strata_x);
        *v = unit_float((stratum / s->strata_x + jitter_v) / s->strata_y);
    } else {
        *u = unit_float((stratum + jitter_u) / (double)count);
    }
}

static float halton(uint64_t node, uint32_t index, size_t slot)
{
    return unit_float(radical_inverse(hash64(node, slot), primes[slot], index));
}

/* i / N in the first slot, shifted at random; in the others Halton's bases, one slot late */
static float hammersley(const struct sampler *s, uint64_t node, uint32_t index, size_t slot)
{
    uint64_t count = s->planned_samples;
    node = hash64(node, index / count);
    uint32_t place = (uint32_t)(index % count);
    if (slot > 0)
        return halton(node, place, slot - 1);
    double shifted = place / (double)count + hash64_unit(hash64_mix(node));
    return unit_float(shifted < 1 ? shifted : shifted - 1);
}

void sampler_other(const struct sampler *s, const struct sample_key8 *key, const u8 *dimension,
                   f8 *u, f8 *v)
{
    f8 first = F8(0), second = F8(0);
    for (int lane = 0; lane < LANES; lane++) {
        uint32_t dim = (*dimension)[lane];
        uint32_t index = sampler_reverse32(key->reversed[lane]);
        uint64_t node = hash64((uint64_t)key->hi[lane] << 32 | key->lo[lane], dim);
        size_t slot = dimension_slot(dim);
        float a = 0, b = 0;
        if (s->kind == SAMPLER_STRATIFIED) {
            stratified(s, node, index, v != NULL, &a, &b);
        } else if (s->kind == SAMPLER_HALTON && slot < SLOT_COUNT) {
            a = halton(node, index, slot);
            b = v ? halton(node, index, slot + 1) : 0;
        } else if (s->kind == SAMPLER_HAMMERSLEY && slot < SLOT_COUNT) {
            a = hammersley(s, node, index, slot);
            b = v ? hammersley(s, node, index, slot + 1) : 0;
        } else {
            independent(node, index, &a, &b); /* also dimensions beyond Halton's bases */
        }
        first[lane] = a;
        second[lane] = b;
    }
    *u = first;
    if (v)
        *v = second;
}

bool sampler_needs_plan(unsigned kind)
{
    return kind == SAMPLER_STRATIFIED || kind == SAMPLER_HAMMERSLEY;
}

bool sampler_init(struct sampler *s, unsigned kind, uint64_t planned_samples, struct err *err)
{
    static const char *const names[] = {
#define X(name, number, text) [number] = text,
        SAMPLER_MAP(X)
#undef X
    };
    if (kind >= SAMPLER_COUNT)
        return err_set(err, ERR_ARGUMENT, "no sampler has the number %u", kind);
    *s = (struct sampler){ .kind = kind, .strata_x = 1, .strata_y = 1 };
    if (!sampler_needs_plan(kind))
        return true;

    if (planned_samples == 0)
        return err_set(err, ERR_ARGUMENT, "sampler %s needs the number of samples in advance",
                       names[kind]);
    if (planned_samples > (uint64_t)1 << 32)
        return err_set(err, ERR_ARGUMENT, "sampler %s takes at most 2^32 samples per pixel",
                       names[kind]);

    /* The largest divisor up to the square root */
    uint64_t x = 1;
    for (uint64_t d = 1; d * d <= planned_samples; d++)
        if (planned_samples % d == 0)
            x = d;
    s->planned_samples = planned_samples;
    s->strata_x = (uint32_t)x;
    s->strata_y = (uint32_t)(planned_samples / x);
    return true;
}
