/*
 * Small scenes in code, for tests of the kernels, and their pictures without a farm. Every polygon
 * is a mesh of its own. Out of memory ends the process: nothing can be tested then.
 *
 *   struct scene *scene = scenes_begin(width, height);
 *   scenes_quad(scene, corners, scenes_diffuse(scene, 0.5f), Le) ...
 *   scenes_finish(scene);
 *   struct picture *picture = picture_take(scene, (struct picture_how){ .samples = 16 });
 *
 * The kernel has no switches for tests. What a test wants otherwise, a planted bug or one of two
 * techniques alone, it brings about in the data: in the scene, or in the opened one by `alter`.
 */
#ifndef TESTS_KERNEL_SCENES_H
#define TESTS_KERNEL_SCENES_H

#include "common/arena.h"
#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "worker/kernel/instance.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define SCENES_CAPACITY 4096 /* of every array */

/* An empty scene with a camera at the origin that looks along +z, 90 degrees wide */
static inline struct scene *scenes_begin(uint32_t width, uint32_t height)
{
    struct scene *scene = scene_new();
    if (scene == NULL)
        abort();
#define X(member, count, type, per)                                                           \
    scene->member = arena_alloc(scene->arena, (size_t)SCENES_CAPACITY * (per), sizeof(type)); \
    if (scene->member == NULL)                                                                \
        abort();
    SCENE_ARRAYS(X)
#undef X
    for (uint32_t i = 0; i < 3 * SCENES_CAPACITY; i++) /* whoever reads past the last is seen */
        scene->light_corners[i] = 7 + (float)(i % 5);
    scene->settings.width = scene->settings.crop[1] = width;
    scene->settings.height = scene->settings.crop[3] = height;
    return scene;
}

static inline uint32_t scenes_material(struct scene *scene, struct material material)
{
    scene->materials[scene->material_count] = material;
    return scene->material_count++;
}

static inline uint32_t scenes_diffuse(struct scene *scene, float rho)
{
    return scenes_material(scene, (struct material){ .reflectance = { rho, rho, rho } });
}

static inline uint32_t scenes_light(struct scene *scene, struct light light)
{
    scene->lights[scene->light_count] = light;
    return scene->light_count++;
}

/* `count` corners, counter-clockwise seen from the side of the normal; emits there when Le > 0 */
static inline uint32_t scenes_polygon(struct scene *scene, const float (*corners)[3],
                                      uint32_t count, uint32_t material, float Le)
{
    uint32_t first = scene->vertex_count;
    memcpy(scene->positions + 3 * first, corners, count * 3 * sizeof(float));
    scene->vertex_count += count;
    struct mesh *mesh = &scene->meshes[scene->mesh_count++];
    *mesh = (struct mesh){ .first_triangle = scene->triangle_count,
                           .triangle_count = count - 2,
                           .first_vertex = first,
                           .vertex_count = count,
                           .material = material,
                           .first_emissive = SCENE_NONE };
    double normal[3] = { 0, 0, 0 };
    for (uint32_t i = 2; i < count; i++) {
        uint32_t *t = scene->triangles + 3 * scene->triangle_count++;
        t[0] = first;
        t[1] = first + i - 1;
        t[2] = first + i;
        double e[2][3];
        for (int axis = 0; axis < 3; axis++)
            for (int k = 0; k < 2; k++)
                e[k][axis] = (double)corners[(int)i - 1 + k][axis] - (double)corners[0][axis];
        for (int axis = 0; axis < 3; axis++)
            normal[axis] += e[0][(axis + 1) % 3] * e[1][(axis + 2) % 3] -
                            e[0][(axis + 2) % 3] * e[1][(axis + 1) % 3];
    }
    if (!(Le > 0 || isnan(Le)))
        return scene->mesh_count - 1;
    double twice = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    struct light light = { .kind = LIGHT_POLYGON,
                           .radiance = { Le, Le, Le },
                           .area = (float)(twice / 2),
                           .first_corner = scene->light_corner_count,
                           .corner_count = count };
    for (int axis = 0; axis < 3; axis++)
        light.normal[axis] = (float)(normal[axis] / twice);
    memcpy(scene->light_corners + 3 * scene->light_corner_count, corners,
           count * 3 * sizeof(float));
    scene->light_corner_count += count;
    mesh->first_emissive = scene->triangle_light_count;
    for (uint32_t i = 2; i < count; i++)
        scene->triangle_light[scene->triangle_light_count++] = scene->light_count;
    scenes_light(scene, light);
    return scene->mesh_count - 1;
}

static inline void scenes_quad(struct scene *scene, const float (*corners)[3], uint32_t material,
                               float Le)
{
    scenes_polygon(scene, corners, 4, material, Le);
}

/* The axis-parallel box from a to b, seen from inside; every wall emits Le */
static inline void scenes_box(struct scene *scene, const float a[3], const float b[3],
                              uint32_t material, float Le)
{
    for (int axis = 0; axis < 3; axis++)
        for (int side = 0; side < 2; side++) {
            int u = (axis + 1) % 3, v = (axis + 2) % 3;
            float corners[4][3];
            for (int i = 0; i < 4; i++) {
                int k = side ? 3 - i : i; /* the other way round at the far side */
                corners[i][axis] = side ? b[axis] : a[axis];
                corners[i][u] = k == 1 || k == 2 ? b[u] : a[u];
                corners[i][v] = k >= 2 ? b[v] : a[v];
            }
            scenes_quad(scene, (const float(*)[3])corners, material, Le);
        }
}

/* A box about the origin with one small light below its ceiling, seen from near its back wall */
static inline void scenes_room(struct scene *scene, uint32_t wall, uint32_t lamp)
{
    static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };
    static const float corners[4][3] = { { -0.3f, 0.95f, -0.3f },
                                         { 0.3f, 0.95f, -0.3f },
                                         { 0.3f, 0.95f, 0.3f },
                                         { -0.3f, 0.95f, 0.3f } };
    scene->settings.camera.position[2] = -0.9f;
    scenes_box(scene, low, high, wall, 0);
    scenes_quad(scene, corners, lamp, 4);
}

static inline struct quadric *scenes_quadric(struct scene *scene, uint32_t kind, float x, float y,
                                             float z, float radius, uint32_t material, float Le)
{
    struct quadric *q = &scene->quadrics[scene->quadric_count];
    *q = (struct quadric){ .kind = kind,
                           .flags = QUADRIC_SIMILARITY,
                           .center = { x, y, z },
                           .radius = radius,
                           .z_min = -radius,
                           .z_max = radius,
                           .phi_max = 7,
                           .world_radius = radius,
                           .material = material,
                           .light = SCENE_NONE };
    for (int i = 0; i < 9; i += 4)
        q->to_world[i] = q->to_object[i] = 1;
    if (Le > 0) {
        double area = M_PI * (double)radius * (double)radius * (kind == QUADRIC_SPHERE ? 4 : 1);
        q->light = scenes_light(
            scene, (struct light){ .kind = kind == QUADRIC_SPHERE ? LIGHT_SPHERE : LIGHT_DISK,
                                   .radiance = { Le, Le, Le },
                                   .normal = { 0, 0, 1 },
                                   .area = (float)area,
                                   .quadric = scene->quadric_count });
    }
    scene->quadric_count++;
    return q;
}

static inline void scenes_sky(struct scene *scene, float L)
{
    for (int i = 0; i < 3; i++)
        scene->settings.sky[i] = L;
    scene->settings.sky_light = scenes_light(scene, (struct light){ .kind = LIGHT_SKY });
}

/* ---- groups, instances, motion */

/* Row-major inverse of the affine map, in double */
static inline void scenes_invert(const double m[3][4], double out[3][4])
{
    double det = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            out[i][j] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    for (int i = 0; i < 3; i++)
        det += m[0][i] * out[i][0];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[i][j] /= det;
    for (int i = 0; i < 3; i++)
        out[i][3] = -(out[i][0] * m[0][3] + out[i][1] * m[1][3] + out[i][2] * m[2][3]);
}

/* From here on shapes belong to a group */
static inline void scenes_group_begin(struct scene *scene)
{
    scene->groups[scene->group_count++] = (struct group){ .first_mesh = scene->mesh_count,
                                                          .first_quadric = scene->quadric_count };
}

static inline void scenes_group_end(struct scene *scene)
{
    struct group *group = &scene->groups[scene->group_count - 1];
    group->mesh_count = scene->mesh_count - group->first_mesh;
    group->quadric_count = scene->quadric_count - group->first_quadric;
}

/* One more instance of a group */
static inline struct instance *scenes_place(struct scene *scene, uint32_t group,
                                            const double m[3][4])
{
    struct instance *instance = &scene->instances[scene->instance_count++];
    double inverse[3][4];
    scenes_invert(m, inverse);
    *instance = (struct instance){ .group = group };
    for (int i = 0; i < 12; i++) {
        instance->to_world[i] = (float)m[i / 4][i % 4];
        instance->to_object[i] = (float)inverse[i / 4][i % 4];
        scene->settings.bounds_max[i % 3] = 100;
    }
    return instance;
}

/* A motion along a straight line; 1 + its index */
static inline uint32_t scenes_glide(struct scene *scene, float x, float y, float z)
{
    struct motion *motion = &scene->motions[scene->motion_count++];
    *motion = (struct motion){ .translation[1] = { x, y, z } };
    for (int end = 0; end < 2; end++) {
        motion->rotation[end][3] = 1;
        for (int i = 0; i < 9; i += 4)
            motion->stretch[end][i] = 1;
    }
    return scene->motion_count;
}

/* Lights that have no probability yet share it evenly; bounds and the effect mask follow */
static inline void scenes_finish(struct scene *scene)
{
    struct scene_settings *s = &scene->settings;
    for (uint32_t i = 0; i < scene->light_count; i++)
        if (!(scene->lights[i].pick > 0))
            scene->lights[i].pick = 1 / (float)scene->light_count;
    for (uint32_t i = 0; i < 3 * scene->vertex_count; i++) {
        s->bounds_min[i % 3] = fminf(s->bounds_min[i % 3], scene->positions[i]);
        s->bounds_max[i % 3] = fmaxf(s->bounds_max[i % 3], scene->positions[i]);
    }
    for (uint32_t i = 0; i < scene->quadric_count; i++)
        for (int axis = 0; axis < 3; axis++) {
            const struct quadric *q = &scene->quadrics[i];
            s->bounds_min[axis] = fminf(s->bounds_min[axis], q->center[axis] - q->radius);
            s->bounds_max[axis] = fmaxf(s->bounds_max[axis], q->center[axis] + q->radius);
        }
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        s->has_normals |= scene->meshes[i].flags & MESH_NORMALS;
    s->effects = scene_effects(scene);
}

/* ---- rays */

/* The nearest hits of eight rays between tnear and tfar, as the path kernel resolves them */
struct scenes_hit {
    i8 hit, geometry, prim, instance; /* instance: -1 outside of them */
    f8 t;
};

static inline struct scenes_hit scenes_intersect(const struct kernel_scene *ks, struct vec3x8 o,
                                                 struct vec3x8 d, float tnear, float tfar, f8 time)
{
    _Alignas(32) int32_t valid[LANES];
    struct RTCRayHit8 ray;
    memset(&ray, 0, sizeof(ray));
    i8_store(valid, I8(-1));
    f8_store(ray.ray.org_x, o.x);
    f8_store(ray.ray.org_y, o.y);
    f8_store(ray.ray.org_z, o.z);
    f8_store(ray.ray.dir_x, d.x);
    f8_store(ray.ray.dir_y, d.y);
    f8_store(ray.ray.dir_z, d.z);
    f8_store(ray.ray.tnear, F8(tnear));
    f8_store(ray.ray.tfar, F8(tfar));
    f8_store(ray.ray.time, time);
    i8_store(ray.ray.mask, I8(-1));
    i8_store(ray.hit.geomID, I8(-1));
    i8_store(ray.hit.instID[0], I8(-1));
    rtc_intersect8(valid, ks->rtc, &ray);
    struct scenes_hit found = { .geometry = i8_load(ray.hit.geomID),
                                .prim = i8_load(ray.hit.primID),
                                .instance = i8_load(ray.hit.instID[0]),
                                .t = f8_load(ray.ray.tfar) };
    found.hit = found.geometry != -1;
    i8 inside = instance_resolve(ks, found.hit, found.instance, &found.geometry, &found.prim);
    found.instance = i8_select(inside, found.instance, I8(-1));
    return found;
}

/* ---- pictures */

struct picture_how {
    uint32_t samples;   /* per leaf, a power of two; 0: 16 */
    uint32_t leaves;    /* 0: 1 */
    uint32_t lanes;     /* 0: 8 */
    uint32_t depth_cap; /* 0: 65536 */
    uint32_t kernel;    /* 1: "everything" */
    uint32_t techniques_off;
    uint64_t seed;
    void (*alter)(struct kernel_scene *ks); /* NULL, or what is changed in the opened scene */
};

struct picture {
    uint32_t width, height; /* of the crop window */
    float *rgb;             /* sums of the last leaf, three floats a pixel, top row first */
    double mean, variance;  /* of the red channel: of all pixels, and between leaves' pixels */
    double pixels;          /* how many went into the mean: its variance is variance / pixels */
    double largest;
    unsigned failed; /* pixels that lost a sample */
    struct node_stats stats;
    char variant[32];
};

static inline struct kernel_scene *scenes_open(const struct scene *scene, struct picture_how how)
{
    struct err err = { .code = ERR_OK };
    struct job_spec spec = { .seed = how.seed + 1,
                             .replicates = 1,
                             .channel_count = 3,
                             .leaf_samples = how.samples ? how.samples : 16,
                             .planned_samples = 0,
                             .kernel = how.kernel,
                             .techniques_off = how.techniques_off,
                             .depth_cap = how.depth_cap ? how.depth_cap : 65536,
                             .max_lanes = how.lanes ? how.lanes : 8 };
    profile_thread_mode();
    struct kernel_scene *ks = kernel_open(scene, &spec, &err);
    if (ks == NULL) {
        fprintf(stderr, "%s\n", err.text);
        abort();
    }
    if (how.alter != NULL)
        how.alter(ks);
    return ks;
}

static inline struct picture *picture_take(const struct scene *scene, struct picture_how how)
{
    struct err err = { .code = ERR_OK };
    struct kernel_scene *ks = scenes_open(scene, how);
    struct kernel_thread *thread = kernel_thread_open(ks, &err);
    struct picture *p = calloc(1, sizeof(*p));
    if (thread == NULL || p == NULL)
        abort();
    const uint32_t *crop = scene->settings.crop;
    p->width = crop[1] - crop[0];
    p->height = crop[3] - crop[2];
    p->rgb = calloc((size_t)p->width * p->height * 3, sizeof(float));
    if (p->rgb == NULL)
        abort();
    snprintf(p->variant, sizeof(p->variant), "%s", ks->variant);
    double sum = 0, squares = 0, n = 0;
    for (uint32_t leaf = 0; leaf < (how.leaves ? how.leaves : 1); leaf++)
        for (uint32_t tile = 0; tile < tile_count(scene); tile++) {
            struct tile_rect rect = tile_rect(scene, tile);
            struct node_sums *sums = node_sums_new(rect.width * rect.height, 3);
            if (sums == NULL || !kernel_leaf(ks, thread, tile, 0, leaf, sums, &err))
                abort();
            node_stats_add(&p->stats, &sums->stats);
            for (uint32_t i = 0; i < sums->pixel_count; i++) {
                double value = (double)sums->values[i] / ks->spec.leaf_samples;
                sum += value;
                squares += value * value;
                n++;
                p->largest = fmax(p->largest, value);
                p->failed += sums->failed[i / 32] >> i % 32 & 1;
                uint32_t x = rect.x - crop[0] + i % rect.width,
                         y = rect.y - crop[2] + i / rect.width;
                for (uint32_t c = 0; c < 3; c++)
                    p->rgb[3 * ((size_t)y * p->width + x) + c] =
                        sums->values[c * sums->pixel_count + i];
            }
            node_sums_free(sums);
        }
    p->pixels = n;
    p->mean = sum / n;
    p->variance = fmax(squares / n - p->mean * p->mean, 0) * n / fmax(n - 1, 1);
    kernel_thread_close(thread);
    kernel_close(ks);
    return p;
}

static inline void picture_free(struct picture *p)
{
    if (p != NULL)
        free(p->rgb);
    free(p);
}

/* Standard errors between the picture's mean and `want`, where all pixels see the same */
static inline double picture_z(const struct picture *p, double want)
{
    return fabs(p->mean - want) / (sqrt(p->variance / p->pixels) + 1e-6 * fabs(want) + 1e-30);
}

static inline bool picture_same(const struct picture *a, const struct picture *b)
{
    return a->width == b->width && a->height == b->height &&
           memcmp(a->rgb, b->rgb, (size_t)a->width * a->height * 3 * sizeof(float)) == 0;
}

/* One lane or three instead of eight, and lanes of two halves, give the bits of `want` */
static inline void picture_expect_any_lanes(const struct scene *scene, const struct picture *want,
                                            uint32_t samples)
{
    for (uint32_t lanes = 1; lanes <= 3; lanes += 2) {
        struct picture *p = picture_take(
            scene, (struct picture_how){ .samples = samples, .lanes = lanes });
        if (!picture_same(want, p))
            fail_msg("%s: %u lanes give different bits", p->variant, lanes);
        picture_free(p);
    }
    setenv("PATHFARM_LANES", "base", 1);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = samples });
    unsetenv("PATHFARM_LANES");
    if (!picture_same(want, p))
        fail_msg("%s: without AVX2 the bits are different", p->variant);
    picture_free(p);
}

#endif
