/*
 * Goal: a sheen over any material passes every check of a BSDF (tests/bsdf_checks.h), reflects what
 * its formula says, takes that much from what lies below, and is the same in every lane. Each
 * statistical test also runs with a planted bug, which it must catch. H numbers are those of the
 * numerics notes, section 2.
 */
#include "common/sheen.h"
#include "tests/bsdf_checks.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/textured.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

enum {
    ALONE, /* fibres of the widths of `alphas`, on black */
    MATTE = ALONE + 5,
    MATTE_WHITE,
    PAINT,
    MIRROR,
    METAL,
    GLASS,
    GLASS_ROUGH,
    PANE,
    COAT,
    COAT_ROUGH,
    COATED_METAL,
    SHEET,
    MATERIALS
};

static const char *const names[MATERIALS] = {
    "sheen of 1/256",    "sheen of .01",           "sheen of .06",          "sheen of .3",
    "sheen of 1",        "sheen on matte",         "sheen on white",        "sheen on paint",
    "sheen on a mirror", "sheen on metal",         "sheen on glass",        "sheen on rough glass",
    "sheen on a pane",   "sheen on a smooth coat", "sheen on a rough coat", "sheen on coated metal",
    "sheen on a sheet",
};

static const float alphas[] = { SHEEN_ALPHA_LEAST, 0.01f, 0.06f, 0.3f, 1 };

/* The table of sheens; that of a smooth interface; and three rows of a coated metal's */
enum { ROW_COAT = SHEEN_ROWS, ROW_METAL, ROWS = ROW_METAL + COAT_METAL_ROWS };
static float tables[ROWS][COAT_TABLE_LEN];
static struct material materials[MATERIALS];
static struct subject subjects[MATERIALS];
static struct scene scene = { .settings = { .effects = (uint32_t)FX_SHEEN },
                              .materials = materials,
                              .material_count = MATERIALS,
                              .coat_tables = tables[0],
                              .coat_table_count = ROWS };

/* ---- fixtures */

static void fill_tables(void)
{
    sheen_tabulate(tables);
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        f8 cos_t, root = F8((float)i / (COAT_TABLE_LEN - 1));
        float F = fresnel_dielectric(root * root, F8(1.5f), &cos_t)[0];
        tables[ROW_COAT][i] = tables[ROW_METAL + COAT_ENTER][i] = 1 - F;
        tables[ROW_METAL + COAT_RETURN][i] = F;
        tables[ROW_METAL + COAT_SPREAD][i] = 0.2f - 0.1f * root[0];
    }
}

static struct material coat_of_width(float alpha)
{
    return (struct material){ .kind = MATERIAL_COAT,
                              .ior = 1.5f,
                              .alpha = { alpha, alpha },
                              .reflectance = { 0.7f, 0.5f, 0.3f },
                              .coat_table = ROW_COAT,
                              .coat_inner = 0.596345759708f,
                              .coat_scale = (float)(1 / (M_PI * 2.25)) };
}

static int materials_fill(void **state)
{
    (void)state;
    static const struct material metal = { .kind = MATERIAL_CONDUCTOR,
                                           .eta = { 0.2f, 0.9f, 1.1f },
                                           .k = { 3.9f, 2.4f, 2.1f },
                                           .alpha = { 0.2f, 0.2f } };
    fill_tables();
    materials[MATTE] = (struct material){ .reflectance = { 0.7f, 0.5f, 0.3f } };
    materials[MATTE_WHITE] = (struct material){ .reflectance = { 1, 1, 1 } };
    materials[PAINT] = (struct material){ .kind = MATERIAL_MIXTURE,
                                          .reflectance = { 0.5f, 0.25f, 0.25f },
                                          .specular = { 0.3f, 0.2f, 0.1f } };
    materials[MIRROR] = (struct material){ .kind = MATERIAL_MIXTURE, .specular = { 1, 1, 1 } };
    materials[METAL] = metal;
    materials[GLASS] = (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f };
    materials[GLASS_ROUGH] = materials[GLASS];
    materials[GLASS_ROUGH].alpha[0] = materials[GLASS_ROUGH].alpha[1] = 0.3f;
    materials[PANE] = (struct material){ .kind = MATERIAL_THIN_DIELECTRIC, .ior = 1.5f };
    materials[COAT] = coat_of_width(0);
    materials[COAT_ROUGH] = coat_of_width(0.3f);
    materials[COATED_METAL] = metal;
    materials[COATED_METAL].kind = MATERIAL_COATED_CONDUCTOR;
    materials[COATED_METAL].ior = 1.5f;
    materials[COATED_METAL].base_alpha[0] = materials[COATED_METAL].base_alpha[1] = 0.3f;
    materials[COATED_METAL].coat_table = ROW_METAL;
    materials[COATED_METAL].coat_inner = 0.6f;
    materials[COATED_METAL].coat_scale = 3;
    materials[SHEET] = (struct material){ .kind = MATERIAL_DIFFUSE_TRANSMISSION,
                                          .reflectance = { 0.5f, 0.3f, 0.1f },
                                          .specular = { 0.2f, 0.3f, 0.6f },
                                          .ior = 1 };
    for (int id = 0; id < MATERIALS; id++) {
        struct material *m = &materials[id];
        bool white = id < MATTE || id == MATTE_WHITE || id == MIRROR;
        m->flags |= MATERIAL_SHEEN;
        m->sheen[0] = 1;
        m->sheen[1] = white ? 1 : 0.6f;
        m->sheen[2] = white ? 1 : 0.2f;
        m->sheen_alpha = id < MATTE ? alphas[id] : id % 2 ? 0.3f : 0.09f;
        subjects[id] = (struct subject){ names[id], &scene, m };
    }
    return 0;
}

static double row_at(const float row[COAT_TABLE_LEN], double mu)
{
    double x = sqrt(mu) * (COAT_TABLE_LEN - 1);
    int i = x < COAT_TABLE_LEN - 2 ? (int)x : COAT_TABLE_LEN - 2;
    return (1 - (x - i)) * (double)row[i] + (x - i) * (double)row[i + 1];
}

/* ---- the lobe against the extension's formulas, in double and by libm */

static double fit(double x, double alpha)
{
    double t = (1 - alpha) * (1 - alpha);
    double a = 21.5473 + t * (25.3245 - 21.5473), b = 3.82987 + t * (3.32435 - 3.82987);
    double c = 0.19823 + t * (0.16801 - 0.19823), d = -1.97760 + t * (-1.27393 + 1.97760);
    double e = -4.32054 + t * (-4.85967 + 4.32054);
    return a / (1 + b * pow(x, c)) + d * x + e;
}

static double lambda(double mu, double alpha)
{
    return mu < 0.5 ? exp(fit(mu, alpha)) : exp(2 * fit(0.5, alpha) - fit(1 - mu, alpha));
}

/* Of directions at these cosines, `turn` apart about the normal, times the cosine of wi */
static double formula(double co, double ci, double turn, double alpha)
{
    double so = sqrt(1 - co * co), si = sqrt(1 - ci * ci);
    double x = so + si * cos(turn), y = si * sin(turn), z = co + ci;
    double sine2 = (x * x + y * y) / (x * x + y * y + z * z);
    double D = (2 + 1 / alpha) * pow(sine2, 0.5 / alpha) / (2 * M_PI);
    return D / (4 * co * (1 + lambda(co, alpha) + lambda(ci, alpha)));
}

static void the_value_is_that_of_the_extension(void **state)
{
    (void)state;
    struct random_lanes r = { 1, 0 };
    for (int k = 0; k < 3000; k++) {
        double co = random_double(&r), ci = random_double(&r), turn = 2 * M_PI * random_double(&r);
        double alpha = (double)alphas[k % 5];
        if (co < 1e-3 || ci < 1e-3)
            continue;
        double so = sqrt(1 - co * co), si = sqrt(1 - ci * ci);
        struct vec3x8 wo = vec3x8_all((float)so, 0, (float)co),
                      wi = vec3x8_all((float)(si * cos(turn)), (float)(si * sin(turn)), (float)ci);
        double want = formula(co, ci, turn, alpha);
        double got = (double)sheen_value(wo, wi, F8((float)alpha))[k % LANES];
        /* Half of 1 / alpha times the rounding of a logarithm; tiny values have large ones */
        EXPECT_NEAR(got, want, (3e-5 + 3e-6 / alpha) * want + 1e-9);
    }
    /* Straight up there are no fibres to see */
    struct vec3x8 up = vec3x8_all(0, 0, 1);
    EXPECT_NEAR(sheen_value(up, up, F8(0.3f))[0], 0, 0);
}

static void the_table_is_what_fibres_send_back(void **state)
{
    (void)state;
    enum { STEPS = 200 };
    int caught = 0, runs = 0;
    for (int j = 0; j < SHEEN_ALPHAS; j += 6)
        for (double co = 0.04; co < 1; co *= 1.7) {
            double root = (double)(SHEEN_FIRST + j) / 64, alpha = root * root * root * root;
            const float *bounds = tables[SHEEN_ALPHAS + j];
            double sum = 0, unbound = 0;
            for (int i = 0; i < STEPS; i++)
                for (int k = 0; k < STEPS / 4; k++) {
                    double at = (i + 0.5) / STEPS, turn = M_PI * (k + 0.5) / (STEPS / 4);
                    double f = formula(co, at * at, turn, alpha) * 2 * at;
                    unbound += f;
                    sum += f * fmin(row_at(bounds, co), row_at(bounds, at * at));
                }
            double scale = 2 * M_PI / (STEPS * (STEPS / 4)), got = row_at(tables[j], co);
            sum *= scale;
            unbound *= scale;
            /* Half a per cent more, and as much between entries: see sheen.h */
            if (!(got >= sum - 2e-3 && got <= sum * 1.012 + 2e-3 && got <= 1 && sum <= 1))
                fail_msg("width %g, cosine %g: %g, want %g", alpha, co, got, sum);
            if (!(root < 0.5 || row_at(bounds, co) >= 0.995))
                fail_msg("width %g, cosine %g: bound %g", alpha, co, row_at(bounds, co));
            if (!(unbound <= 1.01 || row_at(bounds, co) <= 1.005 / unbound))
                fail_msg("width %g, cosine %g: bound %g of %g", alpha, co, row_at(bounds, co),
                         unbound);
            runs++;
            caught += !(got >= 1.03 * sum - 2e-3); /* planted */
        }
    assert_true(runs > 50 && caught > runs / 2); /* where there is hardly any, 3 % are nothing */
}

static double albedo(int id, double cosine, int channel, struct tally *t)
{
    *t = subject_albedo(&subjects[id], cosine, channel, 20000, 11);
    return tally_mean(t);
}

static void fibres_on_black_return_their_albedo(void **state)
{
    (void)state;
    for (int id = ALONE; id < MATTE; id++)
        for (double c = 0.03; c < 1; c *= 2.1) {
            struct tally t;
            struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(id));
            struct sheen8 sheen = sheen_of(&b, I8(-1));
            double got = albedo(id, c, 0, &t), noise = 4.5 * sqrt(tally_variance(&t) / t.n);
            double want = (double)sheen_entry(&b, &sheen, 0, F8((float)c))[0];
            if (!(got <= want + noise + 1e-5 && got >= want * 0.988 - noise - 1e-5))
                fail_msg("%s, cosine %g: %g +- %g, want %g", names[id], c, got, noise, want);
        }
}

/* ---- with what lies below */

static void the_share_below_is_what_the_extension_leaves(void **state)
{
    (void)state;
    struct random_lanes r = { 3, 0 };
    struct material bare = materials[SHEET];
    bare.flags = 0;
    const struct subject below = { "sheet", &scene, &bare };
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(SHEET));
    struct sheen8 sheen = sheen_of(&b, I8(-1));
    for (int k = 0; k < 3000; k++) {
        struct vec3x8 wo = random_direction(&r), wi = random_direction(&r);
        f8 o = sheen_entry(&b, &sheen, 0, f8_abs(wo.z)),
           i = sheen_entry(&b, &sheen, 0, f8_abs(wi.z));
        f8 bound = f8_min(sheen_entry(&b, &sheen, SHEEN_ALPHAS, f8_abs(wo.z)),
                          sheen_entry(&b, &sheen, SHEEN_ALPHAS, f8_abs(wi.z)));
        struct vec3x8 up_o = { wo.x, wo.y, f8_abs(wo.z) }, up_i = { wi.x, wi.y, f8_abs(wi.z) };
        f8 fibres = sheen_value(up_o, up_i, F8(bare.sheen_alpha)) * bound;
        struct bsdf_eval8 with = subject_eval(&subjects[SHEET], &wo, &wi, false),
                          without = subject_eval(&below, &wo, &wi, false);
        for (int lane = 0; lane < LANES; lane++) {
            float left = 1 - fmaxf(o[lane], i[lane]); /* the colour's largest is 1 */
            float f = wo.z[lane] * wi.z[lane] > 0 ? fibres[lane] : 0;
            EXPECT_NEAR(with.f_cos.x[lane], without.f_cos.x[lane] * left + f, 1e-6 + 1e-5 * f);
            EXPECT_NEAR(with.f_cos.z[lane], without.f_cos.z[lane] * left + 0.2f * f,
                        1e-6 + 1e-5 * f);
        }
    }
}

/* Over a mirror, wi is at the same cosine as wo: nothing is lost, and nothing made */
static void a_mirror_and_white_fibres_return_all_the_light(void **state)
{
    (void)state;
    for (size_t j = 0; j < sizeof(alphas) / sizeof(alphas[0]); j++)
        for (double c = 0.02; c <= 1; c *= 1.9) {
            struct tally t;
            materials[MIRROR].sheen_alpha = alphas[j];
            double got = albedo(MIRROR, c, 0, &t), noise = 4.5 * sqrt(tally_variance(&t) / t.n);
            if (!(got <= 1 + noise && got >= 0.988 - noise))
                fail_msg("width %g, cosine %g: %g +- %g", (double)alphas[j], c, got, noise);
        }
    materials[MIRROR].sheen_alpha = 0.3f;
    float kept[SHEEN_ALPHAS][COAT_TABLE_LEN];
    memcpy(kept, tables, sizeof(kept));
    for (int j = 0; j < SHEEN_ALPHAS; j++)
        for (int i = 0; i < COAT_TABLE_LEN; i++)
            tables[j][i] *= 0.96f; /* planted: too little is taken from the mirror */
    assert_true(checks_energy(&subjects[MIRROR], 1) > 4.5);
    memcpy(tables, kept, sizeof(kept));
}

static void nothing_returns_more_than_it_gets(void **state)
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++) {
        double z = checks_energy(&subjects[id], 1);
        if (z > 4.5)
            fail_msg("%s: %g standard errors more than all the light", names[id], z);
    }
    /* Over white, the smaller share of both directions loses some; not much */
    for (double c = 0.05; c <= 1; c += 0.19) {
        struct tally t;
        double got = albedo(MATTE_WHITE, c, 1, &t);
        if (!(got > 0.75))
            fail_msg("white below white fibres, cosine %g: %g", c, got);
    }
    assert_true(checks_energy(&subjects[MIRROR], 1.02) > 4.5); /* planted */
}

static void no_colour_is_no_sheen(void **state)
{
    (void)state;
    for (int id = MATTE; id < MATERIALS; id++) {
        struct random_lanes r = { 70, 0 };
        struct material with = materials[id], without = materials[id];
        memset(with.sheen, 0, sizeof(with.sheen));
        without.flags = 0;
        const struct subject a = { names[id], &scene, &with }, b = { names[id], &scene, &without };
        for (int k = 0; k < 500; k++) {
            struct vec3x8 wo = random_direction(&r), wi = random_direction(&r);
            struct bsdf_eval8 ea = subject_eval(&a, &wo, &wi, false),
                              eb = subject_eval(&b, &wo, &wi, false);
            assert_memory_equal(&ea, &eb, sizeof(ea));
            f8 u[3] = { random_f8(&r), random_f8(&r), random_f8(&r) };
            struct bsdf_sample8 sa = subject_sample(&a, &wo, u, false),
                                sb = subject_sample(&b, &wo, u, false);
            assert_memory_equal(&sa.wi, &sb.wi, sizeof(sa.wi));
            assert_memory_equal(&sa.pdf, &sb.pdf, sizeof(sa.pdf));
            assert_memory_equal(&sa.valid, &sb.valid, sizeof(sa.valid));
            for (int lane = 0; lane < LANES; lane++)
                if (sa.valid[lane])
                    EXPECT_NEAR(sa.weight.y[lane], sb.weight.y[lane], 3e-7f * sb.weight.y[lane]);
        }
    }
}

static void light_sampling_reaches_fibres_over_a_mirror(void **state)
{
    (void)state;
    static const int smooth[] = { MIRROR, GLASS, PANE };
    for (int k = 0; k < 3; k++) {
        struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(smooth[k]));
        assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 0);
    }
}

static void textures_give_colour_and_width_within_bounds(void **state) /* H29 */
{
    (void)state;
    static const float colors[3][3] = { { 0.25f, 1.5f, -1 }, { 0.3f, 0.3f, 0.3f }, { 0, 0, 0 } };
    const struct texture_point point = { .n = { 0, 0, 1 } };
    struct err err = { .code = ERR_OK };
    struct scene *textured = scenes_begin(1, 1);
    for (int i = 0; i < 3; i++) {
        struct texture *t = &textured->textures[textured->texture_count++];
        *t = (struct texture){ .kind = TEXTURE_CONSTANT, .channel = SCENE_NONE };
        memcpy(t->value[0], colors[i], sizeof(colors[i]));
    }
    struct texture_set *set = texture_set_open(textured, &err);
    assert_non_null(set);
    struct material m = materials[MATTE];
    m.texture[SLOT_SHEEN] = 1;
    m.texture[SLOT_SHEEN_ALPHA] = 2;
    assert_int_equal(textured_parts(&m), TEXTURED_VALUES);
    textured_material(set, &point, &m);
    EXPECT_NEAR(m.sheen[0], 0.25, 0);
    EXPECT_NEAR(m.sheen[1], 1, 0);
    EXPECT_NEAR(m.sheen[2], 0, 0);
    EXPECT_NEAR(m.sheen_alpha, 0.3f, 0);
    m.texture[SLOT_SHEEN_ALPHA] = 3;
    textured_material(set, &point, &m);
    EXPECT_NEAR(m.sheen_alpha, SHEEN_ALPHA_LEAST, 0);
    texture_set_close(set);
    scene_free(textured);
}

/* ---- every check of a BSDF */

static const struct {
    int id, side;
} scatters[] = {
    { ALONE, 0 },       { ALONE + 2, 0 },    { ALONE + 4, 0 }, { MATTE, 0 },
    { PAINT, 0 },       { MIRROR, 1 },       { METAL, 0 },     { GLASS, 1 },
    { GLASS_ROUGH, 1 }, { GLASS_ROUGH, -1 }, { PANE, 1 },      { COAT, 0 },
    { COAT_ROUGH, 0 },  { COATED_METAL, 0 }, { SHEET, 0 },     { SHEET, -1 },
};
#define SCATTERS (sizeof(scatters) / sizeof(scatters[0]))

static void directions_are_distributed_as_their_density_says(void **state) /* H27 */
{
    (void)state;
    const double cosines[] = { 0.9, 0.15, -0.4 };
    for (size_t i = 0; i < SCATTERS; i++)
        for (size_t c = 0; c < 3; c++) {
            struct scatter s = { &subjects[scatters[i].id], at_cosine(cosines[c]), c % 2,
                                 scatters[i].side, SOUND };
            if (s.side < 0 && cosines[c] < 0 && s.of->material->kind == MATERIAL_DIELECTRIC)
                continue; /* beyond the critical angle */
            checks_distribution(&s, 1, 100 * i + c, 2e-3);
        }
    struct scatter s = { &subjects[MATTE], at_cosine(0.15), false, 0, COSINE_DROPPED };
    struct chi2_case test = scatter_case(&s, 1, 1);
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    s.plant = REUSED_NUMBER;
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    s.plant = PDF_LARGE;
    struct chi2_result r = chi2_run(&test);
    assert_false(chi2_scale_right(&r, test.samples, 2e-3));
}

static void weights_values_and_densities_agree(void **state)
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++)
        for (int importance = 0; id != GLASS_ROUGH && importance < 2; importance++)
            checks_agreement(&subjects[id], importance);
    double worst[GAPS];
    /* Glass is sampled with densities of a thousandth's precision, which count in weights here */
    checks_gaps(&subjects[GLASS_ROUGH], SOUND, true, worst);
    assert_true(worst[GAP_WEIGHT] < 1e-4 && worst[GAP_PDF] < 1e-3 && worst[GAP_EXCHANGED] < 3e-2);
    checks_gaps(&subjects[MATTE], WEIGHT_SMALL, false, worst);
    assert_true(worst[GAP_WEIGHT] > 5e-3);
    checks_gaps(&subjects[METAL], PDF_LARGE, false, worst);
    assert_true(worst[GAP_PDF] > 1e-2);
}

static void scattering_is_reciprocal(void **state) /* H30 */
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++)
        checks_both_ways(&subjects[id]);
}

static void the_ends_of_the_unit_interval_are_sound(void **state) /* H28 */
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++)
        checks_corners(&subjects[id], 300);
}

/* ---- pictures */

static void pictures_are_the_same_in_all_lanes(void **state)
{
    (void)state;
    for (int k = 0; k < 2; k++) {
        struct scene *room = scenes_begin(40, 33);
        memcpy(room->coat_tables, tables, sizeof(tables));
        room->coat_table_count = ROWS;
        uint32_t wall = scenes_material(room, materials[k ? COAT_ROUGH : ALONE + 3]);
        uint32_t lamp = scenes_diffuse(room, 0);
        scenes_room(room, wall, lamp);
        scenes_quadric(room, QUADRIC_SPHERE, 0.2f, -0.5f, 0.3f, 0.4f,
                       scenes_material(room, materials[k ? PANE : MIRROR]), 0);
        scenes_finish(room);
        assert_true(room->settings.effects & FX_SHEEN);
        assert_true(scene_check(room, NULL));
        struct picture *p = picture_take(room, (struct picture_how){ .samples = 8 });
        assert_string_equal(p->variant, "everything");
        assert_int_equal(p->failed, 0);
        assert_true(p->mean > 0);
        picture_expect_any_lanes(room, p, 8);
        picture_free(p);
        scene_free(room);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_value_is_that_of_the_extension),
        cmocka_unit_test(the_table_is_what_fibres_send_back),
        cmocka_unit_test(fibres_on_black_return_their_albedo),
        cmocka_unit_test(the_share_below_is_what_the_extension_leaves),
        cmocka_unit_test(a_mirror_and_white_fibres_return_all_the_light),
        cmocka_unit_test(nothing_returns_more_than_it_gets),
        cmocka_unit_test(no_colour_is_no_sheen),
        cmocka_unit_test(textures_give_colour_and_width_within_bounds),
        cmocka_unit_test(light_sampling_reaches_fibres_over_a_mirror),
        cmocka_unit_test(directions_are_distributed_as_their_density_says),
        cmocka_unit_test(weights_values_and_densities_agree),
        cmocka_unit_test(scattering_is_reciprocal),
        cmocka_unit_test(the_ends_of_the_unit_interval_are_sound),
        cmocka_unit_test(pictures_are_the_same_in_all_lanes),
    };
    return cmocka_run_group_tests(tests, materials_fill, NULL);
}
