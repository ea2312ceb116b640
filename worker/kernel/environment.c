#include "worker/kernel/environment.h"

#include "common/direction_map.h"
#include "common/elem.h"
#include "common/err.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI          3.14159265358979323846
#define CHANCE_BITS 24
#define CHANCES     (1u << CHANCE_BITS)

/* From one texel's `below` to the next */
#define TEXEL_STRIDE (sizeof(struct environment_texel) / sizeof(uint32_t))

/*
 * Chances before each of `count` bins into below[stride * i], the end included: in proportion to
 * weights, and at least one where the weight is above zero. Sums are double: beside one huge weight
 * no small one is lost.
 */
static void share_chances(const double *weights, uint32_t count, uint32_t *below, size_t stride)
{
    double total = 0, sum = 0;
    uint32_t positive = 0, before = 0;
    for (uint32_t i = 0; i < count; i++) {
        total += weights[i];
        positive += weights[i] > 0;
    }
    bool dark = positive == 0;
    if (dark) {
        positive = count;
        total = count;
    }
    for (uint32_t i = 0; i < count; i++) {
        below[stride * i] = (uint32_t)(sum / total * (CHANCES - positive)) + before;
        sum += dark ? 1 : weights[i];
        before += dark || weights[i] > 0;
    }
    below[stride * count] = CHANCES;
}

/* A guide to `count` bins, `arrays` of them; half as many entries as bins or more. NULL: no memory
 */
static int32_t *guide_new(struct environment_guide *guide, uint32_t count, uint32_t arrays)
{
    guide->shift = CHANCE_BITS;
    while (guide->shift > 0 && CHANCES >> guide->shift < (count + 1) / 2)
        guide->shift--;
    guide->size = (int32_t)(CHANCES >> guide->shift) + 1;
    guide->first = malloc((size_t)guide->size * arrays * sizeof(*guide->first));
    return guide->first;
}

static void guide_fill(const struct environment_guide *guide, uint32_t array, const uint32_t *below,
                       size_t stride, uint32_t count)
{
    int32_t *first = guide->first + (size_t)array * (size_t)guide->size;
    uint32_t bin = 0;
    for (uint32_t i = 0; i < (uint32_t)guide->size; i++) {
        while (bin + 1 < count && below[stride * (bin + 1)] <= i << guide->shift)
            bin++;
        first[i] = (int32_t)bin;
    }
}

/* Radiance of row y, and its luminances; returns the sum of these */
static double read_row(struct environment_table *table, const struct scene *scene,
                       const struct environment *environment, uint32_t y, double *luminance)
{
    const struct scene_picture *picture = &scene->pictures[environment->picture];
    struct environment_texel *row = table->texels + (size_t)y * (picture->width + 1);
    double sum = 0;
    for (uint32_t x = 0; x < picture->width; x++) {
        double rgb[3];
        direction_map_texel(picture, scene->texels, x, y, rgb);
        for (int c = 0; c < 3; c++)
            row[x].L[c] = (float)fmin(rgb[c] * (double)environment->scale[c], (double)FLT_MAX);
        luminance[x] = 0.2126 * (double)row[x].L[0] + 0.7152 * (double)row[x].L[1] +
                       0.0722 * (double)row[x].L[2];
        sum += luminance[x];
    }
    memset(row[picture->width].L, 0, sizeof(row[picture->width].L));
    return sum;
}

bool environment_open(struct environment_table *table, const struct scene *scene, uint32_t index,
                      struct err *err)
{
    const struct environment *environment = &scene->environments[index];
    const struct scene_picture *picture = &scene->pictures[environment->picture];
    const uint32_t width = picture->width, height = picture->height;
    const size_t texel_count = (size_t)height * (width + 1);
    double *weights = malloc(((size_t)width + height) * sizeof(*weights));
    table->texels = malloc(texel_count * sizeof(*table->texels));
    table->rows = malloc(((size_t)height + 1) * sizeof(*table->rows));
    table->row_density = malloc((size_t)height * sizeof(*table->row_density));
    table->row_bounds = malloc(((size_t)height + 1) * sizeof(*table->row_bounds));
    if (weights == NULL || table->texels == NULL || table->rows == NULL ||
        table->row_density == NULL || table->row_bounds == NULL ||
        guide_new(&table->row_guide, height, 1) == NULL ||
        guide_new(&table->column_guide, width, height) == NULL) {
        free(weights);
        return err_set(err, ERR_MEMORY, "no memory for an environment of %ux%u", width, height);
    }
    table->width = (int32_t)width;
    table->height = (int32_t)height;
    table->layout = (int32_t)environment->layout;
    table->light = environment->light;
    table->has_portal = environment->light < scene->light_count &&
                        scene->lights[environment->light].kind == LIGHT_SKY &&
                        scene->lights[environment->light].corner_count == 4;
    memcpy(table->to_light, environment->to_light, sizeof(table->to_light));

    double *row_weights = weights + width;
    for (uint32_t y = 0; y < height; y++) {
        double sum = read_row(table, scene, environment, y, weights);
        row_weights[y] = sum * direction_map_omega(environment->layout, width, height, y);
        uint32_t *below = &table->texels[(size_t)y * (width + 1)].below;
        share_chances(weights, width, below, TEXEL_STRIDE);
        guide_fill(&table->column_guide, y, below, TEXEL_STRIDE, width);
    }
    share_chances(row_weights, height, table->rows, 1);
    guide_fill(&table->row_guide, 0, table->rows, 1, height);
    for (uint32_t y = 0; y < height; y++) {
        double chance = (double)(table->rows[y + 1] - table->rows[y]) / CHANCES / CHANCES;
        double omega = direction_map_omega(environment->layout, width, height, y);
        table->row_density[y] = (float)(chance / omega);
    }
    for (uint32_t y = 0; y <= height; y++) {
        double half = elem_sin(PI / 2 * y / height);
        table->row_bounds[y] = (float)(half * half);
    }
    free(weights);
    return !table->has_portal || portal_open(&table->portal, scene, table, err);
}

void environment_close(struct environment_table *table)
{
    free(table->texels);
    free(table->rows);
    free(table->row_guide.first);
    free(table->column_guide.first);
    free(table->row_density);
    free(table->row_bounds);
    portal_close(&table->portal);
}
