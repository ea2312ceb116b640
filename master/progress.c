#include "master/progress.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <string.h>

#define TERMINAL_INTERVAL_MS 200  /* faster than that, nobody reads digits */
#define LOG_FIRST_MS         2000 /* short renders need no log line */
#define LOG_INTERVAL_MAX_MS  60000

/* "45 s", "3 m 07 s", "2 h 15 m" */
static int format_duration(double seconds, char *text, size_t capacity)
{
    uint64_t whole = (uint64_t)fmin(ceil(seconds), 1e9);
    if (whole < 60)
        return snprintf(text, capacity, "%" PRIu64 " s", whole);
    if (whole < 3600)
        return snprintf(text, capacity, "%" PRIu64 " m %02" PRIu64 " s", whole / 60, whole % 60);
    return snprintf(text, capacity, "%" PRIu64 " h %02" PRIu64 " m", whole / 3600, whole / 60 % 60);
}

const char *progress_text(const struct progress_state *state, char *text, size_t capacity)
{
    char done[16] = "   - %", error[32] = "unknown", left[32] = "-";
    if (state->done >= 0) /* never 100 before it is */
        snprintf(done, sizeof(done), "%5.1f %%", fmin(floor(1000 * state->done) / 10, 100));
    if (isfinite(state->error))
        snprintf(error, sizeof(error), "%.3g", state->error);
    if (state->seconds_left >= 0)
        format_duration(state->seconds_left, left, sizeof(left));
    snprintf(text, capacity, "%s  %" PRIu64 " spp  %.2f Mpaths/s  %u worker%s  error %s  %s left",
             done, state->spp, state->mpaths_per_s, state->workers, state->workers == 1 ? "" : "s",
             error, left);
    return text;
}

void progress_open(struct progress *progress, FILE *out, bool terminal, uint64_t now_ms)
{
    *progress = (struct progress){
        .out = out,
        .terminal = terminal,
        .next_ms = terminal ? now_ms : now_ms + LOG_FIRST_MS,
        .interval_ms = terminal ? TERMINAL_INTERVAL_MS : LOG_FIRST_MS,
    };
}

static void put_line(struct progress *progress, const struct progress_state *state)
{
    char text[320];
    progress_text(state, text, sizeof(text));
    size_t length = strlen(text);
    if (progress->terminal && progress->note != NULL)
        snprintf(text + length, sizeof(text) - length, "; %s", progress->note);
    if (progress->terminal)
        fprintf(progress->out, "\r%s\033[K", text); /* the escape clears a longer line's rest */
    else
        fprintf(progress->out, "%s\n", text);
    fflush(progress->out);
    progress->line_open = progress->terminal;
}

void progress_show(struct progress *progress, const struct progress_state *state, uint64_t now_ms)
{
    if (now_ms < progress->next_ms)
        return;
    put_line(progress, state);
    if (!progress->terminal && progress->interval_ms < LOG_INTERVAL_MAX_MS) {
        progress->interval_ms *= 2;
        if (progress->interval_ms > LOG_INTERVAL_MAX_MS)
            progress->interval_ms = LOG_INTERVAL_MAX_MS;
    }
    progress->next_ms = now_ms + progress->interval_ms;
}

void progress_say(struct progress *progress, const char *format, ...)
{
    if (progress->line_open)
        fputs("\r\033[K", progress->out);
    progress->line_open = false;
    va_list args;
    va_start(args, format);
    vfprintf(progress->out, format, args);
    va_end(args);
    fputc('\n', progress->out);
    fflush(progress->out);
}

void progress_close(struct progress *progress, const struct progress_state *state)
{
    put_line(progress, state);
    if (progress->line_open)
        fputc('\n', progress->out);
    progress->line_open = false;
    fflush(progress->out);
}
