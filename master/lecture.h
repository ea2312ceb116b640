/*
 * The experiments of J. Kautz's lecture "Introduction to Path Tracing", run: what they share. One
 * file per group of slides (lecture_integrals, _points, _directions, _light, _roulette) has a
 * function that writes the group's sections into a page, and beside it what computes its numbers,
 * for tests. lecture_caster is the small ray caster that makes the pictures.
 *
 * Everything here is written to be read by who hears the lecture: scalar, in double, one number
 * after another. The renderer itself does the same in eight lanes, see worker/kernel/.
 *
 * The same seed gives the same page, byte for byte: no clocks, common/elem.h instead of libm. One
 * thread.
 */
#ifndef MASTER_LECTURE_H
#define MASTER_LECTURE_H

#include "common/hash.h"
#include "master/fit.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct page;

#define LECTURE_PI 3.14159265358979323846

struct lecture {
    struct page *page;
    uint64_t seed;
    bool quick; /* few samples and small pictures: to see that it works */
};

/*
 * Random numbers in [0, 1): the lecture's uniform(), but never 1, of any thread, and the same on
 * every machine. A source is a value: the n-th number is a hash of its key and n. The first ones
 * may be given: a point of a better-distributed set, see lecture_points.
 */
struct lecture_dice {
    uint64_t key, next;
    const double *given;
    uint64_t given_count;
};

static inline struct lecture_dice lecture_dice(uint64_t seed, uint64_t purpose, uint64_t run)
{
    return (struct lecture_dice){ .key = hash64_3(seed, purpose, run) };
}

static inline double lecture_roll(struct lecture_dice *dice)
{
    uint64_t place = dice->next++;
    return place < dice->given_count ? dice->given[place] : hash64_unit(hash64(dice->key, place));
}

/* An estimate of some integral from n samples */
typedef double lecture_estimate(const void *self, uint64_t n, struct lecture_dice *dice);

/* How its root mean square error falls with n */
#define LECTURE_RATE_MAX 16
struct lecture_rate {
    size_t count;
    double n[LECTURE_RATE_MAX], rmse[LECTURE_RATE_MAX];
    double error[LECTURE_RATE_MAX]; /* standard error of rmse */
};

/* Add the RMSE of `runs` independent estimates with n samples each; its error is that of normal
 * deviations, rmse / sqrt(2 runs). */
void lecture_rate_add(struct lecture_rate *rate, lecture_estimate *estimate, const void *self,
                      double truth, uint64_t n, unsigned runs, struct lecture_dice dice);

/* Or one that is known already, with its relative error. */
void lecture_rate_note(struct lecture_rate *rate, uint64_t n, double rmse, double relative_error);

/* rmse = c n^slope, fitted to the points with n >= from */
struct fit_line lecture_rate_fit(const struct lecture_rate *rate, double from);

/* "-0.503 +- 0.012" in a buffer that the next call but three uses again */
const char *lecture_slope_text(struct fit_line fit);

/* All of it, into a page that is made here and freed by the caller; seed and quick are given. */
bool lecture_make(struct lecture *lecture, struct err *err);

#endif
