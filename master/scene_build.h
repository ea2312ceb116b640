/*
 * A scene in the making: readers add what they find, in the file's own coordinates; finishing it
 * finds the bounds in double, moves everything next to the origin, and only then rounds to float32.
 *
 * The origin moves to a point near the middle of the bounds whose coordinates are multiples of a
 * power of two of about the scene's size: coordinates keep their bits (but for what leading digits
 * free), and a scene that lies around the origin is not moved at all.
 *
 * Shapes that stand in several places are added once, between group_begin and group_end, and then
 * placed by add_instance. Their to_world leads into the group's space, and the instance's from
 * there into the world. Groups do not contain instances. Finishing may do better than it was told:
 * a group with one place that does not move becomes part of the world, and what emits is copied
 * into the world for every instance, so that light sampling knows every light there is; the rest
 * of the group stays shared. What emits cannot move (ERR_UNSUPPORTED).
 */
#ifndef MASTER_SCENE_BUILD_H
#define MASTER_SCENE_BUILD_H

#include "common/scene.h"
#include "master/ply.h"
#include "master/scene_lights.h"
#include "master/source_pos.h"
#include "master/transform.h"

struct err;
struct scene_bounds;

/* How a shape stands in the world. */
struct build_place {
    struct transform to_world;
    bool reverse_orientation;
    uint32_t material;        /* index into `materials` below, or SCENE_NONE */
    uint32_t emitter;         /* index into `emitters`, or SCENE_NONE */
    uint32_t alpha;           /* 1 + index into `textures`, or 0 */
    uint32_t inside, outside; /* 1 + index into `media`, or 0 */
    bool joins; /* may be one mesh with the one before, if that stands alike and may, too */
    struct source_pos pos;
};

/* Lights without a surface, with their place in double; the constant sky is in the settings. */
struct build_light {
    struct light light; /* kind, radiance, direction, falloff, environment */
    double position[3];
    bool has_portal; /* a sky: it shines through this rectangle alone, whose corners go around */
    double portal[4][3]; /* counter-clockwise, seen from where it shines */
};

struct build_mesh {
    struct build_place place;
    struct ply_added range;
    size_t first_normal, first_uv, first_color;
    double *wide;   /* 3 per vertex, when float32 does not hold the file's numbers */
    uint32_t group; /* or 0: stands in the world itself */
};

struct build_quadric {
    struct build_place place;
    struct quadric quadric; /* kind, radius, ranges; in object space */
    double height;          /* disk: its z in object space */
    uint32_t group;         /* as in struct build_mesh */
};

/* Where a group stands. */
struct build_instance {
    double to_world[3][4];
    uint32_t group;
    uint32_t end; /* 1 + index into `ends`: where it moves to; or 0 */
    struct source_pos pos;
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
    struct growing media;          /* struct medium */
    struct growing environments;   /* struct environment, but for the light that each belongs to */
    struct growing instances;      /* struct build_instance */
    struct growing ends;           /* struct transform: what moves comes here */
    struct growing group_names;    /* struct scene_name */
    uint32_t group_count, open_group; /* groups are numbered from 1; 0 is the world */

    /* The camera moves from world_from_camera to here */
    bool camera_moves;
    struct transform world_from_camera_end;
    struct source_pos camera_pos;

    /* scene_groups': what finishing makes of these */
    struct scene_bounds *boxes; /* of the groups, from 1 on, in their own space */
    struct growing centers;     /* 3 doubles per group: its new origin */
    struct growing groups;      /* struct group */
    struct growing placed;      /* struct instance */
    struct growing motions;     /* struct motion */
};

/* NULL when memory runs out. scene_build_free(NULL) does nothing. */
struct scene_build *scene_build_new(void);
void scene_build_free(struct scene_build *build);

/* Add the mesh that was just appended to `vertices`; takes over its wide positions. */
bool scene_build_add_mesh(struct scene_build *build, const struct build_place *place,
                          const struct ply_added *added, struct err *err);

bool scene_build_add_quadric(struct scene_build *build, const struct build_quadric *quadric,
                             struct err *err);

/* Shapes added from here to the end form a group, which is seen through its instances alone. The
 * file's name for it, if any, is given while it is open. */
void scene_build_group_begin(struct scene_build *build);
bool scene_build_group_name(struct scene_build *build, const char *name, size_t length,
                            struct err *err);
void scene_build_group_end(struct scene_build *build, uint32_t *group);

/* Place a group that was ended; or one that moves while the shutter is open, `end` NULL if not. */
bool scene_build_add_instance(struct scene_build *build, uint32_t group,
                              const struct transform *to_world, const struct source_pos *pos,
                              struct err *err);
bool scene_build_add_moving(struct scene_build *build, uint32_t group,
                            const struct transform *start, const struct transform *end,
                            const struct source_pos *pos, struct err *err);

/* The finished, checked scene, the caller's to free; the build is empty then. NULL on failure. */
struct scene *scene_build_finish(struct scene_build *build, struct build_counts *counts,
                                 struct err *err);

#endif
