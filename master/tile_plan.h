/*
 * Plan, then spend: how many samples each tile of a job gets.
 *
 * Without a pilot all tiles are alike, and after r rounds of the job every pair of tile and
 * replicate has finished its own rounds 0 .. r-1.
 *
 * With a pilot (job_spec.pilot_rounds = p) there are K sample sequences more, numbers K .. 2K-1,
 * which are rendered in the first p rounds of the job and never again. What they show fixes a
 * factor per tile, and the K main sequences, which have nothing in common with those that decided,
 * are rendered after that: when r rounds of the job beyond the pilot's are done, a pair of a tile
 * with factor f has finished the rounds that reach f times the leaves of round r. So in one round
 * of the job a pair may advance by any number of its own rounds, none included. Rounds of the job
 * are what ends, seals and makes rows of the ledger; the sum tree below knows only a pair's own.
 *
 * Factors minimise the picture's relMSE for the work that a factor of 1 would be everywhere
 * (Neyman: samples in proportion to sqrt(error / work)). They are powers of two, so that each
 * tile's number of samples is as good for a low-discrepancy sequence as the one that was asked for;
 * finer ones lost more by that than they gained. A pilot does not see everything, hence three
 * precautions: a tile counts for at least a quarter of the mean of its neighbours, so that the edge
 * of a caustic is not starved; one whose error rests on a single sample counts for no more than the
 * worst of its neighbours; and no factor is below 1/4, which bounds what light that the pilot
 * missed can cost: four times the error in its tile.
 *
 * Work is counted in rays and events, never in seconds, so that the plan, like the picture, is a
 * function of the job. Only + - * / and sqrt decide it, in tile order.
 *
 * Plain data; used by one thread at a time.
 */
#ifndef MASTER_TILE_PLAN_H
#define MASTER_TILE_PLAN_H

#include <stdbool.h>
#include <stdint.h>

struct job_spec;
struct node_id;
struct node_stats;
struct scene;

/* Factors are powers of two, from 1/4 to 8. */
#define TILE_PLAN_OCTAVE_MIN (-2)
#define TILE_PLAN_OCTAVE_MAX 3

/* What the pilot saw of a tile. */
struct tile_look {
    uint32_t pixels;
    double error; /* squared relative errors of its mean, over pixels and channels, added up */
    double work;  /* of its samples: tile_plan_work */
    uint64_t samples;
    bool one_sample; /* the error rests on one */
};

struct tile_plan {
    uint32_t tiles, across; /* all, and those of a row */
    uint32_t replicates;    /* K */
    unsigned pilot_rounds;  /* 0: no pilot */
    double pilot_weight;    /* of the pilot's mean in the picture */
    bool made;              /* the factors are known */
    int8_t *octaves;        /* log2 of each tile's factor; NULL: all 0 */
    struct tile_look *looks;
    double predicted_gain; /* relMSE of equal factors over that of these, for equal work */
};

/* The plan of a job without a pilot; needs no closing. */
struct tile_plan tile_plan_uniform(uint32_t tiles, uint32_t replicates);

/* The plan of any job, not made yet where there is a pilot. False when memory runs out.
 * tile_plan_close may follow either way. */
bool tile_plan_open(struct tile_plan *plan, const struct scene *scene, const struct job_spec *spec);
void tile_plan_close(struct tile_plan *plan);

/*
 * Fix the factors by plan->looks, which the caller has filled in. `rounds` of the job, the pilot's
 * included, are going to be rendered: after those the work is right. 0: nobody knows how many.
 */
bool tile_plan_make(struct tile_plan *plan, unsigned rounds);

/* Work in units of a closest-hit ray. The constants are measured: see tile_plan.c. */
double tile_plan_work(const struct node_stats *stats);

uint32_t tile_plan_sequences(const struct tile_plan *plan); /* K, or 2K with a pilot */
double tile_plan_factor(const struct tile_plan *plan, uint32_t tile);

/*
 * Own rounds that a pair has finished after `rounds` rounds of the job. Before the plan is made the
 * main sequences count as if all factors were 1, which is right on average.
 */
unsigned tile_plan_pair_rounds(const struct tile_plan *plan, uint32_t tile, uint32_t sequence,
                               unsigned rounds);

/* The round of the job that a node belongs to. False when it belongs to none, or to one that is not
 * planned yet. */
bool tile_plan_job_round(const struct tile_plan *plan, const struct node_id *node, unsigned *round);

uint64_t tile_plan_units(const struct tile_plan *plan, unsigned round);   /* own rounds in it */
uint64_t tile_plan_leaves(const struct tile_plan *plan, unsigned rounds); /* of all pairs */

/* How many tiles have a factor of at least, or at most, 2^octave. */
uint32_t tile_plan_count_from(const struct tile_plan *plan, int octave);
uint32_t tile_plan_count_to(const struct tile_plan *plan, int octave);

#endif
