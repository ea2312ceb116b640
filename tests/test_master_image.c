/*
 * Pictures on disk: what is written comes back bit by bit, whatever wrote a file is read, and what
 * cannot be read is refused with a reason.
 */
#include "common/err.h"
#include "master/atomic_file.h"
#include "master/exr.h"
#include "master/image.h"
#include "master/png.h"

#include <dirent.h>
#include <math.h>
#include <openexr.h>
#include <png.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static char folder[] = "/tmp/pathfarm-image-XXXXXX";

static const char *in_folder(const char *name)
{
    static char path[4][512];
    static unsigned next;
    char *text = path[next++ % 4];
    snprintf(text, sizeof(path[0]), "%s/%s", folder, name);
    return text;
}

static int make_folder(void **state)
{
    (void)state;
    return mkdtemp(folder) == NULL;
}

/* Removes all files; counts them, so that a test can tell whether something was left behind. */
static unsigned empty_folder(void)
{
    unsigned count = 0;
    DIR *dir = opendir(folder);
    for (struct dirent *entry; (entry = readdir(dir)) != NULL;) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        unlink(in_folder(entry->d_name));
        count++;
    }
    closedir(dir);
    return count;
}

static int remove_folder(void **state)
{
    (void)state;
    empty_folder();
    return rmdir(folder);
}

/* A picture whose every value differs, with the values that a careless writer would change. */
static struct image *some_image(uint32_t width, uint32_t height)
{
    static const char *const names[] = { "R", "G", "B", "stderr.R", "samples" };
    struct image *image = image_new(width, height);
    assert_non_null(image);
    for (unsigned c = 0; c < 5; c++) {
        float *values = image_add_channel(image, names[c]);
        assert_non_null(values);
        for (uint32_t p = 0; p < width * height; p++)
            values[p] = (float)(c * 1000) + (float)p * 0.37f;
        values[0] = NAN;
        values[1] = -INFINITY;
        values[2] = -0.0f;
        values[3] = 1e-42f;
    }
    return image;
}

static void expect_same_channels(const struct image *a, const struct image *b)
{
    assert_int_equal(a->channel_count, b->channel_count);
    for (uint32_t i = 0; i < a->channel_count; i++) {
        const float *other = image_channel(b, a->channels[i].name);
        assert_non_null(other);
        assert_memory_equal(a->channels[i].values, other,
                            (size_t)a->width * a->height * sizeof(float));
    }
}

static void what_is_written_comes_back_bit_by_bit(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = some_image(67, 41); /* neither a multiple of ZIP's 16 lines */
    assert_true(image_set_attribute(image, "pathfarm.spp", "64"));
    assert_true(image_set_attribute(image, "pathfarm.command", "render \"a b\" -o \xc3\xbc.exr"));
    assert_true(image_set_attribute(image, "pathfarm.spp", "256")); /* the last word counts */
    assert_true(exr_image_write(image, in_folder("a.exr"), &err));

    struct image *back = exr_image_read(in_folder("a.exr"), &err);
    assert_non_null(back);
    assert_int_equal(back->width, 67);
    assert_int_equal(back->height, 41);
    assert_int_equal(back->display_width, 67);
    assert_int_equal(back->data_x, 0);
    expect_same_channels(image, back);
    assert_string_equal(image_attribute(back, "pathfarm.spp"), "256");
    assert_string_equal(image_attribute(back, "pathfarm.command"),
                        "render \"a b\" -o \xc3\xbc.exr");
    assert_null(image_attribute(back, "pathfarm.seed"));
    assert_null(image_channel(back, "A"));
    image_free(back);
    image_free(image);
    assert_int_equal(empty_folder(), 1);
}

static void a_crop_keeps_its_place_in_the_full_picture(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = some_image(20, 10);
    image->data_x = 5;
    image->data_y = 7;
    image->display_width = 40;
    image->display_height = 30;
    assert_true(exr_image_write(image, in_folder("crop.exr"), &err));
    struct image *back = exr_image_read(in_folder("crop.exr"), &err);
    assert_non_null(back);
    assert_int_equal(back->data_x, 5);
    assert_int_equal(back->data_y, 7);
    assert_int_equal(back->display_width, 40);
    assert_int_equal(back->display_height, 30);
    expect_same_channels(image, back);
    image_free(back);

    /* Larger than the display window, and outside it */
    image->data_x = -3;
    image->data_y = -9;
    image->display_width = image->display_height = 4;
    assert_true(exr_image_write(image, in_folder("crop.exr"), &err));
    back = exr_image_read(in_folder("crop.exr"), &err);
    assert_non_null(back);
    assert_int_equal(back->data_x, -3);
    assert_int_equal(back->data_y, -9);
    assert_int_equal(back->display_width, 4);
    expect_same_channels(image, back);
    image_free(back);
    image_free(image);
    empty_folder();
}

static void a_failed_write_leaves_the_old_file_and_nothing_else(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = some_image(8, 8);
    assert_true(exr_image_write(image, in_folder("a.exr"), &err));

    /* An attribute name no EXR file can hold makes the library fail after the file was begun */
    assert_true(image_set_attribute(image, "a name of more than thirty-one characters", "x"));
    assert_false(exr_image_write(image, in_folder("a.exr"), &err));
    assert_int_equal(err.code, ERR_IO);
    assert_non_null(strstr(err.text, "a.exr"));

    struct image *back = exr_image_read(in_folder("a.exr"), &err);
    assert_non_null(back);
    image_free(back);
    image_free(image);
    assert_int_equal(empty_folder(), 1);
}

static void files_are_replaced_whole_links_followed_and_devices_refused(void **state)
{
    (void)state;
    struct err err = { 0 };
    assert_true(atomic_file_write(in_folder("text"), "old", 3, &err));
    assert_int_equal(symlink("text", in_folder("link")), 0);
    assert_true(atomic_file_write(in_folder("link"), "new text", 8, &err));
    struct stat status;
    assert_int_equal(lstat(in_folder("link"), &status), 0);
    assert_true(S_ISLNK(status.st_mode));
    assert_int_equal(stat(in_folder("text"), &status), 0);
    assert_int_equal(status.st_size, 8);

    /* Aborted: as if nothing had been */
    struct atomic_file file;
    assert_true(atomic_file_open(&file, in_folder("text"), &err));
    assert_int_equal(write(file.fd, "half", 4), 4);
    atomic_file_abort(&file);
    assert_int_equal(stat(in_folder("text"), &status), 0);
    assert_int_equal(status.st_size, 8);

    assert_false(atomic_file_write("/dev/null", "x", 1, &err));
    assert_non_null(strstr(err.text, "not a regular file"));
    assert_false(atomic_file_write(in_folder("no/such/folder"), "x", 1, &err));
    assert_int_equal(err.code, ERR_IO);
    assert_int_equal(empty_folder(), 2);
}

/* ---- files of others ---- */

/* What pixel (x, y) of channel c of the files below holds: exact in half, float and uint. */
static float foreign_value(uint32_t c, uint32_t x, uint32_t y)
{
    return (float)((x * 3 + y * 7 + c * 11) % 97);
}

static uint16_t half_of(float small_integer)
{
    int exponent;
    float fraction = frexpf(small_integer, &exponent);
    if (small_integer == 0)
        return 0;
    return (uint16_t)((exponent + 14) << 10 | (int)((fraction * 2 - 1) * 1024));
}

/* A file with a half, a float and a uint channel, in tiles of 16x12 or in scanlines. */
static void write_foreign(const char *path, bool tiled, exr_compression_t compression,
                          uint32_t width, uint32_t height)
{
    static const exr_pixel_type_t type[3] = { EXR_PIXEL_HALF, EXR_PIXEL_FLOAT, EXR_PIXEL_UINT };
    static const char *const name[3] = { "C0", "C1", "C2" };
    exr_context_t context;
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    assert_int_equal(exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, &with), 0);
    int part;
    assert_int_equal(
        exr_add_part(context, "one", tiled ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE, &part), 0);
    const exr_attr_box2i_t display = { .min = { .x = 2, .y = 1 }, .max = { .x = 50, .y = 60 } };
    const exr_attr_box2i_t data = {
        .min = { .x = -4, .y = 9 },
        .max = { .x = -4 + (int)width - 1, .y = 9 + (int)height - 1 },
    };
    const exr_attr_v2f_t center = { .x = 0, .y = 0 };
    assert_int_equal(exr_initialize_required_attr(context, part, &display, &data, 1, &center, 1,
                                                  EXR_LINEORDER_INCREASING_Y, compression),
                     0);
    if (tiled)
        assert_int_equal(
            exr_set_tile_descriptor(context, part, 16, 12, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN),
            0);
    for (int c = 0; c < 3; c++)
        assert_int_equal(
            exr_add_channel(context, part, name[c], type[c], EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1),
            0);
    assert_int_equal(exr_attr_set_int(context, part, "frame", -7), 0);
    assert_int_equal(exr_attr_set_float(context, part, "gain", 0.5f), 0);
    assert_int_equal(exr_write_header(context), 0);

    int32_t lines = 12;
    if (!tiled)
        assert_int_equal(exr_get_scanlines_per_chunk(context, part, &lines), 0);
    uint32_t step_x = tiled ? 16 : width, step_y = (uint32_t)lines;
    for (uint32_t y0 = 0; y0 < height; y0 += step_y) {
        for (uint32_t x0 = 0; x0 < width; x0 += step_x) {
            exr_chunk_info_t chunk;
            if (tiled)
                assert_int_equal(exr_write_tile_chunk_info(context, part, (int)(x0 / step_x),
                                                           (int)(y0 / step_y), 0, 0, &chunk),
                                 0);
            else
                assert_int_equal(exr_write_scanline_chunk_info(context, part, 9 + (int)y0, &chunk),
                                 0);
            exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
            assert_int_equal(exr_encoding_initialize(context, part, &chunk, &encoder), 0);
            uint8_t *planes[3];
            for (uint32_t c = 0; c < 3; c++) {
                size_t size = type[c] == EXR_PIXEL_HALF ? 2 : 4;
                uint8_t *plane = planes[c] = malloc((size_t)chunk.width * (size_t)chunk.height * 4);
                assert_non_null(plane);
                for (int p = 0; p < chunk.width * chunk.height; p++) {
                    float value = foreign_value(c, x0 + (uint32_t)(p % chunk.width),
                                                y0 + (uint32_t)(p / chunk.width));
                    uint16_t half = half_of(value);
                    uint32_t integer = (uint32_t)value;
                    memcpy(plane + (size_t)p * size,
                           c == 0   ? (void *)&half
                           : c == 1 ? (void *)&value
                                    : (void *)&integer,
                           size);
                }
                encoder.channels[c].user_bytes_per_element = (int16_t)size;
                encoder.channels[c].user_data_type = (uint16_t)type[c];
                encoder.channels[c].user_pixel_stride = (int32_t)size;
                encoder.channels[c].user_line_stride = (int32_t)size * chunk.width;
                encoder.channels[c].encode_from_ptr = plane;
            }
            assert_int_equal(exr_encoding_choose_default_routines(context, part, &encoder), 0);
            assert_int_equal(exr_encoding_run(context, part, &encoder), 0);
            exr_encoding_destroy(context, &encoder);
            for (int c = 0; c < 3; c++)
                free(planes[c]);
        }
    }
    assert_int_equal(exr_finish(&context), 0);
}

static void half_float_and_uint_in_scanlines_and_tiles_are_read(void **state)
{
    (void)state;
    static const exr_compression_t compressions[] = {
        EXR_COMPRESSION_NONE, EXR_COMPRESSION_RLE, EXR_COMPRESSION_ZIPS,
        EXR_COMPRESSION_ZIP,  EXR_COMPRESSION_PIZ,
    };
    static const uint32_t sizes[][2] = { { 37, 29 }, { 64, 36 }, { 1, 1 }, { 3, 50 } };
    for (unsigned i = 0; i < 2 * 5 * 4; i++) {
        bool tiled = i % 2 == 0;
        exr_compression_t compression = compressions[i / 2 % 5];
        uint32_t width = sizes[i / 10][0], height = sizes[i / 10][1];
        struct err err = { 0 };
        write_foreign(in_folder("foreign.exr"), tiled, compression, width, height);
        struct image *image = exr_image_read(in_folder("foreign.exr"), &err);
        if (image == NULL)
            fail_msg("tiled %d compression %d: %s", tiled, compression, err.text);
        assert_int_equal(image->width, width);
        assert_int_equal(image->height, height);
        assert_int_equal(image->data_x, -6); /* relative to the display window's corner */
        assert_int_equal(image->data_y, 8);
        assert_int_equal(image->display_width, 49);
        assert_int_equal(image->display_height, 60);
        assert_int_equal(image->channel_count, 3);
        assert_string_equal(image_attribute(image, "frame"), "-7");
        assert_string_equal(image_attribute(image, "gain"), "0.5");
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t y = 0; y < height; y++)
                for (uint32_t x = 0; x < width; x++)
                    if (image->channels[c].values[y * width + x] != foreign_value(c, x, y))
                        fail_msg("tiled %d compression %d size %ux%u channel %u (%u, %u): %g, "
                                 "wanted %g",
                                 tiled, compression, width, height, c, x, y,
                                 (double)image->channels[c].values[y * width + x],
                                 (double)foreign_value(c, x, y));
        image_free(image);
    }
    empty_folder();
}

static void every_truncation_is_refused(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = some_image(16, 40);
    assert_true(exr_image_write(image, in_folder("whole.exr"), &err));
    image_free(image);

    char bytes[16384];
    FILE *file = fopen(in_folder("whole.exr"), "rb");
    size_t size = fread(bytes, 1, sizeof(bytes), file);
    fclose(file);
    assert_in_range(size, 100, sizeof(bytes) - 1);
    for (size_t cut = 0; cut < size; cut += 1 + cut / 40) {
        file = fopen(in_folder("cut.exr"), "wb");
        assert_int_equal(fwrite(bytes, 1, cut, file), cut);
        fclose(file);
        err_clear(&err);
        assert_null(exr_image_read(in_folder("cut.exr"), &err));
        assert_int_not_equal(err.code, ERR_OK);
        assert_non_null(strstr(err.text, "cut.exr"));
    }
    empty_folder();
}

static void damaged_bytes_give_an_error_or_an_image_and_never_a_crash(void **state)
{
    (void)state;
    struct err err = { 0 };
    write_foreign(in_folder("whole.exr"), true, EXR_COMPRESSION_ZIP, 37, 29);
    char bytes[16384];
    FILE *file = fopen(in_folder("whole.exr"), "rb");
    size_t size = fread(bytes, 1, sizeof(bytes), file);
    fclose(file);
    uint64_t random = 1;
    for (unsigned round = 0; round < 400; round++) {
        char damaged[sizeof(bytes)];
        memcpy(damaged, bytes, size);
        for (unsigned i = 0; i < 1 + round % 3; i++) {
            random = random * 6364136223846793005u + 1442695040888963407u;
            /* Mostly in the header, where the lengths are */
            damaged[(random >> 33) % (round % 4 == 0 ? size : 500)] = (char)(random >> 25);
        }
        file = fopen(in_folder("damaged.exr"), "wb");
        assert_int_equal(fwrite(damaged, 1, size, file), size);
        fclose(file);
        err_clear(&err);
        struct image *image = exr_image_read(in_folder("damaged.exr"), &err);
        assert_true(image != NULL || err.code != ERR_OK);
        image_free(image);
    }
    empty_folder();
}

static void what_is_no_flat_exr_file_is_refused_with_a_reason(void **state)
{
    (void)state;
    struct err err = { 0 };
    assert_null(exr_image_read(in_folder("absent.exr"), &err));
    assert_non_null(strstr(err.text, "No such file"));
    assert_null(exr_image_read(folder, &err));
    assert_int_equal(err.code, ERR_IO);
    assert_true(
        atomic_file_write(in_folder("text.exr"), "not a picture at all, but text", 30, &err));
    assert_null(exr_image_read(in_folder("text.exr"), &err));
    assert_int_equal(err.code, ERR_IO);

    /* Two parts */
    exr_context_t context;
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    assert_int_equal(
        exr_start_write(&context, in_folder("parts.exr"), EXR_WRITE_FILE_DIRECTLY, &with), 0);
    for (int i = 0; i < 2; i++) {
        int part;
        assert_int_equal(
            exr_add_part(context, i == 0 ? "left" : "right", EXR_STORAGE_SCANLINE, &part), 0);
        assert_int_equal(
            exr_initialize_required_attr_simple(context, part, 4, 4, EXR_COMPRESSION_NONE), 0);
        assert_int_equal(exr_add_channel(context, part, "R", EXR_PIXEL_FLOAT,
                                         EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1),
                         0);
    }
    assert_int_equal(exr_write_header(context), 0);
    static const float row[4];
    for (int part = 0; part < 2; part++) {
        for (int y = 0; y < 4; y++) {
            exr_chunk_info_t chunk;
            assert_int_equal(exr_write_scanline_chunk_info(context, part, y, &chunk), 0);
            assert_int_equal(exr_write_scanline_chunk(context, part, y, row, sizeof(row)), 0);
        }
    }
    assert_int_equal(exr_finish(&context), 0);
    assert_null(exr_image_read(in_folder("parts.exr"), &err));
    assert_int_equal(err.code, ERR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "several parts"));
    empty_folder();
}

static const char *shared(const char *name)
{
    static char path[1024];
    const char *root = getenv("PATHFARM_SHARED"), *source = getenv("PATHFARM_SOURCE");
    if (root != NULL)
        snprintf(path, sizeof(path), "%s/%s", root, name);
    else
        snprintf(path, sizeof(path), "%s/../shared/%s", source != NULL ? source : ".", name);
    if (access(path, R_OK) != 0) {
        print_message("skipped: %s is not there\n", name);
        return NULL;
    }
    return path;
}

/* The same pixels in sixteen windows: openexr-images' DisplayWindow, as its README describes it. */
static void the_same_pixels_are_read_from_sixteen_windows(void **state)
{
    (void)state;
    static const struct {
        int x, y, display_width, display_height;
    } want[16] = {
        { 0, 0, 400, 300 },       { -1, -1, 400, 300 },   { -30, -20, 370, 280 },
        { 0, 0, 370, 280 },       { -30, -20, 340, 260 }, { 1, 1, 402, 302 },
        { 40, 40, 481, 371 },     { 30, 40, 501, 401 },   { -400, 0, 200, 300 },
        { 100, 0, 100, 300 },     { 0, -300, 400, 200 },  { 0, 100, 400, 100 },
        { -399, -299, 101, 101 }, { 100, 100, 101, 101 }, { 40, 40, 481, 371 },
        { 40, 40, 481, 371 },
    };
    struct image *first = NULL;
    for (unsigned i = 0; i < 16; i++) {
        char name[64];
        snprintf(name, sizeof(name), "scenes/exr-samples/DisplayWindow/t%02u.exr", i + 1);
        const char *path = shared(name);
        if (path == NULL)
            skip();
        struct err err = { 0 };
        struct image *image = exr_image_read(path, &err);
        if (image == NULL)
            fail_msg("%s", err.text);
        assert_int_equal(image->width, 400);
        assert_int_equal(image->height, 300);
        assert_int_equal(image->data_x, want[i].x);
        assert_int_equal(image->data_y, want[i].y);
        assert_int_equal(image->display_width, want[i].display_width);
        assert_int_equal(image->display_height, want[i].display_height);
        assert_true(png_preview_write(image, in_folder("window.png"), &err));
        if (first == NULL) {
            first = image;
            continue;
        }
        expect_same_channels(first, image);
        image_free(image);
    }
    image_free(first);
    empty_folder();
}

static void files_of_other_renderers_are_read(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint32_t width, height;
        double green_low, green_high; /* of the mean: a picture, not noise or zeros */
    } files[] = {
        { "references/cornell-box.exr", 256, 256, 0.05, 1 },
        { "references/veach-mis.exr", 320, 240, 0.01, 1 },
        { "references/cycles-cornell.exr", 256, 256, 0.05, 1 },
        { "scenes/exr-samples/TestImages/BrightRings.exr", 800, 800, 0.01, 1e4 },
        { "scenes/exr-samples/TestImages/WideColorGamut.exr", 800, 800, 0.01, 1e4 },
    };
    for (size_t i = 0; i < sizeof(files) / sizeof(files[0]); i++) {
        const char *path = shared(files[i].name);
        if (path == NULL)
            skip();
        struct err err = { 0 };
        struct image *image = exr_image_read(path, &err);
        if (image == NULL)
            fail_msg("%s", err.text);
        const float *green = image_channel(image, "G");
        assert_non_null(green);
        double sum = 0;
        uint32_t pixels = image->width * image->height;
        for (uint32_t p = 0; p < pixels; p++)
            sum += (double)green[p];
        if (image->width != files[i].width || image->height != files[i].height ||
            !(sum / pixels > files[i].green_low && sum / pixels < files[i].green_high))
            fail_msg("%s: %ux%u, mean green %g", files[i].name, image->width, image->height,
                     sum / pixels);
        image_free(image);
    }
}

/* ---- previews ---- */

static void the_srgb_curve_is_the_standards(void **state)
{
    (void)state;
    static const struct {
        float linear;
        unsigned byte;
    } rows[] = {
        { 0, 0 },           { 1, 255 },     { 0.5f, 188 },    { 0.2158605f, 128 },
        { 0.0031308f, 10 }, { 0.18f, 118 }, { 0.001f, 3 },    { 2, 255 },
        { -1, 0 },          { -0.0f, 0 },   { NAN, 0 },       { INFINITY, 255 },
        { -INFINITY, 0 },   { 1e-40f, 0 },  { 0.9999f, 255 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        if (png_preview_byte(rows[i].linear) != rows[i].byte)
            fail_msg("%g gives %u, wanted %u", (double)rows[i].linear,
                     png_preview_byte(rows[i].linear), rows[i].byte);
}

static void a_preview_shows_the_display_window(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = image_new(3, 2);
    image->data_x = 2;
    image->data_y = -1; /* the first row is above the window */
    image->display_width = 4;
    image->display_height = 3;
    static const char *const names[3] = { "R", "G", "B" };
    for (int c = 0; c < 3; c++) {
        float *values = image_add_channel(image, names[c]);
        for (int p = 0; p < 6; p++)
            values[p] = p == 3 + c ? 1 : 0.5f;
    }
    assert_true(png_preview_write(image, in_folder("a.png"), &err));

    png_image png = { .version = PNG_IMAGE_VERSION };
    assert_true(png_image_begin_read_from_file(&png, in_folder("a.png")));
    png.format = PNG_FORMAT_RGB;
    assert_int_equal(png.width, 4);
    assert_int_equal(png.height, 3);
    uint8_t pixels[3][4][3], want[3][4][3] = { 0 };
    assert_true(png_image_finish_read(&png, NULL, pixels, 0, NULL));
    memcpy(want[0][2], (const uint8_t[3]){ 255, 188, 188 }, 3);
    memcpy(want[0][3], (const uint8_t[3]){ 188, 255, 188 }, 3);
    assert_memory_equal(pixels, want, sizeof(want));

    /* No colours, no picture, no file */
    struct image *grey = image_new(2, 2);
    image_add_channel(grey, "Y");
    empty_folder();
    assert_false(png_preview_write(grey, in_folder("grey.png"), &err));
    assert_int_equal(empty_folder(), 0);
    image_free(grey);
    image_free(image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_comes_back_bit_by_bit),
        cmocka_unit_test(a_crop_keeps_its_place_in_the_full_picture),
        cmocka_unit_test(a_failed_write_leaves_the_old_file_and_nothing_else),
        cmocka_unit_test(files_are_replaced_whole_links_followed_and_devices_refused),
        cmocka_unit_test(half_float_and_uint_in_scanlines_and_tiles_are_read),
        cmocka_unit_test(every_truncation_is_refused),
        cmocka_unit_test(damaged_bytes_give_an_error_or_an_image_and_never_a_crash),
        cmocka_unit_test(what_is_no_flat_exr_file_is_refused_with_a_reason),
        cmocka_unit_test(the_same_pixels_are_read_from_sixteen_windows),
        cmocka_unit_test(files_of_other_renderers_are_read),
        cmocka_unit_test(the_srgb_curve_is_the_standards),
        cmocka_unit_test(a_preview_shows_the_display_window),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
