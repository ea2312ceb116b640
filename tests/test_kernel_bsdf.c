/*
 * Scattering: every BSDF against what it must integrate to, what it claims to sample, and itself in
 * reverse (tests/bsdf_checks.h), and what is known of each in closed form. Materials as readers
 * make them are test_farm_materials.c's. Each statistical test also runs with a planted bug, which
 * it must catch. Runs for about ten seconds. H numbers are those of the numerics notes, section 2.
 */
#include "tests/bsdf_checks.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

enum {
    MATTE,
    BLACK,
    PAINT,
    MIRRORED,
    METAL_1,
    METAL_3,
    METAL_10,
    METAL_SKEW,
    METAL_NARROW,
    METAL_FLAT,
    METAL_TINY,
    GLASS,
    GLASS_1,
    GLASS_4,
    GLASS_NARROW,
    GLASS_THIN,
    GLASS_NONE,
    COAT,
    COAT_1,
    COAT_3,
    WHITE_COAT,
    PERFECT_1,
    PERFECT_5,
    GLASS_TINTED,
    PANE,
    PANE_TINTED,
    SHEET,
    SHEET_CLEAR,
    COATED_FLAT,
    COATED_2,
    COATED_BOTH,
    COATED_SKEW,
    COATS_2,
    COATED_COATS,
    GLASS_SKEW,
    COAT_SKEW,
    MATERIALS
};

static const char *const names[MATERIALS] = {
    "diffuse",
    "black mixture",
    "mixture",
    "mirror mixture",
    "conductor .1",
    "conductor .3",
    "conductor 1",
    "conductor .05 x .4",
    "conductor .01",
    "smooth conductor",
    "conductor below ALPHA_SMOOTH",
    "smooth glass",
    "glass .1",
    "glass .4",
    "glass .01",
    "glass of ior 1.1",
    "glass of ior 1",
    "smooth coat",
    "coat .1",
    "coat .3",
    "white coat",
    "lossless conductor .1",
    "lossless conductor .5",
    "tinted glass .4",
    "pane",
    "tinted pane",
    "diffuse transmission",
    "diffuse transmission of all light",
    "coated smooth conductor",
    "smoothly coated conductor .2",
    "conductor .1 under a coat .3",
    "conductor .1 x .4 under a smooth coat",
    "coat .2 among coats",
    "coated conductor .2 among coats",
    "glass .1 x .5",
    "coat .1 x .4",
};

static struct material materials[MATERIALS];
static struct subject subjects[MATERIALS];
/* A smooth coat; a coated conductor; coats of all widths; coated conductors of all widths */
enum {
    TABLE_METAL = 1,
    TABLE_COATS = TABLE_METAL + COAT_METAL_ROWS,
    TABLE_METAL_COATS = TABLE_COATS + COAT_ALPHAS + 1,
    TABLES = TABLE_METAL_COATS + COAT_METAL_ROWS * COAT_ALPHAS + 1
};
static float coat_table[TABLES * COAT_TABLE_LEN];
static struct scene scene = { .materials = materials,
                              .material_count = MATERIALS,
                              .coat_tables = coat_table,
                              .coat_table_count = TABLES };

/* ---- fixtures */

static void metal(int id, float ax, float ay)
{
    materials[id] = (struct material){ .kind = MATERIAL_CONDUCTOR,
                                       .eta = { 0.2f, 0.9f, 1.1f },
                                       .k = { 3.9f, 2.4f, 2.1f },
                                       .alpha = { ax, ay } };
}

static void glass(int id, float alpha, float ior)
{
    materials[id] = (struct material){ .kind = MATERIAL_DIELECTRIC,
                                       .ior = ior,
                                       .alpha = { alpha, alpha } };
}

/*
 * Coats of thickness 0 on the table of a smooth interface: T = 1 - F. By reciprocity the flux that
 * leaves is T / n^2, so coat_scale is 1 / (pi n^2), and R_in the internal mean of F at n = 1.5.
 */
static void coat(int id, float alpha, float r, float g, float b)
{
    materials[id] = (struct material){ .kind = MATERIAL_COAT,
                                       .ior = 1.5f,
                                       .alpha = { alpha, alpha },
                                       .reflectance = { r, g, b },
                                       .coat_inner = 0.596345759708f,
                                       .coat_scale = (float)(1 / (M_PI * 2.25)) };
}

static void coated(int id, float top, float ax, float ay)
{
    metal(id, top, top);
    materials[id].kind = MATERIAL_COATED_CONDUCTOR;
    materials[id].base_alpha[0] = ax;
    materials[id].base_alpha[1] = ay;
    materials[id].ior = 1.5f;
    materials[id].coat_table = TABLE_METAL;
    materials[id].coat_inner = 0.6f;
    materials[id].coat_scale = 3;
}

/* A coat's rows to begin at `table`: those of a smooth interface, darker by `loss` */
static void coat_rows_fill(float *table, float loss)
{
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        f8 cos_t, root = F8((float)i / (COAT_TABLE_LEN - 1));
        float F = fresnel_dielectric(root * root, F8(1.5f), &cos_t)[0];
        table[COAT_ENTER * COAT_TABLE_LEN + i] = (1 - F) * (1 - loss);
        table[COAT_RETURN * COAT_TABLE_LEN + i] = F * (1 - loss);
        table[COAT_SPREAD * COAT_TABLE_LEN + i] = 0.2f - 0.1f * root[0];
    }
}

static void coats_fill(void)
{
    coat_rows_fill(coat_table + (size_t)TABLE_METAL * COAT_TABLE_LEN, 0);
    static float rows[COAT_METAL_ROWS * COAT_TABLE_LEN];
    float *coats = coat_table + (size_t)TABLE_COATS * COAT_TABLE_LEN;
    float *over_metal = coat_table + (size_t)TABLE_METAL_COATS * COAT_TABLE_LEN;
    for (int j = 0; j < COAT_ALPHAS; j++) {
        coat_rows_fill(rows, 0.05f * (float)j);
        memcpy(coats + j * COAT_TABLE_LEN, rows, COAT_TABLE_LEN * sizeof(float));
        memcpy(over_metal + (size_t)j * COAT_METAL_ROWS * COAT_TABLE_LEN, rows, sizeof(rows));
        coats[COAT_ALPHAS * COAT_TABLE_LEN + j] = 0.596345759708f - 0.02f * (float)j;
        coats[COAT_ALPHAS * COAT_TABLE_LEN + COAT_ALPHAS + j] = (float)(M_PI * 2.25);
        over_metal[COAT_ALPHAS * COAT_METAL_ROWS * COAT_TABLE_LEN + j] = 0.6f;
        over_metal[COAT_ALPHAS * COAT_METAL_ROWS * COAT_TABLE_LEN + COAT_ALPHAS + j] = 1 / 3.0f;
    }
}

static int materials_fill(void **state)
{
    (void)state;
    materials[MATTE] = (struct material){ .reflectance = { 0.7f, 0.5f, 0.3f } };
    materials[BLACK] = (struct material){ .kind = MATERIAL_MIXTURE };
    materials[PAINT] = (struct material){ .kind = MATERIAL_MIXTURE,
                                          .reflectance = { 0.5f, 0.25f, 0.25f },
                                          .specular = { 0.3f, 0.2f, 0.1f } };
    materials[MIRRORED] = (struct material){ .kind = MATERIAL_MIXTURE,
                                             .specular = { 0.9f, 0.8f, 0.7f } };
    metal(METAL_1, 0.1f, 0.1f);
    metal(METAL_3, 0.3f, 0.3f);
    metal(METAL_10, 1, 1);
    metal(METAL_SKEW, 0.05f, 0.4f);
    metal(METAL_NARROW, 0.01f, 0.01f);
    metal(METAL_FLAT, 0, 0);
    metal(METAL_TINY, 5e-4f, 5e-4f);
    glass(GLASS, 0, 1.5f);
    glass(GLASS_1, 0.1f, 1.5f);
    glass(GLASS_4, 0.4f, 1.5f);
    glass(GLASS_NARROW, 0.01f, 1.33f);
    glass(GLASS_THIN, 0.2f, 1.1f);
    glass(GLASS_NONE, 0.2f, 1);
    coat(COAT, 0, 0.7f, 0.5f, 0.3f);
    coat(COAT_1, 0.1f, 0.7f, 0.5f, 0.3f);
    coat(COAT_3, 0.3f, 0.7f, 0.5f, 0.3f);
    coat(WHITE_COAT, 0, 1, 1, 1);
    metal(PERFECT_1, 0.1f, 0.1f);
    metal(PERFECT_5, 0.5f, 0.5f);
    for (int i = 0; i < 3; i++) {
        materials[PERFECT_1].eta[i] = materials[PERFECT_5].eta[i] = 0;
        materials[PERFECT_1].k[i] = materials[PERFECT_5].k[i] = 1e4f;
    }
    glass(GLASS_TINTED, 0.4f, 1.5f);
    glass(PANE, 0, 1.5f);
    glass(PANE_TINTED, 0, 1.5f);
    materials[PANE].kind = materials[PANE_TINTED].kind = MATERIAL_THIN_DIELECTRIC;
    static const int tinted[] = { GLASS_TINTED, PANE_TINTED };
    for (int i = 0; i < 2; i++) {
        materials[tinted[i]].flags = MATERIAL_TINTED;
        materials[tinted[i]].specular[0] = 0.9f;
        materials[tinted[i]].specular[1] = 0.5f;
        materials[tinted[i]].specular[2] = 0.2f;
    }
    materials[SHEET] = (struct material){ .kind = MATERIAL_DIFFUSE_TRANSMISSION,
                                          .reflectance = { 0.5f, 0.3f, 0.1f },
                                          .specular = { 0.2f, 0.3f, 0.6f },
                                          .ior = 1 };
    materials[SHEET_CLEAR] = (struct material){ .kind = MATERIAL_DIFFUSE_TRANSMISSION,
                                                .specular = { 1, 1, 1 },
                                                .ior = 1 };
    coated(COATED_FLAT, 0, 0, 0);
    materials[COATED_FLAT].coat_scale = 0;
    coated(COATED_2, 0, 0.2f, 0.2f);
    coated(COATED_BOTH, 0.3f, 0.1f, 0.1f);
    coated(COATED_SKEW, 0, 0.1f, 0.4f);
    coat(COATS_2, 0.2f, 0.7f, 0.5f, 0.3f);
    coated(COATED_COATS, 0.2f, 0.2f, 0.2f);
    glass(GLASS_SKEW, 0.1f, 1.5f);
    materials[GLASS_SKEW].alpha[1] = 0.5f;
    coat(COAT_SKEW, 0.1f, 0.7f, 0.5f, 0.3f);
    materials[COAT_SKEW].alpha[1] = 0.4f;
    materials[COATS_2].coat_table = TABLE_COATS;
    materials[COATED_COATS].coat_table = TABLE_METAL_COATS;
    materials[COATS_2].flags = materials[COATED_COATS].flags = MATERIAL_COATS;
    coats_fill();
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        f8 cos_t, root = F8((float)i / (COAT_TABLE_LEN - 1));
        coat_table[i] = 1 - fresnel_dielectric(root * root, F8(1.5f), &cos_t)[0];
    }
    for (int id = 0; id < MATERIALS; id++)
        subjects[id] = (struct subject){ names[id], &scene, &materials[id] };
    return 0;
}

static struct bsdf_eval8 eval(int id, const struct vec3x8 *wo, const struct vec3x8 *wi,
                              bool importance)
{
    return subject_eval(&subjects[id], wo, wi, importance);
}

static struct bsdf_sample8 sample(int id, const struct vec3x8 *wo, const f8 u[3], bool importance)
{
    return subject_sample(&subjects[id], wo, u, importance);
}

static struct bsdf_sample8 sample_random(int id, const struct vec3x8 *wo, struct random_lanes *r,
                                         bool importance)
{
    return subject_random(&subjects[id], wo, r, importance);
}

static double albedo(int id, double cosine, uint64_t seed)
{
    struct tally t = subject_albedo(&subjects[id], cosine, 0, 30000, seed);
    return tally_mean(&t);
}

static double fresnel(double c, double eta)
{
    f8 cos_t;
    return (double)fresnel_dielectric(F8((float)c), F8((float)eta), &cos_t)[0];
}

static double fresnel_metal(double c, double eta, double k)
{
    return (double)fresnel_conductor(F8((float)c), F8((float)eta), F8((float)k))[0];
}

/* ---- rough metal */

static void the_rough_lobe_has_its_tabulated_albedo(void **state)
{
    (void)state;
    static const struct {
        float alpha;
        double albedo[4];
    } table[] = {
        { 0.1f, { .98833, .98142, .93624, .88345 } },
        { 0.25f, { .91582, .88534, .83791, .89161 } },
        { 0.5f, { .68783, .68295, .74527, .86011 } },
        { 1, { .30685, .37889, .56010, .76020 } },
    };
    const double cosines[4] = { 1, 0.7, 0.3, 0.1 };
    struct random_lanes r = { 25, 0 };
    int caught = 0;
    for (int a = 0; a < 4; a++)
        for (int c = 0; c < 4; c++) {
            struct vec3x8 wo = at_cosine(cosines[c]);
            materials[PERFECT_5].alpha[0] = materials[PERFECT_5].alpha[1] = table[a].alpha;
            struct tally t = { 0 };
            for (int i = 0; i < 30000; i++) {
                struct bsdf_sample8 s = sample_random(PERFECT_5, &wo, &r, false);
                for (int lane = 0; lane < LANES; lane++)
                    tally_add(&t, s.valid[lane] ? (double)s.weight.y[lane] : 0);
            }
            double slack = 6e-6; /* five digits; with eta = 0 the metal has F = 1 exactly */
            double noise = 4.5 * sqrt(tally_variance(&t) / t.n);
            EXPECT_NEAR(tally_mean(&t), table[a].albedo[c], noise + slack);
            caught += fabs(0.99 * tally_mean(&t) - table[a].albedo[c]) > noise + slack;
        }
    materials[PERFECT_5].alpha[0] = materials[PERFECT_5].alpha[1] = 0.5f;
    assert_true(caught >= 14); /* planted: weight x 0.99; two are too noisy to see it */
}

/* ---- chi-square of every kind */

static const struct {
    int id, side;
    double power;
} scatters[] = {
    { MATTE, 0, 1 },        { PAINT, 0, 1 },       { METAL_10, 0, 1 },     { METAL_3, 0, 1 },
    { METAL_1, 1, 2 },      { METAL_SKEW, 1, 2 },  { METAL_NARROW, 1, 4 }, { GLASS_4, 0, 1 },
    { GLASS_1, 1, 2 },      { GLASS_1, -1, 2 },    { GLASS_NARROW, 1, 4 }, { GLASS_NARROW, -1, 4 },
    { GLASS_THIN, -1, 2 },  { COAT, 0, 1 },        { COAT_1, 0, 2 },       { COAT_3, 0, 1 },
    { GLASS_TINTED, 0, 1 }, { SHEET, 0, 1 },       { SHEET_CLEAR, -1, 1 }, { COATED_2, 0, 1 },
    { COATED_BOTH, 0, 1 },  { COATED_SKEW, 0, 1 }, { COATS_2, 0, 1 },      { COATED_COATS, 0, 1 },
    { GLASS_SKEW, 1, 1 },   { GLASS_SKEW, -1, 1 }, { COAT_SKEW, 0, 2 },
};

#define SCATTERS (sizeof(scatters) / sizeof(scatters[0]))

static void directions_are_distributed_as_their_density_says(void **state) /* H27 */
{
    (void)state;
    const double cosines[] = { 0.95, 0.15, 0.04, -0.9, -0.4 };
    for (size_t i = 0; i < SCATTERS; i++)
        for (size_t c = 0; c < sizeof(cosines) / sizeof(cosines[0]); c++) {
            struct scatter s = { &subjects[scatters[i].id], at_cosine(cosines[c]), c % 2,
                                 scatters[i].side, SOUND };
            int kind = (int)s.of->material->kind;
            if (cosines[c] < 0 && kind != MATERIAL_DIELECTRIC && s.side >= 0 && c % 2)
                continue; /* one look from below is enough for what is mirrored */
            if (s.side < 0 && cosines[c] == -0.4 && kind == MATERIAL_DIELECTRIC)
                continue; /* beyond the critical angle */
            checks_distribution(&s, scatters[i].power, 100 * i + c, 2e-3);
        }
}

static void the_chi_square_test_catches_planted_bugs(void **state)
{
    (void)state;
    struct scatter s = { &subjects[MATTE], at_cosine(0.5), false, 0, COSINE_DROPPED };
    struct chi2_case test = scatter_case(&s, 1, 1);
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    s.plant = REUSED_NUMBER;
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    for (size_t i = 0; i < SCATTERS; i++) {
        s = (struct scatter){ &subjects[scatters[i].id], at_cosine(0.5), false, scatters[i].side,
                              PDF_LARGE };
        test = scatter_case(&s, scatters[i].power, 1);
        struct chi2_result r = chi2_run(&test);
        if (r.share > 0.55 && chi2_scale_right(&r, test.samples, 2e-3))
            fail_msg("%s: a density 2 %% too large was not seen: %g of %g", s.of->name, r.integral,
                     r.share);
    }
}

/* ---- the three ways to say one thing: weights, values, densities */

static const int rough[] = { MATTE,      PAINT,        METAL_1,    METAL_3,     METAL_10,
                             METAL_SKEW, METAL_NARROW, GLASS_1,    GLASS_4,     GLASS_NARROW,
                             GLASS_THIN, COAT,         COAT_1,     COAT_3,      GLASS_TINTED,
                             SHEET,      SHEET_CLEAR,  COATED_2,   COATED_BOTH, COATED_SKEW,
                             COATS_2,    COATED_COATS, GLASS_SKEW, COAT_SKEW };
#define ROUGH_COUNT (sizeof(rough) / sizeof(rough[0]))

static void weights_values_and_densities_agree(void **state)
{
    (void)state;
    for (size_t i = 0; i < 2 * ROUGH_COUNT; i++)
        checks_agreement(&subjects[rough[i / 2]], i % 2);
    double worst[GAPS];
    checks_gaps(&subjects[GLASS_1], WEIGHT_SMALL, false, worst);
    assert_true(worst[GAP_WEIGHT] > 5e-3);
    checks_gaps(&subjects[COAT_1], PDF_LARGE, false, worst);
    assert_true(worst[GAP_PDF] > 1e-2);
}

static void transmission_scales_radiance_and_not_importance(void **state)
{
    (void)state;
    struct random_lanes r = { 7, 0 };
    for (int i = 0; i < 3000; i++) {
        struct vec3x8 wo = random_direction(&r);
        f8 u[3] = { random_f8(&r), random_f8(&r), random_f8(&r) };
        int id = i % 2 ? GLASS_1 : GLASS;
        struct bsdf_sample8 a = sample(id, &wo, u, false), b = sample(id, &wo, u, true);
        struct bsdf_eval8 fa = eval(id, &wo, &a.wi, false), fb = eval(id, &wo, &a.wi, true);
        for (int lane = 0; lane < LANES; lane++) {
            if (!a.valid[lane])
                continue;
            double eta2 = (double)a.eta[lane] * (double)a.eta[lane];
            EXPECT_NEAR((double)a.weight.x[lane] * eta2 / (double)b.weight.x[lane], 1, 1e-6);
            if (!a.delta[lane] && fb.f_cos.x[lane] > 1e-6f)
                EXPECT_NEAR((double)fa.f_cos.x[lane] * eta2 / (double)fb.f_cos.x[lane], 1, 1e-6);
        }
    }
}

struct value {
    struct scatter scatter;
    int channel;
};

static void value_density(void *self, const struct vec3x8 *w, f8 *out)
{
    struct value *v = self;
    struct bsdf_eval8 e = subject_eval(v->scatter.of, &v->scatter.wo, w, v->scatter.importance);
    const f8 rgb[3] = { e.f_cos.x, e.f_cos.y, e.f_cos.z };
    *out = rgb[v->channel];
    if (v->scatter.side != 0)
        *out = f8_select(w->z * v->scatter.wo.z * (float)v->scatter.side > 0, *out, F8(0));
}

static void the_value_integrates_to_the_mean_weight(void **state)
{
    (void)state;
    const double cosines[] = { 0.9, 0.3, -0.8, -0.25 };
    int caught = 0, runs = 0;
    for (size_t i = 0; i < SCATTERS; i++)
        for (int c = 0; c < 4; c++) {
            struct value v = { { &subjects[scatters[i].id], at_cosine(cosines[c]), c % 2,
                                 scatters[i].side, SOUND },
                               c % 3 };
            if (cosines[c] == -0.25 && v.scatter.side < 0 && subject_ior(v.scatter.of) != 1)
                continue; /* beyond the critical angle */
            struct chi2_case test = scatter_case(&v.scatter, scatters[i].power, 1);
            test.self = &v;
            test.pdf = value_density;
            static double mass[CHI2_CELLS];
            memset(mass, 0, sizeof(mass));
            struct frame8 frame = frame_around(
                vec3x8_unit(vec3x8_all(test.axis[0], test.axis[1], test.axis[2])));
            chi2_integrate(&test, &frame, mass);
            double integral = 0;
            for (int k = 0; k < CHI2_CELLS; k++)
                integral += mass[k];

            struct random_lanes r = { 300 + i, 0 };
            struct tally t = { 0 };
            for (int k = 0; k < 20000; k++) {
                struct bsdf_sample8 s = subject_random(v.scatter.of, &v.scatter.wo, &r,
                                                       v.scatter.importance);
                const f8 rgb[3] = { s.weight.x, s.weight.y, s.weight.z };
                i8 counts = scattered(&s);
                if (v.scatter.side != 0)
                    counts &= s.wi.z * v.scatter.wo.z * (float)v.scatter.side > 0;
                for (int lane = 0; lane < LANES; lane++)
                    tally_add(&t, counts[lane] ? (double)rgb[v.channel][lane] : 0);
            }
            double slack = 4.5 * sqrt(tally_variance(&t) / t.n) + 2e-3 * integral;
            if (fabs(integral - tally_mean(&t)) > slack)
                fail_msg(
                    "%s, cosine %g, side %d: the value integrates to %g, the mean weight is %g "
                    "+- %g",
                    v.scatter.of->name, cosines[c], v.scatter.side, integral, tally_mean(&t),
                    slack);
            runs++;
            caught += fabs(integral - 0.96 * tally_mean(&t)) > slack;
        }
    assert_true(caught > runs * 3 / 4); /* planted: weight x 0.96, most have the power to see it */
}

static void scattering_is_reciprocal(void **state) /* H30 */
{
    (void)state;
    for (size_t i = 0; i < ROUGH_COUNT; i++)
        checks_both_ways(&subjects[rough[i]]);
}

/* ---- energy */

static void nothing_reflects_more_than_it_gets(void **state)
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++) {
        double z = checks_energy(&subjects[id], 1);
        if (z > 4.5)
            fail_msg("%s: %g standard errors more than all the light", names[id], z);
    }
    /* Planted: a half per cent more of what loses nothing, or two of what loses one */
    assert_true(checks_energy(&subjects[WHITE_COAT], 1.005) > 4.5);
    assert_true(checks_energy(&subjects[SHEET_CLEAR], 1.005) > 4.5);
    assert_true(checks_energy(&subjects[PERFECT_1], 1.02) > 4.5);
}

static void a_white_base_under_a_clear_coat_returns_all_the_light(void **state)
{
    (void)state;
    for (double c = 0.05; c <= 1; c += 0.19)
        EXPECT_NEAR(albedo(WHITE_COAT, c, 11), 1, 4e-3);
    float scale = materials[WHITE_COAT].coat_scale;
    materials[WHITE_COAT].coat_scale = scale * 0.97f; /* planted */
    double lost = albedo(WHITE_COAT, 0.8, 11);
    materials[WHITE_COAT].coat_scale = scale;
    assert_true(lost < 1 - 2e-2);
}

static void glass_keeps_all_energy(void **state)
{
    (void)state;
    for (double c = -1; c <= 1; c += 0.13)
        EXPECT_NEAR(albedo(GLASS, c, 12), 1, 1e-6);
    EXPECT_NEAR(albedo(GLASS_NONE, 0.3, 12), 1,
                0); /* index 1: all goes straight on, however rough */
}

/* ---- sheets, tints and metal under a coat, where the numbers are known */

static void a_pane_reflects_and_transmits_all_there_is(void **state)
{
    (void)state;
    struct random_lanes r = { 41, 0 };
    for (double c = -1; c <= 1; c += 0.2) {
        if (fabs(c) < 0.01)
            continue;
        struct vec3x8 wo = at_cosine(fabs(c));
        wo.z = F8((float)c);
        double mirrored = 0, n = 0;
        for (int i = 0; i < 10000; i++) {
            struct bsdf_sample8 s = sample_random(PANE, &wo, &r, i % 2);
            assert_int_equal(i8_bits(s.valid & s.delta), 255);
            for (int lane = 0; lane < LANES; lane++) {
                EXPECT_NEAR(s.weight.y[lane], 1, 0);
                EXPECT_NEAR(s.eta[lane], 1, 0);
                /* Straight on, or mirrored */
                float side = s.transmitted[lane] ? -1.0f : 1.0f;
                EXPECT_NEAR(s.wi.z[lane], side * wo.z[lane], 0);
                EXPECT_NEAR(s.wi.x[lane], -wo.x[lane], 0);
                mirrored += s.transmitted[lane] ? 0 : 1;
                n++;
            }
        }
        double R = fresnel(fabs(c), 1.5), all = 2 * R / (1 + R); /* the series, summed */
        double noise = 4.5 * sqrt(all * (1 - all) / n);
        EXPECT_NEAR(mirrored / n, all, noise + 1e-6);
        assert_true(fabs(mirrored / n - R) > noise); /* planted: one face only */
    }
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(PANE));
    assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 255);
}

static void tints_colour_what_is_transmitted_only(void **state)
{
    (void)state;
    struct random_lanes r = { 42, 0 };
    static const int pairs[2][2] = { { GLASS_4, GLASS_TINTED }, { PANE, PANE_TINTED } };
    for (int i = 0; i < 4000; i++) {
        struct vec3x8 wo = random_direction(&r);
        f8 u[3] = { random_f8(&r), random_f8(&r), random_f8(&r) };
        const int *pair = pairs[i % 2];
        struct bsdf_sample8 a = sample(pair[0], &wo, u, false), b = sample(pair[1], &wo, u, false);
        struct bsdf_eval8 fa = eval(pair[0], &wo, &a.wi, false),
                          fb = eval(pair[1], &wo, &a.wi, false);
        for (int lane = 0; lane < LANES; lane++) {
            float tint = a.transmitted[lane] ? 0.5f : 1;
            assert_true(a.valid[lane] == b.valid[lane] && a.pdf[lane] == b.pdf[lane]);
            if (!a.valid[lane])
                continue;
            EXPECT_NEAR(b.weight.y[lane], a.weight.y[lane] * tint, 0);
            EXPECT_NEAR(fb.f_cos.y[lane], fa.f_cos.y[lane] * tint, 0);
        }
    }
}

static void sheets_return_what_they_reflect_and_transmit(void **state)
{
    (void)state;
    for (double c = -0.9; c < 1; c += 0.45) {
        EXPECT_NEAR(albedo(SHEET, c == 0 ? 0.1 : c, 43), 0.7, 4e-3);
        EXPECT_NEAR(albedo(SHEET_CLEAR, c == 0 ? 0.1 : c, 43), 1, 0);
    }
    struct random_lanes r = { 44, 0 };
    struct vec3x8 wo = at_cosine(0.4);
    struct bsdf_sample8 s = sample_random(SHEET_CLEAR, &wo, &r, false);
    assert_int_equal(i8_bits(s.valid & s.transmitted & (s.wi.z < 0)), 255);
    struct bsdf_eval8 e = eval(SHEET_CLEAR, &wo, &wo, false);
    EXPECT_NEAR(e.f_cos.x[0] + e.pdf[0], 0, 0);
}

/* Both mirrors of a coated smooth metal are one delta event, which no light sampling reaches */
static void two_mirrors_are_one_event(void **state)
{
    (void)state;
    struct random_lanes r = { 45, 0 };
    struct vec3x8 wo = at_cosine(0.7);
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(COATED_FLAT));
    assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 255);
    b = bsdf_of(&scene, FX_ALL, I8(COATED_2));
    assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 0);
    double F = fresnel(0.7, 1.5), inside = sqrt(1 - (1 - 0.49) / 2.25);
    double Fc = fresnel_metal(inside, 0.9 / 1.5, 2.4 / 1.5);
    double want = F + (1 - F) * (1 - F) * Fc / (1 - F * Fc);
    for (int i = 0; i < 1000; i++) {
        struct bsdf_sample8 s = sample_random(COATED_FLAT, &wo, &r, false);
        assert_int_equal(i8_bits(s.valid & s.delta), 255);
        EXPECT_NEAR(s.weight.y[i % LANES], want, 1e-3);
        EXPECT_NEAR(s.wi.x[0], -wo.x[0], 0);
    }
}

/* A coat of one width and the same among coats of all widths, when the tables are the same */
static void coats_of_many_widths_are_read_between_their_tables(void **state)
{
    (void)state;
    struct random_lanes r = { 46, 0 };
    const size_t size = COAT_TABLE_LEN * sizeof(float);
    float *coats = coat_table + (size_t)TABLE_COATS * COAT_TABLE_LEN;
    materials[COATS_2].alpha[0] = materials[COATS_2].alpha[1] = 0.3f;
    for (int j = 0; j < COAT_ALPHAS; j++)
        memcpy(coats + j * COAT_TABLE_LEN, coat_table, size);
    for (int j = 0; j < COAT_ALPHAS; j++)
        coats[COAT_ALPHAS * COAT_TABLE_LEN + j] = materials[COAT_3].coat_inner;
    for (int i = 0; i < 1000; i++) {
        struct vec3x8 wo = random_direction(&r), wi = random_direction(&r);
        struct bsdf_eval8 one = eval(COAT_3, &wo, &wi, false),
                          many = eval(COATS_2, &wo, &wi, false);
        for (int lane = 0; lane < LANES; lane++) {
            EXPECT_NEAR(many.f_cos.x[lane], one.f_cos.x[lane], 1e-6f + 1e-5f * one.f_cos.x[lane]);
            EXPECT_NEAR(many.pdf[lane], one.pdf[lane], 1e-6f + 1e-5f * one.pdf[lane]);
        }
    }

    /* And between two widths the table is between theirs: sqrt(.3) is .834 of the way from 3/7 */
    for (int j = 0; j < COAT_ALPHAS; j++)
        for (int i = 0; i < COAT_TABLE_LEN; i++)
            coats[j * COAT_TABLE_LEN + i] = 0.1f * (float)j;
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(COATS_2));
    struct coat8 c = coat_of(&b, FX_ALL);
    EXPECT_NEAR(coat_T(&b, FX_ALL, &c, F8(0.5f))[3], 0.1 * 7 * sqrt(0.3), 1e-6);
    materials[COATS_2].alpha[0] = materials[COATS_2].alpha[1] = 0.2f;
    coats_fill();
}

/* ---- corner cases */

static void the_rim_of_the_cosine_lobe_weighs_the_reflectance(void **state) /* H28 */
{
    (void)state;
    struct vec3x8 wo = at_cosine(0.5);
    const float last = 0x1.fffffep-1f;
    const f8 u[3] = { F8(0),
                      { 0, last, 1 - 0x1p-23f, 0.5f, 0, last, 0, 0.25f },
                      { 0, 0, last, last, last, last, 0.5f, 0.75f } };
    struct bsdf_sample8 s = sample(MATTE, &wo, u, false);
    for (int lane = 0; lane < LANES; lane++) {
        assert_true(s.valid[lane]);
        EXPECT_NEAR(s.weight.x[lane], 0.7f, 0);
        assert_true(s.pdf[lane] > 0 && s.wi.z[lane] > 0);
    }
}

static void the_ends_of_the_unit_interval_give_sound_samples(void **state) /* H28 */
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++)
        checks_corners(&subjects[id], 100);
}

static bool finite_and_positive(struct vec3x8 a, int lane)
{
    return a.x[lane] >= 0 && a.y[lane] >= 0 && a.z[lane] >= 0 && isfinite(vec3x8_max(a)[lane]);
}

static void opposite_directions_and_grazing_ones_stay_finite(void **state) /* H26, H36 */
{
    (void)state;
    struct random_lanes r = { 26, 0 };
    bool planted = false;
    for (int id = 0; id < MATERIALS; id++)
        for (int i = 0; i < 4000; i++) {
            struct vec3x8 wo = random_direction(&r), wi = random_direction(&r);
            float tiny = (float)pow(10, -10 * random_double(&r));
            if (i % 4 == 0)
                wi = vec3x8_neg(wo);
            if (i % 4 == 1)
                wi.z = wi.z * tiny;
            if (i % 4 >= 1) {
                wo.z = wo.z * tiny;
                wo = vec3x8_unit(wo);
            }
            if (i % 8 == 3)
                wi.z = F8(0);
            /* There is no half vector then, and nothing to divide by */
            if (i % 4 == 0)
                planted |= !(vec3x8_length2(vec3x8_add(wo, wi))[0] > 0);
            struct bsdf_eval8 e = eval(id, &wo, &wi, false);
            struct bsdf_sample8 s = sample_random(id, &wo, &r, false);
            for (int lane = 0; lane < LANES; lane++) {
                float pdf = e.pdf[lane], rev = e.pdf_rev[lane];
                if (!finite_and_positive(e.f_cos, lane) || !(pdf >= 0) || !(rev >= 0) || isinf(pdf))
                    fail_msg("%s: f cos %g, pdf %g, pdf_rev %g at cosines %g, %g", names[id],
                             (double)e.f_cos.x[lane], (double)pdf, (double)rev, (double)wo.z[lane],
                             (double)wi.z[lane]);
                if (!s.valid[lane])
                    continue;
                double length = sqrt((double)vec3x8_length2(s.wi)[lane]);
                if (!finite_and_positive(s.weight, lane) || !(s.pdf[lane] >= 0) ||
                    !(s.pdf_rev[lane] >= 0) || !(fabs(length - 1) < 1e-2))
                    fail_msg("%s: weight %g, pdf %g, pdf_rev %g, |wi| %g at cosine %g", names[id],
                             (double)s.weight.x[lane], (double)s.pdf[lane], (double)s.pdf_rev[lane],
                             length, (double)wo.z[lane]);
            }
        }
    assert_true(planted);
}

static void black_absorbs_and_lobes_without_weight_are_never_chosen(void **state) /* H33 */
{
    (void)state;
    struct random_lanes r = { 33, 0 };
    struct vec3x8 wo = at_cosine(0.6);
    for (int i = 0; i < 2000; i++) {
        struct bsdf_sample8 s = sample_random(BLACK, &wo, &r, false);
        assert_false(i8_any(s.valid));
        s = sample_random(MIRRORED, &wo, &r, false);
        assert_int_equal(i8_bits(s.valid & s.delta), 255);
        EXPECT_NEAR(s.weight.y[0], 0.8, 1e-6);
    }
    struct bsdf_eval8 e = eval(MIRRORED, &wo, &wo, false);
    EXPECT_NEAR(e.f_cos.x[0], 0, 0);
    EXPECT_NEAR(e.pdf[0], 0, 0);

    /* The share of the diffuse lobe is k_d / (k_d + k_s), and the rest is the mirror's */
    double diffuse = 0, n = 0;
    for (int i = 0; i < 20000; i++) {
        struct bsdf_sample8 s = sample_random(PAINT, &wo, &r, false);
        diffuse += __builtin_popcount(i8_bits(scattered(&s)));
        n += __builtin_popcount(i8_bits(s.valid));
    }
    EXPECT_NEAR(n, 160000, 0);
    EXPECT_NEAR(diffuse / n, 1 / 1.6, 4.5 * sqrt(0.25 / n));
}

static void roughness_below_the_limit_is_a_mirror(void **state) /* H25: the switch */
{
    (void)state;
    struct random_lanes r = { 8, 0 };
    struct vec3x8 wo = at_cosine(0.6);
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(METAL_TINY));
    assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 255);
    struct bsdf_sample8 s = sample_random(METAL_TINY, &wo, &r, false);
    assert_int_equal(i8_bits(s.valid & s.delta), 255);

    metal(METAL_TINY, ALPHA_SMOOTH, ALPHA_SMOOTH);
    b = bsdf_of(&scene, FX_ALL, I8(METAL_TINY));
    assert_int_equal(i8_bits(bsdf_all_delta(&b, FX_ALL)), 0);
    metal(METAL_TINY, 5e-4f, 5e-4f);
}

/* What is returned just above the limit and just below: of each kind, at each of its surfaces */
static void energy_is_continuous_where_roughness_ends(void **state) /* H25: the switch */
{
    (void)state;
    static const struct {
        int id;
        bool base; /* the metal below the coat */
    } rows[] = { { METAL_3, false },    { PERFECT_5, false }, { GLASS_4, false },
                 { COAT_3, false },     { COATED_2, true },   { COATED_BOTH, false },
                 { COATED_BOTH, true }, { COATED_2, false } };
    int caught = 0;
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        for (double c = -0.95; c < 1; c += 0.38) {
            struct material material = materials[rows[i].id];
            float *alpha = rows[i].base ? material.base_alpha : material.alpha;
            const struct subject m = { names[rows[i].id], &scene, &material };
            alpha[0] = alpha[1] = ALPHA_SMOOTH;
            struct tally above = subject_albedo(&m, c, 1, 4000, 9);
            alpha[0] = alpha[1] = 0.999f * ALPHA_SMOOTH;
            struct tally below = subject_albedo(&m, c, 1, 4000, 9);
            alpha[0] = alpha[1] = 0.3f; /* planted: the switch at another width */
            struct tally wide = subject_albedo(&m, c, 1, 4000, 9);
            double allowed = 0.01 * tally_mean(&below);
            if (!(fabs(tally_mean(&above) - tally_mean(&below)) <= allowed))
                fail_msg("%s at cosine %g: %g above the limit, %g below", m.name, c,
                         tally_mean(&above), tally_mean(&below));
            caught += fabs(tally_mean(&wide) - tally_mean(&below)) > allowed;
        }
    assert_true(caught > 12);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_rough_lobe_has_its_tabulated_albedo),
        cmocka_unit_test(directions_are_distributed_as_their_density_says),
        cmocka_unit_test(the_chi_square_test_catches_planted_bugs),
        cmocka_unit_test(weights_values_and_densities_agree),
        cmocka_unit_test(transmission_scales_radiance_and_not_importance),
        cmocka_unit_test(the_value_integrates_to_the_mean_weight),
        cmocka_unit_test(scattering_is_reciprocal),
        cmocka_unit_test(nothing_reflects_more_than_it_gets),
        cmocka_unit_test(a_white_base_under_a_clear_coat_returns_all_the_light),
        cmocka_unit_test(glass_keeps_all_energy),
        cmocka_unit_test(a_pane_reflects_and_transmits_all_there_is),
        cmocka_unit_test(tints_colour_what_is_transmitted_only),
        cmocka_unit_test(sheets_return_what_they_reflect_and_transmit),
        cmocka_unit_test(two_mirrors_are_one_event),
        cmocka_unit_test(coats_of_many_widths_are_read_between_their_tables),
        cmocka_unit_test(the_rim_of_the_cosine_lobe_weighs_the_reflectance),
        cmocka_unit_test(the_ends_of_the_unit_interval_give_sound_samples),
        cmocka_unit_test(opposite_directions_and_grazing_ones_stay_finite),
        cmocka_unit_test(black_absorbs_and_lobes_without_weight_are_never_chosen),
        cmocka_unit_test(roughness_below_the_limit_is_a_mirror),
        cmocka_unit_test(energy_is_continuous_where_roughness_ends),
    };
    return cmocka_run_group_tests(tests, materials_fill, NULL);
}
