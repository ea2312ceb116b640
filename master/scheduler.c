#include "master/scheduler.h"

#include "master/tile_plan.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FIRST_LEASE_LEAVES_PER_CORE 4 /* before a speed is known */
#define GROWTH_PER_LEASE            4 /* times the largest lease finished, at most */

struct lease {
    uint64_t id;
    struct sched_worker *worker;
    bool live; /* false: expired, but results are still welcome */
    uint64_t issued_ms, leaves;
    struct holder *holders;
    struct lease *prev, *next; /* all leases, oldest first */
};

/* One lease's hold on one piece, linked from both. */
struct holder {
    struct lease *lease;
    struct piece *piece;
    struct holder *next_of_lease, *next_of_piece;
};

struct sched_worker {
    uint64_t nonce;
    void *owner;
    uint32_t cores;
    uint64_t node_credit, nodes_held;
    uint32_t leases_live;
    uint64_t samples;
    uint64_t progress_ms;   /* when it last made sample progress, or got work after idling */
    uint64_t lease_done_ms; /* when it last finished a lease */
    double busy_ms, busy_leaves;
    double leaves_per_second; /* 0: not known yet */
    uint64_t largest_done;    /* leaves of the largest lease it finished */
    struct sched_worker *next;
};

struct scheduler {
    struct scheduler_settings settings;
    struct tile_plan uniform; /* where the settings have no plan */
    struct pieces *pieces;
    struct sched_worker *workers;
    uint32_t worker_count;
    struct lease *first_lease, *last_lease;
    uint32_t leases_live;
    uint64_t next_lease_id;
    uint64_t tick_ms;
    struct node_id *order_nodes;
    struct revocation *revocations;
    size_t revocation_count, revocation_capacity;
    struct scheduler_counts counts;
    bool failed;
    struct err why;
};

struct scheduler_settings scheduler_defaults(void)
{
    return (struct scheduler_settings){
        .lease_target_ms = 1000,
        .leases_per_worker = 3,
        .lease_leaves_min = 1,
        .lease_leaves_max = UINT64_MAX,
        .lease_nodes_max = 1024,
        .stall_ms = 30000,
        .speculate_ms = 500,
        .early_max = 4096,
    };
}

struct scheduler *scheduler_new(const struct scheduler_settings *settings, uint64_t now_ms)
{
    struct scheduler *s = calloc(1, sizeof(*s));
    if (s == NULL)
        return NULL;
    s->settings = *settings;
    s->tick_ms = now_ms;
    s->next_lease_id = 1;
    s->order_nodes = calloc(settings->lease_nodes_max, sizeof(*s->order_nodes));
    if (s->order_nodes == NULL)
        goto fail_nodes;
    s->uniform = tile_plan_uniform(settings->tiles, settings->replicates);
    s->pieces = pieces_new(settings->plan != NULL ? settings->plan : &s->uniform,
                           settings->early_max);
    if (s->pieces == NULL)
        goto fail_pieces;
    return s;

fail_pieces:
    free(s->order_nodes);
fail_nodes:
    free(s);
    return NULL;
}

static void lease_free(struct scheduler *s, struct lease *lease)
{
    assert(lease->holders == NULL);
    if (lease->live) {
        lease->worker->leases_live--;
        s->leases_live--;
    }
    if (lease->prev != NULL)
        lease->prev->next = lease->next;
    else
        s->first_lease = lease->next;
    if (lease->next != NULL)
        lease->next->prev = lease->prev;
    else
        s->last_lease = lease->prev;
    free(lease);
}

void scheduler_free(struct scheduler *s)
{
    if (s == NULL)
        return;
    while (s->first_lease != NULL) {
        struct lease *lease = s->first_lease;
        while (lease->holders != NULL) {
            struct holder *holder = lease->holders;
            lease->holders = holder->next_of_lease;
            free(holder);
        }
        lease_free(s, lease);
    }
    while (s->workers != NULL) {
        struct sched_worker *worker = s->workers;
        s->workers = worker->next;
        free(worker);
    }
    pieces_free(s->pieces);
    free(s->revocations);
    free(s->order_nodes);
    free(s);
}

void scheduler_allow_rounds(struct scheduler *s, unsigned rounds)
{
    pieces_allow_rounds(s->pieces, rounds);
}

static void fail(struct scheduler *s, const struct err *why)
{
    if (!s->failed)
        s->why = *why;
    s->failed = true;
}

static void fail_memory(struct scheduler *s)
{
    struct err err;
    err_set(&err, ERR_MEMORY, "the master has no memory for its schedule");
    fail(s, &err);
}

/* ---- holders */

static bool hold(struct scheduler *s, struct lease *lease, struct piece *piece)
{
    struct holder *holder = malloc(sizeof(*holder));
    if (holder == NULL) {
        fail_memory(s);
        return false;
    }
    *holder = (struct holder){ lease, piece, lease->holders, piece->holders };
    lease->holders = holder;
    piece->holders = holder;
    if (piece->state == PIECE_WAITING)
        pieces_take(s->pieces, piece);
    piece->live_holders++;
    lease->leaves += (uint64_t)1 << piece->node.level;
    lease->worker->nodes_held++;
    return true;
}

static void revoke(struct scheduler *s, const struct lease *lease, const struct piece *piece)
{
    if (s->revocation_count == s->revocation_capacity) {
        size_t capacity = s->revocation_capacity == 0 ? 64 : 2 * s->revocation_capacity;
        struct revocation *more = realloc(s->revocations, capacity * sizeof(*more));
        if (more == NULL)
            return; /* the worker renders a node for nothing: harmless */
        s->revocations = more;
        s->revocation_capacity = capacity;
    }
    s->revocations[s->revocation_count++] = (struct revocation){ lease->worker->owner, lease->id,
                                                                 piece->node };
}

/*
 * A lease whose last piece is finished tells how fast its worker is. Leaves and busy time are added
 * up, and halved from time to time, so that the many small leases at the end of a round, which are
 * mostly latency, weigh no more than the time they took.
 */
static void measure(const struct scheduler *s, struct lease *lease, uint64_t now_ms)
{
    struct sched_worker *worker = lease->worker;
    uint64_t since = lease->issued_ms > worker->lease_done_ms ? lease->issued_ms
                                                              : worker->lease_done_ms;
    worker->busy_ms += now_ms > since ? (double)(now_ms - since) : 0;
    worker->busy_leaves += (double)lease->leaves;
    if (worker->busy_ms > 0)
        worker->leaves_per_second = 1000 * worker->busy_leaves / worker->busy_ms;
    if (worker->busy_ms > 4.0 * s->settings.lease_target_ms) {
        worker->busy_ms /= 2;
        worker->busy_leaves /= 2;
    }
    worker->lease_done_ms = now_ms;
    if (lease->leaves > worker->largest_done)
        worker->largest_done = lease->leaves;
}

/* Take a holder off its lease; an emptied lease is gone afterwards. */
static void leave_lease(struct scheduler *s, struct holder *holder)
{
    struct lease *lease = holder->lease;
    struct holder **link = &lease->holders;
    while (*link != holder)
        link = &(*link)->next_of_lease;
    *link = holder->next_of_lease;
    lease->worker->nodes_held--;
    if (lease->live)
        holder->piece->live_holders--;
    if (lease->holders == NULL)
        lease_free(s, lease);
}

/*
 * Nobody needs to render this piece any more. Every lease on it but that of `finisher` is asked to
 * stop; the finisher's own lease, when this was its last piece, measures its speed.
 */
static void drop_all_holders(struct scheduler *s, struct piece *piece,
                             const struct sched_worker *finisher, uint64_t now_ms)
{
    while (piece->holders != NULL) {
        struct holder *holder = piece->holders;
        struct lease *lease = holder->lease;
        piece->holders = holder->next_of_piece;
        if (lease->worker != finisher)
            revoke(s, lease, piece);
        else if (lease->live && lease->holders == holder && holder->next_of_lease == NULL)
            measure(s, lease, now_ms);
        leave_lease(s, holder);
        free(holder);
    }
}

static void drop_holder_of_piece(struct piece *piece, struct holder *holder)
{
    struct holder **link = &piece->holders;
    while (*link != holder)
        link = &(*link)->next_of_piece;
    *link = holder->next_of_piece;
}

/* ---- failures */

static bool has_failed(const struct piece *piece, uint64_t nonce)
{
    for (unsigned i = 0; i < piece->failed_workers; i++) {
        if (piece->failed_on[i] == nonce)
            return true;
    }
    return false;
}

static bool all_have_failed(const struct scheduler *s, const struct piece *piece)
{
    for (const struct sched_worker *w = s->workers; w != NULL; w = w->next) {
        if (!has_failed(piece, w->nonce))
            return false;
    }
    return true;
}

static void count_failure(struct scheduler *s, struct piece *piece,
                          const struct sched_worker *worker, const struct err *why)
{
    s->counts.failures++;
    piece->failures++;
    if (!has_failed(piece, worker->nonce))
        piece->failed_on[piece->failed_workers++] = worker->nonce;
    if (piece->failed_workers == PIECE_FAIL_LIMIT ||
        (piece->failures >= PIECE_FAIL_LIMIT && all_have_failed(s, piece))) {
        struct err err = *why;
        err_wrap(&err, "%u different workers failed at tile %u, replicate %u, level %u, index %llu",
                 piece->failed_workers, piece->node.tile, piece->node.replicate, piece->node.level,
                 (unsigned long long)piece->node.index);
        fail(s, &err);
    }
}

/* ---- workers */

struct sched_worker *scheduler_worker_joined(struct scheduler *s, uint64_t nonce, uint32_t cores,
                                             uint64_t node_credit, void *owner, uint64_t now_ms)
{
    struct sched_worker *worker = calloc(1, sizeof(*worker));
    if (worker == NULL)
        return NULL;
    worker->nonce = nonce;
    worker->owner = owner;
    worker->cores = cores == 0 ? 1 : cores;
    worker->node_credit = node_credit == 0 ? 1 : node_credit;
    worker->progress_ms = now_ms;
    worker->next = s->workers;
    s->workers = worker;
    s->worker_count++;
    return worker;
}

void scheduler_worker_left(struct scheduler *s, struct sched_worker *worker, bool crashed)
{
    struct err why;
    err_set(&why, ERR_RENDER, "the worker crashed while it held the node");
    struct lease *next;
    for (struct lease *lease = s->first_lease; lease != NULL; lease = next) {
        next = lease->next;
        if (lease->worker != worker)
            continue;
        bool last;
        do {
            struct holder *holder = lease->holders;
            struct piece *piece = holder->piece;
            last = holder->next_of_lease == NULL;
            drop_holder_of_piece(piece, holder);
            leave_lease(s, holder); /* frees the lease with its last holder */
            free(holder);
            if (piece->live_holders == 0 && piece->state == PIECE_LEASED)
                pieces_put_back(s->pieces, piece);
            if (crashed)
                count_failure(s, piece, worker, &why);
        } while (!last);
    }

    size_t kept = 0;
    for (size_t i = 0; i < s->revocation_count; i++) {
        if (s->revocations[i].owner != worker->owner)
            s->revocations[kept++] = s->revocations[i];
    }
    s->revocation_count = kept;

    struct sched_worker **link = &s->workers;
    while (*link != worker)
        link = &(*link)->next;
    *link = worker->next;
    s->worker_count--;
    free(worker);
}

/* Expired leases of a worker that moves again are in force again, where nobody else took over. */
static void revive_leases(struct scheduler *s, struct sched_worker *worker)
{
    for (struct lease *lease = s->first_lease; lease != NULL; lease = lease->next) {
        if (lease->worker != worker || lease->live)
            continue;
        lease->live = true;
        worker->leases_live++;
        s->leases_live++;
        for (struct holder *h = lease->holders; h != NULL; h = h->next_of_lease) {
            if (h->piece->state == PIECE_WAITING)
                pieces_take(s->pieces, h->piece);
            h->piece->live_holders++;
        }
    }
}

static void moved(struct scheduler *s, struct sched_worker *worker, uint64_t now_ms)
{
    worker->progress_ms = now_ms;
    revive_leases(s, worker);
}

void scheduler_worker_progress(struct scheduler *s, struct sched_worker *worker, uint64_t samples,
                               uint64_t now_ms)
{
    if (samples <= worker->samples)
        return;
    worker->samples = samples;
    moved(s, worker, now_ms);
}

static void expire_lease(struct scheduler *s, struct lease *lease)
{
    lease->live = false;
    lease->worker->leases_live--;
    s->leases_live--;
    s->counts.expired_leases++;
    for (struct holder *h = lease->holders; h != NULL; h = h->next_of_lease) {
        if (--h->piece->live_holders == 0)
            pieces_put_back(s->pieces, h->piece);
    }
}

void scheduler_tick(struct scheduler *s, uint64_t now_ms)
{
    uint64_t gap = now_ms - s->tick_ms;
    s->tick_ms = now_ms;
    if (gap > s->settings.stall_ms / 2) {
        for (struct sched_worker *w = s->workers; w != NULL; w = w->next)
            w->progress_ms += gap;
    }
    for (struct lease *lease = s->first_lease; lease != NULL; lease = lease->next) {
        if (lease->live && now_ms > lease->worker->progress_ms &&
            now_ms - lease->worker->progress_ms > s->settings.stall_ms)
            expire_lease(s, lease);
    }
}

/* ---- leases */

static uint64_t clamp(uint64_t value, uint64_t low, uint64_t high)
{
    return value < low ? low : value > high ? high : value;
}

static uint64_t lease_budget(const struct scheduler *s, const struct sched_worker *worker)
{
    uint64_t budget = (uint64_t)FIRST_LEASE_LEAVES_PER_CORE * worker->cores;
    if (worker->leaves_per_second > 0) {
        double wanted = worker->leaves_per_second * s->settings.lease_target_ms / 1000;
        budget = wanted < 1e15 ? (uint64_t)wanted : (uint64_t)1e15;
        uint64_t grown = GROWTH_PER_LEASE * worker->largest_done;
        budget = budget > grown ? grown : budget;
    }
    /* Towards the end leases shrink, so that all workers finish together */
    uint64_t share = pieces_leaves_unleased(s->pieces) /
                     (2 * (uint64_t)s->worker_count * s->settings.leases_per_worker);
    budget = clamp(budget, 1, share > worker->cores ? share : worker->cores);
    return clamp(budget, s->settings.lease_leaves_min, s->settings.lease_leaves_max);
}

/* May this worker have the piece? One that failed at it only when all others have, too. */
static bool may_have(const struct scheduler *s, const struct sched_worker *worker,
                     const struct piece *piece)
{
    return !has_failed(piece, worker->nonce) || all_have_failed(s, piece);
}

static struct piece *next_piece(struct scheduler *s, const struct sched_worker *worker)
{
    for (struct piece *p = pieces_waiting(s->pieces); p != NULL; p = p->waiting_next) {
        if (may_have(s, worker, p))
            return p;
    }
    struct err err = { 0 };
    struct piece *opened = pieces_open_next(s->pieces, &err);
    if (opened == NULL && err.code != ERR_OK)
        fail(s, &err);
    return opened;
}

/* Waiting pieces until the budget is met; one that is too large for it is cut, unless the lease is
 * half full already. */
static uint32_t fill_with_waiting(struct scheduler *s, struct lease *lease, uint64_t budget,
                                  uint64_t nodes_max)
{
    uint32_t count = 0;
    while (count < nodes_max && lease->leaves < budget) {
        struct piece *piece = next_piece(s, lease->worker);
        if (piece == NULL)
            break;
        uint64_t room = budget - lease->leaves;
        if (((uint64_t)1 << piece->node.level) > room) {
            if (lease->leaves >= budget - budget / 2)
                break;
            if (pieces_open_pairs(s->pieces) > 2 * (uint64_t)(s->leases_live + 1) &&
                !piece->leased_before && lease->leaves > 0)
                break;
            struct err err;
            drop_all_holders(s, piece, NULL, 0); /* of expired leases */
            if (!pieces_cut(s->pieces, piece, &err)) {
                fail(s, &err);
                break;
            }
            continue;
        }
        s->counts.nodes_reissued += piece->leased_before;
        if (!hold(s, lease, piece))
            break;
        s->order_nodes[count++] = piece->node;
    }
    return count;
}

/* Nodes that only one other worker has had for a while, oldest lease first. */
static uint32_t fill_with_speculation(struct scheduler *s, struct lease *lease, uint64_t budget,
                                      uint64_t nodes_max, uint64_t now_ms)
{
    uint32_t count = 0;
    for (struct lease *other = s->first_lease; other != NULL; other = other->next) {
        if (!other->live || other->worker == lease->worker || other == lease ||
            now_ms - other->issued_ms < s->settings.speculate_ms)
            continue;
        for (struct holder *h = other->holders; h != NULL; h = h->next_of_lease) {
            if (count == nodes_max || lease->leaves >= budget)
                return count;
            if (h->piece->live_holders > 1 || has_failed(h->piece, lease->worker->nonce))
                continue;
            s->order_nodes[count] = h->piece->node;
            if (!hold(s, lease, h->piece))
                return count;
            count++;
        }
    }
    s->counts.nodes_speculated += count;
    return count;
}

bool scheduler_lease(struct scheduler *s, struct sched_worker *worker, uint64_t now_ms,
                     struct lease_order *order)
{
    if (s->failed || worker->leases_live >= s->settings.leases_per_worker ||
        worker->nodes_held >= worker->node_credit)
        return false;
    uint64_t nodes_max = clamp(worker->node_credit - worker->nodes_held, 1,
                               s->settings.lease_nodes_max);
    uint64_t budget = lease_budget(s, worker);

    struct lease *lease = calloc(1, sizeof(*lease));
    if (lease == NULL) {
        fail_memory(s);
        return false;
    }
    lease->id = s->next_lease_id;
    lease->worker = worker;
    lease->live = true;
    lease->issued_ms = now_ms;

    uint32_t count = fill_with_waiting(s, lease, budget, nodes_max);
    bool speculative = count == 0 && !s->failed;
    if (speculative)
        count = fill_with_speculation(s, lease, budget, nodes_max, now_ms);
    if (count == 0) {
        free(lease);
        return false;
    }

    s->next_lease_id++;
    lease->prev = s->last_lease;
    if (s->last_lease != NULL)
        s->last_lease->next = lease;
    else
        s->first_lease = lease;
    s->last_lease = lease;
    s->leases_live++;
    if (worker->leases_live++ == 0)
        worker->progress_ms = now_ms; /* it could make no progress while it had nothing to do */
    s->counts.leases++;
    s->counts.nodes_leased += count;
    *order = (struct lease_order){ lease->id, speculative, count, s->order_nodes };
    return true;
}

/* ---- results */

enum result_verdict scheduler_result(struct scheduler *s, struct sched_worker *worker,
                                     const struct node_id *node,
                                     const uint8_t digest[CHECKSUM_SIZE], uint64_t now_ms)
{
    if (worker != NULL)
        moved(s, worker, now_ms);
    struct piece *piece = pieces_find(s->pieces, node);
    if (piece == NULL) {
        bool sealed = pieces_is_sealed(s->pieces, node);
        s->counts.late += sealed;
        s->counts.refused += !sealed;
        return sealed ? RESULT_LATE : RESULT_REFUSED;
    }
    if (piece->state == PIECE_DONE) {
        bool equal = memcmp(piece->digest, digest, CHECKSUM_SIZE) == 0;
        s->counts.duplicates++;
        s->counts.mismatches += !equal;
        return equal ? RESULT_DUPLICATE : RESULT_MISMATCH;
    }
    drop_all_holders(s, piece, worker, now_ms);
    pieces_done(s->pieces, piece, digest);
    return RESULT_ACCEPTED;
}

void scheduler_node_failed(struct scheduler *s, struct sched_worker *worker,
                           const struct node_id *node, const struct err *why)
{
    struct piece *piece = pieces_find(s->pieces, node);
    if (piece == NULL || piece->state == PIECE_DONE)
        return;
    struct holder *next;
    for (struct holder *h = piece->holders; h != NULL; h = next) {
        next = h->next_of_piece;
        if (h->lease->worker != worker)
            continue;
        drop_holder_of_piece(piece, h);
        leave_lease(s, h);
        free(h);
    }
    if (piece->state == PIECE_LEASED && piece->live_holders == 0)
        pieces_put_back(s->pieces, piece);
    if (err_reaction(why->code) == COUNT)
        count_failure(s, piece, worker, why);
}

bool scheduler_next_revocation(struct scheduler *s, struct revocation *revocation)
{
    if (s->revocation_count == 0)
        return false;
    *revocation = s->revocations[--s->revocation_count];
    return true;
}

/* ---- what others ask */

bool scheduler_failed(const struct scheduler *s, struct err *why)
{
    if (s->failed && why != NULL)
        *why = s->why;
    return s->failed;
}

bool scheduler_done(const struct scheduler *s)
{
    return pieces_sealed(s->pieces) == pieces_allowed(s->pieces);
}

unsigned scheduler_sealed(const struct scheduler *s)
{
    return pieces_sealed(s->pieces);
}

const struct pieces *scheduler_pieces(const struct scheduler *s)
{
    return s->pieces;
}

uint32_t scheduler_leases_in_flight(const struct scheduler *s)
{
    return s->leases_live;
}

static double seconds_for(const struct scheduler *s, double leaves)
{
    double speed = 0;
    for (const struct sched_worker *w = s->workers; w != NULL; w = w->next)
        speed += w->leaves_per_second;
    return leaves <= 0 ? 0 : speed > 0 ? leaves / speed : INFINITY;
}

double scheduler_seconds_left(const struct scheduler *s, unsigned rounds)
{
    double leaves = (double)pieces_leaves(s->pieces, rounds);
    return seconds_for(s, leaves - (double)pieces_leaves_done(s->pieces));
}

double scheduler_seconds_unleased(const struct scheduler *s)
{
    return seconds_for(s, (double)pieces_leaves_unleased(s->pieces));
}

struct scheduler_counts scheduler_counts(const struct scheduler *s)
{
    return s->counts;
}
