/*
 * The numeric profile: what this worker's arithmetic does, as 32 bytes that two workers share
 * exactly when they render the same bits. It is the digest of a canned micro-render, which the
 * renderer supplies; the text beside it is for people ("embree 3.13.5 avx2; lanes 1").
 *
 * Part of the profile is the floating-point mode of a thread. Every thread that renders, or that
 * prepares a scene, calls profile_thread_mode first; it is the only place that sets it.
 */
#ifndef WORKER_PROFILE_H
#define WORKER_PROFILE_H

#include <stdbool.h>
#include <stdint.h>

struct err;
struct renderer_class;

struct profile {
    uint8_t digest[32];
    char text[256];
};

/* Round to nearest, denormals are zero on input and output (Embree wants that), no traps. */
void profile_thread_mode(void);

/* Run the renderer's micro-render in this thread, whose own mode is restored afterwards. */
bool profile_take(const struct renderer_class *renderer, struct profile *out, struct err *err);

#endif
