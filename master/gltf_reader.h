/*
 * The glTF reader from inside: all that it holds while it reads one scene, each member beside the
 * name of the file that looks after it. Nothing outside master/gltf*.c includes this.
 */
#ifndef MASTER_GLTF_READER_H
#define MASTER_GLTF_READER_H

#include "common/err.h"
#include "common/scene.h"
#include "master/gltf_file.h"
#include "master/gltf_json.h"
#include "master/gltf_lights.h"
#include "master/gltf_materials.h"
#include "master/gltf_meshes.h"
#include "master/gltf_nodes.h"
#include "master/gltf_report.h"
#include "master/gltf_textures.h"
#include "master/gltf_view.h"
#include "master/scene_build.h"

struct gltf_reader {
    const struct gltf_options *options;
    struct err *err; /* set when any function of the reader returns false */
    bool failed;     /* by a function that returns a value: look before it is used */
    struct gltf_report report;

    struct gltf_file file;
    struct gltf_textures textures;
    struct gltf_materials materials;
    struct gltf_meshes meshes;
    struct gltf_nodes nodes;
    struct gltf_lights lights;
    struct gltf_view view;
    struct scene_build *build; /* the scene so far */
};

#endif
