/*
 * Elementary functions whose bits are the same on every machine: made of IEEE + - * / and sqrt,
 * selects and integer operations only, so that neither libm nor the compiler has a say (compile
 * without contraction and fast-math). Use these, never libm's, wherever image bits are decided.
 *
 * f8_*: eight floats, always inlined, without branches, for the kernels. elem_*: one double, for
 * readers, tables and statistics.
 *
 * Errors are the largest ones measured against libm's double (f8_*) or known values (elem_*), in
 * units in the last place (ulp) of a correctly rounded result; tests/test_common_elem.c holds them
 * to it. NaN gives NaN. Results too small for a normal float are zero, so flushing modes do not
 * matter. Pure; any thread.
 */
#ifndef COMMON_ELEM_H
#define COMMON_ELEM_H

#include "common/lane.h"

/* --- One double -------------------------------------------------------------------------- */

double elem_sin(double x); /* 1 ulp for |x| < 1e6; meaningless beyond */
double elem_cos(double x); /* the same */
double elem_tan(double x); /* 3 ulp, the same range */
double elem_exp(double x); /* 1 ulp; 0 below -745, infinite above 709.8 */
double elem_log(double x); /* 1 ulp; -infinity at 0, NaN below */
/* 8 ulp; x >= 0 or y an integer, else NaN; anything to the 0 is 1 */
double elem_pow(double x, double y);
double elem_atan(double x);            /* 2 ulp */
double elem_atan2(double y, double x); /* 2 ulp; quadrants and signed zeros as in libm */
double elem_acos(double x);            /* 3 ulp; NaN outside [-1, 1] */
double elem_asin(double x);            /* 3 ulp; the same */
double elem_erf(double x);             /* relative 1e-14 */
double elem_erfinv(double x);          /* relative 1e-14; infinite at -1 and 1, NaN beyond */

/* --- Eight floats ------------------------------------------------------------------------ */

/* sin and cos of quarter * pi/2 + r, from those of r in [-pi/4, pi/4] */
LANE_FN void f8_sincos_turn(u8 quarter, f8 sin_r, f8 cos_r, f8 *sin_out, f8 *cos_out)
{
    i8 odd = -(i8)(quarter & 1);
    f8 s = f8_select(odd, cos_r, sin_r);
    f8 c = f8_select(odd, sin_r, cos_r);
    *sin_out = (f8)((i8)s ^ (i8)((quarter & 2) << 30));
    *cos_out = (f8)((i8)c ^ (i8)(((quarter + 1) & 2) << 30));
}

/* sin and cos of 2 pi t, t in [0, 1] (in fact |t| < 2^19); 2 ulp. Exact at quarter turns. */
LANE_FN void f8_sincos_turns(f8 t, f8 *sin_out, f8 *cos_out)
{
    f8 quarters = t * 4;
    f8 shifted = quarters + 0x1.8p23f; /* its low bits are the nearest integer */
    f8 r = quarters - (shifted - 0x1.8p23f);
    f8 z = r * r;

    /* pi/2 in two words, or its rounding alone would cost an ulp */
    f8 p = -0x1.4abbbep-1f + z * (0x1.465facp-4f + z * -0x1.2db5d6p-8f);
    f8 s = r * 0x1.921fb6p+0f + r * (-0x1.777a5cp-25f + z * p);
    f8 q = -0x1.3bd3ccp+0f + z * (0x1.03c1b0p-2f + z * (-0x1.55b2b6p-6f + z * 0x1.d4f7eap-11f));
    f8 c = 1 + z * q;
    f8_sincos_turn((u8)shifted, s, c, sin_out, cos_out);
}

/* sin and cos of x radians, |x| < 12000; 2 ulp, or 2^-31 absolute where that is more */
LANE_FN void f8_sincos(f8 x, f8 *sin_out, f8 *cos_out)
{
    /* x - n pi/2: the first two words of pi/2 are so short that their products are exact */
    f8 shifted = x * 0x1.45f306p-1f + 0x1.8p23f;
    f8 n = shifted - 0x1.8p23f;
    f8 r = ((x - n * 0x1.92p+0f) - n * 0x1.fb4p-12f) - n * 0x1.4442d2p-24f;
    f8 z = r * r;

    f8 p = -0x1.555546p-3f + z * (0x1.110778p-7f + z * -0x1.9953fep-13f);
    f8 q = 0x1.55554ap-5f + z * (-0x1.6c0c28p-10f + z * 0x1.99e808p-16f);
    f8_sincos_turn((u8)shifted, r + r * (z * p), 1 - (z * 0.5f - z * (z * q)), sin_out, cos_out);
}

/* e^x; 1 ulp. Infinite above 88.72; 0 below -87.33. */
LANE_FN f8 f8_exp(f8 x)
{
    /* x = n ln2 + r. The order of operands lets NaN through. */
    f8 a = f8_min(F8(100.0f), f8_max(F8(-100.0f), x));
    f8 shifted = a * 0x1.715476p+0f + 0x1.8p23f;
    f8 n = shifted - 0x1.8p23f;
    f8 r = (a - n * 0x1.62ep-1f) - n * 0x1.0bfbe8p-15f;
    f8 p = 0x1.fffffcp-2f +
           r * (0x1.555492p-3f + r * (0x1.5558f2p-5f + r * (0x1.1239e2p-7f + r * 0x1.6a2464p-10f)));
    f8 e = 1 + (r + r * r * p);

    /* 2^n in two factors, since 2^128 is no float */
    i8 power = (i8)((u8)shifted - 0x4b400000u);
    i8 half = power >> 1;
    f8 first = (f8)((u8)(half + 127) << 23);
    f8 second = (f8)((u8)(power - half + 127) << 23);
    return f8_select(a < -87.33654f, F8(0), e * first * second);
}

/* ln x; 1 ulp. x below 2^-126 counts as 0: -infinity; x < 0 gives NaN. */
LANE_FN f8 f8_log(f8 x)
{
    /* x = 2^e (1 + f), sqrt(1/2) <= 1 + f < sqrt(2) */
    i8 from_root = (i8)((u8)x - 0x3f3504f3u); /* unsigned, since NaN's bits may wrap */
    f8 e = f8_from_i8(from_root >> 23);
    f8 f = (f8)((from_root & 0x007fffff) + 0x3f3504f3) - 1;
    f8 z = f * f;
    f8 p = -0x1.5472460p-3f +
           f * (0x1.22d9f8p-3f +
                f * (-0x1.0d8518p-3f + f * (0x1.055c40p-3f + f * -0x1.38b852p-4f)));
    p = 0x1.555554p-2f + f * (-0x1.000228p-2f + f * (0x1.99a00ap-3f + f * p));
    f8 log = (f + ((f * z * p + e * 0x1.0bfbe8p-15f) - z * 0.5f)) + e * 0x1.62ep-1f;

    const f8 infinity = F8(__builtin_inff());
    log = f8_select(x < 0x1p-126f, F8(-__builtin_inff()), log);
    log = f8_select(x == infinity, infinity, log);
    return f8_select((x >= 0) | (x == 0), log, F8(__builtin_nanf("")));
}

typedef double f8_half_double __attribute__((vector_size(32)));
typedef uint64_t f8_half_word __attribute__((vector_size(32)));
typedef float f8_half __attribute__((vector_size(16)));

/* 2^(y log2 x) for four lanes in double, which leaves float's rounding alone to be seen */
LANE_FN f8_half f8_pow_half(f8_half x_float, f8_half y_float)
{
    f8_half_double x = __builtin_convertvector(x_float, f8_half_double);
    f8_half_double y = __builtin_convertvector(y_float, f8_half_double);

    /* log2 of x = 2^e m, m near 1. Clamped so that 0 and infinity stay finite; 0^0 is 1. */
    f8_half_word bits = (f8_half_word)x;
    f8_half_word biased = (bits + 0x00095f619980c433u) >> 52;
    f8_half_double m = (f8_half_double)(bits - ((biased - 1023) << 52));
    f8_half_double e = (f8_half_double)(biased | 0x4330000000000000u) - (0x1p52 + 1023);
    f8_half_double s = (m - 1) / (m + 1);
    f8_half_double z = s * s;
    f8_half_double log2 = e +
                          s * (2.8853900817778495 +
                               z * (0.9617966941139444 +
                                    z * (0.577077942201097 + z * (0.4122092678517222 +
                                                                  z * (0.31990510165175723 +
                                                                       z * 0.28290816773226524)))));

    /* Beyond 2^200 everything is infinite, or zero, in float; a NaN in y stays one */
    f8_half_double p = y * log2;
    const f8_half_double limit = { 200, 200, 200, 200 };
    f8_half_word high = (f8_half_word)(p > limit), low = (f8_half_word)(p < -limit);
    p = (f8_half_double)(((f8_half_word)limit & high) | ((f8_half_word)p & ~high));
    p = (f8_half_double)(((f8_half_word)-limit & low) | ((f8_half_word)p & ~low));
    f8_half_double shifted = p + 0x1.8p52;
    f8_half_double f = p - (shifted - 0x1.8p52);
    f8_half_double exp2 =
        1 + f * (0.6931471807047881 +
                 f * (0.24022651067008408 +
                      f * (0.05550410365346585 +
                           f * (0.009618038059548526 +
                                f * (0.001333393538991601 +
                                     f * (0.00015466781530428742 + f * 1.5196126708649515e-05))))));
    return __builtin_convertvector(exp2 * (f8_half_double)(((f8_half_word)shifted + 1023) << 52),
                                   f8_half);
}

/* x^y for x >= 0; 0.6 ulp. x below 2^-126 counts as 0; x < 0 gives NaN; 0^0 is 1. */
LANE_FN f8 f8_pow(f8 x, f8 y)
{
    f8_half low = f8_pow_half(__builtin_shufflevector(x, x, 0, 1, 2, 3),
                              __builtin_shufflevector(y, y, 0, 1, 2, 3));
    f8_half high = f8_pow_half(__builtin_shufflevector(x, x, 4, 5, 6, 7),
                               __builtin_shufflevector(y, y, 4, 5, 6, 7));
    f8 power = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);

    /* Zero, written out since its logarithm was not; and what is too small for a normal float */
    f8 of_zero = f8_select(y > 0, F8(0), f8_select(y == 0, F8(1), F8(__builtin_inff())));
    power = f8_select(x < 0x1p-126f, of_zero, power);
    power = f8_select(power < 0x1p-126f, F8(0), power);
    return f8_select((x >= 0) & (y == y), power, F8(__builtin_nanf("")));
}

/* (asin(z) - z) for z = sqrt(z2) in [0, 1/2] */
LANE_FN f8 f8_asin_tail(f8 z, f8 z2)
{
    f8 p = 0x1.5555c8p-3f +
           z2 * (0x1.330204p-4f +
                 z2 * (0x1.747bb4p-5f + z2 * (0x1.8c3e96p-6f + z2 * 0x1.595becp-5f)));
    return z * (z2 * p);
}

/* acos x in [0, pi]; 2 ulp. |x| above 1 counts as 1, as rounded dot products want it. */
LANE_FN f8 f8_acos(f8 x)
{
    /* Beyond 1/2: acos(x) = 2 asin(sqrt((1 - x) / 2)) */
    f8 a = f8_min(F8(1), f8_abs(x));
    i8 outer = a > 0.5f;
    f8 z2 = f8_select(outer, (1 - a) * 0.5f, a * a);
    f8 z = f8_select(outer, f8_sqrt(z2), a);
    f8 asin = z + f8_asin_tail(z, z2);
    f8 near_zero = 2 * asin;
    i8 negative = x < 0;
    f8 at_ends = f8_select(negative, 0x1.921fb6p+1f - (near_zero + 0x1.777a5cp-24f), near_zero);
    f8 middle = 0x1.921fb6p+0f - (f8_mulsign(asin, x) + 0x1.777a5cp-25f);
    return f8_select(outer, at_ends, middle);
}

/* asin x in [-pi/2, pi/2]; 3 ulp. |x| above 1 counts as 1. */
LANE_FN f8 f8_asin(f8 x)
{
    f8 a = f8_min(F8(1), f8_abs(x));
    i8 outer = a > 0.5f;
    f8 z2 = f8_select(outer, (1 - a) * 0.5f, a * a);
    f8 z = f8_select(outer, f8_sqrt(z2), a);
    f8 asin = z + f8_asin_tail(z, z2);
    asin = f8_select(outer, 0x1.921fb6p+0f - (2 * asin + 0x1.777a5cp-25f), asin);
    return f8_mulsign(asin, x);
}

/*
 * The angle of (x, y) in [-pi, pi]; 2 ulp. Signed zeros as in libm: atan2(0, 0) is 0 and
 * atan2(0, -0) is pi. Finite numbers with 2^-126 <= max(|x|, |y|) < 2^127.
 */
LANE_FN f8 f8_atan2(f8 y, f8 x)
{
    f8 ax = f8_abs(x), ay = f8_abs(y);
    i8 steep = ay > ax;
    f8 large = f8_select(steep, ay, ax), small = f8_select(steep, ax, ay);

    /* Beyond tan(pi/8): atan(t) = pi/4 + atan((t - 1) / (t + 1)), in the same division */
    i8 beyond = small > large * 0x1.a8279ap-2f;
    f8 over = f8_select(beyond, small - large, small);
    f8 under = f8_select(beyond, small + large, large);
    f8 t = over / f8_max(F8(0x1p-126f), under);
    f8 z = t * t;
    f8 p = -0x1.55554ap-2f +
           z * (0x1.9991e2p-3f +
                z * (-0x1.23b9a0p-3f + z * (0x1.b22414p-4f + z * -0x1.f2e392p-5f)));
    f8 tail = t * (z * p);

    /* The angle is offset +- (t + tail); the offset's low word goes with the tail */
    f8 a = f8_select(beyond, 0x1.921fb6p-1f + (t + (tail - 0x1.777a5cp-26f)), t + tail);
    a = f8_select(steep, 0x1.921fb6p+0f - (a + 0x1.777a5cp-25f), a);
    a = f8_select((i8)x < 0, 0x1.921fb6p+1f - (a + 0x1.777a5cp-24f), a);
    return f8_mulsign(a, y);
}

/* atan x; 2 ulp; infinity gives pi/2 */
LANE_FN f8 f8_atan(f8 x)
{
    return f8_atan2(x, F8(1));
}

#endif
