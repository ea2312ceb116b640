/*
 * Instancing: ObjectBegin, ObjectEnd, ObjectInstance. Part of the pbrt reader.
 *
 * Not supported yet. When lenient, an object's shapes are read past and its instances left out;
 * its block saves the graphics state like any other.
 */
#ifndef MASTER_PBRT_OBJECTS_H
#define MASTER_PBRT_OBJECTS_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

struct pbrt_objects {
    struct growing open; /* struct source_pos: of their ObjectBegin */
};
void pbrt_objects_free(struct pbrt_objects *objects);

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_objects_begin(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_objects_end(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_objects_instance(struct pbrt_reader *reader, const struct pbrt_token *directive);

/* Is a shape read now part of an object, rather than of the scene? */
bool pbrt_objects_inside(const struct pbrt_objects *objects);

#endif
