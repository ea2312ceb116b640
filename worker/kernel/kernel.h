/*
 * The path kernels on Embree, as plain functions: what renderer_embree (worker/renderer.h) wraps,
 * and what tests and benchmarks call directly.
 *
 * kernel_open prepares a scene (it keeps pointers to it); any number of threads then call
 * kernel_leaf, each with its own kernel_thread. The variant is the first of path_variants.def that
 * covers the scene's effects, or the last when spec->kernel is 1. Threads that render must have
 * called profile_thread_mode (worker/profile.h).
 */
#ifndef WORKER_KERNEL_KERNEL_H
#define WORKER_KERNEL_KERNEL_H

#include "worker/kernel/kernel_scene.h"

struct err;

struct kernel_scene *kernel_open(const struct scene *scene, const struct job_spec *spec,
                                 struct err *err);
void kernel_close(struct kernel_scene *ks);

struct kernel_thread *kernel_thread_open(const struct kernel_scene *ks, struct err *err);
void kernel_thread_close(struct kernel_thread *thread);

/* Leaf `leaf` of a tile and replicate into sums, which has the tile's shape and is overwritten. */
bool kernel_leaf(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile,
                 uint32_t replicate, uint64_t leaf, struct node_sums *sums, struct err *err);

/* Names of the variants in order; NULL past the last. */
const char *kernel_variant_name(unsigned index);

#endif
