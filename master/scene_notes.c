#include "master/scene_notes.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NOTES_MOST 200 /* different notes that are kept */

struct note {
    char *where, *text;
    uint64_t count;
};

void scene_notes_free(struct scene_notes *notes)
{
    for (size_t i = 0; i < notes->count; i++)
        free(notes->lines[i]);
    free(notes->lines);
    *notes = (struct scene_notes){ 0 };
}

void scene_notes_draft_free(struct scene_notes_draft *draft)
{
    struct note *notes = draft->notes.data;
    for (size_t i = 0; i < draft->notes.count; i++) {
        free(notes[i].where);
        free(notes[i].text);
    }
    growing_free(&draft->notes);
}

void scene_notes_add(struct scene_notes_draft *draft, const char *where, const char *text)
{
    struct note *notes = draft->notes.data;
    for (size_t i = 0; i < draft->notes.count; i++)
        if (strcmp(notes[i].text, text) == 0) {
            notes[i].count++;
            return;
        }
    if (draft->notes.count == NOTES_MOST)
        return;
    struct note note = { strdup(where), strdup(text), 1 }, *added = NULL;
    if (note.where != NULL && note.text != NULL)
        added = growing_add(&draft->notes, 1, sizeof(*added));
    if (added == NULL) { /* a note is not worth failing for */
        free(note.where);
        free(note.text);
        return;
    }
    *added = note;
}

struct scene_notes scene_notes_of(const struct scene_notes_draft *draft, uint64_t warnings)
{
    const struct note *notes = draft->notes.data;
    struct scene_notes out = { .warnings = warnings };
    if (draft->notes.count > 0)
        out.lines = calloc(draft->notes.count, sizeof(*out.lines));
    for (size_t i = 0; out.lines != NULL && i < draft->notes.count; i++) {
        char times[48] = "";
        if (notes[i].count > 1)
            snprintf(times, sizeof(times), " (%llu times)", (unsigned long long)notes[i].count);
        if (asprintf(&out.lines[out.count], "%s: %s%s", notes[i].where, notes[i].text, times) >= 0)
            out.count++;
    }
    return out;
}
