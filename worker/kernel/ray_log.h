/*
 * A record of the rays a kernel hands to Embree, in their order, for the benchmark that replays
 * them. A kernel_thread whose `log` is NULL (always, but in that benchmark) records nothing.
 */
#ifndef WORKER_KERNEL_RAY_LOG_H
#define WORKER_KERNEL_RAY_LOG_H

#include "worker/kernel/embree.h"

#include <stdbool.h>
#include <stddef.h>

struct logged_ray {
    float o[3], d[3], tfar;
    int shadow;
};

struct ray_log {
    struct logged_ray *rays;
    size_t count, capacity; /* what does not fit any more is dropped, and `dropped` counts it */
    size_t dropped;
};

/* Append the rays of the lanes in `lanes` (a bit each). */
void ray_log_add(struct ray_log *log, const struct RTCRay8 *ray, unsigned lanes, bool shadow);

#endif
