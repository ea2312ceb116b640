/*
 * What a render did, as plain data, and as the JSON file of `--report`. Whoever renders fills the
 * struct; pointers stay the caller's and must live until the report is written. A figure nobody
 * knows is NaN and becomes null.
 */
#ifndef MASTER_REPORT_H
#define MASTER_REPORT_H

#include "common/sumtree.h"
#include "master/ledger.h"
#include "master/limits.h"
#include "master/predict.h"
#include "proto/digest.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct tile_plan;

struct report_worker {
    const char *host, *build;
    unsigned cores;
    uint64_t nodes;   /* accepted from it */
    uint64_t samples; /* camera paths in those nodes */
    double core_seconds;
    bool cached; /* it had the scene already */
    bool lost;   /* it went away before the end */
};

struct render_report {
    const char *command, *build, *profile;
    const char *scene; /* as given on the command line */
    struct digest scene_digest, job_digest;
    uint64_t seed;
    uint32_t replicates;
    uint32_t width, height;      /* of the full image */
    uint32_t crop[4];            /* x0, x1, y0, y1 */
    const char *sampler, *paths; /* names; NULL leaves them out */
    const char *effects;

    uint64_t spp_asked, spp;      /* asked: 0 is as many as other limits allow */
    const struct limits *asked;   /* NULL leaves them and the next two out */
    enum limit stopped_by;        /* LIMIT_NONE: the job did not come to its end */
    struct predict_job predicted; /* how: predictions are made of the ledger's rows */
    const struct tile_plan *plan; /* NULL, or without a pilot: left out */
    double wall_seconds, core_seconds;
    struct node_stats stats; /* of everything in the picture */
    uint64_t bytes_sent, bytes_received;
    struct accuracy accuracy;

    const struct report_worker *workers;
    size_t worker_count;
    uint64_t nodes_accepted, nodes_reissued, nodes_speculated, nodes_duplicate, nodes_mismatched;

    const struct ledger_row *ledger; /* a row per round */
    size_t ledger_count;
};

/* Write the report through a temporary file. */
bool report_write(const struct render_report *report, const char *path, struct err *err);

/* The JSON text, to be released with free(); NULL when memory runs out. */
char *report_json(const struct render_report *report);

#endif
