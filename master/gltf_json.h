/*
 * Values of the file's JSON, checked as they are read. Part of the glTF reader.
 *
 * An item is one object of the file with its place, for errors. Getters of an item without JSON
 * (an object that is not there) return what stands for an absent member. One that meets the wrong
 * type or a number out of range reports it, which sets reader->failed, and returns the same.
 */
#ifndef MASTER_GLTF_JSON_H
#define MASTER_GLTF_JSON_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct gltf_reader;

struct gltf_item {
    const json_t *json; /* an object, or NULL when there is none */
    char where[160];
};

/* The file itself */
struct gltf_item gltf_json_root(const struct gltf_reader *reader);

/* Length of the file's list "nodes", "meshes", ... */
size_t gltf_json_count(const struct gltf_reader *reader, const char *list);

/* An object of such a list; when there is none, an error at the place that refers to it. */
bool gltf_json_find(struct gltf_reader *reader, const char *list, size_t index,
                    const struct gltf_item *from, struct gltf_item *found);

/* A member that is an object; a list in an item, and an object of it. */
struct gltf_item gltf_json_child(struct gltf_reader *reader, const struct gltf_item *item,
                                 const char *name);
struct gltf_item gltf_json_extension(struct gltf_reader *reader, const struct gltf_item *item,
                                     const char *name);
const json_t *gltf_json_list(struct gltf_reader *reader, const struct gltf_item *item,
                             const char *name);
struct gltf_item gltf_json_entry(struct gltf_reader *reader, const struct gltf_item *item,
                                 const char *name, size_t index);

bool gltf_json_has(const struct gltf_item *item, const char *name);
bool gltf_json_bool(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                    bool otherwise);
double gltf_json_number(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        double otherwise, double low, double high);
uint64_t gltf_json_size(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                        uint64_t otherwise);
/* An index, or SCENE_NONE when absent. */
uint32_t gltf_json_index(struct gltf_reader *reader, const struct gltf_item *item,
                         const char *name);
/* A text, or NULL when absent. */
const char *gltf_json_text(struct gltf_reader *reader, const struct gltf_item *item,
                           const char *name);
/* `count` numbers, untouched when absent: then false. */
bool gltf_json_numbers(struct gltf_reader *reader, const struct gltf_item *item, const char *name,
                       double low, double high, double *numbers, size_t count);

/* An entry of a list as an index; SCENE_NONE when it is none. */
uint32_t gltf_json_list_index(const json_t *list, size_t at);

#endif
