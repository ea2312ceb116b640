/* Goal: what emits becomes lights: flat convex parts of meshes are polygons, each knows its area in
 * the world and the side that shines, and weak lights are picked seldom. */
#include "common/effects.h"
#include "tests/reader_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static struct scene *scene_of(const char *text)
{
    return reader_text_scene(text, NULL, NULL);
}

#define QUAD                                                         \
    "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] " \
    "\"integer indices\" [0 1 2 0 2 3] "
#define LIGHT "AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] "

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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_quad_is_one_polygon_light),
        cmocka_unit_test(corners_go_around_the_emitting_side),
        cmocka_unit_test(polygons_merge_only_when_flat_and_convex),
        cmocka_unit_test(no_polygon_has_more_than_eight_corners),
        cmocka_unit_test(light_numbers_are_pbrts),
        cmocka_unit_test(quadric_lights_know_their_size_in_the_world),
        cmocka_unit_test(stretched_lights_have_the_area_of_the_world),
        cmocka_unit_test(picks_follow_power),
        cmocka_unit_test(degenerate_triangles_are_counted_and_never_lights),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
