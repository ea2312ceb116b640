/*
 * Shape: those that become triangles at load, because the scene model has no others like them:
 * cylinder, bilinearmesh, loopsubdiv and curve, and spheres and disks that emit and are cut or
 * stretched. Part of the pbrt reader. False: the reader's err is set.
 *
 * How close they come is said in tessellate.h, subdivide.h and curve_mesh.h; a bilinear patch is
 * true to 1/2048 of its mesh's size. How many triangles a scene may get in this way grows with its
 * text (8 for each byte, and 262,144 to begin with), so that a small file cannot ask for all
 * memory; beyond is ERR_SCENE. Those that emit count twice, and again for every instance, as each
 * has its own.
 */
#ifndef MASTER_PBRT_CURVED_H
#define MASTER_PBRT_CURVED_H

#include "master/scene_build.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;

/* Read the current parameters and add the shape. */
bool pbrt_curved_cylinder(struct pbrt_reader *reader, const struct build_place *place);
bool pbrt_curved_bilinear(struct pbrt_reader *reader, const struct build_place *place);
bool pbrt_curved_loop(struct pbrt_reader *reader, const struct build_place *place);
bool pbrt_curved_curve(struct pbrt_reader *reader, const struct build_place *place);

/* Another instance of an object with so many triangles of these that emit. */
bool pbrt_curved_instance(struct pbrt_reader *reader, uint64_t lights,
                          const struct source_pos *pos);

/* A sphere or disk whose parameters were read. */
bool pbrt_curved_quadric(struct pbrt_reader *reader, const struct build_quadric *quadric);

#endif
