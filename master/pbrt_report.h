/*
 * What the pbrt reader tells its user: one error, which ends it, or notes, which do not. Part of
 * the pbrt reader; every file of it says what is wrong through these functions and nothing else.
 *
 * An error begins with file:line:column. Equal notes are one, with the position of the first and a
 * count; beyond a few hundred different ones, or without memory, a note is lost and nothing fails.
 */
#ifndef MASTER_PBRT_REPORT_H
#define MASTER_PBRT_REPORT_H

#include "master/scene_notes.h"
#include "master/source_pos.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;

struct pbrt_report {
    bool lenient;      /* what is not supported yet is a note, not an error */
    uint64_t warnings; /* how often it was */
    struct scene_notes_draft notes;
};

/* ERR_SCENE: the text is wrong. Always false. */
bool pbrt_report_error(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                       ...) __attribute__((format(printf, 3, 4)));

/* Something pbrt has and we do not: false and ERR_UNSUPPORTED, or, when lenient, true and a note.
 * The text continues "... is not supported yet". */
bool pbrt_report_later(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                       ...) __attribute__((format(printf, 3, 4)));

/* Worth telling, and no reason to stop. */
void pbrt_report_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                      ...) __attribute__((format(printf, 3, 4)));

/* ERR_MEMORY; always false. */
bool pbrt_report_no_memory(struct pbrt_reader *reader);

#endif
