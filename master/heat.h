/*
 * Where a picture is noisy: the relative standard error of every pixel in colours, as a PNG, with
 * the scale below it.
 *
 * What is shown is the square root of the pixel's part of the relMSE, sqrt(mean over R, G and B of
 * stderr^2 / (value^2 + 0.01)), averaged (as squares) over the pixel and its eight neighbours,
 * since one pixel knows its own error from a few replicates only. The scale is logarithmic and
 * always the same, from 0.1 % (black) over violet, red and orange to 100 % (nearly white): pictures
 * can be compared. A pixel whose error is unknown (fewer than two replicates, or non-finite samples
 * were lost) is turquoise, which is not on the scale, and its neighbours are averaged without it.
 *
 * Pure, but for writing the file, which blocks on the disk.
 */
#ifndef MASTER_HEAT_H
#define MASTER_HEAT_H

#include <stdbool.h>
#include <stdint.h>

struct err;
struct image;

#define HEAT_LOWEST  0.001
#define HEAT_HIGHEST 1.0

/* Of each pixel of the data window into values[width * height]; NaN where it is unknown. False
 * without the channels R .. stderr.B. */
bool heat_values(const struct image *image, float *values, struct err *err);

/* The colour of a value; that of NaN is turquoise. */
void heat_color(float value, uint8_t rgb[3]);

/* The map of the display window (black outside the data window), and below it the scale. */
bool heat_write(const struct image *image, const char *path, struct err *err);

#endif
