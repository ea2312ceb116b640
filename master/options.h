/*
 * The command line of `pathfarm render`, which `pathfarm plan` shares. One table in options.c has
 * every option with its parser and its line of help.
 */
#ifndef MASTER_OPTIONS_H
#define MASTER_OPTIONS_H

#include "master/exr.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

#define OPTIONS_PATH 4096

struct render_options {
    const char *scene;
    const char *output;     /* NULL: none was given */
    char png[OPTIONS_PATH]; /* as given, or the output's name with .png */
    const char *report, *ledger, *heat, *keys, *cache;
    const char *camera;     /* NULL: the first */
    uint32_t width, height; /* 0: the scene's */
    bool has_crop;
    double crop[4]; /* x0, x1, y0, y1: fractions if all are at most 1, else pixels */
    uint64_t spp;   /* 0: the scene's */
    double time_s;  /* 0, here and below: no such limit */
    double relmse;
    double core_hours;
    bool adaptive; /* samples per tile as a pilot decides */
    uint64_t seed;
    uint32_t workers, threads; /* threads 0: all cores / workers */
    int sampler;               /* enum sampler_kind; -1: the scene's */
    uint32_t replicates;       /* 0: the default */
    bool has_max_depth;
    uint32_t max_depth;
    bool listens, has_tev;
    char listen_host[256], tev_host[256];
    unsigned listen_port, tev_port;
    double write_every_s; /* 0: only at the end */
    uint32_t aovs;        /* layers besides radiance: common/aov.h */
    struct exr_format exr;
    bool lenient, everything, no_cache, quiet, verbose;
    uint32_t lanes;
    uint32_t lease_ms, leases_in_flight, heartbeat_ms, dead_after_ms, stall_ms; /* 0: default */
    uint64_t lease_leaves_min, lease_leaves_max;
};

enum options_result { OPTIONS_GO, OPTIONS_HELP, OPTIONS_WRONG };

/*
 * argv[0] is the command's name. Texts in `out` point into argv. OPTIONS_WRONG sets err to a
 * sentence that names the option, and the nearest one where it is unknown. Without `needs_output`
 * -o may be missing.
 */
enum options_result options_parse(int argc, char **argv, bool needs_output,
                                  struct render_options *out, struct err *err);

/* All options, a line each, on stdout. */
void options_help(void);

/* The name in a NULL-terminated list that is most like `text`; NULL when none is. */
const char *options_nearest(const char *text, const char *const *names);

#endif
