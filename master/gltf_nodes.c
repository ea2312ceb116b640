#include "master/gltf_nodes.h"

#include "master/gltf_accessors.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FAR 1e18

struct gltf_node {
    uint32_t index;
    struct transform parent;
};

struct gltf_placed {
    uint32_t mesh;
    struct transform to_world;
};

void gltf_nodes_free(struct gltf_nodes *nodes)
{
    growing_free(&nodes->met);
    growing_free(&nodes->ahead);
    growing_free(&nodes->placed);
}

/* --- Transforms --------------------------------------------------------------------------- */

/* T R S, the quaternion (x, y, z, w) brought to unit length */
static struct transform compose(const double t[3], const double q[4], const double s[3])
{
    double norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    double k = norm > 0 ? 2 / norm : 0, x = q[0], y = q[1], z = q[2], w = q[3];
    const double r[3][3] = { { 1 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w) },
                             { k * (x * y + z * w), 1 - k * (x * x + z * z), k * (y * z - x * w) },
                             { k * (x * z - y * w), k * (y * z + x * w),
                               1 - k * (x * x + y * y) } };
    struct transform m = transform_identity();
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            m.m[i][j] = r[i][j] * s[j];
        m.m[i][3] = t[i];
    }
    return m;
}

static bool read_transform(struct gltf_reader *reader, const struct gltf_item *node,
                           struct transform *local)
{
    double t[3] = { 0, 0, 0 }, q[4] = { 0, 0, 0, 1 }, s[3] = { 1, 1, 1 }, columns[16];
    if (gltf_json_numbers(reader, node, "matrix", -FAR, FAR, columns, 16)) {
        for (int i = 0; i < 16; i++)
            local->m[i % 4][i / 4] = columns[i];
        if (!reader->failed && !transform_is_affine(local))
            return gltf_report_error(reader, node->where, "its matrix is not affine");
        return !reader->failed;
    }
    gltf_json_numbers(reader, node, "translation", -FAR, FAR, t, 3);
    gltf_json_numbers(reader, node, "rotation", -1e3, 1e3, q, 4);
    gltf_json_numbers(reader, node, "scale", -FAR, FAR, s, 3);
    *local = compose(t, q, s);
    return !reader->failed;
}

/* --- Meshes ------------------------------------------------------------------------------- */

static bool place(struct gltf_reader *reader, const struct gltf_item *node, uint32_t mesh,
                  const struct transform *to_world)
{
    struct transform inverse;
    if (!transform_invert(to_world, &inverse)) {
        gltf_report_note(reader, node->where, "a mesh that is scaled to nothing is left out");
        return true;
    }
    struct gltf_placed *added = NULL;
    if (!gltf_meshes_use(reader, mesh, node) ||
        !gltf_file_spend(reader, 1, sizeof(*added), node->where))
        return false;
    added = growing_add(&reader->nodes.placed, 1, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    *added = (struct gltf_placed){ mesh, *to_world };
    return true;
}

/* One of the lists of EXT_mesh_gpu_instancing; *values is NULL when the file has none */
static bool read_list(struct gltf_reader *reader, const struct gltf_item *attributes,
                      const char *name, uint32_t components, uint32_t *count, float **values)
{
    struct gltf_accessor accessor;
    uint32_t index = gltf_json_index(reader, attributes, name);
    *values = NULL;
    if (reader->failed || index == SCENE_NONE)
        return !reader->failed;
    if (!gltf_accessors_open(reader, index, attributes, &accessor) ||
        !gltf_file_spend(reader, accessor.count, 4 * components, accessor.item.where))
        return false;
    if (accessor.components != components || (*count != 0 && *count != accessor.count))
        return gltf_report_error(reader, accessor.item.where, "this is no %s of %u instances", name,
                                 *count);
    *count = accessor.count;
    *values = malloc((size_t)accessor.count * components * sizeof(float) + 1);
    if (*values == NULL)
        return gltf_report_no_memory(reader);
    return gltf_accessors_floats(reader, &accessor, *values);
}

static bool place_many(struct gltf_reader *reader, const struct gltf_item *node,
                       const struct gltf_item *many, uint32_t mesh,
                       const struct transform *to_world)
{
    struct gltf_item attributes = gltf_json_child(reader, many, "attributes");
    float *move = NULL, *turn = NULL, *scale = NULL;
    uint32_t count = 0;
    bool good = read_list(reader, &attributes, "TRANSLATION", 3, &count, &move) &&
                read_list(reader, &attributes, "ROTATION", 4, &count, &turn) &&
                read_list(reader, &attributes, "SCALE", 3, &count, &scale);
    for (size_t i = 0; good && i < count; i++) {
        double t[3] = { 0, 0, 0 }, q[4] = { 0, 0, 0, 1 }, s[3] = { 1, 1, 1 };
        for (size_t axis = 0; axis < 3; axis++) {
            t[axis] = move != NULL ? (double)move[3 * i + axis] : t[axis];
            s[axis] = scale != NULL ? (double)scale[3 * i + axis] : s[axis];
        }
        for (size_t axis = 0; axis < 4; axis++)
            q[axis] = turn != NULL ? (double)turn[4 * i + axis] : q[axis];
        struct transform local = compose(t, q, s), instance = transform_mul(to_world, &local);
        good = place(reader, node, mesh, &instance);
    }
    free(move);
    free(turn);
    free(scale);
    return good;
}

static bool show_mesh(struct gltf_reader *reader, const struct gltf_item *node,
                      const struct transform *to_world)
{
    uint32_t mesh = gltf_json_index(reader, node, "mesh");
    if (reader->failed || mesh == SCENE_NONE)
        return !reader->failed;
    if (gltf_json_has(node, "skin"))
        gltf_report_note(reader, node->where, "skins are not applied: the mesh is shown unbent");
    if (gltf_json_has(node, "weights"))
        gltf_report_note(reader, node->where, "morph targets are not applied");
    struct gltf_item many = gltf_json_extension(reader, node, "EXT_mesh_gpu_instancing");
    if (many.json != NULL)
        return place_many(reader, node, &many, mesh, to_world);
    return !reader->failed && place(reader, node, mesh, to_world);
}

/* --- The walk ----------------------------------------------------------------------------- */

/* Look at these nodes next, the first of them first */
static bool push(struct gltf_reader *reader, const json_t *list, const char *where,
                 const struct transform *parent)
{
    for (size_t i = json_array_size(list); i-- > 0;) {
        struct gltf_node *ahead = growing_add(&reader->nodes.ahead, 1, sizeof(*ahead));
        if (ahead == NULL)
            return gltf_report_no_memory(reader);
        *ahead = (struct gltf_node){ gltf_json_list_index(list, i), *parent };
        if (ahead->index >= reader->nodes.met.count)
            return gltf_report_error(reader, where, "entry %zu of its list is no node", i);
        bool *met = (bool *)reader->nodes.met.data + ahead->index;
        if (*met)
            return gltf_report_error(
                reader, where, "nodes[%u] is the child of two nodes, or of itself", ahead->index);
        *met = true;
    }
    return true;
}

static bool visit(struct gltf_reader *reader, const struct gltf_node *node)
{
    struct gltf_item item, root = gltf_json_root(reader);
    struct transform local, to_world;
    if (!gltf_json_find(reader, "nodes", node->index, &root, &item) ||
        !read_transform(reader, &item, &local))
        return false;
    to_world = transform_mul(&node->parent, &local);
    for (int i = 0; i < 12; i++)
        if (!(fabs(to_world.m[i / 4][i % 4]) <= FAR))
            return gltf_report_error(reader, item.where, "it stands beyond %g", FAR);
    return show_mesh(reader, &item, &to_world) && gltf_lights_add(reader, &item, &to_world) &&
           gltf_view_camera(reader, &item, &to_world) &&
           push(reader, gltf_json_list(reader, &item, "children"), item.where, &to_world) &&
           !reader->failed;
}

/* Nodes that are no node's children, for files without a scene */
static bool push_roots(struct gltf_reader *reader)
{
    size_t count = reader->nodes.met.count;
    bool *child = calloc(count + 1, sizeof(*child));
    if (child == NULL)
        return gltf_report_no_memory(reader);
    struct gltf_item root = gltf_json_root(reader), item;
    const struct transform here = transform_identity();
    bool good = true;
    for (size_t i = 0; good && i < count; i++) {
        good = gltf_json_find(reader, "nodes", i, &root, &item);
        const json_t *children = good ? gltf_json_list(reader, &item, "children") : NULL;
        for (size_t j = 0; j < json_array_size(children); j++) {
            uint32_t index = gltf_json_list_index(children, j);
            if (index < count)
                child[index] = true;
        }
    }
    for (size_t i = count; good && i-- > 0;) {
        struct gltf_node *ahead = child[i] ? NULL
                                           : growing_add(&reader->nodes.ahead, 1, sizeof(*ahead));
        if (ahead != NULL) {
            *ahead = (struct gltf_node){ (uint32_t)i, here };
            ((bool *)reader->nodes.met.data)[i] = true;
        } else if (!child[i]) {
            good = gltf_report_no_memory(reader);
        }
    }
    free(child);
    return good && !reader->failed;
}

static bool push_scene(struct gltf_reader *reader)
{
    struct gltf_item root = gltf_json_root(reader), scene;
    const struct transform here = transform_identity();
    size_t count = gltf_json_count(reader, "scenes");
    uint32_t chosen = gltf_json_index(reader, &root, "scene");
    if (reader->failed)
        return false;
    if (count == 0 && chosen == SCENE_NONE)
        return push_roots(reader);
    chosen = chosen == SCENE_NONE ? 0 : chosen;
    if (count > 1)
        gltf_report_note(reader, "", "the file has %zu scenes; this is number %u", count, chosen);
    return gltf_json_find(reader, "scenes", chosen, &root, &scene) &&
           push(reader, gltf_json_list(reader, &scene, "nodes"), scene.where, &here) &&
           !reader->failed;
}

bool gltf_nodes_walk(struct gltf_reader *reader)
{
    struct gltf_nodes *nodes = &reader->nodes;
    size_t count = gltf_json_count(reader, "nodes");
    bool *met = growing_add(&nodes->met, count, sizeof(*met));
    if (met == NULL)
        return gltf_report_no_memory(reader);
    memset(met, 0, count * sizeof(*met));
    if (!push_scene(reader))
        return false;
    while (nodes->ahead.count > 0) {
        struct gltf_node node = ((struct gltf_node *)nodes->ahead.data)[--nodes->ahead.count];
        if (!visit(reader, &node))
            return false;
    }
    const struct gltf_placed *placed = nodes->placed.data;
    for (size_t i = 0; i < nodes->placed.count; i++)
        if (!gltf_meshes_add(reader, placed[i].mesh, &placed[i].to_world))
            return false;
    return true;
}
