#include "worker/journal.h"

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

static enum journal_level journal_level = JOURNAL_NEWS;
static void (*journal_sink)(const char *line);

void journal_open(enum journal_level level, void (*sink)(const char *line))
{
    journal_level = level;
    journal_sink = sink;
}

void journal_say(enum journal_level level, const char *format, ...)
{
    if (level > journal_level)
        return;
    char line[1536];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof(line), format, args);
    va_end(args);
    if (journal_sink != NULL)
        journal_sink(line);
    else
        fprintf(stderr, "pathfarm-worker: %s\n", line); /* one call: lines do not mix */
}
