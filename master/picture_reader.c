#include "master/picture_reader.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

size_t picture_reader_pixel_size(const struct picture *picture)
{
    static const size_t sizes[] = {
        [PICTURE_U8] = 1,
        [PICTURE_U16] = 2,
        [PICTURE_HALF] = 2,
        [PICTURE_FLOAT] = 4,
    };
    return sizes[picture->format] * picture->channels;
}

size_t picture_reader_row_size(const struct picture *picture)
{
    return picture_reader_pixel_size(picture) * picture->width;
}

bool picture_reader_allocate(const struct picture_source *source, uint64_t width, uint64_t height,
                             uint32_t channels, enum picture_format format, struct picture *picture,
                             struct err *err)
{
    if (width == 0 || height == 0)
        return err_set(err, ERR_SCENE, "%s: a picture of %" PRIu64 "x%" PRIu64 " pixels is empty",
                       source->name, width, height);
    picture->channels = channels;
    picture->format = format;
    uint64_t row_size, size;
    if (width > INT32_MAX || height > INT32_MAX ||
        __builtin_mul_overflow(width, picture_reader_pixel_size(picture), &row_size) ||
        __builtin_mul_overflow(row_size, height, &size) || size > source->limit)
        return err_set(err, ERR_LIMIT,
                       "%s: its header claims %" PRIu64 "x%" PRIu64
                       " pixels, more than is believed of a file of %zu bytes",
                       source->name, width, height, source->size);

    picture->width = picture->display_width = (uint32_t)width;
    picture->height = picture->display_height = (uint32_t)height;
    picture->has_alpha = channels == 2 || channels == 4;
    picture->encoding = format == PICTURE_U8 || format == PICTURE_U16 ? PICTURE_SRGB
                                                                      : PICTURE_LINEAR;
    picture->pixels = calloc(1, size);
    if (picture->pixels == NULL)
        return err_set(err, ERR_MEMORY, "%s: no memory for %" PRIu64 "x%" PRIu64 " pixels",
                       source->name, width, height);
    return true;
}

float picture_reader_float(uint16_t half)
{
    uint32_t magnitude = half & 0x7fffu, bits = magnitude << 13;
    float value;
    if (magnitude < 0x400) { /* too small to be normal; so is its float, bit by bit */
        value = (float)magnitude * 0x1p-24f;
    } else {
        bits += magnitude < 0x7c00 ? (127u - 15) << 23 : (255u - 31) << 23;
        memcpy(&value, &bits, sizeof(value));
    }
    return (half & 0x8000) != 0 ? -value : value;
}
