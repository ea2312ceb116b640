/*
 * OpenEXR: the first part of any flat file, scanlines or tiles (full resolution), by the library's
 * C core. What Debian 12's C core (3.1.5) cannot decode, DWA compression, goes through the C
 * interface of the C++ library, and so do subsampled luminance and chroma, which that turns into
 * RGB; it gives halves, which is what DWA codes colours in anyway.
 *
 * Which channels: R, G and B (missing ones are 0), with A; else Y, with A; else those of the first
 * layer that has either; else the first channel of the file, as grey.
 */
#include "master/picture_reader.h"

#include <ImfCRgbaFile.h>
#include <errno.h>
#include <inttypes.h>
#include <openexr.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#define SIDE_MAX     (1 << 20) /* pixels; keeps the library's arithmetic far from its ends */
#define CHANNELS_MAX 4096      /* of all layers together */

/*
 * The library complains while it holds the context's lock, so asking the context for our data would
 * wait for ever; and its allocator is given no context at all.
 */
static _Thread_local char complaint[512];  /* the first of this thread's present file */
static _Thread_local uint64_t alloc_limit; /* bytes at once */

static void on_error(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    if (complaint[0] == '\0')
        snprintf(complaint, sizeof(complaint), "%s",
                 message != NULL ? message : exr_get_default_error_message(code));
}

/* Zeroed, so that a chunk that decodes to less than it should shows nothing of other files. */
static void *on_alloc(size_t size)
{
    return size <= alloc_limit ? calloc(1, size) : NULL;
}

static int64_t on_size(exr_const_context_t context, void *user)
{
    (void)context;
    return (int64_t)((const struct picture_source *)user)->size;
}

static int64_t on_read(exr_const_context_t context, void *user, void *buffer, uint64_t size,
                       uint64_t offset, exr_stream_error_func_ptr_t complain)
{
    (void)context;
    (void)complain;
    const struct picture_source *source = user;
    if (offset >= source->size)
        return 0;
    uint64_t left = source->size - offset;
    memcpy(buffer, source->bytes + offset, size < left ? size : left);
    return (int64_t)(size < left ? size : left);
}

struct reading {
    const struct picture_source *source;
    exr_context_t context;
    exr_compression_t compression;
    exr_storage_t storage;
    exr_attr_box2i_t data;
    const exr_attr_chlist_t *list;
    uint32_t chunk_width, chunk_height; /* of a tile, or of a chunk of whole scanlines */
    struct picture *picture;
    const char *names[4]; /* the file's channel of each of ours; NULL: missing, or we have fewer */
    bool by_rgba;         /* the C++ library reads it */
    struct err *err;
};

/* The library's words, or the meaning of its code, as our error. */
static bool failed(struct reading *reading, exr_result_t code)
{
    return err_set(reading->err, code == EXR_ERR_OUT_OF_MEMORY ? ERR_MEMORY : ERR_SCENE, "%s: %s",
                   reading->source->name,
                   complaint[0] != '\0' ? complaint : exr_get_default_error_message(code));
}

/* --- Which channels ----------------------------------------------------------------------- */

/* The channel `name` of the layer that the first `length` characters of `layer` name ("Z."). */
static const exr_attr_chlist_entry_t *find(const exr_attr_chlist_t *list, const char *layer,
                                           size_t length, const char *name)
{
    for (int i = 0; i < list->num_channels; i++) {
        const char *other = list->entries[i].name.str;
        if (strncmp(other, layer, length) == 0 && strcmp(other + length, name) == 0)
            return &list->entries[i];
    }
    return NULL;
}

/* Our channels from this layer; how many, or 0 when it has neither RGB nor Y. */
static uint32_t choose_layer(const exr_attr_chlist_t *list, const char *layer, size_t length,
                             const exr_attr_chlist_entry_t *chosen[4])
{
    static const char *const rgb[] = { "R", "G", "B" };
    unsigned found = 0;
    for (unsigned c = 0; c < 3; c++) {
        chosen[c] = find(list, layer, length, rgb[c]);
        found += chosen[c] != NULL;
    }
    const exr_attr_chlist_entry_t *alpha = find(list, layer, length, "A");
    if (found >= 2) {
        chosen[3] = alpha;
        return alpha != NULL ? 4 : 3;
    }
    /* One colour alone, as masks and heights are stored, is a grey picture */
    const exr_attr_chlist_entry_t *grey = find(list, layer, length, "Y");
    for (unsigned c = 0; c < 3 && grey == NULL; c++)
        grey = chosen[c];
    chosen[0] = grey;
    chosen[1] = alpha;
    chosen[2] = chosen[3] = NULL;
    return grey == NULL ? 0 : alpha != NULL ? 2 : 1;
}

static uint32_t choose_channels(const exr_attr_chlist_t *list,
                                const exr_attr_chlist_entry_t *chosen[4])
{
    uint32_t count = choose_layer(list, "", 0, chosen);
    const char *layer = "";
    size_t length = 0;
    for (int i = 0; count == 0 && i < list->num_channels; i++) {
        const char *name = list->entries[i].name.str, *dot = strrchr(name, '.');
        size_t own = dot != NULL ? (size_t)(dot - name) + 1 : 0;
        if (own == length && strncmp(name, layer, own) == 0)
            continue; /* seen */
        layer = name;
        length = own;
        count = choose_layer(list, layer, length, chosen);
    }
    if (count == 0) {
        chosen[0] = &list->entries[0];
        count = 1;
    }
    return count;
}

/* --- The header --------------------------------------------------------------------------- */

static void keep_primaries(struct reading *reading)
{
    const exr_attribute_t *attribute;
    if (exr_get_attribute_by_name(reading->context, 0, "chromaticities", &attribute) !=
            EXR_ERR_SUCCESS ||
        attribute->type != EXR_ATTR_CHROMATICITIES)
        return;
    reading->picture->has_primaries = true;
    memcpy(reading->picture->primaries, attribute->chromaticities,
           sizeof(reading->picture->primaries));
}

static exr_result_t get_chunk_shape(struct reading *reading)
{
    if (reading->storage == EXR_STORAGE_TILED) {
        exr_tile_level_mode_t level;
        exr_tile_round_mode_t round;
        return exr_get_tile_descriptor(reading->context, 0, &reading->chunk_width,
                                       &reading->chunk_height, &level, &round);
    }
    int32_t lines = 1;
    exr_result_t result = exr_get_scanlines_per_chunk(reading->context, 0, &lines);
    reading->chunk_width = SIDE_MAX;
    reading->chunk_height = (uint32_t)lines;
    return result;
}

/* What the file says it is. */
struct claims {
    exr_attr_box2i_t display;
    int32_t chunks;
    uint64_t chunk_size; /* bytes, decoded */
};

static exr_result_t get_claims(struct reading *reading, struct claims *claims)
{
    exr_context_t context = reading->context;
    exr_result_t result = exr_get_compression(context, 0, &reading->compression);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_display_window(context, 0, &claims->display);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_data_window(context, 0, &reading->data);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_channels(context, 0, &reading->list);
    if (result == EXR_ERR_SUCCESS)
        result = get_chunk_shape(reading);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_chunk_count(context, 0, &claims->chunks);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_chunk_unpacked_size(context, 0, &claims->chunk_size);
    return result;
}

static bool check_claims(struct reading *reading, const struct claims *claims)
{
    const struct picture_source *source = reading->source;
    int channels = reading->list->num_channels;
    if (channels < 1 || channels > CHANNELS_MAX)
        return err_set(reading->err, ERR_LIMIT, "%s: %d channels; 1 to %d are supported",
                       source->name, channels, CHANNELS_MAX);
    if (claims->chunks < 1 || reading->chunk_width == 0 || reading->chunk_height == 0 ||
        (uint64_t)claims->chunks > source->size / 8) /* each has its place in a table */
        return picture_reader_ends_early(source, reading->err);
    if (claims->chunk_size > source->limit)
        return err_set(reading->err, ERR_LIMIT,
                       "%s: its header claims chunks of %" PRIu64
                       " bytes, more than is believed of a file of %zu bytes",
                       source->name, claims->chunk_size, source->size);
    return true;
}

/* Our channels, and who can read them. */
static bool choose_reader(struct reading *reading, uint32_t *channels, enum picture_format *format)
{
    const char *name = reading->source->name;
    const exr_attr_chlist_t *list = reading->list;
    const exr_attr_chlist_entry_t *chosen[4] = { NULL };
    uint32_t count = choose_channels(list, chosen);
    bool half = true, whole = true;
    for (uint32_t c = 0; c < count; c++) {
        if (chosen[c] == NULL)
            continue;
        reading->names[c] = chosen[c]->name.str;
        half = half && chosen[c]->pixel_type == EXR_PIXEL_HALF;
        whole = whole && chosen[c]->x_sampling == 1 && chosen[c]->y_sampling == 1;
    }
    const char *first = reading->names[0] != NULL ? reading->names[0] : reading->names[1];
    bool plain = strchr(first, '.') == NULL &&
                 (count >= 3 || strcmp(first, "R") == 0 || strcmp(first, "Y") == 0);
    bool chroma = count < 3 && strcmp(first, "Y") == 0 && find(list, "", 0, "RY") != NULL &&
                  find(list, "", 0, "BY") != NULL;
    reading->by_rgba = chroma || reading->compression == EXR_COMPRESSION_DWAA ||
                       reading->compression == EXR_COMPRESSION_DWAB;
    if (reading->by_rgba && !plain)
        return err_set(reading->err, ERR_UNSUPPORTED,
                       "%s: of a file with DWA compression, only R, G, B, Y and A can be read, not "
                       "channel \"%s\"",
                       name, first);
    if (!reading->by_rgba && !whole)
        return err_set(reading->err, ERR_UNSUPPORTED,
                       "%s: subsampled channels like \"%s\" are not supported", name, first);
    *channels = chroma ? count + 2 : count;
    *format = half || reading->by_rgba ? PICTURE_HALF : PICTURE_FLOAT;
    return true;
}

static bool place_windows(struct reading *reading, const exr_attr_box2i_t *display)
{
    int64_t x = (int64_t)reading->data.min.x - display->min.x;
    int64_t y = (int64_t)reading->data.min.y - display->min.y;
    int64_t width = (int64_t)display->max.x - display->min.x + 1;
    int64_t height = (int64_t)display->max.y - display->min.y + 1;
    if (x != (int32_t)x || y != (int32_t)y || width < 1 || height < 1 || width > INT32_MAX ||
        height > INT32_MAX)
        return err_set(reading->err, ERR_SCENE, "%s: its windows make no sense",
                       reading->source->name);
    reading->picture->data_x = (int32_t)x;
    reading->picture->data_y = (int32_t)y;
    reading->picture->display_width = (uint32_t)width;
    reading->picture->display_height = (uint32_t)height;
    return true;
}

/* Check what the file claims to be, choose its channels and allocate the picture. */
static bool read_header(struct reading *reading)
{
    struct claims claims;
    uint32_t channels;
    enum picture_format format;
    exr_result_t result = exr_get_storage(reading->context, 0, &reading->storage);
    if (result == EXR_ERR_SUCCESS && reading->storage != EXR_STORAGE_SCANLINE &&
        reading->storage != EXR_STORAGE_TILED)
        return err_set(reading->err, ERR_UNSUPPORTED, "%s: deep EXR files are not supported",
                       reading->source->name);
    if (result == EXR_ERR_SUCCESS)
        result = get_claims(reading, &claims);
    if (result != EXR_ERR_SUCCESS)
        return failed(reading, result);
    if (!check_claims(reading, &claims) || !choose_reader(reading, &channels, &format))
        return false;
    uint64_t width = (uint64_t)((int64_t)reading->data.max.x - reading->data.min.x + 1);
    uint64_t height = (uint64_t)((int64_t)reading->data.max.y - reading->data.min.y + 1);
    if (!picture_reader_allocate(reading->source, width, height, channels, format, reading->picture,
                                 reading->err) ||
        !place_windows(reading, &claims.display))
        return false;
    keep_primaries(reading);
    return true;
}

/* --- By the C core ------------------------------------------------------------------------ */

/* A line of one channel to every picture->channels-th value of `to`, an index in the pixels. */
static void store_line(struct picture *picture, size_t to, const uint8_t *from, size_t count,
                       uint16_t type)
{
    for (size_t i = 0; i < count; i++, to += picture->channels) {
        uint16_t half;
        uint32_t word;
        if (type == EXR_PIXEL_HALF) {
            memcpy(&half, from + 2 * i, sizeof(half));
            if (picture->format == PICTURE_HALF)
                ((uint16_t *)picture->pixels)[to] = half;
            else
                ((float *)picture->pixels)[to] = picture_reader_float(half);
            continue;
        }
        memcpy(&word, from + 4 * i, sizeof(word));
        float value = (float)word;
        if (type == EXR_PIXEL_FLOAT)
            memcpy(&value, &word, sizeof(value));
        ((float *)picture->pixels)[to] = value;
    }
}

/*
 * Decode one chunk, and put it where (x, y) is its first pixel. The library's own unpacking is left
 * out: ours takes the channels we want and no others, and never writes beyond the picture.
 */
static bool read_chunk(struct reading *reading, exr_decode_pipeline_t *decoder,
                       const exr_chunk_info_t *chunk, uint32_t x, uint32_t y)
{
    exr_const_context_t context = reading->context;
    struct picture *picture = reading->picture;
    exr_result_t result;
    if (decoder->channels == NULL) {
        result = exr_decoding_initialize(context, 0, chunk, decoder);
        if (result == EXR_ERR_SUCCESS)
            result = exr_decoding_choose_default_routines(context, 0, decoder);
        decoder->unpack_and_convert_fn = NULL;
    } else {
        result = exr_decoding_update(context, 0, chunk, decoder);
    }
    if (result == EXR_ERR_SUCCESS)
        result = exr_decoding_run(context, 0, decoder);
    if (result != EXR_ERR_SUCCESS)
        return failed(reading, result);

    const uint8_t *from = decoder->unpacked_buffer;
    uint64_t left = decoder->unpacked_buffer == decoder->packed_buffer ? chunk->packed_size
                                                                       : chunk->unpacked_size;
    if (chunk->height < 0 || chunk->width < 0 || (uint32_t)chunk->height > picture->height - y ||
        (uint32_t)chunk->width > picture->width - x || from == NULL)
        return failed(reading, EXR_ERR_BAD_CHUNK_LEADER);
    for (uint32_t line = 0; line < (uint32_t)chunk->height; line++) {
        int64_t file_y = (int64_t)reading->data.min.y + y + line;
        for (int16_t i = 0; i < decoder->channel_count; i++) {
            const exr_coding_channel_info_t *channel = &decoder->channels[i];
            if (channel->y_samples > 1 && file_y % channel->y_samples != 0)
                continue;
            uint64_t size = (uint64_t)channel->width * (uint64_t)channel->bytes_per_element;
            if (size > left)
                return failed(reading, EXR_ERR_CORRUPT_CHUNK);
            for (uint32_t c = 0; c < picture->channels; c++)
                if (reading->names[c] != NULL && channel->width == chunk->width &&
                    strcmp(reading->names[c], channel->channel_name) == 0)
                    store_line(picture,
                               ((size_t)(y + line) * picture->width + x) * picture->channels + c,
                               from, (size_t)chunk->width, channel->data_type);
            from += size;
            left -= size;
        }
    }
    return true;
}

/* The chunk whose first pixel is (x, y) of the picture. */
static exr_result_t find_chunk(const struct reading *reading, uint32_t x, uint32_t y,
                               exr_chunk_info_t *chunk)
{
    if (reading->storage == EXR_STORAGE_TILED)
        return exr_read_tile_chunk_info(reading->context, 0, (int)(x / reading->chunk_width),
                                        (int)(y / reading->chunk_height), 0, 0, chunk);
    return exr_read_scanline_chunk_info(reading->context, 0, reading->data.min.y + (int)y, chunk);
}

static bool read_core(struct reading *reading)
{
    bool good = true;
    exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
    for (uint64_t y = 0; good && y < reading->picture->height; y += reading->chunk_height) {
        for (uint64_t x = 0; good && x < reading->picture->width; x += reading->chunk_width) {
            exr_chunk_info_t chunk;
            exr_result_t result = find_chunk(reading, (uint32_t)x, (uint32_t)y, &chunk);
            good = result == EXR_ERR_SUCCESS
                       ? read_chunk(reading, &decoder, &chunk, (uint32_t)x, (uint32_t)y)
                       : failed(reading, result);
        }
    }
    exr_decoding_destroy(reading->context, &decoder);
    return good;
}

/* --- By the C++ library's C interface ----------------------------------------------------- */

#define STRIP_ROWS 64

static int64_t on_write(exr_const_context_t context, void *user, const void *buffer, uint64_t size,
                        uint64_t offset, exr_stream_error_func_ptr_t complain)
{
    for (uint64_t done = 0; done < size;) {
        ssize_t put = pwrite(*(int *)user, (const char *)buffer + done, size - done,
                             (off_t)(offset + done));
        if (put < 0 && errno == EINTR)
            continue;
        if (put <= 0) {
            complain(context, EXR_ERR_WRITE_IO, "%s", strerror(errno));
            return -1;
        }
        done += (uint64_t)put;
    }
    return (int64_t)size;
}

/* A header that says of our part what decides its pixels, and nothing else. */
static exr_result_t copy_header(const struct reading *reading, exr_context_t copy)
{
    int part;
    const struct picture *picture = reading->picture;
    const exr_attr_v2f_t center = { .x = 0, .y = 0 };
    exr_result_t result = exr_add_part(copy, NULL, reading->storage, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr(copy, part, &reading->data, &reading->data, 1,
                                              &center, 1, EXR_LINEORDER_INCREASING_Y,
                                              reading->compression);
    if (result == EXR_ERR_SUCCESS)
        result = exr_set_channels(copy, part, reading->list);
    if (result == EXR_ERR_SUCCESS && picture->has_primaries) { /* what luminance is made of */
        exr_attr_chromaticities_t primaries;
        memcpy(&primaries, picture->primaries, sizeof(primaries));
        result = exr_attr_set_chromaticities(copy, part, "chromaticities", &primaries);
    }
    if (result == EXR_ERR_SUCCESS && reading->storage == EXR_STORAGE_TILED)
        result = exr_set_tile_descriptor(copy, part, reading->chunk_width, reading->chunk_height,
                                         EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN);
    if (result == EXR_ERR_SUCCESS)
        result = exr_write_header(copy);
    return result;
}

static exr_result_t copy_chunk(const struct reading *reading, exr_context_t copy, uint32_t x,
                               uint32_t y)
{
    exr_chunk_info_t chunk;
    exr_result_t result = find_chunk(reading, x, y, &chunk);
    if (result != EXR_ERR_SUCCESS)
        return result;
    void *bytes = chunk.packed_size <= reading->source->size ? malloc(chunk.packed_size + 1) : NULL;
    if (bytes == NULL)
        return EXR_ERR_OUT_OF_MEMORY;
    result = exr_read_chunk(reading->context, 0, &chunk, bytes);
    if (result == EXR_ERR_SUCCESS && reading->storage == EXR_STORAGE_TILED)
        result = exr_write_tile_chunk(copy, 0, (int)(x / reading->chunk_width),
                                      (int)(y / reading->chunk_height), 0, 0, bytes,
                                      chunk.packed_size);
    else if (result == EXR_ERR_SUCCESS)
        result = exr_write_scanline_chunk(copy, 0, reading->data.min.y + (int)y, bytes,
                                          chunk.packed_size);
    free(bytes);
    return result;
}

/*
 * The C++ library reads files by name only, so it gets one that nobody else sees: the compressed
 * chunks as they are, behind a new header. Two parsers can disagree about a damaged header, and
 * then it would write where we have nothing, or allocate what we refused.
 */
static bool copy_file(struct reading *reading, int fd)
{
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    with.error_handler_fn = on_error;
    with.user_data = &fd;
    with.write_fn = on_write;
    exr_context_t copy = NULL;
    exr_result_t result = exr_start_write(&copy, reading->source->name, EXR_WRITE_FILE_DIRECTLY,
                                          &with);
    if (result == EXR_ERR_SUCCESS)
        result = copy_header(reading, copy);
    for (uint64_t y = 0; result == EXR_ERR_SUCCESS && y < reading->picture->height;
         y += reading->chunk_height)
        for (uint64_t x = 0; result == EXR_ERR_SUCCESS && x < reading->picture->width;
             x += reading->chunk_width)
            result = copy_chunk(reading, copy, (uint32_t)x, (uint32_t)y);
    exr_result_t finished = copy != NULL ? exr_finish(&copy) : EXR_ERR_SUCCESS;
    if (result == EXR_ERR_SUCCESS)
        result = finished;
    return result == EXR_ERR_SUCCESS || failed(reading, result);
}

static bool copy_strips(struct reading *reading, ImfInputFile *file, ImfRgba *strip)
{
    struct picture *picture = reading->picture;
    size_t width = picture->width;
    uint16_t *to = picture->pixels;
    for (uint32_t y = 0; y < picture->height; y += STRIP_ROWS) {
        uint32_t rows = picture->height - y < STRIP_ROWS ? picture->height - y : STRIP_ROWS;
        int first = reading->data.min.y + (int)y;
        /* The library wants the address that pixel (0, 0) would have */
        uintptr_t origin = (uintptr_t)strip -
                           (uintptr_t)(((int64_t)first * (int64_t)width + reading->data.min.x) *
                                       (int64_t)sizeof(*strip));
        if (!ImfInputSetFrameBuffer(file, (ImfRgba *)origin, 1, width) ||
            !ImfInputReadPixels(file, first, first + (int)rows - 1))
            return err_set(reading->err, ERR_SCENE, "%s: %s", reading->source->name,
                           ImfErrorMessage());
        for (size_t i = 0; i < rows * width; i++, to += picture->channels) {
            ImfHalf rgba[4] = { strip[i].r, strip[i].g, strip[i].b, strip[i].a };
            memcpy(to, rgba, picture->channels * sizeof(*to));
            if (picture->channels == 2)
                to[1] = strip[i].a;
        }
    }
    return true;
}

/* What the library may allocate at once: rows of whole chunks, cut into blocks of 8 by 8, of the
 * widest values and a quarter more for what does not compress. */
static uint64_t rgba_memory(const struct reading *reading)
{
    uint64_t width = reading->picture->width;
    if (reading->storage == EXR_STORAGE_TILED && reading->chunk_width > width)
        width = reading->chunk_width;
    return (width + 7) * ((uint64_t)reading->chunk_height + 7) *
           (uint64_t)reading->list->num_channels * 5;
}

static bool read_rgba(struct reading *reading)
{
    /* The library has one error message for all threads */
    static pthread_mutex_t one_at_a_time = PTHREAD_MUTEX_INITIALIZER;
    bool good = false;
    char path[64];
    int fd = memfd_create("pathfarm-exr", MFD_CLOEXEC);
    if (fd < 0)
        return err_set(reading->err, ERR_IO, "%s: no file in memory: %s", reading->source->name,
                       strerror(errno));
    const struct picture *picture = reading->picture;
    uint32_t rows = picture->height < STRIP_ROWS ? picture->height : STRIP_ROWS;
    uint64_t size = (uint64_t)picture->width * rows * sizeof(ImfRgba);
    ImfRgba *strip = rgba_memory(reading) <= reading->source->limit &&
                             size <= reading->source->limit
                         ? malloc(size)
                         : NULL;
    if (strip == NULL) {
        err_set(reading->err, ERR_MEMORY, "%s: no memory for chunks of %" PRIu32 " rows",
                reading->source->name, reading->chunk_height);
        goto fail_strip;
    }
    if (!copy_file(reading, fd))
        goto fail_copy;

    snprintf(path, sizeof(path), "/proc/self/fd/%d", fd);
    pthread_mutex_lock(&one_at_a_time);
    ImfInputFile *file = ImfOpenInputFile(path);
    if (file == NULL) {
        err_set(reading->err, ERR_SCENE, "%s: %s", reading->source->name, ImfErrorMessage());
        goto fail_file;
    }
    good = copy_strips(reading, file, strip);
    ImfCloseInputFile(file);
fail_file:
    pthread_mutex_unlock(&one_at_a_time);
fail_copy:
    free(strip);
fail_strip:
    close(fd);
    return good;
}

bool picture_exr_read(const struct picture_source *source, struct picture *picture, struct err *err)
{
    complaint[0] = '\0';
    alloc_limit = source->limit;
    exr_context_initializer_t with = EXR_DEFAULT_CONTEXT_INITIALIZER;
    with.error_handler_fn = on_error;
    with.alloc_fn = on_alloc;
    with.free_fn = free;
    with.user_data = (void *)source;
    with.read_fn = on_read;
    with.size_fn = on_size;
    with.max_image_width = with.max_image_height = SIDE_MAX;
    with.max_tile_width = with.max_tile_height = SIDE_MAX;
    /* A file with holes is damaged; guessing where its chunks are makes no picture of it */
    with.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;

    struct reading reading = { .source = source, .picture = picture, .err = err };
    exr_result_t result = exr_start_read(&reading.context, source->name, &with);
    if (result != EXR_ERR_SUCCESS)
        return failed(&reading, result);
    bool good = read_header(&reading) &&
                (reading.by_rgba ? read_rgba(&reading) : read_core(&reading));
    exr_finish(&reading.context);
    return good;
}
