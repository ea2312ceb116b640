/*
 * The renders behind `pathfarm accuracy`: a ladder of sample counts for each way of rendering, with
 * several seeds each; a reference of seeds of its own; and crops to look at. Blocking, for minutes.
 *
 * Equal core-seconds: every ladder doubles its samples until the next picture would take longer
 * than `core_s` of processor time, whatever that takes by the clock on the wall; but no ladder has
 * fewer than four.
 */
#ifndef MASTER_ACCURACY_RUN_H
#define MASTER_ACCURACY_RUN_H

#include "master/accuracy_curve.h"
#include "master/accuracy_setup.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct image;
struct scene;

#define ACCURACY_SEEDS_MAX 32
#define ACCURACY_SEED      1000 /* of the pictures: this, and those after it */
#define ACCURACY_DEPTH_TEXT                                               \
    "64" /* the depth limit where there is no roulette and no other limit \
          */

struct accuracy_plan {
    const char *const *arguments; /* of every render, the scene first; up to a NULL */
    const struct scene *scene;    /* as those arguments make it */
    const struct accuracy_setup *const *setups;
    size_t setup_count;
    unsigned seeds; /* 2 to ACCURACY_SEEDS_MAX */
    double core_s;
    unsigned multiple;          /* samples of the reference, in those of the longest ladder */
    const char *reference_path; /* NULL: it is rendered */
    const uint64_t *crop_spp;   /* ACCURACY_CROPS_MAX; 0: none */
};

struct accuracy_window {
    uint32_t x, y, side;
};

struct accuracy_study {
    struct image *reference;
    uint64_t reference_spp; /* 0: it came from a file */
    double reference_core_s;
    double reference_variance;     /* relative; NaN: unknown, and taken for 0 */
    struct accuracy_curve *curves; /* one per setup; the first is what others are held against */
    size_t curve_count;
    struct accuracy_window window;  /* of the crops: where the noise is */
    struct image *window_reference; /* the reference there */
};

/*
 * Progress goes to stderr, a line per setup. On failure there is nothing to free; a render that
 * fails ends everything.
 */
bool accuracy_run(const struct accuracy_plan *plan, struct accuracy_study *study, struct err *err);
void accuracy_run_free(struct accuracy_study *study);

#endif
