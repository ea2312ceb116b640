/*
 * One job, from its bundle to the film, by whichever workers come: listening, the workers'
 * sessions, deadlines, and results on their way to the film. Nothing a worker does or fails to do
 * harms the job, except a reported failure that makes it impossible.
 *
 *     farm_open, uv_run .. on_round .. on_end(why) .. farm_close, uv_run until idle
 *
 * Two doors: local workers, which this process has started, come in plain through a port on
 * loopback of their own, and nobody else is let in there; others come to `listen_host`, over TLS,
 * or plain where that is a loopback address.
 *
 * The job pins the numeric profile of its first worker (of its first local worker where there are
 * any), and turns away workers with another.
 *
 * Used from the event loop only; callbacks come from it.
 */
#ifndef MASTER_FARM_H
#define MASTER_FARM_H

#include "master/limits.h"
#include "master/predict.h"
#include "master/scheduler.h"
#include "proto/digest.h"

#include <sys/types.h>
#include <uv.h>

struct bundle;
struct film;
struct image;
struct job_spec;
struct keys;
struct scene;

struct farm_settings {
    const char *listen_host;            /* NULL: local workers only */
    unsigned listen_port;               /* 0: any */
    const struct keys *keys;            /* NULL: plain, loopback only */
    uint32_t heartbeat_ms;              /* how often either side says something */
    uint32_t dead_after_ms;             /* silence after which the other is gone */
    struct scheduler_settings schedule; /* tiles and replicates are filled in by the farm */
};
struct farm_settings farm_defaults(void);

/* What is rendered. Everything must outlive the farm (until its loop is idle). */
struct farm_job {
    const struct scene *scene;
    const struct job_spec *spec;
    const struct bundle *bundle;
    struct film *film;
    const char *title;
    struct limits limits; /* when it ends */
    double elapsed_s;     /* of limits.time_s, before farm_open */
    bool local_workers;   /* some are going to be started */
};

struct farm_events {
    void (*on_round)(void *owner); /* a round ended; the film holds exactly the rounds so far */
    /* Once: the job is done (ERR_OK) or has failed. Workers have been told, or not yet. */
    void (*on_end)(void *owner, const struct err *why);
    void (*say)(void *owner, const char *line); /* for people */
    /* The process behind a connection from our own machine; -1 for one that we did not start. */
    pid_t (*local_pid)(void *owner, const char *peer_address);
};

struct farm;

/* NULL and err on failure. `events` and `job` are copied. */
struct farm *farm_open(uv_loop_t *loop, const struct farm_settings *settings,
                       const struct farm_job *job, const struct farm_events *events, void *owner,
                       struct err *err);

/* Tell all workers that the job is over and close everything; the memory goes once the loop has
 * closed the handles. No more callbacks but `say`. Ask for what a report needs before. */
void farm_close(struct farm *farm);

unsigned farm_local_port(const struct farm *farm);
unsigned farm_listen_port(const struct farm *farm); /* 0 without listen_host */

/* A process that we started is gone; `crash` is the signal when it died of a fault of its own, else
 * 0. The farm counts a crash against the nodes that it held. */
void farm_local_exited(struct farm *farm, pid_t pid, int crash);
/* No local worker will be started any more: fails the job unless somebody else works on it. */
void farm_local_hopeless(struct farm *farm, const struct err *why);

/* A worker process, once connected; its place is kept after it left. */
struct farm_worker {
    uint64_t nonce;
    char host[128], build[128];
    pid_t pid; /* of a local one; else -1 */
    unsigned cores;
    uint64_t nodes, samples;
    double core_seconds;
    bool connected, cached;
    struct farm_worker *next;
};

struct farm_status {
    unsigned rounds_done;
    unsigned workers;        /* connected and greeted */
    double done;             /* share of the rounds, or of the time */
    double seconds_left;     /* negative: unknown */
    double wall_s;           /* since farm_open */
    double core_s;           /* reported with results, used or not */
    enum limit stopped_by;   /* once the job is done */
    uint64_t nodes, samples; /* accepted */
    uint64_t bytes_in, bytes_out;
    struct scheduler_counts counts;
};
struct farm_status farm_status(const struct farm *farm);

const struct farm_worker *farm_workers(const struct farm *farm); /* the newest first */
const struct ledger_row *farm_ledger(const struct farm *farm, size_t *count);
/* What is predicted for a job by error: for predict_end, with any beginning of the ledger. */
struct predict_job farm_predict_job(const struct farm *farm);

/* The picture of the last round that ended, whatever came since; NULL before the first. It changes
 * with the next. */
const struct image *farm_picture(const struct farm *farm);

/* The pinned profile; NULL and "" before the first worker came. */
const uint8_t *farm_profile(const struct farm *farm);
const char *farm_profile_text(const struct farm *farm);

#endif
