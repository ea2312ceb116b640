/* The render threads: the same bits for any number of them and any splitting, and nobody waits. */
#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "worker/memory.h"
#include "worker/pool.h"
#include "worker/renderer.h"

#include <pthread.h>
#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cmocka.h>

/* A sanitizer's bookkeeping grows with every allocation */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

#define WIDTH  70 /* three tiles wide, the last one cut */
#define HEIGHT 40

static const struct job_spec spec = {
    .seed = 7, .replicates = 4, .leaf_samples = 4, .channel_count = 3, .max_lanes = 8
};

static void one_scene(struct scene *scene)
{
    *scene = (struct scene){
        .settings = { .width = WIDTH, .height = HEIGHT, .crop = { 0, WIDTH, 0, HEIGHT } }
    };
}

/* What the event loop is to a worker: somebody who can be woken. */
static sem_t bell;
static atomic_uint releases;

static void ring(void *context)
{
    (void)context;
    sem_post(&bell);
}

static void count_release(void *owner)
{
    (void)owner;
    releases++;
}

static struct pool_result take(struct pool *pool)
{
    struct pool_result result;
    while (!pool_take(pool, &result))
        sem_wait(&bell);
    return result;
}

static struct pool *some_pool(unsigned threads)
{
    struct err err;
    struct pool *pool = pool_new(threads, ring, NULL, &err);
    assert_non_null(pool);
    return pool;
}

static struct pool_job *some_job(struct pool *pool, const struct renderer_class *class,
                                 const struct scene *scene)
{
    struct err err;
    struct pool_job *job = pool_job_open(pool, class, scene, &spec, count_release, NULL, &err);
    assert_non_null(job);
    return job;
}

/* The definition, taken literally: node(l, j) = node(l-1, 2j) + node(l-1, 2j+1). */
static struct node_sums *by_definition(struct renderer *renderer, const struct scene *scene,
                                       struct node_id id)
{
    if (id.level == 0) {
        struct tile_rect rect = tile_rect(scene, id.tile);
        struct node_sums *sums = node_sums_new(rect.width * rect.height, spec.channel_count);
        assert_true(renderer_simulated.leaf(renderer, renderer, id.tile, id.replicate, id.index,
                                            sums, NULL));
        return sums;
    }
    struct node_id below = { id.tile, id.replicate, id.level - 1, 2 * id.index };
    struct node_sums *left = by_definition(renderer, scene, below);
    below.index++;
    struct node_sums *right = by_definition(renderer, scene, below);
    node_sums_add(left, right);
    node_sums_free(right);
    return left;
}

static void assert_same_sums(const struct node_sums *a, const struct node_sums *b)
{
    assert_int_equal(a->pixel_count, b->pixel_count);
    assert_int_equal(a->channel_count, b->channel_count);
    assert_memory_equal(a->values, b->values, sizeof(float) * a->pixel_count * a->channel_count);
    assert_memory_equal(&a->stats, &b->stats, sizeof(a->stats));
    assert_memory_equal(a->failed, b->failed, sizeof(a->failed));
}

static void any_number_of_threads_gives_the_bits_of_the_definition(void **state)
{
    (void)state;
    static const struct node_id nodes[] = {
        { 0, 0, 0, 0 }, { 2, 1, 5, 0 },           { 5, 3, 3, 7 },
        { 1, 2, 6, 1 }, { 3, 0, 0, 12345678901 }, { 4, 1, 1, 3 },
    };
    const size_t count = sizeof(nodes) / sizeof(nodes[0]);
    struct scene scene;
    one_scene(&scene);
    struct renderer *renderer = renderer_simulated.open(&scene, &spec, 1, NULL);
    struct node_sums *want[sizeof(nodes) / sizeof(nodes[0])];
    for (size_t i = 0; i < count; i++)
        want[i] = by_definition(renderer, &scene, nodes[i]);

    static const unsigned threads[] = { 1, 2, 4, 7 };
    for (size_t t = 0; t < sizeof(threads) / sizeof(threads[0]); t++) {
        struct pool *pool = some_pool(threads[t]);
        struct pool_job *job = some_job(pool, &renderer_simulated, &scene);
        struct err err;
        assert_true(pool_add(pool, job, 9, nodes, count, &err));
        uint64_t samples = 0;
        for (size_t i = 0; i < count; i++) {
            struct pool_result result = take(pool);
            assert_non_null(result.sums);
            assert_int_equal(result.lease_id, 9);
            size_t n = 0;
            while (memcmp(&nodes[n], &result.node, sizeof(nodes[n])) != 0)
                assert_true(++n < count);
            assert_same_sums(result.sums, want[n]);
            samples += result.sums->stats.samples;
            node_sums_free(result.sums);
        }
        assert_int_equal(pool_nodes(pool), 0);
        assert_int_equal(pool_samples(pool), samples);
        pool_job_close(pool, job);
        pool_free(pool);
    }
    for (size_t i = 0; i < count; i++)
        node_sums_free(want[i]);
    renderer_simulated.close(renderer);
}

/* A renderer whose leaves wait until they are told to go on; a leaf number can be made to fail. */
static pthread_mutex_t gate_mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t gate_cond = PTHREAD_COND_INITIALIZER;
static unsigned gate_inside, gate_passes;
static atomic_uint gate_leaves;
static _Atomic uint64_t gate_bad_leaf = UINT64_MAX;

static bool gate_leaf(struct renderer *renderer, void *thread, uint32_t tile, uint32_t replicate,
                      uint64_t leaf, struct node_sums *sums, struct err *err)
{
    pthread_mutex_lock(&gate_mutex);
    gate_inside++;
    pthread_cond_broadcast(&gate_cond);
    while (gate_passes == 0)
        pthread_cond_wait(&gate_cond, &gate_mutex);
    gate_passes--;
    pthread_mutex_unlock(&gate_mutex);
    atomic_fetch_add(&gate_leaves, 1);
    if (leaf == gate_bad_leaf)
        return err_set(err, ERR_RENDER, "leaf %u is bad", (unsigned)leaf);
    return renderer_simulated.leaf(renderer, thread, tile, replicate, leaf, sums, err);
}

static struct renderer_class gated(void)
{
    struct renderer_class class = renderer_simulated;
    class.leaf = gate_leaf;
    gate_inside = 0;
    gate_passes = 0;
    gate_leaves = 0;
    return class;
}

static void gate_wait_for(unsigned leaves_begun)
{
    pthread_mutex_lock(&gate_mutex);
    while (gate_inside < leaves_begun)
        pthread_cond_wait(&gate_cond, &gate_mutex);
    pthread_mutex_unlock(&gate_mutex);
}

static void gate_open(unsigned passes)
{
    pthread_mutex_lock(&gate_mutex);
    gate_passes = passes;
    pthread_cond_broadcast(&gate_cond);
    pthread_mutex_unlock(&gate_mutex);
}

static void a_single_node_keeps_every_thread_busy(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    struct renderer_class class = gated();
    struct pool *pool = some_pool(4);
    struct pool_job *job = some_job(pool, &class, &scene);

    assert_true(pool_add(pool, job, 1, &(struct node_id){ 0, 0, 7, 0 }, 1, NULL));
    gate_wait_for(4); /* none has passed: four threads are in a leaf of it at once */
    gate_open(1000);
    struct pool_result result = take(pool);
    assert_non_null(result.sums);
    assert_int_equal(gate_leaves, 128);
    node_sums_free(result.sums);
    pool_job_close(pool, job);
    pool_free(pool);
}

static void revoking_drops_what_nobody_has_begun_and_nothing_else(void **state)
{
    (void)state;
    static const struct node_id nodes[] = {
        { 0, 0, 2, 0 }, { 1, 0, 0, 0 }, { 2, 0, 0, 0 }, { 3, 0, 0, 0 }
    };
    struct scene scene;
    one_scene(&scene);
    struct renderer_class class = gated();
    struct pool *pool = some_pool(1);
    struct pool_job *job = some_job(pool, &class, &scene);

    assert_true(pool_add(pool, job, 1, nodes, 4, NULL));
    assert_true(pool_add(pool, job, 2, nodes, 1, NULL));
    gate_wait_for(1);
    assert_int_equal(pool_revoke(pool, 1, &nodes[2], 1), 1); /* one node by name */
    assert_int_equal(pool_revoke(pool, 1, &nodes[2], 1), 0);
    assert_int_equal(pool_revoke(pool, 1, &nodes[0], 1), 0); /* begun */
    assert_int_equal(pool_nodes(pool), 4);
    uint64_t leases[4];
    assert_int_equal(pool_leases(pool, leases, 4), 2);
    assert_int_equal(leases[0], 1);
    assert_int_equal(leases[1], 2);
    assert_int_equal(pool_revoke(pool, 2, NULL, 0), 1); /* a whole lease */
    assert_int_equal(pool_revoke(pool, 3, NULL, 0), 0);
    assert_int_equal(pool_leases(pool, leases, 4), 1);
    assert_int_equal(pool_revoke_all(pool), 2);
    gate_open(1000);
    struct pool_result result = take(pool);
    assert_int_equal(result.node.tile, 0);
    assert_non_null(result.sums);
    node_sums_free(result.sums);
    assert_int_equal(pool_nodes(pool), 0);
    assert_int_equal(gate_leaves, 4);
    pool_job_close(pool, job);
    pool_free(pool);
}

static void threads_that_may_begin_nothing_finish_what_they_began(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    struct renderer_class class = gated();
    struct pool *pool = some_pool(1);
    struct pool_job *job = some_job(pool, &class, &scene);

    static const struct node_id nodes[] = { { 0, 0, 3, 0 }, { 1, 0, 0, 0 } };
    assert_true(pool_add(pool, job, 1, nodes, 2, NULL));
    gate_wait_for(1);
    pool_allow(pool, 0);
    gate_open(1000);
    struct pool_result result = take(pool);
    assert_int_equal(result.node.tile, 0);
    node_sums_free(result.sums);
    struct timespec moment = { 0, 20000000 };
    nanosleep(&moment, NULL);
    assert_false(pool_take(pool, &result));
    assert_int_equal(gate_leaves, 8);

    pool_allow(pool, 1);
    result = take(pool);
    assert_int_equal(result.node.tile, 1);
    node_sums_free(result.sums);
    pool_job_close(pool, job);
    pool_free(pool);
}

static void one_bad_leaf_fails_its_node_once_and_no_other(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    for (unsigned threads = 1; threads <= 4; threads++) {
        struct renderer_class class = gated();
        gate_bad_leaf = 37;
        struct pool *pool = some_pool(threads);
        struct pool_job *job = some_job(pool, &class, &scene);
        static const struct node_id nodes[] = { { 0, 0, 6, 0 }, { 1, 0, 2, 0 } };
        gate_open(100000);
        assert_true(pool_add(pool, job, 1, nodes, 2, NULL));
        for (int i = 0; i < 2; i++) {
            struct pool_result result = take(pool);
            if (result.node.tile == 0) {
                assert_null(result.sums);
                assert_int_equal(result.err.code, ERR_RENDER);
                assert_string_equal(result.err.text, "leaf 37 is bad");
            } else {
                assert_int_equal(result.err.code, ERR_OK);
                assert_non_null(result.sums);
            }
            node_sums_free(result.sums);
        }
        struct pool_result result;
        assert_false(pool_take(pool, &result));
        assert_int_equal(pool_nodes(pool), 0);
        pool_job_close(pool, job);
        pool_free(pool);
        gate_bad_leaf = UINT64_MAX;
    }
}

static void *no_scratch(struct renderer *renderer, struct err *err)
{
    (void)renderer;
    err_set(err, ERR_MEMORY, "no scratch");
    return NULL;
}

static void a_thread_without_scratch_memory_fails_the_node(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    struct renderer_class class = renderer_simulated;
    class.thread_open = no_scratch;
    struct pool *pool = some_pool(2);
    struct pool_job *job = some_job(pool, &class, &scene);
    assert_true(pool_add(pool, job, 1, &(struct node_id){ 0, 0, 6, 0 }, 1, NULL));
    struct pool_result result = take(pool);
    assert_null(result.sums);
    assert_int_equal(result.err.code, ERR_MEMORY);
    pool_job_close(pool, job);
    pool_free(pool);
}

static void closing_a_job_stops_it_and_leaves_the_others(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    struct renderer_class class = gated();
    struct pool *pool = some_pool(2);
    struct pool_job *unloved = some_job(pool, &class, &scene);
    struct pool_job *other = some_job(pool, &renderer_simulated, &scene);
    unsigned before = releases;

    assert_true(pool_add(pool, unloved, 1, &(struct node_id){ 0, 0, 30, 0 }, 1, NULL));
    gate_wait_for(2);
    assert_true(pool_add(pool, other, 2, &(struct node_id){ 1, 0, 3, 0 }, 1, NULL));
    pool_job_close(pool, unloved);
    assert_int_equal(releases, before); /* two threads are still inside */
    assert_int_equal(pool_nodes(pool), 1);
    gate_open(1000);
    struct pool_result result = take(pool);
    assert_ptr_equal(result.job, other);
    assert_non_null(result.sums);
    node_sums_free(result.sums);
    pool_job_close(pool, other);
    pool_free(pool);
    assert_int_equal(releases, before + 2);
}

static void a_pool_can_end_with_work_at_hand(void **state)
{
    (void)state;
    struct scene scene;
    one_scene(&scene);
    struct pool *pool = some_pool(3);
    struct pool_job *job = some_job(pool, &renderer_simulated, &scene);
    unsigned before = releases;
    static const struct node_id nodes[] = { { 0, 0, 40, 0 }, { 1, 0, 0, 0 }, { 2, 0, 4, 1 } };
    assert_true(pool_add(pool, job, 1, nodes, 3, NULL));
    pool_job_close(pool, job);
    pool_free(pool);
    assert_int_equal(releases, before + 1);
}

static void memory_stays_flat_over_many_nodes(void **state)
{
    (void)state;
    if (SANITIZED)
        skip();
    struct scene scene;
    one_scene(&scene);
    struct pool *pool = some_pool(2);
    struct pool_job *job = some_job(pool, &renderer_simulated, &scene);
    uint64_t early = 0;
    for (unsigned i = 0; i < 300; i++) {
        struct node_id nodes[4];
        for (unsigned n = 0; n < 4; n++)
            nodes[n] = (struct node_id){ (i + n) % 6, n, i % 4, i };
        assert_true(pool_add(pool, job, i, nodes, 4, NULL));
        for (unsigned n = 0; n < 4; n++)
            node_sums_free(take(pool).sums);
        if (i == 100)
            early = memory_resident();
    }
    assert_true(memory_resident() < early + early / 20 + (1 << 20));
    pool_job_close(pool, job);
    pool_free(pool);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(any_number_of_threads_gives_the_bits_of_the_definition),
        cmocka_unit_test(a_single_node_keeps_every_thread_busy),
        cmocka_unit_test(revoking_drops_what_nobody_has_begun_and_nothing_else),
        cmocka_unit_test(threads_that_may_begin_nothing_finish_what_they_began),
        cmocka_unit_test(one_bad_leaf_fails_its_node_once_and_no_other),
        cmocka_unit_test(a_thread_without_scratch_memory_fails_the_node),
        cmocka_unit_test(closing_a_job_stops_it_and_leaves_the_others),
        cmocka_unit_test(a_pool_can_end_with_work_at_hand),
        cmocka_unit_test(memory_stays_flat_over_many_nodes),
    };
    sem_init(&bell, 0, 0);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
