/*
 * OpenEXR files, through the library's C core. Written: one part of scanlines, every channel
 * float32, ZIP. Read: the first part of any flat file, scanlines or tiles (full resolution level),
 * half, float or uint channels; luminance stays under its name "Y". DWA compression is read where
 * the library's C core can (3.1.5 cannot, and says so).
 *
 * Both calls block on the disk and are safe from any thread on different images.
 */
#ifndef MASTER_EXR_H
#define MASTER_EXR_H

#include <stdbool.h>

struct err;
struct image;

/*
 * Write through a temporary file, so that `path` is the old file or the whole new one. Attributes
 * become string attributes; names are at most 31 characters, the limit every reader shares.
 */
bool exr_image_write(const struct image *image, const char *path, struct err *err);

/*
 * The caller owns the image. String, int, float and double attributes are kept as text. NULL with a
 * reason for deep data, several parts, subsampled channels, and what is no EXR file.
 */
struct image *exr_image_read(const char *path, struct err *err);

#endif
