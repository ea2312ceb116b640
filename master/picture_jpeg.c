/*
 * JPEG by libjpeg-turbo: grey stays one channel, everything else becomes RGB, CMYK included. The
 * inverse DCT is the accurate integer one, whose SIMD code gives the same values as its C code.
 */
#include "master/picture_reader.h"

#include <limits.h>
#include <setjmp.h>
#include <stdio.h>

#include <jpeglib.h>

#include <jerror.h>

/* Real progressive files have a dozen; without a limit, a small hostile one takes minutes. */
#define SCANS_MAX 100

struct reading {
    struct jpeg_error_mgr errors; /* first, so that libjpeg's pointer to it is one to us */
    struct jpeg_progress_mgr progress;
    const struct picture_source *source;
    struct err *err;
    jmp_buf leave;
};

static _Noreturn void fail(struct reading *reading, enum err_code code, j_common_ptr jpeg)
{
    char text[JMSG_LENGTH_MAX];
    reading->errors.format_message(jpeg, text);
    /* Where libjpeg is says little: it is ahead of what it complains about, but not by much */
    const struct jpeg_source_mgr *from = ((j_decompress_ptr)jpeg)->src;
    size_t at = from != NULL ? reading->source->size - from->bytes_in_buffer : 0;
    if (reading->errors.msg_code == JWRN_JPEG_EOF)
        picture_reader_ends_early(reading->source, reading->err);
    else
        err_set(reading->err, code, "%s: near byte %zu: %s", reading->source->name, at, text);
    longjmp(reading->leave, 1);
}

static _Noreturn void on_error(j_common_ptr jpeg)
{
    struct reading *reading = (struct reading *)jpeg->err;
    int code = reading->errors.msg_code;
    /* Virtual arrays that would exceed max_memory_to_use ask for a file, which there is not */
    fail(reading,
         code == JERR_OUT_OF_MEMORY || code == JERR_NO_BACKING_STORE ? ERR_MEMORY : ERR_SCENE,
         jpeg);
}

/* A warning about pixels is an error: libjpeg would make up what is missing. */
static void on_message(j_common_ptr jpeg, int level)
{
    struct reading *reading = (struct reading *)jpeg->err;
    switch (level < 0 ? reading->errors.msg_code : 0) {
    case JWRN_JPEG_EOF:
    case JWRN_HIT_MARKER:
    case JWRN_HUFF_BAD_CODE:
    case JWRN_ARITH_BAD_CODE:
    case JWRN_MUST_RESYNC:
    case JWRN_BOGUS_PROGRESSION:
        fail(reading, ERR_SCENE, jpeg);
    default:
        break;
    }
}

static void on_progress(j_common_ptr jpeg)
{
    struct reading *reading = (struct reading *)jpeg->err;
    if (((j_decompress_ptr)jpeg)->input_scan_number <= SCANS_MAX)
        return;
    err_set(reading->err, ERR_LIMIT, "%s: has more than %d scans", reading->source->name,
            SCANS_MAX);
    longjmp(reading->leave, 1);
}

/* Four channels to three, in place. Adobe's files, which is nearly all, store what light is left.
 */
static void rgb_of_cmyk(uint8_t *pixels, size_t count, bool inverted)
{
    unsigned flip = inverted ? 0 : 255;
    for (size_t i = 0; i < count; i++) {
        unsigned k = pixels[4 * i + 3] ^ flip;
        for (size_t c = 0; c < 3; c++)
            pixels[3 * i + c] = (uint8_t)(((pixels[4 * i + c] ^ flip) * k + 127) / 255);
    }
}

/* Everything between setjmp and longjmp. */
static void read_pixels(j_decompress_ptr jpeg, struct reading *reading, struct picture *picture)
{
    const struct picture_source *source = reading->source;
    jpeg_create_decompress(jpeg);
    jpeg->progress = &reading->progress;
    jpeg->mem->max_memory_to_use = source->limit < LONG_MAX ? (long)source->limit : LONG_MAX;
    jpeg_mem_src(jpeg, source->bytes, source->size);
    jpeg_read_header(jpeg, TRUE);

    /* What libjpeg can convert to: CMYK to nothing but itself */
    bool four = jpeg->jpeg_color_space == JCS_CMYK || jpeg->jpeg_color_space == JCS_YCCK;
    bool grey = jpeg->jpeg_color_space == JCS_GRAYSCALE;
    jpeg->out_color_space = grey ? JCS_GRAYSCALE : four ? JCS_CMYK : JCS_RGB;
    jpeg->dct_method = JDCT_ISLOW;
    uint32_t channels = grey ? 1 : four ? 4 : 3;
    if (!picture_reader_allocate(source, jpeg->image_width, jpeg->image_height, channels,
                                 PICTURE_U8, picture, reading->err))
        longjmp(reading->leave, 1);

    jpeg_start_decompress(jpeg);
    size_t row_size = picture_reader_row_size(picture);
    while (jpeg->output_scanline < jpeg->output_height) {
        JSAMPROW row = (JSAMPROW)picture->pixels + jpeg->output_scanline * row_size;
        jpeg_read_scanlines(jpeg, &row, 1);
    }
    if (four) {
        rgb_of_cmyk(picture->pixels, (size_t)picture->width * picture->height,
                    jpeg->saw_Adobe_marker);
        picture->channels = 3;
        picture->has_alpha = false;
    }
    jpeg_finish_decompress(jpeg);
}

/* In a function of its own: what setjmp's caller changes meanwhile is lost. */
static bool try_pixels(j_decompress_ptr jpeg, struct reading *reading, struct picture *picture)
{
    if (setjmp(reading->leave) != 0)
        return false;
    read_pixels(jpeg, reading, picture);
    return true;
}

bool picture_jpeg_read(const struct picture_source *source, struct picture *picture,
                       struct err *err)
{
    struct jpeg_decompress_struct jpeg = { 0 };
    struct reading reading = { .source = source, .err = err };
    jpeg.err = jpeg_std_error(&reading.errors);
    reading.errors.error_exit = on_error;
    reading.errors.emit_message = on_message;
    reading.progress.progress_monitor = on_progress;
    bool good = try_pixels(&jpeg, &reading, picture);
    jpeg_destroy_decompress(&jpeg);
    return good;
}
