/*
 * Loop's subdivision of triangle meshes (Loop 1987, with the boundary rules of Hoppe et al. 1994),
 * as pbrt-v4's shape "loopsubdiv" has it: after `levels` refinements every vertex is moved to where
 * it would be after infinitely many, and gets the normal of the limit surface there.
 *
 * As in pbrt, that normal is on the side from which the corners of a face go around clockwise:
 * opposite to that of a trianglemesh of the same corners. Unlike pbrt, whose masks for tangents see
 * the moved neighbours, it is that of the limit surface itself; and a boundary is moved to its own
 * limit, the cubic B-spline (pbrt weighs 1/5 : 3/5 : 1/5 instead of 1/6 : 4/6 : 1/6). After the
 * usual three levels neither is seen. Pure, but for memory.
 */
#ifndef MASTER_SUBDIVIDE_H
#define MASTER_SUBDIVIDE_H

#include "master/tessellate.h"

struct subdivide_mesh {
    const double *points; /* 3 each */
    size_t point_count;
    const double *indices; /* 3 per triangle: whole numbers, as text is read */
    size_t triangle_count;
};

#define SUBDIVIDE_LEVELS 12

/* ERR_SCENE when an index is out of range, a triangle meets itself, neighbours are wound against
 * each other or more than two share an edge, or there would be too many triangles. */
bool subdivide_loop(struct tessellation *out, const struct subdivide_mesh *mesh, unsigned levels,
                    struct err *err);

#endif
