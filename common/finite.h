/*
 * Are all floats of an array numbers, neither infinite nor NaN? Asked of whole meshes, so the loop
 * is one that compilers make vectors of: a look at exponents, without branches. Pure.
 */
#ifndef COMMON_FINITE_H
#define COMMON_FINITE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

static inline bool finite_all(const float *values, size_t count)
{
    int32_t infinite = 0;
    for (size_t i = 0; i < count; i++) {
        int32_t bits;
        memcpy(&bits, values + i, sizeof(bits));
        infinite |= (bits & 0x7fffffff) >= 0x7f800000;
    }
    return infinite == 0;
}

#endif
