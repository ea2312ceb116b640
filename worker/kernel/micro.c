#include "worker/kernel/micro.h"

#include "common/arena.h"
#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "proto/digest.h"
#include "worker/kernel/kernel.h"

#include <math.h>
#include <string.h>

enum { WHITE, SHINY, METAL, GLASS, COATED, BLEND, MATERIALS };
enum { CEILING, BALL, WINDOW, LAMP, SUN, LIGHTS };
enum { BOX_TRIANGLES = 12, LIGHT_TRIANGLES = 2, FAN_TRIANGLES = 48 };
enum { TRIANGLES = BOX_TRIANGLES + LIGHT_TRIANGLES + FAN_TRIANGLES };
enum { BOX_VERTICES = 8, LIGHT_VERTICES = 4, FAN_VERTICES = FAN_TRIANGLES + 2 };
enum { VERTICES = BOX_VERTICES + LIGHT_VERTICES + FAN_VERTICES };

static void set3(float *to, float x, float y, float z)
{
    to[0] = x;
    to[1] = y;
    to[2] = z;
}

static void materials_fill(struct material *m)
{
    for (int i = 0; i < MATERIALS; i++) {
        set3(m[i].reflectance, 0.7f, 0.5f, 0.3f);
        m[i].ior = 1.5f;
    }
    m[WHITE].kind = MATERIAL_DIFFUSE;
    m[SHINY].kind = MATERIAL_MIXTURE;
    set3(m[SHINY].specular, 0.2f, 0.3f, 0.25f);
    m[METAL].kind = MATERIAL_CONDUCTOR;
    set3(m[METAL].eta, 0.2f, 0.9f, 1.1f);
    set3(m[METAL].k, 3.9f, 2.4f, 2.1f);
    m[METAL].alpha[0] = m[METAL].alpha[1] = 0.2f;
    m[GLASS].kind = MATERIAL_DIELECTRIC;
    m[GLASS].alpha[0] = m[GLASS].alpha[1] = 0.1f;
    m[COATED].kind = MATERIAL_COAT;
    m[COATED].alpha[0] = m[COATED].alpha[1] = 0.05f;
    m[COATED].coat_inner = 0.6f;
    m[COATED].coat_scale = 0.14f;
    m[BLEND].kind = MATERIAL_MIX;
    m[BLEND].mix[0] = SHINY;
    m[BLEND].mix[1] = COATED;
    m[BLEND].mix_amount = 0.4f;
}

static void quadric_fill(struct quadric *q, uint32_t kind, const float center[3], float radius,
                         uint32_t material, uint32_t light)
{
    q->kind = kind;
    q->flags = QUADRIC_SIMILARITY;
    memcpy(q->center, center, sizeof(q->center));
    for (int i = 0; i < 9; i += 4)
        q->to_world[i] = q->to_object[i] = 1;
    q->radius = q->world_radius = radius;
    q->z_min = -radius;
    q->z_max = radius;
    q->phi_max = 7;
    q->material = material;
    q->light = light;
}

static void lights_fill(struct scene *scene)
{
    struct light *l = scene->lights;
    for (int i = 0; i < LIGHTS; i++) {
        set3(l[i].radiance, 3, 4, 5);
        set3(l[i].direction, 0, -1, 0);
        set3(l[i].normal, 0, -1, 0);
        set3(l[i].position, 0.3f, 0.2f, -0.4f);
        l[i].pick = 1.0f / LIGHTS;
    }
    l[CEILING].kind = LIGHT_POLYGON;
    l[CEILING].area = 0.25f;
    l[CEILING].corner_count = LIGHT_VERTICES;
    l[BALL].kind = LIGHT_SPHERE;
    l[BALL].quadric = 0;
    l[BALL].area = 12.566371f * 0.01f;
    l[WINDOW].kind = LIGHT_DISK;
    l[WINDOW].quadric = 1;
    l[WINDOW].area = 3.1415927f * 0.04f;
    set3(l[WINDOW].normal, 0, 0, 1);
    l[LAMP].kind = LIGHT_SPOT;
    l[LAMP].cos_falloff_start = 0.9f;
    l[LAMP].cos_falloff_end = 0.5f;
    l[SUN].kind = LIGHT_DISTANT;
    scene->light_corner_count = LIGHT_VERTICES;
    memcpy(scene->light_corners, scene->positions + 3 * BOX_VERTICES,
           LIGHT_VERTICES * 3 * sizeof(float));
}

/* A unit box, open towards the camera by its corner-on view, a light below its top, and a fan with
 * sharp edges and smooth normals in its middle */
static void geometry_fill(struct scene *scene)
{
    float *P = scene->positions;
    for (int i = 0; i < BOX_VERTICES; i++)
        set3(P + 3 * i, i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
    static const uint32_t box[BOX_TRIANGLES * 3] = { 0, 1, 3, 0, 3, 2, 4, 7, 5, 4, 6, 7,
                                                     0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6,
                                                     0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3 };
    memcpy(scene->triangles, box, sizeof(box));

    float *light = P + 3 * BOX_VERTICES;
    for (int i = 0; i < LIGHT_VERTICES; i++)
        set3(light + 3 * i, i == 1 || i == 2 ? 0.25f : -0.25f, 0.97f, i >= 2 ? 0.25f : -0.25f);
    uint32_t *T = scene->triangles + 3 * BOX_TRIANGLES;
    const uint32_t b = BOX_VERTICES;
    const uint32_t quad[6] = { b, b + 1, b + 2, b, b + 2, b + 3 };
    memcpy(T, quad, sizeof(quad));

    uint32_t center = BOX_VERTICES + LIGHT_VERTICES;
    set3(P + 3 * center, 0.1f, -0.2f, 0.05f);
    set3(scene->normals, 0, 1, 0);
    T += 3 * LIGHT_TRIANGLES;
    float x = 0.6f, z = 0;
    for (uint32_t i = 0; i <= FAN_TRIANGLES; i++) {
        uint32_t vertex = center + 1 + i;
        set3(P + 3 * vertex, x, -0.5f + 0.1f * (float)(i % 3), z);
        set3(scene->normals + 3 * (i + 1), x, 0.8f, z);
        /* Rotate by about a 24th of a turn */
        float next = x * 0.9659258f - z * 0.2588190f;
        z = x * 0.2588190f + z * 0.9659258f;
        x = next;
        if (i < FAN_TRIANGLES) {
            const uint32_t triangle[3] = { center, vertex, vertex + 1 };
            memcpy(T + 3 * i, triangle, sizeof(triangle));
        }
    }

    static const struct mesh meshes[3] = {
        { .triangle_count = BOX_TRIANGLES,
          .vertex_count = BOX_VERTICES,
          .material = BLEND,
          .first_emissive = SCENE_NONE },
        { .first_triangle = BOX_TRIANGLES,
          .triangle_count = LIGHT_TRIANGLES,
          .first_vertex = BOX_VERTICES,
          .vertex_count = LIGHT_VERTICES,
          .material = WHITE,
          .flags = MESH_FLIP_NORMAL },
        { .first_triangle = BOX_TRIANGLES + LIGHT_TRIANGLES,
          .triangle_count = FAN_TRIANGLES,
          .first_vertex = BOX_VERTICES + LIGHT_VERTICES,
          .vertex_count = FAN_VERTICES,
          .normal_shift = 0u - (BOX_VERTICES + LIGHT_VERTICES),
          .material = COATED,
          .first_emissive = SCENE_NONE,
          .flags = MESH_NORMALS },
    };
    memcpy(scene->meshes, meshes, sizeof(meshes));
    quadric_fill(&scene->quadrics[0], QUADRIC_SPHERE, (float[3]){ -0.5f, 0.4f, 0.2f }, 0.1f, WHITE,
                 BALL);
    quadric_fill(&scene->quadrics[1], QUADRIC_DISK, (float[3]){ 0.2f, 0.1f, -0.9f }, 0.2f, WHITE,
                 WINDOW);
    quadric_fill(&scene->quadrics[2], QUADRIC_SPHERE, (float[3]){ 0.4f, 0, 0.3f }, 0.3f, GLASS,
                 SCENE_NONE);
    quadric_fill(&scene->quadrics[3], QUADRIC_SPHERE, (float[3]){ -0.4f, -0.3f, -0.3f }, 0.25f,
                 METAL, SCENE_NONE);
}

static struct scene *micro_scene(void)
{
    struct scene *scene = scene_new();
    if (scene == NULL)
        return NULL;
    scene->vertex_count = VERTICES;
    scene->normal_count = FAN_VERTICES;
    scene->triangle_count = TRIANGLES;
    scene->mesh_count = 3;
    scene->quadric_count = 4;
    scene->material_count = MATERIALS;
    scene->coat_table_count = 1;
    scene->light_count = LIGHTS;
    scene->light_corner_count = LIGHT_VERTICES;
    scene->triangle_light_count = LIGHT_TRIANGLES;
    bool allocated = true;
#define X(member, count, type, per)                                                        \
    scene->member = arena_alloc(scene->arena, (size_t)scene->count * (per), sizeof(type)); \
    allocated = allocated && scene->member != NULL;
    SCENE_ARRAYS(X)
#undef X
    if (!allocated) {
        scene_free(scene);
        return NULL;
    }

    geometry_fill(scene);
    materials_fill(scene->materials);
    lights_fill(scene);
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        scene->coat_tables[i] = 0.9f - 0.8f / (1 + (float)i);

    struct scene_settings *s = &scene->settings;
    s->width = s->height = TILE_SIZE;
    s->crop[1] = s->crop[3] = TILE_SIZE;
    set3(s->bounds_min, -1, -1, -1);
    set3(s->bounds_max, 1, 1, 1);
    s->camera = (struct camera){ .kind = CAMERA_PERSPECTIVE,
                                 .position = { 0.8f, 0.7f, 0.9f },
                                 .right = { -0.7f, 0, 0.7f },
                                 .up = { -0.4f, 0.8f, -0.4f },
                                 .forward = { -0.6f, -0.6f, -0.6f },
                                 .screen = { -1, 1, -1, 1 },
                                 .lens_radius = 0.01f,
                                 .focal_distance = 1.5f };
    s->filter = (struct filter_spec){
        .kind = FILTER_MITCHELL, .radius = { 2, 2 }, .b = 1 / 3.0f, .c = 1 / 3.0f
    };
    s->max_depth = 32;
    s->has_normals = 1;
    s->effects = scene_effects(scene);
    return scene;
}

bool micro_render(uint8_t out[32], struct err *err)
{
    struct scene *scene = micro_scene();
    if (scene == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the micro-render");
    struct job_spec spec = { .seed = 1,
                             .replicates = 1,
                             .leaf_samples = 4,
                             .channel_count = 3,
                             .depth_cap = 65536,
                             .kernel = 1,
                             .max_lanes = 8 };
    bool ok = false;
    struct kernel_scene *ks = kernel_open(scene, &spec, err);
    if (ks == NULL)
        goto fail_open;
    struct kernel_thread *thread = kernel_thread_open(ks, err);
    if (thread == NULL)
        goto fail_thread;
    struct node_sums *sums = node_sums_new(TILE_PIXELS, 3);
    if (sums == NULL) {
        err_set(err, ERR_MEMORY, "no memory for the micro-render");
        goto fail_sums;
    }
    if (!kernel_leaf(ks, thread, 0, 0, 0, sums, err))
        goto fail_leaf;
    struct digest digest = digest_of(sums->values, TILE_PIXELS * 3 * sizeof(float));
    memcpy(out, digest.bytes, sizeof(digest.bytes));
    ok = true;

fail_leaf:
    node_sums_free(sums);
fail_sums:
    kernel_thread_close(thread);
fail_thread:
    kernel_close(ks);
fail_open:
    scene_free(scene);
    return ok || err_wrap(err, "the micro-render behind the numeric profile");
}
