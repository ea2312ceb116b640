#include "master/accuracy_run.h"

#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "master/exr.h"
#include "master/image.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define REFERENCE_SEED ((uint64_t)1 << 40) /* far from those of the pictures */
#define WINDOW_SIDE    64
#define SPP_MAX        ((uint64_t)1 << 30)
#define RUNGS_LEAST    4 /* however short the time: a slope needs some */

struct runner {
    const struct accuracy_plan *plan;
    struct render_run *run;
};

/* ---- one render */

struct call {
    const char *arguments[RENDER_RUN_ARGUMENTS + 1];
    size_t count;
    bool full;
    char numbers[3][80]; /* texts of those that are no constants */
};

static void add(struct call *call, const char *argument)
{
    if (call->count == RENDER_RUN_ARGUMENTS)
        call->full = true;
    else
        call->arguments[call->count++] = argument;
}

static void add_all(struct call *call, const char *const *arguments, size_t most)
{
    for (size_t i = 0; i < most && arguments[i] != NULL; i++)
        add(call, arguments[i]);
}

/* Paths without roulette need a limit; if the scene has one, that is it */
static bool needs_depth(const struct accuracy_setup *setup, const struct scene *scene)
{
    return (setup->techniques_off & TECHNIQUE_ROULETTE) && scene->settings.max_depth > 65535;
}

/* `setup` may be NULL: nothing but what all have */
static struct image *render(const struct runner *runner, const struct accuracy_setup *setup,
                            const char *const *more, uint64_t spp, uint64_t seed,
                            struct render_facts *facts, struct err *err)
{
    struct call call = { .count = 0 };
    add_all(&call, runner->plan->arguments, SIZE_MAX);
    add_all(&call, setup->arguments, ACCURACY_ARGUMENTS);
    if (needs_depth(setup, runner->plan->scene)) {
        add(&call, "--max-depth");
        add(&call, ACCURACY_DEPTH_TEXT);
    }
    if (more != NULL)
        add_all(&call, more, SIZE_MAX);
    snprintf(call.numbers[0], sizeof(call.numbers[0]), "%" PRIu64, spp);
    snprintf(call.numbers[1], sizeof(call.numbers[1]), "%" PRIu64, seed);
    add(&call, "--spp");
    add(&call, call.numbers[0]);
    add(&call, "--seed");
    add(&call, call.numbers[1]);
    if (call.full) {
        err_set(err, ERR_ARGUMENT, "too many options");
        return NULL;
    }
    struct image *image = render_run_picture(runner->run, call.arguments, facts, err);
    if (image == NULL)
        err_wrap(err, "%s at %" PRIu64 " samples per pixel", setup->name, spp);
    return image;
}

/* ---- the ladders */

static void free_all(struct image **images, size_t count)
{
    for (size_t i = 0; i < count; i++)
        image_free(images[i]);
}

/* Pictures of all seeds, and what they tell */
static bool climb(const struct runner *runner, const struct accuracy_setup *setup, uint64_t spp,
                  const struct image *reference, struct accuracy_rung *rung, struct err *err)
{
    const unsigned seeds = runner->plan->seeds;
    struct image *images[ACCURACY_SEEDS_MAX] = { NULL };
    struct render_facts sum = { 0 };
    for (unsigned s = 0; s < seeds; s++) {
        struct render_facts facts;
        images[s] = render(runner, setup, NULL, spp, ACCURACY_SEED + s, &facts, err);
        if (images[s] == NULL) {
            free_all(images, s);
            return false;
        }
        sum.spp = facts.spp;
        sum.replicates = facts.replicates;
        sum.core_s += facts.core_s / seeds;
        sum.wall_s += facts.wall_s / seeds;
        sum.truncated_energy += facts.truncated_energy / seeds;
        sum.truncated_paths += facts.truncated_paths;
        sum.nonfinite += facts.nonfinite;
    }
    rung->facts = sum;
    bool measured = accuracy_measure_pictures((const struct image *const *)images, seeds, reference,
                                              &rung->point, err);
    free_all(images, seeds);
    return measured;
}

static bool ladder(const struct runner *runner, const struct image *reference,
                   struct accuracy_curve *curve, struct err *err)
{
    const struct accuracy_plan *plan = runner->plan;
    for (uint64_t spp = 1; curve->count < ACCURACY_RUNGS_MAX && spp <= SPP_MAX; spp *= 2) {
        const struct accuracy_rung *last = accuracy_curve_last(curve);
        if (curve->count >= RUNGS_LEAST && 2 * last->facts.core_s > plan->core_s)
            break;
        if (!climb(runner, curve->setup, spp, reference, &curve->rungs[curve->count], err))
            return false;
        curve->count++;
    }
    curve->seeds = plan->seeds;
    const struct accuracy_rung *last = accuracy_curve_last(curve);
    fprintf(stderr,
            "%-18s %6" PRIu64 " samples per pixel, %.3g core-seconds, relMSE %.3g +- %.1g\n",
            curve->setup->name, last->facts.spp, last->facts.core_s, last->point.relmse,
            last->point.relmse_error);
    return true;
}

/* ---- the reference */

/* Samples that the first setup gets out of the time that each has */
static bool samples_in_time(const struct runner *runner, uint64_t *spp, struct err *err)
{
    struct render_facts facts = { 0 };
    for (*spp = 1; *spp < SPP_MAX; *spp *= 2) {
        struct image *image = render(runner, runner->plan->setups[0], NULL, *spp, ACCURACY_SEED,
                                     &facts, err);
        if (image == NULL)
            return false;
        image_free(image);
        if (2 * facts.core_s > runner->plan->core_s)
            break;
    }
    return true;
}

static bool make_reference(const struct runner *runner, struct accuracy_study *study,
                           struct err *err)
{
    static const char *const MORE[] = { "--replicates", "8", NULL };
    uint64_t spp;
    struct render_facts facts;
    if (!samples_in_time(runner, &spp, err))
        return false;
    fprintf(stderr, "the reference: %" PRIu64 " samples per pixel\n", spp * runner->plan->multiple);
    study->reference = render(runner, runner->plan->setups[0], MORE, spp * runner->plan->multiple,
                              REFERENCE_SEED, &facts, err);
    if (study->reference == NULL)
        return err_wrap(err, "the reference");
    study->reference_spp = facts.spp;
    study->reference_core_s = facts.core_s;
    return true;
}

/* A picture with one of our seeds would share its noise with those it judges */
static bool read_reference(const struct accuracy_plan *plan, struct accuracy_study *study,
                           struct err *err)
{
    study->reference = exr_image_read(plan->reference_path, err);
    if (study->reference == NULL)
        return false;
    const char *text = image_attribute(study->reference, "pathfarm.seed");
    uint64_t seed = text == NULL ? 0 : strtoull(text, NULL, 10);
    if (text == NULL || seed < ACCURACY_SEED || seed >= ACCURACY_SEED + plan->seeds)
        return true;
    image_free(study->reference);
    study->reference = NULL;
    return err_set(err, ERR_ARGUMENT,
                   "%s has seed %s, as one of the pictures that it is to judge; render it with "
                   "another --seed",
                   plan->reference_path, text);
}

/* ---- crops */

/* Relative variance of the reference at a pixel: where it is large, so is all noise */
static double noise_at(const struct image *reference, size_t pixel)
{
    const float *value = image_channel(reference, "G"),
                *error = image_channel(reference, "stderr.G");
    double r = (double)value[pixel], e = (double)error[pixel];
    double noise = e * e / (r * r + ACCURACY_EPSILON);
    return isfinite(noise) ? noise : 0;
}

/* The noisiest of the windows whose corners are multiples of half a side; else the middle */
static struct accuracy_window choose_window(const struct image *reference)
{
    uint32_t width = reference->width, height = reference->height;
    uint32_t side = (width < height ? width : height) / 2;
    side = side > WINDOW_SIDE ? WINDOW_SIDE : side < 1 ? 1 : side;
    struct accuracy_window best = { (width - side) / 2, (height - side) / 2, side };
    if (image_channel(reference, "stderr.G") == NULL || image_channel(reference, "G") == NULL)
        return best;
    double most = -1;
    const uint32_t step = side > 1 ? side / 2 : 1;
    for (uint32_t y = 0; y + side <= height; y += step)
        for (uint32_t x = 0; x + side <= width; x += step) {
            double sum = 0;
            for (uint32_t i = 0; i < side * side; i++)
                sum += noise_at(reference, (size_t)(y + i / side) * width + x + i % side);
            if (sum > most) {
                most = sum;
                best.x = x;
                best.y = y;
            }
        }
    return best;
}

/* The window as an image of its own; NULL when memory runs out */
static struct image *cut(const struct image *from, const struct accuracy_window *window)
{
    static const char *const COLORS[] = { "R", "G", "B" };
    struct image *image = image_new(window->side, window->side);
    for (int c = 0; c < 3 && image != NULL; c++) {
        const float *source = image_channel(from, COLORS[c]);
        float *values = image_add_channel(image, COLORS[c]);
        if (values == NULL) {
            image_free(image);
            return NULL;
        }
        for (uint32_t i = 0; source != NULL && i < window->side * window->side; i++)
            values[i] = source[(size_t)(window->y + i / window->side) * from->width + window->x +
                               i % window->side];
    }
    return image;
}

/* The window by a setup, from few samples to many */
static bool take_crops(const struct runner *runner, const struct accuracy_study *study,
                       struct accuracy_curve *curve, struct err *err)
{
    char text[80];
    const struct accuracy_window *w = &study->window;
    const uint32_t x = w->x + (uint32_t)study->reference->data_x,
                   y = w->y + (uint32_t)study->reference->data_y;
    snprintf(text, sizeof(text), "%" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%" PRIu32, x, x + w->side, y,
             y + w->side);
    const char *const more[] = { "--crop", text, NULL };
    for (int i = 0; i < ACCURACY_CROPS_MAX && runner->plan->crop_spp[i] > 0; i++) {
        struct render_facts facts;
        struct image *image = render(runner, curve->setup, more, runner->plan->crop_spp[i],
                                     ACCURACY_SEED, &facts, err);
        if (image == NULL)
            return false;
        curve->crops[i] = cut(image, &(struct accuracy_window){ .side = w->side });
        image_free(image);
        if (curve->crops[i] == NULL)
            return err_set(err, ERR_MEMORY, "no memory for a crop");
        curve->crop_spp[i] = facts.spp;
    }
    return true;
}

/* ---- all of it */

static bool run_all(const struct runner *runner, struct accuracy_study *study, struct err *err)
{
    const struct accuracy_plan *plan = runner->plan;
    if (plan->reference_path == NULL ? !make_reference(runner, study, err)
                                     : !read_reference(plan, study, err))
        return false;
    study->reference_variance = accuracy_measure_reference(study->reference);
    study->window = choose_window(study->reference);
    study->window_reference = cut(study->reference, &study->window);
    if (study->window_reference == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a crop");
    for (size_t i = 0; i < plan->setup_count; i++) {
        struct accuracy_curve *curve = &study->curves[i];
        curve->setup = plan->setups[i];
        curve->refusal = accuracy_setup_refusal(curve->setup, plan->scene);
        curve->cut = needs_depth(curve->setup, plan->scene);
        if (curve->refusal != NULL)
            fprintf(stderr, "%-18s left out: %s\n", curve->setup->name, curve->refusal);
        else if (!ladder(runner, study->reference, curve, err) ||
                 !take_crops(runner, study, curve, err))
            return false;
        accuracy_curve_finish(curve, &study->curves[0]);
    }
    return true;
}

bool accuracy_run(const struct accuracy_plan *plan, struct accuracy_study *study, struct err *err)
{
    *study = (struct accuracy_study){ .curve_count = plan->setup_count };
    study->curves = calloc(plan->setup_count, sizeof(*study->curves));
    if (study->curves == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %zu curves", plan->setup_count);
    struct runner runner = { plan, render_run_open(err) };
    bool done = runner.run != NULL && run_all(&runner, study, err);
    render_run_close(runner.run);
    if (!done)
        accuracy_run_free(study);
    return done;
}

void accuracy_run_free(struct accuracy_study *study)
{
    for (size_t i = 0; study->curves != NULL && i < study->curve_count; i++)
        free_all(study->curves[i].crops, ACCURACY_CROPS_MAX);
    free(study->curves);
    image_free(study->reference);
    image_free(study->window_reference);
    *study = (struct accuracy_study){ 0 };
}
