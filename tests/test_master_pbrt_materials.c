/* Goal: the materials of pbrt-v4 that are sheets, coats over metal, or not there are read with
 * pbrt's names and defaults. The others are test_master_pbrt's. */
#include "common/effects.h"
#include "master/coat.h"
#include "tests/reader_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

/* A sphere of the material that `text` makes current */
static struct scene *scene_with(const char *text, struct scene_notes *notes)
{
    char whole[2000];
    snprintf(whole, sizeof(whole), "WorldBegin %s Shape \"sphere\"", text);
    return reader_text_scene(whole, NULL, notes);
}

static void expect_refused(const char *text, const char *why)
{
    char whole[2000];
    snprintf(whole, sizeof(whole), "WorldBegin %s Shape \"sphere\"", text);
    reader_text_refused(whole, NULL, ERR_OK, why);
}

static void panes_have_an_index(void **state)
{
    (void)state;
    struct scene *s = scene_with("Material \"thindielectric\"", NULL);
    assert_int_equal(s->materials[0].kind, MATERIAL_THIN_DIELECTRIC);
    EXPECT_NEAR((double)s->materials[0].ior, 1.5, 0);
    assert_int_equal(s->settings.effects & ~(unsigned)FX_FILTER_ANY, FX_QUADRIC | FX_THIN);
    scene_free(s);
    s = scene_with("Material \"thindielectric\" \"float eta\" 1.33", NULL);
    EXPECT_NEAR((double)s->materials[0].ior, 1.33, 1e-6);
    scene_free(s);
    expect_refused("Material \"thindielectric\" \"float roughness\" .1", "unknown parameter");
    expect_refused("Material \"thindielectric\" \"float eta\" 0", "index of refraction of 0");
}

static void sheets_reflect_and_transmit(void **state)
{
    (void)state;
    struct scene *s = scene_with("Material \"diffusetransmission\"", NULL);
    assert_int_equal(s->materials[0].kind, MATERIAL_DIFFUSE_TRANSMISSION);
    EXPECT_NEAR((double)s->materials[0].reflectance[1], 0.25, 0);
    EXPECT_NEAR((double)s->materials[0].specular[2], 0.25, 0);
    assert_int_equal(s->settings.effects & ~(unsigned)FX_FILTER_ANY, FX_QUADRIC | FX_THIN);
    scene_free(s);
    s = scene_with(
        "Material \"diffusetransmission\" \"rgb reflectance\" [.1 .2 .3] \"rgb transmittance\" "
        "[.4 .5 .8] \"float scale\" .5",
        NULL);
    EXPECT_NEAR((double)s->materials[0].reflectance[2], 0.15, 1e-7);
    EXPECT_NEAR((double)s->materials[0].specular[0], 0.2, 1e-7);
    scene_free(s);

    /* As in pbrt each is clamped to one; that both make more is said */
    struct scene_notes notes = { 0 };
    s = scene_with("Material \"diffusetransmission\" \"rgb reflectance\" [.6 .6 .6] \"float scale\""
                   " 2",
                   &notes);
    EXPECT_NEAR((double)s->materials[0].reflectance[0], 1, 0);
    EXPECT_NEAR((double)s->materials[0].specular[0], 0.5, 0);
    assert_true(notes_saying(&notes, "more than is received") == 1);
    scene_notes_free(&notes);
    scene_free(s);
    expect_refused("Material \"diffusetransmission\" \"float scale\" -1", "a scale of -1");
}

static void coated_metals_have_pbrts_defaults(void **state)
{
    (void)state;
    struct scene *s = scene_with("Material \"coatedconductor\"", NULL);
    const struct material *m = &s->materials[0];
    assert_int_equal(m->kind, MATERIAL_COATED_CONDUCTOR);
    EXPECT_NEAR((double)m->ior, 1.5, 0);
    EXPECT_NEAR((double)m->eta[0], 0.2, 0.1); /* copper is red */
    assert_true(m->k[0] > 2.5f && m->eta[2] > m->eta[0]);
    EXPECT_NEAR((double)(m->alpha[0] + m->base_alpha[0]), 0, 0);
    assert_int_equal(s->settings.effects & ~(unsigned)FX_FILTER_ANY,
                     FX_QUADRIC | FX_COATED_CONDUCTOR);
    assert_int_equal(s->coat_table_count, COAT_METAL_ROWS);
    static struct coat_metal want;
    coat_metal_tabulate(0, 0, 1.5, 0.01, &want);
    assert_memory_equal(s->coat_tables, want.rows, sizeof(want.rows));
    scene_free(s);
}

static void coated_metals_take_both_roughnesses(void **state)
{
    (void)state;
    struct scene *s = scene_with(
        "Material \"coatedconductor\" \"float interface.roughness\" .04 \"float "
        "conductor.uroughness\" .09 \"float conductor.vroughness\" .25 \"float interface.eta\" 1.4 "
        "\"rgb reflectance\" [.5 .5 .5] \"float thickness\" .1 \"integer maxdepth\" 100 "
        "\"integer nsamples\" 4 \"float g\" 0 Shape \"sphere\" "
        "Material \"coatedconductor\" \"float interface.roughness\" .2 \"float "
        "conductor.roughness\" .5 \"bool remaproughness\" false",
        NULL);
    const struct material *m = s->materials;
    EXPECT_NEAR((double)m[0].alpha[0], 0.2, 1e-7);
    EXPECT_NEAR((double)m[0].alpha[1], 0.2, 1e-7);
    EXPECT_NEAR((double)m[0].base_alpha[0], 0.3, 1e-7);
    EXPECT_NEAR((double)m[0].base_alpha[1], 0.5, 1e-7);
    EXPECT_NEAR((double)m[0].ior, 1.4, 1e-6);
    EXPECT_NEAR((double)m[0].k[1], 2, 1e-6);
    EXPECT_NEAR((double)m[1].base_alpha[1], 0.5, 1e-7);
    EXPECT_NEAR((double)m[1].alpha[1], 0.2, 1e-7);
    assert_int_equal(m[1].coat_table, COAT_METAL_ROWS);
    assert_int_equal(s->settings.effects & ~(unsigned)FX_FILTER_ANY,
                     FX_QUADRIC | FX_COATED_CONDUCTOR | FX_ROUGH | FX_ANISOTROPIC);
    scene_free(s);
    expect_refused("Material \"coatedconductor\" \"float roughness\" .1", "unknown parameter");
    expect_refused("Material \"coatedconductor\" \"float interface.eta\" 20", "outside .1 to 10");
    expect_refused("Material \"coatedconductor\" \"rgb reflectance\" [1 1 1] \"rgb conductor.k\" "
                   "[1 1 1]",
                   "either reflectance or");
    expect_refused("Material \"coatedconductor\" \"rgb albedo\" [.1 0 0]", "not supported yet");
}

static void hundreds_of_coats_share_tables_and_that_is_said(void **state)
{
    (void)state;
    static char text[60000];
    for (int many = 0; many < 2; many++) {
        size_t at = (size_t)snprintf(text, sizeof(text), "WorldBegin ");
        for (int i = 0; i < (many ? 400 : 100); i++)
            at += (size_t)snprintf(text + at, sizeof(text) - at,
                                   "Material \"coateddiffuse\" \"float roughness\" %g "
                                   "\"float eta\" %g Shape \"sphere\" ",
                                   0.001 + 0.002 * i, 1.3 + 0.001 * i);
        struct scene_notes notes = { 0 };
        struct scene *s = reader_text_scene(text, NULL, &notes);
        assert_int_equal(notes_saying(&notes, "different coats share tables"), many);
        assert_in_range(s->coat_table_count, 100, 300);
        for (uint32_t i = 0; i < s->material_count; i++) { /* the lobes stay as they are */
            EXPECT_NEAR(s->materials[i].alpha[0], sqrt(0.001 + 0.002 * i), 1e-6);
            EXPECT_NEAR(s->materials[i].ior, 1.3 + 0.001 * i, 1e-6);
        }
        scene_notes_free(&notes);
        scene_free(s);
    }
}

static void only_two_widths_that_differ_are_anisotropic(void **state)
{
    (void)state;
    static const char *const kinds[] = { "conductor", "dielectric", "coateddiffuse" };
    for (int i = 0; i < 3; i++) {
        char text[300];
        snprintf(text, sizeof(text), "Material \"%s\" \"float uroughness\" .1", kinds[i]);
        struct scene *s = scene_with(text, NULL);
        assert_true(s->settings.effects & FX_ANISOTROPIC);
        scene_free(s);
        snprintf(text, sizeof(text), "Material \"%s\" \"float roughness\" .1", kinds[i]);
        s = scene_with(text, NULL);
        assert_false(s->settings.effects & FX_ANISOTROPIC);
        scene_free(s);
    }
}

static void interfaces_are_not_there_and_give_no_light(void **state)
{
    (void)state;
    static const char *const names[] = { "interface", "" };
    for (int i = 0; i < 2; i++) {
        char text[300];
        struct scene_notes notes = { 0 };
        snprintf(text, sizeof(text),
                 "Material \"%s\" AreaLightSource \"diffuse\" Shape \"sphere\" Material "
                 "\"diffuse\"",
                 names[i]);
        struct scene *s = scene_with(text, &notes);
        assert_int_equal(s->material_count, 1);
        assert_int_equal(s->light_count, 1);
        assert_int_equal(s->quadrics[0].material, SCENE_NONE);
        assert_int_equal(s->quadrics[0].light, SCENE_NONE);
        assert_int_equal(s->quadrics[1].material, 0);
        assert_true(notes_saying(&notes, "gives no light") == 1);
        scene_notes_free(&notes);
        scene_free(s);
    }
    expect_refused("MakeNamedMaterial \"a\" \"string type\" \"interface\" MakeNamedMaterial \"m\" "
                   "\"string type\" \"mix\" \"string materials\" [\"a\" \"a\"] NamedMaterial \"m\"",
                   "cannot be part of a mix");
}

static void sheets_and_coated_metals_mix(void **state)
{
    (void)state;
    struct scene *s = scene_with(
        "MakeNamedMaterial \"a\" \"string type\" \"coatedconductor\" "
        "MakeNamedMaterial \"b\" \"string type\" \"diffusetransmission\" "
        "MakeNamedMaterial \"m\" \"string type\" \"mix\" \"string materials\" [\"a\" \"b\"] "
        "NamedMaterial \"m\"",
        NULL);
    assert_int_equal(s->material_count, 3);
    assert_int_equal(s->settings.effects & ~(unsigned)FX_FILTER_ANY,
                     FX_QUADRIC | FX_MIX | FX_THIN | FX_COATED_CONDUCTOR);
    scene_free(s);
}

static void sheets_and_coated_metals_take_textures(void **state)
{
    (void)state;
#define CHECKS \
    "Texture \"t\" \"spectrum\" \"checkerboard\" Texture \"f\" \"float\" \"checkerboard\" "
    struct scene *s = scene_with(CHECKS
                                 "Material \"coatedconductor\" \"texture reflectance\" \"t\" "
                                 "\"texture interface.roughness\" \"f\" Shape \"sphere\" "
                                 "Material \"diffusetransmission\" \"texture transmittance\" \"t\"",
                                 NULL);
    const struct material *m = s->materials;
    assert_true(m[0].texture[SLOT_REFLECTANCE] != 0 && (m[0].flags & MATERIAL_METAL));
    assert_true(m[0].texture[SLOT_ROUGHNESS_U] != 0 && (m[0].flags & MATERIAL_COATS));
    assert_int_equal(m[0].texture[SLOT_ROUGHNESS_U], m[0].texture[SLOT_ROUGHNESS_V]);
    assert_int_equal(s->coat_table_count, COAT_METAL_ROWS * COAT_ALPHAS + 1);
    assert_true(m[1].texture[SLOT_SPECULAR] != 0 && m[1].texture[SLOT_REFLECTANCE] == 0);
    assert_false(s->settings.effects & FX_ANISOTROPIC);
    scene_free(s);
    s = scene_with(CHECKS "Material \"coateddiffuse\" \"texture roughness\" \"f\"", NULL);
    assert_int_equal(s->coat_table_count, COAT_ALPHAS + 1);
    assert_true(s->materials[0].flags & MATERIAL_COATS);
    scene_free(s);
    expect_refused(CHECKS "Material \"diffusetransmission\" \"texture reflectance\" \"t\" "
                          "\"float scale\" .5",
                   "not supported yet");
}

static void what_is_not_supported_yet_says_so(void **state)
{
    (void)state;
    static const char *const kinds[] = { "hair", "measured", "subsurface" };
    for (int i = 0; i < 3; i++) {
        char text[100];
        snprintf(text, sizeof(text), "Material \"%s\"", kinds[i]);
        expect_refused(text, "not supported yet");
    }
    expect_refused("Material \"translucent\"", "in pbrt-v4 it is \"diffusetransmission\"");
    expect_refused("Material \"none\"", "in pbrt-v4 it is \"interface\"");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(panes_have_an_index),
        cmocka_unit_test(sheets_reflect_and_transmit),
        cmocka_unit_test(coated_metals_have_pbrts_defaults),
        cmocka_unit_test(coated_metals_take_both_roughnesses),
        cmocka_unit_test(hundreds_of_coats_share_tables_and_that_is_said),
        cmocka_unit_test(only_two_widths_that_differ_are_anisotropic),
        cmocka_unit_test(interfaces_are_not_there_and_give_no_light),
        cmocka_unit_test(sheets_and_coated_metals_mix),
        cmocka_unit_test(sheets_and_coated_metals_take_textures),
        cmocka_unit_test(what_is_not_supported_yet_says_so),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
