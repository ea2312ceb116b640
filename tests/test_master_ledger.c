/*
 * The accuracy ledger: its rows, and what they say about the rounds to come.
 */
#include "master/ledger.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static void the_ledger_fits_a_slope_and_predicts(void **state)
{
    (void)state;
    struct ledger_row rows[10];
    for (int i = 0; i < 10; i++) {
        struct node_stats stats = { .samples = 1000, .truncated_energy = 5 };
        uint64_t spp = (uint64_t)16 << i;
        struct accuracy accuracy = { .relmse = 3.0 / (double)spp };
        rows[i] = ledger_row_of((unsigned)i, spp, 2 + 0.5 * (double)spp, 0, &accuracy, &stats);
    }
    assert_true(rows[0].truncated_energy == 0.005);
    rows[4].accuracy.verdict = ACCURACY_FEW_PIXELS;
    rows[4].accuracy.relmse = 1000; /* left out */
    struct error_fit fit = ledger_fit(rows, 10);
    assert_int_equal(fit.rows, 9);
    assert_true(fabs(fit.slope + 1) < 1e-9 && fit.slope_stderr < 1e-6);
    assert_true(fabs(ledger_spp_for(&fit, 3e-4) / 10000 - 1) < 1e-9);
    assert_true(fabs(ledger_seconds_left(rows, 10, 16384) - 0.5 * 8192) < 1e-6);
    assert_true(ledger_seconds_left(rows, 10, 100) == 0);
    assert_true(isinf(ledger_seconds_left(rows, 0, 100)));
    fit = ledger_fit(rows, 2);
    assert_true(fit.rows == 2 && isnan(fit.slope) && isinf(ledger_spp_for(&fit, 1e-3)));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_ledger_fits_a_slope_and_predicts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
