/*
 * PFM: "PF" (colour) or "Pf" (grey), width, height, and a scale whose sign is the byte order, then
 * floats from the bottom row up. A scale other than 1 multiplies the values.
 */
#include "master/number.h"
#include "master/picture_reader.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

static bool is_space(uint8_t byte)
{
    return byte == ' ' || byte == '\t' || byte == '\n' || byte == '\r';
}

/* The next word of the header, and one white space behind it; false at the end of the file. */
static bool next_word(const struct picture_source *source, size_t *at, const char **begin,
                      const char **end)
{
    while (*at < source->size && is_space(source->bytes[*at]))
        (*at)++;
    *begin = (const char *)source->bytes + *at;
    while (*at < source->size && !is_space(source->bytes[*at]))
        (*at)++;
    *end = (const char *)source->bytes + *at;
    if (*at == source->size)
        return false;
    (*at)++;
    return true;
}

bool picture_pfm_read(const struct picture_source *source, struct picture *picture, struct err *err)
{
    size_t at = 2;
    if (source->size < 3 || source->bytes[0] != 'P' ||
        (source->bytes[1] != 'F' && source->bytes[1] != 'f') || !is_space(source->bytes[2]))
        return err_set(err, ERR_SCENE, "%s: is no PFM picture: does not begin with PF or Pf",
                       source->name);
    uint32_t channels = source->bytes[1] == 'F' ? 3 : 1;

    static const char *const names[] = { "width", "height", "scale" };
    double numbers[3];
    for (int i = 0; i < 3; i++) {
        const char *begin, *end;
        if (!next_word(source, &at, &begin, &end))
            return picture_reader_ends_early(source, err);
        bool good = number_parse(begin, end, &numbers[i]);
        if (good)
            good = i == 2 ? isfinite((float)numbers[i]) && (float)numbers[i] != 0
                          : numbers[i] >= 1 && numbers[i] <= INT32_MAX &&
                                numbers[i] == floor(numbers[i]);
        if (!good)
            return err_set(err, ERR_SCENE, "%s: byte %zu: \"%.*s\" is no %s", source->name,
                           at - 1 - (size_t)(end - begin),
                           (int)(end - begin < 40 ? end - begin : 40), begin, names[i]);
    }
    uint64_t size = (uint64_t)numbers[0] * (uint64_t)numbers[1];
    if (source->bytes[at - 1] == '\r' && at < source->size && source->bytes[at] == '\n')
        at++; /* a line's end on other systems */
    if ((source->size - at) / 4 / channels < size)
        return err_set(err, ERR_SCENE,
                       "%s: ends early: %.0fx%.0f pixels of %u floats do not fit in %zu bytes",
                       source->name, numbers[0], numbers[1], (unsigned)channels, source->size - at);

    if (!picture_reader_allocate(source, (uint64_t)numbers[0], (uint64_t)numbers[1], channels,
                                 PICTURE_FLOAT, picture, err))
        return false;
    size_t row_size = picture_reader_row_size(picture);
    for (uint32_t y = 0; y < picture->height; y++)
        memcpy((uint8_t *)picture->pixels + (picture->height - 1 - y) * row_size,
               source->bytes + at + y * row_size, row_size);

    bool swapped = numbers[2] > 0; /* big-endian */
    float scale = fabsf((float)numbers[2]);
    float *values = picture->pixels;
    for (size_t i = 0; i < size * channels && (swapped || scale != 1); i++) {
        uint32_t bits;
        memcpy(&bits, &values[i], sizeof(bits));
        if (swapped)
            bits = __builtin_bswap32(bits);
        memcpy(&values[i], &bits, sizeof(bits));
        if (scale != 1)
            values[i] *= scale;
    }
    return true;
}
