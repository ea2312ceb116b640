/*
 * Radiance HDR: RGBE pixels, flat or run-length coded in the old way or the new, in any of the
 * eight orders of pixels. Values are radiances: EXPOSURE and COLORCORR, which say what the pixels
 * were multiplied by, are divided out.
 */
#include "master/number.h"
#include "master/picture_reader.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LINE_MAX_BYTES 2048

struct header {
    size_t data;        /* where pixels begin */
    double exposure[3]; /* what they were multiplied by */
    /* The file's scanlines run along one axis of the picture, and follow each other along the
     * other */
    uint32_t length, count;
    bool along_y;    /* scanlines are columns */
    bool x_reversed; /* from right to left */
    bool y_reversed; /* from the bottom up */
};

/* The next line, without its end; false when there is none, or it is too long. */
static bool next_line(const struct picture_source *source, size_t *at, char line[LINE_MAX_BYTES])
{
    size_t left = source->size - *at;
    const uint8_t *begin = source->bytes + *at, *end = memchr(begin, '\n', left);
    if (end == NULL || end - begin >= LINE_MAX_BYTES)
        return false;
    size_t length = (size_t)(end - begin);
    *at += length + 1;
    if (length > 0 && begin[length - 1] == '\r')
        length--;
    memcpy(line, begin, length);
    line[length] = '\0';
    return true;
}

/* `count` numbers with blanks between them; false when there are not that many, or not positive. */
static bool parse_numbers(const char *text, double *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        text += strspn(text, " \t");
        size_t length = strcspn(text, " \t");
        if (!number_parse(text, text + length, &numbers[i]) || !(numbers[i] > 0) ||
            !isfinite(numbers[i]))
            return false;
        text += length;
    }
    return text[strspn(text, " \t")] == '\0';
}

/* A line of the header: what it says about the pixels. */
static bool read_variable(const struct picture_source *source, const char *line,
                          struct header *header, struct err *err)
{
    double factors[3];
    if (strncmp(line, "EXPOSURE=", 9) == 0) {
        if (!parse_numbers(line + 9, factors, 1))
            return err_set(err, ERR_SCENE, "%s: \"%.60s\" is no exposure", source->name, line);
        factors[1] = factors[2] = factors[0];
    } else if (strncmp(line, "COLORCORR=", 10) == 0) {
        if (!parse_numbers(line + 10, factors, 3))
            return err_set(err, ERR_SCENE, "%s: \"%.60s\" is no colour correction", source->name,
                           line);
    } else if (strncmp(line, "FORMAT=", 7) == 0) {
        if (strcmp(line + 7, "32-bit_rle_rgbe") != 0)
            return err_set(err, ERR_UNSUPPORTED,
                           "%s: pixels of format \"%.60s\" are not supported, only RGB",
                           source->name, line + 7);
        return true;
    } else {
        return true;
    }
    for (int c = 0; c < 3; c++) {
        header->exposure[c] *= factors[c]; /* there may be several */
        if (!(header->exposure[c] >= 1e-30 && header->exposure[c] <= 1e30))
            return err_set(err, ERR_SCENE, "%s: \"%.60s\" makes no sense", source->name, line);
    }
    return true;
}

/* "-Y 512 +X 1024": the slow axis first. Y counts upwards, so that -Y is the usual order. */
static bool read_resolution(const char *line, struct header *header)
{
    char axis[2];
    double size[2];
    for (int i = 0; i < 2; i++) {
        line += strspn(line, " ");
        if ((line[0] != '-' && line[0] != '+') || (line[1] != 'X' && line[1] != 'Y'))
            return false;
        axis[i] = line[1];
        bool positive = line[0] == '+';
        if (axis[i] == 'X')
            header->x_reversed = !positive;
        else
            header->y_reversed = positive;
        line += 2;
        line += strspn(line, " ");
        size_t length = strcspn(line, " ");
        if (!number_parse(line, line + length, &size[i]) || !(size[i] >= 1) ||
            size[i] > INT32_MAX || size[i] != floor(size[i]))
            return false;
        line += length;
    }
    if (axis[0] == axis[1] || line[strspn(line, " ")] != '\0')
        return false;
    header->count = (uint32_t)size[0];
    header->length = (uint32_t)size[1];
    header->along_y = axis[1] == 'Y';
    return true;
}

static bool read_header(const struct picture_source *source, struct header *header, struct err *err)
{
    char line[LINE_MAX_BYTES];
    size_t at = 0;
    *header = (struct header){ .exposure = { 1, 1, 1 } };
    if (source->size < 2 || memcmp(source->bytes, "#?", 2) != 0)
        return err_set(err, ERR_SCENE, "%s: is no Radiance picture: does not begin with #?",
                       source->name);
    do {
        if (!next_line(source, &at, line))
            return err_set(err, ERR_SCENE,
                           "%s: byte %zu: the header has no end, or a line beyond %d bytes",
                           source->name, at, LINE_MAX_BYTES);
        if (!read_variable(source, line, header, err))
            return false;
    } while (line[0] != '\0');

    size_t resolution = at;
    if (!next_line(source, &at, line) || !read_resolution(line, header))
        return err_set(err, ERR_SCENE, "%s: byte %zu: no resolution like \"-Y 512 +X 1024\"",
                       source->name, resolution);
    header->data = at;
    return true;
}

/* --- Scanlines ---------------------------------------------------------------------------- */

struct cursor {
    const uint8_t *at, *end;
    const char *failure;
};

static bool fail(struct cursor *in, const char *why)
{
    in->failure = why;
    return false;
}

/* One component after the other, in runs (above 128) and raw stretches. */
static bool read_new_runs(struct cursor *in, uint8_t (*line)[4], uint32_t length)
{
    for (int c = 0; c < 4; c++) {
        for (uint32_t x = 0; x < length;) {
            if (in->end - in->at < 2)
                return fail(in, "ends early");
            bool run = *in->at > 128;
            uint32_t some = run ? *in->at - 128u : *in->at;
            in->at++;
            if (some == 0 || some > length - x)
                return fail(in, "a run is longer than its scanline, or empty");
            if (!run && (size_t)(in->end - in->at) < some)
                return fail(in, "ends early");
            for (uint32_t i = 0; i < some; i++)
                line[x + i][c] = in->at[run ? 0 : i];
            in->at += run ? 1 : some;
            x += some;
        }
    }
    return true;
}

/* Pixels as they are; one of (1, 1, 1, n) repeats the one before, the next such 256 times that. */
static bool read_old_runs(struct cursor *in, uint8_t (*line)[4], uint32_t length)
{
    unsigned shift = 0;
    for (uint32_t x = 0; x < length;) {
        if (in->end - in->at < 4)
            return fail(in, "ends early");
        const uint8_t *pixel = in->at;
        in->at += 4;
        if (pixel[0] != 1 || pixel[1] != 1 || pixel[2] != 1) {
            memcpy(line[x++], pixel, 4);
            shift = 0;
            continue;
        }
        if (x == 0 || shift > 24)
            return fail(in, "a run that repeats nothing");
        uint64_t some = (uint64_t)pixel[3] << shift;
        if (some > length - x)
            return fail(in, "a run is longer than its scanline");
        for (uint64_t i = 0; i < some; i++, x++)
            memcpy(line[x], line[x - 1], 4);
        shift += 8;
    }
    return true;
}

static bool read_scanline(struct cursor *in, uint8_t (*line)[4], uint32_t length)
{
    const uint8_t *at = in->at;
    bool is_new = length >= 8 && length <= 32767 && in->end - at >= 4 && at[0] == 2 && at[1] == 2 &&
                  at[2] < 128;
    if (!is_new)
        return read_old_runs(in, line, length);
    if ((at[2] << 8 | at[3]) != (int)length)
        return fail(in, "a scanline of another length than the picture's");
    in->at += 4;
    return read_new_runs(in, line, length);
}

/* 2^n for the exponents there are, exactly. */
static double power_of_two(int n)
{
    double power = 1;
    for (; n > 0; n--)
        power *= 2;
    for (; n < 0; n++)
        power /= 2;
    return power;
}

bool picture_hdr_read(const struct picture_source *source, struct picture *picture, struct err *err)
{
    struct header header;
    if (!read_header(source, &header, err))
        return false;

    if (header.count > (source->size - header.data) / 4) /* a scanline takes a pixel at least */
        return picture_reader_ends_early(source, err);
    uint32_t width = header.along_y ? header.count : header.length;
    uint32_t height = header.along_y ? header.length : header.count;
    if (!picture_reader_allocate(source, width, height, 3, PICTURE_FLOAT, picture, err))
        return false;
    uint8_t(*line)[4] = calloc(header.length, 4);
    if (line == NULL)
        return err_set(err, ERR_MEMORY, "%s: no memory", source->name);

    /* What a mantissa is worth with each exponent; exponent 0 is black, whatever the mantissas */
    float worth[256][3];
    for (int e = 0; e < 256; e++)
        for (int c = 0; c < 3; c++)
            worth[e][c] = e > 0 ? (float)(power_of_two(e - 136) / header.exposure[c]) : 0;

    struct cursor in = { source->bytes + header.data, source->bytes + source->size, NULL };
    float *values = picture->pixels;
    for (uint32_t i = 0; i < header.count && in.failure == NULL; i++) {
        if (!read_scanline(&in, line, header.length))
            break;
        for (uint32_t k = 0; k < header.length; k++) {
            uint32_t x = header.along_y ? i : k, y = header.along_y ? k : i;
            x = header.x_reversed ? width - 1 - x : x;
            y = header.y_reversed ? height - 1 - y : y;
            float *rgb = values + 3 * ((size_t)y * width + x);
            for (int c = 0; c < 3; c++)
                rgb[c] = (float)line[k][c] * worth[line[k][3]][c];
        }
    }
    free(line);
    if (in.failure != NULL)
        return err_set(err, ERR_SCENE, "%s: byte %zu: %s", source->name,
                       (size_t)(in.at - source->bytes), in.failure);
    return true;
}
