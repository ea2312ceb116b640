/*
 * Goal: pictures of every format, made here value by value, come back as they were made; files that
 * people have are read; and what is damaged, cut short or lying about its size is refused with a
 * reason, without crash, leak or memory given on a header's word.
 */
#include "common/err.h"
#include "master/picture_file.h"
#include "tests/scratch.h"

#include <ImfCRgbaFile.h>
#include <dirent.h>
#include <math.h>
#include <openexr.h>
#include <png.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/stat.h>

#include <jpeglib.h>

#include <cmocka.h>

static char folder[256];

static int make_folder(void **state)
{
    (void)state;
    scratch_make(folder);
    return 0;
}

static int remove_folder(void **state)
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

static void put(struct file *file, const void *bytes, size_t size)
{
    if (file->size + size > file->capacity) {
        file->capacity = 2 * (file->size + size);
        file->bytes = realloc(file->bytes, file->capacity);
        assert_non_null(file->bytes);
    }
    memcpy(file->bytes + file->size, bytes, size);
    file->size += size;
}

static void put_byte(struct file *file, unsigned byte)
{
    uint8_t one = (uint8_t)byte;
    put(file, &one, 1);
}

static void put_text(struct file *file, const char *text)
{
    put(file, text, strlen(text));
}

static struct file load(const char *path)
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

static struct picture *read_good(const struct file *file, const char *name)
{
    struct err err = { .text = "" };
    struct picture *picture = picture_file_read_bytes(file->bytes, file->size, name, NULL, &err);
    if (picture == NULL)
        fail_msg("%s: refused: %s", name, err.text);
    assert_non_null(picture->pixels);
    return picture;
}

/* Refused, with the file's name and all of `reason` in the error. */
static void expect_refused(const void *bytes, size_t size, const char *name, const char *reason)
{
    struct err err = { .text = "" };
    struct picture *picture = picture_file_read_bytes(bytes, size, name, NULL, &err);
    if (picture != NULL)
        fail_msg("%s: was read, and \"%s\" expected", name, reason);
    if (strncmp(err.text, name, strlen(name)) != 0 || strstr(err.text, reason) == NULL)
        fail_msg("%s: \"%s\" and not \"%s\"", name, err.text, reason);
    assert_int_not_equal(err.code, ERR_OK);
}

static void expect_shape(const struct picture *picture, uint32_t width, uint32_t height,
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
static unsigned value_at(uint32_t x, uint32_t y, uint32_t c)
{
    return (x * 7 + y * 31 + c * 77 + x * y) & 0xffff;
}

/*
 * Every shorter file is refused, or the same in size (a footer was lost); and files with one bit or
 * byte wrong are read or refused, whatever they become. In a copy without slack, so that the
 * sanitizers see a byte too far.
 */
static void survive_damage(const struct file *file, const char *name, unsigned places)
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

/* --- PNG ---------------------------------------------------------------------------------- */

static void png_put(png_structp png, png_bytep bytes, size_t size)
{
    put(png_get_io_ptr(png), bytes, size);
}

/* Rows are given as they stand in the file. */
static struct file png_file(uint32_t width, uint32_t height, int depth, int color, bool interlaced,
                            uint8_t *rows, size_t row_size, bool transparency)
{
    struct file file = { 0 };
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    if (setjmp(png_jmpbuf(png)) != 0)
        fail_msg("libpng cannot write");
    png_set_write_fn(png, &file, png_put, NULL);
    png_set_IHDR(png, info, width, height, depth, color,
                 interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_BASE,
                 PNG_FILTER_TYPE_BASE);
    if (color == PNG_COLOR_TYPE_PALETTE) {
        png_color palette[256];
        png_byte alpha[256];
        for (unsigned i = 0; i < 256; i++) {
            palette[i] = (png_color){ (png_byte)(3 * i), (png_byte)(255 - i), (png_byte)(i ^ 90) };
            alpha[i] = (png_byte)(255 - 2 * i);
        }
        png_set_PLTE(png, info, palette, 1 << depth);
        if (transparency)
            png_set_tRNS(png, info, alpha, 1 << depth, NULL);
    } else if (transparency) {
        png_color_16 color_16 = { .gray = 1, .red = 7, .green = 84, .blue = 161 };
        png_set_tRNS(png, info, NULL, 0, &color_16);
    }
    png_set_gAMA(png, info, 1.0); /* a claim to ignore */
    png_write_info(png, info);
    png_bytep *list = calloc(height, sizeof(*list));
    for (uint32_t y = 0; y < height; y++)
        list[y] = rows + y * row_size;
    png_write_image(png, list);
    png_write_end(png, NULL);
    free(list);
    png_destroy_write_struct(&png, &info);
    return file;
}

static struct file png_of(int depth, int color, bool interlaced, bool transparency)
{
    enum { WIDTH = 21, HEIGHT = 11 };
    uint32_t channels = color == PNG_COLOR_TYPE_PALETTE
                            ? 1
                            : ((color & 2) != 0 ? 3 : 1) + ((color & 4) != 0);
    uint8_t rows[HEIGHT][WIDTH * 8] = { 0 };
    for (uint32_t y = 0; y < HEIGHT; y++) {
        for (uint32_t i = 0; i < WIDTH * channels; i++) {
            unsigned value = value_at(i / channels, y, i % channels);
            if (depth == 16) {
                rows[y][2 * i] = (uint8_t)(value * 5 >> 8);
                rows[y][2 * i + 1] = (uint8_t)(value * 5);
            } else {
                unsigned shift = 8 - (unsigned)depth - i * (unsigned)depth % 8;
                rows[y][i * (unsigned)depth / 8] |= (uint8_t)((value & ((1u << depth) - 1))
                                                              << shift);
            }
        }
    }
    return png_file(WIDTH, HEIGHT, depth, color, interlaced, rows[0], sizeof(rows[0]),
                    transparency);
}

/* What the reader should make of it, from the definition of the format */
static unsigned png_value(int depth, int color, bool transparency, uint32_t x, uint32_t y,
                          uint32_t c)
{
    unsigned mask = (1u << depth) - 1, full = depth == 16 ? 65535 : 255;
    unsigned v[4];
    for (unsigned i = 0; i < 4; i++)
        v[i] = (depth == 16 ? value_at(x, y, i) * 5 : value_at(x, y, i)) & mask;
    if (color == PNG_COLOR_TYPE_PALETTE) {
        const unsigned rgba[] = { 3 * v[0] & 255, 255 - v[0], v[0] ^ 90, (255 - 2 * v[0]) & 255 };
        return rgba[c];
    }
    if (transparency && color == PNG_COLOR_TYPE_GRAY && c == 1)
        return v[0] == 1 ? 0 : full;
    if (transparency && color == PNG_COLOR_TYPE_RGB && c == 3)
        return v[0] == 7 && v[1] == 84 && v[2] == 161 ? 0 : full;
    return v[c] * full / mask;
}

static void png_pictures_of_every_kind_come_back(void **state)
{
    (void)state;
    static const struct {
        int depth, color;
        bool transparency;
        uint32_t channels;
    } kinds[] = {
        { 1, PNG_COLOR_TYPE_GRAY, false, 1 },    { 2, PNG_COLOR_TYPE_GRAY, false, 1 },
        { 4, PNG_COLOR_TYPE_GRAY, true, 2 },     { 8, PNG_COLOR_TYPE_GRAY, false, 1 },
        { 16, PNG_COLOR_TYPE_GRAY, false, 1 },   { 8, PNG_COLOR_TYPE_GA, false, 2 },
        { 16, PNG_COLOR_TYPE_GA, false, 2 },     { 8, PNG_COLOR_TYPE_RGB, false, 3 },
        { 8, PNG_COLOR_TYPE_RGB, true, 4 },      { 16, PNG_COLOR_TYPE_RGB, false, 3 },
        { 8, PNG_COLOR_TYPE_RGBA, false, 4 },    { 16, PNG_COLOR_TYPE_RGBA, false, 4 },
        { 1, PNG_COLOR_TYPE_PALETTE, false, 3 }, { 2, PNG_COLOR_TYPE_PALETTE, true, 4 },
        { 4, PNG_COLOR_TYPE_PALETTE, false, 3 }, { 8, PNG_COLOR_TYPE_PALETTE, true, 4 },
    };
    for (size_t k = 0; k < 2 * sizeof(kinds) / sizeof(kinds[0]); k++) {
        int depth = kinds[k / 2].depth, color = kinds[k / 2].color;
        bool transparency = kinds[k / 2].transparency;
        struct file file = png_of(depth, color, k % 2, transparency);
        struct picture *picture = read_good(&file, "kind");
        expect_shape(picture, 21, 11, kinds[k / 2].channels,
                     depth == 16 ? PICTURE_U16 : PICTURE_U8);
        for (uint32_t y = 0; y < 11; y++) {
            for (uint32_t x = 0; x < 21; x++) {
                for (uint32_t c = 0; c < picture->channels; c++) {
                    size_t i = (y * 21 + x) * picture->channels + c;
                    unsigned got = depth == 16 ? ((uint16_t *)picture->pixels)[i]
                                               : ((uint8_t *)picture->pixels)[i];
                    assert_int_equal(got, png_value(depth, color, transparency, x, y, c));
                    float scaled = picture_file_value(picture, x, y, c);
                    assert_true(scaled == (float)got / (depth == 16 ? 65535.0f : 255.0f));
                }
            }
        }
        picture_file_free(picture);
        free(file.bytes);
    }
}

static void damaged_png_files_are_refused(void **state)
{
    (void)state;
    for (int interlaced = 0; interlaced < 2; interlaced++) {
        struct file file = png_of(8, PNG_COLOR_TYPE_RGBA, interlaced, false);
        for (size_t size = 9; size < file.size; size++)
            expect_refused(file.bytes, size, "cut.png", size < 45 ? "" : "ends early");
        for (size_t at = 45; at + 12 < file.size; at++) { /* all chunks but the last have a sum */
            file.bytes[at] ^= 4;
            struct picture *picture = picture_file_read_bytes(file.bytes, file.size, "flip.png",
                                                              NULL, NULL);
            bool ancillary = at < 49; /* of a chunk that is left out when its sum is wrong */
            if (picture != NULL && !ancillary)
                fail_msg("a wrong byte %zu goes unnoticed", at);
            picture_file_free(picture);
            file.bytes[at] ^= 4;
        }
        free(file.bytes);
    }
}

/* A header's size with its sum put right */
static void png_claim(struct file *file, uint32_t width, uint32_t height)
{
    for (unsigned i = 0; i < 4; i++) {
        file->bytes[16 + i] = (uint8_t)(width >> (24 - 8 * i));
        file->bytes[20 + i] = (uint8_t)(height >> (24 - 8 * i));
    }
    uint32_t sum = 0xffffffff;
    for (unsigned i = 12; i < 29; i++) {
        sum ^= file->bytes[i];
        for (int bit = 0; bit < 8; bit++)
            sum = sum >> 1 ^ ((sum & 1) != 0 ? 0xedb88320 : 0);
    }
    for (unsigned i = 0; i < 4; i++)
        file->bytes[29 + i] = (uint8_t)(~sum >> (24 - 8 * i));
}

static void sizes_beyond_what_a_file_can_hold_are_refused_before_memory_is_asked_for(void **state)
{
    (void)state;
    struct file png = png_of(16, PNG_COLOR_TYPE_RGBA, false, false);
    png_claim(&png, 60000, 60000);
    expect_refused(png.bytes, png.size, "big.png", "cannot hold the 60000x60000 pixels");
    png_claim(&png, 0x7fffffff, 0x7fffffff);
    expect_refused(png.bytes, png.size, "huge.png", "cannot hold");
    free(png.bytes);

    uint8_t tga[18 + 64] = { [2] = 10, [13] = 0xff, [15] = 0xff, [16] = 32 };
    expect_refused(tga, sizeof(tga), "big.tga", "ends early");
    const char *pfm = "PF 2147483647 2147483647 -1\n0000";
    expect_refused(pfm, strlen(pfm), "big.pfm", "do not fit");
    const char *hdr = "#?RADIANCE\n\n-Y 2147483647 +X 2147483647\n1234";
    expect_refused(hdr, strlen(hdr), "big.hdr", "ends early");
    const char *flat = "#?RADIANCE\n\n-Y 1 +X 2147483647\n1234";
    expect_refused(flat, strlen(flat), "flat.hdr", "more than is believed");
}

static void one_colour_over_16k_by_16k_is_read_unless_the_limits_are_strict(void **state)
{
    (void)state;
    enum { SIDE = 16384 };
    uint8_t *row = malloc(SIDE / 8);
    memset(row, 0xff, SIDE / 8);
    struct file file = png_file(SIDE, SIDE, 1, PNG_COLOR_TYPE_GRAY, false, row, 0, false);
    free(row);
    assert_true(file.size < 100000);

    struct picture *picture = read_good(&file, "flat.png");
    expect_shape(picture, SIDE, SIDE, 1, PICTURE_U8);
    assert_int_equal(((uint8_t *)picture->pixels)[(size_t)SIDE * SIDE - 1], 255);
    picture_file_free(picture);

    struct err err = { .text = "" };
    assert_null(
        picture_file_read_bytes(file.bytes, file.size, "flat.png", &picture_file_strict, &err));
    assert_int_equal(err.code, ERR_LIMIT);
    assert_non_null(strstr(err.text, "16384x16384"));
    free(file.bytes);
}

/* --- JPEG --------------------------------------------------------------------------------- */

enum jpeg_kind { JPEG_GREY, JPEG_COLOR, JPEG_PROGRESSIVE, JPEG_CMYK, JPEG_YCCK, JPEG_SCANS };

/* A smooth picture, 40 x 24, hardly changed by the best quality. */
static unsigned jpeg_value(uint32_t x, uint32_t y, uint32_t c)
{
    return c == 0 ? 20 + 5 * x : c == 1 ? 230 - 8 * y : c == 2 ? 60 + 2 * x + 3 * y : 128 + 2 * x;
}

static struct file jpeg_of(enum jpeg_kind kind)
{
    struct jpeg_compress_struct jpeg;
    struct jpeg_error_mgr errors;
    unsigned char *bytes = NULL;
    unsigned long size = 0;
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    jpeg_mem_dest(&jpeg, &bytes, &size);
    bool four = kind == JPEG_CMYK || kind == JPEG_YCCK;
    jpeg.image_width = 40;
    jpeg.image_height = 24;
    jpeg.input_components = kind == JPEG_GREY ? 1 : four ? 4 : 3;
    jpeg.in_color_space = kind == JPEG_GREY ? JCS_GRAYSCALE : four ? JCS_CMYK : JCS_RGB;
    jpeg_set_defaults(&jpeg);
    if (kind == JPEG_YCCK)
        jpeg_set_colorspace(&jpeg, JCS_YCCK);
    jpeg_set_quality(&jpeg, 100, TRUE);
    for (int c = 0; c < jpeg.num_components; c++)
        jpeg.comp_info[c].h_samp_factor = jpeg.comp_info[c].v_samp_factor = 1;
    if (kind == JPEG_PROGRESSIVE)
        jpeg_simple_progression(&jpeg);
    jpeg_scan_info scans[1 + 3 * 63] = { { 3, { 0, 1, 2 }, 0, 0, 0, 0 } };
    if (kind == JPEG_SCANS) { /* one for each coefficient of each colour */
        for (int i = 0; i < 3 * 63; i++)
            scans[1 + i] = (jpeg_scan_info){ 1, { i / 63 }, i % 63 + 1, i % 63 + 1, 0, 0 };
        jpeg.scan_info = scans;
        jpeg.num_scans = 1 + 3 * 63;
    }
    jpeg_start_compress(&jpeg, TRUE);
    while (jpeg.next_scanline < jpeg.image_height) {
        uint8_t row[40 * 4], *rows = row;
        for (unsigned i = 0; i < 40u * (unsigned)jpeg.input_components; i++)
            row[i] = (uint8_t)jpeg_value(i / (unsigned)jpeg.input_components, jpeg.next_scanline,
                                         i % (unsigned)jpeg.input_components);
        jpeg_write_scanlines(&jpeg, &rows, 1);
    }
    jpeg_finish_compress(&jpeg);
    jpeg_destroy_compress(&jpeg);
    return (struct file){ bytes, size, size };
}

static void jpeg_pictures_come_back_nearly(void **state)
{
    (void)state;
    for (int kind = JPEG_GREY; kind <= JPEG_YCCK; kind++) {
        struct file file = jpeg_of((enum jpeg_kind)kind);
        struct picture *picture = read_good(&file, "photo");
        expect_shape(picture, 40, 24, kind == JPEG_GREY ? 1 : 3, PICTURE_U8);
        for (uint32_t y = 0; y < 24; y++) {
            for (uint32_t x = 0; x < 40; x++) {
                for (uint32_t c = 0; c < picture->channels; c++) {
                    double want = jpeg_value(x, y, c);
                    if (kind >= JPEG_CMYK) /* as Adobe stores it: what light is left */
                        want *= jpeg_value(x, y, 3) / 255.0;
                    double got = 255 * (double)picture_file_value(picture, x, y, c);
                    if (fabs(got - want) > 4)
                        fail_msg("kind %d at (%u, %u), channel %u: %g, not %g", kind, x, y, c, got,
                                 want);
                }
            }
        }
        picture_file_free(picture);
        free(file.bytes);
    }
}

static void damaged_jpeg_files_are_refused(void **state)
{
    (void)state;
    for (int kind = JPEG_GREY; kind <= JPEG_YCCK; kind++) {
        struct file file = jpeg_of((enum jpeg_kind)kind);
        for (size_t size = 3; size < file.size; size += size < 700 ? 1 : 13)
            expect_refused(file.bytes, size, "cut.jpg", "");
        survive_damage(&file, "bad.jpg", 400);
        free(file.bytes);
    }
}

static void a_jpeg_with_endless_scans_is_refused(void **state)
{
    (void)state;
    struct file file = jpeg_of(JPEG_SCANS);
    expect_refused(file.bytes, file.size, "a.jpg", "has more than 100 scans");
    free(file.bytes);
}

/* --- TGA ---------------------------------------------------------------------------------- */

struct tga_kind {
    unsigned kind, bits, map_bits, alpha_bits, origin; /* origin: the descriptor's two bits */
    uint32_t channels;
};

enum { TGA_WIDTH = 19, TGA_HEIGHT = 9, TGA_FIRST = 5, TGA_COLORS = 40 };

/* The channels of a colour of so many bits, from those of value_at */
static void tga_color(unsigned bits, uint32_t x, uint32_t y, uint8_t packed[4], uint8_t rgba[4])
{
    unsigned v[4];
    for (uint32_t c = 0; c < 4; c++)
        v[c] = value_at(x, y, c) & 255;
    if (bits >= 24) {
        for (unsigned c = 0; c < 4; c++)
            rgba[c] = (uint8_t)v[c];
        packed[0] = rgba[2];
        packed[1] = rgba[1];
        packed[2] = rgba[0];
        packed[3] = rgba[3];
        return;
    }
    unsigned word = (v[0] >> 3) << 10 | (v[1] >> 3) << 5 | v[2] >> 3 | (v[3] >> 7) << 15;
    packed[0] = (uint8_t)word;
    packed[1] = (uint8_t)(word >> 8);
    for (unsigned c = 0; c < 3; c++)
        rgba[c] = (uint8_t)lround((v[c] >> 3) * 255 / 31.0);
    rgba[3] = v[3] >> 7 ? 255 : 0;
}

/* The pixel (x, y), top row first: its bytes in the file, and what they mean */
static void tga_pixel(const struct tga_kind *k, uint32_t x, uint32_t y, uint8_t packed[4],
                      uint8_t want[4])
{
    /* Columns in pairs and triples, so that there is something to run over */
    x = x < 12 ? x / 4 : x;
    switch (k->kind & 3) {
    case 1: {
        unsigned index = value_at(x, y, 0) % TGA_COLORS;
        uint8_t ignored[4];
        packed[0] = (uint8_t)(index + TGA_FIRST);
        packed[1] = 0;
        tga_color(k->map_bits, index, 3, ignored, want);
        break;
    }
    case 2:
        tga_color(k->bits, x, y, packed, want);
        break;
    default:
        for (unsigned c = 0; c < 2; c++)
            packed[c] = want[c] = (uint8_t)value_at(x, y, c);
    }
}

static struct file tga_of(const struct tga_kind *k, bool footer)
{
    struct file file = { 0 };
    bool mapped = (k->kind & 3) == 1;
    const uint8_t header[18] = {
        [0] = 3,
        [1] = mapped,
        [2] = (uint8_t)k->kind,
        [3] = mapped ? TGA_FIRST : 0,
        [5] = mapped ? TGA_COLORS : 0,
        [7] = (uint8_t)k->map_bits,
        [12] = TGA_WIDTH,
        [14] = TGA_HEIGHT,
        [16] = (uint8_t)k->bits,
        [17] = (uint8_t)(k->alpha_bits | k->origin << 4),
    };
    put(&file, header, sizeof(header));
    put(&file, "an", 3);
    for (uint32_t i = 0; mapped && i < TGA_COLORS; i++) {
        uint8_t packed[4], want[4];
        tga_color(k->map_bits, i, 3, packed, want);
        put(&file, packed, (k->map_bits + 7) / 8);
    }

    uint8_t pixels[TGA_WIDTH * TGA_HEIGHT][4], want[4];
    for (uint32_t i = 0; i < TGA_WIDTH * TGA_HEIGHT; i++) {
        uint32_t x = i % TGA_WIDTH, y = i / TGA_WIDTH;
        tga_pixel(k, (k->origin & 1) != 0 ? TGA_WIDTH - 1 - x : x,
                  (k->origin & 2) != 0 ? y : TGA_HEIGHT - 1 - y, pixels[i], want);
    }
    size_t size = (k->bits + 7) / 8;
    for (uint32_t i = 0; i < TGA_WIDTH * TGA_HEIGHT;) {
        if (k->kind < 8) {
            put(&file, pixels[i++], size);
            continue;
        }
        uint32_t run = 1, left = TGA_WIDTH * TGA_HEIGHT - i; /* across rows, too */
        while (run < left && run < 128 && memcmp(pixels[i], pixels[i + run], size) == 0)
            run++;
        if (run > 1) {
            put_byte(&file, 127 + run);
            put(&file, pixels[i], size);
        } else {
            run = left < 3 ? left : 3;
            put_byte(&file, run - 1);
            for (uint32_t j = 0; j < run; j++)
                put(&file, pixels[i + j], size);
        }
        i += run;
    }
    if (footer)
        put(&file, "\0\0\0\0\0\0\0\0TRUEVISION-XFILE.", 26);
    return file;
}

static const struct tga_kind tga_kinds[] = {
    { 1, 8, 24, 0, 2, 3 },  { 1, 8, 15, 0, 0, 3 },  { 1, 8, 16, 1, 1, 4 },  { 1, 16, 32, 8, 3, 4 },
    { 2, 15, 0, 0, 0, 3 },  { 2, 16, 0, 1, 2, 4 },  { 2, 16, 0, 0, 2, 3 },  { 2, 24, 0, 0, 0, 3 },
    { 2, 32, 0, 8, 1, 4 },  { 2, 32, 0, 0, 2, 4 },  { 3, 8, 0, 0, 3, 1 },   { 3, 16, 0, 8, 0, 2 },
    { 9, 8, 24, 0, 0, 3 },  { 9, 16, 16, 1, 1, 4 }, { 10, 15, 0, 0, 2, 3 }, { 10, 16, 0, 1, 3, 4 },
    { 10, 24, 0, 0, 0, 3 }, { 10, 32, 0, 8, 2, 4 }, { 11, 8, 0, 0, 0, 1 },  { 11, 16, 0, 8, 2, 2 },
};
#define TGA_KINDS (sizeof(tga_kinds) / sizeof(tga_kinds[0]))

static void tga_pictures_of_every_kind_come_back(void **state)
{
    (void)state;
    for (size_t i = 0; i < TGA_KINDS; i++) {
        const struct tga_kind *k = &tga_kinds[i];
        bool footer = i % 2; /* without one, the name has to say what it is */
        struct file file = tga_of(k, footer);
        struct picture *picture = read_good(&file, footer ? "texture" : "texture.TGA");
        expect_shape(picture, TGA_WIDTH, TGA_HEIGHT, k->channels, PICTURE_U8);
        for (uint32_t y = 0; y < TGA_HEIGHT; y++) {
            for (uint32_t x = 0; x < TGA_WIDTH; x++) {
                uint8_t packed[4], want[4];
                tga_pixel(k, x, y, packed, want);
                const uint8_t *got = (uint8_t *)picture->pixels + (y * TGA_WIDTH + x) * k->channels;
                for (uint32_t c = 0; c < k->channels; c++)
                    if (got[c] != want[c])
                        fail_msg("kind %zu at (%u, %u), channel %u: %u, not %u", i, x, y, c, got[c],
                                 want[c]);
            }
        }
        picture_file_free(picture);
        free(file.bytes);
    }
}

static void a_tga_whose_alpha_is_neither_promised_nor_set_has_none(void **state)
{
    (void)state;
    uint8_t bytes[18 + 8] = { [2] = 2, [12] = 2, [14] = 1, [16] = 32, [17] = 32 };
    memcpy(bytes + 18, "abc\0def\0", 8);
    struct file file = { bytes, sizeof(bytes), 0 };
    struct picture *picture = read_good(&file, "old.tga");
    expect_shape(picture, 2, 1, 3, PICTURE_U8);
    assert_memory_equal(picture->pixels, "cbafed", 6);
    picture_file_free(picture);

    bytes[17] = 32 | 8; /* promised: transparent */
    picture = read_good(&file, "clear.tga");
    expect_shape(picture, 2, 1, 4, PICTURE_U8);
    picture_file_free(picture);
}

static void bad_tga_files_are_refused_with_a_reason(void **state)
{
    (void)state;
    for (size_t i = 0; i < TGA_KINDS; i++) {
        struct file file = tga_of(&tga_kinds[i], false);
        for (size_t size = 1; size < file.size; size += size < 60 ? 1 : 7)
            expect_refused(file.bytes, size, "cut.tga", "ends early");
        survive_damage(&file, "bad.tga", 300);
        free(file.bytes);
    }
    static const struct {
        const char *what;
        unsigned at, byte;
        const char *reason;
    } rows[] = {
        { "kind 4", 2, 4, "is no TGA picture (kind 4" },
        { "kind 32", 2, 32, "is no TGA picture" },
        { "no width", 12, 0, "is empty" },
        { "7 bits", 16, 7, "of 7 bits" },
        { "a map of 9 bits", 7, 9, "a map of 9 bits" },
        { "interleaved", 17, 0x40, "interleaved" },
        { "no map", 1, 0, "want a colour map" },
        { "colour below the map", 21 + 3 * TGA_COLORS, 4, "colour 4, and the map has 40 from 5" },
        { "colour above the map", 21 + 3 * TGA_COLORS, 45, "colour 45, and the map has 40 from 5" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct file file = tga_of(&tga_kinds[0], false);
        file.bytes[rows[i].at] = (uint8_t)rows[i].byte;
        expect_refused(file.bytes, file.size, "bad.tga", rows[i].reason);
        free(file.bytes);
    }
}

/* --- Radiance HDR ------------------------------------------------------------------------- */

enum hdr_coding { HDR_FLAT, HDR_OLD, HDR_NEW };
enum { HDR_WIDTH = 21, HDR_HEIGHT = 10 };

static void hdr_pixel(uint32_t x, uint32_t y, uint8_t rgbe[4])
{
    x = x < 12 ? x / 6 : x; /* something to run over */
    for (uint32_t c = 0; c < 3; c++)
        rgbe[c] = (uint8_t)(value_at(x, y, c) | 128);
    rgbe[3] = (uint8_t)(y == 3 ? 0 : 120 + x);
}

static void hdr_new_line(struct file *file, uint8_t (*line)[4], uint32_t length)
{
    put_byte(file, 2);
    put_byte(file, 2);
    put_byte(file, length >> 8);
    put_byte(file, length & 255);
    for (int c = 0; c < 4; c++) {
        for (uint32_t x = 0; x < length;) {
            uint32_t run = 1;
            while (x + run < length && run < 127 && line[x + run][c] == line[x][c])
                run++;
            if (run > 2) {
                put_byte(file, 128 + run);
                put_byte(file, line[x][c]);
            } else {
                put_byte(file, run);
                for (uint32_t i = 0; i < run; i++)
                    put_byte(file, line[x + i][c]);
            }
            x += run;
        }
    }
}

static void hdr_old_line(struct file *file, uint8_t (*line)[4], uint32_t length)
{
    for (uint32_t x = 0; x < length;) {
        uint32_t run = 0;
        put(file, line[x++], 4);
        while (x + run < length && memcmp(line[x + run], line[x - 1], 4) == 0)
            run++;
        if (run > 0)
            put(file, (uint8_t[]){ 1, 1, 1, (uint8_t)run }, 4);
        x += run;
    }
}

static struct file hdr_of(const char *variables, const char *resolution, enum hdr_coding coding)
{
    struct file file = { 0 };
    put_text(&file, "#?RADIANCE\n# by hand\nFORMAT=32-bit_rle_rgbe\n");
    put_text(&file, variables);
    put_text(&file, "\n");
    put_text(&file, resolution);
    put_text(&file, "\n");
    bool along_y = strchr(resolution, 'X') < strchr(resolution, 'Y');
    bool x_reversed = strstr(resolution, "-X") != NULL;
    bool y_reversed = strstr(resolution, "+Y") != NULL;
    uint32_t length = along_y ? HDR_HEIGHT : HDR_WIDTH, count = along_y ? HDR_WIDTH : HDR_HEIGHT;
    for (uint32_t i = 0; i < count; i++) {
        uint8_t line[HDR_WIDTH][4];
        for (uint32_t k = 0; k < length; k++) {
            uint32_t x = along_y ? i : k, y = along_y ? k : i;
            hdr_pixel(x_reversed ? HDR_WIDTH - 1 - x : x, y_reversed ? HDR_HEIGHT - 1 - y : y,
                      line[k]);
        }
        if (coding == HDR_NEW)
            hdr_new_line(&file, line, length);
        else if (coding == HDR_OLD)
            hdr_old_line(&file, line, length);
        else
            put(&file, line, 4 * length);
    }
    return file;
}

static void hdr_pictures_come_back_in_every_order_and_coding(void **state)
{
    (void)state;
    static const char *const resolutions[] = { "-Y 10 +X 21", "+Y 10 +X 21", "-Y 10 -X 21",
                                               "+Y 10 -X 21", "+X 21 -Y 10", "+X 21 +Y 10",
                                               "-X 21 -Y 10", "-X 21 +Y 10" };
    for (int i = 0; i < 8 * 3; i++) {
        bool exposed = i % 2;
        struct file file = hdr_of(exposed ? "EXPOSURE=2\nEXPOSURE= 4\nCOLORCORR=1 2 0.5\n" : "",
                                  resolutions[i / 3], (enum hdr_coding)(i % 3));
        struct picture *picture = read_good(&file, "probe");
        expect_shape(picture, HDR_WIDTH, HDR_HEIGHT, 3, PICTURE_FLOAT);
        for (uint32_t y = 0; y < HDR_HEIGHT; y++) {
            for (uint32_t x = 0; x < HDR_WIDTH; x++) {
                uint8_t rgbe[4];
                hdr_pixel(x, y, rgbe);
                for (uint32_t c = 0; c < 3; c++) {
                    float want = rgbe[3] == 0 ? 0 : ldexpf(rgbe[c], rgbe[3] - 136);
                    want /= !exposed ? 1 : c == 0 ? 8.0f : c == 1 ? 16.0f : 4.0f;
                    assert_true(picture_file_value(picture, x, y, c) == want);
                }
            }
        }
        picture_file_free(picture);
        free(file.bytes);
    }
}

static void bad_hdr_files_are_refused_with_a_reason(void **state)
{
    (void)state;
    for (int coding = HDR_FLAT; coding <= HDR_NEW; coding++) {
        struct file file = hdr_of("", "-Y 10 +X 21", (enum hdr_coding)coding);
        for (size_t size = 2; size < file.size; size++)
            expect_refused(file.bytes, size, "cut.hdr", "");
        survive_damage(&file, "bad.hdr", 600);
        free(file.bytes);
    }
    static const struct {
        const char *text, *reason;
    } rows[] = {
        { "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n....", "32-bit_rle_xyze" },
        { "#?RADIANCE\nEXPOSURE=zero\n\n-Y 1 +X 1\n....", "EXPOSURE=zero" },
        { "#?RADIANCE\nEXPOSURE=-1\n\n-Y 1 +X 1\n....", "is no exposure" },
        { "#?RADIANCE\nEXPOSURE=1e20\nEXPOSURE=1e20\n\n-Y 1 +X 1\n....", "makes no sense" },
        { "#?RADIANCE\nCOLORCORR=1 1\n\n-Y 1 +X 1\n....", "is no colour correction" },
        { "#?RADIANCE\n\n-Y 1 +Y 1\n....", "byte 12: no resolution" },
        { "#?RADIANCE\n\n-Y 0 +X 1\n....", "no resolution" },
        { "#?RADIANCE\n\n-Y 1.5 +X 1\n....", "no resolution" },
        { "#?RADIANCE\n\nY 1 X 1\n....", "no resolution" },
        { "#?RADIANCE\n\n-Y 1 +X 1", "no resolution" },
        { "#?RADIANCE\nVIEW=x\n", "header has no end" },
        { "#?RADIANCE\n\n-Y 1 +X 9\n\2\2\0\10.......", "another length" },
        { "#?RADIANCE\n\n-Y 1 +X 9\n\2\2\0\11\212.......", "longer than its scanline" },
        { "#?RADIANCE\n\n-Y 1 +X 9\n\2\2\0\11\0.......", "" },
        { "#?RADIANCE\n\n-Y 1 +X 2\n\1\1\1\1....", "repeats nothing" },
        { "#?RADIANCE\n\n-Y 1 +X 2\n....\1\1\1\2", "longer than its scanline" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        /* A new-style line of 9 has zeros in its text */
        size_t size = strlen(rows[i].text);
        if (strstr(rows[i].text, "+X 9") != NULL)
            size = (size_t)(strstr(rows[i].text, "+X 9") - rows[i].text) + 17;
        expect_refused(rows[i].text, size, "bad.hdr", rows[i].reason);
    }
}

/* --- PFM ---------------------------------------------------------------------------------- */

static struct file pfm_of(uint32_t channels, bool big_endian, const char *header)
{
    struct file file = { 0 };
    put_text(&file, header);
    for (uint32_t row = 0; row < 5; row++) {
        for (uint32_t i = 0; i < 7 * channels; i++) {
            float value = (float)value_at(i / channels, 4 - row, i % channels) * 0.37f - 9;
            if (row == 0 && i == 0)
                value = INFINITY;
            uint32_t bits;
            memcpy(&bits, &value, 4);
            bits = big_endian ? __builtin_bswap32(bits) : bits;
            put(&file, &bits, 4);
        }
    }
    return file;
}

static void pfm_pictures_come_back_bit_by_bit(void **state)
{
    (void)state;
    static const struct {
        uint32_t channels;
        bool big_endian;
        const char *header;
        float scale;
    } rows[] = {
        { 3, false, "PF\n7 5\n-1.0\n", 1 },     { 1, false, "Pf\n7 5\n-1\n", 1 },
        { 3, true, "PF\n7 5\n1.000000\n", 1 },  { 1, true, "Pf 7\n5 1 ", 1 },
        { 3, false, "PF\r\n7 5\r\n-1\r\n", 1 }, { 1, true, "Pf\n7 5\n0.5\n", 0.5f },
        { 3, false, "PF\n7 5\n-2\n", 2 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct file file = pfm_of(rows[i].channels, rows[i].big_endian, rows[i].header);
        struct picture *picture = read_good(&file, "floats");
        expect_shape(picture, 7, 5, rows[i].channels, PICTURE_FLOAT);
        for (uint32_t y = 0; y < 5; y++) {
            for (uint32_t x = 0; x < 7; x++) {
                for (uint32_t c = 0; c < rows[i].channels; c++) {
                    float want = (float)value_at(x, y, c) * 0.37f - 9;
                    if (x + c == 0 && y == 4)
                        want = INFINITY;
                    assert_true(picture_file_value(picture, x, y, c) == want * rows[i].scale);
                }
            }
        }
        picture_file_free(picture);
        for (size_t size = 3; size < file.size; size++)
            expect_refused(file.bytes, size, "cut.pfm", "");
        survive_damage(&file, "bad.pfm", 300);
        free(file.bytes);
    }
    expect_refused("PF 1 0 -1\n....", 14, "a.pfm", "byte 5: \"0\" is no height");
    expect_refused("PF x 1 -1\n....", 14, "b.pfm", "byte 3: \"x\" is no width");
    expect_refused("PF 1 1 0\n....", 13, "c.pfm", "is no scale");
    expect_refused("PF 1 1 nan\n....", 15, "d.pfm", "is no scale");
    expect_refused("P6 1 1 255\n...", 14, "e.pfm", "does not begin with PF or Pf");
}

/* --- OpenEXR ------------------------------------------------------------------------------ */

enum { EXR_WIDTH = 37, EXR_HEIGHT = 45, EXR_X = -3, EXR_Y = 4 };

struct exr_kind {
    const char *channels[7]; /* in the alphabet's order */
    exr_pixel_type_t type;
    exr_compression_t compression;
    bool tiled, second_part;
};

/* Small whole numbers, which every pixel type holds */
static unsigned exr_value(uint32_t x, uint32_t y, uint32_t c)
{
    return value_at(x, y, c) & 1023;
}

static uint16_t half_of(unsigned whole)
{
    ImfHalf half;
    ImfFloatToHalf((float)whole, &half);
    return half;
}

static void exr_put_part(exr_context_t context, const struct exr_kind *kind, const char *name)
{
    int part;
    const exr_attr_box2i_t data = {
        .min = { .x = EXR_X, .y = EXR_Y },
        .max = { .x = EXR_X + EXR_WIDTH - 1, .y = EXR_Y + EXR_HEIGHT - 1 },
    };
    const exr_attr_box2i_t display = { .min = { .x = -5, .y = 0 }, .max = { .x = 94, .y = 59 } };
    const exr_attr_v2f_t center = { .x = 0, .y = 0 };
    assert_int_equal(
        0,
        exr_add_part(context, name, kind->tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE, &part));
    assert_int_equal(0,
                     exr_initialize_required_attr(context, part, &display, &data, 1, &center, 1,
                                                  EXR_LINEORDER_INCREASING_Y, kind->compression));
    if (kind->tiled)
        assert_int_equal(0, exr_set_tile_descriptor(context, part, 16, 16, EXR_TILE_ONE_LEVEL,
                                                    EXR_TILE_ROUND_DOWN));
    for (int c = 0; kind->channels[c] != NULL; c++)
        assert_int_equal(0, exr_add_channel(context, part, kind->channels[c], kind->type,
                                            EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1));
}

/* One chunk, of which (x, y) is the first pixel. */
static void exr_put_chunk(exr_context_t context, int part, const struct exr_kind *kind,
                          const exr_chunk_info_t *chunk, uint32_t x, uint32_t y)
{
    static uint8_t values[6][16 * EXR_WIDTH * 4 * 4];
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    assert_int_equal(0, exr_encoding_initialize(context, part, chunk, &encoder));
    size_t size = kind->type == EXR_PIXEL_HALF ? 2 : 4;
    for (int16_t c = 0; c < encoder.channel_count; c++) {
        for (uint32_t i = 0; i < (uint32_t)(chunk->width * chunk->height); i++) {
            unsigned value = exr_value(x + i % (uint32_t)chunk->width,
                                       y + i / (uint32_t)chunk->width, (uint32_t)c);
            uint16_t half = half_of(value);
            float real = (float)value;
            const void *from = kind->type == EXR_PIXEL_HALF    ? (void *)&half
                               : kind->type == EXR_PIXEL_FLOAT ? (void *)&real
                                                               : (void *)&value;
            memcpy(values[c] + i * size, from, size);
        }
        exr_coding_channel_info_t *channel = &encoder.channels[c];
        channel->user_bytes_per_element = (int16_t)size;
        channel->user_data_type = (uint16_t)kind->type;
        channel->user_pixel_stride = (int32_t)size;
        channel->user_line_stride = (int32_t)size * chunk->width;
        channel->encode_from_ptr = values[c];
    }
    assert_int_equal(0, exr_encoding_choose_default_routines(context, part, &encoder));
    assert_int_equal(0, exr_encoding_run(context, part, &encoder));
    exr_encoding_destroy(context, &encoder);
}

static void exr_put_pixels(exr_context_t context, int part, const struct exr_kind *kind)
{
    exr_chunk_info_t chunk;
    if (kind->tiled) {
        for (uint32_t y = 0; y < EXR_HEIGHT; y += 16) {
            for (uint32_t x = 0; x < EXR_WIDTH; x += 16) {
                assert_int_equal(0, exr_write_tile_chunk_info(context, part, (int)x / 16,
                                                              (int)y / 16, 0, 0, &chunk));
                exr_put_chunk(context, part, kind, &chunk, x, y);
            }
        }
        return;
    }
    int32_t lines;
    assert_int_equal(0, exr_get_scanlines_per_chunk(context, part, &lines));
    for (uint32_t y = 0; y < EXR_HEIGHT; y += (uint32_t)lines) {
        assert_int_equal(0, exr_write_scanline_chunk_info(context, part, EXR_Y + (int)y, &chunk));
        exr_put_chunk(context, part, kind, &chunk, 0, y);
    }
}

static struct file exr_of(const struct exr_kind *kind)
{
    const char *path = scratch_path(folder, "made.exr");
    exr_context_t context = NULL;
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    assert_int_equal(0, exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, &with));
    exr_put_part(context, kind, kind->second_part ? "first" : NULL);
    struct exr_kind second = *kind;
    second.channels[0] = "Z";
    second.channels[1] = NULL;
    if (kind->second_part)
        exr_put_part(context, &second, "second");
    assert_int_equal(0, exr_write_header(context));
    exr_put_pixels(context, 0, kind);
    if (kind->second_part)
        exr_put_pixels(context, 1, &second);
    assert_int_equal(0, exr_finish(&context));
    return load(path);
}

/* `from`: which of the file's channels each of the picture's is; -1: zero. */
static void expect_exr(const struct picture *picture, const int from[4])
{
    assert_int_equal(picture->data_x, EXR_X + 5);
    assert_int_equal(picture->data_y, EXR_Y);
    assert_int_equal(picture->display_width, 100);
    assert_int_equal(picture->display_height, 60);
    for (uint32_t y = 0; y < EXR_HEIGHT; y++) {
        for (uint32_t x = 0; x < EXR_WIDTH; x++) {
            for (uint32_t c = 0; c < picture->channels; c++) {
                float want = from[c] < 0 ? 0 : (float)exr_value(x, y, (uint32_t)from[c]);
                float got = picture_file_value(picture, x, y, c);
                if (got != want)
                    fail_msg("(%u, %u), channel %u: %g, not %g", x, y, c, (double)got,
                             (double)want);
            }
        }
    }
}

static void exr_pictures_of_every_kind_come_back(void **state)
{
    (void)state;
    static const exr_compression_t compressions[] = {
        EXR_COMPRESSION_NONE, EXR_COMPRESSION_RLE, EXR_COMPRESSION_ZIPS,
        EXR_COMPRESSION_ZIP,  EXR_COMPRESSION_PIZ, EXR_COMPRESSION_PXR24,
    };
    static const exr_pixel_type_t types[] = { EXR_PIXEL_HALF, EXR_PIXEL_FLOAT, EXR_PIXEL_UINT };
    static const int from[] = { 3, 2, 1, 0 };
    for (int i = 0; i < 6 * 3 * 2; i++) {
        struct exr_kind kind = { .channels = { "A", "B", "G", "R", "Z", NULL },
                                 .type = types[i / 2 % 3],
                                 .compression = compressions[i / 6],
                                 .tiled = i % 2,
                                 .second_part = i % 5 == 0 };
        struct file file = exr_of(&kind);
        struct picture *picture = read_good(&file, "layers");
        expect_shape(picture, EXR_WIDTH, EXR_HEIGHT, 4,
                     kind.type == EXR_PIXEL_HALF ? PICTURE_HALF : PICTURE_FLOAT);
        expect_exr(picture, from);
        picture_file_free(picture);
        free(file.bytes);
    }
}

/* The C++ library's reading of the same file is the second opinion. */
static void compare_with_rgba(const struct picture *picture, const char *path)
{
    ImfInputFile *file = ImfOpenInputFile(path);
    assert_non_null(file);
    int min_x, min_y, max_x, max_y;
    ImfHeaderDataWindow(ImfInputHeader(file), &min_x, &min_y, &max_x, &max_y);
    assert_int_equal(picture->width, max_x - min_x + 1);
    assert_int_equal(picture->height, max_y - min_y + 1);
    size_t width = picture->width;
    ImfRgba *pixels = calloc(width * picture->height, sizeof(*pixels));
    uintptr_t origin = (uintptr_t)pixels - (uintptr_t)(((int64_t)min_y * (int64_t)width + min_x) *
                                                       (int64_t)sizeof(*pixels));
    assert_int_equal(1, ImfInputSetFrameBuffer(file, (ImfRgba *)origin, 1, width));
    assert_int_equal(1, ImfInputReadPixels(file, min_y, max_y));
    for (size_t i = 0; i < width * picture->height; i++) {
        const uint16_t *got = (uint16_t *)picture->pixels + i * picture->channels;
        uint16_t want[4] = { pixels[i].r, pixels[i].g, pixels[i].b, pixels[i].a };
        if (memcmp(got, want, 2 * picture->channels) != 0)
            fail_msg("%s: pixel %zu differs", path, i);
    }
    free(pixels);
    ImfCloseInputFile(file);
}

static void exr_pictures_in_lossy_blocks_are_what_others_read(void **state)
{
    (void)state;
    for (int i = 0; i < 4; i++) {
        struct exr_kind kind = { .channels = { "A", "B", "G", "R" },
                                 .type = EXR_PIXEL_HALF,
                                 .compression = i < 2 ? EXR_COMPRESSION_B44 : EXR_COMPRESSION_B44A,
                                 .tiled = i % 2 };
        struct file file = exr_of(&kind);
        struct picture *picture = read_good(&file, "blocks");
        expect_shape(picture, EXR_WIDTH, EXR_HEIGHT, 4, PICTURE_HALF);
        compare_with_rgba(picture, scratch_path(folder, "made.exr"));
        picture_file_free(picture);
        free(file.bytes);
    }
}

static void exr_channels_are_chosen_as_the_header_says(void **state)
{
    (void)state;
    static const struct {
        const char *channels[7];
        uint32_t count;
        int from[4];
    } rows[] = {
        { { "B", "G", "R" }, 3, { 2, 1, 0 } },
        { { "Y" }, 1, { 0 } },
        { { "A", "Y" }, 2, { 1, 0 } },
        { { "R", "a.B", "a.G", "a.R" }, 1, { 0 } },
        { { "G", "R" }, 3, { 1, 0, -1 } },
        { { "B", "G" }, 3, { -1, 1, 0 } },
        { { "Z", "a.A", "a.B", "a.G", "a.R", "b.Y" }, 4, { 4, 3, 2, 1 } },
        { { "Z", "a.X", "b.c.A", "b.c.Y" }, 2, { 3, 2 } },
        { { "depth.V", "height" }, 1, { 0 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct exr_kind kind = { .type = EXR_PIXEL_HALF, .compression = EXR_COMPRESSION_ZIP };
        memcpy(kind.channels, rows[i].channels, sizeof(kind.channels));
        struct file file = exr_of(&kind);
        struct picture *picture = read_good(&file, "channels");
        expect_shape(picture, EXR_WIDTH, EXR_HEIGHT, rows[i].count, PICTURE_HALF);
        expect_exr(picture, rows[i].from);
        picture_file_free(picture);
        free(file.bytes);
    }
}

/* What the C++ library writes through its C interface: DWA, and luminance with chroma. */
static struct file rgba_of(int compression, int channels, bool tiled)
{
    const char *path = scratch_path(folder, "rgba.exr");
    static ImfRgba pixels[64 * 80];
    for (int y = 0; y < 80; y++)
        for (int x = 0; x < 64; x++)
            pixels[64 * y + x] = (ImfRgba){ half_of((unsigned)(100 + x)),
                                            half_of((unsigned)(300 - y)),
                                            half_of((unsigned)(200 + x + y)),
                                            half_of((unsigned)(y % 2)) };
    ImfHeader *header = ImfNewHeader();
    ImfHeaderSetDataWindow(header, -10, 20, 53, 99);
    ImfHeaderSetDisplayWindow(header, 0, 0, 127, 127);
    ImfHeaderSetCompression(header, compression);
    const ImfRgba *origin = (const ImfRgba *)((uintptr_t)pixels -
                                              (uintptr_t)((20 * 64 - 10) * (int)sizeof(*pixels)));
    if (tiled) {
        ImfTiledOutputFile *out = ImfOpenTiledOutputFile(path, header, channels, 32, 32,
                                                         IMF_MIPMAP_LEVELS, IMF_ROUND_DOWN);
        assert_non_null(out);
        assert_int_equal(1, ImfTiledOutputSetFrameBuffer(out, origin, 1, 64));
        assert_int_equal(1, ImfTiledOutputWriteTiles(out, 0, 1, 0, 2, 0, 0));
        for (int level = 1; level < 7; level++) /* smaller ones, of anything */
            assert_int_equal(1, ImfTiledOutputWriteTiles(out, 0, 0, 0, level == 1, level, level));
        ImfCloseTiledOutputFile(out);
    } else {
        ImfOutputFile *out = ImfOpenOutputFile(path, header, channels);
        assert_non_null(out);
        assert_int_equal(1, ImfOutputSetFrameBuffer(out, origin, 1, 64));
        assert_int_equal(1, ImfOutputWritePixels(out, 80));
        ImfCloseOutputFile(out);
    }
    ImfDeleteHeader(header);
    return load(path);
}

static void dwa_and_luminance_chroma_come_back_nearly(void **state)
{
    (void)state;
    static const struct {
        int compression, channels;
        bool tiled;
        uint32_t count;
    } rows[] = {
        { IMF_DWAA_COMPRESSION, IMF_WRITE_RGBA, false, 4 },
        { IMF_DWAB_COMPRESSION, IMF_WRITE_RGB, false, 3 },
        { IMF_DWAA_COMPRESSION, IMF_WRITE_RGB, true, 3 },
        { IMF_DWAB_COMPRESSION, IMF_WRITE_RGBA, true, 4 },
        { IMF_DWAA_COMPRESSION, IMF_WRITE_Y, false, 1 },
        { IMF_DWAB_COMPRESSION, IMF_WRITE_YA, false, 2 },
        { IMF_PIZ_COMPRESSION, IMF_WRITE_YC, false, 3 },
        { IMF_DWAA_COMPRESSION, IMF_WRITE_YCA, false, 4 },
        { IMF_ZIP_COMPRESSION, IMF_WRITE_RGBA, true, 4 }, /* mipmaps by the C core */
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct file file = rgba_of(rows[i].compression, rows[i].channels, rows[i].tiled);
        struct picture *picture = read_good(&file, "by-rgba");
        expect_shape(picture, 64, 80, rows[i].count, PICTURE_HALF);
        assert_int_equal(picture->data_x, -10);
        assert_int_equal(picture->data_y, 20);
        for (uint32_t y = 0; y < 80; y++) {
            for (uint32_t x = 0; x < 64; x++) {
                float rgb[] = { 100 + (float)x, 300 - (float)y, 200 + (float)(x + y) };
                float grey = 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
                for (uint32_t c = 0; c < rows[i].count; c++) {
                    bool alpha = picture->has_alpha && c == rows[i].count - 1;
                    float want = alpha ? (float)(y % 2) : rows[i].count < 3 ? grey : rgb[c];
                    float got = picture_file_value(picture, x, y, c);
                    if (!(fabsf(got - want) <= (alpha ? 0 : 10)))
                        fail_msg("file %zu at (%u, %u), channel %u: %g, not %g", i, x, y, c,
                                 (double)got, (double)want);
                }
            }
        }
        picture_file_free(picture);
        survive_damage(&file, "bad.exr", 120);
        free(file.bytes);
    }
}

static void damaged_exr_files_are_read_or_refused(void **state)
{
    (void)state;
    static const exr_compression_t compressions[] = { EXR_COMPRESSION_NONE,  EXR_COMPRESSION_RLE,
                                                      EXR_COMPRESSION_ZIP,   EXR_COMPRESSION_PIZ,
                                                      EXR_COMPRESSION_PXR24, EXR_COMPRESSION_B44 };
    for (int i = 0; i < 12; i++) {
        struct exr_kind kind = { .channels = { "B", "G", "R" },
                                 .type = EXR_PIXEL_HALF,
                                 .compression = compressions[i / 2],
                                 .tiled = i % 2 };
        struct file file = exr_of(&kind);
        for (size_t size = 4; size < file.size; size += 1 + size / 16)
            expect_refused(file.bytes, size, "cut.exr", "");
        survive_damage(&file, "bad.exr", 400);
        free(file.bytes);
    }
}

/* --- Telling formats apart ---------------------------------------------------------------- */

static void the_content_decides_and_then_the_name(void **state)
{
    (void)state;
    struct file png = png_of(8, PNG_COLOR_TYPE_RGB, false, false);
    struct picture *picture = read_good(&png, "actually.jpg");
    expect_shape(picture, 21, 11, 3, PICTURE_U8);
    picture_file_free(picture);
    free(png.bytes);

    expect_refused("", 0, "nothing.png", "is empty");
    expect_refused("GIF89a..", 8, "a.gif", "is no PNG, JPEG, TGA");
    expect_refused("GIF89a..", 8, "png", "is no PNG, JPEG, TGA");
    expect_refused("GIF89a..", 8, "a.PNG", "");
    expect_refused("GIF89a..", 8, "a.jpeg", "");
    expect_refused("GIF89a..", 8, "a.hdr", "does not begin with #?");
    expect_refused("GIF89a..", 8, "a.exr", "");
    expect_refused("GIF89a..", 8, "a.pfm", "does not begin with PF");
}

static void files_are_read_by_path_and_missing_ones_are_errors(void **state)
{
    (void)state;
    struct file file = pfm_of(3, false, "PF\n7 5\n-1\n");
    const char *path = scratch_path(folder, "on-disk.pfm");
    scratch_write(path, file.bytes, file.size);
    struct err err = { .text = "" };
    struct picture *picture = picture_file_read(path, &picture_file_strict, &err);
    assert_non_null(picture);
    expect_shape(picture, 7, 5, 3, PICTURE_FLOAT);
    picture_file_free(picture);
    free(file.bytes);

    assert_null(picture_file_read(scratch_path(folder, "missing.png"), NULL, &err));
    assert_non_null(strstr(err.text, "missing.png: cannot be opened: No such file"));
    assert_null(picture_file_read(folder, NULL, &err));
    assert_non_null(strstr(err.text, "not a regular file"));
    assert_null(picture_file_read("/dev/zero", NULL, &err));
    assert_non_null(strstr(err.text, "not a regular file"));
    picture_file_free(NULL);
}

static void every_half_has_its_value(void **state)
{
    (void)state;
    uint16_t half;
    struct picture picture = { .width = 1, .height = 1, .channels = 1, .format = PICTURE_HALF };
    picture.pixels = &half;
    for (unsigned bits = 0; bits < 65536; bits++) {
        half = (uint16_t)bits;
        float got = picture_file_value(&picture, 0, 0, 0), want = ImfHalfToFloat(half);
        if (memcmp(&got, &want, 4) != 0)
            fail_msg("half %04x: %g, not %g", bits, (double)got, (double)want);
    }
}

/* --- Files that people have --------------------------------------------------------------- */

/* A path in the shared test data, or NULL (and the test is skipped). */
static const char *shared(const char *name)
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

static void the_odd_exr_files_are_read_and_their_ruins_survived(void **state)
{
    (void)state;
    static const char *const folders[] = { "exr-samples/TestImages", "exr-samples/DisplayWindow",
                                           "envmaps", "bmw-m6/textures" };
    for (unsigned i = 0; i < 4; i++) {
        const char *base = shared(folders[i]);
        if (base == NULL)
            skip();
        DIR *dir = opendir(base);
        assert_non_null(dir);
        for (struct dirent *entry; (entry = readdir(dir)) != NULL;) {
            if (strstr(entry->d_name, ".exr") == NULL)
                continue;
            char path[2048];
            snprintf(path, sizeof(path), "%s/%s", base, entry->d_name);
            struct err err = { .text = "" };
            struct picture *picture = picture_file_read(path, &picture_file_strict, &err);
            if (picture == NULL)
                fail_msg("%s", err.text);
            if (strcmp(entry->d_name, "WideFloatRange.exr") == 0)
                expect_shape(picture, 500, 500, 1, PICTURE_FLOAT);
            else
                compare_with_rgba(picture, path);
            assert_int_equal(picture->has_primaries,
                             strcmp(entry->d_name, "WideColorGamut.exr") == 0 ||
                                 strcmp(entry->d_name, "city.exr") == 0);
            picture_file_free(picture);
            struct file file = load(path);
            survive_damage(&file, entry->d_name, i < 2 ? 10 : 2);
            free(file.bytes);
        }
        closedir(dir);
    }
}

static double mean_of(const struct picture *picture, uint32_t first_row, uint32_t rows)
{
    double sum = 0;
    for (uint32_t y = first_row; y < first_row + rows; y++)
        for (uint32_t x = 0; x < picture->width; x++)
            for (uint32_t c = 0; c < picture->channels; c++)
                sum += (double)picture_file_value(picture, x, y, c);
    return sum / ((double)picture->width * rows * picture->channels);
}

static void the_sunset_is_bright_above_and_dark_below(void **state)
{
    (void)state;
    const char *path = shared("envmaps/sunset.exr");
    if (path == NULL)
        skip();
    struct picture *picture = picture_file_read(path, NULL, NULL);
    assert_non_null(picture);
    expect_shape(picture, 1024, 512, 3, PICTURE_HALF);
    double above = mean_of(picture, 0, 256), below = mean_of(picture, 256, 256);
    assert_true(isfinite(above) && above > 2 * below && below > 0);
    picture_file_free(picture);
}

static void textures_and_probes_of_real_scenes_are_read(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint32_t width, height, channels;
        enum picture_format format;
        double mean; /* as a reader of these two formats in another language has it */
    } rows[] = {
        { "gltf-shaderball/env3.hdr", 1500, 750, 3, PICTURE_FLOAT, 0.76360215 },
        { "gltf-shaderball/std_env.hdr", 1500, 750, 3, PICTURE_FLOAT, 0.644380512 },
        { "gltf-blender/04_common_materials/04_crate.png", 512, 512, 4, PICTURE_U8, 0.627142282 },
        { "gltf-blender/14_emission_strength/14_emission_strength.png", 128, 128, 3, PICTURE_U16,
          0.333325435 },
        { "gltf-blender/02_suzanne/02_suzanne_Normal.png", 1024, 1024, 4, PICTURE_U8, 0.749996752 },
        { "gltf-blender/01_alpha_mask/01_alpha_mask.png", 512, 512, 4, PICTURE_U8, 0.327536314 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        const char *path = shared(rows[i].name);
        if (path == NULL)
            skip();
        struct err err = { .text = "" };
        struct picture *picture = picture_file_read(path, &picture_file_strict, &err);
        if (picture == NULL)
            fail_msg("%s", err.text);
        expect_shape(picture, rows[i].width, rows[i].height, rows[i].channels, rows[i].format);
        double mean = mean_of(picture, 0, picture->height);
        if (!(fabs(mean - rows[i].mean) <= 1e-6 * rows[i].mean))
            fail_msg("%s: mean %.9g, not %.9g", rows[i].name, mean, rows[i].mean);
        picture_file_free(picture);
        struct file file = load(path);
        survive_damage(&file, rows[i].name, 8);
        free(file.bytes);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(png_pictures_of_every_kind_come_back),
        cmocka_unit_test(damaged_png_files_are_refused),
        cmocka_unit_test(sizes_beyond_what_a_file_can_hold_are_refused_before_memory_is_asked_for),
        cmocka_unit_test(one_colour_over_16k_by_16k_is_read_unless_the_limits_are_strict),
        cmocka_unit_test(jpeg_pictures_come_back_nearly),
        cmocka_unit_test(damaged_jpeg_files_are_refused),
        cmocka_unit_test(a_jpeg_with_endless_scans_is_refused),
        cmocka_unit_test(tga_pictures_of_every_kind_come_back),
        cmocka_unit_test(a_tga_whose_alpha_is_neither_promised_nor_set_has_none),
        cmocka_unit_test(bad_tga_files_are_refused_with_a_reason),
        cmocka_unit_test(hdr_pictures_come_back_in_every_order_and_coding),
        cmocka_unit_test(bad_hdr_files_are_refused_with_a_reason),
        cmocka_unit_test(pfm_pictures_come_back_bit_by_bit),
        cmocka_unit_test(exr_pictures_of_every_kind_come_back),
        cmocka_unit_test(exr_pictures_in_lossy_blocks_are_what_others_read),
        cmocka_unit_test(exr_channels_are_chosen_as_the_header_says),
        cmocka_unit_test(dwa_and_luminance_chroma_come_back_nearly),
        cmocka_unit_test(damaged_exr_files_are_read_or_refused),
        cmocka_unit_test(the_content_decides_and_then_the_name),
        cmocka_unit_test(files_are_read_by_path_and_missing_ones_are_errors),
        cmocka_unit_test(every_half_has_its_value),
        cmocka_unit_test(the_odd_exr_files_are_read_and_their_ruins_survived),
        cmocka_unit_test(the_sunset_is_bright_above_and_dark_below),
        cmocka_unit_test(textures_and_probes_of_real_scenes_are_read),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
