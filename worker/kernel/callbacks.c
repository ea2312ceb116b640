#include "worker/kernel/callbacks.h"

#include "worker/kernel/alpha.h"
#include "worker/kernel/instance.h"
#include "worker/kernel/isa.h"
#include "worker/kernel/quadric.h"

/* ---- spheres and disks */

void KERNEL_NAME(callbacks_quadric_bounds)(const struct RTCBoundsFunctionArguments *args)
{
    const struct kernel_quadrics *quadrics = args->geometryUserPtr;
    const struct quadric *q = &quadrics->first[args->primID];
    float half[3];
    for (int axis = 0; axis < 3; axis++) {
        /* The image of a ball reaches |row| * radius along each axis; a disk's, |x, y part of row|
         */
        const float *row = q->to_world + 3 * axis;
        float z = q->kind == QUADRIC_SPHERE ? row[2] : 0;
        half[axis] = q->radius * __builtin_sqrtf(row[0] * row[0] + row[1] * row[1] + z * z);
        float magnitude = __builtin_fabsf(q->center[axis]) + half[axis];
        half[axis] += magnitude * 0x1p-20f; /* rounding, and thickness for a flat disk */
    }
    args->bounds_o->lower_x = q->center[0] - half[0];
    args->bounds_o->lower_y = q->center[1] - half[1];
    args->bounds_o->lower_z = q->center[2] - half[2];
    args->bounds_o->upper_x = q->center[0] + half[0];
    args->bounds_o->upper_y = q->center[1] + half[1];
    args->bounds_o->upper_z = q->center[2] + half[2];
}

/* Up to eight of the N rays, from `first` on, as lanes */
struct callback8 {
    struct vec3x8 o, d;
    f8 tnear, tfar, time, id;
    i8 valid;
};

LANE_FN struct callback8 callback_load(const int *valid, const float *rays, unsigned N,
                                       unsigned first)
{
    struct callback8 c = { .d = vec3x8_all(0, 0, 1), .time = F8(0), .id = F8(0), .valid = I8(0) };
    for (unsigned lane = 0; lane < LANES && first + lane < N; lane++) {
        const float *ray = rays + first + lane;
        c.o.x[lane] = ray[RAY_ORG_X * N];
        c.o.y[lane] = ray[RAY_ORG_Y * N];
        c.o.z[lane] = ray[RAY_ORG_Z * N];
        c.d.x[lane] = ray[RAY_DIR_X * N];
        c.d.y[lane] = ray[RAY_DIR_Y * N];
        c.d.z[lane] = ray[RAY_DIR_Z * N];
        c.tnear[lane] = ray[RAY_TNEAR * N];
        c.tfar[lane] = ray[RAY_TFAR * N];
        c.time[lane] = ray[RAY_TIME * N];
        c.id[lane] = ray[RAY_ID * N];
        c.valid[lane] = valid[first + lane];
    }
    return c;
}

/* The nearest hits that count of rays with a quadric that is there in part: of its two hits the
 * second may, where the first does not */
static __attribute__((noinline)) void quadric_in_part(const struct kernel_scene *ks,
                                                      const struct quadric *q, unsigned geometry,
                                                      unsigned prim, const struct callback8 *c,
                                                      i8 *hit, f8 *t)
{
    i8 pending = *hit, found = I8(0);
    f8 at = *t;
    for (uint32_t turn = 0; turn < 2 && i8_any(pending); turn++) {
        for (unsigned todo = i8_bits(pending); todo != 0; todo &= todo - 1) {
            int lane = __builtin_ctz(todo);
            const struct alpha_hit met = { .o = { c->o.x[lane], c->o.y[lane], c->o.z[lane] },
                                           .d = { c->d.x[lane], c->d.y[lane], c->d.z[lane] },
                                           .t = at[lane],
                                           .ray = (uint32_t)((i8)c->id)[lane],
                                           .geometry = geometry,
                                           .prim = prim,
                                           .turn = turn };
            if (alpha_quadric(ks, q, &met)) {
                found[lane] = -1;
                (*t)[lane] = at[lane];
            }
        }
        pending &= ~found;
        f8 beyond = at + f8_max(at * 0x1p-22f, F8(0x1p-126f));
        pending = quadric_intersect(q, pending, c->o, c->d, beyond, c->tfar, &at);
    }
    *hit = found;
}

/* What rays find of a quadric */
LANE_FN i8 quadric_found(const struct kernel_quadrics *quadrics, unsigned geometry, unsigned prim,
                         const struct callback8 *c, f8 *t)
{
    const struct quadric *q = &quadrics->first[prim];
    i8 hit = quadric_intersect(q, c->valid, c->o, c->d, c->tnear, c->tfar, t);
    if (__builtin_expect(q->alpha != 0, 0) && i8_any(hit)) {
        struct callback8 rays = *c;
        i8 some = hit;
        f8 at = *t;
        quadric_in_part(quadrics->ks, q, geometry, prim, &rays, &some, &at);
        *t = at;
        hit = some;
    }
    return hit;
}

void KERNEL_NAME(callbacks_quadric_intersect)(const struct RTCIntersectFunctionNArguments *args)
{
    const struct kernel_quadrics *quadrics = args->geometryUserPtr;
    const struct quadric *q = &quadrics->first[args->primID];
    unsigned N = args->N;
    float *rays = (float *)args->rayhit;
    unsigned *hits = (unsigned *)args->rayhit + (size_t)RAY_ROWS * N;
    if (q->material == SCENE_NONE && q->inside == q->outside)
        return; /* an interface that is not there */
    for (unsigned first = 0; first < N; first += LANES) {
        struct callback8 c = callback_load(args->valid, rays, N, first);
        f8 t;
        i8 hit = quadric_found(quadrics, args->geomID, args->primID, &c, &t);
        for (unsigned todo = i8_bits(hit); todo != 0; todo &= todo - 1) {
            unsigned lane = (unsigned)__builtin_ctz(todo), i = first + lane;
            rays[RAY_TFAR * N + i] = t[lane];
            hits[HIT_GEOM * N + i] = args->geomID;
            hits[HIT_PRIM * N + i] = args->primID;
            hits[HIT_INST * N + i] = RTC_INVALID_GEOMETRY_ID;
        }
    }
}

void KERNEL_NAME(callbacks_quadric_occluded)(const struct RTCOccludedFunctionNArguments *args)
{
    const struct kernel_quadrics *quadrics = args->geometryUserPtr;
    const struct quadric *q = &quadrics->first[args->primID];
    unsigned N = args->N;
    float *rays = (float *)args->ray;
    if (q->material == SCENE_NONE && q->inside == q->outside)
        return;
    for (unsigned first = 0; first < N; first += LANES) {
        struct callback8 c = callback_load(args->valid, rays, N, first);
        f8 t;
        i8 hit = quadric_found(quadrics, args->geomID, args->primID, &c, &t);
        for (unsigned todo = i8_bits(hit); todo != 0; todo &= todo - 1)
            rays[RAY_TFAR * N + first + (unsigned)__builtin_ctz(todo)] = -__builtin_inff();
    }
}

/* ---- instances */

/* The corners of a box, one per lane */
LANE_FN struct vec3x8 box_corners(const struct RTCBounds *box)
{
    i8 lane = i8_lanes();
    return (struct vec3x8){
        f8_select((lane & 1) != 0, F8(box->lower_x), F8(box->upper_x)),
        f8_select((lane & 2) != 0, F8(box->lower_y), F8(box->upper_y)),
        f8_select((lane & 4) != 0, F8(box->lower_z), F8(box->upper_z)),
    };
}

LANE_FN float lanes_min(f8 a)
{
    float least = a[0];
    for (int lane = 1; lane < LANES; lane++)
        least = a[lane] < least ? a[lane] : least;
    return least;
}

/*
 * Between two of MOTION_STEPS moments a point of the group leaves the straight line by at most an
 * eighth of its acceleration times the square of the step; with it, the box holds every moment.
 */
#define MOTION_STEPS 16
LANE_FN float motion_bulge(const struct motion *motion, struct vec3x8 corners)
{
    float reach = -lanes_min(-f8_sqrt(vec3x8_length2(corners)));
    float size = 0, change = 0;
    for (int i = 0; i < 9; i++) {
        float a = motion->stretch[0][i], b = motion->stretch[1][i];
        size += __builtin_fmaxf(a * a, b * b);
        change += (b - a) * (b - a);
    }
    float turn = 2 * motion->angle;
    float acceleration = turn * turn * __builtin_sqrtf(size) + 2 * turn * __builtin_sqrtf(change);
    return reach * acceleration / (8 * MOTION_STEPS * MOTION_STEPS);
}

void KERNEL_NAME(callbacks_instance_bounds)(const struct RTCBoundsFunctionArguments *args)
{
    const struct kernel_scene *ks = args->geometryUserPtr;
    const struct scene *scene = ks->scene;
    const struct instance *instance = &scene->instances[args->primID];
    const struct RTCBounds *box = &ks->groups[instance->group].bounds;
    *args->bounds_o = *box;
    if (!(box->lower_x <= box->upper_x))
        return; /* there is nothing inside: Embree leaves the empty out */
    struct vec3x8 corners = box_corners(box), world;
    f8 low[3], high[3], size = F8(0);
    int steps = instance->motion != 0 ? MOTION_STEPS : 0;
    for (int step = 0; step <= steps; step++) {
        f8 time = F8((float)step * (1.0f / MOTION_STEPS));
        struct pose8 pose = instance_pose(scene, FX_ALL, true, I8((int32_t)args->primID), time);
        world = rows8_point(&pose.to_world, corners);
        size = f8_max(size, vec3x8_max(rows8_magnitude(&pose.to_world, vec3x8_abs(corners))));
        const f8 at[3] = { world.x, world.y, world.z };
        for (int axis = 0; axis < 3; axis++) {
            low[axis] = step == 0 ? at[axis] : f8_min(low[axis], at[axis]);
            high[axis] = step == 0 ? at[axis] : f8_max(high[axis], at[axis]);
        }
    }
    float margin = -lanes_min(-size) * 0x1p-20f; /* rounding */
    if (instance->motion != 0)
        margin += motion_bulge(&scene->motions[instance->motion - 1], corners);
    args->bounds_o->lower_x = lanes_min(low[0]) - margin;
    args->bounds_o->lower_y = lanes_min(low[1]) - margin;
    args->bounds_o->lower_z = lanes_min(low[2]) - margin;
    args->bounds_o->upper_x = -lanes_min(-high[0]) + margin;
    args->bounds_o->upper_y = -lanes_min(-high[1]) + margin;
    args->bounds_o->upper_z = -lanes_min(-high[2]) + margin;
}

/* The rays of a callback, in the space of the instance it is about */
LANE_FN void instance_rays(const struct kernel_scene *ks, unsigned instance, struct callback8 *c,
                           struct RTCRay8 *ray)
{
    struct pose8 pose = instance_pose(ks->scene, FX_ALL, true, I8((int32_t)instance), c->time);
    instance_enter(I8(-1), &pose, &c->o, &c->d);
    f8_store(ray->org_x, c->o.x);
    f8_store(ray->org_y, c->o.y);
    f8_store(ray->org_z, c->o.z);
    f8_store(ray->dir_x, c->d.x);
    f8_store(ray->dir_y, c->d.y);
    f8_store(ray->dir_z, c->d.z);
    f8_store(ray->tnear, c->tnear);
    f8_store(ray->tfar, c->tfar);
    f8_store(ray->time, c->time);
    /* What alpha.h knows the ray by: here another, as it may pass the same shape elsewhere */
    i8_store(ray->id, (i8)u8_hash((u8)c->id ^ (instance + 1) * 0x9e3779b9u));
    i8_store(ray->mask, I8(-1));
    i8_store(ray->flags, I8(0));
}

void KERNEL_NAME(callbacks_instance_intersect)(const struct RTCIntersectFunctionNArguments *args)
{
    const struct kernel_scene *ks = args->geometryUserPtr;
    unsigned N = args->N, instance = args->primID;
    float *rays = (float *)args->rayhit;
    unsigned *hits = (unsigned *)args->rayhit + (size_t)RAY_ROWS * N;
    for (unsigned first = 0; first < N; first += LANES) {
        _Alignas(32) int32_t valid[LANES];
        struct RTCRayHit8 inner;
        struct callback8 c = callback_load(args->valid, rays, N, first);
        i8_store(valid, c.valid);
        instance_rays(ks, instance, &c, &inner.ray);
        i8_store(inner.hit.geomID, I8(-1));
        i8_store(inner.hit.primID, I8(-1));
        i8_store(inner.hit.instID[0], I8(-1));
        rtc_intersect_inside8(valid, ks->groups[ks->scene->instances[instance].group].rtc, args,
                              &inner);
        i8 found = c.valid & (i8_load(inner.hit.geomID) != -1);
        for (unsigned todo = i8_bits(found); todo != 0; todo &= todo - 1) {
            unsigned lane = (unsigned)__builtin_ctz(todo), i = first + lane;
            rays[RAY_TFAR * N + i] = inner.ray.tfar[lane];
            hits[HIT_GEOM * N + i] = inner.hit.geomID[lane];
            hits[HIT_PRIM * N + i] = inner.hit.primID[lane];
            hits[HIT_INST * N + i] = instance;
        }
    }
}

void KERNEL_NAME(callbacks_instance_occluded)(const struct RTCOccludedFunctionNArguments *args)
{
    const struct kernel_scene *ks = args->geometryUserPtr;
    unsigned N = args->N, instance = args->primID;
    float *rays = (float *)args->ray;
    for (unsigned first = 0; first < N; first += LANES) {
        _Alignas(32) int32_t valid[LANES];
        struct RTCRay8 inner;
        struct callback8 c = callback_load(args->valid, rays, N, first);
        i8_store(valid, c.valid);
        instance_rays(ks, instance, &c, &inner);
        rtc_occluded_inside8(valid, ks->groups[ks->scene->instances[instance].group].rtc, args,
                             &inner);
        i8 found = c.valid & (f8_load(inner.tfar) < 0);
        for (unsigned todo = i8_bits(found); todo != 0; todo &= todo - 1)
            rays[RAY_TFAR * N + first + (unsigned)__builtin_ctz(todo)] = -__builtin_inff();
    }
}
