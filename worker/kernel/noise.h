/*
 * The noises of pbrt-v4 (Pharr, Jakob, Humphreys: Physically Based Rendering, chapter 10), which
 * are sums of Perlin's improved noise (SIGGRAPH 2002) with his reference permutation. Pure.
 */
#ifndef WORKER_KERNEL_NOISE_H
#define WORKER_KERNEL_NOISE_H

#include <stdbool.h>
#include <stdint.h>

/* In [-1, 1], 0 at every point of integers; any float is a point. */
float noise_at(const float p[3]);

/* Octaves of noise, each 1.99 times finer and omega times as strong. width2: the square of the
 * footprint; what is finer than twice it is faded out, in turbulence to its mean. */
float noise_fbm(const float p[3], float width2, float omega, uint32_t octaves);
float noise_turbulence(const float p[3], float width2, float omega, uint32_t octaves);

/* Is (s, t) inside of one of the dots that half the unit cells have? */
bool noise_in_dot(float s, float t);

#endif
