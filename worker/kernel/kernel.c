#include "worker/kernel/kernel.h"

#include "common/aov.h"
#include "common/effects.h"
#include "common/elem.h"
#include "common/err.h"
#include "common/pages.h"
#include "proto/digest.h"
#include "worker/kernel/alpha.h"
#include "worker/kernel/callbacks.h"
#include "worker/kernel/emission.h"
#include "worker/kernel/first_hit.h"
#include "worker/kernel/micro.h"
#include "worker/kernel/path.h"
#include "worker/renderer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void leaf_function(const struct kernel_scene *, struct kernel_thread *, uint32_t, uint32_t,
                           uint64_t, struct path_stats *);

struct variant {
    const char *name;
    unsigned mask;
    leaf_function *leaf; /* with AVX2; without it there is one function for all */
};

static const struct variant variants[] = {
#define X(name, mask) { #name, (mask), path_leaf_##name##_avx2 },
    PATH_VARIANTS(X)
#undef X
};
#define VARIANT_COUNT (sizeof(variants) / sizeof(variants[0]))

/* PATHFARM_LANES=base renders without AVX2: for the test that this changes no bit */
static bool has_avx2(void)
{
    const char *forced = getenv("PATHFARM_LANES");
    if (forced != NULL && strcmp(forced, "base") == 0)
        return false;
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2");
}

/* What Embree is pinned to: its hits differ between instruction sets, our arithmetic does not */
static const char *embree_isa(void)
{
    return __builtin_cpu_supports("avx2") ? "avx2" : "sse2";
}

static void embree_error(void *user, enum RTCError code, const char *text)
{
    (void)code;
    struct err *err = user;
    if (err->code == ERR_OK)
        err_set(err, code == RTC_ERROR_OUT_OF_MEMORY ? ERR_MEMORY : ERR_RENDER, "Embree: %s", text);
}

/* ---- lights */

static float light_extent(const struct scene *scene, const struct light *light)
{
    float extent = 0;
    if (light->kind == LIGHT_POLYGON) {
        const float *corner = scene->light_corners + 3 * (size_t)light->first_corner;
        for (uint32_t i = 0; i < 3 * light->corner_count; i++)
            extent = fmaxf(extent, fabsf(corner[i]));
    }
    if (light->kind == LIGHT_SPHERE || light->kind == LIGHT_DISK) {
        const struct quadric *quadric = &scene->quadrics[light->quadric];
        extent = quadric->world_radius;
        for (int axis = 0; axis < 3; axis++)
            extent = fmaxf(extent, fabsf(quadric->center[axis]));
    }
    return extent;
}

static bool environments_open(struct kernel_scene *ks, struct err *err)
{
    const uint32_t count = ks->scene->environment_count;
    if (count == 0)
        return true;
    ks->environments = calloc(count, sizeof(*ks->environments));
    if (ks->environments == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u environments", count);
    for (uint32_t i = 0; i < count; i++)
        if (!environment_open(&ks->environments[i], ks->scene, i, err))
            return false;
    return true;
}

static void environments_close(struct kernel_scene *ks)
{
    if (ks->environments == NULL)
        return;
    for (uint32_t i = 0; i < ks->scene->environment_count; i++)
        environment_close(&ks->environments[i]);
    free(ks->environments);
}

/* Scattering finds a constant sky as well as any light sampling could */
static bool is_sampled(const struct light *light)
{
    return light->kind != LIGHT_SKY || light->environment != 0;
}

/*
 * Cumulative choice probabilities, half by power (`pick`) and half the same for all: power alone
 * would leave dim lights near a receiver to chance.
 */
static bool lights_open(struct kernel_scene *ks, struct err *err)
{
    const struct scene *scene = ks->scene;
    uint32_t n = scene->light_count;
    ks->light_count = n;
    ks->polygon_fans = 2;
    ks->light_cdf = calloc((size_t)n + 1, sizeof(*ks->light_cdf));
    ks->light_pmf = calloc((size_t)n + 1, sizeof(*ks->light_pmf));
    ks->light_extent = calloc((size_t)n + 1, sizeof(*ks->light_extent));
    if (ks->light_cdf == NULL || ks->light_pmf == NULL || ks->light_extent == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u lights", n);

    double power = 0, number = 0;
    for (uint32_t i = 0; i < n; i++) {
        const struct light *light = &scene->lights[i];
        if (light->kind == LIGHT_POLYGON && (int32_t)light->corner_count - 2 > ks->polygon_fans)
            ks->polygon_fans = (int32_t)light->corner_count - 2;
        ks->light_extent[i] = light_extent(scene, light);
        if (is_sampled(light)) {
            power += (double)light->pick;
            number++;
        }
    }
    ks->lights_sampled = number > 0 && (ks->spec.techniques_off & TECHNIQUE_LIGHT_SAMPLING) == 0;
    double sum = 0, left = number;
    for (uint32_t i = 0; i < n; i++) {
        const struct light *light = &scene->lights[i];
        if (is_sampled(light)) {
            double by_power = power > 0 ? (double)light->pick / power : 1 / number;
            sum += 0.5 * by_power + 0.5 / number;
            left--;
        }
        ks->light_cdf[i + 1] = left > 0 ? (float)sum : 1; /* the last ends at exactly one */
    }
    for (uint32_t i = 0; i < n; i++)
        ks->light_pmf[i] = ks->light_cdf[i + 1] - ks->light_cdf[i];
    ks->light_steps = 1;
    while ((uint32_t)ks->light_steps * 2 < n)
        ks->light_steps *= 2;
    if ((scene->settings.effects & FX_LIGHT_TREE) &&
        !light_tree_open(&ks->light_tree, scene, ks->light_pmf, err))
        return false;
    return environments_open(ks, err) && emission_open(ks, err);
}

/* ---- textures */

/*
 * Textures are read as wide as FOOTPRINT times a pixel at the point's distance from the camera, by
 * whatever way the path came there: one rule without state, after pbrt-v4, but fixed where pbrt
 * takes 1 / sqrt(spp) and at least 1/8, as no sample may depend on how many there are. At a half,
 * texels are as wide as pixels, and what they blur is less than what the pixel filter does.
 */
#define FOOTPRINT 0.5f

static void footprint_open(struct kernel_scene *ks)
{
    const struct scene_settings *settings = &ks->scene->settings;
    const struct camera *c = &settings->camera;
    float length[3];
    const float *axes[3] = { c->right, c->up, c->forward };
    for (int i = 0; i < 3; i++)
        length[i] = sqrtf(axes[i][0] * axes[i][0] + axes[i][1] * axes[i][1] +
                          axes[i][2] * axes[i][2]);
    float x = fabsf(c->screen[1] - c->screen[0]) * length[0] / (float)settings->width;
    float y = fabsf(c->screen[3] - c->screen[2]) * length[1] / (float)settings->height;
    float pixel = FOOTPRINT * fminf(x, y);
    if (c->kind == CAMERA_ORTHOGRAPHIC)
        ks->footprint_size = pixel;
    else if (length[2] > 0)
        ks->footprint_angle = pixel / length[2];
}

static bool textures_open(struct kernel_scene *ks, struct err *err)
{
    const struct scene *scene = ks->scene;
    ks->textures = texture_set_open(scene, err);
    if (ks->textures == NULL)
        return false;
    footprint_open(ks);
    ks->textured = calloc((size_t)scene->material_count + 1, sizeof(*ks->textured));
    if (ks->textured == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u materials", scene->material_count);
    for (uint32_t i = 0; i < scene->material_count; i++) {
        const struct material *material = &scene->materials[i];
        ks->textured[i] = (int32_t)textured_parts(material);
        for (int k = 0; material->kind == MATERIAL_MIX && k < 2; k++)
            ks->textured[i] |= ks->textured[material->mix[k]];
    }
    bool any_alpha = false;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        any_alpha |= scene->meshes[i].alpha != 0;
    ks->has_alpha = any_alpha;
    for (uint32_t i = 0; i < scene->quadric_count; i++)
        ks->has_alpha |= scene->quadrics[i].alpha != 0;
    if (!any_alpha)
        return true;
    ks->alpha_meshes = calloc(scene->mesh_count, sizeof(*ks->alpha_meshes));
    if (ks->alpha_meshes == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u meshes", scene->mesh_count);
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        ks->alpha_meshes[i] = (struct alpha_mesh){ scene, ks->textures, i };
    return true;
}

/* ---- geometry */

/* The meshes of a group, or of the world outside all groups; geomIDs count from its first */
static bool meshes_attach(struct kernel_scene *ks, RTCScene rtc, const struct group *group,
                          struct err *err)
{
    const struct scene *scene = ks->scene;
    for (uint32_t i = 0; i < group->mesh_count; i++) {
        const struct mesh *mesh = &scene->meshes[group->first_mesh + i];
        if (mesh->material == SCENE_NONE && mesh->inside == mesh->outside)
            continue;
        RTCGeometry geometry = rtcNewGeometry(ks->device, RTC_GEOMETRY_TYPE_TRIANGLE);
        if (geometry == NULL)
            return err_set(err, ERR_MEMORY, "no memory for mesh %u", i);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                   scene->positions, 0, 12, scene->vertex_count);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                   scene->triangles, (size_t)mesh->first_triangle * 12, 12,
                                   mesh->triangle_count);
        if (mesh->alpha != 0) {
            rtcSetGeometryUserData(geometry, &ks->alpha_meshes[mesh - scene->meshes]);
            rtcSetGeometryIntersectFilterFunction(geometry, alpha_filter);
            rtcSetGeometryOccludedFilterFunction(geometry, alpha_filter);
        }
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(rtc, geometry, i);
        rtcReleaseGeometry(geometry);
    }
    return true;
}

static bool quadrics_attach(struct kernel_scene *ks, RTCScene rtc, const struct group *group,
                            uint32_t geometry_id, struct kernel_quadrics *quadrics, struct err *err)
{
    if (group->quadric_count == 0)
        return true;
    RTCGeometry geometry = rtcNewGeometry(ks->device, RTC_GEOMETRY_TYPE_USER);
    if (geometry == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u spheres and disks", group->quadric_count);
    bool avx2 = has_avx2();
    rtcSetGeometryUserPrimitiveCount(geometry, group->quadric_count);
    *quadrics = (struct kernel_quadrics){ ks, &ks->scene->quadrics[group->first_quadric] };
    rtcSetGeometryUserData(geometry, quadrics);
    /* Bounds are in double precision nowhere, so one version serves both instruction sets */
    rtcSetGeometryBoundsFunction(geometry, callbacks_quadric_bounds_base, NULL);
    rtcSetGeometryIntersectFunction(geometry, avx2 ? callbacks_quadric_intersect_avx2
                                                   : callbacks_quadric_intersect_base);
    rtcSetGeometryOccludedFunction(geometry, avx2 ? callbacks_quadric_occluded_avx2
                                                  : callbacks_quadric_occluded_base);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(rtc, geometry, geometry_id);
    rtcReleaseGeometry(geometry);
    return true;
}

/* A committed Embree scene for every group */
static bool groups_open(struct kernel_scene *ks, struct err *err)
{
    const struct scene *scene = ks->scene;
    if (scene->group_count == 0)
        return true;
    size_t size = scene->group_count * sizeof(*ks->groups);
    ks->groups = aligned_alloc(_Alignof(struct kernel_group), size);
    if (ks->groups == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u groups", scene->group_count);
    memset(ks->groups, 0, size);
    for (uint32_t i = 0; i < scene->group_count; i++) {
        const struct group *group = &scene->groups[i];
        RTCScene rtc = ks->groups[i].rtc = rtcNewScene(ks->device);
        rtcSetSceneFlags(rtc, RTC_SCENE_FLAG_ROBUST);
        if (!meshes_attach(ks, rtc, group, err) ||
            !quadrics_attach(ks, rtc, group, group->mesh_count, &ks->groups[i].quadrics, err))
            return false;
        rtcCommitScene(rtc);
        rtcGetSceneBounds(rtc, &ks->groups[i].bounds);
    }
    return true;
}

/* All instances are one geometry: its primitives are looked into by instance.h's arithmetic */
static bool instances_attach(struct kernel_scene *ks, struct err *err)
{
    const struct scene *scene = ks->scene;
    if (scene->instance_count == 0)
        return true;
    RTCGeometry geometry = rtcNewGeometry(ks->device, RTC_GEOMETRY_TYPE_USER);
    if (geometry == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u instances", scene->instance_count);
    bool avx2 = has_avx2();
    rtcSetGeometryUserPrimitiveCount(geometry, scene->instance_count);
    rtcSetGeometryUserData(geometry, ks);
    rtcSetGeometryBoundsFunction(geometry, callbacks_instance_bounds_base, NULL);
    rtcSetGeometryIntersectFunction(geometry, avx2 ? callbacks_instance_intersect_avx2
                                                   : callbacks_instance_intersect_base);
    rtcSetGeometryOccludedFunction(geometry, avx2 ? callbacks_instance_occluded_avx2
                                                  : callbacks_instance_occluded_base);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(ks->rtc, geometry, scene->mesh_count + 1);
    rtcReleaseGeometry(geometry);
    return true;
}

/* Hits of a large mesh read it at random */
static void arrays_prefer_huge_pages(const struct scene *scene)
{
#define X(array, count, type, per) \
    pages_make_huge(scene->array, (size_t)scene->count *(per) * sizeof(type));
    SCENE_ARRAYS(X)
#undef X
}

/*
 * The tree is built by one thread: which of two surfaces at the very same distance is found may
 * depend on how it was built, and so must not depend on the number of threads.
 */
static bool geometry_open(struct kernel_scene *ks, struct err *err)
{
    char config[64];
    snprintf(config, sizeof(config), "threads=1,isa=%s", embree_isa());
    ks->device = rtcNewDevice(config);
    if (ks->device == NULL)
        return err_set(err, ERR_RENDER, "Embree does not start with \"%s\"", config);
    struct err first = { .code = ERR_OK };
    rtcSetDeviceErrorFunction(ks->device, embree_error, &first);
    ks->rtc = rtcNewScene(ks->device);
    rtcSetSceneFlags(ks->rtc, RTC_SCENE_FLAG_ROBUST);
    const struct scene *scene = ks->scene;
    ks->quadric_geometry = (int32_t)scene->mesh_count;
    struct group world = { .mesh_count = scene->mesh_count, .quadric_count = scene->quadric_count };
    if (scene->group_count > 0)
        world = (struct group){ .mesh_count = scene->groups[0].first_mesh,
                                .quadric_count = scene->groups[0].first_quadric };
    if (!meshes_attach(ks, ks->rtc, &world, err) ||
        !quadrics_attach(ks, ks->rtc, &world, scene->mesh_count, &ks->quadrics, err) ||
        !groups_open(ks, err) || !instances_attach(ks, err))
        return false;
    rtcCommitScene(ks->rtc);
    rtcSetDeviceErrorFunction(ks->device, NULL, NULL);
    if (first.code != ERR_OK)
        return err_set(err, first.code, "%s", first.text);
    return true;
}

/* ---- opening and closing */

const char *kernel_variant_name(unsigned index)
{
    return index < VARIANT_COUNT ? variants[index].name : NULL;
}

static const struct variant *variant_for(unsigned effects, bool everything)
{
    const struct variant *last = &variants[VARIANT_COUNT - 1];
    if (everything)
        return last;
    for (unsigned i = 0; i < VARIANT_COUNT; i++)
        if ((effects & ~variants[i].mask) == 0)
            return &variants[i];
    return last;
}

struct kernel_scene *kernel_open(const struct scene *scene, const struct job_spec *spec,
                                 struct err *err)
{
    struct kernel_scene *ks = aligned_alloc(64, (sizeof(*ks) + 63) / 64 * 64);
    if (ks == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a scene");
        return NULL;
    }
    memset(ks, 0, sizeof(*ks));
    ks->scene = scene;
    ks->spec = *spec;

    unsigned effects = scene_effects(scene);
    if (effects != scene->settings.effects) {
        err_set(err, ERR_SCENE, "the scene's effect mask is %#x, recomputed it is %#x",
                scene->settings.effects, effects);
        goto fail;
    }
    if (spec->max_lanes < 1 || spec->max_lanes > LANES) {
        err_set(err, ERR_ARGUMENT, "%u active lanes; it must be 1 to 8", spec->max_lanes);
        goto fail;
    }
    if ((spec->aovs & ~AOV_ALL) != 0 || spec->channel_count != aov_channel_count(spec->aovs)) {
        err_set(err, ERR_ARGUMENT, "%u channels for the layers %#x, which need %u",
                spec->channel_count, spec->aovs, aov_channel_count(spec->aovs & AOV_ALL));
        goto fail;
    }
    bool avx2 = has_avx2();
    bool everything = !avx2 || spec->kernel != 0 || spec->techniques_off != 0;
    const struct variant *variant = variant_for(effects, everything);
    ks->variant = variant->name;
    ks->fx = variant->mask;
    ks->leaf = avx2 ? variant->leaf : path_leaf_everything_base;
    ks->max_depth = scene->settings.max_depth < spec->depth_cap ? scene->settings.max_depth
                                                                : spec->depth_cap;
    if (ks->max_depth > INT32_MAX)
        ks->max_depth = INT32_MAX;
    ks->dfa = path_dfa_everything();
    filter_table_make(&ks->filter, &scene->settings.filter);
    float far = 1;
    for (int axis = 0; axis < 3; axis++)
        far += scene->settings.bounds_max[axis] - scene->settings.bounds_min[axis] +
               fabsf(scene->settings.camera.position[axis]);
    ks->far_distance = 2 * far;
    arrays_prefer_huge_pages(scene);
    if (!sampler_init(&ks->sampler, scene->settings.sampler, spec->planned_samples, err) ||
        !lights_open(ks, err) || !textures_open(ks, err) || !geometry_open(ks, err))
        goto fail;
    return ks;

fail:
    kernel_close(ks);
    return NULL;
}

void kernel_close(struct kernel_scene *ks)
{
    if (ks == NULL)
        return;
    if (ks->rtc != NULL)
        rtcReleaseScene(ks->rtc);
    for (uint32_t i = 0; ks->groups != NULL && i < ks->scene->group_count; i++)
        if (ks->groups[i].rtc != NULL)
            rtcReleaseScene(ks->groups[i].rtc);
    if (ks->device != NULL)
        rtcReleaseDevice(ks->device);
    environments_close(ks);
    emission_close(ks);
    free(ks->groups);
    free(ks->light_cdf);
    free(ks->light_pmf);
    free(ks->light_extent);
    texture_set_close(ks->textures);
    free(ks->textured);
    free(ks->alpha_meshes);
    light_tree_close(&ks->light_tree);
    free(ks);
}

struct kernel_thread *kernel_thread_open(const struct kernel_scene *ks, struct err *err)
{
    struct kernel_thread *thread = calloc(1, sizeof(*thread));
    if (thread == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a render thread");
        return NULL;
    }
    thread->slot_count = TILE_PIXELS * ks->spec.leaf_samples;
    thread->radiance = calloc((size_t)thread->slot_count * 3, sizeof(float));
    if (thread->radiance == NULL)
        goto fail;
    if (ks->spec.aovs != 0) {
        thread->first_hits = calloc(thread->slot_count, sizeof(*thread->first_hits));
        if (thread->first_hits == NULL)
            goto fail;
    }
    return thread;

fail:
    kernel_thread_close(thread);
    err_set(err, ERR_MEMORY, "no memory for a render thread");
    return NULL;
}

void kernel_thread_close(struct kernel_thread *thread)
{
    if (thread == NULL)
        return;
    free(thread->first_hits);
    free(thread->radiance);
    free(thread);
}

/* ---- one leaf */

/* Why a sample cannot be summed, or -1 */
static int nonfinite_cause(const float L[3])
{
    int cause = -1;
    for (int channel = 0; channel < 3; channel++) {
        if (isnan(L[channel]))
            return NONFINITE_NAN;
        if (isinf(L[channel]))
            cause = NONFINITE_INF;
        else if (L[channel] < 0 && cause < 0)
            cause = NONFINITE_NEGATIVE;
    }
    return cause;
}

/*
 * Add the samples of every pixel in index order, in double, and round once. A sample that is not a
 * finite radiance is left out and counted, and its pixel is marked as failed (NUMERICS H60).
 */
static void sum_samples(const struct kernel_scene *ks, const struct kernel_thread *thread,
                        uint64_t first_sample, struct node_sums *sums)
{
    uint32_t B = ks->spec.leaf_samples;
    for (uint32_t pixel = 0; pixel < sums->pixel_count; pixel++) {
        double total[3] = { 0, 0, 0 };
        for (uint32_t k = 0; k < B; k++) {
            uint32_t slot = pixel * B + k;
            float L[3] = { thread->radiance[slot], thread->radiance[thread->slot_count + slot],
                           thread->radiance[2 * thread->slot_count + slot] };
            int cause = nonfinite_cause(L);
            if (cause >= 0) {
                sums->stats.nonfinite[cause]++;
                sums->failed[pixel / 32] |= 1u << pixel % 32;
                continue;
            }
            float weight = 1;
            if (ks->filter.has_negative)
                weight = (first_sample + k) % 4 == 3 ? ks->filter.weight_negative
                                                     : ks->filter.weight_positive;
            for (int channel = 0; channel < 3; channel++)
                total[channel] += (double)weight * (double)L[channel];
            float luminance = (0.2126f * L[0] + 0.7152f * L[1] + 0.0722f * L[2]) * fabsf(weight);
            if (luminance > sums->stats.largest)
                sums->stats.largest = luminance;
        }
        for (uint32_t channel = 0; channel < 3; channel++)
            sums->values[channel * sums->pixel_count + pixel] = (float)total[channel];
    }
}

bool kernel_leaf(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile,
                 uint32_t replicate, uint64_t leaf, struct node_sums *sums, struct err *err)
{
    struct tile_rect rect = tile_rect(ks->scene, tile);
    if (sums->pixel_count != rect.width * rect.height ||
        sums->channel_count != ks->spec.channel_count)
        return err_set(err, ERR_INTERNAL, "sums of tile %u have the wrong shape", tile);
    memset(&sums->stats, 0, sizeof(sums->stats));
    memset(sums->failed, 0, sizeof(sums->failed));

    uint64_t first_sample = leaf * ks->spec.leaf_samples;
    if (thread->first_hits != NULL)
        memset(thread->first_hits, 0, thread->slot_count * sizeof(*thread->first_hits));
    struct path_stats stats = { 0 };
    ks->leaf(ks, thread, tile, replicate, leaf, &stats);
    sum_samples(ks, thread, first_sample, sums);
    if (thread->first_hits != NULL)
        first_hit_sum(ks, thread->first_hits, first_sample, sums);
    sums->stats.samples = (uint64_t)sums->pixel_count * ks->spec.leaf_samples;
    sums->stats.rays_closest = stats.rays_closest;
    sums->stats.rays_shadow = stats.rays_shadow;
    sums->stats.events = stats.events;
    sums->stats.truncated_paths = stats.truncated_paths;
    sums->stats.truncated_energy = stats.truncated_energy;
    return true;
}

/* ---- the renderer interface */

static bool embree_profile(uint8_t digest[32], char *text, size_t capacity, struct err *err)
{
    snprintf(text, capacity, "embree %d.%d.%d %s, robust; kernel bits 1", RTC_VERSION_MAJOR,
             RTC_VERSION_MINOR, RTC_VERSION_PATCH, embree_isa());
    return micro_render(digest, err);
}

static struct renderer *embree_open(const struct scene *scene, const struct job_spec *spec,
                                    unsigned threads, struct err *err)
{
    (void)threads;
    return (struct renderer *)kernel_open(scene, spec, err);
}

static void *embree_thread_open(struct renderer *renderer, struct err *err)
{
    return kernel_thread_open((struct kernel_scene *)renderer, err);
}

static void embree_thread_close(struct renderer *renderer, void *thread)
{
    (void)renderer;
    kernel_thread_close(thread);
}

static bool embree_leaf(struct renderer *renderer, void *thread, uint32_t tile, uint32_t replicate,
                        uint64_t leaf, struct node_sums *sums, struct err *err)
{
    return kernel_leaf((struct kernel_scene *)renderer, thread, tile, replicate, leaf, sums, err);
}

static void embree_close(struct renderer *renderer)
{
    kernel_close((struct kernel_scene *)renderer);
}

const struct renderer_class renderer_embree = {
    .name = "embree",
    .profile = embree_profile,
    .open = embree_open,
    .thread_open = embree_thread_open,
    .thread_close = embree_thread_close,
    .leaf = embree_leaf,
    .close = embree_close,
};
