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
 * mask `fx` are not compiled. Kinds but dielectric are two-sided: they take wo to the upper side,
 * and what they transmit to the lower. Over any of them may lie a sheen (common/sheen.h).
 */
#ifndef WORKER_KERNEL_BSDF_H
#define WORKER_KERNEL_BSDF_H

#include "common/effects.h"
#include "common/scene.h"
#include "common/sheen.h"
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
    unsigned sheen;            /* lanes that have one, as bits; with FX_SHEEN */
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
    const unsigned other = FX_MIXTURE | FX_CONDUCTOR | FX_DIELECTRIC | FX_COAT | FX_MIX | FX_THIN |
                           FX_COATED_CONDUCTOR | FX_TEXTURE;
    b.kind = fx & other ? GATHER_I(materials, struct material, kind, id) : I8(MATERIAL_DIFFUSE);
    b.reflectance = GATHER3(materials, struct material, reflectance, id);
    b.sheen = 0;
    if ((fx & FX_SHEEN) && (scene->settings.effects & FX_SHEEN))
        b.sheen = i8_bits((GATHER_I(materials, struct material, flags, id) & MATERIAL_SHEEN) != 0);
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

/* The widths of the metal below a coat, as they are */
LANE_FN struct ggx8 bsdf_ggx_base(const struct bsdf8 *b)
{
    return (struct ggx8){ GATHER(b->materials, struct material, base_alpha[0], b->id),
                          GATHER(b->materials, struct material, base_alpha[1], b->id) };
}

/* Lanes where it matters how the frame is turned about the normal */
LANE_FN i8 bsdf_anisotropic(const struct bsdf8 *b, unsigned fx)
{
    i8 kind = I8(0), base = I8(0);
    if (fx & FX_CONDUCTOR)
        kind |= b->kind == MATERIAL_CONDUCTOR;
    if (fx & FX_DIELECTRIC)
        kind |= b->kind == MATERIAL_DIELECTRIC;
    if (fx & FX_COAT)
        kind |= b->kind == MATERIAL_COAT;
    if (fx & FX_COATED_CONDUCTOR) {
        struct ggx8 g = bsdf_ggx_base(b);
        base = (b->kind == MATERIAL_COATED_CONDUCTOR) & (g.ax != g.ay);
        kind |= b->kind == MATERIAL_COATED_CONDUCTOR;
    }
    struct ggx8 g = bsdf_ggx(b);
    return (kind & (g.ax != g.ay)) | base;
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
    if (fx & FX_THIN)
        all |= b->kind == MATERIAL_THIN_DIELECTRIC;
    if (fx & FX_COATED_CONDUCTOR) {
        i8 smooth = b->kind == MATERIAL_COATED_CONDUCTOR;
        if (fx & FX_ROUGH) {
            struct ggx8 base = bsdf_ggx_base(b);
            smooth &= (bsdf_ggx(b).ax == 0) & (base.ax < ALPHA_SMOOTH) & (base.ay < ALPHA_SMOOTH);
        }
        all |= smooth;
    }
    if ((fx & FX_SHEEN) && b->sheen != 0)
        all &= ~i8_from_bits(b->sheen);
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

/* ---- what dielectrics transmit, coloured where the material says so */

LANE_FN void bsdf_tint(const struct bsdf8 *b, i8 transmitted, struct vec3x8 *value)
{
    i8 flags = GATHER_I(b->materials, struct material, flags, b->id);
    i8 tinted = transmitted & ((flags & MATERIAL_TINTED) != 0);
    if (i8_any(tinted)) {
        struct vec3x8 tint = GATHER3(b->materials, struct material, specular, b->id);
        *value = vec3x8_select(tinted, vec3x8_mul(*value, tint), *value);
    }
}

/* ---- sheets */

/* What a pane reflects: both faces and all turns between them, R + T^2 R / (1 - R^2) */
LANE_FN f8 pane_R(const struct bsdf8 *b, f8 c)
{
    f8 cos_t;
    f8 R = fresnel_dielectric(c, GATHER(b->materials, struct material, ior, b->id), &cos_t);
    f8 T = 1 - R;
    return f8_select(R < 1, R + T * T * R / (1 - R * R), F8(1));
}

/* Share of samples that stay on wo's side of a sheet of diffuse transmission */
LANE_FN f8 sheet_p(const struct bsdf8 *b, struct vec3x8 transmittance)
{
    f8 r = f8_sum3(b->reflectance), t = f8_sum3(transmittance);
    return f8_select(r + t > 0, r / (r + t), F8(0));
}

/* ---- conductor */

LANE_FN void conductor_index(const struct bsdf8 *b, struct vec3x8 *eta, struct vec3x8 *k)
{
    *eta = GATHER3(b->materials, struct material, eta, b->id);
    *k = GATHER3(b->materials, struct material, k, b->id);
}

LANE_FN struct vec3x8 conductor_F(const struct bsdf8 *b, f8 c)
{
    struct vec3x8 eta, k;
    conductor_index(b, &eta, &k);
    return (struct vec3x8){ fresnel_conductor(c, eta.x, k.x), fresnel_conductor(c, eta.y, k.y),
                            fresnel_conductor(c, eta.z, k.z) };
}

/* ---- coats: a dielectric interface over a base, see struct material */

struct coat_rows8 {
    i8 table;   /* first entry */
    i8 next;    /* entries from there to the rows of the next alpha; 0 where there is one alpha */
    f8 between; /* where between the two alphas */
    f8 inner, scale;
};

/* The rows of coats of kind `kind`, `count` for an alpha; rows of other lanes must not be read
 * but the first */
LANE_FN struct coat_rows8 coat_rows_of(const struct bsdf8 *b, unsigned fx, int kind, int count)
{
    struct coat_rows8 rows;
    rows.table = GATHER_I(b->materials, struct material, coat_table, b->id) * COAT_TABLE_LEN;
    rows.inner = GATHER(b->materials, struct material, coat_inner, b->id);
    rows.scale = GATHER(b->materials, struct material, coat_scale, b->id);
    rows.next = I8(0);
    rows.between = F8(0);
    if (fx & FX_TEXTURE) {
        i8 many = GATHER_I(b->materials, struct material, flags, b->id) & MATERIAL_COATS;
        many = (many != 0) & (b->kind == kind);
        if (i8_any(many)) {
            struct ggx8 g = bsdf_ggx(b);
            f8 alpha = f8_clamp((g.ax + g.ay) * 0.5f, 0, 1);
            f8 x = f8_sqrt(alpha) * (float)(COAT_ALPHAS - 1);
            i8 j = i8_from_f8(f8_min(x, F8(COAT_ALPHAS - 2)));
            f8 t = x - f8_from_i8(j);
            i8 last = (rows.table + count * COAT_ALPHAS * COAT_TABLE_LEN + j) & many;
            f8 inner = (1 - t) * f8_gather(b->coat_tables, last) +
                       t * f8_gather(b->coat_tables + 1, last);
            f8 inverse = (1 - t) * f8_gather(b->coat_tables + COAT_ALPHAS, last) +
                         t * f8_gather(b->coat_tables + COAT_ALPHAS + 1, last);
            f8 scale = f8_select(inverse > 0, 1 / inverse, F8(0));
            rows.inner = f8_select(many, inner, rows.inner);
            rows.scale = f8_select(many, scale, rows.scale);
            rows.table += many & (j * (count * COAT_TABLE_LEN));
            rows.next = many & (count * COAT_TABLE_LEN);
            rows.between = t;
        }
    }
    return rows;
}

LANE_FN f8 coat_entry(const struct bsdf8 *b, i8 table, i8 i, f8 t)
{
    f8 low = f8_gather(b->coat_tables, table + i);
    f8 high = f8_gather(b->coat_tables, table + i + 1);
    return (1 - t) * low + t * high;
}

/* Row `row` of the tables at cosine mu */
LANE_FN f8 coat_row(const struct bsdf8 *b, unsigned fx, const struct coat_rows8 *rows, int row,
                    f8 mu)
{
    f8 x = f8_sqrt(f8_clamp(mu, 0, 1)) * (float)(COAT_TABLE_LEN - 1);
    i8 i = i8_from_f8(f8_min(x, F8(COAT_TABLE_LEN - 2)));
    f8 t = x - f8_from_i8(i);
    i8 table = rows->table + row * COAT_TABLE_LEN;
    f8 value = coat_entry(b, table, i, t);
    if ((fx & FX_TEXTURE) && i8_any(rows->next != 0)) {
        f8 other = coat_entry(b, table + rows->next, i, t), s = rows->between;
        value = f8_select(rows->next != 0, (1 - s) * value + s * other, value);
    }
    return value;
}

/* ---- over a diffuse base */

struct coat8 {
    struct vec3x8 base; /* reflectance * scale / (1 - reflectance * inner) */
    f8 ior;
    struct coat_rows8 rows;
};

LANE_FN struct coat8 coat_of(const struct bsdf8 *b, unsigned fx)
{
    struct coat8 coat;
    coat.rows = coat_rows_of(b, fx, MATERIAL_COAT, 1);
    f8 inner = coat.rows.inner, scale = coat.rows.scale;
    coat.base = (struct vec3x8){ b->reflectance.x * scale / (1 - b->reflectance.x * inner),
                                 b->reflectance.y * scale / (1 - b->reflectance.y * inner),
                                 b->reflectance.z * scale / (1 - b->reflectance.z * inner) };
    coat.ior = GATHER(b->materials, struct material, ior, b->id);
    return coat;
}

LANE_FN f8 coat_T(const struct bsdf8 *b, unsigned fx, const struct coat8 *coat, f8 mu)
{
    return coat_row(b, fx, &coat->rows, COAT_ENTER, mu);
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

/* ---- over metal: the lobes of master/coat.h */

#define COAT_LEAST 1e-6f /* what a division by nothing is kept at */

struct coat_metal8 {
    struct coat_rows8 rows;
    f8 ior;
    struct vec3x8 eta, k;  /* of the metal, against the coat */
    struct vec3x8 spread;  /* C / Z */
    struct ggx8 top, base; /* zero where smooth; the base as seen through the top */
};

/* What the model needs at one of its two directions */
struct coat_metal_side8 {
    f8 F, T, R, M;
    struct vec3x8 inside; /* the direction after refraction, upwards */
    f8 p_top, p_base, p_spread;
};

LANE_FN struct vec3x8 coat_metal_F(const struct coat_metal8 *coat, f8 c)
{
    return (struct vec3x8){ fresnel_conductor(c, coat->eta.x, coat->k.x),
                            fresnel_conductor(c, coat->eta.y, coat->k.y),
                            fresnel_conductor(c, coat->eta.z, coat->k.z) };
}

/* All turns between metal and interface: F / (1 - F R) */
LANE_FN struct vec3x8 coat_metal_B(const struct coat_metal8 *coat, f8 c, f8 R)
{
    struct vec3x8 F = coat_metal_F(coat, c);
    return (struct vec3x8){ F.x / f8_max(1 - F.x * R, F8(COAT_LEAST)),
                            F.y / f8_max(1 - F.y * R, F8(COAT_LEAST)),
                            F.z / f8_max(1 - F.z * R, F8(COAT_LEAST)) };
}

LANE_FN f8 coat_metal_C(f8 F0, f8 q)
{
    f8 Fa = F0 + (1 - F0) * (1 / 21.0f); /* the mean over the hemisphere, after Schlick */
    return Fa * Fa * (1 - q) / f8_max(1 - q * Fa, F8(COAT_LEAST));
}

LANE_FN struct coat_metal8 coat_metal_of(const struct bsdf8 *b, unsigned fx, i8 lanes)
{
    struct coat_metal8 coat;
    coat.rows = coat_rows_of(b, fx, MATERIAL_COATED_CONDUCTOR, COAT_METAL_ROWS);
    coat.rows.table &= lanes;
    coat.ior = f8_select(lanes, GATHER(b->materials, struct material, ior, b->id), F8(1));
    f8 inv = 1 / coat.ior;
    conductor_index(b, &coat.eta, &coat.k);
    coat.eta = vec3x8_scale(coat.eta, inv);
    coat.k = vec3x8_scale(coat.k, inv);
    struct vec3x8 F0 = coat_metal_F(&coat, F8(1));
    f8 q = coat.rows.inner, scale = coat.rows.scale;
    coat.spread = (struct vec3x8){ coat_metal_C(F0.x, q) * scale, coat_metal_C(F0.y, q) * scale,
                                   coat_metal_C(F0.z, q) * scale };
    coat.top = coat.base = (struct ggx8){ F8(0), F8(0) };
    if (fx & FX_ROUGH) {
        coat.top = bsdf_ggx(b);
        coat.base = bsdf_ggx_base(b);
        f8 deflection = 1 - inv, half = deflection * deflection * 0.5f;
        f8 ax = f8_sqrt(coat.base.ax * coat.base.ax + half * (coat.top.ax * coat.top.ax));
        f8 ay = f8_sqrt(coat.base.ay * coat.base.ay + half * (coat.top.ay * coat.top.ay));
        i8 rough = (ax >= ALPHA_SMOOTH) | (ay >= ALPHA_SMOOTH);
        coat.base.ax = f8_select(rough, f8_max(ax, F8(ALPHA_SMOOTH)), F8(0));
        coat.base.ay = f8_select(rough, f8_max(ay, F8(ALPHA_SMOOTH)), F8(0));
    }
    return coat;
}

LANE_FN struct coat_metal_side8 coat_metal_side(const struct bsdf8 *b, unsigned fx,
                                                const struct coat_metal8 *coat, struct vec3x8 w)
{
    struct coat_metal_side8 side;
    f8 inv = 1 / coat->ior, cos_t;
    side.F = fresnel_dielectric(f8_min(w.z, F8(1)), coat->ior, &cos_t);
    side.inside = (struct vec3x8){ w.x * inv, w.y * inv, cos_t };
    side.T = coat_row(b, fx, &coat->rows, COAT_ENTER, w.z);
    side.R = coat_row(b, fx, &coat->rows, COAT_RETURN, w.z);
    side.M = coat_row(b, fx, &coat->rows, COAT_SPREAD, w.z);

    /* Lobes are chosen in proportion to what each is about to return */
    f8 base = side.T * side.T * f8_sum3(coat_metal_B(coat, cos_t, side.R)) * (1 / 3.0f);
    f8 q = coat->rows.scale;
    f8 C = f8_select(q > 0, f8_sum3(coat->spread) / (3 * q), F8(0));
    f8 spread = side.T * side.M * C;
    f8 sum = side.F + base + spread;
    f8 share = f8_select(sum > 0, 1 / sum, F8(0));
    side.p_top = f8_select(sum > 0, side.F * share, F8(1));
    side.p_base = base * share;
    side.p_spread = spread * share;
    return side;
}

/* All lobes that are not delta events; o and i are upwards */
LANE_FN struct bsdf_eval8 coat_metal_eval(const struct coat_metal8 *coat, unsigned fx,
                                          struct vec3x8 o, const struct coat_metal_side8 *so,
                                          struct vec3x8 i, const struct coat_metal_side8 *si)
{
    struct bsdf_eval8 out;
    f8 TT = so->T * si->T;
    out.f_cos = vec3x8_scale(coat->spread, TT * so->M * si->M * i.z);
    out.pdf = so->p_spread * i.z * PI_INV_F;
    out.pdf_rev = si->p_spread * o.z * PI_INV_F;
    if (fx & FX_ROUGH) {
        i8 rough = coat->top.ax > 0;
        struct vec3x8 h = vec3x8_unit(vec3x8_add(o, i));
        f8 D = ggx_D(coat->top, h), cos_t;
        f8 F = fresnel_dielectric(f8_min(vec3x8_dot(o, h), F8(1)), coat->ior, &cos_t);
        f8 f = f8_select(rough, F * D * ggx_G2(coat->top, o, i) / (4 * o.z), F8(0));
        out.f_cos = vec3x8_add(out.f_cos, (struct vec3x8){ f, f, f });
        f8 pdf = so->p_top * ggx_G1(coat->top, o) * D / (4 * o.z);
        f8 pdf_rev = si->p_top * ggx_G1(coat->top, i) * D / (4 * i.z);
        out.pdf += f8_select(rough, pdf, F8(0));
        out.pdf_rev += f8_select(rough, pdf_rev, F8(0));

        struct vec3x8 p = so->inside, q = si->inside;
        rough = (coat->base.ax > 0) & (p.z > 0) & (q.z > 0);
        h = vec3x8_unit(vec3x8_add(p, q));
        D = ggx_D(coat->base, h);
        f8 common = D / (4 * p.z * q.z * coat->ior * coat->ior);
        struct vec3x8 B = coat_metal_B(coat, f8_min(vec3x8_dot(p, h), F8(1)), f8_min(so->R, si->R));
        struct vec3x8 metal = vec3x8_scale(B, TT * ggx_G2(coat->base, p, q) * common * i.z);
        out.f_cos = vec3x8_select(rough, vec3x8_add(out.f_cos, metal), out.f_cos);
        pdf = so->p_base * ggx_G1(coat->base, p) * common * i.z;
        pdf_rev = si->p_base * ggx_G1(coat->base, q) * common * o.z;
        out.pdf += f8_select(rough, pdf, F8(0));
        out.pdf_rev += f8_select(rough, pdf_rev, F8(0));
    }
    return out;
}

/* ---- all kinds, without what lies over them */

LANE_FN struct bsdf_eval8 bsdf_eval_below(const struct bsdf8 *b, unsigned fx,
                                          enum transport_mode mode, i8 valid, struct vec3x8 wo,
                                          struct vec3x8 wi)
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
            struct vec3x8 value = { f, f, f };
            bsdf_tint(b, lanes & ~reflect, &value);
            out.f_cos = vec3x8_select(lanes, value, out.f_cos);
            out.pdf = f8_select(lanes, f8_select(reflect, pdf_r, pdf_t), out.pdf);
            out.pdf_rev = f8_select(lanes, f8_select(reflect, pdf_r_rev, pdf_t_rev), out.pdf_rev);
        }
    }

    if (fx & FX_COAT) {
        i8 lanes = same_side & (b->kind == MATERIAL_COAT);
        if (i8_any(lanes)) {
            struct coat8 coat = coat_of(b, fx);
            f8 To = coat_T(b, fx, &coat, co), Ti = coat_T(b, fx, &coat, ci);
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

    if (fx & FX_THIN) {
        i8 lanes = valid & (b->kind == MATERIAL_DIFFUSE_TRANSMISSION) & (wo.z * wi.z != 0);
        if (i8_any(lanes)) {
            struct vec3x8 kt = GATHER3(b->materials, struct material, specular, b->id);
            f8 p = sheet_p(b, kt), share = f8_select(same_side, p, 1 - p);
            struct vec3x8 k = vec3x8_select(same_side, b->reflectance, kt);
            out.f_cos = vec3x8_select(lanes, vec3x8_scale(k, lambert), out.f_cos);
            out.pdf = f8_select(lanes, share * lambert, out.pdf);
            out.pdf_rev = f8_select(lanes, share * co * PI_INV_F, out.pdf_rev);
        }
    }

    if (fx & FX_COATED_CONDUCTOR) {
        i8 lanes = same_side & (b->kind == MATERIAL_COATED_CONDUCTOR);
        if (i8_any(lanes)) {
            struct coat_metal8 coat = coat_metal_of(b, fx, lanes);
            /* Mirrored together with wo when it comes from below */
            struct vec3x8 o = { wo.x, wo.y, co }, i = { wi.x, wi.y, ci };
            struct coat_metal_side8 so = coat_metal_side(b, fx, &coat, o);
            struct coat_metal_side8 si = coat_metal_side(b, fx, &coat, i);
            struct bsdf_eval8 e = coat_metal_eval(&coat, fx, o, &so, i, &si);
            out.f_cos = vec3x8_select(lanes, e.f_cos, out.f_cos);
            out.pdf = f8_select(lanes, e.pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, e.pdf_rev, out.pdf_rev);
        }
    }
    return out;
}

LANE_FN struct bsdf_sample8 bsdf_sample_below(const struct bsdf8 *b, unsigned fx,
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
            out.pdf = f8_select(lanes, f8_select(mirror, F8(0), p * out.pdf), out.pdf);
            out.pdf_rev = f8_select(lanes, f8_select(mirror, F8(0), p * out.pdf_rev), out.pdf_rev);
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
            struct vec3x8 value = { weight, weight, weight };
            bsdf_tint(b, transmit, &value);
            out.weight = vec3x8_select(lanes, value, out.weight);
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
            struct coat8 coat = coat_of(b, fx);
            f8 po = coat_p(&coat, co, coat_T(b, fx, &coat, co));
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
            struct bsdf_eval8 e = bsdf_eval_below(b, fx & (FX_COAT | FX_ROUGH | FX_TEXTURE), mode,
                                                  lanes, wo, wi);
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

    if (fx & FX_THIN) {
        i8 lanes = valid & (b->kind == MATERIAL_THIN_DIELECTRIC);
        if (i8_any(lanes)) {
            i8 transmit = lanes & (lobe >= pane_R(b, f8_min(co, F8(1))));
            struct vec3x8 mirrored = { -wo.x, -wo.y, wo.z };
            struct vec3x8 wi = vec3x8_select(transmit, vec3x8_neg(wo), mirrored);
            struct vec3x8 value = vec3x8_all(1, 1, 1);
            bsdf_tint(b, transmit, &value);
            out.wi = vec3x8_select(lanes, wi, out.wi);
            out.weight = vec3x8_select(lanes, value, out.weight);
            out.pdf = f8_select(lanes, F8(0), out.pdf);
            out.pdf_rev = f8_select(lanes, F8(0), out.pdf_rev);
            out.delta |= lanes;
            out.transmitted |= transmit;
            out.valid |= lanes;
        }
        lanes = valid & (b->kind == MATERIAL_DIFFUSE_TRANSMISSION);
        if (i8_any(lanes)) {
            struct vec3x8 kt = GATHER3(b->materials, struct material, specular, b->id);
            f8 p = sheet_p(b, kt);
            i8 transmit = lanes & (lobe >= p);
            f8 share = f8_select(transmit, 1 - p, p);
            struct vec3x8 weight = vec3x8_select(transmit, kt, b->reflectance);
            out.wi.z = f8_select(transmit, -lift.z, out.wi.z);
            out.weight = vec3x8_select(lanes, vec3x8_scale(weight, 1 / share), out.weight);
            out.pdf = f8_select(lanes, share * out.pdf, out.pdf);
            out.pdf_rev = f8_select(lanes, share * out.pdf_rev, out.pdf_rev);
            out.transmitted |= transmit;
            i8 black = f8_sum3(b->reflectance) + f8_sum3(kt) <= 0;
            out.valid |= lanes & ~black & (share > 0) & (lift.z != 0);
        }
    }

    if (fx & FX_COATED_CONDUCTOR) {
        i8 lanes = valid & (b->kind == MATERIAL_COATED_CONDUCTOR);
        if (i8_any(lanes)) {
            struct coat_metal8 coat = coat_metal_of(b, fx, lanes);
            struct vec3x8 o = { wo.x, wo.y, co };
            struct coat_metal_side8 so = coat_metal_side(b, fx, &coat, o);
            i8 top = lanes & (lobe < so.p_top);
            i8 base = lanes & ~top & (lobe < so.p_top + so.p_base);
            i8 top_smooth = I8(-1), base_smooth = I8(-1);
            struct vec3x8 mirrored = { -wo.x, -wo.y, co }, i = mirrored;
            if (fx & FX_ROUGH) {
                /* One normal, of the surface that was chosen, and one mirror direction */
                top_smooth = coat.top.ax == 0;
                base_smooth = coat.base.ax == 0;
                struct ggx8 g = { f8_select(base, coat.base.ax, coat.top.ax),
                                  f8_select(base, coat.base.ay, coat.top.ay) };
                i8 rough = f8_min(g.ax, g.ay) > 0;
                g.ax = f8_select(rough, g.ax, F8(1));
                g.ay = f8_select(rough, g.ay, F8(1));
                struct vec3x8 from = vec3x8_select(base, so.inside, o);
                struct vec3x8 to = bsdf_mirror(from, ggx_visible_sample(g, from, u, v));
                /* Out through the interface; beyond the critical angle nothing is left of z */
                f8 nx = to.x * coat.ior, ny = to.y * coat.ior;
                f8 nz = f8_sqrt(f8_max(1 - nx * nx - ny * ny, F8(0)));
                nz = f8_select(to.z > 0, nz, F8(0));
                to = vec3x8_select(base, (struct vec3x8){ nx, ny, nz }, to);
                i = vec3x8_select(rough, to, mirrored);
            }
            i8 delta = (top & top_smooth) | (base & base_smooth);
            i8 cosine = lanes & ~top & ~base;
            i = vec3x8_select(cosine, (struct vec3x8){ lift.x, lift.y, f8_abs(lift.z) }, i);
            i8 up = i.z > 0;

            struct coat_metal_side8 si = coat_metal_side(b, fx, &coat, i);
            struct bsdf_eval8 e = coat_metal_eval(&coat, fx, o, &so, i, &si);
            struct vec3x8 weight = vec3x8_scale(e.f_cos, 1 / e.pdf);
            if (i8_any(delta)) {
                /* Both mirrors send the light the same way: one event where both are smooth */
                struct vec3x8 B = coat_metal_B(&coat, so.inside.z, so.R);
                struct vec3x8 f = vec3x8_scale(B, f8_select(base_smooth, so.T * so.T, F8(0)));
                f8 F = f8_select(top_smooth, so.F, F8(0));
                f8 p = f8_select(top_smooth, so.p_top, F8(0)) +
                       f8_select(base_smooth, so.p_base, F8(0));
                f = vec3x8_scale((struct vec3x8){ f.x + F, f.y + F, f.z + F }, 1 / p);
                weight = vec3x8_select(delta, f, weight);
            }
            i.z = f8_mulsign(i.z, wo.z);
            out.wi = vec3x8_select(lanes, i, out.wi);
            out.weight = vec3x8_select(lanes, weight, out.weight);
            out.pdf = f8_select(lanes, f8_select(delta, F8(0), e.pdf), out.pdf);
            out.pdf_rev = f8_select(lanes, f8_select(delta, F8(0), e.pdf_rev), out.pdf_rev);
            out.delta |= delta;
            out.valid |= lanes & up & (delta | (e.pdf > 0));
        }
    }
    return out;
}

/* ---- a sheen over them; not inline, as few scenes have one, and the others shall not pay */

#define SHEEN_FN static __attribute__((noinline, unused))

struct sheen8 {
    struct vec3x8 color;
    f8 alpha;
    i8 table; /* first entry of the albedo at the nearest width below */
    f8 between;
};

/* What the sheen is for one direction */
struct sheen_side8 {
    f8 bound;
    f8 below; /* the share of light that what lies below gets */
    f8 p;     /* of samples for the sheen, as if what lies below returned all of that */
};

LANE_FN struct sheen8 sheen_of(const struct bsdf8 *b, i8 lanes)
{
    struct sheen8 sheen;
    sheen.color = GATHER3(b->materials, struct material, sheen, b->id);
    sheen.alpha = f8_select(lanes, GATHER(b->materials, struct material, sheen_alpha, b->id),
                            F8(1));
    f8 x = f8_sqrt(f8_sqrt(sheen.alpha)) * (float)(SHEEN_FIRST + SHEEN_ALPHAS - 1) - SHEEN_FIRST;
    i8 j = i8_from_f8(f8_clamp(x, 0, SHEEN_ALPHAS - 2));
    sheen.between = x - f8_from_i8(j);
    i8 row = GATHER_I(b->materials, struct material, sheen_table, b->id) + j;
    sheen.table = (row & lanes) * COAT_TABLE_LEN;
    return sheen;
}

LANE_FN f8 sheen_entry(const struct bsdf8 *b, const struct sheen8 *sheen, int row, f8 mu)
{
    f8 x = f8_sqrt(f8_clamp(mu, 0, 1)) * (float)(COAT_TABLE_LEN - 1);
    i8 i = i8_from_f8(f8_min(x, F8(COAT_TABLE_LEN - 2)));
    f8 t = x - f8_from_i8(i), s = sheen->between;
    i8 table = sheen->table + row * COAT_TABLE_LEN;
    return (1 - s) * coat_entry(b, table, i, t) + s * coat_entry(b, table + COAT_TABLE_LEN, i, t);
}

LANE_FN struct sheen_side8 sheen_side(const struct bsdf8 *b, const struct sheen8 *sheen, f8 mu)
{
    struct sheen_side8 side;
    f8 E = sheen_entry(b, sheen, 0, mu);
    side.bound = sheen_entry(b, sheen, SHEEN_ALPHAS, mu);
    side.below = f8_max(1 - vec3x8_max(sheen->color) * E, F8(0));
    f8 mean = f8_sum3(sheen->color) * (1 / 3.0f) * E, sum = mean + side.below;
    side.p = f8_select(sum > 0, mean / sum, F8(0));
    return side;
}

/* *e, of what lies below, becomes that of all, in the lanes of `lanes` */
SHEEN_FN void bsdf_eval_sheen(const struct bsdf8 *b, i8 lanes, const struct vec3x8 *wo,
                              const struct vec3x8 *wi, struct bsdf_eval8 *e)
{
    /* Mirrored together with wo when it comes from below */
    struct vec3x8 o = { wo->x, wo->y, f8_abs(wo->z) }, i = { wi->x, wi->y, f8_abs(wi->z) };
    struct sheen8 sheen = sheen_of(b, lanes);
    struct sheen_side8 so = sheen_side(b, &sheen, o.z), si = sheen_side(b, &sheen, i.z);
    i8 reflect = lanes & (wo->z * wi->z > 0);
    f8 f = f8_min(so.bound, si.bound) * sheen_value(o, i, sheen.alpha);
    f = f8_select(reflect, f, F8(0));
    f8 uniform = f8_select(reflect, F8(0.5f * PI_INV_F), F8(0));
    struct vec3x8 f_cos = vec3x8_along(vec3x8_scale(e->f_cos, f8_min(so.below, si.below)),
                                       sheen.color, f);
    e->f_cos = vec3x8_select(lanes, f_cos, e->f_cos);
    e->pdf = f8_select(lanes, (1 - so.p) * e->pdf + so.p * uniform, e->pdf);
    e->pdf_rev = f8_select(lanes, (1 - si.p) * e->pdf_rev + si.p * uniform, e->pdf_rev);
}

/* The lanes of `lanes` that sample the sheen; in the others *lobe is what is left of it for what
 * lies below */
SHEEN_FN i8 bsdf_choose_sheen(const struct bsdf8 *b, i8 lanes, f8 co, f8 *lobe)
{
    struct sheen8 sheen = sheen_of(b, lanes);
    f8 p = sheen_side(b, &sheen, co).p;
    i8 chosen = lanes & (*lobe < p);
    f8 rest = f8_min((*lobe - p) / (1 - p), F8(0x1.fffffep-1f));
    *lobe = f8_select(lanes & ~chosen, rest, *lobe);
    return chosen;
}

/* *out, of what lies below, becomes that of all, in the lanes of `lanes`; in those of `chosen` the
 * direction is the sheen's, uniform over the hemisphere */
SHEEN_FN void bsdf_sample_sheen(const struct bsdf8 *b, enum transport_mode mode, i8 lanes,
                                i8 chosen, const struct vec3x8 *wo, f8 u, f8 v,
                                struct bsdf_sample8 *out)
{
    f8 sine, cosine, r = f8_sqrt(u * (2 - u));
    f8_sincos_turns(v, &sine, &cosine);
    struct vec3x8 up = { r * cosine, r * sine, f8_mulsign(1 - u, wo->z) };
    out->wi = vec3x8_select(chosen, up, out->wi);
    out->delta &= ~chosen;
    out->transmitted &= ~chosen;
    out->eta = f8_select(chosen, F8(1), out->eta);
    out->valid |= chosen;

    /* What was sampled below is known there; delta events have no rival, but are dimmer and rarer
     */
    struct bsdf_eval8 e = { vec3x8_scale(out->weight, out->pdf), out->pdf, out->pdf_rev };
    if (i8_any(chosen)) {
        struct bsdf_eval8 below = bsdf_eval_below(b, FX_ALL, mode, chosen, *wo, out->wi);
        e.f_cos = vec3x8_select(chosen, below.f_cos, e.f_cos);
        e.pdf = f8_select(chosen, below.pdf, e.pdf);
        e.pdf_rev = f8_select(chosen, below.pdf_rev, e.pdf_rev);
    }
    struct sheen8 sheen = sheen_of(b, lanes);
    struct sheen_side8 so = sheen_side(b, &sheen, f8_abs(wo->z));
    struct sheen_side8 si = sheen_side(b, &sheen, f8_abs(out->wi.z));
    i8 mirror = lanes & out->delta, spread = lanes & ~out->delta & out->valid;
    f8 dimmed = f8_min(so.below, si.below) / (1 - so.p);
    bsdf_eval_sheen(b, spread, wo, &out->wi, &e);
    out->weight = vec3x8_select(mirror, vec3x8_scale(out->weight, dimmed), out->weight);
    out->weight = vec3x8_select(spread, vec3x8_scale(e.f_cos, 1 / e.pdf), out->weight);
    out->pdf = f8_select(spread, e.pdf, out->pdf);
    out->pdf_rev = f8_select(spread, e.pdf_rev, out->pdf_rev);
}

/* ---- a surface and what lies over it */

/* Told to be seldom, so that the calls behind it do not cost others their registers */
LANE_FN int bsdf_has_sheen(const struct bsdf8 *b, unsigned fx)
{
    return (fx & FX_SHEEN) && __builtin_expect_with_probability(b->sheen != 0, 0, 0.9999);
}

/*
 * f cos and both densities for given directions, delta lobes excluded. wo.z != 0 in valid lanes;
 * lanes outside `valid` give zero.
 */
LANE_FN struct bsdf_eval8 bsdf_eval(const struct bsdf8 *b, unsigned fx, enum transport_mode mode,
                                    i8 valid, struct vec3x8 wo, struct vec3x8 wi)
{
    struct bsdf_eval8 out = bsdf_eval_below(b, fx, mode, valid, wo, wi);
    if (bsdf_has_sheen(b, fx)) {
        /* Copies: what has its address taken is in memory for good */
        const struct bsdf8 surface = *b;
        const struct vec3x8 o = wo, i = wi;
        struct bsdf_eval8 all = out;
        bsdf_eval_sheen(&surface, i8_from_bits(b->sheen) & valid, &o, &i, &all);
        out = all;
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
    i8 over = I8(0), chosen = I8(0);
    if (bsdf_has_sheen(b, fx)) {
        const struct bsdf8 surface = *b;
        f8 rest = lobe;
        over = i8_from_bits(b->sheen) & valid & (wo.z != 0);
        chosen = bsdf_choose_sheen(&surface, over, f8_abs(wo.z), &rest);
        lobe = rest;
    }
    struct bsdf_sample8 out = bsdf_sample_below(b, fx, mode, valid, wo, lobe, u, v);
    if (bsdf_has_sheen(b, fx)) {
        const struct bsdf8 surface = *b;
        const struct vec3x8 o = wo;
        struct bsdf_sample8 all = out;
        bsdf_sample_sheen(&surface, mode, over, chosen, &o, u, v, &all);
        out = all;
    }
    return out;
}

#endif
