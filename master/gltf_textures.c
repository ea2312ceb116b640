#include "master/gltf_textures.h"

#include "common/elem.h"
#include "master/gltf.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FAR 1e6 /* offsets and scales of texture coordinates */

enum { FILTER_NEAREST = 9728, WRAP_TO_EDGE = 33071, WRAP_MIRRORED = 33648, WRAP_REPEATED = 10497 };

struct gltf_image {
    uint32_t picture[2]; /* as numbers, as colours; SCENE_NONE: not read yet */
};

bool gltf_textures_start(struct gltf_reader *reader)
{
    size_t count = gltf_json_count(reader, "images");
    struct gltf_image *images = growing_add(&reader->textures.images, count, sizeof(*images));
    if (images == NULL)
        return gltf_report_no_memory(reader);
    memset(images, 0xff, count * sizeof(*images));
    return true;
}

void gltf_textures_free(struct gltf_textures *textures)
{
    scene_pictures_free(&textures->pictures);
    growing_free(&textures->images);
}

/* --- Pictures ----------------------------------------------------------------------------- */

static bool read_file(struct gltf_reader *reader, const char *uri, const char *where,
                      const struct picture_wish *wish, uint32_t *picture)
{
    char *path = gltf_file_path(reader, uri, where);
    if (path == NULL)
        return false;
    bool good = scene_pictures_read(&reader->textures.pictures, reader->build, path, wish, picture,
                                    reader->err);
    free(path);
    return good || gltf_report_wrap(reader, where);
}

static bool read_bytes(struct gltf_reader *reader, struct gltf_bytes bytes, const char *where,
                       const struct picture_wish *wish, uint32_t *picture)
{
    char name[512];
    snprintf(name, sizeof(name), "%.300s: %s", reader->report.path, where);
    bool good = scene_pictures_read_bytes(&reader->textures.pictures, reader->build, bytes.data,
                                          bytes.size, name, wish, picture, reader->err);
    reader->failed = reader->failed || !good;
    return good;
}

static bool read_image(struct gltf_reader *reader, const struct gltf_item *image, bool colors,
                       uint32_t *picture)
{
    const struct picture_wish wish = { .encoding = colors ? ENCODING_SRGB : ENCODING_LINEAR,
                                       .pyramid = true };
    const char *uri = gltf_json_text(reader, image, "uri");
    struct gltf_bytes bytes;
    size_t stride;
    if (reader->failed)
        return false;
    if (uri != NULL && gltf_file_is_data(uri)) {
        unsigned char *data = gltf_file_data(reader, uri, image->where, &bytes.size);
        bytes.data = data;
        bool good = data != NULL && read_bytes(reader, bytes, image->where, &wish, picture);
        free(data);
        return good;
    }
    if (uri != NULL)
        return read_file(reader, uri, image->where, &wish, picture);
    uint32_t view = gltf_json_index(reader, image, "bufferView");
    return !reader->failed && gltf_file_view(reader, view, image, &bytes, &stride) &&
           read_bytes(reader, bytes, image->where, &wish, picture);
}

/* --- Texture infos ------------------------------------------------------------------------ */

static uint32_t wrap_of(struct gltf_reader *reader, const struct gltf_item *sampler,
                        const char *name)
{
    uint64_t wrap = gltf_json_size(reader, sampler, name, WRAP_REPEATED);
    if (wrap != WRAP_TO_EDGE && wrap != WRAP_MIRRORED && wrap != WRAP_REPEATED)
        gltf_report_error(reader, sampler->where, "\"%s\" is none that is known", name);
    return wrap == WRAP_TO_EDGE ? WRAP_CLAMP : wrap == WRAP_MIRRORED ? WRAP_MIRROR : WRAP_REPEAT;
}

static bool read_sampler(struct gltf_reader *reader, const struct gltf_item *texture,
                         struct texture *node)
{
    struct gltf_item sampler = { 0 };
    uint32_t index = gltf_json_index(reader, texture, "sampler");
    if (index != SCENE_NONE && !gltf_json_find(reader, "samplers", index, texture, &sampler))
        return false;
    node->wrap[0] = wrap_of(reader, &sampler, "wrapS");
    node->wrap[1] = wrap_of(reader, &sampler, "wrapT");
    if (gltf_json_size(reader, &sampler, "magFilter", 0) == FILTER_NEAREST)
        node->flags |= TEXTURE_NEAREST;
    return !reader->failed;
}

/* Scale, turn, move, as KHR_texture_transform in its upside-down coordinates; ours are 1 - v */
static void read_transform(struct gltf_reader *reader, const struct gltf_item *info,
                           struct gltf_texture *texture)
{
    struct gltf_item transform = gltf_json_extension(reader, info, "KHR_texture_transform");
    double offset[2] = { 0, 0 }, scale[2] = { 1, 1 };
    gltf_json_numbers(reader, &transform, "offset", -FAR, FAR, offset, 2);
    gltf_json_numbers(reader, &transform, "scale", -FAR, FAR, scale, 2);
    double angle = gltf_json_number(reader, &transform, "rotation", 0, -1e5, 1e5);
    if (gltf_json_has(&transform, "texCoord"))
        texture->set = gltf_json_index(reader, &transform, "texCoord");
    double c = elem_cos(angle), s = elem_sin(angle);
    float *map = texture->node.map;
    map[0] = (float)(scale[0] * c);
    map[1] = (float)(-scale[1] * s);
    map[2] = (float)(scale[1] * s + offset[0]);
    map[3] = (float)(scale[0] * s);
    map[4] = (float)(scale[1] * c);
    map[5] = (float)(1 - scale[1] * c - offset[1]);
}

static bool read_info(struct gltf_reader *reader, const struct gltf_item *info, bool colors,
                      struct gltf_texture *texture)
{
    struct gltf_item item, image;
    uint32_t index = gltf_json_index(reader, info, "index");
    uint64_t set = gltf_json_size(reader, info, "texCoord", 0);
    if (reader->failed || !gltf_json_find(reader, "textures", index, info, &item))
        return false;
    texture->set = (uint32_t)(set < 1000 ? set : 1000);
    uint32_t source = gltf_json_index(reader, &item, "source");
    if (reader->failed || !read_sampler(reader, &item, &texture->node))
        return false;
    read_transform(reader, info, texture);
    if (source == SCENE_NONE)
        return !reader->failed &&
               gltf_report_later(reader, item.where, "a picture that is neither PNG nor JPEG");
    if (reader->failed || !gltf_json_find(reader, "images", source, &item, &image))
        return false;
    uint32_t *picture = ((struct gltf_image *)reader->textures.images.data)[source].picture +
                        colors;
    if (*picture == SCENE_NONE && !read_image(reader, &image, colors, picture)) {
        *picture = SCENE_NONE;
        if (!reader->options->lenient)
            return false;
        reader->failed = false;
        return gltf_report_later(reader, image.where, "this picture");
    }
    texture->node.picture = *picture;
    texture->there = true;
    return true;
}

bool gltf_textures_read(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        bool colors, struct gltf_texture *texture)
{
    struct gltf_item info = gltf_json_child(reader, item, name);
    *texture = (struct gltf_texture){
        .node = { .kind = TEXTURE_IMAGE, .channel = SCENE_NONE, .scale = 1 }
    };
    memcpy(texture->where, info.where, sizeof(texture->where));
    return info.json == NULL ? !reader->failed : read_info(reader, &info, colors, texture);
}

/* --- The mean ----------------------------------------------------------------------------- */

static double half_value(uint16_t bits)
{
    int exponent = bits >> 10 & 31, mantissa = bits & 1023;
    double value = exponent == 0 ? ldexp(mantissa, -24) : ldexp(1024 + mantissa, exponent - 25);
    return bits & 0x8000 ? -value : value;
}

static double srgb_value(uint8_t code)
{
    double c = code / 255.0;
    return c <= 0.04045 ? c / 12.92 : elem_pow((c + 0.055) / 1.055, 2.4);
}

void gltf_textures_mean(const struct gltf_reader *reader, const struct gltf_texture *texture,
                        double rgba[4])
{
    const struct scene_picture *picture =
        (const struct scene_picture *)reader->build->pictures.data + texture->node.picture;
    const uint8_t *texels = (const uint8_t *)reader->build->texels.data +
                            (size_t)picture->first_block * TEXEL_BLOCK;
    size_t count = (size_t)picture->width * picture->height, channels = picture->channels;
    double sum[4] = { 0 }, srgb[256];
    for (unsigned code = 0; code < 256; code++)
        srgb[code] = srgb_value((uint8_t)code);
    for (size_t i = 0; i < count * channels; i++) {
        size_t channel = i % channels;
        bool alpha = channels % 2 == 0 && channel == channels - 1;
        double value;
        uint16_t half;
        float single;
        switch (picture->texel) {
        case TEXEL_U8_SRGB:
            value = alpha ? texels[i] / 255.0 : srgb[texels[i]];
            break;
        case TEXEL_U8:
            value = texels[i] / 255.0;
            break;
        case TEXEL_HALF:
            memcpy(&half, texels + 2 * i, sizeof(half));
            value = half_value(half);
            break;
        default:
            memcpy(&single, texels + 4 * i, sizeof(single));
            value = single;
        }
        sum[channel] += value;
    }
    bool grey = channels <= 2;
    for (unsigned c = 0; c < 3; c++)
        rgba[c] = sum[grey ? 0 : c] / (double)count;
    rgba[3] = channels % 2 == 0 ? sum[channels - 1] / (double)count : 1;
}

/* --- Trees -------------------------------------------------------------------------------- */

static bool add(struct gltf_reader *reader, const struct texture *node, uint32_t *added)
{
    struct texture *slot = growing_add(&reader->build->textures, 1, sizeof(*slot));
    if (slot == NULL)
        return gltf_report_no_memory(reader);
    *slot = *node;
    *added = (uint32_t)reader->build->textures.count;
    return true;
}

bool gltf_textures_image(struct gltf_reader *reader, const struct gltf_texture *texture,
                         uint32_t channel, uint32_t *added)
{
    *added = 0;
    if (!texture->there)
        return true;
    const struct scene_picture *picture =
        (const struct scene_picture *)reader->build->pictures.data + texture->node.picture;
    struct texture node = texture->node;
    if (channel == 3 && picture->channels % 2 != 0)
        return true;
    node.channel = channel; /* of a grey picture, red, green and blue are the same */
    return add(reader, &node, added);
}

bool gltf_textures_colors(struct gltf_reader *reader, uint32_t channel, uint32_t *added)
{
    return add(reader, &(struct texture){ .kind = TEXTURE_VERTEX_COLOR, .channel = channel },
               added);
}

bool gltf_textures_product(struct gltf_reader *reader, uint32_t *texture, uint32_t other)
{
    if (*texture == 0 || other == 0) {
        *texture = *texture != 0 ? *texture : other;
        return true;
    }
    const struct texture node = { .kind = TEXTURE_SCALE,
                                  .child = { *texture, other },
                                  .channel = SCENE_NONE };
    return add(reader, &node, texture);
}

bool gltf_textures_scale(struct gltf_reader *reader, uint32_t *texture, const double factor[3])
{
    if (*texture != 0 && factor[0] == 1 && factor[1] == 1 && factor[2] == 1)
        return true;
    struct texture node = { .kind = *texture != 0 ? TEXTURE_SCALE : TEXTURE_CONSTANT,
                            .child = { *texture },
                            .channel = SCENE_NONE };
    for (int c = 0; c < 3; c++)
        node.value[*texture != 0][c] = (float)factor[c];
    return add(reader, &node, texture);
}

bool gltf_textures_step(struct gltf_reader *reader, uint32_t *texture, double threshold)
{
    const float t = (float)threshold;
    const struct texture node = { .kind = TEXTURE_STEP,
                                  .child = { *texture },
                                  .value = { { 0 }, { t, t, t } },
                                  .channel = SCENE_NONE };
    return add(reader, &node, texture);
}

bool gltf_textures_constant(struct gltf_reader *reader, double value, uint32_t *added)
{
    *added = 0;
    return gltf_textures_scale(reader, added, (double[]){ value, value, value });
}
