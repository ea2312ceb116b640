#include "common/elem.h"

#include <math.h> /* fabs and sqrt, which IEEE 754 defines to the bit; constants */
#include <stdbool.h>

#define PI_2_HI 0x1.921fb54442d18p+0
#define PI_2_LO 0x1.1a62633145c07p-54
#define LN2_HI  0x1.62e42ff000000p-1 /* 32 bits: its products with exponents are exact */
#define LN2_LO  -0x1.718432a1b0e26p-35

/* A number as an unevaluated sum, hi the larger */
struct pair {
    double hi, lo;
};

static struct pair sum_exact(double a, double b)
{
    double sum = a + b;
    double from_b = sum - a;
    return (struct pair){ sum, (a - (sum - from_b)) + (b - from_b) };
}

/* Veltkamp's split and Dekker's product: |a|, |b| and |a b| below 2^990 */
static struct pair product_exact(double a, double b)
{
    double wide_a = a * 0x1.0000002p27, wide_b = b * 0x1.0000002p27;
    double a_hi = wide_a - (wide_a - a), b_hi = wide_b - (wide_b - b);
    double a_lo = a - a_hi, b_lo = b - b_hi;
    double product = a * b;
    return (struct pair){ product,
                          ((a_hi * b_hi - product) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo };
}

static double polynomial(double x, const double *coefficients, int count)
{
    double sum = coefficients[count - 1];
    for (int i = count - 2; i >= 0; i--)
        sum = sum * x + coefficients[i];
    return sum;
}

#define POLYNOMIAL(x, table) polynomial(x, table, (int)(sizeof(table) / sizeof(table[0])))

static uint64_t bits_of(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof(bits));
    return bits;
}

static double double_of(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof(x));
    return x;
}

/* 2^n for -1022 <= n <= 1023 */
static double power_of_two(int n)
{
    return double_of((uint64_t)(n + 1023) << 52);
}

/* a 2^n, |n| < 2000; one rounding where the result is subnormal */
static double scale(double a, int n)
{
    int half = n / 2;
    return a * power_of_two(half) * power_of_two(n - half);
}

static double with_sign_of(double magnitude, double sign)
{
    return double_of((bits_of(magnitude) & INT64_MAX) | (bits_of(sign) & ~(uint64_t)INT64_MAX));
}

static double nearest(double x) /* |x| < 2^51 */
{
    return (x + 0x1.8p52) - 0x1.8p52;
}

/* --- sine and cosine ---------------------------------------------------------------------- */

/* x - n pi/2 in two words, within +-pi/4; the number of the quarter into *quarter */
static struct pair reduce(double x, int *quarter)
{
    if (!(fabs(x) < 0x1p30)) {
        *quarter = 0;
        return (struct pair){ x - x, 0 }; /* infinity and NaN give NaN; elsewhere see the header */
    }
    /* The first two words have 32 bits: their products with n < 2^21 are exact */
    double n = nearest(x * 0x1.45f306dc9c883p-1);
    *quarter = (int)((int64_t)n & 3);
    double first = x - n * 0x1.921fb54400000p+0;
    struct pair second = sum_exact(first, -(n * 0x1.0b4611a600000p-34));
    struct pair r = sum_exact(second.hi, second.lo - n * 0x1.3198a2e037073p-69);
    return r;
}

/* Taylor's coefficients suffice on +-pi/4, and need no fitting */
static double sin_near(struct pair r)
{
    static const double c[] = { -1.0 / 6,
                                1.0 / 120,
                                -1.0 / 5040,
                                1.0 / 362880,
                                -1.0 / 39916800,
                                1.0 / 6227020800.0,
                                -1.0 / 1307674368000.0,
                                1.0 / 355687428096000.0 };
    double z = r.hi * r.hi;
    return r.hi + (r.lo * (1 - 0.5 * z) + r.hi * (z * POLYNOMIAL(z, c)));
}

static double cos_near(struct pair r)
{
    static const double c[] = {
        1.0 / 24,        -1.0 / 720,           1.0 / 40320,           -1.0 / 3628800,
        1.0 / 479001600, -1.0 / 87178291200.0, 1.0 / 20922789888000.0
    };
    double z = r.hi * r.hi;
    double half = 0.5 * z, one_less = 1 - half;
    return one_less + (((1 - one_less) - half) + (z * (z * POLYNOMIAL(z, c)) - r.hi * r.lo));
}

double elem_sin(double x)
{
    int quarter;
    struct pair r = reduce(x, &quarter);
    if (r.hi == 0 && quarter == 0)
        return x; /* keeps the sign of zero */
    double value = quarter & 1 ? cos_near(r) : sin_near(r);
    return quarter & 2 ? -value : value;
}

double elem_cos(double x)
{
    int quarter;
    struct pair r = reduce(x, &quarter);
    double value = quarter & 1 ? sin_near(r) : cos_near(r);
    return (quarter + 1) & 2 ? -value : value;
}

double elem_tan(double x)
{
    return elem_sin(x) / elem_cos(x);
}

/* --- exponential, logarithm, power -------------------------------------------------------- */

/* e^(a.hi + a.lo) for a small a.lo */
static double exp_pair(struct pair a)
{
    static const double c[] = {
        1.0 / 2,       1.0 / 6,        1.0 / 24,        1.0 / 120,
        1.0 / 720,     1.0 / 5040,     1.0 / 40320,     1.0 / 362880,
        1.0 / 3628800, 1.0 / 39916800, 1.0 / 479001600, 1.0 / 6227020800.0
    };
    if (a.hi > 709.79)
        return INFINITY;
    if (a.hi < -745.2)
        return 0;
    if (isnan(a.hi))
        return a.hi;
    double n = nearest(a.hi * 0x1.71547652b82fep+0);
    struct pair r = sum_exact(a.hi - n * LN2_HI, a.lo - n * LN2_LO);
    double tail = r.lo + r.hi * (r.hi * POLYNOMIAL(r.hi, c)) + r.hi * r.lo;
    return scale(1 + (r.hi + tail), (int)n);
}

double elem_exp(double x)
{
    return exp_pair((struct pair){ x, 0 });
}

/* ln of a positive finite number, to about 60 bits */
static struct pair log_pair(double x)
{
    /* Of 2 atanh(s), after its first term 2s */
    static const double c[] = { 2.0 / 3,  2.0 / 5,  2.0 / 7,  2.0 / 9,  2.0 / 11, 2.0 / 13,
                                2.0 / 15, 2.0 / 17, 2.0 / 19, 2.0 / 21, 2.0 / 23 };
    int exponent = 0;
    if (x < 0x1p-1022) {
        x *= 0x1p54;
        exponent = -54;
    }

    /* x = 2^exponent m, sqrt(1/2) <= m < sqrt(2); ln m = 2 atanh s, s = (m - 1) / (m + 1) */
    uint64_t from_root = bits_of(x) - 0x3fe6a09e667f3bcdu;
    int power = (int)((int64_t)from_root >> 52);
    double m = double_of(bits_of(x) - ((uint64_t)power << 52));
    double f = m - 1;
    struct pair under = sum_exact(m, 1);
    double s = f / under.hi;
    struct pair back = product_exact(s, under.hi);
    double s_lo = ((f - back.hi) - back.lo - s * under.lo) / under.hi;

    double z = s * s;
    double tail = 2 * s_lo + s * (z * POLYNOMIAL(z, c));
    double e = power + exponent;
    struct pair sum = sum_exact(e * LN2_HI, 2 * s);
    return sum_exact(sum.hi, sum.lo + (e * LN2_LO + tail));
}

double elem_log(double x)
{
    if (x == 0)
        return -INFINITY;
    if (!(x > 0))
        return NAN;
    if (x == INFINITY)
        return x;
    return log_pair(x).hi;
}

double elem_pow(double x, double y)
{
    if (y == 0 || x == 1)
        return 1;
    if (isnan(x) || isnan(y))
        return NAN;

    /* A negative base needs an integer: odd ones keep its sign */
    bool odd = false;
    if (x < 0 || (x == 0 && signbit(x))) {
        bool whole = fabs(y) >= 0x1p53 || (double)(int64_t)y == y;
        odd = fabs(y) < 0x1p53 && whole && ((int64_t)y & 1) != 0;
        if (!whole && x < 0 && x != -INFINITY && !isinf(y))
            return NAN;
    }
    double sign = odd ? -1 : 1;
    double base = fabs(x);

    if (base == 0 || base == INFINITY)
        return (base == 0) == (y < 0) ? sign * INFINITY : sign * 0.0;
    if (base == 1)
        return sign;
    if (y > 1e20 || y < -1e20) /* far beyond, and products must stay finite */
        y = with_sign_of(1e20, y);
    struct pair log = log_pair(base);
    struct pair product = product_exact(y, log.hi);
    return sign * exp_pair(sum_exact(product.hi, product.lo + y * log.lo));
}

/* --- angles -------------------------------------------------------------------------------- */

double elem_atan2(double y, double x)
{
    /* atan(k / 8), k = 0..8 */
    static const struct pair table[] = {
        { 0, 0 },
        { 0x1.fd5ba9aac2f6ep-4, -0x1.cd37686760c17p-59 },
        { 0x1.f5b75f92c80ddp-3, 0x1.8ab6e3cf7afbdp-57 },
        { 0x1.6f61941e4def1p-2, -0x1.c63aae6f6e918p-56 },
        { 0x1.dac670561bb4fp-2, 0x1.a2b7f222f65e2p-56 },
        { 0x1.1e00babdefeb4p-1, -0x1.928df287a668fp-58 },
        { 0x1.4978fa3269ee1p-1, 0x1.2419a87f2a458p-56 },
        { 0x1.700a7c5784634p-1, -0x1.8c34d25aadef6p-56 },
        { 0x1.921fb54442d18p-1, 0x1.1a62633145c07p-55 },
    };
    static const double c[] = { -1.0 / 3, 1.0 / 5, -1.0 / 7, 1.0 / 9, -1.0 / 11, 1.0 / 13 };

    if (isnan(x) || isnan(y))
        return NAN;
    double ax = fabs(x), ay = fabs(y);
    bool steep = ay > ax;
    double large = steep ? ay : ax, small = steep ? ax : ay;
    double t = large == 0 ? 0 : small == large ? 1 : small / large;

    /* atan t = atan(k/8) + atan of a number within +-1/16 */
    int k = (int)nearest(8 * t);
    double center = k * 0.125;
    double r = (t - center) / (1 + t * center);
    double z = r * r;
    double tail = r * (z * POLYNOMIAL(z, c)) + table[k].lo;
    double hi = table[k].hi, lo = r + tail; /* hi is 0, or larger than lo */

    /* Fold back from the first octant, keeping both words */
    if (steep) {
        struct pair sum = sum_exact(PI_2_HI, -hi);
        hi = sum.hi;
        lo = sum.lo + (PI_2_LO - lo);
    }
    if (signbit(x)) {
        struct pair sum = sum_exact(2 * PI_2_HI, -hi);
        hi = sum.hi;
        lo = sum.lo + (2 * PI_2_LO - lo);
    }
    return with_sign_of(hi + lo, y);
}

double elem_atan(double x)
{
    return elem_atan2(x, 1);
}

double elem_acos(double x)
{
    return elem_atan2(sqrt((1 - x) * (1 + x)), x);
}

double elem_asin(double x)
{
    return elem_atan2(x, sqrt((1 - x) * (1 + x)));
}

/* --- error function ------------------------------------------------------------------------ */

#define TWO_OVER_ROOT_PI 0x1.20dd750429b6dp+0

/* 2/sqrt(pi) e^(-x^2), the derivative of erf; the square in two words keeps its digits */
static double erf_slope(double x)
{
    struct pair square = product_exact(x, x);
    return TWO_OVER_ROOT_PI * exp_pair((struct pair){ -square.hi, -square.lo });
}

/* 1 - erf(x) for x >= 1.5: Laplace's continued fraction, from the far end */
static double erfc_far(double x)
{
    double fraction = x;
    for (int k = 90; k >= 1; k--)
        fraction = x + 0.5 * k / fraction;
    return 0.5 * erf_slope(x) / fraction;
}

double elem_erf(double x)
{
    double a = fabs(x);
    if (isnan(x))
        return x;
    if (a > 6)
        return with_sign_of(1, x);
    if (a > 2)
        return with_sign_of(1 - erfc_far(a), x);

    /* e^(-x^2) times a series of positive terms */
    double term = x, sum = x, square = x * x;
    for (int k = 1; k < 60; k++) {
        term = term * square * 2 / (2 * k + 1);
        sum += term;
    }
    return erf_slope(x) * sum;
}

double elem_erfinv(double x)
{
    double a = fabs(x);
    if (!(a < 1))
        return a == 1 ? x * INFINITY : NAN;
    if (a < 1e-8)
        return x * 0x1.c5bf891b4ef6ap-1; /* sqrt(pi) / 2 */

    /* Winitzki's approximation, within 0.4 % */
    double log = elem_log((1 - a) * (1 + a));
    double half = 2 / (2 * PI_2_HI * 0.147) + 0.5 * log;
    double y = sqrt(sqrt(half * half - log / 0.147) - half);

    /* Halley's steps triple the digits. Near 1 the complement has them, erf itself does not. */
    for (int step = 0; step < 3; step++) {
        double slope = erf_slope(y);
        double excess = (y < 1.5 ? elem_erf(y) - a : (1 - a) - erfc_far(y)) / slope;
        y -= excess / (1 + y * excess);
    }
    return with_sign_of(y, x);
}
