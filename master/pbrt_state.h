/*
 * The graphics state of pbrt: what a shape or light takes with it from the directives before it.
 * AttributeBegin and ObjectBegin save it, the matching End brings it back. Part of the pbrt
 * reader; whoever adds to the state adds a member here, and it is saved and restored.
 *
 * Here are the stack and the directives that set a member without more ado; the transform is set
 * by pbrt_transforms, the material by pbrt_materials, the area light by pbrt_lights.
 */
#ifndef MASTER_PBRT_STATE_H
#define MASTER_PBRT_STATE_H

#include "master/color_space.h"
#include "master/growing.h"
#include "master/pbrt_params.h"
#include "master/transform.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct pbrt_reader;

/* What Attribute may give parameters to; TARGET_NONE, which it cannot name, never has any. */
enum pbrt_target {
    TARGET_NONE,
    TARGET_SHAPE,
    TARGET_LIGHT,
    TARGET_MATERIAL,
    TARGET_MEDIUM,
    TARGET_TEXTURE,
    TARGETS
};

struct pbrt_state {
    struct transform ctm;     /* world from object, or camera from world before WorldBegin */
    struct transform ctm_end; /* the same at the end of a motion; equal to ctm if there is none */
    bool reverse_orientation;
    enum color_space color_space; /* of rgb parameters */
    bool fixed_start, fixed_end;  /* ActiveTransform: of these two, the other is meant alone */
    uint32_t material;            /* index of a definition */
    uint32_t emitter;             /* index of an area light, or SCENE_NONE */
    uint32_t inside, outside;     /* 1 + index of a named medium, or 0 for vacuum */
    struct {
        size_t items, numbers, strings; /* how much of stack.defaults there was; on the stack */
    } defaults[TARGETS];
};

struct pbrt_stack {
    struct growing frames;                /* struct pbrt_frame: the blocks that are open */
    size_t imports;                       /* how many of them are imported files */
    struct pbrt_params defaults[TARGETS]; /* of Attribute, of all open blocks */
};

void pbrt_state_start(struct pbrt_reader *reader);
bool pbrt_state_moves(const struct pbrt_state *state);
void pbrt_state_free(struct pbrt_stack *stack);

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_state_attribute_begin(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_state_attribute_end(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_state_attribute(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_state_reverse_orientation(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_state_color_space(struct pbrt_reader *reader, const struct pbrt_token *directive);

/*
 * Import: what the imported file does to the state ends with it. The block begins when its file was
 * opened; before every directive, those end whose file has (an error if a block inside is open).
 */
bool pbrt_state_import(struct pbrt_reader *reader, const struct pbrt_token *name);
bool pbrt_state_end_imports(struct pbrt_reader *reader);

/* At the end of the text: an error at the innermost block that was not closed. */
bool pbrt_state_closed(struct pbrt_reader *reader);

#endif
