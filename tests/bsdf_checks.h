/*
 * What every BSDF must pass, whoever made its material: directions are distributed as their density
 * says, weights are values over densities, both densities change places with the directions, light
 * goes both ways alike, and no more leaves than arrives. H numbers are those of the numerics notes,
 * section 2.
 *
 * A check fails with the material's name. Given a planted bug, checks_* count instead what they
 * would have refused, so that a test can ask for it.
 */
#ifndef TESTS_BSDF_CHECKS_H
#define TESTS_BSDF_CHECKS_H

#include "common/effects.h"
#include "common/scene.h"
#include "tests/chi2.h"
#include "worker/kernel/bsdf.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

struct subject {
    const char *name;
    const struct scene *scene; /* of its coat tables */
    const struct material *material;
};

static inline enum transport_mode transported(bool importance)
{
    return importance ? TRANSPORT_IMPORTANCE : TRANSPORT_RADIANCE;
}

/* One copy of the code each, for both modes: the headers inline everything */
static __attribute__((noinline, unused)) struct bsdf_eval8 subject_eval(const struct subject *m,
                                                                        const struct vec3x8 *wo,
                                                                        const struct vec3x8 *wi,
                                                                        bool importance)
{
    struct bsdf8 b = bsdf_of_materials(m->scene, m->material, FX_ALL, I8(0));
    return bsdf_eval(&b, FX_ALL, transported(importance), I8(-1), *wo, *wi);
}

static __attribute__((noinline, unused)) struct bsdf_sample8
subject_sample(const struct subject *m, const struct vec3x8 *wo, const f8 u[3], bool importance)
{
    struct bsdf8 b = bsdf_of_materials(m->scene, m->material, FX_ALL, I8(0));
    return bsdf_sample(&b, FX_ALL, transported(importance), I8(-1), *wo, u[0], u[1], u[2]);
}

static inline struct bsdf_sample8 subject_random(const struct subject *m, const struct vec3x8 *wo,
                                                 struct random_lanes *r, bool importance)
{
    f8 u[3];
    for (int i = 0; i < 3; i++)
        u[i] = random_f8(r);
    return subject_sample(m, wo, u, importance);
}

/* Below the surface, relative to above it */
static inline float subject_ior(const struct subject *m)
{
    return m->material->kind == MATERIAL_DIELECTRIC ? m->material->ior : 1;
}

/* The narrowest width of any of its lobes, 1 where none is a microfacet's */
static inline double subject_width(const struct subject *m)
{
    const struct material *a = m->material;
    double width = 1;
    for (int i = 0; i < 2; i++) {
        bool facets = a->kind == MATERIAL_CONDUCTOR || a->kind == MATERIAL_DIELECTRIC ||
                      a->kind == MATERIAL_COAT || a->kind == MATERIAL_COATED_CONDUCTOR;
        if (facets && a->alpha[i] >= ALPHA_SMOOTH)
            width = fmin(width, (double)a->alpha[i]);
        if (a->kind == MATERIAL_COATED_CONDUCTOR && a->base_alpha[i] >= ALPHA_SMOOTH)
            width = fmin(width, (double)a->base_alpha[i]);
    }
    return width;
}

static inline struct vec3x8 at_cosine(double z)
{
    double across = sqrt(1 - z * z);
    return vec3x8_all((float)(across * 0.8), (float)(across * 0.6), (float)z);
}

static inline i8 scattered(const struct bsdf_sample8 *s)
{
    return s->valid & ~s->delta;
}

/* ---- distribution and density */

enum plant { SOUND, PDF_LARGE, COSINE_DROPPED, REUSED_NUMBER, WEIGHT_SMALL };

struct scatter {
    const struct subject *of;
    struct vec3x8 wo;
    bool importance;
    int side; /* 0: both; 1: reflection only; -1: transmission only */
    enum plant plant;
};

static inline void scatter_pdf(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct scatter *s = self;
    struct bsdf_eval8 e = subject_eval(s->of, &s->wo, w, s->importance);
    *pdf = e.pdf;
    f8 side = w->z * s->wo.z;
    if (s->side != 0)
        *pdf = f8_select(side * (float)s->side > 0, *pdf, F8(0));
    if (s->plant == PDF_LARGE)
        *pdf = *pdf * 1.02f;
    if (s->plant == COSINE_DROPPED)
        *pdf = f8_select(side > 0, F8((float)(0.5 / M_PI)), F8(0));
}

static inline void scatter_sample(void *self, struct random_lanes *r, struct vec3x8 *w, i8 *valid)
{
    const struct scatter *s = self;
    f8 u[3] = { random_f8(r), random_f8(r), random_f8(r) };
    if (s->plant == REUSED_NUMBER)
        u[2] = 0.9f * u[2] + 0.1f * u[1];
    struct bsdf_sample8 b = subject_sample(s->of, &s->wo, u, s->importance);
    *w = b.wi;
    *valid = scattered(&b);
    if (s->side != 0)
        *valid &= w->z * s->wo.z * (float)s->side > 0;
}

/* Around +z, or for a power above 1 around where a smooth surface would send the light */
static inline struct chi2_case scatter_case(struct scatter *s, double power, uint64_t seed)
{
    struct chi2_case c = { .self = s,
                           .axis = { 0, 0, 1 },
                           .power = power,
                           .samples = 100000,
                           .seed = seed,
                           .pdf = scatter_pdf,
                           .sample = scatter_sample };
    if (power > 1) {
        float ior = subject_ior(s->of);
        f8 eta = F8(s->wo.z[0] > 0 ? ior : 1 / ior), cos_t;
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

/* The whole integral of the density is the share of samples that scatter: for a microfacet lobe,
 * with what falls below the surface, the weak white furnace (H27) */
static inline void checks_distribution(struct scatter *s, double power, uint64_t seed, double slack)
{
    struct chi2_case test = scatter_case(s, power, seed);
    struct chi2_result r = chi2_run(&test);
    double cosine = (double)s->wo.z[0];
    if (!(r.p > CHI2_ALPHA) || r.outside > 2) /* a cell at the horizon may */
        fail_msg("%s, cosine %g, side %d: p = %g, %llu samples where the density is zero",
                 s->of->name, cosine, s->side, r.p, r.outside);
    if (!chi2_scale_right(&r, test.samples, slack))
        fail_msg("%s, cosine %g, side %d: the density integrates to %g, %g of the samples are "
                 "valid",
                 s->of->name, cosine, s->side, r.integral, r.share);
}

/* ---- the three ways to say one thing: weights, values, densities */

static inline double gap(f8 a, f8 b, int lane)
{
    double x = (double)a[lane], y = (double)b[lane];
    return fabs(x - y) / fmax(fmax(fabs(x), fabs(y)), 1e-12);
}

enum { GAP_WEIGHT, GAP_PDF, GAP_PDF_REV, GAP_EXCHANGED, GAPS };

/* The largest relative gaps: weight to f cos / pdf, pdf and pdf_rev of the sample to those of the
 * value, pdf_rev to the pdf of the exchanged directions */
static inline void checks_gaps(const struct subject *m, enum plant plant, bool importance,
                               double worst[GAPS])
{
    struct random_lanes r = { 1000 + (uint64_t)m->material->kind, 0 };
    memset(worst, 0, GAPS * sizeof(worst[0]));
    for (int i = 0; i < 4000; i++) {
        struct vec3x8 wo = random_direction(&r);
        struct bsdf_sample8 s = subject_random(m, &wo, &r, importance);
        if (plant == WEIGHT_SMALL)
            s.weight = vec3x8_scale(s.weight, F8(0.99f));
        if (plant == PDF_LARGE)
            s.pdf = s.pdf * 1.02f;
        struct bsdf_eval8 e = subject_eval(m, &wo, &s.wi, importance),
                          back = subject_eval(m, &s.wi, &wo, importance);
        struct vec3x8 weight = vec3x8_scale(e.f_cos, 1 / e.pdf);
        /* Within a degree of grazing a rounding of the direction is a large part of its cosine */
        i8 check = scattered(&s) & (f8_abs(wo.z) > 0.02f) & (f8_abs(s.wi.z) > 0.02f);
        for (unsigned todo = i8_bits(check); todo != 0; todo &= todo - 1) {
            int lane = __builtin_ctz(todo);
            worst[GAP_WEIGHT] = fmax(worst[GAP_WEIGHT], fmax(gap(s.weight.x, weight.x, lane),
                                                             gap(s.weight.z, weight.z, lane)));
            worst[GAP_PDF] = fmax(worst[GAP_PDF], gap(s.pdf, e.pdf, lane));
            worst[GAP_PDF_REV] = fmax(worst[GAP_PDF_REV], gap(s.pdf_rev, e.pdf_rev, lane));
            worst[GAP_EXCHANGED] = fmax(worst[GAP_EXCHANGED], gap(e.pdf_rev, back.pdf, lane));
            float ior = subject_ior(m);
            if (s.eta[lane] != (s.transmitted[lane] ? wo.z[lane] > 0 ? ior : 1 / ior : 1))
                fail_msg("%s: eta is %g", m->name, (double)s.eta[lane]);
        }
    }
}

/* A rounding of the half vector counts more in a narrow lobe; of glass again in the densities, and
 * in the reverse one beside the critical angle (H23) */
static inline void checks_agreement(const struct subject *m, bool importance)
{
    static const char *const what[GAPS] = { "weight and f cos / pdf", "pdf of sample and of eval",
                                            "pdf_rev of sample and of eval",
                                            "pdf_rev and pdf of the reverse" };
    static const double of_glass[GAPS] = { 1e-5, 1e-3, 3e-2, 3e-2 };
    double worst[GAPS];
    checks_gaps(m, SOUND, importance, worst);
    for (int k = 0; k < GAPS; k++) {
        double allowed = subject_ior(m) != 1 ? of_glass[k] : 2e-6 + 2e-6 / subject_width(m);
        if (!(worst[k] <= allowed))
            fail_msg("%s: %s differ by %g", m->name, what[k], worst[k]);
    }
}

/* ---- reciprocity */

/*
 * The share of pairs for which f(a, b) and f(b, a) differ by more than `by` of the larger, through
 * the surface f(a, b) n_a^2 and f(b, a) n_b^2, where n is the index on the direction's side (H30):
 * pairs from anywhere and pairs of a lobe, cosines below 0.02 left out.
 */
static inline double checks_reciprocity(const struct subject *m, double by, double planted)
{
    struct random_lanes r = { 30, 0 };
    double pairs = 0, apart = 0, ior2 = (double)subject_ior(m) * (double)subject_ior(m);
    for (int k = 0; k < 4000; k++) {
        struct vec3x8 a = random_direction(&r), b = random_direction(&r);
        if (k % 2) /* narrow lobes are hit by their own samples only */
            b = subject_random(m, &a, &r, false).wi;
        struct bsdf_eval8 there = subject_eval(m, &a, &b, false),
                          back = subject_eval(m, &b, &a, false);
        for (int lane = 0; lane < LANES; lane++) {
            double co = (double)a.z[lane], ci = (double)b.z[lane];
            double f = (double)there.f_cos.x[lane] / fabs(ci);
            double g = (double)back.f_cos.x[lane] / fabs(co);
            if (fabs(co) < 0.02 || fabs(ci) < 0.02 || f + g < 1e-4)
                continue;
            if (co * ci < 0 && co > 0)
                f *= ior2;
            if (co * ci < 0 && co < 0)
                g *= ior2;
            f *= 1 + planted;
            apart += !(fabs(f - g) <= by * fmax(f, g));
            pairs += 1;
        }
    }
    return apart / fmax(pairs, 1);
}

/* The notes' 1e-5 for all but glass: beside the critical angle a rounding counts more (H23), and
 * one pair in two hundred is more than 1e-4 apart */
static inline void checks_both_ways(const struct subject *m)
{
    bool glass = subject_ior(m) != 1;
    double by = glass ? 1e-4 : 1e-5, share = checks_reciprocity(m, by, 0);
    if (!(share <= (glass ? 5e-3 : 0)))
        fail_msg("%s: f there and f back differ by more than %g for %g of all pairs", m->name, by,
                 share);
    if (!(checks_reciprocity(m, by, 2 * by) > 0.5))
        fail_msg("%s: a difference of %g is not seen", m->name, 2 * by);
}

/* ---- energy */

/* The mean weight in one channel, delta events included, as importance: light, not radiance */
static inline struct tally subject_albedo(const struct subject *m, double cosine, int channel,
                                          int rounds, uint64_t seed)
{
    struct vec3x8 wo = at_cosine(cosine);
    struct random_lanes r = { seed, 0 };
    struct tally t = { 0 };
    for (int i = 0; i < rounds; i++) {
        struct bsdf_sample8 s = subject_random(m, &wo, &r, true);
        const f8 rgb[3] = { s.weight.x, s.weight.y, s.weight.z };
        for (int lane = 0; lane < LANES; lane++)
            tally_add(&t, s.valid[lane] ? (double)rgb[channel][lane] : 0);
    }
    return t;
}

/* By how many standard errors more than all of it is returned, at the worst of several angles */
static inline double checks_energy(const struct subject *m, double planted)
{
    static const double cosines[] = { 1, 0.6, 0.25, 0.05, -0.05, -0.4, -0.9 };
    double worst = 0;
    for (size_t i = 0; i < sizeof(cosines) / sizeof(cosines[0]); i++) {
        struct tally t = subject_albedo(m, cosines[i], (int)i % 3, 6000, 3);
        double more = planted * tally_mean(&t) - 1;
        worst = fmax(worst, more / (sqrt(tally_variance(&t) / t.n) + 1e-6));
    }
    return worst;
}

/* ---- the ends of the unit interval */

/* Every sample made of the first, the last and other numbers is sound, also at the rim of its lobe,
 * where a density vanishes (H28): finite, not above `most`, its direction unit */
static inline void checks_corners(const struct subject *m, double most)
{
    static const float ends[] = { 0, 0x1p-24f, 0.5f, 1 - 0x1p-23f, 1 - 0x1p-24f };
    static const double cosines[] = { 1, 0.5, 1e-2, 1e-4, -1e-4, -0.3 };
    enum { ENDS = sizeof(ends) / sizeof(ends[0]) };
    for (int i = 0; i < ENDS * ENDS * ENDS * 6; i++) {
        struct vec3x8 wo = at_cosine(cosines[i % 6]);
        const f8 u[3] = { F8(ends[i / 6 % ENDS]), F8(ends[i / 6 / ENDS % ENDS]),
                          F8(ends[i / 6 / ENDS / ENDS]) };
        struct bsdf_sample8 s = subject_sample(m, &wo, u, true);
        if (!s.valid[0])
            continue;
        struct vec3x8 w = s.weight;
        bool sound = w.x[0] >= 0 && w.y[0] >= 0 && w.z[0] >= 0 &&
                     (double)vec3x8_max(w)[0] <= most && fabsf(s.wi.z[0]) > 0 &&
                     fabsf(vec3x8_length2(s.wi)[0] - 1) < 1e-4f && s.pdf_rev[0] >= 0 &&
                     (s.delta[0] ? s.pdf[0] == 0 : s.pdf[0] > 0) && isfinite(s.pdf[0]);
        if (!sound)
            fail_msg("%s at cosine %g, numbers %g, %g, %g: weight %g %g %g, pdf %g, pdf_rev %g, "
                     "wi.z %g",
                     m->name, cosines[i % 6], (double)u[0][0], (double)u[1][0], (double)u[2][0],
                     (double)w.x[0], (double)w.y[0], (double)w.z[0], (double)s.pdf[0],
                     (double)s.pdf_rev[0], (double)s.wi.z[0]);
    }
}

#endif
