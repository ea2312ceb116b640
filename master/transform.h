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
 * latter with the inverse's transpose, which is why they take the inverse. Not normalised. Inline,
 * as meshes have millions. */
static inline void transform_point(const struct transform *a, const double p[3], double out[3])
{
    double x = p[0], y = p[1], z = p[2];
    for (int i = 0; i < 3; i++)
        out[i] = a->m[i][0] * x + a->m[i][1] * y + a->m[i][2] * z + a->m[i][3];
    double w = a->m[3][0] * x + a->m[3][1] * y + a->m[3][2] * z + a->m[3][3];
    if (w != 1)
        for (int i = 0; i < 3; i++)
            out[i] /= w;
}

static inline void transform_vector(const struct transform *a, const double v[3], double out[3])
{
    double x = v[0], y = v[1], z = v[2];
    for (int i = 0; i < 3; i++)
        out[i] = a->m[i][0] * x + a->m[i][1] * y + a->m[i][2] * z;
}

static inline void transform_normal(const struct transform *inverse, const double n[3],
                                    double out[3])
{
    double x = n[0], y = n[1], z = n[2];
    for (int i = 0; i < 3; i++)
        out[i] = inverse->m[0][i] * x + inverse->m[1][i] * y + inverse->m[2][i] * z;
}

bool transform_is_affine(const struct transform *a);
double transform_det3(const struct transform *a); /* of the upper left 3x3 */

/* Is the 3x3 a rotation, mirrored or not, times one scale? Then that scale, else 0. */
double transform_similarity(const struct transform *a);

#endif
