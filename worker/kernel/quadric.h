/*
 * Spheres and disks, eight rays at a time: our own user geometry, because a triangulated sphere is
 * not a sphere and a quadratic solved carelessly loses all its digits far away (NUMERICS H8, H9).
 */
#ifndef WORKER_KERNEL_QUADRIC_H
#define WORKER_KERNEL_QUADRIC_H

#include "common/elem.h"
#include "common/lane.h"
#include "common/scene.h"

/* v through a row-major 3x3 matrix, the same for all lanes */
LANE_FN struct vec3x8 quadric_linear(const float m[9], struct vec3x8 v)
{
    return (struct vec3x8){ v.x * m[0] + v.y * m[1] + v.z * m[2],
                            v.x * m[3] + v.y * m[4] + v.z * m[5],
                            v.x * m[6] + v.y * m[7] + v.z * m[8] };
}

LANE_FN f8 quadric_phi(f8 x, f8 y)
{
    f8 phi = f8_atan2(y, x);
    return f8_select(phi < 0, phi + 6.28318530717958647692f, phi);
}

/* Is the object-space point on the part that was not cut away? */
LANE_FN i8 quadric_keeps(const struct quadric *q, struct vec3x8 point)
{
    i8 keeps = I8(-1);
    if (q->flags & QUADRIC_PARTIAL) {
        keeps = (point.z >= q->z_min) & (point.z <= q->z_max);
        if (q->kind == QUADRIC_DISK)
            keeps = I8(-1);
        keeps &= quadric_phi(point.x, point.y) <= q->phi_max;
    }
    return keeps;
}

/*
 * The nearest hit with tnear <= t <= tfar of rays o + t d: its t, and the lanes that hit. The
 * discriminant is taken from the ray's closest point to the centre, and the two roots from the
 * product form, so that neither cancels (Haines et al., Ray Tracing Gems, chapter 7). Their product
 * c is taken from that point too: what rounds b then hardly moves c over the other root.
 */
LANE_FN i8 quadric_intersect(const struct quadric *q, i8 valid, struct vec3x8 origin,
                             struct vec3x8 direction, f8 tnear, f8 tfar, f8 *t_hit)
{
    struct vec3x8 center = vec3x8_all(q->center[0], q->center[1], q->center[2]);
    struct vec3x8 o = quadric_linear(q->to_object, vec3x8_sub(origin, center));
    struct vec3x8 d = quadric_linear(q->to_object, direction);

    if (q->kind == QUADRIC_DISK) {
        f8 t = -o.z / d.z;
        struct vec3x8 point = vec3x8_along(o, d, t);
        f8 r2 = point.x * point.x + point.y * point.y;
        i8 hit = valid & (d.z != 0) & (t >= tnear) & (t <= tfar) & (r2 <= q->radius * q->radius) &
                 (r2 >= q->inner_radius * q->inner_radius) & quadric_keeps(q, point);
        *t_hit = t;
        return hit;
    }

    f8 a = vec3x8_length2(d);
    f8 b = -vec3x8_dot(o, d);
    struct vec3x8 closest = vec3x8_along(o, d, b / a);
    f8 distance = f8_sqrt(vec3x8_length2(closest));
    f8 discriminant = (q->radius - distance) * (q->radius + distance) * a;
    i8 meets = valid & (discriminant >= 0) & (a > 0);
    f8 root = f8_sqrt(f8_max(discriminant, F8(0)));
    f8 far_sum = b + f8_copysign(root, b);
    f8 c = b * (b / a) - (q->radius - distance) * (q->radius + distance);
    f8 t_a = c / far_sum, t_b = far_sum / a;
    t_a = f8_select(far_sum != 0, t_a, F8(0));
    f8 t0 = f8_min(t_a, t_b), t1 = f8_max(t_a, t_b);

    i8 in0 = meets & (t0 >= tnear) & (t0 <= tfar);
    i8 in1 = meets & (t1 >= tnear) & (t1 <= tfar);
    if (q->flags & QUADRIC_PARTIAL) {
        in0 &= quadric_keeps(q, vec3x8_along(o, d, t0));
        in1 &= quadric_keeps(q, vec3x8_along(o, d, t1));
    }
    *t_hit = f8_select(in0, t0, t1);
    return in0 | in1;
}

#endif
