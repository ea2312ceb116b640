/*
 * Error against time of one way of rendering: a ladder of sample counts, and what follows from it.
 * Pure; any thread.
 */
#ifndef MASTER_ACCURACY_CURVE_H
#define MASTER_ACCURACY_CURVE_H

#include "master/accuracy_measure.h"
#include "master/fit.h"
#include "master/render_run.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct accuracy_setup;
struct image;

#define ACCURACY_RUNGS_MAX 32
#define ACCURACY_CROPS_MAX 4

struct accuracy_rung {
    struct render_facts facts; /* means over the seeds; nonfinite: the sum */
    struct accuracy_point point;
};

/* A number and its standard error; NaN where it cannot be told */
struct accuracy_value {
    double value, error;
};

struct accuracy_curve {
    const struct accuracy_setup *setup;
    const char *refusal; /* why the scene cannot be rendered so: then there is nothing else */
    bool cut;            /* it has a depth limit (ACCURACY_DEPTH_TEXT) that others have not */
    unsigned seeds;
    struct accuracy_rung rungs[ACCURACY_RUNGS_MAX]; /* samples double from one to the next */
    size_t count;
    struct image *crops[ACCURACY_CROPS_MAX]; /* NULL: none */
    uint64_t crop_spp[ACCURACY_CROPS_MAX];

    /* What accuracy_curve_finish makes of the rungs */
    struct accuracy_value slope;   /* of ln relMSE over ln core-seconds */
    struct accuracy_value speedup; /* against another curve, at equal error */
    double at_relmse;              /* that error */
    double speedup_below;          /* where they reach no error both: a bound; else NaN */
};

/*
 * Fit the slope, to the rungs with as many replicates as the last and an error that is known to a
 * third, and find how many times faster than `base` this curve comes to the smallest error that
 * both reach. Between rungs, logarithms are interpolated; beyond them nothing is said, but that a
 * curve that surely ends above where `base` begins is slower than the two times make it.
 */
void accuracy_curve_finish(struct accuracy_curve *curve, const struct accuracy_curve *base);

/* Core-seconds until relMSE is `relmse`, and relMSE after so many core-seconds. */
struct accuracy_value accuracy_curve_time(const struct accuracy_curve *curve, double relmse);
struct accuracy_value accuracy_curve_error(const struct accuracy_curve *curve, double core_s);

/* The last rung, or NULL. */
const struct accuracy_rung *accuracy_curve_last(const struct accuracy_curve *curve);

/* Core-seconds until the relative variance of a pixel would be one, at this rung's pace. */
double accuracy_curve_ttuv(const struct accuracy_rung *rung);

#endif
