/*
 * How much of the light that falls on a surface comes back, whatever its direction: the mean of a
 * material's albedo over the hemisphere, weighted by the cosine. For the option "forcediffuse", in
 * which pbrt makes every surface diffuse with its albedo. Pure.
 *
 * Rough metal counts as smooth, which loses nothing between its facets. What is transmitted counts
 * as pbrt-v4's estimate does: as radiance, which glass makes smaller by the square of its index.
 */
#ifndef MASTER_ALBEDO_H
#define MASTER_ALBEDO_H

#include "common/scene.h"

/* `coat_tables` are the scene's; any material but MATERIAL_MIX. Textures are not looked at. */
void albedo_of(const struct material *material, const float *coat_tables, double rgb[3]);

#endif
