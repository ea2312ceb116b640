/* Goal: pbrt text becomes the scene that pbrt means by it, and real files are read without
 * leniency. Settings, lights, and what can be wrong have tests of their own. */
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

#define TRI   "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
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

/* --- Attributes --------------------------------------------------------------------------- */

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
        cmocka_unit_test(attribute_sets_defaults_in_its_block),
        cmocka_unit_test(attributes_hold_material_light_and_orientation),
        cmocka_unit_test(materials_have_pbrts_defaults),
        cmocka_unit_test(equal_coats_share_a_table),
        cmocka_unit_test(only_materials_in_use_join_the_scene),
        cmocka_unit_test(imports_leave_the_state_as_it_was),
        cmocka_unit_test(includes_are_relative_and_errors_name_the_inner_file),
        cmocka_unit_test(real_scenes_are_read_strictly),
        cmocka_unit_test(the_comparison_scenes_are_read_strictly),
        cmocka_unit_test(our_own_scenes_are_read_strictly),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
