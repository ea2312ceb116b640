/*
 * Bounds of shapes in the making, in double and in the file's own coordinates, and the origin that
 * a scene or a group is moved to. Part of scene_build and scene_groups.
 */
#ifndef MASTER_SCENE_BOUNDS_H
#define MASTER_SCENE_BOUNDS_H

#include "master/scene_build.h"

#include <string.h>

struct scene_bounds {
    double min[3], max[3];
};

struct scene_bounds scene_bounds_empty(void);
bool scene_bounds_is_empty(const struct scene_bounds *bounds);
void scene_bounds_add(struct scene_bounds *bounds, const double p[3]);

/* Where a shape is after its own to_world: of a group, in the space of the group. */
void scene_bounds_add_mesh(struct scene_bounds *bounds, const struct scene_build *build,
                           const struct build_mesh *mesh);
void scene_bounds_add_quadric(struct scene_bounds *bounds, const struct build_quadric *quadric);

/* Everything inside of a box, wherever the transform takes it */
void scene_bounds_add_box(struct scene_bounds *bounds, const struct scene_bounds *box,
                          const struct transform *to_world);

/* The file's position of vertex i of a mesh after its to_world; a quadric's centre likewise. */
static inline void scene_bounds_vertex(const struct scene_build *build,
                                       const struct build_mesh *mesh, uint32_t i, double world[3])
{
    const float *narrow = (const float *)build->vertices.positions.data +
                          3 * ((size_t)mesh->range.first_vertex + i);
    double p[3] = { narrow[0], narrow[1], narrow[2] };
    if (mesh->wide != NULL)
        memcpy(p, mesh->wide + 3 * (size_t)i, sizeof(p));
    transform_point(&mesh->place.to_world, p, world);
}
void scene_bounds_quadric_center(const struct build_quadric *quadric, double center[3]);

/* The point that becomes the origin: see scene_build.h. */
void scene_bounds_center(const struct scene_bounds *bounds, double center[3]);

#endif
