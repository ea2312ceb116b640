/*
 * Emission that changes over a light (light.texture), and lights that are there in part (alpha).
 *
 * A ray that finds a light by chance and a sample of it must be samples of one integral: both read
 * the same texture at the same place, without a footprint; and where the ray finds as much of the
 * surface as its alpha says, a sample is weighed by that share. Densities do not know of either:
 * points are chosen by what the receiver sees of the whole shape.
 *
 * Not inlined: scalar, as textures are, and none of it is in kernels without FX_TEXTURE.
 */
#ifndef WORKER_KERNEL_EMISSION_H
#define WORKER_KERNEL_EMISSION_H

#include "worker/kernel/kernel_scene.h"

#include <stdbool.h>

/* Of one light: the shape whose points it has, where it wants any */
struct emission {
    const struct mesh *mesh;       /* of a polygon; NULL else */
    const struct quadric *quadric; /* of a sphere or disk; NULL else */
    uint32_t prim;                 /* triangle of the mesh */
};

/* ks->emission: one per light, or NULL when no light needs it. */
bool emission_open(struct kernel_scene *ks, struct err *err);
void emission_close(struct kernel_scene *ks);

/* What the light emits at a point that a ray found; rgb holds its mean, and keeps it where the
 * emission is the same everywhere. */
void emission_seen(const struct kernel_scene *ks, uint32_t light, const struct texture_point *point,
                   float rgb[3]);

/* The same at the point `to` away from p, times how much of the surface is there. */
void emission_sampled(const struct kernel_scene *ks, uint32_t light, const float p[3],
                      const float to[3], float rgb[3]);

#endif
