/* Goal: shapes that become triangles at load stand in the scene like any other: on their side, with
 * their light, holes, motion and instances; hair is few meshes; and odd ones are refused or told.
 */
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
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define W        "WorldBegin\n"
#define LIGHT    "AreaLightSource \"diffuse\" \"rgb L\" [3 3 3] "
#define CYLINDER "Shape \"cylinder\" \"float radius\" 2 \"float zmin\" 0 \"float zmax\" 3 "
#define HAIR(x)                                                                          \
    "Shape \"curve\" \"string type\" \"cylinder\" \"float width\" .01 \"point3 P\" [" #x \
    " 0 0 " #x " 1 0 " #x " 2 1 " #x " 3 2] "
#define PI 3.14159265358979323846

static struct scene *scene_of(const char *text)
{
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), NULL, NULL, NULL, &err);
    if (scene == NULL)
        fail_msg("%s\nin: %s", err.text, text);
    return scene;
}

/* Signed volume under a mesh's triangles as the kernel winds them: positive when they face
 * outwards */
static double volume_of(const struct scene *scene, const struct mesh *mesh)
{
    double sum = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        const uint32_t *t = scene->triangles + 3 * ((size_t)mesh->first_triangle + i);
        const float *a = scene->positions + 3 * (size_t)t[0];
        const float *b = scene->positions + 3 * (size_t)t[1];
        const float *c = scene->positions + 3 * (size_t)t[2];
        for (int k = 0; k < 3; k++) {
            int l = (k + 1) % 3, m = (k + 2) % 3;
            sum += (double)a[k] * ((double)b[l] * (double)c[m] - (double)b[m] * (double)c[l]) / 6;
        }
    }
    return mesh->flags & MESH_FLIP_NORMAL ? -sum : sum;
}

/* The volume between a cylinder's side and the origin: 2/3 of the whole */
static void cylinders_face_outwards_unless_reversed(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        double volume;
    } rows[] = {
        { W CYLINDER, 8 * PI },
        { W "ReverseOrientation " CYLINDER, -8 * PI },
        { W "Scale -1 1 1 " CYLINDER, 8 * PI },
        { W "Scale 1 2 1 Scale -1 1 1 ReverseOrientation " CYLINDER, -16 * PI },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scene_of(rows[i].text);
        assert_int_equal(scene->mesh_count, 1);
        assert_int_equal(scene->meshes[0].flags, MESH_NORMALS | MESH_UVS);
        EXPECT_NEAR(volume_of(scene, &scene->meshes[0]) / rows[i].volume, 1, 1e-3);
        const float *n = scene->normals, *p = scene->positions;
        double along = (double)(n[0] * p[0] + n[1] * p[1]);
        assert_true(along * rows[i].volume > 0);
        scene_free(scene);
    }
}

static double power_of(const struct scene *scene)
{
    double sum = 0;
    for (uint32_t i = 0; i < scene->light_count; i++)
        sum += PI * (double)scene->lights[i].radiance[0] * (double)scene->lights[i].area;
    return sum;
}

static void they_emit_what_they_should(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        double power;
    } rows[] = {
        { W LIGHT CYLINDER, PI * 3 * 2 * PI * 2 * 3 },
        { W LIGHT "\"float power\" 100 " CYLINDER, 300 },
        { W LIGHT "\"float power\" 100 Scale 3 3 3 " CYLINDER, 300 },
        { W LIGHT "Shape \"sphere\" \"float radius\" 2 \"float zmin\" 0", PI * 3 * 2 * PI * 4 },
        { W LIGHT "Scale 1 1 2 Shape \"disk\" \"float radius\" 2 \"float innerradius\" 1",
          PI * 3 * PI * 3 },
        { W LIGHT "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 2 0 0 0 2 0 2 2 0]", PI * 3 * 4 },
        { W LIGHT "\"float power\" 7 Shape \"bilinearmesh\" \"integer indices\" [0 1 2 3 2 3 4 5] "
                  "\"point3 P\" [0 0 0 2 0 0 0 2 0 2 2 0 0 9 0 2 9 0]",
          42 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scene_of(rows[i].text);
        assert_int_equal(scene->quadric_count, 0);
        if (!(fabs(power_of(scene) / rows[i].power - 1) < 2.5e-3))
            fail_msg("%s\ngives %g W, not %g", rows[i].text, power_of(scene), rows[i].power);
        scene_free(scene);
    }
    /* A flat patch is one light: its two triangles are one polygon, on the side of du x dv */
    struct scene *scene = scene_of(W LIGHT
                                   "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 2 0 0 0 2 0 2 2 0]");
    assert_int_equal(scene->light_count, 1);
    assert_int_equal(scene->meshes[0].flags, MESH_UVS);
    EXPECT_NEAR(scene->lights[0].normal[2], 1, 1e-6);
    scene_free(scene);
}

static void holes_motion_and_instances_are_a_meshs(void **state)
{
    (void)state;
    struct scene *scene = scene_of(W "Shape \"sphere\" \"float alpha\" .5 Shape \"cylinder\" "
                                     "\"float alpha\" .5");
    assert_int_equal(scene->quadric_count, 1);
    assert_int_equal(scene->mesh_count, 1);
    assert_true(scene->quadrics[0].alpha != 0 && scene->meshes[0].alpha != 0);
    scene_free(scene);

    scene = scene_of(W "ActiveTransform EndTime Translate 1 0 0 ActiveTransform All " CYLINDER);
    assert_int_equal(scene->motion_count, 1);
    assert_int_equal(scene->group_count, 1);
    assert_int_equal(scene->groups[0].mesh_count, 1);
    scene_free(scene);

    scene = scene_of(W "ObjectBegin \"o\" " CYLINDER HAIR(0)
                         HAIR(1) "ObjectEnd ObjectInstance "
                                 "\"o\" Translate 9 0 0 ObjectInstance \"o\" " HAIR(2));
    assert_int_equal(scene->instance_count, 2);
    assert_int_equal(scene->groups[0].mesh_count, 2);
    assert_int_equal(scene->mesh_count, 3); /* the last hair is not of the object */
    scene_free(scene);
}

static void hair_that_stands_alike_is_one_mesh(void **state)
{
    (void)state;
    struct scene *alone = scene_of(W HAIR(0));
    struct scene *scene = scene_of(W HAIR(0) HAIR(1) HAIR(2) "Translate 0 1 0 " HAIR(3)
                                       CYLINDER HAIR(4) HAIR(5) "Material \"diffuse\" " HAIR(6));
    assert_int_equal(scene->mesh_count, 5);
    static const uint32_t hairs[] = { 3, 1, 0, 2, 1 };
    for (uint32_t i = 0; i < 5; i++)
        if (hairs[i] > 0)
            assert_int_equal(scene->meshes[i].triangle_count,
                             hairs[i] * alone->meshes[0].triangle_count);
    /* Each keeps its own vertices, normals and (u, v) */
    uint32_t count = alone->meshes[0].vertex_count;
    const struct mesh *mesh = &scene->meshes[0];
    for (uint32_t v = 0; v < count; v++) {
        const float *n = scene->normals +
                         3 * (size_t)(mesh->first_vertex + 2 * count + v + mesh->normal_shift);
        for (int axis = 0; axis < 3; axis++)
            EXPECT_NEAR(n[axis], (double)alone->normals[3 * (size_t)v + (size_t)axis], 1e-6);
    }
    scene_free(alone);
    scene_free(scene);
}

static void subdivision_is_on_pbrts_side(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        W "Shape \"loopsubdiv\" \"integer levels\" 3 \"point3 P\" [1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 "
          "0 0 -1] \"integer indices\" [0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5]");
    assert_int_equal(scene->triangle_count, 512);
    assert_int_equal(scene->vertex_count, 258);
    assert_true(volume_of(scene, &scene->meshes[0]) < -.3);
    scene_free(scene);
}

/* A far-away hair is not rounded before it is moved next to the origin */
static void curves_far_away_keep_their_shape(void **state)
{
    (void)state;
    struct scene *near = scene_of(W HAIR(0)), *far = scene_of(W HAIR(1e7));
    for (uint32_t i = 0; i < 3 * near->vertex_count; i++)
        EXPECT_NEAR((double)far->positions[i] + (i % 3 == 0 ? far->settings.center[0] - 1e7 : 0) +
                        (i % 3 ? far->settings.center[i % 3] : 0),
                    (double)near->positions[i] + near->settings.center[i % 3], 1e-6);
    scene_free(near);
    scene_free(far);
}

static void what_is_wrong_is_said(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
    } rows[] = {
        { W "Shape \"cylinder\" \"float radius\" -1", "a radius of -1" },
        { W "Shape \"cylinder\" \"float raduis\" 1", "the nearest is \"radius\"" },
        { W LIGHT "Shape \"cylinder\" \"float phimax\" 0", "this light has no area" },
        { W "Shape \"bilinearmesh\"", "wants \"point3 P\"" },
        { W "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 1 1]", "wants \"integer indices\"" },
        { W "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 1 1] \"integer indices\" [0 1 0 2]",
          "index 2 (number 3) is out of range: there are 2 vertices" },
        { W "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 1 1] \"integer indices\" [0 1 0]",
          "3 indices are not a multiple of four" },
        { W "Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 1] \"normal N\" [0 0 1]",
          "\"N\" has 1 entries for 4 vertices" },
        { W "Shape \"loopsubdiv\" \"point3 P\" [0 0 0]", "wants \"point3 P\" and \"integer" },
        { W "Shape \"loopsubdiv\" \"integer nlevels\" 2 \"point3 P\" [0 0 0] \"integer indices\" "
            "[0 0 0]",
          "in pbrt-v4 it is \"levels\"" },
        { W "Shape \"loopsubdiv\" \"point3 P\" [0 0 0] \"integer indices\" [0 0 0]",
          "text:2:7: triangle 0 has vertex 0 twice" },
        { W "Shape \"loopsubdiv\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
            "\"integer levels\" 11",
          "takes 4194304 triangles: 26" },
        { W "Shape \"loopsubdiv\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2] "
            "\"string scheme\" \"catmark\"",
          "unknown subdivision scheme \"catmark\"" },
        { W "Shape \"curve\"", "wants \"point3 P\"" },
        { W "Shape \"curve\" \"point3 P\" [0 0 0]", "1 points: a Bezier curve" },
        { W "Shape \"curve\" \"integer degree\" 5 \"point3 P\" [0 0 0]", "degree 5" },
        { W "Shape \"curve\" \"string type\" \"round\" \"point3 P\" [0 0 0]",
          "unknown type of curve \"round\"" },
        { W "Shape \"curve\" \"string basis\" \"hermite\" \"point3 P\" [0 0 0]",
          "unknown basis of a curve" },
        { W "Shape \"curve\" \"float width\" -1 \"point3 P\" [0 0 0]", "a curve's width of -1" },
        { W "Shape \"curve\" \"point3 P\" [0 0 0 1e300 0 0 0 1 0 1e300 1 0]", "beyond float32" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        struct scene *scene = pbrt_read_text(rows[i].text, strlen(rows[i].text), NULL, NULL, NULL,
                                             &err);
        if (scene != NULL || strstr(err.text, rows[i].says) == NULL || err.code != ERR_SCENE ||
            strncmp(err.text, "text:2:", 7) != 0)
            fail_msg("%s\ngave %s \"%s\"\nnot \"%s\"", rows[i].text, err_name(err.code), err.text,
                     rows[i].says);
    }
}

static void what_is_left_out_or_made_otherwise_is_noted(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
    } rows[] = {
        { W "Shape \"cylinder\" \"float zmin\" 1", "a shape without area was left out" },
        { W "Shape \"cylinder\" \"float radius\" 0", "a shape without area was left out" },
        { W "Shape \"curve\" \"float width\" 0 \"point3 P\" [0 0 0 1 0 0 2 0 0 3 0 0]",
          "a shape without area was left out" },
        { W "Shape \"curve\" \"point3 P\" [0 0 0 1 0 0 2 0 0 3 0 0]", "is a tube of its width" },
        { W LIGHT "Shape \"disk\" \"float phimax\" 90", "a disk that emits and is cut" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene_notes notes;
        struct scene *scene = pbrt_read_text(rows[i].text, strlen(rows[i].text), NULL, NULL, &notes,
                                             NULL);
        assert_non_null(scene);
        bool said = false;
        for (size_t n = 0; n < notes.count; n++)
            said = said || strstr(notes.lines[n], rows[i].says) != NULL;
        if (!said)
            fail_msg("%s\ndoes not say \"%s\"", rows[i].text, rows[i].says);
        scene_notes_free(&notes);
        scene_free(scene);
    }
}

/* 2^18 triangles are free, and 16 more for each byte */
static void small_files_cannot_ask_for_all_memory(void **state)
{
    (void)state;
    static const char one[] = "Shape\"loopsubdiv\"\"integer levels\"[8]\"integer indices\"[0 1 2]"
                              "\"point3 P\"[0 0 0 1 0 0 0 1 0]\n";
    char *text = malloc(sizeof(W) + 10 * sizeof(one));
    assert_non_null(text);
    strcpy(text, W);
    for (int i = 0; i < 5; i++) {
        struct err err = { .text = "" };
        strcat(text, one);
        struct scene *scene = pbrt_read_text(text, strlen(text), NULL, NULL, NULL, &err);
        assert_int_equal(scene != NULL, i < 4);
        if (scene == NULL)
            assert_non_null(strstr(err.text, "text:6:6: the shape takes 65536 triangles: "));
        scene_free(scene);
    }
    free(text);
}

/* Every instance has lights of its own: 42 times 4096 triangles that count twice are too many */
static void instances_of_lights_are_counted(void **state)
{
    (void)state;
    static const char object[] = W "ObjectBegin \"o\" " LIGHT
                                   "Shape \"sphere\" \"float zmin\" -.99 ObjectEnd\n";
    static const char here[] = "ObjectInstance \"o\" Translate 3 0 0\n";
    for (int count = 2; count <= 42; count += 40) {
        char text[sizeof(object) + 42 * sizeof(here)];
        struct err err = { .text = "" };
        strcpy(text, object);
        for (int i = 0; i < count; i++)
            strcat(text, here);
        struct scene *scene = pbrt_read_text(text, strlen(text), NULL, NULL, NULL, &err);
        assert_int_equal(scene != NULL, count == 2);
        if (scene == NULL)
            assert_non_null(strstr(err.text, "the lights of this object take 3"));
        scene_free(scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cylinders_face_outwards_unless_reversed),
        cmocka_unit_test(they_emit_what_they_should),
        cmocka_unit_test(holes_motion_and_instances_are_a_meshs),
        cmocka_unit_test(hair_that_stands_alike_is_one_mesh),
        cmocka_unit_test(subdivision_is_on_pbrts_side),
        cmocka_unit_test(curves_far_away_keep_their_shape),
        cmocka_unit_test(what_is_wrong_is_said),
        cmocka_unit_test(what_is_left_out_or_made_otherwise_is_noted),
        cmocka_unit_test(small_files_cannot_ask_for_all_memory),
        cmocka_unit_test(instances_of_lights_are_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
