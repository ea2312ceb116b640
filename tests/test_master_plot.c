/* Goal: plots show every number where it belongs, with axes that people can read, whatever the
 * numbers are; and fitted lines are as sure as they say. */
#include "common/hash.h"
#include "master/fit.h"
#include "master/plot.h"
#include "tests/balanced.h"
#include "tests/expect.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define LENGTH(array) (sizeof(array) / sizeof((array)[0]))

static char *svg_of(const struct plot *plot)
{
    char *text;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    assert_non_null(out);
    plot_write(plot, out);
    assert_int_equal(fclose(out), 0);
    return text;
}

static size_t count_of(const char *text, const char *part)
{
    size_t count = 0;
    for (; (text = strstr(text, part)) != NULL; text++)
        count++;
    return count;
}

/* A plot of one series; ends of axes from the data */
static char *svg_of_one(const double *x, const double *y, const double *error, size_t count,
                        bool log_x, bool log_y, unsigned style)
{
    const struct plot_series series = { "one", style, count, x, y, error };
    return svg_of(&(struct plot){ .title = "title",
                                  .x = { .label = "x", .log = log_x },
                                  .y = { .label = "y", .log = log_y },
                                  .series = &series,
                                  .series_count = 1 });
}

static void expect_well_formed(const char *svg)
{
    const char *fault = balanced_fault(svg);
    if (fault != NULL)
        fail_msg("%s", fault);
    assert_null(strstr(svg, "nan"));
    assert_null(strstr(svg, "inf"));
}

static void the_check_of_tags_sees_what_is_wrong(void **state)
{
    (void)state;
    static const struct {
        const char *text, *fault;
    } rows[] = {
        { "<a><b></b></a>", NULL },
        { "<a b=\"c > d\">e &amp; f</a><img src=\"g\"><p/>", NULL },
        { "<a><b></a>", "closed out of order" },
        { "<a>", "never closed" },
        { "</a>", "closed out of order" },
        { "a & b", "a bare &" },
        { "1 < 2", "a malformed tag" },
        { "<a b=\"c<d\"></a>", "a malformed tag" },
    };
    for (size_t i = 0; i < LENGTH(rows); i++) {
        const char *fault = balanced_fault(rows[i].text);
        assert_int_equal(fault == NULL, rows[i].fault == NULL);
        if (fault != NULL)
            assert_non_null(strstr(fault, rows[i].fault));
    }
}

static void logarithmic_axes_name_powers_of_ten(void **state)
{
    (void)state;
    const double x[] = { 1, 1e3, 1e6 }, y[] = { .5, .02, .0007 };
    char *svg = svg_of_one(x, y, NULL, 3, true, true, PLOT_MARKERS);
    expect_well_formed(svg);
    for (int exponent = 0; exponent <= 6; exponent++) {
        char label[64];
        snprintf(label, sizeof(label), ">10<tspan dy=\"-.45em\" font-size=\"75%%\">%d</tspan>",
                 exponent);
        assert_int_equal(count_of(svg, label), 1);
    }
    /* Four decades around 1 are read better as they are */
    assert_int_equal(count_of(svg, ">0.001<"), 1);
    assert_int_equal(count_of(svg, ">0.1<"), 1);
    free(svg);
}

static void linear_axes_go_in_steps_of_one_two_or_five(void **state)
{
    (void)state;
    static const struct {
        double low, high;
        const char *first, *second, *absent;
    } rows[] = {
        { 0, 1, ">0.1<", ">0.2<", ">0.15<" },
        { 0, 10, ">1<", ">2<", ">1.5<" },
        { -3e-5, 2e-5, ">-3e-05<", ">-2.5e-05<", ">-2.75e-05<" },
        { 1000, 1020, ">1002<", ">1004<", ">1003<" },
    };
    for (size_t i = 0; i < LENGTH(rows); i++) {
        char *svg = svg_of(
            &(struct plot){ .x = { .label = "x", .low = rows[i].low, .high = rows[i].high } });
        expect_well_formed(svg);
        assert_non_null(strstr(svg, rows[i].first));
        assert_non_null(strstr(svg, rows[i].second));
        assert_null(strstr(svg, rows[i].absent));
        free(svg);
    }
}

static void numbers_that_cannot_be_shown_are_left_out(void **state)
{
    (void)state;
    const double x[] = { 1, 2, 3, 4, 5, 6 };
    const double y[] = { 1, NAN, 10, 0, -3, INFINITY };
    const double error[] = { .5, .5, 20, .5, .5, .5 };
    char *svg = svg_of_one(x, y, error, LENGTH(x), false, true, PLOT_MARKERS | PLOT_LINE);
    expect_well_formed(svg);
    /* Two circles, and the one of the legend */
    assert_int_equal(count_of(svg, "a4 4 0 1 0 8 0"), 3);
    free(svg);

    svg = svg_of_one(x, y, NULL, LENGTH(x), false, false, PLOT_MARKERS);
    expect_well_formed(svg);
    assert_int_equal(count_of(svg, "a4 4 0 1 0 8 0"), 5);
    free(svg);
}

static void strange_data_make_no_strange_plot(void **state)
{
    (void)state;
    static const double same[] = { 7, 7, 7 }, zero[] = { 0, 0, 0 }, none[] = { NAN, NAN, NAN };
    static const double far[] = { -1e308, 0, 1e308 }, tiny[] = { 5e-324, 1, 1e308 };
    const double *const kinds[] = { same, zero, none, far, tiny };
    for (size_t i = 0; i < LENGTH(kinds); i++)
        for (size_t j = 0; j < LENGTH(kinds); j++)
            for (int log = 0; log < 4; log++)
                for (size_t count = 0; count <= 3; count += 1 + (count == 1)) {
                    char *svg = svg_of_one(kinds[i], kinds[j], kinds[j], count, log & 1, log & 2,
                                           PLOT_LINE | PLOT_MARKERS | PLOT_DOTS);
                    expect_well_formed(svg);
                    assert_true(count_of(svg, "<text") < 60);
                    free(svg);
                }
}

static void names_are_text_and_never_markup(void **state)
{
    (void)state;
    const double one = 1;
    const struct plot_series series = { "a<b & \"c\" N^{-1/2}", PLOT_MARKERS, 1, &one, &one, NULL };
    char *svg = svg_of(&(struct plot){ .title = "</title><script>",
                                       .x = { .label = "<x>" },
                                       .y = { .label = "&amp;" },
                                       .series = &series,
                                       .series_count = 1 });
    expect_well_formed(svg);
    assert_null(strstr(svg, "<script"));
    assert_non_null(strstr(svg, "a&lt;b &amp; &quot;c&quot; N<tspan"));
    assert_non_null(strstr(svg, ">&amp;amp;<"));
    free(svg);
}

static void series_have_colours_and_shapes_of_their_own(void **state)
{
    (void)state;
    const double x[] = { 1, 2 };
    const struct plot_series series[] = {
        { "first", PLOT_MARKERS, 2, x, x, NULL },
        { "its theory", PLOT_DASHED | PLOT_SAME, 2, x, x, NULL },
        { "a level", PLOT_LINE | PLOT_GREY, 2, x, x, NULL },
        { "second", PLOT_MARKERS, 2, x, x, NULL },
    };
    char *svg = svg_of(&(struct plot){ .series = series, .series_count = 4 });
    expect_well_formed(svg);
    /* Three markers with fill and stroke; the dashes here and in the legend */
    assert_int_equal(count_of(svg, "#3b82c4"), 2 * 3 + 2);
    assert_int_equal(count_of(svg, "#c8741a"), 2 * 3);
    assert_int_equal(count_of(svg, "h7.2v7.2"), 3);
    free(svg);
}

static void lines_are_fitted_as_well_as_their_points_are_known(void **state)
{
    (void)state;
    /* Exactly on a line */
    const double x[] = { 1, 10, 100, 1000 }, relative[] = { .1, .1, .1, .1 };
    double y[4];
    for (int i = 0; i < 4; i++)
        y[i] = 3 / sqrt(x[i]);
    struct fit_line fit = fit_power(x, y, relative, 4);
    EXPECT_NEAR(fit.slope, -.5, 1e-12);
    EXPECT_NEAR(exp(fit.at_zero), 3, 1e-12);
    EXPECT_NEAR(fit.chi_square, 0, 1e-12);
    assert_true(isnan(fit_power(x, y, relative, 1).slope));

    /* With noise of a known size: slopes scatter by what each of them says */
    double sum = 0, squares = 0, chi_square = 0, stated = 0;
    const unsigned tries = 4000;
    for (unsigned t = 0; t < tries; t++) {
        double noisy[4], error[4];
        for (unsigned i = 0; i < 4; i++) {
            double uniform = hash64_unit(hash64_3(1, t, i));
            error[i] = .1 * (i + 1);
            noisy[i] = 2 + 5 * i + error[i] * sqrt(12) * (uniform - .5);
        }
        fit = fit_line((const double[]){ 0, 1, 2, 3 }, noisy, error, 4);
        sum += fit.slope;
        squares += (fit.slope - 5) * (fit.slope - 5);
        chi_square += fit.chi_square;
        stated = fit.slope_error;
    }
    EXPECT_NEAR(sum / tries, 5, 4 * stated / sqrt(tries));
    EXPECT_NEAR(sqrt(squares / tries) / stated, 1, .05);
    EXPECT_NEAR(chi_square / tries, 2, .15);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_check_of_tags_sees_what_is_wrong),
        cmocka_unit_test(logarithmic_axes_name_powers_of_ten),
        cmocka_unit_test(linear_axes_go_in_steps_of_one_two_or_five),
        cmocka_unit_test(numbers_that_cannot_be_shown_are_left_out),
        cmocka_unit_test(strange_data_make_no_strange_plot),
        cmocka_unit_test(names_are_text_and_never_markup),
        cmocka_unit_test(series_have_colours_and_shapes_of_their_own),
        cmocka_unit_test(lines_are_fitted_as_well_as_their_points_are_known),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
