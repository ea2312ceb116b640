/*
 * The pbrt reader's inside: its state, and what its files offer each other. Functions that return
 * false have set the reader's err. Nothing outside master/pbrt*.c includes this.
 */
#ifndef MASTER_PBRT_READER_H
#define MASTER_PBRT_READER_H

#include "common/err.h"
#include "common/scene.h"
#include "master/growing.h"
#include "master/pbrt_lexer.h"
#include "master/pbrt_names.h"
#include "master/pbrt_params.h"
#include "master/scene_build.h"
#include "master/transform.h"

/* Targets of Attribute that have parameters we read */
enum pbrt_target {
    TARGET_SHAPE,
    TARGET_LIGHT,
    TARGET_MATERIAL,
    TARGET_MEDIUM,
    TARGET_TEXTURE,
    TARGETS
};

/* What AttributeBegin saves */
struct pbrt_state {
    struct transform ctm;
    bool reverse_orientation;
    bool only_end_time; /* ActiveTransform EndTime: no effect on what does not move */
    uint32_t material;  /* index of a definition */
    uint32_t emitter;   /* index of an area light, or SCENE_NONE */
    struct {
        size_t items, numbers, strings;
    } defaults[TARGETS];
};

/* A material as written. It joins the scene when a shape uses it, so that what is not used calls
 * for no effect. */
struct pbrt_material {
    struct material material;
    double coat_thickness;
    uint32_t mixes[2]; /* index in `mix_names`, for MATERIAL_MIX */
    uint32_t in_scene; /* index among the scene's materials, or SCENE_NONE */
    bool busy;         /* being resolved: a mix that meets itself */
    struct source_pos pos;
};

struct pbrt_material_name {
    const char *text;
    size_t length;
    uint32_t definition;
};

/* What the camera is made of; put together when the film is known */
struct pbrt_view {
    enum camera_kind kind;
    struct transform world_from_camera;
    double fov;    /* radians */
    double aspect; /* 0: the film's */
    bool has_screen;
    double screen[4];
    double lens_radius, focal_distance;
    uint32_t width, height;
    double crop[4];
    bool has_pixel_bounds;
    int64_t pixel_bounds[4];
};

struct pbrt_note {
    char *text;
    struct source_pos pos;
    uint64_t count;
};

struct pbrt_reader {
    struct pbrt_lexer *lexer;
    struct err *err;
    bool lenient;
    struct growing notes; /* struct pbrt_note */
    uint64_t warnings;

    struct scene_build *build;
    struct pbrt_view view;
    bool in_world;
    struct transform camera_space; /* the coordinate system "camera": world from camera */
    struct growing systems;        /* struct pbrt_system: CoordinateSystem */

    struct pbrt_state state;
    struct growing stack;   /* struct pbrt_frame: AttributeBegin */
    struct growing objects; /* struct source_pos: ObjectBegin, when lenient */

    struct pbrt_params params; /* of the current directive */
    struct pbrt_params defaults[TARGETS];

    struct growing materials;      /* struct pbrt_material */
    struct growing material_names; /* struct pbrt_material_name */
    struct growing mix_names;      /* struct pbrt_token: what mixes refer to */
    struct growing coats;          /* struct pbrt_coat: tables computed already */
};

/* pbrt.c: err_set with the position in front; always false. */
bool pbrt_fail(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
/* Something pbrt has and we do not: false and ERR_UNSUPPORTED, or true and a counted note. The
 * text continues "... is not supported yet". */
bool pbrt_later(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
void pbrt_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
bool pbrt_no_memory(struct pbrt_reader *reader);

/* Look a name up and report what is wrong with it. False: an error. True and *found NULL: known to
 * pbrt, not to us, and we are lenient. `kind` is "material", "shape", ... */
bool pbrt_name(struct pbrt_reader *reader, const char *kind, const struct pbrt_name *names,
               size_t count, const struct pbrt_token *token, const struct pbrt_name **found);

/* pbrt_color.c: the parameter as linear sRGB. False when it is absent (or failed). */
enum pbrt_color_kind { COLOR_REFLECTANCE, COLOR_LIGHT, COLOR_INDEX };
bool pbrt_color(struct pbrt_params *params, const char *name, enum pbrt_color_kind kind,
                double rgb[3]);

/* pbrt_view.c: each reads its directive's parameters; `type` is the quoted name. */
void pbrt_view_defaults(struct pbrt_view *view);
bool pbrt_view_camera(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_film(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_filter(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_sampler(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_integrator(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_finish(struct pbrt_reader *reader);

/* pbrt_materials.c */
bool pbrt_materials_start(struct pbrt_reader *reader); /* the default one */
bool pbrt_materials_set(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_materials_define(struct pbrt_reader *reader, const struct pbrt_token *name);
bool pbrt_materials_use(struct pbrt_reader *reader, const struct pbrt_token *name);
bool pbrt_materials_resolve(struct pbrt_reader *reader, uint32_t *in_scene); /* the current one */

/* pbrt_lights.c, pbrt_shapes.c */
bool pbrt_lights_add(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_lights_area(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_shapes_add(struct pbrt_reader *reader, const struct pbrt_token *type);

#endif
