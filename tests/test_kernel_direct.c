/*
 * Direct light three ways (NUMERICS H36): by light sampling alone, by scattering alone, and by both
 * under their weights, for every shape of light on every material. No closed form is needed: see
 * techniques.h.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "tests/techniques.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* Planted: densities of light sampling 2 % too large */
static void planted_alone(struct kernel_scene *ks)
{
    technique_overstate(ks, 1.02f * OVERSTATED);
}

static void planted_among_both(struct kernel_scene *ks)
{
    technique_overstate(ks, 1.02f);
}

static struct estimate direct(struct scene *scene, enum technique technique, uint32_t samples)
{
    void (*const planted[])(struct kernel_scene *) = {
        [LIGHTS_PLANTED] = planted_alone, [BOTH_PLANTED] = planted_among_both
    };
    return estimate_take(scene, technique,
                         (struct picture_how){ .samples = samples, .alter = planted[technique] });
}

/* ---- the receiver: a speck facing +z, and every pixel looks at the origin in it */

static const struct {
    const char *name;
    struct material material;
    bool mirrors; /* a lobe without density: the camera stands where it shows no light */
} materials[] = {
    { "diffuse", { .reflectance = { 0.5f, 0.5f, 0.5f } }, false },
    { "mixture",
      { .kind = MATERIAL_MIXTURE,
        .reflectance = { 0.4f, 0.4f, 0.4f },
        .specular = { 0.3f, 0.3f, 0.3f } },
      true },
    { "rough metal",
      { .kind = MATERIAL_CONDUCTOR,
        .eta = { 0.2f, 0.2f, 0.2f },
        .k = { 3.9f, 3.9f, 3.9f },
        .alpha = { 0.3f, 0.3f } },
      false },
    { "brushed metal",
      { .kind = MATERIAL_CONDUCTOR,
        .eta = { 0.2f, 0.2f, 0.2f },
        .k = { 3.9f, 3.9f, 3.9f },
        .alpha = { 0.1f, 0.5f } },
      false },
    { "rough glass", { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f, .alpha = { 0.3f, 0.3f } }, false },
    { "smooth coat",
      { .kind = MATERIAL_COAT,
        .ior = 1.5f,
        .reflectance = { 0.5f, 0.5f, 0.5f },
        .coat_inner = 0.6f,
        .coat_scale = 0.14f },
      true },
    { "rough coat",
      { .kind = MATERIAL_COAT,
        .ior = 1.5f,
        .alpha = { 0.2f, 0.2f },
        .reflectance = { 0.5f, 0.5f, 0.5f },
        .coat_inner = 0.6f,
        .coat_scale = 0.14f },
      false },
    { "diffuse transmission",
      { .kind = MATERIAL_DIFFUSE_TRANSMISSION,
        .reflectance = { 0.3f, 0.3f, 0.3f },
        .specular = { 0.5f, 0.5f, 0.5f } },
      false },
    { "brushed metal under a smooth coat",
      { .kind = MATERIAL_COATED_CONDUCTOR,
        .ior = 1.5f,
        .eta = { 0.2f, 0.2f, 0.2f },
        .k = { 3.9f, 3.9f, 3.9f },
        .base_alpha = { 0.1f, 0.4f },
        .coat_inner = 0.6f,
        .coat_scale = 1 },
      true },
    { "metal under a rough coat",
      { .kind = MATERIAL_COATED_CONDUCTOR,
        .ior = 1.5f,
        .eta = { 0.2f, 0.2f, 0.2f },
        .k = { 3.9f, 3.9f, 3.9f },
        .alpha = { 0.3f, 0.3f },
        .base_alpha = { 0.2f, 0.2f },
        .coat_inner = 0.6f,
        .coat_scale = 1 },
      false },
    { "mix", { .kind = MATERIAL_MIX, .mix = { 0, 2 }, .mix_amount = 0.4f }, false },
};
enum { MATERIALS = sizeof(materials) / sizeof(materials[0]) };

static struct scene *receiver(uint32_t material)
{
    struct scene *scene = scenes_begin(16, 16);
    /* None that is not needed: the kernel variant follows from all there are */
    bool mix = materials[material].material.kind == MATERIAL_MIX;
    for (uint32_t i = 0; i < MATERIALS; i++)
        scenes_material(scene, materials[mix ? i : material].material);
    scene->coat_table_count = COAT_METAL_ROWS;
    for (int k = 0; k < COAT_TABLE_LEN; k++) {
        scene->coat_tables[k] = 0.95f - 0.9f / (1 + (float)k);
        scene->coat_tables[COAT_RETURN * COAT_TABLE_LEN + k] = 0.9f / (1 + (float)k);
        scene->coat_tables[COAT_SPREAD * COAT_TABLE_LEN + k] = 0.3f;
    }
    const float x = 0.6f, y = materials[material].mirrors ? -3.0f : 0;
    technique_receiver(scene, material, (float[3]){ x, y, 1 }, (float[3]){ -x, -y, -1 });
    return scene;
}

/* ---- lights, about where the camera is mirrored to */

/* A regular polygon at `distance` along (-.6, 0, 1), facing the receiver, turned about y */
static void polygon_light(struct scene *scene, int corners, double radius, double distance,
                          double turn)
{
    float c[POLYGON_MAX][3];
    const double length = sqrt(1.36), to[3] = { -0.6 / length, 0, 1 / length };
    for (int i = 0; i < corners; i++) {
        double phi = 0.3 - 2 * M_PI * i / corners, u = radius * cos(phi), v = radius * sin(phi);
        c[i][0] = (float)(distance * to[0] + u * (cos(turn) * to[2] + sin(turn) * to[0]));
        c[i][1] = (float)v;
        c[i][2] = (float)(distance * to[2] + u * (-cos(turn) * to[0] + sin(turn) * to[2]));
    }
    scenes_polygon(scene, (const float(*)[3])c, (uint32_t)corners, scenes_diffuse(scene, 0), 1);
}

static void triangle(struct scene *scene)
{
    polygon_light(scene, 3, 1.5, 1.5, 0.2);
}

static void quad(struct scene *scene)
{
    polygon_light(scene, 4, 1.2, 1.5, -0.3);
}

static void octagon(struct scene *scene)
{
    polygon_light(scene, 8, 1.2, 1.5, 0);
}

static void leaning_quad(struct scene *scene) /* almost edge-on */
{
    polygon_light(scene, 4, 1.2, 1.3, 1.45);
}

static void sunken_quad(struct scene *scene) /* half of it below the horizon */
{
    polygon_light(scene, 4, 2.5, 1.2, 0.1);
}

static void ball(struct scene *scene)
{
    scenes_quadric(scene, QUADRIC_SPHERE, -0.9f, 0, 1.5f, 1, scenes_diffuse(scene, 0), 1);
}

static void sunken_ball(struct scene *scene)
{
    scenes_quadric(scene, QUADRIC_SPHERE, -1.5f, 0, 0.4f, 1.2f, scenes_diffuse(scene, 0), 1);
}

static void all_around(struct scene *scene) /* a ball that shines inwards */
{
    struct quadric *q = scenes_quadric(scene, QUADRIC_SPHERE, 0.5f, 0, 0.5f, 4,
                                       scenes_diffuse(scene, 0), 1);
    q->flags |= QUADRIC_FLIP_NORMAL;
}

static void disk(struct scene *scene)
{
    scenes_quadric(scene, QUADRIC_DISK, -0.8f, 0, 1.2f, 1.1f, scenes_diffuse(scene, 0), 1);
    scene->lights[scene->light_count - 1].flags |= LIGHT_TWO_SIDED;
}

static void several(struct scene *scene) /* one of them behind the receiver */
{
    quad(scene);
    disk(scene);
    static const float below[4][3] = { { -1, -1, -1 }, { 1, -1, -1 }, { 1, 1, -1 }, { -1, 1, -1 } };
    scenes_quad(scene, below, scenes_diffuse(scene, 0), 1);
}

static const struct {
    const char *name;
    void (*add)(struct scene *scene);
} lights[] = {
    { "triangle", triangle },
    { "quad", quad },
    { "octagon", octagon },
    { "quad almost edge-on", leaning_quad },
    { "quad cut by the horizon", sunken_quad },
    { "sphere", ball },
    { "sphere cut by the horizon", sunken_ball },
    { "sphere all around", all_around },
    { "disk", disk },
    { "several lights", several },
};
enum { LIGHTS_COUNT = sizeof(lights) / sizeof(lights[0]) };

/* ---- sentences */

static void all_techniques_find_the_same_light(void **state) /* H36 */
{
    (void)state;
    for (uint32_t m = 0; m < MATERIALS; m++)
        for (uint32_t i = 0; i < LIGHTS_COUNT; i++) {
            if (materials[m].mirrors && lights[i].add == all_around)
                continue; /* wherever the camera stands */
            struct scene *scene = receiver(m);
            lights[i].add(scene);
            scenes_finish(scene);
            struct estimate e[3];
            for (int technique = LIGHTS; technique <= BOTH; technique++)
                e[technique] = direct(scene, (enum technique)technique, 32);
            for (int a = LIGHTS; a <= BOTH; a++) {
                int b = (a + 1) % 3;
                if (!(e[a].mean > 0 && estimate_apart(e[a], e[b]) < 4))
                    fail_msg("%s on %s: lights %g +- %g, scattering %g +- %g, both %g +- %g",
                             lights[i].name, materials[m].name, e[LIGHTS].mean, e[LIGHTS].error,
                             e[SCATTERING].mean, e[SCATTERING].error, e[BOTH].mean, e[BOTH].error);
            }
            technique_expect_switches(scene, (struct picture_how){ .samples = 32 }, e[BOTH],
                                      materials[m].name);
            scene_free(scene);
        }
}

static void a_density_two_percent_off_is_noticed(void **state)
{
    (void)state;
    void (*const shapes[])(struct scene *) = { triangle, quad, octagon, ball, sunken_ball, disk };
    for (uint32_t m = 0; m < 4; m += 2) /* diffuse and rough metal */
        for (size_t i = 0; i < sizeof(shapes) / sizeof(shapes[0]); i++) {
            struct scene *scene = receiver(m);
            shapes[i](scene);
            scenes_finish(scene);
            struct estimate by_chance = direct(scene, SCATTERING, 128);
            double alone = estimate_apart(direct(scene, LIGHTS_PLANTED, 128), by_chance);
            double among_both = estimate_apart(direct(scene, BOTH_PLANTED, 128), by_chance);
            if (!(alone > 4 && among_both > 4))
                fail_msg("light %zu on %s: %g and %g standard errors apart", i, materials[m].name,
                         alone, among_both);
            scene_free(scene);
        }
}

/* What is sampled is another light than the one that is hit */
static void a_light_that_is_not_where_it_is_hit_is_noticed(void **state)
{
    (void)state;
    enum { CORNER_MOVED, TRIANGLE_LOST, RADIUS_LARGE, AREA_LARGE, ONE_SIDED, PLANTS };
    void (*const shapes[PLANTS])(struct scene *) = { quad, octagon, ball, disk, disk };
    for (int plant = 0; plant < PLANTS; plant++) {
        struct scene *scene = receiver(0);
        shapes[plant](scene);
        scenes_finish(scene);
        struct light *light = &scene->lights[0];
        struct estimate by_chance = direct(scene, SCATTERING, 128);
        if (plant == CORNER_MOVED)
            scene->light_corners[0] -= 0.05f;
        if (plant == TRIANGLE_LOST)
            light->corner_count--;
        if (plant == RADIUS_LARGE)
            scene->quadrics[0].world_radius *= 1.01f;
        if (plant == AREA_LARGE)
            light->area *= 1.02f;
        if (plant == ONE_SIDED)
            light->flags &= ~(uint32_t)LIGHT_TWO_SIDED;
        scene->settings.effects = scene_effects(scene);
        struct estimate by_light = direct(scene, LIGHTS, 128);
        if (!(estimate_apart(by_light, by_chance) > 4))
            fail_msg("plant %d: %g +- %g by light sampling, %g +- %g by chance", plant,
                     by_light.mean, by_light.error, by_chance.mean, by_chance.error);
        scene_free(scene);
    }
}

static void light_edge_on_from_behind_or_below_is_none_by_any_technique(void **state) /* H36 */
{
    (void)state;
    static const float cases[][4][3] = {
        { { 1, 0, 0 }, { 2, 0, 0 }, { 2, 0, 1 }, { 1, 0, 1 } },         /* edge-on */
        { { -1, -1, 2 }, { 1, -1, 2 }, { 1, 1, 2 }, { -1, 1, 2 } },     /* its back */
        { { -1, -1, -1 }, { 1, -1, -1 }, { 1, 1, -1 }, { -1, 1, -1 } }, /* below */
        { { 1, -1, -1 }, { 1, -1, 0 }, { 1, 1, 0 }, { 1, 1, -1 } },     /* up to the horizon */
        { { -1, -1, 2 }, { 0, -1, 2 }, { 1, -1, 2 }, { 0.5f, -1, 2 } }, /* without area */
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++)
        for (uint32_t m = 0; m < MATERIALS; m++) {
            if (materials[m].material.kind == MATERIAL_DIELECTRIC ||
                materials[m].material.kind == MATERIAL_DIFFUSE_TRANSMISSION)
                continue; /* light from below shines through */
            struct scene *scene = receiver(m);
            scenes_quad(scene, cases[i], scenes_diffuse(scene, 0), 1);
            for (int k = 0; k < 3; k++)
                if (isnan(scene->lights[0].normal[k]))
                    scene->lights[0].normal[k] = k == 2;
            scenes_finish(scene);
            for (int technique = LIGHTS; technique <= BOTH; technique++) {
                /* Rounding may put the receiver in front of a light by its 1e-10 */
                struct estimate e = direct(scene, (enum technique)technique, 4);
                if (!(fabs(e.mean) < 1e-9))
                    fail_msg("case %zu on %s: %g by technique %d", i, materials[m].name, e.mean,
                             technique);
            }
            scene_free(scene);
        }
}

static void a_mirror_leaves_nothing_to_light_sampling(void **state)
{
    (void)state;
    const struct material mirrors[] = {
        { .kind = MATERIAL_CONDUCTOR, .eta = { 0.2f, 0.2f, 0.2f }, .k = { 3.9f, 3.9f, 3.9f } },
        { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f },
        { .kind = MATERIAL_THIN_DIELECTRIC, .ior = 1.5f },
        { .kind = MATERIAL_COATED_CONDUCTOR, .ior = 1.5f, .eta = { 1, 1, 1 }, .k = { 2, 2, 2 } },
    };
    for (int i = 0; i < 2; i++) {
        struct scene *scene = receiver(0);
        scene->materials[0] = mirrors[i];
        quad(scene);
        scenes_finish(scene);
        const struct picture_how how = { .samples = 16, .kernel = 1 };
        struct picture_how alone = how;
        alone.alter = technique_scattering_alone;
        struct picture *both = picture_take(scene, how), *one = picture_take(scene, alone);
        assert_true(both->mean > 0.03);
        assert_int_equal(both->stats.rays_shadow, 0);
        assert_true(picture_same(both, one));
        picture_free(both);
        picture_free(one);
        scene_free(scene);
    }
}

static void a_mix_of_all_or_nothing_is_one_of_its_materials(void **state) /* H33 */
{
    (void)state;
    for (int second = 0; second < 2; second++) {
        struct picture *p[2];
        for (int mixed = 0; mixed < 2; mixed++) {
            struct scene *scene = receiver(mixed ? MATERIALS - 1 : second ? 2 : 0);
            scene->materials[MATERIALS - 1].mix_amount = (float)second;
            quad(scene);
            scenes_finish(scene);
            p[mixed] = picture_take(scene, (struct picture_how){ .samples = 16 });
            scene_free(scene);
        }
        assert_true(p[0]->mean > 0.01 && picture_same(p[0], p[1]));
        picture_free(p[0]);
        picture_free(p[1]);
    }
}

/* Of each shape there is a variant that knows of a single light, or of few corners */
static void variants_see_every_light_as_everything_does(void **state)
{
    (void)state;
    for (uint32_t m = 0; m < MATERIALS; m++)
        for (uint32_t i = 0; i < LIGHTS_COUNT; i++) {
            struct scene *scene = receiver(m);
            lights[i].add(scene);
            scenes_finish(scene);
            struct picture *a = picture_take(scene, (struct picture_how){ .samples = 4 });
            struct picture *b = picture_take(scene,
                                             (struct picture_how){ .samples = 4, .kernel = 1 });
            if (m == 0 && i < 2) /* a single polygon on diffuse: the test would be void */
                assert_string_not_equal(a->variant, b->variant);
            if (!picture_same(a, b))
                fail_msg("%s on %s: %s and everything give different bits", lights[i].name,
                         materials[m].name, a->variant);
            picture_free(a);
            picture_free(b);
            scene_free(scene);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_techniques_find_the_same_light),
        cmocka_unit_test(a_density_two_percent_off_is_noticed),
        cmocka_unit_test(a_light_that_is_not_where_it_is_hit_is_noticed),
        cmocka_unit_test(light_edge_on_from_behind_or_below_is_none_by_any_technique),
        cmocka_unit_test(a_mirror_leaves_nothing_to_light_sampling),
        cmocka_unit_test(a_mix_of_all_or_nothing_is_one_of_its_materials),
        cmocka_unit_test(variants_see_every_light_as_everything_does),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
