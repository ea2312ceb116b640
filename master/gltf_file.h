/*
 * The file as bytes: JSON or GLB, its buffers, data: URIs and the files that it names. Part of the
 * glTF reader.
 *
 * Whatever is handed out lies inside of what was read; it stays until gltf_file_free.
 */
#ifndef MASTER_GLTF_FILE_H
#define MASTER_GLTF_FILE_H

#include "master/gltf_json.h"
#include "master/growing.h"

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct gltf_bytes {
    const unsigned char *data;
    size_t size;
};

struct gltf_file {
    json_t *json;
    unsigned char *content;  /* of the whole file, when it was ours to read */
    char *folder;            /* with its slash; NULL: files may not be named */
    struct gltf_bytes chunk; /* of a GLB */
    struct growing buffers;  /* struct gltf_buffer, as many as the file lists */
    uint64_t allowance;      /* bytes that geometry may take: it follows what was read */
    uint64_t spent;          /* and what it took */
};

/* Read `path`, or take bytes that stay, and parse. `name` may be NULL. */
bool gltf_file_open(struct gltf_reader *reader, const char *path);
bool gltf_file_open_bytes(struct gltf_reader *reader, const void *bytes, size_t size,
                          const char *name);
void gltf_file_free(struct gltf_file *file);

/* The bytes of bufferViews[index]; *stride is 0 when it has none. */
bool gltf_file_view(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from,
                    struct gltf_bytes *bytes, size_t *stride);

/* Is this URI data itself? Then the bytes, malloc'ed: the caller's. NULL when it is damaged. */
bool gltf_file_is_data(const char *uri);
unsigned char *gltf_file_data(struct gltf_reader *reader, const char *uri, const char *where,
                              size_t *size);

/* Else the path of the file that it names: relative, regular and there. The caller's to free; NULL
 * after an error. */
char *gltf_file_path(struct gltf_reader *reader, const char *uri, const char *where);

/* Take so much of the allowance; an error when that is more than is left. */
bool gltf_file_spend(struct gltf_reader *reader, uint64_t count, size_t size, const char *where);

#endif
