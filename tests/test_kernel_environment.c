/*
 * Environments: places and directions, densities against samples (NUMERICS H40 to H42), irradiance
 * against closed forms, and pictures of the path kernel by light sampling, by scattering and by
 * both. Runs for about ten seconds.
 */
#include "common/direction_map.h"
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "tests/techniques.h"
#include "worker/kernel/light.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const float straight[9] = { 1, 0, 0, 0, 1, 0, 0, 0, 1 };
static const float turned[9] = { /* and mirrored */
                                 0.36f, 0.48f, -0.8f, -0.8f, 0.6f, 0, -0.48f, -0.64f, -0.6f
};

typedef double picture_function(uint32_t x, uint32_t y, const double w[3]);

/* A light of the sky (or a point at the origin) with a picture of its own; texels of one channel */
static uint32_t add_environment(struct scene *scene, uint32_t kind, uint32_t layout, uint32_t width,
                                uint32_t height, const float to_light[9], picture_function *value)
{
    uint32_t blocks = (width * height * 4 + TEXEL_BLOCK - 1) / TEXEL_BLOCK;
    uint8_t *texels = arena_alloc(scene->arena, scene->texel_block_count + blocks, TEXEL_BLOCK);
    assert_non_null(texels);
    memcpy(texels, scene->texels, (size_t)scene->texel_block_count * TEXEL_BLOCK);
    float *out = (float *)(void *)(texels + (size_t)scene->texel_block_count * TEXEL_BLOCK);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            double w[3];
            direction_map_direction(layout, (x + 0.5) / width, (y + 0.5) / height, w);
            *out++ = (float)value(x, y, w);
        }
    scene->pictures[scene->picture_count] = (struct scene_picture){
        .first_block = scene->texel_block_count,
        .width = width,
        .height = height,
        .channels = 1,
        .levels = 1,
        .texel = TEXEL_FLOAT,
    };
    scene->texels = texels;
    scene->texel_block_count += blocks;
    struct environment *environment = &scene->environments[scene->environment_count];
    *environment = (struct environment){ .picture = scene->picture_count++,
                                         .layout = layout,
                                         .scale = { 1, 1, 1 } };
    memcpy(environment->to_light, to_light, sizeof(environment->to_light));
    environment->light = scenes_light(
        scene, (struct light){ .kind = kind, .environment = ++scene->environment_count });
    return environment->light;
}

static double one(uint32_t x, uint32_t y, const double w[3])
{
    (void)x;
    (void)y;
    (void)w;
    return 1;
}

static double nothing(uint32_t x, uint32_t y, const double w[3])
{
    return 0 * one(x, y, w);
}

static double noise(uint32_t x, uint32_t y, const double w[3])
{
    (void)w;
    return 0.2 + (double)(hash64(x, y) >> 40) * 0x1p-24;
}

static double lobe(uint32_t x, uint32_t y, const double w[3])
{
    (void)x;
    (void)y;
    return fmax(0.6 * w[0] + 0.8 * w[2], 0);
}

/* A bright texel, a dim half, and darkness in the first, the last and a middle row and column */
static double sun(uint32_t x, uint32_t y, const double w[3])
{
    if (x == 5 && y == 4)
        return 1e4;
    if (x == 0 || x == 7 || x == 15 || y == 0 || y == 7 || y == 15)
        return 0;
    return w[2] > 0 ? 0.5 : 0;
}

/* A scene of one environment, opened */
struct sky {
    struct scene *scene;
    struct kernel_scene *ks;
    const struct environment_table *table;
};

static struct sky sky_open(uint32_t layout, uint32_t width, uint32_t height, const float m[9],
                           picture_function *value)
{
    struct sky sky = { .scene = scenes_begin(1, 1) };
    scenes_diffuse(sky.scene, 0);
    add_environment(sky.scene, LIGHT_SKY, layout, width, height, m, value);
    scenes_finish(sky.scene);
    assert_true(scene_check(sky.scene, NULL));
    sky.ks = scenes_open(sky.scene, (struct picture_how){ 0 });
    sky.table = &sky.ks->environments[0];
    return sky;
}

static void sky_close(struct sky *sky)
{
    kernel_close(sky->ks);
    scene_free(sky->scene);
}

static __attribute__((noinline)) struct light_sample8 take(const struct kernel_scene *ks,
                                                           struct random_lanes *r)
{
    f8 u = random_f8(r), v = random_f8(r), pick = random_f8(r);
    return light_sample(ks, FX_ALL, I8(-1), vec3x8_all(1, 2, 3), vec3x8_all(0, 0, 0), pick, u, v);
}

/* Density times solid angle of every texel, and their sum */
static double texel_masses(const struct environment_table *t, double *mass)
{
    double sum = 0;
    for (int32_t y = 0; y < t->height; y++)
        for (int32_t x = 0; x < t->width; x++) {
            const struct environment_texel *texel = &t->texels[y * (t->width + 1) + x];
            double m = (double)(texel[1].below - texel[0].below) * (double)t->row_density[y] *
                       direction_map_omega((uint32_t)t->layout, (uint32_t)t->width,
                                           (uint32_t)t->height, (uint32_t)y);
            if (mass != NULL)
                mass[y * t->width + x] = m;
            sum += m;
        }
    return sum;
}

/* ---- places */

static void directions_and_places_are_each_others_inverse(void **state) /* H41 */
{
    (void)state;
    struct random_lanes r = { 3, 0 };
    const float special[] = {
        0, -0.0f, 1, -1, 1e-30f, -1e-30f, 1e-20f, 1e-5f, -1e-5f, 0.6f, -0.8f
    };
    enum { SPECIAL = sizeof(special) / sizeof(special[0]) };
    for (int i = 0; i < 20000; i++) {
        struct vec3x8 w = random_direction(&r);
        if (i < SPECIAL * SPECIAL * SPECIAL) {
            w = vec3x8_all(special[i % SPECIAL], special[i / SPECIAL % SPECIAL],
                           special[i / SPECIAL / SPECIAL]);
            float longest = fmaxf(fabsf(w.x[0]), fmaxf(fabsf(w.y[0]), fabsf(w.z[0])));
            if (longest < 0.5f)
                continue;
            w = vec3x8_unit(w);
        }
        struct vec2x8 place = environment_to_square(w);
        struct vec3x8 back = environment_from_square(place.x, place.y);
        for (int lane = 0; lane < LANES; lane++) {
            double u = (double)place.x[lane], v = (double)place.y[lane], exact[3];
            assert_true(fabs(u) <= 1 && fabs(v) <= 1);
            direction_map_direction(ENVIRONMENT_SQUARE, (u + 1) / 2, (v + 1) / 2, exact);
            EXPECT_NEAR(back.x[lane], w.x[lane], 4e-7);
            EXPECT_NEAR(back.y[lane], w.y[lane], 4e-7);
            EXPECT_NEAR(back.z[lane], w.z[lane], 4e-7);
            EXPECT_NEAR(exact[0], w.x[lane], 4e-7);
            EXPECT_NEAR(exact[1], w.y[lane], 4e-7);
            EXPECT_NEAR(exact[2], w.z[lane], 4e-7);
        }
    }
    /* At the upper pole every digit is kept */
    struct vec2x8 place = environment_to_square(vec3x8_all(3e-12f, 4e-12f, 1));
    struct vec3x8 back = environment_from_square(place.x, place.y);
    EXPECT_NEAR(back.x[0] / 3e-12f, 1, 1e-6);
    EXPECT_NEAR(back.y[0] / 4e-12f, 1, 1e-6);
}

/*
 * Points inside of texels, by the double formulas, are found in them: close to the edges too, and
 * less close where a rotation in float32 lies between
 */
static void every_point_is_in_its_texel(void **state)
{
    (void)state;
    for (int i = 0; i < 4; i++) {
        uint32_t layout = i % 2 ? ENVIRONMENT_LAT_LONG : ENVIRONMENT_SQUARE;
        uint32_t width = i % 2 ? 126 : 64, height = i % 2 ? 63 : 64;
        const float *m = i < 2 ? straight : turned;
        const double edge = i < 2 ? 0.001 : 0.1;
        struct sky sky = sky_open(layout, width, height, m, noise);
        for (uint32_t corner = 0; corner < 4 * width * height; corner++) {
            uint32_t x = corner / 4 % width, y = corner / 4 / width;
            double w[3], world[3];
            direction_map_direction(layout, (x + (corner & 1 ? 1 - edge : edge)) / width,
                                    (y + (corner & 2 ? 1 - edge : edge)) / height, w);
            for (int k = 0; k < 3; k++)
                world[k] = w[0] * (double)m[k] + w[1] * (double)m[3 + k] + w[2] * (double)m[6 + k];
            struct vec3x8 wi = vec3x8_all((float)world[0], (float)world[1], (float)world[2]);
            struct environment_place8 place = environment_place(sky.table, wi);
            if (place.row[0] != (int32_t)y || place.texel[0] != (int32_t)(y * (width + 1) + x))
                fail_msg("layout %u: texel %u, %u is found in row %d, texel %d", layout, x, y,
                         place.row[0], place.texel[0]);
        }
        sky_close(&sky);
    }
}

/* ---- densities */

static const struct {
    const char *name;
    uint32_t layout, width, height;
    const float *m;
    picture_function *value;
} pictures[] = {
    { "square noise", ENVIRONMENT_SQUARE, 16, 16, turned, noise },
    { "square sun", ENVIRONMENT_SQUARE, 16, 16, straight, sun },
    { "square of one", ENVIRONMENT_SQUARE, 1, 1, straight, one },
    { "odd square", ENVIRONMENT_SQUARE, 13, 13, turned, lobe },
    { "dark square", ENVIRONMENT_SQUARE, 5, 5, straight, nothing },
    { "lat-long noise", ENVIRONMENT_LAT_LONG, 24, 12, turned, noise },
    { "lat-long sun", ENVIRONMENT_LAT_LONG, 32, 16, turned, sun },
    { "lat-long of two", ENVIRONMENT_LAT_LONG, 2, 1, straight, one },
    { "odd lat-long", ENVIRONMENT_LAT_LONG, 18, 9, straight, lobe },
};
enum { PICTURES = sizeof(pictures) / sizeof(pictures[0]) };

static void every_texel_is_chosen_as_often_as_its_density_says(void **state) /* H40, H42 */
{
    (void)state;
    for (int i = 0; i < PICTURES; i++) {
        struct sky sky = sky_open(pictures[i].layout, pictures[i].width, pictures[i].height,
                                  pictures[i].m, pictures[i].value);
        const struct environment_table *t = sky.table;
        double mass[24 * 32], planted[24 * 32];
        unsigned long long counts[24 * 32] = { 0 };
        int cells = t->width * t->height;
        EXPECT_NEAR(texel_masses(t, mass), 1, 1e-6);
        struct random_lanes r = { (uint64_t)i, 0 };
        unsigned strays = 0;
        const int samples = 400000;
        for (int k = 0; k < samples; k += LANES) {
            struct environment_sample8 s = environment_sample(t, random_f8(&r), random_f8(&r));
            struct environment_sample8 seen = environment_seen(t, s.wi);
            struct environment_place8 place = environment_place(t, s.wi);
            for (int lane = 0; lane < LANES; lane++) {
                assert_true(s.L.x[lane] > 0 || pictures[i].value == nothing);
                strays += seen.pdf[lane] != s.pdf[lane] || seen.L.x[lane] != s.L.x[lane];
                counts[place.row[lane] * t->width + place.texel[lane] -
                       place.row[lane] * (t->width + 1)]++;
            }
        }
        assert_true(strays <= 20); /* on the very edge of a texel */
        for (int k = 0; k < cells; k++)
            planted[k] = mass[k] * (k % 2 ? 1.06 : 1);
        double p = cells > 2 ? chi2_pooled(mass, counts, cells, samples) : 1;
        if (!(p > CHI2_ALPHA))
            fail_msg("%s: p = %g", pictures[i].name, p);
        if (pictures[i].value == noise)
            assert_true(chi2_pooled(planted, counts, cells, samples) < CHI2_ALPHA);
        sky_close(&sky);
    }
}

static void aim_pdf(void *self, const struct vec3x8 *w, f8 *pdf)
{
    *pdf = environment_seen(self, *w).pdf;
}

static void aim_sample(void *self, struct random_lanes *r, struct vec3x8 *w, i8 *valid)
{
    *w = environment_sample(self, random_f8(r), random_f8(r)).wi;
    *valid = I8(-1);
}

static void directions_follow_the_density_on_the_sphere(void **state) /* H41 */
{
    (void)state;
    for (int i = 0; i < PICTURES; i++) {
        if (pictures[i].value == sun)
            continue; /* too sharp for this grid; counted by texels above */
        struct sky sky = sky_open(pictures[i].layout, pictures[i].width, pictures[i].height,
                                  pictures[i].m, pictures[i].value);
        struct environment_table table = *sky.table;
        struct chi2_case c = { .self = &table,
                               .axis = { 0.2f, -0.3f, 1 },
                               .power = 1,
                               .samples = 200000,
                               .seed = (uint64_t)i + 77,
                               .pdf = aim_pdf,
                               .sample = aim_sample };
        struct chi2_result result = chi2_run(&c);
        if (!(result.p > CHI2_ALPHA && chi2_scale_right(&result, c.samples, 3e-3)))
            fail_msg("%s: p = %g, integral %g", pictures[i].name, result.p, result.integral);
        sky_close(&sky);
    }
    /* Planted: sines forgotten at the poles, as if all rows had the same solid angle */
    struct sky sky = sky_open(ENVIRONMENT_LAT_LONG, 24, 12, turned, noise);
    struct environment_table *t = &sky.ks->environments[0];
    for (int32_t y = 0; y < t->height; y++)
        t->row_bounds[y] = (float)y / (float)t->height;
    struct chi2_case c = { .self = t,
                           .axis = { 0.2f, -0.3f, 1 },
                           .power = 1,
                           .samples = 200000,
                           .seed = 5,
                           .pdf = aim_pdf,
                           .sample = aim_sample };
    assert_true(chi2_run(&c).p < CHI2_CAUGHT);
    sky_close(&sky);
}

static double h40(uint32_t x, uint32_t y, const double w[3])
{
    (void)w;
    return x == 1000 && y == 300 ? 1e6 : 1e-2;
}

static void a_tiny_sun_leaves_every_other_texel_its_chance(void **state) /* H40 */
{
    (void)state;
    enum { WIDTH = 4096, HEIGHT = 2048 };
    struct sky sky = sky_open(ENVIRONMENT_LAT_LONG, WIDTH, HEIGHT, straight, h40);
    const struct environment_table *t = sky.table;
    EXPECT_NEAR(texel_masses(t, NULL), 1, 1e-6); /* of the float densities; the chances: */
    assert_int_equal(t->rows[HEIGHT], 1 << 24);
    float running = 0; /* planted: a running sum in float */
    unsigned lost = 0;
    for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
        float next = running + (float)h40(i % WIDTH, i / WIDTH, NULL);
        lost += next <= running;
        running = next;
    }
    assert_true(lost > 7000000);
    for (int32_t y = 0; y < t->height; y++) {
        assert_true(t->row_density[y] > 0);
        assert_int_equal(t->texels[y * (t->width + 1) + t->width].below, 1 << 24);
        for (int32_t x = 0; x < t->width; x++)
            assert_true(t->texels[y * (t->width + 1) + x + 1].below >
                        t->texels[y * (t->width + 1) + x].below);
    }
    /* The integral of the radiance, by samples */
    double want = 4 * M_PI * 1e-2 +
                  1e6 * direction_map_omega(ENVIRONMENT_LAT_LONG, WIDTH, HEIGHT, 300);
    struct random_lanes r = { 40, 0 };
    struct tally all = { 0 };
    for (int i = 0; i < 50000; i++) {
        struct environment_sample8 s = environment_sample(t, random_f8(&r), random_f8(&r));
        for (int lane = 0; lane < LANES; lane++)
            tally_add(&all, (double)s.L.x[lane] / (double)s.pdf[lane]);
    }
    if (!(tally_z(&all, want) < 4.5))
        fail_msg("%g, want %g, z = %g", tally_mean(&all), want, tally_z(&all, want));
    sky_close(&sky);
}

static void the_ends_of_the_unit_interval_never_find_darkness(void **state) /* H42 */
{
    (void)state;
    const float ends[] = { 0, 0x1p-24f, 0.5f, 0x1.fffffep-1f };
    for (uint32_t layout = ENVIRONMENT_SQUARE; layout <= ENVIRONMENT_LAT_LONG; layout++) {
        struct sky sky = sky_open(layout, layout ? 32 : 16, 16, straight, sun);
        for (int i = 0; i < 16; i++) {
            struct environment_sample8 s = environment_sample(sky.table, F8(ends[i % 4]),
                                                              F8(ends[i / 4]));
            assert_true(s.L.x[0] > 0 && s.pdf[0] > 0 && isfinite(s.pdf[0]));
            EXPECT_NEAR(vec3x8_length2(s.wi)[0], 1, 1e-6);
        }
        sky_close(&sky);
    }
}

/* ---- irradiance */

/* Of a surface with normal n: the sum over texels, each cut into smaller ones */
static double irradiance_of(uint32_t layout, uint32_t width, uint32_t height, const float m[9],
                            picture_function *value, const double n[3])
{
    const uint32_t cut = 256 / width + 8;
    double sum = 0, local[3];
    for (int k = 0; k < 3; k++)
        local[k] = (double)m[3 * k] * n[0] + (double)m[3 * k + 1] * n[1] +
                   (double)m[3 * k + 2] * n[2];
    for (uint32_t y = 0; y < cut * height; y++)
        for (uint32_t x = 0; x < cut * width; x++) {
            double w[3], center[3];
            direction_map_direction(layout, (x / cut + 0.5) / width, (y / cut + 0.5) / height,
                                    center);
            direction_map_direction(layout, (x + 0.5) / (cut * width), (y + 0.5) / (cut * height),
                                    w);
            double cosine = w[0] * local[0] + w[1] * local[1] + w[2] * local[2];
            sum += value(x / cut, y / cut, center) * fmax(cosine, 0) *
                   direction_map_omega(layout, cut * width, cut * height, y);
        }
    return sum;
}

static struct tally irradiance(const struct sky *sky, const double n[3], double plant)
{
    struct random_lanes r = { 42, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < 50000; i++) {
        struct light_sample8 s = take(sky->ks, &r);
        for (int lane = 0; lane < LANES; lane++) {
            double cosine = (double)s.wi.x[lane] * n[0] + (double)s.wi.y[lane] * n[1] +
                            (double)s.wi.z[lane] * n[2];
            double f = (double)s.radiance.x[lane] / (plant * (double)s.pdf[lane]);
            tally_add(&t, s.valid[lane] && cosine > 0 ? f * cosine : 0);
        }
    }
    return t;
}

static void surfaces_receive_what_the_picture_sends(void **state)
{
    (void)state;
    const double normals[3][3] = { { 0, 0, 1 }, { 0.6, -0.8, 0 }, { -0.48, 0.6, -0.64 } };
    for (int i = 0; i < PICTURES; i++) {
        if (pictures[i].value == nothing)
            continue;
        struct sky sky = sky_open(pictures[i].layout, pictures[i].width, pictures[i].height,
                                  pictures[i].m, pictures[i].value);
        double most = 0;
        int brightest = 0;
        for (int k = 0; k < 3; k++) {
            double want = irradiance_of(pictures[i].layout, pictures[i].width, pictures[i].height,
                                        pictures[i].m, pictures[i].value, normals[k]);
            if (pictures[i].value == one)
                EXPECT_NEAR(want, M_PI, 1e-3);
            struct tally t = irradiance(&sky, normals[k], 1);
            if (!(tally_z(&t, want) < 4.5 || fabs(tally_mean(&t) - want) < 1e-3 * want))
                fail_msg("%s: %g, want %g, z = %g", pictures[i].name, tally_mean(&t), want,
                         tally_z(&t, want));
            brightest = want > most ? k : brightest;
            most = fmax(most, want);
        }
        struct tally planted = irradiance(&sky, normals[brightest], 1.05);
        if (!(tally_z(&planted, most) > 4.5))
            fail_msg("%s: a density 5 %% too large is not seen", pictures[i].name);
        sky_close(&sky);
    }
    /* A cosine lobe, head on: the integral of cos^2 is 2 pi / 3 */
    struct sky sky = sky_open(ENVIRONMENT_SQUARE, 64, 64, straight, lobe);
    struct tally t = irradiance(&sky, (const double[3]){ 0.6, 0, 0.8 }, 1);
    EXPECT_NEAR(tally_mean(&t), 2 * M_PI / 3, 4.5 * sqrt(tally_variance(&t) / t.n) + 1e-3);
    sky_close(&sky);
}

/* ---- pictures */

static void planted_alone(struct kernel_scene *ks) /* densities 2 % too large */
{
    for (int32_t y = 0; y < ks->environments[0].height; y++)
        ks->environments[0].row_density[y] *= 1.02f;
    technique_lights_alone(ks);
}

static struct estimate direct(struct scene *scene, enum technique technique)
{
    return estimate_take(
        scene, technique,
        (struct picture_how){ .samples = 256,
                              .leaves = 4,
                              .alter = technique == LIGHTS_PLANTED ? planted_alone : NULL });
}

static struct scene *receiver(struct material material)
{
    struct scene *scene = scenes_begin(16, 16);
    technique_receiver(scene, scenes_material(scene, material), (float[3]){ 0.6f, 0, 1 },
                       (float[3]){ -0.6f, 0, -1 });
    return scene;
}

static void all_techniques_find_the_same_light(void **state) /* H36, H40 */
{
    (void)state;
    const struct material materials[] = {
        { .reflectance = { 0.5f, 0.5f, 0.5f } },
        { .kind = MATERIAL_CONDUCTOR,
          .eta = { 0.2f, 0.2f, 0.2f },
          .k = { 3.9f, 3.9f, 3.9f },
          .alpha = { 0.3f, 0.3f } },
        { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f, .alpha = { 0.3f, 0.3f } },
    };
    for (int m = 0; m < 3; m++)
        for (int i = 0; i < PICTURES; i++) {
            if (pictures[i].value == nothing)
                continue;
            struct scene *scene = receiver(materials[m]);
            add_environment(scene, LIGHT_SKY, pictures[i].layout, pictures[i].width,
                            pictures[i].height, pictures[i].m, pictures[i].value);
            if (i == 0) /* two of them, and the constant one */
                add_environment(scene, LIGHT_SKY, ENVIRONMENT_LAT_LONG, 24, 12, straight, lobe);
            if (i == 0)
                scenes_sky(scene, 0.25f);
            scenes_finish(scene);
            struct estimate e[3];
            for (int technique = LIGHTS; technique <= BOTH; technique++)
                e[technique] = direct(scene, (enum technique)technique);
            bool mixed = i == 0; /* the constant sky is not light sampling's */
            for (int a = mixed ? SCATTERING : LIGHTS; a <= (mixed ? SCATTERING : BOTH); a++) {
                int b = (a + 1) % 3;
                if (!(e[a].mean > 0 && estimate_apart(e[a], e[b]) < 4))
                    fail_msg("%s on %d: lights %g +- %g, scattering %g +- %g, both %g +- %g",
                             pictures[i].name, m, e[LIGHTS].mean, e[LIGHTS].error,
                             e[SCATTERING].mean, e[SCATTERING].error, e[BOTH].mean, e[BOTH].error);
            }
            technique_expect_switches(scene, (struct picture_how){ .samples = 256, .leaves = 4 },
                                      e[BOTH], pictures[i].name);
            if (pictures[i].value == noise && m == 0 && !mixed)
                assert_true(estimate_apart(direct(scene, LIGHTS_PLANTED), e[SCATTERING]) > 4);
            scene_free(scene);
        }
}

/* A ball on a floor, below a sky that is everywhere 0.7 */
static struct picture *below_a_sky(bool pictured, uint32_t layout)
{
    struct scene *scene = scenes_begin(32, 32);
    scene->settings.camera.position[1] = 1;
    static const float floor[4][3] = { { -9, 0, 0 }, { -9, 0, 18 }, { 9, 0, 18 }, { 9, 0, 0 } };
    scenes_quad(scene, floor, scenes_diffuse(scene, 0.6f), 0);
    scenes_quadric(scene, QUADRIC_SPHERE, 0, 1, 4, 1, scenes_diffuse(scene, 0.8f), 0);
    if (pictured)
        add_environment(scene, LIGHT_SKY, layout, layout ? 16 : 8, 8, turned, one);
    else
        scenes_sky(scene, 0.7f);
    if (pictured)
        for (int c = 0; c < 3; c++)
            scene->environments[0].scale[c] = 0.7f;
    scenes_finish(scene);
    struct picture *picture = picture_take(
        scene, (struct picture_how){ .samples = 256, .lanes = layout ? 8 : 7 });
    scene_free(scene);
    return picture;
}

static void a_constant_picture_is_the_constant_sky(void **state)
{
    (void)state;
    struct picture *sky = below_a_sky(false, 0);
    for (uint32_t layout = ENVIRONMENT_SQUARE; layout <= ENVIRONMENT_LAT_LONG; layout++) {
        struct picture *pictured = below_a_sky(true, layout);
        /* Pixels differ in what they see: compare pixel by pixel */
        struct tally difference = { 0 };
        for (uint32_t i = 0; i < 32 * 32; i++)
            tally_add(&difference, (double)(sky->rgb[3 * i] - pictured->rgb[3 * i]) / 256);
        double z = tally_mean(&difference) / sqrt(tally_variance(&difference) / difference.n);
        EXPECT_NEAR(z, 0, 4);
        EXPECT_NEAR(tally_mean(&difference), 0, 1e-3);
        picture_free(pictured);
    }
    picture_free(sky);
}

/* ---- lights with a picture of their own */

static double quarters(uint32_t x, uint32_t y, const double w[3])
{
    (void)w;
    return 1 + x + 2.0 * y;
}

static void a_point_light_shows_its_picture(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    const float slide[9] = { 2, 0, 0, 0, 2, 0, 0, 0, 1 };
    add_environment(scene, LIGHT_POINT, ENVIRONMENT_PROJECTION, 2, 2, slide, quarters);
    scenes_finish(scene);
    assert_true(scene_check(scene, NULL));
    struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
    const struct {
        float at[3];
        float want; /* intensity */
    } cases[] = {
        { { -0.1f, -0.1f, 1 }, 1 }, { { 0.1f, -0.1f, 1 }, 2 },    { { -0.9f, 0.1f, 2 }, 3 },
        { { 0.9f, 0.9f, 2 }, 4 },   { { 0.51f, 0.1f, 1 }, 0 },    { { 0.1f, 0.51f, 1 }, 0 },
        { { 0.1f, 0.1f, -1 }, 0 },  { { 0.1f, 0.1f, -0.0f }, 0 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        const float *p = cases[i].at;
        float d2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
        struct light_sample8 s = light_sample(ks, FX_ALL, I8(-1), vec3x8_all(p[0], p[1], p[2]),
                                              vec3x8_all(0, 0, 0), F8(0), F8(0), F8(0));
        EXPECT_NEAR(s.radiance.y[0], cases[i].want / d2, 1e-5);
        assert_true(s.valid[0] && s.delta[0]);
    }
    kernel_close(ks);
    scene_free(scene);
}

/* A goniometric light sends into every direction what the picture has there, over the square of the
 * distance, wherever it stands and however it is turned */
static void a_goniometric_light_shines_as_its_picture_says(void **state)
{
    (void)state;
    for (uint32_t layout = ENVIRONMENT_SQUARE; layout <= ENVIRONMENT_LAT_LONG; layout++)
        for (int planted = 0; planted < 2; planted++) {
            const uint32_t width = layout ? 32 : 16, height = 16;
            struct scene *scene = scenes_begin(1, 1);
            scenes_diffuse(scene, 0);
            uint32_t light = add_environment(scene, LIGHT_POINT, layout, width, height, turned,
                                             noise);
            const float at[3] = { 3, -2, 1 };
            memcpy(scene->lights[light].position, at, sizeof(at));
            scenes_finish(scene);
            struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
            struct random_lanes r = { 66, 0 };
            unsigned wrong = 0;
            for (int i = 0; i < 20000; i++) {
                uint32_t x = (uint32_t)(width * random_double(&r)),
                         y = (uint32_t)(height * random_double(&r));
                double w[3], d = pow(10, 4 * random_double(&r) - 2), p[3];
                direction_map_direction(layout, (x + 0.1 + 0.8 * random_double(&r)) / width,
                                        (y + 0.1 + 0.8 * random_double(&r)) / height, w);
                for (int k = 0; k < 3; k++) /* out of the picture's space, or planted: into it */
                    p[k] = planted
                               ? w[0] * (double)turned[3 * k] + w[1] * (double)turned[3 * k + 1] +
                                     w[2] * (double)turned[3 * k + 2]
                               : w[0] * (double)turned[k] + w[1] * (double)turned[3 + k] +
                                     w[2] * (double)turned[6 + k];
                struct vec3x8 from = vec3x8_all((float)(p[0] * d) + at[0],
                                                (float)(p[1] * d) + at[1],
                                                (float)(p[2] * d) + at[2]);
                struct light_sample8 s = light_sample(ks, FX_ALL, I8(-1), from, vec3x8_all(0, 0, 0),
                                                      F8(0), F8(0), F8(0));
                double want = noise(x, y, w) / (d * d);
                double turn = (double)s.wi.x[0] * p[0] + (double)s.wi.y[0] * p[1] +
                              (double)s.wi.z[0] * p[2];
                bool right = s.valid[0] && s.delta[0] && s.pdf[0] == 1 &&
                             fabs((double)s.radiance.x[0] - want) < 2e-4 * want &&
                             fabs(turn + 1) < 1e-5 && fabs((double)s.distance[0] - d) < 2e-4 * d;
                wrong += !right;
            }
            if (planted ? wrong < 10000 : wrong > 0)
                fail_msg("layout %u: %u of 20000 are wrong", layout, wrong);
            kernel_close(ks);
            scene_free(scene);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(directions_and_places_are_each_others_inverse),
        cmocka_unit_test(every_point_is_in_its_texel),
        cmocka_unit_test(every_texel_is_chosen_as_often_as_its_density_says),
        cmocka_unit_test(directions_follow_the_density_on_the_sphere),
        cmocka_unit_test(a_tiny_sun_leaves_every_other_texel_its_chance),
        cmocka_unit_test(the_ends_of_the_unit_interval_never_find_darkness),
        cmocka_unit_test(surfaces_receive_what_the_picture_sends),
        cmocka_unit_test(all_techniques_find_the_same_light),
        cmocka_unit_test(a_constant_picture_is_the_constant_sky),
        cmocka_unit_test(a_point_light_shows_its_picture),
        cmocka_unit_test(a_goniometric_light_shines_as_its_picture_says),
    };
    profile_thread_mode();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
