/*
 * What renders a leaf: the path kernels on Embree (worker/kernel/kernel.h), or a simulation for
 * tests of the farm that should not trace rays. The pool knows only this interface.
 */
#ifndef WORKER_RENDERER_H
#define WORKER_RENDERER_H

#include "common/job.h"

#include <stdbool.h>

struct err;
struct renderer;
struct scene;

struct renderer_class {
    const char *name;

    /* Digest of a canned micro-render, equal on two workers exactly when their bits are, and what
     * did it in words for people. Called once, before any open. */
    bool (*profile)(uint8_t digest[32], char *text, size_t capacity, struct err *err);

    /* Prepare `scene` for rendering as `spec` says, on up to `threads` threads. Keeps pointers to
     * both until close; NULL and err on failure. */
    struct renderer *(*open)(const struct scene *scene, const struct job_spec *spec,
                             unsigned threads, struct err *err);

    /* Scratch memory of one render thread; closed when no leaf is being rendered any more, maybe
     * by another thread. */
    void *(*thread_open)(struct renderer *renderer, struct err *err);
    void (*thread_close)(struct renderer *renderer, void *thread);

    /*
     * Render leaf `leaf` of a tile and replicate into `sums`, which has the tile's shape and is
     * overwritten. Called from many threads at once, each with its own `thread`.
     */
    bool (*leaf)(struct renderer *renderer, void *thread, uint32_t tile, uint32_t replicate,
                 uint64_t leaf, struct node_sums *sums, struct err *err);

    void (*close)(struct renderer *renderer);
};

extern const struct renderer_class renderer_embree;    /* worker/kernel/ */
extern const struct renderer_class renderer_simulated; /* worker/simulated.c: hashes, no rays */

#endif
