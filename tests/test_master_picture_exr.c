/*
 * Goal: OpenEXR pictures of every kind, made here value by value, come back as they were made, and
 * the odd ones that people have are read as others read them; what is damaged is read or refused.
 */
#include "tests/picture_bytes.h"

#include <ImfCRgbaFile.h>
#include <dirent.h>
#include <math.h>
#include <openexr.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exr_pictures_of_every_kind_come_back),
        cmocka_unit_test(exr_pictures_in_lossy_blocks_are_what_others_read),
        cmocka_unit_test(exr_channels_are_chosen_as_the_header_says),
        cmocka_unit_test(dwa_and_luminance_chroma_come_back_nearly),
        cmocka_unit_test(damaged_exr_files_are_read_or_refused),
        cmocka_unit_test(every_half_has_its_value),
        cmocka_unit_test(the_odd_exr_files_are_read_and_their_ruins_survived),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
