#include "worker/kernel/first_hit.h"

#include "common/aov.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Where the values of a sample are, and how many there are */
enum {
    DEPTH = 0,
    POSITION = 1,
    NORMAL = 4,
    GEOMETRIC_NORMAL = 7,
    ALBEDO = 10,
    VALUES = 13,
};

/* Sums over the samples of one pixel */
struct totals {
    double coverage, alpha;
    double values[VALUES];
    uint32_t object[AOV_ID_SAMPLES], material[AOV_ID_SAMPLES]; /* 1 + index, or 0 */
};

static double depth(const struct camera *camera, const float p[3])
{
    double length2 = 0, along = 0;
    for (int axis = 0; axis < 3; axis++) {
        double forward = (double)camera->forward[axis];
        length2 += forward * forward;
        along += forward * ((double)p[axis] - (double)camera->position[axis]);
    }
    return along / sqrt(length2);
}

/* False when there is nothing to show */
static bool values_of(const struct camera *camera, const struct first_hit *hit, double *values)
{
    if (hit->seen == 0)
        return false;
    values[DEPTH] = depth(camera, hit->p);
    for (int axis = 0; axis < 3; axis++) {
        values[POSITION + axis] = (double)hit->p[axis];
        values[NORMAL + axis] = (double)hit->ns[axis];
        values[GEOMETRIC_NORMAL + axis] = (double)hit->ng[axis];
        values[ALBEDO + axis] = (double)hit->albedo[axis];
    }
    for (int i = 0; i < VALUES; i++)
        if (!isfinite(values[i]))
            return false;
    return true;
}

static struct totals totals_of(const struct kernel_scene *ks, const struct first_hit *hits,
                               uint64_t first_sample)
{
    struct totals totals = { .coverage = 0 };
    for (uint32_t k = 0; k < ks->spec.leaf_samples; k++) {
        double values[VALUES];
        if (!values_of(&ks->scene->settings.camera, &hits[k], values))
            continue;
        uint64_t sample = first_sample + k;
        double weight = 1;
        if (ks->filter.has_negative)
            weight = (double)(sample % 4 == 3 ? ks->filter.weight_negative
                                              : ks->filter.weight_positive);
        totals.alpha += weight;
        totals.coverage += fabs(weight);
        for (int i = 0; i < VALUES; i++)
            totals.values[i] += fabs(weight) * values[i];
        if (sample < AOV_ID_SAMPLES) {
            totals.object[sample] = hits[k].object + 1;
            totals.material[sample] = hits[k].material + 1;
        }
    }
    return totals;
}

/* `count` sums of one pixel into the planes of a layer, if it is asked for */
static void put(struct node_sums *sums, uint32_t aovs, enum aov aov, uint32_t pixel,
                const double *values, uint32_t count)
{
    if (!aov_in(aovs, aov))
        return;
    float *plane = sums->values + (size_t)aov_channel(aovs, aov) * sums->pixel_count;
    for (uint32_t c = 0; c < count; c++)
        plane[(size_t)c * sums->pixel_count + pixel] = (float)values[c];
}

static void put_ids(struct node_sums *sums, uint32_t aovs, enum aov aov, uint32_t pixel,
                    const uint32_t ids[AOV_ID_SAMPLES])
{
    double values[AOV_ID_SAMPLES];
    for (int s = 0; s < AOV_ID_SAMPLES; s++)
        values[s] = (double)ids[s];
    put(sums, aovs, aov, pixel, values, AOV_ID_SAMPLES);
}

void first_hit_sum(const struct kernel_scene *ks, const struct first_hit *hits,
                   uint64_t first_sample, struct node_sums *sums)
{
    uint32_t aovs = ks->spec.aovs;
    for (uint32_t pixel = 0; pixel < sums->pixel_count; pixel++) {
        struct totals totals = totals_of(ks, hits + (size_t)pixel * ks->spec.leaf_samples,
                                         first_sample);
        sums->values[(size_t)AOV_COVERAGE_CHANNEL * sums->pixel_count + pixel] =
            (float)totals.coverage;
        put(sums, aovs, AOV_ALPHA, pixel, &totals.alpha, 1);
        put(sums, aovs, AOV_DEPTH, pixel, totals.values + DEPTH, 1);
        put(sums, aovs, AOV_POSITION, pixel, totals.values + POSITION, 3);
        put(sums, aovs, AOV_NORMAL, pixel, totals.values + NORMAL, 3);
        put(sums, aovs, AOV_GEOMETRIC_NORMAL, pixel, totals.values + GEOMETRIC_NORMAL, 3);
        put(sums, aovs, AOV_ALBEDO, pixel, totals.values + ALBEDO, 3);
        put_ids(sums, aovs, AOV_OBJECT, pixel, totals.object);
        put_ids(sums, aovs, AOV_MATERIAL, pixel, totals.material);
    }
}
