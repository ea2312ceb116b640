/*
 * Pictures by this very program: `pathfarm render` as a process of its own, for commands that
 * measure what users would get. A run owns a temporary folder for the pictures, the reports and
 * the workers' cache of scenes.
 *
 * Blocking, one render at a time, and one run in a process: between open and close SIGINT and
 * SIGTERM are passed on to the render, which then fails, as do all after it; so that the folder is
 * gone in the end.
 */
#ifndef MASTER_RENDER_RUN_H
#define MASTER_RENDER_RUN_H

#include <stdint.h>

struct err;
struct image;
struct render_run;

#define RENDER_RUN_ARGUMENTS 64 /* at most, of one render */

/* What the report of a render says about it */
struct render_facts {
    uint64_t spp;
    uint32_t replicates;
    double core_s, wall_s;
    uint64_t truncated_paths;
    double truncated_energy; /* per camera path */
    uint64_t nonfinite;      /* samples that were left out, for whatever cause */
};

/* NULL when there is no place for the folder. render_run_close(NULL) does nothing. */
struct render_run *render_run_open(struct err *err);
void render_run_close(struct render_run *run);

/*
 * Render with these arguments, the scene among them, up to a NULL; -o, --report, --cache and
 * --quiet are added. The caller owns the image. NULL with what the render said last.
 */
struct image *render_run_picture(struct render_run *run, const char *const *arguments,
                                 struct render_facts *facts, struct err *err);

#endif
