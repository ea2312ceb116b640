/*
 * Named textures: Texture "name" "float|spectrum" "class" parameters. Part of the pbrt reader.
 *
 * Not supported yet, neither here nor where a parameter names one (pbrt_params, pbrt_color). When
 * lenient, they are read past.
 */
#ifndef MASTER_PBRT_TEXTURES_H
#define MASTER_PBRT_TEXTURES_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

/* A directive: reads what follows its word. False: the reader's err is set. */
bool pbrt_textures_define(struct pbrt_reader *reader, const struct pbrt_token *directive);

#endif
