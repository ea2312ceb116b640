#include "common/job.h"

#include "common/scene.h"

#define DEFAULT_REPLICATES   4
#define DEFAULT_LEAF_SAMPLES 4

static uint32_t tiles_across(const struct scene_settings *settings)
{
    return (settings->crop[1] - settings->crop[0] + TILE_SIZE - 1) / TILE_SIZE;
}

static uint32_t tiles_down(const struct scene_settings *settings)
{
    return (settings->crop[3] - settings->crop[2] + TILE_SIZE - 1) / TILE_SIZE;
}

uint32_t tile_count(const struct scene *scene)
{
    return tiles_across(&scene->settings) * tiles_down(&scene->settings);
}

static uint32_t smaller(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

struct tile_rect tile_rect(const struct scene *scene, uint32_t tile)
{
    const uint32_t *crop = scene->settings.crop;
    uint32_t across = tiles_across(&scene->settings);
    struct tile_rect rect = {
        .x = crop[0] + tile % across * TILE_SIZE,
        .y = crop[2] + tile / across * TILE_SIZE,
    };
    rect.width = smaller(TILE_SIZE, crop[1] - rect.x);
    rect.height = smaller(TILE_SIZE, crop[3] - rect.y);
    return rect;
}

uint32_t job_sequences(const struct job_spec *spec)
{
    return spec->pilot_rounds == 0 ? spec->replicates : 2 * spec->replicates;
}

double job_pilot_weight(const struct job_spec *spec)
{
    return spec->pilot_weight / 65536.0;
}

unsigned job_rounds(const struct job_spec *spec, uint64_t spp)
{
    const uint64_t most = (uint64_t)1 << NODE_LEVEL_MAX;
    uint64_t samples_per_leaf = (uint64_t)spec->replicates * spec->leaf_samples;
    uint64_t leaves = spp / samples_per_leaf + (spp % samples_per_leaf != 0);
    return spec->pilot_rounds + round_reaching(leaves < most ? leaves : most) + 1;
}

uint64_t job_samples(const struct job_spec *spec, unsigned rounds)
{
    if (rounds <= spec->pilot_rounds)
        return 0;
    return (uint64_t)spec->replicates * spec->leaf_samples *
           round_end(rounds - spec->pilot_rounds - 1);
}

uint64_t job_shape(uint64_t spp, uint32_t replicates, struct job_spec *spec)
{
    uint64_t k = replicates == 0 ? DEFAULT_REPLICATES : replicates;
    if (spp < 2 * k)
        k = spp < 2 ? 1 : spp / 2;

    uint64_t b = DEFAULT_LEAF_SAMPLES;
    while (b > 1 && spp < b * k)
        b /= 2;

    spec->replicates = (uint32_t)k;
    spec->leaf_samples = (uint32_t)b;
    return job_samples(spec, job_rounds(spec, spp));
}

uint64_t job_shape_in_fours(uint64_t spp, uint32_t replicates, struct job_spec *spec)
{
    uint64_t k = replicates == 0 ? DEFAULT_REPLICATES : replicates;
    if (spp < 4 * k)
        k = spp < 4 ? 1 : spp / 4;

    spec->replicates = (uint32_t)k;
    spec->leaf_samples = 4;
    return job_samples(spec, job_rounds(spec, spp));
}

bool job_shape_pilot(uint64_t spp, struct job_spec *spec)
{
    uint64_t of_leaf = (uint64_t)spec->replicates * spec->leaf_samples, leaves = 1;
    if (spec->replicates < 2 || (spp != 0 && spp / 16 < of_leaf))
        return false;
    while (leaves < (uint64_t)1 << 20 && 2 * leaves * of_leaf <= spp / 32)
        leaves *= 2;
    spec->pilot_rounds = round_reaching(leaves) + 1;
    uint64_t samples = leaves * of_leaf;
    spec->pilot_weight = spp == 0 ? 0 : (uint32_t)((samples << 14) / (spp + samples));
    return true;
}

/* Mitchell's outer piece is (2 - x)^2 ((B/6 + C)(2 - x) - C): negative near 2 for any C > 0. */
bool job_in_fours(const struct filter_spec *filter)
{
    return filter->kind == FILTER_MITCHELL && (filter->c > 0 || filter->b > 3);
}
