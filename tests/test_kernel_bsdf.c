/*
 * Scattering: Fresnel, microfacets and every BSDF against what they must integrate to, what they
 * claim to sample, and each other. Each statistical test also runs with a planted bug, which it
 * must catch. Runs for about ten seconds. H numbers are those of the numerics notes, section 2.
 */
#include "common/effects.h"
#include "common/scene.h"
#include "tests/chi2.h"
#include "worker/kernel/bsdf.h"

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
};

static struct material materials[MATERIALS];
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
    materials[COATS_2].coat_table = TABLE_COATS;
    materials[COATED_COATS].coat_table = TABLE_METAL_COATS;
    materials[COATS_2].flags = materials[COATED_COATS].flags = MATERIAL_COATS;
    coats_fill();
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        f8 cos_t, root = F8((float)i / (COAT_TABLE_LEN - 1));
        coat_table[i] = 1 - fresnel_dielectric(root * root, F8(1.5f), &cos_t)[0];
    }
    return 0;
}

/* One copy of the code each: the headers inline everything */
static __attribute__((noinline)) struct bsdf_eval8 eval(int id, const struct vec3x8 *wo,
                                                        const struct vec3x8 *wi, bool importance)
{
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(id));
    return importance ? bsdf_eval(&b, FX_ALL, TRANSPORT_IMPORTANCE, I8(-1), *wo, *wi)
                      : bsdf_eval(&b, FX_ALL, TRANSPORT_RADIANCE, I8(-1), *wo, *wi);
}

static __attribute__((noinline)) struct bsdf_sample8 sample(int id, const struct vec3x8 *wo,
                                                            const f8 u[3], bool importance)
{
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(id));
    return importance ? bsdf_sample(&b, FX_ALL, TRANSPORT_IMPORTANCE, I8(-1), *wo, u[0], u[1], u[2])
                      : bsdf_sample(&b, FX_ALL, TRANSPORT_RADIANCE, I8(-1), *wo, u[0], u[1], u[2]);
}

static struct bsdf_sample8 sample_random(int id, const struct vec3x8 *wo, struct random_lanes *r,
                                         bool importance)
{
    f8 u[3];
    for (int i = 0; i < 3; i++)
        u[i] = random_f8(r);
    return sample(id, wo, u, importance);
}

static struct vec3x8 at_cosine(double z)
{
    double across = sqrt(1 - z * z);
    return vec3x8_all((float)(across * 0.8), (float)(across * 0.6), (float)z);
}

static i8 scattered(const struct bsdf_sample8 *s)
{
    return s->valid & ~s->delta;
}

/* ---- Fresnel */

static double fresnel(double c, double eta)
{
    f8 cos_t;
    return (double)fresnel_dielectric(F8((float)c), F8((float)eta), &cos_t)[0];
}

static double fresnel_metal(double c, double eta, double k)
{
    return (double)fresnel_conductor(F8((float)c), F8((float)eta), F8((float)k))[0];
}

static void fresnel_has_its_table_values(void **state) /* H24 */
{
    (void)state;
    const double degree = M_PI / 180;
    EXPECT_NEAR(fresnel(1, 1.5), 0.04, 1e-7);
    EXPECT_NEAR(fresnel(1, 1 / 1.5), 0.04, 1e-7);
    EXPECT_NEAR(fresnel(cos(45 * degree), 1.5), 0.050239911012, 1e-6);
    EXPECT_NEAR(fresnel(cos(60 * degree), 1.5), 0.089186712802, 1e-6);
    EXPECT_NEAR(fresnel(cos(atan(1.5)), 1.5), 0.073964497041, 1e-6);
    EXPECT_NEAR(fresnel(cos(85 * degree), 1.5), 0.612799645265, 2e-6);
    EXPECT_NEAR(fresnel(cos(89.9 * degree), 1.5), 0.989911876919, 2e-6);
    EXPECT_NEAR(fresnel(0, 1.5), 1, 0);
    EXPECT_NEAR(fresnel_metal(1, 0.2, 3.9), 0.951951951952, 1e-6);
    EXPECT_NEAR(fresnel_metal(cos(80 * degree), 0.2, 3.9), 0.948407448365, 1e-6);
    EXPECT_NEAR(fresnel_metal(0, 0.2, 3.9), 1, 1e-6);
}

static void an_index_of_one_is_transparent_at_every_angle(void **state) /* H22 */
{
    (void)state;
    for (double c = 1; c > 1e-9; c *= 0.9)
        EXPECT_NEAR(fresnel(c, 1), 0, 0);
    EXPECT_NEAR(fresnel(0, 1), 0, 0);
}

static void fresnel_rises_to_one_at_the_critical_angle(void **state) /* H23 */
{
    (void)state;
    const double critical = 0.7453559925;
    double before = 0;
    for (int i = 0; i <= 4000; i++) {
        double c = 1 - i / 4000.0;
        f8 cos_t;
        double F = (double)fresnel_dielectric(F8((float)c), F8(1 / 1.5f), &cos_t)[0];
        if (!(F >= 0 && F <= 1) || !(cos_t[0] >= 0) || F < before - 1e-6)
            fail_msg("F(%g) = %g after %g, cos_t %g", c, F, before, (double)cos_t[0]);
        if (c < critical - 1e-5)
            EXPECT_NEAR(F, 1, 0);
        double sine2 = (1 - c * c) * 2.25, ct = sqrt(fmax(0, 1 - sine2));
        double parallel = (c / 1.5 - ct) / (c / 1.5 + ct), across = (c - ct / 1.5) / (c + ct / 1.5);
        double want = sine2 >= 1 ? 1 : 0.5 * (parallel * parallel + across * across);
        /* A square root's singularity: one rounding of c is far more of F beside it */
        EXPECT_NEAR(F, want, 2e-6 + 6e-8 / (fabs(c - critical) + 1e-5));
        before = F;
    }
}

static void a_conductor_that_absorbs_nothing_is_a_dielectric(void **state) /* H31 */
{
    (void)state;
    for (int i = 0; i <= 1000; i++)
        for (double eta = 1.1; eta < 3; eta += 0.4)
            EXPECT_NEAR(fresnel_metal(i / 1000.0, eta, 0), fresnel(i / 1000.0, eta), 2e-6);
}

static void fresnel_has_its_hemispherical_means(void **state)
{
    (void)state;
    double outside = 0, inside = 0;
    const int n = 100000;
    for (int i = 0; i < n; i++) {
        double c = (i + 0.5) / n;
        outside += 2 * c * fresnel(c, 1.5) / n;
        inside += 2 * c * fresnel(c, 1 / 1.5) / n;
    }
    EXPECT_NEAR(outside, 0.091777959342, 1e-6);
    EXPECT_NEAR(inside, 0.596345759708, 1e-5);
}

/* ---- frames */

static double frame_error(struct vec3x8 n, int lane)
{
    struct frame8 f = frame_around(n);
    const struct vec3x8 v[3] = { f.s, f.t, f.n };
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) {
            double dot = (double)v[i].x[lane] * (double)v[j].x[lane] +
                         (double)v[i].y[lane] * (double)v[j].y[lane] +
                         (double)v[i].z[lane] * (double)v[j].z[lane];
            worst = fmax(worst, fabs(dot - (i == j)));
        }
    return worst;
}

static void frames_are_orthonormal_down_to_minus_z(void **state) /* H16 */
{
    (void)state;
    struct random_lanes r = { 16, 0 };
    double worst = 0;
    for (int i = 0; i < 60000; i++) {
        struct vec3x8 n = random_direction(&r);
        if (i % 2) { /* crowd them at -z, at every scale */
            double scale = pow(10, -8 * random_double(&r));
            for (int lane = 0; lane < LANES; lane++) {
                double x = (double)n.x[lane] * scale, y = (double)n.y[lane] * scale;
                n.x[lane] = (float)x;
                n.y[lane] = (float)y;
                n.z[lane] = (float)-sqrt(1 - x * x - y * y);
            }
        }
        for (int lane = 0; lane < LANES; lane++)
            worst = fmax(worst, frame_error(n, lane));
    }
    EXPECT_NEAR(worst, 0, 4e-7);
    const float poles[] = { 1, -1 };
    for (int i = 0; i < 2; i++)
        EXPECT_NEAR(frame_error(vec3x8_all(0, 0, poles[i]), 0), 0, 0);
    EXPECT_NEAR(frame_error(vec3x8_all(1, 0, -0.0f), 0), 0, 0);
    EXPECT_NEAR(frame_error(vec3x8_all(0, 1, 0.0f), 0), 0, 0);
}

/* ---- the microfacet distribution */

static void the_peak_of_a_narrow_lobe_keeps_its_digits(void **state) /* H25 */
{
    (void)state;
    struct vec3x8 h = vec3x8_all((float)sin(1e-3), 0, (float)cos(1e-3));
    double D = (double)ggx_D((struct ggx8){ F8(1e-3f), F8(1e-3f) }, h)[0];
    EXPECT_NEAR(D / 79577.6, 1, 3e-6);
    for (float a = 1; a > 5e-5f; a *= 0.5f) {
        D = (double)ggx_D((struct ggx8){ F8(a), F8(a) }, vec3x8_all(0, 0, 1))[0];
        EXPECT_NEAR(D * M_PI * (double)a * (double)a, 1, 1e-6);
    }
}

/* The integral of G1 D / (4 |o.n|) over the sphere, by sampling normals from D in double */
static void the_weak_white_furnace_returns_one(void **state) /* H27 */
{
    (void)state;
    const float alphas[] = { 0.1f, 0.5f, 1 };
    const double cosines[] = { 1, 0.5, 0.1 };
    for (int a = 0; a < 3; a++)
        for (int c = 0; c < 3; c++) {
            struct ggx8 g = { F8(alphas[a]), F8(alphas[a]) };
            struct vec3x8 o = at_cosine(cosines[c]);
            /* h = (theta, phi), tan^2 theta = alpha^2 u / (1 - u): density D cos(theta) in u, phi
             */
            double sum = 0;
            const int rows = 1024, columns = 512;
            for (int i = 0; i < rows; i++)
                for (int j = 0; j < columns; j += LANES) {
                    double t = (i + 0.5) / rows, u = t * t * (3 - 2 * t);
                    double tan2 = (double)alphas[a] * (double)alphas[a] * u / (1 - u);
                    double ch = 1 / sqrt(1 + tan2), sh = sqrt(tan2) * ch;
                    struct vec3x8 h = vec3x8_all(0, 0, (float)ch);
                    for (int lane = 0; lane < LANES; lane++) {
                        double phi = 2 * M_PI * (j + lane + 0.5) / columns;
                        h.x[lane] = (float)(sh * cos(phi));
                        h.y[lane] = (float)(sh * sin(phi));
                    }
                    f8 pdf = ggx_visible_pdf(g, o, h) / (ggx_D(g, h) * F8((float)ch));
                    for (int lane = 0; lane < LANES; lane++)
                        sum += (double)pdf[lane] * 6 * t * (1 - t) / (rows * columns);
                }
            EXPECT_NEAR(sum, 1, 2e-3);
        }
}

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

enum plant { SOUND, PDF_LARGE, COSINE_DROPPED, REUSED_NUMBER, WEIGHT_SMALL };

struct scatter {
    int id;
    struct vec3x8 wo;
    bool importance;
    int side; /* 0: both; 1: reflection only; -1: transmission only */
    enum plant plant;
};

static void scatter_pdf(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct scatter *s = self;
    struct bsdf_eval8 e = eval(s->id, &s->wo, w, s->importance);
    *pdf = e.pdf;
    f8 side = w->z * s->wo.z;
    if (s->side != 0)
        *pdf = f8_select(side * (float)s->side > 0, *pdf, F8(0));
    if (s->plant == PDF_LARGE)
        *pdf = *pdf * 1.02f;
    if (s->plant == COSINE_DROPPED)
        *pdf = f8_select(side > 0, F8((float)(0.5 / M_PI)), F8(0));
}

static void scatter_sample(void *self, struct random_lanes *r, struct vec3x8 *w, i8 *valid)
{
    const struct scatter *s = self;
    f8 u[3] = { random_f8(r), random_f8(r), random_f8(r) };
    if (s->plant == REUSED_NUMBER)
        u[2] = 0.9f * u[2] + 0.1f * u[1];
    struct bsdf_sample8 b = sample(s->id, &s->wo, u, s->importance);
    *w = b.wi;
    *valid = scattered(&b);
    if (s->side != 0)
        *valid &= w->z * s->wo.z * (float)s->side > 0;
}

static struct chi2_case scatter_case(struct scatter *s, double power, uint64_t seed)
{
    struct chi2_case c = { .self = s,
                           .axis = { 0, 0, 1 },
                           .power = power,
                           .samples = 100000,
                           .seed = seed,
                           .pdf = scatter_pdf,
                           .sample = scatter_sample };
    if (power > 1) { /* around where a smooth surface would send the light */
        f8 eta = F8(s->wo.z[0] > 0 ? materials[s->id].ior : 1 / materials[s->id].ior), cos_t;
        struct vec3x8 o = s->wo, w = { -o.x, -o.y, o.z };
        if (s->side < 0) {
            fresnel_dielectric(f8_abs(o.z), eta, &cos_t);
            w = (struct vec3x8){ -o.x / eta, -o.y / eta, f8_mulsign(-cos_t, o.z) };
        }
        c.axis[0] = w.x[0];
        c.axis[1] = w.y[0];
        c.axis[2] = w.z[0];
    }
    return c;
}

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
};

static void directions_are_distributed_as_their_density_says(void **state)
{
    (void)state;
    const double cosines[] = { 0.95, 0.5, 0.15, -0.9, -0.4 };
    for (size_t i = 0; i < sizeof(scatters) / sizeof(scatters[0]); i++)
        for (size_t c = 0; c < sizeof(cosines) / sizeof(cosines[0]); c++) {
            struct scatter s = { scatters[i].id, at_cosine(cosines[c]), c % 2, scatters[i].side,
                                 0 };
            int kind = (int)materials[s.id].kind;
            if (cosines[c] < 0 && kind != MATERIAL_DIELECTRIC && s.side >= 0 && c % 2)
                continue; /* one look from below is enough for what is mirrored */
            if (s.side < 0 && cosines[c] == -0.4 && kind == MATERIAL_DIELECTRIC)
                continue; /* beyond the critical angle */
            struct chi2_case test = scatter_case(&s, scatters[i].power, 100 * i + c);
            struct chi2_result r = chi2_run(&test);
            if (!(r.p > CHI2_ALPHA) || r.outside > 2) /* a cell at the horizon may */
                fail_msg("%s, cosine %g, side %d: p = %g, %llu samples where the density is zero",
                         names[s.id], cosines[c], s.side, r.p, r.outside);
            if (!chi2_scale_right(&r, test.samples, 2e-3))
                fail_msg("%s, cosine %g, side %d: the density integrates to %g, %g of the samples "
                         "are valid",
                         names[s.id], cosines[c], s.side, r.integral, r.share);
        }
}

static void the_chi_square_test_catches_planted_bugs(void **state)
{
    (void)state;
    struct scatter s = { MATTE, at_cosine(0.5), false, 0, COSINE_DROPPED };
    struct chi2_case test = scatter_case(&s, 1, 1);
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    s.plant = REUSED_NUMBER;
    assert_true(chi2_run(&test).p < CHI2_CAUGHT);
    for (size_t i = 0; i < sizeof(scatters) / sizeof(scatters[0]); i++) {
        s = (struct scatter){ scatters[i].id, at_cosine(0.5), false, scatters[i].side, PDF_LARGE };
        test = scatter_case(&s, scatters[i].power, 1);
        struct chi2_result r = chi2_run(&test);
        if (r.share > 0.55 && chi2_scale_right(&r, test.samples, 2e-3))
            fail_msg("%s: a density 2 %% too large was not seen: %g of %g", names[s.id], r.integral,
                     r.share);
    }
}

/* ---- the three ways to say one thing: weights, values, densities */

static double gap(f8 a, f8 b, int lane)
{
    double x = (double)a[lane], y = (double)b[lane];
    return fabs(x - y) / fmax(fmax(fabs(x), fabs(y)), 1e-12);
}

/* The largest of three relative gaps: weight to f cos / pdf, pdf to pdf, pdf_rev to pdf_rev */
static void worst_gaps(int id, enum plant plant, bool importance, double worst[4])
{
    struct random_lanes r = { 1000 + (uint64_t)id, 0 };
    memset(worst, 0, 4 * sizeof(worst[0]));
    for (int i = 0; i < 4000; i++) {
        struct vec3x8 wo = random_direction(&r);
        struct bsdf_sample8 s = sample_random(id, &wo, &r, importance);
        if (plant == WEIGHT_SMALL)
            s.weight = vec3x8_scale(s.weight, F8(0.99f));
        if (plant == PDF_LARGE)
            s.pdf = s.pdf * 1.02f;
        struct bsdf_eval8 e = eval(id, &wo, &s.wi, importance),
                          back = eval(id, &s.wi, &wo, importance);
        struct vec3x8 weight = vec3x8_scale(e.f_cos, 1 / e.pdf);
        /* Within a degree of grazing a rounding of the direction is a large part of its cosine */
        i8 check = scattered(&s) & (f8_abs(wo.z) > 0.02f) & (f8_abs(s.wi.z) > 0.02f);
        for (unsigned todo = i8_bits(check); todo != 0; todo &= todo - 1) {
            int lane = __builtin_ctz(todo);
            worst[0] = fmax(worst[0],
                            fmax(gap(s.weight.x, weight.x, lane), gap(s.weight.z, weight.z, lane)));
            worst[1] = fmax(worst[1], gap(s.pdf, e.pdf, lane));
            worst[2] = fmax(worst[2], gap(s.pdf_rev, e.pdf_rev, lane));
            worst[3] = fmax(worst[3], gap(e.pdf_rev, back.pdf, lane));
            if (s.eta[lane] != (s.transmitted[lane]
                                    ? wo.z[lane] > 0 ? materials[id].ior : 1 / materials[id].ior
                                    : 1))
                fail_msg("%s: eta is %g", names[id], (double)s.eta[lane]);
        }
    }
}

static const int rough[] = { MATTE,      PAINT,        METAL_1,  METAL_3,     METAL_10,
                             METAL_SKEW, METAL_NARROW, GLASS_1,  GLASS_4,     GLASS_NARROW,
                             GLASS_THIN, COAT,         COAT_1,   COAT_3,      GLASS_TINTED,
                             SHEET,      SHEET_CLEAR,  COATED_2, COATED_BOTH, COATED_SKEW,
                             COATS_2,    COATED_COATS };
#define ROUGH_COUNT (sizeof(rough) / sizeof(rough[0]))

static void weights_values_and_densities_agree(void **state)
{
    (void)state;
    for (size_t i = 0; i < 2 * ROUGH_COUNT; i++) {
        int id = rough[i / 2];
        bool narrow = id == METAL_NARROW || id == GLASS_NARROW || id == GLASS_THIN ||
                      materials[id].kind == MATERIAL_COATED_CONDUCTOR;
        double allowed = narrow ? 1e-2 : 1.5e-3, worst[4];
        worst_gaps(id, SOUND, i % 2, worst);
        static const char *const what[4] = { "weight and f cos / pdf", "pdf of sample and of eval",
                                             "pdf_rev of sample and of eval",
                                             "pdf_rev and pdf of the reverse" };
        for (int k = 0; k < 4; k++)
            if (!(worst[k] <= allowed))
                fail_msg("%s: %s differ by %g", names[id], what[k], worst[k]);
    }
    double worst[4];
    worst_gaps(GLASS_1, WEIGHT_SMALL, false, worst);
    assert_true(worst[0] > 5e-3);
    worst_gaps(COAT_1, PDF_LARGE, false, worst);
    assert_true(worst[1] > 1e-2);
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
    struct bsdf_eval8 e = eval(v->scatter.id, &v->scatter.wo, w, v->scatter.importance);
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
    for (size_t i = 0; i < sizeof(scatters) / sizeof(scatters[0]); i++)
        for (int c = 0; c < 4; c++) {
            struct value v = {
                { scatters[i].id, at_cosine(cosines[c]), c % 2, scatters[i].side, 0 }, c % 3
            };
            if (cosines[c] == -0.25 && v.scatter.side < 0 && scatters[i].id != SHEET_CLEAR)
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
                struct bsdf_sample8 s = sample_random(v.scatter.id, &v.scatter.wo, &r,
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
                    names[v.scatter.id], cosines[c], v.scatter.side, integral, tally_mean(&t),
                    slack);
            runs++;
            caught += fabs(integral - 0.96 * tally_mean(&t)) > slack;
        }
    assert_true(caught > runs * 3 / 4); /* planted: weight x 0.96, most have the power to see it */
}

static void scattering_is_reciprocal(void **state) /* H30 */
{
    (void)state;
    for (size_t i = 0; i < ROUGH_COUNT; i++) {
        int id = rough[i];
        struct random_lanes r = { 30, 0 };
        /* Beside the critical angle a rounding is amplified by a square root (H23) */
        bool narrow = id == METAL_NARROW || materials[id].kind == MATERIAL_DIELECTRIC;
        for (int k = 0; k < 2000; k++) {
            struct vec3x8 a = random_direction(&r), b = random_direction(&r);
            if (k % 2) /* narrow lobes are hit by their own samples only */
                b = sample_random(id, &a, &r, false).wi;
            struct bsdf_eval8 there = eval(id, &a, &b, false), back = eval(id, &b, &a, false);
            for (int lane = 0; lane < LANES; lane++) {
                double f = (double)there.f_cos.x[lane] / fabs((double)b.z[lane]);
                double g = (double)back.f_cos.x[lane] / fabs((double)a.z[lane]);
                if (fabs((double)a.z[lane]) < 0.02 || fabs((double)b.z[lane]) < 0.02 ||
                    f + g < 1e-4)
                    continue;
                /* Through the surface f n_o^2 = g n_i^2, n of the side the light comes out on */
                if (a.z[lane] * b.z[lane] < 0) {
                    double ior2 = (double)materials[id].ior * (double)materials[id].ior;
                    if (a.z[lane] > 0)
                        f *= ior2;
                    else
                        g *= ior2;
                }
                double allowed = narrow ? 1e-2 : 1e-3;
                if (!(fabs(f - g) <= allowed * fmax(f, g) + 1e-6))
                    fail_msg("%s: f is %g there and %g back", names[id], f, g);
            }
        }
    }
}

/* ---- energy */

static double albedo(int id, double cosine, uint64_t seed)
{
    struct vec3x8 wo = at_cosine(cosine);
    struct random_lanes r = { seed, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < 30000; i++) {
        struct bsdf_sample8 s = sample_random(id, &wo, &r, true);
        for (int lane = 0; lane < LANES; lane++)
            tally_add(&t, s.valid[lane] ? (double)s.weight.x[lane] : 0);
    }
    return tally_mean(&t);
}

static void nothing_reflects_more_than_it_gets(void **state)
{
    (void)state;
    for (int id = 0; id < MATERIALS; id++)
        for (double c = 0.05; c <= 1; c += 0.19)
            for (int side = 1; side >= -1; side -= 2)
                if (albedo(id, c * side, 3) > 1.01)
                    fail_msg("%s: albedo %g at cosine %g", names[id], albedo(id, c * side, 3), c);
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

static void frames_turn_with_the_surface(void **state)
{
    (void)state;
    struct random_lanes r = { 47, 0 };
    for (int i = 0; i < 20000; i++) {
        struct vec3x8 n = random_direction(&r), dpdu = random_direction(&r);
        if (i % 3 == 0) /* nearly along the normal */
            dpdu = vec3x8_along(n, dpdu, F8(3e-4f));
        dpdu = vec3x8_scale(dpdu, F8((float)pow(10, 8 * random_double(&r) - 4)));
        struct frame8 around = frame_around(n), f = frame_turned(I8(-1), &around, dpdu);
        struct vec3x8 across = vec3x8_cross(n, vec3x8_unit(dpdu));
        for (int lane = 0; lane < LANES; lane++) {
            EXPECT_NEAR(vec3x8_dot(f.s, f.n)[lane], 0, 3e-7);
            EXPECT_NEAR(vec3x8_dot(f.s, f.t)[lane], 0, 3e-7);
            EXPECT_NEAR(vec3x8_length2(f.s)[lane], 1, 1e-6);
            EXPECT_NEAR(vec3x8_length2(f.t)[lane], 1, 1e-6);
            assert_true(vec3x8_dot(vec3x8_cross(f.s, f.t), n)[lane] > 0.999f);
            if (vec3x8_length2(across)[lane] < 1e-9f) /* so near the normal that nothing turns */
                continue;
            /* dp/du lies in the plane of s and n, on the side of s */
            assert_true(vec3x8_dot(f.s, dpdu)[lane] > 0);
            EXPECT_NEAR(vec3x8_dot(vec3x8_unit(across), f.s)[lane], 0, i % 3 ? 1e-4 : 1e-2);
        }
    }
    struct vec3x8 n = vec3x8_all(0, 0, 1);
    struct frame8 around = frame_around(n);
    struct frame8 same = frame_turned(I8(-1), &around, n);
    EXPECT_NEAR(same.s.x[0] - around.s.x[0], 0, 0);
    same = frame_turned(I8(-1), &around, vec3x8_all(0, 0, 0));
    EXPECT_NEAR(same.t.y[0] - around.t.y[0], 0, 0);
    same = frame_turned(I8(0), &around, vec3x8_all(0, 1, 0)); /* not asked for */
    EXPECT_NEAR(same.s.x[0] - around.s.x[0], 0, 0);
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

static void opposite_directions_and_grazing_ones_stay_finite(void **state) /* H26, H36 */
{
    (void)state;
    struct random_lanes r = { 26, 0 };
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
            struct bsdf_eval8 e = eval(id, &wo, &wi, false);
            struct bsdf_sample8 s = sample_random(id, &wo, &r, false);
            for (int lane = 0; lane < LANES; lane++) {
                float f = e.f_cos.x[lane], pdf = e.pdf[lane], rev = e.pdf_rev[lane];
                if (!(f >= 0) || !(pdf >= 0) || !(rev >= 0) || isinf(f))
                    fail_msg("%s: f cos %g, pdf %g, pdf_rev %g at cosines %g, %g", names[id],
                             (double)f, (double)pdf, (double)rev, (double)wo.z[lane],
                             (double)wi.z[lane]);
                if (!s.valid[lane])
                    continue;
                double length = sqrt((double)vec3x8_length2(s.wi)[lane]);
                if (!(s.weight.x[lane] >= 0) || isinf(s.weight.x[lane]) || !(s.pdf[lane] >= 0) ||
                    !(s.pdf_rev[lane] >= 0) || !(fabs(length - 1) < 1e-2))
                    fail_msg("%s: weight %g, pdf %g, pdf_rev %g, |wi| %g at cosine %g", names[id],
                             (double)s.weight.x[lane], (double)s.pdf[lane], (double)s.pdf_rev[lane],
                             length, (double)wo.z[lane]);
            }
        }
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

    /* And the energy is continuous across it */
    metal(METAL_TINY, ALPHA_SMOOTH, ALPHA_SMOOTH);
    double above = albedo(METAL_TINY, 0.6, 9), below = albedo(METAL_FLAT, 0.6, 9);
    metal(METAL_TINY, 5e-4f, 5e-4f);
    EXPECT_NEAR(above / below, 1, 1e-3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fresnel_has_its_table_values),
        cmocka_unit_test(an_index_of_one_is_transparent_at_every_angle),
        cmocka_unit_test(fresnel_rises_to_one_at_the_critical_angle),
        cmocka_unit_test(a_conductor_that_absorbs_nothing_is_a_dielectric),
        cmocka_unit_test(fresnel_has_its_hemispherical_means),
        cmocka_unit_test(frames_are_orthonormal_down_to_minus_z),
        cmocka_unit_test(the_peak_of_a_narrow_lobe_keeps_its_digits),
        cmocka_unit_test(the_weak_white_furnace_returns_one),
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
        cmocka_unit_test(frames_turn_with_the_surface),
        cmocka_unit_test(the_rim_of_the_cosine_lobe_weighs_the_reflectance),
        cmocka_unit_test(opposite_directions_and_grazing_ones_stay_finite),
        cmocka_unit_test(black_absorbs_and_lobes_without_weight_are_never_chosen),
        cmocka_unit_test(roughness_below_the_limit_is_a_mirror),
    };
    return cmocka_run_group_tests(tests, materials_fill, NULL);
}
