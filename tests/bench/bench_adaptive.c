/*
 * What --adaptive gains, in one process and without a wire: a scene is rendered with SEEDS seeds,
 * with all tiles alike and with a plan, and the variance over the seeds is compared for equal work.
 * No reference is needed: relMSE here is that variance over (mean of everything)^2 + 0.01, as if
 * the mean were the truth, and has no bias by that.
 *
 * Prints a line of "name value" pairs: both relMSE, the work of each in closest-hit rays and in
 * seconds of the processor, the gain for equal work (with a standard error) and seconds, the gain
 * that the pilots predicted (mean), and the gain that the tiles' true errors and work would allow
 * at most, without a pilot, limits and rounding (Neyman).
 *
 * Usage: bench_adaptive SCENE.pbrt SPP SEEDS SIDE [tiles]
 * With "tiles" each tile's error, work counts and seconds follow, a line each.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/film.h"
#include "master/image.h"
#include "master/pbrt.h"
#include "master/tile_plan.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* One of the two ways to spend the samples. */
struct way {
    float *values; /* of every seed: [seed][channel][pixel] */
    double *sum;   /* of those over the seeds */
    double *seed_error, *tile_error;
    struct node_stats *tile_stats;
    double *tile_s;
    double work, seconds, predicted;
};

struct bench {
    struct scene *scene;
    uint64_t spp;
    uint32_t seeds, tiles, values;
    struct way ways[2]; /* all alike, adaptive */
};

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* All pairs, from the round of the job that is done to the end of another. */
static bool render_rounds(const struct bench *bench, struct way *way, struct kernel_scene *ks,
                          struct kernel_thread *thread, struct film *film, unsigned to,
                          struct err *err)
{
    const struct tile_plan *plan = film_plan(film);
    for (uint32_t tile = 0; tile < bench->tiles; tile++) {
        struct tile_rect rect = tile_rect(bench->scene, tile);
        double begin = now_s();
        for (uint32_t s = 0; s < tile_plan_sequences(plan); s++) {
            unsigned done = film_pair_rounds(film, tile, s);
            unsigned own = tile_plan_pair_rounds(plan, tile, s, to);
            uint64_t leaf = done == 0 ? 0 : round_end(done - 1);
            for (; own > 0 && leaf < round_end(own - 1); leaf++) {
                struct node_id node = { .tile = tile, .replicate = s, .index = leaf };
                struct node_sums *sums = node_sums_new(rect.width * rect.height, 3);
                if (sums == NULL || !kernel_leaf(ks, thread, tile, s, leaf, sums, err))
                    return false;
                node_stats_add(&way->tile_stats[tile], &sums->stats);
                way->work += tile_plan_work(&sums->stats);
                film_accept(film, &node, sums);
            }
        }
        way->tile_s[tile] += now_s() - begin;
        way->seconds += now_s() - begin;
    }
    return film_rounds(film) == to;
}

static bool render(const struct bench *bench, struct way *way, uint32_t seed, bool adaptive,
                   struct err *err)
{
    float *values = way->values + (size_t)seed * bench->values;
    struct job_spec spec = {
        .seed = 1000 + (uint64_t)seed, .channel_count = 3, .depth_cap = 65536, .max_lanes = 8
    };
    if (bench->scene->settings.max_depth < spec.depth_cap)
        spec.depth_cap = bench->scene->settings.max_depth;
    if (job_in_fours(&bench->scene->settings.filter))
        job_shape_in_fours(bench->spp, 0, &spec);
    else
        job_shape(bench->spp, 0, &spec);
    if (adaptive && !job_shape_pilot(bench->spp, &spec))
        return err_set(err, ERR_ARGUMENT, "too few samples for a pilot");
    unsigned rounds = job_rounds(&spec, bench->spp);

    bool done = false;
    struct film *film = film_new(bench->scene, &spec, rounds, 0, err);
    struct kernel_scene *ks = kernel_open(bench->scene, &spec, err);
    struct kernel_thread *thread = ks == NULL ? NULL : kernel_thread_open(ks, err);
    struct image *image = film == NULL ? NULL : film_image_new(film);
    if (film == NULL || thread == NULL || image == NULL)
        goto fail;
    if (adaptive && (!render_rounds(bench, way, ks, thread, film, spec.pilot_rounds, err) ||
                     !film_make_plan(film, rounds, err)))
        goto fail;
    if (!render_rounds(bench, way, ks, thread, film, rounds, err) ||
        !film_image(film, image, NULL, err))
        goto fail;
    way->predicted += film_plan(film)->predicted_gain / bench->seeds;
    uint32_t pixels = image->width * image->height;
    for (uint32_t c = 0; c < 3; c++) {
        const float *plane = image_channel(image, (const char *[]){ "R", "G", "B" }[c]);
        memcpy(values + c * pixels, plane, pixels * sizeof(*plane));
        for (uint32_t p = 0; p < pixels; p++)
            way->sum[c * pixels + p] += (double)plane[p];
    }
    done = true;

fail:
    image_free(image);
    kernel_thread_close(thread);
    kernel_close(ks);
    film_free(film);
    return done;
}

/* The variance over seeds, relative, of each tile; returns the picture's mean. */
static double relmse(const struct bench *bench, struct way *way)
{
    const struct scene_settings *s = &bench->scene->settings;
    uint32_t width = s->crop[1] - s->crop[0], pixels = bench->values / 3;
    double n = bench->seeds, total = 0;
    for (uint32_t tile = 0; tile < bench->tiles; tile++) {
        struct tile_rect rect = tile_rect(bench->scene, tile);
        for (uint32_t y = 0; y < rect.height; y++)
            for (uint32_t x = 0; x < rect.width; x++)
                for (uint32_t c = 0; c < 3; c++) {
                    size_t at = c * (size_t)pixels + (rect.y - s->crop[2] + y) * (size_t)width +
                                rect.x - s->crop[0] + x;
                    double truth = (bench->ways[0].sum[at] + bench->ways[1].sum[at]) / (2 * n);
                    double mean = way->sum[at] / n;
                    for (uint32_t s = 0; s < bench->seeds; s++) {
                        double off = (double)way->values[s * (size_t)bench->values + at] - mean;
                        double error = off * off / (n - 1) / (truth * truth + 0.01);
                        way->seed_error[s] += error;
                        way->tile_error[tile] += error;
                    }
                }
        total += way->tile_error[tile];
    }
    return total / bench->values;
}

/* The relative standard error of a relMSE, from those of its seeds */
static double noise(const struct bench *bench, const struct way *way)
{
    double n = bench->seeds, sum = 0, squares = 0;
    for (uint32_t s = 0; s < bench->seeds; s++)
        sum += way->seed_error[s];
    for (uint32_t s = 0; s < bench->seeds; s++)
        squares += (way->seed_error[s] - sum / n) * (way->seed_error[s] - sum / n);
    return sqrt(squares * n / (n - 1)) / sum;
}

static bool way_open(const struct bench *bench, struct way *way)
{
    way->sum = calloc(bench->values, sizeof(*way->sum));
    way->values = calloc((size_t)bench->values * bench->seeds, sizeof(*way->values));
    way->seed_error = calloc(bench->seeds, sizeof(*way->seed_error));
    way->tile_error = calloc(bench->tiles, sizeof(*way->tile_error));
    way->tile_stats = calloc(bench->tiles, sizeof(*way->tile_stats));
    way->tile_s = calloc(bench->tiles, sizeof(*way->tile_s));
    return way->sum != NULL && way->values != NULL && way->seed_error != NULL &&
           way->tile_error != NULL && way->tile_stats != NULL && way->tile_s != NULL;
}

static void way_close(struct way *way)
{
    free(way->sum);
    free(way->values);
    free(way->seed_error);
    free(way->tile_error);
    free(way->tile_stats);
    free(way->tile_s);
}

static void print_result(struct bench *bench)
{
    struct way *alike = &bench->ways[0], *adaptive = &bench->ways[1];
    double a = relmse(bench, alike), b = relmse(bench, adaptive);
    double error = 0, work = 0, both = 0;
    for (uint32_t tile = 0; tile < bench->tiles; tile++) {
        double w = tile_plan_work(&alike->tile_stats[tile]);
        error += alike->tile_error[tile];
        work += w;
        both += sqrt(alike->tile_error[tile] * w);
    }
    double gain = a * alike->work / (b * adaptive->work);
    double of_a = noise(bench, alike), of_b = noise(bench, adaptive);
    printf("uniform %.4g adaptive %.4g work_ratio %.3f seconds_ratio %.3f gain %.3f gain_stderr "
           "%.3f gain_seconds %.3f predicted %.3f possible %.3f\n",
           a, b, adaptive->work / alike->work, adaptive->seconds / alike->seconds, gain,
           gain * sqrt(of_a * of_a + of_b * of_b), a * alike->seconds / (b * adaptive->seconds),
           adaptive->predicted, error * work / (both * both));
}

int main(int argc, char **argv)
{
    if (argc < 5) {
        fprintf(stderr, "usage: bench_adaptive SCENE.pbrt SPP SEEDS SIDE [tiles]\n");
        return 2;
    }
    struct err err = { .code = ERR_OK };
    uint32_t side = (uint32_t)strtoul(argv[4], NULL, 10);
    struct bench bench = { .spp = strtoull(argv[2], NULL, 10),
                           .seeds = (uint32_t)strtoul(argv[3], NULL, 10),
                           .values = 3 * side * side,
                           .scene = pbrt_read(argv[1], NULL, NULL, &err) };
    int status = 1;
    if (bench.scene == NULL || !pbrt_set_resolution(bench.scene, side, side, &err))
        goto fail;
    profile_thread_mode();
    bench.tiles = tile_count(bench.scene);
    if (!way_open(&bench, &bench.ways[0]) || !way_open(&bench, &bench.ways[1]))
        goto fail;
    for (uint32_t seed = 0; seed < bench.seeds; seed++)
        for (int i = 0; i < 2; i++)
            if (!render(&bench, &bench.ways[i], seed, i == 1, &err))
                goto fail;
    print_result(&bench);
    if (argc > 5)
        for (uint32_t tile = 0; tile < bench.tiles; tile++) {
            const struct node_stats *stats = &bench.ways[0].tile_stats[tile];
            printf("tile %u error %.4g adaptive %.4g share %.3f samples %llu closest %llu shadow "
                   "%llu events %llu seconds %.4f\n",
                   tile, bench.ways[0].tile_error[tile], bench.ways[1].tile_error[tile],
                   (double)bench.ways[1].tile_stats[tile].samples / (double)stats->samples,
                   (unsigned long long)stats->samples, (unsigned long long)stats->rays_closest,
                   (unsigned long long)stats->rays_shadow, (unsigned long long)stats->events,
                   bench.ways[0].tile_s[tile]);
        }
    status = 0;
fail:
    if (status != 0)
        fprintf(stderr, "bench_adaptive: %s\n", err.code != ERR_OK ? err.text : "it failed");
    way_close(&bench.ways[0]);
    way_close(&bench.ways[1]);
    scene_free(bench.scene);
    return status;
}
