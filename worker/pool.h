/*
 * The render threads. The event loop hands them nodes and takes finished nodes back; the threads
 * never touch a socket. A node is rendered leaf by leaf, in order, its sums added like the carries
 * of a binary counter; while threads would have nothing to do, what waits is halved and the halves
 * are joined again with struct fold. Any splitting gives the same bits (common/sumtree.h).
 *
 * Threads: every function is for the event loop's thread, except pool_job_open, which may take
 * seconds and belongs on a thread of its own, and the reading of counters, which any thread may do.
 * One mutex guards the queue and the list of finished nodes.
 */
#ifndef WORKER_POOL_H
#define WORKER_POOL_H

#include "common/err.h"
#include "common/sumtree.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct job_spec;
struct renderer_class;
struct scene;

struct pool;
struct pool_job; /* a scene that is ready to be rendered */

/*
 * Start the threads. `wake(context)` is called from a render thread when there is something for
 * pool_take; uv_async_send is what it is for. It is called for every node while little waits, else
 * for many at once: pool_take, asked now and then, may have more. NULL and err on failure.
 */
struct pool *pool_new(unsigned threads, void (*wake)(void *context), void *context,
                      struct err *err);

/* Stop every thread at its next leaf and drop all nodes. Close the jobs first. NULL is fine. */
void pool_free(struct pool *pool);

/* Memory for render threads that a job needs besides its scene and renderer, in bytes. */
uint64_t pool_job_memory(unsigned threads, const struct job_spec *spec);

/*
 * Open the renderer. The scene must live until `release(owner)` is called, after the renderer was
 * closed and maybe by a render thread. NULL and err on failure; release is not called then.
 */
struct pool_job *pool_job_open(struct pool *pool, const struct renderer_class *renderer,
                               const struct scene *scene, const struct job_spec *spec,
                               void (*release)(void *owner), void *owner, struct err *err);

/*
 * Drop all nodes of a job, finished ones too, and close its renderer, which may happen a little
 * later in a render thread: threads at work on it stop at their next leaf.
 */
void pool_job_close(struct pool *pool, struct pool_job *job);

/* Queue nodes in this order; all or, when memory runs out, none. Tile and replicate must exist. */
bool pool_add(struct pool *pool, struct pool_job *job, uint64_t lease_id,
              const struct node_id *nodes, size_t count, struct err *err);

/*
 * Drop those nodes of a lease that nobody has begun; `count` 0 means all of them. Nodes that were
 * begun are finished: their results are as good as any. Returns how many were dropped.
 */
size_t pool_revoke(struct pool *pool, uint64_t lease_id, const struct node_id *nodes, size_t count);

/* The same for every lease. */
size_t pool_revoke_all(struct pool *pool);

/*
 * Say how many results there is room for (SIZE_MAX at first): that many nodes may be begun,
 * counting those that are begun or finished already; each one taken uses up its place. Nodes that
 * were begun are finished in any case; with 0 no more are begun.
 */
void pool_allow(struct pool *pool, size_t nodes);

/* A node that is finished, in order of completion. */
struct pool_result {
    struct pool_job *job;
    uint64_t lease_id;
    struct node_id node;
    struct node_sums *sums; /* the caller's to free; NULL when the node failed as err says */
    double core_seconds;
    struct err err;
};

/* The next finished node; false when there is none. */
bool pool_take(struct pool *pool, struct pool_result *out);

/* Nodes added and neither taken nor dropped. */
size_t pool_nodes(struct pool *pool);

/* The leases they belong to, each once; at most `capacity` are written. Returns how many. */
size_t pool_leases(struct pool *pool, uint64_t *lease_ids, size_t capacity);

/* Since the pool began; counted leaf by leaf, part by part. */
uint64_t pool_samples(const struct pool *pool);
double pool_core_seconds(const struct pool *pool);

#endif
