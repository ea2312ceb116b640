/* Goal: whatever is wrong with pbrt text is said with its position; what leniency replaces is
 * counted, and what pbrt-v3 left behind is named. */
#include "tests/reader_text.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define TRI   "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
#define LIGHT "AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] "
#define W     "WorldBegin\n"

static const struct {
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
    { "PixelFilter \"sinc\" \"float tau\" .5", "a tau of 0.5 is outside 1 to 1000", ERR_SCENE },
    { "PixelFilter \"sinc\" \"float xradius\" 17", "17 pixels is outside .001 to 16", ERR_SCENE },
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(everything_wrong_is_said_with_its_position),
        cmocka_unit_test(leniency_replaces_and_counts),
        cmocka_unit_test(substitutions_are_noted),
        cmocka_unit_test(what_converters_leave_behind_is_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
