#include "master/cryptomatte.h"

#include "master/image.h"

#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NAME_SIZE 256

static uint32_t rotate(uint32_t x, int bits)
{
    return x << bits | x >> (32 - bits);
}

/* Appleby's MurmurHash3, the 32-bit variant; words are little-endian */
uint32_t cryptomatte_hash(const void *bytes, size_t size)
{
    const unsigned char *at = bytes;
    uint32_t hash = 0;
    for (size_t left = size; left > 0;) {
        uint32_t word = 0;
        size_t take = left < 4 ? left : 4;
        for (size_t i = 0; i < take; i++)
            word |= (uint32_t)at[i] << 8 * i;
        hash ^= rotate(word * 0xcc9e2d51u, 15) * 0x1b873593u;
        if (take == 4)
            hash = rotate(hash, 13) * 5 + 0xe6546b64u;
        at += take;
        left -= take;
    }
    hash ^= (uint32_t)size;
    hash = (hash ^ hash >> 16) * 0x85ebca6bu;
    hash = (hash ^ hash >> 13) * 0xc2b2ae35u;
    return hash ^ hash >> 16;
}

static uint32_t id_bits(const char *name)
{
    uint32_t bits = cryptomatte_hash(name, strlen(name));
    uint32_t exponent = bits >> 23 & 255;
    return exponent == 0 || exponent == 255 ? bits ^ 1u << 23 : bits;
}

float cryptomatte_id(const char *name)
{
    uint32_t bits = id_bits(name);
    float id;
    memcpy(&id, &bits, sizeof(id));
    return id;
}

void cryptomatte_channel(const char *name, unsigned channel, char *text, size_t capacity)
{
    snprintf(text, capacity, "%s%02u.%c", name, channel / 4, "RGBA"[channel % 4]);
}

static int by_value(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

void cryptomatte_rank(uint32_t *samples, unsigned count, uint32_t index[CRYPTOMATTE_RANKS],
                      float coverage[CRYPTOMATTE_RANKS])
{
    unsigned hits[CRYPTOMATTE_RANKS] = { 0 };
    memset(index, 0, CRYPTOMATTE_RANKS * sizeof(*index));
    qsort(samples, count, sizeof(*samples), by_value);
    for (unsigned i = 0, end; i < count; i = end) {
        for (end = i + 1; end < count && samples[end] == samples[i]; end++)
            ;
        if (samples[i] == 0)
            continue;
        /* Behind those that cover as much; what falls off the end is lost, as in every reader */
        unsigned rank = CRYPTOMATTE_RANKS;
        while (rank > 0 && hits[rank - 1] < end - i)
            rank--;
        if (rank == CRYPTOMATTE_RANKS)
            continue;
        size_t behind = CRYPTOMATTE_RANKS - 1 - rank;
        memmove(&index[rank + 1], &index[rank], behind * sizeof(*index));
        memmove(&hits[rank + 1], &hits[rank], behind * sizeof(*hits));
        index[rank] = samples[i];
        hits[rank] = end - i;
    }
    for (int rank = 0; rank < CRYPTOMATTE_RANKS; rank++)
        coverage[rank] = hits[rank] == 0 ? 0 : (float)hits[rank] / (float)count;
}

/* {"name":"hash", ...}; a name that is not text is left out */
static char *manifest_of(const struct scene *scene, uint32_t count, cryptomatte_name_fn *name)
{
    json_t *manifest = json_object();
    for (uint32_t i = 0; i < count; i++) {
        char text[NAME_SIZE], hex[16];
        name(scene, i, text, sizeof(text));
        snprintf(hex, sizeof(hex), "%08x", id_bits(text));
        json_object_set_new(manifest, text, json_string(hex));
    }
    char *text = json_dumps(manifest, JSON_COMPACT);
    json_decref(manifest);
    return text;
}

bool cryptomatte_names_make(struct cryptomatte_names *names, const struct scene *scene,
                            uint32_t count, cryptomatte_name_fn *name)
{
    *names = (struct cryptomatte_names){ .count = count };
    names->ids = calloc((size_t)count + 1, sizeof(*names->ids));
    if (names->ids == NULL)
        return false;
    for (uint32_t i = 0; i < count; i++) {
        char text[NAME_SIZE];
        name(scene, i, text, sizeof(text));
        names->ids[i] = cryptomatte_id(text);
    }
    if (count > CRYPTOMATTE_NAMES_MAX)
        return true;
    names->manifest = manifest_of(scene, count, name);
    return names->manifest != NULL;
}

void cryptomatte_names_free(struct cryptomatte_names *names)
{
    free(names->ids);
    free(names->manifest);
    *names = (struct cryptomatte_names){ .ids = NULL };
}

bool cryptomatte_describe(struct image *image, const char *name,
                          const struct cryptomatte_names *names)
{
    const char *const texts[][2] = {
        { "name", name },
        { "hash", "MurmurHash3_32" },
        { "conversion", "uint32_to_float32" },
        { "manifest", names->manifest },
    };
    char key[16];
    snprintf(key, sizeof(key), "%08x", cryptomatte_hash(name, strlen(name)));
    for (size_t i = 0; i < sizeof(texts) / sizeof(texts[0]); i++) {
        char attribute[64];
        snprintf(attribute, sizeof(attribute), "cryptomatte/%.7s/%s", key, texts[i][0]);
        if (texts[i][1] == NULL || image_attribute(image, attribute) != NULL)
            continue;
        if (!image_set_attribute(image, attribute, texts[i][1]))
            return false;
    }
    return true;
}
