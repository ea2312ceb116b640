/* Goal: lights with pictures are what pbrt means by them: how they are turned, how bright they are,
 * and what is wrong with a picture is said at its name. */
#include "common/direction_map.h"
#include "common/effects.h"
#include "tests/reader_text.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static char folder[256];

/* A grey PFM; its rows, here from the top, are stored from the bottom */
static void write_picture(const char *name, unsigned width, unsigned height,
                          float (*value)(unsigned x, unsigned y))
{
    char bytes[65536];
    size_t size = (size_t)snprintf(bytes, sizeof(bytes), "Pf\n%u %u\n-1\n", width, height);
    for (unsigned y = height; y-- > 0;)
        for (unsigned x = 0; x < width; x++) {
            float v = value(x, y);
            memcpy(bytes + size, &v, sizeof(v));
            size += sizeof(v);
        }
    scratch_write(scratch_path(folder, name), bytes, size);
}

static float one(unsigned x, unsigned y)
{
    (void)x;
    (void)y;
    return 1;
}

static float count(unsigned x, unsigned y)
{
    return (float)(x + 4 * y);
}

static float corner(unsigned x, unsigned y)
{
    return x < 8 && y < 8 ? 4 : 0;
}

static float black(unsigned x, unsigned y)
{
    return 0 * one(x, y);
}

static int set_up(void **state)
{
    (void)state;
    scratch_make(folder);
    write_picture("one.pfm", 64, 64, one);
    write_picture("count.pfm", 4, 4, count);
    write_picture("wide.pfm", 128, 64, one);
    write_picture("odd.pfm", 3, 2, one);
    write_picture("corner.pfm", 64, 64, corner);
    write_picture("black.pfm", 16, 16, black);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    scratch_remove(folder);
    return 0;
}

static struct scene *try_read(const char *lights, struct scene_notes *notes, struct err *err)
{
    char text[4096];
    int length = snprintf(text, sizeof(text), "WorldBegin\n%s\n", lights);
    const char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, (size_t)length);
    return pbrt_read(path, NULL, notes, err);
}

static struct scene *scene_of(const char *lights)
{
    struct err err = { .text = "" };
    struct scene *scene = try_read(lights, NULL, &err);
    if (scene == NULL)
        fail_msg("%s\nin: %s", err.text, lights);
    return scene;
}

static void an_infinite_picture_is_a_light_of_its_own(void **state)
{
    (void)state;
    struct scene *s = scene_of("LightSource \"infinite\" \"string filename\" \"count.pfm\" \"float "
                               "scale\" 2 "
                               "LightSource \"infinite\" \"rgb L\" [1 2 3] "
                               "LightSource \"infinite\" \"string filename\" \"one.pfm\" "
                               "LightSource \"infinite\" \"string filename\" \"count.pfm\"");
    assert_int_equal(s->light_count, 4);
    assert_int_equal(s->environment_count, 3);
    assert_int_equal(s->picture_count, 2);
    assert_int_equal(s->settings.sky_light, 3);
    for (uint32_t i = 0; i < 3; i++) {
        assert_int_equal(s->lights[i].kind, LIGHT_SKY);
        assert_int_equal(s->lights[i].environment, i + 1);
        assert_int_equal(s->environments[i].light, i);
        assert_int_equal(s->environments[i].layout, ENVIRONMENT_SQUARE);
    }
    EXPECT_NEAR(s->lights[0].radiance[1], 2 * 7.5, 1e-5);
    EXPECT_NEAR(s->lights[1].radiance[1], 1, 1e-6);
    EXPECT_NEAR(s->environments[0].scale[2], 2, 0);
    EXPECT_NEAR(s->environments[2].scale[2], 1, 0);
    double rgb[3];
    direction_map_texel(&s->pictures[s->environments[0].picture], s->texels, 3, 0, rgb);
    EXPECT_NEAR(rgb[0], 3, 0); /* the top row first */
    /* What reaches a scene without extent: in proportion to the means */
    EXPECT_NEAR(s->lights[0].pick / s->lights[1].pick, 15, 1e-3);
    scene_free(s);
}

static void the_transform_turns_the_picture(void **state)
{
    (void)state;
    static const struct {
        const char *transform;
        float to_light[9];
    } cases[] = {
        { "", { 1, 0, 0, 0, 1, 0, 0, 0, 1 } },
        { "Rotate -90 1 0 0", { 1, 0, 0, 0, 0, -1, 0, 1, 0 } }, /* z of the light is y up */
        { "Scale 3 3 3 Rotate -90 1 0 0 Translate 5 6 7", { 1, 0, 0, 0, 0, -1, 0, 1, 0 } },
        { "Scale -1 1 1", { -1, 0, 0, 0, 1, 0, 0, 0, 1 } },
        { "Transform [ 0.8 0 -0.60003 0 0 1 0 0 0.6 0 0.8 0 0 0 0 1 ]",
          { 0.8f, 0, -0.6f, 0, 1, 0, 0.6f, 0, 0.8f } },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), "%s LightSource \"infinite\" \"string filename\" \"one.pfm\"",
                 cases[i].transform);
        struct scene *s = scene_of(text);
        for (int k = 0; k < 9; k++)
            if (!(fabsf(s->environments[0].to_light[k] - cases[i].to_light[k]) < 5e-5f))
                fail_msg("%s: entry %d is %g", cases[i].transform, k,
                         (double)s->environments[0].to_light[k]);
        scene_free(s);
    }
}

static void a_wide_picture_is_latitude_and_longitude_and_that_is_said(void **state)
{
    (void)state;
    struct scene_notes notes;
    struct err err = { .text = "" };
    struct scene *s = try_read("LightSource \"infinite\" \"string filename\" \"wide.pfm\"", &notes,
                               &err);
    if (s == NULL)
        fail_msg("%s", err.text);
    assert_int_equal(s->environments[0].layout, ENVIRONMENT_LAT_LONG);
    EXPECT_NEAR(s->lights[0].radiance[0], 1, 1e-6);
    unsigned said = 0;
    for (size_t i = 0; i < notes.count; i++)
        said += strstr(notes.lines[i], "latitude") != NULL;
    assert_int_equal(said, 1);
    scene_notes_free(&notes);
    scene_free(s);
}

/* pbrt-v4's illuminance of a picture of one is pi / 2: it halves the solid angle */
static void illuminance_and_power_scale_pictures(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"float illuminance\" 3 "
        "LightSource \"infinite\" \"string filename\" \"wide.pfm\" \"float illuminance\" 3 "
        "LightSource \"goniometric\" \"string filename\" \"one.pfm\" \"float power\" 100 "
        "LightSource \"projection\" \"string filename\" \"one.pfm\" \"float power\" 100");
    EXPECT_NEAR(s->lights[0].radiance[0], 6 / PI, 5e-3);
    EXPECT_NEAR(s->lights[1].radiance[0], 6 / PI, 5e-3);
    EXPECT_NEAR(s->lights[2].radiance[0], 100 / (4 * PI), 1e-4);
    EXPECT_NEAR(s->lights[3].radiance[0], 100 / (4 * PI), 1e-4);
    EXPECT_NEAR(s->environments[3].scale[0], 100 / (4 * PI / 6), 0.02); /* a side of a cube */
    scene_free(s);
}

static void lights_with_pictures_stand_where_they_are_put(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "Translate 1 2 3 "
        "LightSource \"goniometric\" \"string filename\" \"count.pfm\" \"rgb I\" [1 2 4] "
        "LightSource \"projection\" \"string filename\" \"wide.pfm\" \"float fov\" 60");
    for (uint32_t i = 0; i < 2; i++) {
        assert_int_equal(s->lights[i].kind, LIGHT_POINT);
        EXPECT_NEAR(s->lights[i].position[1] + s->settings.center[1], 2, 1e-6);
    }
    EXPECT_NEAR(s->lights[0].radiance[2], 4 * 7.5, 1e-4);
    const float *m = s->environments[0].to_light, yz[9] = { 1, 0, 0, 0, 0, 1, 0, 1, 0 };
    for (int i = 0; i < 9; i++)
        EXPECT_NEAR(m[i], yz[i], 1e-6);
    assert_int_equal(s->environments[1].layout, ENVIRONMENT_PROJECTION);
    m = s->environments[1].to_light;
    EXPECT_NEAR(m[0], 1 / (2 * tan(PI / 6)), 1e-6);
    EXPECT_NEAR(m[4], -1 / tan(PI / 6), 1e-6);
    EXPECT_NEAR(m[8], 1, 1e-6);
    scene_free(s);
}

/*
 * The texel that a direction of the light's space finds, by pbrt-v4's own rules (lights.cpp): the
 * goniometric light exchanges y and z and takes the square of equal areas; the projection turns y
 * over, and (-aspect, -1) to (aspect, 1) of the plane at the shorter side's field of view is its
 * picture, first row first. Here for directions along which both are easily said.
 */
static void pictures_lie_in_directions_as_pbrt_says(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "LightSource \"goniometric\" \"string filename\" \"count.pfm\" "
        "LightSource \"projection\" \"string filename\" \"count.pfm\" \"float fov\" 90");
    /* The middle of the square is the pole of +z there, y here; the edges' middles are the equator,
     * +x at the right, and at the bottom +y there, z here */
    static const struct {
        double w[3], s, t;
    } square[] = {
        { { 0, 1, 0 }, 0.5, 0.5 }, { { 1, 0, 0 }, 1, 0.5 },  { { -1, 0, 0 }, 0, 0.5 },
        { { 0, 0, 1 }, 0.5, 1 },   { { 0, 0, -1 }, 0.5, 0 }, { { 0, -1, 0 }, 0, 0 },
    };
    for (size_t i = 0; i < sizeof(square) / sizeof(square[0]); i++) {
        const float *m = s->environments[0].to_light;
        double there[3];
        direction_map_direction(ENVIRONMENT_SQUARE, square[i].s, square[i].t, there);
        for (int row = 0; row < 3; row++) {
            double sum = 0;
            for (int k = 0; k < 3; k++)
                sum += (double)m[3 * row + k] * square[i].w[k];
            EXPECT_NEAR(sum, there[row], 1e-6);
        }
    }
    /* +x is right in the picture and +y up, towards its first row */
    static const struct {
        double w[3], s, t;
    } slide[] = {
        { { 0, 0, 1 }, 0.5, 0.5 },
        { { 1, 0, 1 }, 1, 0.5 },
        { { 0, 1, 1 }, 0.5, 0 },
        { { -0.5, -0.5, 1 }, 0.25, 0.75 },
    };
    for (size_t i = 0; i < sizeof(slide) / sizeof(slide[0]); i++) {
        const float *m = s->environments[1].to_light;
        double there[3], at[3];
        direction_map_direction(ENVIRONMENT_PROJECTION, slide[i].s, slide[i].t, there);
        for (int row = 0; row < 3; row++) {
            at[row] = 0;
            for (int k = 0; k < 3; k++)
                at[row] += (double)m[3 * row + k] * slide[i].w[k];
        }
        EXPECT_NEAR(at[0] / at[2], there[0] / there[2], 1e-6);
        EXPECT_NEAR(at[1] / at[2], there[1] / there[2], 1e-6);
    }
    scene_free(s);
}

/* A rectangle in world space, whatever the transform; the light goes where p01 x p03 points to */
static void a_portal_stands_where_its_points_are(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "Scale 5 5 5 LightSource \"infinite\" \"string filename\" \"one.pfm\" "
        "\"point3 portal\" [1 2 3 4 2 3 4 4 3 1 4 3]");
    const struct light *light = &s->lights[0];
    assert_int_equal(light->kind, LIGHT_SKY);
    assert_int_equal(light->corner_count, 4);
    EXPECT_NEAR(light->area, 6, 1e-6);
    EXPECT_NEAR(light->normal[2], 1, 1e-6);
    const float *corner = s->light_corners + 3 * light->first_corner;
    EXPECT_NEAR((double)corner[3] + s->settings.center[0], 4, 1e-6);
    EXPECT_NEAR((double)corner[7] + s->settings.center[1], 4, 1e-6);
    EXPECT_NEAR((double)corner[11] + s->settings.center[2], 3, 1e-6);
    assert_int_equal(s->settings.effects & FX_ENVIRONMENT, FX_ENVIRONMENT);
    scene_free(s);
}

#define SCREEN                                                                           \
    "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] \"integer indices\" " \
    "[0 1 2 0 2 3] \"point2 uv\" [0 0 1 0 1 1 0 1] "

/* Each triangle is a light, with the mean of its part of the picture; "power" counts the whole */
static void area_lights_show_their_pictures(void **state)
{
    (void)state;
    struct scene *s = scene_of("AreaLightSource \"diffuse\" \"string filename\" \"count.pfm\" "
                               "\"float scale\" 2 \"bool twosided\" true " SCREEN);
    assert_int_equal(s->light_count, 2);
    assert_int_equal(s->settings.effects & FX_TEXTURE, FX_TEXTURE);
    for (uint32_t i = 0; i < 2; i++) {
        const struct light *light = &s->lights[i];
        assert_int_equal(light->corner_count, 3);
        assert_int_equal(light->flags, LIGHT_TWO_SIDED);
        EXPECT_NEAR(light->texture_scale, 2, 0);
        const struct texture *texture = &s->textures[light->texture - 1];
        assert_int_equal(texture->wrap[0], WRAP_CLAMP);
        EXPECT_NEAR(texture->map[0], 1, 0);
    }
    /* x + 4 y from the top: the first triangle is below the diagonal from bottom left to top right,
     * where both are larger: 10.8 at its middle, a little less at the edges */
    double mean[2] = { (double)s->lights[0].radiance[0] / 2, (double)s->lights[1].radiance[0] / 2 };
    EXPECT_NEAR((mean[0] + mean[1]) / 2, 7.5, 0.3);
    EXPECT_NEAR(mean[0], 10.7, 0.2);
    scene_free(s);

    s = scene_of("AreaLightSource \"diffuse\" \"string filename\" \"count.pfm\" "
                 "\"float power\" 30 " SCREEN);
    for (uint32_t i = 0; i < 2; i++)
        EXPECT_NEAR(s->lights[i].texture_scale, 30 / (PI * 1 * 7.5), 1e-5);
    scene_free(s);

    /* A sphere, a disk, and a copy of an instance */
    s = scene_of("AreaLightSource \"diffuse\" \"string filename\" \"count.pfm\" "
                 "Shape \"sphere\" Shape \"disk\" "
                 "ObjectBegin \"o\" " SCREEN "ObjectEnd "
                 "ObjectInstance \"o\" Translate 9 0 0 ObjectInstance \"o\"");
    assert_int_equal(s->light_count, 6);
    for (uint32_t i = 0; i < 6; i++) {
        assert_true(s->lights[i].texture != 0);
        EXPECT_NEAR(s->lights[i].radiance[0], 7.5, 3.5);
    }
    scene_free(s);
}

/* Parts that are black are no lights, nor is what is black all over */
static void what_is_black_in_its_picture_is_no_light(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "AreaLightSource \"diffuse\" \"string filename\" \"corner.pfm\" "
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 2 0 0 0 1 0 1 1 0 2 1 0] "
        "\"integer indices\" [1 2 5 1 5 4 0 1 4 0 4 3] "
        "\"point2 uv\" [0 0 .5 0 1 0 0 1 .5 1 1 1] ");
    assert_int_equal(s->light_count, 2); /* those of the left half; the bright spot is top left */
    assert_int_equal(s->triangle_light[0], SCENE_NONE);
    assert_int_equal(s->triangle_light[1], SCENE_NONE);
    assert_int_equal(s->triangle_light[3], 1);
    EXPECT_NEAR(s->lights[1].radiance[0], 4 * 4.0 / 64, 0.03); /* 1/16 of the triangle */
    scene_free(s);
    s = scene_of("AreaLightSource \"diffuse\" \"string filename\" \"black.pfm\" " SCREEN);
    assert_int_equal(s->light_count, 0);
    scene_free(s);
}

static void alpha_makes_lights_of_parts_and_of_what_is_not_seen(void **state)
{
    (void)state;
    struct scene *s = scene_of(
        "Texture \"a\" \"float\" \"imagemap\" \"string filename\" \"count.pfm\" "
        "AreaLightSource \"diffuse\" "
        "Shape \"sphere\" \"texture alpha\" \"a\" Shape \"disk\" \"float alpha\" 0.5 "
        "Shape \"disk\" \"float alpha\" 0 "
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] \"integer indices\" "
        "[0 1 2 0 2 3] \"texture alpha\" \"a\" "
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 2 0 0 2 1 0 0 1 0] \"integer indices\" "
        "[0 1 2 0 2 3] \"float alpha\" 0");
    /* Meshes first: two triangles that are there in part, then one quad that is not there at all */
    assert_int_equal(s->light_count, 6);
    assert_int_equal(s->lights[0].corner_count, 3);
    assert_int_equal(s->lights[1].corner_count, 3);
    assert_int_equal(s->lights[2].corner_count, 4);
    assert_int_equal(s->lights[2].flags, LIGHT_UNSEEN);
    assert_int_equal(s->meshes[1].material, SCENE_NONE);
    assert_true(s->quadrics[0].alpha != 0 && s->quadrics[1].alpha != 0);
    assert_int_equal(s->lights[3].flags, 0);
    assert_int_equal(s->quadrics[2].alpha, 0);
    assert_int_equal(s->lights[5].flags, LIGHT_UNSEEN);
    assert_int_equal(s->settings.effects & (FX_TEXTURE | FX_DELTA_LIGHT),
                     FX_TEXTURE | FX_DELTA_LIGHT);
    scene_free(s);
}

static void bad_pictures_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *text, *said;
    } rows[] = {
        { "LightSource \"infinite\" \"string filename\" \"odd.pfm\"", "scene.pbrt:2:42: a light's "
                                                                      "picture is square" },
        { "LightSource \"infinite\" \"string filename\" \"none.pfm\"", "scene.pbrt:2:42" },
        { "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"rgb L\" [1 1 1]",
          "a picture or a colour" },
        { "LightSource \"infinite\" \"string mapname\" \"one.pfm\"", "it is \"filename\"" },
        { "Scale 1 2 1 LightSource \"infinite\" \"string filename\" \"one.pfm\"", "stretches" },
        { "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"rgb scale\" [1 1 1]",
          "scale" },
        { "LightSource \"projection\" \"string filename\" \"one.pfm\" \"float fov\" 180",
          "field of view of 180" },
        { "LightSource \"projection\"", "wants \"string filename\"" },
        { "LightSource \"goniometric\" \"float power\" 3", "wants \"string filename\"" },
        { "AreaLightSource \"diffuse\" \"string filename\" \"none.pfm\"", "scene.pbrt:2:45" },
        { "AreaLightSource \"diffuse\" \"string filename\" \"one.pfm\" \"rgb L\" [1 1 1]",
          "a picture or a colour" },
        { "LightSource \"infinite\" \"point3 portal\" [0 0 0 1 0 0 1 1 0 0 1 0]",
          "a portal wants \"string filename\"" },
        { "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"point3 portal\" "
          "[0 0 0 1 0 0 1 1 0]",
          "four points" },
        { "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"point3 portal\" "
          "[0 0 0 1 0 0 1 1 0 0.1 1 0]",
          "a rectangle" },
        { "LightSource \"infinite\" \"string filename\" \"one.pfm\" \"point3 portal\" "
          "[0 0 0 1 0 0 0 0 0 1 0 0]",
          "a rectangle" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        struct scene *s = try_read(rows[i].text, NULL, &err);
        if (s != NULL || strstr(err.text, rows[i].said) == NULL)
            fail_msg("%s\nfor: %s", s != NULL ? "read" : err.text, rows[i].text);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_infinite_picture_is_a_light_of_its_own),
        cmocka_unit_test(the_transform_turns_the_picture),
        cmocka_unit_test(a_wide_picture_is_latitude_and_longitude_and_that_is_said),
        cmocka_unit_test(illuminance_and_power_scale_pictures),
        cmocka_unit_test(lights_with_pictures_stand_where_they_are_put),
        cmocka_unit_test(pictures_lie_in_directions_as_pbrt_says),
        cmocka_unit_test(a_portal_stands_where_its_points_are),
        cmocka_unit_test(area_lights_show_their_pictures),
        cmocka_unit_test(what_is_black_in_its_picture_is_no_light),
        cmocka_unit_test(alpha_makes_lights_of_parts_and_of_what_is_not_seen),
        cmocka_unit_test(bad_pictures_are_refused_with_a_reason),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
