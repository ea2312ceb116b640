/* Goal: a picture's texels are those of its file, its pyramid is the box average that a reference
 * in double finds, sizes even and odd; a file is read once; what is no colour is mended. */
#include "common/err.h"
#include "common/scene.h"
#include "master/picture_reader.h"
#include "master/scene_build.h"
#include "master/scene_pictures.h"
#include "tests/scratch.h"

#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#include <cmocka.h>

struct fixture {
    struct scene_build *build;
    struct scene_pictures pictures;
    char folder[256];
};

static int open_fixture(void **state)
{
    static struct fixture fixture;
    fixture = (struct fixture){ .build = scene_build_new() };
    scratch_make(fixture.folder);
    *state = &fixture;
    return fixture.build == NULL;
}

static int close_fixture(void **state)
{
    struct fixture *fixture = *state;
    scene_pictures_free(&fixture->pictures);
    scene_build_free(fixture->build);
    scratch_remove(fixture->folder);
    return 0;
}

/* --- Files in memory ---------------------------------------------------------------------- */

#define BYTES_MAX 65536
struct file {
    uint8_t bytes[BYTES_MAX];
    size_t size;
};

/* Bytes top row first: grey, blue green red, or with alpha */
static void make_tga(struct file *file, unsigned width, unsigned height, unsigned channels,
                     const uint8_t *pixels)
{
    const uint8_t header[18] = { [2] = channels == 1 ? 3 : 2,       [12] = (uint8_t)width,
                                 [13] = (uint8_t)(width >> 8),      [14] = (uint8_t)height,
                                 [15] = (uint8_t)(height >> 8),     [16] = (uint8_t)(8 * channels),
                                 [17] = channels == 4 ? 0x28 : 0x20 };
    memcpy(file->bytes, header, sizeof(header));
    memcpy(file->bytes + sizeof(header), pixels, (size_t)width * height * channels);
    file->size = sizeof(header) + (size_t)width * height * channels;
}

/* One row of colours */
static void make_pfm(struct file *file, unsigned width, unsigned channels, const float *pixels)
{
    int length = snprintf((char *)file->bytes, BYTES_MAX, "%s\n%u 1\n-1.0\n",
                          channels == 3 ? "PF" : "Pf", width);
    size_t size = (size_t)width * channels * sizeof(float);
    memcpy(file->bytes + length, pixels, size);
    file->size = (size_t)length + size;
}

static void put_png(png_structp png, png_bytep bytes, size_t size)
{
    struct file *file = png_get_io_ptr(png);
    assert_true(file->size + size <= BYTES_MAX);
    memcpy(file->bytes + file->size, bytes, size);
    file->size += size;
}

/* One row of grey, 16 bits */
static void make_png(struct file *file, unsigned width, const uint16_t *pixels)
{
    file->size = 0;
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    assert_non_null(info);
    png_set_write_fn(png, file, put_png, NULL);
    png_set_IHDR(png, info, width, 1, 16, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_write_info(png, info);
    png_set_swap(png);
    png_write_row(png, (png_const_bytep)pixels);
    png_write_end(png, NULL);
    png_destroy_write_struct(&png, &info);
}

static const struct scene_picture *add(struct fixture *fixture, const struct file *file,
                                       const char *name, const struct picture_wish *wish)
{
    uint32_t index;
    struct err err = { .text = "" };
    if (!scene_pictures_read_bytes(&fixture->pictures, fixture->build, file->bytes, file->size,
                                   name, wish, &index, &err))
        fail_msg("%s", err.text);
    return (const struct scene_picture *)fixture->build->pictures.data + index;
}

/* --- A reference -------------------------------------------------------------------------- */

static double linear_of(double value)
{
    return value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
}

static double encoded(double linear)
{
    return linear <= 0.04045 / 12.92 ? linear * 12.92 : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

/* How much of texel j of `from` lies in texel i of `to`, as a share of the latter */
static double overlap(unsigned from, unsigned to, unsigned i, unsigned j)
{
    double low = fmax((double)i / to, (double)j / from);
    double high = fmin((i + 1.0) / to, (j + 1.0) / from);
    return high > low ? (high - low) * to : 0;
}

static unsigned halved(unsigned side)
{
    return side > 1 ? side / 2 : 1;
}

static void reference_halve(const double *from, unsigned width, unsigned height, unsigned channels,
                            double *to)
{
    for (unsigned y = 0; y < halved(height); y++)
        for (unsigned x = 0; x < halved(width); x++)
            for (unsigned c = 0; c < channels; c++) {
                double sum = 0;
                for (unsigned j = 0; j < height; j++)
                    for (unsigned i = 0; i < width; i++)
                        sum += overlap(width, halved(width), x, i) *
                               overlap(height, halved(height), y, j) *
                               from[(j * width + i) * channels + c];
                to[(y * halved(width) + x) * channels + c] = sum;
            }
}

/* --- Tests -------------------------------------------------------------------------------- */

static void check_srgb_pyramid(struct fixture *fixture, unsigned width, unsigned height,
                               unsigned channels)
{
    static struct file file;
    static uint8_t pixels[4096];
    static double level[4096], next[4096];
    unsigned random = width * 77 + height * 1001 + channels;
    size_t count = (size_t)width * height * channels;
    assert_true(count <= 4096);
    for (size_t i = 0; i < count; i++) {
        random = random * 1664525 + 1013904223;
        pixels[i] = (uint8_t)(random >> 24);
    }
    make_tga(&file, width, height, channels, pixels);
    char name[64];
    snprintf(name, sizeof(name), "%ux%ux%u.tga", width, height, channels);
    const struct picture_wish wish = { .pyramid = true };
    const struct scene_picture *picture = add(fixture, &file, name, &wish);
    assert_int_equal(picture->texel, TEXEL_U8_SRGB);
    assert_int_equal(picture->width, width);
    assert_int_equal(picture->height, height);
    assert_int_equal(picture->channels, channels);

    for (size_t i = 0; i < count; i++) { /* the file's order is blue, green, red */
        size_t c = i % channels, from = channels >= 3 && c < 3 ? i - c + 2 - c : i;
        level[i] = c == 3 ? pixels[from] / 255.0 : linear_of(pixels[from] / 255.0);
    }
    const uint8_t *texel = (const uint8_t *)fixture->build->texels.data +
                           (size_t)picture->first_block * TEXEL_BLOCK;
    unsigned levels = 0;
    for (;;) {
        for (size_t i = 0; i < (size_t)width * height * channels; i++) {
            double want = 255 * (i % channels == 3 ? level[i] : encoded(level[i]));
            if (!(fabs(want - *texel) <= 0.5 + 1e-9))
                fail_msg("%s, level %u, value %zu: %u, not %.3f", name, levels, i, *texel, want);
            texel++;
        }
        levels++;
        if (width == 1 && height == 1)
            break;
        reference_halve(level, width, height, channels, next);
        memcpy(level, next, sizeof(level));
        width = halved(width);
        height = halved(height);
    }
    assert_int_equal(picture->levels, levels);
}

static void pyramids_are_box_averages_of_light(void **state)
{
    static const unsigned sizes[][3] = { { 8, 8, 3 },  { 7, 5, 3 },  { 1, 1, 3 },  { 11, 1, 1 },
                                         { 1, 13, 3 }, { 6, 31, 4 }, { 29, 3, 1 }, { 27, 19, 4 } };
    for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++)
        check_srgb_pyramid(*state, sizes[i][0], sizes[i][1], sizes[i][2]);
}

static void floats_keep_their_bits_and_average_exactly(void **state)
{
    struct fixture *fixture = *state;
    static struct file file;
    const float pixels[9] = { 1, 0x1p-20f, 1e20f, 3, 0.1f, 5e-40f, 5, 0.7f, 123 };
    make_pfm(&file, 3, 3, pixels);
    const struct scene_picture *picture = add(fixture, &file, "a.pfm",
                                              &(struct picture_wish){ .pyramid = true });
    assert_int_equal(picture->texel, TEXEL_FLOAT);
    assert_int_equal(picture->levels, 2);
    const float *texels = fixture->build->texels.data;
    assert_memory_equal(texels, pixels, sizeof(pixels));
    assert_true(texels[9] == 3);
    assert_true(texels[10] == (float)(0x1p-20 / 3 + 0.1f / 3.0 + 0.7f / 3.0));
    assert_int_equal(fixture->pictures.mended, 0);
}

/* Every wish for an 8-bit and a 16-bit file, and what becomes of the values 0, 64, 128, 255 */
static void encodings_decide_the_texels(void **state)
{
    struct fixture *fixture = *state;
    static const struct {
        bool wide;
        struct picture_wish wish;
        enum picture_texel texel;
        double power; /* 0: sRGB */
    } rows[] = {
        { false, { .encoding = ENCODING_AS_FOUND }, TEXEL_U8_SRGB, 0 },
        { false, { .encoding = ENCODING_SRGB }, TEXEL_U8_SRGB, 0 },
        { false, { .encoding = ENCODING_LINEAR }, TEXEL_U8, 1 },
        { false, { .encoding = ENCODING_GAMMA, .gamma = 2.2 }, TEXEL_HALF, 2.2 },
        { false, { .encoding = ENCODING_GAMMA, .gamma = 1.8 }, TEXEL_HALF, 1.8 },
        { true, { .encoding = ENCODING_AS_FOUND }, TEXEL_HALF, 0 },
        { true, { .encoding = ENCODING_LINEAR }, TEXEL_FLOAT, 1 },
        { true, { .encoding = ENCODING_GAMMA, .gamma = 2.2 }, TEXEL_HALF, 2.2 },
    };
    static const uint8_t narrow[] = { 0, 64, 128, 255 };
    static const uint16_t wide[] = { 0, 64 * 257, 128 * 257, 65535 };
    static struct file files[2];
    make_tga(&files[0], 4, 1, 1, narrow);
    make_png(&files[1], 4, wide);
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        const struct scene_picture *picture = add(fixture, &files[rows[i].wide],
                                                  rows[i].wide ? "a.png" : "a.tga", &rows[i].wish);
        assert_int_equal(picture->texel, rows[i].texel);
        assert_int_equal(picture->levels, 1);
        const uint8_t *texels = (const uint8_t *)fixture->build->texels.data +
                                (size_t)picture->first_block * TEXEL_BLOCK;
        for (int k = 0; k < 4; k++) {
            double value = narrow[k] / 255.0, got;
            double want = rows[i].power == 0 ? linear_of(value) : pow(value, rows[i].power);
            if (picture->texel == TEXEL_FLOAT)
                got = ((const float *)texels)[k];
            else if (picture->texel == TEXEL_HALF)
                got = picture_reader_float(((const uint16_t *)texels)[k]);
            else
                got = picture->texel == TEXEL_U8 ? texels[k] / 255.0 : linear_of(texels[k] / 255.0);
            if (!(fabs(got - want) <= want * 0x1p-11))
                fail_msg("row %zu, value %d: %.9g, not %.9g", i, narrow[k], got, want);
        }
    }
}

/* Through gamma 1 every half that 16 bits come near is reached, and none is off by more than half
 * its step */
static void halves_are_the_nearest(void **state)
{
    struct fixture *fixture = *state;
    static struct file file;
    static uint16_t row[4096];
    for (unsigned first = 0; first < 65536; first += 4096) {
        for (unsigned i = 0; i < 4096; i++)
            row[i] = (uint16_t)(first + i);
        make_png(&file, 4096, row);
        char name[32];
        snprintf(name, sizeof(name), "from-%u.png", first);
        const struct picture_wish wish = { .encoding = ENCODING_GAMMA, .gamma = 1 };
        const struct scene_picture *picture = add(fixture, &file, name, &wish);
        const uint16_t *half = (const uint16_t *)fixture->build->texels.data +
                               (size_t)picture->first_block * TEXEL_BLOCK / 2;
        for (unsigned i = 0; i < 4096; i++) {
            double want = (first + i) / 65535.0, got = picture_reader_float(half[i]);
            double above = picture_reader_float(half[i] + 1) - got;
            double below = half[i] > 0 ? got - picture_reader_float(half[i] - 1) : above;
            if (!(want - got <= above / 2 && got - want <= below / 2))
                fail_msg("%u/65535 became %.9g", first + i, got);
        }
    }
}

static void a_file_is_read_once_in_each_way(void **state)
{
    struct fixture *fixture = *state;
    static struct file file;
    static const uint8_t pixels[12] = { 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12 };
    make_tga(&file, 2, 2, 3, pixels);
    char path[600], other[640];
    snprintf(path, sizeof(path), "%s/a.tga", fixture->folder);
    snprintf(other, sizeof(other), "%s/./a.tga", fixture->folder);
    scratch_write(path, file.bytes, file.size);
    uint32_t index[4];
    struct picture_wish wish = { .pyramid = true };
    assert_true(
        scene_pictures_read(&fixture->pictures, fixture->build, path, &wish, &index[0], NULL));
    assert_true(
        scene_pictures_read(&fixture->pictures, fixture->build, other, &wish, &index[1], NULL));
    wish.encoding = ENCODING_LINEAR;
    assert_true(
        scene_pictures_read(&fixture->pictures, fixture->build, path, &wish, &index[2], NULL));
    wish.single = true;
    assert_true(
        scene_pictures_read(&fixture->pictures, fixture->build, path, &wish, &index[3], NULL));
    assert_int_equal(index[0], index[1]);
    assert_int_equal(index[2], index[0] + 1);
    assert_int_equal(index[3], index[0] + 2);
    assert_int_equal(fixture->build->pictures.count, 3);

    struct err err = { .text = "" };
    snprintf(path, sizeof(path), "%s/b.tga", fixture->folder);
    assert_false(
        scene_pictures_read(&fixture->pictures, fixture->build, path, &wish, &index[0], &err));
    assert_non_null(strstr(err.text, "b.tga: cannot be opened"));
    assert_int_equal(fixture->build->pictures.count, 3);
}

static void what_is_no_colour_is_mended_and_counted(void **state)
{
    struct fixture *fixture = *state;
    static struct file file;
    const float pixels[12] = { NAN, 1, 2, -1, 3, -4, INFINITY, 5, -INFINITY, 6, 7, 8 };
    const float colors[12] = { 0, 1, 2, 0, 3, 0, 65504, 5, 0, 6, 7, 8 };
    const float heights[12] = { 0, 1, 2, -1, 3, -4, 65504, 5, -65504, 6, 7, 8 };
    make_pfm(&file, 4, 3, pixels);
    struct picture_wish wish = { .encoding = ENCODING_AS_FOUND };
    add(fixture, &file, "a.pfm", &wish);
    assert_int_equal(fixture->pictures.mended, 3);
    assert_memory_equal(fixture->build->texels.data, colors, sizeof(colors));
    add(fixture, &file, "a.pfm", &wish);
    assert_int_equal(fixture->pictures.mended, 0); /* said already */
    wish.keep_negative = true;
    add(fixture, &file, "a.pfm", &wish);
    assert_int_equal(fixture->pictures.mended, 2);
    assert_memory_equal((uint8_t *)fixture->build->texels.data + 3 * TEXEL_BLOCK, heights,
                        sizeof(heights));
}

static void numbers_are_grey_or_alpha_or_the_mean(void **state)
{
    struct fixture *fixture = *state;
    static const struct {
        const char *name;
        unsigned channels;
        uint8_t pixel[4]; /* as in the file: blue, green, red */
        enum picture_texel texel;
        double value;
    } rows[] = {
        { "grey", 1, { 51 }, TEXEL_U8, 0.2 },
        { "grey in colours", 3, { 51, 51, 51 }, TEXEL_U8, 0.2 },
        { "colours", 3, { 0, 51, 102 }, TEXEL_HALF, 0.2 },
        { "see-through", 4, { 0, 51, 102, 204 }, TEXEL_U8, 0.8 },
        { "opaque", 4, { 51, 51, 51, 255 }, TEXEL_U8, 0.2 },
    };
    static struct file file;
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        make_tga(&file, 1, 1, rows[i].channels, rows[i].pixel);
        char name[64];
        snprintf(name, sizeof(name), "%s.tga", rows[i].name);
        const struct picture_wish wish = { .encoding = ENCODING_LINEAR, .single = true };
        const struct scene_picture *picture = add(fixture, &file, name, &wish);
        assert_int_equal(picture->channels, 1);
        assert_int_equal(picture->texel, rows[i].texel);
        const uint8_t *texel = (const uint8_t *)fixture->build->texels.data +
                               (size_t)picture->first_block * TEXEL_BLOCK;
        double got = picture->texel == TEXEL_HALF ? picture_reader_float(*(const uint16_t *)texel)
                                                  : *texel / 255.0;
        if (!(fabs(got - rows[i].value) < 1e-4))
            fail_msg("%s: %.9g, not %.9g", name, got, rows[i].value);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(pyramids_are_box_averages_of_light, open_fixture,
                                        close_fixture),
        cmocka_unit_test_setup_teardown(floats_keep_their_bits_and_average_exactly, open_fixture,
                                        close_fixture),
        cmocka_unit_test_setup_teardown(encodings_decide_the_texels, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(halves_are_the_nearest, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_file_is_read_once_in_each_way, open_fixture,
                                        close_fixture),
        cmocka_unit_test_setup_teardown(what_is_no_colour_is_mended_and_counted, open_fixture,
                                        close_fixture),
        cmocka_unit_test_setup_teardown(numbers_are_grey_or_alpha_or_the_mean, open_fixture,
                                        close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
