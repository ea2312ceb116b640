/*
 * Pictures over directions, in double: what the layouts of struct environment mean, for the readers
 * and for the tables of the kernels. A texel has one value and covers one patch of directions, so a
 * picture's integral is the sum of its texels times their solid angles, and no interpolation has
 * to be agreed upon. Pure; any thread.
 */
#ifndef COMMON_DIRECTION_MAP_H
#define COMMON_DIRECTION_MAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct environment;
struct scene_picture;

/*
 * Texel (x, y) of the picture's full size as linear RGB; `texels` is the scene's array. Grey is the
 * same in all channels, alpha is left out. What is negative or not finite is 0, and the answer
 * false.
 */
bool direction_map_texel(const struct scene_picture *picture, const uint8_t *texels, uint32_t x,
                         uint32_t y, double rgb[3]);

/* The solid angle of each texel of row y; all texels together make 4 pi. Not for projections. */
double direction_map_omega(uint32_t layout, uint32_t width, uint32_t height, uint32_t y);

/* The unit direction at (s, t) of the unit square, t downwards from the first row. Projections:
 * not unit, and in the space that to_light leads to. */
void direction_map_direction(uint32_t layout, double s, double t, double w[3]);

#endif
