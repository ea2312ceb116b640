/*
 * OpenEXR files, through the library's C core. Written: one part of scanlines, compressed without
 * loss, float32 unless half is asked for. Read: the first part of any flat file, scanlines or tiles
 * (full resolution level), half, float or uint channels; luminance stays under its name "Y". DWA
 * compression is read where the library's C core can (3.1.5 cannot, and says so).
 *
 * Both calls block on the disk and are safe from any thread on different images.
 */
#ifndef MASTER_EXR_H
#define MASTER_EXR_H

#include <stdbool.h>
#include <stdint.h>

struct err;
struct image;

#define EXR_PACKING_MAP(X) /* the compressions that lose nothing */ \
    X(ZIP, 0, "zip")                                                \
    X(ZIPS, 1, "zips")                                              \
    X(PIZ, 2, "piz")                                                \
    X(RLE, 3, "rle")                                                \
    X(NONE, 4, "none")
enum exr_packing {
#define X(name, number, text) EXR_PACKING_##name = number,
    EXR_PACKING_MAP(X)
#undef X
};

/* How pixels are stored; zero is what people want most often. */
struct exr_format {
    bool half; /* channels that are not `exact` have 16 bits */
    enum exr_packing packing;
};

/*
 * Write through a temporary file, so that `path` is the old file or the whole new one. Attributes
 * become string attributes; names are at most 31 characters, the limit every reader shares. As
 * half, finite values beyond 65504 become that; infinities and NaN stay what they are.
 */
bool exr_image_write_as(const struct image *image, const struct exr_format *format,
                        const char *path, struct err *err);
bool exr_image_write(const struct image *image, const char *path, struct err *err);

/* How many values of the image this format would clamp. */
uint64_t exr_values_clamped(const struct image *image, const struct exr_format *format);

/*
 * The caller owns the image. String, int, float and double attributes are kept as text. NULL with a
 * reason for deep data, several parts, subsampled channels, and what is no EXR file.
 */
struct image *exr_image_read(const char *path, struct err *err);

#endif
