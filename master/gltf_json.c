#include "master/gltf_json.h"

#include "master/gltf_reader.h"

#include <math.h>
#include <stdio.h>

#define EXACT 9007199254740992.0 /* 2^53 */

/* "place.name", or "name[index]"; a place too long for its text ends early, which harms nobody */
static void extend(struct gltf_item *item, const char *parent, const char *name, long long index)
{
    char at[32] = "";
    if (index >= 0)
        snprintf(at, sizeof(at), "[%lld]", index);
    int length = snprintf(item->where, sizeof(item->where), "%.80s%s%.40s%s", parent,
                          parent[0] == '\0' ? "" : ".", name, at);
    if (length < 0)
        item->where[0] = '\0';
}

struct gltf_item gltf_json_root(const struct gltf_reader *reader)
{
    return (struct gltf_item){ .json = reader->file.json };
}

size_t gltf_json_count(const struct gltf_reader *reader, const char *list)
{
    return json_array_size(json_object_get(reader->file.json, list));
}

bool gltf_json_find(struct gltf_reader *reader, const char *list, size_t index,
                    const struct gltf_item *from, struct gltf_item *found)
{
    found->json = json_array_get(json_object_get(reader->file.json, list), index);
    extend(found, "", list, (long long)index);
    if (json_is_object(found->json))
        return true;
    return gltf_report_error(reader, from->where, "there is no %s", found->where);
}

struct gltf_item gltf_json_child(struct gltf_reader *reader, const struct gltf_item *item,
                                 const char *name)
{
    struct gltf_item child = { .json = json_object_get(item->json, name) };
    extend(&child, item->where, name, -1);
    if (child.json != NULL && !json_is_object(child.json)) {
        gltf_report_error(reader, child.where, "this is not an object");
        child.json = NULL;
    }
    return child;
}

struct gltf_item gltf_json_extension(struct gltf_reader *reader, const struct gltf_item *item,
                                     const char *name)
{
    struct gltf_item extensions = gltf_json_child(reader, item, "extensions");
    struct gltf_item extension = gltf_json_child(reader, &extensions, name);
    extend(&extension, item->where, name, -1);
    return extension;
}

const json_t *gltf_json_list(struct gltf_reader *reader, const struct gltf_item *item,
                             const char *name)
{
    const json_t *list = json_object_get(item->json, name);
    if (list == NULL || json_is_array(list))
        return list;
    gltf_report_error(reader, item->where, "\"%s\" is not a list", name);
    return NULL;
}

struct gltf_item gltf_json_entry(struct gltf_reader *reader, const struct gltf_item *item,
                                 const char *name, size_t index)
{
    struct gltf_item entry = { .json = json_array_get(json_object_get(item->json, name), index) };
    extend(&entry, item->where, name, (long long)index);
    if (!json_is_object(entry.json)) {
        gltf_report_error(reader, entry.where, "this is not an object");
        entry.json = NULL;
    }
    return entry;
}

bool gltf_json_has(const struct gltf_item *item, const char *name)
{
    return json_object_get(item->json, name) != NULL;
}

bool gltf_json_bool(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                    bool otherwise)
{
    const json_t *value = json_object_get(item->json, name);
    if (value == NULL)
        return otherwise;
    if (!json_is_boolean(value))
        gltf_report_error(reader, item->where, "\"%s\" is neither true nor false", name);
    return json_is_true(value);
}

static double number_of(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        const json_t *value, double otherwise, double low, double high)
{
    double number = json_number_value(value);
    if (json_is_number(value) && number >= low && number <= high)
        return number;
    if (json_is_number(value))
        gltf_report_error(reader, item->where, "\"%s\" is %g; %g to %g is possible", name, number,
                          low, high);
    else
        gltf_report_error(reader, item->where, "\"%s\" is not a number", name);
    return otherwise;
}

double gltf_json_number(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        double otherwise, double low, double high)
{
    const json_t *value = json_object_get(item->json, name);
    return value == NULL ? otherwise : number_of(reader, item, name, value, otherwise, low, high);
}

/* A whole number, also one that was written as 3.0 */
static bool whole(const json_t *value, uint64_t *number)
{
    double real = json_number_value(value);
    if (!json_is_number(value) || !(real >= 0 && real < EXACT) || real != floor(real))
        return false;
    *number = (uint64_t)real;
    return true;
}

uint64_t gltf_json_size(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        uint64_t otherwise)
{
    const json_t *value = json_object_get(item->json, name);
    uint64_t size = otherwise;
    if (value != NULL && !whole(value, &size))
        gltf_report_error(reader, item->where, "\"%s\" is not a whole number", name);
    return size;
}

uint32_t gltf_json_index(struct gltf_reader *reader, const struct gltf_item *item, const char *name)
{
    uint64_t index = gltf_json_size(reader, item, name, SCENE_NONE);
    if (index > SCENE_NONE)
        gltf_report_error(reader, item->where, "\"%s\" is far too large", name);
    return index > SCENE_NONE ? SCENE_NONE : (uint32_t)index;
}

uint32_t gltf_json_list_index(const json_t *list, size_t at)
{
    uint64_t index;
    return whole(json_array_get(list, at), &index) && index < SCENE_NONE ? (uint32_t)index
                                                                         : SCENE_NONE;
}

const char *gltf_json_text(struct gltf_reader *reader, const struct gltf_item *item,
                           const char *name)
{
    const json_t *value = json_object_get(item->json, name);
    if (value != NULL && !json_is_string(value))
        gltf_report_error(reader, item->where, "\"%s\" is not a text", name);
    return json_string_value(value);
}

bool gltf_json_numbers(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                       double low, double high, double *numbers, size_t count)
{
    const json_t *list = gltf_json_list(reader, item, name);
    if (list == NULL)
        return false;
    if (json_array_size(list) != count) {
        gltf_report_error(reader, item->where, "\"%s\" has %zu numbers and should have %zu", name,
                          json_array_size(list), count);
        return false;
    }
    for (size_t i = 0; i < count; i++)
        numbers[i] = number_of(reader, item, name, json_array_get(list, i), numbers[i], low, high);
    return true;
}
