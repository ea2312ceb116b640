/*
 * What path.c exports, once per instruction set: the leaf function of every kernel variant. Used by
 * kernel.c, which chooses.
 */
#ifndef WORKER_KERNEL_PATH_H
#define WORKER_KERNEL_PATH_H

#include "worker/kernel/kernel_scene.h"
#include "worker/kernel/path_variants.def"

#define PATH_DECLARE(name, isa)                                                                \
    void path_leaf_##name##_##isa(const struct kernel_scene *ks, struct kernel_thread *thread, \
                                  uint32_t tile, uint32_t replicate, uint64_t leaf,            \
                                  struct path_stats *stats);

#define X(name, mask) PATH_DECLARE(name, avx2)
PATH_VARIANTS(X)
#undef X
PATH_DECLARE(everything, base)

#endif
