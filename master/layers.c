#include "master/layers.h"

#include "common/aov.h"
#include "common/job.h"
#include "common/scene.h"
#include "master/cryptomatte.h"
#include "master/image.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct layers {
    uint32_t aovs, replicates, channels;
    double center[3];
    struct cryptomatte_names objects, materials;

    /* The tile in the making: sums over its replicates so far */
    uint32_t pixel_count, added;
    uint32_t id_count; /* identities of each pixel, from all replicates */
    double *sums;      /* [channel][pixel], radiance included but unused */
    uint32_t *ids[2];  /* object, material: [pixel][replicate and sample] */
};

/* The averages over hits, in the order of their channels */
static const struct {
    enum aov aov;
    uint32_t component;
    const char *plane;
    bool exact; /* half would not hold it */
} averages[] = {
    { AOV_DEPTH, 0, "depth.Z", true },
    { AOV_POSITION, 0, "position.X", true },
    { AOV_POSITION, 1, "position.Y", true },
    { AOV_POSITION, 2, "position.Z", true },
    { AOV_NORMAL, 0, "normal.X", false },
    { AOV_NORMAL, 1, "normal.Y", false },
    { AOV_NORMAL, 2, "normal.Z", false },
    { AOV_GEOMETRIC_NORMAL, 0, "geometric_normal.X", false },
    { AOV_GEOMETRIC_NORMAL, 1, "geometric_normal.Y", false },
    { AOV_GEOMETRIC_NORMAL, 2, "geometric_normal.Z", false },
    { AOV_ALBEDO, 0, "albedo.R", false },
    { AOV_ALBEDO, 1, "albedo.G", false },
    { AOV_ALBEDO, 2, "albedo.B", false },
    { AOV_MOTION, 0, "motion.X", true },
    { AOV_MOTION, 1, "motion.Y", true },
};
#define AVERAGES (sizeof(averages) / sizeof(averages[0]))

static const struct {
    enum aov aov;
    const char *name;
} cryptomattes[2] = { { AOV_OBJECT, "CryptoObject" }, { AOV_MATERIAL, "CryptoMaterial" } };

/* ---- making */

static int by_index(const void *key, const void *name)
{
    uint32_t wanted = *(const uint32_t *)key, is = ((const struct scene_name *)name)->index;
    return (wanted > is) - (wanted < is);
}

/* Meshes have no names: they are numbered in the scene's order, then spheres and disks. Instances
 * have that of their object, and a number of their own. */
static void object_name(const struct scene *scene, uint32_t index, char *text, size_t capacity)
{
    uint32_t shapes = scene->mesh_count + scene->quadric_count;
    if (index < shapes) {
        snprintf(text, capacity, "object %u", index);
        return;
    }
    uint32_t group = scene->instances[index - shapes].group;
    const struct scene_name *name = NULL;
    if (scene->group_name_count > 0)
        name = bsearch(&group, scene->group_names, scene->group_name_count, sizeof(*name),
                       by_index);
    snprintf(text, capacity, "%.200s#%u", name != NULL ? name->text : "instance", index - shapes);
}

static void material_name(const struct scene *scene, uint32_t index, char *text, size_t capacity)
{
    for (uint32_t i = 0; i < scene->material_name_count; i++)
        if (scene->material_names[i].index == index) {
            snprintf(text, capacity, "%s", scene->material_names[i].text);
            return;
        }
    snprintf(text, capacity, "material %u", index);
}

struct layers *layers_new(const struct scene *scene, const struct job_spec *spec)
{
    struct layers *layers = calloc(1, sizeof(*layers));
    if (layers == NULL)
        return NULL;
    layers->aovs = spec->aovs;
    layers->replicates = spec->replicates;
    layers->channels = aov_channel_count(spec->aovs);
    memcpy(layers->center, scene->settings.center, sizeof(layers->center));
    layers->sums = calloc((size_t)layers->channels * TILE_PIXELS, sizeof(*layers->sums));
    bool done = layers->sums != NULL;
    for (int i = 0; i < 2 && done; i++) {
        if (!aov_in(layers->aovs, cryptomattes[i].aov))
            continue;
        layers->ids[i] = calloc((size_t)spec->replicates * AOV_ID_SAMPLES * TILE_PIXELS,
                                sizeof(*layers->ids[i]));
        done = layers->ids[i] != NULL;
    }
    if (done && aov_in(layers->aovs, AOV_OBJECT))
        done = cryptomatte_names_make(
            &layers->objects, scene,
            scene->mesh_count + scene->quadric_count + scene->instance_count, object_name);
    if (done && aov_in(layers->aovs, AOV_MATERIAL))
        done = cryptomatte_names_make(&layers->materials, scene, scene->material_count,
                                      material_name);
    if (done)
        return layers;
    layers_free(layers);
    return NULL;
}

void layers_free(struct layers *layers)
{
    if (layers == NULL)
        return;
    cryptomatte_names_free(&layers->objects);
    cryptomatte_names_free(&layers->materials);
    free(layers->ids[0]);
    free(layers->ids[1]);
    free(layers->sums);
    free(layers);
}

static const struct cryptomatte_names *names_of(const struct layers *layers, int which)
{
    return which == 0 ? &layers->objects : &layers->materials;
}

static bool add_plane(struct image *image, const char *name, bool exact)
{
    if (image_channel(image, name) != NULL)
        return true;
    return (exact ? image_add_exact_channel(image, name) : image_add_channel(image, name)) != NULL;
}

bool layers_prepare(const struct layers *layers, struct image *image)
{
    if (aov_in(layers->aovs, AOV_ALPHA) && !add_plane(image, "A", false))
        return false;
    for (size_t i = 0; i < AVERAGES; i++)
        if (aov_in(layers->aovs, averages[i].aov) &&
            !add_plane(image, averages[i].plane, averages[i].exact))
            return false;
    for (int i = 0; i < 2; i++) {
        if (!aov_in(layers->aovs, cryptomattes[i].aov))
            continue;
        for (unsigned channel = 0; channel < 2 * CRYPTOMATTE_RANKS; channel++) {
            char name[32];
            cryptomatte_channel(cryptomattes[i].name, channel, name, sizeof(name));
            if (!add_plane(image, name, true))
                return false;
        }
        if (!cryptomatte_describe(image, cryptomattes[i].name, names_of(layers, i)))
            return false;
    }
    return true;
}

/* ---- a tile */

void layers_tile_begin(struct layers *layers, uint32_t pixel_count)
{
    assert(pixel_count <= TILE_PIXELS);
    layers->pixel_count = pixel_count;
    layers->added = 0;
    layers->id_count = 0;
    memset(layers->sums, 0, sizeof(*layers->sums) * layers->channels * pixel_count);
}

void layers_tile_add(struct layers *layers, const struct node_sums *sums, uint64_t samples)
{
    assert(sums->pixel_count == layers->pixel_count && sums->channel_count == layers->channels);
    assert(layers->added < layers->replicates);
    uint32_t pixels = layers->pixel_count;
    uint32_t alpha = aov_in(layers->aovs, AOV_ALPHA) ? aov_channel(layers->aovs, AOV_ALPHA) : 0;
    for (uint32_t c = AOV_COVERAGE_CHANNEL; c < layers->channels; c++) {
        double scale = c == alpha ? 1 / (double)samples : 1; /* replicates count alike */
        for (uint32_t p = 0; p < pixels; p++)
            layers->sums[(size_t)c * pixels + p] += scale *
                                                    (double)sums->values[(size_t)c * pixels + p];
    }

    uint32_t known = samples < AOV_ID_SAMPLES ? (uint32_t)samples : AOV_ID_SAMPLES;
    for (int i = 0; i < 2; i++) {
        if (layers->ids[i] == NULL)
            continue;
        const float *from = sums->values +
                            (size_t)aov_channel(layers->aovs, cryptomattes[i].aov) * pixels;
        for (uint32_t p = 0; p < pixels; p++) {
            uint32_t *to = layers->ids[i] + (size_t)p * layers->replicates * AOV_ID_SAMPLES;
            for (uint32_t s = 0; s < known; s++)
                to[layers->id_count + s] = (uint32_t)from[(size_t)s * pixels + p];
        }
    }
    layers->id_count += known;
    layers->added++;
}

static void write_average(const struct layers *layers, size_t which, uint32_t y,
                          const struct tile_rect *at, float *row)
{
    size_t pixels = layers->pixel_count, first = (size_t)y * at->width;
    uint32_t channel = aov_channel(layers->aovs, averages[which].aov) + averages[which].component;
    const double *sum = layers->sums + channel * pixels + first;
    const double *coverage = layers->sums + AOV_COVERAGE_CHANNEL * pixels + first;
    double origin = averages[which].aov == AOV_POSITION ? layers->center[averages[which].component]
                                                        : 0;
    for (uint32_t x = 0; x < at->width; x++)
        row[x] = coverage[x] > 0 ? (float)(origin + sum[x] / coverage[x]) : 0;
}

static void write_alpha(const struct layers *layers, uint32_t y, const struct tile_rect *at,
                        float *row)
{
    const double *sum = layers->sums +
                        (size_t)aov_channel(layers->aovs, AOV_ALPHA) * layers->pixel_count +
                        (size_t)y * at->width;
    for (uint32_t x = 0; x < at->width; x++)
        row[x] = layers->added == 0 ? 0 : (float)(sum[x] / layers->added);
}

static void write_ids(const struct layers *layers, int which, const struct tile_rect *at,
                      struct image *image)
{
    const struct cryptomatte_names *names = names_of(layers, which);
    float *planes[2 * CRYPTOMATTE_RANKS];
    for (unsigned channel = 0; channel < 2 * CRYPTOMATTE_RANKS; channel++) {
        char name[32];
        cryptomatte_channel(cryptomattes[which].name, channel, name, sizeof(name));
        planes[channel] = image_channel(image, name);
    }
    for (uint32_t p = 0; p < layers->pixel_count; p++) {
        uint32_t index[CRYPTOMATTE_RANKS];
        float coverage[CRYPTOMATTE_RANKS];
        uint32_t *samples = layers->ids[which] + (size_t)p * layers->replicates * AOV_ID_SAMPLES;
        cryptomatte_rank(samples, layers->id_count, index, coverage);
        size_t pixel = (size_t)(at->y + p / at->width) * image->width + at->x + p % at->width;
        for (int rank = 0; rank < CRYPTOMATTE_RANKS; rank++) {
            bool known = index[rank] > 0 && index[rank] <= names->count;
            planes[2 * rank][pixel] = known ? names->ids[index[rank] - 1] : 0;
            planes[2 * rank + 1][pixel] = coverage[rank];
        }
    }
}

void layers_tile_write(const struct layers *layers, const struct tile_rect *at, struct image *image)
{
    assert(at->width * at->height == layers->pixel_count);
    for (uint32_t y = 0; y < at->height; y++) {
        size_t pixel = (size_t)(at->y + y) * image->width + at->x;
        if (aov_in(layers->aovs, AOV_ALPHA))
            write_alpha(layers, y, at, image_channel(image, "A") + pixel);
        for (size_t i = 0; i < AVERAGES; i++)
            if (aov_in(layers->aovs, averages[i].aov))
                write_average(layers, i, y, at, image_channel(image, averages[i].plane) + pixel);
    }
    for (int i = 0; i < 2; i++)
        if (aov_in(layers->aovs, cryptomattes[i].aov))
            write_ids(layers, i, at, image);
}
