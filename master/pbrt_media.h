/*
 * Participating media: MakeNamedMedium, and MediumInterface, which says what is inside and outside
 * of the surfaces after it. Part of the pbrt reader.
 *
 * Not supported yet. When lenient, they are read past and everything stands in vacuum.
 */
#ifndef MASTER_PBRT_MEDIA_H
#define MASTER_PBRT_MEDIA_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_media_define(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_media_interface(struct pbrt_reader *reader, const struct pbrt_token *directive);

#endif
