/*
 * How the render is going, on stderr: on a terminal one line that is rewritten in place, elsewhere
 * plain lines, seldom (after 2 s, then at growing intervals up to a minute), for logs that people
 * read later. Time is passed in. One thread.
 */
#ifndef MASTER_PROGRESS_H
#define MASTER_PROGRESS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

struct progress_state {
    double done;         /* 0..1; negative when unknown */
    uint64_t spp;        /* in every pixel by now */
    double mpaths_per_s; /* camera paths */
    unsigned workers;    /* connected */
    double error;        /* estimated RMSE; NaN when unknown */
    double seconds_left; /* negative when unknown */
};

struct progress {
    FILE *out;
    bool terminal;
    bool line_open;   /* the rewritten line is on the screen */
    uint64_t next_ms; /* nothing is shown before */
    uint64_t interval_ms;
    const char *note; /* the user's, shown behind the line on a terminal; NULL: nothing */
};

/* `out` stays the caller's; `terminal` says whether lines can be rewritten (isatty). */
void progress_open(struct progress *progress, FILE *out, bool terminal, uint64_t now_ms);

/* Show the state if it is time to. Cheap enough to call on every event. */
void progress_show(struct progress *progress, const struct progress_state *state, uint64_t now_ms);

/* A message of its own line; the rewritten line comes back with the next progress_show. */
void progress_say(struct progress *progress, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* Show a last state whatever the time, and end the line. */
void progress_close(struct progress *progress, const struct progress_state *state);

/* " 42.0 %  64 spp  1.70 Mpaths/s  2 workers  error 0.0123  1 m 05 s left"; cut at capacity. */
const char *progress_text(const struct progress_state *state, char *text, size_t capacity);

#endif
