/*
 * For tests of the glTF reader: files made here, of a few accessors and the JSON that a test adds.
 *
 *   start_triangle();
 *   struct scene *scene = scene_of(MESH "," SHOW);
 */
#ifndef TESTS_GLTF_TEXT_H
#define TESTS_GLTF_TEXT_H

#include "master/gltf.h"
#include "tests/reader_text.h"

#include <openssl/evp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* The accessors made so far */
static struct {
    unsigned char bytes[8192];
    size_t size;
    char views[4096], accessors[8192];
    unsigned count;
} made;

static inline void start_empty(void)
{
    memset(&made, 0, sizeof(made));
}

/* An accessor of these bytes; `more` is further JSON, beginning with a comma */
static inline unsigned add_accessor(const void *bytes, size_t size, unsigned type, size_t count,
                                    const char *shape, const char *more)
{
    const char *comma = made.count > 0 ? "," : "";
    memcpy(made.bytes + made.size, bytes, size);
    size_t v = strlen(made.views), a = strlen(made.accessors);
    snprintf(made.views + v, sizeof(made.views) - v,
             "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}", comma, made.size, size);
    snprintf(made.accessors + a, sizeof(made.accessors) - a,
             "%s{\"bufferView\":%u,\"componentType\":%u,\"count\":%zu,\"type\":\"%s\"%s}", comma,
             made.count, type, count, shape, more);
    made.size += (size + 3) / 4 * 4;
    return made.count++;
}

static inline unsigned add_floats(const float *values, size_t count, unsigned components)
{
    static const char *const shapes[] = { "", "SCALAR", "VEC2", "VEC3", "VEC4" };
    return add_accessor(values, count * components * sizeof(float), 5126, count, shapes[components],
                        "");
}

static const float corner[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };

/* Accessor 0 is the triangle (0,0,0) (1,0,0) (0,1,0), as the mesh below wants it */
static inline void start_triangle(void)
{
    start_empty();
    add_floats(corner, 3, 3);
}

/* The mesh of accessor 0, a node that shows it, and the whole with a light beside it */
#define MESH "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]"
#define SHOW "\"nodes\":[{\"mesh\":0}]"
#define LIGHT_NODE                                                        \
    ",{\"translation\":[1,2,3],\"rotation\":[0,0.70710678,0,0.70710678]," \
    "\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}"
#define WITH_LIGHT(text)                                            \
    MESH ",\"nodes\":[{\"mesh\":0}" LIGHT_NODE "],\"extensions\":{" \
         "\"KHR_lights_punctual\":{\"lights\":[" text "]}}"

/* The file with the accessors made so far, and the rest of it; in a buffer of its own */
static inline const char *document_of(const char *rest, const char *asset)
{
    static char text[65536], base64[16384];
    EVP_EncodeBlock((unsigned char *)base64, made.bytes, (int)made.size);
    snprintf(text, sizeof(text),
             "{\"asset\":{\"version\":\"2.0\"%s},\"buffers\":[{\"byteLength\":%zu,\"uri\":"
             "\"data:application/octet-stream;base64,%s\"}],\"bufferViews\":[%s],"
             "\"accessors\":[%s],%s}",
             asset, made.size, base64, made.views, made.accessors, rest);
    return text;
}

static inline struct scene *read_document(const char *rest, const struct gltf_options *options,
                                          struct scene_notes *notes, struct err *err)
{
    const char *text = document_of(rest, "");
    return gltf_read_bytes(text, strlen(text), NULL, options, notes, err);
}

static inline struct scene *scene_of(const char *rest)
{
    struct err err = { .text = "" };
    struct scene *scene = read_document(rest, NULL, NULL, &err);
    if (scene == NULL)
        fail_msg("%s\nin: %s", err.text, rest);
    return scene;
}

static inline void expect_note(const char *rest, const char *text)
{
    struct err err = { .text = "" };
    struct scene_notes notes;
    struct scene *scene = read_document(rest, NULL, &notes, &err);
    if (scene == NULL)
        fail_msg("%s", err.text);
    if (!notes_saying(&notes, text))
        fail_msg("no note says \"%s\"; the first is: %s", text,
                 notes.count > 0 ? notes.lines[0] : "none");
    scene_notes_free(&notes);
    scene_free(scene);
}

#endif
