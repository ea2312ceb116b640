/*
 * A job without its farm: what `pathfarm render` computes, in one process and without a wire. Two
 * (or THREADS) threads take the pairs of tile and replicate in order, render their leaves, and add
 * them up along the sum tree as a film does. What the farm costs is the difference between the two.
 *
 * Prints "seconds samples" of the rendering alone: from when the scene is ready to the last sum.
 *
 * Usage: bench_inprocess SCENE.pbrt SPP THREADS SIDE
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define THREADS_MAX 64

struct bench {
    struct scene *scene;
    struct kernel_scene *ks;
    uint32_t pairs, replicates;
    uint64_t leaves;        /* of a pair */
    struct sum_stack *film; /* one per pair */
    atomic_uint next_pair;
    atomic_ullong samples;
    atomic_bool failed;
};

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* All leaves of a pair, in order, onto its binary counter */
static bool render_pair(struct bench *bench, struct kernel_thread *thread, uint32_t pair,
                        struct err *err)
{
    uint32_t tile = pair / bench->replicates, replicate = pair % bench->replicates;
    struct tile_rect rect = tile_rect(bench->scene, tile);
    for (uint64_t i = 0; i < bench->leaves; i++) {
        struct node_sums *leaf = node_sums_new(rect.width * rect.height, 3);
        if (leaf == NULL || !kernel_leaf(bench->ks, thread, tile, replicate, i, leaf, err)) {
            node_sums_free(leaf);
            return false;
        }
        atomic_fetch_add(&bench->samples, leaf->stats.samples);
        sum_stack_push(&bench->film[pair], 0, leaf);
    }
    return true;
}

static void *work(void *context)
{
    struct bench *bench = context;
    struct err err = { .code = ERR_OK };
    profile_thread_mode();
    struct kernel_thread *thread = kernel_thread_open(bench->ks, &err);
    while (thread != NULL && !atomic_load(&bench->failed)) {
        uint32_t pair = atomic_fetch_add(&bench->next_pair, 1);
        if (pair >= bench->pairs)
            break;
        if (!render_pair(bench, thread, pair, &err))
            atomic_store(&bench->failed, true);
    }
    if (thread == NULL)
        atomic_store(&bench->failed, true);
    kernel_thread_close(thread);
    return NULL;
}

static bool run(struct bench *bench, unsigned threads)
{
    pthread_t thread[THREADS_MAX];
    unsigned started = 0;
    while (started < threads && pthread_create(&thread[started], NULL, work, bench) == 0)
        started++;
    for (unsigned i = 0; i < started; i++)
        pthread_join(thread[i], NULL);
    return started == threads && !atomic_load(&bench->failed);
}

int main(int argc, char **argv)
{
    if (argc != 5) {
        fprintf(stderr, "usage: bench_inprocess SCENE.pbrt SPP THREADS SIDE\n");
        return 2;
    }
    uint64_t spp = strtoull(argv[2], NULL, 10);
    unsigned threads = (unsigned)strtoul(argv[3], NULL, 10);
    uint32_t side = (uint32_t)strtoul(argv[4], NULL, 10);
    if (threads < 1 || threads > THREADS_MAX)
        threads = 1;
    struct err err = { .code = ERR_OK };
    struct job_spec spec = { .channel_count = 3, .depth_cap = 65536, .max_lanes = 8 };
    struct bench bench = { .scene = pbrt_read(argv[1], NULL, NULL, &err) };
    int status = 1;
    if (bench.scene == NULL || !pbrt_set_resolution(bench.scene, side, side, &err))
        goto fail_scene;

    profile_thread_mode();
    if (bench.scene->settings.max_depth < spec.depth_cap)
        spec.depth_cap = bench.scene->settings.max_depth;
    spp = job_shape(spp, 0, &spec);
    bench.replicates = spec.replicates;
    bench.leaves = round_end(job_rounds(&spec, spp) - 1);
    bench.pairs = tile_count(bench.scene) * spec.replicates;
    bench.ks = kernel_open(bench.scene, &spec, &err);
    if (bench.ks == NULL)
        goto fail_scene;
    bench.film = calloc(bench.pairs, sizeof(*bench.film));
    if (bench.film == NULL)
        goto fail_film;

    double begin = now_s();
    if (run(&bench, threads)) {
        printf("%.4f %llu\n", now_s() - begin, atomic_load(&bench.samples));
        status = 0;
    }
    for (uint32_t pair = 0; pair < bench.pairs; pair++)
        sum_stack_clear(&bench.film[pair]);
    free(bench.film);
fail_film:
    kernel_close(bench.ks);
fail_scene:
    scene_free(bench.scene);
    if (status != 0)
        fprintf(stderr, "bench_inprocess: %s\n", err.code != ERR_OK ? err.text : "it failed");
    return status;
}
