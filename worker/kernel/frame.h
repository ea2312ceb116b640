/*
 * Orthonormal frames around a normal, eight at a time. Local coordinates have the normal as +z.
 */
#ifndef WORKER_KERNEL_FRAME_H
#define WORKER_KERNEL_FRAME_H

#include "common/lane.h"

struct frame8 {
    struct vec3x8 s, t, n;
};

/*
 * Duff et al., "Building an Orthonormal Basis, Revisited" (JCGT 6(1), 2017): no singularity at
 * n.z = -1, and right at n.z = -0 because only the sign bit is read. n is unit length.
 */
LANE_FN struct frame8 frame_around(struct vec3x8 n)
{
    f8 sign = f8_copysign(F8(1), n.z);
    f8 a = -1 / (sign + n.z);
    f8 b = n.x * n.y * a;
    struct frame8 frame;
    frame.s = (struct vec3x8){ 1 + sign * n.x * n.x * a, sign * b, -sign * n.x };
    frame.t = (struct vec3x8){ b, sign + n.y * n.y * a, -n.y };
    frame.n = n;
    return frame;
}

/* In the lanes of `turned`, the same frame turned about its normal until s lies along dpdu; where
 * dpdu has no direction across the normal nothing turns */
LANE_FN struct frame8 frame_turned(i8 turned, const struct frame8 *frame, struct vec3x8 dpdu)
{
    struct vec3x8 n = frame->n;
    dpdu = vec3x8_unit(dpdu);
    struct vec3x8 s = vec3x8_along(dpdu, n, -vec3x8_dot(dpdu, n));
    turned &= vec3x8_length2(s) > 1e-10f;
    s = vec3x8_unit(s);
    s = vec3x8_unit(vec3x8_along(s, n, -vec3x8_dot(s, n))); /* what cancelled above, once more */
    struct frame8 out;
    out.s = vec3x8_select(turned, s, frame->s);
    out.t = vec3x8_select(turned, vec3x8_cross(n, s), frame->t);
    out.n = n;
    return out;
}

LANE_FN struct vec3x8 frame_to_local(const struct frame8 *frame, struct vec3x8 v)
{
    return (struct vec3x8){ vec3x8_dot(v, frame->s), vec3x8_dot(v, frame->t),
                            vec3x8_dot(v, frame->n) };
}

LANE_FN struct vec3x8 frame_to_world(const struct frame8 *frame, struct vec3x8 v)
{
    struct vec3x8 world = vec3x8_scale(frame->s, v.x);
    world = vec3x8_along(world, frame->t, v.y);
    return vec3x8_along(world, frame->n, v.z);
}

#endif
