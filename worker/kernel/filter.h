/*
 * Reconstruction filters by importance sampling: a sample lands at a random place under the filter
 * and counts for its own pixel alone. The x and y parts are tabulated inverse cumulative functions,
 * with a piece of the table for each lobe, so that no sample falls between two of them.
 *
 * A filter with negative lobes (Mitchell, sinc) has fixed strata: of every four consecutive samples
 * the last falls in a negative lobe and weighs -4 N, the others in a positive one and weigh 4/3 P,
 * where P - N = 1 are the integrals; so four samples of a constant image sum to exactly four. One
 * in four is what a sinc wants (at its defaults the variance is .3 % above that of the best share);
 * Mitchell would do with fewer (19 %).
 */
#ifndef WORKER_KERNEL_FILTER_H
#define WORKER_KERNEL_FILTER_H

#include "common/scene.h"

#define FILTER_TABLE_LEN 1024
#define FILTER_LOBES     18 /* of one sign, on one side: a sinc of the largest radius has so many */

/* What has one sign, along one axis: its inverse CDF over x / radius in [0, 1]. Of u in [0, 1] the
 * part above begin[i] and up to the next is lobe i, at first[i] + (u - begin[i]) step[i] in the
 * table. */
struct filter_part {
    int lobes;
    float begin[FILTER_LOBES], first[FILTER_LOBES], step[FILTER_LOBES];
    float table[FILTER_TABLE_LEN + 2]; /* what is left behind the last lobe repeats its end */
};

struct filter_table {
    uint32_t kind;
    float radius[2];
    struct filter_part positive[2], negative[2]; /* per axis */
    int has_negative;
    float both_positive; /* share of (+,+) in the positive mass; the rest is (-,-) */
    float only_x;        /* share of (-,+) in the negative mass; the rest is (+,-) */
    float weight_positive, weight_negative;
};

void filter_table_make(struct filter_table *table, const struct filter_spec *spec);

#endif
