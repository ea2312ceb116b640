/*
 * Pictures on their way into a scene: read from files or memory (picture_file.h), given their
 * pyramid of half sizes, and appended to the texels of the scene in the making. A file is read
 * once, however many textures use it in the same way.
 *
 * Texels stay as small as the file has them: 8 bits as 8 bits, halves as halves. 16-bit integers
 * become floats when they are linear and halves when they are not; so do 8 bits with a gamma.
 * The pyramid's texels are box averages of linear values in double, rounded once per level.
 *
 * Texels that are no colour are mended, and counted: NaN and, unless wished for, what is negative
 * become 0; infinity becomes the largest half.
 */
#ifndef MASTER_SCENE_PICTURES_H
#define MASTER_SCENE_PICTURES_H

#include "master/growing.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct scene_build;

/* Of integers; alpha, halves and floats are linear whatever is wished for. */
enum texel_encoding {
    ENCODING_AS_FOUND = 0, /* sRGB, as pbrt takes integers too */
    ENCODING_SRGB = 1,
    ENCODING_LINEAR = 2,
    ENCODING_GAMMA = 3, /* value^gamma */
};

struct picture_wish {
    enum texel_encoding encoding;
    double gamma;
    bool pyramid;       /* else the full size alone */
    bool single;        /* one channel: alpha when any pixel lets light through, else the mean of
                           the colours, as pbrt makes numbers of pictures */
    bool keep_negative; /* the values are heights or the like */
};

/* What was read already; zero-initialised at first. Lives as long as the reader. */
struct scene_pictures {
    struct growing known;
    uint64_t mended; /* texels of the latest picture; 0 when it was known already */
};
void scene_pictures_free(struct scene_pictures *pictures);

/* The picture in file `path`, as an index into build->pictures. ERR_SCENE and the like say why
 * not. */
bool scene_pictures_read(struct scene_pictures *pictures, struct scene_build *build,
                         const char *path, const struct picture_wish *wish, uint32_t *index,
                         struct err *err);

/* The same from memory; `name` is unique among the scene's pictures, and used for errors. */
bool scene_pictures_read_bytes(struct scene_pictures *pictures, struct scene_build *build,
                               const void *bytes, size_t size, const char *name,
                               const struct picture_wish *wish, uint32_t *index, struct err *err);

#endif
