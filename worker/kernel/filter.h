/*
 * Reconstruction filters by importance sampling: a sample lands at a random place under the filter
 * and counts for its own pixel alone. The x and y parts are tabulated inverse cumulative functions.
 *
 * A filter with negative lobes (Mitchell) has fixed strata: of every four consecutive samples the
 * last falls in a negative lobe and weighs -4 N, the others in a positive one and weigh 4/3 P,
 * where P - N = 1 are the integrals; so four samples of a constant image sum to exactly four.
 */
#ifndef WORKER_KERNEL_FILTER_H
#define WORKER_KERNEL_FILTER_H

#include "common/scene.h"

#define FILTER_TABLE_LEN 1024

struct filter_table {
    uint32_t kind;
    float radius[2];
    /* Per axis: inverse CDF of the positive and of the negative part over x / radius in [0, 1] */
    float positive[2][FILTER_TABLE_LEN + 1], negative[2][FILTER_TABLE_LEN + 1];
    int has_negative;
    float both_positive; /* share of (+,+) in the positive mass; the rest is (-,-) */
    float weight_positive, weight_negative;
};

void filter_table_make(struct filter_table *table, const struct filter_spec *spec);

#endif
