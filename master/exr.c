#include "master/exr.h"

#include "common/err.h"
#include "master/atomic_file.h"
#include "master/image.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <openexr.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Larger pictures are taken for damaged headers, before anything is allocated. */
#define SIDE_MAX   65536
#define VALUES_MAX ((uint64_t)1 << 31)

/* What the library's callbacks are given: the file. */
struct stream {
    int fd;
};

/*
 * The first complaint about the file this thread is busy with. The library complains while it holds
 * the context's lock, so that asking the context for its user data would wait for ever.
 */
static _Thread_local char complaint[512];

static void on_error(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    if (complaint[0] == '\0')
        snprintf(complaint, sizeof(complaint), "%s",
                 message != NULL ? message : exr_get_default_error_message(code));
}

static int64_t on_size(exr_const_context_t context, void *user)
{
    (void)context;
    struct stat status;
    return fstat(((struct stream *)user)->fd, &status) == 0 ? status.st_size : -1;
}

static int64_t on_read(exr_const_context_t context, void *user, void *buffer, uint64_t size,
                       uint64_t offset, exr_stream_error_func_ptr_t complain)
{
    uint64_t done = 0;
    while (done < size) {
        ssize_t got = pread(((struct stream *)user)->fd, (char *)buffer + done, size - done,
                            (off_t)(offset + done));
        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0) {
            complain(context, EXR_ERR_READ_IO, "%s", strerror(errno));
            return -1;
        }
        if (got == 0)
            break;
        done += (uint64_t)got;
    }
    return (int64_t)done;
}

static int64_t on_write(exr_const_context_t context, void *user, const void *buffer, uint64_t size,
                        uint64_t offset, exr_stream_error_func_ptr_t complain)
{
    uint64_t done = 0;
    while (done < size) {
        ssize_t put = pwrite(((struct stream *)user)->fd, (const char *)buffer + done, size - done,
                             (off_t)(offset + done));
        if (put < 0 && errno == EINTR)
            continue;
        if (put < 0) {
            complain(context, EXR_ERR_WRITE_IO, "%s", strerror(errno));
            return -1;
        }
        done += (uint64_t)put;
    }
    return (int64_t)done;
}

/* Forgets old complaints, too. */
static exr_context_initializer_t initializer(struct stream *stream)
{
    complaint[0] = '\0';
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    with.error_handler_fn = on_error;
    with.user_data = stream;
    with.read_fn = on_read;
    with.size_fn = on_size;
    with.write_fn = on_write;
    with.max_image_width = SIDE_MAX;
    with.max_image_height = SIDE_MAX;
    with.max_tile_width = SIDE_MAX;
    with.max_tile_height = SIDE_MAX;
    /* A file with holes is damaged; guessing where its chunks are helps nobody who compares */
    with.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    return with;
}

/* The library's words, or the meaning of its code, as our error. */
static bool failed(struct err *err, const char *path, exr_result_t code)
{
    return err_set(err, code == EXR_ERR_OUT_OF_MEMORY ? ERR_MEMORY : ERR_IO, "%s: %s", path,
                   complaint[0] != '\0' ? complaint : exr_get_default_error_message(code));
}

/* ---- writing ---- */

#define HALF_MAX 65504.f

static exr_compression_t compression_of(enum exr_packing packing)
{
    switch (packing) {
    case EXR_PACKING_ZIPS:
        return EXR_COMPRESSION_ZIPS;
    case EXR_PACKING_PIZ:
        return EXR_COMPRESSION_PIZ;
    case EXR_PACKING_RLE:
        return EXR_COMPRESSION_RLE;
    case EXR_PACKING_NONE:
        return EXR_COMPRESSION_NONE;
    case EXR_PACKING_ZIP:
        break;
    }
    return EXR_COMPRESSION_ZIP;
}

static bool beyond_half(float value)
{
    return isfinite(value) && fabsf(value) > HALF_MAX;
}

uint64_t exr_values_clamped(const struct image *image, const struct exr_format *format)
{
    uint64_t clamped = 0;
    size_t pixels = (size_t)image->width * image->height;
    for (uint32_t c = 0; format->half && c < image->channel_count; c++) {
        const struct image_channel *channel = &image->channels[c];
        for (size_t p = 0; !channel->exact && p < pixels; p++)
            clamped += beyond_half(channel->values[p]);
    }
    return clamped;
}

static exr_result_t write_header(exr_context_t context, const struct image *image,
                                 const struct exr_format *format)
{
    int part;
    exr_result_t result = exr_add_part(context, NULL, EXR_STORAGE_SCANLINE, &part);
    if (result != EXR_ERR_SUCCESS)
        return result;

    const exr_attr_box2i_t display = {
        .max.x = (int32_t)image->display_width - 1,
        .max.y = (int32_t)image->display_height - 1,
    };
    const exr_attr_box2i_t data = {
        .min.x = image->data_x,
        .min.y = image->data_y,
        .max.x = image->data_x + (int32_t)image->width - 1,
        .max.y = image->data_y + (int32_t)image->height - 1,
    };
    const exr_attr_v2f_t center = { .x = 0, .y = 0 };
    result = exr_initialize_required_attr(context, part, &display, &data, 1, &center, 1,
                                          EXR_LINEORDER_INCREASING_Y,
                                          compression_of(format->packing));

    for (uint32_t i = 0; i < image->channel_count && result == EXR_ERR_SUCCESS; i++) {
        bool half = format->half && !image->channels[i].exact;
        result = exr_add_channel(context, part, image->channels[i].name,
                                 half ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT,
                                 EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    }
    for (uint32_t i = 0; i < image->attribute_count && result == EXR_ERR_SUCCESS; i++)
        result = exr_attr_set_string(context, part, image->attributes[i].name,
                                     image->attributes[i].text);
    if (result == EXR_ERR_SUCCESS)
        result = exr_write_header(context);
    return result;
}

/* Rows of one channel, no value beyond half's range; the library rounds them to half */
static const float *clamped(const float *values, size_t count, float *to)
{
    for (size_t i = 0; i < count; i++)
        to[i] = beyond_half(values[i]) ? copysignf(HALF_MAX, values[i]) : values[i];
    return to;
}

/* `scratch` has room for one chunk of all channels, or is NULL when none is half */
static exr_result_t write_pixels(exr_context_t context, const struct image *image, float *scratch)
{
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    int32_t lines;
    exr_result_t result = exr_get_scanlines_per_chunk(context, 0, &lines);

    for (uint32_t row = 0; row < image->height && result == EXR_ERR_SUCCESS;
         row += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        result = exr_write_scanline_chunk_info(context, 0, image->data_y + (int32_t)row, &chunk);
        if (result != EXR_ERR_SUCCESS)
            break;
        result = row == 0 ? exr_encoding_initialize(context, 0, &chunk, &encoder)
                          : exr_encoding_update(context, 0, &chunk, &encoder);
        if (result != EXR_ERR_SUCCESS)
            break;

        /* The encoder lists the channels in the file's order, which is the alphabet's */
        size_t count = (size_t)chunk.height * image->width;
        for (int16_t i = 0; i < encoder.channel_count; i++) {
            exr_coding_channel_info_t *channel = &encoder.channels[i];
            const float *values = image_channel(image, channel->channel_name) +
                                  (size_t)row * image->width;
            if (channel->data_type == EXR_PIXEL_HALF)
                values = clamped(values, count, scratch + (size_t)i * count);
            channel->user_bytes_per_element = sizeof(float);
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = sizeof(float);
            channel->user_line_stride = (int32_t)(image->width * sizeof(float));
            channel->encode_from_ptr = (const uint8_t *)values;
        }
        result = exr_encoding_choose_default_routines(context, 0, &encoder);
        if (result == EXR_ERR_SUCCESS)
            result = exr_encoding_run(context, 0, &encoder);
    }
    exr_encoding_destroy(context, &encoder);
    return result;
}

/* The header, then the pixels, through a scratch buffer where they are converted */
static exr_result_t write_all(exr_context_t context, const struct image *image,
                              const struct exr_format *format)
{
    exr_result_t result = write_header(context, image, format);
    int32_t lines;
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_scanlines_per_chunk(context, 0, &lines);
    if (result != EXR_ERR_SUCCESS)
        return result;
    float *scratch = NULL;
    if (format->half) {
        scratch = calloc((size_t)lines * image->width * image->channel_count, sizeof(float));
        if (scratch == NULL)
            return EXR_ERR_OUT_OF_MEMORY;
    }
    result = write_pixels(context, image, scratch);
    free(scratch);
    return result;
}

bool exr_image_write(const struct image *image, const char *path, struct err *err)
{
    const struct exr_format format = { .half = false };
    return exr_image_write_as(image, &format, path, err);
}

bool exr_image_write_as(const struct image *image, const struct exr_format *format,
                        const char *path, struct err *err)
{
    if (image->width < 1 || image->height < 1 || image->width > SIDE_MAX ||
        image->height > SIDE_MAX || image->channel_count == 0)
        return err_set(err, ERR_ARGUMENT,
                       "%s: no EXR file can hold %" PRIu32 "x%" PRIu32 " pixels of %" PRIu32
                       " channels",
                       path, image->width, image->height, image->channel_count);

    struct atomic_file file;
    if (!atomic_file_open(&file, path, err))
        return false;

    struct stream stream = { .fd = file.fd };
    exr_context_initializer_t with = initializer(&stream);
    exr_context_t context = NULL;
    exr_result_t result = exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, &with);
    if (result == EXR_ERR_SUCCESS)
        result = write_all(context, image, format);
    /* Finishing writes the table of chunks, so it can fail too */
    exr_result_t finished = context != NULL ? exr_finish(&context) : EXR_ERR_SUCCESS;
    if (result == EXR_ERR_SUCCESS)
        result = finished;
    if (result != EXR_ERR_SUCCESS) {
        atomic_file_abort(&file);
        return failed(err, path, result);
    }
    return atomic_file_commit(&file, err);
}

/* ---- reading ---- */

/* Zeroed, in the file's order */
static bool add_channels(struct image *image, const exr_attr_chlist_t *list, const char *path,
                         struct err *err)
{
    for (int i = 0; i < list->num_channels; i++) {
        const exr_attr_chlist_entry_t *entry = &list->entries[i];
        const char *name = entry->name.str;
        if (entry->x_sampling != 1 || entry->y_sampling != 1)
            return err_set(err, ERR_UNSUPPORTED,
                           "%s: channel \"%s\" is subsampled, which is not supported", path, name);
        if (strlen(name) >= sizeof(image->channels->name))
            return err_set(err, ERR_UNSUPPORTED, "%s: the name of channel \"%s\" is too long", path,
                           name);
        if (image_add_channel(image, name) == NULL)
            return err_set(err, ERR_MEMORY, "%s: out of memory", path);
    }
    return true;
}

/* Check the header and make an image of its shape */
static struct image *image_of_header(exr_const_context_t context, const char *path, struct err *err)
{
    int parts;
    exr_storage_t storage;
    exr_attr_box2i_t display, data;
    const exr_attr_chlist_t *list;
    exr_result_t result = exr_get_count(context, &parts);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_storage(context, 0, &storage);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_display_window(context, 0, &display);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_data_window(context, 0, &data);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_channels(context, 0, &list);
    if (result != EXR_ERR_SUCCESS) {
        failed(err, path, result);
        return NULL;
    }

    if (storage != EXR_STORAGE_SCANLINE && storage != EXR_STORAGE_TILED) {
        err_set(err, ERR_UNSUPPORTED, "%s: deep EXR files are not supported", path);
        return NULL;
    }
    if (parts != 1) {
        err_set(err, ERR_UNSUPPORTED, "%s: EXR files of several parts are not supported (%d here)",
                path, parts);
        return NULL;
    }

    int64_t width = (int64_t)data.max.x - data.min.x + 1;
    int64_t height = (int64_t)data.max.y - data.min.y + 1;
    int64_t display_width = (int64_t)display.max.x - display.min.x + 1;
    int64_t display_height = (int64_t)display.max.y - display.min.y + 1;
    int64_t data_x = (int64_t)data.min.x - display.min.x;
    int64_t data_y = (int64_t)data.min.y - display.min.y;
    if (width < 1 || height < 1 || width > SIDE_MAX || height > SIDE_MAX || display_width < 1 ||
        display_height < 1 || display_width > SIDE_MAX || display_height > SIDE_MAX ||
        data_x < -SIDE_MAX || data_x > SIDE_MAX || data_y < -SIDE_MAX || data_y > SIDE_MAX ||
        (uint64_t)(width * height) * (uint64_t)list->num_channels > VALUES_MAX) {
        err_set(err, ERR_IO,
                "%s: its header claims %" PRId64 "x%" PRId64
                " pixels of %d channels, which is not believed",
                path, width, height, list->num_channels);
        return NULL;
    }

    struct image *image = image_new((uint32_t)width, (uint32_t)height);
    if (image == NULL) {
        err_set(err, ERR_MEMORY, "%s: out of memory", path);
        return NULL;
    }
    image->data_x = (int32_t)data_x;
    image->data_y = (int32_t)data_y;
    image->display_width = (uint32_t)display_width;
    image->display_height = (uint32_t)display_height;
    if (add_channels(image, list, path, err))
        return image;
    image_free(image);
    return NULL;
}

/* Attributes that are text or numbers; those with overlong names are left behind. */
static bool read_attributes(exr_const_context_t context, struct image *image)
{
    int32_t count = 0;
    if (exr_get_attribute_count(context, 0, &count) != EXR_ERR_SUCCESS)
        return true;
    for (int32_t i = 0; i < count; i++) {
        const exr_attribute_t *attribute;
        if (exr_get_attribute_by_index(context, 0, EXR_ATTR_LIST_FILE_ORDER, i, &attribute) !=
            EXR_ERR_SUCCESS)
            continue;
        char number[64];
        const char *text = number;
        switch (attribute->type) {
        case EXR_ATTR_STRING:
            text = attribute->string->str;
            break;
        case EXR_ATTR_INT:
            snprintf(number, sizeof(number), "%" PRId32, attribute->i);
            break;
        case EXR_ATTR_FLOAT:
            snprintf(number, sizeof(number), "%.9g", (double)attribute->f);
            break;
        case EXR_ATTR_DOUBLE:
            snprintf(number, sizeof(number), "%.17g", attribute->d);
            break;
        default:
            continue;
        }
        if (text != NULL && strlen(attribute->name) < sizeof(image->attributes->name) &&
            !image_set_attribute(image, attribute->name, text))
            return false;
    }
    return true;
}

/* Decode one chunk to where its first pixel belongs. */
static exr_result_t read_chunk(exr_const_context_t context, const exr_chunk_info_t *chunk,
                               bool first, exr_decode_pipeline_t *decoder, struct image *image,
                               size_t pixel)
{
    exr_result_t result = first ? exr_decoding_initialize(context, 0, chunk, decoder)
                                : exr_decoding_update(context, 0, chunk, decoder);
    if (result != EXR_ERR_SUCCESS)
        return result;
    for (int16_t i = 0; i < decoder->channel_count; i++) {
        exr_coding_channel_info_t *channel = &decoder->channels[i];
        float *values = image_channel(image, channel->channel_name);
        /* Halves become floats on the way; integers are converted afterwards, in place */
        channel->user_bytes_per_element = 4;
        channel->user_data_type = channel->data_type == EXR_PIXEL_UINT ? EXR_PIXEL_UINT
                                                                       : EXR_PIXEL_FLOAT;
        channel->user_pixel_stride = 4;
        channel->user_line_stride = (int32_t)(image->width * 4);
        channel->decode_to_ptr = (uint8_t *)(values + pixel);
    }
    result = exr_decoding_choose_default_routines(context, 0, decoder);
    if (result == EXR_ERR_SUCCESS)
        result = exr_decoding_run(context, 0, decoder);
    return result;
}

static exr_result_t read_scanlines(exr_const_context_t context, exr_decode_pipeline_t *decoder,
                                   struct image *image)
{
    exr_attr_box2i_t data;
    int32_t lines;
    exr_result_t result = exr_get_data_window(context, 0, &data);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_scanlines_per_chunk(context, 0, &lines);
    for (uint32_t row = 0; row < image->height && result == EXR_ERR_SUCCESS;
         row += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        result = exr_read_scanline_chunk_info(context, 0, data.min.y + (int32_t)row, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result = read_chunk(context, &chunk, row == 0, decoder, image,
                                (size_t)row * image->width);
    }
    return result;
}

static exr_result_t read_tiles(exr_const_context_t context, exr_decode_pipeline_t *decoder,
                               struct image *image)
{
    uint32_t tile_width, tile_height;
    exr_tile_level_mode_t level;
    exr_tile_round_mode_t round;
    exr_result_t result = exr_get_tile_descriptor(context, 0, &tile_width, &tile_height, &level,
                                                  &round);
    bool first = true;
    for (uint32_t y = 0; result == EXR_ERR_SUCCESS && y < image->height; y += tile_height) {
        for (uint32_t x = 0; result == EXR_ERR_SUCCESS && x < image->width; x += tile_width) {
            exr_chunk_info_t chunk;
            result = exr_read_tile_chunk_info(context, 0, (int)(x / tile_width),
                                              (int)(y / tile_height), 0, 0, &chunk);
            if (result == EXR_ERR_SUCCESS)
                result = read_chunk(context, &chunk, first, decoder, image,
                                    (size_t)y * image->width + x);
            first = false;
        }
    }
    return result;
}

static void integers_to_floats(exr_const_context_t context, struct image *image)
{
    const exr_attr_chlist_t *list;
    if (exr_get_channels(context, 0, &list) != EXR_ERR_SUCCESS)
        return;
    size_t pixels = (size_t)image->width * image->height;
    for (int i = 0; i < list->num_channels; i++) {
        float *values = image->channels[i].values;
        if (list->entries[i].pixel_type != EXR_PIXEL_UINT)
            continue;
        for (size_t p = 0; p < pixels; p++) {
            uint32_t integer;
            memcpy(&integer, &values[p], sizeof(integer));
            values[p] = (float)integer;
        }
    }
}

struct image *exr_image_read(const char *path, struct err *err)
{
    struct image *image = NULL;
    struct stream stream = { .fd = open(path, O_RDONLY | O_CLOEXEC) };
    if (stream.fd < 0) {
        err_set(err, ERR_IO, "%s: %s", path, strerror(errno));
        return NULL;
    }

    exr_context_initializer_t with = initializer(&stream);
    exr_context_t context = NULL;
    exr_result_t result = exr_start_read(&context, path, &with);
    if (result != EXR_ERR_SUCCESS) {
        failed(err, path, result);
        goto fail_start;
    }
    image = image_of_header(context, path, err);
    if (image == NULL)
        goto fail_header;
    if (!read_attributes(context, image)) {
        err_set(err, ERR_MEMORY, "%s: out of memory", path);
        goto fail_pixels;
    }

    exr_storage_t storage;
    exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
    result = exr_get_storage(context, 0, &storage);
    if (result == EXR_ERR_SUCCESS)
        result = storage == EXR_STORAGE_TILED ? read_tiles(context, &decoder, image)
                                              : read_scanlines(context, &decoder, image);
    exr_decoding_destroy(context, &decoder);
    if (result != EXR_ERR_SUCCESS) {
        failed(err, path, result);
        goto fail_pixels;
    }
    integers_to_floats(context, image);
    exr_finish(&context);
    close(stream.fd);
    return image;

fail_pixels:
    image_free(image);
fail_header:
    exr_finish(&context);
fail_start:
    close(stream.fd);
    return NULL;
}
