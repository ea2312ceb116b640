#include "master/scene_notes.h"

#include <stdlib.h>

void scene_notes_free(struct scene_notes *notes)
{
    for (size_t i = 0; i < notes->count; i++)
        free(notes->lines[i]);
    free(notes->lines);
    *notes = (struct scene_notes){ 0 };
}
