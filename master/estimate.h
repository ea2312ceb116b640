/*
 * How wrong is this picture? The error estimate of an image from its K replicates.
 *
 * What is estimated: the error of the image mean x that a comparison with the truth r would find,
 *     MSE    = mean over pixels and channels of (x - r)^2
 *     relMSE = the same of (x - r)^2 / (r^2 + 0.01).
 *
 * Method. The K replicates of a pixel are independent, so (m_i - m_j)^2 / 2 of two replicate means,
 * averaged over pairs and divided by K, has the expectation of (x - r)^2 whatever the sampler.
 *   Denominator: r is replaced by a mean of the replicates that are not in the pair (of both when
 *     K = 2), over the smallest window of 1, 3x3 or 5x5 pixels (cut at the tile) in which that mean
 *     is known to about 15 %; the second-order bias of 1/(r^2 + 0.01) that its noise leaves is
 *     taken off. What may still be wrong is added to both ends of the interval: what was taken
 *     off, and the difference that the windows make against each pixel alone.
 *   Interval: squared errors of independent blocks of 8x8 pixels add, so the true error over the
 *     estimated one is close to an F variable with n and n (K - 1) degrees of freedom, where n, the
 *     number of values that effectively hold the error, comes from tr(C^2) of each block's
 *     covariance C. With K >= 4 that is estimated without assuming normal replicate means or
 *     independent channels: E <d_ab, d_cd>^2 = 4 tr(C^2) for differences d of disjoint pairs. With
 *     K = 2 or 3 it is bounded under normality, pixel by pixel. F quantiles are Paulson's
 *     approximation, with Student's t for the normal quantile since n itself is an estimate.
 *   "Unknown" is said, in place of a small number, when there are fewer than two replicates, or
 *     two and a relMSE above 0.001 (their own mean is the denominator, which skewed noise biases),
 *     non-finite samples were lost, nothing but black was seen, the error rests on fewer than ten
 *     pixels or values (n), or tiles in which one sample holds a sixteenth of the light or
 *     a quarter of the squared error make up more than a tenth of the error. The numbers are still
 *     there then.
 *   Known limits, measured on synthetic noise with K = 4: the MSE's interval covers 93 to 98 %
 *     throughout, the relMSE's 92 % or more while the picture's noise is below a tenth of its
 *     pixels, even for lognormal replicate means. Above, it widens, and on pictures whose detail is
 *     lost in the noise the estimate reads high, by up to a half.
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
    enum accuracy_verdict verdict; /* anything but ACCURACY_KNOWN: unknown */
    uint32_t replicates;           /* the fewest of any tile */
    double mse, rmse, relmse;
    struct interval mse95, rmse95, relmse95; /* 95 %; [0, inf] with fewer than two replicates */
    double effective_values;                 /* n above, for relMSE */
    double unknown_share;                    /* of the pixels: in unknown tiles, or failed */
};

/* Caller owns it; NULL when memory runs out. estimate_free(NULL) does nothing. */
struct estimate *estimate_new(void);
void estimate_free(struct estimate *estimate);

/* Forget everything and prepare for tiles of up to `replicates`; false when memory runs out. */
bool estimate_begin(struct estimate *estimate, uint32_t replicates);
void estimate_tile(struct estimate *estimate, const struct tile_means *tile);
struct accuracy estimate_result(const struct estimate *estimate);

const char *estimate_verdict_text(enum accuracy_verdict verdict);

/* The value below which 97.5 % of Student's t lies; dof may be fractional, at least 1. */
double estimate_student(double dof);
/* The 2.5 % and 97.5 % quantiles of F(n, m), with z standard deviations instead of 1.96. */
struct interval estimate_f95(double n, double m, double z);

#endif
