/*
 * Meshes: primitives of triangles with the material of each. Part of the glTF reader.
 */
#ifndef MASTER_GLTF_MESHES_H
#define MASTER_GLTF_MESHES_H

#include "master/gltf_json.h"
#include "master/growing.h"

#include <stdbool.h>
#include <stdint.h>

struct transform;

struct gltf_mesh {
    uint32_t uses; /* nodes that show it: more than one share a group of the build */
    bool grouped;
    uint32_t group;
    bool emits;    /* then it is copied for every use, */
    uint64_t cost; /* and takes so much of the allowance again */
    bool has_box;
    double min[3], max[3]; /* of its vertices, in its own space */
};

struct gltf_meshes {
    struct growing all; /* struct gltf_mesh, as many as the file lists */
};

bool gltf_meshes_start(struct gltf_reader *reader);
void gltf_meshes_free(struct gltf_meshes *meshes);

/* A node shows meshes[index]. */
bool gltf_meshes_use(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from);

/* Put it there, once all nodes have said what they show. */
bool gltf_meshes_add(struct gltf_reader *reader, uint32_t index, const struct transform *to_world);

#endif
