/*
 * Mean and variance of a stream of numbers, in double, by Welford's update and Chan's merge: any
 * partition of the stream, merged in any tree, agrees with the serial result to rounding. Never by
 * sums of squares, which lose everything when the mean is large against the spread.
 *
 * Plain data; zeroed moments are those of nothing.
 */
#ifndef COMMON_MOMENTS_H
#define COMMON_MOMENTS_H

#include <stdint.h>

struct moments {
    uint64_t n;
    double mean;
    double m2; /* sum of squared distances to the mean */
};

void moments_add(struct moments *m, double x);

/* m = m and other together. Merging with nothing changes no bit, whichever side it is on. */
void moments_merge(struct moments *m, const struct moments *other);

/* Sample variance, m2 / (n - 1), and standard error of the mean; +inf, "unknown", below n = 2. */
double moments_variance(const struct moments *m);
double moments_stderr(const struct moments *m);

#endif
