#include "master/pbrt_report.h"

#include "common/err.h"
#include "master/pbrt_reader.h"

#include <stdarg.h>
#include <stdio.h>

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
    char where[1024];
    if (pos->line > 0)
        snprintf(where, sizeof(where), "%s:%d:%d", pos->path, pos->line, pos->column);
    else
        snprintf(where, sizeof(where), "%s", pos->path);
    scene_notes_add(&reader->report.notes, where, text);
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
