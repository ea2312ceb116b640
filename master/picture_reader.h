/*
 * The picture readers' inside: what they are given, what they share, and each format's entry.
 * Nothing outside master/picture_*.c and its tests includes this.
 *
 * A reader fills a zeroed picture, and leaves freeing its pixels to the caller even when it fails.
 */
#ifndef MASTER_PICTURE_READER_H
#define MASTER_PICTURE_READER_H

#include "common/err.h"
#include "master/picture_file.h"

/* A file in memory. */
struct picture_source {
    const uint8_t *bytes;
    size_t size;
    const char *name; /* for errors */
    uint64_t limit;   /* bytes that may be allocated at once */
};

/*
 * Set the picture's shape and allocate its pixels, zeroed: width * height * channels values of
 * `format`, from which the encoding follows. Fails when the pixels are beyond the limit or there
 * are none.
 */
bool picture_reader_allocate(const struct picture_source *source, uint64_t width, uint64_t height,
                             uint32_t channels, enum picture_format format, struct picture *picture,
                             struct err *err);

/* Bytes of one pixel and of one row. */
size_t picture_reader_pixel_size(const struct picture *picture);
size_t picture_reader_row_size(const struct picture *picture);

/* The error for a file that is shorter than its header promises. */
static inline bool picture_reader_ends_early(const struct picture_source *source, struct err *err)
{
    return err_set(err, ERR_SCENE, "%s: ends early, after %zu bytes", source->name, source->size);
}

/* The value of a half, exactly. */
float picture_reader_float(uint16_t half);

#define PICTURE_READERS(X) \
    X(png)                 \
    X(jpeg)                \
    X(tga)                 \
    X(hdr)                 \
    X(pfm)                 \
    X(exr)

#define X(name)                                                                              \
    bool picture_##name##_read(const struct picture_source *source, struct picture *picture, \
                               struct err *err);
PICTURE_READERS(X)
#undef X

#endif
