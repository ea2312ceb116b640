/*
 * The accuracy ledger of a job: a row for every round that ended, which says what it had cost by
 * then and how wrong it was. Rows are plain data; what they say about the rounds to come is
 * master/predict.h.
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
    double wall_s; /* passed in: since the job began */
    double core_s; /* passed in: of the workers' cores, for what is in this round's picture */
    struct accuracy accuracy;
    uint64_t samples, rays_closest, rays_shadow;
    uint64_t nonfinite[NONFINITE_CAUSES];
    uint64_t truncated_paths;
    double truncated_energy; /* mean per camera path: compares with pixel values */
};

struct ledger_row ledger_row_of(unsigned round, uint64_t spp, double wall_s, double core_s,
                                const struct accuracy *accuracy, const struct node_stats *stats);

/*
 * The rows as CSV text: a header line, then a line for each round. Where the error is unknown its
 * fields are empty and `unknown` says why; an interval without an upper end ends at "inf". To be
 * released with free(); NULL when memory runs out.
 */
char *ledger_csv(const struct ledger_row *rows, size_t count);

#endif
