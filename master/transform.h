/*
 * Affine and projective transforms of scene files: 4x4 matrices in double, row-major, acting on
 * column vectors. Angles are radians. Pure.
 */
#ifndef MASTER_TRANSFORM_H
#define MASTER_TRANSFORM_H

#include <stdbool.h>

struct transform {
    double m[4][4];
};

struct transform transform_identity(void);
struct transform transform_translate(double x, double y, double z);
struct transform transform_scale(double x, double y, double z);

/* a * b: b is applied first */
struct transform transform_mul(const struct transform *a, const struct transform *b);

/* Right-handed about an axis, which need not be unit; false when it is zero. */
bool transform_rotate(double angle, const double axis[3], struct transform *out);

/* World to camera: the camera at `eye` looks along +z at `at`, +y is up, +x completes pbrt's
 * left-handed frame. False when the three do not define a frame. */
bool transform_look_at(const double eye[3], const double at[3], const double up[3],
                       struct transform *out);

/* False when the matrix is singular or not finite. */
bool transform_invert(const struct transform *a, struct transform *out);

/* Points (with the division by w where the last row asks for it), directions, and normals: the
 * latter with the inverse's transpose, which is why they take the inverse. Not normalised. */
void transform_point(const struct transform *a, const double p[3], double out[3]);
void transform_vector(const struct transform *a, const double v[3], double out[3]);
void transform_normal(const struct transform *inverse, const double n[3], double out[3]);

bool transform_is_affine(const struct transform *a);
double transform_det3(const struct transform *a); /* of the upper left 3x3 */

/* Is the 3x3 a rotation, mirrored or not, times one scale? Then that scale, else 0. */
double transform_similarity(const struct transform *a);

#endif
