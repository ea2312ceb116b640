/*
 * Picture files for textures and environment maps: PNG, JPEG, TGA, Radiance HDR, PFM and OpenEXR,
 * told apart by their content, and by the ending of their name where the content does not say
 * (only TGA has no mark of its own). Values stay as the file has them: 8 bits stay 8, 16 stay 16,
 * halves stay halves, so that a texture takes no more memory than it must.
 *
 * The caller owns the picture. Calls block on the disk and are safe from any thread. An error names
 * the file, the place in it where there is one, and what is wrong; damaged and truncated files are
 * refused, never half read.
 */
#ifndef MASTER_PICTURE_FILE_H
#define MASTER_PICTURE_FILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

enum picture_format {
    PICTURE_U8,    /* uint8_t, 255 means 1 */
    PICTURE_U16,   /* uint16_t in the machine's byte order, 65535 means 1 */
    PICTURE_HALF,  /* IEEE binary16 in a uint16_t */
    PICTURE_FLOAT, /* float; infinities and NaNs as the file has them */
};

/* What the colour values mean. Alpha is linear always. */
enum picture_encoding {
    PICTURE_SRGB,   /* of integers: the sRGB curve, whatever a file's gamma chunk claims */
    PICTURE_LINEAR, /* of halves and floats */
};

struct picture {
    uint32_t width, height;
    uint32_t channels; /* 1: grey; 2: grey, alpha; 3: red, green, blue; 4: with alpha */
    enum picture_format format;
    enum picture_encoding encoding;
    bool has_alpha; /* the last channel; colours are multiplied by it only in EXR files */
    void *pixels;   /* channels of a pixel side by side, row by row, top row first, no padding */

    /* EXR: the pixels are those of the data window, which sits here in the display window; other
     * files: the same window. Textures and environment maps use the pixels and ignore this. */
    int32_t data_x, data_y;
    uint32_t display_width, display_height;

    /* EXR, when the file says: x and y of red, green, blue and white; otherwise sRGB is meant */
    bool has_primaries;
    float primaries[8];
};

/*
 * What a file of `size` bytes may make us allocate at once: flat_bytes + per_byte * size. Whatever
 * a header claims is also held against what the rest of the file could possibly decode to.
 */
struct picture_limits {
    uint64_t flat_bytes, per_byte;
};

/* For files the user named: one colour over 16384 x 16384 pixels in any format is well inside. */
extern const struct picture_limits picture_file_generous;
/* For files of strangers: 64 MiB and 64 bytes per byte. */
extern const struct picture_limits picture_file_strict;

/* NULL with a reason. `limits` may be NULL: generous. */
struct picture *picture_file_read(const char *path, const struct picture_limits *limits,
                                  struct err *err);

/* The same from memory, which may go afterwards. `name` is for errors, and its ending is a hint. */
struct picture *picture_file_read_bytes(const void *bytes, size_t size, const char *name,
                                        const struct picture_limits *limits, struct err *err);

/* picture_file_free(NULL) does nothing. */
void picture_file_free(struct picture *picture);

/* One value as a float: integers scaled to [0, 1], the encoding left as it is. Pure. */
float picture_file_value(const struct picture *picture, uint32_t x, uint32_t y, uint32_t channel);

#endif
