#include "master/scene_build.h"

#include "common/arena.h"
#include "common/effects.h"
#include "common/err.h"
#include "master/scene_bounds.h"
#include "master/scene_groups.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FARTHEST 1e18 /* beyond it Embree's and our squares of distances leave float32 */

struct scene_build *scene_build_new(void)
{
    struct scene_build *build = calloc(1, sizeof(*build));
    if (build == NULL)
        return NULL;
    build->scene = scene_new();
    if (build->scene == NULL) {
        free(build);
        return NULL;
    }
    build->world_from_camera = transform_identity();
    return build;
}

void scene_build_free(struct scene_build *build)
{
    if (build == NULL)
        return;
    struct build_mesh *meshes = build->meshes.data;
    for (size_t i = 0; i < build->meshes.count; i++)
        free(meshes[i].wide);
    growing_free(&build->vertices.positions);
    growing_free(&build->vertices.normals);
    growing_free(&build->vertices.uvs);
    growing_free(&build->vertices.colors);
    growing_free(&build->vertices.triangles);
    growing_free(&build->vertices.wide);
    growing_free(&build->meshes);
    growing_free(&build->quadrics);
    growing_free(&build->materials);
    growing_free(&build->coat_tables);
    growing_free(&build->emitters);
    growing_free(&build->lights);
    growing_free(&build->textures);
    growing_free(&build->texture_spaces);
    growing_free(&build->pictures);
    growing_free(&build->texels);
    growing_free(&build->environments);
    growing_free(&build->media);
    growing_free(&build->instances);
    growing_free(&build->ends);
    growing_free(&build->group_names);
    free(build->boxes);
    growing_free(&build->centers);
    growing_free(&build->groups);
    growing_free(&build->placed);
    growing_free(&build->motions);
    scene_free(build->scene);
    free(build);
}

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory for the scene");
}

/* Does float32 hold the numbers of the file exactly? Then their doubles need not be kept. */
static bool narrow_is_enough(const double *wide, const float *narrow, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (wide[i] != (double)narrow[i])
            return false;
    return true;
}

/* Does a mesh stand exactly like another, and begin where that one ends? */
static bool goes_on(const struct build_mesh *before, const struct build_mesh *mesh)
{
    const struct build_place *a = &before->place, *b = &mesh->place;
    const struct ply_added *x = &before->range, *y = &mesh->range;
    return a->joins && b->joins && before->group == mesh->group && !x->has_wide && !y->has_wide &&
           memcmp(&a->to_world, &b->to_world, sizeof(a->to_world)) == 0 &&
           a->reverse_orientation == b->reverse_orientation && a->material == b->material &&
           a->emitter == b->emitter && a->alpha == b->alpha &&
           x->first_vertex + x->vertex_count == y->first_vertex &&
           x->first_triangle + x->triangle_count == y->first_triangle &&
           x->has_normals == y->has_normals && x->has_uvs == y->has_uvs &&
           x->has_colors == y->has_colors;
}

bool scene_build_add_mesh(struct scene_build *build, const struct build_place *place,
                          const struct ply_added *added, struct err *err)
{
    struct ply_target *vertices = &build->vertices;
    struct build_mesh mesh = { .place = *place, .range = *added, .group = build->open_group };
    size_t before = build->meshes.count;
    struct build_mesh *last = before > 0 ? (struct build_mesh *)build->meshes.data + before - 1
                                         : NULL;
    if (last != NULL && goes_on(last, &mesh)) {
        last->range.vertex_count += added->vertex_count;
        last->range.triangle_count += added->triangle_count;
        return true;
    }
    if (added->has_normals)
        mesh.first_normal = vertices->normals.count - added->vertex_count;
    if (added->has_uvs)
        mesh.first_uv = vertices->uvs.count - added->vertex_count;
    if (added->has_colors)
        mesh.first_color = vertices->colors.count - added->vertex_count;
    struct build_mesh *slot = growing_add(&build->meshes, 1, sizeof(mesh));
    if (slot == NULL)
        return no_memory(err);
    *slot = mesh;
    if (!added->has_wide)
        return true;
    const float *narrow = (const float *)vertices->positions.data + 3 * (size_t)added->first_vertex;
    if (narrow_is_enough(vertices->wide.data, narrow, 3 * (size_t)added->vertex_count)) {
        vertices->wide.count = 0;
        return true;
    }
    growing_trim(&vertices->wide, 3 * sizeof(double));
    slot->wide = vertices->wide.data;
    vertices->wide = (struct growing){ 0 };
    return true;
}

bool scene_build_add_quadric(struct scene_build *build, const struct build_quadric *quadric,
                             struct err *err)
{
    struct build_quadric *added = growing_add(&build->quadrics, 1, sizeof(*added));
    if (added == NULL)
        return no_memory(err);
    *added = *quadric;
    added->group = build->open_group;
    return true;
}

/* --- Groups ------------------------------------------------------------------------------- */

void scene_build_group_begin(struct scene_build *build)
{
    assert(build->open_group == 0);
    build->open_group = ++build->group_count;
}

bool scene_build_group_name(struct scene_build *build, const char *name, size_t length,
                            struct err *err)
{
    assert(build->open_group != 0);
    const char *text = arena_text(build->scene->arena, name, length);
    struct scene_name *added = growing_add(&build->group_names, 1, sizeof(*added));
    if (text == NULL || added == NULL)
        return no_memory(err);
    *added = (struct scene_name){ build->open_group - 1, text };
    return true;
}

void scene_build_group_end(struct scene_build *build, uint32_t *group)
{
    assert(build->open_group != 0);
    *group = build->open_group;
    build->open_group = 0;
}

bool scene_build_add_instance(struct scene_build *build, uint32_t group,
                              const struct transform *to_world, const struct source_pos *pos,
                              struct err *err)
{
    return scene_build_add_moving(build, group, to_world, NULL, pos, err);
}

bool scene_build_add_moving(struct scene_build *build, uint32_t group,
                            const struct transform *start, const struct transform *end,
                            const struct source_pos *pos, struct err *err)
{
    assert(group != 0 && group <= build->group_count);
    struct transform inverse;
    if (!transform_is_affine(start) || !transform_invert(start, &inverse))
        return err_set(err, ERR_SCENE, "%s:%d:%d: the instance's transform cannot be inverted",
                       pos->path, pos->line, pos->column);
    struct build_instance *instance = growing_add(&build->instances, 1, sizeof(*instance));
    if (instance == NULL)
        return no_memory(err);
    *instance = (struct build_instance){ .group = group, .pos = *pos };
    memcpy(instance->to_world, start->m, sizeof(instance->to_world));
    if (end == NULL)
        return true;
    struct transform *last = growing_add(&build->ends, 1, sizeof(*last));
    if (last == NULL)
        return no_memory(err);
    *last = *end;
    instance->end = (uint32_t)build->ends.count;
    return true;
}

/* --- Bounds and centre -------------------------------------------------------------------- */

static bool find_bounds(const struct scene_build *build, struct scene_bounds *bounds,
                        struct err *err)
{
    *bounds = scene_bounds_empty();
    const struct build_mesh *meshes = build->meshes.data;
    for (size_t i = 0; i < build->meshes.count; i++)
        if (meshes[i].group == 0)
            scene_bounds_add_mesh(bounds, build, &meshes[i]);
    const struct build_quadric *quadrics = build->quadrics.data;
    for (size_t i = 0; i < build->quadrics.count; i++)
        if (quadrics[i].group == 0)
            scene_bounds_add_quadric(bounds, &quadrics[i]);
    scene_groups_add_bounds(build, bounds);

    if (scene_bounds_is_empty(bounds))
        *bounds = (struct scene_bounds){ { 0 }, { 0 } };
    for (int axis = 0; axis < 3; axis++)
        if (!(fabs(bounds->min[axis]) < FARTHEST && fabs(bounds->max[axis]) < FARTHEST))
            return err_set(err, ERR_SCENE, "the scene reaches from %g to %g: beyond %g",
                           bounds->min[axis], bounds->max[axis], FARTHEST);
    return true;
}

/* --- Geometry ----------------------------------------------------------------------------- */

/* What becomes the origin of a group (1 + its number), or of the world (0) */
static const double *center_of(const struct scene_build *build, uint32_t group)
{
    return group == 0 ? build->scene->settings.center : scene_groups_center(build, group);
}

static void place_vertices(struct scene_build *build, const struct build_mesh *mesh)
{
    const double *center = center_of(build, mesh->group);
    float *out = (float *)build->vertices.positions.data + 3 * (size_t)mesh->range.first_vertex;
    const double to[3] = { center[0], center[1], center[2] };
    const struct build_mesh from = *mesh; /* no store below can change it */
    for (uint32_t v = 0; v < from.range.vertex_count; v++, out += 3) {
        double world[3];
        scene_bounds_vertex(build, &from, v, world);
        for (int axis = 0; axis < 3; axis++)
            out[axis] = (float)(world[axis] - to[axis]);
    }
}

/* Unit normals in the world, on the side the file says; a zero normal stays zero for now */
static bool place_normals(struct scene_build *build, const struct build_mesh *mesh, struct err *err)
{
    struct transform inverse;
    if (!transform_invert(&mesh->place.to_world, &inverse))
        return err_set(err, ERR_SCENE, "%s:%d:%d: the transform cannot be inverted",
                       mesh->place.pos.path, mesh->place.pos.line, mesh->place.pos.column);
    float *normal = (float *)build->vertices.normals.data + 3 * mesh->first_normal;
    double side = mesh->place.reverse_orientation ? -1 : 1;
    for (uint32_t v = 0; v < mesh->range.vertex_count; v++, normal += 3) {
        double n[3] = { normal[0], normal[1], normal[2] };
        transform_normal(&inverse, n, n);
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int axis = 0; axis < 3; axis++)
            normal[axis] = length > 0 && isfinite(length) ? (float)(side * n[axis] / length) : 0;
    }
    return true;
}

/* Twice the area times the normal, in float32 as the kernel will compute it */
static void face_normal(const float *positions, const uint32_t corner[3], float normal[3])
{
    const float *a = positions + 3 * (size_t)corner[0], *b = positions + 3 * (size_t)corner[1];
    const float *c = positions + 3 * (size_t)corner[2];
    float u[3], v[3];
    for (int axis = 0; axis < 3; axis++) {
        u[axis] = b[axis] - a[axis];
        v[axis] = c[axis] - a[axis];
    }
    normal[0] = u[1] * v[2] - u[2] * v[1];
    normal[1] = u[2] * v[0] - u[0] * v[2];
    normal[2] = u[0] * v[1] - u[1] * v[0];
}

/* Wind the triangle so that its geometric normal is on the side of its vertex normals; `side`
 * decides where they do not. Vertices without a normal get that of a face of theirs. */
static void follow_normals(float *normals, uint32_t shift, const float face[3], float side,
                           uint32_t corner[3], uint64_t *rewound)
{
    float *n[3], agree = 0;
    for (int i = 0; i < 3; i++) {
        n[i] = normals + 3 * (size_t)(uint32_t)(corner[i] + shift);
        agree += n[i][0] * face[0] + n[i][1] * face[1] + n[i][2] * face[2];
    }
    if (agree != 0)
        side = agree < 0 ? -1 : 1;
    for (int i = 0; i < 3; i++) {
        if (n[i][0] != 0 || n[i][1] != 0 || n[i][2] != 0)
            continue;
        float length = sqrtf(face[0] * face[0] + face[1] * face[1] + face[2] * face[2]);
        for (int axis = 0; axis < 3; axis++)
            n[i][axis] = side * face[axis] / length;
    }
    if (side < 0) {
        uint32_t swapped = corner[1];
        corner[1] = corner[2];
        corner[2] = swapped;
        *rewound += 1;
    }
}

/* Drop what has no area and move the rest up to `kept`; wind by normals where there are some */
static void place_triangles(struct scene_build *build, const struct build_mesh *from,
                            struct mesh *mesh, size_t *kept, struct build_counts *counts)
{
    const float *positions = build->vertices.positions.data;
    uint32_t *triangles = build->vertices.triangles.data;
    const uint32_t *in = triangles + 3 * (size_t)from->range.first_triangle;
    uint32_t *out = triangles + 3 * *kept;
    float side = mesh->flags & MESH_FLIP_NORMAL ? -1 : 1;
    float *normals = mesh->flags & MESH_NORMALS ? build->vertices.normals.data : NULL;
    const uint32_t count = from->range.triangle_count, shift = mesh->normal_shift;
    uint32_t made = 0;
    for (uint32_t t = 0; t < count; t++, in += 3) {
        uint32_t corner[3] = { in[0], in[1], in[2] };
        float face[3];
        face_normal(positions, corner, face);
        float size2 = face[0] * face[0] + face[1] * face[1] + face[2] * face[2];
        if (!(size2 >= FLT_MIN && size2 <= FLT_MAX)) {
            counts->degenerate_triangles++;
            continue;
        }
        if (normals != NULL)
            follow_normals(normals, shift, face, side, corner, &counts->rewound_triangles);
        memcpy(out, corner, sizeof(corner));
        out += 3;
        made++;
    }
    mesh->first_triangle = (uint32_t)*kept;
    mesh->triangle_count = made;
    *kept += made;
    if (mesh->flags & MESH_NORMALS)
        mesh->flags &= ~(uint32_t)MESH_FLIP_NORMAL; /* the winding says it now */
}

/* Vertices that no triangle uses may be left without a normal */
static void fill_normals(struct growing *array)
{
    float *n = array->data;
    for (size_t i = 0; i < array->count; i++, n += 3)
        if (n[0] == 0 && n[1] == 0 && n[2] == 0)
            n[2] = 1;
}

static bool place_meshes(struct scene_build *build, struct build_counts *counts, struct err *err)
{
    struct scene *scene = build->scene;
    struct build_mesh *from = build->meshes.data;
    size_t kept = 0;
    scene->meshes = arena_alloc(scene->arena, build->meshes.count, sizeof(struct mesh));
    if (scene->meshes == NULL)
        return no_memory(err);
    for (size_t i = 0; i < build->meshes.count; i++) {
        const struct ply_added *range = &from[i].range;
        bool mirrored = transform_det3(&from[i].place.to_world) < 0;
        struct mesh mesh = { .first_vertex = range->first_vertex,
                             .vertex_count = range->vertex_count,
                             .alpha = from[i].place.alpha,
                             .material = from[i].place.material,
                             .inside = from[i].place.inside,
                             .outside = from[i].place.outside,
                             .first_emissive = SCENE_NONE };
        if (mirrored != from[i].place.reverse_orientation)
            mesh.flags |= MESH_FLIP_NORMAL;
        place_vertices(build, &from[i]);
        free(from[i].wide);
        from[i].wide = NULL;
        if (range->has_normals) {
            mesh.flags |= MESH_NORMALS;
            mesh.normal_shift = (uint32_t)from[i].first_normal - range->first_vertex;
            scene->settings.has_normals = 1;
            if (!place_normals(build, &from[i], err))
                return false;
        }
        if (range->has_uvs) {
            mesh.flags |= MESH_UVS;
            mesh.uv_shift = (uint32_t)from[i].first_uv - range->first_vertex;
        }
        if (range->has_colors) {
            mesh.flags |= MESH_COLORS;
            mesh.color_shift = (uint32_t)from[i].first_color - range->first_vertex;
        }
        place_triangles(build, &from[i], &mesh, &kept, counts);
        scene->meshes[i] = mesh;
    }
    scene->mesh_count = (uint32_t)build->meshes.count;
    build->vertices.triangles.count = kept;
    fill_normals(&build->vertices.normals);
    return true;
}

static bool place_quadrics(struct scene_build *build, struct err *err)
{
    struct scene *scene = build->scene;
    const struct build_quadric *from = build->quadrics.data;
    scene->quadrics = arena_alloc(scene->arena, build->quadrics.count, sizeof(struct quadric));
    if (scene->quadrics == NULL)
        return no_memory(err);
    for (size_t i = 0; i < build->quadrics.count; i++) {
        const struct build_place *place = &from[i].place;
        struct quadric *quadric = &scene->quadrics[i];
        struct transform inverse;
        double center[3];
        if (!transform_invert(&place->to_world, &inverse))
            return err_set(err, ERR_SCENE, "%s:%d:%d: the transform cannot be inverted",
                           place->pos.path, place->pos.line, place->pos.column);
        *quadric = from[i].quadric;
        scene_bounds_quadric_center(&from[i], center);
        const double *origin = center_of(build, from[i].group);
        for (int axis = 0; axis < 3; axis++)
            quadric->center[axis] = (float)(center[axis] - origin[axis]);
        for (int j = 0; j < 9; j++) {
            quadric->to_world[j] = (float)place->to_world.m[j / 3][j % 3];
            quadric->to_object[j] = (float)inverse.m[j / 3][j % 3];
        }
        double scale = transform_similarity(&place->to_world);
        if (scale > 0) {
            quadric->flags |= QUADRIC_SIMILARITY;
            quadric->world_radius = (float)(scale * quadric->radius);
        }
        if (place->reverse_orientation)
            quadric->flags |= QUADRIC_FLIP_NORMAL;
        quadric->material = place->material;
        quadric->inside = place->inside;
        quadric->outside = place->outside;
        quadric->light = SCENE_NONE;
        quadric->alpha = place->alpha;
    }
    scene->quadric_count = (uint32_t)build->quadrics.count;
    return true;
}

/* Textures of points, too, move next to the origin: map (p + center) becomes map p + its image */
static void place_textures(struct scene_build *build)
{
    const double *center = build->scene->settings.center;
    const struct build_texture_space *space = build->texture_spaces.data;
    for (size_t i = 0; i < build->texture_spaces.count; i++, space++) {
        struct texture *texture = (struct texture *)build->textures.data + space->texture;
        for (int row = 0; row < 3; row++) {
            const double *m = space->map + 4 * row;
            for (int column = 0; column < 3; column++)
                texture->map[4 * row + column] = (float)m[column];
            texture->map[4 * row + 3] = (float)(m[0] * center[0] + m[1] * center[1] +
                                                m[2] * center[2] + m[3]);
        }
    }
}

static bool place_camera(struct scene_build *build, struct err *err)
{
    struct scene_settings *settings = &build->scene->settings;
    const struct transform *m = &build->world_from_camera;
    for (int axis = 0; axis < 3; axis++) {
        settings->camera.right[axis] = (float)m->m[axis][0];
        settings->camera.up[axis] = (float)m->m[axis][1];
        settings->camera.forward[axis] = (float)m->m[axis][2];
        settings->camera.position[axis] = (float)(m->m[axis][3] - settings->center[axis]);
    }
    return !build->camera_moves ||
           scene_groups_add_motion(build, m, &build->world_from_camera_end, &build->camera_pos,
                                   &settings->camera_motion, err);
}

/* Rounded like everything else, so that no vertex lies outside */
static void store_bounds(struct scene *scene, const struct scene_bounds *bounds)
{
    for (int axis = 0; axis < 3; axis++) {
        double center = scene->settings.center[axis];
        scene->settings.bounds_min[axis] = (float)(bounds->min[axis] - center);
        scene->settings.bounds_max[axis] = (float)(bounds->max[axis] - center);
    }
}

/* --- Lights and arrays -------------------------------------------------------------------- */

/* The emitter of a place, unless it sends nothing */
static const struct emitter *emitter_of(const struct scene_build *build,
                                        const struct build_place *place)
{
    if (place->emitter == SCENE_NONE)
        return NULL;
    const struct emitter *emitter = (const struct emitter *)build->emitters.data + place->emitter;
    bool dark = emitter->radiance[0] == 0 && emitter->radiance[1] == 0 && emitter->radiance[2] == 0;
    return dark ? NULL : emitter;
}

static bool add_other_lights(struct scene_build *build, struct light_arrays *arrays,
                             struct err *err)
{
    struct scene_settings *settings = &build->scene->settings;
    const struct build_light *from = build->lights.data;
    for (size_t i = 0; i < build->lights.count; i++) {
        struct light *light = growing_add(&arrays->lights, 1, sizeof(*light));
        if (light == NULL)
            return no_memory(err);
        *light = from[i].light;
        for (int axis = 0; axis < 3; axis++)
            light->position[axis] = (float)(from[i].position[axis] - settings->center[axis]);
        if (from[i].has_portal) {
            double corners[4][3];
            for (int k = 0; k < 12; k++)
                corners[k / 3][k % 3] = from[i].portal[k / 3][k % 3] - settings->center[k % 3];
            if (!scene_lights_add_portal(light, (const double(*)[3])corners, arrays, err))
                return false;
        }
        if (light->environment != 0)
            build->scene->environments[light->environment - 1].light =
                (uint32_t)arrays->lights.count - 1;
    }
    if (settings->sky[0] == 0 && settings->sky[1] == 0 && settings->sky[2] == 0)
        return true;
    settings->sky_light = (uint32_t)arrays->lights.count;
    struct light *sky = growing_add(&arrays->lights, 1, sizeof(*sky));
    if (sky == NULL)
        return no_memory(err);
    *sky = (struct light){ .kind = LIGHT_SKY, .quadric = SCENE_NONE };
    memcpy(sky->radiance, settings->sky, sizeof(sky->radiance));
    return true;
}

static bool make_lights(struct scene_build *build, struct light_arrays *arrays, struct err *err)
{
    const struct build_mesh *meshes = build->meshes.data;
    for (uint32_t i = 0; i < build->meshes.count; i++) {
        if (meshes[i].group != 0) /* its copies in the world emit */
            continue;
        const struct emitter *emitter = emitter_of(build, &meshes[i].place);
        if (emitter != NULL && !scene_lights_add_mesh(build->scene, i, emitter, arrays, err))
            return false;
    }
    const struct build_quadric *quadrics = build->quadrics.data;
    for (uint32_t i = 0; i < build->quadrics.count; i++) {
        const struct emitter *emitter = emitter_of(build, &quadrics[i].place);
        if (emitter != NULL && !scene_lights_add_quadric(build->scene, i, emitter, arrays, err))
            return false;
    }
    return add_other_lights(build, arrays, err);
}

/* Hand a grown array to the scene's arena: *member and *count are the scene's */
static bool give(struct scene *scene, struct growing *array, size_t size, void **member,
                 uint32_t *count, struct err *err)
{
    if (array->count > UINT32_MAX - 1)
        return err_set(err, ERR_SCENE, "the scene has more than 2^32 of something");
    if (array->count == 0)
        return true;
    growing_trim(array, size);
    if (!arena_adopt(scene->arena, array->data, free))
        return no_memory(err);
    *member = array->data;
    *count = (uint32_t)array->count;
    *array = (struct growing){ 0 };
    return true;
}

#define GIVE(array, per, member, count)                                                          \
    give(scene, (array), (per) * sizeof(*scene->member), (void **)&scene->member, &scene->count, \
         err)

static bool place_all(struct scene_build *build, struct build_counts *counts, struct err *err)
{
    struct scene *scene = build->scene;
    struct scene_bounds bounds;
    if (!scene_groups_prepare(build, err) || !find_bounds(build, &bounds, err))
        return false;
    scene_bounds_center(&bounds, scene->settings.center);
    store_bounds(scene, &bounds);
    if (!place_camera(build, err))
        return false;
    place_textures(build);
    return place_meshes(build, counts, err) && place_quadrics(build, err) &&
           GIVE(&build->vertices.positions, 3, positions, vertex_count) &&
           GIVE(&build->vertices.normals, 3, normals, normal_count) &&
           GIVE(&build->vertices.uvs, 2, uvs, uv_count) &&
           GIVE(&build->vertices.colors, 4, colors, color_count) &&
           GIVE(&build->vertices.triangles, 3, triangles, triangle_count) &&
           GIVE(&build->materials, 1, materials, material_count) &&
           GIVE(&build->coat_tables, COAT_TABLE_LEN, coat_tables, coat_table_count) &&
           GIVE(&build->textures, 1, textures, texture_count) &&
           GIVE(&build->pictures, 1, pictures, picture_count) &&
           GIVE(&build->texels, TEXEL_BLOCK, texels, texel_block_count) &&
           GIVE(&build->environments, 1, environments, environment_count) &&
           GIVE(&build->media, 1, media, medium_count);
}

struct scene *scene_build_finish(struct scene_build *build, struct build_counts *counts,
                                 struct err *err)
{
    struct scene *scene = build->scene;
    struct light_arrays arrays = { 0 };
    *counts = (struct build_counts){ 0 };
    bool good = place_all(build, counts, err) && make_lights(build, &arrays, err) &&
                GIVE(&arrays.lights, 1, lights, light_count) &&
                GIVE(&arrays.corners, 3, light_corners, light_corner_count) &&
                GIVE(&arrays.triangle_light, 1, triangle_light, triangle_light_count) &&
                scene_lights_pick(scene, err) && scene_groups_finish(build, err) &&
                GIVE(&build->groups, 1, groups, group_count) &&
                GIVE(&build->group_names, 1, group_names, group_name_count) &&
                GIVE(&build->placed, 1, instances, instance_count) &&
                GIVE(&build->motions, 1, motions, motion_count);
    growing_free(&arrays.lights);
    growing_free(&arrays.corners);
    growing_free(&arrays.triangle_light);
    if (!good)
        return NULL;
    scene->settings.effects = scene_effects(scene);
    if (!scene_check(scene, err))
        return NULL;
    build->scene = NULL;
    return scene;
}
