/*
 * How much more does an error cost? From the rows of the ledger, the samples, core-seconds and wall
 * time at which a job by --error will end, each with a 90 % band.
 *
 * Method. The expected relMSE falls as spp^-slope. Along x = ln spp, a Kalman filter follows three
 * numbers from row to row:
 *     the logarithm of the expected relMSE, which falls with the slope;
 *     the slope, which starts at what is usual for the sampler, goes to what is usual later, and
 *     wanders a little;
 *     the noise of the estimate. Rows share samples, so it is remembered: estimates at n and N > n
 *     samples are correlated by n / N, which is exp(-dx). Its variance is that of a chi-square
 *     variable with n (K - 1) degrees of freedom, n the values that hold the error (estimate.h;
 *     as all rows so far see it),
 *     and what powers of two do to the error of stratified samplers.
 * Each row is observed as the first plus the third, exactly. Looking ahead, the same steps give for
 * the end of every later round the chance that its estimate meets the target, and the band is made
 * of the rounds whose chances are nearest to 5, 50 and 95 %. Since only whole rounds can be the
 * end, a band reaches half a round beyond its outer ones, where their costs are told.
 *
 * Cost per sample is that of the last half of the samples, give or take what it was measured to
 * change by on a busy machine.
 *
 * Known limit: where edges hold all of the error it falls as n^-1.5 and ends earlier than the band;
 * light that has not been seen yet makes it end later.
 *
 * For people, and for deciding what to render ahead of a verdict: no bit of a picture depends on
 * it. Pure.
 */
#ifndef MASTER_PREDICT_H
#define MASTER_PREDICT_H

#include "common/job.h"
#include "master/ledger.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct predict_job {
    struct job_spec spec;
    uint32_t sampler; /* enum sampler_kind */
    double relmse;    /* the target */
};

/* Totals at the end of the job. */
struct predict_band {
    double low, mid, high;
};

struct prediction {
    struct predict_band spp, core_s, wall_s;
    double slope, slope_stderr; /* of ln relMSE over ln spp now: about -1 */
};

/*
 * What the first `count` rows say. False, and *out untouched, before the samples have doubled twice
 * since the first row of known error, or where the end is beyond all rounds.
 */
bool predict_end(const struct predict_job *job, const struct ledger_row *rows, size_t count,
                 struct prediction *out);

/* The chance that the target is met within so many rounds; NaN while no error is known. */
double predict_chance(const struct predict_job *job, const struct ledger_row *rows, size_t count,
                      unsigned rounds);

/*
 * "0.001 needs 1400 to 2100 samples per pixel, 31 to 44 core-seconds, 12 to 18 s more": what is
 * left after this row; cut at capacity.
 */
const char *predict_text(const struct prediction *prediction, const struct ledger_row *now,
                         double relmse, char *text, size_t capacity);

#endif
