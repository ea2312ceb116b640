/* Goal: arenas keep what they promise, and a scene from outside is checked before anyone trusts
 * it: every index, every number, the effect mask. */
#include "common/arena.h"
#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* --- Arena -------------------------------------------------------------------------------- */

static void arena_memory_is_zeroed_aligned_and_padded(void **state)
{
    (void)state;
    struct arena *arena = arena_new();
    static const size_t sizes[] = { 0, 1, 63, 64, 65, 5000, 16384, 70000, 1000000 };
    for (size_t k = 0; k < sizeof(sizes) / sizeof(sizes[0]); k++) {
        size_t size = sizes[k];
        unsigned char *memory = arena_alloc(arena, size, 1);
        assert_non_null(memory);
        assert_int_equal((uintptr_t)memory % 64, 0);
        for (size_t i = 0; i < size + 16; i++)
            assert_int_equal(memory[i], 0);
        memset(memory, 0xff, size);
    }
    assert_null(arena_alloc(arena, SIZE_MAX / 2, 3));
    assert_string_equal(arena_text(arena, "text and more", 4), "text");
    arena_free(arena);
    arena_free(NULL);
}

static int released;

static void release(void *memory)
{
    released++;
    free(memory);
}

static void adopted_memory_is_released_once(void **state)
{
    (void)state;
    struct arena *arena = arena_new();
    released = 0;
    assert_true(arena_adopt(arena, malloc(8), release));
    assert_true(arena_adopt(arena, malloc(8), release));
    arena_reset(arena);
    assert_int_equal(released, 2);
    assert_true(arena_adopt(arena, malloc(8), release));
    assert_non_null(arena_alloc(arena, 1 << 20, 1));
    arena_free(arena);
    assert_int_equal(released, 3);
}

static void a_reset_arena_gives_zeroed_memory_again(void **state)
{
    (void)state;
    struct arena *arena = arena_new();
    memset(arena_alloc(arena, 1000, 1), 0xff, 1000);
    arena_reset(arena);
    const unsigned char *memory = arena_alloc(arena, 1000, 1);
    for (int i = 0; i < 1000; i++)
        assert_int_equal(memory[i], 0);
    arena_free(arena);
}

/* --- Scene -------------------------------------------------------------------------------- */

/* A triangle that emits, an emitting sphere, a coat, a mix, a medium and the sky: one of everything
 */
static struct scene *one_of_everything(void)
{
    struct scene *s = scene_new();
    struct arena *arena = s->arena;
    s->vertex_count = s->normal_count = s->uv_count = 3;
    s->positions = arena_alloc(arena, 3, 3 * sizeof(float));
    s->normals = arena_alloc(arena, 3, 3 * sizeof(float));
    s->uvs = arena_alloc(arena, 3, 2 * sizeof(float));
    s->positions[3] = s->positions[7] = 1;
    for (int i = 0; i < 3; i++)
        s->normals[3 * i + 2] = 1;
    s->triangle_count = s->mesh_count = 1;
    s->triangles = arena_alloc(arena, 1, 3 * sizeof(uint32_t));
    s->triangles[1] = 1;
    s->triangles[2] = 2;
    s->meshes = arena_alloc(arena, 1, sizeof(struct mesh));
    s->meshes[0] = (struct mesh){ .triangle_count = 1,
                                  .vertex_count = 3,
                                  .flags = MESH_NORMALS | MESH_UVS };
    s->settings.has_normals = 1;
    s->quadric_count = 1;
    s->quadrics = arena_alloc(arena, 1, sizeof(struct quadric));
    s->quadrics[0] = (struct quadric){
        .kind = QUADRIC_SPHERE, .radius = 1, .material = 2, .light = 1
    };
    s->material_count = 3;
    s->materials = arena_alloc(arena, 3, sizeof(struct material));
    s->materials[1] = (struct material){ .kind = MATERIAL_COAT, .ior = 1.5f, .alpha = { 0.1f } };
    s->materials[2] = (struct material){ .kind = MATERIAL_MIX, .mix = { 0, 1 } };
    s->coat_table_count = 1;
    s->coat_tables = arena_alloc(arena, COAT_TABLE_LEN, sizeof(float));
    s->light_count = 3;
    s->lights = arena_alloc(arena, 3, sizeof(struct light));
    s->lights[0] = (struct light){
        .kind = LIGHT_POLYGON, .area = 0.5f, .pick = 0.5f, .corner_count = 3
    };
    s->lights[1] = (struct light){ .kind = LIGHT_SPHERE, .area = 12.5f, .pick = 0.25f };
    s->lights[2] = (struct light){ .kind = LIGHT_SKY, .pick = 0.25f };
    s->settings.sky_light = 2;
    s->light_corner_count = 3;
    s->light_corners = arena_alloc(arena, 3, 3 * sizeof(float));
    s->triangle_light_count = 1;
    s->triangle_light = arena_alloc(arena, 1, sizeof(uint32_t));
    s->medium_count = 1;
    s->media = arena_alloc(arena, 1, sizeof(struct medium));
    s->media[0] = (struct medium){ .sigma_a = { 1, 2, 3 }, .sigma_s = { 3, 2, 1 }, .g = -1 };
    s->quadrics[0].inside = 1;
    s->settings.camera_medium = 1;
    s->settings.effects = scene_effects(s);
    return s;
}

static void a_new_scene_is_empty_and_valid(void **state)
{
    (void)state;
    struct scene *scene = scene_new();
    assert_true(scene_check(scene, NULL));
    assert_int_equal(scene_effects(scene), 0);
    scene_free(scene);
    scene_free(NULL);
}

static void a_whole_scene_passes(void **state)
{
    (void)state;
    struct scene *scene = one_of_everything();
    struct err err = { .text = "" };
    if (!scene_check(scene, &err))
        fail_msg("%s", err.text);
    scene_free(scene);
}

#define DAMAGES(X) /* what is broken, what the error says */             \
    X(s->triangles[2] = 3, "out of range")                               \
    X(s->positions[4] = NAN, "position is not finite")                   \
    X(s->positions[4] = INFINITY, "position is not finite")              \
    X(s->normals[0] = NAN, "normal is not finite")                       \
    X(s->meshes[0].triangle_count = 2, "beyond the arrays")              \
    X(s->meshes[0].first_triangle = UINT32_MAX, "beyond the arrays")     \
    X(s->meshes[0].vertex_count = 4, "beyond the arrays")                \
    X(s->meshes[0].material = 3, "no material")                          \
    X(s->meshes[0].normal_shift = 1, "normals are missing")              \
    X(s->meshes[0].uv_shift = 7, "texture coordinates are missing")      \
    X(s->meshes[0].first_emissive = 1, "lights are missing")             \
    X(s->settings.has_normals = 0, "says none has")                      \
    X(s->triangle_light[0] = 3, "there is none")                         \
    X(s->quadrics[0].kind = 2, "unknown kind")                           \
    X(s->quadrics[0].radius = 0, "not valid")                            \
    X(s->quadrics[0].light = 3, "no light")                              \
    X(s->quadrics[0].light = 0, "do not know each other")                \
    X(s->materials[0].kind = MATERIAL_KINDS, "unknown kind")             \
    X(s->materials[0].reflectance[1] = NAN, "not finite")                \
    X(s->materials[1].ior = 0, "index of refraction")                    \
    X(s->materials[1].coat_table = 1, "no coat table")                   \
    X(s->materials[1].kind = MATERIAL_COATED_CONDUCTOR, "no coat table") \
    X(s->materials[1].flags = MATERIAL_COATS, "no coat table")           \
    X(s->materials[1].base_alpha[1] = NAN, "not finite")                 \
    X(s->materials[2].mix[1] = 2, "not before it")                       \
    X(s->lights[0].kind = LIGHT_KINDS, "unknown kind")                   \
    X(s->lights[0].corner_count = POLYGON_MAX + 1, "corners")            \
    X(s->lights[0].first_corner = 1, "corners")                          \
    X(s->lights[0].area = 0, "no area")                                  \
    X(s->lights[0].texture = 1, "no texture")                            \
    X(s->lights[0].texture_scale = NAN, "not finite")                    \
    X(s->lights[2].flags = LIGHT_UNSEEN, "no shape")                     \
    X(s->lights[2].corner_count = 3, "cannot have its portal")           \
    X(s->lights[2].corner_count = 4, "corners")                          \
    X(s->quadrics[0].alpha = 1, "no texture")                            \
    X(s->lights[0].pick = 0, "probability")                              \
    X(s->lights[0].pick = 0.75f, "in all")                               \
    X(s->lights[1].quadric = 1, "do not know each other")                \
    X(s->lights[2].radiance[0] = INFINITY, "not finite")                 \
    X(s->settings.sky_light = 1, "not a light of the sky")               \
    X(s->settings.effects ^= FX_MIXTURE, "effect mask")                  \
    X(s->settings.width = 0, "resolution")                               \
    X(s->settings.crop[1] = 2, "crop window")                            \
    X(s->settings.crop[2] = 1, "crop window")                            \
    X(s->settings.sampler = SAMPLER_COUNT, "sampler")                    \
    X(s->settings.filter.radius[0] = 0, "filter")                        \
    X(s->settings.filter.kind = FILTER_SINC, "sinc filter's tau is 0")   \
    X(s->settings.camera.kind = 2, "camera kind")                        \
    X(s->settings.camera.forward[0] = NAN, "camera")                     \
    X(s->settings.camera.lens_radius = -1, "lens radius")                \
    X(s->settings.center[0] = NAN, "centre")                             \
    X(s->settings.camera_medium = 2, "camera: no medium 2")              \
    X(s->meshes[0].inside = 2, "mesh 0: no media 2 and 0")               \
    X(s->quadrics[0].outside = 2, "quadric 0: no media 1 and 2")         \
    X(s->media[0].sigma_a[2] = -1, "medium 0 has a number")              \
    X(s->media[0].sigma_s[0] = INFINITY, "medium 0 has a number")        \
    X(s->media[0].Le[1] = NAN, "medium 0 has a number")                  \
    X(s->media[0].g = 1.001f, "medium 0 has a number")                   \
    X(s->media = NULL, "is missing")                                     \
    X(s->lights = NULL, "is missing")

static void every_kind_of_damage_is_found(void **state)
{
    (void)state;
    struct err err;
#define X(damage, says)                                                             \
    do {                                                                            \
        struct scene *s = one_of_everything();                                      \
        damage;                                                                     \
        err_clear(&err);                                                            \
        if (scene_check(s, &err) || strstr(err.text, says) == NULL)                 \
            fail_msg("%s: \"%s\" was wanted, not \"%s\"", #damage, says, err.text); \
        assert_int_equal(err.code, ERR_SCENE);                                      \
        scene_free(s);                                                              \
    } while (0);
    DAMAGES(X)
#undef X
}

static void a_sheen_is_checked(void **state)
{
    (void)state;
    static const struct {
        struct material material;
        const char *says; /* NULL: nothing */
    } rows[] = {
        { { .sheen = { 1, 0.5f, 0 }, .sheen_alpha = 1 }, NULL },
        { { .sheen = { 1, 0.5f, 1.001f }, .sheen_alpha = 1 }, "a sheen of 1.001" },
        { { .sheen = { 1, -0.5f, 0 }, .sheen_alpha = 1 }, "a sheen of -0.5" },
        { { .sheen = { NAN, 0, 0 }, .sheen_alpha = 1 }, "a sheen of nan" },
        { { .sheen_alpha = 0 }, "a sheen of width 0" },
        { { .sheen_alpha = 1.5f }, "a sheen of width 1.5" },
        { { .sheen_alpha = NAN }, "a sheen of width nan" },
        { { .sheen_alpha = 1, .sheen_table = 2 }, "no table 2 of a sheen" },
        { { .sheen_alpha = 1, .sheen_table = UINT32_MAX }, "no table 4294967295 of a sheen" },
        { { .sheen_alpha = 1, .kind = MATERIAL_UNLIT }, "cannot have a sheen" },
        { { .sheen_alpha = 1, .kind = MATERIAL_MIX }, "cannot have a sheen" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *s = scene_new();
        s->coat_table_count = SHEEN_ROWS + 1;
        s->coat_tables = arena_alloc(s->arena, SHEEN_ROWS + 1, COAT_TABLE_LEN * sizeof(float));
        s->material_count = 1;
        s->materials = arena_alloc(s->arena, 1, sizeof(struct material));
        s->materials[0] = rows[i].material;
        s->materials[0].flags = MATERIAL_SHEEN;
        s->settings.effects = scene_effects(s);
        assert_true(s->settings.effects & FX_SHEEN);
        struct err err = { .text = "" };
        assert_int_equal(scene_check(s, &err), rows[i].says == NULL);
        if (rows[i].says != NULL && strstr(err.text, rows[i].says) == NULL)
            fail_msg("\"%s\" was wanted, not \"%s\"", rows[i].says, err.text);
        scene_free(s);
    }
}

/* A sky and a point light with a picture each; two pictures of 2 x 2 */
static struct scene *two_environments(void)
{
    struct scene *s = scene_new();
    s->texels = arena_alloc(s->arena, 2, TEXEL_BLOCK);
    s->texel_block_count = 2;
    s->picture_count = s->environment_count = s->light_count = 2;
    s->pictures = arena_alloc(s->arena, 2, sizeof(struct scene_picture));
    s->environments = arena_alloc(s->arena, 2, sizeof(struct environment));
    s->lights = arena_alloc(s->arena, 2, sizeof(struct light));
    for (uint32_t i = 0; i < 2; i++) {
        s->pictures[i] = (struct scene_picture){ .first_block = i,
                                                 .width = 2,
                                                 .height = 2,
                                                 .channels = 1,
                                                 .levels = 1,
                                                 .texel = TEXEL_FLOAT };
        s->environments[i] = (struct environment){ .picture = i,
                                                   .light = i,
                                                   .to_light = { 1, 0, 0, 0, 0, -1, 0, 1, 0 },
                                                   .scale = { 1, 1, 1 } };
        s->lights[i] = (struct light){ .kind = i ? LIGHT_POINT : LIGHT_SKY,
                                       .pick = 0.5f,
                                       .environment = i + 1 };
    }
    s->environments[1].layout = ENVIRONMENT_PROJECTION;
    s->environments[1].to_light[0] = 3;
    s->settings.effects = scene_effects(s);
    return s;
}

static void damaged_environments_are_found(void **state)
{
    (void)state;
    struct scene *whole = two_environments();
    struct err err = { .text = "" };
    if (!scene_check(whole, &err))
        fail_msg("%s", err.text);
    assert_int_equal(whole->settings.effects, FX_ENVIRONMENT | FX_DELTA_LIGHT | FX_MANY_LIGHTS);
    scene_free(whole);
#define ENVIRONMENT_DAMAGES(X)                                               \
    X(s->environments[0].picture = 2, "no picture")                          \
    X(s->environments[0].layout = 3, "shape of its picture")                 \
    X(s->pictures[0].height = 1, "shape of its picture")                     \
    X(s->environments[0].light = 1, "do not know each other")                \
    X(s->environments[0].light = 2, "do not know each other")                \
    X(s->environments[0].to_light[0] = 3, "not turned by a rotation")        \
    X(s->environments[0].to_light[0] = NAN, "not valid")                     \
    X(s->environments[1].to_light[1] = INFINITY, "not valid")                \
    X(s->environments[0].scale[1] = -1, "not valid")                         \
    X(s->lights[0].environment = 3, "do not know each other")                \
    X(s->lights[1].environment = 0, "do not know each other")                \
    X(s->lights[1].kind = LIGHT_SPOT, "cannot have its environment")         \
    X(s->environments[0].layout = ENVIRONMENT_PROJECTION, "cannot have its") \
    X(s->settings.sky_light = 0, "not a light of the sky")
#define X(damage, says)                                                             \
    do {                                                                            \
        struct scene *s = two_environments();                                       \
        damage;                                                                     \
        err_clear(&err);                                                            \
        if (scene_check(s, &err) || strstr(err.text, says) == NULL)                 \
            fail_msg("%s: \"%s\" was wanted, not \"%s\"", #damage, says, err.text); \
        scene_free(s);                                                              \
    } while (0);
    ENVIRONMENT_DAMAGES(X)
#undef X
}

/* --- Effects ------------------------------------------------------------------------------ */

static void each_effect_is_set_by_what_needs_it(void **state)
{
    (void)state;
    struct scene *s = one_of_everything();
    assert_int_equal(scene_effects(s), FX_MESH | FX_QUADRIC | FX_SMOOTH_NORMALS | FX_COAT |
                                           FX_ROUGH | FX_MIX | FX_POLYGON_LIGHT | FX_SPHERE_LIGHT |
                                           FX_SKY | FX_MANY_LIGHTS | FX_ANISOTROPIC | FX_MEDIUM);
    uint32_t before = scene_effects(s);
    s->settings.camera.lens_radius = 0.1f;
    assert_int_equal(scene_effects(s), before | FX_LENS);
    s->settings.camera.kind = CAMERA_ORTHOGRAPHIC;
    assert_int_equal(scene_effects(s), before | FX_LENS | FX_ORTHOGRAPHIC);
    s->settings.sampler = SAMPLER_HALTON;
    s->settings.filter.radius[1] = 1;
    assert_int_equal(scene_effects(s),
                     before | FX_LENS | FX_ORTHOGRAPHIC | FX_SAMPLER_ANY | FX_FILTER_ANY);
    scene_free(s);

    s = one_of_everything();
    s->materials[1].alpha[0] = 0;
    assert_int_equal(scene_effects(s), before & ~(uint32_t)(FX_ROUGH | FX_ANISOTROPIC));
    s->materials[1].kind = MATERIAL_COATED_CONDUCTOR;
    s->materials[1].base_alpha[0] = s->materials[1].base_alpha[1] = 0.1f;
    assert_int_equal(scene_effects(s) & (FX_COAT | FX_ROUGH | FX_COATED_CONDUCTOR | FX_ANISOTROPIC),
                     FX_ROUGH | FX_COATED_CONDUCTOR);
    s->materials[1].kind = MATERIAL_THIN_DIELECTRIC;
    assert_int_equal(scene_effects(s) & (FX_ROUGH | FX_THIN), FX_THIN);
    s->materials[1].kind = MATERIAL_DIFFUSE_TRANSMISSION;
    assert_int_equal(scene_effects(s) & (FX_ROUGH | FX_THIN), FX_THIN);
    s->materials[0] = (struct material){ .kind = MATERIAL_CONDUCTOR, .alpha = { 0, 0.5f } };
    s->materials[2] = (struct material){ .kind = MATERIAL_DIELECTRIC };
    assert_int_equal(scene_effects(s) & (FX_MIX | FX_ROUGH | FX_CONDUCTOR | FX_DIELECTRIC),
                     FX_ROUGH | FX_CONDUCTOR | FX_DIELECTRIC);
    s->materials[0] = (struct material){ .kind = MATERIAL_MIXTURE };
    assert_true(scene_effects(s) & FX_MIXTURE);
    s->light_count = 1;
    s->lights[0].kind = LIGHT_SPOT;
    assert_int_equal(scene_effects(s) & (FX_MANY_LIGHTS | FX_DELTA_LIGHT | FX_SKY), FX_DELTA_LIGHT);
    s->lights[0].kind = LIGHT_DISK;
    assert_true(scene_effects(s) & FX_DISK_LIGHT);
    assert_int_equal(scene_effects(s) & ~(uint32_t)FX_ALL, 0);
    scene_free(s);
}

static void effects_are_printed_and_cut(void **state)
{
    (void)state;
    char text[32];
    assert_string_equal(effects_text(FX_MESH | FX_SKY, text, sizeof(text)), "mesh, sky");
    assert_string_equal(effects_text(0, text, sizeof(text)), "");
    assert_string_equal(effects_text(FX_ALL, text, 8), "mesh, q");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arena_memory_is_zeroed_aligned_and_padded),
        cmocka_unit_test(adopted_memory_is_released_once),
        cmocka_unit_test(a_reset_arena_gives_zeroed_memory_again),
        cmocka_unit_test(a_new_scene_is_empty_and_valid),
        cmocka_unit_test(a_whole_scene_passes),
        cmocka_unit_test(every_kind_of_damage_is_found),
        cmocka_unit_test(a_sheen_is_checked),
        cmocka_unit_test(damaged_environments_are_found),
        cmocka_unit_test(each_effect_is_set_by_what_needs_it),
        cmocka_unit_test(effects_are_printed_and_cut),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
