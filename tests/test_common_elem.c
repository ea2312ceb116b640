/* Goal: the elementary functions and distributions are as exact as their headers say, over the
 * whole range they promise; measured against libm (long double for the double ones). */
#include "common/elem.h"
#include "common/hash.h"
#include "common/stats.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#define TRIES 200000

/* A number in [a, b), the i-th of its kind */
static double between(double a, double b, uint64_t i)
{
    return a + (b - a) * hash64_unit(hash64(0x656c656d, i));
}

/* |got - want| in units in the last place of `want`, with `digits` bits and a smallest exponent */
static double ulps(double got, long double want, int digits, int lowest)
{
    if (isnan(got) || isnan((double)want) || isinf(got) || isinf((double)want))
        return (isnan(got) && isnan((double)want)) || got == (double)want ? 0 : INFINITY;
    int exponent;
    frexpl(want, &exponent);
    exponent = exponent - digits < lowest ? lowest : exponent - digits;
    return (double)(fabsl((long double)got - want) / ldexpl(1, exponent));
}

/* The worst error of a function over one range, and where */
struct worst {
    double ulps, x, y;
};

static void worst_note(struct worst *w, double error, double x, double y)
{
    if (!(error <= w->ulps))
        *w = (struct worst){ error, x, y };
}

static void worst_expect(const char *name, struct worst w, double limit)
{
    if (!(w.ulps <= limit))
        fail_msg("%s is off by %.3f ulp at %a, %a; promised are %.3f", name, w.ulps, w.x, w.y,
                 limit);
    if (getenv("PATHFARM_VERBOSE"))
        print_message("    %-24s %.3f ulp of %.3f\n", name, w.ulps, limit);
}

/* --- double ------------------------------------------------------------------------------- */

#define DOUBLE_ROWS(X)                       \
    X(elem_sin, sinl, -10, 10, 1)            \
    X(elem_sin, sinl, -1e6, 1e6, 1)          \
    X(elem_cos, cosl, -10, 10, 1)            \
    X(elem_cos, cosl, -1e6, 1e6, 1)          \
    X(elem_tan, tanl, -1e3, 1e3, 3)          \
    X(elem_exp, expl, -745, 709.7, 1)        \
    X(elem_exp, expl, -1, 1, 1)              \
    X(elem_log, logl, 0, 2, 1)               \
    X(elem_log, logl, 0, 1e300, 1)           \
    X(elem_log, logl, 0.99, 1.01, 1)         \
    X(elem_atan, atanl, -2, 2, 2)            \
    X(elem_atan, atanl, -1e6, 1e6, 2)        \
    X(elem_asin, asinl, -1, 1, 3)            \
    X(elem_acos, acosl, -1, 1, 3)            \
    X(elem_acos, acosl, 0.999, 1, 3)         \
    X(elem_erf, erfl, -7, 7, 45) /* 1e-14 */ \
    X(elem_erf, erfl, -0.01, 0.01, 45)

static void double_functions_keep_their_promise(void **state)
{
    (void)state;
#define X(function, truth, low, high, limit)                              \
    {                                                                     \
        struct worst w = { 0 };                                           \
        for (uint64_t i = 0; i < TRIES; i++) {                            \
            double x = between(low, high, i);                             \
            worst_note(&w, ulps(function(x), truth(x), 53, -1074), x, 0); \
        }                                                                 \
        worst_expect(#function, w, limit);                                \
    }
    DOUBLE_ROWS(X)
#undef X
}

static void double_powers_and_angles_keep_their_promise(void **state)
{
    (void)state;
    struct worst wide = { 0 }, near_one = { 0 }, angle = { 0 };
    for (uint64_t i = 0; i < TRIES; i++) {
        double x = exp(between(-20, 20, 2 * i)), y = between(-35, 35, 2 * i + 1);
        worst_note(&wide, ulps(elem_pow(x, y), powl(x, y), 53, -1074), x, y);
        x = between(0.5, 1.5, 2 * i);
        y *= 10;
        worst_note(&near_one, ulps(elem_pow(x, y), powl(x, y), 53, -1074), x, y);
        x = between(-1, 1, 2 * i);
        worst_note(&angle, ulps(elem_atan2(y, x), atan2l(y, x), 53, -1074), x, y);
        y = between(-1, 1, 2 * i + 1);
        worst_note(&angle, ulps(elem_atan2(y, x), atan2l(y, x), 53, -1074), x, y);
    }
    worst_expect("elem_pow", wide, 8);
    worst_expect("elem_pow near 1", near_one, 8);
    worst_expect("elem_atan2", angle, 2);
}

static void the_inverse_error_function_inverts(void **state)
{
    (void)state;
    double worst = 0;
    for (uint64_t i = 0; i < TRIES / 4; i++) {
        /* Small, middling, and close to 1 in turn. How far off is y, to first order? */
        double x = i % 3 == 0 ? exp(between(-40, 0, i)) : between(0, 1, i);
        x = i % 3 == 1 ? 1 - exp(between(-36, 0, i)) : x;
        long double y = elem_erfinv(x);
        long double excess = x < 0.5 ? erfl(y) - x : (1 - (long double)x) - erfcl(y);
        double relative = (double)fabsl(excess / (M_2_SQRTPI * expl(-y * y)) / y);
        worst = relative > worst ? relative : worst;
        assert_true(elem_erfinv(-x) == -elem_erfinv(x));
    }
    assert_true(worst < 1e-14);
}

/* Bits, so that -0 is not 0 and NaN is NaN */
static int same(double a, double b)
{
    return (isnan(a) && isnan(b)) || memcmp(&a, &b, sizeof(a)) == 0;
}

static void double_functions_know_their_edges(void **state)
{
    (void)state;
    static const double odd[] = { 0.0,    -0.0,   1,      -1,        2,         -2,  3,
                                  -3,     0.5,    -0.5,   INFINITY,  -INFINITY, NAN, 1e300,
                                  -1e300, 5e-324, 0x1p53, -0x1.8p53, 1e-300 };
    const int count = (int)(sizeof(odd) / sizeof(odd[0]));
    for (int i = 0; i < count; i++) {
        for (int j = 0; j < count; j++) {
            if (!same(elem_pow(odd[i], odd[j]), pow(odd[i], odd[j])))
                assert_true(fabs(elem_pow(odd[i], odd[j]) / pow(odd[i], odd[j]) - 1) < 1e-15);
            if (!same(elem_atan2(odd[i], odd[j]), atan2(odd[i], odd[j])))
                assert_true(fabs(elem_atan2(odd[i], odd[j]) / atan2(odd[i], odd[j]) - 1) < 1e-15);
        }
    }
    assert_true(same(elem_log(0), -INFINITY) && same(elem_log(INFINITY), INFINITY));
    assert_true(isnan(elem_log(-1)) && isnan(elem_log(NAN)) && same(elem_log(1), 0));
    assert_true(same(elem_exp(0), 1) && same(elem_exp(-INFINITY), 0));
    assert_true(isinf(elem_exp(INFINITY)) && isinf(elem_exp(709.8)) && isnan(elem_exp(NAN)));
    assert_true(same(elem_sin(-0.0), -0.0) && same(elem_cos(0), 1));
    assert_true(isnan(elem_sin(INFINITY)) && isnan(elem_cos(NAN)) && isnan(elem_tan(NAN)));
    assert_true(same(elem_acos(1), 0) && isnan(elem_acos(1.0000001)) && isnan(elem_asin(-2)));
    assert_true(same(elem_asin(1), asin(1)) && same(elem_acos(-1), acos(-1)));
    assert_true(same(elem_erf(INFINITY), 1) && same(elem_erf(-7), -1) && isnan(elem_erf(NAN)));
    assert_true(same(elem_erfinv(1), INFINITY) && same(elem_erfinv(-1), -INFINITY));
    assert_true(isnan(elem_erfinv(1.1)) && same(elem_erfinv(-0.0), -0.0));
}

/* --- float -------------------------------------------------------------------------------- */

static f8 just_sin(f8 x)
{
    f8 s, c;
    f8_sincos(x, &s, &c);
    return s;
}

static f8 just_cos(f8 x)
{
    f8 s, c;
    f8_sincos(x, &s, &c);
    return c;
}

static f8 just_sin_turns(f8 x)
{
    f8 s, c;
    f8_sincos_turns(x, &s, &c);
    return s;
}

static f8 just_cos_turns(f8 x)
{
    f8 s, c;
    f8_sincos_turns(x, &s, &c);
    return c;
}

/* Exactly reduced, or pi's own error would be seen */
static double sin_turns(double t)
{
    double quarter = nearbyint(4 * t), r = (4 * t - quarter) * M_PI_2;
    switch ((int)quarter & 3) {
    case 0:
        return sin(r);
    case 1:
        return cos(r);
    case 2:
        return -sin(r);
    default:
        return -cos(r);
    }
}

static double cos_turns(double t)
{
    return sin_turns(t + 0.25);
}

#define FLOAT_ROWS(X)                     \
    X(just_sin_turns, sin_turns, 0, 1, 2) \
    X(just_cos_turns, cos_turns, 0, 1, 2) \
    X(just_sin, sin, -3.2, 3.2, 2)        \
    X(just_cos, cos, -3.2, 3.2, 2)        \
    X(f8_exp, exp, -87.3365, 88.7228, 1)  \
    X(f8_exp, exp, -1, 1, 1)              \
    X(f8_log, log, 0, 2, 1)               \
    X(f8_log, log, 0, 3e38, 1)            \
    X(f8_log, log, 0.9, 1.1, 1)           \
    X(f8_asin, asin, -1, 1, 3)            \
    X(f8_acos, acos, -1, 1, 2)            \
    X(f8_acos, acos, 0.99, 1, 2)          \
    X(f8_atan, atan, -2, 2, 2)            \
    X(f8_atan, atan, -1e6, 1e6, 2)

static void float_functions_keep_their_promise(void **state)
{
    (void)state;
#define X(function, truth, low, high, limit)                                                   \
    {                                                                                          \
        struct worst w = { 0 };                                                                \
        for (uint64_t i = 0; i < 4 * TRIES; i += LANES) {                                      \
            f8 x;                                                                              \
            for (int lane = 0; lane < LANES; lane++)                                           \
                x[lane] = (float)between(low, high, i + (uint64_t)lane);                       \
            f8 got = function(x);                                                              \
            for (int lane = 0; lane < LANES; lane++)                                           \
                worst_note(&w, ulps(got[lane], truth((double)x[lane]), 24, -149), x[lane], 0); \
        }                                                                                      \
        worst_expect(#function, w, limit);                                                     \
    }
    FLOAT_ROWS(X)
#undef X
}

static void float_powers_and_angles_keep_their_promise(void **state)
{
    (void)state;
    struct worst wide = { 0 }, unit = { 0 }, angle = { 0 };
    double far = 0;
    for (uint64_t i = 0; i < 2 * TRIES; i += LANES) {
        f8 x, y, a, b, t;
        for (int lane = 0; lane < LANES; lane++) {
            uint64_t n = 3 * (i + (uint64_t)lane);
            x[lane] = (float)exp(between(-80, 80, n));
            y[lane] = (float)between(-1.1, 1.1, n + 1);
            a[lane] = (float)between(0, 1, n);
            b[lane] = (float)between(-1, 1, n + 1);
            t[lane] = (float)between(-12000, 12000, n + 2);
        }
        f8 xy = f8_pow(x, y), ay = f8_pow(a, 3 + 10 * b), ab = f8_atan2(y, b), ba = f8_atan2(b, -a);
        f8 s, c;
        f8_sincos(t, &s, &c);
        for (int lane = 0; lane < LANES; lane++) {
            double p = pow(x[lane], y[lane]), q = pow(a[lane], 3 + 10 * b[lane]);
            if (p > 0x1p-126 && p < 0x1p127)
                worst_note(&wide, ulps(xy[lane], p, 24, -149), x[lane], y[lane]);
            if (q > 0x1p-126 && q < 0x1p127)
                worst_note(&unit, ulps(ay[lane], q, 24, -149), a[lane], 3 + 10 * b[lane]);
            worst_note(&angle, ulps(ab[lane], atan2(y[lane], b[lane]), 24, -149), y[lane], b[lane]);
            worst_note(&angle, ulps(ba[lane], atan2(b[lane], -a[lane]), 24, -149), b[lane],
                       -a[lane]);
            far = fmax(far, fabs(s[lane] - sin(t[lane])) - 0x1p-23 * fabs(s[lane]));
            far = fmax(far, fabs(c[lane] - cos(t[lane])) - 0x1p-23 * fabs(c[lane]));
        }
    }
    worst_expect("f8_pow", wide, 0.6);
    worst_expect("f8_pow of [0, 1]", unit, 0.6);
    worst_expect("f8_atan2", angle, 2);
    assert_true(far < 0x1p-31);
}

static void float_functions_know_their_edges(void **state)
{
    (void)state;
    const float inf = INFINITY;
    f8 s, c;
    f8_sincos_turns((f8){ 0, 0.25f, 0.5f, 0.75f, 1, 0x1.fffffep-1f, 0x1p-24f, 0.125f }, &s, &c);
    static const float sines[] = { 0, 1, 0, -1, 0 }, cosines[] = { 1, 0, -1, 0, 1 };
    for (int i = 0; i < 5; i++)
        assert_true(s[i] == sines[i] && c[i] == cosines[i]);
    assert_true(s[5] < 0 && c[5] == 1 && s[6] > 0 && c[6] == 1);
    for (int i = 0; i < 8; i++)
        assert_true(fabsf(s[i]) <= 1 && fabsf(c[i]) <= 1);

    f8 e = f8_exp((f8){ 0, -inf, inf, NAN, 88.8f, -87.4f, -200, 200 });
    assert_true(e[0] == 1 && e[1] == 0 && e[2] == inf && isnan(e[3]) && e[4] == inf);
    assert_true(e[5] == 0 && e[6] == 0 && e[7] == inf);

    f8 l = f8_log((f8){ 1, 0, -0.0f, inf, NAN, -1, -inf, 0x1p-126f });
    assert_true(l[0] == 0 && l[1] == -inf && l[2] == -inf && l[3] == inf);
    assert_true(isnan(l[4]) && isnan(l[5]) && isnan(l[6]) && l[7] == (float)log(0x1p-126));

    f8 p = f8_pow((f8){ 0, 0, 0, 1, inf, 2, NAN, -1 }, (f8){ 0, 2, -1, 1e30f, 1, 10, 1, 2 });
    assert_true(p[0] == 1 && p[1] == 0 && p[2] == inf && p[3] == 1 && p[4] == inf);
    assert_true(p[5] == 1024 && isnan(p[6]) && isnan(p[7]));
    p = f8_pow((f8){ 2, 2, inf, 0.5f, 3, 1e-30f, 1e30f, 1 },
               (f8){ 200, -200, -1, 0, NAN, 2, 2, 0 });
    assert_true(p[0] == inf && p[1] == 0 && p[2] == 0 && p[3] == 1 && isnan(p[4]));
    assert_true(p[5] == 0 && p[6] == inf && p[7] == 1);

    f8 a = f8_acos((f8){ 1, -1, 0, 1.0000002f, -2, NAN, 0.5f, -0.5f });
    assert_true(a[0] == 0 && a[1] == (float)M_PI && a[2] == (float)M_PI_2 && a[3] == 0);
    assert_true(a[4] == (float)M_PI && isnan(a[5]));
    f8 i = f8_asin((f8){ 1, -1, 0, 1.0000002f, -2, NAN, -0.0f, 1e-30f });
    assert_true(i[0] == (float)M_PI_2 && i[1] == -(float)M_PI_2 && i[2] == 0);
    assert_true(i[3] == i[0] && i[4] == i[1] && isnan(i[5]) && signbit(i[6]) && i[7] == 1e-30f);

    f8 t = f8_atan2((f8){ 0, 0, -0.0f, 1, -1, NAN, 1, 0 }, (f8){ 0, -0.0f, 1, 0, 0, 1, NAN, -1 });
    assert_true(t[0] == 0 && t[1] == (float)M_PI && t[2] == 0 && signbit(t[2]));
    assert_true(t[3] == (float)M_PI_2 && t[4] == -(float)M_PI_2 && isnan(t[5]) && isnan(t[6]));
    assert_true(t[7] == (float)M_PI && f8_atan(F8(inf))[0] == (float)M_PI_2);
}

/* --- distributions ------------------------------------------------------------------------ */

static void expect_relative(const char *what, double got, double want, double limit)
{
    if (!(fabs(got - want) <= limit * fabs(want)))
        fail_msg("%s: got %.15g, want %.15g", what, got, want);
}

static void distributions_agree_with_published_values(void **state)
{
    (void)state;
    expect_relative("normal 1.96", stats_normal_survival(1.96), 0.0249978951482204, 1e-10);
    expect_relative("normal 8", stats_normal_survival(8), 6.22096057427178e-16, 1e-10);
    expect_relative("normal -1", stats_normal_survival(-1), 0.841344746068543, 1e-10);
    expect_relative("z .975", stats_normal_quantile(0.975), 1.95996398454005, 1e-10);
    expect_relative("z 1e-10", stats_normal_quantile(1e-10), -6.36134090240406, 1e-10);
    expect_relative("z 1e-100", stats_normal_quantile(1e-100), -21.2734535609653, 1e-10);
    expect_relative("chi2 1", stats_chi_square_survival(3.84145882069412, 1), 0.05, 1e-10);
    expect_relative("chi2 100", stats_chi_square_survival(150, 100), 0.000903932042354009, 1e-10);
    expect_relative("chi2 low", stats_chi_square_survival(70, 100), 0.990154497523591, 1e-10);
    expect_relative("t 1", stats_student_quantile(0.975, 1), 12.7062047361747, 1e-10);
    expect_relative("t 3", stats_student_quantile(0.975, 3), 3.18244630528371, 1e-10);
    expect_relative("t 3 far", stats_student_quantile(0.0005, 3), -12.9239786366875, 1e-10);
    expect_relative("t 31.5", stats_student_quantile(0.975, 31.5), 2.03820213671188, 1e-10);
    expect_relative("t 1e9", stats_student_quantile(0.975, 1e9), 1.95996398454005, 1e-6);
    assert_true(stats_chi_square_survival(0, 3) == 1 && isnan(stats_chi_square_survival(1, 0)));
    assert_true(isnan(stats_normal_quantile(-0.1)) && stats_normal_quantile(1) == INFINITY);
    assert_true(stats_student_quantile(0.5, 3) == 0 && isnan(stats_student_quantile(2, 3)));
}

static void quantiles_invert_survival_functions(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < 300; i++) {
        double p = exp(between(-60, -0.7, 2 * i)), dof = exp(between(0, 7, 2 * i + 1));
        expect_relative("t", stats_student_survival(-stats_student_quantile(p, dof), dof), p, 1e-9);
        expect_relative("z", stats_normal_survival(-stats_normal_quantile(p)), p, 1e-9);
    }
    const unsigned long long counts[] = { 10, 20, 30, 40 };
    const double shares[] = { 0.1, 0.2, 0.3, 0.4 }, holes[] = { 0, 0.3, 0.3, 0.4 };
    assert_true(stats_chi_square(counts, shares, 4) < 1e-12);
    expect_relative("equal shares", stats_chi_square(counts, NULL, 4), 20, 1e-12);
    assert_true(stats_chi_square(counts, holes, 4) == INFINITY);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(double_functions_keep_their_promise),
        cmocka_unit_test(double_powers_and_angles_keep_their_promise),
        cmocka_unit_test(the_inverse_error_function_inverts),
        cmocka_unit_test(double_functions_know_their_edges),
        cmocka_unit_test(float_functions_keep_their_promise),
        cmocka_unit_test(float_powers_and_angles_keep_their_promise),
        cmocka_unit_test(float_functions_know_their_edges),
        cmocka_unit_test(distributions_agree_with_published_values),
        cmocka_unit_test(quantiles_invert_survival_functions),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
