/*
 * Camera rays, eight at a time.
 */
#ifndef WORKER_KERNEL_CAMERA_H
#define WORKER_KERNEL_CAMERA_H

#include "common/effects.h"
#include "common/elem.h"
#include "worker/kernel/instance.h"
#include "worker/kernel/kernel_scene.h"

struct ray8 {
    struct vec3x8 o, d; /* d is unit length */
};

/* Concentric map of the unit square to the unit disk (Shirley and Chiu 1997) */
LANE_FN struct vec2x8 disk_from_square(f8 u, f8 v)
{
    f8 a = 2 * u - 1, b = 2 * v - 1;
    i8 wide = a * a > b * b;
    f8 r = f8_select(wide, a, b);
    f8 ratio = f8_select(wide, b / a, a / b);
    ratio = f8_select(r == 0, F8(0), ratio);
    /* Angle in turns: ratio / 8 beside the x axis, 1/4 - ratio / 8 beside the y axis */
    f8 turns = f8_select(wide, ratio * 0.125f, 0.25f - ratio * 0.125f);
    turns = f8_select(turns < 0, turns + 1, turns);
    f8 sine, cosine;
    f8_sincos_turns(turns, &sine, &cosine);
    return (struct vec2x8){ r * cosine, r * sine };
}

/* One axis of the filter: a table entry for the magnitude, the upper half of u for the sign */
LANE_FN f8 filter_axis_sample(const struct filter_part *part, float radius, f8 u)
{
    f8 folded = f8_abs(2 * u - 1), at = folded * part->step[0];
    for (int lobe = 1; lobe < part->lobes; lobe++)
        at = f8_select(folded < part->begin[lobe], f8_min(at, F8(part->first[lobe] - 1)),
                       part->first[lobe] + (folded - part->begin[lobe]) * part->step[lobe]);
    i8 i = i8_from_f8(f8_min(at, F8(FILTER_TABLE_LEN)));
    f8 t = at - f8_from_i8(i);
    f8 low = f8_gather(part->table, i), high = f8_gather(part->table, i + 1);
    f8 x = ((1 - t) * low + t * high) * radius;
    return f8_select(u < 0.5f, -x, x);
}

/*
 * Where samples fall, in pixels from the centre of their pixel. `negative` lanes belong to the
 * filter's negative stratum; `lobe` picks between the lobes of one sign.
 */
LANE_FN struct vec2x8 filter_offset(const struct filter_table *filter, unsigned fx, i8 negative,
                                    f8 lobe, f8 u, f8 v)
{
    if (!(fx & FX_FILTER_ANY))
        return (struct vec2x8){ u - 0.5f, v - 0.5f };
    if (filter->kind == FILTER_BOX)
        return (struct vec2x8){ (2 * u - 1) * filter->radius[0], (2 * v - 1) * filter->radius[1] };
    struct vec2x8 plus = { filter_axis_sample(&filter->positive[0], filter->radius[0], u),
                           filter_axis_sample(&filter->positive[1], filter->radius[1], v) };
    if (!filter->has_negative)
        return plus;
    struct vec2x8 minus = { filter_axis_sample(&filter->negative[0], filter->radius[0], u),
                            filter_axis_sample(&filter->negative[1], filter->radius[1], v) };
    /* One axis negative gives a negative lobe, none or both a positive one */
    i8 both = ~negative & (lobe >= filter->both_positive);
    i8 only_x = negative & (lobe < filter->only_x), only_y = negative & ~only_x;
    return (struct vec2x8){ f8_select(both | only_x, minus.x, plus.x),
                            f8_select(both | only_y, minus.y, plus.y) };
}

/* The ray through film point (x, y), in pixels of the full image; (lu, lv) place it on the lens,
 * and `time` a camera that moves */
LANE_FN struct ray8 camera_ray(const struct scene *scene, unsigned fx, f8 x, f8 y, f8 lu, f8 lv,
                               f8 time)
{
    const struct camera *c = &scene->settings.camera;
    float width = (float)scene->settings.width, height = (float)scene->settings.height;
    f8 sx = c->screen[0] + (c->screen[1] - c->screen[0]) * (x / width);
    f8 sy = c->screen[3] - (c->screen[3] - c->screen[2]) * (y / height);
    struct vec3x8 position = vec3x8_all(c->position[0], c->position[1], c->position[2]);
    struct vec3x8 right = vec3x8_all(c->right[0], c->right[1], c->right[2]);
    struct vec3x8 up = vec3x8_all(c->up[0], c->up[1], c->up[2]);
    struct vec3x8 forward = vec3x8_all(c->forward[0], c->forward[1], c->forward[2]);
    if ((fx & FX_MOTION) && scene->settings.camera_motion != 0) {
        i8 motion = I8((int32_t)scene->settings.camera_motion - 1);
        struct rows8 m = motion_pose(scene, true, motion, time).to_world;
        right = (struct vec3x8){ m.x.x, m.y.x, m.z.x };
        up = (struct vec3x8){ m.x.y, m.y.y, m.z.y };
        forward = (struct vec3x8){ m.x.z, m.y.z, m.z.z };
        position = m.add;
    }

    /* In camera space the ray starts at (ox, oy, 0) and goes along (dx, dy, 1) */
    f8 ox = F8(0), oy = F8(0), dx = sx, dy = sy;
    if ((fx & FX_ORTHOGRAPHIC) && c->kind == CAMERA_ORTHOGRAPHIC) {
        ox = sx;
        oy = sy;
        dx = F8(0);
        dy = F8(0);
    }
    if ((fx & FX_LENS) && c->lens_radius > 0) {
        /* All rays of a film point meet where its central ray crosses the plane of focus */
        struct vec2x8 lens = disk_from_square(lu, lv);
        f8 lx = lens.x * c->lens_radius, ly = lens.y * c->lens_radius;
        float per_focus = 1 / c->focal_distance; /* 0 for parallel rays */
        dx = dx - lx * per_focus;
        dy = dy - ly * per_focus;
        ox = ox + lx;
        oy = oy + ly;
    }
    struct ray8 ray;
    ray.d = vec3x8_along(vec3x8_along(forward, right, dx), up, dy);
    ray.d = vec3x8_unit(ray.d);
    ray.o = vec3x8_along(vec3x8_along(position, right, ox), up, oy);
    return ray;
}

#endif
