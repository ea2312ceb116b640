/*
 * Materials: metallic-roughness and the KHR_materials extensions (what is made of which is told in
 * gltf.h). Part of the glTF reader.
 */
#ifndef MASTER_GLTF_MATERIALS_H
#define MASTER_GLTF_MATERIALS_H

#include "master/gltf_json.h"
#include "master/growing.h"
#include "master/scene_coats.h"

#include <stdbool.h>
#include <stdint.h>

/* What a primitive takes from its material. */
struct gltf_surface {
    uint32_t material; /* index among the scene's */
    uint32_t emitter;  /* index among the build's, or SCENE_NONE */
    uint32_t alpha;    /* texture, 1 + index, or 0 */
    uint32_t inside;   /* medium, 1 + index, or 0 */
    uint32_t set;      /* of texture coordinates, or SCENE_NONE when none are needed */
    bool done;
};

struct gltf_materials {
    struct growing surfaces; /* struct gltf_surface: two of each material, and of the default */
    struct scene_coats coats;
};

bool gltf_materials_start(struct gltf_reader *reader);
void gltf_materials_free(struct gltf_materials *materials);

/* materials[index], or the default for SCENE_NONE; `colored` when the mesh has vertex colours. */
bool gltf_materials_use(struct gltf_reader *reader, uint32_t index, bool colored,
                        const struct gltf_item *from, struct gltf_surface *surface);

#endif
