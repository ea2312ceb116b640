/*
 * What a reader tells beside the scene it returns: lines worth telling the user. Equal ones are
 * counted, not repeated.
 */
#ifndef MASTER_SCENE_NOTES_H
#define MASTER_SCENE_NOTES_H

#include "master/growing.h"

#include <stddef.h>
#include <stdint.h>

/* The caller's to free, also after an error. */
struct scene_notes {
    char **lines;
    size_t count;
    uint64_t warnings; /* how often something unsupported was skipped or replaced (lenient) */
};
void scene_notes_free(struct scene_notes *notes);

/* Notes while a reader collects them; zero-initialised at first. */
struct scene_notes_draft {
    struct growing notes;
};
void scene_notes_draft_free(struct scene_notes_draft *draft);

/* A note on what is at `where` ("file:line:column"). An equal text is counted, and stays where it
 * was first; beyond a few hundred different ones, or without memory, a note is lost. */
void scene_notes_add(struct scene_notes_draft *draft, const char *where, const char *text);

/* "where: text", in the order they came up. */
struct scene_notes scene_notes_of(const struct scene_notes_draft *draft, uint64_t warnings);

#endif
