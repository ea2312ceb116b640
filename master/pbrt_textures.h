/*
 * Named textures: Texture "name" "float|spectrum" "class" parameters, and what may stand where a
 * parameter is a number, a colour or the name of one. Part of the pbrt reader.
 *
 * A texture is kept as it was written and joins the scene, with its picture, when a material or a
 * shape that is used has it. One that does not vary is the number or colour that it always is, so
 * that it calls for no effect. Float and spectrum textures have names of their own.
 */
#ifndef MASTER_PBRT_TEXTURES_H
#define MASTER_PBRT_TEXTURES_H

#include "master/growing.h"
#include "master/pbrt_params.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;

struct pbrt_textures {
    struct growing definitions; /* struct pbrt_texture: as written */
    bool unfiltered;            /* option "disabletexturefiltering" */
};
void pbrt_textures_free(struct pbrt_textures *textures);

/* A directive: reads what follows its word. False: the reader's err is set. */
bool pbrt_textures_define(struct pbrt_reader *reader, const struct pbrt_token *directive);

/*
 * Where a parameter names a texture of that type: 1 + its definition, and the parameter is gone. A
 * texture that does not vary is 0, and the parameter has its number or rgb colour from now on; so
 * is what is no texture, or failed (params->failed). Call before reading the number.
 */
uint32_t pbrt_textures_take(struct pbrt_params *params, const char *name, bool spectrum);

/* "string normalmap": 0 when absent, or 1 + the definition of its picture. */
uint32_t pbrt_textures_normal_map(struct pbrt_params *params, const char *name);

/* Into the scene: *texture, 1 + a definition, becomes 1 + an index there; 0 stays. False: the
 * reader's err is set. */
bool pbrt_textures_resolve(struct pbrt_reader *reader, uint32_t *texture);

/* The same of a number, for where the scene has no place for one. */
bool pbrt_textures_resolve_number(struct pbrt_reader *reader, double value, uint32_t *texture);

/* At the end: what the option says. */
void pbrt_textures_finish(struct pbrt_reader *reader);

#endif
