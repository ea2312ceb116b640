/*
 * From what Embree reports to a surface point: everything is recomputed in our own arithmetic from
 * the primitive found, so that the bits do not depend on Embree's t, u and v, and the point lies on
 * its surface to a few roundings.
 */
#ifndef WORKER_KERNEL_HIT_H
#define WORKER_KERNEL_HIT_H

#include "worker/kernel/bsdf.h"
#include "worker/kernel/frame.h"
#include "worker/kernel/kernel_scene.h"
#include "worker/kernel/quadric.h"

/* Effects that ask for texture coordinates */
#define HIT_MAPPED (FX_TEXTURE | FX_ANISOTROPIC)

struct surface8 {
    struct vec3x8 p;
    struct vec3x8 ng; /* geometric normal, unit, on the side the file gives */
    struct vec3x8 ns; /* shading normal, unit; ng where there is no other */
    f8 spawn;         /* how far rays start from p along the normal */
    i8 material;      /* valid for every lane; -1: only media make this a surface (FX_MEDIUM) */
    i8 light;         /* light it emits as, or -1 */
    /* With FX_MEDIUM only: media against and along ng, 1 + index or 0; the same where the surface
     * says nothing */
    i8 inside, outside;
    /* With HIT_MAPPED only: */
    f8 u, v;
    struct vec3x8 dpdu, dpdv; /* never parallel or 0: where uv says nothing, any two tangents */
    f8 color[4];              /* of the vertices; white where there are none */
};

LANE_FN f8 vec3x8_max_abs(struct vec3x8 a)
{
    return f8_max(f8_abs(a.x), f8_max(f8_abs(a.y), f8_abs(a.z)));
}

LANE_FN struct vec3x8 hit_vertex(const float *base, i8 vertex)
{
    i8 i = vertex * 3;
    return (struct vec3x8){ f8_gather(base, i), f8_gather(base + 1, i), f8_gather(base + 2, i) };
}

/*
 * The corners of the triangles found. Fetched apart from the rest, as in a large mesh they come
 * from memory: what is computed before hit_surface needs them is computed while waiting.
 */
struct hit_corners8 {
    i8 mesh, prim; /* valid in every lane, as are the rest */
    i8 a, b, c;    /* vertices */
};

LANE_FN struct hit_corners8 hit_corners(const struct kernel_scene *ks, unsigned fx, i8 hit,
                                        i8 geometry, i8 prim)
{
    struct hit_corners8 corners = { I8(0), I8(0), I8(0), I8(0), I8(0) };
    if (fx & FX_MESH) {
        const struct scene *scene = ks->scene;
        i8 lanes = fx & FX_QUADRIC ? hit & (geometry != ks->quadric_geometry) : hit;
        corners.mesh = geometry & lanes;
        corners.prim = prim & lanes;
        i8 first = GATHER_I(scene->meshes, struct mesh, first_triangle, corners.mesh);
        i8 index = (corners.prim + first) * 3;
        corners.a = i8_gather(scene->triangles, index);
        corners.b = i8_gather(scene->triangles + 1, index);
        corners.c = i8_gather(scene->triangles + 2, index);
    }
    return corners;
}

/* Three values at the corners of the lanes in `lanes`, each `stride` floats of `base` apart */
LANE_FN f8 hit_interpolate(const float *base, int32_t stride, i8 lanes,
                           const struct hit_corners8 *at, i8 shift, f8 u, f8 v)
{
    i8 a = ((at->a + shift) & lanes) * stride, b = ((at->b + shift) & lanes) * stride,
       c = ((at->c + shift) & lanes) * stride;
    return f8_gather(base, a) * (1 - u - v) + f8_gather(base, b) * u + f8_gather(base, c) * v;
}

/*
 * What textures need of a triangle with edges e1 and e2 at barycentric (u, v). Meshes without uv
 * have pbrt's: (0, 0), (1, 0), (1, 1).
 */
LANE_FN void hit_triangle_uv(const struct scene *scene, i8 flags, const struct hit_corners8 *at,
                             struct vec3x8 e1, struct vec3x8 e2, f8 u, f8 v, struct surface8 *s)
{
    struct vec2x8 A = { F8(0), F8(0) }, B = { F8(1), F8(0) }, C = { F8(1), F8(1) };
    i8 lanes = (flags & MESH_UVS) != 0;
    if (i8_any(lanes)) {
        i8 shift = GATHER_I(scene->meshes, struct mesh, uv_shift, at->mesh);
        i8 a = ((at->a + shift) & lanes) * 2, b = ((at->b + shift) & lanes) * 2,
           c = ((at->c + shift) & lanes) * 2;
        A.x = f8_select(lanes, f8_gather(scene->uvs, a), A.x);
        A.y = f8_select(lanes, f8_gather(scene->uvs + 1, a), A.y);
        B.x = f8_select(lanes, f8_gather(scene->uvs, b), B.x);
        B.y = f8_select(lanes, f8_gather(scene->uvs + 1, b), B.y);
        C.x = f8_select(lanes, f8_gather(scene->uvs, c), C.x);
        C.y = f8_select(lanes, f8_gather(scene->uvs + 1, c), C.y);
    }
    s->u = A.x * (1 - u - v) + B.x * u + C.x * v;
    s->v = A.y * (1 - u - v) + B.y * u + C.y * v;

    f8 u1 = B.x - A.x, v1 = B.y - A.y, u2 = C.x - A.x, v2 = C.y - A.y;
    f8 determinant = u1 * v2 - v1 * u2;
    f8 inv = 1 / determinant;
    i8 usable = (f8_abs(determinant) > 1e-30f) & (f8_abs(inv) < 1e30f);
    struct frame8 any = frame_around(s->ng);
    struct vec3x8 dpdu = vec3x8_sub(vec3x8_scale(e1, v2), vec3x8_scale(e2, v1));
    struct vec3x8 dpdv = vec3x8_sub(vec3x8_scale(e2, u1), vec3x8_scale(e1, u2));
    s->dpdu = vec3x8_select(usable, vec3x8_scale(dpdu, inv), any.s);
    s->dpdv = vec3x8_select(usable, vec3x8_scale(dpdv, inv), any.t);

    lanes = (flags & MESH_COLORS) != 0;
    if (i8_any(lanes)) {
        i8 shift = GATHER_I(scene->meshes, struct mesh, color_shift, at->mesh);
        for (int c = 0; c < 4; c++) {
            f8 color = hit_interpolate(scene->colors + c, 4, lanes, at, shift, u, v);
            s->color[c] = f8_select(lanes, color, s->color[c]);
        }
    }
}

/* The surface at triangles hit by rays from o along d */
LANE_FN void hit_triangle(const struct scene *scene, unsigned fx, const struct hit_corners8 *at,
                          struct vec3x8 o, struct vec3x8 d, struct surface8 *s)
{
    i8 mesh = at->mesh, prim = at->prim, ia = at->a, ib = at->b, ic = at->c;
    i8 flags = GATHER_I(scene->meshes, struct mesh, flags, mesh);
    struct vec3x8 A = hit_vertex(scene->positions, ia), B = hit_vertex(scene->positions, ib),
                  C = hit_vertex(scene->positions, ic);
    struct vec3x8 e1 = vec3x8_sub(B, A), e2 = vec3x8_sub(C, A);

    /* Barycentric coordinates (Moeller and Trumbore 1997), kept inside the triangle */
    struct vec3x8 h = vec3x8_cross(d, e2);
    f8 inv = 1 / vec3x8_dot(e1, h);
    struct vec3x8 from = vec3x8_sub(o, A);
    f8 u = f8_clamp(inv * vec3x8_dot(from, h), 0, 1);
    struct vec3x8 q = vec3x8_cross(from, e1);
    f8 v = f8_min(f8_max(inv * vec3x8_dot(d, q), F8(0)), 1 - u);
    s->p = vec3x8_along(vec3x8_along(A, e1, u), e2, v);

    struct vec3x8 n = vec3x8_unit(vec3x8_cross(e1, e2));
    n = vec3x8_select((flags & MESH_FLIP_NORMAL) != 0, vec3x8_neg(n), n);
    s->ng = n;
    s->ns = n;
    f8 extent = f8_max(vec3x8_max_abs(A), f8_max(vec3x8_max_abs(B), vec3x8_max_abs(C)));
    s->spawn = extent * SPAWN_ULPS;
    if (fx & HIT_MAPPED)
        hit_triangle_uv(scene, flags, at, e1, e2, u, v, s);

    if (fx & FX_SMOOTH_NORMALS) {
        i8 smooth = (flags & MESH_NORMALS) != 0;
        if (i8_any(smooth)) {
            i8 shift = i8_select(smooth, GATHER_I(scene->meshes, struct mesh, normal_shift, mesh),
                                 I8(0));
            i8 zero = I8(0);
            struct vec3x8 na = hit_vertex(scene->normals, i8_select(smooth, ia + shift, zero));
            struct vec3x8 nb = hit_vertex(scene->normals, i8_select(smooth, ib + shift, zero));
            struct vec3x8 nc = hit_vertex(scene->normals, i8_select(smooth, ic + shift, zero));
            struct vec3x8 ns = vec3x8_scale(na, 1 - u - v);
            ns = vec3x8_along(vec3x8_along(ns, nb, u), nc, v);
            i8 usable = smooth & (vec3x8_length2(ns) > 0);
            s->ns = vec3x8_select(usable, vec3x8_unit(ns), n);
            /* The vertex normals say which side is outside */
            i8 against = usable & (vec3x8_dot(s->ns, n) < 0);
            s->ng = vec3x8_select(against, vec3x8_neg(n), n);
        }
    }

    s->material = GATHER_I(scene->meshes, struct mesh, material, mesh);
    if (fx & FX_MEDIUM) {
        s->inside = GATHER_I(scene->meshes, struct mesh, inside, mesh);
        s->outside = GATHER_I(scene->meshes, struct mesh, outside, mesh);
    }
    i8 emissive = GATHER_I(scene->meshes, struct mesh, first_emissive, mesh);
    s->light = I8(-1);
    i8 emits = emissive != -1;
    if (i8_any(emits))
        s->light = i8_select(
            emits, i8_gather(scene->triangle_light, i8_select(emits, emissive + prim, I8(0))),
            s->light);
}

/* What textures need of a quadric at the point `local` of its own space: pbrt's parametrisation */
LANE_FN void hit_quadric_uv(const struct quadric *q, i8 lanes, struct vec3x8 local,
                            struct surface8 *s)
{
    const float turn = 6.28318530717958647692f;
    float phi_max = q->phi_max < turn ? q->phi_max : turn;
    f8 r2 = local.x * local.x + local.y * local.y;
    i8 pole = r2 < 1e-10f * q->radius * q->radius; /* no angle, or none that is exact */
    f8 x = f8_select(pole, F8(1e-5f * q->radius), local.x), y = f8_select(pole, F8(0), local.y);
    f8 r = f8_sqrt(x * x + y * y);
    f8 u = quadric_phi(x, y) / phi_max, v;
    struct vec3x8 dpdu = { -y * phi_max, x * phi_max, F8(0) }, dpdv;
    if (q->kind == QUADRIC_SPHERE) {
        f8 ends = f8_acos((f8){ q->z_min / q->radius, q->z_max / q->radius });
        float theta_min = ends[0], range = ends[1] - ends[0];
        v = (f8_acos(local.z / q->radius) - theta_min) / range;
        dpdv = vec3x8_scale((struct vec3x8){ local.z * (x / r), local.z * (y / r), -r }, F8(range));
    } else {
        float range = q->inner_radius - q->radius;
        v = (r - q->radius) / range;
        dpdv = vec3x8_scale((struct vec3x8){ x / r, y / r, F8(0) }, F8(range));
    }
    s->u = f8_select(lanes, u, s->u);
    s->v = f8_select(lanes, v, s->v);
    s->dpdu = vec3x8_select(lanes, quadric_linear(q->to_world, dpdu), s->dpdu);
    s->dpdv = vec3x8_select(lanes, quadric_linear(q->to_world, dpdv), s->dpdv);
    for (int c = 0; c < 4; c++)
        s->color[c] = f8_select(lanes, F8(1), s->color[c]);
}

/* Quadric `prim` of the lanes in `lanes`, hit at o + t d; one at a time, as matrices differ */
LANE_FN void hit_quadric(const struct scene *scene, unsigned fx, i8 lanes, i8 prim, struct vec3x8 o,
                         struct vec3x8 d, f8 t, struct surface8 *s)
{
    for (unsigned todo = i8_bits(lanes); todo != 0;) {
        int32_t first = prim[__builtin_ctz(todo)];
        i8 same = lanes & (prim == first);
        todo &= ~i8_bits(same);
        const struct quadric *q = &scene->quadrics[first];
        struct vec3x8 center = vec3x8_all(q->center[0], q->center[1], q->center[2]);

        /* In object space, put the point back onto the surface */
        struct vec3x8 local = quadric_linear(q->to_object,
                                             vec3x8_add(vec3x8_sub(o, center), vec3x8_scale(d, t)));
        struct vec3x8 normal;
        if (q->kind == QUADRIC_SPHERE) {
            normal = vec3x8_unit(local);
            local = vec3x8_scale(normal, F8(q->radius));
        } else {
            local.z = F8(0);
            normal = vec3x8_all(0, 0, 1);
        }
        struct vec3x8 p = vec3x8_add(quadric_linear(q->to_world, local), center);

        /* Normals go by the inverse transpose */
        const float *m = q->to_object;
        const float transposed[9] = { m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8] };
        struct vec3x8 n = vec3x8_unit(quadric_linear(transposed, normal));
        if (q->flags & QUADRIC_FLIP_NORMAL)
            n = vec3x8_neg(n);
        f8 extent = vec3x8_max_abs(p);
        extent = f8_max(extent, vec3x8_max_abs(vec3x8_sub(p, center)));

        s->p = vec3x8_select(same, p, s->p);
        s->ng = vec3x8_select(same, n, s->ng);
        s->ns = vec3x8_select(same, n, s->ns);
        s->spawn = f8_select(same, extent * SPAWN_ULPS, s->spawn);
        s->material = i8_select(same, I8((int32_t)q->material), s->material);
        s->light = i8_select(same, I8((int32_t)q->light), s->light);
        if (fx & FX_MEDIUM) {
            s->inside = i8_select(same, I8((int32_t)q->inside), s->inside);
            s->outside = i8_select(same, I8((int32_t)q->outside), s->outside);
        }
        if (fx & HIT_MAPPED)
            hit_quadric_uv(q, same, local, s);
    }
}

/* The surface at the hits of the lanes in `hit`; other lanes hold something harmless */
LANE_FN struct surface8 hit_surface(const struct kernel_scene *ks, unsigned fx, i8 hit, i8 geometry,
                                    i8 prim, const struct hit_corners8 *corners, struct vec3x8 o,
                                    struct vec3x8 d, f8 t)
{
    struct surface8 s = { .p = vec3x8_all(0, 0, 0),
                          .ng = vec3x8_all(0, 0, 1),
                          .ns = vec3x8_all(0, 0, 1),
                          .spawn = F8(0),
                          .material = I8(0),
                          .light = I8(-1) };
    if (fx & FX_MEDIUM)
        s.inside = s.outside = I8(0);
    if (fx & HIT_MAPPED) {
        s.u = s.v = F8(0);
        s.dpdu = vec3x8_all(1, 0, 0);
        s.dpdv = vec3x8_all(0, 1, 0);
        for (int c = 0; c < 4; c++)
            s.color[c] = F8(1);
    }
    i8 quadric = I8(0);
    if (fx & FX_QUADRIC)
        quadric = hit & (geometry == ks->quadric_geometry);
    if (fx & FX_MESH) {
        i8 mesh = hit & ~quadric;
        if (i8_any(mesh))
            hit_triangle(ks->scene, fx, corners, o, d, &s);
    }
    if ((fx & FX_QUADRIC) && i8_any(quadric))
        hit_quadric(ks->scene, fx, quadric, prim, o, d, t, &s);
    return s;
}

#endif
