/*
 * The pbrt reader from inside: all that it holds while it reads one scene, each member beside the
 * name of the file that looks after it. A directive's function gets all of it. Nothing outside
 * master/pbrt*.c includes this.
 */
#ifndef MASTER_PBRT_READER_H
#define MASTER_PBRT_READER_H

#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt_lexer.h"
#include "master/pbrt_materials.h"
#include "master/pbrt_media.h"
#include "master/pbrt_names.h"
#include "master/pbrt_objects.h"
#include "master/pbrt_params.h"
#include "master/pbrt_report.h"
#include "master/pbrt_state.h"
#include "master/pbrt_textures.h"
#include "master/pbrt_transforms.h"
#include "master/pbrt_view.h"
#include "master/scene_build.h"
#include "master/scene_pictures.h"

struct pbrt_reader {
    struct err *err; /* set when any function of the reader returns false */
    struct pbrt_report report;

    struct pbrt_lexer *lexer;  /* what is still to be read */
    struct pbrt_params params; /* of the current directive */
    bool in_world;             /* after WorldBegin */

    struct pbrt_state state; /* what the next shape or light takes with it */
    struct pbrt_stack stack; /* ... and what the states around it were */
    struct pbrt_spaces spaces;
    struct pbrt_objects objects;
    struct pbrt_materials materials;
    struct pbrt_textures textures;
    struct pbrt_media media;

    struct scene_pictures pictures; /* that were read already */

    uint64_t curved_triangles; /* pbrt_curved: so far */

    struct pbrt_view view;
    struct scene_build *build; /* the scene so far */
};

#endif
