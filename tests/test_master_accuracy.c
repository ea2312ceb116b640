/*
 * What `pathfarm accuracy` makes of its renders, without rendering: errors, variances and biases of
 * pictures whose noise is known, slopes and speeds of curves that are powers, lists, tables and the
 * page. With renders: farm-23-accuracy.sh.
 */
#include "common/err.h"
#include "common/hash.h"
#include "common/scene.h"
#include "master/accuracy_csv.h"
#include "master/accuracy_page.h"
#include "master/accuracy_peers.h"
#include "master/accuracy_run.h"
#include "master/image.h"
#include "tests/expect.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define SIDE 24

/* ---- pictures with a noise that is known */

/* About normal, with variance 1: the same for the same keys */
static double noise(uint64_t picture, uint64_t pixel, uint64_t channel)
{
    double sum = 0;
    for (uint64_t i = 0; i < 12; i++)
        sum += hash64_unit(hash64_3(picture * 12 + i, pixel, channel));
    return sum - 6;
}

static double truth_at(uint64_t pixel)
{
    return 0.05 + (double)(pixel % 7) * 0.3;
}

/* The truth, a relative bias and noise of a standard deviation relative to the weight; with error
 * layers, if it is a reference */
static struct image *picture(uint64_t seed, double bias, double sigma, bool reference)
{
    static const char *const NAMES[] = { "R", "G", "B", "stderr.R", "stderr.G", "stderr.B" };
    struct image *image = image_new(SIDE, SIDE);
    for (int c = 0; c < (reference ? 6 : 3); c++) {
        float *values = image_add_channel(image, NAMES[c]);
        assert_non_null(values);
        for (uint64_t p = 0; p < SIDE * SIDE; p++) {
            double r = truth_at(p), scale = sqrt(r * r + ACCURACY_EPSILON);
            double value = r + scale * (bias + sigma * noise(seed, p, (uint64_t)c));
            values[p] = (float)(c < 3 ? value : sigma * scale);
        }
    }
    return image;
}

static struct accuracy_point measured(uint64_t first_seed, size_t count, double bias, double sigma,
                                      const struct image *reference)
{
    struct image *images[16] = { NULL };
    struct accuracy_point point;
    for (size_t s = 0; s < count; s++)
        images[s] = picture(first_seed + s, bias, sigma, false);
    assert_true(accuracy_measure_pictures((const struct image *const *)images, count, reference,
                                          &point, NULL));
    for (size_t s = 0; s < count; s++)
        image_free(images[s]);
    return point;
}

static void error_variance_and_bias_come_out_with_errors_that_hold(void **state)
{
    (void)state;
    struct image *reference = picture(1, 0, 0.05, true);
    EXPECT_NEAR(accuracy_measure_reference(reference), 0.05 * 0.05, 2e-5);
    const double sigma = 0.3;
    for (int planted = 0; planted < 2; planted++) {
        const double bias = planted ? 0.06 : 0;
        double relmse_z2 = 0, bias_z = 0, bias_z2 = 0;
        enum { TRIALS = 60 };
        for (uint64_t trial = 0; trial < TRIALS; trial++) {
            struct accuracy_point p = measured(100 + 4 * trial, 4, bias, sigma, reference);
            assert_int_equal(p.pixels, SIDE * SIDE);
            EXPECT_NEAR(p.variance, sigma * sigma, 0.012);
            EXPECT_NEAR(p.relmse - p.variance, p.bias2, 1e-12);
            double z = (p.relmse - sigma * sigma - bias * bias) / p.relmse_error;
            relmse_z2 += z * z / TRIALS;
            z = p.bias2 / p.bias2_error;
            bias_z += z / TRIALS;
            bias_z2 += z * z / TRIALS;
        }
        assert_true(relmse_z2 > 0.6 && relmse_z2 < 1.5);
        if (planted) /* a bias of a fifth of the noise is seen in each single trial's sum */
            assert_true(bias_z > 2);
        else
            assert_true(fabs(bias_z) < 0.6 && bias_z2 > 0.5 && bias_z2 < 1.6);
    }
    image_free(reference);
}

/* Planted: the reference's own noise, when it does not say how noisy it is, looks like a bias */
static void what_a_reference_does_not_say_looks_like_bias(void **state)
{
    (void)state;
    struct image *silent = picture(1, 0, 0.2, false), *honest = picture(1, 0, 0.2, true);
    assert_true(isnan(accuracy_measure_reference(silent)));
    struct accuracy_point a = measured(50, 8, 0, 0.1, silent), b = measured(50, 8, 0, 0.1, honest);
    EXPECT_NEAR(a.bias2, 0.04, 4 * a.bias2_error);
    assert_true(a.bias2 > 8 * a.bias2_error);
    EXPECT_NEAR(b.bias2, 0, 4 * b.bias2_error);
    image_free(silent);
    image_free(honest);
}

static void pixels_that_are_not_finite_are_left_out_and_counted(void **state)
{
    (void)state;
    struct image *reference = picture(1, 0, 0, true), *a = picture(2, 0, 0.1, false),
                 *b = picture(3, 0, 0.1, false);
    image_channel(a, "G")[5] = INFINITY;
    image_channel(b, "B")[5] = NAN;
    image_channel(reference, "R")[9] = NAN;
    const struct image *const both[] = { a, b };
    struct accuracy_point p;
    assert_true(accuracy_measure_pictures(both, 2, reference, &p, NULL));
    assert_int_equal(p.skipped, 2);
    assert_int_equal(p.pixels, SIDE * SIDE - 2);
    assert_true(isfinite(p.relmse + p.relmse_error + p.variance + p.bias2 + p.bias2_error));

    assert_true(accuracy_measure_pictures(both, 1, reference, &p, NULL)); /* alone: no errors */
    assert_true(isfinite(p.relmse) && isnan(p.relmse_error) && isnan(p.bias2));
    struct image *smaller = image_new(SIDE, SIDE - 1);
    struct err err;
    assert_false(accuracy_measure_pictures(both, 2, smaller, &p, &err));
    assert_non_null(strstr(err.text, "24x23"));
    image_free(smaller);
    image_free(reference);
    image_free(a);
    image_free(b);
}

/* ---- curves */

/* relMSE = scale t^slope at the times first, 2 first, ... */
static struct accuracy_curve power(double scale, double slope, double first, size_t count)
{
    struct accuracy_curve curve = { .setup = &accuracy_setup_table[1], .seeds = 4, .count = count };
    for (size_t i = 0; i < count; i++) {
        double t = first * (double)(1u << i), e = scale * pow(t, slope);
        curve.rungs[i] = (struct accuracy_rung){
            .facts = { .spp = 1u << i, .replicates = 4, .core_s = t, .wall_s = 2 * t },
            .point = { .relmse = e, .relmse_error = e / 20, .variance = e, .pixels = 9 },
        };
    }
    return curve;
}

static void slopes_and_speeds_of_powers_are_found(void **state)
{
    (void)state;
    struct accuracy_curve base = power(0.01, -1, 0.01, 8), fast = power(0.0025, -1, 0.013, 8),
                          steep = power(0.002, -1.5, 0.01, 8);
    base.setup = &accuracy_setup_table[0];
    accuracy_curve_finish(&base, &base);
    accuracy_curve_finish(&fast, &base);
    accuracy_curve_finish(&steep, &base);
    EXPECT_NEAR(base.slope.value, -1, 1e-9);
    EXPECT_NEAR(steep.slope.value, -1.5, 1e-9);
    assert_true(base.slope.error > 0.005 && base.slope.error < 0.02);
    EXPECT_NEAR(base.speedup.value, 1, 1e-9);
    EXPECT_NEAR(fast.speedup.value, 4, 1e-9);
    EXPECT_NEAR(fast.speedup.error, 4 * hypot(0.05, 0.05), 0.08);
    EXPECT_NEAR(fast.at_relmse, 0.01 / 1.28, 1e-9);
    EXPECT_NEAR(accuracy_curve_time(&base, 0.05).value, 0.2, 1e-9);
    EXPECT_NEAR(accuracy_curve_error(&base, 0.2).value, 0.05, 1e-9);
    EXPECT_NEAR(accuracy_curve_ttuv(&base.rungs[3]), 0.01, 1e-9);
}

static void nothing_is_said_beyond_the_ends_of_a_curve(void **state)
{
    (void)state;
    struct accuracy_curve base = power(0.01, -1, 0.01, 8), hopeless = power(10, -1, 0.01, 8),
                          short_one = power(0.01, -1, 0.01, 2), none = power(1, -1, 1, 0);
    accuracy_curve_finish(&hopeless, &base);
    assert_true(isnan(hopeless.speedup.value));
    EXPECT_NEAR(hopeless.speedup_below, 1.0 / 128, 1e-9);
    assert_true(hopeless.speedup_below > 0.001); /* the truth: it is a bound */
    hopeless.rungs[7].point.relmse = 0.3;        /* and none where it may be better than it seems */
    hopeless.rungs[7].point.relmse_error = 0.2;
    accuracy_curve_finish(&hopeless, &base);
    assert_true(isnan(hopeless.speedup.value) && isnan(hopeless.speedup_below));
    EXPECT_NEAR(accuracy_curve_error(&hopeless, 1.28).error, 0.2, 1e-9);
    accuracy_curve_finish(&short_one, &base);
    assert_true(isnan(short_one.slope.value));
    EXPECT_NEAR(short_one.speedup.value, 1, 1e-9);
    accuracy_curve_finish(&none, &base);
    assert_true(isnan(none.slope.value) && isnan(none.speedup.value) && isnan(none.speedup_below));
    assert_true(isnan(accuracy_curve_time(&base, 2).value));
    assert_true(isnan(accuracy_curve_error(&base, 0.001).value));

    base.rungs[7].point.relmse = -1e-4; /* below the reference's noise: not used */
    accuracy_curve_finish(&base, &base);
    EXPECT_NEAR(base.slope.value, -1, 1e-9);
    EXPECT_NEAR(base.at_relmse, base.rungs[6].point.relmse, 0);
    base.rungs[2].point.relmse *= 2; /* off the line by more than its error: a vaguer slope */
    double before = base.slope.error;
    accuracy_curve_finish(&base, &base);
    assert_true(base.slope.error > 2 * before);
}

/* ---- lists */

static void configurations_are_chosen_by_name_with_the_default_first(void **state)
{
    (void)state;
    const struct accuracy_setup *chosen[ACCURACY_SETUPS_MAX];
    size_t count;
    struct err err;
    assert_true(accuracy_setup_choose(NULL, chosen, &count, &err));
    assert_int_equal(count, accuracy_setup_count);
    assert_true(accuracy_setup_choose("no-mis,independent", chosen, &count, &err));
    assert_int_equal(count, 3);
    assert_string_equal(chosen[0]->name, "default");
    assert_string_equal(chosen[1]->name, "independent");
    assert_string_equal(chosen[2]->name, "no-mis");
    assert_false(accuracy_setup_choose("no-mis,halten", chosen, &count, &err));
    assert_string_equal(err.text, "there is no configuration \"halten\"; the nearest is halton");
    assert_false(accuracy_setup_choose("", chosen, &count, &err));
}

static void peers_are_points_and_wrong_ones_are_refused(void **state)
{
    (void)state;
    struct accuracy_peers peers = { .count = 0 };
    struct err err;
    assert_true(accuracy_peers_add(&peers, "Cycles 3.4=25.6,0.00176", &err));
    assert_string_equal(peers.points[0].name, "Cycles 3.4");
    EXPECT_NEAR(peers.points[0].core_s, 25.6, 0);
    EXPECT_NEAR(peers.points[0].relmse, 0.00176, 0);
    static const char *const wrong[] = { "",        "a",       "a=1",   "=1,2",
                                         "a=1,2,3", "a=x,1",   "a=0,1", "a=1,-1",
                                         "a=1,nan", "a=inf,1", "a=1," };
    for (size_t i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++)
        if (accuracy_peers_add(&peers, wrong[i], &err))
            fail_msg("\"%s\" is taken", wrong[i]);
    assert_int_equal(peers.count, 1);

    char folder[256];
    scratch_make(folder);
    const char *path = scratch_path(folder, "peers.csv");
    static const char csv[] = "name,core_seconds,relmse\nA,1,0.5\r\n\nB,2,0.25";
    scratch_write(path, csv, sizeof(csv) - 1);
    assert_true(accuracy_peers_read(&peers, path, &err));
    assert_int_equal(peers.count, 3);
    EXPECT_NEAR(peers.points[2].relmse, 0.25, 0);
    FILE *file = fopen(path, "a");
    fputs("\nC;3;4\n", file);
    fclose(file);
    assert_false(accuracy_peers_read(&peers, path, &err));
    assert_non_null(strstr(err.text, "peers.csv:5:"));
    scratch_remove(folder);
}

/* ---- what is written */

static struct accuracy_study study_of(struct accuracy_curve *curves, size_t count)
{
    struct accuracy_study study = { .reference = picture(1, 0, 0.01, true),
                                    .reference_spp = 4096,
                                    .reference_core_s = 12,
                                    .reference_variance = 1e-4,
                                    .curves = curves,
                                    .curve_count = count,
                                    .window = { 0, 0, SIDE },
                                    .window_reference = picture(1, 0, 0.01, false) };
    for (size_t i = 0; i < count; i++) {
        curves[i].setup = &accuracy_setup_table[i];
        accuracy_curve_finish(&curves[i], &curves[0]);
    }
    return study;
}

static char *text_of(const struct accuracy_study *study, const struct accuracy_peers *peers,
                     void (*write)(const struct accuracy_study *, const struct accuracy_peers *,
                                   FILE *))
{
    char *text;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    write(study, peers, out);
    fclose(out);
    return text;
}

/* Fields of a CSV line, quoted ones counted as one; *line is moved to the next */
static size_t fields(const char **line)
{
    size_t count = 1;
    bool quoted = false;
    for (; **line != '\0' && (quoted || **line != '\n'); (*line)++) {
        quoted ^= **line == '"';
        count += !quoted && **line == ',';
    }
    *line += **line == '\n';
    return count;
}

static void the_csv_has_a_row_per_rung_and_leaves_the_unknown_empty(void **state)
{
    (void)state;
    struct accuracy_curve curves[2] = { power(0.01, -1, 0.01, 8), power(10, -1, 0.01, 5) };
    struct accuracy_study study = study_of(curves, 2);
    struct accuracy_peers peers = { .count = 0 };
    assert_true(accuracy_peers_add(&peers, "a \"peer\", so called=2,0.5", NULL));
    char *text = text_of(&study, &peers, accuracy_csv_write);
    const char *at = text;
    size_t columns = fields(&at), rows = 0;
    assert_int_equal(columns, 23);
    for (; *at != '\0'; rows++)
        assert_int_equal(fields(&at), columns);
    assert_int_equal(rows, 8 + 5 + 1);
    assert_non_null(
        strstr(text, "\ndefault,default,1,4,4,0.01,0.02,1,0.05,0.902,1.098,1,0,0,0.01,"));
    assert_non_null(strstr(text, "\n\"a \"\"peer\"\", so called\",peer,,,,2,,0.5,,"));
    assert_null(strstr(text, "nan"));
    assert_null(strstr(text, "inf"));
    free(text);
    image_free(study.reference);
    image_free(study.window_reference);
}

static size_t times_in(const char *text, const char *word)
{
    size_t count = 0;
    for (; *text != '\0'; text++)
        count += strncmp(text, word, strlen(word)) == 0;
    return count;
}

static void the_page_stands_alone_and_says_what_was_left_out(void **state)
{
    (void)state;
    struct accuracy_curve curves[7] = { power(0.01, -1, 0.01, 8), power(0.02, -1, 0.01, 8),
                                        power(0.03, -1, 0.01, 8), power(0.04, -1, 0.01, 8),
                                        power(0.05, -1, 0.01, 8), power(0.06, -1, 0.01, 0),
                                        power(10, -1, 0.01, 8) };
    curves[5].refusal = "the scene has lights that no path finds by itself";
    curves[0].crops[0] = picture(9, 0, 0.5, false);
    curves[0].crop_spp[0] = 1;
    struct accuracy_study study = study_of(curves, 7);
    struct accuracy_peers peers = { .count = 0 };
    assert_true(accuracy_peers_add(&peers, "<Cycles>=2,0.5", NULL));
    assert_true(accuracy_peers_add(&peers, "<Cycles>=4,0.25", NULL));
    const struct accuracy_facts facts = { "scenes/a&b.pbrt", "pathfarm accuracy scenes/a&b.pbrt",
                                          2 };
    char folder[256];
    scratch_make(folder);
    const char *path = scratch_path(folder, "accuracy.html");
    assert_true(accuracy_page_write(&study, &peers, &facts, path, NULL));

    FILE *file = fopen(path, "r");
    char *page = calloc(1, 1 << 20);
    assert_true(fread(page, 1, (1 << 20) - 1, file) > 1000);
    fclose(file);
    scratch_remove(folder);
    static const char *const wanted[] = { "a&amp;b.pbrt",   "data:image/png;base64,",
                                          "&lt;Cycles&gt;", "Left out",
                                          "no path finds",  "below 0.0078",
                                          "</html>",        "4096 samples",
                                          "TTUV",           "0.250 ± 0.018" };
    for (size_t i = 0; i < sizeof(wanted) / sizeof(wanted[0]); i++)
        if (strstr(page, wanted[i]) == NULL)
            fail_msg("the page lacks %s", wanted[i]);
    static const char *const unwanted[] = { "<script", "href=\"http", "src=\"http",
                                            "url(",    "nan",         "<Cycles>" };
    for (size_t i = 0; i < sizeof(unwanted) / sizeof(unwanted[0]); i++)
        if (strstr(page, unwanted[i]) != NULL)
            fail_msg("the page has %s", unwanted[i]);
    free(page);

    char *svg = text_of(&study, &peers, accuracy_page_plot);
    assert_memory_equal(svg, "<svg xmlns", 10);
    assert_non_null(strstr(svg, "default: -1.00"));
    assert_int_equal(times_in(svg, "&lt;Cycles&gt;"), 1); /* its points are one series */
    free(svg);
    image_free(study.reference);
    image_free(study.window_reference);
    image_free(curves[0].crops[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(error_variance_and_bias_come_out_with_errors_that_hold),
        cmocka_unit_test(what_a_reference_does_not_say_looks_like_bias),
        cmocka_unit_test(pixels_that_are_not_finite_are_left_out_and_counted),
        cmocka_unit_test(slopes_and_speeds_of_powers_are_found),
        cmocka_unit_test(nothing_is_said_beyond_the_ends_of_a_curve),
        cmocka_unit_test(configurations_are_chosen_by_name_with_the_default_first),
        cmocka_unit_test(peers_are_points_and_wrong_ones_are_refused),
        cmocka_unit_test(the_csv_has_a_row_per_rung_and_leaves_the_unknown_empty),
        cmocka_unit_test(the_page_stands_alone_and_says_what_was_left_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
