/*
 * The accuracy ledger of a job: a row for every round that ended, and what its rows say about the
 * rounds to come. Fits and predictions are for people, and use logarithms.
 *
 * Pure: time is passed in.
 */
#ifndef MASTER_LEDGER_H
#define MASTER_LEDGER_H

#include "common/sumtree.h"
#include "master/estimate.h"

#include <stddef.h>
#include <stdint.h>

struct ledger_row {
    unsigned round;
    uint64_t spp;
    double wall_s, core_s; /* passed in: since the job began */
    struct accuracy accuracy;
    uint64_t samples, rays_closest, rays_shadow;
    uint64_t nonfinite[NONFINITE_CAUSES];
    uint64_t truncated_paths;
    double truncated_energy; /* mean per camera path: compares with pixel values */
};

struct ledger_row ledger_row_of(unsigned round, uint64_t spp, double wall_s, double core_s,
                                const struct accuracy *accuracy, const struct node_stats *stats);

/*
 * ln relMSE = intercept + slope * ln spp, by least squares over the rows whose error is known. The
 * rows share samples, so slope_stderr is a lower bound. `rows` counts those used; below 3 there is
 * no fit, and the other fields are not numbers.
 */
struct error_fit {
    size_t rows;
    double slope, slope_stderr, intercept;
};
struct error_fit ledger_fit(const struct ledger_row *rows, size_t count);

/* Samples per pixel at which the fit meets the target; +inf when it never does or is no fit. */
double ledger_spp_for(const struct error_fit *fit, double relmse);

/* Wall seconds from the last row until `spp`, at the pace of the last half; +inf without rows. */
double ledger_seconds_left(const struct ledger_row *rows, size_t count, double spp);

#endif
