/*
 * Point, spot and directional lights (KHR_lights_punctual), and the sky that stands in where there
 * is no light at all. Part of the glTF reader; units are told in gltf.h.
 */
#ifndef MASTER_GLTF_LIGHTS_H
#define MASTER_GLTF_LIGHTS_H

#include "master/gltf_json.h"

#include <stdbool.h>

struct transform;

struct gltf_lights {
    double unit; /* radiant intensity of one candela */
};

bool gltf_lights_start(struct gltf_reader *reader);

/* If the node has a light: put it there. */
bool gltf_lights_add(struct gltf_reader *reader, const struct gltf_item *node,
                     const struct transform *to_world);

/* Once all meshes and lights are there. */
void gltf_lights_finish(struct gltf_reader *reader);

#endif
