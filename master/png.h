/*
 * 8-bit sRGB pictures to look at. Of an image: channels R, G and B, taken as linear, clamped to
 * [0, 1].
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
/* The same in memory; the caller frees them. */
bool png_preview_encode(const struct image *image, uint8_t **bytes, size_t *size, struct err *err);

/* A picture whose pixels are sRGB bytes already: red, green, blue, row by row, top row first. */
bool png_bytes_write(const uint8_t *rgb, uint32_t width, uint32_t height, const char *path,
                     struct err *err);

/* The same bytes in memory; the caller frees them. */
bool png_preview_encode(const struct image *image, uint8_t **bytes, size_t *size, struct err *err);

/* The sRGB curve on one value, rounded to 0..255; NaN gives 0. Pure. */
uint8_t png_preview_byte(float linear);

#endif
