/*
 * Goal: metal under a coat, tabulated by the master and evaluated by the kernel, returns as much
 * light as pbrt's random walk between the two surfaces does, which is walked here the plain way.
 */
#include "common/effects.h"
#include "common/scene.h"
#include "master/coat.h"
#include "tests/chi2.h"
#include "tests/dielectric.h"
#include "worker/kernel/bsdf.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#define WALKS     200000
#define TURNS_MAX 2000

/* What the model may miss of the light that arrives: over white metal, and over any other, where
 * the colour of what comes out after many turns is an estimate, worst at grazing angles */
#define ALLOWED_WHITE 0.013
#define ALLOWED       0.02

struct coated {
    double top, base, n, thickness;
    float eta, k; /* of the metal */
};

#define WHITE 0, 1e4f /* reflects everything, from every direction */
#define GREEN 0.9f, 2.4f
#define DARK  1, 2 /* half of it at normal incidence, in air */

/* ---- the walk */

struct direction {
    double x, y, z;
};

static double dot(struct direction a, struct direction b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* A normal by D cos and the weight that makes it one of the visible normals; false: none */
static bool draw_normal(struct random_lanes *r, struct direction w, double alpha,
                        struct direction *m, double *weight)
{
    *m = (struct direction){ 0, 0, 1 };
    *weight = 1;
    if (alpha == 0)
        return true;
    double u = random_double(r), phi = 2 * M_PI * random_double(r);
    double z = sqrt((1 - u) / (1 + (alpha * alpha - 1) * u)), across = sqrt(fmax(0, 1 - z * z));
    *m = (struct direction){ across * cos(phi), across * sin(phi), z };
    double c = dot(w, *m);
    if (c <= 0)
        return false;
    *weight = c / (w.z * z);
    return true;
}

static double shadowing(double a, double b, double alpha)
{
    return alpha == 0 ? 1
                      : 1 / (1 + dielectric_lambda(a, alpha) + dielectric_lambda(fabs(b), alpha));
}

/*
 * The interface met from a side where w points away from it, z > 0; n is the far side's index over
 * the near one's. Chooses reflection or transmission by Fresnel; *w becomes where the light goes
 * on, seen from the side where it then is: z > 0, going away from the interface.
 */
static double meet_interface(struct random_lanes *r, double alpha, double n, struct direction *w,
                             bool *through)
{
    struct direction m;
    double weight;
    *through = false;
    if (!draw_normal(r, *w, alpha, &m, &weight))
        return 0;
    double c = dot(*w, m), F = dielectric_fresnel(c, n), k = 2 * c, s = 1;
    *through = random_double(r) >= F;
    if (*through) {
        s = 1 / n;
        k = c / n - sqrt(fmax(0, 1 - (1 - c * c) / (n * n)));
    }
    struct direction out = { k * m.x - s * w->x, k * m.y - s * w->y, k * m.z - s * w->z };
    if (*through)
        out.z = -out.z;
    if (out.z <= 0)
        return 0;
    weight *= shadowing(w->z, out.z, alpha);
    *w = out;
    return weight;
}

/* Energy that comes out of one walk from cosine mu */
static double walk(struct random_lanes *r, const struct coated *at, double mu)
{
    struct direction w = { sqrt(1 - mu * mu), 0, mu };
    bool through;
    double beta = meet_interface(r, at->top, at->n, &w, &through);
    if (!through)
        return beta;
    for (int turn = 0; turn < TURNS_MAX && beta > 0; turn++) {
        beta *= exp(-at->thickness / w.z);
        struct direction m;
        double weight;
        w.x = -w.x; /* from where it came */
        w.y = -w.y;
        if (!draw_normal(r, w, at->base, &m, &weight))
            return 0;
        double c = dot(w, m), z = w.z;
        w = (struct direction){ 2 * c * m.x - w.x, 2 * c * m.y - w.y, 2 * c * m.z - w.z };
        if (w.z <= 0)
            return 0;
        beta *= weight * shadowing(z, w.z, at->base) * exp(-at->thickness / w.z);
        beta *= (double)fresnel_conductor(F8((float)c), F8(at->eta / (float)at->n),
                                          F8(at->k / (float)at->n))[0];
        w.x = -w.x;
        w.y = -w.y;
        beta *= meet_interface(r, at->top, 1 / at->n, &w, &through);
        if (through)
            return beta;
        if (beta < 0.1) { /* roulette */
            if (random_double(r) < 0.5)
                return 0;
            beta *= 2;
        }
    }
    return 0;
}

/* ---- the model */

static struct material material;
static float tables[(COAT_METAL_ROWS * COAT_ALPHAS + 1) * COAT_TABLE_LEN];
static struct scene scene = { .materials = &material, .material_count = 1, .coat_tables = tables };

static void coated_fill(const struct coated *at)
{
    struct coat_metal coat;
    coat_metal_tabulate(at->top, at->base, at->n, at->thickness, &coat);
    memcpy(tables, coat.rows, sizeof(coat.rows));
    material = (struct material){ .kind = MATERIAL_COATED_CONDUCTOR,
                                  .alpha = { (float)at->top, (float)at->top },
                                  .base_alpha = { (float)at->base, (float)at->base },
                                  .ior = (float)at->n,
                                  .coat_inner = coat.inner,
                                  .coat_scale = coat.scale };
    for (int c = 0; c < 3; c++) {
        material.eta[c] = at->eta;
        material.k[c] = at->k;
    }
}

static __attribute__((noinline)) struct bsdf_sample8 sample(const struct vec3x8 *wo, const f8 u[3])
{
    struct bsdf8 b = bsdf_of(&scene, FX_ALL, I8(0));
    return bsdf_sample(&b, FX_ALL, TRANSPORT_RADIANCE, I8(-1), *wo, u[0], u[1], u[2]);
}

static struct tally model(double mu, uint64_t seed)
{
    struct vec3x8 wo = vec3x8_all((float)sqrt(1 - mu * mu), 0, (float)mu);
    struct random_lanes r = { seed, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < WALKS / LANES; i++) {
        f8 u[3] = { random_f8(&r), random_f8(&r), random_f8(&r) };
        struct bsdf_sample8 s = sample(&wo, u);
        for (int lane = 0; lane < LANES; lane++)
            tally_add(&t, s.valid[lane] ? (double)s.weight.y[lane] : 0);
    }
    return t;
}

static struct tally walked(const struct coated *at, double mu, uint64_t seed)
{
    struct random_lanes r = { seed, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < WALKS; i++)
        tally_add(&t, walk(&r, at, mu));
    return t;
}

static const struct coated rows[] = {
    { 0, 0, 1.5, 0.01, WHITE },     { 0, 0.05, 1.5, 0.01, WHITE },  { 0, 0.3, 1.5, 0, WHITE },
    { 0, 0.8, 1.5, 0.01, WHITE },   { 0.1, 0, 1.5, 0.01, WHITE },   { 0.4, 0, 1.5, 0.01, WHITE },
    { 0.2, 0.2, 1.5, 0.01, WHITE }, { 0.3, 0.5, 1.33, 0.1, WHITE }, { 0.1, 0.1, 2.2, 0.01, WHITE },
    { 0, 0, 1.5, 0.01, GREEN },     { 0, 0.3, 1.5, 0.01, GREEN },   { 0.2, 0.2, 1.5, 0.5, GREEN },
    { 0, 0, 1.5, 0.01, DARK },      { 0, 0.1, 1.5, 0.01, DARK },    { 0.3, 0.1, 1.5, 0.01, DARK },
    { 0.2, 0.5, 1.8, 0.01, DARK },
};
static const double cosines[] = { 0.1, 0.3, 0.6, 0.95 };

static double noise(const struct tally *t)
{
    return 4.5 * sqrt(tally_variance(t) / t->n);
}

static double allowed(const struct coated *at)
{
    return at->eta == 0 ? ALLOWED_WHITE : ALLOWED;
}

static void metal_under_a_coat_returns_what_the_walk_does(void **state)
{
    (void)state;
    double worst = 0;
    int caught = 0, runs = 0;
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        coated_fill(&rows[i]);
        for (int c = 0; c < 4; c++) {
            struct tally a = model(cosines[c], i), b = walked(&rows[i], cosines[c], 100 + i);
            double gap = fabs(tally_mean(&a) - tally_mean(&b)), by = noise(&a) + noise(&b);
            if (!(gap <= allowed(&rows[i]) + by))
                fail_msg("top %g, metal %g, n %g, eta %g at cosine %g: %g, and the walk %g",
                         rows[i].top, rows[i].base, rows[i].n, (double)rows[i].eta, cosines[c],
                         tally_mean(&a), tally_mean(&b));
            worst = fmax(worst, gap);
        }
    }
    printf("the model misses at most %.4f\n", worst);

    /* Planted: the metal's own Fresnel against air instead of the coat; light lost beyond the
     * critical angle for good; 4 % more through the interface */
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        for (int plant = 0; plant < 3; plant++) {
            if ((plant == 0 && rows[i].eta != 1) ||
                (plant == 1 && (rows[i].base < 0.3 || rows[i].eta > 0)))
                continue;
            coated_fill(&rows[i]);
            for (int k = 0; k < 3; k++) {
                material.eta[k] *= plant == 0 ? material.ior : 1;
                material.k[k] *= plant == 0 ? material.ior : 1;
            }
            material.coat_scale *= plant == 1 ? 0 : 1;
            for (int k = 0; k < COAT_TABLE_LEN; k++)
                tables[k] *= plant == 2 ? 1.04f : 1;
            struct tally a = model(0.6, i), b = walked(&rows[i], 0.6, 100 + i);
            caught += fabs(tally_mean(&a) - tally_mean(&b)) >
                      allowed(&rows[i]) + noise(&a) + noise(&b);
            runs++;
        }
    if (caught * 4 < runs * 3)
        fail_msg("of %d planted bugs only %d were seen", runs, caught);
}

static void two_mirrors_are_exact(void **state)
{
    (void)state;
    const struct coated at = { 0, 0, 1.5, 0.1, GREEN };
    coated_fill(&at);
    for (double mu = 0.05; mu <= 1; mu += 0.05) {
        double inside = sqrt(1 - (1 - mu * mu) / 2.25), A = exp(-0.1 / inside);
        double F = dielectric_fresnel(mu, 1.5);
        double Fc = (double)fresnel_conductor(F8((float)inside), F8(0.6f), F8(1.6f))[0];
        double want = F + (1 - F) * (1 - F) * A * A * Fc / (1 - F * Fc * A * A);
        struct tally t = model(mu, 5);
        EXPECT_NEAR(tally_mean(&t), want, 1.5e-3);
        EXPECT_NEAR(tally_variance(&t), 0, 1e-6); /* one event, whichever mirror was chosen */
    }
}

/* A table for each width, read between them, is nearly that of the width itself */
static void tables_of_many_widths_agree_with_those_of_one(void **state)
{
    (void)state;
    const double base = 0.2, n = 1.5, thickness = 0.01;
    static float many[sizeof(tables) / sizeof(tables[0])];
    const size_t rows_len = COAT_METAL_ROWS * COAT_TABLE_LEN;
    float *last = many + COAT_ALPHAS * rows_len;
    for (int j = 0; j < COAT_ALPHAS; j++) {
        struct coat_metal coat;
        double root = (double)j / (COAT_ALPHAS - 1);
        coat_metal_tabulate(root * root, base, n, thickness, &coat);
        memcpy(many + (size_t)j * rows_len, coat.rows, sizeof(coat.rows));
        last[j] = coat.inner;
        last[COAT_ALPHAS + j] = coat.scale > 0 ? 1 / coat.scale : 0;
    }
    const double widths[] = { 0, 0.01, 0.05, 0.13, 0.4, 0.8, 1 };
    for (size_t i = 0; i < sizeof(widths) / sizeof(widths[0]); i++) {
        const struct coated at = { widths[i], base, n, thickness, WHITE };
        coated_fill(&at);
        struct tally one[4];
        for (int c = 0; c < 4; c++)
            one[c] = model(cosines[c], i);
        memcpy(tables, many, sizeof(many));
        material.flags |= MATERIAL_COATS;
        for (int c = 0; c < 4; c++) {
            struct tally t = model(cosines[c], i);
            EXPECT_NEAR(tally_mean(&t), tally_mean(&one[c]), 0.01 + noise(&t));
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(metal_under_a_coat_returns_what_the_walk_does),
        cmocka_unit_test(two_mirrors_are_exact),
        cmocka_unit_test(tables_of_many_widths_agree_with_those_of_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
