/*
 * Who renders what: leases of sum-tree nodes to workers, their expiry and speculation, and the
 * verdict on every result that comes back. Whatever workers do, every node of the allowed rounds
 * is accepted exactly once.
 *
 * A lease is a list of nodes sized to about `lease_target_ms` of the worker's measured speed. It
 * expires when its worker makes no sample progress for `stall_ms`: its nodes go back in line, and
 * results that come after all are still welcome. Once everything is leased, an idle worker gets a
 * second lease on nodes of others (speculation); the first valid result wins, and the scheduler
 * asks for what nobody needs any more to be revoked.
 *
 * Only failures that are reported, and crashes, count against a node: three different workers (or
 * all there are, three times in all) make the scheduler fail with the reason. Disconnects and
 * expiry never count.
 *
 * Pure: time is passed in, there are no sockets. Time decides lease sizes, expiry and speculation,
 * never what the image is made of. Used from the event loop only.
 */
#ifndef MASTER_SCHEDULER_H
#define MASTER_SCHEDULER_H

#include "common/err.h"
#include "master/pieces.h"

struct scheduler_settings {
    uint32_t tiles, replicates;
    const struct tile_plan *plan; /* of those; must outlive the scheduler. NULL: no pilot */
    uint32_t lease_target_ms;
    uint32_t leases_per_worker;                  /* in flight at once */
    uint64_t lease_leaves_min, lease_leaves_max; /* whatever the speed; for tests: 1,1 is tiny */
    uint32_t lease_nodes_max;                    /* what one LEASE message may carry */
    uint32_t stall_ms;     /* without sample progress a worker's leases expire */
    uint32_t speculate_ms; /* age of a lease before another worker may get its nodes too */
    uint64_t early_max;    /* finished nodes of later rounds, see pieces.h */
};

/* All the usual values; tiles and replicates are zero, and there is no pilot. */
struct scheduler_settings scheduler_defaults(void);

struct scheduler;
struct sched_worker;

/* NULL when memory runs out. scheduler_free(NULL) does nothing. */
struct scheduler *scheduler_new(const struct scheduler_settings *settings, uint64_t now_ms);
void scheduler_free(struct scheduler *s);

/* Rounds 0 .. rounds-1 are to be rendered; never fewer than before, nor more than are planned. */
void scheduler_allow_rounds(struct scheduler *s, unsigned rounds);

/*
 * A worker that is ready to render. `nonce` names its process across reconnects; `node_credit` is
 * how many nodes it may hold at once (its memory and outbox); `owner` comes back with revocations.
 * NULL when memory runs out. It is the scheduler's, and gone after scheduler_worker_left.
 */
struct sched_worker *scheduler_worker_joined(struct scheduler *s, uint64_t nonce, uint32_t cores,
                                             uint64_t node_credit, void *owner, uint64_t now_ms);

/* `crashed` counts against the nodes it held; a mere disconnect does not. */
void scheduler_worker_left(struct scheduler *s, struct sched_worker *worker, bool crashed);

/* It reported `samples` camera paths since its process began. */
void scheduler_worker_progress(struct scheduler *s, struct sched_worker *worker, uint64_t samples,
                               uint64_t now_ms);

struct lease_order {
    uint64_t lease_id;
    bool speculative;
    uint32_t node_count;
    struct node_id *nodes; /* the scheduler's, until the next call */
};

/* The next lease for a worker; false when it has enough in flight or nothing can be had now. */
bool scheduler_lease(struct scheduler *s, struct sched_worker *worker, uint64_t now_ms,
                     struct lease_order *order);

enum result_verdict {
    RESULT_ACCEPTED,  /* the first: give it to the film */
    RESULT_DUPLICATE, /* had already, the same bits */
    RESULT_MISMATCH,  /* had already, OTHER bits: something is badly wrong with one of the two */
    RESULT_LATE,      /* had already, its round is sealed, the bits are not compared */
    RESULT_REFUSED,   /* not a node that is asked for (any more) */
};

/* A result whose payload was found valid. Leases are not looked at: `worker` may be any, or NULL
 * for one that is not ready (any more) but holds results from before. */
enum result_verdict scheduler_result(struct scheduler *s, struct sched_worker *worker,
                                     const struct node_id *node,
                                     const uint8_t digest[CHECKSUM_SIZE], uint64_t now_ms);

/* A worker could not render a node; `why` decides whether that counts (err_reaction COUNT). */
void scheduler_node_failed(struct scheduler *s, struct sched_worker *worker,
                           const struct node_id *node, const struct err *why);

/* Call at least every stall_ms / 4. Expires leases; when the calls themselves came late, the
 * master stalled, and all deadlines move by as much. */
void scheduler_tick(struct scheduler *s, uint64_t now_ms);

/* Nodes no longer wanted from a worker, to be sent as REVOKE; false when there are none (left). */
struct revocation {
    void *owner; /* of the worker */
    uint64_t lease_id;
    struct node_id node;
};
bool scheduler_next_revocation(struct scheduler *s, struct revocation *revocation);

/* Set once the job cannot be finished: a node that three workers failed at, or out of memory. */
bool scheduler_failed(const struct scheduler *s, struct err *why);

bool scheduler_done(const struct scheduler *s); /* every allowed round is sealed */
unsigned scheduler_sealed(const struct scheduler *s);
const struct pieces *scheduler_pieces(const struct scheduler *s);
uint32_t scheduler_leases_in_flight(const struct scheduler *s);

/* Seconds until every leaf of `rounds` rounds is done, at the speed of the workers now here;
 * infinity while no speed is known. For --time and the progress line. */
double scheduler_seconds_left(const struct scheduler *s, unsigned rounds);
/* The same for what nobody holds a lease on, of the allowed rounds. */
double scheduler_seconds_unleased(const struct scheduler *s);

struct scheduler_counts {
    uint64_t leases, nodes_leased;
    uint64_t expired_leases;
    uint64_t nodes_reissued; /* leased again after expiry, failure or a lost worker */
    uint64_t nodes_speculated;
    uint64_t duplicates, mismatches, late, refused, failures;
};
struct scheduler_counts scheduler_counts(const struct scheduler *s);

#endif
