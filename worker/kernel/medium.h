/*
 * Media, eight at a time: flights through them, scattering in them, and what of a light arrives
 * through them. Media are numbered as in scene.h: 1 + index, 0 for vacuum.
 */
#ifndef WORKER_KERNEL_MEDIUM_H
#define WORKER_KERNEL_MEDIUM_H

#include "common/elem.h"
#include "worker/kernel/alpha.h"
#include "worker/kernel/instance.h"
#include "worker/kernel/ray_log.h"

#define MEDIUM_FAR       1e17f     /* how far it is to where nothing is; its square is a float */
#define MEDIUM_CROSSINGS (1 << 16) /* surfaces between media in a row: more is a mistake */

/* ---- the phase function of Henyey and Greenstein */

/*
 * Density per solid angle with which what travels along d goes on along w, both unit. With a = |g|
 * and s the one of d and -d that g prefers, 1 + g^2 - 2 g cos is (1 - a)^2 + a |w - s|^2, which
 * cancels nowhere: not for g near 0, and not in the peaks of g near 1. For g = +-1 scattering goes
 * into one direction: a delta event, and the density is 0 everywhere.
 */
LANE_FN f8 phase_pdf(f8 g, struct vec3x8 d, struct vec3x8 w)
{
    f8 a = f8_abs(g);
    struct vec3x8 s = { f8_mulsign(d.x, g), f8_mulsign(d.y, g), f8_mulsign(d.z, g) };
    f8 q = (1 - a) * (1 - a) + a * vec3x8_length2(vec3x8_sub(w, s));
    q = f8_max(q, F8(0x1p-60f));
    return (1 - a) * (1 + a) * (0.25f * PI_INV_F) / (q * f8_sqrt(q));
}

/*
 * A direction with that density. Inverting the distribution of the cosine c with s, and with
 * D = 1 - a + 2 a u,
 *   1 - c = 2 ((1 - a) / D)^2 (1 - u) (1 + a u)
 *   1 + c = 2 ((1 + a) / D)^2 u (1 - a + a u)
 * are products of sums of positive terms: both are right to a few roundings for every g.
 */
LANE_FN struct vec3x8 phase_sample(f8 g, struct vec3x8 d, f8 u, f8 v)
{
    f8 a = f8_abs(g);
    f8 inv = 1 / f8_max((1 - a) + 2 * a * u, F8(0x1p-40f)); /* 0 for a = 1 and u = 0 alone */
    f8 low = (1 - a) * inv, high = (1 + a) * inv;
    f8 one_minus_c = 2 * (low * low) * ((1 - u) * (1 + a * u));
    f8 one_plus_c = 2 * (high * high) * (u * ((1 - a) + a * u));
    f8 c = f8_select(one_minus_c < 1, 1 - one_minus_c, one_plus_c - 1);
    f8 r = f8_sqrt(one_minus_c * one_plus_c), sine, cosine;
    f8_sincos_turns(v, &sine, &cosine);
    struct vec3x8 s = { f8_mulsign(d.x, g), f8_mulsign(d.y, g), f8_mulsign(d.z, g) };
    struct frame8 frame = frame_around(s);
    /* One such direction follows from the other for thousands of events: keep them unit */
    return vec3x8_unit(frame_to_world(&frame, (struct vec3x8){ r * cosine, r * sine, c }));
}

/* ---- flights */

struct medium8 {
    struct vec3x8 sigma_a, sigma_s, Le;
    f8 g;
};

/* Of vacuum, nothing */
LANE_FN struct medium8 medium_of(const struct scene *scene, i8 medium)
{
    i8 there = medium != 0, index = (medium - 1) & there;
    const struct vec3x8 none = vec3x8_all(0, 0, 0);
    struct vec3x8 sigma_a = GATHER3(scene->media, struct medium, sigma_a, index);
    struct vec3x8 sigma_s = GATHER3(scene->media, struct medium, sigma_s, index);
    struct vec3x8 Le = GATHER3(scene->media, struct medium, Le, index);
    return (struct medium8){ vec3x8_select(there, sigma_a, none),
                             vec3x8_select(there, sigma_s, none), vec3x8_select(there, Le, none),
                             GATHER(scene->media, struct medium, g, index) };
}

/* exp(-sigma distance), per colour */
LANE_FN struct vec3x8 medium_transmittance(struct vec3x8 sigma, f8 distance)
{
    return (struct vec3x8){ f8_exp(-(sigma.x * distance)), f8_exp(-(sigma.y * distance)),
                            f8_exp(-(sigma.z * distance)) };
}

/* The integral of exp(-sigma t) over t up to `distance`, for sigma > 0; 0 for sigma = 0 */
LANE_FN f8 medium_depth(f8 sigma, f8 distance)
{
    f8 x = sigma * distance;
    f8 series = x * (1 - x * (1 / 2.0f) *
                             (1 - x * (1 / 3.0f) * (1 - x * (1 / 4.0f) * (1 - x * (1 / 5.0f)))));
    f8 part = f8_select(x < 0.125f, series, 1 - f8_exp(-x));
    return f8_select(sigma > 0, part / sigma, F8(0));
}

struct flight8 {
    i8 scattered;          /* on the way, after `distance` */
    f8 distance;           /* else all of the way */
    struct vec3x8 beta;    /* the throughput there, with the coefficient of scattering */
    struct vec3x8 emitted; /* the medium's own light, along all of the way */
};

/*
 * Fly up to `far` with throughput beta. A colour is chosen in proportion to beta, and a distance by
 * the extinction of that colour; whatever happens is weighed by how likely it was with all three
 * colours. So the sum of beta never grows, however much the extinctions differ, and where they are
 * the same nothing but the albedo changes beta. A medium that only absorbs is flown through.
 */
LANE_FN struct flight8 medium_fly(const struct medium8 *m, struct vec3x8 beta, f8 far, f8 u_color,
                                  f8 u)
{
    struct flight8 flight;
    struct vec3x8 sigma_t = vec3x8_add(m->sigma_a, m->sigma_s);
    i8 scatters = vec3x8_max(m->sigma_s) > 0;
    f8 xy = beta.x + beta.y, sum = xy + beta.z;
    f8 target = u_color * sum;
    f8 rate = f8_select(target < beta.x, sigma_t.x, f8_select(target < xy, sigma_t.y, sigma_t.z));
    /* Where the rate is 0 this is infinite or not a number: not less than anything */
    f8 t = -f8_log(1 - u) / rate;
    flight.scattered = scatters & (t < far);
    flight.distance = f8_select(flight.scattered, t, far);

    struct vec3x8 T = medium_transmittance(sigma_t, flight.distance);
    struct vec3x8 passed = vec3x8_mul(beta, T);
    f8 likely = f8_select(flight.scattered, vec3x8_dot(passed, sigma_t),
                          f8_select(scatters, passed.x + passed.y + passed.z, sum));
    f8 scale = f8_select(likely > 0, sum / likely, F8(0));
    struct vec3x8 here = vec3x8_select(flight.scattered, vec3x8_mul(passed, m->sigma_s), passed);
    flight.beta = vec3x8_scale(here, scale);

    struct vec3x8 source = vec3x8_mul(vec3x8_mul(m->sigma_a, m->Le), beta);
    flight.emitted = (struct vec3x8){ source.x * medium_depth(sigma_t.x, far),
                                      source.y * medium_depth(sigma_t.y, far),
                                      source.z * medium_depth(sigma_t.z, far) };
    return flight;
}

/* ---- from medium to medium */

/* The medium of a ray that leaves the surface to the side of which w_side = ng . w tells, and that
 * came through `medium` */
LANE_FN i8 medium_beyond(const struct surface8 *s, i8 medium, f8 w_side)
{
    i8 side = i8_select(w_side > 0, s->outside, s->inside);
    return i8_select(s->inside != s->outside, side, medium);
}

/* ---- light */

/* The way from a vertex to a light */
struct medium_ray8 {
    struct vec3x8 o, end;
    f8 lead;   /* how much of it lies before o, which was moved off its surface */
    i8 medium; /* that it starts in */
    i8 beyond; /* lanes whose light is at infinity, and `end` nothing but behind everything */
    f8 time;
};

/*
 * Which lanes of `valid` see the light, and what of it arrives, T: through media, and through the
 * surfaces that only media make, which are looked for one after the other. Everything else that
 * stands between blocks: also glass, as refraction leads elsewhere. Not inlined, as it is long; for
 * all effects, as kernels that have media have them all.
 */
static __attribute__((noinline, unused)) i8 medium_light(const struct kernel_scene *ks,
                                                         struct kernel_thread *thread, i8 valid,
                                                         struct medium_ray8 *way,
                                                         struct path_stats *stats, struct vec3x8 *T)
{
    const unsigned fx = FX_ALL & ~(unsigned)HIT_MAPPED;
    i8 todo = valid;
    *T = vec3x8_select(valid, vec3x8_all(1, 1, 1), vec3x8_all(0, 0, 0));
    for (int crossing = 0; i8_any(todo); crossing++) {
        _Alignas(32) int32_t lanes[LANES];
        struct RTCRayHit8 ray;
        struct vec3x8 to = vec3x8_sub(way->end, way->o);
        i8_store(lanes, todo);
        f8_store(ray.ray.org_x, way->o.x);
        f8_store(ray.ray.org_y, way->o.y);
        f8_store(ray.ray.org_z, way->o.z);
        f8_store(ray.ray.dir_x, to.x);
        f8_store(ray.ray.dir_y, to.y);
        f8_store(ray.ray.dir_z, to.z);
        f8_store(ray.ray.tnear, F8(0));
        f8_store(ray.ray.tfar, F8(1 - SPAWN_ULPS));
        f8_store(ray.ray.time, way->time);
        i8_store(ray.ray.mask, I8(-1));
        i8_store(ray.ray.flags, I8(0));
        i8_store(ray.ray.id, (i8)alpha_ray_id(way->o, to));
        i8_store(ray.hit.geomID, I8(-1));
        i8_store(ray.hit.primID, I8(-1));
        i8_store(ray.hit.instID[0], I8(-1));
        if (thread->log != NULL)
            ray_log_add(thread->log, &ray.ray, i8_bits(todo), true);
        rtc_intersect8(lanes, ks->rtc, &ray);
        stats->rays_shadow += (unsigned)__builtin_popcount(i8_bits(todo));

        i8 geometry = i8_load(ray.hit.geomID), prim = i8_load(ray.hit.primID);
        i8 instance = i8_load(ray.hit.instID[0]), hit = todo & (geometry != -1);
        i8 inside = instance_resolve(ks, hit, instance, &geometry, &prim);
        struct hit_corners8 corners = hit_corners(ks, fx, hit, geometry, prim);
        struct vec3x8 o = way->o, d = to;
        struct pose8 pose;
        if (i8_any(inside)) {
            pose = instance_pose(ks->scene, fx, false, instance & inside, way->time);
            instance_enter(inside, &pose, &o, &d);
        }
        struct surface8 s = hit_surface(ks, fx, hit, geometry, prim, &corners, o, d,
                                        f8_load(ray.ray.tfar));
        if (i8_any(inside))
            instance_leave(inside, fx, &pose, &s);

        /* What stands between blocks; what does not is crossed */
        i8 crossed = hit & (s.material == -1) & I8(crossing < MEDIUM_CROSSINGS ? -1 : 0);
        *T = vec3x8_select(hit & ~crossed, vec3x8_all(0, 0, 0), *T);
        struct vec3x8 flown = vec3x8_select(crossed, vec3x8_sub(s.p, way->o), to);
        f8 distance = f8_sqrt(vec3x8_length2(flown)) + way->lead;
        distance = f8_select(way->beyond & ~hit, F8(MEDIUM_FAR), distance);
        struct medium8 m = medium_of(ks->scene, way->medium);
        struct vec3x8 sigma_t = vec3x8_add(m.sigma_a, m.sigma_s);
        *T = vec3x8_select(todo, vec3x8_mul(*T, medium_transmittance(sigma_t, distance)), *T);

        f8 side = vec3x8_dot(s.ng, to);
        struct vec3x8 behind = vec3x8_along(s.p, s.ng, f8_mulsign(s.spawn, side));
        way->o = vec3x8_select(crossed, behind, way->o);
        way->lead = s.spawn * f8_abs(side) / f8_sqrt(vec3x8_length2(to));
        way->medium = i8_select(crossed, medium_beyond(&s, way->medium, side), way->medium);
        /* A light closer to the surface than rays start from it has been reached */
        i8 ahead = vec3x8_dot(vec3x8_sub(way->end, way->o), to) > 0;
        todo = crossed & ahead & (vec3x8_max(*T) > 0);
    }
    return valid & (vec3x8_max(*T) > 0);
}

#endif
