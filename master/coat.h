/*
 * The smooth or rough dielectric coat over a diffuse base or over metal.
 *
 * Over a diffuse base: what pbrt-v4's layered random walk
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
 * Over metal the walk has no such closed form, and ours differs from it in the shape of its lobes,
 * not in its energy. With primes for directions inside (Snell's, at a smooth interface), mu for a
 * cosine outside, and F_c for the metal's reflectance against the coat:
 *
 *   f(wo,wi) = f_ggx(wo,wi)
 *            + T(wo) T(wi) B D(h') G2(wo',wi') / (4 mu_o' mu_i' n^2)
 *            + T(wo) T(wi) M(wo) M(wi) C / Z
 *
 * The second lobe is the metal seen through the interface. Its half vector h' is that of the
 * refracted directions, so that it is exact for a smooth interface; a rough one deflects what
 * crosses it by (n - 1) / n of its slope inside, twice independently, as much as widening the
 * metal's alpha_c to alpha_c^2 + alpha^2 ((n - 1) / n)^2 / 2 does. B = F_c / (1 - F_c R) are the
 * turns between metal and interface that stay near the mirror direction, with R(mu) what the
 * interface sends back of light that was leaving towards mu; of the two R the smaller one, which
 * can only lose. The third lobe is what is left: light that the metal sent beyond the critical
 * angle and that comes out after more turns. M is tabulated so that for F_c = 1 the two lobes
 * together return what the walk does, from every direction; C = F_a^2 (1 - q) / (1 - q F_a) colours
 * it, F_a being the mean of F_c and q the mean of R over the hemisphere inside.
 * Z is the integral of T M mu. All of it is reciprocal; with both surfaces smooth it is exact. The
 * energy returned differs from the walk's by at most 1.3 % of what arrives over white metal and 2 %
 * over any other, most at grazing angles; typically by a fifth of that.
 *
 * Anisotropic coats use the mean of their two alphas here. Pure; any thread; about a millisecond
 * for a rough coat, four over metal.
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

struct coat_metal {
    float rows[COAT_METAL_ROWS][COAT_TABLE_LEN]; /* mu as above */
    float inner;                                 /* q */
    float scale;                                 /* 1 / Z; 0 where M is 0 */
};

void coat_metal_tabulate(double alpha, double base_alpha, double ior, double thickness,
                         struct coat_metal *coat);

#endif
