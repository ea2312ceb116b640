/*
 * Images, samplers and texture transforms, and the trees of textures that materials are made of.
 * Part of the glTF reader.
 *
 * glTF's v goes downwards; meshes store 1 - v, and so do the mappings here: pictures stand as they
 * should, and the tangent frame of normal maps is glTF's (green points up in the picture).
 *
 * Textures are named as in struct material: 1 + index, or 0 for none.
 */
#ifndef MASTER_GLTF_TEXTURES_H
#define MASTER_GLTF_TEXTURES_H

#include "common/scene.h"
#include "master/gltf_json.h"
#include "master/growing.h"
#include "master/scene_pictures.h"

#include <stdbool.h>
#include <stdint.h>

struct gltf_textures {
    struct scene_pictures pictures;
    struct growing images; /* struct gltf_image, as many as the file lists */
};

/* A picture on a surface. */
struct gltf_texture {
    bool there;
    uint32_t set;        /* of texture coordinates */
    struct texture node; /* its RGB */
    char where[160];
};

bool gltf_textures_start(struct gltf_reader *reader);
void gltf_textures_free(struct gltf_textures *textures);

/* The texture that a member of an object refers to, if any. When lenient, one that cannot be read
 * is not there. `colors` are sRGB, other numbers linear. */
bool gltf_textures_read(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        bool colors, struct gltf_texture *texture);

/* The mean of its red, green, blue and alpha. */
void gltf_textures_mean(const struct gltf_reader *reader, const struct gltf_texture *texture,
                        double rgba[4]);

/* Into the scene: its RGB (channel SCENE_NONE), or one channel of it, 0 to 3. 0 for an alpha that
 * the picture does not have, and for a texture that is not there. */
bool gltf_textures_image(struct gltf_reader *reader, const struct gltf_texture *texture,
                         uint32_t channel, uint32_t *added);

/* The vertices' colours, or one channel of them. */
bool gltf_textures_colors(struct gltf_reader *reader, uint32_t channel, uint32_t *added);

/* *texture times another one, or times a colour; no texture is 1. */
bool gltf_textures_product(struct gltf_reader *reader, uint32_t *texture, uint32_t other);
bool gltf_textures_scale(struct gltf_reader *reader, uint32_t *texture, const double factor[3]);

/* 1 where *texture is at least `threshold`, else 0. */
bool gltf_textures_step(struct gltf_reader *reader, uint32_t *texture, double threshold);

/* The same value everywhere. */
bool gltf_textures_constant(struct gltf_reader *reader, double value, uint32_t *added);

#endif
