/*
 * Environments, eight at a time: radiance by direction, directions by radiance, and the density of
 * the latter. A texel is a patch of directions with one radiance and, in sampling, one density
 * (common/direction_map.h): what is looked up and what is sampled are the same function, so no
 * texel that shines is left out, however its neighbours are, and radiance over density has the
 * same luminance almost everywhere.
 *
 * Sampling is exact with the 24 bits that a random number has: the probability of a row, and of a
 * texel in it, is a whole number of 2^-24, and what shines has at least one of them. A texel is
 * therefore chosen exactly as often as its density says, a sun beside texels 2^-40 of it too
 * (NUMERICS H40), and one without light never is, whatever zeros surround it (H42).
 */
#ifndef WORKER_KERNEL_ENVIRONMENT_H
#define WORKER_KERNEL_ENVIRONMENT_H

#include "common/elem.h"
#include "common/lane.h"
#include "common/scene.h"
#include "worker/kernel/portal.h"

#include <stdbool.h>

struct err;

/* One of width + 1 in a row; the last only ends it */
struct environment_texel {
    float L[3];
    uint32_t below; /* of the row's 2^24 chances, those of the texels before */
};

/*
 * Where to look for a chance among bins: chance c is in one of the bins first[c >> shift] to
 * first[(c >> shift) + 1]. With about as many entries as bins, these are few.
 */
struct environment_guide {
    int32_t *first;
    int32_t shift, size; /* of an array: (2^24 >> shift) + 1 */
};

struct environment_table {
    int32_t width, height, layout;
    uint32_t light; /* the scene's light that it belongs to */
    int has_portal; /* only light.h asks it: nothing here knows of it */
    struct portal portal;
    float to_light[9];
    struct environment_texel *texels;
    uint32_t *rows; /* height + 1: of 2^24 chances, those of the rows before */
    struct environment_guide row_guide, column_guide; /* the latter has an array per row */
    float *row_density; /* density per solid angle of a texel with one chance */
    float *row_bounds;  /* lat-long, height + 1: sin^2(theta / 2), the share of the sphere above */
};

/* Zero-initialised `table` becomes that of the scene's environment `index`; a picture without any
 * light is sampled evenly. Close also what failed to open. */
bool environment_open(struct environment_table *table, const struct scene *scene, uint32_t index,
                      struct err *err);
void environment_close(struct environment_table *table);

/* ---- directions and places in the picture */

/* A place in the unit square, as (u, v) in [-1, 1] */
LANE_FN struct vec2x8 environment_to_square(struct vec3x8 w)
{
    /* 1 - |z| is taken from x and y, in which the pole has all its digits */
    f8 x = f8_abs(w.x), y = f8_abs(w.y);
    f8 r = f8_sqrt((x * x + y * y) / (1 + f8_abs(w.z)));
    i8 steep = y > x;
    f8 large = f8_max(f8_select(steep, y, x), F8(0x1p-126f)), small = f8_select(steep, x, y);
    f8 minor = f8_atan2(small, large) * (2 * 0x1.45f306p-2f) * r, major = r - minor;
    f8 u = f8_select(steep, minor, major), v = f8_select(steep, major, minor);
    i8 below = w.z < 0;
    return (struct vec2x8){ f8_copysign(f8_select(below, 1 - v, u), w.x),
                            f8_copysign(f8_select(below, 1 - u, v), w.y) };
}

LANE_FN struct vec3x8 environment_from_square(f8 u, f8 v)
{
    f8 au = f8_abs(u), av = f8_abs(v), sum = au + av;
    i8 below = sum > 1;
    f8 r = f8_select(below, (1 - au) + (1 - av), sum);
    f8 eighths = f8_select(r > 0, (av - au) / r + 1, F8(1));
    f8 sine, cosine;
    f8_sincos_turns(eighths * 0.125f, &sine, &cosine);
    f8 across = r * f8_sqrt(2 - r * r), z = 1 - r * r;
    return (struct vec3x8){ f8_copysign(across * cosine, u), f8_copysign(across * sine, v),
                            f8_select(below, -z, z) };
}

/* Where a direction falls: its row, and its texel with the row's end texels counted. Directions
 * that are none give a texel too. `inside` is false beyond a projection's picture. */
struct environment_place8 {
    i8 row, texel, inside;
};

LANE_FN i8 environment_cell(f8 place, int32_t count)
{
    return i8_from_f8(f8_clamp(place * (float)count, 0, (float)(count - 1)));
}

LANE_FN struct environment_place8 environment_place(const struct environment_table *env,
                                                    struct vec3x8 wi)
{
    const float *m = env->to_light;
    struct vec3x8 w = { wi.x * m[0] + wi.y * m[1] + wi.z * m[2],
                        wi.x * m[3] + wi.y * m[4] + wi.z * m[5],
                        wi.x * m[6] + wi.y * m[7] + wi.z * m[8] };
    f8 s, t;
    i8 inside = I8(-1);
    if (env->layout == ENVIRONMENT_LAT_LONG) {
        f8 across = f8_sqrt(w.x * w.x + w.y * w.y);
        f8 turn = f8_atan2(w.y, f8_select(across > 0, w.x, F8(1))) * 0x1.45f306p-3f;
        s = f8_select(turn < 0, turn + 1, turn);
        t = f8_atan2(across, w.z) * 0x1.45f306p-2f;
    } else {
        struct vec2x8 uv;
        if (env->layout == ENVIRONMENT_SQUARE) {
            uv = environment_to_square(w);
        } else {
            uv = (struct vec2x8){ w.x / w.z, w.y / w.z };
            inside = (w.z > 0) & (f8_max(f8_abs(uv.x), f8_abs(uv.y)) <= 1);
        }
        s = (uv.x + 1) * 0.5f;
        t = (uv.y + 1) * 0.5f;
    }
    struct environment_place8 place = { .row = environment_cell(t, env->height), .inside = inside };
    place.texel = place.row * (env->width + 1) + environment_cell(s, env->width);
    return place;
}

LANE_FN struct vec3x8 environment_texel_radiance(const struct environment_table *env, i8 texel)
{
    const float *L = env->texels[0].L;
    return (struct vec3x8){ f8_gather(L, texel * 4), f8_gather(L + 1, texel * 4),
                            f8_gather(L + 2, texel * 4) };
}

/* Radiance in direction wi, zero where the picture is not */
LANE_FN struct vec3x8 environment_radiance(const struct environment_table *env, struct vec3x8 wi)
{
    struct environment_place8 place = environment_place(env, wi);
    struct vec3x8 L = environment_texel_radiance(env, place.texel);
    return vec3x8_select(place.inside, L, vec3x8_all(0, 0, 0));
}

/* ---- sampling; not for projections */

struct environment_sample8 {
    struct vec3x8 wi, L;
    f8 pdf; /* per solid angle */
};

/* What is seen in direction wi, and the density with which environment_sample chooses it */
LANE_FN struct environment_sample8 environment_seen(const struct environment_table *env,
                                                    struct vec3x8 wi)
{
    struct environment_place8 place = environment_place(env, wi);
    const uint32_t *below = &env->texels[0].below;
    i8 chances = i8_gather(below + 4, place.texel * 4) - i8_gather(below, place.texel * 4);
    struct environment_sample8 seen = { .wi = wi };
    seen.L = environment_texel_radiance(env, place.texel);
    seen.pdf = f8_from_i8(chances) * f8_gather(env->row_density, place.row);
    return seen;
}

/* The bin that chance `at` belongs to: the last with below[stride * (first + bin)] <= at. `array`
 * is where in the guide that of these bins begins. */
LANE_FN i8 environment_search(const uint32_t *below, int32_t stride, i8 first,
                              const struct environment_guide *guide, i8 array, i8 at)
{
    i8 entry = array + (at >> guide->shift);
    i8 low = i8_gather(guide->first, entry), high = i8_gather(guide->first + 1, entry);
    while (i8_any(low < high)) {
        i8 middle = (low + high + 1) >> 1;
        i8 reached = at >= i8_gather(below, (first + middle) * stride);
        low = i8_select(reached, middle, low);
        high = i8_select(reached, high, middle - 1);
    }
    return low;
}

/* How far into its bin a chance is */
LANE_FN f8 environment_within(i8 at, i8 below, i8 end)
{
    f8 share = (f8_from_i8(at - below) + 0.5f) / f8_from_i8(end - below);
    return f8_min(share, F8(0x1.fffffep-1f));
}

LANE_FN struct vec3x8 environment_from_lat_long(const struct environment_table *env, i8 column,
                                                i8 row, f8 across, f8 down)
{
    /* The share of the sphere between here and the nearer pole: uniform in it, and exact there */
    i8 lower = row + row >= env->height;
    i8 near = i8_select(lower, row + 1, row), far = i8_select(lower, row, row + 1);
    f8 from = f8_select(lower, 1 - down, down);
    near = i8_select(lower, env->height - near, near);
    far = i8_select(lower, env->height - far, far);
    f8 a = f8_gather(env->row_bounds, near), b = f8_gather(env->row_bounds, far);
    f8 share = a + (b - a) * from;
    f8 radius = 2 * f8_sqrt(share * (1 - share)), z = 1 - 2 * share;
    f8 sine, cosine;
    f8_sincos_turns((f8_from_i8(column) + across) / (float)env->width, &sine, &cosine);
    return (struct vec3x8){ radius * cosine, radius * sine, f8_select(lower, -z, z) };
}

LANE_FN struct environment_sample8 environment_sample(const struct environment_table *env, f8 u,
                                                      f8 v)
{
    /* A row, and a texel in it */
    i8 U = i8_from_f8(u * 0x1p24f), V = i8_from_f8(v * 0x1p24f);
    i8 row = environment_search(env->rows, 1, I8(0), &env->row_guide, I8(0), V);
    i8 row_below = i8_gather(env->rows, row), row_end = i8_gather(env->rows + 1, row);
    const uint32_t *below = &env->texels[0].below;
    i8 first = row * (env->width + 1);
    i8 column = environment_search(below, 4, first, &env->column_guide,
                                   row * env->column_guide.size, U);
    i8 texel = first + column;
    i8 texel_below = i8_gather(below, texel * 4), texel_end = i8_gather(below + 4, texel * 4);

    /* A direction in it */
    f8 across = environment_within(U, texel_below, texel_end);
    f8 down = environment_within(V, row_below, row_end);
    struct vec3x8 w;
    if (env->layout == ENVIRONMENT_LAT_LONG) {
        w = environment_from_lat_long(env, column, row, across, down);
    } else {
        f8 scale = F8(2 / (float)env->width);
        w = environment_from_square((f8_from_i8(column) + across) * scale - 1,
                                    (f8_from_i8(row) + down) * scale - 1);
    }
    const float *m = env->to_light;
    struct environment_sample8 sample;
    sample.wi = (struct vec3x8){ w.x * m[0] + w.y * m[3] + w.z * m[6],
                                 w.x * m[1] + w.y * m[4] + w.z * m[7],
                                 w.x * m[2] + w.y * m[5] + w.z * m[8] };
    sample.L = environment_texel_radiance(env, texel);
    sample.pdf = f8_from_i8(texel_end - texel_below) * f8_gather(env->row_density, row);
    return sample;
}

#endif
