/* Means and variances that stay right for long streams, large means and any tree of merges. */
#include "common/moments.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define COUNT 20000

static double uniform(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return (double)(*state >> 11) * 0x1p-53;
}

/* Mean 1000, variance .01 */
static void fill(double *values)
{
    uint64_t state = 58;
    for (int i = 0; i < COUNT; i++)
        values[i] = 1000 + 0.1 * (uniform(&state) - 0.5) * 3.4641016151377544;
}

static void assert_near(double got, double want, double tolerance)
{
    if (!(fabs(got - want) <= tolerance))
        fail_msg("got %.17g, want %.17g +- %g", got, want, tolerance);
}

static void many_zeros_then_many_ones_have_the_mean_of_both(void **state) /* H57 */
{
    (void)state;
    struct moments m = { 0 };
    for (int i = 0; i < 1000000; i++)
        moments_add(&m, 0);
    for (int i = 0; i < 10000000; i++)
        moments_add(&m, 1);
    assert_near(m.mean, 10.0 / 11, 1e-12);
    assert_near(moments_variance(&m), 10.0 / 121, 1e-7);
}

static void a_large_mean_does_not_drown_the_variance(void **state) /* H58 */
{
    (void)state;
    static double values[COUNT];
    fill(values);
    struct moments m = { 0 };
    long double sum = 0, squares = 0;
    float naive_sum = 0, naive_squares = 0;
    for (int i = 0; i < COUNT; i++) {
        moments_add(&m, values[i]);
        sum += values[i] - 1000.0L;
        squares += (values[i] - 1000.0L) * (values[i] - 1000.0L);
        naive_sum += (float)values[i];
        naive_squares += (float)values[i] * (float)values[i];
    }
    double want = (double)((squares - sum * sum / COUNT) / (COUNT - 1));
    assert_near(moments_variance(&m) / want, 1, 1e-11);
    assert_near(moments_stderr(&m), sqrt(want / COUNT), 1e-14);

    /* The planted bug: sums of squares in float are not even near */
    double naive = ((double)naive_squares - (double)naive_sum * naive_sum / COUNT) / (COUNT - 1);
    assert_true(fabs(naive - want) > 10 * want);
}

static void any_tree_of_merges_is_the_serial_result(void **state)
{
    (void)state;
    static double values[COUNT];
    fill(values);
    struct moments serial = { 0 };
    for (int i = 0; i < COUNT; i++)
        moments_add(&serial, values[i]);

    uint64_t random = 1;
    for (int trial = 0; trial < 20; trial++) {
        struct moments parts[64] = { 0 };
        int count = 1 + (int)(uniform(&random) * 64);
        for (int i = 0; i < COUNT; i++)
            moments_add(&parts[(int)(uniform(&random) * count)], values[i]);
        for (; count > 1; count--) { /* merge a random one into another */
            int into = (int)(uniform(&random) * (count - 1));
            moments_merge(&parts[into], &parts[count - 1]);
        }
        assert_int_equal(parts[0].n, serial.n);
        assert_near(parts[0].mean / serial.mean, 1, 1e-12);
        assert_near(parts[0].m2 / serial.m2, 1, 1e-10); /* rounding at 1000 over a spread of .1 */
    }
}

static void a_spread_like_the_mean_merges_to_twelve_digits(void **state)
{
    (void)state;
    uint64_t random = 2;
    struct moments serial = { 0 }, left = { 0 }, right = { 0 };
    for (int i = 0; i < COUNT; i++) {
        double x = 2 * uniform(&random) - 1;
        moments_add(&serial, x);
        moments_add(i % 3 == 0 ? &left : &right, x);
    }
    moments_merge(&left, &right);
    assert_near(left.mean, serial.mean, 1e-12);
    assert_near(left.m2 / serial.m2, 1, 1e-12);
    assert_near(moments_variance(&left), 1.0 / 3, 0.01);
}

static void merging_with_nothing_changes_no_bit(void **state)
{
    (void)state;
    struct moments m = { 0 };
    moments_add(&m, 0.1);
    moments_add(&m, 0.7);
    struct moments before = m, nothing = { 0 };
    moments_merge(&m, &nothing);
    assert_memory_equal(&m, &before, sizeof(m));
    moments_merge(&nothing, &m);
    assert_memory_equal(&nothing, &before, sizeof(m));
}

static void the_variance_of_one_number_is_unknown(void **state)
{
    (void)state;
    struct moments m = { 0 };
    assert_true(isinf(moments_variance(&m)));
    moments_add(&m, 3);
    assert_true(isinf(moments_variance(&m)) && isinf(moments_stderr(&m)));
    moments_add(&m, 3);
    assert_true(moments_variance(&m) == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(many_zeros_then_many_ones_have_the_mean_of_both),
        cmocka_unit_test(a_large_mean_does_not_drown_the_variance),
        cmocka_unit_test(any_tree_of_merges_is_the_serial_result),
        cmocka_unit_test(a_spread_like_the_mean_merges_to_twelve_digits),
        cmocka_unit_test(merging_with_nothing_changes_no_bit),
        cmocka_unit_test(the_variance_of_one_number_is_unknown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
