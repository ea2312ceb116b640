/* Goal: objects and motion of pbrt text become groups, instances and motions where pbrt would put
 * them; what one place or a light makes needless is not one; and what is wrong is said. */
#include "common/effects.h"
#include "tests/reader_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#define W "WorldBegin\n"
#define TRI                                                       \
    "Shape \"trianglemesh\" \"point3 P\" [1 0 0  2 0 0  1 1 0 ] " \
    "\"integer indices\" [0 1 2] "
#define BALL   "Shape \"sphere\" \"float radius\" .5 "
#define OBJECT "ObjectBegin \"o\" " TRI BALL "ObjectEnd "
#define HERE   "ObjectInstance \"o\" "

static struct scene *scene_of(const char *text)
{
    return reader_text_scene(text, NULL, NULL);
}

/* Corner `i` of the only triangle of a mesh, in the file's world, through an instance or not */
static void corner(const struct scene *scene, uint32_t mesh, unsigned i,
                   const struct instance *instance, double world[3])
{
    const uint32_t *t = scene->triangles + 3 * (size_t)scene->meshes[mesh].first_triangle;
    const float *p = scene->positions + 3 * (size_t)t[i];
    for (int axis = 0; axis < 3; axis++) {
        world[axis] = (double)p[axis];
        if (instance != NULL) {
            const float *m = instance->to_world + 4 * axis;
            world[axis] = (double)m[0] * (double)p[0] + (double)m[1] * (double)p[1] +
                          (double)m[2] * (double)p[2] + (double)m[3];
        }
        world[axis] += scene->settings.center[axis];
    }
}

static void expect_corner(const struct scene *scene, uint32_t mesh, unsigned i,
                          const struct instance *instance, double x, double y, double z)
{
    double world[3];
    corner(scene, mesh, i, instance, world);
    EXPECT_NEAR(world[0], x, 1e-5);
    EXPECT_NEAR(world[1], y, 1e-5);
    EXPECT_NEAR(world[2], z, 1e-5);
}

/* The definition's transform comes first, then the instance's (as in pbrt-v4) */
static void an_instance_moves_the_object_as_a_whole(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        W TRI "Translate 0 0 7 " OBJECT "AttributeBegin Identity Scale 2 1 1 " HERE
              "AttributeEnd AttributeBegin Identity Translate 10 0 0 Scale -1 1 1 " HERE
              "AttributeEnd");
    assert_int_equal(scene->mesh_count, 2);
    assert_int_equal(scene->quadric_count, 1);
    assert_int_equal(scene->group_count, 1);
    assert_int_equal(scene->groups[0].first_mesh, 1);
    assert_int_equal(scene->instance_count, 2);
    assert_true((scene->settings.effects & FX_INSTANCE) != 0);
    assert_true((scene->settings.effects & FX_MOTION) == 0);
    expect_corner(scene, 0, 1, NULL, 2, 0, 0);
    expect_corner(scene, 1, 1, &scene->instances[0], 4, 0, 7);
    expect_corner(scene, 1, 2, &scene->instances[0], 2, 1, 7);
    expect_corner(scene, 1, 1, &scene->instances[1], 8, 0, 7);
    assert_int_equal(scene->meshes[1].flags & MESH_FLIP_NORMAL, 0);
    EXPECT_NEAR((double)scene->settings.bounds_max[0] + scene->settings.center[0], 10.5, 1e-5);
    scene_free(scene);
}

static void groups_have_the_names_of_their_objects(void **state)
{
    (void)state;
    struct scene *scene = scene_of(W "ActiveTransform EndTime Translate 1 0 0 " BALL
                                     "Identity ActiveTransform All " OBJECT HERE HERE
                                     "ObjectBegin \"tree\" " TRI
                                     "ObjectEnd ObjectInstance \"tree\"");
    assert_int_equal(scene->instance_count, 3);
    assert_int_equal(scene->group_name_count, 2);
    assert_int_equal(scene->group_names[0].index, scene->instances[1].group);
    assert_string_equal(scene->group_names[0].text, "o");
    assert_true(scene->group_names[1].index > scene->group_names[0].index);
    assert_string_equal(scene->group_names[1].text, "tree");
    scene_free(scene);
}

/* Where the world is far away, neither the group nor its instances lose digits */
static void far_objects_are_recentred_like_the_world(void **state)
{
    (void)state;
    struct scene *scene = scene_of(W "Translate 1e7 0 .125 " OBJECT
                                     "Identity Translate 0 1e7 0 " HERE "Translate 3 0 0 " HERE);
    expect_corner(scene, 0, 1, &scene->instances[0], 1e7 + 2, 1e7, .125);
    expect_corner(scene, 0, 1, &scene->instances[1], 1e7 + 5, 1e7, .125);
    assert_true(fabsf(scene->positions[0]) < 100);
    assert_true(fabsf(scene->instances[1].to_world[3]) < 100);
    scene_free(scene);
}

static void an_object_in_one_place_is_part_of_the_world(void **state)
{
    (void)state;
    struct scene *scene = scene_of(W OBJECT "ObjectBegin \"unused\" " BALL "ObjectEnd "
                                            "Translate 0 3 0 Scale -1 1 1 " HERE);
    assert_int_equal(scene->group_count, 0);
    assert_int_equal(scene->instance_count, 0);
    assert_int_equal(scene->mesh_count, 1);
    assert_int_equal(scene->quadric_count, 1);
    expect_corner(scene, 0, 1, NULL, -2, 3, 0);
    assert_int_equal(scene->meshes[0].flags & MESH_FLIP_NORMAL, MESH_FLIP_NORMAL);
    scene_free(scene);
}

static void what_emits_stands_in_the_world_once_per_instance(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        W "ObjectBegin \"o\" " TRI
          "AttributeBegin AreaLightSource \"diffuse\" Translate 0 0 1 " TRI BALL
          "AttributeEnd " BALL "ObjectEnd " HERE "Translate 5 0 0 Scale 2 2 2 " HERE
          "Translate 5 0 0 " HERE);
    assert_int_equal(scene->light_count, 6);
    assert_int_equal(scene->mesh_count, 4);
    assert_int_equal(scene->quadric_count, 4);
    assert_int_equal(scene->groups[0].first_mesh, 3);
    assert_int_equal(scene->groups[0].mesh_count, 1);
    assert_int_equal(scene->groups[0].first_quadric, 3);
    assert_int_equal(scene->groups[0].quadric_count, 1);
    expect_corner(scene, 1, 1, NULL, 9, 0, 2);
    for (uint32_t i = 0; i < 3; i++) {
        const struct light *light = &scene->lights[scene->quadrics[i].light];
        assert_int_equal(light->quadric, i);
        EXPECT_NEAR(scene->quadrics[i].world_radius, i == 0 ? 0.5 : 1, 1e-6);
    }
    scene_free(scene);

    /* Nothing but light: then there is nothing to share */
    scene = scene_of(W "AreaLightSource \"diffuse\" " OBJECT HERE "Translate 5 0 0 " HERE);
    assert_int_equal(scene->instance_count, 0);
    assert_int_equal(scene->light_count, 4);
    scene_free(scene);
}

static void motion_is_between_the_two_transforms(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "TransformTimes 1 3 Camera \"perspective\" \"float shutteropen\" 1.5 \"float "
        "shutterclose\" 2 " W "Translate 1 0 0 ActiveTransform EndTime Translate 0 4 0 Rotate 90 0 "
        "0 1 ActiveTransform All "
        "Scale 1 2 1 " BALL "ActiveTransform StartTime Identity ActiveTransform EndTime Identity "
        "ActiveTransform All " TRI);
    assert_int_equal(scene->motion_count, 1);
    assert_int_equal(scene->instance_count, 1);
    assert_int_equal(scene->mesh_count, 1);
    assert_int_equal(scene->instances[0].motion, 1);
    assert_true((scene->settings.effects & FX_MOTION) != 0);
    EXPECT_NEAR(scene->settings.shutter[0], 0.25, 1e-7);
    EXPECT_NEAR(scene->settings.shutter[1], 0.5, 1e-7);
    const struct motion *m = &scene->motions[0];
    EXPECT_NEAR((double)m->translation[0][0] + scene->settings.center[0], 1, 1e-6);
    EXPECT_NEAR((double)m->translation[1][1] + scene->settings.center[1], 4, 1e-6);
    EXPECT_NEAR(m->angle, 3.14159265358979 / 4, 1e-6);
    EXPECT_NEAR(m->rotation[0][3], 1, 1e-6);
    EXPECT_NEAR(fabsf(m->rotation[1][2]), sqrt(0.5), 1e-6);
    for (int end = 0; end < 2; end++)
        EXPECT_NEAR(m->stretch[end][4], 2, 1e-6);
    scene_free(scene);
}

static void cameras_and_objects_move_too(void **state)
{
    (void)state;
    struct scene *scene = scene_of("ActiveTransform EndTime Translate 0 0 -2 ActiveTransform All "
                                   "Camera \"perspective\" " W TRI OBJECT
                                   "ActiveTransform StartTime Scale -1 1 1 "
                                   "ActiveTransform EndTime Translate 0 1 0 Scale -1 1 1 " HERE);
    assert_int_equal(scene->motion_count, 2);
    assert_int_equal(scene->settings.camera_motion, 1);
    EXPECT_NEAR((double)scene->motions[0].translation[1][2] + scene->settings.center[2], 2, 1e-6);
    assert_int_equal(scene->instances[0].motion, 2);
    EXPECT_NEAR(scene->motions[1].angle, 0, 1e-6);
    scene_free(scene);
}

/* What stands still in a scene that moves is as if nothing did: H18 */
static void a_motion_between_equal_transforms_is_none(void **state)
{
    (void)state;
    static const char *const still[] = {
        "ActiveTransform EndTime ActiveTransform All ",
        "ActiveTransform EndTime Translate 0 0 0 ActiveTransform All ",
        "Translate 1 2 3 Rotate 30 1 2 3 ActiveTransform EndTime Scale 1 1 1 ActiveTransform All ",
        "ActiveTransform StartTime Scale 2 2 2 ActiveTransform EndTime Scale 2 2 2 ",
    };
    for (size_t i = 0; i < sizeof(still) / sizeof(still[0]); i++) {
        char text[1000];
        snprintf(text, sizeof(text), W "%s" BALL, still[i]);
        struct scene *scene = scene_of(text);
        assert_int_equal(scene->motion_count, 0);
        assert_int_equal(scene->instance_count, 0);
        assert_false(scene->settings.effects & FX_MOTION);
        scene_free(scene);
    }
}

static void bad_objects_and_motions_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
        enum err_code code;
    } rows[] = {
        { W "ObjectBegin \"a\" ObjectBegin \"b\"", "text:2:17: ObjectBegin inside", ERR_SCENE },
        { W "ObjectBegin \"a\" ObjectInstance \"a\"", "ObjectInstance inside", ERR_SCENE },
        { W "ObjectBegin \"a\" ObjectEnd ObjectBegin \"a\" ", "a second object \"a\"", ERR_SCENE },
        { W "ObjectBegin \"a\" AttributeBegin ObjectEnd", "is not closed", ERR_SCENE },
        { W "ObjectBegin \"a\" AttributeEnd", "ObjectEnd is wanted", ERR_SCENE },
        { W "ObjectBegin \"a\"", "not closed at the end", ERR_SCENE },
        { W "ObjectEnd", "without an ObjectBegin", ERR_SCENE },
        { W "ObjectInstance \"a\"", "there is none at all", ERR_SCENE },
        { W "ObjectBegin \"tree\" ObjectEnd ObjectBegin \"car\" ObjectEnd ObjectInstance \"thre\"",
          "no object \"thre\"; the nearest is \"tree\"", ERR_SCENE },
        { "TransformTimes 1 1", "a start before its end", ERR_SCENE },
        { "Camera \"perspective\" \"float shutteropen\" 2", "before it opens", ERR_SCENE },
        { W "ActiveTransform EndTime Scale -1 1 1 " BALL, "mirror image", ERR_SCENE },
        { W "AreaLightSource \"diffuse\" ActiveTransform EndTime Translate 1 0 0 " BALL,
          "light from what moves is not supported yet", ERR_UNSUPPORTED },
        { W "ActiveTransform EndTime Translate 1 0 0 LightSource \"point\"", "a light that moves",
          ERR_UNSUPPORTED },
        { W "AreaLightSource \"diffuse\" " OBJECT "ActiveTransform EndTime Translate 1 0 0 " HERE,
          "light from what moves", ERR_UNSUPPORTED },
        { W "ObjectBegin \"a\" ActiveTransform EndTime Translate 1 0 0 " BALL,
          "inside of an object", ERR_UNSUPPORTED },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        reader_text_refused(rows[i].text, NULL, rows[i].code, rows[i].says);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_instance_moves_the_object_as_a_whole),
        cmocka_unit_test(groups_have_the_names_of_their_objects),
        cmocka_unit_test(far_objects_are_recentred_like_the_world),
        cmocka_unit_test(an_object_in_one_place_is_part_of_the_world),
        cmocka_unit_test(what_emits_stands_in_the_world_once_per_instance),
        cmocka_unit_test(motion_is_between_the_two_transforms),
        cmocka_unit_test(cameras_and_objects_move_too),
        cmocka_unit_test(a_motion_between_equal_transforms_is_none),
        cmocka_unit_test(bad_objects_and_motions_are_refused_with_a_reason),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
