/*
 * TGA: colour-mapped, true-colour and grey, plain or run-length coded, any of the four origins.
 * The rules for alpha are those of the writers found in the wild: the fourth byte counts unless
 * the header promises no alpha and all of them are zero.
 */
#include "master/picture_reader.h"

#include <inttypes.h>
#include <string.h>

struct header {
    unsigned id_size;
    unsigned map_first, map_length, map_bits;
    unsigned width, height;
    unsigned bits;       /* of a pixel in the file */
    unsigned alpha_bits; /* as promised */
    bool has_map, mapped, grey, packed;
    bool right_to_left, bottom_up;
};

static unsigned word(const uint8_t *bytes)
{
    return bytes[0] | (unsigned)bytes[1] << 8;
}

static bool read_header(const struct picture_source *source, struct header *header, struct err *err)
{
    const uint8_t *bytes = source->bytes;
    if (source->size < 18)
        return picture_reader_ends_early(source, err);
    unsigned kind = bytes[2];
    *header = (struct header){
        .id_size = bytes[0],
        .has_map = bytes[1] == 1,
        .mapped = (kind & 7) == 1,
        .grey = (kind & 7) == 3,
        .packed = kind >= 9,
        .map_first = word(bytes + 3),
        .map_length = word(bytes + 5),
        .map_bits = bytes[7],
        .width = word(bytes + 12),
        .height = word(bytes + 14),
        .bits = bytes[16],
        .alpha_bits = bytes[17] & 15,
        .right_to_left = (bytes[17] & 16) != 0,
        .bottom_up = (bytes[17] & 32) == 0,
    };
    if (bytes[1] > 1 || !((kind >= 1 && kind <= 3) || (kind >= 9 && kind <= 11)))
        return err_set(err, ERR_SCENE, "%s: is no TGA picture (kind %u, colour map %u)",
                       source->name, kind, (unsigned)bytes[1]);
    if ((bytes[17] & 0xc0) != 0)
        return err_set(err, ERR_UNSUPPORTED, "%s: interleaved TGA rows are not supported",
                       source->name);

    bool map_good = header->map_bits == 15 || header->map_bits == 16 || header->map_bits == 24 ||
                    header->map_bits == 32;
    bool bits_good = header->mapped || header->grey ? header->bits == 8 || header->bits == 16
                                                    : header->bits == 15 || header->bits == 16 ||
                                                          header->bits == 24 || header->bits == 32;
    if (!bits_good || (header->has_map && header->map_length > 0 && !map_good))
        return err_set(err, ERR_SCENE,
                       "%s: TGA pixels of %u bits, of kind %u and with a map of %u bits, are not "
                       "known",
                       source->name, header->bits, kind, header->map_bits);
    if (header->mapped && (!header->has_map || header->map_length == 0))
        return err_set(err, ERR_SCENE, "%s: its pixels want a colour map, and there is none",
                       source->name);
    return true;
}

/* One colour as the file has it, blue first, to RGBA. */
static void unpack_color(const uint8_t *from, unsigned bits, unsigned alpha_bits, uint8_t rgba[4])
{
    if (bits >= 24) {
        rgba[0] = from[2];
        rgba[1] = from[1];
        rgba[2] = from[0];
        rgba[3] = bits == 32 ? from[3] : 255;
        return;
    }
    unsigned five = word(from);
    for (unsigned c = 0; c < 3; c++)
        rgba[c] = (uint8_t)(((five >> (10 - 5 * c) & 31) * 255 + 15) / 31);
    rgba[3] = bits == 16 && alpha_bits == 1 && (five & 0x8000) == 0 ? 0 : 255;
}

/* The file's pixels, one after the other; packets run across the ends of rows. */
struct pixels {
    const uint8_t *at, *end;
    size_t size; /* bytes of one */
    bool packed, run;
    unsigned left; /* pixels of the current packet */
};

/* NULL at the end of the file. */
static const uint8_t *next_pixel(struct pixels *in)
{
    if (in->packed && in->left == 0 && in->at < in->end) {
        in->run = *in->at >= 128;
        in->left = (*in->at & 127) + 1u;
        in->at++;
    }
    if ((size_t)(in->end - in->at) < in->size)
        return NULL;
    const uint8_t *pixel = in->at;
    in->left -= in->packed;
    if (!in->run || in->left == 0)
        in->at += in->size;
    return pixel;
}

static bool read_pixels(const struct picture_source *source, const struct header *header,
                        struct pixels *in, const uint8_t *map, struct picture *picture,
                        struct err *err)
{
    size_t map_size = (header->map_bits + 7) / 8;
    for (uint32_t i = 0; i < header->height; i++) {
        uint32_t y = header->bottom_up ? header->height - 1 - i : i;
        for (uint32_t k = 0; k < header->width; k++) {
            uint32_t x = header->right_to_left ? header->width - 1 - k : k;
            const uint8_t *from = next_pixel(in);
            if (from == NULL)
                return picture_reader_ends_early(source, err);

            uint8_t *to = (uint8_t *)picture->pixels +
                          ((size_t)y * header->width + x) * picture->channels;
            if (header->grey) {
                memcpy(to, from, picture->channels);
                continue;
            }
            unsigned bits = header->bits;
            if (header->mapped) {
                unsigned index = bits == 16 ? word(from) : *from;
                if (index < header->map_first || index - header->map_first >= header->map_length)
                    return err_set(err, ERR_SCENE,
                                   "%s: pixel (%" PRIu32 ", %" PRIu32
                                   ") has colour %u, and the map has %u from %u on",
                                   source->name, x, y, index, header->map_length,
                                   header->map_first);
                from = map + (index - header->map_first) * map_size;
                bits = header->map_bits;
            }
            uint8_t rgba[4];
            unpack_color(from, bits, header->alpha_bits, rgba);
            memcpy(to, rgba, picture->channels);
        }
    }
    return true;
}

/* Writers that mean no alpha leave zeros. */
static bool alpha_is_zero(const struct picture *picture)
{
    const uint8_t *pixels = picture->pixels;
    size_t count = (size_t)picture->width * picture->height;
    for (size_t i = 0; i < count; i++)
        if (pixels[4 * i + 3] != 0)
            return false;
    return true;
}

static void drop_alpha(struct picture *picture)
{
    uint8_t *pixels = picture->pixels;
    size_t count = (size_t)picture->width * picture->height;
    for (size_t i = 0; i < count; i++)
        memmove(pixels + 3 * i, pixels + 4 * i, 3);
    picture->channels = 3;
    picture->has_alpha = false;
}

bool picture_tga_read(const struct picture_source *source, struct picture *picture, struct err *err)
{
    struct header header;
    if (!read_header(source, &header, err))
        return false;

    size_t map_size = header.has_map ? (size_t)header.map_length * ((header.map_bits + 7) / 8) : 0;
    size_t before = 18 + (size_t)header.id_size;
    if (source->size < before || source->size - before < map_size)
        return picture_reader_ends_early(source, err);
    const uint8_t *map = source->bytes + before, *data = map + map_size;
    size_t data_size = source->size - before - map_size;

    /* A packet of two bytes or more holds 128 pixels at most */
    size_t count = (size_t)header.width * header.height, pixel_size = (header.bits + 7) / 8;
    if (header.packed ? count / 128 > data_size : count * pixel_size > data_size)
        return picture_reader_ends_early(source, err);

    unsigned color_bits = header.mapped ? header.map_bits : header.bits;
    bool alpha = color_bits == 32 || (color_bits == 16 && header.alpha_bits == 1);
    uint32_t channels = header.grey ? header.bits / 8 : alpha ? 4 : 3;
    if (!picture_reader_allocate(source, header.width, header.height, channels, PICTURE_U8, picture,
                                 err))
        return false;

    struct pixels in = {
        .at = data,
        .end = data + data_size,
        .size = pixel_size,
        .packed = header.packed,
    };
    if (!read_pixels(source, &header, &in, map, picture, err))
        return false;
    if (alpha && header.alpha_bits == 0 && alpha_is_zero(picture))
        drop_alpha(picture);
    return true;
}
