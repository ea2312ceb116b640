#include "master/pieces.h"

#include "common/err.h"
#include "master/tile_plan.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

/* The round node of one (tile, replicate), from its opening until its round seals. */
struct unit {
    unsigned round;
    bool cut;
    uint64_t leaves, leaves_done;
    struct unit *next; /* in its round */
};

struct round {
    struct unit *units;
    uint64_t units_done;
    uint64_t pieces_done;
};

struct pieces {
    const struct tile_plan *plan;
    uint32_t sequences;
    uint64_t pairs, early_max;

    unsigned allowed;        /* rounds */
    uint64_t leaves_allowed; /* in them */
    unsigned sealed;         /* rounds */
    uint64_t units;          /* in the next round to seal */
    unsigned cursor_round;   /* the next unit to open: its round, its pair, the pair's own round */
    uint64_t cursor_pair;
    unsigned cursor_own;
    struct round rounds[ROUNDS_AHEAD]; /* round r >= sealed at r % ROUNDS_AHEAD */

    struct piece *waiting_first;
    struct piece **buckets;
    size_t bucket_count, piece_count;

    uint64_t leaves_handed, leaves_done, open_pairs;
};

struct pieces *pieces_new(const struct tile_plan *plan, uint64_t early_max)
{
    struct pieces *p = calloc(1, sizeof(*p));
    if (p == NULL)
        return NULL;
    p->plan = plan;
    p->sequences = tile_plan_sequences(plan);
    p->pairs = (uint64_t)plan->tiles * p->sequences;
    p->early_max = early_max;
    p->bucket_count = 1024;
    p->buckets = calloc(p->bucket_count, sizeof(struct piece *));
    if (p->buckets == NULL) {
        free(p);
        return NULL;
    }
    return p;
}

static void round_release_units(struct round *round)
{
    while (round->units != NULL) {
        struct unit *unit = round->units;
        round->units = unit->next;
        free(unit);
    }
    *round = (struct round){ 0 };
}

void pieces_free(struct pieces *p)
{
    if (p == NULL)
        return;
    for (size_t b = 0; b < p->bucket_count; b++) {
        while (p->buckets[b] != NULL) {
            struct piece *piece = p->buckets[b];
            p->buckets[b] = piece->in_bucket;
            free(piece);
        }
    }
    for (unsigned r = 0; r < ROUNDS_AHEAD; r++)
        round_release_units(&p->rounds[r]);
    free(p->buckets);
    free(p);
}

/* ---- the table of pieces, by node */

static size_t node_bucket(const struct pieces *p, const struct node_id *node)
{
    uint64_t h = node->index * 0x9e3779b97f4a7c15u;
    h ^= ((uint64_t)node->tile << 16) ^ ((uint64_t)node->replicate << 48) ^ node->level;
    h *= 0xff51afd7ed558ccdu;
    return (size_t)(h >> 20) & (p->bucket_count - 1);
}

static bool node_equal(const struct node_id *a, const struct node_id *b)
{
    return a->tile == b->tile && a->replicate == b->replicate && a->level == b->level &&
           a->index == b->index;
}

struct piece *pieces_find(const struct pieces *p, const struct node_id *node)
{
    struct piece *piece = p->buckets[node_bucket(p, node)];
    while (piece != NULL && !node_equal(&piece->node, node))
        piece = piece->in_bucket;
    return piece;
}

static void table_grow(struct pieces *p)
{
    struct pieces bigger = *p;
    bigger.bucket_count = 2 * p->bucket_count;
    bigger.buckets = calloc(bigger.bucket_count, sizeof(struct piece *));
    if (bigger.buckets == NULL)
        return; /* longer chains are slower, not wrong */
    for (size_t b = 0; b < p->bucket_count; b++) {
        while (p->buckets[b] != NULL) {
            struct piece *piece = p->buckets[b];
            p->buckets[b] = piece->in_bucket;
            struct piece **head = &bigger.buckets[node_bucket(&bigger, &piece->node)];
            piece->in_bucket = *head;
            *head = piece;
        }
    }
    free(p->buckets);
    p->buckets = bigger.buckets;
    p->bucket_count = bigger.bucket_count;
}

static void table_add(struct pieces *p, struct piece *piece)
{
    if (p->piece_count >= p->bucket_count)
        table_grow(p);
    struct piece **head = &p->buckets[node_bucket(p, &piece->node)];
    piece->in_bucket = *head;
    *head = piece;
    p->piece_count++;
}

static void table_remove(struct pieces *p, struct piece *piece)
{
    struct piece **link = &p->buckets[node_bucket(p, &piece->node)];
    while (*link != piece)
        link = &(*link)->in_bucket;
    *link = piece->in_bucket;
    p->piece_count--;
}

/* ---- the waiting list */

static void waiting_add_first(struct pieces *p, struct piece *piece)
{
    piece->state = PIECE_WAITING;
    piece->waiting_prev = NULL;
    piece->waiting_next = p->waiting_first;
    if (p->waiting_first != NULL)
        p->waiting_first->waiting_prev = piece;
    p->waiting_first = piece;
}

static void waiting_remove(struct pieces *p, struct piece *piece)
{
    assert(piece->state == PIECE_WAITING);
    if (piece->waiting_next != NULL)
        piece->waiting_next->waiting_prev = piece->waiting_prev;
    if (piece->waiting_prev != NULL)
        piece->waiting_prev->waiting_next = piece->waiting_next;
    else
        p->waiting_first = piece->waiting_next;
    piece->waiting_prev = piece->waiting_next = NULL;
}

struct piece *pieces_waiting(struct pieces *p)
{
    return p->waiting_first;
}

static uint64_t leaves_of(const struct node_id *node)
{
    return (uint64_t)1 << node->level;
}

static struct piece *piece_new(struct unit *unit, const struct node_id *node)
{
    struct piece *piece = calloc(1, sizeof(*piece));
    if (piece != NULL) {
        piece->unit = unit;
        piece->node = *node;
    }
    return piece;
}

/* Own rounds that a pair has finished after so many of the job's. */
static unsigned own_rounds(const struct pieces *p, uint64_t pair, unsigned rounds)
{
    return tile_plan_pair_rounds(p->plan, (uint32_t)(pair / p->sequences),
                                 (uint32_t)(pair % p->sequences), rounds);
}

/* Move the cursor to a unit that may be opened, past pairs that have none in its round. */
static bool find_unit(struct pieces *p)
{
    while (p->cursor_round < p->allowed && p->cursor_round < p->sealed + ROUNDS_AHEAD) {
        for (; p->cursor_pair < p->pairs; p->cursor_pair++, p->cursor_own = 0) {
            unsigned before = own_rounds(p, p->cursor_pair, p->cursor_round);
            p->cursor_own = p->cursor_own < before ? before : p->cursor_own;
            if (p->cursor_own < own_rounds(p, p->cursor_pair, p->cursor_round + 1))
                return true;
        }
        p->cursor_pair = 0;
        p->cursor_round++;
    }
    return false;
}

struct piece *pieces_open_next(struct pieces *p, struct err *err)
{
    if (!find_unit(p) || (p->cursor_round > p->sealed && pieces_early(p) >= p->early_max))
        return NULL;

    struct node_id node = { .tile = (uint32_t)(p->cursor_pair / p->sequences),
                            .replicate = (uint32_t)(p->cursor_pair % p->sequences) };
    round_node(p->cursor_own, &node.level, &node.index);
    struct unit *unit = calloc(1, sizeof(*unit));
    struct piece *piece = unit == NULL ? NULL : piece_new(unit, &node);
    if (piece == NULL) {
        free(unit);
        err_set(err, ERR_MEMORY, "no memory for the next node");
        return NULL;
    }

    struct round *round = &p->rounds[p->cursor_round % ROUNDS_AHEAD];
    unit->round = p->cursor_round;
    unit->leaves = leaves_of(&node);
    unit->next = round->units;
    round->units = unit;
    table_add(p, piece);
    waiting_add_first(p, piece);
    p->cursor_own++;
    return piece;
}

bool pieces_cut(struct pieces *p, struct piece *piece, struct err *err)
{
    assert(piece->state == PIECE_WAITING && piece->holders == NULL && piece->node.level > 0);
    struct node_id half = piece->node;
    half.level--;
    half.index *= 2;
    struct piece *left = piece_new(piece->unit, &half);
    half.index++;
    struct piece *right = piece_new(piece->unit, &half);
    if (left == NULL || right == NULL) {
        free(left);
        free(right);
        return err_set(err, ERR_MEMORY, "no memory to cut a node in two");
    }

    /* Whoever failed at the whole has failed at either half */
    struct piece *children[2] = { right, left };
    for (int c = 0; c < 2; c++) {
        memcpy(children[c]->failed_on, piece->failed_on, sizeof(piece->failed_on));
        children[c]->failed_workers = piece->failed_workers;
        children[c]->failures = piece->failures;
        table_add(p, children[c]);
        waiting_add_first(p, children[c]);
    }
    if (!piece->unit->cut) {
        piece->unit->cut = true;
        p->open_pairs++;
    }
    waiting_remove(p, piece);
    table_remove(p, piece);
    free(piece);
    return true;
}

void pieces_take(struct pieces *p, struct piece *piece)
{
    waiting_remove(p, piece);
    piece->state = PIECE_LEASED;
    piece->leased_before = true;
    p->leaves_handed += leaves_of(&piece->node);
}

void pieces_put_back(struct pieces *p, struct piece *piece)
{
    assert(piece->state == PIECE_LEASED);
    p->leaves_handed -= leaves_of(&piece->node);
    waiting_add_first(p, piece);
}

/* Forget the pieces and units of the oldest open round. */
static void seal_round(struct pieces *p)
{
    for (size_t b = 0; b < p->bucket_count; b++) {
        struct piece **link = &p->buckets[b];
        while (*link != NULL) {
            struct piece *piece = *link;
            if (piece->unit->round == p->sealed) {
                assert(piece->state == PIECE_DONE && piece->holders == NULL);
                *link = piece->in_bucket;
                p->piece_count--;
                free(piece);
            } else {
                link = &piece->in_bucket;
            }
        }
    }
    round_release_units(&p->rounds[p->sealed % ROUNDS_AHEAD]);
    p->sealed++;
    p->units = tile_plan_units(p->plan, p->sealed);
}

static void seal_complete_rounds(struct pieces *p)
{
    while (p->sealed < p->allowed && p->rounds[p->sealed % ROUNDS_AHEAD].units_done == p->units)
        seal_round(p);
}

void pieces_allow_rounds(struct pieces *p, unsigned rounds)
{
    assert(p->plan->made || rounds <= p->plan->pilot_rounds);
    if (rounds <= p->allowed)
        return;
    p->allowed = rounds;
    p->leaves_allowed = tile_plan_leaves(p->plan, rounds);
    p->units = tile_plan_units(p->plan, p->sealed); /* it may have been planned since */
    seal_complete_rounds(p);
}

void pieces_done(struct pieces *p, struct piece *piece, const uint8_t digest[CHECKSUM_SIZE])
{
    assert(piece->state != PIECE_DONE && piece->holders == NULL);
    if (piece->state == PIECE_WAITING)
        pieces_take(p, piece);
    piece->state = PIECE_DONE;
    memcpy(piece->digest, digest, CHECKSUM_SIZE);

    struct unit *unit = piece->unit;
    struct round *round = &p->rounds[unit->round % ROUNDS_AHEAD];
    uint64_t leaves = leaves_of(&piece->node);
    p->leaves_done += leaves;
    round->pieces_done++;
    unit->leaves_done += leaves;
    if (unit->leaves_done == unit->leaves) {
        round->units_done++;
        if (unit->cut)
            p->open_pairs--;
    }
    seal_complete_rounds(p);
}

bool pieces_is_sealed(const struct pieces *p, const struct node_id *node)
{
    if (node->replicate >= p->sequences || node->tile >= p->plan->tiles ||
        node->level > NODE_LEVEL_MAX)
        return false;
    unsigned own = tile_plan_pair_rounds(p->plan, node->tile, node->replicate, p->sealed);
    return own > 0 && node->index < round_end(own - 1) >> node->level;
}

unsigned pieces_allowed(const struct pieces *p)
{
    return p->allowed;
}

unsigned pieces_sealed(const struct pieces *p)
{
    return p->sealed;
}

uint64_t pieces_leaves(const struct pieces *p, unsigned rounds)
{
    return tile_plan_leaves(p->plan, rounds);
}

uint64_t pieces_leaves_unleased(const struct pieces *p)
{
    return p->leaves_allowed - p->leaves_handed;
}

uint64_t pieces_leaves_done(const struct pieces *p)
{
    return p->leaves_done;
}

uint64_t pieces_open_pairs(const struct pieces *p)
{
    return p->open_pairs;
}

uint64_t pieces_early(const struct pieces *p)
{
    uint64_t early = 0;
    for (unsigned r = p->sealed + 1; r < p->sealed + ROUNDS_AHEAD; r++)
        early += p->rounds[r % ROUNDS_AHEAD].pieces_done;
    return early;
}
