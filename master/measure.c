#include "master/measure.h"

#include "common/err.h"
#include "master/flip.h"
#include "master/image.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PIXELS_PER_DEGREE 67.0 /* the viewer the paper assumes: a 0.7 m wide 4K screen at 0.7 m */

static double luminance(const double rgb[3])
{
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

static bool find_channels(const struct image *image, const char *which,
                          const struct measure_channels *channels, const float *rgb[3],
                          struct err *err)
{
    for (int c = 0; c < 3; c++) {
        rgb[c] = image_channel(image, channels->name[c]);
        if (rgb[c] == NULL)
            return err_set(err, ERR_ARGUMENT, "%s has no channel \"%s\"", which, channels->name[c]);
    }
    return true;
}

/* Both pictures' channels, when the pictures can be laid on top of each other. */
static bool find_pair(const struct image *a, const struct image *b,
                      const struct measure_channels *channels, const float *rgb_a[3],
                      const float *rgb_b[3], struct err *err)
{
    if (a->width != b->width || a->height != b->height)
        return err_set(err, ERR_ARGUMENT,
                       "the sizes differ: %" PRIu32 "x%" PRIu32 " and %" PRIu32 "x%" PRIu32,
                       a->width, a->height, b->width, b->height);
    if (a->data_x != b->data_x || a->data_y != b->data_y)
        return err_set(err, ERR_ARGUMENT,
                       "the windows differ: they begin at %" PRId32 ",%" PRId32 " and %" PRId32
                       ",%" PRId32,
                       a->data_x, a->data_y, b->data_x, b->data_y);
    return find_channels(a, "the first image", channels, rgb_a, err) &&
           find_channels(b, "the second image", channels, rgb_b, err);
}

static bool finite_pixel(const float *const rgb[3], size_t p)
{
    return isfinite(rgb[0][p]) && isfinite(rgb[1][p]) && isfinite(rgb[2][p]);
}

bool measure_images(const struct image *a, const struct image *b,
                    const struct measure_channels *channels, struct measure *out, struct err *err)
{
    const float *rgb_a[3], *rgb_b[3];
    if (!find_pair(a, b, channels, rgb_a, rgb_b, err))
        return false;

    *out = (struct measure){ 0 };
    double squares = 0, relative_squares = 0, relative = 0;
    for (size_t p = 0; p < (size_t)a->width * a->height; p++) {
        bool fine_a = finite_pixel(rgb_a, p), fine_b = finite_pixel(rgb_b, p);
        out->nonfinite_a += !fine_a;
        out->nonfinite_b += !fine_b;
        if (!fine_a || !fine_b)
            continue;
        out->pixels++;
        for (int c = 0; c < 3; c++) {
            double x = (double)rgb_a[c][p], r = (double)rgb_b[c][p], d = x - r;
            out->mean_a[c] += x;
            out->mean_b[c] += r;
            squares += d * d;
            relative_squares += d * d / (r * r + 0.01);
            relative += fabs(d) / (fabs(r) + 0.01);
        }
    }

    double values = 3 * (double)out->pixels; /* none: 0/0 says so with NaN */
    out->rmse = sqrt(squares / values);
    out->relmse = relative_squares / values;
    out->mape = relative / values;
    for (int c = 0; c < 3; c++) {
        out->mean_a[c] /= (double)out->pixels;
        out->mean_b[c] /= (double)out->pixels;
    }
    out->flip = flip_mean(rgb_a, rgb_b, a->width, a->height, PIXELS_PER_DEGREE);
    if (isnan(out->flip))
        return err_set(err, ERR_MEMORY, "out of memory");
    return true;
}

/* The "stderr." planes of the channels; false when one is missing. */
static bool find_stderr(const struct image *image, const struct measure_channels *channels,
                        const float *planes[3])
{
    for (int c = 0; c < 3; c++) {
        char name[80];
        snprintf(name, sizeof(name), "stderr.%s", channels->name[c]);
        planes[c] = image_channel(image, name);
        if (planes[c] == NULL)
            return false;
    }
    return true;
}

struct measure_block *measure_blocks(const struct image *a, const struct image *b,
                                     const struct measure_channels *channels, uint32_t side,
                                     size_t *count, struct err *err)
{
    const float *rgb[2][3], *noise[2][3];
    if (!find_pair(a, b, channels, rgb[0], rgb[1], err))
        return NULL;
    if (side == 0) {
        err_set(err, ERR_ARGUMENT, "blocks need at least one pixel");
        return NULL;
    }
    const bool noisy[2] = { find_stderr(a, channels, noise[0]),
                            find_stderr(b, channels, noise[1]) };

    size_t across = ((size_t)a->width + side - 1) / side,
           down = ((size_t)a->height + side - 1) / side;
    struct measure_block *blocks = calloc(across * down > 0 ? across * down : 1, sizeof(*blocks));
    if (blocks == NULL) {
        err_set(err, ERR_MEMORY, "out of memory");
        return NULL;
    }
    *count = across * down;
    for (size_t i = 0; i < *count; i++) {
        struct measure_block *block = &blocks[i];
        block->x = (uint32_t)(i % across * side);
        block->y = (uint32_t)(i / across * side);
        block->width = a->width - block->x < side ? a->width - block->x : side;
        block->height = a->height - block->y < side ? a->height - block->y : side;

        double *mean[2] = { block->mean_a, block->mean_b }, variance[2] = { 0, 0 };
        for (uint32_t y = block->y; y < block->y + block->height; y++) {
            for (uint32_t x = block->x; x < block->x + block->width; x++) {
                size_t p = (size_t)y * a->width + x;
                if (!finite_pixel(rgb[0], p) || !finite_pixel(rgb[1], p))
                    continue;
                block->pixels++;
                for (int k = 0; k < 2; k++) {
                    for (int c = 0; c < 3; c++)
                        mean[k][c] += (double)rgb[k][c][p];
                    if (!noisy[k])
                        continue;
                    double error = luminance((const double[3]){
                        (double)noise[k][0][p], (double)noise[k][1][p], (double)noise[k][2][p] });
                    variance[k] += error * error;
                }
            }
        }

        double pixels = (double)block->pixels;
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++)
                mean[k][c] /= pixels;
        block->luminance_a = luminance(block->mean_a);
        block->luminance_b = luminance(block->mean_b);
        block->stderr_a = noisy[0] ? sqrt(variance[0]) / pixels : NAN;
        block->stderr_b = noisy[1] ? sqrt(variance[1]) / pixels : NAN;
    }
    return blocks;
}

bool measure_pixels_digest(const struct image *image, const struct measure_channels *channels,
                           struct digest *digest, struct err *err)
{
    const float *rgb[3];
    if (!find_channels(image, "the image", channels, rgb, err))
        return false;
    float *row = malloc((3 * (size_t)image->width + 1) * sizeof(*row));
    if (row == NULL)
        return err_set(err, ERR_MEMORY, "out of memory");

    struct digest_stream *stream = digest_begin();
    for (uint32_t y = 0; y < image->height; y++) {
        for (uint32_t x = 0; x < image->width; x++)
            for (int c = 0; c < 3; c++)
                row[3 * (size_t)x + (size_t)c] = rgb[c][(size_t)y * image->width + x];
        digest_add(stream, row, 3 * (size_t)image->width * sizeof(*row));
    }
    *digest = digest_end(stream);
    free(row);
    return true;
}
