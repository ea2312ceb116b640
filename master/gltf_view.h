/*
 * Cameras, and the view of everything for files without one. Part of the glTF reader.
 */
#ifndef MASTER_GLTF_VIEW_H
#define MASTER_GLTF_VIEW_H

#include "common/scene.h"
#include "master/gltf_json.h"
#include "master/transform.h"

#include <stdbool.h>
#include <stdint.h>

struct gltf_view {
    unsigned cameras; /* nodes with one, so far */
    bool found;       /* the camera that is wanted */
    enum camera_kind kind;
    double half_height, aspect; /* of the screen at distance 1, or of the view; 0: not said */
    struct transform world_from_camera;
    char name[80];   /* of the camera that is used */
    char names[320]; /* of all of them */
    bool has_bounds;
    double min[3], max[3]; /* of all that can be seen */
};

/* If the node has a camera: take it if it is the one. */
bool gltf_view_camera(struct gltf_reader *reader, const struct gltf_item *node,
                      const struct transform *to_world);

/* A box stands in the world. */
void gltf_view_enclose(struct gltf_reader *reader, const double min[3], const double max[3],
                       const struct transform *to_world);

/* Into the scene's settings. */
bool gltf_view_finish(struct gltf_reader *reader);

#endif
