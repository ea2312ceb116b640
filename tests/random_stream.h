/*
 * Random numbers for tests: a stream is a 64-bit state that begins anywhere, so that a fixed seed
 * gives the same numbers everywhere.
 */
#ifndef TESTS_RANDOM_STREAM_H
#define TESTS_RANDOM_STREAM_H

#include "common/elem.h"

#include <math.h>
#include <stdint.h>

static inline uint64_t random_hash(uint64_t x)
{
    x = (x ^ x >> 32) * 0xd6e8feb86659fd93u;
    x = (x ^ x >> 32) * 0xd6e8feb86659fd93u;
    return x ^ x >> 32;
}

/* In (0, 1) */
static inline double random_uniform(uint64_t *state)
{
    *state += 0x9e3779b97f4a7c15u;
    return ((double)(random_hash(*state) >> 11) + 0.5) * 0x1p-53;
}

/* Of mean 0 and variance 1 */
static inline double random_normal(uint64_t *state)
{
    double radius = sqrt(-2 * elem_log(random_uniform(state)));
    return radius * elem_cos(2 * 3.14159265358979323846 * random_uniform(state));
}

#endif
