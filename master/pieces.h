/*
 * The work of a job as the scheduler sees it: the rounds that may be rendered, the round nodes of
 * every (tile, replicate) that they are made of (master/tile_plan.h), and the pieces those are cut
 * into. A piece is a node of the sum tree that is rendered as a whole; cutting it makes its two
 * children pieces and forgets the parent, whose sums are refused from then on. Who renders a piece
 * is the scheduler's business.
 *
 * Pieces are created lazily, round by round and pair by pair, as work is asked for; all pieces of a
 * round live until the round is sealed, because their digests tell a late duplicate from a worker
 * that computes other bits. Sealed means: every piece of this and of all earlier rounds is done.
 *
 * Pure: no clocks, no sockets. Used by the scheduler only, from the event loop.
 */
#ifndef MASTER_PIECES_H
#define MASTER_PIECES_H

#include "common/sumtree.h"
#include "proto/digest.h"

#define PIECE_FAIL_LIMIT 3  /* different workers that may fail at a piece before the job fails */
#define ROUNDS_AHEAD     16 /* rounds that may be open beyond the sealed ones */

struct holder;
struct tile_plan;
struct unit;

enum piece_state { PIECE_WAITING, PIECE_LEASED, PIECE_DONE };

struct piece {
    struct node_id node;
    enum piece_state state;
    bool leased_before;
    unsigned live_holders;  /* leases in force that hold it; more than one by speculation */
    struct holder *holders; /* all leases that hold it, expired ones included */
    uint64_t failed_on[PIECE_FAIL_LIMIT]; /* nonces of the different workers that failed at it */
    unsigned failed_workers, failures;
    uint8_t digest[CHECKSUM_SIZE]; /* of the accepted sums */

    struct unit *unit; /* the rest is pieces.c's own */
    struct piece *in_bucket;
    struct piece *waiting_prev, *waiting_next;
};

struct pieces;

/* `plan` says what a round of the job is made of and must outlive this; `early_max`: pieces of
 * unsealed later rounds that may be done before no new pair is opened. NULL when memory runs out.
 * pieces_free(NULL) does nothing. */
struct pieces *pieces_new(const struct tile_plan *plan, uint64_t early_max);
void pieces_free(struct pieces *pieces);

/* Rounds 0 .. rounds-1 may be rendered; never fewer than were allowed before, nor more than are
 * planned. */
void pieces_allow_rounds(struct pieces *pieces, unsigned rounds);

/*
 * The waiting pieces, oldest first, and then, where `pieces_open_next` finds one that may be
 * opened, the next round node of the next pair, which is then first in the list. NULL: no pair may
 * be opened now (`err` unset), or memory ran out (`err` set).
 */
struct piece *pieces_waiting(struct pieces *pieces);
struct piece *pieces_open_next(struct pieces *pieces, struct err *err);

/* Cut a waiting piece above level 0 in two; both children wait, the left one first. It must have no
 * holders. False when memory runs out; nothing has changed then. */
bool pieces_cut(struct pieces *pieces, struct piece *piece, struct err *err);

/* Waiting -> leased, and back again: first in line. */
void pieces_take(struct pieces *pieces, struct piece *piece);
void pieces_put_back(struct pieces *pieces, struct piece *piece);

/* Waiting or leased -> done. The piece stays until its round seals; then it is gone: ask
 * pieces_sealed for how many rounds are. */
void pieces_done(struct pieces *pieces, struct piece *piece, const uint8_t digest[CHECKSUM_SIZE]);

/* The piece that is this very node, or NULL. */
struct piece *pieces_find(const struct pieces *pieces, const struct node_id *node);
/* Does the node belong to a sealed round of this job? */
bool pieces_is_sealed(const struct pieces *pieces, const struct node_id *node);

unsigned pieces_allowed(const struct pieces *pieces);
unsigned pieces_sealed(const struct pieces *pieces);
uint64_t pieces_leaves(const struct pieces *pieces, unsigned rounds); /* of so many, all pairs */
uint64_t pieces_leaves_unleased(const struct pieces *pieces);         /* of the allowed rounds */
uint64_t pieces_leaves_done(const struct pieces *pieces);             /* of all rounds */
uint64_t pieces_open_pairs(const struct pieces *pieces); /* round nodes cut and not complete */
uint64_t pieces_early(const struct pieces *pieces); /* done, but not of the next round to seal */

#endif
