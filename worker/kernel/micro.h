/*
 * The canned micro-render behind the numeric profile: a small scene with every kind of material,
 * light and shape, rendered by `everything`, digested. Two workers with equal digests render equal
 * bits, as far as so small a sample can tell.
 */
#ifndef WORKER_KERNEL_MICRO_H
#define WORKER_KERNEL_MICRO_H

#include <stdbool.h>
#include <stdint.h>

struct err;

/* Takes a few milliseconds. Thread: any, with the floating-point mode of render threads. */
bool micro_render(uint8_t digest[32], struct err *err);

#endif
