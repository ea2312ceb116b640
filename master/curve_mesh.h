/*
 * pbrt-v4's curves as triangles: Bezier or B-spline curves of degree 2 or 3, drawn with a width.
 *
 * A ribbon is the strip that pbrt has: across it lies the cross product of its normal and the
 * tangent, and (u, v) go along each segment and across. "flat" and "cylinder" curves, which in pbrt
 * are strips that turn to every ray, are tubes here: seen from anywhere they are as wide (on
 * average over directions exactly so), their normals point outwards, and v goes once around. Tubes
 * are open at both ends.
 *
 * The middle line keeps within a thousandth of the curve's size (the diagonal of its control
 * points and width), and so does a tube of its circle, so that hair has four sides. Pure, but for
 * memory.
 */
#ifndef MASTER_CURVE_MESH_H
#define MASTER_CURVE_MESH_H

#include "master/tessellate.h"

struct curve {
    const double *points; /* 3 each */
    size_t point_count;
    int degree; /* 2 or 3 */
    bool bspline;
    bool ribbon;
    double width[2];       /* at the curve's start and end */
    const double *normals; /* ribbon: 3 for the start of each segment and the last one's end */
    size_t normal_count;
};

/* How many segments the points make, or 0 with ERR_SCENE: a wrong degree or number of points. */
size_t curve_mesh_segments(const struct curve *curve, struct err *err);

/* Add the whole curve; what has no length or no width gives no triangles. ERR_SCENE also when a
 * ribbon's normals do not match its segments. */
bool curve_mesh_add(struct tessellation *out, const struct curve *curve, struct err *err);

#endif
