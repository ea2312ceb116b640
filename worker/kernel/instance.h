/*
 * Instances and motion, eight at a time: where groups of shapes stand at the times of eight rays,
 * rays into their space, and surfaces out of it.
 *
 * Embree sees all instances as one user geometry whose callbacks (callbacks.c) take the rays to the
 * group's space and ask the group's own scene. That needs no more than struct instance and a leaf
 * of the tree per instance, where an instance object of Embree's takes half a kilobyte; and the
 * rays that find a surface are the very ones from which its point is computed here.
 */
#ifndef WORKER_KERNEL_INSTANCE_H
#define WORKER_KERNEL_INSTANCE_H

#include "worker/kernel/hit.h"

/* Below this angle between two quaternions a straight line is as good as the arc */
#define SLERP_LEAST 1e-3f

/* An affine map, row by row: a row is a vector and what is added */
struct rows8 {
    struct vec3x8 x, y, z, add;
};

struct pose8 {
    struct rows8 to_world, to_object;
};

LANE_FN struct vec3x8 rows8_vector(const struct rows8 *m, struct vec3x8 v)
{
    return (struct vec3x8){ vec3x8_dot(m->x, v), vec3x8_dot(m->y, v), vec3x8_dot(m->z, v) };
}

LANE_FN struct vec3x8 rows8_point(const struct rows8 *m, struct vec3x8 p)
{
    return vec3x8_add(rows8_vector(m, p), m->add);
}

/* v through the transpose: normals, when m is the inverse of what points go through */
LANE_FN struct vec3x8 rows8_transposed(const struct rows8 *m, struct vec3x8 v)
{
    struct vec3x8 sum = vec3x8_scale(m->x, v.x);
    return vec3x8_along(vec3x8_along(sum, m->y, v.y), m->z, v.z);
}

LANE_FN struct vec3x8 vec3x8_abs(struct vec3x8 a)
{
    return (struct vec3x8){ f8_abs(a.x), f8_abs(a.y), f8_abs(a.z) };
}

/* The sums that m makes of a point of these magnitudes, without regard to signs: what the rounding
 * of rows8_point is relative to */
LANE_FN struct vec3x8 rows8_magnitude(const struct rows8 *m, struct vec3x8 size)
{
    struct rows8 a = { vec3x8_abs(m->x), vec3x8_abs(m->y), vec3x8_abs(m->z), vec3x8_abs(m->add) };
    return rows8_point(&a, size);
}

LANE_FN struct rows8 rows8_select(i8 mask, const struct rows8 *a, const struct rows8 *b)
{
    return (struct rows8){ vec3x8_select(mask, a->x, b->x), vec3x8_select(mask, a->y, b->y),
                           vec3x8_select(mask, a->z, b->z), vec3x8_select(mask, a->add, b->add) };
}

/* base[at + i]; with `one`, a constant, all lanes read what the first does */
LANE_FN f8 instance_number(const float *base, int one, i8 at, int i)
{
    return one ? F8(base[at[0] + i]) : f8_gather(base + i, at);
}

LANE_FN struct vec3x8 instance_vector(const float *base, int one, i8 at, int i, int step)
{
    return (struct vec3x8){ instance_number(base, one, at, i),
                            instance_number(base, one, at, i + step),
                            instance_number(base, one, at, i + 2 * step) };
}

/* A 3x4 matrix of the instances `at` */
LANE_FN struct rows8 instance_rows(const float *base, int one, i8 at)
{
    return (
        struct rows8){ instance_vector(base, one, at, 0, 1), instance_vector(base, one, at, 4, 1),
                       instance_vector(base, one, at, 8, 1), instance_vector(base, one, at, 3, 4) };
}

/* Between two keys; exactly these at s = 0 and s = 1 (NUMERICS H18) */
LANE_FN struct vec3x8 motion_between(const float *base, int one, i8 at, int size, f8 s)
{
    struct vec3x8 first = instance_vector(base, one, at, 0, 1),
                  second = instance_vector(base, one, at, size, 1);
    return vec3x8_along(vec3x8_scale(first, 1 - s), second, s);
}

/* Where motions `index` (of the array, not 1 + index) are at time s */
LANE_FN struct pose8 motion_pose(const struct scene *scene, int one, i8 index, f8 s)
{
    const struct motion *m = scene->motions;
    i8 at = index * (int32_t)(sizeof(*m) / sizeof(float));

    /* Along the great arc between the two rotations */
    f8 angle = instance_number(&m->angle, one, at, 0), w0 = 1 - s, w1 = s;
    f8 whole, part0, part1, unused;
    f8_sincos(angle, &whole, &unused);
    f8_sincos(angle * (1 - s), &part0, &unused);
    f8_sincos(angle * s, &part1, &unused);
    i8 arc = angle > SLERP_LEAST;
    w0 = f8_select(arc, part0 / whole, w0);
    w1 = f8_select(arc, part1 / whole, w1);
    f8 q[4], length2 = F8(0);
    for (int i = 0; i < 4; i++) {
        q[i] = instance_number(m->rotation[0], one, at, i) * w0 +
               instance_number(m->rotation[1], one, at, i) * w1;
        length2 = length2 + q[i] * q[i];
    }
    f8 x = q[0], y = q[1], z = q[2], w = q[3], n = 2 / length2;
    struct rows8 R = {
        { 1 - n * (y * y + z * z), n * (x * y - z * w), n * (x * z + y * w) },
        { n * (x * y + z * w), 1 - n * (x * x + z * z), n * (y * z - x * w) },
        { n * (x * z - y * w), n * (y * z + x * w), 1 - n * (x * x + y * y) },
        vec3x8_all(0, 0, 0),
    };

    /* The columns of S, which is symmetric but for rounding, and of its inverse's transpose */
    struct vec3x8 S[3], C[3];
    for (int i = 0; i < 3; i++) {
        struct vec3x8 first = instance_vector(m->stretch[0], one, at, i, 3),
                      second = instance_vector(m->stretch[1], one, at, i, 3);
        S[i] = vec3x8_along(vec3x8_scale(first, 1 - s), second, s);
    }
    for (int i = 0; i < 3; i++)
        C[i] = vec3x8_cross(S[(i + 1) % 3], S[(i + 2) % 3]);
    f8 scale = 1 / vec3x8_dot(S[0], C[0]);

    struct pose8 pose;
    struct vec3x8 columns[3], T = motion_between(m->translation[0], one, at, 3, s);
    for (int i = 0; i < 3; i++)
        columns[i] = rows8_vector(&R, S[i]);
    pose.to_world = (struct rows8){ { columns[0].x, columns[1].x, columns[2].x },
                                    { columns[0].y, columns[1].y, columns[2].y },
                                    { columns[0].z, columns[1].z, columns[2].z },
                                    T };
    /* Row i of S^-1 R^T is R times column i of the inverse's transpose */
    struct vec3x8 rows[3];
    for (int i = 0; i < 3; i++)
        rows[i] = rows8_vector(&R, vec3x8_scale(C[i], scale));
    pose.to_object = (struct rows8){ rows[0], rows[1], rows[2], vec3x8_all(0, 0, 0) };
    pose.to_object.add = vec3x8_neg(rows8_vector(&pose.to_object, T));
    return pose;
}

/* Where instances `index` are at time s. With `one` (a constant) they are all the first lane's. */
LANE_FN struct pose8 instance_pose(const struct scene *scene, unsigned fx, int one, i8 index, f8 s)
{
    const struct instance *base = scene->instances;
    i8 at = index * (int32_t)(sizeof(*base) / sizeof(float));
    struct pose8 pose = { instance_rows(base->to_world, one, at),
                          instance_rows(base->to_object, one, at) };
    if (fx & FX_MOTION) {
        i8 motion = i8_gather(&base->motion, at);
        i8 moves = motion != 0;
        if (i8_any(moves)) {
            struct pose8 moved = motion_pose(scene, one, (motion - 1) & moves, s);
            pose.to_world = rows8_select(moves, &moved.to_world, &pose.to_world);
            pose.to_object = rows8_select(moves, &moved.to_object, &pose.to_object);
        }
    }
    return pose;
}

/*
 * Hits inside instances come with a geometry and primitive of their group's scene: make them those
 * of the whole scene. Returns the lanes that hit an instance.
 */
LANE_FN i8 instance_resolve(const struct kernel_scene *ks, i8 hit, i8 instance, i8 *geometry,
                            i8 *prim)
{
    i8 inside = hit & (instance != -1);
    if (!i8_any(inside))
        return inside;
    const struct scene *scene = ks->scene;
    i8 group = GATHER_I(scene->instances, struct instance, group, instance & inside);
    i8 meshes = GATHER_I(scene->groups, struct group, mesh_count, group);
    i8 first_mesh = GATHER_I(scene->groups, struct group, first_mesh, group);
    i8 first_quadric = GATHER_I(scene->groups, struct group, first_quadric, group);
    i8 quadric = inside & (*geometry == meshes);
    *prim = *prim + (first_quadric & quadric);
    *geometry = *geometry + (first_mesh & inside);
    *geometry = i8_select(quadric, I8(ks->quadric_geometry), *geometry);
    return inside;
}

/* Take the rays of the lanes `inside` to the space of what they hit */
LANE_FN void instance_enter(i8 inside, const struct pose8 *pose, struct vec3x8 *o, struct vec3x8 *d)
{
    *o = vec3x8_select(inside, rows8_point(&pose->to_object, *o), *o);
    *d = vec3x8_select(inside, rows8_vector(&pose->to_object, *d), *d);
}

/*
 * Take the surfaces of the lanes `inside` to the world. A spawned ray must clear its surface by the
 * rounding of the point's way out and of the next ray's way back in, both relative to the sums
 * without regard to signs. A distance along the normal in the world is |to_object^T n| times that
 * in object space, whatever the transform does to the shape.
 */
LANE_FN void instance_leave(i8 inside, unsigned fx, const struct pose8 *pose, struct surface8 *s)
{
    struct vec3x8 world = rows8_magnitude(&pose->to_world, vec3x8_abs(s->p));
    struct vec3x8 object = rows8_magnitude(&pose->to_object, world);
    struct vec3x8 n = rows8_transposed(&pose->to_object, s->ng);
    f8 shrink = 1 / f8_sqrt(vec3x8_length2(n));
    f8 spawn = vec3x8_max(world) * SPAWN_ULPS +
               (s->spawn + vec3x8_max(object) * SPAWN_ULPS) * shrink;
    n = vec3x8_unit(n);
    struct vec3x8 ns = n;
    if (fx & FX_SMOOTH_NORMALS) {
        ns = vec3x8_unit(rows8_transposed(&pose->to_object, s->ns));
        n = vec3x8_select(vec3x8_dot(ns, n) < 0, vec3x8_neg(n), n);
    }
    if (fx & HIT_MAPPED) {
        s->dpdu = vec3x8_select(inside, rows8_vector(&pose->to_world, s->dpdu), s->dpdu);
        s->dpdv = vec3x8_select(inside, rows8_vector(&pose->to_world, s->dpdv), s->dpdv);
    }
    s->p = vec3x8_select(inside, rows8_point(&pose->to_world, s->p), s->p);
    s->ng = vec3x8_select(inside, n, s->ng);
    s->ns = vec3x8_select(inside, ns, s->ns);
    s->spawn = f8_select(inside, spawn, s->spawn);
}

#endif
