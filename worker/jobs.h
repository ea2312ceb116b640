/*
 * The jobs this worker knows: from the master's offer (JOB) over the objects that the cache has or
 * the wire brings to a scene that is checked and ready in the pool. One job at a time is on that
 * way; whatever takes long (reading and hashing the cache, building the renderer, writing the
 * cache) happens on libuv's worker threads, so that the loop goes on sending heartbeats.
 *
 *     jobs_offer -> queued -> loading -> fetching -> preparing -> ready | failed
 *
 * A job survives a lost connection: offered again, by its digest, it is ready at once. One that is
 * not offered any more makes room when another wants to be loaded.
 *
 * Everything here is for the event loop's thread.
 */
#ifndef WORKER_JOBS_H
#define WORKER_JOBS_H

#include "common/err.h"
#include "common/job.h"
#include "proto/digest.h"
#include "proto/pathfarm.pb-c.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/queue.h>
#include <uv.h>

struct assembly;
struct pool;
struct pool_job;
struct profile;
struct renderer_class;
struct scene;

enum job_state { JOB_QUEUED, JOB_LOADING, JOB_FETCHING, JOB_PREPARING, JOB_READY, JOB_FAILED };

/* To be read only by others than jobs.c. */
struct job {
    TAILQ_ENTRY(job) link;
    struct jobs *jobs;
    struct digest digest;
    char title[128];
    bool offered; /* on this connection, where `id` is its name */
    uint64_t id;
    enum job_state state;
    struct err failure; /* JOB_FAILED */
    struct job_spec spec;
    uint64_t object_bytes, need_bytes;
    uint32_t tiles; /* JOB_READY and later, like the next three */
    struct pool_job *rendering;
    bool cached;
    double load_seconds;

    /* private */
    struct assembly *assembly; /* the renderer's once it is open */
    uint64_t begin_ns;
    bool working;  /* `work` is on its way */
    bool unwanted; /* to be freed when it is back */
    uv_work_t work;
    void (*step)(struct job *job);
    void (*after)(struct job *job);
};

struct jobs_options {
    const struct renderer_class *renderer;
    const struct profile *profile;
    unsigned threads;
    const char *cache_dir; /* NULL: no cache */
    uint64_t cache_quota;
    uint64_t max_memory; /* of this process, bytes; UINT64_MAX: what the machine has */
};

struct jobs_events {
    void (*on_settled)(void *owner, struct job *job); /* JOB_READY or JOB_FAILED, and offered */
    void (*on_wish)(void *owner, const Pathfarm__ObjectWanted *wish);
    void (*on_closed)(void *owner); /* after jobs_close: all is freed */
};

struct jobs;

/* Options are copied, the strings in them are not. NULL when memory runs out. */
struct jobs *jobs_new(uv_loop_t *loop, struct pool *pool, const struct jobs_options *options,
                      const struct jobs_events *events, void *owner);

/* Drop everything; on_closed, maybe before this returns, when nothing of it is left. */
void jobs_close(struct jobs *jobs);

/*
 * The master offers a job. False when the message breaks the protocol; a job that cannot be loaded
 * is settled as failed instead, maybe before this returns.
 */
bool jobs_offer(struct jobs *jobs, const Pathfarm__Job *offer, struct err *err);

/* A slice came. False when it breaks the protocol. */
bool jobs_slice(struct jobs *jobs, const Pathfarm__ObjectSlice *slice, const void *data,
                size_t size, struct err *err);

/* The job is done: free it, with its nodes in the pool. */
void jobs_done(struct jobs *jobs, struct job *job);

/* The connection is gone: no job is offered, and wishes are forgotten. */
void jobs_disconnected(struct jobs *jobs);

/* NULL when there is none; the first two look at offered jobs only. */
struct job *jobs_by_id(struct jobs *jobs, uint64_t id);
struct job *jobs_by_digest(struct jobs *jobs, const struct digest *digest);
struct job *jobs_by_rendering(struct jobs *jobs, const struct pool_job *rendering);

#endif
