#include "master/pbrt_shapes.h"

#include "master/pbrt_curved.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define PI       3.14159265358979323846
#define COUNT(a) (sizeof(a) / sizeof((a)[0]))

enum {
    SHAPE_MESH,
    SHAPE_PLY,
    SHAPE_SPHERE,
    SHAPE_DISK,
    SHAPE_CYLINDER,
    SHAPE_BILINEAR,
    SHAPE_LOOP,
    SHAPE_CURVE
};

static const struct pbrt_name kinds[] = {
    { "trianglemesh", SHAPE_MESH, NAME_OURS, NULL },
    { "plymesh", SHAPE_PLY, NAME_OURS, NULL },
    { "sphere", SHAPE_SPHERE, NAME_OURS, NULL },
    { "disk", SHAPE_DISK, NAME_OURS, NULL },
    { "bilinearmesh", SHAPE_BILINEAR, NAME_OURS, NULL },
    { "curve", SHAPE_CURVE, NAME_OURS, NULL },
    { "cylinder", SHAPE_CYLINDER, NAME_OURS, NULL },
    { "loopsubdiv", SHAPE_LOOP, NAME_OURS, NULL },
    { "cone", 0, NAME_OLD, "pbrt-v4 has no such shape" },
    { "heightfield", 0, NAME_OLD, "pbrt-v4 has no such shape" },
    { "hyperboloid", 0, NAME_OLD, "pbrt-v4 has no such shape" },
    { "nurbs", 0, NAME_OLD, "pbrt-v4 has no such shape" },
    { "paraboloid", 0, NAME_OLD, "pbrt-v4 has no such shape" },
};

static bool place_here(struct pbrt_reader *reader, const struct source_pos *pos,
                       struct build_place *place)
{
    *place = (struct build_place){ .to_world = reader->state.ctm,
                                   .reverse_orientation = reader->state.reverse_orientation,
                                   .emitter = reader->state.emitter,
                                   .pos = *pos };
    if (!pbrt_materials_resolve(reader, &place->material))
        return false;
    const struct pbrt_state *state = &reader->state;
    if (state->inside != state->outside &&
        (!pbrt_media_resolve(reader, state->inside, &place->inside) ||
         !pbrt_media_resolve(reader, state->outside, &place->outside)))
        return false;
    if (place->material == SCENE_NONE && place->emitter != SCENE_NONE) {
        pbrt_report_note(reader, pos, "a shape that is an interface gives no light, as in pbrt");
        place->emitter = SCENE_NONE;
    }
    return true;
}

/* "alpha" cuts holes: how much of the surface is there; *none when there is nothing of it. What
 * emits with an alpha of nothing is not seen, and lights as if it were there, as in pbrt. */
static bool read_alpha(struct pbrt_reader *reader, struct build_place *place, bool *none)
{
    struct pbrt_params *params = &reader->params;
    place->alpha = pbrt_textures_take(params, "alpha", false);
    double alpha = pbrt_params_float(params, "alpha", 1);
    *none = !(alpha > 0);
    if (params->failed)
        return false;
    if (place->alpha == 0 && alpha >= 1)
        return true;
    if (*none) {
        *none = place->emitter == SCENE_NONE;
        place->material = SCENE_NONE;
        place->inside = place->outside;
        return true;
    }
    return place->alpha != 0 ? pbrt_textures_resolve(reader, &place->alpha)
                             : pbrt_textures_resolve_number(reader, alpha, &place->alpha);
}

/* --- Meshes ------------------------------------------------------------------------------- */

static bool note_flat_faces(struct pbrt_reader *reader, const struct source_pos *pos,
                            const struct ply_added *added)
{
    if (added->flat_faces > 0)
        pbrt_report_note(reader, pos, "%llu faces of fewer than three corners were left out",
                         (unsigned long long)added->flat_faces);
    return true;
}

static bool add_ply(struct pbrt_reader *reader, const struct build_place *place)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_token *filename = pbrt_params_string(params, "filename");
    pbrt_params_later(params, "displacement");
    pbrt_params_ignore(params, "edgelength");
    if (filename == NULL && !params->failed)
        pbrt_params_fail(params, NULL, "a plymesh wants \"string filename\"");
    if (!pbrt_params_done(params))
        return false;
    const char *path = pbrt_lexer_resolve(reader->lexer, filename);
    if (path == NULL)
        return pbrt_report_error(reader, &filename->pos, "no file can be read from here");
    struct ply_added added;
    if (!ply_read(path, &reader->build->vertices, &added, reader->err))
        return err_wrap(reader->err, "%s:%d:%d", filename->pos.path, filename->pos.line,
                        filename->pos.column);
    return scene_build_add_mesh(reader->build, place, &added, reader->err) &&
           note_flat_faces(reader, &place->pos, &added);
}

static void fail_count(struct pbrt_params *params, const char *name, size_t count, size_t vertices)
{
    pbrt_params_fail(params, pbrt_params_find(params, name),
                     "\"%s\" has %zu entries for %zu vertices", name, count, vertices);
}

/* Round doubles into the mesh's float32 array; every one must be finite afterwards */
static bool append_floats(struct growing *array, size_t groups, size_t size, const double *values,
                          bool *finite)
{
    float *out = growing_add(array, groups, size * sizeof(float));
    if (out == NULL)
        return false;
    for (size_t i = 0; i < groups * size; i++) {
        out[i] = (float)values[i];
        *finite = *finite && isfinite(out[i]);
    }
    return true;
}

static bool append_indices(struct pbrt_reader *reader, const double *indices, size_t count,
                           const struct ply_added *added)
{
    uint32_t *out = growing_add(&reader->build->vertices.triangles, count / 3,
                                3 * sizeof(uint32_t));
    if (out == NULL)
        return pbrt_report_no_memory(reader);
    for (size_t i = 0; i < count; i++) {
        if (!(indices[i] >= 0 && indices[i] < added->vertex_count)) {
            pbrt_params_fail(&reader->params, pbrt_params_find(&reader->params, "indices"),
                             "index %.0f (number %zu) is out of range: there are %u vertices",
                             indices[i], i, added->vertex_count);
            return false;
        }
        out[i] = added->first_vertex + (uint32_t)indices[i];
    }
    return true;
}

static bool add_mesh(struct pbrt_reader *reader, const struct build_place *place)
{
    static const double one_triangle[] = { 0, 1, 2 };
    struct pbrt_params *params = &reader->params;
    struct ply_target *target = &reader->build->vertices;
    size_t points, normals, uvs, indices;
    const double *p = pbrt_params_array(params, "P", PARAM_POINT3, &points);
    const double *n = pbrt_params_array(params, "N", PARAM_NORMAL, &normals);
    const double *uv = pbrt_params_array(params, "uv", PARAM_POINT2, &uvs);
    const double *index = pbrt_params_array(params, "indices", PARAM_INTEGER, &indices);
    size_t ignored;
    pbrt_params_array(params, "S", PARAM_POINT3, &ignored); /* tangents: nothing uses them yet */
    pbrt_params_ignore(params, "faceIndices");
    if (p == NULL)
        pbrt_params_fail(params, NULL, "a trianglemesh wants \"point3 P\"");
    if (!params->failed && index == NULL && points == 3) {
        index = one_triangle;
        indices = 3;
    }
    if (index == NULL)
        pbrt_params_fail(params, NULL, "a trianglemesh wants \"integer indices\"");
    if (indices % 3 != 0)
        pbrt_params_fail(params, pbrt_params_find(params, "indices"),
                         "%zu indices are not a multiple of three", indices);
    if (n != NULL && normals != points)
        fail_count(params, "N", normals, points);
    if (uv != NULL && uvs != points)
        fail_count(params, "uv", uvs, points);
    if (!pbrt_params_done(params))
        return false;
    if (target->positions.count + points > UINT32_MAX - 1 ||
        target->triangles.count + indices / 3 > UINT32_MAX / 3)
        return pbrt_report_error(reader, &place->pos,
                                 "the scene has too many vertices or triangles");

    struct ply_added added = { .first_vertex = (uint32_t)target->positions.count,
                               .vertex_count = (uint32_t)points,
                               .first_triangle = (uint32_t)target->triangles.count,
                               .triangle_count = (uint32_t)(indices / 3),
                               .has_normals = n != NULL,
                               .has_uvs = uv != NULL,
                               .has_wide = true };
    bool finite = true;
    double *wide = growing_add(&target->wide, points, 3 * sizeof(double));
    if (wide == NULL || !append_floats(&target->positions, points, 3, p, &finite) ||
        (n != NULL && !append_floats(&target->normals, points, 3, n, &finite)) ||
        (uv != NULL && !append_floats(&target->uvs, points, 2, uv, &finite)))
        return pbrt_report_no_memory(reader);
    memcpy(wide, p, points * 3 * sizeof(double));
    if (!finite)
        return pbrt_report_error(reader, &place->pos, "a number of the mesh is beyond float32");
    return append_indices(reader, index, indices, &added) &&
           scene_build_add_mesh(reader->build, place, &added, reader->err);
}

/* --- Spheres and disks -------------------------------------------------------------------- */

static double clamp(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

static bool add_quadric(struct pbrt_reader *reader, const struct build_place *place, bool sphere)
{
    struct pbrt_params *params = &reader->params;
    struct build_quadric built = { .place = *place };
    struct quadric *quadric = &built.quadric;
    double radius = pbrt_params_float(params, "radius", 1), inner = 0;
    double z_min = 0, z_max = 0, phi = pbrt_params_float(params, "phimax", 360);
    if (sphere) {
        double a = pbrt_params_float(params, "zmin", -radius);
        double b = pbrt_params_float(params, "zmax", radius);
        z_min = clamp(fmin(a, b), -radius, radius);
        z_max = clamp(fmax(a, b), -radius, radius);
    } else {
        built.height = pbrt_params_float(params, "height", 0);
        inner = pbrt_params_float(params, "innerradius", 0);
    }
    if (!((float)radius > 0 && radius < 1e18) || !(phi > 0) || !(inner >= 0 && inner < radius) ||
        (sphere && !(z_min < z_max)))
        pbrt_params_fail(params, NULL, "this shape has no area: radius %g, phimax %g", radius, phi);
    if (!pbrt_params_done(params))
        return false;
    phi = fmin(phi, 360);
    quadric->kind = sphere ? QUADRIC_SPHERE : QUADRIC_DISK;
    quadric->radius = (float)radius;
    quadric->inner_radius = (float)inner;
    quadric->z_min = (float)z_min;
    quadric->z_max = (float)z_max;
    quadric->phi_max = (float)(phi * (PI / 180));
    if (phi < 360 || inner > 0 || (sphere && (z_min > -radius || z_max < radius)))
        quadric->flags |= QUADRIC_PARTIAL;
    bool whole = !(quadric->flags & QUADRIC_PARTIAL) && transform_similarity(&place->to_world) > 0;
    if (place->emitter != SCENE_NONE && !whole) {
        pbrt_report_note(reader, &place->pos,
                         "a %s that emits and is cut or stretched is made of triangles",
                         sphere ? "sphere" : "disk");
        return pbrt_curved_quadric(reader, &built);
    }
    return scene_build_add_quadric(reader->build, &built, reader->err);
}

/* --- All of them -------------------------------------------------------------------------- */

static bool add_shape(struct pbrt_reader *reader, const struct pbrt_name *kind,
                      const struct build_place *place)
{
    switch (kind->value) {
    case SHAPE_MESH:
        return add_mesh(reader, place);
    case SHAPE_PLY:
        return add_ply(reader, place);
    case SHAPE_CYLINDER:
        return pbrt_curved_cylinder(reader, place);
    case SHAPE_BILINEAR:
        return pbrt_curved_bilinear(reader, place);
    case SHAPE_LOOP:
        return pbrt_curved_loop(reader, place);
    case SHAPE_CURVE:
        return pbrt_curved_curve(reader, place);
    default:
        return add_quadric(reader, place, kind->value == SHAPE_SPHERE);
    }
}

/* A group of one shape, in the shape's own space, with an instance that moves */
static bool add_moving(struct pbrt_reader *reader, const struct pbrt_name *kind,
                       struct build_place *place)
{
    uint32_t group;
    if (pbrt_objects_inside(&reader->objects))
        return pbrt_report_later(reader, &place->pos, "motion inside of an object") &&
               add_shape(reader, kind, place);
    if (place->emitter != SCENE_NONE &&
        !pbrt_report_later(reader, &place->pos, "light from what moves"))
        return false;
    place->emitter = SCENE_NONE;
    place->to_world = transform_identity();
    scene_build_group_begin(reader->build);
    bool added = add_shape(reader, kind, place);
    scene_build_group_end(reader->build, &group);
    return added && scene_build_add_moving(reader->build, group, &reader->state.ctm,
                                           &reader->state.ctm_end, &place->pos, reader->err);
}

bool pbrt_shapes_add(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "shape", kinds, COUNT(kinds), type, &found))
        return false;
    if (found == NULL)
        return true; /* lenient, and noted already */
    struct build_place place;
    if (!place_here(reader, &type->pos, &place))
        return false;
    bool none;
    if (!read_alpha(reader, &place, &none))
        return false;
    if (none)
        return true;
    return pbrt_state_moves(&reader->state) ? add_moving(reader, found, &place)
                                            : add_shape(reader, found, &place);
}
