/*
 * What BSDFs are made of: Fresnel's equations, frames around normals, and the microfacet
 * distribution, against closed forms in double. H numbers are those of the numerics notes,
 * section 2.
 */
#include "tests/chi2.h"
#include "worker/kernel/fresnel.h"
#include "worker/kernel/ggx.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* ---- Fresnel */

static double fresnel(double c, double eta)
{
    f8 cos_t;
    return (double)fresnel_dielectric(F8((float)c), F8((float)eta), &cos_t)[0];
}

static double fresnel_metal(double c, double eta, double k)
{
    return (double)fresnel_conductor(F8((float)c), F8((float)eta), F8((float)k))[0];
}

static void fresnel_has_its_table_values(void **state) /* H24 */
{
    (void)state;
    const double degree = M_PI / 180;
    EXPECT_NEAR(fresnel(1, 1.5), 0.04, 1e-7);
    EXPECT_NEAR(fresnel(1, 1 / 1.5), 0.04, 1e-7);
    EXPECT_NEAR(fresnel(cos(45 * degree), 1.5), 0.050239911012, 1e-6);
    EXPECT_NEAR(fresnel(cos(60 * degree), 1.5), 0.089186712802, 1e-6);
    EXPECT_NEAR(fresnel(cos(atan(1.5)), 1.5), 0.073964497041, 1e-6);
    EXPECT_NEAR(fresnel(cos(85 * degree), 1.5), 0.612799645265, 2e-6);
    EXPECT_NEAR(fresnel(cos(89.9 * degree), 1.5), 0.989911876919, 2e-6);
    EXPECT_NEAR(fresnel(0, 1.5), 1, 0);
    EXPECT_NEAR(fresnel_metal(1, 0.2, 3.9), 0.951951951952, 1e-6);
    EXPECT_NEAR(fresnel_metal(cos(80 * degree), 0.2, 3.9), 0.948407448365, 1e-6);
    EXPECT_NEAR(fresnel_metal(0, 0.2, 3.9), 1, 1e-6);
}

static void an_index_of_one_is_transparent_at_every_angle(void **state) /* H22 */
{
    (void)state;
    for (double c = 1; c > 1e-9; c *= 0.9)
        EXPECT_NEAR(fresnel(c, 1), 0, 0);
    EXPECT_NEAR(fresnel(0, 1), 0, 0);
}

/* In double, of the very numbers that the kernel gets */
static double fresnel_exact(float c, float eta)
{
    double x = (double)c, n = (double)eta, sine2 = (1 - x) * (1 + x) / (n * n);
    if (sine2 >= 1)
        return 1;
    double t = sqrt(1 - sine2), p = (n * x - t) / (n * x + t), s = (x - n * t) / (x + n * t);
    return (p * p + s * s) / 2;
}

/*
 * H23. F is within 1e-3 of the truth beside the critical angle and 1e-6 far from it. Between them
 * a rounding of sin^2 theta_t counts dF / d sin^2, which no float can help, and the bound is 1e-6
 * and three roundings.
 */
#define CRITICAL_ROUNDINGS 3

static double fresnel_slack(float c, float eta)
{
    double x = (double)c, n = (double)eta, cos_t = sqrt(fabs(1 - (1 - x) * (1 + x) / (n * n)));
    double slope = (n + 1 / n) / (fmax(x, 1e-6) * fmax(cos_t, 1e-12)); /* where cos_t is small */
    return fmin(1e-3, 1e-6 + CRITICAL_ROUNDINGS * 0x1p-24 * slope);
}

static void fresnel_rises_to_one_at_the_critical_angle(void **state) /* H23 */
{
    (void)state;
    static const float indices[] = { 1 / 1.5f, 1 / 1.33f, 1 / 2.4f, 1 / 1.8f };
    for (int k = 0; k < 4; k++) {
        float eta = indices[k];
        float critical = (float)sqrt(1 - (double)eta * (double)eta);
        float before = 0;
        double planted = 0;
        for (int i = 0; i <= 24000; i++) {
            /* Down to the critical cosine, through all the floats around it, and on to zero */
            float c = critical * (1 - (float)(i - 14000) / 10000);
            if (i < 10000)
                c = 1 - (1 - critical) * (float)i / 10000;
            else if (i < 14000)
                c = fminf(critical + (float)(12000 - i) * 0x1p-24f, 1);
            if (i == 10000)
                before = 0;
            f8 cos_t;
            float F = fresnel_dielectric(F8(c), F8(eta), &cos_t)[0];
            double want = fresnel_exact(c, eta), slack = fresnel_slack(c, eta);
            if (!(F >= 0 && F <= 1) || !(cos_t[0] >= 0))
                fail_msg("eta %g: F(%.9g) = %g, cos_t %g", (double)eta, (double)c, (double)F,
                         (double)cos_t[0]);
            if (c < critical * (1 - 1e-5f))
                EXPECT_NEAR(F, 1, 0);
            EXPECT_NEAR(F, want, slack);
            /* Beyond Brewster's angle it rises, but for roundings */
            if (c < critical * 1.01f && (double)F < (double)before - 2 * slack)
                fail_msg("eta %g: F falls from %.9g to %.9g at %.9g", (double)eta, (double)before,
                         (double)F, (double)c);
            before = F;
            /* Planted: an index that is off in its sixth digit */
            planted = fmax(planted, fabs(fresnel_exact(c, eta * 1.00001f) - want) / slack);
        }
        assert_true(planted > 2);
    }
}

static void a_conductor_that_absorbs_nothing_is_a_dielectric(void **state) /* H31 */
{
    (void)state;
    double worst = 0, planted = 0;
    for (int i = 0; i <= 1000; i++)
        for (double eta = 1.1; eta < 3; eta += 0.4) {
            float c = (float)i / 1000;
            double want = fresnel_exact(c, (float)eta);
            worst = fmax(worst, fabs(fresnel_metal((double)c, eta, 0) - want));
            worst = fmax(worst, fabs(fresnel((double)c, eta) - want));
            planted = fmax(planted, fabs(fresnel_metal((double)c, eta, 0.01) - want));
        }
    EXPECT_NEAR(worst, 0, 1e-6);
    assert_true(planted > 1e-5); /* a little absorption */
}

static void fresnel_has_its_hemispherical_means(void **state)
{
    (void)state;
    double outside = 0, inside = 0;
    const int n = 100000;
    for (int i = 0; i < n; i++) {
        double c = (i + 0.5) / n;
        outside += 2 * c * fresnel(c, 1.5) / n;
        inside += 2 * c * fresnel(c, 1 / 1.5) / n;
    }
    EXPECT_NEAR(outside, 0.091777959342, 1e-6);
    EXPECT_NEAR(inside, 0.596345759708, 1e-5);
}

/* ---- frames */

/* Of s, t and n: how far from unit length, and from right angles */
static double frame_error(struct frame8 f, int lane)
{
    const struct vec3x8 v[3] = { f.s, f.t, f.n };
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) {
            double dot = (double)v[i].x[lane] * (double)v[j].x[lane] +
                         (double)v[i].y[lane] * (double)v[j].y[lane] +
                         (double)v[i].z[lane] * (double)v[j].z[lane];
            worst = fmax(worst, fabs(dot - (i == j)));
        }
    return worst;
}

/* Planted: Frisvad's frame with its usual guard */
static struct frame8 frisvad(struct vec3x8 n)
{
    f8 a = 1 / (1 + n.z), b = -n.x * n.y * a;
    i8 low = n.z < -0.9999999f;
    struct frame8 f = { { 1 - n.x * n.x * a, b, -n.x }, { b, 1 - n.y * n.y * a, -n.y }, n };
    f.s = vec3x8_select(low, vec3x8_all(0, -1, 0), f.s);
    f.t = vec3x8_select(low, vec3x8_all(-1, 0, 0), f.t);
    return f;
}

static void frames_are_orthonormal_down_to_minus_z(void **state) /* H16 */
{
    (void)state;
    struct random_lanes r = { 16, 0 };
    double worst = 0, planted = 0;
    for (int i = 0; i < 250000; i++) {
        struct vec3x8 n;
        double scale = i % 2 ? pow(10, -8 * random_double(&r)) : 1;
        if (i % 2 == 0)
            n = random_direction(&r);
        for (int lane = 0; lane < LANES && i % 2; lane++) { /* crowd them at -z, at every scale */
            double phi = 2 * M_PI * random_double(&r), across = scale * random_double(&r);
            n.x[lane] = (float)(across * cos(phi));
            n.y[lane] = (float)(across * sin(phi));
            n.z[lane] = (float)-sqrt(1 - across * across);
        }
        struct frame8 f = frame_around(n), wrong = frisvad(n);
        for (int lane = 0; lane < LANES; lane++) {
            worst = fmax(worst, frame_error(f, lane));
            planted = fmax(planted, frame_error(wrong, lane));
        }
    }
    EXPECT_NEAR(worst, 0, 2e-7);
    assert_true(planted > 0.1);
    const float poles[] = { 1, -1 };
    for (int i = 0; i < 2; i++)
        EXPECT_NEAR(frame_error(frame_around(vec3x8_all(0, 0, poles[i])), 0), 0, 0);
    EXPECT_NEAR(frame_error(frame_around(vec3x8_all(1, 0, -0.0f)), 0), 0, 0);
    EXPECT_NEAR(frame_error(frame_around(vec3x8_all(0, 1, 0.0f)), 0), 0, 0);
}

static void frames_turn_with_the_surface(void **state)
{
    (void)state;
    struct random_lanes r = { 47, 0 };
    for (int i = 0; i < 20000; i++) {
        struct vec3x8 n = random_direction(&r), dpdu = random_direction(&r);
        if (i % 3 == 0) /* nearly along the normal */
            dpdu = vec3x8_along(n, dpdu, F8(3e-4f));
        dpdu = vec3x8_scale(dpdu, F8((float)pow(10, 8 * random_double(&r) - 4)));
        struct frame8 around = frame_around(n), f = frame_turned(I8(-1), &around, dpdu);
        struct vec3x8 across = vec3x8_cross(n, vec3x8_unit(dpdu));
        for (int lane = 0; lane < LANES; lane++) {
            EXPECT_NEAR(vec3x8_dot(f.s, f.n)[lane], 0, 3e-7);
            EXPECT_NEAR(vec3x8_dot(f.s, f.t)[lane], 0, 3e-7);
            EXPECT_NEAR(vec3x8_length2(f.s)[lane], 1, 1e-6);
            EXPECT_NEAR(vec3x8_length2(f.t)[lane], 1, 1e-6);
            assert_true(vec3x8_dot(vec3x8_cross(f.s, f.t), n)[lane] > 0.999f);
            if (vec3x8_length2(across)[lane] < 1e-9f) /* so near the normal that nothing turns */
                continue;
            /* dp/du lies in the plane of s and n, on the side of s */
            assert_true(vec3x8_dot(f.s, dpdu)[lane] > 0);
            EXPECT_NEAR(vec3x8_dot(vec3x8_unit(across), f.s)[lane], 0, i % 3 ? 1e-4 : 1e-2);
        }
    }
    struct vec3x8 n = vec3x8_all(0, 0, 1);
    struct frame8 around = frame_around(n);
    struct frame8 same = frame_turned(I8(-1), &around, n);
    EXPECT_NEAR(same.s.x[0] - around.s.x[0], 0, 0);
    same = frame_turned(I8(-1), &around, vec3x8_all(0, 0, 0));
    EXPECT_NEAR(same.t.y[0] - around.t.y[0], 0, 0);
    same = frame_turned(I8(0), &around, vec3x8_all(0, 1, 0)); /* not asked for */
    EXPECT_NEAR(same.s.x[0] - around.s.x[0], 0, 0);
}

/* ---- the microfacet distribution */

static void the_peak_of_a_narrow_lobe_keeps_its_digits(void **state) /* H25 */
{
    (void)state;
    double worst = 0, planted = 0;
    for (float a = 1; a > 5e-5f; a *= 0.7f)
        for (double t = 0; t < 4; t += 0.25) { /* out to four widths from the peak */
            double theta = fmin((double)a * t, 1.5);
            struct vec3x8 h = vec3x8_all((float)(0.6 * sin(theta)), (float)(0.8 * sin(theta)),
                                         (float)cos(theta));
            double s2 = (double)h.x[0] * (double)h.x[0] + (double)h.y[0] * (double)h.y[0];
            double a2 = (double)a * (double)a, e = s2 + a2 * (1 - s2);
            double want = a2 / (M_PI * e * e);
            worst = fmax(worst,
                         fabs((double)ggx_D((struct ggx8){ F8(a), F8(a) }, h)[0] / want - 1));
            float c = h.z[0], book = c * c * (a * a - 1) + 1; /* planted: the textbook's form */
            planted = fmax(planted, fabs((double)(a * a / (book * book)) / M_PI / want - 1));
        }
    EXPECT_NEAR(worst, 0, 1e-6);
    assert_true(planted > 0.3);
    struct vec3x8 h = vec3x8_all((float)sin(1e-3), 0, (float)cos(1e-3));
    double D = (double)ggx_D((struct ggx8){ F8(1e-3f), F8(1e-3f) }, h)[0];
    EXPECT_NEAR(D / 79577.6, 1, 3e-6); /* the notes' six digits */
}

/*
 * The integral of G1(o) D(h) / (4 |o.n|) over the sphere of mirror directions, which is that of
 * G1 D (o.h) / (o.n) over the normals that o sees: by midpoints in the angles of h, stretched so
 * that alpha drops out.
 */
static double weak_furnace(float ax, float ay, struct vec3x8 o, bool planted)
{
    struct ggx8 g = { F8(ax), F8(ay) };
    double sum = 0;
    const int rows = 512, columns = 512;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j += LANES) {
            /* tan^2 theta = u / (1 - u) before stretching: the density D cos(theta) in u, phi */
            double t = (i + 0.5) / rows, u = t * t * (3 - 2 * t), tangent = sqrt(u / (1 - u));
            struct vec3x8 h;
            for (int lane = 0; lane < LANES; lane++) {
                double phi = 2 * M_PI * (j + lane + 0.5) / columns;
                double x = (double)ax * tangent * cos(phi), y = (double)ay * tangent * sin(phi);
                double inverse = 1 / sqrt(1 + x * x + y * y);
                h.x[lane] = (float)(x * inverse);
                h.y[lane] = (float)(y * inverse);
                h.z[lane] = (float)inverse;
            }
            f8 pdf = ggx_visible_pdf(g, o, h) / (ggx_D(g, h) * h.z);
            if (planted) /* the masking of a surface one per cent rougher */
                pdf = pdf * ggx_G1((struct ggx8){ F8(1.01f * ax), F8(1.01f * ay) }, o) /
                      ggx_G1(g, o);
            for (int lane = 0; lane < LANES; lane++)
                sum += (double)pdf[lane] * 6 * t * (1 - t) / (rows * columns);
        }
    return sum;
}

static void the_weak_white_furnace_returns_one(void **state) /* H27 */
{
    (void)state;
    static const float widths[][2] = { { 0.01f, 0.01f }, { 0.1f, 0.1f },  { 0.5f, 0.5f },
                                       { 1, 1 },         { 0.05f, 0.4f }, { 1, 0.2f } };
    static const double cosines[] = { 1, 0.5, 0.1, 0.02 };
    int caught = 0;
    for (int a = 0; a < 6; a++)
        for (int c = 0; c < 4; c++) {
            double across = sqrt(1 - cosines[c] * cosines[c]);
            struct vec3x8 o = vec3x8_all((float)(0.8 * across), (float)(0.6 * across),
                                         (float)cosines[c]);
            EXPECT_NEAR(weak_furnace(widths[a][0], widths[a][1], o, false), 1, 1e-3);
            caught += fabs(weak_furnace(widths[a][0], widths[a][1], o, true) - 1) > 1e-3;
        }
    assert_true(caught >= 8); /* where little is masked there is little to see */
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fresnel_has_its_table_values),
        cmocka_unit_test(an_index_of_one_is_transparent_at_every_angle),
        cmocka_unit_test(fresnel_rises_to_one_at_the_critical_angle),
        cmocka_unit_test(a_conductor_that_absorbs_nothing_is_a_dielectric),
        cmocka_unit_test(fresnel_has_its_hemispherical_means),
        cmocka_unit_test(frames_are_orthonormal_down_to_minus_z),
        cmocka_unit_test(frames_turn_with_the_surface),
        cmocka_unit_test(the_peak_of_a_narrow_lobe_keeps_its_digits),
        cmocka_unit_test(the_weak_white_furnace_returns_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
