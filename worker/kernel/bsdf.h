/*
 * BSDFs, eight at a time: value, sampling and both densities of every material kind.
 *
 * Directions are in the local shading frame and point away from the surface. f_cos is
 * f(wo, wi) |cos theta_i|; densities are per solid angle: pdf of wi given wo, pdf_rev of wo given
 * wi. Delta lobes have no density: `delta` is set, and f_cos / pdf is given as `weight`. In
 * TRANSPORT_RADIANCE a transmission scales by 1 / eta^2 (radiance is compressed or expanded),
 * in TRANSPORT_IMPORTANCE it does not.
 *
 * Each kind present among the lanes is evaluated once, under a mask; kinds outside the constant
 * mask `fx` are not compiled. Kinds but dielectric are two-sided: they take wo to the upper side.
 */
#ifndef WORKER_KERNEL_BSDF_H
#define WORKER_KERNEL_BSDF_H

#include "common/effects.h"
#include "common/scene.h"
#include "worker/kernel/fresnel.h"
#include "worker/kernel/ggx.h"

#include <stddef.h>

enum transport_mode { TRANSPORT_RADIANCE = 0, TRANSPORT_IMPORTANCE = 1 };

/* Field `field` of the array of structs at `base`, for element `index` of each lane */
#define GATHER(base, type, field, index)                                       \
    f8_gather((const float *)(const void *)(base) + offsetof(type, field) / 4, \
              (index) * (int32_t)(sizeof(type) / 4))
#define GATHER_I(base, type, field, index) ((i8)GATHER(base, type, field, index))
#define GATHER3(base, type, field, index)                                                       \
    ((struct vec3x8){ GATHER(base, type, field[0], index), GATHER(base, type, field[1], index), \
                      GATHER(base, type, field[2], index) })

struct bsdf8 {
    const struct material *materials;
    const float *coat_tables;
    i8 id;                     /* material of each lane, valid for every lane */
    i8 kind;                   /* enum material_kind */
    struct vec3x8 reflectance; /* of the diffuse part */
};

struct bsdf_eval8 {
    struct vec3x8 f_cos;
    f8 pdf, pdf_rev;
};

struct bsdf_sample8 {
    struct vec3x8 wi;
    struct vec3x8 weight; /* f_cos / pdf */
    f8 pdf, pdf_rev;      /* of all non-delta lobes together; 0 for a delta event */
    i8 delta, transmitted;
    f8 eta; /* n_transmitted / n_incident of a transmission, else 1 */
    i8 valid;
};

/* Of materials[id]: the scene's, or copies that textures have changed */
LANE_FN struct bsdf8 bsdf_of_materials(const struct scene *scene, const struct material *materials,
                                       unsigned fx, i8 id)
{
    struct bsdf8 b;
    b.materials = materials;
    b.coat_tables = scene->coat_tables;
    b.id = id;
    const unsigned other = FX_MIXTURE | FX_CONDUCTOR | FX_DIELECTRIC | FX_COAT | FX_MIX;
    b.kind = fx & other ? GATHER_I(materials, struct material, kind, id) : I8(MATERIAL_DIFFUSE);
    b.reflectance = GATHER3(materials, struct material, reflectance, id);
    return b;
}

LANE_FN struct bsdf8 bsdf_of(const struct scene *scene, unsigned fx, i8 id)
{
    return bsdf_of_materials(scene, scene->materials, fx, id);
}

/* The widths; zero in both where the surface counts as smooth, positive in both elsewhere */
LANE_FN struct ggx8 bsdf_ggx(const struct bsdf8 *b)
{
    f8 ax = GATHER(b->materials, struct material, alpha[0], b->id);
    f8 ay = GATHER(b->materials, struct material, alpha[1], b->id);
    i8 rough = (ax >= ALPHA_SMOOTH) | (ay >= ALPHA_SMOOTH);
    return (struct ggx8){ f8_select(rough, f8_max(ax, F8(ALPHA_SMOOTH)), F8(0)),
                          f8_select(rough, f8_max(ay, F8(ALPHA_SMOOTH)), F8(0)) };
}

/* Lanes whose every lobe is a delta event: light sampling cannot reach them */
LANE_FN i8 bsdf_all_delta(const struct bsdf8 *b, unsigned fx)
{
    i8 all = I8(0);
    if (fx & (FX_CONDUCTOR | FX_DIELECTRIC)) {
        i8 kind = (b->kind == MATERIAL_CONDUCTOR) | (b->kind == MATERIAL_DIELECTRIC);
        all = kind;
        if (fx & FX_ROUGH)
            all &= bsdf_ggx(b).ax == 0;
    }
    return all;
}

LANE_FN f8 f8_sum3(struct vec3x8 a)
{
    return a.x + a.y + a.z;
}

/* The mirror direction about h; both unit */
LANE_FN struct vec3x8 bsdf_mirror(struct vec3x8 wo, struct vec3x8 h)
{
    return vec3x8_sub(vec3x8_scale(h, 2 * vec3x8_dot(wo, h)), wo);
}

/*
 * Refract wo about h (wo.h > 0), eta = n_transmitted / n_incident, cos_t from Fresnel. The part
 * across h is -wo's divided by eta.
 */
LANE_FN struct vec3x8 bsdf_refract(struct vec3x8 wo, struct vec3x8 h, f8 eta, f8 cos_t)
{
    f8 inv = 1 / eta;
    f8 c = vec3x8_dot(wo, h);
    struct vec3x8 across = vec3x8_sub(wo, vec3x8_scale(h, c));
    return vec3x8_unit(vec3x8_sub(vec3x8_scale(across, -inv), vec3x8_scale(h, cos_t)));
}

/* ---- mixture: diffuse with probability p = k_d / (k_d + k_s), else a perfect mirror; black
 * absorbs */

LANE_FN f8 mixture_p(const struct bsdf8 *b, struct vec3x8 specular)
{
    f8 kd = f8_sum3(b->reflectance), ks = f8_sum3(specular);
    return f8_select(kd + ks > 0, kd / (kd + ks), F8(0));
}

/* ---- conductor */

LANE_FN struct vec3x8 conductor_F(const struct bsdf8 *b, f8 c)
{
    struct vec3x8 eta = GATHER3(b->materials, struct material, eta, b->id);
    struct vec3x8 k = GATHER3(b->materials, struct material, k, b->id);
    return (struct vec3x8){ fresnel_conductor(c, eta.x, k.x), fresnel_conductor(c, eta.y, k.y),
                            fresnel_conductor(c, eta.z, k.z) };
}

/* ---- coat: dielectric interface over a diffuse base, see struct material */

struct coat8 {
    struct vec3x8 base; /* reflectance * scale / (1 - reflectance * inner) */
    f8 ior;
    i8 table;
};

LANE_FN struct coat8 coat_of(const struct bsdf8 *b)
{
    struct coat8 coat;
    f8 inner = GATHER(b->materials, struct material, coat_inner, b->id);
    f8 scale = GATHER(b->materials, struct material, coat_scale, b->id);
    coat.base = (struct vec3x8){ b->reflectance.x * scale / (1 - b->reflectance.x * inner),
                                 b->reflectance.y * scale / (1 - b->reflectance.y * inner),
                                 b->reflectance.z * scale / (1 - b->reflectance.z * inner) };
    coat.ior = GATHER(b->materials, struct material, ior, b->id);
    coat.table = GATHER_I(b->materials, struct material, coat_table, b->id) * COAT_TABLE_LEN;
    return coat;
}

LANE_FN f8 coat_T(const struct bsdf8 *b, const struct coat8 *coat, f8 mu)
{
    f8 x = f8_sqrt(f8_clamp(mu, 0, 1)) * (float)(COAT_TABLE_LEN - 1);
    i8 i = i8_from_f8(f8_min(x, F8(COAT_TABLE_LEN - 2)));
    f8 t = x - f8_from_i8(i);
    f8 low = f8_gather(b->coat_tables, coat->table + i);
    f8 high = f8_gather(b->coat_tables, coat->table + i + 1);
    return (1 - t) * low + t * high;
}

/* Share of samples for the interface lobe: its reflectance against what the base can give back */
LANE_FN f8 coat_p(const struct coat8 *coat, f8 mu, f8 T)
{
    f8 cos_t;
    f8 F = fresnel_dielectric(mu, coat->ior, &cos_t);
    f8 base = PI_F * T * f8_sum3(coat->base) * (1 / 3.0f);
    f8 sum = F + base;
    return f8_select(sum > 0, F / sum, F8(1));
}

/*
 * f cos and both densities for given directions, delta lobes excluded. wo.z != 0 in valid lanes;
 * lanes outside `valid` give zero.
 */
LANE_FN struct bsdf_eval8 bsdf_eval(const struct bsdf8 *b, unsigned fx, enum transport_mode mode,
                                    i8 valid, struct vec3x8 wo, struct vec3x8 wi)
{
    struct bsdf_eval8 out = { vec3x8_all(0, 0, 0), F8(0), F8(0) };
    f8 co = f8_abs(wo.z), ci = f8_abs(wi.z);
    i8 same_side = (wo.z * wi.z > 0) & valid;

    /* The diffuse lobe, which diffuse, mixture and coat share */
    i8 diffuse = same_side & (b->kind == MATERIAL_DIFFUSE);
    f8 lambert = ci * PI_INV_F;
    out.f_cos = vec3x8_select(diffuse, vec3x8_scale(b->reflectance, lambert), out.f_cos);
    out.pdf = f8_select(diffuse, lambert, out.pdf);
    out.pdf_rev = f8_select(diffuse, co * PI_INV_F, out.pdf_rev);

    if (fx & FX_MIXTURE) {
        i8 lanes = same_side & (b->kind == MATERIAL_MIXTURE);
        if (i8_any(lanes)) {
            struct vec3x8 ks = GATHER3(b->materials, struct material, specular, b->id);
            f8 p = mixture_p(b, ks);
            out.f_cos = vec3x8_select(lanes, vec3x8_scale(b->reflectance, lambert), out.f_cos);
            out.pdf = f8_select(lanes, p * lambert, out.pdf);
            out.pdf_rev = f8_select(lanes, p * co * PI_INV_F, out.pdf_rev);
        }
    }

    if ((fx & FX_CONDUCTOR) && (fx & FX_ROUGH)) {
        i8 lanes = same_side & (b->kind == MATERIAL_CONDUCTOR);
        struct ggx8 g = bsdf_ggx(b);
        lanes &= g.ax > 0;
        if (i8_any(lanes)) {
            struct vec3x8 o = { wo.x, wo.y, co }, i = { wi.x, wi.y, ci };
            struct vec3x8 sum = vec3x8_add(o, i);
            lanes &= vec3x8_length2(sum) > 0;
            struct vec3x8 h = vec3x8_unit(sum);
            f8 D = ggx_D(g, h), oh = vec3x8_dot(o, h);
            f8 f = D * ggx_G2(g, o, i) / (4 * co);
            out.f_cos = vec3x8_select(lanes, vec3x8_scale(conductor_F(b, oh), f), out.f_cos);
            out.pdf = f8_select(lanes, ggx_G1(g, o) * D / (4 * co), out.pdf);
            out.pdf_rev = f8_select(lanes, ggx_G1(g, i) * D / (4 * ci), out.pdf_rev);
        }
    }

    if ((fx & FX_DIELECTRIC) && (fx & FX_ROUGH)) {
        struct ggx8 g = bsdf_ggx(b);
        i8 lanes = valid & (b->kind == MATERIAL_DIELECTRIC) & (g.ax > 0) & (wi.z != 0);
        if (i8_any(lanes)) {
            f8 ior = GATHER(b->materials, struct material, ior, b->id);
            f8 eta = f8_select(wo.z > 0, ior, 1 / ior);
            lanes &= ior != 1; /* nothing is there, however rough: a delta event straight on */
            i8 reflect = wo.z * wi.z > 0;

            /* The generalised half vector, on the side of wo's normal */
            f8 scale = f8_select(reflect, F8(1), eta);
            struct vec3x8 h = vec3x8_along(wo, wi, scale);
            lanes &= vec3x8_length2(h) > 0;
            h = vec3x8_unit(h);
            h = vec3x8_select(h.z < 0, vec3x8_neg(h), h);
            struct vec3x8 side = vec3x8_select(wo.z < 0, vec3x8_neg(h), h);
            f8 oh = vec3x8_dot(wo, side), ih = vec3x8_dot(wi, side);
            /* Back-facing microfacets do not exist for either direction */
            lanes &= (oh > 0) & ((ih > 0) == reflect);

            f8 cos_t;
            f8 F = fresnel_dielectric(oh, eta, &cos_t);
            f8 F_rev = f8_select(reflect, F, fresnel_dielectric(f8_abs(ih), 1 / eta, &cos_t));
            struct vec3x8 o = { wo.x, wo.y, co }, i = { wi.x, wi.y, ci };
            f8 D = ggx_D(g, h), G2 = ggx_G2(g, o, i);
            f8 G1o = ggx_G1(g, o), G1i = ggx_G1(g, i);

            /* Walter et al. 2007: equations 20 and 21 */
            f8 denominator = ih + oh / eta;
            denominator = f8_max(denominator * denominator, F8(1e-30f));
            f8 denominator_rev = oh + ih * eta;
            denominator_rev = f8_max(denominator_rev * denominator_rev, F8(1e-30f));
            f8 aih = f8_abs(ih);
            f8 f_r = F * D * G2 / (4 * co);
            f8 f_t = (1 - F) * D * G2 * aih * oh / (co * denominator);
            if (mode == TRANSPORT_RADIANCE)
                f_t = f_t / (eta * eta);
            f8 visible_o = G1o * D / co, visible_i = G1i * D / ci;
            f8 pdf_r = F * visible_o * 0.25f, pdf_r_rev = F * visible_i * 0.25f;
            f8 pdf_t = (1 - F) * visible_o * oh * aih / denominator;
            f8 pdf_t_rev = (1 - F_rev) * visible_i * aih * oh / denominator_rev;

            f8 f = f8_select(reflect, f_r, f_t);
            out.f_cos = vec3x8_select(lanes, (struct vec3x8){ f, f, f }, out.f_cos);
            out.pdf = f8_select(lanes, f8_select(reflect, pdf_r, pdf_t), out.pdf);
            out.pdf_rev = f8_select(lanes, f8_select(reflect, pdf_r_rev, pdf_t_rev), out.pdf_rev);
        }
    }

    if (fx & FX_COAT) {
        i8 lanes = same_side & (b->kind == MATERIAL_COAT);
        if (i8_any(lanes)) {
            struct coat8 coat = coat_of(b);
            f8 To = coat_T(b, &coat, co), Ti = coat_T(b, &coat, ci);
            struct vec3x8 f = vec3x8_scale(coat.base, To * Ti * ci);
            f8 po = coat_p(&coat, co, To), pi = coat_p(&coat, ci, Ti);
            f8 pdf = (1 - po) * lambert, pdf_rev = (1 - pi) * co * PI_INV_F;
            if (fx & FX_ROUGH) {
                struct ggx8 g = bsdf_ggx(b);
                i8 rough = g.ax > 0;
                struct vec3x8 o = { wo.x, wo.y, co }, i = { wi.x, wi.y, ci };
                /* Mirrored together with wo when it comes from below */
                struct vec3x8 h = vec3x8_unit(vec3x8_add(o, i));
                f8 D = ggx_D(g, h), cos_t;
                f8 F = fresnel_dielectric(vec3x8_dot(o, h), coat.ior, &cos_t);
                f8 f_r = f8_select(rough, F * D * ggx_G2(g, o, i) / (4 * co), F8(0));
                f = (struct vec3x8){ f.x + f_r, f.y + f_r, f.z + f_r };
                pdf = pdf + f8_select(rough, po * ggx_G1(g, o) * D / (4 * co), F8(0));
                pdf_rev = pdf_rev + f8_select(rough, pi * ggx_G1(g, i) * D / (4 * ci), F8(0));
            }
            out.f_cos = vec3x8_select(lanes, f, out.f_cos);
            out.pdf = f8_select(lanes, pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, pdf_rev, out.pdf_rev);
        }
    }
    return out;
}

/*
 * Choose wi. `lobe` picks between lobes, (u, v) the direction. Lanes where nothing is scattered
 * come back with valid = 0.
 */
LANE_FN struct bsdf_sample8 bsdf_sample(const struct bsdf8 *b, unsigned fx,
                                        enum transport_mode mode, i8 valid, struct vec3x8 wo,
                                        f8 lobe, f8 u, f8 v)
{
    struct bsdf_sample8 out;
    f8 co = f8_abs(wo.z);
    valid &= co > 0;
    out.delta = I8(0);
    out.transmitted = I8(0);
    out.eta = F8(1);

    /*
     * The cosine lobe, needed by almost every path: Lambert's weight is the reflectance itself,
     * never 0 / 0 at the rim (NUMERICS H28)
     */
    f8 r = f8_sqrt(u), sine, cosine;
    f8_sincos_turns(v, &sine, &cosine);
    struct vec3x8 lift = { r * cosine, r * sine, f8_mulsign(f8_sqrt(1 - u), wo.z) };
    out.wi = lift;
    out.weight = b->reflectance;
    out.pdf = f8_abs(lift.z) * PI_INV_F;
    out.pdf_rev = co * PI_INV_F;
    out.valid = valid & (b->kind == MATERIAL_DIFFUSE) & (lift.z != 0);

    if (fx & FX_MIXTURE) {
        i8 lanes = valid & (b->kind == MATERIAL_MIXTURE);
        if (i8_any(lanes)) {
            struct vec3x8 ks = GATHER3(b->materials, struct material, specular, b->id);
            f8 p = mixture_p(b, ks);
            i8 mirror = lanes & (lobe >= p);
            f8 chosen = f8_select(mirror, 1 - p, p);
            struct vec3x8 weight = vec3x8_select(mirror, ks, b->reflectance);
            out.wi = vec3x8_select(mirror, (struct vec3x8){ -wo.x, -wo.y, wo.z }, out.wi);
            out.weight = vec3x8_select(lanes, vec3x8_scale(weight, 1 / chosen), out.weight);
            out.pdf = f8_select(lanes, p * out.pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, p * out.pdf_rev, out.pdf_rev);
            out.delta |= mirror;
            i8 black = f8_sum3(b->reflectance) + f8_sum3(ks) <= 0;
            out.valid |= lanes & ~black & (chosen > 0) & (mirror | (lift.z != 0));
        }
    }

    if (fx & FX_CONDUCTOR) {
        i8 lanes = valid & (b->kind == MATERIAL_CONDUCTOR);
        if (i8_any(lanes)) {
            struct vec3x8 o = { wo.x, wo.y, co }, h = vec3x8_all(0, 0, 1);
            f8 weight = F8(1), pdf = F8(0), pdf_rev = F8(0);
            i8 smooth = I8(-1);
            if (fx & FX_ROUGH) {
                struct ggx8 g = bsdf_ggx(b);
                smooth = g.ax <= 0;
                g.ax = f8_select(smooth, F8(1), g.ax);
                g.ay = f8_select(smooth, F8(1), g.ay);
                struct vec3x8 m = ggx_visible_sample(g, o, u, v);
                h = vec3x8_select(smooth, h, m);
                struct vec3x8 i = bsdf_mirror(o, h);
                f8 G1 = ggx_G1(g, o), D = ggx_D(g, h);
                weight = f8_select(smooth, F8(1), ggx_G2(g, o, i) / G1);
                pdf = f8_select(smooth, F8(0), G1 * D / (4 * co));
                pdf_rev = f8_select(smooth, F8(0), ggx_G1(g, i) * D / (4 * f8_abs(i.z)));
            }
            struct vec3x8 i = bsdf_mirror(o, h);
            i8 up = i.z > 0;
            i.z = f8_mulsign(i.z, wo.z);
            struct vec3x8 F = conductor_F(b, f8_min(vec3x8_dot(o, h), F8(1)));
            out.wi = vec3x8_select(lanes, i, out.wi);
            out.weight = vec3x8_select(lanes, vec3x8_scale(F, weight), out.weight);
            out.pdf = f8_select(lanes, pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, pdf_rev, out.pdf_rev);
            out.delta |= lanes & smooth;
            out.valid |= lanes & up;
        }
    }

    if (fx & FX_DIELECTRIC) {
        i8 lanes = valid & (b->kind == MATERIAL_DIELECTRIC);
        if (i8_any(lanes)) {
            f8 ior = GATHER(b->materials, struct material, ior, b->id);
            f8 eta = f8_select(wo.z > 0, ior, 1 / ior);
            /* Work on wo's side: o.z > 0, and mirror the result back at the end */
            struct vec3x8 o = { wo.x, wo.y, co }, h = vec3x8_all(0, 0, 1);
            i8 smooth = I8(-1);
            struct ggx8 g = { F8(1), F8(1) };
            if (fx & FX_ROUGH) {
                g = bsdf_ggx(b);
                smooth = (g.ax <= 0) | (ior == 1);
                g.ax = f8_select(smooth, F8(1), g.ax);
                g.ay = f8_select(smooth, F8(1), g.ay);
                h = vec3x8_select(smooth, h, ggx_visible_sample(g, o, u, v));
            }
            f8 oh = f8_min(vec3x8_dot(o, h), F8(1)), cos_t;
            f8 F = fresnel_dielectric(oh, eta, &cos_t);
            i8 transmit = lanes & (lobe >= F);
            struct vec3x8 i = vec3x8_select(transmit, bsdf_refract(o, h, eta, cos_t),
                                            bsdf_mirror(o, h));
            i8 right_side = f8_select(transmit, -i.z, i.z) > 0;

            f8 weight = F8(1), pdf = F8(0), pdf_rev = F8(0);
            if (fx & FX_ROUGH) {
                struct vec3x8 up = { i.x, i.y, f8_abs(i.z) };
                f8 G1o = ggx_G1(g, o), G1i = ggx_G1(g, up), D = ggx_D(g, h);
                f8 ih = vec3x8_dot(i, h), aih = f8_abs(ih), unused;
                f8 jacobian_t = ih + oh / eta, jacobian_t_rev = oh + ih * eta;
                f8 F_rev = f8_select(transmit,
                                     fresnel_dielectric(f8_min(aih, F8(1)), 1 / eta, &unused), F);
                f8 visible_o = G1o * D / co, visible_i = G1i * D / f8_max(up.z, F8(1e-30f));
                f8 pdf_t = (1 - F) * visible_o * oh * aih /
                           f8_max(jacobian_t * jacobian_t, F8(1e-30f));
                f8 pdf_t_rev = (1 - F_rev) * visible_i * oh * aih /
                               f8_max(jacobian_t_rev * jacobian_t_rev, F8(1e-30f));
                pdf = f8_select(transmit, pdf_t, F * visible_o * 0.25f);
                pdf_rev = f8_select(transmit, pdf_t_rev, F * visible_i * 0.25f);
                weight = f8_select(smooth, F8(1), ggx_G2(g, o, up) / G1o);
                pdf = f8_select(smooth, F8(0), pdf);
                pdf_rev = f8_select(smooth, F8(0), pdf_rev);
            }
            if (mode == TRANSPORT_RADIANCE)
                weight = f8_select(transmit, weight / (eta * eta), weight);
            i.z = f8_mulsign(i.z, wo.z);
            out.wi = vec3x8_select(lanes, i, out.wi);
            out.weight = vec3x8_select(lanes, (struct vec3x8){ weight, weight, weight },
                                       out.weight);
            out.pdf = f8_select(lanes, pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, pdf_rev, out.pdf_rev);
            out.delta |= lanes & smooth;
            out.transmitted |= transmit;
            out.eta = f8_select(transmit, eta, out.eta);
            out.valid |= lanes & right_side;
        }
    }

    if (fx & FX_COAT) {
        i8 lanes = valid & (b->kind == MATERIAL_COAT);
        if (i8_any(lanes)) {
            struct coat8 coat = coat_of(b);
            f8 po = coat_p(&coat, co, coat_T(b, &coat, co));
            i8 surface = lanes & (lobe < po);
            i8 smooth = I8(-1);
            struct vec3x8 o = { wo.x, wo.y, co };
            struct vec3x8 i = { -wo.x, -wo.y, co };
            if (fx & FX_ROUGH) {
                struct ggx8 g = bsdf_ggx(b);
                smooth = g.ax <= 0;
                g.ax = f8_select(smooth, F8(1), g.ax);
                g.ay = f8_select(smooth, F8(1), g.ay);
                struct vec3x8 m = bsdf_mirror(o, ggx_visible_sample(g, o, u, v));
                i = vec3x8_select(smooth, i, m);
            }
            i8 mirror = surface & smooth;
            i8 up = i.z > 0;
            i.z = f8_mulsign(i.z, wo.z);
            struct vec3x8 wi = vec3x8_select(surface, i, lift);

            /* Both lobes overlap unless the interface is a mirror: one value, one density */
            struct bsdf_eval8 e = bsdf_eval(b, fx & (FX_COAT | FX_ROUGH), mode, lanes, wo, wi);
            f8 cos_t;
            f8 F = fresnel_dielectric(co, coat.ior, &cos_t);
            f8 inv = 1 / e.pdf;
            struct vec3x8 weight = vec3x8_scale(e.f_cos, inv);
            f8 mirrored = F / po;
            weight = vec3x8_select(mirror, (struct vec3x8){ mirrored, mirrored, mirrored }, weight);
            out.wi = vec3x8_select(lanes, wi, out.wi);
            out.weight = vec3x8_select(lanes, weight, out.weight);
            out.pdf = f8_select(lanes, f8_select(mirror, F8(0), e.pdf), out.pdf);
            out.pdf_rev = f8_select(lanes, f8_select(mirror, F8(0), e.pdf_rev), out.pdf_rev);
            out.delta |= mirror;
            out.valid |= lanes & (up | ~surface) & (mirror | (e.pdf > 0)) & (wi.z != 0);
        }
    }
    return out;
}

#endif
