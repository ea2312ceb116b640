/*
 * The scheduler: single sentences first, then a discrete simulation of farms whose workers join,
 * die, stall, repeat themselves and answer late, with fixed seeds.
 */
#include "common/hash.h"
#include "master/scheduler.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct scheduler_settings settings_for(uint32_t tiles, uint32_t replicates)
{
    struct scheduler_settings settings = scheduler_defaults();
    settings.tiles = tiles;
    settings.replicates = replicates;
    return settings;
}

static void digest_node(const struct node_id *node, uint8_t digest[CHECKSUM_SIZE])
{
    uint64_t words[2] = { hash64_4(node->tile, node->replicate, node->level, node->index), 7 };
    memcpy(digest, words, CHECKSUM_SIZE);
}

static enum result_verdict deliver(struct scheduler *s, struct sched_worker *worker,
                                   const struct node_id *node, uint64_t now_ms)
{
    uint8_t digest[CHECKSUM_SIZE];
    digest_node(node, digest);
    return scheduler_result(s, worker, node, digest, now_ms);
}

/* One worker's lease, copied: the scheduler's own list lives until its next call. */
struct copied_lease {
    uint64_t id;
    bool speculative;
    uint32_t count;
    struct node_id nodes[1024];
};

static bool take_lease(struct scheduler *s, struct sched_worker *worker, uint64_t now_ms,
                       struct copied_lease *copy)
{
    struct lease_order order;
    if (!scheduler_lease(s, worker, now_ms, &order))
        return false;
    copy->id = order.lease_id;
    copy->speculative = order.speculative;
    copy->count = order.node_count;
    memcpy(copy->nodes, order.nodes, order.node_count * sizeof(*order.nodes));
    return true;
}

static void deliver_all(struct scheduler *s, struct sched_worker *worker,
                        const struct copied_lease *lease, uint64_t now_ms)
{
    for (uint32_t i = 0; i < lease->count; i++)
        assert_int_equal(deliver(s, worker, &lease->nodes[i], now_ms), RESULT_ACCEPTED);
}

static uint64_t leaves_in(const struct copied_lease *lease)
{
    uint64_t leaves = 0;
    for (uint32_t i = 0; i < lease->count; i++)
        leaves += (uint64_t)1 << lease->nodes[i].level;
    return leaves;
}

/* Render rounds 0 .. rounds-1 with one tireless worker at `ms` per leaf. */
static uint64_t finish_rounds(struct scheduler *s, struct sched_worker *worker, uint64_t now_ms,
                              uint64_t ms)
{
    struct copied_lease lease = { 0 };
    while (take_lease(s, worker, now_ms, &lease)) {
        now_ms += leaves_in(&lease) * ms;
        deliver_all(s, worker, &lease, now_ms);
    }
    return now_ms;
}

/* ---- sentences */

static void one_worker_renders_every_round(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(3, 2);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 20);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 4, 100, NULL, 0);
    finish_rounds(s, worker, 0, 1);
    assert_true(scheduler_done(s));
    assert_int_equal(scheduler_sealed(s), 20);
    assert_int_equal(pieces_leaves_done(scheduler_pieces(s)), 3 * 2 * round_end(19));
    assert_int_equal(scheduler_counts(s).nodes_reissued, 0);
    scheduler_free(s);
}

static void a_worker_has_no_more_leases_and_nodes_than_it_may(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(100, 4);
    settings.leases_per_worker = 2;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 1, 5, NULL, 0);
    struct copied_lease a = { 0 }, b = { 0 }, c = { 0 };
    assert_true(take_lease(s, worker, 0, &a));
    assert_true(take_lease(s, worker, 0, &b));
    assert_false(take_lease(s, worker, 0, &c));
    assert_int_equal(a.count + b.count, 5);
    assert_int_equal(scheduler_leases_in_flight(s), 2);
    scheduler_free(s);
}

static void lease_sizes_follow_measured_speed(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(10000, 1);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 4);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 4, 100000, NULL, 0);
    struct copied_lease lease = { 0 };
    uint64_t now_ms = 0;
    for (int i = 0; i < 12; i++) {
        assert_true(take_lease(s, worker, now_ms, &lease));
        now_ms += 5 * leaves_in(&lease); /* 200 leaves a second */
        deliver_all(s, worker, &lease, now_ms);
    }
    assert_in_range(leaves_in(&lease), 190, 210);
    scheduler_free(s);
}

static void forced_lease_sizes_hold_whatever_the_speed(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 2);
    settings.lease_leaves_min = settings.lease_leaves_max = 1;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 30);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 4, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    uint64_t leases = 0;
    for (; take_lease(s, worker, leases, &lease); leases++) {
        assert_int_equal(leaves_in(&lease), 1);
        deliver_all(s, worker, &lease, leases);
    }
    assert_int_equal(leases, 4 * round_end(29));
    scheduler_free(s);

    settings.lease_leaves_min = settings.lease_leaves_max = 1000000;
    s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 30);
    worker = scheduler_worker_joined(s, 1, 4, 10000, NULL, 0);
    finish_rounds(s, worker, 0, 1);
    assert_true(scheduler_done(s));
    assert_true(scheduler_counts(s).leases <= 8);
    scheduler_free(s);
}

static void a_large_node_is_cut_and_refused_from_then_on(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(1, 1);
    settings.lease_leaves_min = settings.lease_leaves_max = 2;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, round_reaching(40) + 1);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 1, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    unsigned first_of_four = round_reaching(32) + 1; /* rounds of 4 leaves */
    while (scheduler_sealed(s) < first_of_four) {
        assert_true(take_lease(s, worker, 0, &lease));
        deliver_all(s, worker, &lease, 0);
    }
    assert_true(take_lease(s, worker, 0, &lease));
    assert_int_equal(lease.nodes[0].level, 1);
    struct node_id parent = lease.nodes[0];
    parent.level++;
    parent.index /= 2;
    assert_int_equal(deliver(s, worker, &parent, 0), RESULT_REFUSED);
    deliver_all(s, worker, &lease, 0);
    scheduler_free(s);
}

static void an_expired_lease_goes_to_another_and_late_results_are_welcome(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 1);
    settings.stall_ms = 1000;
    settings.leases_per_worker = 1;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct sched_worker *slow = scheduler_worker_joined(s, 1, 1, 100, NULL, 0);
    struct sched_worker *fast = scheduler_worker_joined(s, 2, 1, 100, NULL, 0);
    struct copied_lease first = { 0 }, second = { 0 };
    assert_true(take_lease(s, slow, 0, &first));
    uint64_t now_ms = 0;
    for (; now_ms <= 1250; now_ms += 250) /* heartbeats alone do not help */ {
        scheduler_worker_progress(s, slow, 0, now_ms);
        scheduler_tick(s, now_ms);
    }
    assert_int_equal(scheduler_counts(s).expired_leases, 1);
    assert_true(take_lease(s, fast, now_ms, &second));
    assert_int_equal(deliver(s, slow, &first.nodes[0], now_ms), RESULT_ACCEPTED);
    struct revocation revocation;
    assert_true(scheduler_next_revocation(s, &revocation));
    assert_int_equal(revocation.lease_id, second.id);
    assert_int_equal(deliver(s, fast, &first.nodes[0], now_ms), RESULT_DUPLICATE);
    scheduler_free(s);
}

static void a_revoked_node_may_be_cut_and_is_refused_then(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(1, 1);
    settings.stall_ms = 1000;
    struct scheduler *s = scheduler_new(&settings, 0);
    unsigned first_of_eight = round_reaching(64) + 1; /* rounds of 8 leaves */
    scheduler_allow_rounds(s, first_of_eight);
    struct sched_worker *fast = scheduler_worker_joined(s, 1, 64, 100, NULL, 0);
    uint64_t now_ms = finish_rounds(s, fast, 0, 1);
    scheduler_allow_rounds(s, first_of_eight + 4);
    struct copied_lease whole = { 0 }, part = { 0 };
    assert_true(take_lease(s, fast, now_ms, &whole));
    assert_int_equal(whole.nodes[0].level, 3);
    for (int i = 0; i < 6; i++)
        scheduler_tick(s, now_ms += 250);

    struct sched_worker *small = scheduler_worker_joined(s, 2, 1, 100, NULL, now_ms);
    assert_true(take_lease(s, small, now_ms, &part));
    struct node_id parent = part.nodes[0];
    assert_true(parent.level < 3);
    while (parent.level < 3) {
        parent.level++;
        parent.index /= 2;
    }
    struct revocation revocation;
    assert_true(scheduler_next_revocation(s, &revocation));
    assert_int_equal(revocation.lease_id, whole.id);
    assert_int_equal(revocation.node.level, 3);
    assert_int_equal(revocation.node.index, parent.index);
    assert_int_equal(deliver(s, fast, &parent, now_ms), RESULT_REFUSED);
    deliver_all(s, small, &part, now_ms);
    scheduler_free(s);
}

static void a_worker_that_moves_again_keeps_its_lease(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(4, 1);
    settings.stall_ms = 1000;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 4, 100, NULL, 0);
    struct sched_worker *other = scheduler_worker_joined(s, 2, 4, 100, NULL, 0);
    struct copied_lease lease, none;
    while (take_lease(s, worker, 0, &lease))
        ;
    for (uint64_t now_ms = 0; now_ms <= 1500; now_ms += 250)
        scheduler_tick(s, now_ms);
    assert_int_equal(scheduler_leases_in_flight(s), 0);
    scheduler_worker_progress(s, worker, 10, 1600);
    assert_true(scheduler_leases_in_flight(s) > 0);
    settings.speculate_ms = 0;
    while (take_lease(s, other, 1600, &none))
        assert_true(none.speculative);
    scheduler_free(s);
}

static void a_stall_of_the_master_extends_all_deadlines(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 1);
    settings.stall_ms = 1000;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 1, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    assert_true(take_lease(s, worker, 0, &lease));
    scheduler_tick(s, 100);
    scheduler_tick(s, 60100);
    scheduler_tick(s, 60200);
    assert_int_equal(scheduler_counts(s).expired_leases, 0);
    for (uint64_t now_ms = 60200; now_ms < 62000; now_ms += 100)
        scheduler_tick(s, now_ms);
    assert_int_equal(scheduler_counts(s).expired_leases, 1);
    scheduler_free(s);
}

static void an_idle_worker_speculates_and_the_loser_is_told(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 1);
    settings.leases_per_worker = 1;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    int slow_owner, fast_owner;
    struct sched_worker *slow = scheduler_worker_joined(s, 1, 2, 100, &slow_owner, 0);
    struct sched_worker *fast = scheduler_worker_joined(s, 2, 2, 100, &fast_owner, 0);
    struct copied_lease first = { 0 }, second = { 0 };
    assert_true(take_lease(s, slow, 0, &first));
    assert_int_equal(first.count, 2);
    assert_false(take_lease(s, fast, 10, &second)); /* too early to doubt the first */
    assert_true(take_lease(s, fast, 1000, &second));
    assert_true(second.speculative);
    assert_int_equal(deliver(s, fast, &second.nodes[0], 1100), RESULT_ACCEPTED);
    struct revocation revocation;
    assert_true(scheduler_next_revocation(s, &revocation));
    assert_ptr_equal(revocation.owner, &slow_owner);
    assert_int_equal(revocation.lease_id, first.id);
    assert_false(scheduler_next_revocation(s, &revocation));
    scheduler_free(s);
}

static void a_late_duplicate_is_compared_until_its_round_seals(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 1);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 2, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    assert_true(take_lease(s, worker, 0, &lease));
    uint8_t other[CHECKSUM_SIZE] = { 1 };
    assert_int_equal(deliver(s, worker, &lease.nodes[0], 1), RESULT_ACCEPTED);
    assert_int_equal(deliver(s, NULL, &lease.nodes[0], 1), RESULT_DUPLICATE);
    assert_int_equal(scheduler_result(s, worker, &lease.nodes[0], other, 1), RESULT_MISMATCH);
    assert_int_equal(deliver(s, worker, &lease.nodes[1], 1), RESULT_ACCEPTED);
    assert_int_equal(scheduler_result(s, worker, &lease.nodes[0], other, 1), RESULT_LATE);
    assert_int_equal(scheduler_counts(s).mismatches, 1);
    assert_true(scheduler_done(s));
    scheduler_free(s);
}

static void three_different_workers_that_fail_at_a_node_fail_the_job(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(1, 1);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct err why = { .code = ERR_RENDER, .text = "it hurts" };
    struct copied_lease lease = { 0 };
    for (uint64_t nonce = 1; nonce <= 3; nonce++) {
        struct sched_worker *worker = scheduler_worker_joined(s, nonce, 1, 100, NULL, 0);
        assert_true(take_lease(s, worker, 0, &lease));
        assert_false(scheduler_failed(s, NULL));
        scheduler_node_failed(s, worker, &lease.nodes[0], &why);
        if (nonce < 3) {
            struct sched_worker *patient = scheduler_worker_joined(s, 99, 1, 100, NULL, 0);
            scheduler_worker_left(s, worker, false);
            scheduler_worker_left(s, patient, false);
        }
    }
    struct err told;
    assert_true(scheduler_failed(s, &told));
    assert_non_null(strstr(told.text, "it hurts"));
    assert_non_null(strstr(told.text, "3 different workers"));
    scheduler_free(s);
}

static void crashes_count_but_disconnects_and_expiry_never_do(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(1, 1);
    settings.stall_ms = 1000;
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct copied_lease lease = { 0 };
    uint64_t now_ms = 0;
    for (uint64_t nonce = 1; nonce <= 10; nonce++) {
        struct sched_worker *worker = scheduler_worker_joined(s, nonce, 1, 100, NULL, now_ms);
        assert_true(take_lease(s, worker, now_ms, &lease));
        for (int i = 0; i < 10; i++)
            scheduler_tick(s, now_ms += 250);
        scheduler_worker_left(s, worker, false);
    }
    assert_false(scheduler_failed(s, NULL));
    for (uint64_t nonce = 11; nonce <= 13; nonce++) {
        assert_false(scheduler_failed(s, NULL));
        struct sched_worker *worker = scheduler_worker_joined(s, nonce, 1, 100, NULL, now_ms);
        assert_true(take_lease(s, worker, now_ms, &lease));
        scheduler_worker_left(s, worker, true);
    }
    assert_true(scheduler_failed(s, NULL));
    scheduler_free(s);
}

static void a_lone_worker_that_keeps_failing_does_not_hang_the_job(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(2, 1);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct err why = { .code = ERR_RENDER, .text = "no" };
    struct sched_worker *worker = scheduler_worker_joined(s, 1, 1, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    int failures = 0;
    while (take_lease(s, worker, 0, &lease)) {
        for (uint32_t i = 0; i < lease.count; i++)
            scheduler_node_failed(s, worker, &lease.nodes[i], &why);
        assert_true(++failures < 20);
    }
    assert_true(scheduler_failed(s, NULL));
    scheduler_free(s);
}

static void a_node_that_failed_here_is_tried_elsewhere(void **state)
{
    (void)state;
    struct scheduler_settings settings = settings_for(1, 1);
    struct scheduler *s = scheduler_new(&settings, 0);
    scheduler_allow_rounds(s, 1);
    struct err why = { .code = ERR_RENDER, .text = "no" };
    struct sched_worker *bad = scheduler_worker_joined(s, 1, 1, 100, NULL, 0);
    struct sched_worker *good = scheduler_worker_joined(s, 2, 1, 100, NULL, 0);
    struct copied_lease lease = { 0 };
    assert_true(take_lease(s, bad, 0, &lease));
    scheduler_node_failed(s, bad, &lease.nodes[0], &why);
    assert_false(take_lease(s, bad, 0, &lease));
    assert_true(take_lease(s, good, 0, &lease));
    deliver_all(s, good, &lease, 0);
    assert_true(scheduler_done(s));
    scheduler_free(s);
}

/* ---- the simulation */

#define SIM_WORKERS 6
#define SIM_QUEUE   4096
#define SIM_LATE    512

struct sim_worker {
    struct sched_worker *handle; /* NULL: not connected */
    uint64_t nonce;
    double leaves_per_ms, progress;
    uint64_t samples;
    uint64_t stalled_until;
    struct node_id queue[SIM_QUEUE];
    uint32_t first, count;
    struct node_id late[SIM_LATE]; /* finished, not sent: kept when the connection is lost */
    uint32_t late_count;
};

struct sim {
    struct scheduler *s;
    struct scheduler_settings settings;
    uint64_t rng, now_ms, nonces;
    unsigned rounds;
    uint8_t *covered; /* per pair and leaf */
    uint64_t leaves_per_pair, accepted;
    uint64_t most_open, most_early;
    struct sim_worker workers[SIM_WORKERS];
};

static double roll(struct sim *sim)
{
    sim->rng = hash64_mix(sim->rng);
    return hash64_unit(sim->rng);
}

static void sim_deliver(struct sim *sim, struct sim_worker *worker, const struct node_id *node)
{
    enum result_verdict verdict = deliver(sim->s, worker->handle, node, sim->now_ms);
    assert_int_not_equal(verdict, RESULT_MISMATCH);
    if (verdict != RESULT_ACCEPTED)
        return;
    uint64_t pair = (uint64_t)node->tile * sim->settings.replicates + node->replicate;
    for (uint64_t leaf = node->index << node->level; leaf < (node->index + 1) << node->level;
         leaf++) {
        assert_true(leaf < sim->leaves_per_pair);
        uint8_t *covered = &sim->covered[pair * sim->leaves_per_pair + leaf];
        assert_int_equal(*covered, 0);
        *covered = 1;
        sim->accepted++;
    }
}

static void sim_connect(struct sim *sim, struct sim_worker *worker, bool again)
{
    if (!again) {
        worker->nonce = ++sim->nonces;
        worker->samples = 0;
        worker->late_count = 0;
    }
    double luck = roll(sim);
    worker->leaves_per_ms = 0.005 + luck * luck * luck; /* some are two hundred times as fast */
    worker->first = worker->count = 0;
    worker->handle = scheduler_worker_joined(sim->s, worker->nonce, 1 + (uint32_t)(4 * roll(sim)),
                                             1 + (uint64_t)(300 * roll(sim)), worker, sim->now_ms);
    while (worker->late_count > 0) /* the outbox is offered again */
        sim_deliver(sim, worker, &worker->late[--worker->late_count]);
}

static void sim_disconnect(struct sim *sim, struct sim_worker *worker)
{
    scheduler_worker_left(sim->s, worker->handle, false);
    worker->handle = NULL;
}

static void sim_finish_node(struct sim *sim, struct sim_worker *worker, const struct node_id *node)
{
    worker->samples += (uint64_t)1 << node->level;
    double fate = roll(sim);
    if (fate < 0.05 && worker->late_count < SIM_LATE) {
        worker->late[worker->late_count++] = *node;
        return;
    }
    sim_deliver(sim, worker, node);
    if (fate > 0.95)
        sim_deliver(sim, worker, node);
}

static void sim_render(struct sim *sim, struct sim_worker *worker, uint64_t ms)
{
    if (worker->stalled_until > sim->now_ms)
        return;
    worker->progress += worker->leaves_per_ms * (double)ms;
    while (worker->count > 0) {
        struct node_id node = worker->queue[worker->first % SIM_QUEUE];
        double leaves = (double)((uint64_t)1 << node.level);
        if (worker->progress < leaves)
            break;
        worker->progress -= leaves;
        worker->first++;
        worker->count--;
        sim_finish_node(sim, worker, &node);
    }
    worker->progress = worker->count == 0 ? 0 : worker->progress;
    scheduler_worker_progress(sim->s, worker->handle, worker->samples, sim->now_ms);
    if (worker->late_count > 0 && roll(sim) < 0.05)
        sim_deliver(sim, worker, &worker->late[--worker->late_count]);
}

static void sim_take_leases(struct sim *sim, struct sim_worker *worker)
{
    struct lease_order order;
    while (scheduler_lease(sim->s, worker->handle, sim->now_ms, &order)) {
        assert_true(worker->count + order.node_count <= SIM_QUEUE);
        for (uint32_t i = 0; i < order.node_count; i++)
            worker->queue[(worker->first + worker->count++) % SIM_QUEUE] = order.nodes[i];
    }
}

static void sim_step(struct sim *sim)
{
    uint64_t ms = 10 + (uint64_t)(40 * roll(sim));
    ms = roll(sim) < 0.002 ? 5000 : ms; /* the master itself slept */
    sim->now_ms += ms;
    scheduler_tick(sim->s, sim->now_ms);
    for (int i = 0; i < SIM_WORKERS; i++) {
        struct sim_worker *worker = &sim->workers[i];
        if (worker->handle == NULL) {
            if (i == 0 || roll(sim) < 0.03) /* the first comes at once, always */
                sim_connect(sim, worker, worker->nonce != 0 && roll(sim) < 0.5);
        } else if (roll(sim) < 0.01) {
            sim_disconnect(sim, worker);
        } else {
            if (roll(sim) < 0.01)
                worker->stalled_until = sim->now_ms + (uint64_t)(4000 * roll(sim));
            sim_render(sim, worker, ms);
            sim_take_leases(sim, worker);
        }
    }
    struct revocation revocation;
    while (scheduler_next_revocation(sim->s, &revocation)) {
        const struct sim_worker *worker = revocation.owner;
        assert_non_null(worker->handle); /* nobody is told who is not here */
    }
    const struct pieces *pieces = scheduler_pieces(sim->s);
    uint64_t open = pieces_open_pairs(pieces), early = pieces_early(pieces);
    sim->most_open = open > sim->most_open ? open : sim->most_open;
    sim->most_early = early > sim->most_early ? early : sim->most_early;
}

static void simulate(uint64_t seed, struct scheduler_counts *total)
{
    static struct sim sim;
    sim = (struct sim){ .rng = seed };
    uint32_t tiles = 1 + (uint32_t)(8 * roll(&sim)), replicates = 1 + (uint32_t)(4 * roll(&sim));
    sim.settings = settings_for(tiles, replicates);
    sim.settings.stall_ms = 1000;
    sim.settings.lease_target_ms = 200;
    sim.settings.speculate_ms = 100;
    sim.settings.early_max = 16;
    sim.settings.leases_per_worker = 1 + (uint32_t)(4 * roll(&sim));
    double kind = roll(&sim);
    if (kind < 0.2)
        sim.settings.lease_leaves_min = sim.settings.lease_leaves_max = 1;
    else if (kind < 0.4)
        sim.settings.lease_leaves_min = sim.settings.lease_leaves_max = 100000;
    sim.rounds = 1 + (unsigned)(40 * roll(&sim));
    sim.leaves_per_pair = round_end(sim.rounds - 1);
    sim.covered = calloc((size_t)tiles * replicates, sim.leaves_per_pair);
    sim.s = scheduler_new(&sim.settings, 0);

    unsigned allowed = 1;
    scheduler_allow_rounds(sim.s, allowed);
    unsigned steps = 0;
    while (allowed < sim.rounds || !scheduler_done(sim.s)) {
        if (allowed < sim.rounds && roll(&sim) < 0.2)
            scheduler_allow_rounds(sim.s, ++allowed);
        sim_step(&sim);
        assert_false(scheduler_failed(sim.s, NULL));
        assert_true(++steps < 100000);
    }
    assert_int_equal(sim.accepted, sim.leaves_per_pair * tiles * replicates);
    assert_int_equal(scheduler_sealed(sim.s), sim.rounds);
    uint64_t leases = SIM_WORKERS * (uint64_t)sim.settings.leases_per_worker;
    assert_true(sim.most_open <= 2 * (leases + 1));
    uint64_t in_flight = SIM_WORKERS * 300;
    assert_true(sim.most_early <= sim.settings.early_max + in_flight);
    struct scheduler_counts counts = scheduler_counts(sim.s);
    total->expired_leases += counts.expired_leases;
    total->nodes_reissued += counts.nodes_reissued;
    total->nodes_speculated += counts.nodes_speculated;
    total->duplicates += counts.duplicates;
    total->refused += counts.refused;
    scheduler_free(sim.s);
    free(sim.covered);
}

static void every_leaf_reaches_the_film_exactly_once_whatever_workers_do(void **state)
{
    (void)state;
    struct scheduler_counts total = { 0 };
    for (uint64_t seed = 1; seed <= 200; seed++)
        simulate(seed, &total);
    /* ... and they did all of it */
    assert_true(total.expired_leases > 100);
    assert_true(total.nodes_reissued > 1000);
    assert_true(total.nodes_speculated > 1000);
    assert_true(total.duplicates > 1000);
    assert_true(total.refused > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_worker_renders_every_round),
        cmocka_unit_test(a_worker_has_no_more_leases_and_nodes_than_it_may),
        cmocka_unit_test(lease_sizes_follow_measured_speed),
        cmocka_unit_test(forced_lease_sizes_hold_whatever_the_speed),
        cmocka_unit_test(a_large_node_is_cut_and_refused_from_then_on),
        cmocka_unit_test(an_expired_lease_goes_to_another_and_late_results_are_welcome),
        cmocka_unit_test(a_revoked_node_may_be_cut_and_is_refused_then),
        cmocka_unit_test(a_worker_that_moves_again_keeps_its_lease),
        cmocka_unit_test(a_stall_of_the_master_extends_all_deadlines),
        cmocka_unit_test(an_idle_worker_speculates_and_the_loser_is_told),
        cmocka_unit_test(a_late_duplicate_is_compared_until_its_round_seals),
        cmocka_unit_test(three_different_workers_that_fail_at_a_node_fail_the_job),
        cmocka_unit_test(crashes_count_but_disconnects_and_expiry_never_do),
        cmocka_unit_test(a_lone_worker_that_keeps_failing_does_not_hang_the_job),
        cmocka_unit_test(a_node_that_failed_here_is_tried_elsewhere),
        cmocka_unit_test(every_leaf_reaches_the_film_exactly_once_whatever_workers_do),
    };
    return cmocka_run_group_tests_name("scheduler", tests, NULL, NULL);
}
