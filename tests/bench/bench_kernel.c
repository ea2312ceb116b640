/*
 * How close the kernel comes to bare Embree: render some leaves of a scene on one thread, record
 * their rays, and replay these one at a time through rtcIntersect1 and rtcOccluded1 with the same
 * scene and flags. Prints "kernel_ratio_NAME value", value = replay time / render time, the median
 * over runs of processor time, tile by tile in turns; and, for people, the rest as comments.
 *
 * Usage: bench_kernel NAME SCENE.pbrt [RUNS]
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "worker/kernel/kernel.h"
#include "worker/kernel/ray_log.h"
#include "worker/profile.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define LEAVES 8 /* per tile; of the tiles, as many as make about a second */

static double cpu_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *values, int count)
{
    qsort(values, (size_t)count, sizeof(*values), by_value);
    return values[count / 2];
}

/* Render the first `leaves` leaves of a tile; camera paths traced, or 0 after an error */
static uint64_t render(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile,
                       unsigned leaves, struct err *err)
{
    struct tile_rect rect = tile_rect(ks->scene, tile);
    struct node_sums *sums = node_sums_new(rect.width * rect.height, 3);
    if (sums == NULL)
        return 0;
    uint64_t samples = 0;
    for (unsigned leaf = 0; leaf < leaves; leaf++) {
        if (!kernel_leaf(ks, thread, tile, 0, leaf, sums, err)) {
            samples = 0;
            break;
        }
        samples += sums->stats.samples;
    }
    node_sums_free(sums);
    return samples;
}

/* Trace the rays [first, end) of the log again */
static size_t replay(const struct kernel_scene *ks, const struct ray_log *log, size_t first,
                     size_t end)
{
    size_t hits = 0;
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (size_t i = first; i < end; i++) {
        const struct logged_ray *r = &log->rays[i];
        if (r->shadow) {
            struct RTCRay ray = { .org_x = r->o[0],
                                  .org_y = r->o[1],
                                  .org_z = r->o[2],
                                  .dir_x = r->d[0],
                                  .dir_y = r->d[1],
                                  .dir_z = r->d[2],
                                  .tfar = r->tfar,
                                  .mask = ~0u };
            rtcOccluded1(ks->rtc, &context, &ray);
            hits += ray.tfar < 0;
        } else {
            struct RTCRayHit hit = { .ray = { .org_x = r->o[0],
                                              .org_y = r->o[1],
                                              .org_z = r->o[2],
                                              .dir_x = r->d[0],
                                              .dir_y = r->d[1],
                                              .dir_z = r->d[2],
                                              .tfar = r->tfar,
                                              .mask = ~0u },
                                     .hit = { .geomID = RTC_INVALID_GEOMETRY_ID } };
            rtcIntersect1(ks->rtc, &context, &hit);
            hits += hit.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        }
    }
    return hits;
}

int main(int argc, char **argv)
{
    if (argc < 3) {
        fprintf(stderr, "usage: bench_kernel NAME SCENE.pbrt [RUNS]\n");
        return 2;
    }
    int runs = argc > 3 ? atoi(argv[3]) : 5;
    if (runs < 1 || runs > 99)
        runs = 5;
    struct err err = { .code = ERR_OK };
    struct scene *scene = pbrt_read(argv[2], NULL, NULL, &err);
    if (scene == NULL)
        goto fail;
    if (!pbrt_set_resolution(scene, 256, 256, &err))
        goto fail;
    profile_thread_mode();
    struct job_spec spec = { .seed = 1,
                             .replicates = 1,
                             .leaf_samples = 4,
                             .channel_count = 3,
                             .depth_cap = 65536,
                             .max_lanes = 8 };
    struct kernel_scene *ks = kernel_open(scene, &spec, &err);
    if (ks == NULL)
        goto fail;
    struct kernel_thread *thread = kernel_thread_open(ks, &err);
    if (thread == NULL)
        goto fail;

    struct ray_log log = { .capacity = (size_t)64 << 20 >> 3 };
    log.rays = malloc(log.capacity * sizeof(*log.rays));
    if (log.rays == NULL)
        goto fail;
    /* Which rays belong to which tile; fewer leaves where the log would run over */
    uint32_t tiles = tile_count(scene);
    size_t *first = calloc((size_t)tiles + 1, sizeof(*first));
    if (first == NULL)
        goto fail;
    unsigned leaves = LEAVES * 2;
    thread->log = &log;
    do {
        leaves /= 2;
        log.count = log.dropped = 0;
        for (uint32_t tile = 0; tile < tiles; tile++) {
            if (render(ks, thread, tile, leaves, &err) == 0)
                goto fail;
            first[tile + 1] = log.count;
        }
    } while (leaves > 1 && log.dropped > 0);
    thread->log = NULL;

    /* Tile by tile in turns, so that what disturbs the machine disturbs both */
    double ratios[99], speeds[99];
    for (int run = 0; run < runs; run++) {
        uint64_t samples = 0;
        size_t hits = 0;
        double rendering = 0, replaying = 0;
        for (uint32_t tile = 0; tile < tiles; tile++) {
            double t0 = cpu_seconds();
            samples += render(ks, thread, tile, leaves, &err);
            double t1 = cpu_seconds();
            hits += replay(ks, &log, first[tile], first[tile + 1]);
            double t2 = cpu_seconds();
            rendering += t1 - t0;
            replaying += t2 - t1;
        }
        if (samples == 0 || hits == 0)
            goto fail;
        ratios[run] = replaying / rendering;
        speeds[run] = (double)samples / rendering * 1e-6;
    }
    double ratio = median(ratios, runs);
    printf("kernel_ratio_%s %.3f\n", argv[1], ratio);
    printf("# %s: variant %s, %zu rays, %.3f Mpaths/s on one thread; ratios %.3f to %.3f\n",
           argv[1], ks->variant, log.count, median(speeds, runs), ratios[0], ratios[runs - 1]);
    free(first);
    free(log.rays);
    kernel_thread_close(thread);
    kernel_close(ks);
    scene_free(scene);
    return 0;

fail:
    fprintf(stderr, "bench_kernel: %s\n", err.code != ERR_OK ? err.text : "out of memory");
    return 1;
}
