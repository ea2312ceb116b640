#include "master/scene_groups.h"

#include "common/arena.h"
#include "common/err.h"
#include "master/motion.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define REMOVED UINT32_MAX /* the group of quadrics that nothing shows */

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory for the scene's instances");
}

static struct transform start_of(const struct build_instance *instance)
{
    struct transform m = transform_identity();
    memcpy(m.m, instance->to_world, sizeof(instance->to_world));
    return m;
}

static const struct transform *end_of(const struct scene_build *build,
                                      const struct build_instance *instance)
{
    return (const struct transform *)build->ends.data + instance->end - 1;
}

/* Nothing shows it: without triangles it is left out at the end */
static void remove_mesh(struct build_mesh *mesh)
{
    mesh->range.triangle_count = 0;
    mesh->place.emitter = SCENE_NONE;
}

/* --- Copies of what emits ----------------------------------------------------------------- */

static bool emits(const struct scene_build *build, const struct build_place *place)
{
    if (place->emitter == SCENE_NONE)
        return false;
    const struct emitter *emitter = (const struct emitter *)build->emitters.data + place->emitter;
    return emitter->radiance[0] != 0 || emitter->radiance[1] != 0 || emitter->radiance[2] != 0;
}

/* Append a copy of `count` elements of an array to it; false without memory */
static bool repeat(struct growing *array, size_t first, size_t count, size_t size)
{
    char *copy = growing_add(array, count, size);
    if (copy != NULL)
        memcpy(copy, (const char *)array->data + first * size, count * size);
    return copy != NULL;
}

static bool copy_mesh(struct scene_build *build, size_t index, const struct transform *to_world,
                      struct err *err)
{
    struct ply_target *vertices = &build->vertices;
    struct build_mesh mesh = ((const struct build_mesh *)build->meshes.data)[index];
    const struct ply_added from = mesh.range;
    mesh.group = 0;
    mesh.place.to_world = transform_mul(to_world, &mesh.place.to_world);
    if (vertices->positions.count + from.vertex_count > UINT32_MAX - 1 ||
        vertices->triangles.count + from.triangle_count > UINT32_MAX / 3)
        return err_set(err, ERR_SCENE,
                       "%s:%d:%d: the instances of this light have too many vertices",
                       mesh.place.pos.path, mesh.place.pos.line, mesh.place.pos.column);
    mesh.range.first_vertex = (uint32_t)vertices->positions.count;
    mesh.range.first_triangle = (uint32_t)vertices->triangles.count;
    if (!repeat(&vertices->positions, from.first_vertex, from.vertex_count, 3 * sizeof(float)) ||
        !repeat(&vertices->triangles, from.first_triangle, from.triangle_count,
                3 * sizeof(uint32_t)))
        return no_memory(err);
    uint32_t *corner = (uint32_t *)vertices->triangles.data + 3 * (size_t)mesh.range.first_triangle;
    for (size_t i = 0; i < 3 * (size_t)from.triangle_count; i++)
        corner[i] = corner[i] - from.first_vertex + mesh.range.first_vertex;
    if (from.has_normals) {
        size_t first = mesh.first_normal;
        mesh.first_normal = vertices->normals.count;
        if (!repeat(&vertices->normals, first, from.vertex_count, 3 * sizeof(float)))
            return no_memory(err);
    }
    if (from.has_uvs) {
        size_t first = mesh.first_uv;
        mesh.first_uv = vertices->uvs.count;
        if (!repeat(&vertices->uvs, first, from.vertex_count, 2 * sizeof(float)))
            return no_memory(err);
    }
    /* Colours stay what they are: the copy's lie where the original's do */
    if (mesh.wide != NULL) {
        size_t size = 3 * (size_t)from.vertex_count * sizeof(double);
        const double *wide = mesh.wide;
        mesh.wide = malloc(size);
        if (mesh.wide == NULL)
            return no_memory(err);
        memcpy(mesh.wide, wide, size);
    }
    struct build_mesh *added = growing_add(&build->meshes, 1, sizeof(*added));
    if (added == NULL) {
        free(mesh.wide);
        return no_memory(err);
    }
    *added = mesh;
    return true;
}

static bool copy_quadric(struct scene_build *build, size_t index, const struct transform *to_world,
                         struct err *err)
{
    struct build_quadric quadric = ((const struct build_quadric *)build->quadrics.data)[index];
    quadric.group = 0;
    quadric.place.to_world = transform_mul(to_world, &quadric.place.to_world);
    struct build_quadric *added = growing_add(&build->quadrics, 1, sizeof(*added));
    if (added == NULL)
        return no_memory(err);
    *added = quadric;
    return true;
}

static bool refuse_moving_light(const struct build_place *place, struct err *err)
{
    return err_set(err, ERR_UNSUPPORTED, "%s:%d:%d: light from what moves is not supported yet",
                   place->pos.path, place->pos.line, place->pos.column);
}

typedef bool copy_part(struct scene_build *build, size_t index, const struct transform *to_world,
                       struct err *err);

/* A copy for each instance of the group that the emitter at `place` is in */
static bool copy_for_instances(struct scene_build *build, uint32_t group,
                               const struct build_place *place, copy_part *copy, size_t index,
                               struct err *err)
{
    const struct build_instance *instances = build->instances.data;
    for (size_t k = 0; k < build->instances.count; k++) {
        if (instances[k].group != group)
            continue;
        if (instances[k].end != 0)
            return refuse_moving_light(place, err);
        struct transform to_world = start_of(&instances[k]);
        if (!copy(build, index, &to_world, err))
            return false;
    }
    return true;
}

static bool copy_emitters(struct scene_build *build, struct err *err)
{
    size_t meshes = build->meshes.count, quadrics = build->quadrics.count;
    for (size_t i = 0; i < meshes; i++) { /* the arrays grow, and may move */
        const struct build_mesh mesh = ((const struct build_mesh *)build->meshes.data)[i];
        if (mesh.group == 0 || !emits(build, &mesh.place))
            continue;
        if (!copy_for_instances(build, mesh.group, &mesh.place, copy_mesh, i, err))
            return false;
        remove_mesh((struct build_mesh *)build->meshes.data + i);
    }
    for (size_t i = 0; i < quadrics; i++) {
        const struct build_quadric quadric =
            ((const struct build_quadric *)build->quadrics.data)[i];
        if (quadric.group == 0 || !emits(build, &quadric.place))
            continue;
        if (!copy_for_instances(build, quadric.group, &quadric.place, copy_quadric, i, err))
            return false;
        ((struct build_quadric *)build->quadrics.data)[i].group = REMOVED;
    }
    return true;
}

/* --- Before anything is placed ------------------------------------------------------------ */

/* Groups that stand in one place are dissolved: the world is the one place where a shape need not
 * be looked up. only[group] is the instance that does not move, or NULL. */
static bool dissolve(struct scene_build *build, struct err *err)
{
    struct build_instance *instances = build->instances.data;
    uint32_t *uses = calloc((size_t)build->group_count + 1, sizeof(*uses));
    struct transform *only = malloc(((size_t)build->group_count + 1) * sizeof(*only));
    if (uses == NULL || only == NULL) {
        free(uses);
        free(only);
        return no_memory(err);
    }
    for (size_t i = 0; i < build->instances.count; i++) {
        uint32_t group = instances[i].group;
        uses[group] += instances[i].end != 0 ? 2 : uses[group] < 2;
        only[group] = start_of(&instances[i]);
    }
    struct build_mesh *mesh = build->meshes.data;
    for (size_t i = 0; i < build->meshes.count; i++, mesh++) {
        if (mesh->group == 0)
            continue;
        if (uses[mesh->group] == 0)
            remove_mesh(mesh);
        if (uses[mesh->group] != 1)
            continue;
        mesh->place.to_world = transform_mul(&only[mesh->group], &mesh->place.to_world);
        mesh->group = 0;
    }
    struct build_quadric *quadric = build->quadrics.data;
    for (size_t i = 0; i < build->quadrics.count; i++, quadric++) {
        if (quadric->group == 0)
            continue;
        uint32_t used = uses[quadric->group];
        if (used == 1)
            quadric->place.to_world = transform_mul(&only[quadric->group],
                                                    &quadric->place.to_world);
        quadric->group = used == 0 ? REMOVED : used == 1 ? 0 : quadric->group;
    }
    size_t kept = 0;
    for (size_t i = 0; i < build->instances.count; i++)
        if (uses[instances[i].group] > 1)
            instances[kept++] = instances[i];
    build->instances.count = kept;
    free(uses);
    free(only);
    return true;
}

/* Stable, by group; what was marked is left out */
static bool sort_quadrics(struct scene_build *build, struct err *err)
{
    struct growing sorted = { 0 };
    size_t *next = calloc((size_t)build->group_count + 2, sizeof(*next));
    const struct build_quadric *quadrics = build->quadrics.data;
    bool good = next != NULL;
    for (size_t i = 0; good && i < build->quadrics.count; i++)
        if (quadrics[i].group <= build->group_count)
            next[quadrics[i].group + 1]++;
    for (size_t group = 0; good && group < build->group_count; group++)
        next[group + 1] += next[group];
    size_t total = good ? next[build->group_count] + next[build->group_count + 1] : 0;
    struct build_quadric *to = good && total > 0 ? growing_add(&sorted, total, sizeof(*to)) : NULL;
    good = good && (total == 0 || to != NULL);
    for (size_t i = 0; good && i < build->quadrics.count; i++)
        if (quadrics[i].group <= build->group_count)
            to[next[quadrics[i].group]++] = quadrics[i];
    free(next);
    if (!good)
        return no_memory(err);
    growing_free(&build->quadrics);
    build->quadrics = sorted;
    return true;
}

static bool find_boxes(struct scene_build *build, struct scene_bounds **out, struct err *err)
{
    struct scene_bounds *boxes = malloc(((size_t)build->group_count + 1) * sizeof(*boxes));
    if (boxes == NULL)
        return no_memory(err);
    for (uint32_t group = 0; group <= build->group_count; group++)
        boxes[group] = scene_bounds_empty();
    const struct build_mesh *meshes = build->meshes.data;
    for (size_t i = 0; i < build->meshes.count; i++)
        if (meshes[i].group != 0 && meshes[i].range.triangle_count > 0)
            scene_bounds_add_mesh(&boxes[meshes[i].group], build, &meshes[i]);
    const struct build_quadric *quadrics = build->quadrics.data;
    for (size_t i = 0; i < build->quadrics.count; i++)
        if (quadrics[i].group != 0)
            scene_bounds_add_quadric(&boxes[quadrics[i].group], &quadrics[i]);
    *out = boxes;
    return true;
}

static bool choose_centers(struct scene_build *build, struct err *err)
{
    build->boxes = NULL;
    double *centers = growing_add(&build->centers, build->group_count, 3 * sizeof(double));
    if (centers == NULL || !find_boxes(build, &build->boxes, err))
        return no_memory(err);
    for (uint32_t group = 1; group <= build->group_count; group++, centers += 3)
        if (scene_bounds_is_empty(&build->boxes[group]))
            memset(centers, 0, 3 * sizeof(double));
        else
            scene_bounds_center(&build->boxes[group], centers);
    /* Instances of nothing are nothing */
    struct build_instance *instances = build->instances.data;
    size_t kept = 0;
    for (size_t i = 0; i < build->instances.count; i++)
        if (!scene_bounds_is_empty(&build->boxes[instances[i].group]))
            instances[kept++] = instances[i];
    build->instances.count = kept;
    return true;
}

bool scene_groups_prepare(struct scene_build *build, struct err *err)
{
    return build->group_count == 0 || (dissolve(build, err) && copy_emitters(build, err) &&
                                       sort_quadrics(build, err) && choose_centers(build, err));
}

const double *scene_groups_center(const struct scene_build *build, uint32_t group)
{
    return (const double *)build->centers.data + 3 * (size_t)(group - 1);
}

void scene_groups_add_bounds(const struct scene_build *build, struct scene_bounds *bounds)
{
    const struct build_instance *instances = build->instances.data;
    for (size_t i = 0; i < build->instances.count; i++) {
        const struct scene_bounds *box = &build->boxes[instances[i].group];
        struct transform to_world = start_of(&instances[i]);
        scene_bounds_add_box(bounds, box, &to_world);
        if (instances[i].end == 0)
            continue;
        /* On its way, it stays within the sphere about its box: about every place of its middle */
        const struct transform *end = end_of(build, &instances[i]);
        scene_bounds_add_box(bounds, box, end);
        double reach = 0;
        for (int which = 0; which < 2; which++) {
            const struct transform *m = which == 0 ? &to_world : end;
            double size = 0, corner = 0;
            for (int axis = 0; axis < 3; axis++) {
                double far = fmax(fabs(box->min[axis]), fabs(box->max[axis]));
                corner += far * far;
                for (int j = 0; j < 3; j++)
                    size += m->m[axis][j] * m->m[axis][j];
            }
            reach = fmax(reach, sqrt(size * corner));
        }
        for (int which = 0; which < 2; which++)
            for (int side = -1; side <= 1; side += 2) {
                double p[3];
                for (int axis = 0; axis < 3; axis++)
                    p[axis] = (which == 0 ? &to_world : end)->m[axis][3] + side * reach;
                scene_bounds_add(bounds, p);
            }
    }
}

/* --- The finished arrays ------------------------------------------------------------------ */

bool scene_groups_add_motion(struct scene_build *build, const struct transform *start,
                             const struct transform *end, const struct source_pos *pos,
                             uint32_t *motion, struct err *err)
{
    struct transform moved[2] = { *start, *end };
    for (int which = 0; which < 2; which++)
        for (int axis = 0; axis < 3; axis++)
            moved[which].m[axis][3] -= build->scene->settings.center[axis];
    struct motion *added = growing_add(&build->motions, 1, sizeof(*added));
    if (added == NULL)
        return no_memory(err);
    if (!motion_decompose(&moved[0], &moved[1], added))
        return err_set(err, ERR_SCENE,
                       "%s:%d:%d: there is no motion between these two transforms: one is the "
                       "other's mirror image, or flat",
                       pos->path, pos->line, pos->column);
    *motion = (uint32_t)build->motions.count;
    return true;
}

/* The group's new origin is at its centre: object is now center + object */
static struct transform from_center(const struct transform *to_world, const double center[3])
{
    struct transform shift = transform_translate(center[0], center[1], center[2]);
    return transform_mul(to_world, &shift);
}

static void round_rows(const struct transform *m, float out[12])
{
    for (int i = 0; i < 12; i++)
        out[i] = (float)m->m[i / 4][i % 4];
}

static bool place_instance(struct scene_build *build, const struct build_instance *from,
                           struct instance *out, struct err *err)
{
    const double *center = scene_groups_center(build, from->group);
    struct transform start = start_of(from), inverse;
    start = from_center(&start, center);
    *out = (struct instance){ .group = from->group - 1 };
    if (from->end != 0) {
        struct transform end = from_center(end_of(build, from), center);
        if (!scene_groups_add_motion(build, &start, &end, &from->pos, &out->motion, err))
            return false;
    }
    for (int axis = 0; axis < 3; axis++)
        start.m[axis][3] -= build->scene->settings.center[axis];
    if (!transform_invert(&start, &inverse))
        return err_set(err, ERR_SCENE, "%s:%d:%d: the instance's transform cannot be inverted",
                       from->pos.path, from->pos.line, from->pos.column);
    round_rows(&start, out->to_world);
    round_rows(&inverse, out->to_object);
    return true;
}

static bool place_instances(struct scene_build *build, struct err *err)
{
    const struct build_instance *from = build->instances.data;
    size_t count = build->instances.count;
    struct instance *out = growing_add(&build->placed, count, sizeof(*out));
    if (count > 0 && out == NULL)
        return no_memory(err);
    for (size_t i = 0; i < count; i++)
        if (!place_instance(build, &from[i], &out[i], err))
            return false;
    growing_free(&build->instances);
    return true;
}

/* Has this mesh something to say? Neither what lost all its triangles, nor what no group holds */
static bool is_kept(const struct scene_build *build, uint32_t index)
{
    return build->scene->meshes[index].triangle_count > 0 &&
           ((const struct build_mesh *)build->meshes.data)[index].group <= build->group_count;
}

/* Stable, by group */
static bool sort_meshes(struct scene_build *build, struct err *err)
{
    struct scene *scene = build->scene;
    const struct build_mesh *from = build->meshes.data;
    struct group *groups = build->groups.data;
    struct mesh *sorted = arena_alloc(scene->arena, scene->mesh_count, sizeof(*sorted));
    uint32_t *next = calloc((size_t)build->group_count + 2, sizeof(*next));
    if (next == NULL || sorted == NULL) {
        free(next);
        return no_memory(err);
    }
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        if (is_kept(build, i))
            next[from[i].group + 1]++;
    for (uint32_t group = 0; group <= build->group_count; group++) {
        if (group > 0)
            groups[group - 1] = (struct group){ .first_mesh = next[group],
                                                .mesh_count = next[group + 1] };
        next[group + 1] += next[group];
    }
    uint32_t kept = next[build->group_count + 1];
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        if (is_kept(build, i))
            sorted[next[from[i].group]++] = scene->meshes[i];
    free(next);
    scene->meshes = sorted;
    scene->mesh_count = kept;
    return true;
}

static void count_quadrics(struct scene_build *build)
{
    const struct build_quadric *quadrics = build->quadrics.data;
    struct group *groups = build->groups.data;
    uint32_t at = 0;
    for (uint32_t group = 0; group <= build->group_count; group++) {
        uint32_t first = at;
        while (at < build->quadrics.count && quadrics[at].group == group)
            at++;
        if (group > 0) {
            groups[group - 1].first_quadric = first;
            groups[group - 1].quadric_count = at - first;
        }
    }
}

bool scene_groups_finish(struct scene_build *build, struct err *err)
{
    uint32_t count = build->instances.count > 0 ? build->group_count : 0;
    if (growing_add(&build->groups, count, sizeof(struct group)) == NULL && count > 0)
        return no_memory(err);
    build->group_count = count;
    if (!sort_meshes(build, err))
        return false;
    count_quadrics(build);
    return place_instances(build, err);
}
