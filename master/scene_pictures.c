#include "master/scene_pictures.h"

#include "common/elem.h"
#include "common/err.h"
#include "master/picture_file.h"
#include "master/scene_build.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SIDE_MAX     (1u << 20) /* texels */
#define HALF_LARGEST 65504.0

struct known_picture {
    char *name;
    struct picture_wish wish;
    uint32_t index;
};

void scene_pictures_free(struct scene_pictures *pictures)
{
    struct known_picture *known = pictures->known.data;
    for (size_t i = 0; i < pictures->known.count; i++)
        free(known[i].name);
    growing_free(&pictures->known);
}

/* --- Values ------------------------------------------------------------------------------- */

/* The curve of IEC 61966-2-1 */
static double from_srgb(double value)
{
    return value <= 0.04045 ? value / 12.92 : elem_pow((value + 0.055) / 1.055, 2.4);
}

/* To the nearest half, ties to even; finite, and not above the largest */
static uint16_t to_half(double value)
{
    uint16_t sign = value < 0 ? 0x8000 : 0;
    double size = fabs(value);
    if (size >= HALF_LARGEST)
        return sign | 0x7bff;
    int exponent;
    frexp(size, &exponent); /* size = m 2^exponent, m from 1/2 */
    if (exponent < -13 || size == 0)
        exponent = -13; /* subnormal: the same step as the smallest normal ones */
    double steps = size * ldexp(1, 11 - exponent);
    double whole = floor(steps), rest = steps - whole;
    if (rest > 0.5 || (rest == 0.5 && fmod(whole, 2) == 1))
        whole += 1;
    /* A carry out of the mantissa runs into the exponent, as it should; the leading bit does too */
    return sign | (uint16_t)(((exponent + 13) << 10) + (int)whole);
}

enum take { TAKE_ALL, TAKE_MEAN, TAKE_ALPHA }; /* the latter two make one channel */

/* How the values of a picture's file become linear numbers, and those become texels. */
struct texel_coder {
    const struct picture *file;
    const struct picture_wish *wish;
    enum picture_texel texel;
    uint32_t channels; /* of the texels */
    enum take take;
    double *linear;    /* of integers: what each is worth; NULL for halves and floats */
    double above[256]; /* TEXEL_U8_SRGB: halfway to the next byte, as the eye sees it, for bytes */
    uint8_t guess[1025];
};

static bool is_alpha(const struct picture *file, uint32_t channel)
{
    return file->has_alpha && channel == file->channels - 1;
}

/* As the file has it, but linear */
static double file_value(const struct texel_coder *coder, uint32_t x, uint32_t y, uint32_t channel)
{
    const struct picture *file = coder->file;
    size_t i = ((size_t)y * file->width + x) * file->channels + channel;
    if (file->format == PICTURE_U8) {
        uint8_t value = ((const uint8_t *)file->pixels)[i];
        return is_alpha(file, channel) ? value / 255.0 : coder->linear[value];
    }
    if (file->format == PICTURE_U16) {
        uint16_t value = ((const uint16_t *)file->pixels)[i];
        return is_alpha(file, channel) ? value / 65535.0 : coder->linear[value];
    }
    return picture_file_value(file, x, y, channel);
}

static double mend(const struct texel_coder *coder, double value)
{
    if (isnan(value) || (value < 0 && !coder->wish->keep_negative))
        return 0;
    return isinf(value) ? copysign(HALF_LARGEST, value) : value;
}

/* The mended value of a texel at full size */
static double full_value(const struct texel_coder *coder, uint32_t x, uint32_t y, uint32_t channel)
{
    const struct picture *file = coder->file;
    if (coder->take == TAKE_ALL)
        return mend(coder, file_value(coder, x, y, channel));
    if (coder->take == TAKE_ALPHA)
        return mend(coder, file_value(coder, x, y, file->channels - 1));
    if (file->channels < 3)
        return mend(coder, file_value(coder, x, y, 0));
    double sum = 0;
    for (uint32_t c = 0; c < 3; c++)
        sum += mend(coder, file_value(coder, x, y, c));
    return sum / 3;
}

/* The byte that looks nearest */
static uint8_t to_srgb(const struct texel_coder *coder, double value)
{
    value = value < 0 ? 0 : value > 1 ? 1 : value;
    unsigned byte = coder->guess[(unsigned)(value * 1024)];
    while (byte < 255 && value >= coder->above[byte])
        byte++;
    return (uint8_t)byte;
}

static void store(const struct texel_coder *coder, uint8_t *texels, size_t i, bool alpha,
                  double value)
{
    if (coder->texel == TEXEL_FLOAT) {
        float narrow = (float)value;
        memcpy(texels + 4 * i, &narrow, 4);
    } else if (coder->texel == TEXEL_HALF) {
        uint16_t half = to_half(value);
        memcpy(texels + 2 * i, &half, 2);
    } else if (coder->texel == TEXEL_U8_SRGB && !alpha) {
        texels[i] = to_srgb(coder, value);
    } else {
        texels[i] = (uint8_t)(value * 255 + 0.5);
    }
}

/* --- Setting up --------------------------------------------------------------------------- */

static bool is_opaque(const struct texel_coder *coder)
{
    const struct picture *file = coder->file;
    for (uint32_t y = 0; y < file->height; y++)
        for (uint32_t x = 0; x < file->width; x++)
            if (file_value(coder, x, y, file->channels - 1) != 1)
                return false;
    return true;
}

/* Is the mean of the colours one of them, so that it takes no more bits than they do? */
static bool is_grey(const struct picture *file)
{
    size_t size = file->format == PICTURE_U8 ? 1 : file->format == PICTURE_FLOAT ? 4 : 2;
    size_t pixel = size * file->channels, count = (size_t)file->width * file->height;
    const uint8_t *at = file->pixels;
    for (size_t i = 0; i < count; i++, at += pixel)
        if (memcmp(at, at + size, size) != 0 || memcmp(at, at + 2 * size, size) != 0)
            return false;
    return true;
}

static enum picture_texel choose_texel(const struct texel_coder *coder,
                                       enum texel_encoding encoding)
{
    const struct picture *file = coder->file;
    bool mean = coder->take == TAKE_MEAN && file->channels >= 3 && !is_grey(file);
    bool linear = encoding == ENCODING_LINEAR || coder->take == TAKE_ALPHA;
    switch (file->format) {
    case PICTURE_U8:
        if (encoding == ENCODING_GAMMA && !linear)
            return TEXEL_HALF;
        return mean ? TEXEL_HALF : linear ? TEXEL_U8 : TEXEL_U8_SRGB;
    case PICTURE_U16:
        return linear ? TEXEL_FLOAT : TEXEL_HALF;
    case PICTURE_HALF:
        return mean ? TEXEL_FLOAT : TEXEL_HALF;
    default:
        return TEXEL_FLOAT;
    }
}

static void fill_srgb_bytes(struct texel_coder *coder)
{
    for (int i = 0; i < 256; i++)
        coder->above[i] = i < 255 ? from_srgb((i + 0.5) / 255) : INFINITY;
    unsigned byte = 0;
    for (int i = 0; i <= 1024; i++) {
        while (i / 1024.0 >= coder->above[byte])
            byte++;
        coder->guess[i] = (uint8_t)byte;
    }
}

static bool coder_open(struct texel_coder *coder, const struct picture *file,
                       const struct picture_wish *wish)
{
    enum texel_encoding encoding = wish->encoding;
    if (encoding == ENCODING_AS_FOUND)
        encoding = file->encoding == PICTURE_SRGB ? ENCODING_SRGB : ENCODING_LINEAR;
    *coder = (struct texel_coder){ .file = file, .wish = wish };
    bool integers = file->format == PICTURE_U8 || file->format == PICTURE_U16;
    if (integers) {
        int count = file->format == PICTURE_U8 ? 256 : 65536;
        coder->linear = malloc((size_t)count * sizeof(double));
        if (coder->linear == NULL)
            return false;
        for (int i = 0; i < count; i++) {
            double value = i / (count - 1.0);
            coder->linear[i] = encoding == ENCODING_SRGB    ? from_srgb(value)
                               : encoding == ENCODING_GAMMA ? elem_pow(value, wish->gamma)
                                                            : value;
        }
    }
    if (wish->single)
        coder->take = file->has_alpha && !is_opaque(coder) ? TAKE_ALPHA : TAKE_MEAN;
    coder->channels = wish->single ? 1 : file->channels;
    coder->texel = choose_texel(coder, encoding);
    if (coder->texel == TEXEL_U8_SRGB)
        fill_srgb_bytes(coder);
    return true;
}

/* --- Pyramids ----------------------------------------------------------------------------- */

/*
 * Which texels of a side of `from` the texel `i` of a side of from / 2 covers, and how much of
 * each. Sides round down, so that with from = 2n + 1 a texel covers 2 + 1/n.
 */
struct cover {
    uint32_t first, count;
    double weight[3];
};

static struct cover cover_of(uint32_t from, uint32_t i)
{
    uint32_t n = from / 2;
    if (from == 1)
        return (struct cover){ 0, 1, { 1 } };
    if (from % 2 == 0)
        return (struct cover){ 2 * i, 2, { 0.5, 0.5 } };
    double all = from;
    return (struct cover){ 2 * i, 3, { (n - i) / all, n / all, (i + 1) / all } };
}

/* Halve a level. `values` has the last one, or is NULL for the full size; `out` may be `values`:
 * no texel is written before all that need its place were. */
static void halve(const struct texel_coder *coder, const double *values, uint32_t width,
                  uint32_t height, double *out)
{
    uint32_t channels = coder->channels;
    uint32_t half_width = width > 1 ? width / 2 : 1, half_height = height > 1 ? height / 2 : 1;
    for (uint32_t y = 0; y < half_height; y++) {
        struct cover rows = cover_of(height, y);
        for (uint32_t x = 0; x < half_width; x++, out += channels) {
            struct cover columns = cover_of(width, x);
            double sum[4] = { 0, 0, 0, 0 };
            for (uint32_t j = 0; j < rows.count; j++)
                for (uint32_t i = 0; i < columns.count; i++) {
                    uint32_t from_x = columns.first + i, from_y = rows.first + j;
                    size_t at = ((size_t)from_y * width + from_x) * channels;
                    double weight = rows.weight[j] * columns.weight[i];
                    for (uint32_t c = 0; c < channels; c++)
                        sum[c] += weight * (values != NULL ? values[at + c]
                                                           : full_value(coder, from_x, from_y, c));
                }
            memcpy(out, sum, channels * sizeof(double));
        }
    }
}

static uint64_t level_bytes(enum picture_texel texel, uint64_t width, uint64_t height,
                            uint32_t channels)
{
    static const unsigned sizes[] = {
        [TEXEL_U8] = 1, [TEXEL_U8_SRGB] = 1, [TEXEL_HALF] = 2, [TEXEL_FLOAT] = 4
    };
    return width * height * channels * sizes[texel];
}

static uint64_t all_bytes(const struct scene_picture *picture)
{
    uint64_t bytes = 0;
    for (uint32_t level = 0; level < picture->levels; level++) {
        uint32_t width = picture->width >> level, height = picture->height >> level;
        bytes += level_bytes(picture->texel, width > 0 ? width : 1, height > 0 ? height : 1,
                             picture->channels);
    }
    return bytes;
}

/* Level 0; how many texels were mended */
static uint64_t store_full(const struct texel_coder *coder, uint8_t *texels)
{
    const struct picture *file = coder->file;
    static const enum picture_format as_file[] = { [TEXEL_U8] = PICTURE_U8,
                                                   [TEXEL_U8_SRGB] = PICTURE_U8,
                                                   [TEXEL_HALF] = PICTURE_HALF,
                                                   [TEXEL_FLOAT] = PICTURE_FLOAT };
    bool same = file->format == as_file[coder->texel] && coder->channels == file->channels;
    if (same)
        memcpy(texels, file->pixels,
               level_bytes(coder->texel, file->width, file->height, file->channels));
    if (same && file->format == PICTURE_U8)
        return 0; /* a byte is always good */
    uint64_t mended = 0;
    size_t i = 0;
    for (uint32_t y = 0; y < file->height; y++)
        for (uint32_t x = 0; x < file->width; x++, i += coder->channels) {
            bool good = true;
            for (uint32_t c = 0; c < file->channels; c++) {
                double value = file_value(coder, x, y, c);
                good = good && mend(coder, value) == value; /* a NaN equals nothing */
            }
            mended += !good;
            for (uint32_t c = 0; !(same && good) && c < coder->channels; c++)
                store(coder, texels, i + c, coder->take == TAKE_ALL && is_alpha(file, c),
                      full_value(coder, x, y, c));
        }
    return mended;
}

/* All levels but the first */
static bool store_pyramid(const struct texel_coder *coder, const struct scene_picture *picture,
                          uint8_t *texels)
{
    uint32_t width = picture->width, height = picture->height, channels = coder->channels;
    size_t half = ((size_t)(width > 1 ? width / 2 : 1)) * (height > 1 ? height / 2 : 1);
    double *values = malloc(half * channels * sizeof(double));
    if (values == NULL)
        return false;
    size_t first = (size_t)width * height * channels;
    for (uint32_t level = 1; level < picture->levels; level++) {
        halve(coder, level == 1 ? NULL : values, width, height, values);
        width = width > 1 ? width / 2 : 1;
        height = height > 1 ? height / 2 : 1;
        size_t count = (size_t)width * height * channels;
        for (size_t i = 0; i < count; i++) {
            uint32_t c = (uint32_t)(i % channels);
            store(coder, texels, first + i, coder->take == TAKE_ALL && is_alpha(coder->file, c),
                  values[i]);
        }
        first += count;
    }
    free(values);
    return true;
}

/* --- Into the scene ----------------------------------------------------------------------- */

static bool append(struct scene_pictures *pictures, struct scene_build *build,
                   const struct picture *file, const char *name, const struct picture_wish *wish,
                   uint32_t *index, struct err *err)
{
    if (file->width > SIDE_MAX || file->height > SIDE_MAX)
        return err_set(err, ERR_SCENE, "%s: a side of more than %u pixels", name, SIDE_MAX);
    bool good = false;
    struct texel_coder coder;
    if (!coder_open(&coder, file, wish))
        goto fail_memory;
    struct scene_picture picture = { .first_block = (uint32_t)build->texels.count,
                                     .width = file->width,
                                     .height = file->height,
                                     .channels = coder.channels,
                                     .levels = 1,
                                     .texel = coder.texel };
    uint32_t longer = file->width > file->height ? file->width : file->height;
    while (wish->pyramid && longer >> picture.levels != 0)
        picture.levels++;
    size_t bytes = all_bytes(&picture), blocks = (bytes + TEXEL_BLOCK - 1) / TEXEL_BLOCK;
    if (blocks > UINT32_MAX - 1 - build->texels.count) {
        err_set(err, ERR_SCENE, "%s: the scene's pictures have more than 64 GiB", name);
        goto done;
    }
    struct scene_picture *added = growing_add(&build->pictures, 1, sizeof(*added));
    if (added == NULL)
        goto fail_memory;
    uint8_t *texels = growing_add(&build->texels, blocks, TEXEL_BLOCK);
    if (texels == NULL)
        goto fail_memory;
    memset(texels + bytes, 0, blocks * TEXEL_BLOCK - bytes);
    pictures->mended = store_full(&coder, texels);
    if (picture.levels > 1 && !store_pyramid(&coder, &picture, texels))
        goto fail_memory;
    *added = picture;
    *index = (uint32_t)(build->pictures.count - 1);
    good = true;
    goto done;

fail_memory:
    err_set(err, ERR_MEMORY, "%s: no memory for %ux%u texels", name, file->width, file->height);
done:
    free(coder.linear);
    return good;
}

static bool same_wish(const struct picture_wish *a, const struct picture_wish *b)
{
    return a->encoding == b->encoding && a->pyramid == b->pyramid && a->single == b->single &&
           a->keep_negative == b->keep_negative &&
           (a->encoding != ENCODING_GAMMA || a->gamma == b->gamma);
}

static bool find_known(struct scene_pictures *pictures, const char *name,
                       const struct picture_wish *wish, uint32_t *index)
{
    const struct known_picture *known = pictures->known.data;
    pictures->mended = 0;
    for (size_t i = 0; i < pictures->known.count; i++)
        if (strcmp(known[i].name, name) == 0 && same_wish(&known[i].wish, wish)) {
            *index = known[i].index;
            return true;
        }
    return false;
}

/* Append the picture, which may be NULL: err is set then; and remember it */
static bool add(struct scene_pictures *pictures, struct scene_build *build, struct picture *file,
                const char *name, const struct picture_wish *wish, uint32_t *index, struct err *err)
{
    if (file == NULL)
        return false;
    bool good = append(pictures, build, file, name, wish, index, err);
    picture_file_free(file);
    if (!good)
        return false;
    char *copy = strdup(name);
    struct known_picture *known = copy != NULL ? growing_add(&pictures->known, 1, sizeof(*known))
                                               : NULL;
    if (known == NULL) {
        free(copy);
        return err_set(err, ERR_MEMORY, "%s: no memory", name);
    }
    *known = (struct known_picture){ copy, *wish, *index };
    return true;
}

bool scene_pictures_read(struct scene_pictures *pictures, struct scene_build *build,
                         const char *path, const struct picture_wish *wish, uint32_t *index,
                         struct err *err)
{
    char *real = realpath(path, NULL); /* one file may be named in many ways */
    const char *name = real != NULL ? real : path;
    bool good = find_known(pictures, name, wish, index) ||
                add(pictures, build, picture_file_read(path, NULL, err), name, wish, index, err);
    free(real);
    return good;
}

bool scene_pictures_read_bytes(struct scene_pictures *pictures, struct scene_build *build,
                               const void *bytes, size_t size, const char *name,
                               const struct picture_wish *wish, uint32_t *index, struct err *err)
{
    return find_known(pictures, name, wish, index) ||
           add(pictures, build, picture_file_read_bytes(bytes, size, name, NULL, err), name, wish,
               index, err);
}
