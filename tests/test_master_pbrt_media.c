/* Goal: media are what pbrt means by them: their numbers, whose inside and outside they are, when
 * they join the scene, and what is wrong is said at its place. */
#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "master/scene_notes.h"
#include "tests/expect.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#define HAZE "MakeNamedMedium \"haze\" \"string type\" \"homogeneous\" "
#define DUST "MakeNamedMedium \"dust\" \"string type\" \"homogeneous\" "
#define W    "WorldBegin\n"

static struct scene *read_with(const char *text, struct scene_notes *notes)
{
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), "text", NULL, notes, &err);
    if (scene == NULL)
        fail_msg("\"%s\": %s", text, err.text);
    return scene;
}

static struct scene *read(const char *text)
{
    return read_with(text, NULL);
}

static void coefficients_are_scaled_and_light_is_coloured(void **state)
{
    (void)state;
    struct scene *scene = read(HAZE "\"rgb sigma_a\" [1 2 3] \"rgb sigma_s\" [.5 0 4] \"float "
                                    "scale\" .1 \"float g\" -.7 \"rgb Le\" [3 2 1] \"float "
                                    "Lescale\" 2\n" W
                                    "MediumInterface \"haze\" \"\" Shape \"sphere\"");
    assert_int_equal(scene->medium_count, 1);
    const struct medium *m = &scene->media[0];
    const double a[3] = { .1, .2, .3 }, s[3] = { .05, 0, .4 }, Le[3] = { 6, 4, 2 };
    for (int c = 0; c < 3; c++) {
        EXPECT_NEAR(m->sigma_a[c], a[c], 1e-7);
        EXPECT_NEAR(m->sigma_s[c], s[c], 1e-7);
        EXPECT_NEAR(m->Le[c], Le[c], 1e-6);
    }
    EXPECT_NEAR(m->g, -.7, 1e-7);
    assert_true(scene->settings.effects & FX_MEDIUM);
    scene_free(scene);
}

static void a_spectrum_may_exceed_one(void **state)
{
    (void)state;
    struct scene *scene = read(HAZE "\"spectrum sigma_s\" [300 7 800 7]\n" W
                                    "MediumInterface \"haze\" \"\" Shape \"sphere\"");
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(scene->media[0].sigma_s[c], 7, 1e-4);
    scene_free(scene);
}

static void without_numbers_it_is_milk_and_presets_have_their_own(void **state)
{
    (void)state;
    struct scene *scene = read(HAZE DUST "\"string preset\" \"Skin1\" \"rgb sigma_a\" [1 1 1]\n" W
                                         "MediumInterface \"haze\" \"dust\" Shape \"sphere\"");
    assert_int_equal(scene->medium_count, 2);
    EXPECT_NEAR(scene->media[0].sigma_a[2], .014, 1e-8);
    EXPECT_NEAR(scene->media[0].sigma_s[0], 2.55, 1e-6);
    EXPECT_NEAR(scene->media[1].sigma_a[1], .17, 1e-7);
    EXPECT_NEAR(scene->media[1].sigma_s[2], 1.01, 1e-6);
    scene_free(scene);
}

static void both_sides_follow_the_graphics_state(void **state)
{
    (void)state;
    struct scene *scene = read(
        W HAZE DUST "Shape \"sphere\" AttributeBegin MediumInterface \"haze\" \"dust\" "
                    "Shape \"sphere\" Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] "
                    "AttributeEnd Shape \"sphere\" MediumInterface \"dust\" Shape \"sphere\" "
                    "MediumInterface \"\" \"dust\" Material \"interface\" Shape \"sphere\"");
    static const uint32_t want[5][2] = { { 0, 0 }, { 1, 2 }, { 0, 0 }, { 0, 0 }, { 0, 2 } };
    assert_int_equal(scene->quadric_count, 5);
    for (int i = 0; i < 5; i++) {
        assert_int_equal(scene->quadrics[i].inside, want[i][0]);
        assert_int_equal(scene->quadrics[i].outside, want[i][1]);
    }
    assert_int_equal(scene->meshes[0].inside, 1);
    assert_int_equal(scene->meshes[0].outside, 2);
    assert_int_equal(scene->quadrics[4].material, SCENE_NONE);
    scene_free(scene);
}

static void the_camera_stands_in_what_was_outside(void **state)
{
    (void)state;
    struct scene_notes notes;
    struct scene *scene = read_with("MediumInterface \"\" \"haze\" Camera \"perspective\"\n" HAZE W
                                    "MediumInterface \"\" LightSource \"distant\" Shape \"sphere\"",
                                    &notes);
    assert_int_equal(scene->settings.camera_medium, 1);
    assert_int_equal(scene->quadrics[0].outside, 0);
    bool noted = false;
    for (size_t i = 0; i < notes.count; i++)
        noted |= strstr(notes.lines[i], "light from infinity does not come through") != NULL;
    assert_true(noted);
    scene_notes_free(&notes);
    scene_free(scene);
}

static void what_nothing_uses_calls_for_no_effect(void **state)
{
    (void)state;
    /* Neither a definition, nor the same on both sides, which is no transition */
    struct scene *scene = read(W HAZE "MediumInterface \"haze\" \"haze\" Shape \"sphere\"");
    assert_int_equal(scene->medium_count, 0);
    assert_false(scene->settings.effects & FX_MEDIUM);
    scene_free(scene);
}

static void shapes_in_objects_keep_their_media(void **state)
{
    (void)state;
    struct scene *scene = read(W HAZE "ObjectBegin \"o\" MediumInterface \"haze\" \"\" Material "
                                      "\"interface\" Shape \"sphere\" ObjectEnd ObjectInstance "
                                      "\"o\" Translate 3 0 0 ObjectInstance \"o\"");
    assert_int_equal(scene->instance_count, 2);
    assert_int_equal(scene->quadrics[0].inside, 1);
    scene_free(scene);
}

static void what_is_wrong_is_said_at_its_place(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
        enum err_code code;
    } rows[] = {
        { W "MediumInterface \"nowhere\" \"\"", "text:2:17: no medium \"nowhere\"", ERR_SCENE },
        { W "MediumInterface 3", "wants a name in quotes", ERR_SCENE },
        { W HAZE HAZE, "text:2:68: a second medium \"haze\"", ERR_SCENE },
        { W "MakeNamedMedium \"\" \"string type\" \"homogeneous\"", "is vacuum", ERR_SCENE },
        { W "MakeNamedMedium \"a\"", "wants \"string type\"", ERR_SCENE },
        { W "MakeNamedMedium \"a\" \"string type\" \"homogenous\"",
          "the nearest is \"homogeneous\"", ERR_SCENE },
        { W "MakeNamedMedium \"a\" \"string type\" \"heterogeneous\"", "uniformgrid", ERR_SCENE },
        { W "MakeNamedMedium \"a\" \"string type\" \"nanovdb\"",
          "medium \"nanovdb\" is not supported yet", ERR_UNSUPPORTED },
        { W "MakeNamedMedium \"a\" \"string type\" \"uniformgrid\"", "not supported yet",
          ERR_UNSUPPORTED },
        { W "MakeNamedMedium \"a\" \"string type\" \"rgbgrid\"", "not supported yet",
          ERR_UNSUPPORTED },
        { W "MakeNamedMedium \"a\" \"string type\" \"cloud\"", "not supported yet",
          ERR_UNSUPPORTED },
        { W HAZE "\"float g\" 1.5", "-1 to 1 is possible", ERR_SCENE },
        { W HAZE "\"rgb sigma_a\" [0 -1 0]", "a colour of -1", ERR_SCENE },
        { W HAZE "\"rgb sigma_s\" [1 1 1e30] \"float scale\" 1e30", "beyond float32", ERR_SCENE },
        { W HAZE "\"float scale\" -1", "below 0", ERR_SCENE },
        { W HAZE "\"string preset\" \"Skinn1\"", "the nearest is \"Skin1\"", ERR_SCENE },
        { W HAZE "\"spectrum sigma_a\" \"metal-Cu-eta\"", "no spectrum \"metal-Cu-eta\" here",
          ERR_SCENE },
        { W HAZE "\"float sigmas\" 1", "sigmas", ERR_SCENE },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        struct scene *scene = pbrt_read_text(rows[i].text, strlen(rows[i].text), "text", NULL, NULL,
                                             &err);
        if (scene != NULL || strstr(err.text, rows[i].says) == NULL || err.code != rows[i].code)
            fail_msg("\"%s\" gave \"%s\", not \"%s\"", rows[i].text, err.text, rows[i].says);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(coefficients_are_scaled_and_light_is_coloured),
        cmocka_unit_test(a_spectrum_may_exceed_one),
        cmocka_unit_test(without_numbers_it_is_milk_and_presets_have_their_own),
        cmocka_unit_test(both_sides_follow_the_graphics_state),
        cmocka_unit_test(the_camera_stands_in_what_was_outside),
        cmocka_unit_test(what_nothing_uses_calls_for_no_effect),
        cmocka_unit_test(shapes_in_objects_keep_their_media),
        cmocka_unit_test(what_is_wrong_is_said_at_its_place),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
