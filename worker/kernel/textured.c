#include "worker/kernel/textured.h"

#include <math.h>
#include <string.h>

#define ALPHA_LEAST    1e-4f /* as in the pbrt reader: of one axis when the other is rough */
#define ROUGHNESS_MOST 100.f
#define INDEX_MOST     1e4f     /* of refraction, and of absorption */
#define SEEN_LEAST     0.02f    /* cosine to which a normal is turned back towards wo */
#define BUMP_STEP      5e-4f    /* in u and v where there is no footprint; as pbrt */
#define BUMP_LEAST     0x1p-14f /* of a step relative to u: below it rounding is the slope */

static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* a + s b */
static void add(float a[3], float s, const float b[3])
{
    for (int axis = 0; axis < 3; axis++)
        a[axis] += s * b[axis];
}

/* False, and a as it was, where it has no direction */
static bool make_unit(float a[3])
{
    float length2 = dot(a, a);
    if (!(length2 > 0 && length2 < 1e37f))
        return false;
    float scale = 1 / sqrtf(length2);
    for (int axis = 0; axis < 3; axis++)
        a[axis] *= scale;
    return true;
}

/* Not a number counts as `low` */
static float clamp(float x, float low, float high)
{
    return x > low ? (x < high ? x : high) : low;
}

uint32_t textured_parts(const struct material *material)
{
    uint32_t parts = 0;
    for (int slot = 0; slot < MATERIAL_SLOTS; slot++)
        if (material->texture[slot] != 0)
            parts |= slot == SLOT_NORMAL || slot == SLOT_BUMP ? TEXTURED_NORMALS : TEXTURED_VALUES;
    return parts;
}

static bool slot_at(const struct texture_set *set, const struct texture_point *point,
                    const struct material *material, enum material_slot slot, float low, float high,
                    float rgb[3])
{
    uint32_t texture = material->texture[slot];
    if (texture == 0)
        return false;
    texture_at(set, texture - 1, point, rgb);
    for (int c = 0; c < 3; c++)
        rgb[c] = clamp(rgb[c], low, high);
    return true;
}

static void set_roughness(const struct texture_set *set, const struct texture_point *point,
                          struct material *material)
{
    bool textured = false;
    for (int i = 0; i < 2; i++) {
        float r[3];
        enum material_slot slot = i == 0 ? SLOT_ROUGHNESS_U : SLOT_ROUGHNESS_V;
        if (!slot_at(set, point, material, slot, 0, ROUGHNESS_MOST, r))
            continue;
        material->alpha[i] = material->flags & MATERIAL_REMAP ? sqrtf(r[0]) : r[0];
        textured = true;
    }
    if (!textured)
        return;
    float *alpha = material->alpha;
    bool smooth = alpha[0] < ALPHA_SMOOTH && alpha[1] < ALPHA_SMOOTH;
    for (int i = 0; i < 2; i++)
        alpha[i] = smooth ? 0 : clamp(alpha[i], ALPHA_LEAST, ROUGHNESS_MOST);
}

void textured_material(const struct texture_set *set, const struct texture_point *point,
                       struct material *material)
{
    float rgb[3];
    if (slot_at(set, point, material, SLOT_REFLECTANCE, 0, 1, rgb)) {
        memcpy(material->reflectance, rgb, sizeof(rgb));
        for (int c = 0; (material->flags & MATERIAL_METAL) && c < 3; c++) {
            /* The k that reflects r at normal incidence, for eta 1; never quite all of it */
            float r = clamp(rgb[c], 0, 0.9999f);
            material->eta[c] = 1;
            material->k[c] = 2 * sqrtf(r) / sqrtf(1 - r);
        }
    }
    if (slot_at(set, point, material, SLOT_SPECULAR, 0, 1, rgb))
        memcpy(material->specular, rgb, sizeof(rgb));
    if (material->kind == MATERIAL_MIXTURE)
        for (int c = 0; c < 3; c++) /* together they return no more than they receive */
            material->specular[c] = clamp(material->specular[c], 0, 1 - material->reflectance[c]);
    if (slot_at(set, point, material, SLOT_ETA, 1e-3f, INDEX_MOST, rgb))
        memcpy(material->eta, rgb, sizeof(rgb));
    if (slot_at(set, point, material, SLOT_K, 0, INDEX_MOST, rgb))
        memcpy(material->k, rgb, sizeof(rgb));
    set_roughness(set, point, material);
    if (slot_at(set, point, material, SLOT_SHEEN, 0, 1, rgb))
        memcpy(material->sheen, rgb, sizeof(rgb));
    if (slot_at(set, point, material, SLOT_SHEEN_ALPHA, SHEEN_ALPHA_LEAST, 1, rgb))
        material->sheen_alpha = rgb[0];
}

float textured_amount(const struct texture_set *set, const struct texture_point *point,
                      const struct material *material)
{
    float rgb[3];
    return slot_at(set, point, material, SLOT_AMOUNT, 0, 1, rgb) ? rgb[0] : material->mix_amount;
}

/* ---- normals */

static void apply_map(const struct texture_set *set, const struct texture_point *point,
                      const struct material *material, float ns[3])
{
    float c[3], x[3], y[3], dv[3];
    texture_at(set, material->texture[SLOT_NORMAL] - 1, point, c);
    for (int i = 0; i < 3; i++)
        c[i] = 2 * clamp(c[i], 0, 1) - 1;
    if (material->flags & MATERIAL_NORMAL_SCALED) {
        c[0] *= material->normal_scale;
        c[1] *= material->normal_scale;
    }
    memcpy(x, point->dpdu, sizeof(x));
    add(x, -dot(x, ns), ns);
    if ((c[0] == 0 && c[1] == 0) || !make_unit(c) || !make_unit(x))
        return;
    y[0] = ns[1] * x[2] - ns[2] * x[1];
    y[1] = ns[2] * x[0] - ns[0] * x[2];
    y[2] = ns[0] * x[1] - ns[1] * x[0];
    memcpy(dv, point->dpdv, sizeof(dv));
    if (dot(y, dv) < 0)
        c[1] = -c[1];
    for (int axis = 0; axis < 3; axis++)
        ns[axis] = c[0] * x[axis] + c[1] * y[axis] + c[2] * ns[axis];
    make_unit(ns);
}

static float displacement_at(const struct texture_set *set, uint32_t texture,
                             const struct texture_point *point)
{
    float rgb[3];
    texture_at(set, texture, point, rgb);
    return rgb[0];
}

/* Slope of the displacement in u or v by a finite difference; `gradient` is that coordinate's */
static float slope_at(const struct texture_set *set, uint32_t texture,
                      const struct texture_point *point, int coordinate, const float gradient[3],
                      float here)
{
    const float *dp = coordinate == 0 ? point->dpdu : point->dpdv;
    float from = point->uv[coordinate], step = BUMP_STEP;
    if (point->width > 0)
        step = 0.5f * point->width * sqrtf(dot(gradient, gradient));
    step = fmaxf(step, BUMP_LEAST * fmaxf(1, fabsf(from)));
    if (texture_uses_p(set, texture)) {
        /* Rounding of p, too, is no slope */
        float extent = fmaxf(fabsf(point->p[0]), fmaxf(fabsf(point->p[1]), fabsf(point->p[2])));
        float speed2 = dot(dp, dp);
        if (speed2 > 0)
            step = fmaxf(step, 0x1p-18f * extent / sqrtf(speed2));
    }
    struct texture_point there = *point;
    there.uv[coordinate] = from + step;
    step = there.uv[coordinate] - from; /* as it was rounded */
    add(there.p, step, dp);
    return (displacement_at(set, texture, &there) - here) / step;
}

/* A surface moved by h along its normal n leans by the gradient of h along the surface: its normal
 * is n - grad h, whatever the directions of u and v */
static void apply_bump(const struct texture_set *set, const struct texture_point *point,
                       const struct material *material, float ns[3])
{
    float du[3], dv[3], bent[3];
    texture_gradients(point, du, dv);
    uint32_t texture = material->texture[SLOT_BUMP] - 1;
    float here = displacement_at(set, texture, point);
    float hu = slope_at(set, texture, point, 0, du, here);
    float hv = slope_at(set, texture, point, 1, dv, here);
    if (hu == 0 && hv == 0)
        return;
    memcpy(bent, ns, sizeof(bent));
    float lean[3] = { 0, 0, 0 };
    add(lean, hu, du);
    add(lean, hv, dv);
    add(lean, -dot(lean, ns), ns);
    add(bent, -1, lean);
    if (make_unit(bent))
        memcpy(ns, bent, sizeof(bent));
}

void textured_normal(const struct texture_set *set, const struct texture_point *point,
                     const struct material *material, const float wo[3], float ns[3])
{
    const float old[3] = { ns[0], ns[1], ns[2] };
    if (material->texture[SLOT_NORMAL] != 0)
        apply_map(set, point, material, ns);
    if (material->texture[SLOT_BUMP] != 0)
        apply_bump(set, point, material, ns);
    if (memcmp(old, ns, sizeof(old)) == 0)
        return;

    /* On the side of the old normal that wo is on, and seen from there */
    float side = dot(old, wo) < 0 ? -1 : 1;
    float seen = side * dot(ns, wo);
    if (seen < SEEN_LEAST) {
        add(ns, side * (SEEN_LEAST - seen), wo);
        if (!make_unit(ns))
            memcpy(ns, old, sizeof(old));
    }
}
