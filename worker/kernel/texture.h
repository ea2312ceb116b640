/*
 * Textures (struct texture, common/scene.h): their value at one point of a surface. Scalar and
 * compiled once, so both instruction sets get the same bits; only + - * /, sqrt and common/elem.h
 * decide them (and floor, fmod and the like, which are exact).
 *
 * A texture and all it is made of is a list of steps, children first: evaluating it neither
 * recurses nor computes anything twice. What is made of more than TEXTURE_STEPS is refused.
 *
 * Pictures with a pyramid are filtered between the two levels that the footprint lies between,
 * bilinearly in each; without, bilinearly in the only level. A footprint of zero reads the full
 * size. The filter is round: at grazing angles it is sharper than pbrt's trilinear one and aliases
 * more, which samples average. Noises leave out the octaves that a footprint hides, as pbrt-v4's
 * do.
 *
 * A set is read-only once open; any number of threads evaluate it.
 */
#ifndef WORKER_KERNEL_TEXTURE_H
#define WORKER_KERNEL_TEXTURE_H

#include "common/scene.h"

#include <stdbool.h>
#include <stdint.h>

#define TEXTURE_STEPS 64

struct texture_set;

/* Keeps a pointer to the scene, which scene_check has passed. NULL with err set on failure;
 * texture_set_close(NULL) does nothing. */
struct texture_set *texture_set_open(const struct scene *scene, struct err *err);
void texture_set_close(struct texture_set *set);

/* Where a texture is evaluated */
struct texture_point {
    float uv[2];
    float p[3];             /* world, re-centred */
    float n[3];             /* geometric normal, unit */
    float dpdu[3], dpdv[3]; /* of p */
    float width;            /* of the footprint, in world units; 0: none */
    float color[4];         /* of the mesh's vertices; white where there are none */
};

/* Texture `index` there. Not clamped: negative, huge and not even finite where the data are. */
void texture_at(const struct texture_set *set, uint32_t index, const struct texture_point *point,
                float rgb[3]);

/* Does any part of it depend on p, rather than on uv alone? */
bool texture_uses_p(const struct texture_set *set, uint32_t index);

/* The directions in which u and v grow fastest, as gradients along the surface; zero where uv does
 * not tell one direction from another. */
void texture_gradients(const struct texture_point *point, float du[3], float dv[3]);

/* A half-precision float; every one is a float. */
float texture_half(uint16_t bits);

#endif
