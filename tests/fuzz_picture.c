/*
 * libFuzzer target: any bytes as a picture file, under the strict limits. One source, a target for
 * each format (png, jpeg, tga, hdr, pfm, exr; tests/fuzz.sh builds them). Without FUZZ_FORMAT, the
 * content says which format it is.
 */
#include "common/err.h"
#include "master/picture_file.h"

#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#define TEXT(x)   TEXT_2(x)
#define TEXT_2(x) #x

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* A PNG's sums would keep all but the luckiest changes from the decoder: put them right. */
static void repair_png(uint8_t *bytes, size_t size)
{
    for (size_t at = 8; at + 12 <= size;) {
        size_t length = (size_t)bytes[at] << 24 | (size_t)bytes[at + 1] << 16 |
                        (size_t)bytes[at + 2] << 8 | bytes[at + 3];
        if (length > size - at - 12)
            break;
        uLong sum = crc32(0, bytes + at + 4, (uInt)length + 4);
        for (unsigned i = 0; i < 4; i++)
            bytes[at + 8 + length + i] = (uint8_t)(sum >> (24 - 8 * i));
        at += 12 + length;
    }
}

/* Every value can be looked at. */
static void look(const struct picture *picture)
{
    if (picture->width == 0 || picture->height == 0 || picture->channels < 1 ||
        picture->channels > 4 || picture->has_alpha != (picture->channels % 2 == 0))
        abort();
    volatile float sum = 0;
    for (uint32_t y = 0; y < picture->height; y += 1 + picture->height / 64)
        for (uint32_t x = 0; x < picture->width; x += 1 + picture->width / 64)
            for (uint32_t c = 0; c < picture->channels; c++)
                sum = sum + picture_file_value(picture, x, y, c);
    picture_file_value(picture, picture->width - 1, picture->height - 1, picture->channels - 1);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const char *name = "fuzz";
    uint8_t *bytes = malloc(size > 0 ? size : 1); /* ours to change, and no byte longer */
    memcpy(bytes, data, size);
#ifdef FUZZ_FORMAT
    /* Begin as the format does, so that no input strays to another's reader */
    static const struct {
        const char *name, *mark;
        size_t size;
    } marks[] = {
        { "fuzz.png", "\x89PNG\r\n\x1a\n", 8 }, { "fuzz.jpeg", "\xff\xd8\xff", 3 },
        { "fuzz.hdr", "#?RADIANCE\n", 11 },     { "fuzz.pfm", "PF\n", 3 },
        { "fuzz.exr", "\x76\x2f\x31\x01", 4 },
    };
    name = "fuzz." TEXT(FUZZ_FORMAT);
    for (size_t i = 0; i < sizeof(marks) / sizeof(marks[0]); i++) {
        if (strcmp(name, marks[i].name) == 0 && size >= marks[i].size) {
            bool grey = i == 3 && bytes[1] == 'f';
            memcpy(bytes, marks[i].mark, marks[i].size);
            bytes[1] = grey ? 'f' : bytes[1];
        }
    }
#endif
    if (size > 8 && memcmp(bytes, "\x89PNG", 4) == 0)
        repair_png(bytes, size);

    struct err err = { .code = ERR_OK };
    struct picture *picture = picture_file_read_bytes(bytes, size, name, &picture_file_strict,
                                                      &err);
    if (picture != NULL)
        look(picture);
    else if (err.code == ERR_OK || err.text[0] == '\0')
        abort();
    picture_file_free(picture);
    free(bytes);
    return 0;
}
