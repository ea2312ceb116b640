/*
 * How often is the stated error right? Renders one scene with many seeds, without farm and wire but
 * through the film and the estimator that every job has, and sets what they state beside the true
 * errors. No reference is needed: the other seeds' pictures are one. Against their mean an error
 * has the variance of the picture and 1 / (SEEDS - 1) of it more, which is taken off.
 *
 * Prints, for every SPP of the list:
 *   seed SPP SEED UNKNOWN_SHARE VERDICT MSE LOW HIGH TRUE VERDICT RELMSE LOW HIGH TRUE
 *   tile SPP TILE UNKNOWN VALUES    the share of seeds in which the tile was unknown; how many
 *                                   normal values would have its squared error's spread
 *   stderr SPP KIND COVERED COUNT   of the values in tiles that are vouched for, or unknown: those
 *                                   within Student's t standard errors of the truth, at 95 %
 *   error SPP MSE STDERR RELMSE STDERR    means over the seeds, of the true errors
 *
 * Usage: calibrate SCENE.pbrt SPP[,SPP...] SEEDS [--replicates K] [--side N] [--first SEED]
 *                  [--keep FILE]
 * SPP rises, and the first rounds of a larger one are a smaller one's. FILE keeps what was
 * rendered; if it is there already, nothing is rendered: for who works on the estimator.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/estimate.h"
#include "master/film.h"
#include "master/image.h"
#include "master/pbrt.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <getopt.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LEVELS_MAX 16

static const char *const CHANNELS[] = { "R", "G", "B" };
static const char *const STDERR_CHANNELS[] = { "stderr.R", "stderr.G", "stderr.B" };

/* What is kept of one seed at one number of samples */
struct outcome {
    struct accuracy accuracy;
    float *values, *errors; /* three planes each: picture, standard errors */
    bool *unknown;          /* [tile] */
};

struct level {
    uint64_t spp;
    unsigned rounds;
    struct outcome *outcomes; /* [seed] */
    double *mean;             /* three planes, over the seeds */
};

struct calibration {
    struct scene *scene;
    struct kernel_scene *ks;
    struct kernel_thread *thread;
    struct job_spec spec;
    struct estimate *estimate;
    struct image *image;
    FILE *kept;
    bool rendering; /* else all is read from `kept` */
    uint64_t first_seed;
    uint32_t seeds, tiles;
    size_t pixels;
    struct level levels[LEVELS_MAX];
    unsigned level_count;
};

/* The estimator says tile by tile what it vouches for: this listens (see CMakeLists.txt). */
bool __real_estimate_tile(struct estimate *estimate, const struct tile_means *tile);
bool __wrap_estimate_tile(struct estimate *estimate, const struct tile_means *tile);
static bool *next_unknown;

bool __wrap_estimate_tile(struct estimate *estimate, const struct tile_means *tile)
{
    bool vouched = __real_estimate_tile(estimate, tile);
    *next_unknown++ = !vouched;
    return vouched;
}

/* ---- rendering, or reading what was rendered */

static bool kept_bytes(struct calibration *c, void *bytes, size_t size)
{
    return c->rendering ? fwrite(bytes, size, 1, c->kept) == 1
                        : fread(bytes, size, 1, c->kept) == 1;
}

static bool make_leaf(struct calibration *c, const struct node_id *id, struct node_sums *sums,
                      struct err *err)
{
    if (c->rendering &&
        !kernel_leaf(c->ks, c->thread, id->tile, id->replicate, id->index, sums, err))
        return false;
    size_t values = (size_t)sums->pixel_count * sums->channel_count * sizeof(*sums->values);
    if (c->kept != NULL && (!kept_bytes(c, &sums->stats, sizeof(sums->stats)) ||
                            !kept_bytes(c, sums->failed, sizeof(sums->failed)) ||
                            !kept_bytes(c, sums->values, values)))
        return err_set(err, ERR_IO, "the kept leaves are of another run, or the disk is full");
    return true;
}

static bool add_leaf(struct calibration *c, struct film *film, const struct node_id *id,
                     struct err *err)
{
    struct node_sums *sums = node_sums_new(film_tile_pixels(film, id->tile), 3);
    if (sums == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a leaf");
    if (!make_leaf(c, id, sums, err))
        goto fail;
    enum film_result result = film_accept(film, id, sums);
    if (result == FILM_ADDED || result == FILM_SEALED)
        return true;
    err_set(err, ERR_INTERNAL, "the film refused a leaf");
fail:
    node_sums_free(sums);
    return false;
}

static bool look(struct calibration *c, const struct film *film, struct outcome *outcome,
                 struct err *err)
{
    size_t plane = c->pixels;
    outcome->values = malloc(3 * plane * sizeof(float));
    outcome->errors = malloc(3 * plane * sizeof(float));
    outcome->unknown = next_unknown = calloc(c->tiles, sizeof(bool));
    if (outcome->values == NULL || outcome->errors == NULL || outcome->unknown == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the pictures");
    if (!film_image(film, c->image, c->estimate, err))
        return false;
    outcome->accuracy = estimate_result(c->estimate);
    for (int i = 0; i < 3; i++) {
        memcpy(outcome->values + i * plane, image_channel(c->image, CHANNELS[i]),
               plane * sizeof(float));
        memcpy(outcome->errors + i * plane, image_channel(c->image, STDERR_CHANNELS[i]),
               plane * sizeof(float));
    }
    return true;
}

static bool run_seed(struct calibration *c, uint32_t seed, struct err *err)
{
    unsigned rounds = c->levels[c->level_count - 1].rounds;
    struct film *film = film_new(c->scene, &c->spec, rounds, 0, err);
    if (film == NULL)
        return false;
    /* Numbers alone are made of the seed: nothing else of an opened scene changes with it */
    if (c->rendering)
        c->ks->spec.seed = c->first_seed + seed;
    uint64_t leaf = 0;
    for (unsigned i = 0; i < c->level_count; i++) {
        for (uint64_t end = round_end(c->levels[i].rounds - 1); leaf < end; leaf++)
            for (uint32_t pair = 0; pair < c->tiles * c->spec.replicates; pair++) {
                struct node_id id = { .tile = pair / c->spec.replicates,
                                      .replicate = pair % c->spec.replicates,
                                      .index = leaf };
                if (!add_leaf(c, film, &id, err))
                    goto fail;
            }
        if (!look(c, film, &c->levels[i].outcomes[seed], err))
            goto fail;
    }
    film_free(film);
    return true;

fail:
    film_free(film);
    return false;
}

/* ---- what came out */

static bool average(struct calibration *c, struct level *level)
{
    level->mean = calloc(3 * c->pixels, sizeof(double));
    if (level->mean == NULL)
        return false;
    for (uint32_t seed = 0; seed < c->seeds; seed++)
        for (size_t i = 0; i < 3 * c->pixels; i++)
            level->mean[i] += (double)level->outcomes[seed].values[i] / c->seeds;
    return true;
}

/* The picture's squared error, with that of the other seeds' mean taken off */
static double squared_error(const struct calibration *c, const struct level *level,
                            const struct outcome *outcome, size_t i)
{
    double distance = (double)outcome->values[i] - level->mean[i];
    return distance * distance * c->seeds / (c->seeds - 1.0);
}

static double others_mean(const struct calibration *c, const struct level *level,
                          const struct outcome *outcome, size_t i)
{
    return level->mean[i] + (level->mean[i] - (double)outcome->values[i]) / (c->seeds - 1.0);
}

struct spread {
    double n, mean, m2;
};

static void spread_add(struct spread *s, double x)
{
    double d = x - s->mean;
    s->n++;
    s->mean += d / s->n;
    s->m2 += d * (x - s->mean);
}

static double spread_stderr(const struct spread *s)
{
    return sqrt(s->m2 / (s->n - 1) / s->n);
}

static void print_seeds(const struct calibration *c, const struct level *level)
{
    static const char *const verdicts[] = {
#define X(name, text) #name,
        ACCURACY_MAP(X)
#undef X
    };
    struct spread mse = { 0 }, relmse = { 0 };
    for (uint32_t seed = 0; seed < c->seeds; seed++) {
        const struct outcome *outcome = &level->outcomes[seed];
        const struct accuracy *a = &outcome->accuracy;
        double absolute = 0, relative = 0, values = 3 * (double)c->pixels;
        for (size_t i = 0; i < 3 * c->pixels; i++) {
            double squared = squared_error(c, level, outcome, i);
            double r = others_mean(c, level, outcome, i);
            absolute += squared / values;
            relative += squared / (r * r + 0.01) / values;
        }
        spread_add(&mse, absolute);
        spread_add(&relmse, relative);
        printf("seed %" PRIu64 " %" PRIu64 " %.5f %s %.9g %.9g %.9g %.9g %s %.9g %.9g %.9g %.9g\n",
               level->spp, c->first_seed + seed, a->unknown_share, verdicts[a->mse_verdict], a->mse,
               a->mse95.low, a->mse95.high, absolute, verdicts[a->verdict], a->relmse,
               a->relmse95.low, a->relmse95.high, relative);
    }
    printf("error %" PRIu64 " %.9g %.3g %.9g %.3g\n", level->spp, mse.mean, spread_stderr(&mse),
           relmse.mean, spread_stderr(&relmse));
}

struct counts {
    uint64_t covered, all;
};

/* A value that nothing ever moves, as of a light seen directly, says nothing either way */
static void count_value(const struct calibration *c, const struct level *level,
                        const struct outcome *outcome, size_t i, struct counts *counts)
{
    double error = sqrt(squared_error(c, level, outcome, i));
    double stated = (double)outcome->errors[i];
    if (stated == 0 && error < 1e-6 * fabs(level->mean[i]) + 1e-12)
        return;
    counts->all++;
    counts->covered += error <= estimate_student(film_stderr_dof(c->spec.replicates)) * stated;
}

static void print_tiles(const struct calibration *c, const struct level *level)
{
    struct counts counts[2] = { { 0 } };
    const uint32_t *crop = c->scene->settings.crop;
    for (uint32_t tile = 0; tile < c->tiles; tile++) {
        struct tile_rect rect = tile_rect(c->scene, tile);
        struct spread spread = { 0 };
        uint32_t unknown = 0;
        for (uint32_t seed = 0; seed < c->seeds; seed++) {
            const struct outcome *outcome = &level->outcomes[seed];
            double sum = 0;
            unknown += outcome->unknown[tile];
            for (uint32_t y = rect.y; y < rect.y + rect.height; y++)
                for (uint32_t x = rect.x; x < rect.x + rect.width; x++)
                    for (size_t channel = 0; channel < 3; channel++) {
                        size_t i = channel * c->pixels + (size_t)(y - crop[2]) * c->image->width +
                                   x - crop[0];
                        sum += squared_error(c, level, outcome, i);
                        count_value(c, level, outcome, i, &counts[outcome->unknown[tile]]);
                    }
            spread_add(&spread, sum);
        }
        double variance = spread.m2 / (spread.n - 1);
        printf("tile %" PRIu64 " %u %.4f %.4g\n", level->spp, tile, (double)unknown / c->seeds,
               variance > 0 ? 2 * spread.mean * spread.mean / variance : INFINITY);
    }
    static const char *const kinds[] = { "vouched", "unknown" };
    for (int i = 0; i < 2; i++)
        printf("stderr %" PRIu64 " %s %" PRIu64 " %" PRIu64 "\n", level->spp, kinds[i],
               counts[i].covered, counts[i].all);
}

/* ---- opening and closing */

static bool read_levels(struct calibration *c, char *list, uint32_t replicates, struct err *err)
{
    uint64_t most = 0;
    for (char *item = strtok(list, ","); item != NULL; item = strtok(NULL, ",")) {
        if (c->level_count == LEVELS_MAX)
            return err_set(err, ERR_ARGUMENT, "more than %d numbers of samples", LEVELS_MAX);
        uint64_t spp = strtoull(item, NULL, 10);
        if (spp <= most)
            return err_set(err, ERR_ARGUMENT, "numbers of samples must rise, and %s does not",
                           item);
        c->levels[c->level_count++].spp = most = spp;
    }
    if (c->level_count == 0 || c->seeds < 2)
        return err_set(err, ERR_ARGUMENT, "at least one number of samples and two seeds");

    job_shape(c->levels[0].spp, replicates, &c->spec);
    for (unsigned i = 0; i < c->level_count; i++) {
        struct level *level = &c->levels[i];
        level->rounds = job_rounds(&c->spec, level->spp);
        level->spp = job_samples(&c->spec, level->rounds);
        level->outcomes = calloc(c->seeds, sizeof(*level->outcomes));
        if (level->outcomes == NULL)
            return err_set(err, ERR_MEMORY, "no memory for %u seeds", c->seeds);
    }
    return true;
}

static bool open_kept(struct calibration *c, const char *path, struct err *err)
{
    c->rendering = true;
    if (path == NULL)
        return true;
    c->kept = fopen(path, "rb");
    c->rendering = c->kept == NULL;
    if (c->rendering)
        c->kept = fopen(path, "wb");
    return c->kept != NULL || err_set(err, ERR_IO, "%s cannot be written", path);
}

static bool open_kernel(struct calibration *c, struct err *err)
{
    profile_thread_mode();
    c->spec.channel_count = 3;
    c->spec.depth_cap = 65536;
    c->spec.max_lanes = LANES;
    if (!c->rendering)
        return true;
    c->ks = kernel_open(c->scene, &c->spec, err);
    if (c->ks != NULL)
        c->thread = kernel_thread_open(c->ks, err);
    return c->thread != NULL;
}

static bool calibrate(struct calibration *c, struct err *err)
{
    for (uint32_t seed = 0; seed < c->seeds; seed++)
        if (!run_seed(c, seed, err))
            return false;
    for (unsigned i = 0; i < c->level_count; i++) {
        if (!average(c, &c->levels[i]))
            return err_set(err, ERR_MEMORY, "no memory for the mean picture");
        print_seeds(c, &c->levels[i]);
        print_tiles(c, &c->levels[i]);
    }
    return true;
}

static void release(struct calibration *c)
{
    for (unsigned i = 0; i < c->level_count; i++) {
        for (uint32_t s = 0; c->levels[i].outcomes != NULL && s < c->seeds; s++) {
            free(c->levels[i].outcomes[s].values);
            free(c->levels[i].outcomes[s].errors);
            free(c->levels[i].outcomes[s].unknown);
        }
        free(c->levels[i].outcomes);
        free(c->levels[i].mean);
    }
    if (c->kept != NULL)
        fclose(c->kept);
    estimate_free(c->estimate);
    image_free(c->image);
    kernel_thread_close(c->thread);
    kernel_close(c->ks);
    scene_free(c->scene);
}

int main(int argc, char **argv)
{
    static const struct option options[] = { { "replicates", required_argument, NULL, 'k' },
                                             { "side", required_argument, NULL, 's' },
                                             { "first", required_argument, NULL, 'n' },
                                             { "keep", required_argument, NULL, 'f' },
                                             { 0 } };
    uint32_t replicates = 0, side = 128;
    uint64_t first_seed = 0;
    const char *keep = NULL;
    int option;
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1) {
        if (option == 'k')
            replicates = (uint32_t)strtoul(optarg, NULL, 10);
        else if (option == 's')
            side = (uint32_t)strtoul(optarg, NULL, 10);
        else if (option == 'n')
            first_seed = strtoull(optarg, NULL, 10);
        else if (option == 'f')
            keep = optarg;
        else
            return 2;
    }
    if (argc - optind != 3) {
        fprintf(stderr, "usage: calibrate SCENE.pbrt SPP[,SPP...] SEEDS [--replicates K] "
                        "[--side N] [--first SEED] [--keep FILE]\n");
        return 2;
    }

    struct err err = { .code = ERR_OK };
    struct calibration c = { .first_seed = first_seed,
                             .seeds = (uint32_t)strtoul(argv[optind + 2], NULL, 10) };
    c.scene = pbrt_read(argv[optind], NULL, NULL, &err);
    bool good = c.scene != NULL && pbrt_set_resolution(c.scene, side, side, &err) &&
                read_levels(&c, argv[optind + 1], replicates, &err) && open_kept(&c, keep, &err) &&
                open_kernel(&c, &err);
    if (good) {
        const uint32_t *crop = c.scene->settings.crop;
        uint32_t width = crop[1] - crop[0], height = crop[3] - crop[2];
        c.pixels = (size_t)width * height;
        c.tiles = tile_count(c.scene);
        c.image = image_new(width, height);
        c.estimate = estimate_new();
        good = (c.image != NULL && c.estimate != NULL) || err_set(&err, ERR_MEMORY, "no memory");
    }
    good = good && calibrate(&c, &err);
    if (!good)
        fprintf(stderr, "calibrate: %s\n", err.text);
    release(&c);
    return good ? 0 : 1;
}
