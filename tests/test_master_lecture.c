/* Goal: the lecture's experiments come out as theory says, each judged in its standard errors, and
 * each check is shown to refuse a bug. */
#include "common/err.h"
#include "common/moments.h"
#include "common/sampler.h"
#include "master/cmd_lecture.h"
#include "master/lecture_caster.h"
#include "master/lecture_directions.h"
#include "master/lecture_integrals.h"
#include "master/lecture_light.h"
#include "master/lecture_points.h"
#include "master/lecture_roulette.h"
#include "master/page.h"
#include "tests/balanced.h"
#include "tests/expect.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#define LENGTH(array) (sizeof(array) / sizeof((array)[0]))

/* ---- integrals */

/* Standard errors between the mean of many estimates and the truth */
static double distance(lecture_estimate *estimate, const void *self, double truth, uint64_t n)
{
    struct moments m = { 0 };
    for (uint64_t run = 0; run < 400; run++) {
        struct lecture_dice dice = lecture_dice(1, n, run);
        moments_add(&m, estimate(self, n, &dice));
    }
    return fabs(m.mean - truth) / moments_stderr(&m);
}

/* Planted: the density of uniform samples over [0, 2] taken for that over [0, 1] */
static double without_density(const void *self, uint64_t n, struct lecture_dice *dice)
{
    return lecture_integrals_random(self, n, dice) / 2;
}

/* Planted: samples of all strata but the last */
static double without_the_last(const void *self, uint64_t n, struct lecture_dice *dice)
{
    const struct lecture_integrand *of = self;
    struct lecture_integrand less = *of;
    less.high = of->low + (of->high - of->low) * (double)(n - 1) / (double)n;
    return lecture_integrals_stratified(&less, n - 1, dice) * (double)n / (double)(n - 1);
}

/* Planted: two points that were not counted */
static double pi_too_large(const void *self, uint64_t n, struct lecture_dice *dice)
{
    return lecture_integrals_pi_random(self, n, dice) * (double)(n + 2) / (double)n;
}

static const struct lecture_integrand POLYNOMIAL = { lecture_integrals_5x4, 0, 1 };
static const struct lecture_integrand TWICE = { lecture_integrals_5x4, 0, 2 };
static const struct lecture_integrand WAVE = { lecture_integrals_wave, 0, 1 };

static void integrals_are_right_within_their_errors(void **state)
{
    (void)state;
    const double wave = 1.7760990452428;
    assert_true(distance(lecture_integrals_random, &POLYNOMIAL, 1, 100) < 4);
    assert_true(distance(lecture_integrals_stratified, &POLYNOMIAL, 1, 100) < 4);
    assert_true(distance(lecture_integrals_random, &TWICE, 32, 100) < 4);
    assert_true(distance(lecture_integrals_stratified, &TWICE, 32, 100) < 4);
    assert_true(distance(lecture_integrals_random, &WAVE, wave, 100) < 4);
    assert_true(distance(lecture_integrals_stratified, &WAVE, wave, 100) < 4);
    assert_true(distance(lecture_integrals_pi_random, NULL, LECTURE_PI, 100) < 4);
    assert_true(distance(lecture_integrals_pi_stratified, NULL, LECTURE_PI, 100) < 4);
    assert_true(distance(lecture_integrals_smooth_stratified, NULL, 2.9524924420125598, 100) < 4);

    assert_true(distance(without_density, &TWICE, 32, 100) > 8);
    assert_true(distance(without_the_last, &WAVE, wave, 100) > 8);
    assert_true(distance(pi_too_large, NULL, LECTURE_PI, 50) > 4.5);
    /* And the slide's first number is nobody's */
    assert_true(distance(lecture_integrals_random, &WAVE, 2.75039, 100) > 100);
}

static void samples_of_their_own_density_have_no_variance(void **state)
{
    (void)state;
    struct lecture_dice dice = lecture_dice(1, 2, 3);
    struct moments values = lecture_integrals_importance(10000, &dice);
    assert_true(values.mean == 1);
    assert_true(moments_variance(&values) == 0);

    /* Also where the generator gives 0 */
    const double zero = 0;
    dice = (struct lecture_dice){ .given = &zero, .given_count = 1 };
    assert_true(lecture_integrals_importance(1, &dice).mean == 1);
}

static void the_theory_of_the_wave_is_what_others_computed(void **state)
{
    (void)state;
    struct lecture_wave wave = lecture_integrals_wave_theory();
    EXPECT_NEAR(wave.integral, 1.7760990452428, 1e-12);
    EXPECT_NEAR(wave.sigma, .600214543929, 1e-11);
    EXPECT_NEAR(wave.stratified_scale, 1.16117974349, 1e-10);
}

/* The slope of the RMSE between 64 and 16384 samples, in standard errors from what it should be */
static double slope_distance(lecture_estimate *estimate, const void *self, double truth,
                             double slope)
{
    struct lecture_rate rate = { 0 };
    for (uint64_t n = 64; n <= 16384; n *= 4)
        lecture_rate_add(&rate, estimate, self, truth, n, 200, lecture_dice(1, 5, 0));
    struct fit_line fit = lecture_rate_fit(&rate, 0);
    return fabs(fit.slope - slope) / fit.slope_error;
}

static void errors_fall_at_the_rates_of_theory(void **state)
{
    (void)state;
    const double wave = lecture_integrals_wave_theory().integral;
    assert_true(slope_distance(lecture_integrals_random, &WAVE, wave, -.5) < 4);
    assert_true(slope_distance(lecture_integrals_stratified, &WAVE, wave, -1.5) < 4);
    assert_true(slope_distance(lecture_integrals_pi_random, NULL, LECTURE_PI, -.5) < 4);
    assert_true(slope_distance(lecture_integrals_pi_stratified, NULL, LECTURE_PI, -.75) < 4);
    assert_true(slope_distance(lecture_integrals_smooth_stratified, NULL, 2.9524924420125598, -1) <
                4);

    /* The slide's rate, and a bias of 1/n, are told from it */
    assert_true(slope_distance(lecture_integrals_stratified, &WAVE, wave, -1) > 8);
    assert_true(slope_distance(without_the_last, &WAVE, wave, -1.5) > 8);
}

static void rand_of_the_slide_reaches_one(void **state)
{
    (void)state;
    assert_int_equal(lecture_integrals_rand_ones(), 64);
    for (uint64_t i = 0; i < 100000; i++) {
        struct lecture_dice dice = lecture_dice(1, 6, i);
        double u = lecture_roll(&dice);
        assert_true(u >= 0 && u < 1);
    }
}

/* ---- points */

static void halton_mirrors_digits(void **state)
{
    (void)state;
    EXPECT_NEAR(lecture_points_halton(0, 2), 0, 0);
    EXPECT_NEAR(lecture_points_halton(1, 2), .5, 0);
    EXPECT_NEAR(lecture_points_halton(6, 2), .375, 0);
    EXPECT_NEAR(lecture_points_halton(5, 3), 7 / 9., 1e-16);
    assert_true(lecture_points_halton(UINT32_MAX, 2) < 1);
    /* As C reads the slide */
    EXPECT_NEAR(lecture_points_halton_integers(6, 2), 0, 0);
    EXPECT_NEAR(lecture_points_halton_float(6, 2), .375, 0);
    EXPECT_NEAR(lecture_points_halton_float(UINT32_MAX, 2), 1, 0);
}

/* By trying every box that ends at points' coordinates, open and closed */
static double star_by_trying(const double (*points)[2], uint32_t n)
{
    double worst = 0;
    for (uint32_t i = 0; i <= n; i++)
        for (uint32_t j = 0; j <= n; j++) {
            double x = i < n ? points[i][0] : 1, y = j < n ? points[j][1] : 1;
            uint32_t open = 0, closed = 0;
            for (uint32_t k = 0; k < n; k++) {
                open += points[k][0] < x && points[k][1] < y;
                closed += points[k][0] <= x && points[k][1] <= y;
            }
            worst = fmax(worst, fmax(x * y - open / (double)n, closed / (double)n - x * y));
        }
    return worst;
}

static void discrepancy_is_what_its_definition_says(void **state)
{
    (void)state;
    const double middle[1][2] = { { .5, .5 } };
    EXPECT_NEAR(lecture_points_star(middle, 1), .75, 0);
    for (uint32_t n = 1; n <= 40; n += 13) {
        double points[40][2];
        for (int kind = 0; kind < LECTURE_POINTS_COUNT; kind++) {
            lecture_points_fill(kind, SAMPLE_PIXEL, 1, n, n, points);
            EXPECT_NEAR(lecture_points_star((const double(*)[2])points, n),
                        star_by_trying((const double(*)[2])points, n), 1e-15);
        }
        for (uint32_t i = 0; i < n; i++) /* with ties */
            points[i][0] = points[i][1] = floor(4 * points[i][0]) / 4;
        EXPECT_NEAR(lecture_points_star((const double(*)[2])points, n),
                    star_by_trying((const double(*)[2])points, n), 1e-15);
    }

    /* Random points: the mean square is (1/4 - 1/9) / n */
    struct moments squares = { 0 };
    double points[64][2];
    for (uint64_t run = 0; run < 2000; run++) {
        lecture_points_fill(LECTURE_POINTS_RANDOM, SAMPLE_PIXEL, 1, run, 64, points);
        double l2 = lecture_points_l2((const double(*)[2])points, 64);
        moments_add(&squares, l2 * l2);
    }
    EXPECT_NEAR(squares.mean, (1 / 4. - 1 / 9.) / 64, 4 * moments_stderr(&squares));
    assert_true(fabs(squares.mean - 1 / 4. / 64) > 8 * moments_stderr(&squares));
}

static void strata_hold_one_point_each_and_sobol_too(void **state)
{
    (void)state;
    static const int kinds[] = { LECTURE_POINTS_STRATIFIED, LECTURE_POINTS_SOBOL,
                                 LECTURE_POINTS_RANDOM };
    for (size_t k = 0; k < LENGTH(kinds); k++) {
        double points[256][2];
        unsigned counts[256] = { 0 }, empty = 0;
        lecture_points_fill(kinds[k], SAMPLE_PIXEL, 1, 0, 256, points);
        for (int i = 0; i < 256; i++)
            counts[(int)(16 * points[i][1]) * 16 + (int)(16 * points[i][0])]++;
        for (int i = 0; i < 256; i++)
            empty += counts[i] == 0;
        if (kinds[k] == LECTURE_POINTS_RANDOM)
            assert_true(empty > 60); /* e^-1 of them */
        else
            assert_int_equal(empty, 0);
    }
}

/* ---- directions */

static void hemispheres_are_covered_as_they_claim(void **state)
{
    (void)state;
    const uint64_t n = 100000;
    const double accepted = LECTURE_PI / 6;
    for (int how = 0; how < LECTURE_HEMISPHERE_COUNT; how++) {
        struct lecture_hemisphere_result r = lecture_directions_measure(
            how, n, lecture_dice(1, 7, (uint64_t)how));
        if (how == LECTURE_HEMISPHERE_CUBE) { /* the planted bug */
            assert_true(r.p < 1e-12);
            assert_true(fabs(r.integral - LECTURE_PI) > 8 * r.integral_error);
            continue;
        }
        assert_true(r.p > 1e-4);
        EXPECT_NEAR(r.integral, LECTURE_PI, 4 * r.integral_error + 1e-9);
        EXPECT_NEAR(r.mean_z, how == LECTURE_HEMISPHERE_COSINE ? 2 / 3. : .5,
                    4 * .289 / sqrt((double)n));
        bool rejects = how == LECTURE_HEMISPHERE_REJECTION;
        /* Tries are geometric: variance (1 - p) / p^2 */
        EXPECT_NEAR(r.tries, rejects ? 1 / accepted : 1,
                    rejects ? 4 * sqrt((1 - accepted) / (double)n) / accepted : 0);
        EXPECT_NEAR(r.numbers, rejects ? 3 * r.tries : 2, 1e-12);
    }
}

static void the_zero_vector_is_rejected(void **state)
{
    (void)state;
    const double given[6] = { .5, .5, 0, .5, .5, .25 };
    struct lecture_dice dice = { .given = given, .given_count = 6 };
    unsigned tries;
    lecture_vec w = lecture_directions_hemisphere(LECTURE_HEMISPHERE_REJECTION, &dice, &tries);
    assert_int_equal(tries, 2);
    EXPECT_NEAR(w[2], 1, 0);
}

static const struct lecture_polygon TRIANGLE = { 3, { { 0, 0 }, { 1, .2 }, { .3, .8 } } };
static const struct lecture_polygon SQUARE = { 4, { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 1 } } };
static const struct lecture_polygon HEXAGON = {
    6, { { .2, 0 }, { .7, .1 }, { 1, .5 }, { .9, .9 }, { .4, 1 }, { 0, .6 } }
};

static void polygons_are_covered_evenly_but_for_barycentric_weights(void **state)
{
    (void)state;
    const struct lecture_polygon *const polygons[] = { &TRIANGLE, &SQUARE, &HEXAGON };
    for (size_t i = 0; i < LENGTH(polygons); i++)
        for (int how = 0; how < LECTURE_POLYGON_COUNT; how++) {
            bool barycentric = how == LECTURE_POLYGON_BARYCENTRIC;
            const uint64_t n = barycentric ? 4000 : 40000;
            struct lecture_polygon_result r = lecture_directions_measure_polygon(
                how, polygons[i], n, lecture_dice(1, 8 + i, (uint64_t)how));
            if (barycentric && polygons[i]->corners > 3) {
                assert_true(r.p < 1e-12);
                assert_true(r.inner > .6);
                continue;
            }
            assert_true(r.p > 1e-4);
            EXPECT_NEAR(r.inner, .5, 4 * .5 / sqrt((double)n));
            if (how == LECTURE_POLYGON_RECTANGLE) {
                double share = lecture_directions_share(polygons[i]);
                EXPECT_NEAR(r.acceptance, share, 4 * sqrt(share * (1 - share) / (double)n));
            }
        }
    EXPECT_NEAR(lecture_directions_share(&SQUARE), 1, 0);
    assert_int_equal(lecture_directions_exact_sums(5, 200000, lecture_dice(1, 9, 0)), 0);
}

/* ---- the caster */

#define ONES LECTURE_VEC(1, 1, 1)

static lecture_vec white_sky(lecture_vec d)
{
    (void)d;
    return ONES;
}

/* Moments of the radiance along one ray */
static struct moments look(const struct caster_scene *scene, const struct caster_how *how,
                           lecture_vec o, lecture_vec d, unsigned n)
{
    struct moments m = { 0 };
    for (unsigned i = 0; i < n; i++) {
        struct lecture_dice dice = lecture_dice(2, 0, i);
        struct caster_counts counts = { 0 };
        moments_add(&m, lecture_caster_radiance(scene, how, o, d, 0, &dice, &counts)[1]);
    }
    return m;
}

static void a_square_light_lights_as_its_form_factor_says(void **state)
{
    (void)state;
    const double truth = .6 * .239456470461; /* albedo x F of a unit square at distance 1 */
    const struct caster_object objects[] = {
        { .at = { -.5, 1, -.5 },
          .u = { 1, 0, 0 },
          .v = { 0, 0, 1 },
          .surface = { .emission = { 1, 1, 1 }, .exponent = 1 } },
        { .at = { -5, 0, 5 },
          .u = { 10, 0, 0 },
          .v = { 0, 0, -10 },
          .surface = { .kd = { .6, .6, .6 }, .exponent = 1 } },
    };
    struct caster_scene scene = { .objects = objects, .object_count = 2, .light = 0 };
    const lecture_vec o = { 0, .5, 0 }, down = { 0, -1, 0 };
    static const struct caster_how ways[] = {
        { .light_sampling = true }, { .light_sampling = false }, { .uniform = true },
        { .branches = 4 },          { .survival = .3 },          { .survival = 1, .max_depth = 1 },
    };
    for (size_t i = 0; i < LENGTH(ways); i++) {
        struct moments m = look(&scene, &ways[i], o, down, 40000);
        EXPECT_NEAR(m.mean, truth, 4 * moments_stderr(&m));
    }

    /* Planted: a light that is a little larger than its theory */
    struct caster_object larger[2] = { objects[0], objects[1] };
    larger[0].at = LECTURE_VEC(-.51, 1, -.51);
    larger[0].u *= 1.02;
    larger[0].v *= 1.02;
    scene.objects = larger;
    struct moments m = look(&scene, &ways[0], o, down, 40000);
    assert_true(fabs(m.mean - truth) > 8 * moments_stderr(&m));
}

static void glossy_directions_reflect_the_same_as_uniform_ones(void **state)
{
    (void)state;
    const struct caster_object ball = {
        .sphere = true,
        .radius = 1,
        .surface = { .kd = { .2, .2, .2 }, .ks = { .6, .6, .6 }, .exponent = 9 }
    };
    struct caster_scene scene = {
        .objects = &ball, .object_count = 1, .light = -1, .sky = white_sky
    };
    const lecture_vec o = { .6, 0, 5 }, forward = { 0, 0, -1 };
    struct moments own = look(&scene, &(struct caster_how){ .survival = 1 }, o, forward, 100000);
    struct moments uniform = look(&scene, &(struct caster_how){ .survival = 1, .uniform = true }, o,
                                  forward, 100000);
    double error = sqrt(moments_variance(&own) / 1e5 + moments_variance(&uniform) / 1e5);
    EXPECT_NEAR(own.mean, uniform.mean, 4 * error);
    assert_true(own.mean < .8 * 11 / 10 && own.mean > .2);
    assert_true(moments_variance(&own) < moments_variance(&uniform));

    /* Planted: the lobe's factor n + 2 taken for n + 1 */
    double bug = .2 + (own.mean - .2) * 10 / 11;
    assert_true(fabs(bug - uniform.mean) > 8 * error);
}

static void a_black_surface_absorbs(void **state)
{
    (void)state;
    const struct caster_surface black = { .exponent = INFINITY };
    const lecture_vec up = { 0, 1, 0 };
    struct lecture_dice dice = lecture_dice(1, 1, 1);
    lecture_vec wi, weight;
    bool diffuse;
    assert_false(lecture_caster_reflect(&black, up, up, &dice, &wi, &weight, &diffuse));
    assert_true(isnan(black.kd[0] / (black.kd[0] + black.ks[0]))); /* what the slide would use */
}

static void trees_have_as_many_rays_as_powers_say(void **state)
{
    (void)state;
    const struct caster_object ball = { .sphere = true,
                                        .radius = 3,
                                        .surface = { .kd = { .5, .5, .5 }, .exponent = 1 } };
    struct caster_scene scene = {
        .objects = &ball, .object_count = 1, .light = -1, .target = { 0, 0, 1 }, .tan_half_fov = .5
    };
    for (unsigned branches = 1; branches <= 4; branches++) {
        double rays[CASTER_DEPTHS], expected = 1;
        lecture_light_tree(&scene, branches, 5, 3, lecture_dice(1, 1, branches), rays);
        for (unsigned d = 0; d <= 5; d++, expected *= branches)
            EXPECT_NEAR(rays[d], expected, 0);
        EXPECT_NEAR(rays[6], 0, 0);
    }

    /* In the room, too, no ray is lost: only what hits the light ends */
    scene = lecture_light_room(false);
    double rays[CASTER_DEPTHS];
    lecture_light_tree(&scene, 1, 8, 20000, lecture_dice(1, 2, 0), rays);
    for (unsigned d = 1; d <= 8; d++) {
        double end = rays[d - 1] - rays[d];
        assert_true(end >= 0 && end < .08 * rays[d - 1]);
    }
}

static void pictures_agree_whatever_way_they_are_made(void **state)
{
    (void)state;
    struct caster_scene room = lecture_light_room(false);
    static const struct caster_how ways[] = {
        { .light_sampling = true },
        { .light_sampling = false },
        { .light_sampling = true, .survival = .5 },
        { .light_sampling = true, .max_depth = 1, .survival = 1 }, /* planted: a cap */
    };
    double mean[4], error[4], rmse[4];
    for (size_t i = 0; i < LENGTH(ways); i++) {
        struct lecture_pair pair = lecture_light_pair(&room, &ways[i], 16, 128, 100 + i);
        mean[i] = lecture_light_mean(&pair);
        error[i] = lecture_light_mean_error(&pair);
        rmse[i] = lecture_light_rmse(&pair);
        lecture_light_pair_free(&pair);
    }
    EXPECT_NEAR(mean[1], mean[0], 4 * hypot(error[0], error[1]));
    EXPECT_NEAR(mean[2], mean[0], 4 * hypot(error[0], error[2]));
    assert_true(mean[0] - mean[3] > 8 * hypot(error[0], error[3]));
    assert_true(rmse[0] < .5 * rmse[1]);
}

/* ---- Russian roulette */

static void russian_roulette_is_unbiased(void **state)
{
    (void)state;
    for (double q = .4; q < .95; q += .1) {
        double error;
        struct lecture_furnace want = lecture_roulette_theory(.5, q);
        struct lecture_furnace got = lecture_roulette_measure(
            .5, q, 200000, lecture_dice(1, 10, (uint64_t)(q * 10)), &error);
        EXPECT_NEAR(want.mean, 2, 1e-12);
        EXPECT_NEAR(got.mean, 2, 4 * error);
        EXPECT_NEAR(got.variance, want.variance,
                    q < .55 ? .3 * want.variance : .05 * want.variance);
        EXPECT_NEAR(got.walls, want.walls, .02 * want.walls);

        /* Planted: survivors that are not weighted by 1 / q add up to 1 / (1 - q albedo) */
        assert_true(fabs(1 / (1 - .5 * q) - got.mean) > 8 * error);
    }
    assert_true(isinf(lecture_roulette_theory(.5, .25).variance));
    assert_true(isfinite(lecture_roulette_theory(.5, .26).variance));
}

/* ---- the page */

static char *quick_page(uint64_t seed)
{
    struct lecture lecture = { .seed = seed, .quick = true };
    struct err err = { 0 };
    char *text = NULL;
    size_t size;
    if (!lecture_make(&lecture, &err) || !page_finish(lecture.page, &text, &size, &err))
        fail_msg("%s", err.text);
    page_free(lecture.page);
    return text;
}

static void the_page_is_whole_and_the_same_for_the_same_seed(void **state)
{
    (void)state;
    /* Each of the lecture's traps has a place */
    static const char *const traps[] = {
        "2.75039",     "N<sup>-3/2</sup>",
        "RAND_MAX",    "r &gt; q",
        "1 / base",    "sum 1",
        "π/6",         "0/0",
        "LD[S*]E",     "largest depth",
        "zero vector", "(impossible)",
    };
    char *one = quick_page(1), *again = quick_page(1), *other = quick_page(2);
    const char *fault = balanced_fault(one);
    if (fault != NULL)
        fail_msg("%s", fault);
    assert_string_equal(one, again);
    assert_string_not_equal(one, other);
    for (size_t i = 0; i < LENGTH(traps); i++)
        if (strstr(one, traps[i]) == NULL)
            fail_msg("the page does not mention %s", traps[i]);
    for (const char *at = one; (at = strstr(at, "src=")) != NULL; at++)
        assert_memory_equal(at, "src=\"data:", 10);
    assert_null(strstr(one, "nan"));
    free(one);
    free(again);
    free(other);
}

static int run(char *const *arguments, int count)
{
    char *argv[8] = { (char[]){ "lecture" } };
    for (int i = 0; i < count; i++)
        argv[i + 1] = arguments[i];
    return cmd_lecture(count + 1, argv);
}

static void the_command_says_what_went_wrong_by_its_status(void **state)
{
    (void)state;
    char folder[256];
    scratch_make(folder);
    char path[600], nowhere[600];
    snprintf(path, sizeof(path), "%s/out.html", folder);
    snprintf(nowhere, sizeof(nowhere), "%s/no/out.html", folder);
    assert_int_equal(run((char *[]){ "--quick", "-q", "-o", path, "--seed", "3" }, 6), 0);
    assert_int_equal(access(path, R_OK), 0);
    assert_int_equal(run((char *[]){ "--quick", "-q", "-o", nowhere }, 4), 1);
    assert_int_equal(run((char *[]){ "--seed", "-1" }, 2), 2);
    assert_int_equal(run((char *[]){ "--seed", "12x" }, 2), 2);
    assert_int_equal(run((char *[]){ "out.html" }, 1), 2);
    assert_int_equal(run((char *[]){ "--no-such" }, 1), 2);
    scratch_remove(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(integrals_are_right_within_their_errors),
        cmocka_unit_test(samples_of_their_own_density_have_no_variance),
        cmocka_unit_test(the_theory_of_the_wave_is_what_others_computed),
        cmocka_unit_test(errors_fall_at_the_rates_of_theory),
        cmocka_unit_test(rand_of_the_slide_reaches_one),
        cmocka_unit_test(halton_mirrors_digits),
        cmocka_unit_test(discrepancy_is_what_its_definition_says),
        cmocka_unit_test(strata_hold_one_point_each_and_sobol_too),
        cmocka_unit_test(hemispheres_are_covered_as_they_claim),
        cmocka_unit_test(the_zero_vector_is_rejected),
        cmocka_unit_test(polygons_are_covered_evenly_but_for_barycentric_weights),
        cmocka_unit_test(a_square_light_lights_as_its_form_factor_says),
        cmocka_unit_test(glossy_directions_reflect_the_same_as_uniform_ones),
        cmocka_unit_test(a_black_surface_absorbs),
        cmocka_unit_test(trees_have_as_many_rays_as_powers_say),
        cmocka_unit_test(pictures_agree_whatever_way_they_are_made),
        cmocka_unit_test(russian_roulette_is_unbiased),
        cmocka_unit_test(the_page_is_whole_and_the_same_for_the_same_seed),
        cmocka_unit_test(the_command_says_what_went_wrong_by_its_status),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
