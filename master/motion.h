/*
 * Motion from one transform to another, taken apart so that what lies between them is a motion and
 * not a crumpling: T R S as pbrt-v4 does it, after Shoemake and Duff 1992. Pure.
 */
#ifndef MASTER_MOTION_H
#define MASTER_MOTION_H

#include "common/scene.h"
#include "master/transform.h"

/* Both must be affine and invertible; false when they are not, or when turning one into the other
 * means passing through a mirror. */
bool motion_decompose(const struct transform *start, const struct transform *end,
                      struct motion *out);

#endif
