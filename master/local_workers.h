/*
 * Worker processes on this machine, started by a render: spawned, watched, reaped, and started
 * again when they die. A place whose processes die three times in a row, quickly and without
 * having rendered anything, stays empty. They die with us: the kernel kills them when the thread
 * that started them ends, and they see the closed connection.
 *
 * Used from the event loop only; the loop's thread must be the process's main thread, or one that
 * lives as long.
 */
#ifndef MASTER_LOCAL_WORKERS_H
#define MASTER_LOCAL_WORKERS_H

#include "common/err.h"

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>
#include <uv.h>

struct local_settings {
    unsigned count;
    unsigned threads;      /* per worker */
    unsigned port;         /* on 127.0.0.1 */
    const char *cache_dir; /* NULL: the worker's own choice */
    bool no_cache;
    bool verbose;
};

struct local_events {
    /* A process has ended. `crash`: the signal, when it died of a fault of its own, else 0. */
    void (*on_exit)(void *owner, pid_t pid, int crash);
    /* Every place stays empty; once. */
    void (*on_hopeless)(void *owner, const struct err *why);
    /* Has this process done anything useful yet? */
    bool (*was_useful)(void *owner, pid_t pid);
    void (*say)(void *owner, const char *line);
};

struct local_workers;

/*
 * Start them. The program is $PATHFARM_WORKER, or pathfarm-worker beside this one; the words of
 * $PATHFARM_WORKER_ARGS are added to its arguments. NULL and err when it cannot be run at all.
 */
struct local_workers *local_workers_start(uv_loop_t *loop, const struct local_settings *settings,
                                          const struct local_events *events, void *owner,
                                          struct err *err);

/* Nobody is started again. They may leave on their own for grace_ms, then they are killed; the
 * memory goes once all are reaped and the loop has closed the handles. No more callbacks. */
void local_workers_stop(struct local_workers *local, unsigned grace_ms);

/*
 * Which of our processes is at the other end of a TCP connection that came from `peer_address`
 * ("127.0.0.1:50412") to `port`? -1 for none: nobody else can make the kernel say otherwise.
 */
pid_t local_workers_pid(const struct local_workers *local, const char *peer_address);

#endif
