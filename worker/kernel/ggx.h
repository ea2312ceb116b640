/*
 * The GGX (Trowbridge-Reitz) microfacet distribution with height-correlated Smith masking, eight at
 * a time: Walter et al. 2007, Heitz 2014. Directions are in the local frame.
 */
#ifndef WORKER_KERNEL_GGX_H
#define WORKER_KERNEL_GGX_H

#include "common/elem.h"
#include "common/lane.h"

#define PI_F     3.14159265358979323846f
#define PI_INV_F 0.31830988618379067154f

struct ggx8 {
    f8 ax, ay;
};

/*
 * D(h) for unit h. Written with h_x and h_y, so that small alphas lose nothing near the peak (the
 * textbook form c^2 (alpha^2 - 1) + 1 is wrong by 30 % at alpha = 3e-4: NUMERICS H25).
 */
LANE_FN f8 ggx_D(struct ggx8 g, struct vec3x8 h)
{
    f8 x = h.x / g.ax, y = h.y / g.ay;
    f8 e = x * x + y * y + h.z * h.z;
    return 1 / (PI_F * g.ax * g.ay * e * e);
}

/* Lambda(w) of Smith's model, w.z != 0 */
LANE_FN f8 ggx_lambda(struct ggx8 g, struct vec3x8 w)
{
    f8 x = g.ax * w.x, y = g.ay * w.y;
    f8 a2 = (x * x + y * y) / f8_max(w.z * w.z, F8(1e-30f));
    /* (sqrt(1 + a2) - 1) / 2 without its cancellation at small a2 */
    f8 lambda = a2 / (2 * (1 + f8_sqrt(1 + a2)));
    return lambda;
}

LANE_FN f8 ggx_G1(struct ggx8 g, struct vec3x8 w)
{
    return 1 / (1 + ggx_lambda(g, w));
}

LANE_FN f8 ggx_G2(struct ggx8 g, struct vec3x8 wo, struct vec3x8 wi)
{
    return 1 / (1 + ggx_lambda(g, wo) + ggx_lambda(g, wi));
}

/* Density of the visible normal h seen from wo (wo.z > 0), per solid angle of h */
LANE_FN f8 ggx_visible_pdf(struct ggx8 g, struct vec3x8 wo, struct vec3x8 h)
{
    f8 wo_h = f8_max(vec3x8_dot(wo, h), F8(0));
    return ggx_G1(g, wo) * wo_h * ggx_D(g, h) / f8_max(wo.z, F8(1e-30f));
}

/*
 * A visible normal seen from wo (wo.z > 0): spherical caps, Dupuy and Benyoub 2023. 1 - z is kept
 * as u (1 + w.z), exact where z is close to 1.
 */
LANE_FN struct vec3x8 ggx_visible_sample(struct ggx8 g, struct vec3x8 wo, f8 u, f8 v)
{
    /* Stretch to the hemisphere of alpha 1 */
    struct vec3x8 w = vec3x8_unit((struct vec3x8){ wo.x * g.ax, wo.y * g.ay, wo.z });

    /* A uniform point on the cap of directions that reflect w upwards */
    f8 one_minus_z = u * (1 + w.z);
    f8 z = 1 - one_minus_z;
    f8 r = f8_sqrt(f8_max(one_minus_z * (2 - one_minus_z), F8(0)));
    f8 sine, cosine;
    f8_sincos_turns(v, &sine, &cosine);

    /* The half vector, squeezed back */
    f8 hz = f8_max(z + w.z, F8(1e-12f));
    return vec3x8_unit((struct vec3x8){ g.ax * (r * cosine + w.x), g.ay * (r * sine + w.y), hz });
}

#endif
