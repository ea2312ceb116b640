/*
 * The smooth or rough dielectric coat over a diffuse base: what pbrt-v4's layered random walk
 * (CoatedDiffuse, no medium between the layers) expects, integrated instead of walked.
 *
 * With n the coat's index, GGX interface of width alpha (VNDF, height-correlated Smith, single
 * scattering), and every crossing of the layer at cosine mu attenuated by exp(-thickness / mu):
 *
 *   T(mu)    what enters from outside at cosine mu and arrives at the base (energy, without the
 *            1/n^2 that radiance picks up at the interface)
 *   R_in     of a diffuse upward flux leaving the base, what the interface sends back to the base
 *   f(wo,wi) = f_ggx(wo,wi) + T(wo) T(wi) rho / (pi n^2 (1 - rho R_in))
 *
 * T(wo) carries 1/n^2 because radiance leaves through the interface, T(wi) none because light
 * enters through it; between them the base scatters rho/pi, and rho R_in sums as a geometric
 * series. For alpha and thickness towards 0, (1 - R_in) n^2 is the hemispherical mean of T.
 *
 * Anisotropic coats use the mean of their two alphas here. Pure; any thread; about 30 ms for a
 * rough coat.
 */
#ifndef MASTER_COAT_H
#define MASTER_COAT_H

#include "common/scene.h"

struct coat {
    float table[COAT_TABLE_LEN]; /* T at mu = (i / (COAT_TABLE_LEN - 1))^2 */
    float inner;                 /* R_in */
    float scale;                 /* 1 / (pi n^2) */
};

void coat_tabulate(double alpha, double ior, double thickness, struct coat *coat);

#endif
