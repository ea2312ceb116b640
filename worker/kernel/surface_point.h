/*
 * One point of a shape as textures see it, scalar: what filters and emission need where no surface
 * of eight lanes is at hand. The same parametrisation as hit.h's, in our own arithmetic; without
 * dpdu, dpdv and a footprint, so textures are read at full size. Points are in the shape's space,
 * which in a group is the group's.
 */
#ifndef WORKER_KERNEL_SURFACE_POINT_H
#define WORKER_KERNEL_SURFACE_POINT_H

#include "common/scene.h"
#include "worker/kernel/texture.h"

/* Triangle `prim` of the mesh where the ray from o along d meets it, or next to there: never
 * outside of the triangle. */
void surface_point_triangle(const struct scene *scene, const struct mesh *mesh, uint32_t prim,
                            const float o[3], const float d[3], struct texture_point *point);

/* The quadric at o + t d. */
void surface_point_quadric(const struct quadric *quadric, const float o[3], const float d[3],
                           float t, struct texture_point *point);

#endif
