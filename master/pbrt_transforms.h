/*
 * The directives that move things: they change the current transform (the state's ctm), name it,
 * or come back to one that was named. Part of the pbrt reader.
 *
 * All of them end in one place that sets the transform and refuses one that cannot be inverted;
 * ActiveTransform says there which of the two ends of a motion is meant.
 */
#ifndef MASTER_PBRT_TRANSFORMS_H
#define MASTER_PBRT_TRANSFORMS_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"
#include "master/transform.h"

#include <stdbool.h>

struct pbrt_reader;

struct pbrt_spaces {
    struct growing named;        /* struct pbrt_space: CoordinateSystem */
    struct transform camera;     /* the one called "camera": world from camera */
    struct transform camera_end; /* where it moves to */
    double times[2];             /* TransformTimes: of the two ends of every motion */
};
void pbrt_transforms_start(struct pbrt_spaces *spaces);
void pbrt_transforms_free(struct pbrt_spaces *spaces);

/* Directives: each reads what follows its word. False: the reader's err is set. */
bool pbrt_transforms_identity(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_translate(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_scale(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_rotate(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_look_at(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_set(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_concat(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_name(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_recall(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_active(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_transforms_times(struct pbrt_reader *reader, const struct pbrt_token *directive);

#endif
