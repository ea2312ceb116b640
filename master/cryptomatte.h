/*
 * Identities as Cryptomatte wants them (Friedman and Jones, "Cryptomatte Specification", 1.2.0):
 * names hashed to floats, and pixels as ranked pairs of such a float and its coverage.
 */
#ifndef MASTER_CRYPTOMATTE_H
#define MASTER_CRYPTOMATTE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct image;
struct scene;

#define CRYPTOMATTE_RANKS 6 /* of a pixel: two in each layer of four channels */

/* MurmurHash3_x86_32 with seed 0 */
uint32_t cryptomatte_hash(const void *bytes, size_t size);

/* The hash of a name as the bits of a float that is neither subnormal, infinite nor NaN */
float cryptomatte_id(const char *name);

/* Channel `channel` (0..2 * CRYPTOMATTE_RANKS - 1) of the layers of `name`: "CryptoObject01.G" */
void cryptomatte_channel(const char *name, unsigned channel, char *text, size_t capacity);

/*
 * Rank `count` samples' identities, 0 for none; they are sorted on the way. The pair of rank r is
 * put into index[r] and coverage[r], by falling coverage and rising identity; unused ranks are 0.
 */
void cryptomatte_rank(uint32_t *samples, unsigned count, uint32_t index[CRYPTOMATTE_RANKS],
                      float coverage[CRYPTOMATTE_RANKS]);

/*
 * The names of all objects, or of all materials: the float of each, and the manifest that tells
 * readers their names. With more than CRYPTOMATTE_NAMES_MAX there is no manifest, as the
 * specification allows. `name` writes the name of `index`. False: out of memory; then, as always,
 * cryptomatte_names_free.
 */
#define CRYPTOMATTE_NAMES_MAX 65536
struct cryptomatte_names {
    float *ids;
    uint32_t count;
    char *manifest; /* NULL: there is none */
};
typedef void cryptomatte_name_fn(const struct scene *scene, uint32_t index, char *text,
                                 size_t capacity);
bool cryptomatte_names_make(struct cryptomatte_names *names, const struct scene *scene,
                            uint32_t count, cryptomatte_name_fn *name);
void cryptomatte_names_free(struct cryptomatte_names *names);

/* The attributes by which readers find the layers of `name`. False: out of memory. */
bool cryptomatte_describe(struct image *image, const char *name,
                          const struct cryptomatte_names *names);

#endif
