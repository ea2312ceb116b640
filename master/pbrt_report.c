#include "master/pbrt_report.h"

#include "common/err.h"
#include "master/pbrt_reader.h"
#include "master/scene_notes.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NOTES_MOST 200 /* different notes that are kept */

struct pbrt_note {
    char *text;
    struct source_pos pos;
    uint64_t count;
};

void pbrt_report_free(struct pbrt_report *report)
{
    struct pbrt_note *notes = report->notes.data;
    for (size_t i = 0; i < report->notes.count; i++)
        free(notes[i].text);
    growing_free(&report->notes);
}

bool pbrt_report_no_memory(struct pbrt_reader *reader)
{
    return err_set(reader->err, ERR_MEMORY, "no memory to read the scene");
}

bool pbrt_report_error(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                       ...)
{
    char text[768];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    return err_set(reader->err, ERR_SCENE, "%s:%d:%d: %s", pos->path, pos->line, pos->column, text);
}

static void add_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *text)
{
    struct pbrt_note *notes = reader->report.notes.data;
    for (size_t i = 0; i < reader->report.notes.count; i++)
        if (strcmp(notes[i].text, text) == 0) {
            notes[i].count++;
            return;
        }
    if (reader->report.notes.count == NOTES_MOST)
        return;
    char *copy = strdup(text);
    struct pbrt_note *added = copy != NULL ? growing_add(&reader->report.notes, 1, sizeof(*added))
                                           : NULL;
    if (added == NULL) {
        free(copy); /* a note is not worth failing for */
        return;
    }
    *added = (struct pbrt_note){ copy, *pos, 1 };
}

void pbrt_report_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                      ...)
{
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    add_note(reader, pos, text);
}

bool pbrt_report_later(struct pbrt_reader *reader, const struct source_pos *pos, const char *format,
                       ...)
{
    char what[400], text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(what, sizeof(what), format, args);
    va_end(args);
    if (!reader->report.lenient)
        return err_set(reader->err, ERR_UNSUPPORTED, "%s:%d:%d: %s is not supported yet", pos->path,
                       pos->line, pos->column, what);
    snprintf(text, sizeof(text), "%s is not supported yet; the picture lacks it", what);
    add_note(reader, pos, text);
    reader->report.warnings++;
    return true;
}

void pbrt_report_hand_over(const struct pbrt_report *report, struct scene_notes *out)
{
    const struct pbrt_note *notes = report->notes.data;
    *out = (struct scene_notes){ .warnings = report->warnings };
    out->lines = report->notes.count > 0 ? calloc(report->notes.count, sizeof(char *)) : NULL;
    for (size_t i = 0; out->lines != NULL && i < report->notes.count; i++) {
        char where[32] = "", times[48] = "";
        if (notes[i].pos.line > 0)
            snprintf(where, sizeof(where), ":%d:%d", notes[i].pos.line, notes[i].pos.column);
        if (notes[i].count > 1)
            snprintf(times, sizeof(times), " (%llu times)", (unsigned long long)notes[i].count);
        if (asprintf(&out->lines[out->count], "%s%s: %s%s", notes[i].pos.path, where, notes[i].text,
                     times) >= 0)
            out->count++;
    }
}
