#include "master/picture_file.h"

#include "master/picture_reader.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

/* Deflate, the densest of the formats' coders, turns a byte into 1032 at most */
const struct picture_limits picture_file_generous = { (uint64_t)4 << 30, 1100 };
const struct picture_limits picture_file_strict = { (uint64_t)64 << 20, 64 };

typedef bool read_fn(const struct picture_source *source, struct picture *picture, struct err *err);

static bool has_mark(const struct picture_source *source, const char *mark, size_t size)
{
    return source->size >= size && memcmp(source->bytes, mark, size) == 0;
}

static read_fn *reader_by_content(const struct picture_source *source)
{
    static const struct {
        const char *mark;
        size_t size;
        read_fn *read;
    } marks[] = {
        { "\x89PNG\r\n\x1a\n", 8, picture_png_read },
        { "\xff\xd8\xff", 3, picture_jpeg_read },
        { "\x76\x2f\x31\x01", 4, picture_exr_read },
        { "#?", 2, picture_hdr_read },
        { "PF\n", 3, picture_pfm_read },
        { "Pf\n", 3, picture_pfm_read },
        { "PF\r\n", 4, picture_pfm_read },
        { "Pf\r\n", 4, picture_pfm_read },
        { "PF ", 3, picture_pfm_read },
        { "Pf ", 3, picture_pfm_read },
    };
    for (size_t i = 0; i < sizeof(marks) / sizeof(marks[0]); i++)
        if (has_mark(source, marks[i].mark, marks[i].size))
            return marks[i].read;

    /* Newer TGA files have a mark at the end, where the text's final zero belongs to it */
    static const char tga_mark[18] = "TRUEVISION-XFILE.";
    if (source->size > sizeof(tga_mark) &&
        memcmp(source->bytes + source->size - sizeof(tga_mark), tga_mark, sizeof(tga_mark)) == 0)
        return picture_tga_read;
    return NULL;
}

static read_fn *reader_by_name(const char *name)
{
    static const struct {
        const char *ending;
        read_fn *read;
    } endings[] = {
        { ".png", picture_png_read },   { ".jpg", picture_jpeg_read },
        { ".jpeg", picture_jpeg_read }, { ".tga", picture_tga_read },
        { ".hdr", picture_hdr_read },   { ".pic", picture_hdr_read },
        { ".rgbe", picture_hdr_read },  { ".pfm", picture_pfm_read },
        { ".exr", picture_exr_read },
    };
    size_t length = strlen(name);
    for (size_t i = 0; i < sizeof(endings) / sizeof(endings[0]); i++) {
        size_t ending = strlen(endings[i].ending);
        if (length >= ending && strcasecmp(name + length - ending, endings[i].ending) == 0)
            return endings[i].read;
    }
    return NULL;
}

struct picture *picture_file_read_bytes(const void *bytes, size_t size, const char *name,
                                        const struct picture_limits *limits, struct err *err)
{
    struct picture_source source = { .bytes = bytes, .size = size, .name = name };
    if (limits == NULL)
        limits = &picture_file_generous;
    if (__builtin_mul_overflow(limits->per_byte, (uint64_t)size, &source.limit) ||
        __builtin_add_overflow(limits->flat_bytes, source.limit, &source.limit) ||
        source.limit > PTRDIFF_MAX)
        source.limit = PTRDIFF_MAX;

    if (size == 0) {
        err_set(err, ERR_SCENE, "%s: is empty", name);
        return NULL;
    }
    read_fn *read = reader_by_content(&source);
    if (read == NULL)
        read = reader_by_name(name);
    if (read == NULL) {
        err_set(err, ERR_SCENE, "%s: is no PNG, JPEG, TGA, Radiance HDR, PFM or EXR picture", name);
        return NULL;
    }

    struct picture *picture = calloc(1, sizeof(*picture));
    if (picture == NULL) {
        err_set(err, ERR_MEMORY, "%s: no memory", name);
        return NULL;
    }
    if (!read(&source, picture, err)) {
        picture_file_free(picture);
        return NULL;
    }
    return picture;
}

struct picture *picture_file_read(const char *path, const struct picture_limits *limits,
                                  struct err *err)
{
    struct picture *picture = NULL;
    struct stat status;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* a pipe must not hold us up */
    if (fd < 0 || fstat(fd, &status) != 0) {
        err_set(err, ERR_IO, "%s: cannot be opened: %s", path, strerror(errno));
        goto fail_open;
    }
    if (!S_ISREG(status.st_mode)) {
        err_set(err, ERR_IO, "%s: not a regular file", path);
        goto fail_open;
    }

    /* Read rather than mapped: a file that shrinks meanwhile must be an error and not a signal */
    size_t size = (size_t)status.st_size, done = 0;
    uint8_t *bytes = malloc(size + 1);
    if (bytes == NULL) {
        err_set(err, ERR_MEMORY, "%s: no memory for its %zu bytes", path, size);
        goto fail_open;
    }
    while (done < size) {
        ssize_t got = read(fd, bytes + done, size - done);
        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0) {
            err_set(err, ERR_IO, "%s: reading failed at byte %zu: %s", path, done, strerror(errno));
            goto fail_read;
        }
        if (got == 0)
            break;
        done += (size_t)got;
    }
    picture = picture_file_read_bytes(bytes, done, path, limits, err);
fail_read:
    free(bytes);
fail_open:
    if (fd >= 0)
        close(fd);
    return picture;
}

void picture_file_free(struct picture *picture)
{
    if (picture == NULL)
        return;
    free(picture->pixels);
    free(picture);
}

float picture_file_value(const struct picture *picture, uint32_t x, uint32_t y, uint32_t channel)
{
    size_t i = ((size_t)y * picture->width + x) * picture->channels + channel;
    switch (picture->format) {
    case PICTURE_U8:
        return (float)((const uint8_t *)picture->pixels)[i] / 255;
    case PICTURE_U16:
        return (float)((const uint16_t *)picture->pixels)[i] / 65535;
    case PICTURE_HALF:
        return picture_reader_float(((const uint16_t *)picture->pixels)[i]);
    case PICTURE_FLOAT:
        break;
    }
    return ((const float *)picture->pixels)[i];
}
