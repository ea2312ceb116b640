#include "master/pbrt_curved.h"

#include "master/curve_mesh.h"
#include "master/pbrt_reader.h"
#include "master/subdivide.h"
#include "master/tessellate.h"
#include "master/vector.h"

#include <math.h>
#include <string.h>

#define PI             3.14159265358979323846
#define COUNT(a)       (sizeof(a) / sizeof((a)[0]))
#define FREE_TRIANGLES (1u << 18) /* of a whole scene, */
#define PER_BYTE       8          /* and for each byte of its text */
#define LIGHT_COSTS    2          /* of what another triangle does */
#define PATCH_SHARE    2048       /* of a mesh's size: how far from a patch triangles may be */

/* --- Into the scene ----------------------------------------------------------------------- */

static bool at(struct pbrt_reader *reader, const struct source_pos *pos)
{
    return err_wrap(reader->err, "%s:%d:%d", pos->path, pos->line, pos->column);
}

static uint64_t cost_of(const struct build_place *place)
{
    return place->emitter != SCENE_NONE ? LIGHT_COSTS : 1;
}

static uint64_t left(const struct pbrt_reader *reader)
{
    uint64_t most = FREE_TRIANGLES + PER_BYTE * (uint64_t)pbrt_lexer_bytes(reader->lexer);
    return most > reader->curved_triangles ? most - reader->curved_triangles : 0;
}

static void start(const struct pbrt_reader *reader, const struct build_place *place,
                  struct tessellation *shape)
{
    *shape = (struct tessellation){ .most = left(reader) / cost_of(place) };
}

bool pbrt_curved_instance(struct pbrt_reader *reader, uint64_t lights, const struct source_pos *pos)
{
    if (LIGHT_COSTS * lights > left(reader))
        return pbrt_report_error(reader, pos,
                                 "the lights of this object take %llu triangles: %llu are possible "
                                 "here",
                                 (unsigned long long)lights,
                                 (unsigned long long)left(reader) / LIGHT_COSTS);
    reader->curved_triangles += LIGHT_COSTS * lights;
    return true;
}

/* Round doubles to float32; false when one is beyond it */
static bool append(struct growing *to, const struct growing *from, size_t size, bool *fits)
{
    float *out = growing_add(to, from->count, size * sizeof(float));
    if (out == NULL)
        return false;
    const double *values = from->data;
    for (size_t i = 0; i < from->count * size; i++) {
        out[i] = (float)values[i];
        *fits = *fits && isfinite(out[i]);
    }
    return true;
}

static bool append_triangles(struct ply_target *to, const struct tessellation *shape,
                             uint32_t first)
{
    uint32_t *out = growing_add(&to->triangles, shape->triangles.count, 3 * sizeof(uint32_t));
    const uint32_t *in = shape->triangles.data;
    for (size_t i = 0; out != NULL && i < 3 * shape->triangles.count; i++)
        out[i] = first + in[i];
    return out != NULL;
}

/* Of all triangles in the world */
static double area_of(const struct tessellation *shape, const struct transform *to_world)
{
    const uint32_t *t = shape->triangles.data;
    double sum = 0;
    for (size_t i = 0; i < shape->triangles.count; i++, t += 3) {
        struct vec p[3];
        for (int corner = 0; corner < 3; corner++) {
            double at[3];
            transform_point(to_world, (const double *)shape->positions.data + 3 * (size_t)t[corner],
                            at);
            p[corner] = vec_at(at);
        }
        sum += vec_length(vec_cross(vec_sub(p[1], p[0]), vec_sub(p[2], p[0]))) / 2;
    }
    return sum;
}

/* A light's "power" is that of the whole shape, not of each of its triangles */
static bool share_power(struct pbrt_reader *reader, const struct tessellation *shape,
                        struct build_place *place)
{
    struct growing *emitters = &reader->build->emitters;
    if (place->emitter == SCENE_NONE ||
        !(((const struct emitter *)emitters->data)[place->emitter].power > 0))
        return true;
    struct emitter *added = growing_add(emitters, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = ((const struct emitter *)emitters->data)[place->emitter];
    added->whole_area = area_of(shape, &place->to_world);
    place->emitter = (uint32_t)emitters->count - 1;
    return true;
}

/* Make a mesh of the triangles. `wide`: keep the doubles as long as nothing is re-centred. */
static bool add(struct pbrt_reader *reader, const struct tessellation *shape, bool wide,
                const struct build_place *at_place)
{
    struct ply_target *target = &reader->build->vertices;
    struct build_place place = *at_place;
    size_t points = shape->positions.count;
    if (shape->triangles.count == 0 && place.emitter != SCENE_NONE)
        return pbrt_report_error(reader, &place.pos, "this light has no area");
    if (shape->triangles.count == 0) {
        pbrt_report_note(reader, &place.pos, "a shape without area was left out");
        return true;
    }
    if (target->positions.count + points > UINT32_MAX - 1 ||
        target->triangles.count + shape->triangles.count > UINT32_MAX / 3)
        return pbrt_report_error(reader, &place.pos,
                                 "the scene has too many vertices or triangles");
    if (!share_power(reader, shape, &place))
        return false;

    struct ply_added added = { .first_vertex = (uint32_t)target->positions.count,
                               .vertex_count = (uint32_t)points,
                               .first_triangle = (uint32_t)target->triangles.count,
                               .triangle_count = (uint32_t)shape->triangles.count,
                               .has_normals = shape->normals.count > 0,
                               .has_uvs = shape->uvs.count > 0,
                               .has_wide = wide };
    bool fits = true;
    double *doubles = wide ? growing_add(&target->wide, points, 3 * sizeof(double)) : NULL;
    if ((wide && doubles == NULL) || !append(&target->positions, &shape->positions, 3, &fits) ||
        (added.has_normals && !append(&target->normals, &shape->normals, 3, &fits)) ||
        (added.has_uvs && !append(&target->uvs, &shape->uvs, 2, &fits)) ||
        !append_triangles(target, shape, added.first_vertex))
        return pbrt_report_no_memory(reader);
    if (wide)
        memcpy(doubles, shape->positions.data, points * 3 * sizeof(double));
    if (!fits)
        return pbrt_report_error(reader, &place.pos, "a number of the shape is beyond float32");
    reader->curved_triangles += cost_of(&place) * shape->triangles.count;
    if (place.emitter != SCENE_NONE)
        reader->objects.curved_lights += shape->triangles.count;
    return scene_build_add_mesh(reader->build, &place, &added, reader->err);
}

/* --- Cylinders, spheres, disks ------------------------------------------------------------ */

bool pbrt_curved_cylinder(struct pbrt_reader *reader, const struct build_place *place)
{
    struct pbrt_params *params = &reader->params;
    double a = pbrt_params_float(params, "zmin", -1), b = pbrt_params_float(params, "zmax", 1);
    double phi = pbrt_params_float(params, "phimax", 360);
    struct tessellate_round round = { .radius = pbrt_params_float(params, "radius", 1),
                                      .phi_max = fmin(fmax(phi, 0), 360) * (PI / 180),
                                      .z_min = fmin(a, b),
                                      .z_max = fmax(a, b) };
    if (round.radius < 0)
        pbrt_params_fail(params, pbrt_params_find(params, "radius"), "a radius of %g",
                         round.radius);
    if (!pbrt_params_done(params))
        return false;
    struct tessellation shape;
    start(reader, place, &shape);
    bool area = round.radius > 0 && round.phi_max > 0 && round.z_min < round.z_max;
    bool made = (!area || tessellate_cylinder(&shape, &round, reader->err) ||
                 at(reader, &place->pos)) &&
                add(reader, &shape, true, place);
    tessellate_free(&shape);
    return made;
}

bool pbrt_curved_quadric(struct pbrt_reader *reader, const struct build_quadric *built)
{
    const struct quadric *quadric = &built->quadric;
    bool sphere = quadric->kind == QUADRIC_SPHERE;
    struct tessellate_round round = { .radius = (double)quadric->radius,
                                      .phi_max = (double)quadric->phi_max,
                                      .z_min = (double)quadric->z_min,
                                      .z_max = (double)quadric->z_max,
                                      .height = built->height,
                                      .inner_radius = (double)quadric->inner_radius };
    if (round.phi_max > 2 * PI - 1e-6)
        round.phi_max = 2 * PI; /* it was rounded to float32 */
    struct tessellation shape;
    start(reader, &built->place, &shape);
    bool made = ((sphere ? tessellate_sphere : tessellate_disk)(&shape, &round, reader->err) ||
                 at(reader, &built->place.pos)) &&
                add(reader, &shape, true, &built->place);
    tessellate_free(&shape);
    return made;
}

/* --- Bilinear patches --------------------------------------------------------------------- */

struct bilinear {
    const double *p, *n, *uv, *indices;
    size_t points, patches;
};

static void fail_count(struct pbrt_params *params, const char *name, size_t count, size_t vertices)
{
    pbrt_params_fail(params, pbrt_params_find(params, name),
                     "\"%s\" has %zu entries for %zu vertices", name, count, vertices);
}

static bool read_bilinear(struct pbrt_params *params, struct bilinear *mesh)
{
    static const double one_patch[] = { 0, 1, 2, 3 };
    size_t normals, uvs, indices;
    mesh->p = pbrt_params_array(params, "P", PARAM_POINT3, &mesh->points);
    mesh->n = pbrt_params_array(params, "N", PARAM_NORMAL, &normals);
    mesh->uv = pbrt_params_array(params, "uv", PARAM_POINT2, &uvs);
    mesh->indices = pbrt_params_array(params, "indices", PARAM_INTEGER, &indices);
    pbrt_params_ignore(params, "faceIndices");
    pbrt_params_ignore(params, "emissionfilename"); /* only says where pbrt looks for the light */
    if (mesh->p == NULL)
        pbrt_params_fail(params, NULL, "a bilinearmesh wants \"point3 P\"");
    if (!params->failed && mesh->indices == NULL && mesh->points == 4) {
        mesh->indices = one_patch;
        indices = 4;
    }
    if (mesh->indices == NULL)
        pbrt_params_fail(params, NULL, "a bilinearmesh wants \"integer indices\"");
    if (indices % 4 != 0)
        pbrt_params_fail(params, pbrt_params_find(params, "indices"),
                         "%zu indices are not a multiple of four", indices);
    if (mesh->n != NULL && normals != mesh->points)
        fail_count(params, "N", normals, mesh->points);
    if (mesh->uv != NULL && uvs != mesh->points)
        fail_count(params, "uv", uvs, mesh->points);
    for (size_t i = 0; !params->failed && i < indices; i++)
        if (!(mesh->indices[i] >= 0 && mesh->indices[i] < (double)mesh->points))
            pbrt_params_fail(params, pbrt_params_find(params, "indices"),
                             "index %.0f (number %zu) is out of range: there are %zu vertices",
                             mesh->indices[i], i, mesh->points);
    mesh->patches = indices / 4;
    return pbrt_params_done(params);
}

static struct tessellate_patch patch_of(const struct bilinear *mesh, size_t index)
{
    struct tessellate_patch patch = { .has_normals = mesh->n != NULL, .has_uvs = mesh->uv != NULL };
    for (int corner = 0; corner < 4; corner++) {
        size_t vertex = (size_t)mesh->indices[4 * index + (size_t)corner];
        memcpy(patch.p[corner], mesh->p + 3 * vertex, sizeof(patch.p[corner]));
        if (mesh->n != NULL)
            memcpy(patch.n[corner], mesh->n + 3 * vertex, sizeof(patch.n[corner]));
        if (mesh->uv != NULL)
            memcpy(patch.uv[corner], mesh->uv + 2 * vertex, sizeof(patch.uv[corner]));
    }
    return patch;
}

bool pbrt_curved_bilinear(struct pbrt_reader *reader, const struct build_place *place)
{
    struct bilinear mesh;
    struct tessellation shape;
    if (!read_bilinear(&reader->params, &mesh))
        return false;
    const struct emitter *emitters = reader->build->emitters.data;
    bool each = place->emitter != SCENE_NONE && emitters[place->emitter].power > 0, flat = true;
    for (size_t i = 0; i < mesh.patches && flat; i++) {
        struct tessellate_patch patch = patch_of(&mesh, i);
        flat = tessellate_patch_is_flat(&patch);
    }
    double tolerance = vec_extent(mesh.p, mesh.points) / PATCH_SHARE;
    start(reader, place, &shape);
    bool made = true;
    for (size_t i = 0; made && i < mesh.patches; i++) {
        struct tessellate_patch patch = patch_of(&mesh, i);
        made = tessellate_patch(&shape, &patch, tolerance, flat, reader->err) ||
               at(reader, &place->pos);
        if (made && (each || i + 1 == mesh.patches)) { /* pbrt's power is that of a patch */
            made = add(reader, &shape, true, place);
            tessellate_free(&shape);
            start(reader, place, &shape);
        }
    }
    tessellate_free(&shape);
    return made;
}

/* --- Subdivision surfaces ----------------------------------------------------------------- */

bool pbrt_curved_loop(struct pbrt_reader *reader, const struct build_place *place)
{
    static const struct pbrt_name schemes[] = { { "loop", 0, NAME_OURS, NULL } };
    struct pbrt_params *params = &reader->params;
    struct subdivide_mesh mesh;
    size_t indices;
    const struct pbrt_name *found;
    mesh.points = pbrt_params_array(params, "P", PARAM_POINT3, &mesh.point_count);
    mesh.indices = pbrt_params_array(params, "indices", PARAM_INTEGER, &indices);
    mesh.triangle_count = indices / 3;
    int64_t levels = pbrt_params_integer(params, "levels", 3);
    const struct pbrt_token *scheme = pbrt_params_string(params, "scheme");
    if (mesh.points == NULL || mesh.indices == NULL)
        pbrt_params_fail(params, NULL, "a loopsubdiv wants \"point3 P\" and \"integer indices\"");
    if (indices % 3 != 0)
        pbrt_params_fail(params, pbrt_params_find(params, "indices"),
                         "%zu indices are not a multiple of three", indices);
    if (levels < 0 || levels > SUBDIVIDE_LEVELS)
        pbrt_params_fail(params, pbrt_params_find(params, "levels"),
                         "%lld levels of subdivision: 0 to %d are possible", (long long)levels,
                         SUBDIVIDE_LEVELS);
    if (!pbrt_params_done(params) ||
        (scheme != NULL &&
         !pbrt_names_choose(reader, "subdivision scheme", schemes, COUNT(schemes), scheme, &found)))
        return false;
    struct tessellation shape;
    start(reader, place, &shape);
    bool made = (subdivide_loop(&shape, &mesh, (unsigned)levels, reader->err) ||
                 at(reader, &place->pos)) &&
                add(reader, &shape, true, place);
    tessellate_free(&shape);
    return made;
}

/* --- Curves ------------------------------------------------------------------------------- */

enum { CURVE_FLAT, CURVE_CYLINDER, CURVE_RIBBON, BASIS_BEZIER, BASIS_BSPLINE };

static const struct pbrt_name types[] = { { "flat", CURVE_FLAT, NAME_OURS, NULL },
                                          { "cylinder", CURVE_CYLINDER, NAME_OURS, NULL },
                                          { "ribbon", CURVE_RIBBON, NAME_OURS, NULL } };
static const struct pbrt_name bases[] = { { "bezier", BASIS_BEZIER, NAME_OURS, NULL },
                                          { "bspline", BASIS_BSPLINE, NAME_OURS, NULL } };

static bool choose(struct pbrt_reader *reader, const char *kind, const struct pbrt_name *names,
                   size_t count, const struct pbrt_token *token, int *value)
{
    const struct pbrt_name *found;
    if (token == NULL)
        return true;
    if (!pbrt_names_choose(reader, kind, names, count, token, &found))
        return false;
    *value = found->value;
    return true;
}

/* Would float32 round the points by less than the width can hide? */
static bool narrow_is_enough(const struct curve *curve)
{
    double largest = 0, width = fmin(curve->width[0], curve->width[1]);
    for (size_t i = 0; i < 3 * curve->point_count; i++)
        largest = fmax(largest, fabs(curve->points[i]));
    width = width > 0 ? width : fmax(curve->width[0], curve->width[1]);
    return largest * 0x1p-24 <= width * 0x1p-8;
}

bool pbrt_curved_curve(struct pbrt_reader *reader, const struct build_place *place)
{
    struct pbrt_params *params = &reader->params;
    struct curve curve = { 0 };
    int type = CURVE_FLAT, basis = BASIS_BEZIER;
    double width = pbrt_params_float(params, "width", 1);
    curve.width[0] = pbrt_params_float(params, "width0", width);
    curve.width[1] = pbrt_params_float(params, "width1", width);
    int64_t degree = pbrt_params_integer(params, "degree", 3);
    curve.degree = degree == 2 || degree == 3 ? (int)degree : 0;
    curve.points = pbrt_params_array(params, "P", PARAM_POINT3, &curve.point_count);
    curve.normals = pbrt_params_array(params, "N", PARAM_NORMAL, &curve.normal_count);
    const struct pbrt_token *type_name = pbrt_params_string(params, "type");
    const struct pbrt_token *basis_name = pbrt_params_string(params, "basis");
    pbrt_params_ignore(params, "splitdepth"); /* of pbrt's own way to find hits */
    if (curve.points == NULL)
        pbrt_params_fail(params, NULL, "a curve wants \"point3 P\"");
    if (curve.degree == 0)
        pbrt_params_fail(params, pbrt_params_find(params, "degree"),
                         "a curve of degree %lld: 2 and 3 are possible", (long long)degree);
    if (!(curve.width[0] >= 0 && curve.width[1] >= 0))
        pbrt_params_fail(params, NULL, "a curve's width of %g",
                         fmin(curve.width[0], curve.width[1]));
    if (!pbrt_params_done(params) ||
        !choose(reader, "type of curve", types, COUNT(types), type_name, &type) ||
        !choose(reader, "basis of a curve", bases, COUNT(bases), basis_name, &basis))
        return false;
    curve.bspline = basis == BASIS_BSPLINE;
    curve.ribbon = type == CURVE_RIBBON;
    if (type == CURVE_FLAT)
        pbrt_report_note(reader, &place->pos,
                         "a flat curve, which in pbrt turns to every ray, is a tube of its width");
    if (!curve.ribbon && curve.normals != NULL)
        pbrt_report_note(reader, &place->pos, "\"N\" of a curve that is no ribbon is not used");
    struct build_place here = *place;
    here.joins = true; /* hair: a mesh for each would be too many */
    struct tessellation shape;
    start(reader, place, &shape);
    bool made = (curve_mesh_add(&shape, &curve, reader->err) || at(reader, &place->pos)) &&
                add(reader, &shape, !narrow_is_enough(&curve), &here);
    tessellate_free(&shape);
    return made;
}
