/*
 * About how much a texture emits over a triangle or a quadric: by it lights are chosen, so it need
 * not be right. Pictures, constants and their products are read at points spread evenly over the
 * surface; whatever else a texture is made of counts as one.
 *
 * `budget` is how many texels may still be looked at, for all the triangles of a scene together,
 * and goes down: without any left, the answers are coarse. Pure.
 */
#ifndef MASTER_SCENE_EMISSION_H
#define MASTER_SCENE_EMISSION_H

#include <stdbool.h>
#include <stdint.h>

#define SCENE_EMISSION_BUDGET 2e7 /* a few seconds */

struct quadric;
struct scene;

/* The mean of scene->textures[texture] over the triangle with these texture coordinates. False: it
 * is black all over, for certain. */
bool scene_emission_triangle(const struct scene *scene, uint32_t texture, const double uv[3][2],
                             double *budget, double mean[3]);

void scene_emission_quadric(const struct scene *scene, uint32_t texture,
                            const struct quadric *quadric, double mean[3]);

#endif
