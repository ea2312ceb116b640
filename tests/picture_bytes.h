/*
 * For tests of picture files: a folder of the test's own, files made in memory, what must be read
 * or refused, and damage of every kind.
 */
#ifndef TESTS_PICTURE_BYTES_H
#define TESTS_PICTURE_BYTES_H

#include "common/err.h"
#include "master/picture_file.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/stat.h>

#include <cmocka.h>

static char folder[256];

static inline int make_folder(void **state)
{
    (void)state;
    scratch_make(folder);
    return 0;
}

static inline int remove_folder(void **state)
{
    (void)state;
    scratch_remove(folder);
    return 0;
}

/* --- Files in memory ---------------------------------------------------------------------- */

struct file {
    uint8_t *bytes;
    size_t size, capacity;
};

static inline void put(struct file *file, const void *bytes, size_t size)
{
    if (file->size + size > file->capacity) {
        file->capacity = 2 * (file->size + size);
        file->bytes = realloc(file->bytes, file->capacity);
        assert_non_null(file->bytes);
    }
    memcpy(file->bytes + file->size, bytes, size);
    file->size += size;
}

static inline void put_byte(struct file *file, unsigned byte)
{
    uint8_t one = (uint8_t)byte;
    put(file, &one, 1);
}

static inline void put_text(struct file *file, const char *text)
{
    put(file, text, strlen(text));
}

static inline struct file load(const char *path)
{
    struct file file = { 0 };
    FILE *in = fopen(path, "rb");
    assert_non_null(in);
    uint8_t buffer[65536];
    for (size_t got; (got = fread(buffer, 1, sizeof(buffer), in)) > 0;)
        put(&file, buffer, got);
    fclose(in);
    return file;
}

static inline struct picture *read_good(const struct file *file, const char *name)
{
    struct err err = { .text = "" };
    struct picture *picture = picture_file_read_bytes(file->bytes, file->size, name, NULL, &err);
    if (picture == NULL)
        fail_msg("%s: refused: %s", name, err.text);
    assert_non_null(picture->pixels);
    return picture;
}

/* Refused, with the file's name and all of `reason` in the error. */
static inline void expect_refused(const void *bytes, size_t size, const char *name,
                                  const char *reason)
{
    struct err err = { .text = "" };
    struct picture *picture = picture_file_read_bytes(bytes, size, name, NULL, &err);
    if (picture != NULL)
        fail_msg("%s: was read, and \"%s\" expected", name, reason);
    if (strncmp(err.text, name, strlen(name)) != 0 || strstr(err.text, reason) == NULL)
        fail_msg("%s: \"%s\" and not \"%s\"", name, err.text, reason);
    assert_int_not_equal(err.code, ERR_OK);
}

static inline void expect_shape(const struct picture *picture, uint32_t width, uint32_t height,
                                uint32_t channels, enum picture_format format)
{
    assert_int_equal(picture->width, width);
    assert_int_equal(picture->height, height);
    assert_int_equal(picture->channels, channels);
    assert_int_equal(picture->format, format);
    assert_int_equal(picture->has_alpha, channels % 2 == 0);
    bool integers = format == PICTURE_U8 || format == PICTURE_U16;
    assert_int_equal(picture->encoding, integers ? PICTURE_SRGB : PICTURE_LINEAR);
}

/* Different for every place and channel, and asymmetric */
static inline unsigned value_at(uint32_t x, uint32_t y, uint32_t c)
{
    return (x * 7 + y * 31 + c * 77 + x * y) & 0xffff;
}

/*
 * Every shorter file is refused, or the same in size (a footer was lost); and files with one bit or
 * byte wrong are read or refused, whatever they become. In a copy without slack, so that the
 * sanitizers see a byte too far.
 */
static inline void survive_damage(const struct file *file, const char *name, unsigned places)
{
    for (unsigned i = 0; i < places; i++) {
        /* Half of the places in the header, half spread over the file */
        size_t header = file->size < 512 ? file->size : 512;
        size_t at = i < places / 2 ? 2 * i * header / places : (size_t)i * file->size / places;
        if (at >= file->size)
            break;
        struct err err = { .text = "" };
        uint8_t *copy = malloc(at + 1);
        memcpy(copy, file->bytes, at);
        copy = realloc(copy, at > 0 ? at : 1);
        struct picture *picture = picture_file_read_bytes(copy, at, name, &picture_file_strict,
                                                          &err);
        if (picture == NULL)
            assert_true(err.code != ERR_OK && err.text[0] != '\0');
        picture_file_free(picture);
        free(copy);

        copy = malloc(file->size);
        memcpy(copy, file->bytes, file->size);
        copy[at] ^= (uint8_t)(i % 3 == 0 ? 0xff : 1u << i % 8);
        err = (struct err){ .text = "" };
        picture = picture_file_read_bytes(copy, file->size, name, &picture_file_strict, &err);
        if (picture == NULL)
            assert_true(err.code != ERR_OK && err.text[0] != '\0');
        picture_file_free(picture);
        free(copy);
    }
}

/* A path in the shared test data, or NULL (and the test is skipped). */
static inline const char *shared(const char *name)
{
    static char path[4][1024];
    static unsigned next;
    char *text = path[next++ % 4];
    const char *base = getenv("PATHFARM_SHARED"), *source = getenv("PATHFARM_SOURCE");
    if (base != NULL)
        snprintf(text, sizeof(path[0]), "%s/scenes/%s", base, name);
    else
        snprintf(text, sizeof(path[0]), "%s/../shared/scenes/%s", source != NULL ? source : ".",
                 name);
    struct stat status;
    if (stat(text, &status) == 0)
        return text;
    print_message("%s is missing: skipped\n", text);
    return NULL;
}

#endif
