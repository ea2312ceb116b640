/*
 * Lights, eight at a time: choosing one, sampling a direction towards it, and the density with
 * which that direction would have been chosen.
 *
 * Area lights are sampled over what the receiver sees of them: polygons uniformly in solid angle as
 * a fan of spherical triangles, spheres over their visible cone; disks, and receivers inside a
 * sphere or with one that is there in part, uniformly in area. What a texture makes of their
 * emission changes no density. Skies with an environment are sampled by its radiance, and
 * by what comes through their portal. `pdf` is per solid angle at the receiver, the choice of
 * the light included; lights that no ray finds have `delta` set, and those without area have pdf
 * the probability of the choice. pdf_position (per area) and pdf_direction (per solid angle)
 * are the densities of emission from there, for methods that start at the light.
 */
#ifndef WORKER_KERNEL_LIGHT_H
#define WORKER_KERNEL_LIGHT_H

#include "common/elem.h"
#include "worker/kernel/bsdf.h"
#include "worker/kernel/emission.h"
#include "worker/kernel/environment.h"
#include "worker/kernel/frame.h"
#include "worker/kernel/kernel_scene.h"
#include "worker/kernel/light_tree.h"

struct light_sample8 {
    struct vec3x8 point; /* on the light, moved towards the receiver by its rounding error */
    struct vec3x8 wi;    /* unit, from the receiver to the light */
    struct vec3x8
        radiance; /* area lights: L; delta lights: what arrives, inverse square included */
    f8 pdf;
    f8 pdf_position, pdf_direction;
    f8 distance; /* along wi; large for distant lights */
    i8 delta, valid;
};

/*
 * The power heuristic: the weight of a sample taken with density `own` that another technique would
 * have taken with density `other`. As a ratio, so that no square overflows (NUMERICS H45); own > 0.
 */
LANE_FN f8 mis_weight(f8 own, f8 other)
{
    f8 ratio = other / own;
    return 1 / (1 + ratio * ratio);
}

/* ---- choosing a light */

/*
 * Choose by u, for the lanes in `valid`: in the tree of lights, where there is one, by what the
 * receiver at p may get; else by binary search in the cumulative pick probabilities. n is the unit
 * normal on the side that light is wanted from, or zero where it may come from anywhere.
 */
LANE_FN i8 light_choose(const struct kernel_scene *ks, unsigned fx, i8 valid, struct vec3x8 p,
                        struct vec3x8 n, f8 u, f8 *chosen)
{
    *chosen = F8(1);
    i8 low = I8(0);
    if (!(fx & FX_MANY_LIGHTS))
        return low;
    if ((fx & FX_LIGHT_TREE) && ks->light_tree.node_count > 0) {
        light_tree_choose(&ks->light_tree, i8_bits(valid), &p, &n, &u, &low, chosen);
        return low;
    }
    for (int32_t step = ks->light_steps; step > 0; step >>= 1) {
        i8 next = low + step;
        i8 inside = next < (int32_t)ks->light_count;
        f8 bound = f8_gather(ks->light_cdf, i8_select(inside, next, I8(0)));
        low = i8_select(inside & (u >= bound), next, low);
    }
    *chosen = f8_gather(ks->light_pmf, low);
    return low;
}

/* The probability of that choice */
LANE_FN f8 light_pick(const struct kernel_scene *ks, unsigned fx, i8 valid, struct vec3x8 p,
                      struct vec3x8 n, i8 light)
{
    if (!(fx & FX_MANY_LIGHTS))
        return F8(1);
    if ((fx & FX_LIGHT_TREE) && ks->light_tree.node_count > 0) {
        f8 pick;
        light_tree_pick(&ks->light_tree, i8_bits(valid), &p, &n, &light, &pick);
        return pick;
    }
    return f8_gather(ks->light_pmf, light);
}

/* ---- convex polygons */

/*
 * Below this solid angle sampling is uniform in area: the rounding of the corner directions would
 * show otherwise, and over so small a patch the two densities hardly differ.
 */
#define POLYGON_OMEGA_MIN 1e-5f

/* Fields of the chosen lights; with a single light they are the same in every lane */
#define LIGHT(field)                                                             \
    (fx & FX_MANY_LIGHTS ? GATHER(ks->scene->lights, struct light, field, light) \
                         : F8(ks->scene->lights[0].field))
#define LIGHT_I(field)                                                             \
    (fx & FX_MANY_LIGHTS ? GATHER_I(ks->scene->lights, struct light, field, light) \
                         : I8((int32_t)ks->scene->lights[0].field))
#define LIGHT3(field) ((struct vec3x8){ LIGHT(field[0]), LIGHT(field[1]), LIGHT(field[2]) })

/* Corner `i` of polygons with corners [first, first + count), relative to p; past the end the last
 */
LANE_FN struct vec3x8 light_corner(const struct kernel_scene *ks, unsigned fx, i8 first, i8 count,
                                   int i, struct vec3x8 p)
{
    const float *base = ks->scene->light_corners;
    if (!(fx & FX_MANY_LIGHTS)) {
        int last = (int)ks->scene->lights[0].corner_count - 1;
        const float *corner = base + 3 * (i < last ? i : last);
        return vec3x8_sub(vec3x8_all(corner[0], corner[1], corner[2]), p);
    }
    i8 at = (first + i8_select(count > i, I8(i), count - 1)) * 3;
    return vec3x8_sub(
        (struct vec3x8){ f8_gather(base, at), f8_gather(base + 1, at), f8_gather(base + 2, at) },
        p);
}

/*
 * One spherical triangle of a polygon's fan, seen from the origin: corners A, B, C, their unit
 * directions a, b, c, and solid angle omega = 2 atan2(G0, P) with G0 = det(a, b, c) and
 * P = 1 + ab + bc + ca, after Van Oosterom and Strackee 1983. G0 is taken from the edges, right to
 * the tiniest angles (NUMERICS H38); P from the sum s = a + c, right to the widest, where a and c
 * are almost opposite (a wall beside the floor it lights: H37).
 */
struct fan8 {
    struct vec3x8 A, B, C, a, b, s;
    f8 G0, G2, P, omega; /* G2 = 1 + ab */
    f8 one_plus_ac;
};

/* Fans of one polygon: A and a are the same in both */
LANE_FN struct fan8 fan_select(i8 mask, struct fan8 x, struct fan8 y)
{
    struct fan8 fan = y;
    fan.B = vec3x8_select(mask, x.B, y.B);
    fan.C = vec3x8_select(mask, x.C, y.C);
    fan.b = vec3x8_select(mask, x.b, y.b);
    fan.s = vec3x8_select(mask, x.s, y.s);
    fan.G0 = f8_select(mask, x.G0, y.G0);
    fan.G2 = f8_select(mask, x.G2, y.G2);
    fan.P = f8_select(mask, x.P, y.P);
    fan.omega = f8_select(mask, x.omega, y.omega);
    fan.one_plus_ac = f8_select(mask, x.one_plus_ac, y.one_plus_ac);
    return fan;
}

/*
 * a + c of unit vectors. It is at right angles to a - c; where the two are almost opposite, what
 * the rounding of their lengths adds along a - c is taken away again.
 */
LANE_FN struct vec3x8 fan_sum(struct vec3x8 a, struct vec3x8 c)
{
    struct vec3x8 sum = vec3x8_add(a, c), apart = vec3x8_sub(a, c);
    f8 d2 = vec3x8_length2(apart);
    f8 along = f8_select(d2 > 2, vec3x8_dot(sum, apart) / d2, F8(0));
    return vec3x8_along(sum, apart, -along);
}

/*
 * A direction uniform in the fan triangle's solid angle. Choose the vertex c' on the arc a..c that
 * cuts off the share u of the angle: with c' the mirror image of a about m = (x - y) a + y (a + c),
 * Van Oosterom's formula gives x - y and y in closed form (compare Peters, "BRDF Importance
 * Sampling for Polygonal Lights", 2021). Then choose the point between b and c', uniform in its
 * cosine with b; 1 - s is kept as a product, so that nothing cancels in small triangles.
 */
LANE_FN struct vec3x8 fan_direction(const struct fan8 *fan, f8 u, f8 v)
{
    f8 sine, cosine;
    f8_sincos_turns(fan->omega * u * (0.25f * PI_INV_F), &sine, &cosine);
    f8 x_y = fan->G0 * cosine - fan->P * sine, y = fan->G2 * sine;
    struct vec3x8 m = vec3x8_along(vec3x8_scale(fan->a, x_y), fan->s, y);
    f8 m2 = vec3x8_length2(m);
    f8 twice = 2 * (x_y + y * fan->one_plus_ac) / m2;
    struct vec3x8 c = vec3x8_sub(vec3x8_scale(m, twice), fan->a);
    c = vec3x8_select(m2 > 0, c, fan->a);

    struct vec3x8 chord = vec3x8_sub(c, fan->b);
    f8 one_minus_s2 = vec3x8_length2(chord) * 0.5f;
    f8 one_plus_s2 = vec3x8_length2(vec3x8_add(c, fan->b)) * 0.5f;
    f8 one_plus_s = 2 * (1 - v) + v * one_plus_s2;
    f8 t = f8_sqrt(v * one_plus_s / f8_max(one_plus_s2, F8(1e-20f)));
    /* (s - t s2) b + t c, as b + t (c - b) plus what is left */
    f8 rest = one_minus_s2 * (t - v);
    struct vec3x8 w = vec3x8_along(vec3x8_scale(fan->b, 1 + rest), chord, t);
    return vec3x8_unit(w);
}

/* Where the ray from the origin along w meets the fan triangle: on its plane to rounding, never
 * outside */
LANE_FN struct vec3x8 fan_point(const struct fan8 *fan, struct vec3x8 w)
{
    struct vec3x8 e1 = vec3x8_sub(fan->B, fan->A), e2 = vec3x8_sub(fan->C, fan->A);
    struct vec3x8 h = vec3x8_cross(w, e2);
    f8 inv = -1 / vec3x8_dot(e1, h);
    f8 u = f8_clamp(vec3x8_dot(fan->A, h) * inv, 0, 1);
    struct vec3x8 q = vec3x8_cross(fan->A, e1);
    f8 v = f8_min(f8_max(vec3x8_dot(w, q) * inv, F8(0)), 1 - u);
    return vec3x8_along(vec3x8_along(fan->A, e1, u), e2, v);
}

/*
 * All triangles of the fans of polygons with corners [first, first + count) seen from p. Lanes with
 * fewer corners repeat their last one: triangles without area. Two triangles are enough for most
 * scenes; only FX_WIDE_POLYGON brings loops.
 */
struct polygon8 {
    struct fan8 fans[POLYGON_MAX - 2];
    f8 omega;
    i8 by_angle; /* sampled uniformly in solid angle; elsewhere in area */
};

/*
 * Triangle `i` of the fan into seen->fans: `fan` holds A, a and the edge to the triangle before
 * (B, b, G2), and is left with the edge to the next. ia, ib: 1 / |A|, 1 / |B|
 */
LANE_FN void polygon_fan(const struct kernel_scene *ks, unsigned fx, struct vec3x8 p, i8 first,
                         i8 count, int i, struct fan8 *fan, f8 ia, f8 *ib, struct polygon8 *seen)
{
    fan->C = light_corner(ks, fx, first, count, i + 2, p);
    f8 ic = 1 / f8_sqrt(vec3x8_length2(fan->C));
    struct vec3x8 c = vec3x8_scale(fan->C, ic);
    fan->s = fan_sum(fan->a, c);
    fan->one_plus_ac = vec3x8_length2(fan->s) * 0.5f;
    fan->P = fan->one_plus_ac + vec3x8_dot(fan->b, fan->s);
    struct vec3x8 normal = vec3x8_cross(vec3x8_sub(fan->B, fan->A), vec3x8_sub(fan->C, fan->A));
    fan->G0 = f8_abs(vec3x8_dot(fan->A, normal)) * (ia * *ib * ic);
    f8 omega = 2 * f8_atan2(fan->G0, fan->P);
    fan->omega = f8_select(fan->G0 > 0, omega, F8(0));
    seen->omega = seen->omega + fan->omega;
    seen->fans[i] = *fan;
    fan->B = fan->C;
    fan->b = c;
    *ib = ic;
    fan->G2 = fan->one_plus_ac;
}

LANE_FN void polygon_seen(const struct kernel_scene *ks, unsigned fx, struct vec3x8 p, i8 first,
                          i8 count, struct polygon8 *seen)
{
    struct fan8 fan;
    fan.A = light_corner(ks, fx, first, count, 0, p);
    fan.B = light_corner(ks, fx, first, count, 1, p);
    f8 ia = 1 / f8_sqrt(vec3x8_length2(fan.A)), ib = 1 / f8_sqrt(vec3x8_length2(fan.B));
    fan.a = vec3x8_scale(fan.A, ia);
    fan.b = vec3x8_scale(fan.B, ib);
    fan.G2 = vec3x8_length2(fan_sum(fan.a, fan.b)) * 0.5f;
    seen->omega = F8(0);
    polygon_fan(ks, fx, p, first, count, 0, &fan, ia, &ib, seen);
    polygon_fan(ks, fx, p, first, count, 1, &fan, ia, &ib, seen);
    if (fx & FX_WIDE_POLYGON)
        for (int i = 2; i < ks->polygon_fans; i++)
            polygon_fan(ks, fx, p, first, count, i, &fan, ia, &ib, seen);
    seen->by_angle = seen->omega >= POLYGON_OMEGA_MIN;
}

/* Density per solid angle with which polygon_sample chooses the point `to`, relative to p */
LANE_FN f8 polygon_pdf(const struct polygon8 *seen, i8 lanes, struct vec3x8 to,
                       struct vec3x8 normal, f8 area)
{
    f8 pdf = 1 / seen->omega;
    if (i8_any(lanes & ~seen->by_angle)) {
        f8 d2 = vec3x8_length2(to);
        f8 facing = f8_abs(vec3x8_dot(to, normal));
        f8 by_area = f8_select(facing > 0, d2 * f8_sqrt(d2) / (facing * area), F8(0));
        pdf = f8_select(seen->by_angle, pdf, by_area);
    }
    return pdf;
}

LANE_FN f8 fan_area(const struct fan8 *fan)
{
    struct vec3x8 normal = vec3x8_cross(vec3x8_sub(fan->B, fan->A), vec3x8_sub(fan->C, fan->A));
    return f8_sqrt(vec3x8_length2(normal)) * 0.5f;
}

/* The fan triangle that a point of the unit interval falls into, the triangles side by side */
struct fan_choice8 {
    struct fan8 fan;
    f8 below, width; /* of all triangles before it; its own */
    f8 edge;         /* where the next begins */
};

LANE_FN void fan_choose(struct fan_choice8 *choice, f8 target, const struct fan8 *fan, f8 weight)
{
    i8 later = (target >= choice->edge) & (weight > 0);
    choice->fan = fan_select(later, *fan, choice->fan);
    choice->width = f8_select(later, weight, choice->width);
    choice->below = f8_select(later, choice->edge, choice->below);
    choice->edge = choice->edge + weight;
}

/* A point of the polygon relative to p, for the lanes in `lanes` */
LANE_FN struct vec3x8 polygon_sample(const struct kernel_scene *ks, unsigned fx,
                                     const struct polygon8 *seen, i8 lanes, f8 u, f8 v)
{
    /* Which triangle of the fan: by solid angle, or by area where the angle is too small */
    const int fans = fx & FX_WIDE_POLYGON ? ks->polygon_fans : 2;
    int some_by_area = i8_any(lanes & ~seen->by_angle);
    f8 weight[POLYGON_MAX - 2], total = seen->omega;
    weight[0] = seen->fans[0].omega;
    weight[1] = seen->fans[1].omega;
    if (fx & FX_WIDE_POLYGON)
        for (int i = 2; i < fans; i++)
            weight[i] = seen->fans[i].omega;
    if (some_by_area) {
        f8 areas = F8(0);
        for (int i = 0; i < fans; i++) {
            weight[i] = f8_select(seen->by_angle, weight[i], fan_area(&seen->fans[i]));
            areas = areas + weight[i];
        }
        total = f8_select(seen->by_angle, total, areas);
    }
    f8 target = u * total;
    struct fan_choice8 choice = { seen->fans[0], F8(0), weight[0], weight[0] };
    fan_choose(&choice, target, &seen->fans[1], weight[1]);
    if (fx & FX_WIDE_POLYGON)
        for (int i = 2; i < fans; i++)
            fan_choose(&choice, target, &seen->fans[i], weight[i]);
    struct fan8 chosen = choice.fan;
    f8 share = f8_clamp((target - choice.below) / choice.width, 0, 0x1.fffffep-1f);

    struct vec3x8 point = fan_point(&chosen, fan_direction(&chosen, share, v));
    if (some_by_area) {
        /* Uniform in area: the fold of the unit square onto the triangle */
        f8 r = f8_sqrt(share);
        struct vec3x8 e1 = vec3x8_sub(chosen.B, chosen.A), e2 = vec3x8_sub(chosen.C, chosen.A);
        struct vec3x8 flat = vec3x8_along(vec3x8_along(chosen.A, e1, r * (1 - v)), e2, r * v);
        point = vec3x8_select(seen->by_angle, point, flat);
    }
    return point;
}

/* ---- spheres */

/*
 * What p sees of a sphere: a cone of directions with 1 - cos(theta_max) = s^2 / (1 + sqrt(1 -
 * s^2)), s = radius / distance (NUMERICS H34). `outside` is false where p is on or in the sphere
 * (H35).
 */
struct cone8 {
    struct vec3x8 to; /* from p to the centre */
    f8 distance, one_minus_cos;
    i8 outside;
};

LANE_FN struct cone8 sphere_cone(struct vec3x8 p, struct vec3x8 center, f8 radius)
{
    struct cone8 cone;
    cone.to = vec3x8_sub(center, p);
    f8 d2 = vec3x8_length2(cone.to);
    cone.distance = f8_sqrt(d2);
    cone.outside = cone.distance > radius * (1 + 0x1p-20f);
    f8 s2 = f8_min(radius * radius / d2, F8(1));
    f8 rest = f8_max((cone.distance - radius) * (cone.distance + radius) / d2, F8(0));
    cone.one_minus_cos = s2 / (1 + f8_sqrt(rest));
    return cone;
}

/* A point of the sphere relative to its centre */
LANE_FN struct vec3x8 sphere_sample(const struct cone8 *cone, f8 radius, f8 u, f8 v)
{
    f8 sine, cosine;
    f8_sincos_turns(v, &sine, &cosine);

    /* Uniform in the cone; then the nearer of the two points of the sphere in that direction */
    f8 one_minus_c = u * cone->one_minus_cos;
    f8 c = 1 - one_minus_c;
    f8 s2 = one_minus_c * (1 + c);
    f8 s = f8_sqrt(f8_max(s2, F8(0)));
    f8 d = cone->distance;
    f8 half_chord = f8_sqrt(f8_max(radius * radius - d * d * s2, F8(0)));
    f8 t = d * c - half_chord;
    struct frame8 frame = frame_around(vec3x8_scale(cone->to, 1 / d));
    struct vec3x8 w = frame_to_world(&frame, (struct vec3x8){ s * cosine, s * sine, c });
    struct vec3x8 seen = vec3x8_sub(vec3x8_scale(w, t), cone->to);

    /* From inside: uniform on the sphere */
    f8 z = 1 - 2 * u, r = 2 * f8_sqrt(u * (1 - u));
    struct vec3x8 any = { r * cosine, r * sine, z };
    struct vec3x8 point = vec3x8_select(cone->outside, vec3x8_unit(seen), any);
    return vec3x8_scale(point, radius);
}

/* Through holes one sees the far side, too, which samples of the cone never reach */
LANE_FN i8 sphere_whole(const struct kernel_scene *ks, i8 quadric)
{
    return GATHER_I(ks->scene->quadrics, struct quadric, alpha, quadric) == 0;
}

LANE_FN f8 sphere_pdf(const struct cone8 *cone, f8 radius, f8 cosine, f8 d2)
{
    f8 by_cone = 0.5f * PI_INV_F / cone->one_minus_cos;
    f8 by_area = d2 / (4 * PI_F * radius * radius * f8_abs(cosine));
    by_area = f8_select(cosine != 0, by_area, F8(0));
    return f8_select(cone->outside, by_cone, by_area);
}

/* ---- emission */

/* Lanes whose light emits towards wo from a point with this normal, both pointing outwards */
LANE_FN i8 light_faces(const struct kernel_scene *ks, unsigned fx, i8 light, f8 cosine)
{
    i8 flags = LIGHT_I(flags);
    return (cosine > 0) | (((flags & LIGHT_TWO_SIDED) != 0) & (cosine < 0));
}

/*
 * Density with which light_sample would have chosen the direction from p to the point y of area
 * light `light`, whose normal there is n; the choice of the light included. For valid lanes; side
 * is the receiver's normal as in light_choose.
 */
LANE_FN f8 light_pdf(const struct kernel_scene *ks, unsigned fx, i8 valid, i8 light,
                     struct vec3x8 p, struct vec3x8 side, struct vec3x8 y, struct vec3x8 n)
{
    i8 kind = LIGHT_I(kind);
    f8 pdf = F8(0);
    struct vec3x8 to = vec3x8_sub(y, p);
    f8 d2 = vec3x8_length2(to);
    f8 cosine = f8_abs(vec3x8_dot(to, n)) / f8_sqrt(d2);
    f8 area = LIGHT(area);

    if (fx & FX_POLYGON_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_POLYGON);
        if (i8_any(lanes)) {
            i8 first = LIGHT_I(first_corner);
            i8 count = LIGHT_I(corner_count);
            struct polygon8 seen;
            polygon_seen(ks, fx, p, i8_select(lanes, first, I8(0)), i8_select(lanes, count, I8(3)),
                         &seen);
            pdf = f8_select(lanes, polygon_pdf(&seen, lanes, to, n, area), pdf);
        }
    }
    if (fx & FX_SPHERE_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_SPHERE);
        if (i8_any(lanes)) {
            i8 quadric = i8_select(lanes, LIGHT_I(quadric), I8(0));
            struct vec3x8 center = GATHER3(ks->scene->quadrics, struct quadric, center, quadric);
            f8 radius = GATHER(ks->scene->quadrics, struct quadric, world_radius, quadric);
            struct cone8 cone = sphere_cone(p, center, radius);
            if (fx & FX_TEXTURE)
                cone.outside &= sphere_whole(ks, quadric);
            pdf = f8_select(lanes, sphere_pdf(&cone, radius, cosine, d2), pdf);
        }
    }
    if (fx & FX_DISK_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_DISK);
        f8 by_area = f8_select(cosine > 0, d2 / (cosine * area), F8(0));
        pdf = f8_select(lanes, by_area, pdf);
    }
    return pdf * light_pick(ks, fx, valid, p, side, light);
}

/* The smoothstep of pbrt-v4's spot light, between its two cones */
LANE_FN f8 spot_falloff(const struct kernel_scene *ks, unsigned fx, i8 light, f8 cosine)
{
    f8 start = LIGHT(cos_falloff_start);
    f8 end = LIGHT(cos_falloff_end);
    f8 width = start - end;
    f8 x = f8_clamp((cosine - end) / width, 0, 1);
    f8 smooth = x * x * (3 - 2 * x);
    f8 step = f8_select(cosine >= start, F8(1), F8(0));
    return f8_select(width > 0, smooth, step);
}

/* What a point light with an environment sends along w; `intensity` where it has none */
LANE_FN struct vec3x8 point_intensity(const struct kernel_scene *ks, unsigned fx, i8 valid,
                                      i8 light, struct vec3x8 w, struct vec3x8 intensity)
{
    i8 environment = LIGHT_I(environment) - 1;
    for (uint32_t e = 0; e < ks->scene->environment_count; e++) {
        i8 lanes = valid & (environment == (int32_t)e);
        if (i8_any(lanes)) {
            struct vec3x8 seen = environment_radiance(&ks->environments[e], w);
            intensity = vec3x8_select(lanes, seen, intensity);
        }
    }
    return intensity;
}

/* ---- portals; not inlined, as they are rare and long */

/* What is seen from o in the lanes of `todo` of an environment with a portal, along s->wi, and the
 * density with which light sampling chooses that direction; s->L is what the environment says */
static __attribute__((noinline, unused)) void light_through(const struct environment_table *env,
                                                            unsigned todo, const struct vec3x8 *o,
                                                            struct environment_sample8 *s)
{
    s->pdf = F8(0);
    for (; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        const float from[3] = { o->x[lane], o->y[lane], o->z[lane] };
        const float w[3] = { s->wi.x[lane], s->wi.y[lane], s->wi.z[lane] };
        s->pdf[lane] = portal_pdf(&env->portal, from, w);
    }
    s->L = vec3x8_select(s->pdf > 0, s->L, vec3x8_all(0, 0, 0));
}

/* A direction from p through the portal by (u, v), in the lanes of `todo`; pdf 0 where p is behind
 */
static __attribute__((noinline, unused)) void
light_sample_through(const struct environment_table *env, unsigned todo, const struct vec3x8 *p,
                     const f8 *u, const f8 *v, struct environment_sample8 *s)
{
    s->wi = vec3x8_all(0, 0, 1);
    s->pdf = F8(0);
    for (; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        const float from[3] = { p->x[lane], p->y[lane], p->z[lane] };
        float w[3], pdf;
        if (!portal_sample(&env->portal, from, (*u)[lane], (*v)[lane], w, &pdf))
            continue;
        s->wi.x[lane] = w[0];
        s->wi.y[lane] = w[1];
        s->wi.z[lane] = w[2];
        s->pdf[lane] = pdf;
    }
    s->L = environment_radiance(env, s->wi);
}

/* The sky's part of light_sample, for the lanes whose light is one with an environment */
LANE_FN void sky_sample(const struct kernel_scene *ks, unsigned fx, i8 sky, i8 light,
                        struct vec3x8 p, f8 chosen, f8 u, f8 v, struct light_sample8 *out)
{
    i8 environment = LIGHT_I(environment) - 1;
    f8 far = F8(ks->far_distance);
    for (uint32_t e = 0; e < ks->scene->environment_count; e++) {
        i8 lanes = sky & (environment == (int32_t)e);
        if (!i8_any(lanes))
            continue;
        const struct environment_table *env = &ks->environments[e];
        struct environment_sample8 s;
        if (env->has_portal) {
            /* Copies: what has its address taken is in memory for good */
            struct vec3x8 from = p;
            f8 su = u, sv = v;
            struct environment_sample8 through;
            light_sample_through(env, i8_bits(lanes), &from, &su, &sv, &through);
            s = through;
        } else {
            s = environment_sample(env, u, v);
        }
        out->wi = vec3x8_select(lanes, s.wi, out->wi);
        out->point = vec3x8_select(lanes, vec3x8_along(p, s.wi, far), out->point);
        out->distance = f8_select(lanes, far, out->distance);
        out->radiance = vec3x8_select(lanes, s.L, out->radiance);
        out->pdf = f8_select(lanes, s.pdf, out->pdf);
        f8 disk = chosen * PI_INV_F / (far * far);
        out->pdf_position = f8_select(lanes, disk, out->pdf_position);
        out->pdf_direction = f8_select(lanes, s.pdf, out->pdf_direction);
        out->valid |= lanes;
    }
}

/* What the lights of the lanes in `todo` send from their points `to` away from p, where textures
 * have a say; their radiance elsewhere */
static __attribute__((noinline, unused)) void
light_emission(const struct kernel_scene *ks, unsigned todo, const i8 *light,
               const struct vec3x8 *p, const struct vec3x8 *to, struct vec3x8 *radiance)
{
    for (; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        const float from[3] = { p->x[lane], p->y[lane], p->z[lane] };
        const float way[3] = { to->x[lane], to->y[lane], to->z[lane] };
        float rgb[3] = { radiance->x[lane], radiance->y[lane], radiance->z[lane] };
        emission_sampled(ks, (uint32_t)(*light)[lane], from, way, rgb);
        radiance->x[lane] = rgb[0];
        radiance->y[lane] = rgb[1];
        radiance->z[lane] = rgb[2];
    }
}

/*
 * Choose a light by `pick` and a point on it by (u, v), as seen from p; side as in light_choose.
 * Lanes that get no light (the light faces away, has no extent seen from here) come back with
 * valid = 0.
 */
LANE_FN struct light_sample8 light_sample(const struct kernel_scene *ks, unsigned fx, i8 valid,
                                          struct vec3x8 p, struct vec3x8 side, f8 pick, f8 u, f8 v)
{
    struct light_sample8 out;
    f8 chosen;
    i8 light = light_choose(ks, fx, valid, p, side, pick, &chosen);
    i8 kind = LIGHT_I(kind);
    f8 area = LIGHT(area);
    out.radiance = LIGHT3(radiance);
    out.delta = I8(0);
    out.valid = I8(0);
    out.pdf = F8(0);
    struct vec3x8 to = vec3x8_all(0, 0, 1), n = vec3x8_all(0, 0, 1);

    if (fx & FX_POLYGON_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_POLYGON);
        if (i8_any(lanes)) {
            i8 first = LIGHT_I(first_corner);
            i8 count = LIGHT_I(corner_count);
            struct polygon8 seen;
            polygon_seen(ks, fx, p, i8_select(lanes, first, I8(0)), i8_select(lanes, count, I8(3)),
                         &seen);
            struct vec3x8 point = polygon_sample(ks, fx, &seen, lanes, u, v);
            struct vec3x8 normal = LIGHT3(normal);
            f8 pdf = polygon_pdf(&seen, lanes, point, normal, area);
            to = vec3x8_select(lanes, point, to);
            n = vec3x8_select(lanes, normal, n);
            out.pdf = f8_select(lanes, pdf, out.pdf);
            out.valid |= lanes & (seen.omega > 0);
        }
    }
    if (fx & FX_SPHERE_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_SPHERE);
        if (i8_any(lanes)) {
            i8 quadric = i8_select(lanes, LIGHT_I(quadric), I8(0));
            const struct quadric *quadrics = ks->scene->quadrics;
            struct vec3x8 center = GATHER3(quadrics, struct quadric, center, quadric);
            f8 radius = GATHER(quadrics, struct quadric, world_radius, quadric);
            i8 flags = GATHER_I(quadrics, struct quadric, flags, quadric);
            struct cone8 cone = sphere_cone(p, center, radius);
            if (fx & FX_TEXTURE)
                cone.outside &= sphere_whole(ks, quadric);
            struct vec3x8 on = sphere_sample(&cone, radius, u, v);
            struct vec3x8 point = vec3x8_add(cone.to, on);
            struct vec3x8 normal = vec3x8_scale(on, 1 / radius);
            i8 flip = (flags & QUADRIC_FLIP_NORMAL) != 0;
            normal = vec3x8_select(flip, vec3x8_neg(normal), normal);
            f8 d2 = vec3x8_length2(point);
            f8 cosine = vec3x8_dot(point, normal) / f8_sqrt(d2);
            to = vec3x8_select(lanes, point, to);
            n = vec3x8_select(lanes, normal, n);
            out.pdf = f8_select(lanes, sphere_pdf(&cone, radius, cosine, d2), out.pdf);
            out.valid |= lanes;
        }
    }
    if (fx & FX_DISK_LIGHT) {
        i8 lanes = valid & (kind == LIGHT_DISK);
        if (i8_any(lanes)) {
            i8 quadric = i8_select(lanes, LIGHT_I(quadric), I8(0));
            const struct quadric *quadrics = ks->scene->quadrics;
            struct vec3x8 center = GATHER3(quadrics, struct quadric, center, quadric);
            f8 outer = GATHER(quadrics, struct quadric, radius, quadric);
            f8 inner = GATHER(quadrics, struct quadric, inner_radius, quadric);
            f8 r = f8_sqrt(inner * inner + u * ((outer - inner) * (outer + inner))), sine, cosine;
            f8_sincos_turns(v, &sine, &cosine);
            struct vec3x8 column_x = { GATHER(quadrics, struct quadric, to_world[0], quadric),
                                       GATHER(quadrics, struct quadric, to_world[3], quadric),
                                       GATHER(quadrics, struct quadric, to_world[6], quadric) };
            struct vec3x8 column_y = { GATHER(quadrics, struct quadric, to_world[1], quadric),
                                       GATHER(quadrics, struct quadric, to_world[4], quadric),
                                       GATHER(quadrics, struct quadric, to_world[7], quadric) };
            struct vec3x8 point = vec3x8_along(vec3x8_scale(column_x, r * cosine), column_y,
                                               r * sine);
            point = vec3x8_add(point, vec3x8_sub(center, p));
            struct vec3x8 normal = LIGHT3(normal);
            f8 d2 = vec3x8_length2(point);
            f8 facing = f8_abs(vec3x8_dot(point, normal)) / f8_sqrt(d2);
            to = vec3x8_select(lanes, point, to);
            n = vec3x8_select(lanes, normal, n);
            out.pdf = f8_select(lanes, d2 / (facing * area), out.pdf);
            out.valid |= lanes & (facing > 0) & (d2 > 0);
        }
    }

    /*
     * Area lights: the side that emits, and a point in front of it by more than its rounding error,
     * which the light's size decides even where the receiver is close
     */
    f8 d2 = vec3x8_length2(to);
    f8 d = f8_sqrt(d2);
    out.wi = vec3x8_scale(to, 1 / d);
    f8 facing = -vec3x8_dot(out.wi, n);
    out.valid &= (d2 > 0) & light_faces(ks, fx, light, facing);
    out.distance = d;
    struct vec3x8 y = vec3x8_add(p, to);
    f8 extent = fx & FX_MANY_LIGHTS ? f8_gather(ks->light_extent, light) : F8(ks->light_extent[0]);
    f8 reach = f8_max(f8_max(f8_abs(y.x), f8_max(f8_abs(y.y), f8_abs(y.z))), f8_max(d, extent));
    out.point = vec3x8_along(y, n, f8_mulsign(reach * SPAWN_ULPS, facing));
    out.pdf_position = chosen / area;
    out.pdf_direction = f8_abs(facing) * PI_INV_F;

    if (fx & FX_DELTA_LIGHT) {
        i8 point = valid & ((kind == LIGHT_POINT) | (kind == LIGHT_SPOT));
        i8 distant = valid & (kind == LIGHT_DISTANT);
        if (i8_any(point | distant)) {
            struct vec3x8 direction = LIGHT3(direction);
            struct vec3x8 from = LIGHT3(position);
            struct vec3x8 away = vec3x8_neg(direction);
            struct vec3x8 near = vec3x8_sub(from, p);
            f8 l2 = vec3x8_length2(near), l = f8_sqrt(l2);
            struct vec3x8 wi = vec3x8_select(distant, away, vec3x8_scale(near, 1 / l));
            f8 falloff = f8_select(distant, F8(1), 1 / l2);
            i8 spot = kind == LIGHT_SPOT;
            f8 shape = spot_falloff(ks, fx, light, -vec3x8_dot(wi, direction));
            falloff = f8_select(spot, falloff * shape, falloff);
            i8 delta = point | distant;
            if (fx & FX_ENVIRONMENT)
                out.radiance = point_intensity(ks, fx, point, light, vec3x8_neg(wi), out.radiance);
            f8 far = F8(ks->far_distance);
            out.wi = vec3x8_select(delta, wi, out.wi);
            out.distance = f8_select(delta, f8_select(distant, far, l), out.distance);
            out.point = vec3x8_select(
                delta, vec3x8_select(distant, vec3x8_along(p, away, far), from), out.point);
            out.radiance = vec3x8_select(delta, vec3x8_scale(out.radiance, falloff), out.radiance);
            out.pdf = f8_select(delta, F8(1), out.pdf);
            out.pdf_position = f8_select(delta, chosen, out.pdf_position);
            out.pdf_direction = f8_select(delta, F8(0.25f * PI_INV_F), out.pdf_direction);
            out.delta = delta;
            out.valid |= delta & (distant | (l2 > 0)) & (falloff > 0);
        }
    }

    if (fx & FX_ENVIRONMENT) {
        i8 sky = valid & (kind == LIGHT_SKY);
        if (i8_any(sky))
            sky_sample(ks, fx, sky, light, p, chosen, u, v, &out);
    }

    out.pdf = out.pdf * chosen;
    out.valid &= (out.pdf > 0) & (out.pdf < __builtin_inff());
    if (fx & FX_DELTA_LIGHT)
        out.delta |= (LIGHT_I(flags) & LIGHT_UNSEEN) != 0;
    if ((fx & FX_TEXTURE) && ks->emission != NULL) {
        i8 lanes = out.valid & (kind <= LIGHT_DISK);
        if (i8_any(lanes)) {
            i8 of = light;
            struct vec3x8 from = p, way = to, radiance = out.radiance;
            light_emission(ks, i8_bits(lanes), &of, &from, &way, &radiance);
            out.radiance = radiance;
        }
    }
    return out;
}

#endif
