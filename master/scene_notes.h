/*
 * What a reader tells beside the scene it returns: lines worth telling the user. Equal ones are
 * counted, not repeated. The caller's to free, also after an error.
 */
#ifndef MASTER_SCENE_NOTES_H
#define MASTER_SCENE_NOTES_H

#include <stddef.h>
#include <stdint.h>

struct scene_notes {
    char **lines;
    size_t count;
    uint64_t warnings; /* how often something unsupported was skipped or replaced (lenient) */
};
void scene_notes_free(struct scene_notes *notes);

#endif
