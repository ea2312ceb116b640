/*
 * A worker's dealings with its master: it connects, greets, takes jobs and leases, has them
 * rendered, and hands the results in; and when the connection is lost it comes back, with
 * growing pauses, and offers what it still holds. A master that breaks the protocol is
 * disconnected, with the reason in the journal; the worker lives on.
 *
 * Owns the pool, the jobs and the outbox. Used from the event loop only.
 */
#ifndef WORKER_SESSION_H
#define WORKER_SESSION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <uv.h>

struct err;
struct keys;
struct profile;
struct renderer_class;

struct session_options {
    const char *host; /* of the master */
    unsigned port;
    const struct keys *keys; /* NULL: plain, and then the master must be on loopback */
    const struct renderer_class *renderer;
    const struct profile *profile;
    unsigned threads;
    const char *cache_dir;               /* NULL: no cache */
    uint64_t cache_quota;                /* bytes */
    uint64_t max_memory;                 /* bytes; UINT64_MAX: what the machine has */
    size_t outbox_results;               /* held at most until they are durable */
    bool once;                           /* end instead of reconnecting */
    uint32_t once_connect_ms;            /* with `once`: how long to try to connect */
    uint32_t retry_min_ms, retry_max_ms; /* pause before the first new attempt, and the longest */
};

/* Sane values for everything but host, keys, renderer, profile and threads. */
struct session_options session_options_default(void);

struct session;

/*
 * Start the threads and connect. Pointers in the options must outlive the session. on_end is
 * called once, from the loop, when everything is closed; `status` is for exit(). NULL and err on
 * failure.
 */
struct session *session_new(uv_loop_t *loop, const struct session_options *options,
                            void (*on_end)(void *owner, int status), void *owner, struct err *err);

/* After on_end only. */
void session_free(struct session *session);

/* End in an orderly way: hand back what was not begun, finish and hand in the rest, say goodbye. */
void session_drain(struct session *session);

#endif
