/*
 * Counter-based hashing: a random-looking number is a function of what it is for, never of what was
 * drawn before it. No state, no order, any thread; integer arithmetic only, so the same bits
 * everywhere. Not for defence against an adversary (that is what SHA-256 is for).
 */
#ifndef COMMON_HASH_H
#define COMMON_HASH_H

#include "common/lane.h"

#include <stdint.h>

/* A bijection of 64-bit words in which every input bit moves every output bit (Stafford's mix 13,
 * after an odd offset: 0 does not stay 0). */
LANE_FN uint64_t hash64_mix(uint64_t x)
{
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/* Order counts: hash64(a, b) is not hash64(b, a). A bijection of either word, the other fixed. */
LANE_FN uint64_t hash64(uint64_t a, uint64_t b)
{
    return hash64_mix(hash64_mix(a) ^ b);
}

LANE_FN uint64_t hash64_3(uint64_t a, uint64_t b, uint64_t c)
{
    return hash64_mix(hash64(a, b) ^ c);
}

LANE_FN uint64_t hash64_4(uint64_t a, uint64_t b, uint64_t c, uint64_t d)
{
    return hash64_mix(hash64_3(a, b, c) ^ d);
}

/* A bijection of 32-bit words (Wellons' lowbias32 constants) */
LANE_FN uint32_t hash32_mix(uint32_t x)
{
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

/* hash32_mix of every lane */
LANE_FN u8 u8_hash(u8 x)
{
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

/* A hash as a number in [0, 1): 2^24 equally likely values, never 1 */
LANE_FN f8 f8_from_hash(u8 x)
{
    return f8_from_i8((i8)(x >> 8)) * 0x1p-24f;
}

/* The same of the high bits of a 64-bit hash, with 53 bits */
LANE_FN double hash64_unit(uint64_t x)
{
    return (double)(x >> 11) * 0x1p-53;
}

#endif
