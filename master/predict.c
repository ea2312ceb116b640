#include "master/predict.h"

#include "common/elem.h"
#include "common/scene.h"

#include <math.h>
#include <stdio.h>

/* What errors of a kind of sampler usually do. */
struct habits {
    double slope, spread; /* at the first rows, and how much scenes differ */
    double later;         /* the slope that it goes to */
    double wanders;       /* per root of a factor e in samples */
    double bumps;         /* how far the error is off a smooth curve, as a share of it */
};

/* Of independent samples: a law, with a little room for what the estimate itself does. */
static const struct habits RANDOM = { .slope = 1, .spread = 0.01, .later = 1 };

/* Of all others, measured on small renders of a dozen scenes; tests/prediction checks what follows.
 * Powers of two fill strata, which makes bumps; edges and smooth parts, whose errors fall faster,
 * have their share in the first rows. */
static const struct habits STRATIFIED = { 1.1, 0.08, 1.06, 0.04, 0.04 };

#define GOES_LATER 0.4 /* of the way that is left, per factor e in samples */

#define COST_SPREAD 0.05 /* of what a sample costs now and later, as a relative deviation */

#define TOO_LOW  0.05
#define TOO_HIGH 0.95

/* ln relMSE as it is expected, its slope (positive), and the noise in units of its own deviation */
enum { LEVEL, SLOPE, NOISE, STATES };

struct filter {
    double at[STATES], covariance[STATES][STATES];
    double x;         /* ln spp */
    double deviation; /* of the noise */
    double variances; /* of the rows' estimates, added up */
    double rows;
    const struct habits *habits;
};

static bool known(const struct ledger_row *row)
{
    return row->accuracy.verdict == ACCURACY_KNOWN && row->accuracy.relmse > 0 && row->spp > 0;
}

/*
 * The noise of a row's estimate, as a relative deviation. Where rare samples matter, the values
 * that seem to hold the error are many until such a sample comes and few after it: so what all rows
 * say of it is averaged.
 */
static void learn_deviation(struct filter *f, const struct accuracy *accuracy)
{
    double dof = accuracy->effective_values * (accuracy->replicates - 1);
    f->variances += isfinite(dof) && dof > 0 ? 2 / dof : 0;
    f->rows++;
    f->deviation = sqrt(f->variances / f->rows + f->habits->bumps * f->habits->bumps);
}

/* a = m a m^T */
static void transform(double a[STATES][STATES], const double m[STATES][STATES])
{
    double half[STATES][STATES];
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++) {
            half[i][j] = 0;
            for (int k = 0; k < STATES; k++)
                half[i][j] += m[i][k] * a[k][j];
        }
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++) {
            a[i][j] = 0;
            for (int k = 0; k < STATES; k++)
                a[i][j] += half[i][k] * m[j][k];
        }
}

static void begin(struct filter *f, const struct ledger_row *row, uint32_t sampler)
{
    const struct habits *habits = sampler == SAMPLER_INDEPENDENT ? &RANDOM : &STRATIFIED;
    *f = (struct filter){
        .at = { elem_log(row->accuracy.relmse), habits->slope, 0 },
        .x = elem_log((double)row->spp),
        .habits = habits,
    };
    learn_deviation(f, &row->accuracy);
    double deviation = f->deviation;
    /* The level is known but for the noise of its only observation */
    f->covariance[LEVEL][LEVEL] = deviation * deviation;
    f->covariance[LEVEL][NOISE] = f->covariance[NOISE][LEVEL] = -deviation;
    f->covariance[NOISE][NOISE] = 1;
    f->covariance[SLOPE][SLOPE] = habits->spread * habits->spread;
}

/* On to x: the level falls, the slope goes where it usually does and wanders, part of the noise is
 * forgotten. */
static void advance(struct filter *f, double x)
{
    double d = x - f->x, later = f->habits->later, wandered = pow(f->habits->wanders, 2);
    double kept = elem_exp(-d), kept_slope = elem_exp(-GOES_LATER * d);
    double reach = (1 - kept_slope) / GOES_LATER; /* the integral of what is kept of the slope */
    const double step[STATES][STATES] = { { 1, -reach, 0 }, { 0, kept_slope, 0 }, { 0, 0, kept } };
    f->at[LEVEL] -= later * d + (f->at[SLOPE] - later) * reach;
    f->at[SLOPE] = later + (f->at[SLOPE] - later) * kept_slope;
    f->at[NOISE] *= kept;
    transform(f->covariance, step);
    f->covariance[LEVEL][LEVEL] += wandered * d * d * d / 3;
    f->covariance[LEVEL][SLOPE] -= wandered * d * d / 2;
    f->covariance[SLOPE][LEVEL] -= wandered * d * d / 2;
    f->covariance[SLOPE][SLOPE] += wandered * d;
    f->covariance[NOISE][NOISE] += 1 - kept * kept;
    f->x = x;
}

/* What the next estimate will be, and its variance. */
static double expected(const struct filter *f, double *variance)
{
    double s = f->deviation;
    *variance = f->covariance[LEVEL][LEVEL] + 2 * s * f->covariance[LEVEL][NOISE] +
                s * s * f->covariance[NOISE][NOISE];
    return f->at[LEVEL] + s * f->at[NOISE];
}

static void observe(struct filter *f, const struct accuracy *accuracy)
{
    double variance, gain[STATES], seen[STATES];
    learn_deviation(f, accuracy);
    double surprise = elem_log(accuracy->relmse) - expected(f, &variance);
    if (!(variance > 1e-12)) /* nothing to learn, and nothing to divide by */
        return;
    for (int i = 0; i < STATES; i++) {
        seen[i] = f->covariance[i][LEVEL] + f->deviation * f->covariance[i][NOISE];
        gain[i] = seen[i] / variance;
    }
    for (int i = 0; i < STATES; i++) {
        f->at[i] += gain[i] * surprise;
        for (int j = 0; j < STATES; j++)
            f->covariance[i][j] -= gain[i] * seen[j];
    }
}

/* The filter after all rows; the first one of known error, or NULL. */
static const struct ledger_row *follow(struct filter *f, const struct predict_job *job,
                                       const struct ledger_row *rows, size_t count)
{
    const struct ledger_row *first = NULL;
    for (size_t i = 0; i < count; i++) {
        if (!known(&rows[i]))
            continue;
        if (first == NULL) {
            first = &rows[i];
            begin(f, first, job->sampler);
        } else {
            advance(f, elem_log((double)rows[i].spp));
            observe(f, &rows[i].accuracy);
        }
    }
    return first;
}

/* That an estimate after so many samples is at most the target. */
static double chance_at(const struct filter *now, const struct predict_job *job, uint64_t spp)
{
    struct filter f = *now;
    double variance;
    advance(&f, elem_log((double)spp));
    double above = expected(&f, &variance) - elem_log(job->relmse);
    if (!(variance > 0))
        return above <= 0;
    return 0.5 * erfc(above / sqrt(2 * variance));
}

double predict_chance(const struct predict_job *job, const struct ledger_row *rows, size_t count,
                      unsigned rounds)
{
    struct filter f;
    if (count == 0 || rounds == 0 || follow(&f, job, rows, count) == NULL)
        return NAN;
    uint64_t spp = job_samples(&job->spec, rounds);
    return chance_at(&f, job, spp > rows[count - 1].spp ? spp : rows[count - 1].spp);
}

/* Per sample, over the last half of the samples. */
static void pace(const struct ledger_row *rows, size_t count, double *core_s, double *wall_s)
{
    const struct ledger_row *last = &rows[count - 1];
    struct ledger_row before = { 0 };
    for (size_t i = count - 1; i-- > 0;)
        if (rows[i].spp <= last->spp / 2) {
            before = rows[i];
            break;
        }
    double done = (double)(last->spp - before.spp);
    *core_s = (last->core_s - before.core_s) / done;
    *wall_s = (last->wall_s - before.wall_s) / done;
}

/* The ends of rounds, as numbers of rounds, whose chances are nearest to 5, 50 and 95 %. */
struct ends {
    unsigned low, mid, high;
};

static bool find_ends(const struct filter *now, const struct predict_job *job, unsigned rounds,
                      struct ends *ends)
{
    double before = 0, low = TOO_LOW, high = 1; /* distances of the best so far */
    *ends = (struct ends){ .low = rounds + 1 };
    while (++rounds <= ROUND_COUNT) {
        double chance = chance_at(now, job, job_samples(&job->spec, rounds));
        chance = chance > before ? chance : before; /* who has met the target has met it */
        if (fabs(chance - TOO_LOW) <= low) {
            low = fabs(chance - TOO_LOW);
            ends->low = rounds + 1;
        }
        if (ends->mid == 0 && chance >= 0.5)
            ends->mid = rounds;
        if (fabs(chance - TOO_HIGH) < high) {
            high = fabs(chance - TOO_HIGH);
            ends->high = rounds;
        } else if (chance > TOO_HIGH) {
            break;
        }
        before = chance;
    }
    if (ends->low > ends->high)
        ends->low = ends->high;
    return ends->mid > 0 && rounds <= ROUND_COUNT;
}

/* A band of samples still to come as one of what they cost, in the cost of one sample now: half a
 * round is added by the caller, and here that other samples may cost more or less. */
static struct predict_band wider(double low, double mid, double high)
{
    double spread = 1.645 * COST_SPREAD;
    double down = sqrt(pow(log(mid / low), 2) + spread * spread);
    double up = sqrt(pow(log(high / mid), 2) + spread * spread);
    return (struct predict_band){ mid * exp(-down), mid, mid * exp(up) };
}

static struct predict_band after(double spent, double cost, const struct predict_band *more)
{
    return (struct predict_band){ spent + cost * more->low, spent + cost * more->mid,
                                  spent + cost * more->high };
}

bool predict_end(const struct predict_job *job, const struct ledger_row *rows, size_t count,
                 struct prediction *out)
{
    struct filter f;
    struct ends ends;
    const struct ledger_row *first = count == 0 ? NULL : follow(&f, job, rows, count);
    if (first == NULL || rows[count - 1].spp < 4 * first->spp ||
        !find_ends(&f, job, rows[count - 1].round + 1, &ends))
        return false;

    const struct ledger_row *last = &rows[count - 1];
    const struct job_spec *spec = &job->spec;
    double now = (double)last->spp, core_s, wall_s;
    double low = (double)job_samples(spec, ends.low), mid = (double)job_samples(spec, ends.mid);
    double high = (double)job_samples(spec, ends.high);
    out->spp = (struct predict_band){ low, mid, high };
    low = sqrt(low * (double)job_samples(spec, ends.low - 1)) - now;
    high = sqrt(high * (double)job_samples(spec, ends.high + 1)) - now;
    pace(rows, count, &core_s, &wall_s);
    struct predict_band more = wider(low, mid - now, high);
    out->core_s = after(last->core_s, core_s, &more);
    out->wall_s = after(last->wall_s, wall_s, &more);
    out->slope = -f.at[SLOPE];
    out->slope_stderr = sqrt(f.covariance[SLOPE][SLOPE]);
    return true;
}

const char *predict_text(const struct prediction *prediction, const struct ledger_row *now,
                         double relmse, char *text, size_t capacity)
{
    const struct prediction *p = prediction;
    snprintf(text, capacity,
             "%g needs %.0f to %.0f samples per pixel, %.3g to %.3g core-seconds, "
             "%.3g to %.3g s more",
             relmse, p->spp.low, p->spp.high, p->core_s.low - now->core_s,
             p->core_s.high - now->core_s, p->wall_s.low - now->wall_s,
             p->wall_s.high - now->wall_s);
    return text;
}
