/*
 * Embree's user geometry: the spheres and disks of a group or of the world (user data: struct
 * kernel_quadrics), and all instances (user data: struct kernel_scene). Compiled once per
 * instruction set, as path.c is; kernel.c chooses. Called by Embree on the thread that traces.
 */
#ifndef WORKER_KERNEL_CALLBACKS_H
#define WORKER_KERNEL_CALLBACKS_H

#include "worker/kernel/embree.h"

#define CALLBACKS_DECLARE(isa)                                                                  \
    void callbacks_quadric_bounds_##isa(const struct RTCBoundsFunctionArguments *args);         \
    void callbacks_quadric_intersect_##isa(const struct RTCIntersectFunctionNArguments *args);  \
    void callbacks_quadric_occluded_##isa(const struct RTCOccludedFunctionNArguments *args);    \
    void callbacks_instance_bounds_##isa(const struct RTCBoundsFunctionArguments *args);        \
    void callbacks_instance_intersect_##isa(const struct RTCIntersectFunctionNArguments *args); \
    void callbacks_instance_occluded_##isa(const struct RTCOccludedFunctionNArguments *args);

CALLBACKS_DECLARE(avx2)
CALLBACKS_DECLARE(base)

#endif
