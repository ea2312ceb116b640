/*
 * How far two pictures are apart. `a` is what is judged, `b` the reference. Pixels where either
 * picture is not finite are counted and left out of everything but FLIP, which sees them as black.
 * Pure functions; any thread.
 */
#ifndef MASTER_MEASURE_H
#define MASTER_MEASURE_H

#include "proto/digest.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct image;

/* Which channels stand for red, green and blue; an entry may repeat. */
struct measure_channels {
    const char *name[3];
};

struct measure {
    double rmse;   /* sqrt(mean((a - b)^2)) over pixels and channels */
    double relmse; /* mean((a - b)^2 / (b^2 + 0.01)) */
    double mape;   /* mean(|a - b| / (|b| + 0.01)) */
    double flip;   /* mean LDR-FLIP: see flip.h */
    double mean_a[3], mean_b[3];
    uint64_t pixels;                   /* that count */
    uint64_t nonfinite_a, nonfinite_b; /* pixels with a channel that is not finite */
};

struct measure_block {
    uint32_t x, y, width, height; /* within the data window */
    double mean_a[3], mean_b[3];
    double luminance_a, luminance_b;
    /*
     * Standard errors of the luminances, from the channels "stderr.<name>"; NaN without them. The
     * three channels of a pixel count as fully correlated (they come from the same paths, and it
     * errs on the safe side), pixels as independent.
     */
    double stderr_a, stderr_b;
    uint64_t pixels; /* finite in both; with none of them every figure is NaN */
};

/* ERR_ARGUMENT when sizes or positions differ or a channel is missing. */
bool measure_images(const struct image *a, const struct image *b,
                    const struct measure_channels *channels, struct measure *out, struct err *err);

/* Blocks of side x side pixels in reading order, cut at the edges. Free the array with free(). */
struct measure_block *measure_blocks(const struct image *a, const struct image *b,
                                     const struct measure_channels *channels, uint32_t side,
                                     size_t *count, struct err *err);

/* SHA-256 over the three channels as interleaved little-endian float32, top row first. */
bool measure_pixels_digest(const struct image *image, const struct measure_channels *channels,
                           struct digest *digest, struct err *err);

#endif
