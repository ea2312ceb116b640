/*
 * The path tracer: one always-inline body, instantiated once per kernel variant. This file is
 * compiled twice (with AVX2 and without) under the names path_leaf_VARIANT_ISA; see kernel.c.
 * Symbols are those of NOTATION.md.
 */
#include "worker/kernel/path.h"

#include "common/sampler.h"
#include "worker/kernel/alpha.h"
#include "worker/kernel/camera.h"
#include "worker/kernel/emission.h"
#include "worker/kernel/first_hit.h"
#include "worker/kernel/frame.h"
#include "worker/kernel/hit.h"
#include "worker/kernel/instance.h"
#include "worker/kernel/isa.h"
#include "worker/kernel/light.h"
#include "worker/kernel/medium.h"
#include "worker/kernel/path_variants.def"

#include <assert.h>

/* Without AVX2 there is the last variant only: the fallback need not be fast, but takes long to
 * compile */
#if defined(KERNEL_EVERYTHING_ONLY)
#define KERNEL_VARIANTS(X) X(everything, FX_ALL)
#else
#define KERNEL_VARIANTS(X) PATH_VARIANTS(X)
#endif

/*
 * Throughput at which roulette begins. Measured at equal time: on the Cornell box 1/4 is twice as
 * efficient as 1, and below it the longer paths cost more than they bring; with many lights and
 * glass 1/2 is a little better than 1/4.
 */
#define ROULETTE_REFERENCE 0.25f

/* Everything a path carries from one vertex to the next, a path per lane */
struct path8 {
    struct vec3x8 o, d;    /* the next ray */
    struct vec3x8 beta, L; /* throughput so far, radiance gathered so far */
    struct vec3x8 from;    /* the vertex the ray left, for the light's density */
    struct vec3x8 side;    /* its lit_side; where lights may be chosen in a tree */
    f8 pdf;       /* density of d at that vertex; 0 after a delta event and at the camera */
    f8 eta_scale; /* product of eta^2 so far: beta * eta_scale is what reaches the eye */
    f8 time;      /* 0 to 1, where scene.h's motions are */
    struct sample_key8 key;
    i8 events; /* scattering events so far */
    i8 medium; /* that the next ray starts in, 1 + index or 0; with FX_MEDIUM */
    f8 lead;   /* the part of the ray before o, which was moved off its surface; with FX_MEDIUM */
    i8 passed; /* surfaces between media on the way, which take a vertex's numbers, too */
    i8 state;  /* of the path automaton */
    i8 slot;   /* sample of the leaf */
};

/* What Embree finds along rays: the nearest surface, and how far */
struct found8 {
    f8 t;
    i8 geometry, prim, instance; /* -1: none */
};

/* Rays that are not rays never reach Embree */
LANE_FN i8 sound_rays(struct vec3x8 o, struct vec3x8 d)
{
    f8 d2 = vec3x8_length2(d);
    return (d2 > 0.5f) & (d2 < 2) & (vec3x8_max_abs(o) < 1e30f);
}

/* Find the nearest surface of the rays of `lanes`; what else is in `found` stays. Together: they go
 * nearly one way. */
LANE_FN void find_nearest(const struct kernel_scene *ks, struct kernel_thread *thread, unsigned fx,
                          i8 lanes, struct vec3x8 o, struct vec3x8 d, f8 time, bool together,
                          struct found8 *found)
{
    _Alignas(32) int32_t valid[LANES];
    struct RTCRayHit8 ray;
    i8_store(valid, lanes);
    f8_store(ray.ray.org_x, o.x);
    f8_store(ray.ray.org_y, o.y);
    f8_store(ray.ray.org_z, o.z);
    f8_store(ray.ray.dir_x, d.x);
    f8_store(ray.ray.dir_y, d.y);
    f8_store(ray.ray.dir_z, d.z);
    f8_store(ray.ray.tnear, F8(0));
    f8_store(ray.ray.tfar, f8_select(lanes, F8(__builtin_inff()), found->t));
    f8_store(ray.ray.time, time);
    i8_store(ray.ray.mask, I8(-1));
    i8_store(ray.ray.flags, I8(0));
    i8_store(ray.hit.geomID, found->geometry | lanes);
    i8_store(ray.hit.primID, found->prim | lanes);
    i8_store(ray.hit.instID[0], found->instance | lanes);
    if ((fx & FX_TEXTURE) && ks->has_alpha)
        i8_store(ray.ray.id, (i8)alpha_ray_id(o, d));
    if (thread->log != NULL)
        ray_log_add(thread->log, &ray.ray, i8_bits(lanes), false);
    if (together)
        rtc_intersect_together8(valid, ks->rtc, &ray);
    else
        rtc_intersect8(valid, ks->rtc, &ray);
    found->t = f8_load(ray.ray.tfar);
    found->geometry = i8_load(ray.hit.geomID);
    found->prim = i8_load(ray.hit.primID);
    found->instance = i8_load(ray.hit.instID[0]);
}

/* Camera rays made and traced eight at a time, and handed to lanes as they fall free */
struct camera_batch {
    struct vec3x8 o, d;
    f8 time;
    struct found8 found;
    struct sample_key8 key;
    int used, count;
    int32_t first_slot;
};

LANE_FN void camera_batch_fill(struct camera_batch *batch, const struct kernel_scene *ks,
                               struct kernel_thread *thread, unsigned fx,
                               const struct tile_rect *tile, uint32_t replicate,
                               uint64_t first_sample, int32_t first_slot, int32_t slot_end)
{
    const struct scene_settings *settings = &ks->scene->settings;
    uint32_t B = ks->spec.leaf_samples;
    unsigned shift = (unsigned)__builtin_ctz(B);
    f8 px, py;
    for (int lane = 0; lane < LANES; lane++) {
        uint32_t slot = (uint32_t)(first_slot + lane), pixel = slot >> shift;
        uint32_t x = tile->x + pixel % tile->width, y = tile->y + pixel / tile->width;
        px[lane] = (float)x;
        py[lane] = (float)y;
        sampler_key_lane(&batch->key, lane, ks->spec.seed, replicate,
                         (uint64_t)y * settings->width + x, first_sample + (slot & (B - 1)));
    }

    f8 u, v, lobe = F8(0), lu = F8(0), lv = F8(0);
    int any = (fx & FX_SAMPLER_ANY) != 0;
    i8 negative = I8(0);
    sampler_2d(&ks->sampler, any, &batch->key,
               sample_dimension(SAMPLE_FROM_CAMERA, U8(0), SAMPLE_PIXEL), &u, &v);
    if ((fx & FX_FILTER_ANY) && ks->filter.has_negative) {
        lobe = sampler_1d(&ks->sampler, any, &batch->key,
                          sample_dimension(SAMPLE_FROM_CAMERA, U8(0), SAMPLE_FILTER));
        i8 index = (first_slot + i8_lanes()) & (int32_t)(B - 1);
        negative = ((index + (int32_t)(first_sample & 3)) & 3) == 3;
    }
    if ((fx & FX_LENS) && settings->camera.lens_radius > 0)
        sampler_2d(&ks->sampler, any, &batch->key,
                   sample_dimension(SAMPLE_FROM_CAMERA, U8(0), SAMPLE_LENS), &lu, &lv);
    batch->time = F8(0);
    if (fx & FX_MOTION) {
        f8 t = sampler_1d(&ks->sampler, any, &batch->key,
                          sample_dimension(SAMPLE_FROM_CAMERA, U8(0), SAMPLE_TIME));
        t = (1 - t) * settings->shutter[0] + t * settings->shutter[1];
        batch->time = f8_clamp(t, 0, 1);
    }
    struct vec2x8 offset = filter_offset(&ks->filter, fx, negative, lobe, u, v);
    struct ray8 ray = camera_ray(ks->scene, fx, px + 0.5f + offset.x, py + 0.5f + offset.y, lu, lv,
                                 batch->time);
    batch->o = ray.o;
    batch->d = ray.d;
    batch->used = 0;
    batch->first_slot = first_slot;
    int32_t left = slot_end - first_slot;
    batch->count = left < LANES ? left : LANES;
    i8 lanes = (i8_lanes() < batch->count) & sound_rays(batch->o, batch->d);
    find_nearest(ks, thread, fx, lanes, batch->o, batch->d, batch->time, true, &batch->found);
}

/* Start waiting camera rays, and what they found, in the lanes of `idle`; returns the lanes that
 * got one */
LANE_FN unsigned camera_batch_take(struct camera_batch *batch, const struct kernel_scene *ks,
                                   unsigned fx, unsigned idle, struct path8 *path,
                                   struct found8 *found)
{
    int32_t source[LANES] = { 0 };
    unsigned taken = 0;
    for (unsigned todo = idle; todo != 0 && batch->used < batch->count; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        source[lane] = batch->used++;
        taken |= 1u << lane;
    }
    i8 from = i8_load(source), fresh = i8_from_bits(taken);
    struct sample_key8 key = { u8_permute(batch->key.lo, from), u8_permute(batch->key.hi, from),
                               u8_permute(batch->key.reversed, from) };
    path->key = sampler_key_select(fresh, key, path->key);
    path->o = vec3x8_select(fresh, vec3x8_permute(batch->o, from), path->o);
    path->d = vec3x8_select(fresh, vec3x8_permute(batch->d, from), path->d);
    found->t = f8_select(fresh, f8_permute(batch->found.t, from), found->t);
    found->geometry = i8_select(fresh, i8_permute(batch->found.geometry, from), found->geometry);
    found->prim = i8_select(fresh, i8_permute(batch->found.prim, from), found->prim);
    if (fx & FX_INSTANCE)
        found->instance = i8_select(fresh, i8_permute(batch->found.instance, from),
                                    found->instance);
    path->beta = vec3x8_select(fresh, vec3x8_all(1, 1, 1), path->beta);
    path->L = vec3x8_select(fresh, vec3x8_all(0, 0, 0), path->L);
    path->pdf = f8_select(fresh, F8(0), path->pdf);
    path->eta_scale = f8_select(fresh, F8(1), path->eta_scale);
    if (fx & FX_MOTION)
        path->time = f8_select(fresh, f8_permute(batch->time, from), path->time);
    path->events = path->events & ~fresh;
    path->slot = i8_select(fresh, batch->first_slot + from, path->slot);
    if (fx & FX_MEDIUM) {
        uint32_t medium = ks->scene->settings.camera_medium;
        path->medium = i8_select(fresh, I8((int32_t)medium), path->medium);
        path->passed = path->passed & ~fresh;
        path->lead = f8_select(fresh, F8(0), path->lead);
    }
    if (fx & FX_PATHS)
        path->state = i8_select(fresh, I8((int32_t)ks->dfa.start), path->state);
    return taken;
}

/* Does the job do without? Only the variant for everything can, and only it has code for that. */
LANE_FN int without(const struct kernel_scene *ks, unsigned fx, uint32_t technique)
{
    return fx == (unsigned)FX_ALL && (ks->spec.techniques_off & technique) != 0;
}

/* The weight of light that scattering found, with density `pdf`; light sampling would have chosen
 * that direction with density `pdf_light` (power heuristic) */
LANE_FN f8 found_weight(const struct kernel_scene *ks, unsigned fx, f8 pdf, f8 pdf_light)
{
    if (without(ks, fx, TECHNIQUE_LIGHT_SAMPLING))
        return F8(1);
    if (without(ks, fx, TECHNIQUE_MIS))
        return f8_select(pdf_light > 0, F8(0), F8(1));
    return mis_weight(pdf, pdf_light);
}

LANE_FN struct vec3x8 vec3x8_add_where(i8 mask, struct vec3x8 a, struct vec3x8 b)
{
    return vec3x8_select(mask, vec3x8_add(a, b), a);
}

LANE_FN void store_finished(const struct path8 *path, unsigned finished,
                            struct kernel_thread *thread)
{
    float r[LANES], g[LANES], b[LANES];
    int32_t slot[LANES];
    f8_store(r, path->L.x);
    f8_store(g, path->L.y);
    f8_store(b, path->L.z);
    i8_store(slot, path->slot);
    for (unsigned todo = finished; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        thread->radiance[slot[lane]] = r[lane];
        thread->radiance[thread->slot_count + (uint32_t)slot[lane]] = g[lane];
        thread->radiance[2 * thread->slot_count + (uint32_t)slot[lane]] = b[lane];
    }
}

/* The surface as textures see it, in the lanes of `lanes` */
LANE_FN void texture_points(const struct kernel_scene *ks, struct kernel_thread *thread, i8 lanes,
                            const struct surface8 *s)
{
    enum { FLOATS = sizeof(struct texture_point) / sizeof(float) };
    const float *eye = ks->scene->settings.camera.position;
    struct vec3x8 away = vec3x8_sub(s->p, vec3x8_all(eye[0], eye[1], eye[2]));
    f8 width = ks->footprint_size + ks->footprint_angle * f8_sqrt(vec3x8_length2(away));
    const f8 rows[FLOATS] = { s->u,        s->v,        s->p.x,      s->p.y,     s->p.z,
                              s->ng.x,     s->ng.y,     s->ng.z,     s->dpdu.x,  s->dpdu.y,
                              s->dpdu.z,   s->dpdv.x,   s->dpdv.y,   s->dpdv.z,  width,
                              s->color[0], s->color[1], s->color[2], s->color[3] };
    float values[FLOATS][LANES];
    memcpy(values, rows, sizeof(values));
    for (unsigned todo = i8_bits(lanes); todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        float point[FLOATS];
        for (int i = 0; i < FLOATS; i++)
            point[i] = values[i][lane];
        memcpy(&thread->points[lane], point, sizeof(point));
    }
}

/* What the lights of the lanes in `lanes` emit at the surface; Le where it is the same everywhere
 */
LANE_FN struct vec3x8 texture_emission(const struct kernel_scene *ks, struct kernel_thread *thread,
                                       i8 lanes, i8 light, const struct surface8 *s,
                                       struct vec3x8 Le)
{
    lanes &= GATHER_I(ks->scene->lights, struct light, texture, light) != 0;
    if (!i8_any(lanes))
        return Le;
    texture_points(ks, thread, lanes, s);
    for (unsigned todo = i8_bits(lanes); todo != 0; todo &= todo - 1) {
        int lane = __builtin_ctz(todo);
        float rgb[3];
        thread->points[lane].width = 0;
        emission_seen(ks, (uint32_t)light[lane], &thread->points[lane], rgb);
        Le.x[lane] = rgb[0];
        Le.y[lane] = rgb[1];
        Le.z[lane] = rgb[2];
    }
    return Le;
}

/* `amount` of the mixes `id` of the lanes in `lanes`, where it has a texture */
LANE_FN f8 texture_amounts(const struct kernel_scene *ks, const struct kernel_thread *thread,
                           i8 lanes, i8 id, f8 amount)
{
    const struct scene *scene = ks->scene;
    lanes &= GATHER_I(scene->materials, struct material, texture[SLOT_AMOUNT], id) != 0;
    for (unsigned todo = i8_bits(lanes); todo != 0; todo &= todo - 1) {
        int lane = __builtin_ctz(todo);
        amount[lane] = textured_amount(ks->textures, &thread->points[lane],
                                       &scene->materials[id[lane]]);
    }
    return amount;
}

/* The materials of all lanes into thread->materials, with what textures make of those in `lanes`;
 * and the shading normals there */
LANE_FN void texture_materials(const struct kernel_scene *ks, struct kernel_thread *thread,
                               unsigned fx, i8 lanes, i8 id, struct vec3x8 wo, struct surface8 *s)
{
    for (int lane = 0; lane < LANES; lane++) {
        const struct material *material = &ks->scene->materials[id[lane]];
        const struct texture_point *point = &thread->points[lane];
        thread->materials[lane] = *material;
        if (!lanes[lane])
            continue;
        int32_t parts = ks->textured[id[lane]];
        if (parts & TEXTURED_VALUES)
            textured_material(ks->textures, point, &thread->materials[lane]);
        if ((fx & FX_BUMP) && (parts & TEXTURED_NORMALS)) {
            const float to[3] = { wo.x[lane], wo.y[lane], wo.z[lane] };
            float ns[3] = { s->ns.x[lane], s->ns.y[lane], s->ns.z[lane] };
            textured_normal(ks->textures, point, material, to, ns);
            s->ns.x[lane] = ns[0];
            s->ns.y[lane] = ns[1];
            s->ns.z[lane] = ns[2];
        }
    }
}

/* The first hits of eight camera paths, for the layers of common/aov.h */
struct first_hit8 {
    i8 slot, object, material;
    struct vec3x8 p, ns, ng, albedo;
    f8 time;
};

/* Not inline: most jobs have no layers, and then this must not cost the loop a register */
static __attribute__((noinline, cold)) void
store_first_hits(const struct first_hit8 *at, unsigned lanes, struct kernel_thread *thread)
{
    for (; lanes != 0; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        thread->first_hits[at->slot[lane]] = (struct first_hit){
            .seen = 1,
            .object = (uint32_t)at->object[lane],
            .material = (uint32_t)at->material[lane],
            .time = at->time[lane],
            .p = { at->p.x[lane], at->p.y[lane], at->p.z[lane] },
            .ns = { at->ns.x[lane], at->ns.y[lane], at->ns.z[lane] },
            .ng = { at->ng.x[lane], at->ng.y[lane], at->ng.z[lane] },
            .albedo = { at->albedo.x[lane], at->albedo.y[lane], at->albedo.z[lane] },
        };
    }
}

/* Where a path first scatters in a medium there is neither an object nor a normal, and the albedo
 * is what is left of the light */
static __attribute__((noinline, cold)) void first_scatter(const struct scene *scene, i8 volume,
                                                          i8 medium, struct first_hit8 *at)
{
    const struct vec3x8 none = vec3x8_all(0, 0, 0);
    struct medium8 m = medium_of(scene, medium);
    struct vec3x8 sigma_t = vec3x8_add(m.sigma_a, m.sigma_s);
    struct vec3x8 albedo = { f8_select(sigma_t.x > 0, m.sigma_s.x / sigma_t.x, F8(0)),
                             f8_select(sigma_t.y > 0, m.sigma_s.y / sigma_t.y, F8(0)),
                             f8_select(sigma_t.z > 0, m.sigma_s.z / sigma_t.z, F8(0)) };
    at->object = at->object | volume;
    at->material = at->material | volume;
    at->ns = vec3x8_select(volume, none, at->ns);
    at->ng = vec3x8_select(volume, none, at->ng);
    at->albedo = vec3x8_select(volume, albedo, at->albedo);
}

/* Which vertices see the light at the end of the segment from o along `to`, up to `to` itself */
LANE_FN i8 unoccluded(const struct kernel_scene *ks, struct kernel_thread *thread, unsigned fx,
                      i8 valid, struct vec3x8 o, struct vec3x8 to, f8 time)
{
    _Alignas(32) int32_t lanes[LANES];
    struct RTCRay8 ray;
    i8_store(lanes, valid);
    f8_store(ray.org_x, o.x);
    f8_store(ray.org_y, o.y);
    f8_store(ray.org_z, o.z);
    f8_store(ray.dir_x, to.x);
    f8_store(ray.dir_y, to.y);
    f8_store(ray.dir_z, to.z);
    f8_store(ray.tnear, F8(0));
    f8_store(ray.tfar, F8(1 - SPAWN_ULPS));
    f8_store(ray.time, time);
    i8_store(ray.mask, I8(-1));
    i8_store(ray.flags, I8(0));
    if ((fx & FX_TEXTURE) && ks->has_alpha)
        i8_store(ray.id, (i8)alpha_ray_id(o, to));
    if (thread->log != NULL)
        ray_log_add(thread->log, &ray, i8_bits(valid), true);
    rtc_occluded8(lanes, ks->rtc, &ray);
    return valid & (f8_load(ray.tfar) >= 0);
}

/* The shading normal on the side that a surface reflects light from; zero where it also transmits
 */
LANE_FN struct vec3x8 lit_side(const struct bsdf8 *bsdf, struct vec3x8 ns, f8 wo_z)
{
    i8 opaque = (bsdf->kind == MATERIAL_DIFFUSE) | (bsdf->kind == MATERIAL_MIXTURE) |
                (bsdf->kind == MATERIAL_CONDUCTOR) | (bsdf->kind == MATERIAL_COAT);
    struct vec3x8 side = { f8_mulsign(ns.x, wo_z), f8_mulsign(ns.y, wo_z), f8_mulsign(ns.z, wo_z) };
    return vec3x8_select(opaque, side, vec3x8_all(0, 0, 0));
}

/* The next dimension of the vertex that a path is at: event 0 is the camera */
LANE_FN u8 vertex_dimension(const struct path8 *path, unsigned purpose)
{
    return sample_dimension(SAMPLE_FROM_CAMERA, (u8)(path->events + path->passed) + 1, purpose);
}

/* Radiance of the paths after those of `sky` found the environments, each weighted against light
 * sampling from the vertex before */
LANE_FN struct vec3x8 sky_seen(const struct kernel_scene *ks, unsigned fx, i8 sky,
                               const struct path8 *path)
{
    struct vec3x8 L = path->L;
    if (!i8_any(sky))
        return L;
    i8 rival = path->pdf > 0;
    for (uint32_t e = 0; e < ks->scene->environment_count; e++) {
        const struct environment_table *env = &ks->environments[e];
        if (ks->scene->lights[env->light].kind != LIGHT_SKY)
            continue;
        struct environment_sample8 seen = environment_seen(env, path->d);
        if (env->has_portal) {
            /* Copies: what has its address taken is in memory for good */
            struct vec3x8 o = path->o;
            struct environment_sample8 through = seen;
            light_through(env, i8_bits(sky), &o, &through);
            seen = through;
        }
        f8 pdf_light = seen.pdf * light_pick(ks, fx, sky & rival, path->from, path->side,
                                             I8((int32_t)env->light));
        f8 w = f8_select(rival, found_weight(ks, fx, path->pdf, pdf_light), F8(1));
        struct vec3x8 found = vec3x8_mul(vec3x8_scale(path->beta, w), seen.L);
        L = vec3x8_add_where(sky, L, found);
    }
    return L;
}

/*
 * The way to the surfaces s of the lanes in `hit`, or into the open in the others of `active`,
 * through the media that the paths are in. Returns the lanes that scatter on the way. For them s is
 * the place where they do, without a side; other lanes of s do not change.
 */
LANE_FN i8 fly(const struct kernel_scene *ks, unsigned fx, i8 active, i8 hit, struct path8 *path,
               struct surface8 *s)
{
    i8 inside = active & (path->medium != 0);
    if (!i8_any(inside))
        return inside;
    f8 u_color, u;
    sampler_2d(&ks->sampler, (fx & FX_SAMPLER_ANY) != 0, &path->key,
               vertex_dimension(path, SAMPLE_DISTANCE), &u_color, &u);
    f8 far = f8_max(vec3x8_dot(vec3x8_sub(s->p, path->o), path->d) + path->lead, F8(0));
    struct medium8 medium = medium_of(ks->scene, path->medium);
    struct flight8 flight = medium_fly(&medium, path->beta, f8_select(hit, far, F8(MEDIUM_FAR)),
                                       u_color, u);
    i8 glows = inside;
    if (fx & FX_PATHS)
        glows &= i8_gather(ks->dfa.accepts, path->state);
    path->L = vec3x8_add_where(glows, path->L, flight.emitted);
    path->beta = vec3x8_select(inside, flight.beta, path->beta);
    i8 scattered = inside & flight.scattered;
    f8 t = f8_max(flight.distance - path->lead, F8(0));
    struct vec3x8 p = vec3x8_along(path->o, path->d, t);
    s->p = vec3x8_select(scattered, p, s->p);
    s->spawn = f8_select(scattered, F8(0), s->spawn);
    s->inside = s->inside & ~scattered;
    s->outside = s->outside & ~scattered;
    return scattered;
}

/* Light from a vertex at s on the way to ls through media; T as in medium_light */
LANE_FN i8 lit_through_media(const struct kernel_scene *ks, struct kernel_thread *thread,
                             unsigned fx, i8 valid, const struct path8 *path,
                             const struct surface8 *s, f8 wi_side, struct vec3x8 start,
                             const struct light_sample8 *ls, struct path_stats *stats,
                             struct vec3x8 *T)
{
    struct medium_ray8 way = {
        .o = start,
        .end = ls->point,
        .lead = s->spawn * f8_abs(wi_side),
        .medium = medium_beyond(s, path->medium, wi_side),
        .beyond = ls->distance == ks->far_distance, /* no other light is just there */
        .time = fx & FX_MOTION ? path->time : F8(0),
    };
    return medium_light(ks, thread, valid, &way, stats, T);
}

/* Scattering by the phase function, which is sampled as it is: nothing weighs it */
LANE_FN void scatter_in_media(i8 volume, f8 g, const struct path8 *path, f8 u, f8 v,
                              struct bsdf_sample8 *bs, struct vec3x8 *wi)
{
    struct vec3x8 w = phase_sample(g, path->d, u, v);
    *wi = vec3x8_select(volume, w, *wi);
    bs->weight = vec3x8_select(volume, vec3x8_all(1, 1, 1), bs->weight);
    bs->pdf = f8_select(volume, phase_pdf(g, path->d, w), bs->pdf);
    bs->eta = f8_select(volume, F8(1), bs->eta);
    bs->delta = bs->delta & ~volume;
    bs->valid |= volume;
}

/*
 * Trace every sample of a leaf: B samples of each pixel of the tile, in lanes that start empty and
 * take the next sample as soon as their path ends. What is left in thread->radiance does not depend
 * on which lane traced what.
 */
static inline __attribute__((always_inline)) void
path_radiance(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile_index,
              uint32_t replicate, uint64_t leaf, struct path_stats *stats, const unsigned fx)
{
    const struct scene *scene = ks->scene;
    const int any = (fx & FX_SAMPLER_ANY) != 0;
    const struct tile_rect tile = tile_rect(scene, tile_index);
    const uint64_t first_sample = leaf * ks->spec.leaf_samples;
    const int32_t slot_end = (int32_t)(tile.width * tile.height * ks->spec.leaf_samples);
    const unsigned usable = (1u << ks->spec.max_lanes) - 1;
    const i8 depth_limit = I8((int32_t)ks->max_depth);

    struct camera_batch batch = { .count = 0 };
    struct found8 found = { .t = F8(0) };
    struct path8 path = { .slot = I8(0) };
    int32_t next_slot = 0;
    unsigned alive = 0;

    for (;;) {
        /* Give idle lanes the next samples of the leaf */
        unsigned going_on = alive;
        while ((alive ^ usable) != 0) {
            if (batch.used == batch.count) {
                if (next_slot >= slot_end)
                    break;
                camera_batch_fill(&batch, ks, thread, fx, &tile, replicate, first_sample, next_slot,
                                  slot_end);
                next_slot += batch.count;
            }
            alive |= camera_batch_take(&batch, ks, fx, usable & ~alive, &path, &found);
        }
        if (alive == 0)
            break;

        /* Samples of rays that are none count as not a number */
        i8 active = i8_from_bits(alive);
        i8 sound = sound_rays(path.o, path.d), broken = active & ~sound;
        if (i8_any(broken)) {
            path.L = vec3x8_select(broken, vec3x8_all(__builtin_nanf(""), 0, 0), path.L);
            active &= sound;
        }

        /* The nearest surface along each ray; those of the camera know it */
        find_nearest(ks, thread, fx, active & i8_from_bits(going_on), path.o, path.d,
                     fx & FX_MOTION ? path.time : F8(0), false, &found);
        stats->rays_closest += (unsigned)__builtin_popcount(i8_bits(active));
        i8 geometry = found.geometry, prim = found.prim;
        i8 hit = active & (geometry != -1), inside = I8(0), instance = I8(-1);
        if (fx & FX_INSTANCE) {
            instance = found.instance;
            inside = instance_resolve(ks, hit, instance, &geometry, &prim);
        }
        struct hit_corners8 corners = hit_corners(ks, fx, hit, geometry, prim);

        /* The numbers that almost every vertex needs */
        f8 light_u, light_v, scatter_u, scatter_v;
        sampler_2d(&ks->sampler, any, &path.key, vertex_dimension(&path, SAMPLE_LIGHT_POINT),
                   &light_u, &light_v);
        sampler_2d(&ks->sampler, any, &path.key, vertex_dimension(&path, SAMPLE_BSDF_DIRECTION),
                   &scatter_u, &scatter_v);

        /* What was hit; inside an instance, as seen from there */
        struct pose8 pose;
        struct vec3x8 o = path.o, d = path.d;
        if ((fx & FX_INSTANCE) && i8_any(inside)) {
            pose = instance_pose(scene, fx, false, instance & inside, path.time);
            instance_enter(inside, &pose, &o, &d);
        }
        struct surface8 s = hit_surface(ks, fx, hit, geometry, prim, &corners, o, d, found.t);
        if ((fx & FX_INSTANCE) && i8_any(inside))
            instance_leave(inside, fx, &pose, &s);
        struct vec3x8 wo_world = vec3x8_neg(path.d);

        /* Some scatter before they get there, and some only come into another medium */
        i8 escaped = active & ~hit, volume = I8(0), crossed = I8(0);
        const bool media = (fx & FX_MEDIUM) && scene->medium_count > 0;
        if (media) {
            volume = fly(ks, fx, active, hit, &path, &s);
            escaped &= ~volume;
            crossed = hit & ~volume & (s.material == -1);
            hit &= ~(volume | crossed);
            s.material = s.material & ~(s.material == -1);
        }

        /* Paths that leave the scene find the sky; with the constant one nothing competes */
        if (fx & FX_SKY) {
            i8 sky = escaped;
            if (fx & FX_PATHS)
                sky &= i8_gather(ks->dfa.accepts, path.state);
            const float *c = scene->settings.sky;
            struct vec3x8 seen = vec3x8_mul(path.beta, vec3x8_all(c[0], c[1], c[2]));
            path.L = vec3x8_add_where(sky, path.L, seen);
        }
        if (fx & FX_ENVIRONMENT) {
            i8 sky = escaped;
            if (fx & FX_PATHS)
                sky &= i8_gather(ks->dfa.accepts, path.state);
            path.L = sky_seen(ks, fx, sky, &path);
        }

        /* Emission, weighted against light sampling from the vertex before */
        i8 emits = hit & (s.light != -1);
        if (fx & FX_PATHS)
            emits &= i8_gather(ks->dfa.accepts, path.state);
        if (i8_any(emits)) {
            i8 light = i8_select(emits, s.light, I8(0));
            struct vec3x8 n = s.ng;
            if (fx & FX_POLYGON_LIGHT) {
                i8 polygon = LIGHT_I(kind) == LIGHT_POLYGON;
                n = vec3x8_select(polygon, LIGHT3(normal), n);
            }
            emits &= light_faces(ks, fx, light, vec3x8_dot(n, wo_world));
            if (fx & FX_DELTA_LIGHT)
                emits &= (LIGHT_I(flags) & LIGHT_UNSEEN) == 0;
            i8 rival = emits & (path.pdf > 0);
            f8 w = F8(1);
            if (i8_any(rival)) {
                f8 pdf_light = light_pdf(ks, fx, rival, light, path.from, path.side, s.p, n);
                w = f8_select(rival, found_weight(ks, fx, path.pdf, pdf_light), w);
            }
            struct vec3x8 Le = LIGHT3(radiance);
            if ((fx & FX_TEXTURE) && ks->emission != NULL)
                Le = texture_emission(ks, thread, emits, light, &s, Le);
            struct vec3x8 seen = vec3x8_mul(vec3x8_scale(path.beta, w), Le);
            path.L = vec3x8_add_where(emits, path.L, seen);
        }

        /* Which material; a mix decides here, once per level of nesting */
        i8 id = s.material;
        i8 textured = I8(0);
        if (fx & FX_TEXTURE) {
            textured = hit & (i8_gather(ks->textured, id) != 0);
            if (i8_any(textured))
                texture_points(ks, thread, textured, &s);
        }
        if (fx & FX_MIX) {
            i8 mixed = hit &
                       (GATHER_I(scene->materials, struct material, kind, id) == MATERIAL_MIX);
            if (i8_any(mixed)) {
                f8 u = sampler_1d(&ks->sampler, any, &path.key,
                                  vertex_dimension(&path, SAMPLE_MIX));
                while (i8_any(mixed)) {
                    f8 amount = GATHER(scene->materials, struct material, mix_amount, id);
                    if (fx & FX_TEXTURE)
                        amount = texture_amounts(ks, thread, mixed, id, amount);
                    i8 second = u < amount;
                    i8 a = GATHER_I(scene->materials, struct material, mix[0], id);
                    i8 b = GATHER_I(scene->materials, struct material, mix[1], id);
                    /* What is left of u decides the next level */
                    f8 rest = f8_select(second, u / amount, (u - amount) / (1 - amount));
                    u = f8_select(mixed, f8_min(rest, F8(0x1.fffffep-1f)), u);
                    id = i8_select(mixed, i8_select(second, b, a), id);
                    mixed &= GATHER_I(scene->materials, struct material, kind, id) == MATERIAL_MIX;
                }
            }
        }
        /* Where textures have a say, every lane has a material of its own */
        const struct material *materials = scene->materials;
        i8 own = id;
        if (fx & FX_TEXTURE) {
            textured &= i8_gather(ks->textured, id) != 0;
            if (i8_any(textured)) {
                texture_materials(ks, thread, fx, textured, id, wo_world, &s);
                materials = thread->materials;
                own = i8_lanes();
            }
        }
        struct bsdf8 bsdf = bsdf_of_materials(scene, materials, fx, own);
        i8 go = hit;
        if (fx & FX_TEXTURE) {
            i8 unlit = go & (bsdf.kind == MATERIAL_UNLIT), shown = unlit & (path.pdf == 0);
            if (fx & FX_PATHS)
                shown &= i8_gather(ks->dfa.accepts, path.state);
            path.L = vec3x8_add_where(shown, path.L, vec3x8_mul(path.beta, bsdf.reflectance));
            go &= ~unlit;
        }
        i8 black = (bsdf.kind == MATERIAL_DIFFUSE) & (vec3x8_max(bsdf.reflectance) <= 0);
        if ((fx & FX_SHEEN) && bsdf.sheen != 0)
            black &= ~i8_from_bits(bsdf.sheen);
        go &= ~black;
        if (media)
            go |= volume;

        /* A path cut by the depth limit is counted, with the energy it still carried */
        i8 cut = go & (path.events >= depth_limit);
        if (media)
            cut |= crossed & (path.passed >= MEDIUM_CROSSINGS);
        if (i8_any(cut)) {
            f8 energy = vec3x8_luminance(path.beta);
            for (unsigned todo = i8_bits(cut); todo != 0; todo &= todo - 1)
                stats->truncated_energy += (double)energy[__builtin_ctz(todo)];
            stats->truncated_paths += (unsigned)__builtin_popcount(i8_bits(cut));
            go &= ~cut;
            crossed &= ~cut;
        }

        struct frame8 frame = frame_around(s.ns);
        if (fx & FX_ANISOTROPIC) {
            i8 turned = go & bsdf_anisotropic(&bsdf, fx);
            if (i8_any(turned))
                frame = frame_turned(turned, &frame, s.dpdu);
        }
        struct vec3x8 wo = frame_to_local(&frame, wo_world);
        f8 wo_side = vec3x8_dot(s.ng, wo_world);
        go &= wo.z != 0;
        f8 g = F8(0);
        if (media) {
            go |= volume & ~cut;
            g = medium_of(scene, path.medium).g;
        }

        /* Light sampling */
        struct vec3x8 side = vec3x8_all(0, 0, 0);
        if (fx & FX_LIGHT_TREE)
            side = lit_side(&bsdf, s.ns, wo.z);
        i8 lit = go;
        if (fx & (FX_CONDUCTOR | FX_DIELECTRIC | FX_THIN | FX_COATED_CONDUCTOR))
            lit &= ~bsdf_all_delta(&bsdf, fx);
        if (media) {
            side = vec3x8_select(volume, vec3x8_all(0, 0, 0), side);
            lit |= go & volume;
        }
        i8 state_d = I8(0);
        if (fx & FX_PATHS) {
            state_d = i8_gather(ks->dfa.next, path.state * PATH_SYMBOLS + PATH_D);
            lit &= i8_gather(ks->dfa.accepts, state_d);
        }
        if (ks->lights_sampled && i8_any(lit)) {
            f8 pick = F8(0);
            if (fx & FX_MANY_LIGHTS)
                pick = sampler_1d(&ks->sampler, any, &path.key,
                                  vertex_dimension(&path, SAMPLE_LIGHT_PICK));
            struct light_sample8 ls = light_sample(ks, fx, lit, s.p, side, pick, light_u, light_v);
            struct vec3x8 wi = frame_to_local(&frame, ls.wi);
            struct bsdf_eval8 f = bsdf_eval(&bsdf, fx, TRANSPORT_RADIANCE, ls.valid & ~volume, wo,
                                            wi);
            if (media) {
                f8 phase = phase_pdf(g, path.d, ls.wi);
                f.f_cos = vec3x8_select(volume, (struct vec3x8){ phase, phase, phase }, f.f_cos);
                f.pdf = f8_select(volume, phase, f.pdf);
            }
            i8 worth = ls.valid & (vec3x8_max(f.f_cos) > 0);
            f8 wi_side = vec3x8_dot(s.ng, ls.wi);
            /* No light through the surface (NUMERICS H15) */
            if (fx & (FX_SMOOTH_NORMALS | FX_BUMP))
                worth &= ((wo.z * wi.z > 0) == (wo_side * wi_side > 0)) | volume;
            if (i8_any(worth)) {
                struct vec3x8 start = vec3x8_along(s.p, s.ng, f8_mulsign(s.spawn, wi_side));
                struct vec3x8 to = vec3x8_sub(ls.point, start);
                i8 visible;
                if (media) {
                    struct vec3x8 T;
                    visible = lit_through_media(ks, thread, fx, worth, &path, &s, wi_side, start,
                                                &ls, stats, &T);
                    ls.radiance = vec3x8_mul(ls.radiance, T);
                } else {
                    stats->rays_shadow += (unsigned)__builtin_popcount(i8_bits(worth));
                    visible = unoccluded(ks, thread, fx, worth, start, to,
                                         fx & FX_MOTION ? path.time : F8(0));
                }
                f8 w = mis_weight(ls.pdf, f.pdf);
                if (without(ks, fx, TECHNIQUE_MIS))
                    w = F8(1);
                if (fx & FX_DELTA_LIGHT)
                    w = f8_select(ls.delta, F8(1), w);
                w = w / ls.pdf;
                struct vec3x8 seen = vec3x8_mul(vec3x8_mul(path.beta, f.f_cos), ls.radiance);
                path.L = vec3x8_add_where(visible, path.L, vec3x8_scale(seen, w));
            }
        }

        /* Scatter */
        f8 lobe = F8(0);
        if (fx & (FX_MIXTURE | FX_DIELECTRIC | FX_COAT | FX_THIN | FX_COATED_CONDUCTOR | FX_SHEEN))
            lobe = sampler_1d(&ks->sampler, any, &path.key,
                              vertex_dimension(&path, SAMPLE_BSDF_LOBE));
        struct bsdf_sample8 bs = bsdf_sample(&bsdf, fx, TRANSPORT_RADIANCE, go & ~volume, wo, lobe,
                                             scatter_u, scatter_v);

        /* What the other layers of the picture show */
        if (__builtin_expect(thread->first_hits != NULL, 0)) {
            i8 first = hit & (path.events == 0), object = geometry;
            if (fx & FX_QUADRIC)
                object = object + (prim & (geometry == ks->quadric_geometry));
            if (fx & FX_INSTANCE)
                object = i8_select(inside, instance + first_hit_instance(scene), object);
            struct vec3x8 albedo = vec3x8_scale(bs.weight, bs.eta * bs.eta);
            albedo = vec3x8_select(bs.valid, albedo, vec3x8_all(0, 0, 0));
            const f8 time = fx & FX_MOTION ? path.time : F8(0);
            struct first_hit8 at = {
                path.slot, object, s.material, s.p, frame.n, s.ng, albedo, time
            };
            if (media) {
                first |= volume & (path.events == 0);
                first_scatter(scene, volume, path.medium, &at);
            }
            store_first_hits(&at, i8_bits(first), thread);
        }
        struct vec3x8 wi_world = frame_to_world(&frame, bs.wi);
        if (media)
            scatter_in_media(volume, g, &path, scatter_u, scatter_v, &bs, &wi_world);
        f8 wi_side = vec3x8_dot(s.ng, wi_world);
        go &= bs.valid;
        if (fx & (FX_SMOOTH_NORMALS | FX_BUMP))
            go &= ((bs.transmitted == 0) == (wo_side * wi_side > 0)) | volume;
        stats->events += (unsigned)__builtin_popcount(i8_bits(go));
        struct vec3x8 beta = vec3x8_mul(path.beta, bs.weight);

        if (fx & FX_PATHS) {
            i8 state_s = i8_gather(ks->dfa.next, path.state * PATH_SYMBOLS + PATH_S);
            path.state = i8_select(go, i8_select(bs.delta, state_s, state_d), path.state);
            go &= path.state != 0;
        }

        /*
         * Russian roulette from the second event on: survive with probability q, the throughput
         * that reaches the eye over ROULETTE_REFERENCE, never capped below it, so that no survivor
         * weighs more than the reference (NUMERICS H47, H48)
         */
        f8 q = vec3x8_max(beta);
        if (fx & FX_DIELECTRIC) {
            path.eta_scale = f8_select(go, path.eta_scale * (bs.eta * bs.eta), path.eta_scale);
            q = q * path.eta_scale;
        }
        q = q * (1 / ROULETTE_REFERENCE);
        go &= q > 0;
        i8 gamble = go & (q < 1) & (path.events > 0);
        if (without(ks, fx, TECHNIQUE_ROULETTE))
            gamble = I8(0);
        if (i8_any(gamble)) {
            f8 r = sampler_1d(&ks->sampler, any, &path.key,
                              vertex_dimension(&path, SAMPLE_ROULETTE));
            go &= ~(gamble & (r >= q));
            beta = vec3x8_select(gamble, vec3x8_scale(beta, 1 / q), beta);
        }

        /* What only comes into another medium goes on as if nothing had been there */
        i8 medium = path.medium;
        if (media) {
            f8 on_side = vec3x8_dot(s.ng, path.d);
            go |= crossed;
            beta = vec3x8_select(crossed, path.beta, beta);
            wi_world = vec3x8_select(crossed, path.d, wi_world);
            wi_side = f8_select(crossed, on_side, wi_side);
            medium = medium_beyond(&s, medium, wi_side);
        }

        /* Paths that end here are done; the others leave along wi */
        i8 ended = i8_from_bits(alive) & ~go;
        unsigned finished = i8_bits(ended);
        if (finished != 0)
            store_finished(&path, finished, thread);
        alive &= ~finished;
        path.beta = beta;
        path.d = wi_world;
        path.o = vec3x8_along(s.p, s.ng, f8_mulsign(s.spawn, wi_side));
        struct vec3x8 from = s.p;
        f8 pdf = f8_select(bs.delta, F8(0), bs.pdf);
        i8 scattered = I8(1);
        if (media) {
            from = vec3x8_select(crossed, path.from, from);
            side = vec3x8_select(crossed, path.side, side);
            pdf = f8_select(crossed, path.pdf, pdf);
            scattered = scattered + crossed;
            path.passed = path.passed - crossed;
            path.lead = s.spawn * f8_abs(wi_side);
            path.medium = medium;
        }
        path.from = from;
        if (fx & FX_LIGHT_TREE)
            path.side = side;
        path.pdf = pdf;
        path.events = path.events + scattered;
    }
}

#define X(name, mask)                                                               \
    void KERNEL_NAME(path_leaf_##name)(                                             \
        const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile, \
        uint32_t replicate, uint64_t leaf, struct path_stats *stats)                \
    {                                                                               \
        assert((ks->fx & ~(unsigned)(mask)) == 0);                                  \
        path_radiance(ks, thread, tile, replicate, leaf, stats, (mask));            \
    }
KERNEL_VARIANTS(X)
#undef X
