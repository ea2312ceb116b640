/*
 * A renderer without rays, for tests of the farm: every sample of every pixel is a hash of (seed,
 * tile, replicate, sample, pixel, channel), uniform in [0, 1), so that any mistake in the sum tree
 * changes the image and the mean is known. Two settings from the environment, read at open:
 *   PATHFARM_SIMULATED_US    microseconds that a leaf takes (it sleeps; 0)
 *   PATHFARM_SIMULATED_FAIL  a tile whose leaves fail (none)
 */
#include "worker/renderer.h"

#include "common/err.h"
#include "common/hash.h"
#include "common/job.h"
#include "proto/digest.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

struct renderer {
    const struct scene *scene;
    struct job_spec spec;
    uint64_t leaf_us;
    uint64_t failing_tile; /* UINT64_MAX: none */
};

static void render(const struct job_spec *spec, uint32_t tile, uint32_t replicate, uint64_t leaf,
                   struct node_sums *sums)
{
    uint64_t samples = (uint64_t)spec->leaf_samples * sums->pixel_count;
    uint64_t key = hash64_3(spec->seed, tile, replicate);
    float largest = 0;

    for (uint32_t c = 0; c < sums->channel_count; c++)
        for (uint32_t p = 0; p < sums->pixel_count; p++) {
            double sum = 0;
            for (uint32_t s = 0; s < spec->leaf_samples; s++) {
                uint64_t sample = leaf * spec->leaf_samples + s;
                uint64_t bits = hash64_3(key, sample, (uint64_t)c << 32 | p);
                float value = (float)(bits >> 40) * 0x1p-24f;
                sum += value;
                largest = value > largest ? value : largest;
            }
            sums->values[(size_t)c * sums->pixel_count + p] = (float)sum;
        }
    sums->stats = (struct node_stats){
        .samples = samples,
        .rays_closest = 2 * samples,
        .rays_shadow = samples,
        .events = samples,
        .largest = largest,
    };
    memset(sums->failed, 0, sizeof(sums->failed));
}

static bool simulated_profile(uint8_t digest[32], char *text, size_t capacity, struct err *err)
{
    struct job_spec spec = { .seed = 1, .leaf_samples = 4, .channel_count = 3 };
    struct node_sums *sums = node_sums_new(TILE_PIXELS, spec.channel_count);
    if (sums == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the sums of one tile");
    render(&spec, 2, 3, 5, sums);

    size_t bytes = sizeof(float) * sums->pixel_count * sums->channel_count;
    struct digest values = digest_of(sums->values, bytes);
    memcpy(digest, values.bytes, sizeof(values.bytes));
    node_sums_free(sums);
    snprintf(text, capacity, "simulated 1");
    return true;
}

static uint64_t setting(const char *name, uint64_t otherwise)
{
    const char *text = getenv(name);
    char *end;
    if (text == NULL || *text == '\0')
        return otherwise;
    uint64_t value = strtoull(text, &end, 10);
    return *end == '\0' ? value : otherwise;
}

static struct renderer *simulated_open(const struct scene *scene, const struct job_spec *spec,
                                       unsigned threads, struct err *err)
{
    (void)threads;
    struct renderer *renderer = malloc(sizeof(*renderer));
    if (renderer == NULL) {
        err_set(err, ERR_MEMORY, "no memory for the simulated renderer");
        return NULL;
    }
    *renderer = (struct renderer){
        .scene = scene,
        .spec = *spec,
        .leaf_us = setting("PATHFARM_SIMULATED_US", 0),
        .failing_tile = setting("PATHFARM_SIMULATED_FAIL", UINT64_MAX),
    };
    return renderer;
}

/* There is no scratch memory, but NULL would say that it could not be had. */
static void *simulated_thread_open(struct renderer *renderer, struct err *err)
{
    (void)err;
    return renderer;
}

static void simulated_thread_close(struct renderer *renderer, void *thread)
{
    (void)renderer;
    (void)thread;
}

static void sleep_us(uint64_t us)
{
    struct timespec left = { (time_t)(us / 1000000), (long)(us % 1000000) * 1000 };
    while (nanosleep(&left, &left) != 0 && errno == EINTR)
        ;
}

static bool simulated_leaf(struct renderer *renderer, void *thread, uint32_t tile,
                           uint32_t replicate, uint64_t leaf, struct node_sums *sums,
                           struct err *err)
{
    (void)thread;
    if (tile == renderer->failing_tile)
        return err_set(err, ERR_RENDER, "simulated failure of tile %u", tile);
    if (renderer->leaf_us > 0)
        sleep_us(renderer->leaf_us);
    render(&renderer->spec, tile, replicate, leaf, sums);
    return true;
}

static void simulated_close(struct renderer *renderer)
{
    free(renderer);
}

const struct renderer_class renderer_simulated = {
    .name = "simulated",
    .profile = simulated_profile,
    .open = simulated_open,
    .thread_open = simulated_thread_open,
    .thread_close = simulated_thread_close,
    .leaf = simulated_leaf,
    .close = simulated_close,
};
