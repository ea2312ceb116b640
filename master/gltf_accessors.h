/*
 * Accessors: arrays of numbers in the file's buffers, interleaved or not, sparse, or integers that
 * stand for fractions. Part of the glTF reader.
 *
 * An open accessor lies inside of its buffer, whatever is asked of it. Without a buffer view it is
 * all zeros, but for what is sparse.
 */
#ifndef MASTER_GLTF_ACCESSORS_H
#define MASTER_GLTF_ACCESSORS_H

#include "master/gltf_json.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct gltf_accessor {
    struct gltf_item item;
    uint32_t count, components; /* elements, and numbers of each */
    uint32_t type;              /* of a number, as in the file: 5126 is a float */
    bool normalized;
    const unsigned char *data; /* NULL: zeros */
    size_t stride;
    uint32_t sparse_count, sparse_type; /* of what replaces elements */
    const unsigned char *sparse_indices, *sparse_values;
};

bool gltf_accessors_open(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from,
                         struct gltf_accessor *accessor);

/* All elements as floats, components side by side; `out` has room for them. Numbers that are not
 * finite are an error. */
bool gltf_accessors_floats(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                           float *out);

/* All elements of an accessor of whole scalars. */
bool gltf_accessors_indices(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                            uint32_t *out);

#endif
