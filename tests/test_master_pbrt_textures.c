/* Goal: every class and mapping of texture becomes the texture that pbrt means by it, what does not
 * vary becomes a number, and whatever is wrong is said with its position. */
#include "common/effects.h"
#include "tests/reader_text.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>

#include <cmocka.h>

static char folder[256];

/* --- Scenes ------------------------------------------------------------------------------- */

static struct scene *scene_of(const char *text)
{
    return reader_text_scene(text, scratch_path(folder, "text.pbrt"), NULL);
}

/* A scene whose only material has the texture "t" as its reflectance, or as its displacement when
 * it is of floats */
static struct scene *scene_with(const char *directives)
{
    char text[2048];
    bool spectrum = strstr(directives, "\"t\" \"spectrum\"") != NULL;
    snprintf(text, sizeof(text),
             "WorldBegin %s Material \"diffuse\" \"texture %s\" \"t\" "
             "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0]",
             directives, spectrum ? "reflectance" : "displacement");
    return scene_of(text);
}

static const struct texture *texture_of(const struct scene *scene)
{
    const uint32_t *slots = scene->materials[0].texture;
    uint32_t index = slots[SLOT_REFLECTANCE] != 0 ? slots[SLOT_REFLECTANCE] : slots[SLOT_BUMP];
    return index != 0 ? &scene->textures[index - 1] : NULL;
}

static const struct texture *child_of(const struct scene *scene, const struct texture *texture,
                                      int i)
{
    assert_int_not_equal(texture->child[i], 0);
    return &scene->textures[texture->child[i] - 1];
}

/* One pixel wide pictures: grey, red over green, and half there */
static int make_pictures(void **state)
{
    (void)state;
    static const uint8_t grey[] = { 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 8, 0x20, 51 };
    static const uint8_t color[] = { 0, 0, 2, 0, 0,  0,    0, 0, 0,   0, 0,   0,
                                     1, 0, 2, 0, 24, 0x20, 0, 0, 255, 0, 255, 0 };
    static const uint8_t alpha[] = { 0, 0, 2, 0, 0, 0,  0,    0,   0,   0,   0,
                                     0, 1, 0, 1, 0, 32, 0x28, 255, 255, 255, 128 };
    static const uint8_t pfm[] = "PF\n1 1\n-1.0\n\0\0\x80\x3f\0\0\x80\xbf\0\0\xc0\x7f";
    scratch_make(folder);
    mkdir(scratch_path(folder, "pictures"), 0700);
    scratch_write(scratch_path(folder, "grey.tga"), grey, sizeof(grey));
    scratch_write(scratch_path(folder, "pictures/color.tga"), color, sizeof(color));
    scratch_write(scratch_path(folder, "alpha.tga"), alpha, sizeof(alpha));
    scratch_write(scratch_path(folder, "odd.pfm"), pfm, sizeof(pfm) - 1);
    scratch_write(scratch_path(folder, "cut.tga"), color, sizeof(color) - 1);
    return 0;
}

static int remove_pictures(void **state)
{
    (void)state;
    scratch_remove(folder);
    return 0;
}

/* --- Classes ------------------------------------------------------------------------------ */

static void an_imagemap_has_its_file_wrap_filter_and_encoding(void **state)
{
    (void)state;
    static const struct {
        const char *parameters;
        uint32_t wrap, flags, texel;
        float scale;
    } rows[] = {
        { "", WRAP_REPEAT, 0, TEXEL_U8_SRGB, 1 },
        { "\"string wrap\" \"clamp\" \"string filter\" \"point\"", WRAP_CLAMP, TEXTURE_NEAREST,
          TEXEL_U8_SRGB, 1 },
        { "\"string wrap\" \"black\" \"string encoding\" \"linear\"", WRAP_BLACK, 0, TEXEL_U8, 1 },
        { "\"string encoding\" \"gamma 2.2\" \"string filter\" \"trilinear\"", WRAP_REPEAT, 0,
          TEXEL_HALF, 1 },
        { "\"string encoding\" \"sRGB\" \"float scale\" .25 \"bool invert\" true "
          "\"string filter\" \"ewa\" \"float maxanisotropy\" 4",
          WRAP_REPEAT, TEXTURE_INVERT, TEXEL_U8_SRGB, 0.25f },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text),
                 "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" "
                 "\"pictures/color.tga\" %s",
                 rows[i].parameters);
        struct scene *scene = scene_with(text);
        const struct texture *texture = texture_of(scene);
        assert_int_equal(texture->kind, TEXTURE_IMAGE);
        assert_int_equal(texture->wrap[0], rows[i].wrap);
        assert_int_equal(texture->wrap[1], rows[i].wrap);
        assert_int_equal(texture->flags, rows[i].flags);
        assert_int_equal(texture->channel, SCENE_NONE);
        EXPECT_NEAR(texture->scale, rows[i].scale, 0);
        assert_int_equal(scene->picture_count, 1);
        assert_int_equal(scene->pictures[texture->picture].texel, rows[i].texel);
        assert_int_equal(scene->pictures[texture->picture].levels, 2);
        if (rows[i].texel == TEXEL_U8)
            assert_memory_equal(scene->texels, ((uint8_t[]){ 255, 0, 0, 0, 255, 0 }), 6);
        scene_free(scene);
    }
}

static void without_filtering_a_picture_has_no_smaller_versions(void **state)
{
    (void)state;
    static const char *const options[] = { "", "Option \"disabletexturefiltering\" true " };
    for (int i = 0; i < 2; i++) {
        char text[1000];
        snprintf(text, sizeof(text),
                 "%sWorldBegin Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" "
                 "\"pictures/color.tga\" Material \"diffuse\" \"texture reflectance\" \"t\" "
                 "Shape \"sphere\"",
                 options[i]);
        struct scene *scene = scene_of(text);
        assert_int_equal(scene->picture_count, 1);
        assert_int_equal(scene->pictures[0].levels, 2 - i);
        scene_free(scene);
    }
}

static void a_float_imagemap_is_one_channel(void **state)
{
    (void)state;
    struct scene *scene = scene_with("Texture \"t\" \"float\" \"imagemap\" \"string filename\" "
                                     "\"alpha.tga\"");
    assert_int_equal(texture_of(scene)->channel, 0);
    assert_int_equal(scene->pictures[0].channels, 1);
    assert_int_equal(scene->texels[0], 128);
    assert_int_equal(scene->settings.effects & FX_BUMP, FX_BUMP);
    scene_free(scene);
}

#define GREY  "Texture \"g\" \"float\" \"imagemap\" \"string filename\" \"grey.tga\" "
#define COLOR "Texture \"c\" \"spectrum\" \"imagemap\" \"string filename\" \"pictures/color.tga\" "

static void textures_are_made_of_textures(void **state)
{
    (void)state;
    struct scene *scene = scene_with(GREY COLOR "Texture \"t\" \"spectrum\" \"scale\" "
                                                "\"texture tex\" \"c\" \"texture scale\" \"g\"");
    const struct texture *texture = texture_of(scene);
    assert_int_equal(texture->kind, TEXTURE_SCALE);
    assert_int_equal(child_of(scene, texture, 0)->channel, SCENE_NONE);
    assert_int_equal(child_of(scene, texture, 1)->channel, 0);
    scene_free(scene);

    scene = scene_with(GREY COLOR "Texture \"t\" \"spectrum\" \"mix\" \"texture tex1\" \"c\" "
                                  "\"rgb tex2\" [.1 .2 .3] \"texture amount\" \"g\"");
    texture = texture_of(scene);
    assert_int_equal(texture->kind, TEXTURE_MIX);
    assert_int_equal(child_of(scene, texture, 0)->kind, TEXTURE_IMAGE);
    assert_int_equal(texture->child[1], 0);
    EXPECT_NEAR(texture->value[1][2], 0.3, 1e-7);
    assert_int_equal(child_of(scene, texture, 2)->channel, 0);
    scene_free(scene);

    scene = scene_with(COLOR "Rotate 90 0 0 1 Texture \"t\" \"spectrum\" \"directionmix\" "
                             "\"texture tex1\" \"c\" \"vector dir\" [2 0 0]");
    texture = texture_of(scene);
    assert_int_equal(texture->kind, TEXTURE_DIRECTION);
    assert_int_equal(child_of(scene, texture, 0)->kind, TEXTURE_IMAGE);
    EXPECT_NEAR(texture->value[1][0], 1, 0);
    EXPECT_NEAR(texture->value[2][0], 0, 1e-7);
    EXPECT_NEAR(texture->value[2][1], 1, 1e-7);
    scene_free(scene);
}

static void patterns_have_their_colours_and_defaults(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        uint32_t kind, flags, mapping;
        double value[4]; /* red */
    } rows[] = {
        { "\"spectrum\" \"checkerboard\"", TEXTURE_CHECKERBOARD, 0, MAPPING_UV, { 1, 0 } },
        { "\"spectrum\" \"checkerboard\" \"rgb tex1\" [.5 1 1] \"rgb tex2\" [.25 0 0] "
          "\"integer dimension\" 3",
          TEXTURE_CHECKERBOARD,
          TEXTURE_THREE_SPACE,
          MAPPING_POINT,
          { 0.5, 0.25 } },
        { "\"float\" \"checkerboard\" \"float tex1\" 3 \"integer dimension\" 2",
          TEXTURE_CHECKERBOARD,
          0,
          MAPPING_UV,
          { 3, 0 } },
        { "\"float\" \"bilerp\"", TEXTURE_BILERP, 0, MAPPING_UV, { 0, 1, 0, 1 } },
        { "\"spectrum\" \"bilerp\" \"rgb v00\" [.125 0 0] \"rgb v01\" [.25 0 0] "
          "\"rgb v10\" [.5 0 0] \"rgb v11\" [.75 0 0]",
          TEXTURE_BILERP,
          0,
          MAPPING_UV,
          { 0.125, 0.25, 0.5, 0.75 } },
        { "\"spectrum\" \"dots\" \"rgb inside\" [.5 0 0] \"rgb outside\" [.75 0 0]",
          TEXTURE_DOTS,
          0,
          MAPPING_UV,
          { 0.5, 0.75 } },
        { "\"float\" \"dots\" \"string mapping\" \"planar\"",
          TEXTURE_DOTS,
          0,
          MAPPING_PLANAR,
          { 1, 0 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), "Texture \"t\" %s", rows[i].text);
        struct scene *scene = scene_with(text);
        const struct texture *texture = texture_of(scene);
        assert_int_equal(texture->kind, rows[i].kind);
        assert_int_equal(texture->flags, rows[i].flags);
        assert_int_equal(texture->mapping, rows[i].mapping);
        for (int k = 0; k < 4; k++)
            EXPECT_NEAR(texture->value[k][0], rows[i].value[k], 0);
        assert_int_equal(scene->texture_count, 1);
        scene_free(scene);
    }
}

static void noises_have_their_numbers(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        uint32_t kind, octaves;
        double omega, scale, variation;
    } rows[] = {
        { "\"float\" \"fbm\"", TEXTURE_FBM, 8, 0.5, 1, 0 },
        { "\"float\" \"wrinkled\" \"integer octaves\" 3 \"float roughness\" .25", TEXTURE_WRINKLED,
          3, 0.25, 1, 0 },
        { "\"float\" \"windy\"", TEXTURE_WINDY, 0, 0, 1, 0 },
        { "\"spectrum\" \"marble\"", TEXTURE_MARBLE, 8, 0.5, 1, 0.2 },
        { "\"spectrum\" \"marble\" \"float scale\" 4 \"float variation\" .5", TEXTURE_MARBLE, 8,
          0.5, 4, 0.5 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[256];
        snprintf(text, sizeof(text), "Texture \"t\" %s", rows[i].text);
        struct scene *scene = scene_with(text);
        const struct texture *texture = texture_of(scene);
        assert_int_equal(texture->kind, rows[i].kind);
        assert_int_equal(texture->mapping, MAPPING_POINT);
        assert_int_equal(texture->octaves, rows[i].octaves);
        EXPECT_NEAR(texture->omega, rows[i].omega, 0);
        EXPECT_NEAR(texture->scale, rows[i].scale, 0);
        EXPECT_NEAR(texture->variation, rows[i].variation, 1e-8);
        scene_free(scene);
    }
}

/* --- Mappings ----------------------------------------------------------------------------- */

/* Where the mapping takes the point p of the file, or (u, v) = p */
static void mapped(const struct scene *scene, const struct texture *texture, const double file[3],
                   double out[3])
{
    const float *m = texture->map;
    double p[3];
    for (int axis = 0; axis < 3; axis++)
        p[axis] = file[axis] - scene->settings.center[axis];
    for (int row = 0; row < 3; row++) {
        const float *r = m + (texture->mapping == MAPPING_UV ? 3 : 4) * row;
        if (texture->mapping == MAPPING_UV)
            out[row] = row < 2 ? r[0] * file[0] + r[1] * file[1] + (double)r[2] : 0;
        else
            out[row] = r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + (double)r[3];
    }
}

static void mappings_go_from_the_world_to_the_texture(void **state)
{
    (void)state;
    static const struct {
        const char *before, *parameters;
        uint32_t mapping;
        double p[3], q[3]; /* in the file and in the texture */
    } rows[] = {
        { "Scale 9 9 9", "", MAPPING_UV, { .25, .5 }, { .25, .5 } },
        { "",
          "\"float uscale\" 4 \"float vscale\" 2 \"float udelta\" 10 \"float vdelta\" 20",
          MAPPING_UV,
          { .25, .5 },
          { 11, 21 } },
        { "", "\"string mapping\" \"planar\"", MAPPING_PLANAR, { 3, 4, 5 }, { 3, 4 } },
        { "Translate 1 2 3 Scale 2 2 2",
          "\"string mapping\" \"planar\" \"vector3 v1\" [0 0 4] \"vector v2\" [1 1 0] "
          "\"float udelta\" .5 \"float vdelta\" -1",
          MAPPING_PLANAR,
          { 3, 4, 5 },
          { 4.5, 1 } },
        { "Translate 1 2 3",
          "\"string mapping\" \"spherical\"",
          MAPPING_SPHERICAL,
          { 3, 4, 5 },
          { 2, 2, 2 } },
        { "Rotate 90 0 0 1",
          "\"string mapping\" \"cylindrical\"",
          MAPPING_CYLINDRICAL,
          { 3, 4, 5 },
          { 4, -3, 5 } },
        { "Scale 2 4 8", "\"integer dimension\" 3", MAPPING_POINT, { 4, 4, 4 }, { 2, 1, .5 } },
        { "Translate 1e6 -1e6 3e6 Scale .5 .5 .5",
          "\"integer dimension\" 3",
          MAPPING_POINT,
          { 1e6 + .25, -1e6, 3e6 - .125 },
          { .5, 0, -.25 } },
        { "Translate 1e6 -1e6 3e6",
          "\"string mapping\" \"planar\"",
          MAPPING_PLANAR,
          { 1e6 + .25, .5 - 1e6, 3e6 },
          { .25, .5 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1024];
        snprintf(text, sizeof(text),
                 "WorldBegin %s Texture \"t\" \"spectrum\" \"checkerboard\" %s "
                 "Material \"diffuse\" \"texture reflectance\" \"t\" "
                 "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0]",
                 rows[i].before, rows[i].parameters);
        struct scene *scene = scene_of(text);
        const struct texture *texture = texture_of(scene);
        assert_int_equal(texture->mapping, rows[i].mapping);
        double q[3];
        mapped(scene, texture, rows[i].p, q);
        int rank = texture->mapping <= MAPPING_PLANAR ? 2 : 3;
        for (int axis = 0; axis < rank; axis++)
            if (!(fabs(q[axis] - rows[i].q[axis]) < 1e-5))
                fail_msg("row %zu, coordinate %d: %.9g, not %.9g", i, axis, q[axis],
                         rows[i].q[axis]);
        scene_free(scene);
    }
}

/* --- What does not vary ------------------------------------------------------------------- */

static void what_does_not_vary_is_a_number(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        double rgb[3];
    } rows[] = {
        { "Texture \"t\" \"spectrum\" \"constant\"", { 1, 1, 1 } },
        { "Texture \"t\" \"spectrum\" \"constant\" \"rgb value\" [.25 .5 .75]", { .25, .5, .75 } },
        { "Texture \"a\" \"spectrum\" \"constant\" \"rgb value\" [.25 .5 .75] "
          "Texture \"t\" \"spectrum\" \"scale\" \"texture tex\" \"a\" \"float scale\" .5",
          { .125, .25, .375 } },
        { "Texture \"a\" \"float\" \"constant\" \"float value\" .25 "
          "Texture \"t\" \"spectrum\" \"mix\" \"rgb tex1\" [1 0 0] \"rgb tex2\" [0 1 0] "
          "\"texture amount\" \"a\"",
          { .75, .25, 0 } },
        { COLOR "Texture \"t\" \"spectrum\" \"mix\" \"texture tex1\" \"c\" "
                "\"rgb tex2\" [.5 .25 .125] \"float amount\" 1",
          { .5, .25, .125 } },
        { "Texture \"t\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [.5 .5 .5] "
          "\"rgb tex2\" [.5 .5 .5]",
          { .5, .5, .5 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scene_with(rows[i].text);
        assert_null(texture_of(scene));
        assert_int_equal(scene->texture_count + scene->picture_count, 0);
        assert_int_equal(scene->settings.effects & (FX_TEXTURE | FX_BUMP), 0);
        for (int c = 0; c < 3; c++)
            EXPECT_NEAR(scene->materials[0].reflectance[c], rows[i].rgb[c], 0);
        scene_free(scene);
    }
    struct scene *scene = scene_with("Texture \"t\" \"float\" \"constant\"");
    assert_int_equal(scene->settings.effects & (FX_TEXTURE | FX_BUMP), 0); /* no slope */
    scene_free(scene);
}

static void scaling_by_a_number_happens_in_the_picture(void **state)
{
    (void)state;
    struct scene *scene = scene_with(COLOR "Texture \"t\" \"spectrum\" \"scale\" "
                                           "\"texture tex\" \"c\" \"float scale\" .25");
    assert_int_equal(texture_of(scene)->kind, TEXTURE_IMAGE);
    EXPECT_NEAR(texture_of(scene)->scale, 0.25, 0);
    assert_int_equal(scene->texture_count, 1);
    scene_free(scene);

    scene = scene_with(COLOR "Texture \"t\" \"spectrum\" \"scale\" \"texture tex\" \"c\"");
    assert_int_equal(texture_of(scene)->kind, TEXTURE_IMAGE);
    scene_free(scene);

    /* 1 - (scale x) is not scale (1 - x) */
    scene = scene_with("Texture \"c\" \"float\" \"imagemap\" \"string filename\" \"grey.tga\" "
                       "\"bool invert\" true Texture \"t\" \"float\" \"scale\" "
                       "\"texture tex\" \"c\" \"float scale\" .25");
    assert_int_equal(texture_of(scene)->kind, TEXTURE_SCALE);
    scene_free(scene);
}

static void what_is_not_used_is_not_in_the_scene(void **state)
{
    (void)state;
    struct scene *scene = scene_of("WorldBegin " GREY COLOR
                                   "Material \"diffuse\" \"texture reflectance\" \"c\" "
                                   "Material \"diffuse\" Shape \"sphere\"");
    assert_int_equal(scene->texture_count, 0);
    assert_int_equal(scene->picture_count, 0);
    assert_int_equal(scene->settings.effects & FX_TEXTURE, 0);
    scene_free(scene);
}

static void one_picture_serves_many_textures(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "WorldBegin " COLOR
        "Texture \"d\" \"spectrum\" \"imagemap\" \"string filename\" \"./pictures/color.tga\" "
        "Material \"diffuse\" \"texture reflectance\" \"c\" Shape \"sphere\" "
        "Material \"mixture\" \"texture diffuse\" \"c\" \"texture specular\" \"d\" "
        "Shape \"sphere\"");
    assert_int_equal(scene->picture_count, 1);
    assert_int_equal(scene->texture_count, 2);
    assert_int_equal(scene->materials[0].texture[SLOT_REFLECTANCE], 1);
    assert_int_equal(scene->materials[1].texture[SLOT_REFLECTANCE], 1);
    assert_int_equal(scene->materials[1].texture[SLOT_SPECULAR], 2);
    scene_free(scene);
}

/* --- Where textures go -------------------------------------------------------------------- */

static void every_parameter_has_its_slot(void **state)
{
    (void)state;
    static const struct {
        const char *material;
        uint32_t slots, flags; /* bits by slot */
    } rows[] = {
        { "\"diffuse\" \"texture reflectance\" \"c\"", 1 << SLOT_REFLECTANCE, 0 },
        { "\"mixture\" \"texture diffuse\" \"c\"", 1 << SLOT_REFLECTANCE, 0 },
        { "\"mixture\" \"texture specular\" \"c\"", 1 << SLOT_SPECULAR, 0 },
        { "\"coateddiffuse\" \"texture reflectance\" \"c\"", 1 << SLOT_REFLECTANCE, 0 },
        { "\"coateddiffuse\" \"texture roughness\" \"g\"",
          1 << SLOT_ROUGHNESS_U | 1 << SLOT_ROUGHNESS_V, MATERIAL_REMAP },
        { "\"conductor\" \"texture reflectance\" \"c\"", 1 << SLOT_REFLECTANCE, MATERIAL_METAL },
        { "\"conductor\" \"texture eta\" \"c\"", 1 << SLOT_ETA, 0 },
        { "\"conductor\" \"texture k\" \"c\"", 1 << SLOT_K, 0 },
        { "\"conductor\" \"texture uroughness\" \"g\" \"float vroughness\" .25 "
          "\"bool remaproughness\" false",
          1 << SLOT_ROUGHNESS_U, 0 },
        { "\"dielectric\" \"texture vroughness\" \"g\"", 1 << SLOT_ROUGHNESS_V, MATERIAL_REMAP },
        { "\"dielectric\" \"texture roughness\" \"g\" \"float uroughness\" .5",
          1 << SLOT_ROUGHNESS_V, MATERIAL_REMAP },
        { "\"diffuse\" \"texture displacement\" \"g\"", 1 << SLOT_BUMP, 0 },
        { "\"dielectric\" \"string normalmap\" \"pictures/color.tga\"", 1 << SLOT_NORMAL, 0 },
        { "\"mix\" \"string materials\" [\"a\" \"a\"] \"texture amount\" \"g\"", 1 << SLOT_AMOUNT,
          0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1024];
        snprintf(text, sizeof(text),
                 "WorldBegin " GREY COLOR "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" "
                 "Material %s Shape \"sphere\"",
                 rows[i].material);
        struct scene *scene = scene_of(text);
        const struct material *material = &scene->materials[scene->material_count - 1];
        for (int slot = 0; slot < MATERIAL_SLOTS; slot++)
            if ((material->texture[slot] != 0) != ((rows[i].slots >> slot & 1) != 0))
                fail_msg("row %zu: slot %d is %u", i, slot, material->texture[slot]);
        assert_int_equal(material->flags & (MATERIAL_REMAP | MATERIAL_METAL), rows[i].flags);
        scene_free(scene);
    }
}

static void numbers_beside_textures_are_kept(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "WorldBegin " GREY "Texture \"r\" \"float\" \"constant\" \"float value\" .25 "
        "Texture \"m\" \"spectrum\" \"constant\" \"rgb value\" [.5 .5 .5] "
        "Material \"conductor\" \"texture uroughness\" \"g\" \"texture vroughness\" \"r\" "
        "\"texture reflectance\" \"m\" Shape \"sphere\"");
    const struct material *material = &scene->materials[0];
    EXPECT_NEAR(material->alpha[1], 0.5, 1e-7);
    EXPECT_NEAR(material->eta[0], 1, 0);
    EXPECT_NEAR(material->k[0], 2, 1e-6); /* 2 sqrt(r / (1 - r)) */
    assert_int_equal(material->flags, MATERIAL_REMAP);
    scene_free(scene);
}

static void a_normal_map_is_linear(void **state)
{
    (void)state;
    struct scene *scene = scene_of("WorldBegin Material \"diffuse\" \"string normalmap\" "
                                   "\"pictures/color.tga\" Shape \"sphere\"");
    const struct texture *texture = &scene->textures[scene->materials[0].texture[SLOT_NORMAL] - 1];
    assert_int_equal(scene->pictures[texture->picture].texel, TEXEL_U8);
    assert_int_equal(texture->mapping, MAPPING_UV);
    EXPECT_NEAR(texture->map[0], 1, 0);
    EXPECT_NEAR(texture->map[4], 1, 0);
    assert_int_equal(scene->settings.effects & (FX_BUMP | FX_TEXTURE), FX_BUMP | FX_TEXTURE);
    scene_free(scene);
}

static void alpha_cuts_meshes(void **state)
{
    (void)state;
    static const struct {
        const char *alpha;
        int meshes, textures;
    } rows[] = {
        { "", 1, 0 },
        { "\"float alpha\" 1", 1, 0 },
        { "\"float alpha\" 2", 1, 0 },
        { "\"float alpha\" .5", 1, 1 },
        { "\"float alpha\" 0", 0, 0 },
        { "\"texture alpha\" \"g\"", 1, 1 },
        { "\"texture alpha\" \"one\"", 1, 0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[1024];
        snprintf(text, sizeof(text),
                 "WorldBegin " GREY "Texture \"one\" \"float\" \"constant\" "
                 "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] %s",
                 rows[i].alpha);
        struct scene *scene = scene_of(text);
        assert_int_equal(scene->mesh_count, rows[i].meshes);
        assert_int_equal(scene->texture_count, rows[i].textures);
        if (scene->mesh_count > 0)
            assert_int_equal(scene->meshes[0].alpha, rows[i].textures);
        scene_free(scene);
    }
}

/* --- Files and names ---------------------------------------------------------------------- */

static void pictures_are_found_beside_the_file_that_names_them(void **state)
{
    (void)state;
    static const char included[] = "Texture \"t\" \"spectrum\" \"imagemap\" "
                                   "\"string filename\" \"color.tga\" "
                                   "Texture \"u\" \"spectrum\" \"imagemap\" "
                                   "\"string filename\" \"grey.tga\" ";
    scratch_write(scratch_path(folder, "pictures/part.pbrt"), included, sizeof(included) - 1);
    struct scene *scene = scene_of("WorldBegin Include \"pictures/part.pbrt\" "
                                   "Material \"mixture\" \"texture diffuse\" \"t\" "
                                   "\"texture specular\" \"u\" Shape \"sphere\"");
    assert_int_equal(scene->picture_count, 2);
    scene_free(scene);
}

static void odd_texels_are_noted(void **state)
{
    (void)state;
    struct scene_notes notes;
    struct scene *scene = reader_text_scene(
        "WorldBegin Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"odd.pfm\" "
        "Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\"",
        scratch_path(folder, "text.pbrt"), &notes);
    assert_int_equal(notes_saying(&notes, "odd.pfm: 1 texels that are no colour"), 1);
    scene_notes_free(&notes);
    scene_free(scene);
}

static void float_and_spectrum_textures_have_names_of_their_own(void **state)
{
    (void)state;
    struct scene *scene = scene_of(
        "WorldBegin Texture \"t\" \"spectrum\" \"checkerboard\" Texture \"t\" \"float\" \"fbm\" "
        "Material \"diffuse\" \"texture reflectance\" \"t\" \"texture displacement\" \"t\" "
        "Shape \"sphere\"");
    const uint32_t *slots = scene->materials[0].texture;
    assert_int_equal(scene->textures[slots[SLOT_REFLECTANCE] - 1].kind, TEXTURE_CHECKERBOARD);
    assert_int_equal(scene->textures[slots[SLOT_BUMP] - 1].kind, TEXTURE_FBM);
    scene_free(scene);
}

#define W   "WorldBegin\n"
#define IMG "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"pictures/color.tga\" "

static void whatever_is_wrong_is_said_with_its_position(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
        enum err_code code;
    } rows[] = {
        { W "Texture \"t\" \"spectrum\" \"imagmap\"", "text.pbrt:2:24: unknown texture \"imagmap\"",
          ERR_SCENE },
        { W "Texture \"t\" \"color\" \"constant\"", "text.pbrt:2:13: type of texture \"color\" is",
          ERR_SCENE },
        { W "Texture \"t\" \"spectrum\" \"ptex\"", "texture \"ptex\" is not supported yet",
          ERR_UNSUPPORTED },
        { W "Texture \"t\" \"spectrum\" \"fbm\"",
          "text.pbrt:2:24: there is no spectrum texture \"fbm\", but a float one", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"marble\"", "but a spectrum one", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"fbm\" Texture \"t\" \"float\" \"windy\"",
          "text.pbrt:2:35: float texture \"t\" is defined twice", ERR_SCENE },
        { W "Texture \"t\" \"spectrum\" \"imagemap\"", "wants \"string filename\"", ERR_SCENE },
        { W IMG "\"string wrap\" \"octahedralsphere\"",
          "wrap mode \"octahedralsphere\" is not supported yet", ERR_UNSUPPORTED },
        { W IMG "\"string wrap\" \"mirror\"", "unknown wrap mode \"mirror\"", ERR_SCENE },
        { W IMG "\"string filter\" \"lanczos\"", "unknown texture filter", ERR_SCENE },
        { W IMG "\"string encoding\" \"gamma\"", "\"gamma\" is no encoding", ERR_SCENE },
        { W IMG "\"string encoding\" \"gamma -1\"", "\"gamma -1\" is no encoding", ERR_SCENE },
        { W IMG "\"string mapping\" \"planer\"", "the nearest is \"planar\"", ERR_SCENE },
        { W IMG "\"float uscal\" 3", "the nearest is \"uscale\"", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"fbm\" \"integer octaves\" 65", "65 octaves are outside",
          ERR_SCENE },
        { W "Texture \"t\" \"float\" \"checkerboard\" \"integer dimension\" 4",
          "2 or 3 dimensions, not 4", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"directionmix\" \"vector dir\" [0 0 0]", "has no direction",
          ERR_SCENE },
        { W "Texture \"wood\" \"spectrum\" \"checkerboard\" "
            "Material \"diffuse\" \"texture reflectance\" \"woud\"",
          "text.pbrt:2:83: no spectrum texture \"woud\"; the nearest is \"wood\"", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"fbm\" Material \"diffuse\" \"texture reflectance\" \"t\"",
          "\"t\" is a float texture, and a spectrum texture is wanted here", ERR_SCENE },
        { W "Material \"diffuse\" \"texture displacement\" \"t\"",
          "no texture \"t\": no float texture has been named", ERR_SCENE },
        { W "Texture \"t\" \"float\" \"scale\" \"texture tex\" \"t\"", "no texture \"t\"",
          ERR_SCENE },
        { W "Material \"diffuse\" \"texture reflectance\" [\"a\" \"b\"]", "wants one name",
          ERR_SCENE },
        { W "Texture \"t\" \"spectrum\" \"checkerboard\" Material \"conductor\" "
            "\"texture reflectance\" \"t\" \"rgb k\" [1 1 1]",
          "either reflectance or eta and k", ERR_SCENE },
        { W "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"none.png\" "
            "Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\"",
          "none.png: cannot be opened", ERR_IO },
        { W "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\"\n\"cut.tga\" "
            "Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\"",
          "text.pbrt:3:1: ", ERR_SCENE },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        reader_text_refused(rows[i].text, scratch_path(folder, "text.pbrt"), rows[i].code,
                            rows[i].says);
}

/* Each doubles the work of the one before */
static void textures_of_too_many_parts_are_refused(void **state)
{
    (void)state;
    char text[4096] = W "Texture \"0\" \"float\" \"fbm\" ";
    for (int i = 1; i < 10; i++)
        snprintf(
            text + strlen(text), sizeof(text) - strlen(text),
            "Texture \"%d\" \"float\" \"mix\" \"texture tex1\" \"%d\" \"texture tex2\" \"%d\" ", i,
            i - 1, i - 1);
    reader_text_refused(text, NULL, ERR_OK, "made of more than 64 textures");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_imagemap_has_its_file_wrap_filter_and_encoding),
        cmocka_unit_test(without_filtering_a_picture_has_no_smaller_versions),
        cmocka_unit_test(a_float_imagemap_is_one_channel),
        cmocka_unit_test(textures_are_made_of_textures),
        cmocka_unit_test(patterns_have_their_colours_and_defaults),
        cmocka_unit_test(noises_have_their_numbers),
        cmocka_unit_test(mappings_go_from_the_world_to_the_texture),
        cmocka_unit_test(what_does_not_vary_is_a_number),
        cmocka_unit_test(scaling_by_a_number_happens_in_the_picture),
        cmocka_unit_test(what_is_not_used_is_not_in_the_scene),
        cmocka_unit_test(one_picture_serves_many_textures),
        cmocka_unit_test(every_parameter_has_its_slot),
        cmocka_unit_test(numbers_beside_textures_are_kept),
        cmocka_unit_test(a_normal_map_is_linear),
        cmocka_unit_test(alpha_cuts_meshes),
        cmocka_unit_test(pictures_are_found_beside_the_file_that_names_them),
        cmocka_unit_test(odd_texels_are_noted),
        cmocka_unit_test(float_and_spectrum_textures_have_names_of_their_own),
        cmocka_unit_test(whatever_is_wrong_is_said_with_its_position),
        cmocka_unit_test(textures_of_too_many_parts_are_refused),
    };
    return cmocka_run_group_tests(tests, make_pictures, remove_pictures);
}
