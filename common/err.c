#include "common/err.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static void end_with_ellipsis_if_cut(char *text, size_t capacity, int wanted)
{
    if (wanted >= 0 && (size_t)wanted >= capacity)
        memcpy(text + capacity - 4, "...", 4);
}

bool err_record(struct err *err, enum err_code code, const char *format, ...)
{
    if (err == NULL)
        return false;
    va_list args;
    va_start(args, format);
    err->code = code;
    int wanted = vsnprintf(err->text, sizeof(err->text), format, args);
    va_end(args);
    end_with_ellipsis_if_cut(err->text, sizeof(err->text), wanted);
    return false;
}

bool err_context(struct err *err, const char *format, ...)
{
    if (err == NULL)
        return false;
    char context[sizeof(err->text)];
    va_list args;
    va_start(args, format);
    vsnprintf(context, sizeof(context), format, args);
    va_end(args);

    char whole[2 * sizeof(err->text) + 2];
    snprintf(whole, sizeof(whole), "%s: %s", context, err->text);
    int wanted = snprintf(err->text, sizeof(err->text), "%.*s", (int)sizeof(whole) - 1, whole);
    end_with_ellipsis_if_cut(err->text, sizeof(err->text), wanted);
    return false;
}

void err_clear(struct err *err)
{
    err->code = ERR_OK;
    err->text[0] = '\0';
}

const char *err_name(enum err_code code)
{
    switch (code) {
#define X(name, number, reaction, text) \
    case ERR_##name:                    \
        return #name;
        ERR_MAP(X)
#undef X
    }
    return "UNKNOWN";
}

const char *err_meaning(enum err_code code)
{
    switch (code) {
#define X(name, number, reaction, text) \
    case ERR_##name:                    \
        return text;
        ERR_MAP(X)
#undef X
    }
    return "unknown error";
}

enum err_reaction err_reaction(enum err_code code)
{
    switch (code) {
#define X(name, number, reaction, text) \
    case ERR_##name:                    \
        return reaction;
        ERR_MAP(X)
#undef X
    }
    return COUNT;
}

bool err_from_wire(unsigned number, enum err_code *code)
{
    switch (number) {
#define X(name, wire_number, reaction, text) \
    case wire_number:                        \
        *code = ERR_##name;                  \
        return true;
        ERR_MAP(X)
#undef X
    }
    return false;
}
