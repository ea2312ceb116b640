/* Goal: camera, film, sensor, filter, sampler, integrator and options of pbrt text are what pbrt
 * means by them, and what of them changes nothing here is said. */
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

#define TRI   "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
#define LIGHT "AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] "

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
    s = scene_of("PixelFilter \"sinc\" \"float yradius\" 2.5 WorldBegin");
    assert_int_equal(s->settings.filter.kind, FILTER_SINC);
    EXPECT_NEAR(s->settings.filter.radius[0], 4, 0);
    EXPECT_NEAR(s->settings.filter.radius[1], 2.5, 0);
    EXPECT_NEAR(s->settings.filter.tau, 3, 0);
    scene_free(s);
    s = scene_of("WorldBegin"); /* pbrt's defaults, but no depth limit */
    assert_int_equal(s->settings.filter.kind, FILTER_GAUSSIAN);
    EXPECT_NEAR(s->settings.filter.sigma, 0.5, 0);
    assert_int_equal(s->settings.max_depth, SCENE_NONE);
    assert_int_equal(s->settings.sampler, SAMPLER_SOBOL);
    assert_int_equal(s->settings.sampler_spp, 0);
    scene_free(s);
}

/* --- Sensor and options ------------------------------------------------------------------- */

/* The scene of a text of which `says` is said; NULL: whatever is said */
static struct scene *noted(const char *text, const char *says)
{
    struct scene_notes notes;
    struct scene *scene = reader_text_scene(text, NULL, &notes);
    if (says != NULL && notes_saying(&notes, says) == 0)
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_camera_looks_along_z_with_x_to_the_right),
        cmocka_unit_test(screens_follow_the_film_or_what_is_said),
        cmocka_unit_test(a_mirrored_camera_is_left_handed),
        cmocka_unit_test(crop_windows_round_up_and_follow_resolution),
        cmocka_unit_test(samplers_filters_and_integrators_are_read),
        cmocka_unit_test(the_sensor_makes_everything_brighter_or_darker),
        cmocka_unit_test(white_balance_turns_colours_as_pbrts_does),
        cmocka_unit_test(colours_of_other_spaces_become_srgb),
        cmocka_unit_test(integrators_of_the_same_light_are_read),
        cmocka_unit_test(options_that_change_the_picture_do),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
