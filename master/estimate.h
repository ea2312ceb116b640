/*
 * How wrong is this picture? The error estimate of an image from its K replicates.
 *
 * What is estimated: the error of the image mean x that a comparison with the truth r would find,
 *     MSE    = mean over pixels and channels of (x - r)^2
 *     relMSE = the same of (x - r)^2 / (r^2 + 0.01).
 *
 * Method. The K replicates of a pixel are independent, so the variance of their means over K has
 * the expectation of (x - r)^2 whatever the sampler. Denominator: r is replaced by x. What that
 * does to the expectation, by the variance of x and by its covariance with the variance where noise
 * is skewed, is taken off to the second order (with K = 2, skew cannot be seen). Measured on the
 * scenes of tests/calibration, values with a relative squared error below 0.3 come out right to a
 * percent or two. Above, light is seen by so few samples that x says little about r, and the sum
 * reads low: the more so the more such values there are. (Windows over neighbours as denominators
 * were tried: at the edges of small lights they are wrong by orders of magnitude.) Interval:
 * squared errors of independent pixels add, so the true error over the estimated one is close to an
 * F variable with n and n (K - 1) degrees of freedom, where n, the number of values that
 * effectively hold the error, comes from tr(C^2) of each pixel's covariance C. That is estimated in
 * two ways and averaged: from the sample covariance, as if replicate means were normal, which is
 * steady but too large for long tails and too small for short ones; and from E <d_ab, d_cd>^2 = 4
 * tr(C^2) for differences d of disjoint pairs, which is right for all and unsteady. (K = 2 or 3:
 * the first alone.) F quantiles are Paulson's approximation, with Student's t for the normal
 * quantile, its degrees of freedom the pixels that hold tr(C^2). Doubt: values that a few samples
 * hold may be brighter in truth or, as often, much darker: then the true error is far above what
 * can be seen. The upper end of relMSE's interval therefore goes up by four times the squares of
 * relative errors above 0.1, added up. "Unknown" is said, in place of a small number, when there
 * are fewer than two replicates, or two and a relMSE above 0.001 (their skew is not known),
 * non-finite samples were lost, nothing but black was seen, the error rests on fewer than ten
 * pixels or values (n), tiles in which one sample holds a sixteenth of the light or a quarter of
 * the squared error make up more than a tenth of the error, or the doubt is above three quarters of
 * it. The numbers are still there then. MSE and relMSE have a verdict each: a few pixels at the
 * edge of a small bright light may hold all of the MSE of a picture whose relMSE is well known.
 *   Unknown pixels are those that lost samples, those with a relMSE above 0.3, and those with a
 *     quarter of the squared error of the one sample that their tile rests on.
 *   Measured (tests/calibration/README.md): the intervals hold in 94 to 96 % of all runs.
 *
 * Only + - * / and sqrt decide these numbers, in tile order: the same on every machine. Thread: one
 * at a time.
 */
#ifndef MASTER_ESTIMATE_H
#define MASTER_ESTIMATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct estimate;

/* The replicate means of one tile; `replicates` counts only those that have samples. */
struct tile_means {
    uint32_t width, height, replicates;
    const double *means;    /* R, G, B: means[(k * 3 + c) * pixels + p] */
    uint64_t samples;       /* per pixel, over all replicates */
    const uint32_t *failed; /* a bit for each pixel that lost non-finite samples */
    double luminance;       /* of all samples of the tile, added up */
    double largest;         /* luminance of the largest of them */
};

#define ACCURACY_MAP(X) /* why an error is unknown */                      \
    X(KNOWN, "known")                                                      \
    X(NO_REPLICATES, "fewer than two replicates")                          \
    X(TWO_REPLICATES, "two replicates say too little about so much noise") \
    X(NONFINITE, "non-finite samples were left out")                       \
    X(BLACK, "nothing but black was seen")                                 \
    X(FEW_SAMPLES, "a few samples hold the sum")                           \
    X(FEW_PIXELS, "a few pixels hold the error")

enum accuracy_verdict {
#define X(name, text) ACCURACY_##name,
    ACCURACY_MAP(X)
#undef X
};

struct interval {
    double low, high;
};

struct accuracy {
    enum accuracy_verdict verdict;     /* of relMSE: anything but ACCURACY_KNOWN is unknown */
    enum accuracy_verdict mse_verdict; /* of MSE and RMSE */
    uint32_t replicates;               /* the fewest of any tile */
    double mse, rmse, relmse;
    struct interval mse95, rmse95, relmse95; /* 95 %; [0, inf] with fewer than two replicates */
    double effective_values;                 /* n above, for relMSE */
    double unknown_share;                    /* of the pixels, see above */
};

/* Caller owns it; NULL when memory runs out. estimate_free(NULL) does nothing. */
struct estimate *estimate_new(void);
void estimate_free(struct estimate *estimate);

/* Forget everything; `replicates` is what tiles have at most. */
void estimate_begin(struct estimate *estimate, uint32_t replicates);
/* False when one sample holds so much of the tile that its error is unknown. */
bool estimate_tile(struct estimate *estimate, const struct tile_means *tile);
struct accuracy estimate_result(const struct estimate *estimate);

const char *estimate_verdict_text(enum accuracy_verdict verdict);

/* The value below which 97.5 % of Student's t lies; dof may be fractional, at least 1. */
double estimate_student(double dof);
/* The 2.5 % and 97.5 % quantiles of F(n, m), with z standard deviations instead of 1.96. */
struct interval estimate_f95(double n, double m, double z);

#endif
