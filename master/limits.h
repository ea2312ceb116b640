/*
 * When a job ends: asked for by error, samples, time and core-hours, alone or together. The first
 * limit that is met ends it, always at the end of a round.
 *
 * Samples: the round that reaches them. Time and core-seconds: the last round that is predicted to
 * fit in. Error: the first round whose relMSE is known and at most the target, whatever has been
 * rendered of later rounds by then. That is a function of the job alone, and so are the bits of a
 * picture that was asked for by its error, on any farm.
 *
 * Bias. The stop looks at the samples that make the picture, but only at the end of a round, and
 * only at one number for the whole picture, made of differences between replicates. For a sequence
 * of independent samples with standard error s at the expected stop, and n samples at the stop,
 * Wald's equations give E sum(x - mean) = 0 and its variance, and so by Cauchy and Schwarz
 *     |bias of the mean| <= s * (standard deviation of 1/n) / (mean of 1/n).
 * Rounds grow by an eighth and stops vary by a round or two: less than a tenth of the standard
 * error, before the correlation of the pixel with the whole picture's estimate, which makes it
 * smaller by the root of the number of values that hold the error (at least ten). What is left goes
 * to the light side or the dark as replicate means are skewed; a pixel that stopped on its own
 * samples would lose most of its light where light is rare. The estimate at the stop itself reads
 * low, as the first of several noisy numbers below a line does: by about half its own noise.
 *
 * Pure: time is passed in.
 */
#ifndef MASTER_LIMITS_H
#define MASTER_LIMITS_H

#include <stdbool.h>

struct ledger_row;

#define LIMIT_MAP(X) /* what ended a job, as reports say it */ \
    X(NONE, "")                                                \
    X(ERROR, "error")                                          \
    X(SPP, "spp")                                              \
    X(TIME, "time")                                            \
    X(BUDGET, "budget-core-hours")

enum limit {
#define X(name, text) LIMIT_##name,
    LIMIT_MAP(X)
#undef X
};

struct limits {
    unsigned rounds; /* never more */
    double relmse;   /* 0, here and below: no such limit */
    double time_s, core_s;
};

/* Must rounds be decided on one by one? Else all of them can be rendered at once. */
bool limits_are_open(const struct limits *limits);

/* Does the picture of this round meet the target? */
bool limits_met(const struct limits *limits, const struct ledger_row *row);

/* Where a job stands when one more round is considered, and where it would stand after it. */
struct outlook {
    unsigned rounds; /* with the one considered */
    double elapsed_s, left_s;
    double spent_core_s, left_core_s;
};

/* What forbids that round; LIMIT_NONE when nothing does. */
enum limit limits_against(const struct limits *limits, const struct outlook *outlook);

const char *limits_text(enum limit limit);

#endif
