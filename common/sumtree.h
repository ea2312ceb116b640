/*
 * The sum tree: why the bits never change.
 *
 * A leaf is a block of `leaf_samples` samples of every pixel of one tile of one replicate. Node
 * (level l, index j) covers leaves [j 2^l, (j+1) 2^l) and is defined as node(l-1, 2j) +
 * node(l-1, 2j+1), elementwise in float32 (statistics: integers and double). So any aligned range
 * is one node with one value, whoever computes it and in whatever pieces.
 *
 * Rounds end, per replicate, at n = 1, 2, ..., 8 leaves and then at n = 2^m (8 + j) / 8, j = 0..7:
 * 9..16, 18, 20, ..32, 36, ... Every round beyond the eighth is one node of level m - 3, and no
 * leased or stored node crosses the end of a round.
 *
 * Pure data and functions; a struct belongs to one thread at a time.
 */
#ifndef COMMON_SUMTREE_H
#define COMMON_SUMTREE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

#define TILE_SIZE      32 /* pixels along a side */
#define TILE_PIXELS    (TILE_SIZE * TILE_SIZE)
#define NODE_LEVEL_MAX 40  /* leaves per replicate: at most 2^40 */
#define ROUND_COUNT    304 /* rounds up to there */

struct node_id {
    uint32_t tile, replicate, level;
    uint64_t index;
};

enum nonfinite_cause {
    NONFINITE_NAN = 0,
    NONFINITE_INF = 1,
    NONFINITE_NEGATIVE = 2,
    NONFINITE_CAUSES
};

/* What a node counts besides its sums. All of it is a function of the leaves, like the sums. */
struct node_stats {
    uint64_t samples;                     /* camera paths, over all pixels */
    uint64_t rays_closest, rays_shadow;   /* handed to Embree */
    uint64_t events;                      /* scattering events */
    uint64_t nonfinite[NONFINITE_CAUSES]; /* samples left out of the sum, by cause */
    uint64_t truncated_paths;             /* ended by the depth limit or the safety cap */
    double truncated_energy;              /* sum of the luminance of their throughputs */
    float largest;                        /* luminance of the largest single sample in it */
};

/*
 * Sums over the samples of a node. `values` is planar: channel c of pixel p (row-major in the
 * tile, top row first) at values[c * pixel_count + p]. `failed` has a bit for every pixel that lost
 * a non-finite sample.
 */
struct node_sums {
    struct node_stats stats;
    uint32_t pixel_count, channel_count;
    uint32_t failed[TILE_PIXELS / 32];
    float *values;
};

/* Allocated in one piece with its values, zeroed; NULL when memory runs out; free with
 * node_sums_free. */
struct node_sums *node_sums_new(uint32_t pixel_count, uint32_t channel_count);
void node_sums_free(struct node_sums *sums);
size_t node_sums_size(uint32_t pixel_count, uint32_t channel_count); /* bytes of that piece */

/* Counters add, `largest` is the larger. Part of node_sums_add. */
void node_stats_add(struct node_stats *left, const struct node_stats *right);

/* left = left + right: the one addition that defines the tree. Shapes must match. */
void node_sums_add(struct node_sums *left, const struct node_sums *right);

/* Leaves per replicate at the end of round r = 0, 1, ...: 1, 2, ..., 8, 9, ..., 16, 18, ... */
uint64_t round_end(unsigned round);
/* The first round whose end is at least `leaves`. */
unsigned round_reaching(uint64_t leaves);
/* The level and index of the one node that round r adds. */
void round_node(unsigned round, uint32_t *level, uint64_t *index);
/* The round a node lies in; false when it crosses the end of one or lies beyond the last. */
bool round_holding(uint32_t level, uint64_t index, unsigned *round);

/*
 * A fold collects the nodes below one target node in any order and adds siblings as soon as both
 * are there. It owns the sums it is given. At most `depth` sums wait at once when nodes come in
 * order; early arrivals add to that.
 */
struct fold;
struct fold *fold_new(uint32_t target_level, uint64_t target_index);
void fold_free(struct fold *fold);

enum fold_result {
    FOLD_ADDED,     /* taken; the fold owns the sums now */
    FOLD_DUPLICATE, /* some of that range is covered already; the caller keeps the sums */
    FOLD_FOREIGN,   /* not below the target; the caller keeps the sums */
    FOLD_NO_MEMORY  /* the caller keeps the sums */
};
enum fold_result fold_add(struct fold *fold, uint32_t level, uint64_t index,
                          struct node_sums *sums);
/* What fold_add would say: ADDED, DUPLICATE or FOREIGN. */
enum fold_result fold_check(const struct fold *fold, uint32_t level, uint64_t index);

/* The target's sums once everything arrived, else NULL. The caller owns them; the fold is empty. */
struct node_sums *fold_take(struct fold *fold);
size_t fold_waiting(const struct fold *fold); /* sums held */

/*
 * The finished prefix of one (tile, replicate): nodes in index order, added like the carries of a
 * binary counter, so that at the end of a round at most four sums remain.
 */
struct sum_stack {
    struct node_sums *sums[NODE_LEVEL_MAX + 1]; /* by level; NULL where the bit is 0 */
    uint64_t leaves;
};

/* Push the node that starts at leaf `stack->leaves` (it must); the stack owns the sums then. */
void sum_stack_push(struct sum_stack *stack, uint32_t level, struct node_sums *sums);
/* The sum of everything so far into `total` (same shape), folded smallest node first. */
void sum_stack_total(const struct sum_stack *stack, struct node_sums *total);
void sum_stack_clear(struct sum_stack *stack);

#endif
