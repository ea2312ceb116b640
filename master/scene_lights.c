#include "master/scene_lights.h"

#include "common/err.h"
#include "common/scene.h"
#include "master/scene_emission.h"
#include "master/vector.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI          3.14159265358979323846
#define LEAST_SHARE 1e-6 /* of all choices, divided among the lights, that a weak light keeps */

static bool fail(const struct emitter *emitter, enum err_code code, struct err *err,
                 const char *what)
{
    return err_set(err, code, "%s:%d:%d: %s", emitter->pos.path, emitter->pos.line,
                   emitter->pos.column, what);
}

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory for the scene's lights");
}

/* What the emitter sends per area and solid angle, from a piece of `area` */
static bool radiance_of(const struct emitter *emitter, double area, float radiance[3],
                        struct err *err)
{
    double sides = emitter->two_sided ? 2 : 1;
    if (emitter->whole_area > 0)
        area = emitter->whole_area;
    double scale = emitter->power > 0 ? emitter->power / (PI * sides * area) : 1;
    for (int c = 0; c < 3; c++) {
        radiance[c] = (float)(emitter->radiance[c] * scale);
        if (!isfinite(radiance[c]))
            return fail(emitter, ERR_SCENE, err, "the light's radiance is beyond float32");
    }
    return true;
}

static struct light *add_light(struct light_arrays *arrays, const struct light *light)
{
    struct light *added = growing_add(&arrays->lights, 1, sizeof(*added));
    if (added != NULL)
        *added = *light;
    return added;
}

/* --- Meshes ------------------------------------------------------------------------------- */

/* The emitting triangles of a mesh. Vertices at the same place have the same number here, so that
 * triangles are neighbours even where the file repeats their corners. */
struct patch {
    const struct scene *scene;
    uint32_t count;    /* triangles */
    uint32_t *corners; /* 3 per triangle: welded vertices */
    uint32_t *edges;   /* hash table of 3 * triangle + side */
    uint32_t edge_mask;
    uint32_t *owner; /* of a triangle: its light, or SCENE_NONE */
};

static uint32_t mix_bits(uint64_t key)
{
    key ^= key >> 33;
    key *= UINT64_C(0xff51afd7ed558ccd);
    key ^= key >> 33;
    return (uint32_t)(key ^ key >> 29);
}

static uint32_t table_size(uint32_t entries)
{
    uint32_t size = 8;
    while (size < entries + entries / 2)
        size *= 2;
    return size;
}

static struct vec vertex(const struct patch *patch, uint32_t index)
{
    const float *p = patch->scene->positions + 3 * (size_t)index;
    return (struct vec){ p[0], p[1], p[2] };
}

/* Number every corner by the first vertex found at its place */
static bool weld(struct patch *patch, const struct mesh *mesh)
{
    const struct scene *scene = patch->scene;
    const uint32_t *triangles = scene->triangles + 3 * (size_t)mesh->first_triangle;
    uint32_t entries = 3 * patch->count, mask = table_size(entries) - 1;
    uint32_t *table = malloc(((size_t)mask + 1) * sizeof(*table));
    if (table == NULL)
        return false;
    memset(table, 0xff, ((size_t)mask + 1) * sizeof(*table));
    for (uint32_t i = 0; i < entries; i++) {
        float place[3];
        for (int axis = 0; axis < 3; axis++) /* + 0: minus zero is zero */
            place[axis] = scene->positions[3 * (size_t)triangles[i] + (unsigned)axis] + 0.0f;
        uint32_t bits[3];
        memcpy(bits, place, sizeof(bits));
        uint32_t slot = mix_bits(bits[0] + (((uint64_t)bits[1] << 32) ^ bits[2]) * 3) & mask;
        for (; table[slot] != SCENE_NONE; slot = (slot + 1) & mask) {
            const float *other = scene->positions + 3 * (size_t)table[slot];
            if (other[0] == place[0] && other[1] == place[1] && other[2] == place[2])
                break;
        }
        if (table[slot] == SCENE_NONE)
            table[slot] = triangles[i];
        patch->corners[i] = table[slot];
    }
    free(table);
    return true;
}

static uint32_t edge_slot(const struct patch *patch, uint32_t from, uint32_t to)
{
    return mix_bits((uint64_t)from << 32 | to) & patch->edge_mask;
}

static uint32_t next_corner(uint32_t corner)
{
    return corner % 3 == 2 ? corner - 2 : corner + 1;
}

static void index_edges(struct patch *patch)
{
    memset(patch->edges, 0xff, ((size_t)patch->edge_mask + 1) * sizeof(*patch->edges));
    for (uint32_t corner = 0; corner < 3 * patch->count; corner++) {
        uint32_t slot = edge_slot(patch, patch->corners[corner],
                                  patch->corners[next_corner(corner)]);
        while (patch->edges[slot] != SCENE_NONE)
            slot = (slot + 1) & patch->edge_mask;
        patch->edges[slot] = corner;
    }
}

/* The corner that starts the edge `from`-`to` in a triangle that is still free; or SCENE_NONE */
static uint32_t free_neighbour(const struct patch *patch, uint32_t from, uint32_t to)
{
    uint32_t slot = edge_slot(patch, from, to);
    for (int tries = 0; tries < 64 && patch->edges[slot] != SCENE_NONE; tries++) {
        uint32_t corner = patch->edges[slot];
        if (patch->corners[corner] == from && patch->corners[next_corner(corner)] == to &&
            patch->owner[corner / 3] == SCENE_NONE)
            return corner;
        slot = (slot + 1) & patch->edge_mask;
    }
    return SCENE_NONE;
}

struct polygon {
    uint32_t corners[POLYGON_MAX];
    uint32_t count;
    struct vec normal; /* unit; the corners go around it counter-clockwise */
    double flatness;   /* distance from the plane that rounding explains */
    double area;
};

/* Does the way a, b, c turn left, clearly? */
static bool turns_left(const struct patch *patch, const struct polygon *polygon, uint32_t a,
                       uint32_t b, uint32_t c)
{
    struct vec ab = vec_sub(vertex(patch, b), vertex(patch, a));
    struct vec bc = vec_sub(vertex(patch, c), vertex(patch, b));
    return vec_dot(polygon->normal, vec_cross(ab, bc)) > 1e-5 * vec_length(ab) * vec_length(bc);
}

/* Can corner `added` go between corners i and i + 1, and the whole be convex and flat? */
static bool fits(const struct patch *patch, const struct polygon *polygon, uint32_t i,
                 uint32_t added)
{
    uint32_t n = polygon->count;
    uint32_t before = polygon->corners[(i + n - 1) % n], a = polygon->corners[i];
    uint32_t b = polygon->corners[(i + 1) % n], after = polygon->corners[(i + 2) % n];
    struct vec out = vec_sub(vertex(patch, added), vertex(patch, polygon->corners[0]));
    return fabs(vec_dot(out, polygon->normal)) <= polygon->flatness &&
           turns_left(patch, polygon, before, a, added) &&
           turns_left(patch, polygon, a, added, b) && turns_left(patch, polygon, added, b, after);
}

static double triangle_area(const struct patch *patch, uint32_t triangle, struct vec *normal)
{
    struct vec p[3];
    for (unsigned i = 0; i < 3; i++)
        p[i] = vertex(patch, patch->corners[3 * (size_t)triangle + i]);
    struct vec n = vec_cross(vec_sub(p[1], p[0]), vec_sub(p[2], p[0]));
    double twice = vec_length(n);
    *normal = (struct vec){ n.x / twice, n.y / twice, n.z / twice };
    return twice / 2;
}

static struct polygon start_polygon(const struct patch *patch, uint32_t triangle)
{
    struct polygon polygon = { .count = 3 };
    memcpy(polygon.corners, patch->corners + 3 * (size_t)triangle, 3 * sizeof(uint32_t));
    polygon.area = triangle_area(patch, triangle, &polygon.normal);
    double largest = 0;
    for (unsigned i = 0; i < 3; i++) {
        struct vec p = vertex(patch, polygon.corners[i]);
        largest = fmax(largest, fmax(fabs(p.x), fmax(fabs(p.y), fabs(p.z))));
    }
    polygon.flatness = 2.5e-7 * largest + 1e-6 * sqrt(polygon.area);
    return polygon;
}

static bool same_colour(const float a[3], const float b[3])
{
    for (int c = 0; c < 3; c++)
        if (fabsf(a[c] - b[c]) > 1e-5f * fabsf(a[c]))
            return false;
    return true;
}

/* Take free neighbours for as long as the polygon stays what a light can be */
static bool grow_polygon(struct patch *patch, const struct emitter *emitter, uint32_t light,
                         const float radiance[3], struct polygon *polygon, struct err *err)
{
    bool grown = true;
    while (grown && polygon->count < POLYGON_MAX) {
        grown = false;
        for (uint32_t i = 0; i < polygon->count && polygon->count < POLYGON_MAX; i++) {
            uint32_t next = (i + 1) % polygon->count;
            uint32_t corner = free_neighbour(patch, polygon->corners[next], polygon->corners[i]);
            if (corner == SCENE_NONE)
                continue;
            uint32_t added = patch->corners[next_corner(next_corner(corner))];
            struct vec normal;
            double area = triangle_area(patch, corner / 3, &normal);
            float other[3];
            if (!radiance_of(emitter, area, other, err))
                return false;
            if (!same_colour(radiance, other) || vec_dot(normal, polygon->normal) < 0.5 ||
                !fits(patch, polygon, i, added))
                continue;
            memmove(polygon->corners + i + 2, polygon->corners + i + 1,
                    (polygon->count - i - 1) * sizeof(uint32_t));
            polygon->corners[i + 1] = added;
            polygon->count++;
            polygon->area += area;
            patch->owner[corner / 3] = light;
            grown = true;
        }
    }
    return true;
}

/* Flags of what emits from a surface of this material */
static uint32_t light_flags(const struct emitter *emitter, uint32_t material)
{
    return (emitter->two_sided ? LIGHT_TWO_SIDED : 0) | (material == SCENE_NONE ? LIGHT_UNSEEN : 0);
}

/* A texture takes the place of the radiance, which scales it and then is its mean */
static bool set_texture(const struct emitter *emitter, const double mean[3], struct light *light,
                        struct err *err)
{
    light->texture = emitter->texture;
    light->texture_scale = light->radiance[0];
    for (int c = 0; c < 3; c++) {
        light->radiance[c] = (float)(mean[c] * (double)light->texture_scale);
        if (!isfinite(light->radiance[c]))
            return fail(emitter, ERR_SCENE, err, "the light's radiance is beyond float32");
    }
    return true;
}

static bool add_polygon(const struct patch *patch, const struct polygon *polygon,
                        const struct mesh *mesh, const struct emitter *emitter,
                        const float radiance[3], struct light_arrays *arrays, struct err *err)
{
    bool flip = mesh->flags & MESH_FLIP_NORMAL;
    struct light light = { .kind = LIGHT_POLYGON,
                           .flags = light_flags(emitter, mesh->material),
                           .area = (float)polygon->area,
                           .first_corner = (uint32_t)arrays->corners.count,
                           .corner_count = polygon->count,
                           .quadric = SCENE_NONE };
    memcpy(light.radiance, radiance, sizeof(light.radiance));
    double side = flip ? -1 : 1;
    light.normal[0] = (float)(side * polygon->normal.x);
    light.normal[1] = (float)(side * polygon->normal.y);
    light.normal[2] = (float)(side * polygon->normal.z);

    float *corners = growing_add(&arrays->corners, polygon->count, 3 * sizeof(float));
    if (corners == NULL || add_light(arrays, &light) == NULL)
        return no_memory(err);
    double middle[3] = { 0, 0, 0 };
    for (uint32_t i = 0; i < polygon->count; i++) {
        uint32_t index = polygon->corners[flip ? polygon->count - 1 - i : i];
        memcpy(corners + 3 * (size_t)i, patch->scene->positions + 3 * (size_t)index,
               3 * sizeof(float));
        for (unsigned axis = 0; axis < 3; axis++)
            middle[axis] += corners[3 * (size_t)i + axis];
    }
    struct light *added = (struct light *)arrays->lights.data + arrays->lights.count - 1;
    for (int axis = 0; axis < 3; axis++)
        added->position[axis] = (float)(middle[axis] / polygon->count);
    return true;
}

/* The mean of the emitter's texture over a triangle; false where it is black */
static bool mean_over(const struct scene *scene, const struct mesh *mesh,
                      const struct emitter *emitter, uint32_t triangle, struct light_arrays *arrays,
                      double mean[3])
{
    static const double default_uv[3][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 } }; /* pbrt's */
    const uint32_t *corner = scene->triangles + 3 * ((size_t)mesh->first_triangle + triangle);
    double uv[3][2];
    memcpy(uv, default_uv, sizeof(uv));
    for (int i = 0; (mesh->flags & MESH_UVS) && i < 3; i++)
        for (size_t k = 0; k < 2; k++)
            uv[i][k] = (double)scene->uvs[2 * (size_t)(corner[i] + mesh->uv_shift) + k];
    double budget = SCENE_EMISSION_BUDGET - arrays->looks_taken;
    bool shines = scene_emission_triangle(scene, emitter->texture - 1, (const double(*)[2])uv,
                                          &budget, mean);
    arrays->looks_taken = SCENE_EMISSION_BUDGET - budget;
    return shines;
}

/* Every triangle by itself, as what it emits changes over it, or how much of it is there */
static bool add_triangles(struct patch *patch, const struct mesh *mesh,
                          const struct emitter *emitter, struct light_arrays *arrays,
                          struct err *err)
{
    for (uint32_t triangle = 0; triangle < patch->count; triangle++) {
        struct polygon polygon = start_polygon(patch, triangle);
        uint32_t light = (uint32_t)arrays->lights.count;
        float radiance[3];
        double mean[3];
        if (emitter->texture != 0 &&
            !mean_over(patch->scene, mesh, emitter, triangle, arrays, mean))
            continue;
        patch->owner[triangle] = light;
        if (!radiance_of(emitter, polygon.area, radiance, err) ||
            !add_polygon(patch, &polygon, mesh, emitter, radiance, arrays, err))
            return false;
        if (emitter->texture != 0 &&
            !set_texture(emitter, mean, (struct light *)arrays->lights.data + light, err))
            return false;
    }
    return true;
}

static bool add_polygons(struct patch *patch, const struct mesh *mesh,
                         const struct emitter *emitter, struct light_arrays *arrays,
                         struct err *err)
{
    if (emitter->texture != 0 || mesh->alpha != 0)
        return add_triangles(patch, mesh, emitter, arrays, err);
    for (uint32_t triangle = 0; triangle < patch->count; triangle++) {
        if (patch->owner[triangle] != SCENE_NONE)
            continue;
        uint32_t light = (uint32_t)arrays->lights.count;
        struct polygon polygon = start_polygon(patch, triangle);
        float radiance[3];
        patch->owner[triangle] = light;
        if (!radiance_of(emitter, polygon.area, radiance, err) ||
            !grow_polygon(patch, emitter, light, radiance, &polygon, err) ||
            !add_polygon(patch, &polygon, mesh, emitter, radiance, arrays, err))
            return false;
    }
    return true;
}

bool scene_lights_add_mesh(struct scene *scene, uint32_t index, const struct emitter *emitter,
                           struct light_arrays *arrays, struct err *err)
{
    struct mesh *mesh = &scene->meshes[index];
    if (mesh->triangle_count == 0)
        return fail(emitter, ERR_SCENE, err, "this light has no area");
    if (mesh->triangle_count > UINT32_MAX / 8)
        return fail(emitter, ERR_SCENE, err, "this light has too many triangles");

    struct patch patch = { .scene = scene, .count = mesh->triangle_count };
    size_t entries = 3 * (size_t)patch.count;
    patch.edge_mask = table_size((uint32_t)entries) - 1;
    patch.corners = malloc(entries * sizeof(uint32_t));
    patch.edges = malloc(((size_t)patch.edge_mask + 1) * sizeof(uint32_t));
    mesh->first_emissive = (uint32_t)arrays->triangle_light.count;
    patch.owner = growing_add(&arrays->triangle_light, patch.count, sizeof(uint32_t));
    bool good = patch.corners != NULL && patch.edges != NULL && patch.owner != NULL &&
                weld(&patch, mesh);
    if (!good) {
        no_memory(err);
    } else {
        memset(patch.owner, 0xff, patch.count * sizeof(uint32_t));
        index_edges(&patch);
        good = add_polygons(&patch, mesh, emitter, arrays, err);
    }
    free(patch.corners);
    free(patch.edges);
    return good;
}

/* --- Quadrics ----------------------------------------------------------------------------- */

bool scene_lights_add_quadric(struct scene *scene, uint32_t index, const struct emitter *emitter,
                              struct light_arrays *arrays, struct err *err)
{
    struct quadric *quadric = &scene->quadrics[index];
    if ((quadric->flags & QUADRIC_PARTIAL) || !(quadric->flags & QUADRIC_SIMILARITY))
        return fail(emitter, ERR_UNSUPPORTED, err,
                    "light from a cut or stretched sphere or disk is not supported yet");
    bool sphere = quadric->kind == QUADRIC_SPHERE;
    double r = quadric->world_radius, area = (sphere ? 4 : 1) * PI * r * r;
    if (!((float)area > 0))
        return fail(emitter, ERR_SCENE, err, "this light has no area");
    struct light light = { .kind = sphere ? LIGHT_SPHERE : LIGHT_DISK,
                           .flags = light_flags(emitter, quadric->material),
                           .area = (float)area,
                           .quadric = index };
    memcpy(light.position, quadric->center, sizeof(light.position));
    if (!sphere) {
        /* The normal is the last row of the inverse, by its transpose */
        const float *n = quadric->to_object + 6;
        double scale = sqrt((double)n[0] * n[0] + (double)n[1] * n[1] + (double)n[2] * n[2]);
        double side = quadric->flags & QUADRIC_FLIP_NORMAL ? -1 : 1;
        for (int axis = 0; axis < 3; axis++)
            light.normal[axis] = (float)(side * n[axis] / scale);
    }
    if (!radiance_of(emitter, area, light.radiance, err))
        return false;
    if (emitter->texture != 0) {
        double mean[3];
        scene_emission_quadric(scene, emitter->texture - 1, quadric, mean);
        if (!set_texture(emitter, mean, &light, err))
            return false;
    }
    quadric->light = (uint32_t)arrays->lights.count;
    return add_light(arrays, &light) != NULL || no_memory(err);
}

/* --- Portals ------------------------------------------------------------------------------ */

bool scene_lights_add_portal(struct light *sky, const double corners[4][3],
                             struct light_arrays *arrays, struct err *err)
{
    struct vec corner = vec_at(corners[0]);
    struct vec n = vec_cross(vec_sub(vec_at(corners[1]), corner),
                             vec_sub(vec_at(corners[3]), corner));
    double area = vec_length(n);
    sky->first_corner = (uint32_t)arrays->corners.count;
    sky->corner_count = 4;
    sky->area = (float)area;
    sky->normal[0] = (float)(n.x / area);
    sky->normal[1] = (float)(n.y / area);
    sky->normal[2] = (float)(n.z / area);
    float *to = growing_add(&arrays->corners, 4, 3 * sizeof(float));
    for (int i = 0; to != NULL && i < 12; i++)
        to[i] = (float)corners[i / 3][i % 3];
    return to != NULL || no_memory(err);
}

/* --- Choosing ----------------------------------------------------------------------------- */

static double luminance(const float rgb[3])
{
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

/* Watts, more or less: comparable between kinds */
static double power_of(const struct light *light, double scene_radius)
{
    double bright = luminance(light->radiance);
    switch (light->kind) {
    case LIGHT_POINT:
        return 4 * PI * bright;
    case LIGHT_SPOT:
        return 2 * PI * bright *
               (1 - ((double)light->cos_falloff_start + light->cos_falloff_end) / 2);
    case LIGHT_DISTANT:
        return PI * scene_radius * scene_radius * bright;
    case LIGHT_SKY:
        if (light->corner_count != 0)
            return PI * (double)light->area * bright;
        return 4 * PI * PI * scene_radius * scene_radius * bright;
    default:
        return PI * light->area * bright * (light->flags & LIGHT_TWO_SIDED ? 2 : 1);
    }
}

bool scene_lights_pick(struct scene *scene, struct err *err)
{
    uint32_t count = scene->light_count;
    if (count == 0)
        return true;
    double *share = malloc(count * sizeof(*share));
    if (share == NULL)
        return no_memory(err);
    double diagonal2 = 0, all = 0, kept = 0;
    for (int axis = 0; axis < 3; axis++) {
        double side = (double)scene->settings.bounds_max[axis] - scene->settings.bounds_min[axis];
        diagonal2 += side * side;
    }
    double radius = diagonal2 > 0 ? sqrt(diagonal2) / 2 : 1;
    for (uint32_t i = 0; i < count; i++)
        all += share[i] = power_of(&scene->lights[i], radius);
    for (uint32_t i = 0; i < count; i++) {
        share[i] = all > 0 ? fmax(share[i] / all, LEAST_SHARE / count) : 1;
        kept += share[i];
    }
    for (uint32_t i = 0; i < count; i++)
        scene->lights[i].pick = (float)(share[i] / kept);
    free(share);
    return true;
}
