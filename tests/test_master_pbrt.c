/* Goal: pbrt text becomes the scene that pbrt means by it, real files are read without leniency,
 * and whatever is wrong is said with its position. */
#include "common/effects.h"
#include "master/transform.h"
#include "tests/reader_text.h"
#include "tests/scratch.h"

#include <glob.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static struct scene *scene_of(const char *text)
{
    return reader_text_scene(text, NULL, NULL);
}

#define TRI "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
#define QUAD                                                         \
    "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] " \
    "\"integer indices\" [0 1 2 0 2 3] "
#define LIGHT "AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] "

static void expect_vertex(const struct scene *scene, uint32_t vertex, double x, double y, double z)
{
    const double want[3] = { x, y, z };
    for (int axis = 0; axis < 3; axis++)
        EXPECT_NEAR(scene->positions[3 * vertex + (unsigned)axis] + scene->settings.center[axis],
                    want[axis], 1e-6);
}

/* --- Transforms --------------------------------------------------------------------------- */

static void transforms_compose_as_in_pbrt(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        double p[3]; /* where (1, 0, 0) goes */
    } rows[] = {
        { "Translate 1 2 3", { 2, 2, 3 } },
        { "Scale 2 3 4", { 2, 0, 0 } },
        { "Rotate 90 0 0 1", { 0, 1, 0 } },
        { "Rotate 90 0 1 0", { 0, 0, -1 } },
        { "Rotate [ 450 0 0 2 ]", { 0, 1, 0 } },
        { "Translate 1 0 0 Scale 2 2 2", { 3, 0, 0 } },
        { "Scale 2 2 2 Translate 1 0 0", { 4, 0, 0 } },
        { "Translate 9 9 9 Identity", { 1, 0, 0 } },
        { "Transform [1 0 0 0  0 1 0 0  0 0 1 0  5 6 7 1]", { 6, 6, 7 } },
        { "Translate 1 0 0 ConcatTransform [0 1 0 0  -1 0 0 0  0 0 1 0  0 0 0 1]", { 1, 1, 0 } },
        { "CoordinateSystem \"here\" Translate 5 5 5 CoordSysTransform \"here\"", { 1, 0, 0 } },
        { "Translate 1 0 0 AttributeBegin Translate 5 0 0 AttributeEnd", { 2, 0, 0 } },
        { "LookAt 0 0 5  0 0 0  0 1 0", { -1, 0, 5 } },
        { "CoordSysTransform \"camera\"", { 1, 0, -7 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text),
                 "Translate 0 0 7 Camera \"perspective\" WorldBegin %s Shape \"trianglemesh\" "
                 "\"point3 P\" [1 0 0 0 0.1 0.2 0 0 1]",
                 rows[i].text);
        struct scene *scene = scene_of(text);
        expect_vertex(scene, 0, rows[i].p[0], rows[i].p[1], rows[i].p[2]);
        scene_free(scene);
    }
}

static void inverses_are_inverses(void **state)
{
    (void)state;
    struct transform rotate, a, inverse, product;
    assert_true(transform_rotate(1, (double[]){ 1, 2, 3 }, &rotate));
    struct transform scale = transform_scale(1e-3, -5, 1e4), move = transform_translate(1, 2, 1e6);
    a = transform_mul(&move, &rotate);
    a = transform_mul(&a, &scale);
    assert_true(transform_invert(&a, &inverse));
    product = transform_mul(&a, &inverse);
    for (int i = 0; i < 16; i++)
        EXPECT_NEAR(product.m[i / 4][i % 4], i % 5 == 0, 1e-5);
    EXPECT_NEAR(transform_det3(&a), -50, 1e-9);
    EXPECT_NEAR(transform_similarity(&rotate), 1, 1e-12);
    assert_true(transform_similarity(&scale) == 0);
    struct transform flat = transform_scale(1, 0, 1);
    assert_false(transform_invert(&flat, &inverse));
}

static void far_scenes_are_recentred_in_double(void **state)
{
    (void)state;
    struct scene *near = scene_of("Camera \"perspective\" WorldBegin " TRI);
    struct scene *far = scene_of("LookAt 1e6 -1e6 3e6  1e6 -1e6 4e6  0 1 0 Camera \"perspective\" "
                                 "WorldBegin Translate 1e6 -1e6 3e6 " TRI);
    assert_memory_equal(near->positions, far->positions, 9 * sizeof(float));
    assert_memory_equal(near->settings.camera.position, far->settings.camera.position,
                        3 * sizeof(float));
    EXPECT_NEAR(near->settings.center[0], 0, 0); /* it lies around the origin: not moved */
    EXPECT_NEAR(far->settings.center[2], 3e6, 1);
    scene_free(near);
    scene_free(far);
    struct scene *fine = scene_of("WorldBegin Shape \"trianglemesh\" \"point3 P\" "
                                  "[1000000.03 0 0 1000000.05 0 0 1000000.03 .01 0]");
    EXPECT_NEAR((double)fine->positions[3] - fine->positions[0], 0.02, 1e-8);
    scene_free(fine);
}

static void normals_go_by_the_inverse_transpose_and_orientation(void **state)
{
    (void)state;
    static const struct {
        const char *before;
        double n[3];
    } rows[] = {
        { "", { 0.70710678, 0.70710678, 0 } },
        { "Scale 2 1 1", { 0.4472136, 0.8944272, 0 } },
        { "Scale -1 1 1", { -0.70710678, 0.70710678, 0 } },
        { "ReverseOrientation", { -0.70710678, -0.70710678, 0 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text),
                 "WorldBegin %s Shape \"trianglemesh\" \"point3 P\" [0 1 0 1 0 0 0 1 1] "
                 "\"normal N\" [2 2 0 1 1 0 0 0 0]",
                 rows[i].before);
        struct scene *scene = scene_of(text);
        const struct mesh *mesh = &scene->meshes[0];
        assert_int_equal(mesh->flags, MESH_NORMALS);
        assert_true(scene->settings.has_normals);
        double face[3], dot = 0;
        const float *p[3];
        for (int k = 0; k < 3; k++)
            p[k] = scene->positions + 3 * scene->triangles[k];
        for (int k = 0; k < 3; k++) {
            int j = (k + 1) % 3, l = (k + 2) % 3;
            face[k] = ((double)p[1][j] - p[0][j]) * ((double)p[2][l] - p[0][l]) -
                      ((double)p[1][l] - p[0][l]) * ((double)p[2][j] - p[0][j]);
        }
        for (int v = 0; v < 3; v++) /* the third, zero in the file, is the face's */
            for (int axis = 0; axis < 3; axis++)
                EXPECT_NEAR(scene->normals[3 * v + axis], rows[i].n[axis], 1e-6);
        for (int axis = 0; axis < 3; axis++)
            dot += face[axis] * rows[i].n[axis];
        assert_true(dot > 0); /* wound to its normals' side */
        scene_free(scene);
    }
}

static void one_mirror_flips_once(void **state)
{
    (void)state;
    static const struct {
        const char *before;
        bool flipped, quadric_flipped;
    } rows[] = { { "", false, false },
                 { "Scale -1 1 1", true, false },
                 { "Scale -1 -1 1", false, false },
                 { "ReverseOrientation", true, true },
                 { "Scale 1 1 -1 ReverseOrientation", false, true },
                 { "ReverseOrientation ReverseOrientation", false, false } };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), "WorldBegin %s " TRI "Shape \"sphere\"", rows[i].before);
        struct scene *scene = scene_of(text);
        assert_int_equal(scene->meshes[0].flags, rows[i].flipped ? MESH_FLIP_NORMAL : 0);
        assert_int_equal(scene->quadrics[0].flags,
                         QUADRIC_SIMILARITY | (rows[i].quadric_flipped ? QUADRIC_FLIP_NORMAL : 0));
        scene_free(scene);
    }
}

/* --- Camera and film ---------------------------------------------------------------------- */

static void expect_screen(const struct scene *scene, double x, double y)
{
    const float *screen = scene->settings.camera.screen;
    EXPECT_NEAR(screen[0], -x, 1e-6);
    EXPECT_NEAR(screen[1], x, 1e-6);
    EXPECT_NEAR(screen[2], -y, 1e-6);
    EXPECT_NEAR(screen[3], y, 1e-6);
}

static void the_camera_looks_along_z_with_x_to_the_right(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "LookAt 1 2 3  1 2 13  0 1 0 Film \"rgb\" \"integer xresolution\" 400 "
        "\"integer yresolution\" 200 Camera \"perspective\" \"float fov\" 60 "
        "\"float lensradius\" .5 \"float focaldistance\" 4 WorldBegin " TRI);
    const struct camera *camera = &scene->settings.camera;
    for (int axis = 0; axis < 3; axis++) {
        EXPECT_NEAR(camera->position[axis] + scene->settings.center[axis], axis + 1, 1e-6);
        EXPECT_NEAR(camera->right[axis], axis == 0, 1e-12);
        EXPECT_NEAR(camera->up[axis], axis == 1, 1e-12);
        EXPECT_NEAR(camera->forward[axis], axis == 2, 1e-12);
    }
    expect_screen(scene, 2 * tan(PI / 6), tan(PI / 6)); /* fov along the shorter axis */
    EXPECT_NEAR(camera->lens_radius, 0.5, 0);
    EXPECT_NEAR(camera->focal_distance, 4, 0);
    assert_int_equal(scene->settings.effects & FX_LENS, FX_LENS);
    scene_free(scene);
}

static void screens_follow_the_film_or_what_is_said(void **state)
{
    (void)state;
    struct scene *tall = scene_of(
        "Camera \"orthographic\" Film \"rgb\" \"integer xresolution\" 100 "
        "\"integer yresolution\" 300 WorldBegin");
    expect_screen(tall, 1, 3);
    assert_int_equal(tall->settings.camera.kind, CAMERA_ORTHOGRAPHIC);
    scene_free(tall);
    struct scene *said = scene_of(
        "Camera \"perspective\" \"float screenwindow\" [-1 3 -2 .5] WorldBegin");
    const float want[] = { -1, 3, -2, 0.5f };
    for (int i = 0; i < 4; i++)
        EXPECT_NEAR(said->settings.camera.screen[i], want[i], 1e-6); /* fov 90: tan 45 is 1 */
    scene_free(said);
    struct scene *frame = scene_of(
        "Camera \"perspective\" \"float frameaspectratio\" 2 WorldBegin");
    expect_screen(frame, 2, 1);
    assert_int_equal(frame->settings.width, 1280);
    assert_int_equal(frame->settings.height, 720);
    scene_free(frame);
}

static void a_mirrored_camera_is_left_handed(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "Scale -1 1 1 LookAt 0 0 0  0 0 1  0 1 0 Camera \"perspective\" WorldBegin");
    EXPECT_NEAR(scene->settings.camera.right[0], -1, 0);
    EXPECT_NEAR(scene->settings.camera.forward[2], 1, 0);
    scene_free(scene);
}

static void crop_windows_round_up_and_follow_resolution(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" 50 "
        "\"float cropwindow\" [.25 .505 0 1] WorldBegin");
    const uint32_t want[] = { 25, 51, 0, 50 };
    assert_memory_equal(scene->settings.crop, want, sizeof(want));
    expect_screen(scene, 2, 1);
    assert_true(pbrt_set_resolution(scene, 200, 200, NULL));
    const uint32_t twice[] = { 50, 102, 0, 200 };
    assert_memory_equal(scene->settings.crop, twice, sizeof(twice));
    expect_screen(scene, 1, 1);
    assert_true(pbrt_set_resolution(scene, 50, 100, NULL));
    expect_screen(scene, 1, 2);
    assert_true(pbrt_set_crop(scene, (double[]){ 0, 1, 0, 0.5 }, NULL));
    assert_int_equal(scene->settings.crop[3], 50);
    assert_false(pbrt_set_crop(scene, (double[]){ 0.5, 0.5, 0, 1 }, NULL));
    assert_false(pbrt_set_resolution(scene, 0, 100, NULL));
    assert_true(scene_check(scene, NULL));
    scene_free(scene);
    scene = scene_of("Film \"rgb\" \"integer pixelbounds\" [10 20 -5 99999] WorldBegin");
    const uint32_t bounds[] = { 10, 20, 0, 720 };
    assert_memory_equal(scene->settings.crop, bounds, sizeof(bounds));
    scene_free(scene);
}

static void samplers_filters_and_integrators_are_read(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "Sampler \"stratified\" \"integer xsamples\" 3 \"integer ysamples\" 5 "
        "PixelFilter \"mitchell\" \"float B\" .2 Integrator \"volpath\" "
        "\"integer maxdepth\" 7 Option \"disablewavelengthjitter\" true "
        "ColorSpace \"srgb\" WorldBegin");
    assert_int_equal(s->settings.sampler, SAMPLER_STRATIFIED);
    assert_int_equal(s->settings.sampler_spp, 15);
    assert_int_equal(s->settings.filter.kind, FILTER_MITCHELL);
    EXPECT_NEAR(s->settings.filter.b, 0.2, 1e-6);
    EXPECT_NEAR(s->settings.filter.c, 1.0 / 3, 1e-6);
    EXPECT_NEAR(s->settings.filter.radius[1], 2, 0);
    assert_int_equal(s->settings.max_depth, 7);
    scene_free(s);
    s = scene_of("WorldBegin"); /* pbrt's defaults, but no depth limit */
    assert_int_equal(s->settings.filter.kind, FILTER_GAUSSIAN);
    EXPECT_NEAR(s->settings.filter.sigma, 0.5, 0);
    assert_int_equal(s->settings.max_depth, SCENE_NONE);
    assert_int_equal(s->settings.sampler, SAMPLER_SOBOL);
    assert_int_equal(s->settings.sampler_spp, 0);
    scene_free(s);
}

/* --- Materials ---------------------------------------------------------------------------- */

static struct scene *material_scene(const char *material)
{
    char text[1024];
    snprintf(text, sizeof(text), "WorldBegin %s Shape \"sphere\"", material);
    return scene_of(text);
}

static void materials_have_pbrts_defaults(void **state)
{
    (void)state;
    struct scene *s = material_scene("");
    assert_int_equal(s->materials[0].kind, MATERIAL_DIFFUSE);
    EXPECT_NEAR(s->materials[0].reflectance[1], 0.5, 0);
    scene_free(s);
    s = material_scene("Material \"conductor\"");
    EXPECT_NEAR(s->materials[0].eta[0], 0.1690, 1e-6); /* copper */
    EXPECT_NEAR(s->materials[0].alpha[0], 0, 0);
    scene_free(s);
    s = material_scene(
        "Material \"conductor\" \"rgb reflectance\" [.25 .5 1] \"float roughness\" .04");
    EXPECT_NEAR(s->materials[0].eta[0], 1, 0);
    EXPECT_NEAR(s->materials[0].k[0], 2 * 0.5 / sqrt(0.75), 1e-6);
    EXPECT_NEAR(s->materials[0].k[2], 2 * sqrt(0.9999) / sqrt(0.0001), 1e-2);
    EXPECT_NEAR(s->materials[0].alpha[1], 0.2, 1e-7); /* remapped by a square root */
    assert_int_equal(s->settings.effects & FX_ROUGH, FX_ROUGH);
    scene_free(s);
    s = material_scene("Material \"dielectric\"");
    EXPECT_NEAR(s->materials[0].ior, 1.5, 0);
    scene_free(s);
    s = material_scene(
        "Material \"dielectric\" \"spectrum eta\" \"glass-BK7\" \"float uroughness\" .0005 "
        "\"float vroughness\" .0009 \"bool remaproughness\" false");
    EXPECT_NEAR(s->materials[0].ior, 1.5168, 1e-6);
    EXPECT_NEAR(s->materials[0].alpha[0], 0, 0); /* both below ALPHA_SMOOTH: smooth */
    scene_free(s);
    s = material_scene("Material \"dielectric\" \"float uroughness\" 0 \"float vroughness\" .25");
    EXPECT_NEAR(s->materials[0].alpha[0], 1e-4, 1e-9);
    EXPECT_NEAR(s->materials[0].alpha[1], 0.5, 1e-7);
    scene_free(s);
    s = material_scene(
        "Material \"mixture\" \"rgb diffuse\" [.1 .2 .3] \"rgb specular\" [.4 .5 .6]");
    assert_int_equal(s->materials[0].kind, MATERIAL_MIXTURE);
    EXPECT_NEAR(s->materials[0].specular[2], 0.6, 1e-7);
    scene_free(s);
}

static void equal_coats_share_a_table(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin Material \"coateddiffuse\" Shape \"sphere\" "
        "Material \"coateddiffuse\" \"rgb reflectance\" [.1 .2 .3] Shape \"sphere\" "
        "Material \"coateddiffuse\" \"float thickness\" .1 Shape \"sphere\"");
    assert_int_equal(s->material_count, 3);
    assert_int_equal(s->coat_table_count, 2);
    assert_int_equal(s->materials[1].coat_table, 0);
    assert_int_equal(s->materials[2].coat_table, 1);
    EXPECT_NEAR(s->materials[0].reflectance[0], 0.5, 0);
    EXPECT_NEAR(s->materials[0].coat_scale, 1 / (PI * 2.25), 1e-7);
    scene_free(s);
}

static void only_materials_in_use_join_the_scene(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin MakeNamedMaterial \"glass\" \"string type\" \"dielectric\" "
        "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" "
        "MakeNamedMaterial \"m\" \"string type\" \"mix\" \"string materials\" [\"a\" \"later\"] "
        "\"float amount\" .25 "
        "MakeNamedMaterial \"later\" \"string type\" \"mixture\" "
        "NamedMaterial \"m\" Shape \"sphere\" Shape \"disk\"");
    assert_int_equal(s->material_count, 3);
    const struct material *mix = &s->materials[s->quadrics[0].material];
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_int_equal(s->materials[mix->mix[0]].kind, MATERIAL_DIFFUSE);
    assert_int_equal(s->materials[mix->mix[1]].kind, MATERIAL_MIXTURE);
    EXPECT_NEAR(mix->mix_amount, 0.25, 0);
    assert_int_equal(s->settings.effects & (FX_DIELECTRIC | FX_MIX | FX_MIXTURE),
                     FX_MIX | FX_MIXTURE);
    scene_free(s);
}

/* --- Lights ------------------------------------------------------------------------------- */

static void a_quad_is_one_polygon_light(void **state)
{
    (void)state;
    struct scene *s = scene_of("WorldBegin " LIGHT QUAD);
    assert_int_equal(s->light_count, 1);
    const struct light *light = &s->lights[0];
    assert_int_equal(light->kind, LIGHT_POLYGON);
    assert_int_equal(light->corner_count, 4);
    EXPECT_NEAR(light->area, 2, 1e-6);
    EXPECT_NEAR(light->normal[2], 1, 0);
    EXPECT_NEAR(light->pick, 1, 0);
    EXPECT_NEAR(light->radiance[1], 2, 0);
    assert_int_equal(s->meshes[0].first_emissive, 0);
    assert_int_equal(s->triangle_light[0], 0);
    assert_int_equal(s->triangle_light[1], 0);
    scene_free(s);
}

/* Twice the signed area of a light's polygon about its normal */
static double turning_area(const struct scene *s, const struct light *light)
{
    const float *p = s->light_corners + 3 * (size_t)light->first_corner;
    double sum[3] = { 0, 0, 0 };
    for (uint32_t i = 0; i < light->corner_count; i++) {
        const float *a = p + 3 * i, *b = p + 3 * ((i + 1) % light->corner_count);
        for (int k = 0; k < 3; k++)
            sum[k] += (double)a[(k + 1) % 3] * b[(k + 2) % 3] -
                      (double)a[(k + 2) % 3] * b[(k + 1) % 3];
    }
    return sum[0] * light->normal[0] + sum[1] * light->normal[1] + sum[2] * light->normal[2];
}

static void corners_go_around_the_emitting_side(void **state)
{
    (void)state;
    static const char *const before[] = { "", "ReverseOrientation", "Scale -1 1 1",
                                          "Rotate 50 1 2 3 ReverseOrientation Scale 1 -1 2" };
    static const double z[] = { 1, -1, 1 };
    for (size_t i = 0; i < 4; i++) {
        char text[512];
        snprintf(text, sizeof(text), "WorldBegin %s " LIGHT QUAD, before[i]);
        struct scene *s = scene_of(text);
        assert_int_equal(s->light_count, 1);
        EXPECT_NEAR(turning_area(s, &s->lights[0]), 2 * (double)s->lights[0].area, 1e-5);
        if (i < 3)
            EXPECT_NEAR(s->lights[0].normal[2], z[i], 1e-6);
        scene_free(s);
    }
    /* With vertex normals the light leaves on their side */
    struct scene *s = scene_of(
        "WorldBegin " LIGHT
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] \"normal N\" "
        "[0 0 -1 0 0 -1 0 0 -1 0 0 -1] \"integer indices\" [0 1 2 0 2 3] ");
    assert_int_equal(s->light_count, 1);
    EXPECT_NEAR(s->lights[0].normal[2], -1, 0);
    EXPECT_NEAR(turning_area(s, &s->lights[0]), 4, 1e-5);
    scene_free(s);
}

static void polygons_merge_only_when_flat_and_convex(void **state)
{
    (void)state;
    static const struct {
        const char *shape;
        uint32_t lights, corners;
    } rows[] = {
        /* a hexagon as a fan around a corner; the same quad with corners repeated */
        { "[1 0 0 .5 .866025 0 -.5 .866025 0 -1 0 0 -.5 -.866025 0 .5 -.866025 0] \"integer "
          "indices\" "
          "[0 1 2 0 2 3 0 3 4 0 4 5]",
          1, 6 },
        { "[0 0 0 2 0 0 2 1 0 0 0 0 2 1 0 0 1 0] \"integer indices\" [0 1 2 3 4 5]", 1, 4 },
        /* folded; an arrow head; two apart; two that look away from each other */
        { "[0 0 0 2 0 0 2 1 0 0 1 .1] \"integer indices\" [0 1 2 0 2 3]", 2, 6 },
        { "[0 0 0 2 0 0 .5 .5 0 0 2 0] \"integer indices\" [0 1 2 0 2 3]", 2, 6 },
        { "[0 0 0 1 0 0 0 1 0 5 0 0 6 0 0 5 1 0] \"integer indices\" [0 1 2 3 4 5]", 2, 6 },
        { "[0 0 0 2 0 0 2 1 0 0 1 0] \"integer indices\" [0 1 2 0 3 2]", 2, 6 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), "WorldBegin " LIGHT "Shape \"trianglemesh\" \"point3 P\" %s",
                 rows[i].shape);
        struct scene *s = scene_of(text);
        double area = 0;
        if (s->light_count != rows[i].lights || s->light_corner_count != rows[i].corners)
            fail_msg("row %zu: %u lights, %u corners", i, s->light_count, s->light_corner_count);
        for (uint32_t l = 0; l < s->light_count; l++) {
            EXPECT_NEAR(turning_area(s, &s->lights[l]), 2 * (double)s->lights[l].area, 1e-5);
            area += s->lights[l].area;
        }
        assert_true(area > 0.5);
        scene_free(s);
    }
}

static void no_polygon_has_more_than_eight_corners(void **state)
{
    (void)state;
    char text[4096] = "WorldBegin " LIGHT "Shape \"trianglemesh\" \"point3 P\" [";
    for (int i = 0; i < 20; i++)
        snprintf(text + strlen(text), sizeof(text) - strlen(text), "%.9f %.9f 0 ", cos(i * PI / 10),
                 sin(i * PI / 10));
    strcat(text, "] \"integer indices\" [");
    for (int i = 1; i < 19; i++)
        snprintf(text + strlen(text), sizeof(text) - strlen(text), "0 %d %d ", i, i + 1);
    strcat(text, "]");
    struct scene *s = scene_of(text);
    double area = 0;
    for (uint32_t l = 0; l < s->light_count; l++) {
        assert_true(s->lights[l].corner_count <= POLYGON_MAX);
        area += s->lights[l].area;
    }
    assert_int_equal(s->light_count, 3); /* 18 triangles, six each */
    EXPECT_NEAR(area, 10 * sin(PI / 10), 1e-5);
    scene_free(s);
}

static void light_numbers_are_pbrts(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin "
        "LightSource \"point\" \"rgb I\" [1 2 3] \"float scale\" 2 \"point3 from\" [1 2 3] "
        "LightSource \"point\" \"float power\" 100 "
        "Translate 0 1 0 "
        "LightSource \"spot\" \"point3 from\" [0 0 0] \"point3 to\" [0 -5 0] \"float coneangle\" "
        "40 "
        "\"float conedeltaangle\" 10 \"blackbody I\" 5000 \"float scale\" 7 "
        "LightSource \"distant\" \"point3 from\" [0 3 4] \"point3 to\" [0 0 0] \"float "
        "illuminance\" 5 "
        "LightSource \"infinite\" \"rgb L\" [.1 .2 .3] LightSource \"infinite\" \"float "
        "illuminance\" 3.14159265 "
        "LightSource \"point\" \"rgb I\" [0 0 0]");
    assert_int_equal(s->light_count, 5);
    const struct light *light = s->lights;
    EXPECT_NEAR(light[0].radiance[2], 6, 0);
    EXPECT_NEAR(light[0].position[1], 2, 0);
    EXPECT_NEAR(light[1].radiance[0], 100 / (4 * PI), 1e-5);
    EXPECT_NEAR(light[2].cos_falloff_end, cos(40 * PI / 180), 1e-7);
    EXPECT_NEAR(light[2].cos_falloff_start, cos(30 * PI / 180), 1e-7);
    EXPECT_NEAR(light[2].direction[1], -1, 0);
    EXPECT_NEAR(light[2].position[1], 1, 0);
    EXPECT_NEAR(0.2126 * light[2].radiance[0] + 0.7152 * light[2].radiance[1] +
                    0.0722 * light[2].radiance[2],
                7, 0.01);
    EXPECT_NEAR(light[3].direction[1], -0.6, 1e-7);
    EXPECT_NEAR(light[3].direction[2], -0.8, 1e-7);
    EXPECT_NEAR(light[3].radiance[0], 5, 0);
    assert_int_equal(light[4].kind, LIGHT_SKY);
    assert_int_equal(s->settings.sky_light, 4);
    EXPECT_NEAR(s->settings.sky[1], 1.2, 1e-6);
    double sum = 0;
    for (uint32_t i = 0; i < s->light_count; i++) {
        assert_true(light[i].pick > 0);
        sum += light[i].pick;
    }
    EXPECT_NEAR(sum, 1, 1e-6);
    scene_free(s);
}

static void quadric_lights_know_their_size_in_the_world(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin Translate 1 2 3 Scale 2 2 -2 " LIGHT
        "Shape \"sphere\" \"float radius\" 3 Rotate 90 1 0 0 AreaLightSource \"diffuse\" "
        "\"float power\" 10 \"bool twosided\" true Shape \"disk\" \"float height\" 1 "
        "ReverseOrientation "
        "Shape \"disk\" \"float height\" 1");
    assert_int_equal(s->light_count, 3);
    const struct light *sphere = &s->lights[0], *disk = &s->lights[1], *back = &s->lights[2];
    EXPECT_NEAR(sphere->area, 4 * PI * 36, 1e-3);
    EXPECT_NEAR(s->quadrics[0].world_radius, 6, 1e-6);
    EXPECT_NEAR(disk->area, 4 * PI, 1e-5);
    EXPECT_NEAR(disk->radiance[0], 10 / (2 * PI * 4 * PI), 1e-6);
    assert_int_equal(disk->flags, LIGHT_TWO_SIDED);
    EXPECT_NEAR(disk->normal[1], -1, 1e-6); /* +z of the object: turned to -y */
    EXPECT_NEAR(back->normal[1], 1, 1e-6);
    EXPECT_NEAR(disk->position[1] + s->settings.center[1], 0, 1e-6);
    assert_int_equal(s->quadrics[1].light, 1);
    scene_free(s);
}

/* H14: what a light says of its size is its size in the world, however it is stretched there */
static void stretched_lights_have_the_area_of_the_world(void **state)
{
    (void)state;
    static const struct {
        const char *before;
        double area; /* of the quad 1 x 2 */
    } rows[] = {
        { "", 2 },
        { "Scale 3 1 1", 6 },
        { "Scale 1 -5 .5", 10 },
        { "Scale 1e-3 1 1e6", 2e-3 },
        { "Rotate 30 1 2 3 Scale 2 3 4", 12 },
        { "Transform [1 0 0 0 3 1 0 0 0 0 1 0 0 0 0 1]", 2 }, /* sheared along x */
        { "Scale 1 1 2 Rotate 45 1 0 0", 3.16227766 },        /* longer by sqrt(5/2) */
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1000];
        snprintf(text, sizeof(text), "WorldBegin %s " LIGHT QUAD, rows[i].before);
        struct scene *s = scene_of(text);
        double area = 0, turned = 0, planted = 0;
        for (uint32_t l = 0; l < s->light_count; l++) {
            area += s->lights[l].area;
            turned += turning_area(s, &s->lights[l]) / 2;
            planted += 2; /* in the object's space */
        }
        EXPECT_NEAR(area / rows[i].area, 1, 1e-6);
        EXPECT_NEAR(fabs(turned) / rows[i].area, 1, 1e-5);
        assert_true(rows[i].area == 2 || fabs(planted / rows[i].area - 1) > 1e-2);
        scene_free(s);
    }
}

static void picks_follow_power(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin AreaLightSource \"diffuse\" Shape \"disk\" "
        "Translate 5 0 0 AreaLightSource \"diffuse\" \"float scale\" 2 Shape \"disk\" "
        "Translate 5 0 0 AreaLightSource \"diffuse\" \"bool twosided\" true Shape \"disk\" "
        "\"float radius\" 2 Translate 9 0 0 AreaLightSource \"diffuse\" \"float scale\" 1e-20 "
        "Shape \"disk\" AreaLightSource \"diffuse\" \"float scale\" 0 Shape \"disk\"");
    assert_int_equal(s->light_count, 4); /* the dark one is none */
    EXPECT_NEAR(s->lights[0].pick, 1.0 / 11, 1e-5);
    EXPECT_NEAR(s->lights[1].pick, 2.0 / 11, 1e-5);
    EXPECT_NEAR(s->lights[2].pick, 8.0 / 11, 1e-5);
    assert_true(s->lights[3].pick > 0 && s->lights[3].pick < 1e-6);
    assert_int_equal(s->settings.effects & (FX_DISK_LIGHT | FX_MANY_LIGHTS),
                     FX_DISK_LIGHT | FX_MANY_LIGHTS);
    scene_free(s);
}

static void degenerate_triangles_are_counted_and_never_lights(void **state)
{
    (void)state;
    static const char text[] = "WorldBegin " LIGHT
                               "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 2 0 0] "
                               "\"integer indices\" [0 1 3 0 1 2 1 1 2]";
    struct scene_notes notes;
    struct scene *s = pbrt_read_text(text, strlen(text), NULL, NULL, &notes, NULL);
    assert_non_null(s);
    assert_int_equal(s->triangle_count, 1);
    assert_int_equal(s->light_count, 1);
    assert_int_equal(notes.count, 1);
    assert_non_null(strstr(notes.lines[0], "2 triangles without area were left out"));
    scene_notes_free(&notes);
    scene_free(s);
}

/* --- Bad input ---------------------------------------------------------------------------- */

#define W "WorldBegin\n"
static const struct bad_row {
    const char *text, *says;
    enum err_code code;
} bad_rows[] = {
    { "", "text:1:1: the scene has no WorldBegin", ERR_SCENE },
    { W "Shap \"sphere\"", "text:2:1: unknown directive \"Shap\"; the nearest is \"Shape\"",
      ERR_SCENE },
    { W "  Shape \"spere\"", "text:2:9: unknown shape \"spere\"; the nearest is \"sphere\"",
      ERR_SCENE },
    { W "Shape \"cone\"", "is of pbrt-v3", ERR_SCENE },
    { W "Shape \"sphere", "text:2:7: a string without its closing quote", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" [1", "no closing bracket", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" []", "has no value", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\"", "has no value", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" [1 2]", "wants one value, not 2", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" one", "\"one\" is not a number", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" nan", "not a finite number", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" 1e999", "not a finite number", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" \"1\"", "wants a number, not a string", ERR_SCENE },
    { W "Shape \"sphere\" \"float raduis\" 1",
      "text:2:16: unknown parameter \"raduis\" of Shape \"sphere\"; the nearest is \"radius\"",
      ERR_SCENE },
    { W "Shape \"sphere\" \"integer radius\" 1", "\"float radius\" is wanted here", ERR_SCENE },
    { W "Shape \"sphere\" \"floot radius\" 1",
      "unknown parameter type \"floot\"; the nearest is \"float\"", ERR_SCENE },
    { W "Shape \"sphere\" \"radius\" 1", "is not a parameter", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" 1 \"float radius\" 2", "given twice", ERR_SCENE },
    { W "Shape \"sphere\" \"float radius\" 0", "no area", ERR_SCENE },
    { W "Shape \"disk\" \"float innerradius\" 2", "no area", ERR_SCENE },
    /* H19: a lens must be focused somewhere */
    { "Camera \"perspective\" \"float lensradius\" 1 \"float focaldistance\" 0 " W,
      "focaldistance must be positive", ERR_SCENE },
    { "Camera \"perspective\" \"float lensradius\" 1 \"float focaldistance\" -2 " W,
      "focaldistance must be positive", ERR_SCENE },
    { "Camera \"perspective\" \"float lensradius\" -1 " W, "lensradius and focaldistance must",
      ERR_SCENE },
    { "Camera \"perspective\" \"float focaldistance\" inf " W, "not a finite number", ERR_SCENE },
    { W LIGHT "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0]", "text:2:1", ERR_SCENE },
    { W LIGHT "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0]", "this light has no area",
      ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0] \"integer indices\" [0 1 3]",
      "index 3 (number 2) is out of range: there are 3 vertices", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0] \"integer indices\" [0 -1 2]",
      "index -1", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0] \"integer indices\" [0 1.5 2]",
      "not an integer", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0] \"integer indices\" [0 1]",
      "multiple of three", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0]", "groups of 3", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 nan 1 0 0 2 0 0]",
      "text:2:38: \"nan\" is not a finite", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 1e39 1 0 0 2 0 0]", "beyond float32", ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0 4 4 4]", "integer indices",
      ERR_SCENE },
    { W "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"normal N\" [0 0 1]",
      "1 entries for 3 vertices", ERR_SCENE },
    { W "Shape \"trianglemesh\"", "wants \"point3 P\"", ERR_SCENE },
    { W "Scale 1e30 1 1 " TRI, "beyond 1e+18", ERR_SCENE },
    { W "Material \"mate\"", "unknown material", ERR_SCENE },
    { W "Material \"difuse\"", "the nearest is \"diffuse\"", ERR_SCENE },
    { W "Material \"matte\"", "in pbrt-v4 it is \"diffuse\"", ERR_SCENE },
    { W "Material \"uber\"", "is of pbrt-v3", ERR_SCENE },
    { W "Material \"hair\"", "material \"hair\" is not supported yet", ERR_UNSUPPORTED },
    { W "Material \"diffuse\" \"texture reflectance\" \"t\"",
      "no texture \"t\": no spectrum texture has been named", ERR_SCENE },
    { W "Material \"diffuse\" \"rgb reflectance\" [1 1]", "three numbers, not 2", ERR_SCENE },
    { W "Material \"diffuse\" \"rgb reflectance\" [1 -1 0]", "a colour of -1", ERR_SCENE },
    { W "Material \"diffuse\" \"rgb Kd\" [1 1 0]", "unknown parameter \"Kd\"", ERR_SCENE },
    { W "Material \"diffuse\" \"float reflectance\" 1", "\"rgb reflectance\" or \"spectrum",
      ERR_SCENE },
    { W "Material \"diffuse\" \"blackbody reflectance\" 5000", "is a light", ERR_SCENE },
    { W "Material \"diffuse\" \"texture normalmap\" \"n\"", "not supported yet", ERR_UNSUPPORTED },
    { W "Material \"diffuse\" \"texture bumpmap\" \"n\"",
      "in pbrt-v4 it is \"texture displacement\"", ERR_SCENE },
    { W "Material \"conductor\" \"spectrum eta\" \"metal-Cu-etta\"",
      "the nearest is \"metal-Cu-eta\"", ERR_SCENE },
    { W "Material \"conductor\" \"spectrum eta\" \"my.spd\"", "not supported yet",
      ERR_UNSUPPORTED },
    { W "Material \"conductor\" \"rgb reflectance\" [1 1 1] \"rgb k\" [1 1 1]",
      "either reflectance or", ERR_SCENE },
    { W "Material \"coateddiffuse\" \"rgb albedo\" [.1 0 0]", "not supported yet",
      ERR_UNSUPPORTED },
    { W "Material \"dielectric\" \"float eta\" 0", "index of refraction of 0", ERR_SCENE },
    { W "Material \"dielectric\" \"float roughness\" -1", "roughness of -1", ERR_SCENE },
    { W "Material \"mixture\" \"rgb diffuse\" [.8 0 0] \"rgb specular\" [.8 0 0]", "return more",
      ERR_SCENE },
    { W "Material \"mix\" \"string materials\" \"a\"", "two names", ERR_SCENE },
    { W "Material \"mix\" \"string materials\" [\"a\" \"b\"] Shape \"sphere\"", "no material \"a\"",
      ERR_SCENE },
    { W "MakeNamedMaterial \"m\" \"string type\" \"mix\" \"string materials\" [\"m\" \"m\"] "
        "NamedMaterial \"m\" Shape \"sphere\"",
      "this mix contains itself", ERR_SCENE },
    { W "MakeNamedMaterial \"wood\" \"string type\" \"diffuse\" NamedMaterial \"woud\"",
      "no material \"woud\"; the nearest is \"wood\"", ERR_SCENE },
    { W "NamedMaterial \"wood\"", "none has been named", ERR_SCENE },
    { W "MakeNamedMaterial \"wood\"", "wants \"string type\"", ERR_SCENE },
    { W "MakeNamedMaterial \"w\" \"string type\" \"diffuse\" MakeNamedMaterial \"w\" \"string "
        "type\" \"diffuse\"",
      "defined twice", ERR_SCENE },
    { W "LightSource \"pont\"", "the nearest is \"point\"", ERR_SCENE },
    { W "LightSource \"goniometric\"", "wants \"string filename\"", ERR_SCENE },
    { W "AreaLightSource \"diffuse\" \"string filename\" \"sky.exr\"",
      "no file can be read from here", ERR_SCENE },
    { W "LightSource \"spot\" \"point3 to\" [0 0 0]", "are the same point", ERR_SCENE },
    { W "LightSource \"spot\" \"float coneangle\" 200", "a cone of 200", ERR_SCENE },
    { W "LightSource \"point\" \"rgb I\" [1e30 0 0] \"float scale\" 1e20", "too large", ERR_SCENE },
    { W "LightSource \"point\" \"blackbody I\" 5", "outside 100", ERR_SCENE },
    { W "AreaLightSource \"area\"", "in pbrt-v4 it is \"diffuse\"", ERR_SCENE },
    { W "AreaLightSource \"diffuse\" \"rgb L\" [-1 0 0]", "a colour of -1", ERR_SCENE },
    { W "Texture \"t\" \"spectrum\" \"ptex\"", "text:2:24: texture \"ptex\" is not supported yet",
      ERR_UNSUPPORTED },
    { W "ObjectEnd", "without an ObjectBegin", ERR_SCENE },
    { W "AttributeEnd", "AttributeEnd without", ERR_SCENE },
    { W "AttributeBegin\nAttributeBegin", "text:3:1: this block is not closed", ERR_SCENE },
    { W "TransformBegin", "pbrt-v4 has AttributeBegin", ERR_SCENE },
    { W "WorldEnd", "pbrt-v3", ERR_SCENE },
    { W W, "a second WorldBegin", ERR_SCENE },
    { W "Camera \"perspective\"", "must come before WorldBegin", ERR_SCENE },
    { "Shape \"sphere\"", "must come after WorldBegin", ERR_SCENE },
    { W "Scale 1 0 1", "cannot be inverted", ERR_SCENE },
    { W "Scale 1 x 1", "text:2:9: Scale wants 3 numbers", ERR_SCENE },
    { W "Scale 1 2", "Scale wants 3 numbers", ERR_SCENE },
    { W "Scale [1 2 3 4]", "then a ]", ERR_SCENE },
    { W "Rotate 10 0 0 0", "an axis that is not zero", ERR_SCENE },
    { W "LookAt 0 0 0 0 0 0 0 1 0", "do not span", ERR_SCENE },
    { W "LookAt 0 0 0 0 1 0 0 2 0", "do not span", ERR_SCENE },
    { W "Transform [1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1]", "projective", ERR_UNSUPPORTED },
    { W "CoordSysTransform \"there\"", "no coordinate system \"there\"", ERR_SCENE },
    { W "ActiveTransform Now", "All, StartTime or EndTime", ERR_SCENE },
    { W "\"sphere\"", "a directive is wanted here", ERR_SCENE },
    { W "]", "a directive is wanted here", ERR_SCENE },
    { W "Include \"other.pbrt\"", "no file can be read from here", ERR_SCENE },
    { "Camera \"perspectiv\"", "the nearest is \"perspective\"", ERR_SCENE },
    { "Camera \"spherical\"", "not supported yet", ERR_UNSUPPORTED },
    { "Camera \"perspective\" \"float fov\" 180", "outside 0 to 180", ERR_SCENE },
    { "Film \"rgb\" \"integer xresolution\" 0", "xresolution is 0", ERR_SCENE },
    { "Film \"rgb\" \"integer xresolution\" 100000", "1 to 65536", ERR_SCENE },
    { "Film \"rgb\" \"integer xresoluton\" 100", "the nearest is \"xresolution\"", ERR_SCENE },
    { "Film \"rgb\" \"string sensor\" \"canon_eos_10d\"", "the nearest is \"canon_eos_100d\"",
      ERR_SCENE },
    { "Film \"rgb\" \"float iso\" 0", "\"iso\" of 0", ERR_SCENE },
    { "Film \"rgb\" \"float whitebalance\" 500", "500 K is outside 1667 to 25000 K", ERR_SCENE },
    { "Camera \"perspective\" \"float shutteropen\" 1", "as it opens at 1", ERR_SCENE },
    { "Film \"rgb\" \"float cropwindow\" [0 1 1 0]", "cropwindow", ERR_SCENE },
    { "Film \"image\"", "in pbrt-v4 it is \"rgb\"", ERR_SCENE },
    { "PixelFilter \"sinc\"", "not supported yet", ERR_UNSUPPORTED },
    { "PixelFilter \"box\" \"float xradius\" 0", "a filter radius of 0", ERR_SCENE },
    { "Sampler \"sobel\"", "the nearest is \"sobol\"", ERR_SCENE },
    { "Sampler \"random\"", "in pbrt-v4 it is \"independent\"", ERR_SCENE },
    { "Sampler \"sobol\" \"integer pixelsamples\" 0", "0 samples per pixel", ERR_SCENE },
    { "Sampler \"stratified\" \"bool jitter\" false", "not supported yet", ERR_UNSUPPORTED },
    { "Integrator \"function\"", "not supported yet", ERR_UNSUPPORTED },
    { "Integrator \"bdpt\" \"bool visualizeweights\" true", "not supported yet", ERR_UNSUPPORTED },
    { "Integrator \"path\" \"integer maxdepth\" -1", "a depth of -1", ERR_SCENE },
    { "ColorSpace \"rec2021\"", "the nearest is \"rec2020\"", ERR_SCENE },
    { "Option \"forcediffuse\" 1", "is true or false", ERR_SCENE },
    { "Option \"forcediffuze\" true", "the nearest is \"forcediffuse\"", ERR_SCENE },
};

static void everything_wrong_is_said_with_its_position(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof(bad_rows) / sizeof(bad_rows[0]); i++)
        reader_text_refused(bad_rows[i].text, NULL, bad_rows[i].code, bad_rows[i].says);
}

static void leniency_replaces_and_counts(void **state)
{
    (void)state;
    static const char text[] =
        "Integrator \"function\" \"integer maxdepth\" 5 \"integer strange\" 1 WorldBegin "
        "Texture \"t\" \"spectrum\" \"ptex\" \"string filename\" \"a.ptx\" "
        "Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\" "
        "Material \"hair\" \"float eumelanin\" 3 Shape \"sphere\" "
        "MakeNamedMedium \"a\" \"string type\" \"cloud\" MakeNamedMedium \"b\" \"string type\" "
        "\"cloud\" MediumInterface \"a\" \"\" Shape \"disk\" \"float raduis\" 2 ";
    struct pbrt_options options = { .lenient = true };
    struct scene_notes notes;
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), NULL, &options, &notes, &err);
    if (scene == NULL)
        fail_msg("%s", err.text);
    assert_int_equal(scene->quadric_count, 3);
    EXPECT_NEAR(scene->materials[1].reflectance[0], 0.5, 0);
    assert_int_equal(notes.warnings, 6);
    bool counted = false;
    for (size_t i = 0; i < notes.count; i++)
        counted = counted || strstr(notes.lines[i],
                                    "is not supported yet; the picture lacks it (2 times)") != NULL;
    assert_true(counted);
    scene_notes_free(&notes);
    scene_free(scene);

    /* What pbrt does not know stays an error */
    static const char wrong[] = "WorldBegin Shape \"spere\"";
    assert_null(pbrt_read_text(wrong, strlen(wrong), NULL, &options, NULL, &err));
}

static void substitutions_are_noted(void **state)
{
    (void)state;
    static const char text[] = "Sampler \"zsobol\" Film \"gbuffer\" Accelerator \"bvh\" WorldBegin "
                               "Material \"diffuse\" \"rgb reflectance\" [2 1 1]";
    struct scene_notes notes;
    struct scene *scene = pbrt_read_text(text, strlen(text), "s.pbrt", NULL, &notes, NULL);
    assert_non_null(scene);
    assert_int_equal(notes.warnings, 0);
    assert_string_equal(notes.lines[0], "s.pbrt:1:9: sampler \"zsobol\" renders as \"sobol\"");
    assert_non_null(strstr(notes.lines[1], "is read as \"rgb\""));
    assert_non_null(strstr(notes.lines[3], "a reflectance above 1 is taken as 1"));
    assert_int_equal(scene->settings.sampler, SAMPLER_SOBOL);
    scene_notes_free(&notes);
    scene_free(scene);
}

/* Does reading the text say so? */
static struct scene *noted(const char *text, const char *says)
{
    struct scene_notes notes;
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), NULL, NULL, &notes, &err);
    if (scene == NULL)
        fail_msg("%s\nin: %s", err.text, text);
    bool said = says == NULL;
    for (size_t i = 0; i < notes.count; i++)
        said = said || strstr(notes.lines[i], says) != NULL;
    if (!said)
        fail_msg("\"%s\" is not said of %s", says, text);
    scene_notes_free(&notes);
    return scene;
}

#define SHUTTER "Camera \"perspective\" \"float shutteropen\" .25 \"float shutterclose\" .75 "
#define LIT     "WorldBegin LightSource \"point\" LightSource \"infinite\" " LIGHT "Shape \"disk\" "

static void the_sensor_makes_everything_brighter_or_darker(void **state)
{
    (void)state;
    static const struct {
        const char *before;
        double times;
        const char *says;
    } rows[] = {
        { "", 1, NULL },
        { "Film \"rgb\" \"float iso\" 150 ", 1.5, NULL },
        { SHUTTER, .5, NULL },
        { SHUTTER "Film \"spectral\" \"float iso\" 400 ", 2, "is read as \"rgb\"" },
        { SHUTTER "Film \"rgb\" \"float iso\" 400 \"float exposuretime\" .125 ", .5, NULL },
        { SHUTTER "Film \"rgb\" \"float imagingratio\" 3 ", 3, NULL },
        { "Film \"rgb\" \"float maxcomponentvalue\" 1 ", 1, "cutting off bright samples" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1000];
        snprintf(text, sizeof(text), "%s%s", rows[i].before, LIT);
        struct scene *scene = noted(text, rows[i].says);
        assert_int_equal(scene->light_count, 3);
        for (uint32_t l = 0; l < 3; l++)
            EXPECT_NEAR(scene->lights[l].radiance[0], rows[i].times, 1e-6);
        EXPECT_NEAR(scene->settings.sky[2], rows[i].times, 1e-6);
        EXPECT_NEAR(scene->lights[0].radiance[2], 3 * rows[i].times, 1e-6);
        scene_free(scene);
    }
}

/* A sensor balanced for a lamp makes daylight blue; one balanced for daylight changes nothing */
static void white_balance_turns_colours_as_pbrts_does(void **state)
{
    (void)state;
    static const struct {
        const char *sensor;
        double gains[3], tolerance;
    } rows[] = {
        { "\"float whitebalance\" 6504", { 1, 1, 1 }, .003 },
        { "\"string sensor\" \"nikon_d810\"", { 1, 1, 1 }, .003 },
        { "\"float whitebalance\" 5000", { .7713, 1.0287, 1.3372 }, .1 },
        { "\"float whitebalance\" 2856", { .45, 1.08, 3.4 }, .5 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1000];
        snprintf(text, sizeof(text), "Film \"rgb\" %s WorldBegin LightSource \"infinite\"",
                 rows[i].sensor);
        struct scene *scene = noted(text, NULL);
        for (int c = 0; c < 3; c++)
            EXPECT_NEAR(scene->settings.sky[c], rows[i].gains[c], rows[i].tolerance);
        scene_free(scene);
    }
}

/* By the published matrices of these spaces; white surfaces are white in any space */
static void colours_of_other_spaces_become_srgb(void **state)
{
    (void)state;
    static const struct {
        const char *space, *numbers;
        double surface[3], light[3];
    } rows[] = {
        { "srgb", ".1 .2 .3", { .1, .2, .3 }, { .1, .2, .3 } },
        { "rec2020", ".5 .5 .5", { .5, .5, .5 }, { .5, .5, .5 } },
        { "rec2020", ".3 .5 .4", { .17523, .52575, .39172 }, { .17523, .52575, .39172 } },
        { "rec2020", "1 0 0", { 1, 0, 0 }, { 1.6605, 0, 0 } },
        { "dci-p3", ".5 .4 .3", { .52257, .39576, .28808 }, { .52257, .39576, .28808 } },
        { "aces2065-1", ".5 .5 .5", { .5, .5, .5 }, { .52348, .49728, .45777 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1000];
        snprintf(
            text, sizeof(text),
            "WorldBegin ColorSpace \"%s\" LightSource \"infinite\" \"rgb L\" [%s] Texture "
            "\"t\" \"spectrum\" \"constant\" \"rgb value\" [%s] Material \"diffuse\" \"texture "
            "reflectance\" \"t\" Shape \"disk\" Material \"diffuse\" \"rgb reflectance\" [%s] "
            "Shape \"disk\"",
            rows[i].space, rows[i].numbers, rows[i].numbers, rows[i].numbers);
        struct scene *scene = scene_of(text);
        for (int c = 0; c < 3; c++) {
            EXPECT_NEAR(scene->settings.sky[c], rows[i].light[c], 2e-3);
            EXPECT_NEAR(scene->materials[0].reflectance[c], rows[i].surface[c], 2e-3);
            EXPECT_NEAR(scene->materials[1].reflectance[c], rows[i].surface[c], 2e-3);
        }
        scene_free(scene);
    }
    scene_free(noted("ColorSpace \"rec2020\" WorldBegin", "written in linear sRGB"));
    scene_free(noted("WorldBegin ColorSpace \"rec2020\" LightSource \"point\" \"rgb I\" [0 1 0]",
                     "more saturated than sRGB can show"));
}

static void integrators_of_the_same_light_are_read(void **state)
{
    (void)state;
    static const char *const rows[][2] = {
        { "Integrator \"bdpt\" \"integer maxdepth\" 7 ", "\"bdpt\" renders as \"path\"" },
        { "Integrator \"mlt\" \"integer mutationsperpixel\" 9 \"integer maxdepth\" 7 ", "\"mlt\"" },
        { "Integrator \"sppm\" \"float radius\" .1 \"integer maxdepth\" 7 ", "\"sppm\"" },
        { "Integrator \"path\" \"bool regularize\" true \"integer maxdepth\" 7 ",
          "\"regularize\" is not used" },
        { "Integrator \"volpath\" \"string lightsampler\" \"bvh\" \"integer maxdepth\" 7 ", NULL },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1000];
        snprintf(text, sizeof(text), "%s WorldBegin", rows[i][0]);
        struct scene *scene = noted(text, rows[i][1]);
        assert_int_equal(scene->settings.max_depth, 7);
        scene_free(scene);
    }
    struct scene *scene = noted("Integrator \"path\" WorldBegin", "stops at 5");
    assert_int_equal(scene->settings.max_depth, SCENE_NONE);
    scene_free(scene);
}

static void options_that_change_the_picture_do(void **state)
{
    (void)state;
    struct scene *scene = scene_of("PixelFilter \"mitchell\" Option \"disablepixeljitter\" true "
                                   "WorldBegin");
    assert_int_equal(scene->settings.filter.kind, FILTER_BOX);
    assert_true(scene->settings.filter.radius[0] > 0 && scene->settings.filter.radius[0] < 1e-5f);
    scene_free(scene);
    scene = scene_of(
        "Option \"disablepixeljitter\" true Option \"bool disablepixeljitter\" [false] "
        "WorldBegin");
    assert_int_equal(scene->settings.filter.kind, FILTER_GAUSSIAN);
    scene_free(scene);
    scene_free(noted("Option \"seed\" 7 WorldBegin", "--seed"));
    scene_free(noted("Option \"string rendercoordsys\" \"world\" WorldBegin", "of no use here"));

    /* Glass keeps R + T / n^2, metal its mean reflectance, and a coat over white what its thickness
     * does not absorb */
    scene = noted(
        "Option \"forcediffuse\" true WorldBegin Material \"dielectric\" Shape \"disk\" "
        "Material \"conductor\" \"rgb eta\" [1 1 1] \"rgb k\" [1e3 1e3 1e3] Shape \"disk\" "
        "Material \"diffuse\" \"rgb reflectance\" [.2 .3 .4] Shape \"disk\" "
        "Material \"coateddiffuse\" \"rgb reflectance\" [1 1 1] Shape \"disk\"",
        "mean over all directions");
    static const double want[] = { .0918 + (1 - .0918) / 2.25, .997, .2, .92 };
    for (int i = 0; i < 4; i++) {
        assert_int_equal(scene->materials[i].kind, MATERIAL_DIFFUSE);
        EXPECT_NEAR(scene->materials[i].reflectance[0], want[i], 5e-3);
    }
    assert_int_equal(scene->settings.effects & (FX_DIELECTRIC | FX_CONDUCTOR | FX_COAT), 0);
    scene_free(scene);
}

static void what_converters_leave_behind_is_named(void **state)
{
    (void)state;
    static const char *const rows[][2] = {
        { "WorldBegin Material \"diffuse\" \"rgb Kd\" [1 1 1]", "pbrt-v4 it is \"reflectance\"" },
        { "WorldBegin Material \"dielectric\" \"float index\" 1.5", "pbrt-v4 it is \"eta\"" },
        { "WorldBegin AreaLightSource \"diffuse\" \"integer nsamples\" 4", "there is none" },
        { "PixelFilter \"box\" \"float xwidth\" 2", "pbrt-v4 it is \"xradius\"" },
        { "WorldBegin Texture \"t\" \"spectrum\" \"imagemap\" \"string mapname\" \"a.png\"",
          "\"mapname\" is of pbrt-v3: in pbrt-v4 it is \"filename\"" },
        { "WorldBegin Material \"mix\" \"string namedmaterial1\" \"a\"",
          "in pbrt-v4 it is \"materials\"" },
        { "WorldBegin Material \"uber\"", "there is \"coateddiffuse\"" },
        { "WorldBegin TransformBegin", "pbrt-v4 has AttributeBegin" },
        { "Film \"rgb\" \"float xresolution\" 7", "\"integer xresolution\" is wanted here" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        assert_null(pbrt_read_text(rows[i][0], strlen(rows[i][0]), NULL, NULL, NULL, &err));
        if (strstr(err.text, rows[i][1]) == NULL)
            fail_msg("%s\ngave %s", rows[i][0], err.text);
    }
}

static void attribute_sets_defaults_in_its_block(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "WorldBegin AttributeBegin Attribute \"shape\" \"float radius\" 3 \"float unused\" 1 "
        "Shape \"sphere\" AttributeBegin Attribute \"shape\" \"float radius\" 4 Shape \"sphere\" "
        "AttributeEnd Shape \"sphere\" Shape \"sphere\" \"float radius\" 5 AttributeEnd "
        "Shape \"sphere\"");
    const double want[] = { 3, 4, 3, 5, 1 };
    for (int i = 0; i < 5; i++)
        EXPECT_NEAR(s->quadrics[i].radius, want[i], 0);
    scene_free(s);
}

static void attributes_hold_material_light_and_orientation(void **state)
{
    (void)state;
    struct scene *s = scene_of("WorldBegin AttributeBegin " LIGHT
                               "Material \"dielectric\" ReverseOrientation "
                               "Shape \"disk\" AttributeEnd Shape \"disk\"");
    assert_int_equal(s->quadrics[0].light, 0);
    assert_int_equal(s->quadrics[1].light, SCENE_NONE);
    assert_int_equal(s->materials[s->quadrics[1].material].kind, MATERIAL_DIFFUSE);
    assert_int_equal(s->quadrics[0].flags & QUADRIC_FLIP_NORMAL, QUADRIC_FLIP_NORMAL);
    assert_int_equal(s->quadrics[1].flags & QUADRIC_FLIP_NORMAL, 0);
    scene_free(s);
}

/* --- Files -------------------------------------------------------------------------------- */

static void write_text(const char *path, const char *text)
{
    scratch_write(path, text, strlen(text));
}

/* What an imported file does to the state ends with it, even when its last directive has
 * parameters, behind which the reader peeks; an included file's stays */
static void imports_leave_the_state_as_it_was(void **state)
{
    (void)state;
    char folder[256];
    scratch_make(folder);
    const char *part = scratch_path(folder, "part.pbrt"), *open = scratch_path(folder, "open.pbrt");
    const char *first = scratch_path(folder, "a.pbrt"), *second = scratch_path(folder, "b.pbrt");
    write_text(part, "Translate 5 0 0 Shape \"sphere\"\nMaterial \"dielectric\" \"float eta\" 1.3");
    write_text(open, "AttributeBegin");
    write_text(first, "WorldBegin Import \"part.pbrt\" Shape \"sphere\"");
    write_text(second, "WorldBegin Include \"part.pbrt\" Shape \"sphere\"");
    const char *third = scratch_path(folder, "c.pbrt"); /* in the place of `part` */
    write_text(third, "WorldBegin Import \"open.pbrt\" Shape \"sphere\" AttributeEnd");
    struct err err = { .text = "" };
    struct scene *imported = pbrt_read(first, NULL, NULL, &err);
    struct scene *included = pbrt_read(second, NULL, NULL, &err);
    if (imported == NULL || included == NULL)
        fail_msg("%s", err.text);
    EXPECT_NEAR(imported->quadrics[0].center[0] - imported->quadrics[1].center[0], 5, 1e-6);
    EXPECT_NEAR(included->quadrics[0].center[0] - included->quadrics[1].center[0], 0, 1e-6);
    assert_int_equal(imported->material_count, 1);
    assert_int_equal(included->material_count, 2);
    assert_null(pbrt_read(third, NULL, NULL, &err));
    assert_non_null(
        strstr(err.text, "open.pbrt:1:1: this block is not closed at the end of the imp"));
    scene_free(imported);
    scene_free(included);
    scratch_remove(folder);
}

static void includes_are_relative_and_errors_name_the_inner_file(void **state)
{
    (void)state;
    char folder[256];
    scratch_make(folder);
    char inner[600], ply[600];
    snprintf(inner, sizeof(inner), "%s/parts", folder);
    assert_int_equal(mkdir(inner, 0700), 0);
    snprintf(ply, sizeof(ply), "%s/parts/t.ply", folder);
    write_text(
        ply,
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty "
        "float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 "
        "0\n"
        "0 1 0\n3 0 1 2\n");
    const char *main_path = scratch_path(folder, "main.pbrt");
    const char *part_path = scratch_path(folder, "parts/part.pbrt");
    write_text(main_path, "WorldBegin\nInclude \"parts/part.pbrt\"\nShape \"sphere\"\n"
                          "Include \"parts/part.pbrt\"");
    write_text(part_path, "# last in its file: the name is still relative to it\n"
                          "Shape \"plymesh\" \"string filename\" \"t.ply\"");
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read(main_path, NULL, NULL, &err);
    if (scene == NULL)
        fail_msg("%s", err.text);
    assert_int_equal(scene->mesh_count, 2);
    assert_int_equal(scene->quadric_count, 1);
    assert_int_equal(scene->meshes[1].first_vertex, 3);
    scene_free(scene);

    write_text(part_path, "\n Shape \"plymesh\" \"string filename\" \"none.ply\"");
    assert_null(pbrt_read(main_path, NULL, NULL, &err));
    assert_non_null(strstr(err.text, "parts/part.pbrt:2:36: "));
    assert_non_null(strstr(err.text, "none.ply: cannot be opened"));

    write_text(part_path, "Include \"../main.pbrt\"");
    assert_null(pbrt_read(main_path, NULL, NULL, &err));
    assert_non_null(strstr(err.text, "parts/part.pbrt:1:9: "));
    assert_non_null(strstr(err.text, "the file includes itself"));

    write_text(main_path, "WorldBegin\nInclude \"parts/nothing.pbrt\"");
    assert_null(pbrt_read(main_path, NULL, NULL, &err));
    assert_non_null(strstr(err.text, "main.pbrt:2:9: "));
    assert_null(pbrt_read("/nowhere/s.pbrt", NULL, NULL, &err));
    assert_non_null(strstr(err.text, "/nowhere/s.pbrt: No such file"));
    scratch_remove(folder);
}

static const char *shared_folder(void)
{
    static char path[512];
    const char *shared = getenv("PATHFARM_SHARED"), *source = getenv("PATHFARM_SOURCE");
    if (shared != NULL)
        return shared;
    snprintf(path, sizeof(path), "%s/../shared", source != NULL ? source : ".");
    return path;
}

/* Read every file of a pattern, strictly; the number of files */
static size_t read_all(const char *pattern)
{
    glob_t found;
    if (glob(pattern, 0, NULL, &found) != 0)
        return 0;
    size_t count = found.gl_pathc;
    for (size_t i = 0; i < count; i++) {
        struct err err = { .text = "" };
        struct scene *scene = pbrt_read(found.gl_pathv[i], NULL, NULL, &err);
        if (scene == NULL)
            fail_msg("%s", err.text);
        assert_true(scene->light_count > 0);
        scene_free(scene);
    }
    globfree(&found);
    return count;
}

static void real_scenes_are_read_strictly(void **state)
{
    (void)state;
    static const char *const patterns[] = { "scenes/cornell-box/*.pbrt",
                                            "scenes/veach-mis-pbrt/*.pbrt",
                                            "scenes/material-testball/*.pbrt",
                                            "scenes/bmw-m6/*.pbrt" };
    size_t count = 0;
    for (size_t i = 0; i < sizeof(patterns) / sizeof(patterns[0]); i++) {
        char pattern[700];
        snprintf(pattern, sizeof(pattern), "%s/%s", shared_folder(), patterns[i]);
        count += read_all(pattern);
    }
    if (count == 0) {
        print_message("no scenes in %s: set PATHFARM_SHARED\n", shared_folder());
        skip();
    }
}

static void the_comparison_scenes_are_read_strictly(void **state)
{
    (void)state;
    char folder[256], command[4096];
    scratch_make(folder);
    /* Without the last scene, whose mesh takes seconds to make */
    snprintf(command, sizeof(command),
             "python=python3; $python -c 'import numpy' 2>/dev/null || python=/usr/bin/python3; "
             "grep -v 'write(.mesh.' '%s/peers/gen_scenes.py' > '%s/gen.py' 2>/dev/null && "
             "OUT='%s' $python '%s/gen.py' >/dev/null 2>&1",
             shared_folder(), folder, folder, folder);
    if (system(command) != 0) {
        scratch_remove(folder);
        print_message("numpy or %s/peers/gen_scenes.py is missing\n", shared_folder());
        skip();
    }
    struct err err = { .text = "" };
    struct scene *s = pbrt_read(scratch_path(folder, "lights.pbrt"), NULL, NULL, &err);
    if (s == NULL)
        fail_msg("%s", err.text);
    assert_int_equal(s->light_count, 64);
    for (uint32_t i = 0; i < 64; i++) {
        assert_int_equal(s->lights[i].corner_count, 4);
        EXPECT_NEAR(s->lights[i].pick, 1.0 / 64, 1e-5);
        EXPECT_NEAR(s->lights[i].normal[1], -1, 1e-6);
    }
    scene_free(s);
    s = pbrt_read(scratch_path(folder, "cornell.pbrt"), NULL, NULL, &err);
    if (s == NULL)
        fail_msg("%s", err.text);
    assert_int_equal(s->settings.effects, FX_MESH | FX_POLYGON_LIGHT);
    scene_free(s);
    scratch_remove(folder);
}

static void our_own_scenes_are_read_strictly(void **state)
{
    (void)state;
    const char *source = getenv("PATHFARM_SOURCE");
    char pattern[700];
    snprintf(pattern, sizeof(pattern), "%s/scenes/*.pbrt", source != NULL ? source : ".");
    assert_true(read_all(pattern) > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(transforms_compose_as_in_pbrt),
        cmocka_unit_test(inverses_are_inverses),
        cmocka_unit_test(far_scenes_are_recentred_in_double),
        cmocka_unit_test(normals_go_by_the_inverse_transpose_and_orientation),
        cmocka_unit_test(one_mirror_flips_once),
        cmocka_unit_test(the_camera_looks_along_z_with_x_to_the_right),
        cmocka_unit_test(screens_follow_the_film_or_what_is_said),
        cmocka_unit_test(a_mirrored_camera_is_left_handed),
        cmocka_unit_test(crop_windows_round_up_and_follow_resolution),
        cmocka_unit_test(samplers_filters_and_integrators_are_read),
        cmocka_unit_test(materials_have_pbrts_defaults),
        cmocka_unit_test(equal_coats_share_a_table),
        cmocka_unit_test(only_materials_in_use_join_the_scene),
        cmocka_unit_test(a_quad_is_one_polygon_light),
        cmocka_unit_test(corners_go_around_the_emitting_side),
        cmocka_unit_test(polygons_merge_only_when_flat_and_convex),
        cmocka_unit_test(no_polygon_has_more_than_eight_corners),
        cmocka_unit_test(light_numbers_are_pbrts),
        cmocka_unit_test(quadric_lights_know_their_size_in_the_world),
        cmocka_unit_test(stretched_lights_have_the_area_of_the_world),
        cmocka_unit_test(picks_follow_power),
        cmocka_unit_test(degenerate_triangles_are_counted_and_never_lights),
        cmocka_unit_test(everything_wrong_is_said_with_its_position),
        cmocka_unit_test(leniency_replaces_and_counts),
        cmocka_unit_test(substitutions_are_noted),
        cmocka_unit_test(the_sensor_makes_everything_brighter_or_darker),
        cmocka_unit_test(white_balance_turns_colours_as_pbrts_does),
        cmocka_unit_test(colours_of_other_spaces_become_srgb),
        cmocka_unit_test(integrators_of_the_same_light_are_read),
        cmocka_unit_test(options_that_change_the_picture_do),
        cmocka_unit_test(what_converters_leave_behind_is_named),
        cmocka_unit_test(imports_leave_the_state_as_it_was),
        cmocka_unit_test(attribute_sets_defaults_in_its_block),
        cmocka_unit_test(attributes_hold_material_light_and_orientation),
        cmocka_unit_test(includes_are_relative_and_errors_name_the_inner_file),
        cmocka_unit_test(real_scenes_are_read_strictly),
        cmocka_unit_test(the_comparison_scenes_are_read_strictly),
        cmocka_unit_test(our_own_scenes_are_read_strictly),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
