/* Goal: nodes, meshes, lights and cameras of a glTF file are what glTF means by them. Materials,
 * and what can be wrong with files, have tests of their own. */
#include "tests/gltf_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* Where a vertex of the first mesh is in the world */
static void expect_vertex(const struct scene *scene, uint32_t vertex, double x, double y, double z)
{
    const double want[3] = { x, y, z };
    for (unsigned axis = 0; axis < 3; axis++)
        EXPECT_NEAR(scene->positions[3 * vertex + axis] + scene->settings.center[axis], want[axis],
                    1e-5);
}

/* --- Nodes -------------------------------------------------------------------------------- */

static void nodes_put_meshes_where_they_belong(void **state)
{
    (void)state;
    static const struct {
        const char *nodes;
        double p[3]; /* where (1, 0, 0) goes */
    } rows[] = {
        { "{\"mesh\":0}", { 1, 0, 0 } },
        { "{\"mesh\":0,\"translation\":[1,2,3]}", { 2, 2, 3 } },
        { "{\"mesh\":0,\"scale\":[2,3,4]}", { 2, 0, 0 } },
        { "{\"mesh\":0,\"rotation\":[0,0,0.70710678,0.70710678]}", { 0, 1, 0 } },
        { "{\"mesh\":0,\"rotation\":[0,0,3,3]}", { 0, 1, 0 } },
        { "{\"mesh\":0,\"translation\":[5,0,0],\"rotation\":[0,1,0,0],\"scale\":[2,2,2]}",
          { 3, 0, 0 } },
        { "{\"mesh\":0,\"matrix\":[0,1,0,0,-1,0,0,0,0,0,1,0,7,8,9,1]}", { 7, 9, 9 } },
        { "{\"translation\":[1,0,0],\"children\":[1]},{\"mesh\":0,\"scale\":[2,2,2]}",
          { 3, 0, 0 } },
        { "{\"mesh\":0,\"scale\":[2,2,2]},{\"translation\":[1,0,0],\"children\":[0]}",
          { 3, 0, 0 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[600];
        start_triangle();
        snprintf(rest, sizeof(rest), MESH ",\"nodes\":[%s]", rows[i].nodes);
        struct scene *scene = scene_of(rest);
        expect_vertex(scene, 1, rows[i].p[0], rows[i].p[1], rows[i].p[2]);
        scene_free(scene);
    }
}

static void only_the_chosen_scene_is_shown(void **state)
{
    (void)state;
    static const char rest[] = MESH
        ",\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[9,0,0]}],"
        "\"scenes\":[{\"nodes\":[0]},{\"nodes\":[1]}],\"scene\":1";
    start_triangle();
    struct scene *scene = scene_of(rest);
    expect_vertex(scene, 0, 9, 0, 0);
    assert_int_equal(scene->triangle_count, 1);
    scene_free(scene);
    expect_note(rest, "2 scenes; this is number 1");
}

static void mirrored_meshes_keep_their_outside(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(MESH ",\"nodes\":[{\"mesh\":0,\"scale\":[-1,1,1]}]");
    assert_int_equal(scene->meshes[0].flags, MESH_FLIP_NORMAL);
    scene_free(scene);
    expect_note(MESH ",\"nodes\":[{\"mesh\":0,\"scale\":[0,1,1]}]", "scaled to nothing");
}

static void shared_meshes_stand_in_all_their_places(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(MESH
                                   ",\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]},"
                                   "{\"mesh\":0,\"translation\":[0,0,20]}]");
    EXPECT_NEAR(scene->settings.bounds_max[2] + scene->settings.center[2], 20, 1e-5);
    EXPECT_NEAR(scene->settings.bounds_min[2] + scene->settings.center[2], 0, 1e-5);
    assert_int_equal(scene->triangle_count, 1);
    assert_int_equal(scene->instance_count, 3);
    scene_free(scene);

    /* What emits is copied, so that each light knows where it is */
    scene = scene_of("\"materials\":[{\"emissiveFactor\":[1,1,1]}],\"meshes\":[{\"primitives\":["
                     "{\"material\":0,\"attributes\":{\"POSITION\":0}}]}],\"nodes\":"
                     "[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]}]");
    assert_int_equal(scene->light_count, 2);
    scene_free(scene);

    /* The same by EXT_mesh_gpu_instancing */
    static const float moves[6] = { 0, 0, 3, 0, 0, 8 };
    unsigned list = add_floats(moves, 2, 3);
    char rest[400];
    snprintf(rest, sizeof(rest),
             MESH ",\"nodes\":[{\"mesh\":0,\"extensions\":{\"EXT_mesh_gpu_instancing\":"
                  "{\"attributes\":{\"TRANSLATION\":%u}}}}]",
             list);
    scene = scene_of(rest);
    EXPECT_NEAR(scene->settings.bounds_min[2] + scene->settings.center[2], 3, 1e-5);
    EXPECT_NEAR(scene->settings.bounds_max[2] + scene->settings.center[2], 8, 1e-5);
    scene_free(scene);
}

/* --- Meshes ------------------------------------------------------------------------------- */

static void strips_fans_and_lists_become_triangles(void **state)
{
    (void)state;
    static const float five[15] = { 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 2, 0 };
    static const uint8_t bytes[6] = { 2, 0, 1, 3, 2, 1 };
    static const struct {
        const char *more;
        uint32_t count, corners[9];
    } rows[] = {
        { ",\"mode\":5", 3, { 0, 1, 2, 1, 3, 2, 2, 3, 4 } },
        { ",\"mode\":6", 3, { 0, 1, 2, 0, 2, 3, 0, 3, 4 } },
        { "", 1, { 0, 1, 2 } },
        { ",\"indices\":1", 2, { 2, 0, 1, 3, 2, 1 } },
        { ",\"indices\":1,\"mode\":4", 2, { 2, 0, 1, 3, 2, 1 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[400];
        start_empty();
        add_floats(five, 5, 3);
        add_accessor(bytes, 6, 5121, 6, "SCALAR", "");
        snprintf(rest, sizeof(rest),
                 SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}%s}]}]",
                 rows[i].more);
        struct scene *scene = scene_of(rest);
        assert_int_equal(scene->triangle_count, rows[i].count);
        assert_memory_equal(scene->triangles, rows[i].corners, 12 * rows[i].count);
        scene_free(scene);
    }
}

static void points_and_lines_are_left_out_and_said(void **state)
{
    (void)state;
    start_triangle();
    expect_note(SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":1},"
                     "{\"attributes\":{\"POSITION\":0},\"mode\":0}]}]",
                "points and lines are left out (2 times)");
}

static void accessors_may_be_interleaved_normalised_and_sparse(void **state)
{
    (void)state;
    /* Interleaved: position, then four bytes of something else */
    static const float with_gaps[12] = { 0, 0, 0, -1, 1, 0, 0, -1, 0, 1, 0, -1 };
    start_empty();
    add_accessor(with_gaps, sizeof(with_gaps), 5126, 3, "VEC3", "");
    char *stride = strstr(made.views, "}");
    snprintf(stride, 40, ",\"byteStride\":16}");
    struct scene *scene = scene_of(MESH "," SHOW);
    expect_vertex(scene, 2, 0, 1, 0);
    scene_free(scene);

    /* 16-bit positions that stand for fractions, as KHR_mesh_quantization has them */
    static const int16_t fractions[12] = { 0, 0, 0, 0, 32767, 0, 0, 0, 0, -32768, 0, 0 };
    start_empty();
    add_accessor(fractions, sizeof(fractions), 5122, 3, "VEC3", ",\"normalized\":true");
    stride = strstr(made.views, "}");
    snprintf(stride, 40, ",\"byteStride\":8}");
    scene = scene_of("\"extensionsRequired\":[\"KHR_mesh_quantization\"]," MESH "," SHOW);
    expect_vertex(scene, 1, 1, 0, 0);
    expect_vertex(scene, 2, 0, -1, 0);
    scene_free(scene);

    /* Zeros, with the second and third element replaced */
    static const uint16_t which[2] = { 1, 2 };
    static const float what[6] = { 4, 0, 0, 0, 5, 0 };
    start_empty();
    add_accessor(which, sizeof(which), 5123, 2, "SCALAR", "");
    add_accessor(what, sizeof(what), 5126, 2, "VEC3", "");
    size_t length = strlen(made.accessors);
    snprintf(made.accessors + length, sizeof(made.accessors) - length,
             ",{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"sparse\":{\"count\":2,"
             "\"indices\":{\"bufferView\":0,\"componentType\":5123},"
             "\"values\":{\"bufferView\":1}}}");
    scene = scene_of(SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":2}}]}]");
    expect_vertex(scene, 0, 0, 0, 0);
    expect_vertex(scene, 1, 4, 0, 0);
    expect_vertex(scene, 2, 0, 5, 0);
    scene_free(scene);
}

static void vertex_colours_tint_the_base_colour(void **state)
{
    (void)state;
    static const uint8_t rgb[12] = { 255, 0, 0, 0, 0, 255, 0, 0, 51, 0, 255, 0 };
    start_triangle();
    add_accessor(rgb, sizeof(rgb), 5121, 3, "VEC3", ",\"normalized\":true");
    char *stride = strstr(strstr(made.views, "},") + 2, "}");
    snprintf(stride, 40, ",\"byteStride\":4}");
    static const char rest[] = SHOW
        ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,0.5,1,1],"
        "\"metallicFactor\":0}}],\"meshes\":[{\"primitives\":[{\"material\":0,"
        "\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}}]}]";
    struct scene *scene = scene_of(rest);
    assert_true(scene->meshes[0].flags & MESH_COLORS);
    const float want[12] = { 1, 0, 0, 1, 0, 1, 0, 1, 0.2f, 0, 1, 1 };
    assert_memory_equal(scene->colors, want, sizeof(want));
    uint32_t top = scene->materials[0].texture[SLOT_REFLECTANCE];
    assert_int_not_equal(top, 0);
    assert_int_equal(scene->textures[top - 1].kind, TEXTURE_SCALE);
    EXPECT_NEAR(scene->textures[top - 1].value[1][1], 0.5, 0);
    uint32_t child = scene->textures[top - 1].child[0];
    assert_int_equal(scene->textures[child - 1].kind, TEXTURE_VERTEX_COLOR);
    scene_free(scene);

    /* Copies of what emits, one for each place, have them too */
    static const char twice[] =
        "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]}],"
        "\"materials\":[{\"emissiveFactor\":[1,1,1]}],\"meshes\":[{\"primitives\":[{\"material\":0,"
        "\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}}]}]";
    scene = scene_of(twice);
    assert_int_equal(scene->mesh_count, 2);
    for (uint32_t i = 0; i < 2; i++) {
        const struct mesh *mesh = &scene->meshes[i];
        assert_true(mesh->flags & MESH_COLORS);
        uint32_t first = mesh->first_vertex + mesh->color_shift;
        assert_memory_equal(scene->colors + 4 * (size_t)first, want, sizeof(want));
    }
    scene_free(scene);
}

/* --- Lights and cameras ------------------------------------------------------------------- */

static void lights_are_where_and_as_bright_as_they_say(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(
        WITH_LIGHT("{\"type\":\"spot\",\"color\":[1,0.5,0],\"intensity\":40,"
                   "\"spot\":{\"innerConeAngle\":0.5,\"outerConeAngle\":0.7}}"));
    assert_int_equal(scene->light_count, 1);
    const struct light *light = &scene->lights[0];
    assert_int_equal(light->kind, LIGHT_SPOT);
    EXPECT_NEAR(light->radiance[0], 40, 0);
    EXPECT_NEAR(light->radiance[1], 20, 0);
    EXPECT_NEAR(light->position[2] + scene->settings.center[2], 3, 1e-6);
    EXPECT_NEAR(light->direction[0], -1, 1e-6); /* -z, turned by 90 degrees about y */
    EXPECT_NEAR(light->cos_falloff_start, cos(0.5), 1e-6);
    EXPECT_NEAR(light->cos_falloff_end, cos(0.7), 1e-6);
    EXPECT_NEAR(scene->settings.sky[0], 0, 0);
    scene_free(scene);

    scene = scene_of(WITH_LIGHT("{\"type\":\"point\"}"));
    assert_int_equal(scene->lights[0].kind, LIGHT_POINT);
    EXPECT_NEAR(scene->lights[0].radiance[0], 1, 0);
    scene_free(scene);

    /* Blender wrote 683 lm for its W */
    const char *text = document_of(WITH_LIGHT("{\"type\":\"directional\",\"intensity\":1366}"),
                                   ",\"generator\":\"Khronos glTF Blender I/O v4.3.32\"");
    scene = gltf_read_bytes(text, strlen(text), NULL, NULL, NULL, NULL);
    assert_non_null(scene);
    assert_int_equal(scene->lights[0].kind, LIGHT_DISTANT);
    EXPECT_NEAR(scene->lights[0].radiance[0], 2, 1e-6);
    scene_free(scene);
}

static void cameras_are_chosen_by_name(void **state)
{
    (void)state;
    static const char rest[] = MESH
        ",\"nodes\":[{\"mesh\":0},{\"name\":\"Front\",\"camera\":0,\"translation\":[0,0,9],"
        "\"scale\":[2,3,4]},{\"name\":\"Top\",\"camera\":1,\"rotation\":"
        "[-0.70710678,0,0,0.70710678]}],\"cameras\":[{\"type\":\"perspective\","
        "\"perspective\":{\"yfov\":1,\"aspectRatio\":1.5,\"znear\":0.1}},{\"name\":\"Flat\","
        "\"type\":\"orthographic\",\"orthographic\":{\"xmag\":2,\"ymag\":4,\"zfar\":9,"
        "\"znear\":0}}]";
    start_triangle();
    struct scene *scene = scene_of(rest);
    const struct scene_settings *s = &scene->settings;
    assert_int_equal(s->width, 1080);
    assert_int_equal(s->height, 720);
    assert_int_equal(s->camera.kind, CAMERA_PERSPECTIVE);
    EXPECT_NEAR(s->camera.screen[3], tan(0.5), 1e-6);
    EXPECT_NEAR(s->camera.screen[0], -1.5 * tan(0.5), 1e-6);
    EXPECT_NEAR(s->camera.position[2] + s->center[2], 9, 1e-6);
    EXPECT_NEAR(s->camera.forward[2], -1, 1e-6);
    EXPECT_NEAR(s->camera.right[0], 1, 1e-6);
    scene_free(scene);
    expect_note(rest, "camera \"Front\" of \"Front\", \"Top\"");

    static const char *const names[] = { "Top", "Flat", "1" };
    for (int i = 0; i < 3; i++) {
        const struct gltf_options options = { .camera = names[i] };
        scene = read_document(rest, &options, NULL, NULL);
        assert_non_null(scene);
        s = &scene->settings;
        assert_int_equal(s->camera.kind, CAMERA_ORTHOGRAPHIC);
        assert_int_equal(s->width, 360);
        EXPECT_NEAR(s->camera.screen[1], 2, 1e-6);
        EXPECT_NEAR(s->camera.screen[3], 4, 1e-6);
        EXPECT_NEAR(s->camera.forward[1], -1, 1e-6);
        EXPECT_NEAR(s->camera.up[2], -1, 1e-6);
        scene_free(scene);
    }
    const struct gltf_options wrong = { .camera = "Back" };
    struct err err;
    assert_null(read_document(rest, &wrong, NULL, &err));
    assert_non_null(strstr(err.text, "no camera \"Back\"; there are \"Front\", \"Top\""));
}

static void without_a_camera_everything_is_in_the_picture(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(
        MESH ",\"nodes\":[{\"mesh\":0,\"translation\":[1e4,0,0],\"scale\":[3,100,1]}]");
    const struct camera *camera = &scene->settings.camera;
    for (uint32_t i = 0; i < 3; i++) {
        double x = 0, y = 0, z = 0;
        for (unsigned axis = 0; axis < 3; axis++) {
            double way = (double)scene->positions[3 * i + axis] - camera->position[axis];
            x += way * camera->right[axis];
            y += way * camera->up[axis];
            z += way * camera->forward[axis];
        }
        assert_true(z > 0);
        assert_true(fabs(x / z) < camera->screen[1] && fabs(y / z) < camera->screen[3]);
    }
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nodes_put_meshes_where_they_belong),
        cmocka_unit_test(only_the_chosen_scene_is_shown),
        cmocka_unit_test(mirrored_meshes_keep_their_outside),
        cmocka_unit_test(shared_meshes_stand_in_all_their_places),
        cmocka_unit_test(strips_fans_and_lists_become_triangles),
        cmocka_unit_test(points_and_lines_are_left_out_and_said),
        cmocka_unit_test(accessors_may_be_interleaved_normalised_and_sparse),
        cmocka_unit_test(vertex_colours_tint_the_base_colour),
        cmocka_unit_test(lights_are_where_and_as_bright_as_they_say),
        cmocka_unit_test(cameras_are_chosen_by_name),
        cmocka_unit_test(without_a_camera_everything_is_in_the_picture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
