/*
 * Materials: the current one, those with a name, and their way into the scene. Part of the pbrt
 * reader.
 *
 * A material is kept as it was written and joins the scene when a shape uses it, so that what is
 * not used calls for no effect; a mix finds its two materials then, too, whatever their order in
 * the text. Equal coats share one table.
 */
#ifndef MASTER_PBRT_MATERIALS_H
#define MASTER_PBRT_MATERIALS_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"
#include "master/scene_coats.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;

struct pbrt_materials {
    struct growing definitions; /* struct pbrt_material: as written */
    struct growing names;       /* struct pbrt_material_name: MakeNamedMaterial */
    struct growing mix_names;   /* struct pbrt_token: what mixes refer to */
    bool diffuse;               /* option "forcediffuse" */
    struct scene_coats coats;
};

/* Define pbrt's default, grey diffuse, and make it the current one. */
bool pbrt_materials_start(struct pbrt_reader *reader);
void pbrt_materials_free(struct pbrt_materials *materials);

/* Material and MakeNamedMaterial, whose parameters were read, and NamedMaterial. */
bool pbrt_materials_set(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_materials_define(struct pbrt_reader *reader, const struct pbrt_token *name);
bool pbrt_materials_use(struct pbrt_reader *reader, const struct pbrt_token *name);

/* The current one, as an index among the scene's materials; SCENE_NONE: an interface, which is not
 * there. */
bool pbrt_materials_resolve(struct pbrt_reader *reader, uint32_t *in_scene);

/* At the end: the names of those that the scene uses become the scene's, and what "forcediffuse"
 * says happens to them. */
bool pbrt_materials_finish(struct pbrt_reader *reader);

#endif
