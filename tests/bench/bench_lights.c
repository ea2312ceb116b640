/*
 * What it is worth to choose lights by receiver: the same scene, kernel and samples, with lights
 * chosen in the tree and by power alone, in turns. Prints "many_lights_gain value": time to equal
 * relMSE by power / in the tree, which is the ratio of relMSE x seconds of processor time. The
 * errors are those between independent replicates, so no reference is needed; as means, relMSE's
 * denominators, serve those of all pictures of the tree.
 *
 * Usage: bench_lights SCENE.pbrt [SAMPLES [REPLICATES]]
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define LEAF_SAMPLES 4

enum choice { BY_TREE, BY_TABLE, BY_POWER, CHOICES };
static const char *const names[CHOICES] = { "tree", "half by power, half evenly", "power" };

struct picture {
    double *sum, *squares; /* over replicates, of every pixel and channel */
    double seconds, paths;
};

static double seconds_of(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Probabilities of the table as the scene's power alone has them */
static void choose_by_power(struct kernel_scene *ks)
{
    double sum = 0;
    for (uint32_t i = 0; i < ks->light_count; i++) {
        sum += (double)ks->scene->lights[i].pick;
        ks->light_cdf[i + 1] = i + 1 < ks->light_count ? (float)sum : 1;
    }
    for (uint32_t i = 0; i < ks->light_count; i++)
        ks->light_pmf[i] = ks->light_cdf[i + 1] - ks->light_cdf[i];
}

/* One replicate of every pixel, added to the picture */
static bool render(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t replicate,
                   unsigned leaves, struct picture *picture, struct err *err)
{
    size_t at = 0;
    for (uint32_t tile = 0; tile < tile_count(ks->scene); tile++) {
        struct tile_rect rect = tile_rect(ks->scene, tile);
        uint32_t values = rect.width * rect.height * 3;
        struct node_sums *sums = node_sums_new(rect.width * rect.height, 3);
        double *means = calloc(values, sizeof(*means));
        bool good = sums != NULL && means != NULL;
        double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        for (unsigned leaf = 0; good && leaf < leaves; leaf++) {
            good = kernel_leaf(ks, thread, tile, replicate, leaf, sums, err);
            for (uint32_t i = 0; i < values; i++)
                means[i] += (double)sums->values[i] / (leaves * LEAF_SAMPLES);
            picture->paths += (double)sums->stats.samples;
        }
        picture->seconds += seconds_of(CLOCK_THREAD_CPUTIME_ID) - begin;
        for (uint32_t i = 0; good && i < values; i++, at++) {
            picture->sum[at] += means[i];
            picture->squares[at] += means[i] * means[i];
        }
        node_sums_free(sums);
        free(means);
        if (!good)
            return false;
    }
    return true;
}

static double relmse(const struct picture *p, const struct picture *mean, size_t values,
                     unsigned replicates)
{
    double total = 0, n = replicates;
    for (size_t i = 0; i < values; i++) {
        double variance = (p->squares[i] - p->sum[i] * p->sum[i] / n) / (n - 1);
        double m = mean->sum[i] / n;
        total += variance / (m * m + 0.01);
    }
    return total / (double)values;
}

int main(int argc, char **argv)
{
    if (argc < 2) {
        fprintf(stderr, "usage: bench_lights SCENE.pbrt [SAMPLES [REPLICATES]]\n");
        return 2;
    }
    int samples = argc > 2 ? atoi(argv[2]) : 16, replicates = argc > 3 ? atoi(argv[3]) : 8;
    unsigned leaves = samples > LEAF_SAMPLES ? (unsigned)samples / LEAF_SAMPLES : 1;
    if (replicates < 2)
        replicates = 2;
    struct err err = { .code = ERR_OK };
    struct scene *scene = pbrt_read(argv[1], NULL, NULL, &err);
    if (scene == NULL)
        goto fail;
    if (!pbrt_set_resolution(scene, 192, 128, &err))
        goto fail;
    profile_thread_mode();
    struct job_spec spec = { .seed = 1,
                             .replicates = (uint32_t)replicates,
                             .leaf_samples = LEAF_SAMPLES,
                             .channel_count = 3,
                             .depth_cap = 65536,
                             .max_lanes = 8,
                             .kernel = 1 }; /* the same kernel for all */
    struct kernel_scene *ks[CHOICES];
    struct kernel_thread *thread = NULL;
    struct picture pictures[CHOICES] = { 0 };
    size_t values = (size_t)192 * 128 * 3;
    for (int i = 0; i < CHOICES; i++) {
        double begin = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
        ks[i] = kernel_open(scene, &spec, &err);
        pictures[i].sum = calloc(values, sizeof(double));
        pictures[i].squares = calloc(values, sizeof(double));
        if (ks[i] == NULL || pictures[i].sum == NULL || pictures[i].squares == NULL)
            goto fail;
        if (i == BY_TREE) {
            printf("# %u lights, %.2f s to open\n", scene->light_count,
                   seconds_of(CLOCK_PROCESS_CPUTIME_ID) - begin);
            light_tree_close(&ks[i]->light_tree);
            begin = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
            if (!light_tree_open(&ks[i]->light_tree, scene, ks[i]->light_pmf, &err))
                goto fail;
            printf("# tree: %u nodes, %.1f MB, made in %.2f s\n", ks[i]->light_tree.node_count,
                   (double)ks[i]->light_tree.node_count * sizeof(struct light_node) * 1e-6,
                   seconds_of(CLOCK_PROCESS_CPUTIME_ID) - begin);
        } else {
            light_tree_close(&ks[i]->light_tree);
        }
        if (i == BY_POWER)
            choose_by_power(ks[i]);
    }
    thread = kernel_thread_open(ks[0], &err);
    if (thread == NULL)
        goto fail;
    for (uint32_t k = 0; k < (uint32_t)replicates; k++)
        for (int i = 0; i < CHOICES; i++)
            if (!render(ks[i], thread, k, leaves, &pictures[i], &err))
                goto fail;

    double cost[CHOICES];
    for (int i = 0; i < CHOICES; i++) {
        double error = relmse(&pictures[i], &pictures[BY_TREE], values, (unsigned)replicates);
        double mean = 0;
        for (size_t k = 0; k < values; k++)
            mean += pictures[i].sum[k] / (double)values / replicates;
        cost[i] = error * pictures[i].seconds;
        printf(
            "# %s: relMSE %.4g at %u samples in %.2f s, %.3f Mpaths/s on one thread; mean %.5g\n",
            names[i], error, leaves * LEAF_SAMPLES, pictures[i].seconds / replicates,
            pictures[i].paths / pictures[i].seconds * 1e-6, mean);
    }
    printf("many_lights_gain %.2f\n", cost[BY_POWER] / cost[BY_TREE]);
    printf("# against half by power, half evenly: %.2f\n", cost[BY_TABLE] / cost[BY_TREE]);
    for (int i = 0; i < CHOICES; i++) {
        kernel_close(ks[i]);
        free(pictures[i].sum);
        free(pictures[i].squares);
    }
    kernel_thread_close(thread);
    scene_free(scene);
    return 0;

fail:
    fprintf(stderr, "bench_lights: %s\n", err.code != ERR_OK ? err.text : "out of memory");
    return 1;
}
