#include "master/gltf_report.h"

#include "master/gltf.h"
#include "master/gltf_reader.h"

#include <stdarg.h>
#include <stdio.h>

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
    char place[1024];
    snprintf(place, sizeof(place), "%s%s%s", reader->report.path, colon(where), where);
    scene_notes_add(&reader->report.notes, place, text);
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
