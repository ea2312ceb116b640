/* Goal: the materials of a glTF file become those that glTF means by them, and what is approximated
 * is said. */
#include "common/effects.h"
#include "tests/gltf_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* 2 x 2: red, green with alpha 0; blue, white with alpha 128 */
#define PNG_2X2                                                                              \
    "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAFElEQVR42mP4z8DwHwhB4D8INAAAP1MIeYCuwN" \
    "YAAAAASUVORK5CYII="

#define WITH_MATERIAL(text)                                                          \
    SHOW ",\"materials\":[{" text "}],\"meshes\":[{\"primitives\":[{\"material\":0," \
         "\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1}}]}],"                     \
         "\"textures\":[{\"source\":0,\"sampler\":0}],"                              \
         "\"samplers\":[{\"wrapS\":33071,\"wrapT\":33648,\"magFilter\":9728}],"      \
         "\"images\":[{\"uri\":\"data:image/png;base64," PNG_2X2 "\"}]"

/* The triangle with texture coordinates */
static void start_textured(void)
{
    static const float uvs[6] = { 0, 0, 1, 0, 0, 0.25f };
    start_triangle();
    add_floats(uvs, 3, 2);
}

static const struct material *material_of(const struct scene *scene)
{
    return &scene->materials[scene->meshes[0].material];
}

static void metalness_chooses_between_coat_metal_and_a_mix(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        uint32_t kind;
        double alpha;
    } rows[] = {
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5}", MATERIAL_COAT,
          0.25 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":1,\"roughnessFactor\":0.2}",
          MATERIAL_CONDUCTOR, 0.04 },
        { "\"pbrMetallicRoughness\":{\"roughnessFactor\":0.01}", MATERIAL_CONDUCTOR, 0 },
        { "\"name\":\"all defaults\"", MATERIAL_CONDUCTOR, 1 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0.25}", MATERIAL_MIX, 0 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":"
          "{\"KHR_materials_unlit\":{}}",
          MATERIAL_UNLIT, 0 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":"
          "{\"KHR_materials_specular\":{\"specularFactor\":0}}",
          MATERIAL_DIFFUSE, 0 },
        { "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{\"specularFactor\":[0,0,0],"
          "\"glossinessFactor\":0.5}}",
          MATERIAL_COAT, 0.25 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i].text);
        struct scene *scene = scene_of(rest);
        assert_int_equal(material_of(scene)->kind, rows[i].kind);
        EXPECT_NEAR(material_of(scene)->alpha[0], rows[i].alpha, 1e-7);
        if (rows[i].kind == MATERIAL_MIX) {
            EXPECT_NEAR(material_of(scene)->mix_amount, 0.25, 0);
            const uint32_t *mix = material_of(scene)->mix;
            assert_int_equal(scene->materials[mix[0]].kind, MATERIAL_COAT);
            assert_int_equal(scene->materials[mix[1]].kind, MATERIAL_CONDUCTOR);
        }
        scene_free(scene);
    }
}

static void a_metal_reflects_its_base_colour(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.25,0.5,0.9,1]}"));
    const struct material *metal = material_of(scene);
    assert_true(metal->flags & MATERIAL_METAL);
    for (unsigned c = 0; c < 3; c++) {
        double n = metal->eta[c], k2 = (double)metal->k[c] * metal->k[c];
        EXPECT_NEAR(((n - 1) * (n - 1) + k2) / ((n + 1) * (n + 1) + k2), metal->reflectance[c],
                    1e-6);
    }
    EXPECT_NEAR(metal->reflectance[1], 0.5, 0);
    scene_free(scene);
}

static void glass_is_thin_without_a_volume_and_tinted(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0,"
                      "\"baseColorFactor\":[1,0.5,0.25,1]},\"extensions\":{"
                      "\"KHR_materials_transmission\":{\"transmissionFactor\":1}}"));
    assert_int_equal(material_of(scene)->kind, MATERIAL_THIN_DIELECTRIC);
    assert_int_equal(material_of(scene)->flags, MATERIAL_TINTED);
    EXPECT_NEAR(material_of(scene)->specular[2], 0.25, 0);
    EXPECT_NEAR(material_of(scene)->ior, 1.5, 1e-6);
    scene_free(scene);
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5},"
                      "\"extensions\":{\"KHR_materials_transmission\":"
                      "{\"transmissionFactor\":0.75},\"KHR_materials_volume\":"
                      "{\"thicknessFactor\":0.1}}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    EXPECT_NEAR(mix->mix_amount, 0.75, 0);
    assert_int_equal(scene->materials[mix->mix[0]].kind, MATERIAL_COAT);
    assert_int_equal(scene->materials[mix->mix[1]].kind, MATERIAL_DIELECTRIC);
    EXPECT_NEAR(scene->materials[mix->mix[1]].alpha[0], 0.25, 0);
    assert_int_equal(scene->medium_count, 0);
    scene_free(scene);
}

static void thick_glass_absorbs_on_the_way_through(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
                      "\"KHR_materials_volume\":{\"thicknessFactor\":0.1,"
                      "\"attenuationDistance\":2,\"attenuationColor\":[1,0.5,0]}},"
                      "\"pbrMetallicRoughness\":{\"metallicFactor\":0}"));
    assert_int_equal(scene->medium_count, 1);
    assert_int_equal(scene->meshes[0].inside, 1);
    assert_int_equal(scene->meshes[0].outside, 0);
    EXPECT_NEAR(scene->media[0].sigma_a[0], 0, 0);
    EXPECT_NEAR(scene->media[0].sigma_a[1], log(2) / 2, 1e-6);
    EXPECT_NEAR(scene->media[0].sigma_a[2], log(1e6) / 2, 1e-5);
    scene_free(scene);
}

static void clear_coats_lie_over_their_share(void **state)
{
    (void)state;
    static const struct {
        const char *metallic;
        uint32_t kind;
    } rows[] = { { "0", MATERIAL_COAT }, { "1", MATERIAL_COATED_CONDUCTOR } };
    for (int i = 0; i < 2; i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest),
                 WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":%s,"
                               "\"roughnessFactor\":0.5},\"extensions\":{"
                               "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.5,"
                               "\"clearcoatRoughnessFactor\":0.2}}"),
                 rows[i].metallic);
        struct scene *scene = scene_of(rest);
        const struct material *mix = material_of(scene);
        assert_int_equal(mix->kind, MATERIAL_MIX);
        EXPECT_NEAR(mix->mix_amount, 0.5, 0);
        const struct material *coated = &scene->materials[mix->mix[1]];
        assert_int_equal(coated->kind, rows[i].kind);
        EXPECT_NEAR(coated->alpha[0], 0.04, 1e-7);
        EXPECT_NEAR(coated->base_alpha[0], i == 1 ? 0.25 : 0, 0);
        EXPECT_NEAR(scene->materials[mix->mix[0]].alpha[0], 0.25, 0);
        scene_free(scene);
    }
}

static void a_sheen_lies_over_every_part_of_a_material(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0.25},\"extensions\":{"
                      "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.5,0.25,1],"
                      "\"sheenRoughnessFactor\":0.5}}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_false(mix->flags & MATERIAL_SHEEN);
    for (int i = 0; i < 2; i++) {
        const struct material *part = &scene->materials[mix->mix[i]];
        assert_true(part->flags & MATERIAL_SHEEN);
        EXPECT_NEAR(part->sheen[0], 0.5, 0);
        EXPECT_NEAR(part->sheen[1], 0.25, 0);
        EXPECT_NEAR(part->sheen[2], 1, 0);
        EXPECT_NEAR(part->sheen_alpha, 0.25, 0);
        assert_int_equal(part->sheen_table, scene->materials[mix->mix[0]].sheen_table);
        assert_true(part->coat_table < part->sheen_table ||
                    part->coat_table >= part->sheen_table + SHEEN_ROWS ||
                    part->kind == MATERIAL_CONDUCTOR);
    }
    assert_true(scene->settings.effects & FX_SHEEN);
    /* At the width of a row, straight from above and from the side, fibres send little and much */
    const float *rows = scene->coat_tables +
                        (size_t)scene->materials[mix->mix[0]].sheen_table * COAT_TABLE_LEN;
    const float *half = rows + (45 - SHEEN_FIRST) * COAT_TABLE_LEN; /* (45 / 64)^2 = .494 */
    assert_true(half[COAT_TABLE_LEN - 1] < 0.05f && half[8] > 0.75f && half[8] < 0.85f);
    scene_free(scene);

    /* Colours are sRGB, roughness is an alpha of its own square; both with their factors */
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.5,0.25,1],"
                      "\"sheenRoughnessFactor\":0.5,\"sheenColorTexture\":{\"index\":0},"
                      "\"sheenRoughnessTexture\":{\"index\":0}}}"));
    const struct material *cloth = material_of(scene);
    const struct texture *color = &scene->textures[cloth->texture[SLOT_SHEEN] - 1];
    assert_int_equal(color->kind, TEXTURE_SCALE);
    EXPECT_NEAR(color->value[1][1], 0.25, 0);
    const struct texture *image = &scene->textures[color->child[0] - 1];
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8_SRGB);
    assert_int_equal(image->channel, SCENE_NONE);
    const struct texture *square = &scene->textures[cloth->texture[SLOT_SHEEN_ALPHA] - 1];
    assert_int_equal(square->child[0], square->child[1]);
    const struct texture *rough = &scene->textures[square->child[0] - 1];
    EXPECT_NEAR(rough->value[1][0], 0.5, 0);
    image = &scene->textures[rough->child[0] - 1];
    assert_int_equal(image->channel, 3);
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8);
    scene_free(scene);

    static const char *const none[] = { "\"KHR_materials_sheen\":{\"sheenRoughnessFactor\":1}",
                                        "\"KHR_materials_unlit\":{},\"KHR_materials_sheen\":{"
                                        "\"sheenColorFactor\":[1,1,1]}" };
    for (int i = 0; i < 2; i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest),
                 WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},"
                               "\"extensions\":{%s}"),
                 none[i]);
        scene = scene_of(rest);
        assert_false(material_of(scene)->flags & MATERIAL_SHEEN);
        assert_false(scene->settings.effects & FX_SHEEN);
        scene_free(scene);
    }
    start_textured();
    scene = scene_of(WITH_MATERIAL("\"extensions\":{\"KHR_materials_sheen\":{"
                                   "\"sheenColorFactor\":[1,1,1]}}"));
    EXPECT_NEAR(material_of(scene)->sheen_alpha, SHEEN_ALPHA_LEAST, 0);
    scene_free(scene);
}

static void the_index_and_specular_decide_what_a_dielectric_reflects(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_ior\":{\"ior\":2}}"));
    EXPECT_NEAR(material_of(scene)->ior, 2, 1e-6);
    scene_free(scene);
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_specular\":{\"specularFactor\":0.25}}"));
    double root = (material_of(scene)->ior - 1) / (material_of(scene)->ior + 1);
    EXPECT_NEAR(root * root, 0.04 * 0.25, 1e-6);
    scene_free(scene);
}

static void textures_are_placed_as_gltf_places_them(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"baseColorTexture\":"
                      "{\"index\":0}}"));
    EXPECT_NEAR(scene->uvs[1], 1, 0); /* v upwards */
    EXPECT_NEAR(scene->uvs[5], 0.75, 0);
    const struct texture *image =
        &scene->textures[material_of(scene)->texture[SLOT_REFLECTANCE] - 1];
    assert_int_equal(image->kind, TEXTURE_IMAGE);
    assert_int_equal(image->channel, SCENE_NONE);
    assert_int_equal(image->wrap[0], WRAP_CLAMP);
    assert_int_equal(image->wrap[1], WRAP_MIRROR);
    assert_true(image->flags & TEXTURE_NEAREST);
    const float plain[6] = { 1, 0, 0, 0, 1, 0 };
    for (int i = 0; i < 6; i++)
        EXPECT_NEAR(image->map[i], plain[i], 1e-6);
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8_SRGB);
    scene_free(scene);

    /* Scale by (2, 3), turn by 90 degrees, move by (.1, .2): u' = 3 v + .1, v' = -2 u + .2 */
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"baseColorTexture\":"
                      "{\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"scale\":[2,3],"
                      "\"rotation\":1.5707963267948966,\"offset\":[0.1,0.2]}}}}"));
    image = &scene->textures[material_of(scene)->texture[SLOT_REFLECTANCE] - 1];
    double u = 0.3, v = 0.4; /* glTF's */
    EXPECT_NEAR(image->map[0] * u + image->map[1] * (1 - v) + image->map[2], 3 * v + 0.1, 1e-6);
    EXPECT_NEAR(image->map[3] * u + image->map[4] * (1 - v) + image->map[5], 1 - (-2 * u + 0.2),
                1e-6);
    scene_free(scene);
}

static void metalness_and_roughness_come_from_their_channels(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"roughnessFactor\":0.5,"
                      "\"metallicRoughnessTexture\":{\"index\":0}},"
                      "\"normalTexture\":{\"index\":0,\"scale\":0.5}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_int_equal(scene->textures[mix->texture[SLOT_AMOUNT] - 1].channel, 2);
    for (int i = 0; i < 2; i++) {
        const struct material *part = &scene->materials[mix->mix[i]];
        /* Its own square: (0.5 green) (0.5 green) */
        const struct texture *square = &scene->textures[part->texture[SLOT_ROUGHNESS_U] - 1];
        assert_int_equal(square->kind, TEXTURE_SCALE);
        assert_int_equal(square->child[0], square->child[1]);
        const struct texture *half = &scene->textures[square->child[0] - 1];
        EXPECT_NEAR(half->value[1][0], 0.5, 0);
        assert_int_equal(scene->textures[half->child[0] - 1].channel, 1);
        assert_int_equal(part->texture[SLOT_ROUGHNESS_V], part->texture[SLOT_ROUGHNESS_U]);
        assert_int_not_equal(part->texture[SLOT_NORMAL], 0);
        EXPECT_NEAR(part->normal_scale, 0.5, 0);
        assert_true(part->flags & MATERIAL_NORMAL_SCALED);
    }
    for (uint32_t i = 0; i < scene->picture_count; i++)
        assert_int_equal(scene->pictures[i].texel, TEXEL_U8);
    assert_int_equal(scene->picture_count, 1);
    scene_free(scene);
}

static void alpha_modes_cut_holes(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        int kind; /* of the texture; -1 for none */
        double value;
    } rows[] = {
        { "\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.5]}", -1, 0 },
        { "\"alphaMode\":\"OPAQUE\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
          -1, 0 },
        { "\"alphaMode\":\"BLEND\"", -1, 0 },
        { "\"alphaMode\":\"BLEND\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.25]}",
          TEXTURE_CONSTANT, 0.25 },
        { "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.25]}",
          TEXTURE_CONSTANT, 0 },
        { "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.5]}", -1,
          0 },
        { "\"alphaMode\":\"BLEND\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
          TEXTURE_IMAGE, 0 },
        { "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.3,\"pbrMetallicRoughness\":"
          "{\"baseColorTexture\":{\"index\":0}}",
          TEXTURE_STEP, 0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i].text);
        struct scene *scene = scene_of(rest);
        uint32_t alpha = scene->meshes[0].alpha;
        assert_int_equal(alpha != 0, rows[i].kind >= 0);
        const struct texture *texture = alpha != 0 ? &scene->textures[alpha - 1] : NULL;
        if (texture != NULL) {
            assert_int_equal(texture->kind, rows[i].kind);
            EXPECT_NEAR(texture->value[0][0], rows[i].value, 0);
        }
        if (rows[i].kind == TEXTURE_IMAGE)
            assert_int_equal(texture->channel, 3);
        if (rows[i].kind == TEXTURE_STEP)
            EXPECT_NEAR(texture->value[1][0], 0.3, 1e-7);
        scene_free(scene);
    }
}

static void emissive_surfaces_are_lights(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"emissiveFactor\":[1,0.5,0.25],\"doubleSided\":true,\"extensions\":"
                      "{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":8}}"));
    assert_int_equal(scene->light_count, 1);
    assert_int_equal(scene->lights[0].kind, LIGHT_POLYGON);
    assert_int_equal(scene->lights[0].flags, LIGHT_TWO_SIDED);
    EXPECT_NEAR(scene->lights[0].radiance[0], 8, 0);
    EXPECT_NEAR(scene->lights[0].radiance[2], 2, 0);
    scene_free(scene);

    /* A picture: what it shows, times the factor, and about its mean */
    scene = scene_of(WITH_MATERIAL("\"emissiveFactor\":[0.5,1,1],\"emissiveTexture\":{\"index\":0},"
                                   "\"extensions\":{\"KHR_materials_emissive_strength\":"
                                   "{\"emissiveStrength\":4}}"));
    const struct light *light = &scene->lights[0];
    assert_int_equal(light->flags, 0);
    EXPECT_NEAR(light->texture_scale, 1, 0);
    const struct texture *product = &scene->textures[light->texture - 1];
    assert_int_equal(product->kind, TEXTURE_SCALE);
    assert_int_equal(scene->textures[product->child[0] - 1].kind, TEXTURE_IMAGE);
    EXPECT_NEAR(product->value[1][0], 2, 0);
    EXPECT_NEAR(product->value[1][1], 4, 0);
    EXPECT_NEAR(light->radiance[0], 1, 1);
    EXPECT_NEAR(light->radiance[1], 2, 2);
    scene_free(scene);

    /* What is unlit shows itself and emits nothing */
    scene = scene_of(WITH_MATERIAL("\"emissiveFactor\":[1,1,1],\"extensions\":"
                                   "{\"KHR_materials_unlit\":{}}"));
    assert_int_equal(scene->meshes[0].first_emissive, SCENE_NONE);
    scene_free(scene);
}

static void what_is_approximated_is_said_and_counted(void **state)
{
    (void)state;
    static const char *const rows[][2] = {
        { "\"extensions\":{\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1},"
          "\"KHR_materials_sheen\":{\"sheenColorFactor\":[1,1,1]}}",
          "a sheen lies on a clear coat" },
        { "\"extensions\":{\"KHR_materials_iridescence\":{}}", "iridescence is left out" },
        { "\"extensions\":{\"KHR_materials_unlit\":{}}", "seen by the camera and in mirrors" },
        { "\"occlusionTexture\":{\"index\":0}", "occlusion textures are not used" },
        { "\"extensions\":{\"KHR_materials_specular\":{\"specularFactor\":0.5}}",
          "another index of refraction" },
        { "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":1}}",
          "what is inside of glass is clear" },
        { "\"normalTexture\":{\"index\":0},\"emissiveFactor\":[1,1,1],"
          "\"emissiveTexture\":{\"index\":0,\"texCoord\":1}",
          "second set of texture coordinates" },
        { "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{}}",
          "turned into metallic-roughness" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i][0]);
        expect_note(rest, rows[i][1]);
    }
    start_triangle();
    expect_note(MESH "," SHOW, "there is no light: a sky of radiance 1");
    expect_note(MESH "," SHOW, "there is no camera");
    expect_note(MESH "," SHOW ",\"animations\":[{}]", "animations are not played");
    expect_note(MESH "," SHOW ",\"extensionsUsed\":[\"ABC_new\",\"KHR_materials_ior\"]",
                "extensionsUsed: left out, as the file allows: ABC_new");
    expect_note(MESH ",\"nodes\":[{\"mesh\":0,\"skin\":0}]", "skins are not applied");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(metalness_chooses_between_coat_metal_and_a_mix),
        cmocka_unit_test(a_metal_reflects_its_base_colour),
        cmocka_unit_test(glass_is_thin_without_a_volume_and_tinted),
        cmocka_unit_test(thick_glass_absorbs_on_the_way_through),
        cmocka_unit_test(clear_coats_lie_over_their_share),
        cmocka_unit_test(a_sheen_lies_over_every_part_of_a_material),
        cmocka_unit_test(the_index_and_specular_decide_what_a_dielectric_reflects),
        cmocka_unit_test(textures_are_placed_as_gltf_places_them),
        cmocka_unit_test(metalness_and_roughness_come_from_their_channels),
        cmocka_unit_test(alpha_modes_cut_holes),
        cmocka_unit_test(emissive_surfaces_are_lights),
        cmocka_unit_test(what_is_approximated_is_said_and_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
