/*
 * What the glTF reader tells its user: one error, which ends it, or notes, which do not. Part of
 * the glTF reader; every file of it says what is wrong through these functions.
 *
 * `where` is a place in the file, "materials[3]"; "" is the file itself. Equal notes are one, with
 * the place of the first and a count. Text from the file is shown without control characters.
 */
#ifndef MASTER_GLTF_REPORT_H
#define MASTER_GLTF_REPORT_H

#include "master/scene_notes.h"

#include <stdbool.h>
#include <stdint.h>

struct gltf_reader;

struct gltf_report {
    const char *path;  /* of the file, as the user calls it */
    uint64_t warnings; /* how often the file asked in vain, when lenient */
    struct scene_notes_draft notes;
};

/* ERR_SCENE: the file is wrong. Sets reader->failed; always false. An earlier error stays. */
bool gltf_report_error(struct gltf_reader *reader, const char *where, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Something that glTF has and we do not: false and ERR_UNSUPPORTED, or, when lenient, true and a
 * note. The text continues "... is not supported". */
bool gltf_report_later(struct gltf_reader *reader, const char *where, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Worth telling, and no reason to stop. */
void gltf_report_note(struct gltf_reader *reader, const char *where, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Put the file and `where` in front of an error that a function outside of the reader set; false.
 */
bool gltf_report_wrap(struct gltf_reader *reader, const char *where);

/* ERR_MEMORY; always false. */
bool gltf_report_no_memory(struct gltf_reader *reader);

#endif
