#include "master/gltf_report.h"

#include "master/gltf.h"
#include "master/gltf_reader.h"
#include "master/scene_notes.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NOTES_MOST 200 /* different notes that are kept */

struct gltf_note {
    char *text, *where;
    uint64_t count;
};

void gltf_report_free(struct gltf_report *report)
{
    struct gltf_note *notes = report->notes.data;
    for (size_t i = 0; i < report->notes.count; i++) {
        free(notes[i].text);
        free(notes[i].where);
    }
    growing_free(&report->notes);
}

/* A file's names go to the user's terminal: let them not speak to it */
static void defuse(char *text)
{
    for (; *text != '\0'; text++)
        if ((unsigned char)*text < ' ' || *text == 0x7f)
            *text = '?';
}

/* "place: " or nothing */
static const char *colon(const char *where)
{
    return where[0] == '\0' ? "" : ": ";
}

bool gltf_report_no_memory(struct gltf_reader *reader)
{
    reader->failed = true;
    return err_set(reader->err, ERR_MEMORY, "%s: no memory to read the scene", reader->report.path);
}

bool gltf_report_error(struct gltf_reader *reader, const char *where, const char *format, ...)
{
    char text[640];
    if (reader->failed)
        return false;
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    defuse(text);
    reader->failed = true;
    return err_set(reader->err, ERR_SCENE, "%s: %s%s%s", reader->report.path, where, colon(where),
                   text);
}

bool gltf_report_wrap(struct gltf_reader *reader, const char *where)
{
    reader->failed = true;
    return err_wrap(reader->err, "%s%s%s", reader->report.path, colon(where), where);
}

static void add_note(struct gltf_reader *reader, const char *where, const char *text)
{
    struct gltf_note *notes = reader->report.notes.data;
    for (size_t i = 0; i < reader->report.notes.count; i++)
        if (strcmp(notes[i].text, text) == 0) {
            notes[i].count++;
            return;
        }
    if (reader->report.notes.count == NOTES_MOST)
        return;
    struct gltf_note note = { strdup(text), strdup(where), 1 }, *added = NULL;
    if (note.text != NULL && note.where != NULL)
        added = growing_add(&reader->report.notes, 1, sizeof(*added));
    if (added == NULL) { /* a note is not worth failing for */
        free(note.text);
        free(note.where);
        return;
    }
    *added = note;
}

void gltf_report_note(struct gltf_reader *reader, const char *where, const char *format, ...)
{
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    defuse(text);
    add_note(reader, where, text);
}

bool gltf_report_later(struct gltf_reader *reader, const char *where, const char *format, ...)
{
    char what[400], text[512];
    if (reader->failed)
        return false;
    va_list args;
    va_start(args, format);
    vsnprintf(what, sizeof(what), format, args);
    va_end(args);
    defuse(what);
    if (reader->options->lenient) {
        snprintf(text, sizeof(text), "%s is not supported; the picture lacks it", what);
        add_note(reader, where, text);
        reader->report.warnings++;
        return true;
    }
    reader->failed = true;
    return err_set(reader->err, ERR_UNSUPPORTED, "%s: %s%s%s is not supported", reader->report.path,
                   where, colon(where), what);
}

void gltf_report_hand_over(const struct gltf_report *report, struct scene_notes *out)
{
    const struct gltf_note *notes = report->notes.data;
    *out = (struct scene_notes){ .warnings = report->warnings };
    out->lines = report->notes.count > 0 ? calloc(report->notes.count, sizeof(char *)) : NULL;
    for (size_t i = 0; out->lines != NULL && i < report->notes.count; i++) {
        char times[48] = "";
        if (notes[i].count > 1)
            snprintf(times, sizeof(times), " (%llu times)", (unsigned long long)notes[i].count);
        if (asprintf(&out->lines[out->count], "%s: %s%s%s%s", report->path, notes[i].where,
                     colon(notes[i].where), notes[i].text, times) >= 0)
            out->count++;
    }
}
