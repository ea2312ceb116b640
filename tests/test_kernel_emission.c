/*
 * Emission that changes over a light, lights that are there in part or not seen at all, surfaces
 * that show themselves without light, and light through portals. Irradiance against closed forms;
 * sampled directions against their density; and pictures of the path kernel by light sampling, by
 * scattering and by both, which are one integral (NUMERICS H36). Runs for about twenty seconds.
 *
 * What is wrong in a planted bug is brought about in the data, as in test_kernel_direct.c.
 */
#include "common/direction_map.h"
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "tests/techniques.h"
#include "worker/kernel/light.h"
#include "worker/kernel/quadric.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const double up[3] = { 0, 0, 1 };

/* ---- what scenes are made of */

typedef double texel_function(uint32_t x, uint32_t y);

static uint32_t add_picture(struct scene *scene, uint32_t width, uint32_t height,
                            texel_function *value)
{
    float *out = (float *)(void *)(scene->texels + (size_t)scene->texel_block_count * TEXEL_BLOCK);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            *out++ = (float)value(x, y);
    scene->pictures[scene->picture_count] = (struct scene_picture){
        .first_block = scene->texel_block_count,
        .width = width,
        .height = height,
        .channels = 1,
        .levels = 1,
        .texel = TEXEL_FLOAT,
    };
    scene->texel_block_count += (width * height * 4 + TEXEL_BLOCK - 1) / TEXEL_BLOCK;
    assert_true(scene->texel_block_count <= SCENES_CAPACITY);
    return scene->picture_count++;
}

/* 1 + its index */
static uint32_t add_texture(struct scene *scene, uint32_t width, uint32_t height,
                            texel_function *value, uint32_t flags)
{
    scene->textures[scene->texture_count] = (struct texture){
        .kind = TEXTURE_IMAGE,
        .flags = flags,
        .mapping = MAPPING_UV,
        .map = { [0] = 1, [4] = 1 },
        .picture = add_picture(scene, width, height, value),
        .wrap = { WRAP_CLAMP, WRAP_CLAMP },
        .channel = SCENE_NONE,
        .scale = 1,
    };
    return ++scene->texture_count;
}

static double noise(uint32_t x, uint32_t y)
{
    return 4 * (double)(hash64(x + 1, y) >> 40) * 0x1p-24;
}

static double columns(uint32_t x, uint32_t y)
{
    (void)y;
    return x == 0 ? 1 : 3;
}

static double rows(uint32_t x, uint32_t y)
{
    return columns(y, x);
}

static double share(uint32_t x, uint32_t y) /* some of it nothing, some all */
{
    return 2 * (double)(hash64(x, y + 9) >> 40) * 0x1p-24 - 0.5;
}

static double three_tenths(uint32_t x, uint32_t y)
{
    (void)x;
    (void)y;
    return 0.3;
}

static double one(uint32_t x, uint32_t y)
{
    return 1 + 0 * three_tenths(x, y);
}

/* Make the triangles of a quad that emits as one light two lights; uv over the quad is [0, 1]^2 */
static void split_light(struct scene *scene, uint32_t mesh_index, uint32_t texture)
{
    static const float uvs[8] = { 0, 0, 1, 0, 1, 1, 0, 1 };
    struct mesh *mesh = &scene->meshes[mesh_index];
    uint32_t index = scene->triangle_light[mesh->first_emissive];
    struct light light = scene->lights[index];
    light.texture = texture;
    light.texture_scale = 1;
    light.area /= 2;
    light.corner_count = 3;
    scene->lights[index] = light;
    light.first_corner = scene->light_corner_count;
    for (uint32_t i = 0; i < 3; i++)
        memcpy(scene->light_corners + 3 * scene->light_corner_count++,
               scene->positions + 3 * (mesh->first_vertex + (i == 0 ? 0 : i + 1)),
               3 * sizeof(float));
    scene->triangle_light[mesh->first_emissive + 1] = scenes_light(scene, light);
    mesh->flags |= MESH_UVS;
    mesh->uv_shift = scene->uv_count - mesh->first_vertex;
    memcpy(scene->uvs + 2 * scene->uv_count, uvs, sizeof(uvs));
    scene->uv_count += 4;
}

/* A quad that faces down to the origin from z, [-1, 1]^2 / 2; u grows along x, v against y */
static uint32_t add_ceiling(struct scene *scene, float z, uint32_t texture, uint32_t alpha)
{
    const float corners[4][3] = {
        { -.5f, .5f, z }, { .5f, .5f, z }, { .5f, -.5f, z }, { -.5f, -.5f, z }
    };
    uint32_t mesh = scenes_polygon(scene, corners, 4, scenes_diffuse(scene, 0), 1);
    split_light(scene, mesh, texture);
    scene->meshes[mesh].alpha = alpha;
    return mesh;
}

static struct quadric *add_ball(struct scene *scene, float x, float z, float radius, uint32_t kind,
                                uint32_t texture, uint32_t alpha)
{
    struct quadric *q = scenes_quadric(scene, kind, x, 0, z, radius, scenes_diffuse(scene, 0), 1);
    q->alpha = alpha;
    scene->lights[q->light].texture = texture;
    scene->lights[q->light].texture_scale = 1;
    return q;
}

/* A sky that shines through a rectangle: its corners go around counter-clockwise where it shines */
static uint32_t add_window(struct scene *scene, const float corners[4][3], uint32_t size,
                           texel_function *value)
{
    struct environment *environment = &scene->environments[scene->environment_count++];
    *environment = (struct environment){ .picture = add_picture(scene, size, size, value),
                                         .layout = ENVIRONMENT_SQUARE,
                                         .to_light = { 1, 0, 0, 0, 1, 0, 0, 0, 1 },
                                         .scale = { 1, 1, 1 } };
    struct light light = { .kind = LIGHT_SKY,
                           .environment = scene->environment_count,
                           .first_corner = scene->light_corner_count,
                           .corner_count = 4 };
    double e[2][3], n[3], area = 0;
    for (int axis = 0; axis < 3; axis++) {
        e[0][axis] = (double)corners[1][axis] - (double)corners[0][axis];
        e[1][axis] = (double)corners[3][axis] - (double)corners[0][axis];
    }
    for (int axis = 0; axis < 3; axis++) {
        int i = (axis + 1) % 3, k = (axis + 2) % 3;
        n[axis] = e[0][i] * e[1][k] - e[0][k] * e[1][i];
        area += n[axis] * n[axis];
    }
    light.area = (float)sqrt(area);
    for (int axis = 0; axis < 3; axis++)
        light.normal[axis] = (float)(n[axis] / sqrt(area));
    memcpy(scene->light_corners + 3 * scene->light_corner_count, corners, 12 * sizeof(float));
    scene->light_corner_count += 4;
    return environment->light = scenes_light(scene, light);
}

static void finish(struct scene *scene)
{
    struct err err = { .code = ERR_OK };
    scenes_finish(scene);
    if (!scene_check(scene, &err))
        fail_msg("%s", err.text);
}

/* ---- irradiance */

static __attribute__((noinline)) struct light_sample8
take(const struct kernel_scene *ks, const struct vec3x8 *p, struct random_lanes *r)
{
    f8 u = random_f8(r), v = random_f8(r), pick = random_f8(r);
    return light_sample(ks, FX_ALL, I8(-1), *p, vec3x8_all(0, 0, 0), pick, u, v);
}

/* The mean of L cos / (pi pdf) at p, where the normal is n */
static struct tally irradiance(const struct kernel_scene *ks, const float p[3], const double n[3])
{
    struct random_lanes r = { 77, 0 };
    struct tally t = { 0 };
    struct vec3x8 at = vec3x8_all(p[0], p[1], p[2]);
    for (int i = 0; i < 400000; i += LANES) {
        struct light_sample8 s = take(ks, &at, &r);
        for (int lane = 0; lane < LANES; lane++) {
            double cosine = (double)s.wi.x[lane] * n[0] + (double)s.wi.y[lane] * n[1] +
                            (double)s.wi.z[lane] * n[2];
            double f = (double)s.radiance.x[lane] * cosine / (M_PI * (double)s.pdf[lane]);
            tally_add(&t, s.valid[lane] && cosine > 0 ? f : 0);
        }
    }
    return t;
}

/* And that what differs by 2 % is noticed */
static void expect_irradiance(struct scene *scene, const char *what, const float p[3],
                              const double n[3], double want)
{
    finish(scene);
    struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
    struct tally t = irradiance(ks, p, n);
    if (!(tally_z(&t, want) < 4.5))
        fail_msg("%s: %.9g, want %.9g, z = %.1f", what, tally_mean(&t), want, tally_z(&t, want));
    if (want != 0 && !(tally_z(&t, 1.02 * want) > 6))
        fail_msg("%s: 2 %% are not noticed", what);
    kernel_close(ks);
    scene_free(scene);
}

/* Form factor of a polygon above the horizon of the origin with normal +z, by Lambert's formula */
static double lambert(const double (*corners)[3], int count)
{
    double total = 0;
    for (int i = 0; i < count; i++) {
        const double *a = corners[i], *b = corners[(i + 1) % count];
        double c[3], length2 = 0, ab = 0;
        for (int k = 0; k < 3; k++) {
            int u = (k + 1) % 3, v = (k + 2) % 3;
            c[k] = a[u] * b[v] - a[v] * b[u];
            length2 += c[k] * c[k];
            ab += a[k] * b[k];
        }
        total += atan2(sqrt(length2), ab) * c[2] / sqrt(length2);
    }
    return fabs(total) / (2 * M_PI);
}

static double lambert_rectangle(double x0, double x1, double y0, double y1, double z)
{
    const double corners[4][3] = { { x0, y0, z }, { x1, y0, z }, { x1, y1, z }, { x0, y1, z } };
    return lambert(corners, 4);
}

static const float aside[3] = { 0.2f, 0.1f, 0 };

static void surfaces_shine_as_their_pictures_say(void **state)
{
    (void)state;
    /* Seen from aside, both halves of a ceiling; v goes upwards in the picture */
    struct scene *scene = scenes_begin(1, 1);
    add_ceiling(scene, 1, add_texture(scene, 2, 1, columns, TEXTURE_NEAREST), 0);
    double left = lambert_rectangle(-.7, -.2, -.6, .4, 1),
           right = lambert_rectangle(-.2, .3, -.6, .4, 1);
    expect_irradiance(scene, "columns", aside, up, left + 3 * right);

    scene = scenes_begin(1, 1);
    add_ceiling(scene, 1, add_texture(scene, 1, 2, rows, TEXTURE_NEAREST), 0);
    double low = lambert_rectangle(-.7, .3, -.6, -.1, 1),
           high = lambert_rectangle(-.7, .3, -.1, .4, 1);
    expect_irradiance(scene, "rows", aside, up, low + 3 * high);

    /* A disk's u goes around, its v inwards */
    for (int inner = 0; inner < 2; inner++) {
        scene = scenes_begin(1, 1);
        uint32_t texture = inner ? add_texture(scene, 1, 2, rows, TEXTURE_NEAREST)
                                 : add_texture(scene, 2, 1, columns, TEXTURE_NEAREST);
        struct quadric *q = add_ball(scene, 0, 1, 1, QUADRIC_DISK, texture, 0);
        scene->lights[q->light].normal[2] = -1;
        q->flags |= QUADRIC_FLIP_NORMAL;
        double whole = 0.5, half = 0.25 / 1.25;
        expect_irradiance(scene, "disk", (const float[3]){ 0, 0, 0 }, up,
                          inner ? 3 * (whole - half) + half : 2 * whole);
    }

    /* From the middle of a sphere: upwards is the first row, and towards +y the first columns */
    for (int side = 0; side < 2; side++) {
        scene = scenes_begin(1, 1);
        uint32_t texture = side ? add_texture(scene, 2, 1, columns, TEXTURE_NEAREST)
                                : add_texture(scene, 1, 2, rows, TEXTURE_NEAREST);
        add_ball(scene, 0, 0, 2, QUADRIC_SPHERE, texture, 0)->flags |= QUADRIC_FLIP_NORMAL;
        const double along_y[3] = { 0, 1, 0 };
        expect_irradiance(scene, "sphere", (const float[3]){ 0, 0, 0 }, side ? along_y : up, 1);
    }
}

static void what_is_not_there_does_not_shine(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    add_ceiling(scene, 1, 0, add_texture(scene, 1, 1, three_tenths, 0));
    double whole = lambert_rectangle(-.7, .3, -.6, .4, 1);
    expect_irradiance(scene, "a share of .3", aside, up, 0.3 * whole);

    /* Both are textured: what shines is their product */
    scene = scenes_begin(1, 1);
    uint32_t texture = add_texture(scene, 2, 1, columns, TEXTURE_NEAREST);
    add_ceiling(scene, 1, texture, add_texture(scene, 1, 1, three_tenths, 0));
    double left = lambert_rectangle(-.7, -.2, -.6, .4, 1);
    expect_irradiance(scene, "columns there in part", aside, up, 0.3 * (3 * whole - 2 * left));

    /* More than all is all, and less than nothing is nothing */
    scene = scenes_begin(1, 1);
    add_ceiling(scene, 1, 0, add_texture(scene, 2, 1, columns, TEXTURE_NEAREST));
    scene->textures[0].scale = 2;
    expect_irradiance(scene, "all of it", aside, up, whole);
    scene = scenes_begin(1, 1);
    add_ceiling(scene, 1, 0, add_texture(scene, 2, 1, columns, TEXTURE_NEAREST));
    scene->textures[0].scale = -2;
    expect_irradiance(scene, "none of it", aside, up, 0);
}

/* ---- densities */

struct aim {
    struct kernel_scene *ks;
    double wrong; /* planted: the factor by which a density is too large */
    float aside;  /* planted: how far away it is that of */
};

static void sample_aim(void *self, struct random_lanes *r, struct vec3x8 *w, i8 *valid)
{
    const struct aim *a = self;
    struct vec3x8 p = vec3x8_all(0, 0, 0);
    struct light_sample8 s = take(a->ks, &p, r);
    *w = s.wi;
    *valid = s.valid;
}

/* Of a two-sided sphere with holes a direction meets two points, and both may be sampled */
static void pdf_ball(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct aim *a = self;
    const struct quadric *q = &a->ks->scene->quadrics[0];
    const struct vec3x8 p = vec3x8_all(0, 0, 0);
    f8 t[2], beyond = F8(0);
    i8 hit = I8(-1);
    *pdf = F8(0);
    for (int i = 0; i < 2; i++) {
        hit = quadric_intersect(q, hit, p, *w, beyond, F8(1e30f), &t[i]);
        struct vec3x8 y = vec3x8_scale(*w, t[i]);
        struct vec3x8 n = vec3x8_unit(
            vec3x8_sub(y, vec3x8_all(q->center[0], q->center[1], q->center[2])));
        f8 here = light_pdf(a->ks, FX_ALL, hit, I8(0), p, vec3x8_all(0, 0, 0), y, n);
        *pdf = *pdf + f8_select(hit, here, F8(0));
        beyond = t[i] * (1 + 0x1p-20f);
    }
    *pdf = *pdf * (float)a->wrong;
}

static const float window_at[4][3] = {
    { -0.4f, 0.5f, 1 }, { 0.8f, 0.5f, 1 }, { 0.8f, -0.3f, 1 }, { -0.4f, -0.3f, 1 }
};

static void pdf_window(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct aim *a = self;
    const struct environment_table *env = &a->ks->environments[0];
    const struct vec3x8 p = vec3x8_all(a->aside, 0, 0);
    struct environment_sample8 s = environment_seen(env, *w);
    light_through(env, 255, &p, &s);
    *pdf = s.pdf * (float)a->wrong;
}

static void expect_density(struct aim *a, const char *what,
                           void (*pdf)(void *, const struct vec3x8 *, f8 *), const float axis[3])
{
    struct chi2_case c = { .self = a,
                           .axis = { axis[0], axis[1], axis[2] },
                           .power = 1.5,
                           .samples = 800000,
                           .seed = 3,
                           .pdf = pdf,
                           .sample = sample_aim };
    a->wrong = 1;
    struct chi2_result r = chi2_run(&c);
    if (!(r.p > CHI2_ALPHA))
        fail_msg("%s: p = %g", what, r.p);
    if (!chi2_scale_right(&r, c.samples, 1e-2))
        fail_msg("%s: %g of %g", what, r.share, r.integral);
    a->wrong = 1.05;
    r = chi2_run(&c);
    if (chi2_scale_right(&r, c.samples, 1e-2))
        fail_msg("%s: 5 %% are not noticed", what);
}

static void directions_follow_their_density(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    add_ball(scene, 0, 2, 1, QUADRIC_SPHERE, 0, add_texture(scene, 1, 1, three_tenths, 0));
    scene->lights[0].flags |= LIGHT_TWO_SIDED;
    finish(scene);
    struct aim a = { .ks = scenes_open(scene, (struct picture_how){ 0 }) };
    expect_density(&a, "a sphere with holes", pdf_ball, (const float[3]){ 0, 0, 1 });
    /* Planted: the far side is forgotten */
    scene->quadrics[0].alpha = 0;
    struct chi2_case c = { &a, { 0, 0, 1 }, 1.5, 800000, 3, pdf_ball, sample_aim };
    a.wrong = 1;
    struct chi2_result r = chi2_run(&c);
    assert_false(chi2_scale_right(&r, c.samples, 1e-2));
    kernel_close(a.ks);
    scene_free(scene);

    scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    add_window(scene, window_at, 16, noise);
    finish(scene);
    a.ks = scenes_open(scene, (struct picture_how){ 0 });
    expect_density(&a, "a window", pdf_window, (const float[3]){ 0, 0, 1 });
    /* Planted: the density of a place a little to one side */
    c = (struct chi2_case){ &a, { 0, 0, 1 }, 1.5, 800000, 3, pdf_window, sample_aim };
    a.wrong = 1;
    a.aside = 0.05f;
    r = chi2_run(&c);
    assert_true(r.p < CHI2_CAUGHT);
    kernel_close(a.ks);
    scene_free(scene);
}

/* ---- three techniques */

/* Planted: samples of another triangle, of a shape without holes, with u another way around */
static void light_sampling_of_something_else(struct kernel_scene *ks)
{
    static struct mesh mesh;
    static struct quadric quadric;
    technique_overstate(ks, OVERSTATED);
    for (uint32_t i = 0; ks->emission != NULL && i < ks->light_count; i++) {
        struct emission *of = &ks->emission[i];
        if (of->mesh != NULL) {
            mesh = *of->mesh;
            if (mesh.alpha == 0)
                of->prim = 1 - of->prim;
            mesh.alpha = 0;
            of->mesh = &mesh;
        }
        if (of->quadric != NULL) {
            quadric = *of->quadric;
            quadric.phi_max = quadric.alpha == 0 ? 4 : quadric.phi_max;
            quadric.alpha = 0;
            of->quadric = &quadric;
        }
    }
    for (uint32_t i = 0; i < ks->scene->environment_count; i++)
        ks->environments[i].has_portal = 0;
}

static struct estimate direct(struct scene *scene, enum technique technique, bool planted)
{
    return estimate_take(
        scene, technique,
        (struct picture_how){ .samples = 256,
                              .leaves = 2,
                              .alter = planted ? light_sampling_of_something_else : NULL });
}

static struct scene *receiver(struct material material)
{
    struct scene *scene = scenes_begin(16, 16);
    technique_receiver(scene, scenes_material(scene, material), (float[3]){ 0.006f, 0, 0.01f },
                       (float[3]){ -0.6f, 0, -1 });
    return scene;
}

static void ceiling(struct scene *scene)
{
    add_ceiling(scene, 0.5f, add_texture(scene, 5, 7, noise, 0), 0);
}

static void ceiling_with_holes(struct scene *scene)
{
    add_ceiling(scene, 0.5f, 0, add_texture(scene, 5, 7, share, 0));
}

static void ceiling_of_both(struct scene *scene)
{
    uint32_t texture = add_texture(scene, 5, 7, noise, 0);
    add_ceiling(scene, 0.5f, texture, add_texture(scene, 8, 8, share, 0));
}

/* One seen through the other's holes */
static void two_ceilings(struct scene *scene)
{
    ceiling_with_holes(scene);
    add_ceiling(scene, 0.8f, scene->texture_count, 0);
}

static void ball(struct scene *scene)
{
    add_ball(scene, -0.5f, 1, 0.6f, QUADRIC_SPHERE, add_texture(scene, 6, 5, noise, 0), 0);
}

static void ball_with_holes(struct scene *scene)
{
    add_ball(scene, -0.5f, 1, 0.6f, QUADRIC_SPHERE, 0, add_texture(scene, 6, 5, share, 0));
    scene->lights[scene->light_count - 1].flags |= LIGHT_TWO_SIDED;
}

static void ball_that_shines_inwards(struct scene *scene) /* and out of its holes */
{
    uint32_t texture = add_texture(scene, 6, 5, noise, 0);
    add_ball(scene, -0.5f, 1, 0.6f, QUADRIC_SPHERE, texture, add_texture(scene, 6, 5, share, 0))
        ->flags |= QUADRIC_FLIP_NORMAL;
}

static void all_around(struct scene *scene)
{
    add_ball(scene, 0.5f, 0.5f, 4, QUADRIC_SPHERE, add_texture(scene, 6, 5, noise, 0), 0)->flags |=
        QUADRIC_FLIP_NORMAL;
}

static void disk(struct scene *scene)
{
    uint32_t texture = add_texture(scene, 6, 5, noise, 0);
    add_ball(scene, -0.5f, 0.7f, 0.8f, QUADRIC_DISK, texture, add_texture(scene, 6, 5, share, 0));
    scene->lights[scene->light_count - 1].flags |= LIGHT_TWO_SIDED;
}

static void window(struct scene *scene)
{
    add_window(scene, window_at, 8, noise);
}

static void several(struct scene *scene)
{
    window(scene);
    ceiling_of_both(scene);
    ball_with_holes(scene);
}

static const struct {
    const char *name;
    void (*add)(struct scene *scene);
} lights[] = {
    { "ceiling", ceiling },
    { "ceiling with holes", ceiling_with_holes },
    { "ceiling of both", ceiling_of_both },
    { "two ceilings", two_ceilings },
    { "ball", ball },
    { "ball with holes", ball_with_holes },
    { "ball that shines inwards", ball_that_shines_inwards },
    { "all around", all_around },
    { "disk", disk },
    { "window", window },
    { "several", several },
};
enum { LIGHTS_COUNT = sizeof(lights) / sizeof(lights[0]) };

static void all_techniques_find_the_same_light(void **state) /* H36 */
{
    (void)state;
    const struct material materials[] = {
        { .reflectance = { 0.5f, 0.5f, 0.5f } },
        { .kind = MATERIAL_CONDUCTOR,
          .eta = { 0.2f, 0.2f, 0.2f },
          .k = { 3.9f, 3.9f, 3.9f },
          .alpha = { 0.3f, 0.3f } },
    };
    for (int m = 0; m < 2; m++)
        for (int i = 0; i < LIGHTS_COUNT; i++) {
            struct scene *scene = receiver(materials[m]);
            lights[i].add(scene);
            finish(scene);
            struct estimate e[3];
            for (int technique = LIGHTS; technique <= BOTH; technique++)
                e[technique] = direct(scene, (enum technique)technique, false);
            for (int a = LIGHTS; a <= BOTH; a++) {
                int b = (a + 1) % 3;
                if (!(e[a].mean > 0 && estimate_apart(e[a], e[b]) < 4))
                    fail_msg("%s on %d: lights %g +- %g, scattering %g +- %g, both %g +- %g",
                             lights[i].name, m, e[LIGHTS].mean, e[LIGHTS].error, e[SCATTERING].mean,
                             e[SCATTERING].error, e[BOTH].mean, e[BOTH].error);
            }
            technique_expect_switches(scene, (struct picture_how){ .samples = 256, .leaves = 2 },
                                      e[BOTH], lights[i].name);
            double wrong = estimate_apart(direct(scene, LIGHTS, true), e[SCATTERING]);
            if (m == 0 && !(wrong > 4))
                fail_msg("%s: planted, %g standard errors apart", lights[i].name, wrong);
            scene_free(scene);
        }
}

/* ---- pictures */

static struct picture *take_picture(struct scene *scene, uint32_t samples)
{
    finish(scene);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = samples });
    assert_int_equal(p->failed, 0);
    return p;
}

static void what_nobody_sees_lights_all_the_same(void **state)
{
    (void)state;
    struct estimate e[2];
    for (int unseen = 0; unseen < 2; unseen++) {
        struct scene *scene = receiver((struct material){ .reflectance = { 0.5f, 0.5f, 0.5f } });
        ceiling(scene);
        for (uint32_t i = 0; unseen && i < 2; i++) {
            scene->lights[i].flags |= LIGHT_UNSEEN;
            scene->meshes[scene->mesh_count - 1].material = SCENE_NONE;
        }
        struct picture *p = take_picture(scene, 256);
        e[unseen] = estimate_of(p, 1);
        picture_free(p);
        scene->settings.camera.forward[0] = 0;
        scene->settings.camera.forward[2] = 1; /* up to it */
        scene->settings.camera.screen[0] = scene->settings.camera.screen[2] = -0.1f;
        scene->settings.camera.screen[1] = scene->settings.camera.screen[3] = 0.1f;
        p = take_picture(scene, 16);
        assert_true(unseen ? p->largest == 0 : p->mean > 0.5);
        picture_free(p);
        scene_free(scene);
    }
    assert_true(e[0].mean > 0 && estimate_apart(e[0], e[1]) < 4);
}

/* A camera that looks along +z at what is alike in every pixel */
static struct scene *look(void)
{
    struct scene *scene = scenes_begin(16, 16);
    scene->settings.camera.screen[0] = scene->settings.camera.screen[2] = -0.01f;
    scene->settings.camera.screen[1] = scene->settings.camera.screen[3] = 0.01f;
    return scene;
}

static void alpha_lets_its_share_through_spheres_and_disks(void **state)
{
    (void)state;
    for (int sphere = 0; sphere < 2; sphere++)
        for (int shadow = 0; shadow < 2; shadow++) {
            struct scene *scene = look();
            uint32_t alpha = add_texture(scene, 1, 1, three_tenths, 0);
            struct quadric *q = scenes_quadric(scene, sphere ? QUADRIC_SPHERE : QUADRIC_DISK, 0, 0,
                                               3, 1, scenes_diffuse(scene, 0), 0);
            q->alpha = alpha;
            if (shadow) { /* between a white wall, which the camera sees, and its light */
                static const float wall[4][3] = {
                    { -9, 9, 5 }, { 9, 9, 5 }, { 9, -9, 5 }, { -9, -9, 5 }
                };
                q->center[0] = 2;
                q->center[2] = 4;
                scenes_quad(scene, wall, scenes_diffuse(scene, 1), 0);
                scenes_light(scene, (struct light){ .kind = LIGHT_POINT,
                                                    .position = { 8, 0, 1 },
                                                    .radiance = { 1, 1, 1 } });
            } else {
                scenes_sky(scene, 1);
            }
            scene->settings.max_depth = 1;
            struct picture *p = take_picture(scene, 256);
            double want = sphere ? 0.49 : 0.7;
            if (shadow) {
                q->material = SCENE_NONE;
                q->alpha = 0;
                struct picture *clear = take_picture(scene, 256);
                want = sphere ? 0.49 * clear->mean : 0.7 * clear->mean;
                picture_free(clear);
            }
            EXPECT_NEAR(picture_z(p, want), 0, 4.5);
            picture_free(p);
            scene_free(scene);
        }
}

static double one_half(uint32_t x, uint32_t y)
{
    (void)y;
    return x == 0 ? 1 : -1;
}

/* Where the picture says nothing is there, it is as if it were cut away */
static void alpha_cuts_spheres_as_their_pictures_say(void **state)
{
    (void)state;
    /* phi from +x over +y: the first half of u is where y > 0. Turned, that half is in front of the
     * other, or behind it */
    static const float turns[2][9] = { { 1, 0, 0, 0, 0, 1, 0, -1, 0 },
                                       { 1, 0, 0, 0, 0, -1, 0, 1, 0 } };
    for (int behind = 0; behind < 2; behind++)
        for (int cut = 0; cut < 2; cut++) {
            struct scene *scene = look();
            struct quadric *q = scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 3, 1,
                                               scenes_diffuse(scene, 0), 0);
            q->alpha = add_texture(scene, 2, 1, one_half, TEXTURE_NEAREST);
            for (int i = 0; i < 9; i++) {
                q->to_world[i] = turns[behind][i];
                q->to_object[i] = turns[behind][3 * (i % 3) + i / 3];
            }
            if (cut) { /* the other half is there */
                scene->textures[0].map[0] = -1;
                scene->textures[0].map[2] = 1;
            }
            scenes_sky(scene, 1);
            scene->settings.camera.position[0] = 0.5f; /* to one side of the seams */
            struct picture *p = take_picture(scene, 16);
            EXPECT_NEAR(p->mean, 0, 0); /* one half or the other is in the way */
            picture_free(p);
            /* From within, the camera sees the half behind, or through where it would be */
            scene->settings.camera.position[2] = 3;
            p = take_picture(scene, 16);
            EXPECT_NEAR(p->mean, behind == cut ? 1 : 0, 0);
            picture_free(p);
            scene_free(scene);
        }
}

/* Two places of one sheet behind each other: each has a chance of its own */
static void instances_let_through_independently(void **state)
{
    (void)state;
    for (int quadric = 0; quadric < 2; quadric++) {
        struct scene *scene = look();
        uint32_t alpha = add_texture(scene, 1, 1, three_tenths, 0);
        uint32_t black = scenes_diffuse(scene, 0);
        static const float sheet[4][3] = { { -1, 1, 0 }, { 1, 1, 0 }, { 1, -1, 0 }, { -1, -1, 0 } };
        if (quadric)
            scenes_quadric(scene, QUADRIC_DISK, 0, 0, 0, 1, black, 0)->alpha = alpha;
        else
            scene->meshes[scenes_polygon(scene, sheet, 4, black, 0)].alpha = alpha;
        scene->groups[scene->group_count++] = (struct group){
            .first_mesh = 0,
            .mesh_count = scene->mesh_count,
            .first_quadric = 0,
            .quadric_count = scene->quadric_count,
        };
        for (int i = 0; i < 3; i++) {
            struct instance *instance = &scene->instances[scene->instance_count++];
            *instance = (struct instance){ .to_world = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 },
                                           .to_object = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 } };
            instance->to_world[11] = (float)(i + 2);
            instance->to_object[11] = (float)(-i - 2);
        }
        scenes_sky(scene, 1);
        struct picture *p = take_picture(scene, 256);
        EXPECT_NEAR(picture_z(p, 0.343), 0, 4.5);
        assert_true(picture_z(p, 0.7) > 20); /* planted: all three alike */
        picture_free(p);
        scene_free(scene);
    }
}

static void the_unlit_is_seen_and_lights_nothing(void **state)
{
    (void)state;
    static const float wall[4][3] = { { -9, 9, 5 }, { 9, 9, 5 }, { 9, -9, 5 }, { -9, -9, 5 } };
    static const float behind[4][3] = {
        { -9, -9, -5 }, { 9, -9, -5 }, { 9, 9, -5 }, { -9, 9, -5 }
    };
    const struct material unlit = { .kind = MATERIAL_UNLIT, .reflectance = { 0.25f, 0.5f, 0.75f } };
    const struct material mirror = { .kind = MATERIAL_MIXTURE, .specular = { 1, 1, 1 } };
    enum { BY_ITSELF, LIT, IN_A_MIRROR, ON_THE_WALL, CASES };
    const double want[CASES] = { 0.25, 0.25, 0.25, 0 };
    for (int i = 0; i < CASES; i++) {
        struct scene *scene = look();
        uint32_t shown = scenes_material(scene, unlit);
        uint32_t other = i == IN_A_MIRROR   ? scenes_material(scene, mirror)
                         : i == ON_THE_WALL ? scenes_diffuse(scene, 1)
                                            : shown;
        scenes_quad(scene, wall, other, 0);
        scenes_quad(scene, behind, shown, 0);
        if (i == LIT)
            scenes_light(scene,
                         (struct light){ .kind = LIGHT_POINT, .radiance = { 100, 100, 100 } });
        struct picture *p = take_picture(scene, 16);
        EXPECT_NEAR(p->mean, want[i], 1e-6);
        EXPECT_NEAR(p->rgb[2], 3 * 16 * want[i], 1e-4);
        picture_free(p);
        scene_free(scene);
    }
}

/* ---- windows */

static void light_comes_through_the_window_alone(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    add_window(scene, window_at, 1, one);
    expect_irradiance(scene, "a window above", (const float[3]){ 0, 0, 0 }, up,
                      lambert_rectangle(-.4, .8, -.3, .5, 1));

    /* Aslant, and so far away that its solid angle is nothing to rounding */
    static const float far_away[4][3] = {
        { -0.4f, 0.5f, 500 }, { 0.8f, 0.5f, 500 }, { 0.8f, -0.3f, 500 }, { -0.4f, -0.3f, 500 }
    };
    scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    add_window(scene, far_away, 1, one);
    expect_irradiance(scene, "a window far away", (const float[3]){ 0, 0, 0 }, up,
                      lambert_rectangle(-.4, .8, -.3, .5, 500));

    /* From beyond, and the other way around */
    scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    add_window(scene, window_at, 1, one);
    expect_irradiance(scene, "beyond", (const float[3]){ 0, 0, 2 }, up, 0);
    static const float reversed[4][3] = {
        { -0.4f, -0.3f, 1 }, { 0.8f, -0.3f, 1 }, { 0.8f, 0.5f, 1 }, { -0.4f, 0.5f, 1 }
    };
    scene = scenes_begin(1, 1);
    scenes_diffuse(scene, 0);
    add_window(scene, reversed, 1, one);
    expect_irradiance(scene, "the wrong side", (const float[3]){ 0, 0, 0 }, up, 0);
}

/* As pbrt-v4 has it, what does not pass the portal sees no light, the camera's rays too */
static void the_window_is_all_there_is_to_see_of_its_sky(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(64, 64);
    add_window(scene, window_at, 1, one);
    scenes_diffuse(scene, 0);
    struct picture *p = take_picture(scene, 16);
    /* The view is [-1, 1]^2 at z = 1 */
    EXPECT_NEAR(p->mean, 1.2 * 0.8 / 4, 5e-3);
    assert_true(p->largest <= 1);
    picture_free(p);
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(surfaces_shine_as_their_pictures_say),
        cmocka_unit_test(what_is_not_there_does_not_shine),
        cmocka_unit_test(directions_follow_their_density),
        cmocka_unit_test(all_techniques_find_the_same_light),
        cmocka_unit_test(what_nobody_sees_lights_all_the_same),
        cmocka_unit_test(alpha_lets_its_share_through_spheres_and_disks),
        cmocka_unit_test(alpha_cuts_spheres_as_their_pictures_say),
        cmocka_unit_test(instances_let_through_independently),
        cmocka_unit_test(the_unlit_is_seen_and_lights_nothing),
        cmocka_unit_test(light_comes_through_the_window_alone),
        cmocka_unit_test(the_window_is_all_there_is_to_see_of_its_sky),
    };
    profile_thread_mode();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
