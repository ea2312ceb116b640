/* PNG by libpng: palettes and fewer than 8 bits are expanded, a transparent colour becomes alpha.
 */
#include "master/picture_reader.h"

#include <png.h>
#include <string.h>

struct reading {
    const struct picture_source *source;
    size_t at;
    struct err *err;
};

/* libpng leaves through longjmp, so these two never return into its caller. */
static void on_error(png_structp png, png_const_charp text)
{
    const struct reading *reading = png_get_error_ptr(png);
    err_set(reading->err, ERR_SCENE, "%s: byte %zu: %s", reading->source->name, reading->at, text);
    longjmp(png_jmpbuf(png), 1);
}

static void on_warning(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text; /* about chunks that change no pixel */
}

static void on_read(png_structp png, png_bytep bytes, size_t size)
{
    struct reading *reading = png_get_io_ptr(png);
    if (size > reading->source->size - reading->at)
        png_error(png, "ends early");
    memcpy(bytes, reading->source->bytes + reading->at, size);
    reading->at += size;
}

/* Everything between setjmp and longjmp. */
static void read_pixels(png_structp png, png_infop info, struct reading *reading,
                        struct picture *picture)
{
    const struct picture_source *source = reading->source;
    png_set_user_limits(png, INT32_MAX, INT32_MAX); /* ours are in bytes */
    /* Comments and the like are skipped: libpng would take the memory that their headers claim */
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, NULL, -1);
    png_set_read_fn(png, reading, on_read);
    png_read_info(png, info);

    png_uint_32 width, height;
    int depth, color;
    png_get_IHDR(png, info, &width, &height, &depth, &color, NULL, NULL, NULL);

    /* No stream of deflate could hold more rows than this, at a filter byte or more for each */
    uint64_t rows_size = ((uint64_t)png_get_rowbytes(png, info) + 1) * height;
    if (rows_size / 1032 > source->size) {
        err_set(reading->err, ERR_SCENE,
                "%s: %zu bytes cannot hold the %ux%u pixels that its header claims", source->name,
                source->size, (unsigned)width, (unsigned)height);
        longjmp(png_jmpbuf(png), 1);
    }

    bool alpha = (color & PNG_COLOR_MASK_ALPHA) != 0 ||
                 png_get_valid(png, info, PNG_INFO_tRNS) != 0;
    uint32_t channels = ((color & PNG_COLOR_MASK_COLOR) != 0 ? 3 : 1) + alpha;
    if (!picture_reader_allocate(source, width, height, channels,
                                 depth == 16 ? PICTURE_U16 : PICTURE_U8, picture, reading->err))
        longjmp(png_jmpbuf(png), 1);

    png_set_expand(png);
    if (depth == 16)
        png_set_swap(png); /* the file is big-endian */
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, info);
    if (png_get_rowbytes(png, info) != picture_reader_row_size(picture))
        png_error(png, "its rows have another size than its header says");
    size_t row_size = picture_reader_row_size(picture);
    for (int pass = 0; pass < passes; pass++)
        for (uint32_t y = 0; y < height; y++)
            png_read_row(png, (png_bytep)picture->pixels + y * row_size, NULL);
    png_read_end(png, NULL); /* checks the sums of what was read */
}

bool picture_png_read(const struct picture_source *source, struct picture *picture, struct err *err)
{
    struct reading reading = { .source = source, .err = err };
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &reading, on_error, on_warning);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    if (info == NULL) {
        png_destroy_read_struct(&png, NULL, NULL);
        return err_set(err, ERR_MEMORY, "%s: no memory", source->name);
    }
    bool good = setjmp(png_jmpbuf(png)) == 0;
    if (good)
        read_pixels(png, info, &reading, picture);
    png_destroy_read_struct(&png, &info, NULL);
    return good;
}
