/*
 * Instancing: ObjectBegin, ObjectEnd, ObjectInstance. Part of the pbrt reader.
 *
 * An object is a group of scene_build: its shapes stand where their transforms put them, as if they
 * were in the world, and ObjectInstance moves all of that by the transform then current. As in
 * pbrt-v4, objects have one definition each, hold no objects and no instances, and their blocks
 * save the graphics state like any other. Unlike there, shapes of an object may emit.
 */
#ifndef MASTER_PBRT_OBJECTS_H
#define MASTER_PBRT_OBJECTS_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct pbrt_reader;

struct pbrt_objects {
    struct growing named;   /* struct pbrt_object */
    bool open;              /* the last of them is being defined */
    size_t frame;           /* then: how many blocks are open, its own included */
    uint64_t curved_lights; /* ... and how many of pbrt_curved's triangles in it emit */
};
void pbrt_objects_free(struct pbrt_objects *objects);

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_objects_begin(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_objects_end(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_objects_instance(struct pbrt_reader *reader, const struct pbrt_token *directive);

/* May the innermost block end with this directive? An error where it is the object's. */
bool pbrt_objects_may_close(struct pbrt_reader *reader, const struct pbrt_token *directive);

/* Is a shape read now part of an object, rather than of the scene? */
bool pbrt_objects_inside(const struct pbrt_objects *objects);

#endif
