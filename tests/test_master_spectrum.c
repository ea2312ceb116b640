/* Goal: spectra become the colours they should, and a coat's table is what pbrt's random walk
 * through the layers expects: checked by walking, and by the limits that have closed forms. */
#include "common/hash.h"
#include "master/coat.h"
#include "master/spectrum.h"
#include "tests/dielectric.h"
#include "tests/expect.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

/* --- Spectra ------------------------------------------------------------------------------ */

static double luminance(const double rgb[3])
{
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

static void blackbodies_have_luminance_one_and_the_planckian_colour(void **state)
{
    (void)state;
    double rgb[3];
    assert_true(spectrum_blackbody(6500, rgb));
    EXPECT_NEAR(luminance(rgb), 1, 1e-3);
    EXPECT_NEAR(rgb[0], 1.043, 2e-3); /* chromaticity .3135 .3237 */
    EXPECT_NEAR(rgb[2], 1.034, 2e-3);
    assert_true(spectrum_blackbody(2856, rgb)); /* illuminant A: .4476 .4074 */
    double x = 0.4124564 * rgb[0] + 0.3575761 * rgb[1] + 0.1804375 * rgb[2];
    double y = 0.2126729 * rgb[0] + 0.7151522 * rgb[1] + 0.0721750 * rgb[2];
    double z = 0.0193339 * rgb[0] + 0.1191920 * rgb[1] + 0.9503041 * rgb[2];
    EXPECT_NEAR(x / (x + y + z), 0.4476, 5e-4);
    EXPECT_NEAR(y / (x + y + z), 0.4074, 5e-4);
    assert_true(spectrum_blackbody(1000, rgb)); /* out of gamut: no negative blue */
    assert_true(rgb[0] > 0 && rgb[2] == 0);
    assert_true(spectrum_blackbody(1e6, rgb) && spectrum_blackbody(100, rgb));
    assert_false(spectrum_blackbody(99, rgb) || spectrum_blackbody(NAN, rgb));
}

static void constant_spectra_are_grey(void **state)
{
    (void)state;
    static const double constant[] = { 200, 0.3, 900, 0.3 }, one[] = { 550, 0.3 };
    double rgb[3];
    spectrum_reflectance(constant, 2, rgb);
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(rgb[c], 0.3, 1e-12);
    spectrum_index(one, 1, rgb);
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(rgb[c], 0.3, 1e-12);
    assert_true(spectrum_light(constant, 2, rgb)); /* equal energy is pinker than D65 */
    EXPECT_NEAR(luminance(rgb), 1, 1e-3);
    EXPECT_NEAR(rgb[0], 1.205, 2e-3);
    assert_false(spectrum_light(one, 0, rgb));
    static const double ultraviolet[] = { 100, 1, 200, 1 };
    assert_false(spectrum_light(ultraviolet, 2, rgb));
}

static void a_red_spectrum_is_red(void **state)
{
    (void)state;
    static const double red[] = { 380, 0, 600, 0, 610, 1, 780, 1 };
    double rgb[3];
    spectrum_reflectance(red, 4, rgb);
    assert_true(rgb[0] > 0.5 && fabs(rgb[1]) < 0.1 && fabs(rgb[2]) < 0.1);
}

static double reflectance_at_normal(const double eta[3], const double k[3], int c)
{
    double a = (eta[c] - 1) * (eta[c] - 1) + k[c] * k[c];
    return a / ((eta[c] + 1) * (eta[c] + 1) + k[c] * k[c]);
}

static void metals_reflect_their_known_colours(void **state)
{
    (void)state;
    static const struct {
        const char *eta, *k;
        double rgb[3]; /* at normal incidence: the spectrum of the reflectance, under D65 */
        double tolerance;
    } rows[] = {
        { "metal-Ag-eta", "metal-Ag-k", { 0.9715, 0.9599, 0.9153 }, 1e-3 },
        { "metal-Al-eta", "metal-Al-k", { 0.9132, 0.9215, 0.9244 }, 1e-3 },
        { "metal-Au-eta", "metal-Au-k", { 0.98, 0.7826, 0.3434 }, 1e-3 },
        { "metal-Cu-eta", "metal-Cu-k", { 0.9556, 0.6376, 0.5382 }, 1e-3 },
        { "metal-CuZn-eta", "metal-CuZn-k", { 0.89, 0.79, 0.43 }, 0.03 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        double eta[3], k[3];
        assert_true(spectrum_metal(rows[i].eta, eta) && spectrum_metal(rows[i].k, k));
        for (int c = 0; c < 3; c++)
            EXPECT_NEAR(reflectance_at_normal(eta, k, c), rows[i].rgb[c], rows[i].tolerance);
    }
}

/* Aluminium's eta and k every 50 nm, after Palik */
static void aluminium_is_the_average_of_what_its_spectrum_reflects(void **state)
{
    (void)state;
    static const double al[][3] = {
        { 400, .490, 4.86 },  { 450, .618, 5.47 },  { 500, .769, 6.08 },  { 550, .959, 6.69 },
        { 600, 1.198, 7.26 }, { 650, 1.475, 7.79 }, { 700, 1.839, 8.32 }, { 750, 2.395, 8.62 },
    };
    double pairs[16], rgb[3], eta[3], k[3];
    for (int i = 0; i < 8; i++) {
        double low = (al[i][1] - 1) * (al[i][1] - 1), high = (al[i][1] + 1) * (al[i][1] + 1);
        pairs[2 * i] = al[i][0];
        pairs[2 * i + 1] = (low + al[i][2] * al[i][2]) / (high + al[i][2] * al[i][2]);
    }
    spectrum_reflectance(pairs, 8, rgb);
    assert_true(spectrum_metal("metal-Al-eta", eta) && spectrum_metal("metal-Al-k", k));
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(reflectance_at_normal(eta, k, c), rgb[c], 1e-3);
}

static void every_listed_name_is_known(void **state)
{
    (void)state;
    for (size_t i = 0; spectrum_names[i] != NULL; i++) {
        double rgb[3], ior;
        assert_true(spectrum_metal(spectrum_names[i], rgb) ||
                    spectrum_glass(spectrum_names[i], &ior) ||
                    spectrum_illuminant(spectrum_names[i], rgb));
    }
    double ior;
    assert_true(spectrum_glass("glass-BK7", &ior));
    EXPECT_NEAR(ior, 1.5168, 1e-5);
    assert_false(spectrum_glass("glass-BK8", &ior));
}

/* --- Coats -------------------------------------------------------------------------------- */

struct walk {
    double alpha, n, thickness;
    uint64_t seed, draws;
};

static double draw(struct walk *walk)
{
    return hash64_unit(hash64(walk->seed, walk->draws++));
}

/* One crossing of the interface, the plain way: normals by D cos, not by what is visible, with the
 * weight that makes it right. Goes up from cosine wz with index ratio n (of the far side over the
 * near). Returns the weight; *out is the new cosine, negative when transmitted. */
static double cross_interface(struct walk *walk, double wz, double n, bool transmit, double *out)
{
    double u = draw(walk), phi = 2 * PI * draw(walk), mz = 1, mx = 0;
    if (walk->alpha > 0) {
        mz = sqrt((1 - u) / (1 + (walk->alpha * walk->alpha - 1) * u));
        mx = sqrt(fmax(0, 1 - mz * mz)) * cos(phi);
    }
    double c = sqrt(1 - wz * wz) * mx + wz * mz;
    if (c <= 0)
        return 0;
    double f = dielectric_fresnel(c, n);
    if (transmit) {
        if (f == 1)
            return 0;
        *out = (c / n - sqrt(1 - (1 - c * c) / (n * n))) * mz - wz / n;
        if (*out >= 0)
            return 0;
        f = 1 - f;
    } else {
        *out = 2 * c * mz - wz;
        if (*out <= 0)
            return 0;
    }
    if (walk->alpha == 0)
        return f;
    /* D G1(w) c / wz is the density of visible normals, D mz what was drawn from */
    double g2 = 1 / (1 + dielectric_lambda(wz, walk->alpha) +
                     dielectric_lambda(fabs(*out), walk->alpha));
    return f * g2 * c / (wz * mz);
}

static double walk_in(struct walk *walk, double mu)
{
    double inside = 0, weight = cross_interface(walk, mu, walk->n, true, &inside);
    return weight > 0 ? weight * exp(-walk->thickness / fabs(inside)) : 0;
}

static double walk_back(struct walk *walk)
{
    double up = sqrt(fmax(1e-12, draw(walk))), down = 0;
    double weight = cross_interface(walk, up, 1 / walk->n, false, &down);
    return weight > 0 ? weight * exp(-walk->thickness * (1 / up + 1 / down)) : 0;
}

static double table_at(const struct coat *coat, double mu)
{
    double x = sqrt(mu) * (COAT_TABLE_LEN - 1);
    int i = x < COAT_TABLE_LEN - 2 ? (int)x : COAT_TABLE_LEN - 2;
    return coat->table[i] + (x - i) * ((double)coat->table[i + 1] - coat->table[i]);
}

static void coat_tables_agree_with_a_random_walk(void **state)
{
    (void)state;
    static const struct {
        double alpha, n, thickness;
    } rows[] = { { 0, 1.5, 0.01 },
                 { 0.05, 1.5, 0.01 },
                 { 0.3, 1.5, 0.1 },
                 { 0.8, 1.33, 0.5 },
                 { 0.2, 2.2, 0 } };
    enum { WALKS = 100000 };
    for (size_t r = 0; r < sizeof(rows) / sizeof(rows[0]); r++) {
        struct coat coat;
        struct walk walk = { rows[r].alpha, rows[r].n, rows[r].thickness, 77 + r, 0 };
        coat_tabulate(rows[r].alpha, rows[r].n, rows[r].thickness, &coat);
        static const double cosines[] = { 0.15, 0.5, 0.95 };
        for (int k = 0; k < 4; k++) {
            double sum = 0, sum2 = 0;
            for (int i = 0; i < WALKS; i++) {
                double value = k < 3 ? walk_in(&walk, cosines[k]) : walk_back(&walk);
                sum += value;
                sum2 += value * value;
            }
            double mean = sum / WALKS, error = sqrt(fmax(0, sum2 / WALKS - mean * mean) / WALKS);
            EXPECT_NEAR(k < 3 ? table_at(&coat, cosines[k]) : (double)coat.inner, mean,
                        4 * error + 1.5e-3 * mean);
        }
        EXPECT_NEAR(coat.scale, 1 / (PI * rows[r].n * rows[r].n), 1e-7);
    }
}

static double mean_of_table(const struct coat *coat)
{
    double sum = 0;
    enum { STEPS = 4000 };
    for (int i = 0; i < STEPS; i++)
        sum += table_at(coat, sqrt((i + 0.5) / STEPS));
    return sum / STEPS;
}

static void a_smooth_coat_without_thickness_is_fresnel(void **state)
{
    (void)state;
    struct coat coat;
    coat_tabulate(0, 1.5, 0, &coat);
    EXPECT_NEAR(coat.table[COAT_TABLE_LEN - 1], 0.96, 1e-6);
    EXPECT_NEAR(coat.table[0], 0, 1e-4);
    EXPECT_NEAR(coat.inner, 0.596345759708, 2e-5);
    EXPECT_NEAR(mean_of_table(&coat), 1 - 0.091777959342, 2e-3);
    EXPECT_NEAR((1 - (double)coat.inner) * 1.5 * 1.5, 1 - 0.091777959342, 1e-4);
}

/* A white base under a clear, smooth coat returns everything: reflected at the interface, or
 * through it after any number of turns. Uniform light from outside meets uniform radiance. */
static void a_white_base_under_a_clear_coat_loses_nothing(void **state)
{
    (void)state;
    struct coat coat;
    coat_tabulate(0, 1.5, 0, &coat);
    for (double mu = 0.1; mu < 1; mu += 0.2) {
        double t = table_at(&coat, mu);
        double base = t * mean_of_table(&coat) * PI * coat.scale / (1 - coat.inner);
        EXPECT_NEAR(base + dielectric_fresnel(mu, 1.5), 1, 5e-3);
    }
}

static void rough_coats_approach_the_smooth_one(void **state)
{
    (void)state;
    struct coat smooth, rough;
    coat_tabulate(0, 1.5, 0.01, &smooth);
    coat_tabulate(0.002, 1.5, 0.01, &rough);
    for (int i = 16; i < COAT_TABLE_LEN; i++)
        EXPECT_NEAR(rough.table[i], smooth.table[i], 2e-3);
    EXPECT_NEAR(rough.inner, smooth.inner, 3e-3);
}

static void a_coat_of_index_one_is_not_there(void **state)
{
    (void)state;
    struct coat coat;
    coat_tabulate(0, 1, 0, &coat);
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        EXPECT_NEAR(coat.table[i], 1, 1e-6);
    EXPECT_NEAR(coat.inner, 0, 1e-7);
    EXPECT_NEAR(coat.scale, 1 / PI, 1e-7);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blackbodies_have_luminance_one_and_the_planckian_colour),
        cmocka_unit_test(constant_spectra_are_grey),
        cmocka_unit_test(a_red_spectrum_is_red),
        cmocka_unit_test(metals_reflect_their_known_colours),
        cmocka_unit_test(aluminium_is_the_average_of_what_its_spectrum_reflects),
        cmocka_unit_test(every_listed_name_is_known),
        cmocka_unit_test(coat_tables_agree_with_a_random_walk),
        cmocka_unit_test(a_smooth_coat_without_thickness_is_fresnel),
        cmocka_unit_test(a_white_base_under_a_clear_coat_loses_nothing),
        cmocka_unit_test(rough_coats_approach_the_smooth_one),
        cmocka_unit_test(a_coat_of_index_one_is_not_there),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
