/*
 * The sheen of cloth, as glTF's KHR_materials_sheen has it: fibres that stand on a surface, after
 * Estevez and Kulla, "Production Friendly Microfacet Sheen BRDF" (SIGGRAPH 2017).
 *
 *   f_sheen = color D(h) / (4 |cos wo| |cos wi| (1 + Lambda(wo) + Lambda(wi)))
 *   D(h)    = (2 + 1/alpha) sin(h)^(1/alpha) / (2 pi)
 *
 * with their fit for Lambda. The extension offers a simpler visibility, by Ashikhmin and Premoze,
 * and warns that it makes energy: 1.5 times what arrives where this one stays below 1. But narrow
 * fibres (alpha < 1/16) send back more than arrives at grazing angles here, too, up to three times.
 * So f_sheen is multiplied by the smaller `bound` of its two directions, which is 1 but for them.
 *
 * The albedo E is the share of light from one direction that white fibres then send back. The
 * surface below gets what they leave, and both directions have a say, as in the extension:
 *   f = f_sheen + (1 - max(color) max(E(wo), E(wi))) f_below
 * It returns all light where wi is at the same cosine as wo, as in a mirror, and else loses some.
 * alpha is the square of glTF's roughness, and 1/256 where that is below 1/16.
 *
 * Kernels evaluate the functions of eight lanes and read E and the bound from a table, which
 * whoever makes a scene computes. Pure; any thread.
 */
#ifndef COMMON_SHEEN_H
#define COMMON_SHEEN_H

#include "common/elem.h"
#include "common/scene.h"

/* Lambda and 1 / cos cancel towards grazing angles, but not forever: the fit was not made for it */
#define SHEEN_COSINE_LEAST 1e-4f

/* E and the bound of all widths, as struct material describes their rows; some tens of
 * milliseconds. What is read between its entries errs by less than half a per cent; so E is that
 * much larger, and the bound smaller, and together nothing returns more than it gets. */
void sheen_tabulate(float rows[SHEEN_ROWS][COAT_TABLE_LEN]);

/* (1 - t) a + t b */
LANE_FN f8 sheen_between(float a, float b, f8 t)
{
    return (1 - t) * a + t * b;
}

LANE_FN f8 sheen_fit(f8 x, f8 alpha)
{
    f8 t = (1 - alpha) * (1 - alpha);
    f8 a = sheen_between(21.5473f, 25.3245f, t), b = sheen_between(3.82987f, 3.32435f, t);
    f8 c = sheen_between(0.19823f, 0.16801f, t), d = sheen_between(-1.97760f, -1.27393f, t);
    f8 e = sheen_between(-4.32054f, -4.85967f, t);
    return a / (1 + b * f8_exp(c * f8_log(x))) + d * x + e;
}

/* Of a direction at cosine mu in [SHEEN_COSINE_LEAST, 1] */
LANE_FN f8 sheen_lambda(f8 mu, f8 alpha)
{
    i8 low = mu < 0.5f;
    f8 fit = sheen_fit(f8_select(low, mu, f8_max(1 - mu, F8(SHEEN_COSINE_LEAST))), alpha);
    return f8_exp(f8_select(low, fit, 2 * sheen_fit(F8(0.5f), alpha) - fit));
}

/* The density of normals whose sine has this square */
LANE_FN f8 sheen_density(f8 sine2, f8 alpha)
{
    f8 inverse = 1 / alpha;
    return (2 + inverse) * f8_exp(0.5f * inverse * f8_log(sine2)) * 0.15915494f;
}

/* The value of white fibres before the bound, times the cosine of wi; both are above the surface */
LANE_FN f8 sheen_value(struct vec3x8 wo, struct vec3x8 wi, f8 alpha)
{
    struct vec3x8 h = vec3x8_add(wo, wi);
    f8 across = h.x * h.x + h.y * h.y, sine2 = across / f8_max(across + h.z * h.z, F8(1e-30f));
    f8 co = f8_max(wo.z, F8(SHEEN_COSINE_LEAST)), ci = f8_max(wi.z, F8(SHEEN_COSINE_LEAST));
    f8 shadowed = 1 + sheen_lambda(co, alpha) + sheen_lambda(ci, alpha);
    return sheen_density(sine2, alpha) * wi.z / (4 * co * ci * shadowed);
}

#endif
