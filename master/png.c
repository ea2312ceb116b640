#include "master/png.h"

#include "common/err.h"
#include "master/atomic_file.h"
#include "master/image.h"

#include <errno.h>
#include <math.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

uint8_t png_preview_byte(float linear)
{
    if (!(linear > 0))
        return 0;
    if (linear >= 1)
        return 255;
    float encoded = linear <= 0.0031308f ? 12.92f * linear
                                         : 1.055f * powf(linear, 1 / 2.4f) - 0.055f;
    return (uint8_t)(255 * encoded + 0.5f);
}

/* libpng leaves through longjmp, so these two never return into its caller. */
static void on_error(png_structp png, png_const_charp text)
{
    struct err *err = png_get_error_ptr(png);
    if (err != NULL)
        err_set(err, ERR_IO, "%s", text);
    longjmp(png_jmpbuf(png), 1);
}

static void on_warning(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text; /* nothing a user of the preview could do about it */
}

/* Row y of the display window; `row` is black where there is no data. */
static void fill_row(const struct image *image, const float *const rgb[3], uint32_t y, uint8_t *row)
{
    memset(row, 0, (size_t)3 * image->display_width);
    int64_t data_row = (int64_t)y - image->data_y;
    if (data_row < 0 || data_row >= image->height)
        return;
    for (uint32_t x = 0; x < image->width; x++) {
        int64_t column = (int64_t)x + image->data_x;
        if (column < 0 || column >= image->display_width)
            continue;
        for (int c = 0; c < 3; c++)
            row[3 * column + c] = png_preview_byte(rgb[c][(size_t)data_row * image->width + x]);
    }
}

/* The part between setjmp and libpng's longjmp: touches no local that the caller reads after. */
static bool encode(const struct image *image, const float *const rgb[3], FILE *out, uint8_t *row,
                   struct err *err)
{
    png_infop info = NULL;
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, err, on_error, on_warning);
    if (png == NULL)
        return err_set(err, ERR_MEMORY, "out of memory");
    info = png_create_info_struct(png);
    if (info == NULL) {
        png_destroy_write_struct(&png, NULL);
        return err_set(err, ERR_MEMORY, "out of memory");
    }
    if (setjmp(png_jmpbuf(png)) != 0) {
        png_destroy_write_struct(&png, &info);
        return false;
    }
    png_init_io(png, out);
    png_set_IHDR(png, info, image->display_width, image->display_height, 8, PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB_gAMA_and_cHRM(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    for (uint32_t y = 0; y < image->display_height; y++) {
        fill_row(image, rgb, y, row);
        png_write_row(png, row);
    }
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    return true;
}

/* Encode into a stream that the caller has opened; what fails is said without the file's name. */
static bool write_to(FILE *out, const struct image *image, struct err *err)
{
    const float *rgb[3] = { image_channel(image, "R"), image_channel(image, "G"),
                            image_channel(image, "B") };
    if (rgb[0] == NULL || rgb[1] == NULL || rgb[2] == NULL)
        return err_set(err, ERR_ARGUMENT, "no channels R, G and B to show");
    uint8_t *row = malloc((size_t)3 * image->display_width);
    if (row == NULL)
        return err_set(err, ERR_MEMORY, "out of memory");
    bool encoded = encode(image, rgb, out, row, err);
    free(row);
    return encoded;
}

bool png_preview_write(const struct image *image, const char *path, struct err *err)
{
    struct err why = { 0 };
    struct atomic_file file;
    if (!atomic_file_open(&file, path, err))
        return false;
    /* A stream of its own on the same file, so that closing it flushes and the file can be synced
     */
    FILE *out = fopen(file.temporary, "wb");
    if (out == NULL) {
        err_set(&why, ERR_IO, "%s", strerror(errno));
        goto fail;
    }
    bool encoded = write_to(out, image, &why);
    if (fclose(out) != 0 && encoded)
        encoded = err_set(&why, ERR_IO, "%s", strerror(errno));
    if (!encoded)
        goto fail;
    return atomic_file_commit(&file, err);

fail:
    atomic_file_abort(&file);
    return err_set(err, why.code, "%s: %s", path, why.text);
}

bool png_preview_encode(const struct image *image, uint8_t **bytes, size_t *size, struct err *err)
{
    char *text;
    FILE *out = open_memstream(&text, size);
    if (out == NULL)
        return err_set(err, ERR_MEMORY, "out of memory");
    bool encoded = write_to(out, image, err);
    if (fclose(out) != 0 && encoded)
        encoded = err_set(err, ERR_MEMORY, "out of memory");
    if (!encoded) {
        free(text);
        return false;
    }
    *bytes = (uint8_t *)text;
    return true;
}
