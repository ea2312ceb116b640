#include "master/gltf_accessors.h"

#include "master/gltf_reader.h"

#include <math.h>
#include <string.h>

#define COUNT_MOST (1u << 30)

enum { BYTE = 5120, UBYTE = 5121, SHORT = 5122, USHORT = 5123, UINT = 5125, FLOAT = 5126 };

static size_t number_size(uint32_t type)
{
    switch (type) {
    case BYTE:
    case UBYTE:
        return 1;
    case SHORT:
    case USHORT:
        return 2;
    case UINT:
    case FLOAT:
        return 4;
    default:
        return 0;
    }
}

static bool is_index(uint32_t type)
{
    return type == UBYTE || type == USHORT || type == UINT;
}

static uint32_t component_count(const char *type)
{
    static const struct {
        const char *name;
        uint32_t count;
    } types[] = { { "SCALAR", 1 }, { "VEC2", 2 }, { "VEC3", 3 }, { "VEC4", 4 }, { "MAT4", 16 } };
    for (size_t i = 0; type != NULL && i < sizeof(types) / sizeof(types[0]); i++)
        if (strcmp(type, types[i].name) == 0)
            return types[i].count;
    return 0;
}

/* --- Where it lies ------------------------------------------------------------------------ */

/* `count` elements of `size` bytes in the buffer view that `item` names; NULL after an error */
static const unsigned char *elements(struct gltf_reader *reader, const struct gltf_item *item,
                                     uint64_t count, size_t size, size_t *stride)
{
    struct gltf_bytes bytes;
    uint64_t offset = gltf_json_size(reader, item, "byteOffset", 0);
    uint32_t view = gltf_json_index(reader, item, "bufferView");
    if (reader->failed || !gltf_file_view(reader, view, item, &bytes, stride))
        return NULL;
    *stride = *stride > 0 ? *stride : size;
    uint64_t end = offset + (count > 0 ? (count - 1) * *stride + size : 0);
    if (offset > bytes.size || end > bytes.size) {
        gltf_report_error(reader, item->where, "it needs %llu bytes of a view of %zu",
                          (unsigned long long)end, bytes.size);
        return NULL;
    }
    return bytes.data + offset;
}

static bool open_sparse(struct gltf_reader *reader, struct gltf_accessor *accessor)
{
    struct gltf_item sparse = gltf_json_child(reader, &accessor->item, "sparse");
    if (sparse.json == NULL)
        return !reader->failed;
    struct gltf_item indices = gltf_json_child(reader, &sparse, "indices");
    struct gltf_item values = gltf_json_child(reader, &sparse, "values");
    uint64_t count = gltf_json_size(reader, &sparse, "count", 0);
    accessor->sparse_type = gltf_json_index(reader, &indices, "componentType");
    if (reader->failed)
        return false;
    if (count > accessor->count || !is_index(accessor->sparse_type))
        return gltf_report_error(reader, sparse.where, "its count or its type is not possible");
    accessor->sparse_count = (uint32_t)count;
    size_t stride, size = number_size(accessor->type) * accessor->components;
    accessor->sparse_indices = elements(reader, &indices, count, number_size(accessor->sparse_type),
                                        &stride);
    if (accessor->sparse_indices == NULL)
        return false;
    accessor->sparse_values = elements(reader, &values, count, size, &stride);
    return accessor->sparse_values != NULL;
}

bool gltf_accessors_open(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from,
                         struct gltf_accessor *accessor)
{
    *accessor = (struct gltf_accessor){ 0 };
    struct gltf_item *item = &accessor->item;
    if (!gltf_json_find(reader, "accessors", index, from, item))
        return false;
    uint64_t count = gltf_json_size(reader, item, "count", 0);
    accessor->type = gltf_json_index(reader, item, "componentType");
    accessor->components = component_count(gltf_json_text(reader, item, "type"));
    accessor->normalized = gltf_json_bool(reader, item, "normalized", false);
    size_t size = number_size(accessor->type) * accessor->components;
    if (reader->failed)
        return false;
    if (size == 0 || count > COUNT_MOST)
        return gltf_report_error(reader, item->where, "its type or its count is not possible");
    accessor->count = (uint32_t)count;
    if (gltf_json_has(item, "bufferView")) {
        accessor->data = elements(reader, item, count, size, &accessor->stride);
        if (accessor->data == NULL)
            return false;
    }
    return open_sparse(reader, accessor);
}

/* --- What it says ------------------------------------------------------------------------- */

static uint32_t whole(const unsigned char *bytes, uint32_t type)
{
    uint32_t value = bytes[0];
    for (size_t i = 1; i < number_size(type); i++)
        value |= (uint32_t)bytes[i] << (8 * i);
    return value;
}

static float number(const unsigned char *bytes, uint32_t type, bool normalized)
{
    uint32_t bits = whole(bytes, type);
    float value, most;
    switch (type) {
    case BYTE:
        value = (int8_t)bits;
        most = 127;
        break;
    case UBYTE:
        value = (float)bits;
        most = 255;
        break;
    case SHORT:
        value = (int16_t)bits;
        most = 32767;
        break;
    case USHORT:
        value = (float)bits;
        most = 65535;
        break;
    case UINT:
        return (float)bits;
    default:
        memcpy(&value, &bits, sizeof(value));
        return value;
    }
    return !normalized ? value : value < -most ? -1 : value / most;
}

static bool copy(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                 const unsigned char *bytes, uint32_t element, float *out)
{
    size_t size = number_size(accessor->type);
    for (uint32_t c = 0; c < accessor->components; c++) {
        out[c] = number(bytes + c * size, accessor->type, accessor->normalized);
        if (!isfinite(out[c]))
            return gltf_report_error(reader, accessor->item.where, "element %u is %g", element,
                                     out[c]);
    }
    return true;
}

static bool sparse_index(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                         uint32_t i, uint32_t *index)
{
    *index = whole(accessor->sparse_indices + i * number_size(accessor->sparse_type),
                   accessor->sparse_type);
    return *index < accessor->count ||
           gltf_report_error(reader, accessor->item.where, "sparse index %u of %u elements", *index,
                             accessor->count);
}

bool gltf_accessors_floats(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                           float *out)
{
    size_t components = accessor->components;
    if (accessor->data == NULL)
        memset(out, 0, accessor->count * components * sizeof(float));
    for (uint32_t i = 0; accessor->data != NULL && i < accessor->count; i++)
        if (!copy(reader, accessor, accessor->data + i * accessor->stride, i, out + i * components))
            return false;
    const unsigned char *value = accessor->sparse_values;
    for (uint32_t i = 0, index; i < accessor->sparse_count; i++) {
        if (!sparse_index(reader, accessor, i, &index) ||
            !copy(reader, accessor, value, index, out + index * components))
            return false;
        value += number_size(accessor->type) * components;
    }
    return true;
}

bool gltf_accessors_indices(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                            uint32_t *out)
{
    if (accessor->components != 1 || !is_index(accessor->type))
        return gltf_report_error(reader, accessor->item.where, "these are no indices");
    for (uint32_t i = 0; i < accessor->count; i++)
        out[i] = accessor->data == NULL
                     ? 0
                     : whole(accessor->data + i * accessor->stride, accessor->type);
    size_t size = number_size(accessor->type);
    for (uint32_t i = 0, index; i < accessor->sparse_count; i++) {
        if (!sparse_index(reader, accessor, i, &index))
            return false;
        out[index] = whole(accessor->sparse_values + i * size, accessor->type);
    }
    return true;
}
