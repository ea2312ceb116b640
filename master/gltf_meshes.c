#include "master/gltf_meshes.h"

#include "master/gltf_accessors.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { TRIANGLES = 4, STRIP = 5, FAN = 6 };

/* A primitive on its way into the scene */
struct primitive {
    struct gltf_item item, attributes;
    struct gltf_surface surface;
    struct ply_added added;
    const float *positions; /* of its own vertices */
};

bool gltf_meshes_start(struct gltf_reader *reader)
{
    size_t count = gltf_json_count(reader, "meshes");
    struct gltf_mesh *meshes = growing_add(&reader->meshes.all, count, sizeof(*meshes));
    if (meshes == NULL)
        return gltf_report_no_memory(reader);
    memset(meshes, 0, count * sizeof(*meshes));
    return true;
}

void gltf_meshes_free(struct gltf_meshes *meshes)
{
    growing_free(&meshes->all);
}

/* --- Vertices ----------------------------------------------------------------------------- */

/* An attribute with one element for each vertex; *there is false when the mesh lacks it */
static bool open_attribute(struct gltf_reader *reader, const struct primitive *primitive,
                           const char *name, uint32_t least, uint32_t most,
                           struct gltf_accessor *accessor, bool *there)
{
    *there = gltf_json_has(&primitive->attributes, name);
    if (!*there)
        return true;
    uint32_t index = gltf_json_index(reader, &primitive->attributes, name);
    if (reader->failed || !gltf_accessors_open(reader, index, &primitive->attributes, accessor))
        return false;
    if (accessor->components < least || accessor->components > most)
        return gltf_report_error(reader, accessor->item.where, "%u numbers are no %s",
                                 accessor->components, name);
    if (primitive->added.vertex_count > 0 && accessor->count != primitive->added.vertex_count)
        return gltf_report_error(reader, accessor->item.where, "%u %s for %u vertices",
                                 accessor->count, name, primitive->added.vertex_count);
    return gltf_file_spend(reader, accessor->count, 16, accessor->item.where);
}

static float *read_floats(struct gltf_reader *reader, const struct gltf_accessor *accessor,
                          struct growing *array)
{
    float *out = growing_add(array, accessor->count, accessor->components * sizeof(float));
    if (out == NULL)
        gltf_report_no_memory(reader);
    return out != NULL && gltf_accessors_floats(reader, accessor, out) ? out : NULL;
}

static bool read_positions(struct gltf_reader *reader, struct primitive *primitive)
{
    struct ply_target *vertices = &reader->build->vertices;
    struct gltf_accessor accessor;
    bool there;
    if (!open_attribute(reader, primitive, "POSITION", 3, 3, &accessor, &there) || !there)
        return !reader->failed;
    if (accessor.count > UINT32_MAX - 1 - vertices->positions.count)
        return gltf_report_error(reader, accessor.item.where, "more than 2^32 vertices");
    primitive->added.first_vertex = (uint32_t)vertices->positions.count;
    primitive->added.vertex_count = accessor.count;
    primitive->positions = read_floats(reader, &accessor, &vertices->positions);
    return primitive->positions != NULL;
}

static bool read_normals(struct gltf_reader *reader, struct primitive *primitive)
{
    struct gltf_accessor accessor;
    return open_attribute(reader, primitive, "NORMAL", 3, 3, &accessor,
                          &primitive->added.has_normals) &&
           (!primitive->added.has_normals ||
            read_floats(reader, &accessor, &reader->build->vertices.normals) != NULL);
}

/* The set that the material's textures lie on, from the bottom up */
static bool read_uvs(struct gltf_reader *reader, struct primitive *primitive)
{
    struct gltf_accessor accessor;
    char name[32];
    if (primitive->surface.set == SCENE_NONE)
        return true;
    snprintf(name, sizeof(name), "TEXCOORD_%u", primitive->surface.set);
    if (!open_attribute(reader, primitive, name, 2, 2, &accessor, &primitive->added.has_uvs))
        return false;
    if (!primitive->added.has_uvs) {
        gltf_report_note(reader, primitive->item.where, "it has a texture, and no %s to place it",
                         name);
        return true;
    }
    float *uvs = read_floats(reader, &accessor, &reader->build->vertices.uvs);
    for (size_t i = 0; uvs != NULL && i < accessor.count; i++)
        uvs[2 * i + 1] = 1 - uvs[2 * i + 1];
    return uvs != NULL;
}

/* RGB or RGBA, kept within what a surface can reflect */
static bool read_colors(struct gltf_reader *reader, struct primitive *primitive)
{
    struct gltf_accessor accessor;
    if (!open_attribute(reader, primitive, "COLOR_0", 3, 4, &accessor,
                        &primitive->added.has_colors) ||
        !primitive->added.has_colors)
        return !reader->failed;
    float *rgba = growing_add(&reader->build->vertices.colors, accessor.count, 4 * sizeof(float));
    if (rgba == NULL)
        return gltf_report_no_memory(reader);
    if (!gltf_accessors_floats(reader, &accessor, rgba))
        return false;
    for (size_t i = accessor.count; accessor.components == 3 && i-- > 0;) {
        memmove(rgba + 4 * i, rgba + 3 * i, 3 * sizeof(float));
        rgba[4 * i + 3] = 1;
    }
    bool cut = false;
    for (size_t i = 0; i < 4 * (size_t)accessor.count; i++) {
        float inside = fminf(1, fmaxf(0, rgba[i]));
        cut = cut || inside != rgba[i];
        rgba[i] = inside;
    }
    if (cut)
        gltf_report_note(reader, accessor.item.where, "vertex colours outside of 0 to 1 are cut");
    return true;
}

/* --- Triangles ---------------------------------------------------------------------------- */

/* The corners of a triangle as numbers of indices */
static void corners_of(uint32_t mode, uint32_t triangle, uint32_t corner[3])
{
    uint32_t odd = triangle & 1;
    switch (mode) {
    case STRIP:
        corner[0] = triangle;
        corner[1] = triangle + 1 + odd;
        corner[2] = triangle + 2 - odd;
        break;
    case FAN:
        corner[0] = 0;
        corner[1] = triangle + 1;
        corner[2] = triangle + 2;
        break;
    default:
        for (uint32_t i = 0; i < 3; i++)
            corner[i] = 3 * triangle + i;
    }
}

/* The file's indices, behind the array's end: they become triangles there; NULL when a mesh has
 * none, or after an error */
static const uint32_t *read_indices(struct gltf_reader *reader, const struct primitive *primitive,
                                    struct growing *indices, uint32_t *count)
{
    struct gltf_accessor accessor;
    *count = primitive->added.vertex_count;
    if (!gltf_json_has(&primitive->item, "indices"))
        return NULL;
    uint32_t index = gltf_json_index(reader, &primitive->item, "indices");
    if (reader->failed || !gltf_accessors_open(reader, index, &primitive->item, &accessor) ||
        !gltf_file_spend(reader, accessor.count, sizeof(uint32_t), accessor.item.where))
        return NULL;
    uint32_t *all = growing_add(indices, accessor.count, sizeof(*all));
    if (all == NULL)
        gltf_report_no_memory(reader);
    if (all == NULL || !gltf_accessors_indices(reader, &accessor, all))
        return NULL;
    *count = accessor.count;
    for (uint32_t i = 0; i < accessor.count; i++)
        if (all[i] >= primitive->added.vertex_count) {
            gltf_report_error(reader, accessor.item.where, "index %u (number %u) of %u vertices",
                              all[i], i, primitive->added.vertex_count);
            return NULL;
        }
    return all;
}

static bool add_triangles(struct gltf_reader *reader, struct primitive *primitive, uint32_t mode)
{
    struct growing indices = { 0 }, *triangles = &reader->build->vertices.triangles;
    struct ply_added *added = &primitive->added;
    uint32_t count;
    const uint32_t *from = read_indices(reader, primitive, &indices, &count);
    uint32_t wanted = mode == TRIANGLES ? count / 3 : count > 2 ? count - 2 : 0;
    uint32_t *out = NULL;
    if (!reader->failed && wanted > UINT32_MAX / 4 - triangles->count)
        gltf_report_error(reader, primitive->item.where, "more than 2^30 triangles");
    if (!reader->failed && gltf_file_spend(reader, wanted, 12, primitive->item.where)) {
        out = growing_add(triangles, wanted, 3 * sizeof(uint32_t));
        if (out == NULL)
            gltf_report_no_memory(reader);
    }
    added->first_triangle = (uint32_t)(triangles->count - (out != NULL ? wanted : 0));
    added->triangle_count = wanted;
    for (uint32_t t = 0; out != NULL && t < wanted; t++, out += 3) {
        uint32_t corner[3];
        corners_of(mode, t, corner);
        for (int i = 0; i < 3; i++)
            out[i] = added->first_vertex + (from != NULL ? from[corner[i]] : corner[i]);
    }
    growing_free(&indices);
    if (mode == TRIANGLES && count % 3 != 0)
        gltf_report_note(reader, primitive->item.where,
                         "indices that are no triangle are left out");
    return !reader->failed;
}

/* A light wants area: without any, it is none */
static bool has_area(const struct gltf_reader *reader, const struct primitive *primitive)
{
    const struct ply_added *added = &primitive->added;
    const float *positions = reader->build->vertices.positions.data;
    const uint32_t *corner = (const uint32_t *)reader->build->vertices.triangles.data +
                             3 * (size_t)added->first_triangle;
    for (uint32_t t = 0; t < added->triangle_count; t++, corner += 3) {
        const float *a = positions + 3 * (size_t)corner[0];
        double u[3], v[3];
        for (int axis = 0; axis < 3; axis++) {
            u[axis] = (double)positions[3 * (size_t)corner[1] + (size_t)axis] - a[axis];
            v[axis] = (double)positions[3 * (size_t)corner[2] + (size_t)axis] - a[axis];
        }
        if (u[1] * v[2] != u[2] * v[1] || u[2] * v[0] != u[0] * v[2] || u[0] * v[1] != u[1] * v[0])
            return true;
    }
    return false;
}

/* --- Primitives --------------------------------------------------------------------------- */

/* Its material, and whether there is anything to see of it */
static bool open_primitive(struct gltf_reader *reader, const struct gltf_item *mesh, size_t index,
                           struct primitive *primitive, uint32_t *mode, bool *visible)
{
    *primitive = (struct primitive){ .item = gltf_json_entry(reader, mesh, "primitives", index) };
    primitive->attributes = gltf_json_child(reader, &primitive->item, "attributes");
    *mode = gltf_json_index(reader, &primitive->item, "mode");
    *mode = *mode == SCENE_NONE ? TRIANGLES : *mode;
    uint32_t material = gltf_json_index(reader, &primitive->item, "material");
    *visible = *mode >= TRIANGLES && gltf_json_has(&primitive->attributes, "POSITION");
    if (reader->failed)
        return false;
    if (*mode > FAN)
        return gltf_report_error(reader, primitive->item.where, "there is no mode %u", *mode);
    if (*mode < TRIANGLES)
        gltf_report_note(reader, primitive->item.where, "points and lines are left out");
    return !*visible ||
           gltf_materials_use(reader, material, gltf_json_has(&primitive->attributes, "COLOR_0"),
                              &primitive->item, &primitive->surface);
}

static void widen_box(struct gltf_mesh *mesh, const struct primitive *primitive)
{
    const float *p = primitive->positions;
    for (uint32_t v = 0; v < primitive->added.vertex_count; v++, p += 3) {
        for (int axis = 0; axis < 3; axis++) {
            mesh->min[axis] = mesh->has_box ? fmin(mesh->min[axis], p[axis]) : p[axis];
            mesh->max[axis] = mesh->has_box ? fmax(mesh->max[axis], p[axis]) : p[axis];
        }
        mesh->has_box = true;
    }
}

static bool add_primitive(struct gltf_reader *reader, struct gltf_mesh *mesh,
                          struct primitive *primitive, uint32_t mode,
                          const struct transform *to_world)
{
    struct build_place place = { .to_world = *to_world,
                                 .material = primitive->surface.material,
                                 .emitter = primitive->surface.emitter,
                                 .alpha = primitive->surface.alpha,
                                 .inside = primitive->surface.inside,
                                 .pos = { reader->report.path, 0, 0 } };
    if (!read_positions(reader, primitive) || !read_normals(reader, primitive) ||
        !read_uvs(reader, primitive) || !read_colors(reader, primitive) ||
        !add_triangles(reader, primitive, mode))
        return false;
    if (place.emitter != SCENE_NONE && !has_area(reader, primitive))
        place.emitter = SCENE_NONE;
    mesh->emits = mesh->emits || place.emitter != SCENE_NONE;
    widen_box(mesh, primitive);
    return scene_build_add_mesh(reader->build, &place, &primitive->added, reader->err) ||
           gltf_report_wrap(reader, primitive->item.where);
}

static bool add_primitives(struct gltf_reader *reader, const struct gltf_item *item,
                           struct gltf_mesh *mesh, const struct transform *to_world)
{
    size_t count = json_array_size(gltf_json_list(reader, item, "primitives"));
    for (size_t i = 0; i < count; i++) {
        struct primitive primitive;
        uint32_t mode;
        bool visible;
        if (!gltf_file_spend(reader, 1, sizeof(struct build_mesh) + sizeof(struct mesh),
                             item->where) ||
            !open_primitive(reader, item, i, &primitive, &mode, &visible) ||
            (visible && !add_primitive(reader, mesh, &primitive, mode, to_world)))
            return false;
    }
    return !reader->failed;
}

bool gltf_meshes_use(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from)
{
    struct gltf_item item;
    if (!gltf_json_find(reader, "meshes", index, from, &item))
        return false;
    ((struct gltf_mesh *)reader->meshes.all.data)[index].uses++;
    return true;
}

/* Into a group, in its own space */
static bool make_group(struct gltf_reader *reader, const struct gltf_item *item,
                       struct gltf_mesh *mesh)
{
    const struct transform here = transform_identity();
    uint64_t spent = reader->file.spent;
    const char *name = json_string_value(json_object_get(item->json, "name"));
    scene_build_group_begin(reader->build);
    if (name != NULL && !scene_build_group_name(reader->build, name, strlen(name), reader->err))
        return gltf_report_wrap(reader, item->where);
    if (!add_primitives(reader, item, mesh, &here))
        return false;
    scene_build_group_end(reader->build, &mesh->group);
    mesh->cost = reader->file.spent - spent;
    return mesh->grouped = true;
}

bool gltf_meshes_add(struct gltf_reader *reader, uint32_t index, const struct transform *to_world)
{
    const struct source_pos pos = { reader->report.path, 0, 0 };
    struct gltf_item item, root = gltf_json_root(reader);
    struct gltf_mesh *mesh = (struct gltf_mesh *)reader->meshes.all.data + index;
    if (!gltf_json_find(reader, "meshes", index, &root, &item))
        return false;
    if (mesh->uses == 1) {
        if (!add_primitives(reader, &item, mesh, to_world))
            return false;
    } else {
        if (!mesh->grouped && !make_group(reader, &item, mesh))
            return false;
        if ((mesh->emits && !gltf_file_spend(reader, mesh->cost, 1, item.where)) ||
            !gltf_file_spend(reader, 1, sizeof(struct build_instance) + sizeof(struct instance),
                             item.where))
            return false;
        if (!scene_build_add_instance(reader->build, mesh->group, to_world, &pos, reader->err))
            return gltf_report_wrap(reader, item.where);
    }
    if (mesh->has_box)
        gltf_view_enclose(reader, mesh->min, mesh->max, to_world);
    return true;
}
