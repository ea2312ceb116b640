/*
 * What the first hits of a leaf's camera paths show: kept per sample while the leaf is traced, and
 * summed into the layers that the job asks for (common/aov.h says what is summed and how).
 */
#ifndef WORKER_KERNEL_FIRST_HIT_H
#define WORKER_KERNEL_FIRST_HIT_H

#include "common/sumtree.h"
#include "worker/kernel/kernel_scene.h"

#include <stdint.h>

/* One sample: a cache line */
struct first_hit {
    uint32_t seen;             /* 0: the path left the scene, and the rest is zero too */
    uint32_t object, material; /* as common/aov.h numbers them */
    float time;
    float p[3], ns[3], ng[3], albedo[3];
};

/* The first object that is an instance */
static inline int32_t first_hit_instance(const struct scene *scene)
{
    return (int32_t)(scene->mesh_count + scene->quadric_count);
}

/* Add the samples of every pixel in index order, in double, and round once; `sums` has the layers
 * of ks->spec.aovs. */
void first_hit_sum(const struct kernel_scene *ks, const struct first_hit *hits,
                   uint64_t first_sample, struct node_sums *sums);

#endif
