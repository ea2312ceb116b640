/*
 * PLY meshes: ascii, binary of both byte orders, each possibly gzip-compressed (recognised by
 * content). Triangles, and polygons cut into fans; positions, normals and texture coordinates
 * (u v, s t, texture_u texture_v, texture_s texture_t); everything else is skipped.
 *
 * The file is streamed through a small buffer, so that memory goes to the mesh alone. Sizes that a
 * header claims are checked against the file before anything is allocated; in a compressed file
 * the arrays grow as data really arrives. Errors name the file and, as far as there is one, the
 * line, vertex or face.
 */
#ifndef MASTER_PLY_H
#define MASTER_PLY_H

#include "master/growing.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

/* Where a mesh goes: all arrays are appended to. Zeros are a good start. */
struct ply_target {
    struct growing positions; /* 3 floats each */
    struct growing normals;   /* 3 floats each */
    struct growing uvs;       /* 2 floats each */
    struct growing colors;    /* 4 floats each; glTF only */
    struct growing triangles; /* 3 uint32_t each: index in `positions` */
    struct growing wide;      /* 3 doubles each, when the file's positions are doubles */
};

/* What one call added. */
struct ply_added {
    uint32_t first_vertex, vertex_count;
    uint32_t first_triangle, triangle_count;
    bool has_normals, has_uvs, has_colors, has_wide;
    uint64_t flat_faces; /* faces of fewer than three corners, left out */
};

/* On failure the target may hold part of the mesh. */
bool ply_read(const char *path, struct ply_target *target, struct ply_added *added,
              struct err *err);

/* The same from memory; `name` is for errors. */
bool ply_read_bytes(const void *bytes, size_t size, const char *name, struct ply_target *target,
                    struct ply_added *added, struct err *err);

#endif
