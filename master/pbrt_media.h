/*
 * Participating media: MakeNamedMedium, and MediumInterface, which says what is inside and outside
 * of the shapes after it, and around a camera. Part of the pbrt reader.
 *
 * As in pbrt-v4 a medium may be named before it is defined. It joins the scene when a shape with
 * two different sides, or the camera, uses it, so that what is not used calls for no effect.
 */
#ifndef MASTER_PBRT_MEDIA_H
#define MASTER_PBRT_MEDIA_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;
struct scene;

struct pbrt_media {
    struct growing named; /* struct pbrt_medium: everything that has a name */
};
void pbrt_media_free(struct pbrt_media *media);

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_media_define(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_media_interface(struct pbrt_reader *reader, const struct pbrt_token *directive);

/* The medium `named` of the graphics state (1 + index, or 0 for vacuum) as one of the scene's, also
 * 1 + index or 0. */
bool pbrt_media_resolve(struct pbrt_reader *reader, uint32_t named, uint32_t *in_scene);

/* At the end: every name must mean something, and the media that the scene uses are completed. */
bool pbrt_media_finish(struct pbrt_reader *reader);

/* Tell what may surprise in the finished scene. */
void pbrt_media_note(struct pbrt_reader *reader, const struct scene *scene);

#endif
