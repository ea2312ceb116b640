#include "master/film.h"

#include "common/aov.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/estimate.h"
#include "master/image.h"
#include "master/layers.h"
#include "master/tile_plan.h"

#include <assert.h>
#include <inttypes.h>
#include <malloc.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SUMS_AT_ROUND_END 4 /* bits set in 2^m (8 + j) / 8 */

/* A round that is coming in. */
struct open_round {
    unsigned round;
    struct fold *fold;
    struct open_round *next; /* a later round */
};

struct pair {
    struct sum_stack stack;
    unsigned rounds;         /* sealed */
    struct open_round *open; /* in the order of rounds */
};

struct film {
    struct tile_plan plan;
    uint32_t tiles, replicates, sequences, leaf_samples, channels;
    struct tile_rect *rects;
    struct tile_rect crop;
    uint32_t full_width, full_height;
    unsigned rounds_wanted, rounds_complete;
    uint64_t sealed[ROUND_COUNT]; /* own rounds of pairs that belong to round r */
    uint64_t units;               /* of them in the next round to complete */
    size_t held;
    struct pair *pairs;    /* tile * sequences + replicate; from K on they are the pilot's */
    struct layers *layers; /* NULL: radiance alone */
};

static struct pair *pair_of(const struct film *film, uint32_t tile, uint32_t replicate)
{
    assert(tile < film->tiles && replicate < film->sequences);
    return &film->pairs[(size_t)tile * film->sequences + replicate];
}

static uint32_t pixels_of(const struct tile_rect *rect)
{
    return rect->width * rect->height;
}

uint64_t film_memory_bytes(const struct scene *scene, const struct job_spec *spec)
{
    uint32_t tiles = tile_count(scene);
    uint64_t bytes = sizeof(struct film) + tiles * (uint64_t)sizeof(struct tile_rect);
    for (uint32_t tile = 0; tile < tiles; tile++) {
        struct tile_rect rect = tile_rect(scene, tile);
        uint64_t sums = node_sums_size(pixels_of(&rect), spec->channel_count);
        bytes += job_sequences(spec) * (sizeof(struct pair) + SUMS_AT_ROUND_END * sums);
    }
    return bytes;
}

/* The most sums that a pair holds at the end of any of its first `rounds` rounds */
static int sums_held_at_most(unsigned rounds)
{
    int most = 1;
    for (unsigned round = 0; round < rounds && round < ROUND_COUNT; round++) {
        int held = __builtin_popcountll(round_end(round));
        most = held > most ? held : most;
        if (most == SUMS_AT_ROUND_END)
            break;
    }
    return most;
}

struct film *film_new(const struct scene *scene, const struct job_spec *spec, unsigned rounds,
                      uint64_t limit_bytes, struct err *err)
{
    if (spec->replicates == 0 || spec->leaf_samples == 0 || spec->channel_count < 3) {
        err_set(err, ERR_ARGUMENT,
                "a film needs replicates, samples per leaf and three channels, not %" PRIu32
                ", %" PRIu32 " and %" PRIu32,
                spec->replicates, spec->leaf_samples, spec->channel_count);
        return NULL;
    }
    if (spec->aovs != 0 && spec->channel_count != aov_channel_count(spec->aovs)) {
        err_set(err, ERR_ARGUMENT, "%" PRIu32 " channels for layers that need %" PRIu32,
                spec->channel_count, aov_channel_count(spec->aovs));
        return NULL;
    }
    uint64_t needed = film_memory_bytes(scene, spec);
    if (limit_bytes != 0 && needed > limit_bytes) {
        err_set(err, ERR_LIMIT,
                "the film of this job needs %.0f MB and may have %.0f: a smaller crop window or "
                "fewer replicates (now %" PRIu32 "%s) need less",
                (double)needed / 1e6, (double)limit_bytes / 1e6, spec->replicates,
                spec->pilot_rounds == 0 ? "" : ", and as many for the pilot");
        return NULL;
    }

    struct film *film = calloc(1, sizeof(*film));
    if (film == NULL)
        goto fail_film;
    const struct scene_settings *settings = &scene->settings;
    film->tiles = tile_count(scene);
    film->replicates = spec->replicates;
    film->sequences = job_sequences(spec);
    film->leaf_samples = spec->leaf_samples;
    film->channels = spec->channel_count;
    film->full_width = settings->width;
    film->full_height = settings->height;
    film->crop = (struct tile_rect){
        .x = settings->crop[0],
        .y = settings->crop[2],
        .width = settings->crop[1] - settings->crop[0],
        .height = settings->crop[3] - settings->crop[2],
    };
    if (!tile_plan_open(&film->plan, scene, spec))
        goto fail_rects;
    film->units = tile_plan_units(&film->plan, 0);
    film->rects = calloc(film->tiles, sizeof(*film->rects));
    if (film->rects == NULL)
        goto fail_rects;
    for (uint32_t tile = 0; tile < film->tiles; tile++)
        film->rects[tile] = tile_rect(scene, tile);
    film->pairs = calloc((size_t)film->tiles * film->sequences, sizeof(*film->pairs));
    if (film->pairs == NULL)
        goto fail_pairs;
    if (spec->aovs != 0) {
        film->layers = layers_new(scene, spec);
        if (film->layers == NULL)
            goto fail_layers;
    }
    film_extend(film, rounds);
    return film;

fail_layers:
    free(film->pairs);
fail_pairs:
    free(film->rects);
fail_rects:
    tile_plan_close(&film->plan);
    free(film);
fail_film:
    err_set(err, ERR_MEMORY, "no memory for the film");
    return NULL;
}

bool film_take_memory(const struct film *film, unsigned rounds, struct err *err)
{
    /* With a pilot nobody knows yet how far a tile's own rounds go */
    unsigned pilot = film->plan.pilot_rounds;
    int sums = pilot == 0 ? sums_held_at_most(rounds)
                          : sums_held_at_most(ROUND_COUNT) + sums_held_at_most(pilot);
    size_t count = (size_t)film->tiles * film->replicates * (size_t)sums;
    struct node_sums **taken = calloc(count, sizeof(*taken));
    bool enough = taken != NULL;
    mallopt(M_TRIM_THRESHOLD, -1);
    mallopt(M_ARENA_MAX, 1); /* threads that write pictures would each keep an arena of their own */
    for (size_t i = 0; enough && i < count; i++) {
        taken[i] = node_sums_new(pixels_of(&film->rects[i % film->tiles]), film->channels);
        enough = taken[i] != NULL;
    }
    for (size_t i = 0; taken != NULL && i < count; i++)
        node_sums_free(taken[i]);
    free(taken);
    return enough || err_set(err, ERR_MEMORY, "no memory for the film");
}

void film_free(struct film *film)
{
    if (film == NULL)
        return;
    for (size_t i = 0; i < (size_t)film->tiles * film->sequences; i++) {
        struct pair *pair = &film->pairs[i];
        sum_stack_clear(&pair->stack);
        for (struct open_round *open = pair->open, *next; open != NULL; open = next) {
            next = open->next;
            fold_free(open->fold);
            free(open);
        }
    }
    layers_free(film->layers);
    tile_plan_close(&film->plan);
    free(film->pairs);
    free(film->rects);
    free(film);
}

void film_extend(struct film *film, unsigned rounds)
{
    if (rounds > ROUND_COUNT)
        rounds = ROUND_COUNT;
    if (rounds > film->rounds_wanted)
        film->rounds_wanted = rounds;
}

/* Where its own round `round` stands, or would stand, in the pair's list. */
static struct open_round **find_open(struct pair *pair, unsigned round)
{
    struct open_round **link = &pair->open;
    while (*link != NULL && (*link)->round < round)
        link = &(*link)->next;
    return link;
}

enum film_result film_check(const struct film *film, const struct node_id *id)
{
    unsigned job_round, round = 0;
    if (!tile_plan_job_round(&film->plan, id, &job_round) || job_round >= film->rounds_wanted)
        return FILM_FOREIGN;
    round_holding(id->level, id->index, &round); /* the plan knows that it does */
    struct pair *pair = pair_of(film, id->tile, id->replicate);
    if (round < pair->rounds)
        return FILM_DUPLICATE;
    struct open_round *open = *find_open(pair, round);
    if (open == NULL || open->round != round)
        return FILM_ADDED;
    return fold_check(open->fold, id->level, id->index) == FOLD_ADDED ? FILM_ADDED : FILM_DUPLICATE;
}

static bool shape_fits(const struct film *film, const struct node_id *id,
                       const struct node_sums *sums)
{
    uint32_t pixels = film_tile_pixels(film, id->tile);
    uint64_t samples = ((uint64_t)film->leaf_samples * pixels) << id->level;
    return sums->pixel_count == pixels && sums->channel_count == film->channels &&
           sums->stats.samples == samples;
}

static struct fold *open_fold(struct pair *pair, unsigned round)
{
    struct open_round **link = find_open(pair, round);
    if (*link != NULL && (*link)->round == round)
        return (*link)->fold;

    struct open_round *open = malloc(sizeof(*open));
    if (open == NULL)
        return NULL;
    uint32_t level;
    uint64_t index;
    round_node(round, &level, &index);
    open->fold = fold_new(level, index);
    if (open->fold == NULL) {
        free(open);
        return NULL;
    }
    open->round = round;
    open->next = *link;
    *link = open;
    return open->fold;
}

/* Move the pair's next round to its stack if all of it is here. */
static bool seal_next(struct film *film, uint32_t tile, uint32_t replicate)
{
    struct pair *pair = pair_of(film, tile, replicate);
    struct open_round *open = pair->open;
    if (open == NULL || open->round != pair->rounds)
        return false;
    struct node_sums *sums = fold_take(open->fold);
    if (sums == NULL)
        return false;

    uint32_t level;
    uint64_t index;
    round_node(open->round, &level, &index);
    const struct node_id node = { tile, replicate, level, index };
    unsigned job_round = 0;
    tile_plan_job_round(&film->plan, &node, &job_round); /* film_check found one */
    assert(pair->stack.leaves == index << level);
    sum_stack_push(&pair->stack, level, sums);
    film->held--;
    pair->rounds++;
    film->sealed[job_round]++;
    pair->open = open->next;
    fold_free(open->fold);
    free(open);
    return true;
}

static void count_complete_rounds(struct film *film)
{
    while (film->rounds_complete < film->rounds_wanted &&
           film->sealed[film->rounds_complete] == film->units)
        film->units = tile_plan_units(&film->plan, ++film->rounds_complete);
}

enum film_result film_accept(struct film *film, const struct node_id *id, struct node_sums *sums)
{
    enum film_result verdict = film_check(film, id);
    if (verdict != FILM_ADDED)
        return verdict;
    if (!shape_fits(film, id, sums))
        return FILM_FOREIGN;

    unsigned round = 0;
    round_holding(id->level, id->index, &round); /* film_check knows that it does */
    struct pair *pair = pair_of(film, id->tile, id->replicate);
    struct fold *fold = open_fold(pair, round);
    if (fold == NULL)
        return FILM_NO_MEMORY;
    size_t waited = fold_waiting(fold);
    if (fold_add(fold, id->level, id->index, sums) != FOLD_ADDED)
        return FILM_NO_MEMORY;
    film->held = film->held - waited + fold_waiting(fold);

    while (seal_next(film, id->tile, id->replicate))
        verdict = FILM_SEALED;
    count_complete_rounds(film);
    return verdict;
}

uint32_t film_tiles(const struct film *film)
{
    return film->tiles;
}

uint32_t film_tile_pixels(const struct film *film, uint32_t tile)
{
    assert(tile < film->tiles);
    return pixels_of(&film->rects[tile]);
}

unsigned film_pair_rounds(const struct film *film, uint32_t tile, uint32_t replicate)
{
    return pair_of(film, tile, replicate)->rounds;
}

unsigned film_rounds(const struct film *film)
{
    return film->rounds_complete;
}

bool film_round_complete(const struct film *film, unsigned round)
{
    return round < film->rounds_complete;
}

uint64_t film_spp(const struct film *film)
{
    uint64_t samples = 0, pixels = 0;
    uint64_t of_leaf = (uint64_t)film->replicates * film->leaf_samples;
    if (!film_has_picture(film))
        return 0;
    if (film->plan.pilot_rounds == 0)
        return of_leaf * round_end(film->rounds_complete - 1);
    for (uint32_t tile = 0; tile < film->tiles; tile++) {
        unsigned own = tile_plan_pair_rounds(&film->plan, tile, 0, film->rounds_complete);
        pixels += pixels_of(&film->rects[tile]);
        samples += pixels_of(&film->rects[tile]) * round_end(own - 1);
    }
    return of_leaf * samples / pixels;
}

bool film_has_picture(const struct film *film)
{
    return film->rounds_complete > film->plan.pilot_rounds;
}

const struct tile_plan *film_plan(const struct film *film)
{
    return &film->plan;
}

size_t film_held(const struct film *film)
{
    return film->held;
}

static void stack_stats(const struct sum_stack *stack, struct node_stats *total)
{
    for (unsigned level = 0; level <= NODE_LEVEL_MAX; level++)
        if (stack->sums[level] != NULL)
            node_stats_add(total, &stack->sums[level]->stats);
}

void film_stats(const struct film *film, struct node_stats *total)
{
    memset(total, 0, sizeof(*total));
    for (size_t i = 0; i < (size_t)film->tiles * film->sequences; i++)
        stack_stats(&film->pairs[i].stack, total);
}

/* What film_image keeps while it goes over the tiles. */
struct reading {
    struct node_sums *total; /* of one pair */
    double *means;           /* [replicate][channel][pixel] of one tile */
    uint32_t failed[TILE_PIXELS / 32];
};

static bool reading_open(struct reading *reading, const struct film *film)
{
    reading->total = node_sums_new(TILE_PIXELS, film->channels);
    reading->means = malloc(sizeof(double) * 3 * TILE_PIXELS * film->replicates);
    if (reading->total != NULL && reading->means != NULL)
        return true;
    node_sums_free(reading->total);
    free(reading->means);
    return false;
}

static void reading_close(struct reading *reading)
{
    node_sums_free(reading->total);
    free(reading->means);
}

/* A pilot's sequence joins the means of one main replicate, with the weight that was fixed
 * beforehand. `largest` stays that of the sample which moves the tile's mean most. */
static void mix_pilot(const struct film *film, const struct sum_stack *stack, uint64_t samples,
                      double *means, double *largest, struct reading *reading)
{
    struct node_sums *total = reading->total;
    double weight = film->plan.pilot_weight, rest = 1 - weight;
    double n = (double)(stack->leaves * film->leaf_samples);
    sum_stack_total(stack, total);
    for (uint32_t i = 0; i < 3 * total->pixel_count; i++)
        means[i] = weight * ((double)total->values[i] / n) + rest * means[i];
    for (unsigned word = 0; word < TILE_PIXELS / 32; word++)
        reading->failed[word] |= total->failed[word];
    double pilots = total->stats.largest * weight * ((double)samples / n);
    *largest = pilots > *largest * rest ? pilots : *largest * rest;
}

/* The K sequences of a tile from `first` on: 0, or K for the pilot alone */
static struct tile_means read_tile(const struct film *film, uint32_t tile, uint32_t first,
                                   struct reading *reading)
{
    bool layers = film->layers != NULL && first == 0;
    bool mixed = film->plan.pilot_weight > 0 && first == 0;
    const struct tile_rect *rect = &film->rects[tile];
    uint32_t pixels = pixels_of(rect);
    struct tile_means out = { .width = rect->width,
                              .height = rect->height,
                              .means = reading->means,
                              .failed = reading->failed };
    memset(reading->failed, 0, sizeof(reading->failed));
    if (layers)
        layers_tile_begin(film->layers, pixels);

    for (uint32_t k = 0; k < film->replicates; k++) {
        const struct sum_stack *stack = &pair_of(film, tile, first + k)->stack;
        if (stack->leaves == 0)
            continue;
        struct node_sums *total = reading->total;
        total->pixel_count = pixels;
        sum_stack_total(stack, total);

        uint64_t samples = stack->leaves * film->leaf_samples;
        double n = (double)samples;
        if (layers)
            layers_tile_add(film->layers, total, samples);
        double *means = reading->means + (size_t)out.replicates * 3 * pixels;
        for (uint32_t i = 0; i < 3 * pixels; i++)
            means[i] = (double)total->values[i] / n;
        double largest = total->stats.largest;
        for (unsigned word = 0; word < TILE_PIXELS / 32; word++)
            reading->failed[word] |= total->failed[word];
        if (mixed)
            mix_pilot(film, &pair_of(film, tile, film->replicates + k)->stack, samples, means,
                      &largest, reading);
        double luminance = 0;
        for (uint32_t p = 0; p < pixels; p++)
            luminance += 0.2126 * means[p] + 0.7152 * means[pixels + p] +
                         0.0722 * means[2 * pixels + p];

        out.luminance += luminance * (double)samples;
        if (largest > out.largest)
            out.largest = largest;
        out.samples += samples;
        out.replicates++;
    }
    return out;
}

/* The image's planes, in the order of PLANE_NAMES. */
#define PLANES  7
#define SAMPLES 6
static const char *const PLANE_NAMES[PLANES] = { "R",        "G",        "B",      "stderr.R",
                                                 "stderr.G", "stderr.B", "samples" };

/* Mean over the replicates and variance of it, pixel by pixel; nothing where samples were lost. */
static void mean_and_variance(const struct tile_means *tile, uint32_t channel, double *mean,
                              double *variance)
{
    uint32_t pixels = tile->width * tile->height;
    double k_count = tile->replicates;
    memset(mean, 0, pixels * sizeof(*mean));
    memset(variance, 0, pixels * sizeof(*variance));
    for (uint32_t k = 0; k < tile->replicates; k++)
        for (uint32_t p = 0; p < pixels; p++)
            mean[p] += tile->means[((size_t)k * 3 + channel) * pixels + p];
    for (uint32_t p = 0; tile->replicates > 0 && p < pixels; p++)
        mean[p] /= k_count;
    for (uint32_t k = 0; k < tile->replicates; k++)
        for (uint32_t p = 0; p < pixels; p++) {
            double distance = tile->means[((size_t)k * 3 + channel) * pixels + p] - mean[p];
            variance[p] += distance * distance / ((k_count - 1) * k_count);
        }
    for (uint32_t p = 0; p < pixels; p++)
        if (tile->failed[p / 32] >> p % 32 & 1)
            variance[p] = INFINITY;
}

/*
 * A pixel's variance from a few replicates says little, and too little where noise is skewed: the
 * pixels that miss the light that lies beside the mean miss it in their variance, too. So it is
 * the mean over the pixel and its neighbours in the tile (those that lost no samples).
 */
static double pooled_variance(const struct tile_means *tile, const double *variance, uint32_t x,
                              uint32_t y)
{
    double sum = 0, count = 0;
    for (uint32_t v = y > 0 ? y - 1 : 0; v <= y + 1 && v < tile->height; v++)
        for (uint32_t u = x > 0 ? x - 1 : 0; u <= x + 1 && u < tile->width; u++) {
            double value = variance[v * tile->width + u];
            if (isinf(value))
                continue;
            sum += value;
            count++;
        }
    return sum / count;
}

uint32_t film_stderr_dof(uint32_t replicates)
{
    return 9 * (replicates - 1);
}

static void write_tile(const struct film *film, uint32_t tile, const struct tile_means *means,
                       float *const planes[PLANES])
{
    const struct tile_rect *rect = &film->rects[tile];
    double mean[TILE_PIXELS], variance[TILE_PIXELS];
    for (uint32_t c = 0; c < 3; c++) {
        mean_and_variance(means, c, mean, variance);
        for (uint32_t p = 0; p < rect->width * rect->height; p++) {
            uint32_t x = p % rect->width, y = p / rect->width;
            size_t row = rect->y - film->crop.y + y;
            size_t at = row * film->crop.width + rect->x - film->crop.x + x;
            bool unknown = means->replicates < 2 || isinf(variance[p]);
            planes[c][at] = (float)mean[p];
            planes[3 + c][at] = unknown ? INFINITY
                                        : (float)sqrt(pooled_variance(means, variance, x, y));
            planes[SAMPLES][at] = (float)means->samples;
        }
    }
}

/* The image's planes, added where it lacks them. */
static bool prepare_image(const struct film *film, struct image *image, float *planes[PLANES],
                          struct err *err)
{
    const struct tile_rect *crop = &film->crop;
    if (image->width != crop->width || image->height != crop->height)
        return err_set(err, ERR_ARGUMENT,
                       "an image of %" PRIu32 "x%" PRIu32 " for a film of %" PRIu32 "x%" PRIu32,
                       image->width, image->height, crop->width, crop->height);
    for (int i = 0; i < PLANES; i++) {
        if (image_channel(image, PLANE_NAMES[i]) != NULL)
            continue;
        bool exact = i == SAMPLES;
        if ((exact ? image_add_exact_channel(image, PLANE_NAMES[i])
                   : image_add_channel(image, PLANE_NAMES[i])) == NULL)
            return err_set(err, ERR_MEMORY, "no memory for the image");
    }
    if (film->layers != NULL && !layers_prepare(film->layers, image))
        return err_set(err, ERR_MEMORY, "no memory for the image");
    for (int i = 0; i < PLANES; i++)
        planes[i] = image_channel(image, PLANE_NAMES[i]);
    image->data_x = (int32_t)crop->x;
    image->data_y = (int32_t)crop->y;
    image->display_width = film->full_width;
    image->display_height = film->full_height;
    return true;
}

struct image *film_image_new(const struct film *film)
{
    float *planes[PLANES];
    struct err err;
    struct image *image = image_new(film->crop.width, film->crop.height);
    if (image == NULL || !prepare_image(film, image, planes, &err)) {
        image_free(image);
        return NULL;
    }
    /* Not zero: the zeroed memory of a large block is not there before it is written to */
    for (uint32_t i = 0; i < image->channel_count; i++)
        memset(image->channels[i].values, 0xff,
               (size_t)image->width * image->height * sizeof(float));
    return image;
}

bool film_image(const struct film *film, struct image *image, struct estimate *estimate,
                struct err *err)
{
    float *planes[PLANES];
    if (image != NULL && !prepare_image(film, image, planes, err))
        goto fail_image;
    struct reading reading;
    if (!reading_open(&reading, film))
        goto fail_reading;
    if (estimate != NULL)
        estimate_begin(estimate, film->replicates);

    for (uint32_t tile = 0; tile < film->tiles; tile++) {
        struct tile_means means = read_tile(film, tile, 0, &reading);
        if (image != NULL)
            write_tile(film, tile, &means, planes);
        if (image != NULL && film->layers != NULL) {
            struct tile_rect at = film->rects[tile];
            at.x -= film->crop.x;
            at.y -= film->crop.y;
            layers_tile_write(film->layers, &at, image);
        }
        if (estimate != NULL)
            estimate_tile(estimate, &means);
    }
    reading_close(&reading);
    return true;

fail_reading:
    err_set(err, ERR_MEMORY, "no memory for reading the film");
fail_image:
    return err_wrap(err, "making the image");
}

/* What the pilot says about each tile. */
static void look_at_tile(struct film *film, uint32_t tile, struct reading *reading,
                         struct estimate *estimate)
{
    struct tile_look *look = &film->plan.looks[tile];
    struct tile_means means = read_tile(film, tile, film->replicates, reading);
    estimate_begin(estimate, film->replicates);
    look->one_sample = !estimate_tile(estimate, &means);
    struct accuracy accuracy = estimate_result(estimate);
    look->pixels = means.width * means.height;
    look->error = accuracy.relmse * 3 * look->pixels;
    struct node_stats stats = { 0 };
    for (uint32_t k = 0; k < film->replicates; k++)
        stack_stats(&pair_of(film, tile, film->replicates + k)->stack, &stats);
    look->work = tile_plan_work(&stats);
    look->samples = stats.samples;
}

bool film_make_plan(struct film *film, unsigned rounds, struct err *err)
{
    assert(film->rounds_complete == film->plan.pilot_rounds);
    bool made = false;
    struct reading reading;
    struct estimate *estimate = estimate_new();
    if (estimate == NULL)
        goto fail_estimate;
    if (!reading_open(&reading, film))
        goto fail_reading;
    for (uint32_t tile = 0; tile < film->tiles; tile++)
        look_at_tile(film, tile, &reading, estimate);
    made = tile_plan_make(&film->plan, rounds);
    film->units = tile_plan_units(&film->plan, film->rounds_complete);

    reading_close(&reading);
fail_reading:
    estimate_free(estimate);
fail_estimate:
    return made || err_set(err, ERR_MEMORY, "no memory for planning the samples");
}
