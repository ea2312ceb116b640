/*
 * Curved shapes as triangles: what pbrt intersects in closed form and we do not. Every vertex lies
 * on the surface, with pbrt-v4's (u, v) and the surface's own normal, so that only silhouettes and
 * areas differ: a chord of a circle stays within 3.1e-4 of the radius (TESSELLATE_TURN pieces), a
 * sphere, which has half as many, within 2.5e-3 (its area within 2.5e-3, too), and a bilinear patch
 * within the tolerance that its caller states. Seams have the same coordinates on
 * both sides, bit by bit. Also the array that subdivide.h and curve_mesh.h fill.
 *
 * Triangles are wound around the normal, which is that of dp/du x dp/dv. What has no area is left
 * out, so that a shape without any gives no triangles. Coordinates are rounded from doubles by the
 * caller; pure, but for the memory of the arrays.
 */
#ifndef MASTER_TESSELLATE_H
#define MASTER_TESSELLATE_H

#include "master/growing.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

#define TESSELLATE_TURN 128 /* pieces of a full circle */

/* Triangles in the making. Zeros and a limit are a good start. */
struct tessellation {
    struct growing positions; /* 3 doubles each */
    struct growing normals; /* 3 doubles each, unit or, where there is none, zero; or empty: flat */
    struct growing uvs;     /* 2 doubles each; or empty */
    struct growing triangles; /* 3 uint32_t each */
    size_t most;              /* triangles: more are ERR_SCENE */
};
void tessellate_free(struct tessellation *out);

/* Fail with ERR_SCENE if so many triangles more are too many, or more than 2^32. */
bool tessellate_allows(const struct tessellation *out, double more, struct err *err);

/* Add a vertex, without normal or (u, v) where they are NULL, and a triangle of three vertices. */
bool tessellate_vertex(struct tessellation *out, const double p[3], const double n[3],
                       const double uv[2], struct err *err);
bool tessellate_triangle(struct tessellation *out, uint32_t a, uint32_t b, uint32_t c,
                         struct err *err);

/*
 * Shapes about the z axis, from phi = 0 to phi_max (radians; u = phi / phi_max). A cylinder has its
 * normal outwards and v from z_min to z_max, and so has a sphere, where v goes with the polar
 * angle; a disk lies at z = height, its normal up, with v from its rim inwards.
 */
struct tessellate_round {
    double radius, phi_max;
    double z_min, z_max;         /* cylinder, sphere */
    double height, inner_radius; /* disk */
};
bool tessellate_cylinder(struct tessellation *out, const struct tessellate_round *shape,
                         struct err *err);
bool tessellate_sphere(struct tessellation *out, const struct tessellate_round *shape,
                       struct err *err);
bool tessellate_disk(struct tessellation *out, const struct tessellate_round *shape,
                     struct err *err);

/* Corners at (u, v) = (0,0), (1,0), (0,1), (1,1); their normals and texture coordinates, if any,
 * are interpolated bilinearly, too. */
struct tessellate_patch {
    double p[4][3];
    bool has_normals, has_uvs;
    double n[4][3];
    double uv[4][2];
};

/* No further than `tolerance` from the patch, in at most TESSELLATE_PATCH_MOST^2 cells. Without
 * normals of its own a flat patch gets none if `flat` says that nobody wants them. */
#define TESSELLATE_PATCH_MOST 64
bool tessellate_patch(struct tessellation *out, const struct tessellate_patch *patch,
                      double tolerance, bool flat, struct err *err);

/* Is it flat, within rounding of its corners? */
bool tessellate_patch_is_flat(const struct tessellate_patch *patch);

#endif
