/*
 * Eight lanes: f8, i8, u8 are vectors of eight floats, signed and unsigned 32-bit integers, one
 * path per lane. Plain C operators work elementwise (GCC and Clang vector extensions); a comparison
 * gives an i8 mask of 0 and -1. Where the translation unit is compiled with AVX2 these are single
 * instructions, elsewhere the compiler makes two halves of them: the same IEEE operations, so the
 * same bits. Lane arithmetic never mixes lanes: a lane's bits do not depend on its mates.
 *
 * Everything here is always inlined and pure.
 */
#ifndef COMMON_LANE_H
#define COMMON_LANE_H

#include <stdint.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define LANES 8

typedef float f8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
typedef uint32_t u8 __attribute__((vector_size(32)));

#define LANE_FN static inline __attribute__((always_inline, unused))

#define F8(a) ((f8){ (a), (a), (a), (a), (a), (a), (a), (a) })
#define I8(a) ((i8){ (a), (a), (a), (a), (a), (a), (a), (a) })
#define U8(a) ((u8){ (a), (a), (a), (a), (a), (a), (a), (a) })

LANE_FN i8 i8_from_f8(f8 a) /* truncates */
{
    return __builtin_convertvector(a, i8);
}

LANE_FN f8 f8_from_i8(i8 a)
{
    return __builtin_convertvector(a, f8);
}

/* mask ? a : b; a mask lane is all ones or all zeros */
LANE_FN f8 f8_select(i8 mask, f8 a, f8 b)
{
#if defined(__AVX2__)
    return (f8)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)mask);
#else
    return (f8)(((i8)a & mask) | ((i8)b & ~mask));
#endif
}

LANE_FN i8 i8_select(i8 mask, i8 a, i8 b)
{
    return (i8)f8_select(mask, (f8)a, (f8)b);
}

LANE_FN u8 u8_select(i8 mask, u8 a, u8 b)
{
    return (u8)f8_select(mask, (f8)a, (f8)b);
}

/* One bit per lane, lane 0 lowest */
LANE_FN unsigned i8_bits(i8 mask)
{
#if defined(__AVX2__)
    return (unsigned)_mm256_movemask_ps((__m256)mask);
#else
    unsigned bits = 0;
    for (int lane = 0; lane < LANES; lane++)
        bits |= (unsigned)(mask[lane] & 1) << lane;
    return bits;
#endif
}

/* Each lane's own number */
LANE_FN i8 i8_lanes(void)
{
    return (i8){ 0, 1, 2, 3, 4, 5, 6, 7 };
}

LANE_FN int i8_any(i8 mask)
{
    return i8_bits(mask) != 0;
}

LANE_FN i8 i8_from_bits(unsigned bits)
{
    const i8 lane = { 1, 2, 4, 8, 16, 32, 64, 128 };
    return (I8((int32_t)bits) & lane) != 0;
}

/* As SSE's minps and maxps: the second operand when either is NaN */
LANE_FN f8 f8_min(f8 a, f8 b)
{
#if defined(__AVX2__)
    return (f8)_mm256_min_ps((__m256)a, (__m256)b);
#else
    return f8_select(a < b, a, b);
#endif
}

LANE_FN f8 f8_max(f8 a, f8 b)
{
#if defined(__AVX2__)
    return (f8)_mm256_max_ps((__m256)a, (__m256)b);
#else
    return f8_select(a > b, a, b);
#endif
}

LANE_FN f8 f8_clamp(f8 a, float low, float high)
{
    return f8_min(f8_max(a, F8(low)), F8(high));
}

LANE_FN f8 f8_sqrt(f8 a)
{
#if defined(__AVX2__)
    return (f8)_mm256_sqrt_ps((__m256)a);
#else
    f8 root;
    for (int lane = 0; lane < LANES; lane++)
        root[lane] = __builtin_sqrtf(a[lane]);
    return root;
#endif
}

LANE_FN f8 f8_abs(f8 a)
{
    return (f8)((i8)a & I8(0x7fffffff));
}

/* |a| with the sign of b */
LANE_FN f8 f8_copysign(f8 a, f8 b)
{
    return (f8)(((i8)a & I8(0x7fffffff)) | ((i8)b & I8(INT32_MIN)));
}

/* a with its sign flipped where b is negative */
LANE_FN f8 f8_mulsign(f8 a, f8 b)
{
    return (f8)((i8)a ^ ((i8)b & I8(INT32_MIN)));
}

LANE_FN f8 f8_round(f8 a) /* to nearest, ties to even; |a| < 2^22 */
{
    const f8 magic = F8(0x1.8p23f);
    return (a + magic) - magic;
}

LANE_FN f8 f8_load(const void *from)
{
    f8 a;
    memcpy(&a, from, sizeof(a));
    return a;
}

LANE_FN i8 i8_load(const void *from)
{
    i8 a;
    memcpy(&a, from, sizeof(a));
    return a;
}

LANE_FN void f8_store(void *to, f8 a)
{
    memcpy(to, &a, sizeof(a));
}

LANE_FN void i8_store(void *to, i8 a)
{
    memcpy(to, &a, sizeof(a));
}

/* base[index], per lane; every index must be valid */
LANE_FN f8 f8_gather(const float *base, i8 index)
{
#if defined(__AVX2__)
    return (f8)_mm256_i32gather_ps(base, (__m256i)index, 4);
#else
    f8 a;
    for (int lane = 0; lane < LANES; lane++)
        a[lane] = base[index[lane]];
    return a;
#endif
}

LANE_FN i8 i8_gather(const void *base, i8 index)
{
    return (i8)f8_gather(base, index);
}

/* Lane l of the result is a[index[l]]; indices 0..7 */
LANE_FN f8 f8_permute(f8 a, i8 index)
{
#if defined(__AVX2__)
    return (f8)_mm256_permutevar8x32_ps((__m256)a, (__m256i)index);
#else
    f8 b;
    for (int lane = 0; lane < LANES; lane++)
        b[lane] = a[index[lane] & 7];
    return b;
#endif
}

LANE_FN i8 i8_permute(i8 a, i8 index)
{
    return (i8)f8_permute((f8)a, index);
}

LANE_FN u8 u8_permute(u8 a, i8 index)
{
    return (u8)f8_permute((f8)a, index);
}

/* Three components, eight lanes */
struct vec3x8 {
    f8 x, y, z;
};

struct vec2x8 {
    f8 x, y;
};

LANE_FN struct vec3x8 vec3x8_all(float x, float y, float z)
{
    return (struct vec3x8){ F8(x), F8(y), F8(z) };
}

LANE_FN struct vec3x8 vec3x8_add(struct vec3x8 a, struct vec3x8 b)
{
    return (struct vec3x8){ a.x + b.x, a.y + b.y, a.z + b.z };
}

LANE_FN struct vec3x8 vec3x8_sub(struct vec3x8 a, struct vec3x8 b)
{
    return (struct vec3x8){ a.x - b.x, a.y - b.y, a.z - b.z };
}

LANE_FN struct vec3x8 vec3x8_mul(struct vec3x8 a, struct vec3x8 b)
{
    return (struct vec3x8){ a.x * b.x, a.y * b.y, a.z * b.z };
}

LANE_FN struct vec3x8 vec3x8_scale(struct vec3x8 a, f8 s)
{
    return (struct vec3x8){ a.x * s, a.y * s, a.z * s };
}

/* a + b * s */
LANE_FN struct vec3x8 vec3x8_along(struct vec3x8 a, struct vec3x8 b, f8 s)
{
    return (struct vec3x8){ a.x + b.x * s, a.y + b.y * s, a.z + b.z * s };
}

LANE_FN struct vec3x8 vec3x8_neg(struct vec3x8 a)
{
    return (struct vec3x8){ -a.x, -a.y, -a.z };
}

LANE_FN f8 vec3x8_dot(struct vec3x8 a, struct vec3x8 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

LANE_FN struct vec3x8 vec3x8_cross(struct vec3x8 a, struct vec3x8 b)
{
    return (struct vec3x8){ a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x };
}

LANE_FN f8 vec3x8_length2(struct vec3x8 a)
{
    return vec3x8_dot(a, a);
}

/* Unit vector; zero stays zero */
LANE_FN struct vec3x8 vec3x8_unit(struct vec3x8 a)
{
    f8 length2 = vec3x8_length2(a);
    f8 scale = f8_select(length2 > 0, 1 / f8_sqrt(length2), F8(0));
    return vec3x8_scale(a, scale);
}

LANE_FN struct vec3x8 vec3x8_select(i8 mask, struct vec3x8 a, struct vec3x8 b)
{
    return (struct vec3x8){ f8_select(mask, a.x, b.x), f8_select(mask, a.y, b.y),
                            f8_select(mask, a.z, b.z) };
}

LANE_FN struct vec3x8 vec3x8_permute(struct vec3x8 a, i8 index)
{
    return (struct vec3x8){ f8_permute(a.x, index), f8_permute(a.y, index),
                            f8_permute(a.z, index) };
}

LANE_FN f8 vec3x8_max(struct vec3x8 a)
{
    return f8_max(a.x, f8_max(a.y, a.z));
}

/* Linear sRGB luminance (Rec. 709 primaries) */
LANE_FN f8 vec3x8_luminance(struct vec3x8 a)
{
    return F8(0.2126f) * a.x + F8(0.7152f) * a.y + F8(0.0722f) * a.z;
}

#endif
