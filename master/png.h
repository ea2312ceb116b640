/*
 * An 8-bit sRGB picture to look at: channels R, G and B, taken as linear, clamped to [0, 1].
 */
#ifndef MASTER_PNG_H
#define MASTER_PNG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct image;

/*
 * Write the whole display window (black outside the data window) through a temporary file. Negative
 * values and NaN are black, infinity is white. Blocks on the disk.
 */
bool png_preview_write(const struct image *image, const char *path, struct err *err);

/* The same bytes in memory; the caller frees them. */
bool png_preview_encode(const struct image *image, uint8_t **bytes, size_t *size, struct err *err);

/* The sRGB curve on one value, rounded to 0..255; NaN gives 0. Pure. */
uint8_t png_preview_byte(float linear);

#endif
