/*
 * Shape: meshes, in the text or in PLY files, spheres and disks, placed by the graphics state; what
 * else there is, is made of triangles by pbrt_curved. Part of the pbrt reader. False: the reader's
 * err is set.
 */
#ifndef MASTER_PBRT_SHAPES_H
#define MASTER_PBRT_SHAPES_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

/* The parameters were read; `type` is the quoted name. */
bool pbrt_shapes_add(struct pbrt_reader *reader, const struct pbrt_token *type);

#endif
