/*
 * What the worker says on stderr: one line each. Problems are always said, what happens unless the
 * worker is somebody's child (--once), details with --verbose. Any thread.
 */
#ifndef WORKER_JOURNAL_H
#define WORKER_JOURNAL_H

enum journal_level { JOURNAL_PROBLEM, JOURNAL_NEWS, JOURNAL_DETAIL };

/* What is said at all, and to whom; `sink` NULL is stderr. Before other threads start. */
void journal_open(enum journal_level level, void (*sink)(const char *line));

void journal_say(enum journal_level level, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

#endif
