/*
 * The pictures that a render leaves: the EXR, with its metadata, the PNG, and where they are wanted
 * the heat map of its error and the accuracy ledger as CSV, refreshed while it runs (--write-every)
 * and written at the end.
 *
 * Refreshing writes a copy in libuv's thread pool, so that compressing and syncing do not hold up
 * workers; at most one is being written, and a refresh that comes meanwhile is dropped. The copy's
 * memory is taken at the start and used for every picture: a job whose picture could not be written
 * fails then and not after ten hours, and memory stays flat. Used from the event loop only.
 */
#ifndef MASTER_PICTURES_H
#define MASTER_PICTURES_H

#include "common/job.h"
#include "master/exr.h"
#include "master/limits.h"

#include <stdbool.h>
#include <uv.h>

struct bundle;
struct err;
struct film;
struct image;
struct ledger_row;

/* What is written into the files' metadata, besides what the film says, and how pixels are. */
struct picture_facts {
    const char *command, *build;
    const char *profile_text;
    const struct bundle *bundle;
    const struct job_spec *spec;
    struct exr_format format;
};

struct picture_paths {
    const char *exr, *png;
    const char *heat, *ledger; /* NULL: not wanted */
};

/* The rounds that have ended. Copied, as far as it must be. */
struct picture_moment {
    const struct image *picture; /* an image that film_image_new made; NULL: no round has ended */
    const struct ledger_row *rows;
    size_t row_count;
    enum limit stopped_by;
    bool complete; /* all that was asked for */
};

struct pictures;

/* Everything named must outlive it. NULL when memory runs out. pictures_free(NULL) does nothing;
 * nothing may be being written then (pictures_busy). */
struct pictures *pictures_new(uv_loop_t *loop, const struct film *film,
                              const struct picture_facts *facts, const struct picture_paths *paths);
void pictures_free(struct pictures *p);

/* Write all files in the thread pool, or nothing without a picture; `log` hears when that fails. */
void pictures_refresh(struct pictures *p, const struct picture_moment *moment,
                      void (*log)(void *context, const char *line), void *context);
bool pictures_busy(const struct pictures *p);

/* Write all files now, while none is being written. */
bool pictures_write(struct pictures *p, const struct picture_moment *moment, struct err *err);

#endif
