/*
 * A scene in the making: readers add what they find, in the file's own coordinates; finishing it
 * finds the bounds in double, moves everything next to the origin, and only then rounds to float32.
 *
 * The origin moves to a point near the middle of the bounds whose coordinates are multiples of a
 * power of two of about the scene's size: coordinates keep their bits (but for what leading digits
 * free), and a scene that lies around the origin is not moved at all.
 */
#ifndef MASTER_SCENE_BUILD_H
#define MASTER_SCENE_BUILD_H

#include "common/scene.h"
#include "master/ply.h"
#include "master/scene_lights.h"
#include "master/source_pos.h"
#include "master/transform.h"

struct err;

/* How a shape stands in the world. */
struct build_place {
    struct transform to_world;
    bool reverse_orientation;
    uint32_t material; /* index into `materials` below, or SCENE_NONE */
    uint32_t emitter;  /* index into `emitters`, or SCENE_NONE */
    uint32_t alpha;    /* 1 + index into `textures`, or 0 */
    struct source_pos pos;
};

/* Lights without a surface, with their place in double; the constant sky is in the settings. */
struct build_light {
    struct light light; /* kind, radiance, direction, falloff, environment */
    double position[3];
};

struct build_mesh {
    struct build_place place;
    struct ply_added range;
    size_t first_normal, first_uv;
    double *wide; /* 3 per vertex, when float32 does not hold the file's numbers */
};

struct build_quadric {
    struct build_place place;
    struct quadric quadric; /* kind, radius, ranges; in object space */
    double height;          /* disk: its z in object space */
};

/* Where a texture of points (any mapping but MAPPING_UV) has its points: its map before rounding,
 * in the file's coordinates. */
struct build_texture_space {
    uint32_t texture; /* index */
    double map[12];
};

/* What finishing a scene came across. */
struct build_counts {
    uint64_t degenerate_triangles; /* dropped: no area in float32 */
    uint64_t rewound_triangles;    /* whose vertex normals were on the other side */
};

struct scene_build {
    struct scene *scene; /* its settings, but for centre and bounds, are the reader's */
    struct transform world_from_camera;
    struct ply_target vertices;    /* where meshes are appended */
    struct growing meshes;         /* struct build_mesh */
    struct growing quadrics;       /* struct build_quadric */
    struct growing materials;      /* struct material: indices are final */
    struct growing coat_tables;    /* COAT_TABLE_LEN floats each */
    struct growing emitters;       /* struct emitter */
    struct growing lights;         /* struct build_light */
    struct growing textures;       /* struct texture: indices are final */
    struct growing texture_spaces; /* struct build_texture_space */
    struct growing pictures;       /* struct scene_picture, added by scene_pictures.h */
    struct growing texels;         /* TEXEL_BLOCK bytes each */
    struct growing environments;   /* struct environment, but for the light that each belongs to */
};

/* NULL when memory runs out. scene_build_free(NULL) does nothing. */
struct scene_build *scene_build_new(void);
void scene_build_free(struct scene_build *build);

/* Add the mesh that was just appended to `vertices`; takes over its wide positions. */
bool scene_build_add_mesh(struct scene_build *build, const struct build_place *place,
                          const struct ply_added *added, struct err *err);

/* The finished, checked scene, the caller's to free; the build is empty then. NULL on failure. */
struct scene *scene_build_finish(struct scene_build *build, struct build_counts *counts,
                                 struct err *err);

#endif
