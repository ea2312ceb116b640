#include "master/spending.h"

#include "common/elem.h"

#include <math.h>

#define FORGET_S 10.0 /* the pace of workers that came or went is that of all after this time */
#define ENOUGH_S                                                                     \
    0.5 /* of the time since the first results: before, take all since the beginning \
         */

void spending_begin(struct spending *s, uint64_t now_ms)
{
    *s = (struct spending){ .began_ms = now_ms, .seen_ms = now_ms };
}

void spending_add(struct spending *s, double core_s)
{
    s->core_s += core_s;
}

void spending_take(struct spending *s, unsigned round, double core_s)
{
    s->rounds[round] += core_s;
}

void spending_tick(struct spending *s, uint64_t now_ms)
{
    double passed_s = (double)(now_ms - s->seen_ms) / 1000;
    if (s->seen_core_s > 0) { /* else workers were still starting, or loading the scene */
        double kept = elem_exp(-passed_s / FORGET_S);
        s->pace_s = kept * s->pace_s + passed_s;
        s->pace_core_s = kept * s->pace_core_s + s->core_s - s->seen_core_s;
    }
    s->seen_core_s = s->core_s;
    s->seen_ms = now_ms;
}

double spending_until(const struct spending *s, unsigned rounds)
{
    double sum = 0;
    for (unsigned r = 0; r < rounds; r++)
        sum += s->rounds[r];
    return sum;
}

/* Leaves of a (tile, replicate) after so many rounds, on average. */
static double leaves_after(const struct spending *s, unsigned rounds)
{
    unsigned pilot = rounds < s->pilot_rounds ? rounds : s->pilot_rounds, rest = rounds - pilot;
    return (double)((pilot > 0 ? round_end(pilot - 1) : 0) + (rest > 0 ? round_end(rest - 1) : 0));
}

double spending_left(const struct spending *s, unsigned sealed, unsigned rounds, double leaves_done)
{
    double of_leaf = sealed > 0 ? spending_until(s, sealed) / leaves_after(s, sealed)
                                : spending_until(s, ROUND_COUNT) / leaves_done;
    if (!(of_leaf > 0))
        return INFINITY;
    double left = 0;
    for (unsigned r = sealed; r < rounds; r++) {
        double leaves = leaves_after(s, r + 1) - leaves_after(s, r);
        double more = of_leaf * leaves - s->rounds[r];
        left += more > 0 ? more : 0;
    }
    return left;
}

double spending_pace(const struct spending *s)
{
    if (s->pace_s >= ENOUGH_S && s->pace_core_s > 0)
        return s->pace_core_s / s->pace_s;
    return s->seen_ms > s->began_ms ? 1000 * s->core_s / (double)(s->seen_ms - s->began_ms) : 0;
}
