/*
 * What a job has cost its workers' cores, round by round, how fast they spend at present, and so
 * what is left to spend until later rounds end. Rounds go over the same pixels again, so what whole
 * rounds have cost tells the cost of the next, and tiles of a round that is half done do not.
 *
 * Pure: time is passed in.
 */
#ifndef MASTER_SPENDING_H
#define MASTER_SPENDING_H

#include "common/sumtree.h"

#include <stdint.h>

struct spending {
    unsigned pilot_rounds;      /* which come first, and count their own leaves */
    double core_s;              /* of all results */
    double rounds[ROUND_COUNT]; /* of the results that were taken, by the round they belong to */
    double pace_core_s, pace_s; /* lately: the older, the less it weighs */
    double seen_core_s;         /* at the last look */
    uint64_t began_ms, seen_ms;
};

void spending_begin(struct spending *spending, uint64_t now_ms);

/* A result came, whatever becomes of it; and it was taken. */
void spending_add(struct spending *spending, double core_s);
void spending_take(struct spending *spending, unsigned round, double core_s);

/* Look at the clock, several times a second. */
void spending_tick(struct spending *spending, uint64_t now_ms);

/* Core-seconds of the first `rounds` rounds. */
double spending_until(const struct spending *spending, unsigned rounds);

/*
 * Core-seconds still to be spent until `rounds` rounds have ended, of which `sealed` have, and
 * `leaves_done` leaves of a (tile, replicate) on average. Infinite while nothing is known.
 */
double spending_left(const struct spending *spending, unsigned sealed, unsigned rounds,
                     double leaves_done);

/* Core-seconds that results bring per second; 0 while there are none. */
double spending_pace(const struct spending *spending);

#endif
