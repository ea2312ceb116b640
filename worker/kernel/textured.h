/*
 * What textures make of a surface: the material that a lane's path meets, and the normal that a map
 * or a bump gives it. The kernel calls this lane by lane, as textures branch too much for vectors.
 */
#ifndef WORKER_KERNEL_TEXTURED_H
#define WORKER_KERNEL_TEXTURED_H

#include "worker/kernel/texture.h"

enum textured_part {
    TEXTURED_VALUES = 1,  /* any slot but these: */
    TEXTURED_NORMALS = 2, /* SLOT_NORMAL, SLOT_BUMP */
};

/* What of the material textures decide, as bits of enum textured_part. */
uint32_t textured_parts(const struct material *material);

/*
 * The parameters that have a texture, at one point. Reflectances are clamped to [0, 1], and nothing
 * that is not finite gets through. The rules for roughness and for a metal's reflectance are those
 * of the pbrt reader. A coat keeps the table of its own roughness, or the nearest that it has.
 */
void textured_material(const struct texture_set *set, const struct texture_point *point,
                       struct material *material);

/* The share of a mix's second material, in [0, 1]. */
float textured_amount(const struct texture_set *set, const struct texture_point *point,
                      const struct material *material);

/*
 * Change the shading normal `ns` as the material's normal map and then its bump say, by way of the
 * slope of the displacement. Bit for bit as it was where they say nothing. wo is where the light
 * goes: a normal turned so far that its surface could not be seen from there is turned back until
 * it just can.
 *
 * The map's x runs along dpdu, its y to the side of dpdv at right angles to it; pbrt-v4 takes
 * n x dpdu there, which turns mirrored maps inside out.
 */
void textured_normal(const struct texture_set *set, const struct texture_point *point,
                     const struct material *material, const float wo[3], float ns[3]);

#endif
