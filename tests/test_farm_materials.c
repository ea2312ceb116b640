/*
 * Goal: every material that a reader makes, of pbrt-v4 or of glTF, with textures or without, passes
 * every check of a BSDF, and the path kernel renders what the BSDF says: in a uniform sky its
 * albedo, and no light through surfaces whose normals lean. H numbers are those of the numerics
 * notes, section 2.
 */
#include "master/gltf.h"
#include "master/pbrt.h"
#include "tests/bsdf_checks.h"
#include "tests/kernel_scenes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* ---- the materials */

#define PBRT(text) "pbrt: " text, "WorldBegin " BEFORE "Material " text " Shape \"sphere\""
#define BEFORE                                                                                    \
    "Texture \"c\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [.9 .5 .1] \"rgb tex2\" [.1 .2 1] " \
    "Texture \"r\" \"float\" \"checkerboard\" \"float tex1\" .04 \"float tex2\" .25 "             \
    "Texture \"w\" \"float\" \"fbm\" "                                                            \
    "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" \"rgb reflectance\" [.2 .3 .4] "         \
    "MakeNamedMaterial \"b\" \"string type\" \"conductor\" \"float roughness\" .09 "
#define MIX_OF_A_AND_B "\"mix\" \"string materials\" [\"a\" \"b\"] "

/* A triangle with texture coordinates, and pictures of 2 x 2 texels: red and green with alpha 0,
 * blue and white with alpha 128 */
#define GLTF(text)                                                                                 \
    "glTF: " text,                                                                                 \
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":60,\"uri\":"                \
        "\"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"  \
        "AAAAAAAAAAAAAIA/AAAAAAAAAAAAAIA+\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},"  \
        "{\"buffer\":0,\"byteOffset\":36,\"byteLength\":24}],\"accessors\":[{\"bufferView\":0,"    \
        "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,"                 \
        "\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}],\"nodes\":[{\"mesh\":0}],"         \
        "\"meshes\":[{\"primitives\":[{\"material\":0,\"attributes\":{\"POSITION\":0,"             \
        "\"TEXCOORD_0\":1}}]}],\"textures\":[{\"source\":0}],\"images\":[{\"uri\":"                \
        "\"data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAFElEQVR42mP4z8Dw" \
        "HwhB4D8INAAAP1MIeYCuwNYAAAAASUVORK5CYII=\"}],\"materials\":[{" text "}]}"

enum {
    LEANING = 1, /* its normals change from place to place */
    COLOURED = 2 /* its values do */
};

static const struct {
    const char *name, *text;
    unsigned flags;
} rows[] = {
    { PBRT("\"diffuse\" \"rgb reflectance\" [.7 .5 .3]"), 0 },
    { PBRT("\"diffuse\" \"texture reflectance\" \"c\""), COLOURED },
    { PBRT("\"diffuse\" \"texture displacement\" \"w\""), LEANING },
    { PBRT("\"mixture\" \"rgb diffuse\" [.5 .2 .2] \"rgb specular\" [.3 .4 .1]"), 0 },
    { PBRT("\"conductor\" \"float roughness\" 0"), 0 },
    { PBRT("\"conductor\" \"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" \"metal-Au-k\" "
           "\"float roughness\" .09"),
      0 },
    { PBRT("\"conductor\" \"rgb reflectance\" [.9 .6 .3] \"float roughness\" .5"), 0 },
    { PBRT("\"conductor\" \"float uroughness\" .01 \"float vroughness\" .25"), 0 },
    { PBRT("\"conductor\" \"texture reflectance\" \"c\" \"texture roughness\" \"r\""), COLOURED },
    { PBRT("\"dielectric\""), 0 },
    { PBRT("\"dielectric\" \"float roughness\" .09"), 0 },
    { PBRT("\"dielectric\" \"float eta\" 1.33 \"texture roughness\" \"r\""), COLOURED },
    { PBRT("\"thindielectric\""), 0 },
    { PBRT("\"coateddiffuse\" \"rgb reflectance\" [.9 .5 .1]"), 0 },
    { PBRT("\"coateddiffuse\" \"float roughness\" .09 \"float thickness\" .1"), 0 },
    { PBRT("\"coateddiffuse\" \"texture reflectance\" \"c\" \"texture roughness\" \"r\""),
      COLOURED },
    { PBRT("\"coatedconductor\""), 0 },
    { PBRT("\"coatedconductor\" \"float interface.roughness\" .04 \"float conductor.roughness\" "
           ".09"),
      0 },
    { PBRT("\"coatedconductor\" \"texture reflectance\" \"c\" \"float conductor.roughness\" .25"),
      COLOURED },
    { PBRT("\"diffusetransmission\" \"rgb reflectance\" [.5 .3 .1] \"rgb transmittance\" "
           "[.2 .3 .6]"),
      0 },
    { PBRT("\"diffusetransmission\" \"texture transmittance\" \"c\" \"rgb reflectance\" [0 0 0]"),
      COLOURED },
    { PBRT(MIX_OF_A_AND_B "\"float amount\" .3"), 0 },
    { PBRT(MIX_OF_A_AND_B "\"texture amount\" \"r\""), COLOURED },
    { GLTF("\"name\":\"default\""), 0 },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5,"
           "\"baseColorFactor\":[0.9,0.5,0.1,1]}"),
      0 },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0.4,\"roughnessFactor\":0.35}"), 0 },
    { GLTF("\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0},"
           "\"metallicRoughnessTexture\":{\"index\":0}}"),
      COLOURED },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"normalTexture\":{\"index\":0}"),
      LEANING },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0,"
           "\"baseColorFactor\":[1,0.5,0.25,1]},\"extensions\":{\"KHR_materials_transmission\":{"
           "\"transmissionFactor\":1}}"),
      0 },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5},\"extensions\":"
           "{\"KHR_materials_transmission\":{\"transmissionFactor\":0.75},"
           "\"KHR_materials_volume\":{\"thicknessFactor\":0.1}}"),
      0 },
    { GLTF("\"pbrMetallicRoughness\":{\"roughnessFactor\":0.5},\"extensions\":{"
           "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.5,"
           "\"clearcoatRoughnessFactor\":0.4}}"),
      0 },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0.5,\"roughnessFactor\":0.8,"
           "\"baseColorFactor\":[0.2,0.1,0.4,1]},\"extensions\":{\"KHR_materials_sheen\":{"
           "\"sheenColorFactor\":[1,0.8,0.5],\"sheenRoughnessFactor\":0.5}}"),
      0 },
    { GLTF("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.8},"
           "\"extensions\":{\"KHR_materials_sheen\":{\"sheenColorFactor\":[1,1,1],"
           "\"sheenColorTexture\":{\"index\":0},\"sheenRoughnessFactor\":0.9,"
           "\"sheenRoughnessTexture\":{\"index\":0}}}"),
      COLOURED },
};
#define ROWS (sizeof(rows) / sizeof(rows[0]))

static struct scene *read_row(size_t i)
{
    struct err err = { .text = "" };
    const char *text = rows[i].text;
    struct scene *scene = rows[i].name[0] == 'g'
                              ? gltf_read_bytes(text, strlen(text), NULL, NULL, NULL, &err)
                              : pbrt_read_text(text, strlen(text), NULL, NULL, NULL, &err);
    if (scene == NULL)
        fail_msg("%s: %s", rows[i].name, err.text);
    return scene;
}

static uint32_t top_material(const struct scene *scene)
{
    return scene->quadric_count > 0 ? scene->quadrics[0].material : scene->meshes[0].material;
}

static bool is_textured(const struct material *material)
{
    return (textured_parts(material) & TEXTURED_VALUES) != 0;
}

static struct texture_point random_point(struct random_lanes *r)
{
    struct texture_point point = {
        .n = { 0, 0, 1 }, .dpdu = { 1, 0, 0 }, .dpdv = { 0, 1, 0 }, .color = { 1, 1, 1, 1 }
    };
    for (int i = 0; i < 2; i++)
        point.uv[i] = (float)(4 * random_double(r) - 2);
    for (int i = 0; i < 3; i++)
        point.p[i] = (float)(4 * random_double(r) - 2);
    return point;
}

/* ---- every check */

static void check(const struct subject *m)
{
    static const double cosines[] = { 0.6, 0.12, -0.5 };
    struct bsdf8 b = bsdf_of_materials(m->scene, m->material, FX_ALL, I8(0));
    double z = checks_energy(m, 1);
    if (z > 4.5)
        fail_msg("%s: %g standard errors more than all the light", m->name, z);
    checks_corners(m, 100);
    if (i8_any(bsdf_all_delta(&b, FX_ALL)))
        return;
    checks_agreement(m, false);
    checks_agreement(m, true);
    checks_both_ways(m);
    /* From one of two directions; glass from all */
    static int turn;
    for (int i = 0; i < 3 && subject_width(m) >= 0.08; i++) {
        if (subject_ior(m) == 1 && i != turn % 2)
            continue;
        struct scatter s = { m, at_cosine(cosines[i]), i % 2, 0, SOUND };
        checks_distribution(&s, 1, (uint64_t)i + 50, 4e-3);
    }
    turn++;
}

static void every_material_passes_every_check(void **state) /* H25, H27, H28, H30 */
{
    (void)state;
    for (size_t i = 0; i < ROWS; i++) {
        struct scene *scene = read_row(i);
        struct err err = { .code = ERR_OK };
        struct texture_set *set = texture_set_open(scene, &err);
        assert_non_null(set);
        struct random_lanes r = { 70 + i, 0 };
        for (uint32_t k = 0; k < scene->material_count; k++) {
            const struct material *material = &scene->materials[k];
            if (material->kind == MATERIAL_MIX)
                continue;
            for (int place = 0; place < (is_textured(material) ? 2 : 1); place++) {
                struct material here = *material;
                struct texture_point point = random_point(&r);
                textured_material(set, &point, &here);
                check(&(struct subject){ rows[i].name, scene, &here });
            }
        }
        texture_set_close(set);
        scene_free(scene);
    }
}

/* ---- pictures */

/* The row's materials in a scene of its own, with the scene that owns their arrays */
static struct scene *adopt(struct scene *from, uint32_t width)
{
    struct scene *scene = scenes_begin(width, width);
    for (uint32_t i = 0; i < from->material_count; i++)
        scenes_material(scene, from->materials[i]);
    scene->coat_tables = from->coat_tables;
    scene->coat_table_count = from->coat_table_count;
    scene->textures = from->textures;
    scene->texture_count = from->texture_count;
    scene->pictures = from->pictures;
    scene->picture_count = from->picture_count;
    scene->texels = from->texels;
    scene->texel_block_count = from->texel_block_count;
    return scene;
}

/* What a surface returns of a uniform sky of radiance 1 towards cosine c, a mix as its parts */
static double expected(const struct scene *scene, uint32_t index, double c)
{
    const struct material *material = &scene->materials[index];
    if (material->kind == MATERIAL_MIX) {
        double share = (double)material->mix_amount;
        return (1 - share) * expected(scene, material->mix[0], c) +
               share * expected(scene, material->mix[1], c);
    }
    const struct subject m = { "", scene, material };
    struct vec3x8 wo = at_cosine(c);
    struct random_lanes r = { 9, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < 20000; i++) {
        struct bsdf_sample8 s = subject_random(&m, &wo, &r, false);
        for (int lane = 0; lane < LANES; lane++)
            tally_add(&t, s.valid[lane] ? (double)s.weight.x[lane] : 0);
    }
    return tally_mean(&t);
}

static void in_a_uniform_sky_a_surface_shows_its_albedo(void **state)
{
    (void)state;
    static const float wall[4][3] = { { -9, -9, 0 }, { 9, -9, 0 }, { 9, 9, 0 }, { -9, 9, 0 } };
    for (size_t i = 0; i < ROWS; i++) {
        struct scene *from = read_row(i), *scene = adopt(from, 32);
        scene->settings.camera = (struct camera){ .kind = CAMERA_ORTHOGRAPHIC,
                                                  .right = { 0.8f, -0.6f, 0 },
                                                  .up = { 0.36f, 0.48f, -0.8f },
                                                  .forward = { -0.48f, -0.64f, -0.6f },
                                                  .position = { 0.96f, 1.28f, 1.2f },
                                                  .screen = { -1, 1, -1, 1 } };
        scenes_quad(scene, wall, top_material(from), 0);
        scenes_sky(scene, 1);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 128 });
        double noise = 4.5 * sqrt(p->variance / p->pixels);
        assert_int_equal(p->failed, 0);
        if (!(p->mean <= 1 + noise) || !(p->mean > 0.02))
            fail_msg("%s: %g of the sky", rows[i].name, p->mean);
        if (rows[i].flags == 0) {
            double want = expected(from, top_material(from), 0.6);
            /* The expectation is a mean of 160000 */
            if (!(fabs(p->mean - want) <= noise + 3e-3 * want))
                fail_msg("%s: %g of the sky, want %g", rows[i].name, p->mean, want);
            if (!(fabs(0.96 * p->mean - want) > noise + 3e-3 * want)) /* planted */
                fail_msg("%s: four per cent less are not seen", rows[i].name);
        }
        picture_free(p);
        scene_free(scene);
        scene_free(from);
    }
}

/* Does any of it let light through? */
static bool transmits(const struct scene *scene)
{
    for (uint32_t i = 0; i < scene->material_count; i++) {
        uint32_t kind = scene->materials[i].kind;
        if (kind == MATERIAL_DIELECTRIC || kind == MATERIAL_THIN_DIELECTRIC ||
            kind == MATERIAL_DIFFUSE_TRANSMISSION)
            return true;
    }
    return false;
}

static void lean(struct scene *scene, const float n[3])
{
    for (uint32_t i = 0; i < scene->vertex_count; i++)
        for (uint32_t axis = 0; axis < 3; axis++)
            scene->normals[3 * i + axis] = n != NULL
                                               ? n[axis]
                                               : -scene->positions[3 * i + axis] * 0.57735027f;
    scene->normal_count = scene->vertex_count;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        scene->meshes[i].flags |= MESH_NORMALS;
}

/* A closed box whose normals lean far over its edges, in a bright sky and in the sun */
static void leaning_normals_let_no_light_through(void **state) /* H15 */
{
    (void)state;
    static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };
    for (size_t i = 0; i < ROWS; i++) {
        struct scene *from = read_row(i);
        for (int open = 0; open < 2 && !transmits(from); open++) {
            struct scene *scene = adopt(from, 32);
            scenes_box(scene, low, high, top_material(from), 0);
            scene->mesh_count -= (uint32_t)open; /* planted: a wall is missing */
            scenes_sky(scene, 1);
            scenes_light(scene, (struct light){ .kind = LIGHT_DISTANT,
                                                .radiance = { 2, 2, 2 },
                                                .direction = { 0, 0.6f, 0.8f } });
            lean(scene, NULL);
            scenes_finish(scene);
            struct picture *p = picture_take(scene, (struct picture_how){ .samples = 8 });
            assert_int_equal(p->failed, 0);
            if ((p->largest > 0) != open)
                fail_msg("%s: %g in %s box", rows[i].name, p->largest,
                         open ? "an open" : "a closed");
            picture_free(p);
            scene_free(scene);
        }
        scene_free(from);
    }
}

/* Seen exactly across its normal a surface is black, and a number */
static void normals_at_right_angles_to_the_view_give_black(void **state) /* H15 */
{
    (void)state;
    static const float wall[4][3] = { { -9, -9, 3 }, { -9, 9, 3 }, { 9, 9, 3 }, { 9, -9, 3 } };
    static const float across[3] = { 1, 0, 0 }, seen[3] = { 0.6f, 0, -0.8f };
    for (size_t i = 0; i < ROWS; i++) {
        struct scene *from = read_row(i);
        for (int planted = 0; planted < 2; planted++) {
            struct scene *scene = adopt(from, 16);
            scene->settings.camera.kind = CAMERA_ORTHOGRAPHIC;
            scenes_quad(scene, wall, top_material(from), 0);
            scenes_sky(scene, 1);
            lean(scene, planted ? seen : across);
            scenes_finish(scene);
            struct picture *p = picture_take(scene, (struct picture_how){ .samples = 16 });
            assert_int_equal(p->failed, 0);
            /* Maps and bumps give normals that are seen */
            if (planted ? !(p->mean > 0) : !(p->largest <= 0) && rows[i].flags != LEANING)
                fail_msg("%s: %g at normals %s", rows[i].name, p->mean,
                         planted ? "that are seen" : "at right angles");
            picture_free(p);
            scene_free(scene);
        }
        scene_free(from);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_material_passes_every_check),
        cmocka_unit_test(in_a_uniform_sky_a_surface_shows_its_albedo),
        cmocka_unit_test(leaning_normals_let_no_light_through),
        cmocka_unit_test(normals_at_right_angles_to_the_view_give_black),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
