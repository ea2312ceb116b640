/*
 * Media: the phase function, flights, and scenes whose light has a closed form or a quadrature.
 * H numbers are those of the numerics notes, section 2. Runs for about ten seconds.
 */
#include "common/aov.h"
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/light.h"
#include "worker/kernel/medium.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define SIGMAS 4.5 /* what chance may do */

/* ---- the phase function */

static void the_phase_function_is_normalised_and_has_its_mean_cosine(void **state)
{
    (void)state;
    const float gs[] = { 0, 1e-6f, 0.3f, -0.3f, 0.9f, -0.9f, 0.999f, -0.999f };
    for (size_t i = 0; i < sizeof(gs) / sizeof(gs[0]); i++) {
        double sum = 0, cosines = 0;
        const int n = 200000;
        for (int k = 0; k < n; k += LANES) {
            /* Fine where the peak is */
            struct vec3x8 w = vec3x8_all(0, 0, 0), d = vec3x8_all(0, 0, 1);
            double dtheta[LANES], sine[LANES], cosine[LANES];
            for (int lane = 0; lane < LANES; lane++) {
                double t = (k + lane + 0.5) / n, theta = M_PI * pow(t, 4);
                dtheta[lane] = 4 * M_PI * pow(t, 3) / n;
                sine[lane] = sin(theta);
                cosine[lane] = gs[i] < 0 ? -cos(theta) : cos(theta);
                w.x[lane] = (float)sine[lane];
                w.z[lane] = (float)cosine[lane];
            }
            f8 p = phase_pdf(F8(gs[i]), d, w);
            for (int lane = 0; lane < LANES; lane++) {
                double mass = 2 * M_PI * sine[lane] * dtheta[lane] * (double)p[lane];
                sum += mass;
                cosines += mass * cosine[lane];
            }
        }
        EXPECT_NEAR(sum, 1, 3e-4);
        EXPECT_NEAR(cosines, gs[i], 3e-4);
    }
}

struct lobe {
    float d[3], g, claimed; /* what the density is asked for, and is planted wrong */
    float scale;
};

static struct vec3x8 lobe_axis(const struct lobe *lobe)
{
    return vec3x8_unit(vec3x8_all(lobe->d[0], lobe->d[1], lobe->d[2]));
}

static void lobe_pdf(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct lobe *lobe = self;
    *pdf = phase_pdf(F8(lobe->claimed), lobe_axis(lobe), *w) * lobe->scale;
}

static void lobe_sample(void *self, struct random_lanes *random, struct vec3x8 *w, i8 *valid)
{
    const struct lobe *lobe = self;
    f8 u = random_f8(random), v = random_f8(random);
    *w = phase_sample(F8(lobe->g), lobe_axis(lobe), u, v);
    *valid = I8(-1);
}

static void scattered_directions_follow_the_phase_function(void **state)
{
    (void)state;
    const struct {
        float g, power, wrong;
    } cases[] = { { 0, 1, 0.02f },       { 0.4f, 1, 0.42f },    { -0.4f, 1, -0.42f },
                  { 0.9f, 2, 0.905f },   { -0.9f, 2, -0.905f }, { 0.99f, 3, 0.9905f },
                  { 0.999f, 4, 0.9991f } };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++)
        for (int planted = 0; planted < 3; planted++) {
            float side = cases[i].g < 0 ? -1 : 1;
            struct lobe lobe = { .d = { 0.3f, -0.5f, 0.7f },
                                 .g = cases[i].g,
                                 .claimed = planted == 1 ? cases[i].wrong : cases[i].g,
                                 .scale = planted == 2 ? 1.02f : 1 };
            struct chi2_case c = { .self = &lobe,
                                   .axis = { side * 0.3f, side * -0.5f, side * 0.7f },
                                   .power = (double)cases[i].power,
                                   .samples = 400000,
                                   .seed = i + 11,
                                   .pdf = lobe_pdf,
                                   .sample = lobe_sample };
            struct chi2_result r = chi2_run(&c);
            bool scale = chi2_scale_right(&r, c.samples, 3e-3);
            if (planted == 0 && !(r.p > CHI2_ALPHA && scale && r.outside == 0))
                fail_msg("g %g: p = %g, integral %g", (double)lobe.g, r.p, r.integral);
            if (planted == 1 && !(r.p < CHI2_CAUGHT))
                fail_msg("g %g, claimed %g, passes with p = %g", (double)lobe.g,
                         (double)lobe.claimed, r.p);
            if (planted == 2)
                assert_false(scale);
        }
}

static void the_extremes_of_g_are_finite(void **state) /* H32 */
{
    (void)state;
    const float gs[] = { 0,       1e-30f,  -1e-30f,        1e-6f, -1e-6f, 0.999f,
                         -0.999f, 0.9999f, 0x1.fffffep-1f, 1,     -1 };
    const float us[] = { 0, 0x1p-24f, 0.25f, 0.5f, 1 - 0x1p-24f };
    const float ds[][3] = { { 0, 0, 1 }, { 0, 0, -1 }, { 0.6f, 0, 0.8f }, { 0, -1, 0 } };
    for (size_t i = 0; i < sizeof(gs) / sizeof(gs[0]); i++)
        for (int j = 0; j < 25; j++)
            for (int k = 0; k < 4; k++) {
                struct vec3x8 d = vec3x8_all(ds[k][0], ds[k][1], ds[k][2]);
                struct vec3x8 w = phase_sample(F8(gs[i]), d, F8(us[j % 5]), F8(us[j / 5]));
                EXPECT_NEAR(vec3x8_length2(w)[0], 1, 1e-6);
                float pdf = phase_pdf(F8(gs[i]), d, w)[0];
                assert_true(pdf >= 0 && isfinite(pdf));
                float ahead = phase_pdf(F8(gs[i]), d, d)[0];
                float back = phase_pdf(F8(gs[i]), d, vec3x8_neg(d))[0];
                assert_true(ahead >= 0 && isfinite(ahead) && back >= 0 && isfinite(back));
                if (fabsf(gs[i]) == 1) { /* straight on, or straight back */
                    EXPECT_NEAR(vec3x8_dot(d, w)[0], gs[i], 1e-6);
                    EXPECT_NEAR(pdf, 0, 0);
                }
                if (fabsf(gs[i]) <= 1e-6f)
                    EXPECT_NEAR(pdf, 0.25 / M_PI, 1e-6);
            }
}

static void the_mean_cosine_of_samples_is_g(void **state) /* H32 */
{
    (void)state;
    const float gs[] = { 0, 1e-3f, -0.6f, 0.95f, 0.999f, -0.999f, 1, -1 };
    const struct vec3x8 d = vec3x8_unit(vec3x8_all(0.2f, 0.9f, -0.4f));
    for (size_t i = 0; i < sizeof(gs) / sizeof(gs[0]); i++) {
        double sum = 0;
        const int n = 1 << 17;
        for (int k = 0; k < n; k++) {
            struct vec3x8 w = phase_sample(F8(gs[i]), d, F8(((float)k + 0.5f) / (float)n),
                                           F8(0.3f));
            sum += (double)vec3x8_dot(d, w)[0];
        }
        EXPECT_NEAR(sum / n, gs[i], 1e-4);
    }
}

/* ---- flights */

static void the_depth_of_a_medium_is_right_for_every_thickness(void **state)
{
    (void)state;
    for (int k = -70; k <= 20; k++)
        for (int j = -3; j <= 3; j++) {
            double sigma = pow(10, j), x = pow(10, k / 10.0);
            float got = medium_depth(F8((float)sigma), F8((float)(x / sigma)))[0];
            double want = -expm1(-(double)(float)sigma * (double)(float)(x / sigma)) / sigma;
            EXPECT_NEAR(got, want, 1e-6 * want);
        }
    EXPECT_NEAR(medium_depth(F8(0), F8(MEDIUM_FAR))[0], 0, 0);
}

/* A medium with other coefficients in every colour */
static struct medium8 colorful(void)
{
    return (struct medium8){ .sigma_a = vec3x8_all(0.2f, 0, 1.5f),
                             .sigma_s = vec3x8_all(0.3f, 2, 0.1f),
                             .Le = vec3x8_all(0, 0, 0),
                             .g = F8(0) };
}

static void flights_carry_what_arrives_and_what_scatters(void **state)
{
    (void)state;
    for (int planted = 0; planted < 2; planted++) {
        struct random_lanes random = { 3, 0 };
        struct tally arrived[3] = { 0 }, scattered[3] = { 0 };
        const struct medium8 m = colorful();
        struct medium8 flown = m;
        if (planted) /* the colours of the medium confused */
            flown.sigma_s = vec3x8_all(0.3f, 1.96f, 0.1f);
        const float far = 0.8f;
        const struct vec3x8 beta = vec3x8_all(0.7f, 0.2f, 1.1f);
        float most = 0;
        for (int k = 0; k < 200000; k++) {
            f8 u_color = random_f8(&random), u = random_f8(&random);
            struct flight8 f = medium_fly(&flown, beta, F8(far), u_color, u);
            const f8 after[3] = { f.beta.x, f.beta.y, f.beta.z };
            for (int lane = 0; lane < LANES; lane++)
                for (int c = 0; c < 3; c++) {
                    bool on_the_way = f.scattered[lane] != 0;
                    tally_add(&arrived[c], on_the_way ? 0 : (double)after[c][lane]);
                    tally_add(&scattered[c], on_the_way ? (double)after[c][lane] : 0);
                }
            f8 sum = f.beta.x + f.beta.y + f.beta.z;
            for (int lane = 0; lane < LANES; lane++)
                most = fmaxf(most, sum[lane]);
        }
        assert_true(most <= 2.00001f);
        const double b[3] = { 0.7, 0.2, 1.1 }, a[3] = { 0.2, 0, 1.5 }, s[3] = { 0.3, 2, 0.1 };
        double worst = 0;
        for (int c = 0; c < 3; c++) {
            double t = a[c] + s[c], T = exp(-t * (double)far);
            const double want[2] = { b[c] * T, b[c] * s[c] / t * (1 - T) };
            const struct tally *got[2] = { &arrived[c], &scattered[c] };
            for (int k = 0; k < 2; k++)
                worst = fmax(worst, tally_z(got[k], want[k]));
        }
        if (planted)
            assert_true(worst > 8);
        else if (worst > SIGMAS)
            fail_msg("off by %g standard errors", worst);
    }
}

static void what_only_absorbs_is_flown_through_exactly(void **state)
{
    (void)state;
    struct medium8 m = colorful();
    m.sigma_s = vec3x8_all(0, 0, 0);
    const float us[] = { 0, 0.3f, 1 - 0x1p-24f };
    for (int i = 0; i < 9; i++) {
        struct flight8 f = medium_fly(&m, vec3x8_all(1, 2, 3), F8(0.7f), F8(us[i % 3]),
                                      F8(us[i / 3]));
        assert_int_equal(i8_bits(f.scattered), 0);
        EXPECT_NEAR(f.beta.x[0], exp(-0.14), 1e-6);
        EXPECT_NEAR(f.beta.y[0], 2, 1e-6);
        EXPECT_NEAR(f.beta.z[0], 3 * exp(-1.05), 1e-6);
        /* To infinity: only what nothing absorbs */
        f = medium_fly(&m, vec3x8_all(1, 2, 3), F8(MEDIUM_FAR), F8(us[i % 3]), F8(us[i / 3]));
        EXPECT_NEAR(f.beta.x[0], 0, 0);
        EXPECT_NEAR(f.beta.y[0], 2, 0);
        EXPECT_NEAR(f.beta.z[0], 0, 0);
    }
    /* Without any throughput nothing is divided by it */
    m = colorful();
    struct flight8 f = medium_fly(&m, vec3x8_all(0, 0, 0), F8(2), F8(0.5f), F8(0.9f));
    EXPECT_NEAR(vec3x8_max(f.beta)[0], 0, 0);
}

/* ---- scenes */

struct colors {
    double mean[3], error[3];
};

static uint32_t add_medium(struct scene *scene, const float a[3], const float s[3], float g)
{
    struct medium *m = &scene->media[scene->medium_count++];
    *m = (struct medium){ .g = g };
    memcpy(m->sigma_a, a, sizeof(m->sigma_a));
    memcpy(m->sigma_s, s, sizeof(m->sigma_s));
    return scene->medium_count;
}

/* All pixels look straight along +z */
static struct scene *narrow_scene(void)
{
    struct scene *scene = scenes_begin(32, 32);
    const float screen[4] = { -1e-5f, 1e-5f, -1e-5f, 1e-5f };
    memcpy(scene->settings.camera.screen, screen, sizeof(screen));
    return scene;
}

/* A ball with something in it and nothing around it */
static struct quadric *ball(struct scene *scene, float z, float radius, uint32_t material,
                            uint32_t inside)
{
    struct quadric *q = scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, z, radius, material, 0);
    q->inside = inside;
    return q;
}

/* A box from z0 to z1 that is as wide as anything; its normals point inwards */
static void slab(struct scene *scene, float z0, float z1, uint32_t material, uint32_t in,
                 uint32_t around)
{
    uint32_t first = scene->mesh_count;
    const float a[3] = { -50, -50, z0 }, b[3] = { 50, 50, z1 };
    scenes_box(scene, a, b, material, 0);
    for (uint32_t i = first; i < scene->mesh_count; i++) {
        scene->meshes[i].outside = in;
        scene->meshes[i].inside = around;
    }
}

static struct colors colors_seen(struct scene *scene, struct picture_how how)
{
    struct err err = { .text = "" };
    scenes_finish(scene);
    if (!scene_check(scene, &err))
        fail_msg("%s", err.text);
    struct picture *p = picture_take(scene, how);
    struct colors seen = { 0 };
    double n = (double)p->width * p->height, samples = how.samples ? how.samples : 16;
    for (int c = 0; c < 3; c++) {
        double sum = 0, squares = 0;
        for (uint32_t i = 0; i < p->width * p->height; i++) {
            double value = (double)p->rgb[3 * i + (uint32_t)c] / samples;
            sum += value;
            squares += value * value;
        }
        seen.mean[c] = sum / n;
        seen.error[c] = sqrt(fmax(squares / n - seen.mean[c] * seen.mean[c], 0) / (n - 1));
    }
    assert_int_equal(p->failed, 0);
    if (scene->settings.max_depth == SCENE_NONE)
        assert_int_equal(p->stats.truncated_paths, 0);
    picture_free(p);
    return seen;
}

static double colors_off(const struct colors *seen, const double want[3])
{
    double worst = 0;
    for (int c = 0; c < 3; c++)
        worst = fmax(worst, fabs(seen->mean[c] - want[c]) /
                                (seen->error[c] + 2e-6 * fabs(want[c]) + 1e-12));
    return worst;
}

static void expect_colors(const struct colors *seen, const double want[3], int line)
{
    if (colors_off(seen, want) > SIGMAS)
        fail_msg("line %d: %.7g %.7g %.7g (errors %.2g %.2g %.2g), want %.7g %.7g %.7g", line,
                 seen->mean[0], seen->mean[1], seen->mean[2], seen->error[0], seen->error[1],
                 seen->error[2], want[0], want[1], want[2]);
}

static const float none[3] = { 0, 0, 0 }, tints[3] = { 0.5f, 1, 3 };

static void a_slab_absorbs_each_colour_by_its_depth(void **state)
{
    (void)state;
    for (int planted = 0; planted < 2; planted++) {
        struct scene *scene = narrow_scene();
        float sigma[3];
        for (int c = 0; c < 3; c++)
            sigma[c] = tints[c] * (planted ? 1.0001f : 1);
        scenes_sky(scene, 2);
        slab(scene, 1, 1.7f, SCENE_NONE, add_medium(scene, sigma, none, 0), 0);
        struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
        const double want[3] = { 2 * exp(-0.35), 2 * exp(-0.7), 2 * exp(-2.1) };
        if (planted)
            assert_true(colors_off(&seen, want) > 8);
        else
            expect_colors(&seen, want, __LINE__);
        scene_free(scene);
    }
}

static void surfaces_say_which_medium_comes_next(void **state)
{
    (void)state;
    /* A slab in a slab, and one more that says nothing: the same on both sides */
    struct scene *scene = narrow_scene();
    scenes_sky(scene, 1);
    const float b[3] = { 0.2f, 0.4f, 0.1f };
    uint32_t outer = add_medium(scene, tints, none, 0), inner = add_medium(scene, b, none, 0);
    slab(scene, 1, 4, SCENE_NONE, outer, 0);
    slab(scene, 2, 2.5f, SCENE_NONE, inner, outer);
    slab(scene, 3, 3.5f, SCENE_NONE, inner, inner);
    struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
    double want[3];
    for (int c = 0; c < 3; c++)
        want[c] = exp(-2.5 * (double)tints[c] - 0.5 * (double)b[c]);
    expect_colors(&seen, want, __LINE__);

    /* The camera in the outer one, and in vacuum again behind it */
    scene->settings.camera.position[2] = 3;
    scene->settings.camera_medium = outer;
    seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
    for (int c = 0; c < 3; c++)
        want[c] = exp(-(double)tints[c]);
    expect_colors(&seen, want, __LINE__);
    scene_free(scene);
}

static void an_endless_medium_lets_nothing_through_from_infinity(void **state)
{
    (void)state;
    struct scene *scene = narrow_scene();
    scenes_sky(scene, 1);
    scenes_light(
        scene,
        (struct light){ .kind = LIGHT_DISTANT, .radiance = { 5, 5, 5 }, .direction = { 0, 0, 1 } });
    const float floor[4][3] = { { -9, -9, 2 }, { -9, 9, 2 }, { 9, 9, 2 }, { 9, -9, 2 } };
    scenes_quad(scene, floor, scenes_diffuse(scene, 0.5f), 0);
    const float sigma[3] = { 1e-3f, 0, 1e-3f };
    scene->settings.camera_medium = add_medium(scene, sigma, none, 0);
    struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
    assert_true(seen.mean[1] > 0.5);
    EXPECT_NEAR(seen.mean[0], 0, 0);
    EXPECT_NEAR(seen.mean[2], 0, 0);
    scene_free(scene);
}

static void what_does_not_absorb_is_invisible_under_a_sky(void **state)
{
    (void)state;
    const struct {
        float s[3], g, camera_z;
        int glass;
    } cases[] = {
        { { 1, 1, 1 }, 0, 0, 0 },           { { 0.3f, 2, 6 }, 0.7f, 0, 0 },
        { { 0.3f, 2, 6 }, -0.7f, 2.5f, 0 }, { { 2, 2, 0 }, 0.2f, 2.5f, 0 },
        { { 0.3f, 1, 3 }, 0.7f, 0, 1 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++)
        for (int planted = 0; planted < 2; planted++) {
            struct scene *scene = narrow_scene();
            scenes_sky(scene, 1);
            float a[3] = { 0, 0, 0 };
            for (int c = 0; c < 3; c++)
                a[c] = planted ? 0.02f * cases[i].s[c] : 0;
            uint32_t fog = add_medium(scene, a, cases[i].s, cases[i].g), glass = SCENE_NONE;
            if (cases[i].glass) /* it stays inside where it is reflected */
                glass = scenes_material(
                    scene, (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f });
            ball(scene, 3, 1, glass, fog);
            scene->settings.camera.position[2] = cases[i].camera_z;
            if (cases[i].camera_z > 2)
                scene->settings.camera_medium = fog;
            struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 64 });
            const double want[3] = { 1, 1, 1 };
            if (planted)
                assert_true(colors_off(&seen, want) > 8);
            else
                expect_colors(&seen, want, __LINE__);
            scene_free(scene);
        }
}

static void a_medium_glows_by_what_it_absorbs(void **state)
{
    (void)state;
    struct scene *scene = narrow_scene();
    uint32_t fire = add_medium(scene, tints, none, 0);
    const float Le[3] = { 4, 2, 1 };
    memcpy(scene->media[0].Le, Le, sizeof(Le));
    ball(scene, 3, 1, SCENE_NONE, fire);
    struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
    double want[3];
    for (int c = 0; c < 3; c++)
        want[c] = (double)Le[c] * (1 - exp(-2 * (double)tints[c]));
    expect_colors(&seen, want, __LINE__);

    /* As bright as what is around it, it is invisible, however it scatters */
    for (int planted = 0; planted < 2; planted++) {
        struct scene *furnace = narrow_scene();
        const float s[3] = { 3, 0.5f, 1 };
        uint32_t medium = add_medium(furnace, tints, s, 0.5f);
        for (int c = 0; c < 3; c++)
            furnace->media[0].Le[c] = planted ? 1.02f : 1;
        scenes_sky(furnace, 1);
        ball(furnace, 3, 1, SCENE_NONE, medium);
        seen = colors_seen(furnace, (struct picture_how){ .samples = 64 });
        const double one[3] = { 1, 1, 1 };
        if (planted)
            assert_true(colors_off(&seen, one) > 8);
        else
            expect_colors(&seen, one, __LINE__);
        scene_free(furnace);
    }
    scene_free(scene);
}

static void add_point(struct scene *scene, float x, float y, float z)
{
    scenes_light(
        scene,
        (struct light){ .kind = LIGHT_POINT, .radiance = { 1, 1, 1 }, .position = { x, y, z } });
}

static void a_point_light_fades_on_both_ways(void **state)
{
    (void)state;
    /* A floor at 3, the light 1.2 before it; in an endless medium, or the light in a ball of it */
    for (int bounded = 0; bounded < 2; bounded++)
        for (int planted = 0; planted < 2; planted++) {
            struct scene *scene = narrow_scene();
            const float floor[4][3] = { { -9, -9, 3 }, { -9, 9, 3 }, { 9, 9, 3 }, { 9, -9, 3 } };
            scenes_quad(scene, floor, scenes_diffuse(scene, 0.5f), 0);
            scene->settings.max_depth = 1;
            add_point(scene, 0, 0, planted ? 1.801f : 1.8f);
            uint32_t medium = add_medium(scene, tints, none, 0);
            if (bounded)
                ball(scene, 1.8f, 0.4f, SCENE_NONE, medium);
            else
                scene->settings.camera_medium = medium;
            struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
            double want[3];
            for (int c = 0; c < 3; c++)
                want[c] = 0.5 / M_PI / 1.44 * exp(-(double)tints[c] * (bounded ? 1.2 : 4.2));
            if (planted)
                assert_true(colors_off(&seen, want) > 8);
            else
                expect_colors(&seen, want, __LINE__);
            scene_free(scene);
        }
}

static void only_what_media_make_lets_light_through(void **state)
{
    (void)state;
    /* A ball between light and floor: of fog that is clear, of glass, of something black */
    for (int kind = 0; kind < 4; kind++) {
        struct scene *scene = scenes_begin(16, 16);
        const float floor[4][3] = { { -9, -9, 3 }, { -9, 9, 3 }, { 9, 9, 3 }, { 9, -9, 3 } };
        scenes_quad(scene, floor, scenes_diffuse(scene, 0.5f), 0);
        const float screen[4] = { -1e-5f, 1e-5f, -1e-5f, 1e-5f };
        memcpy(scene->settings.camera.screen, screen, sizeof(screen));
        scene->settings.max_depth = 1;
        add_point(scene, 0, 3, 0);
        uint32_t clear = add_medium(scene, none, none, 0), material = SCENE_NONE;
        if (kind == 1)
            material = scenes_material(
                scene, (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f });
        if (kind == 2)
            material = scenes_diffuse(scene, 0);
        if (kind < 3)
            scenes_quadric(scene, QUADRIC_SPHERE, 0, 1.5f, 1.5f, 0.5f, material, 0)->inside = clear;
        struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
        double open = 0.5 / M_PI / 18 * sqrt(0.5);
        EXPECT_NEAR(seen.mean[0], kind == 0 || kind == 3 ? open : 0, 1e-5 * open);
        scene_free(scene);
    }
}

/* Henyey and Greenstein */
static double phase(double g, double cosine)
{
    return (1 - g * g) / (4 * M_PI * pow(1 + g * g - 2 * g * cosine, 1.5));
}

/* Of one scattering, along the ray from the origin along +z, out of light from (x, 0, z) */
static double single_point(double a, double s, double g, double x, double z, int n)
{
    double sum = 0;
    const double end = 40;
    for (int k = 0; k < n; k++) {
        /* Close steps where the light is near */
        double v = (k + 0.5) / n, low = atan(-z / x), high = atan((end - z) / x);
        double angle = low + v * (high - low), t = z + x * tan(angle);
        double r = x / cos(angle), dt = (high - low) / n * r * r / x;
        sum += exp(-(a + s) * (t + r)) * s * phase(g, (z - t) / r) / (r * r) * dt;
    }
    return sum;
}

static void light_scatters_once_as_quadrature_says(void **state)
{
    (void)state;
    const struct {
        float a[3], s[3], g;
    } cases[] = {
        { { 0, 0, 0 }, { 0.2f, 0.6f, 2 }, 0 },
        { { 0.5f, 0, 0.1f }, { 0.1f, 1, 0.3f }, 0.6f },
        { { 0.1f, 0.1f, 0.1f }, { 0.5f, 0.5f, 0.5f }, -0.8f },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct scene *scene = narrow_scene();
        scene->settings.max_depth = 1;
        add_point(scene, 0.5f, 0, 1.5f);
        scene->settings.camera_medium = add_medium(scene, cases[i].a, cases[i].s, cases[i].g);
        struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 256 });
        double want[3], wrong[3];
        for (int c = 0; c < 3; c++) {
            double a = (double)cases[i].a[c], s = (double)cases[i].s[c], g = (double)cases[i].g;
            want[c] = single_point(a, s, g, 0.5, 1.5, 100000);
            wrong[c] = single_point(a, s, g + 0.05, 0.5, 1.5, 100000);
        }
        expect_colors(&seen, want, __LINE__);
        assert_true(colors_off(&seen, wrong) > 8); /* planted: another g */
        scene_free(scene);
    }
}

static void the_tree_of_lights_serves_places_without_a_side(void **state)
{
    (void)state;
    struct scene *scene = narrow_scene();
    scene->settings.max_depth = 1;
    const float a[3] = { 0.1f, 0, 0.3f }, s[3] = { 0.3f, 0.5f, 0.2f };
    scene->settings.camera_medium = add_medium(scene, a, s, 0.4f);
    double want[3] = { 0, 0, 0 };
    for (int i = 0; i < 100; i++) {
        float x = 0.5f + 0.01f * (float)i, z = 0.05f * (float)(i * 37 % 100), turn = (float)i;
        add_point(scene, x * cosf(turn), x * sinf(turn), z);
        for (int c = 0; c < 3; c++)
            want[c] += single_point((double)a[c], (double)s[c], 0.4, (double)x, (double)z, 2000);
    }
    struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 128 });
    assert_true(scene->settings.effects & FX_LIGHT_TREE);
    expect_colors(&seen, want, __LINE__);
    for (int c = 0; c < 3; c++)
        want[c] *= 1.02;
    assert_true(colors_off(&seen, want) >
                8); /* planted: as if 2 % of the lights were never chosen */
    scene_free(scene);
}

/* The same out of a ball of radius R at (x, 0, z) that emits 1, which the ray does not meet */
static double single_ball(double s, double g, double x, double z, double R)
{
    double sum = 0;
    const int n = 400, rings = 60, turns = 60;
    const double end = 30;
    for (int k = 0; k < n; k++) {
        double low = atan(-z / x), high = atan((end - z) / x);
        double at = low + (k + 0.5) / n * (high - low), t = z + x * tan(at);
        double d = x / cos(at), dt = (high - low) / n * d * d / x;
        double cos_axis = (z - t) / d, sin_axis = x / d, one_minus = 1 - sqrt(1 - R * R / (d * d));
        double inner = 0;
        for (int i = 0; i < rings; i++)
            for (int j = 0; j < turns; j++) {
                double m = (i + 0.5) / rings * one_minus, c = 1 - m, r = sqrt(m * (2 - m));
                double cosine = c * cos_axis - r * cos(2 * M_PI * (j + 0.5) / turns) * sin_axis;
                double length = d * c - sqrt(fmax(R * R - d * d * r * r, 0));
                inner += phase(g, cosine) * exp(-s * length);
            }
        sum += inner / (rings * turns) * 2 * M_PI * one_minus * s * exp(-s * t) * dt;
    }
    return sum;
}

/* Densities of light sampling times 2^40 leave it alone to find light, times 0 not at all */
static void light_sampling_alone(struct kernel_scene *ks)
{
    ks->light_pmf[0] *= 0x1p40f;
}

static void scattering_alone(struct kernel_scene *ks)
{
    ks->light_pmf[0] = 0;
}

static void planted_density(struct kernel_scene *ks)
{
    ks->light_pmf[0] *= 1.05f;
}

static void hitting_and_sampling_a_light_agree_in_media(void **state) /* H36 */
{
    (void)state;
    const struct {
        void (*alter)(struct kernel_scene *);
        double scale;
    } techniques[] = { { light_sampling_alone, 0x1p40 },
                       { scattering_alone, 1 },
                       { NULL, 1 },
                       { planted_density, 1 } };
    const float gs[] = { 0, 0.8f };
    for (int i = 0; i < 2; i++) {
        double L = single_ball(0.4, (double)gs[i], 0.8, 1.5, 0.5);
        const double want[3] = { L, L, L };
        for (int k = 0; k < 4; k++) {
            struct scene *scene = narrow_scene();
            scene->settings.max_depth = 1;
            scenes_quadric(scene, QUADRIC_SPHERE, 0.8f, 0, 1.5f, 0.5f, scenes_diffuse(scene, 0), 1);
            const float s[3] = { 0.4f, 0.4f, 0.4f };
            scene->settings.camera_medium = add_medium(scene, none, s, gs[i]);
            struct colors seen = colors_seen(
                scene, (struct picture_how){ .samples = 512, .alter = techniques[k].alter });
            for (int c = 0; c < 3; c++) {
                seen.mean[c] *= techniques[k].scale;
                seen.error[c] *= techniques[k].scale;
            }
            if (k == 3)
                assert_true(colors_off(&seen, want) > 6);
            else
                expect_colors(&seen, want, __LINE__);
            scene_free(scene);
        }
    }
}

static void glass_holds_its_colour_between_its_faces(void **state)
{
    (void)state;
    /* A pane whose inside absorbs exp(-1) on a straight way: the table of the notes, section 3 */
    for (int planted = 0; planted < 2; planted++) {
        struct scene *scene = narrow_scene();
        scenes_sky(scene, 1);
        const float sigma[3] = { planted ? 1.05f : 1, 0, 2 };
        uint32_t medium = add_medium(scene, sigma, none, 0);
        uint32_t glass = scenes_material(
            scene, (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f });
        slab(scene, 1, 2, glass, 0, medium);
        for (uint32_t i = 0; i < scene->mesh_count; i++)
            scene->meshes[i].flags |= MESH_FLIP_NORMAL; /* outwards, as glass wants it */
        struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 256 });
        double R = 0.04, a = exp(-2), T2 = (1 - R) * (1 - R);
        const double want[3] = { 0.339111122903 + 0.044990080416, 1,
                                 (T2 * a + R * a * a * T2) / (1 - R * R * a * a) + R };
        if (planted)
            assert_true(colors_off(&seen, want) > 8);
        else
            expect_colors(&seen, want, __LINE__);
        scene_free(scene);
    }
}

static void instances_hold_media_too(void **state)
{
    (void)state;
    struct scene *scene = narrow_scene();
    scenes_sky(scene, 1);
    uint32_t medium = add_medium(scene, tints, none, 0);
    ball(scene, 0, 0.25f, SCENE_NONE, medium);
    scene->groups[0] = (struct group){ .quadric_count = 1 };
    scene->group_count = 1;
    for (int i = 0; i < 2; i++)
        scene->instances[scene->instance_count++] = (struct instance){
            .to_world = { 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 3.0f + 2.0f * (float)i },
            .to_object = { 0.5f, 0, 0, 0, 0, 0.5f, 0, 0, 0, 0, 0.5f, -1.5f - 1.0f * (float)i },
        };
    struct colors seen = colors_seen(scene, (struct picture_how){ .samples = 4 });
    double want[3];
    for (int c = 0; c < 3; c++)
        want[c] = exp(-2 * (double)tints[c]); /* two balls, each of diameter 1 in the world */
    expect_colors(&seen, want, __LINE__);
    scene_free(scene);
}

static void layers_show_where_paths_scatter_first(void **state)
{
    (void)state;
    struct err err = { .text = "" };
    struct scene *scene = narrow_scene();
    scenes_sky(scene, 1);
    const float a[3] = { 500, 1000, 0 }, s[3] = { 1500, 1000, 4000 };
    ball(scene, 3, 1, SCENE_NONE, add_medium(scene, a, s, 0.3f));
    scenes_finish(scene);
    const uint32_t aovs = AOV_ALL, n = 32 * 32;
    struct job_spec spec = { .replicates = 1,
                             .channel_count = aov_channel_count(aovs),
                             .aovs = aovs,
                             .leaf_samples = 4,
                             .depth_cap = 65536,
                             .max_lanes = 8 };
    profile_thread_mode();
    struct kernel_scene *ks = kernel_open(scene, &spec, &err);
    struct kernel_thread *thread = ks != NULL ? kernel_thread_open(ks, &err) : NULL;
    struct node_sums *sums = node_sums_new(n, spec.channel_count);
    if (thread == NULL || sums == NULL || !kernel_leaf(ks, thread, 0, 0, 0, sums, &err))
        fail_msg("%s", err.text);
    const struct {
        enum aov aov;
        uint32_t component;
        double want, margin;
    } layers[] = { { AOV_ALPHA, 0, 1, 0 },        { AOV_DEPTH, 0, 2, 0.02 },
                   { AOV_POSITION, 2, 2, 0.02 },  { AOV_NORMAL, 2, 0, 0 },
                   { AOV_ALBEDO, 0, 0.75, 1e-6 }, { AOV_ALBEDO, 1, 0.5, 1e-6 },
                   { AOV_ALBEDO, 2, 1, 1e-6 },    { AOV_OBJECT, 0, 0, 0 },
                   { AOV_MATERIAL, 0, 0, 0 } };
    for (size_t i = 0; i < sizeof(layers) / sizeof(layers[0]); i++) {
        double samples = layers[i].want == 0 ? 1 : 4;
        uint32_t channel = aov_channel(aovs, layers[i].aov) + layers[i].component;
        for (uint32_t pixel = 0; pixel < n; pixel++)
            EXPECT_NEAR((double)sums->values[(size_t)channel * n + pixel] / samples, layers[i].want,
                        layers[i].margin);
    }
    node_sums_free(sums);
    kernel_thread_close(thread);
    kernel_close(ks);
    scene_free(scene);
}

/* ---- the same bits */

/* A room full of coloured fog, a ball of glass with ink, a ball of milk, two lights */
static struct scene *foggy_room(void)
{
    struct scene *scene = scenes_begin(40, 33);
    uint32_t white = scenes_diffuse(scene, 0.6f);
    scenes_room(scene, white, white);
    add_point(scene, 0.7f, 0.5f, -0.5f);
    const float s[3] = { 0.2f, 0.4f, 0.9f }, milk[3] = { 8, 9, 10 }, a[3] = { 0.1f, 0, 0 };
    uint32_t fog = add_medium(scene, a, s, 0.6f), ink = add_medium(scene, tints, none, 0);
    uint32_t white_milk = add_medium(scene, none, milk, 0.2f);
    scene->settings.camera_medium = fog;
    uint32_t glass = scenes_material(scene,
                                     (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f });
    struct quadric *q = scenes_quadric(scene, QUADRIC_SPHERE, -0.4f, -0.6f, 0.2f, 0.35f, glass, 0);
    q->inside = ink;
    q->outside = fog;
    q = scenes_quadric(scene, QUADRIC_SPHERE, 0.5f, -0.5f, 0.3f, 0.3f, SCENE_NONE, 0);
    q->inside = white_milk;
    q->outside = fog;
    scenes_finish(scene);
    return scene;
}

static void fog_has_the_same_bits_in_any_number_of_lanes(void **state)
{
    (void)state;
    struct scene *scene = foggy_room();
    struct picture *a = picture_take(scene, (struct picture_how){ .samples = 8 });
    assert_true(a->mean > 0);
    assert_int_equal(a->failed, 0);
    picture_expect_any_lanes(scene, a, 8);
    picture_free(a);
    scene_free(scene);
}

static void a_medium_that_nothing_is_in_changes_no_bit(void **state)
{
    (void)state;
    struct picture *pictures[2];
    for (int unused = 0; unused < 2; unused++) {
        struct scene *scene = foggy_room();
        scene->settings.camera_medium = 0;
        for (uint32_t i = 0; i < scene->quadric_count; i++)
            scene->quadrics[i].inside = scene->quadrics[i].outside = 0;
        scene->medium_count = unused ? 1 : 0;
        scenes_finish(scene);
        pictures[unused] = picture_take(scene, (struct picture_how){ .samples = 8, .kernel = 1 });
        scene_free(scene);
    }
    picture_expect_same(pictures[0], pictures[1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_phase_function_is_normalised_and_has_its_mean_cosine),
        cmocka_unit_test(scattered_directions_follow_the_phase_function),
        cmocka_unit_test(the_extremes_of_g_are_finite),
        cmocka_unit_test(the_mean_cosine_of_samples_is_g),
        cmocka_unit_test(the_depth_of_a_medium_is_right_for_every_thickness),
        cmocka_unit_test(flights_carry_what_arrives_and_what_scatters),
        cmocka_unit_test(what_only_absorbs_is_flown_through_exactly),
        cmocka_unit_test(a_slab_absorbs_each_colour_by_its_depth),
        cmocka_unit_test(surfaces_say_which_medium_comes_next),
        cmocka_unit_test(an_endless_medium_lets_nothing_through_from_infinity),
        cmocka_unit_test(what_does_not_absorb_is_invisible_under_a_sky),
        cmocka_unit_test(a_medium_glows_by_what_it_absorbs),
        cmocka_unit_test(a_point_light_fades_on_both_ways),
        cmocka_unit_test(only_what_media_make_lets_light_through),
        cmocka_unit_test(light_scatters_once_as_quadrature_says),
        cmocka_unit_test(the_tree_of_lights_serves_places_without_a_side),
        cmocka_unit_test(hitting_and_sampling_a_light_agree_in_media),
        cmocka_unit_test(glass_holds_its_colour_between_its_faces),
        cmocka_unit_test(instances_hold_media_too),
        cmocka_unit_test(layers_show_where_paths_scatter_first),
        cmocka_unit_test(fog_has_the_same_bits_in_any_number_of_lanes),
        cmocka_unit_test(a_medium_that_nothing_is_in_changes_no_bit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
