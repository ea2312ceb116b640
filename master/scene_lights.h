/*
 * Lights from what emits: the triangles of a mesh become convex polygon lights (two coplanar
 * triangles of a quad are one light), spheres and disks one light each; then every light gets the
 * probability with which light sampling chooses it.
 *
 * With a texture, or on a mesh that is there in part, every triangle is a light; its radiance is
 * the texture's mean over it (scene_emission.h), and one that is black all over is no light. What
 * emits and has no material is not there for any ray, and lights all the same (LIGHT_UNSEEN).
 */
#ifndef MASTER_SCENE_LIGHTS_H
#define MASTER_SCENE_LIGHTS_H

#include "master/growing.h"
#include "master/source_pos.h"

#include <stdbool.h>
#include <stdint.h>

struct err;
struct light;
struct scene;

/* What an area light directive says. */
struct emitter {
    double radiance[3];
    double power;      /* watts of every triangle or quadric, in place of a scale; 0: not given */
    double whole_area; /* what sends the power together; 0: every triangle or quadric alone */
    bool two_sided;
    uint32_t texture; /* 1 + index: radiance is a factor of it, and grey; or 0 */
    struct source_pos pos;
};

/* The light arrays of a scene in the making. */
struct light_arrays {
    struct growing lights;         /* struct light */
    struct growing corners;        /* 3 floats each */
    struct growing triangle_light; /* uint32_t */
    double looks_taken;            /* of SCENE_EMISSION_BUDGET */
};

/*
 * Make mesh (or quadric) `index` of the scene emit. Its triangles must be final: re-centred, wound,
 * none degenerate. ERR_SCENE when it has no area, ERR_UNSUPPORTED for quadrics that are cut or
 * not similar to themselves.
 */
bool scene_lights_add_mesh(struct scene *scene, uint32_t index, const struct emitter *emitter,
                           struct light_arrays *arrays, struct err *err);
bool scene_lights_add_quadric(struct scene *scene, uint32_t index, const struct emitter *emitter,
                              struct light_arrays *arrays, struct err *err);

/* Give a sky its portal: a rectangle, re-centred, counter-clockwise seen from where it shines. */
bool scene_lights_add_portal(struct light *sky, const double corners[4][3],
                             struct light_arrays *arrays, struct err *err);

/*
 * Choose lights by power: area x luminance x pi (twice for two sides), 4 pi I for a point, what a
 * distant light or the sky sends through the scene's bounding sphere. A light that emits anything
 * keeps a chance, however weak beside others. Sums to 1 in double, then rounded to float32.
 */
bool scene_lights_pick(struct scene *scene, struct err *err);

#endif
