#include "worker/pool.h"

#include "common/job.h"
#include "worker/profile.h"
#include "worker/renderer.h"

#include <assert.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>
#include <time.h>

/*
 * While there is plenty to do, results are handed to the loop in batches: nodes of four samples
 * come every few milliseconds, and waking the loop for each, and the master by what it sends,
 * took 1.4 % of the processors' time.
 */
#define WAKES_APART_NS 20000000

/* An aligned piece of a node, for one thread. */
struct part {
    TAILQ_ENTRY(part) link;
    struct node *node;
    uint32_t level;
    uint64_t index;
};

/* A node in the queue, at work or finished. */
struct node {
    TAILQ_ENTRY(node) link; /* in pool.nodes until finished, then in pool.finished */
    struct pool_result result;
    struct fold *fold; /* NULL while the node is one part */
    size_t parts;      /* waiting or at work */
    bool begun;
    atomic_bool stopped; /* failed or dropped: threads at work on it stop at their next leaf */
    bool dropped;        /* nobody wants to hear of it */
    struct part whole;
};

TAILQ_HEAD(part_list, part);
TAILQ_HEAD(node_list, node);

struct pool_job {
    const struct renderer_class *class;
    struct renderer *renderer;
    const struct scene *scene;
    struct job_spec spec;
    void (*release)(void *owner);
    void *owner;
    unsigned references; /* the owner's, and one per node in pool.nodes */
    unsigned threads;
    void *scratch[]; /* by thread; opened by that thread when it first meets the job */
};

struct thread {
    struct pool *pool;
    unsigned number;
    pthread_t id;
    /* Sums being added, by level: reused from part to part */
    struct node_sums *sums[NODE_LEVEL_MAX + 2];
    uint32_t channel_count;
};

struct pool {
    pthread_mutex_t mutex;
    pthread_cond_t work; /* there may be a part to take, or the end has come */
    struct part_list waiting;
    size_t waiting_count;
    struct node_list nodes, finished;
    size_t node_count;  /* in both lists, less those that were dropped */
    size_t begun_count; /* of these */
    size_t allowed;     /* while begun_count reaches this, no node is begun */
    bool ending;
    void (*wake)(void *context);
    void *context;
    uint64_t woken_ns; /* when `wake` was called last */
    _Atomic uint64_t samples, core_ns;
    unsigned thread_count;
    struct thread threads[];
};

/* ---- jobs ---- */

uint64_t pool_job_memory(unsigned threads, const struct job_spec *spec)
{
    /* A thread's counter, as many sums again in folds, and results on their way out */
    const unsigned sums_per_thread = 3 * 16;
    return (uint64_t)threads * sums_per_thread * node_sums_size(TILE_PIXELS, spec->channel_count);
}

struct pool_job *pool_job_open(struct pool *pool, const struct renderer_class *class,
                               const struct scene *scene, const struct job_spec *spec,
                               void (*release)(void *owner), void *owner, struct err *err)
{
    struct pool_job *job = calloc(1, sizeof(*job) + pool->thread_count * sizeof(job->scratch[0]));
    if (job == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a job");
        return NULL;
    }
    job->class = class;
    job->spec = *spec;
    job->references = 1;
    job->threads = pool->thread_count;
    job->renderer = class->open(scene, &job->spec, pool->thread_count, err);
    if (job->renderer == NULL) {
        free(job);
        return NULL;
    }
    job->scene = scene;
    job->release = release;
    job->owner = owner;
    return job;
}

static void job_free(struct pool_job *job)
{
    if (job == NULL)
        return;
    for (unsigned i = 0; i < job->threads; i++)
        if (job->scratch[i] != NULL)
            job->class->thread_close(job->renderer, job->scratch[i]);
    job->class->close(job->renderer);
    job->release(job->owner);
    free(job);
}

/* Give a reference back, under the mutex; the job, for job_free without it, if it was the last. */
static struct pool_job *job_release(struct pool_job *job)
{
    return --job->references == 0 ? job : NULL;
}

/* ---- nodes; everything here is called under the mutex ---- */

static void part_enqueue(struct pool *pool, struct part *part, bool first)
{
    if (first)
        TAILQ_INSERT_HEAD(&pool->waiting, part, link);
    else
        TAILQ_INSERT_TAIL(&pool->waiting, part, link);
    pool->waiting_count++;
}

static void part_dequeue(struct pool *pool, struct part *part)
{
    TAILQ_REMOVE(&pool->waiting, part, link);
    pool->waiting_count--;
}

static void part_free(struct part *part)
{
    if (part != &part->node->whole)
        free(part);
}

static void node_free(struct node *node)
{
    fold_free(node->fold);
    node_sums_free(node->result.sums);
    free(node);
}

static void node_drop_waiting_parts(struct pool *pool, struct node *node)
{
    struct part *part, *next;
    if (!node->begun) {
        part_dequeue(pool, &node->whole);
        node->parts--;
        return;
    }
    /* Pieces of nodes that were begun are all at the front */
    for (part = TAILQ_FIRST(&pool->waiting); part != NULL && part->node->begun; part = next) {
        next = TAILQ_NEXT(part, link);
        if (part->node != node)
            continue;
        part_dequeue(pool, part);
        part_free(part);
        node->parts--;
    }
}

/* Take a node whose parts are all gone out of the books. The job if it was its last reference. */
static struct pool_job *node_forget(struct pool *pool, struct node *node)
{
    struct pool_job *job = node->result.job;
    TAILQ_REMOVE(&pool->nodes, node, link);
    node_free(node);
    return job_release(job);
}

/* The node is nobody's concern any more: taken or dropped. */
static void node_count_less(struct pool *pool, const struct node *node)
{
    pool->node_count--;
    if (node->begun && --pool->begun_count < pool->allowed)
        pthread_cond_signal(&pool->work);
}

/* Nobody wants the node any more. The job if that was its last reference. */
static struct pool_job *node_drop(struct pool *pool, struct node *node)
{
    node_drop_waiting_parts(pool, node);
    node->dropped = true;
    node_count_less(pool, node);
    atomic_store_explicit(&node->stopped, true, memory_order_relaxed);
    return node->parts == 0 ? node_forget(pool, node) : NULL;
}

static void node_fail(struct pool *pool, struct node *node, const struct err *err)
{
    if (node->result.err.code == ERR_OK)
        node->result.err = *err;
    atomic_store_explicit(&node->stopped, true, memory_order_relaxed);
    node_drop_waiting_parts(pool, node);
}

static uint64_t clock_ns(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

/* Wake the loop, unless it was just woken and the threads have enough to do until the next time. */
static void wake_loop(struct pool *pool)
{
    uint64_t now_ns = clock_ns(CLOCK_MONOTONIC);
    bool plenty = pool->waiting_count >= pool->thread_count && pool->begun_count < pool->allowed;
    if (plenty && now_ns - pool->woken_ns < WAKES_APART_NS)
        return;
    pool->woken_ns = now_ns;
    pool->wake(pool->context); /* under the mutex, so that pool_free never overtakes it */
}

/* Hand a node whose last part is done to the loop. The job if that was its last reference. */
static struct pool_job *node_finish(struct pool *pool, struct node *node)
{
    if (node->dropped)
        return node_forget(pool, node);
    if (node->fold != NULL && node->result.err.code == ERR_OK)
        node->result.sums = fold_take(node->fold);
    fold_free(node->fold);
    node->fold = NULL;
    TAILQ_REMOVE(&pool->nodes, node, link);
    TAILQ_INSERT_TAIL(&pool->finished, node, link);
    wake_loop(pool);
    return job_release(node->result.job);
}

/* ---- render threads ---- */

/*
 * Halve a part that a thread is about to begin while too little waits for the other threads: the
 * right half goes to the front of the queue. Without memory the part just stays whole.
 */
static void part_split(struct pool *pool, struct part *part)
{
    struct node *node = part->node;
    while (part->level > 0 && pool->waiting_count + 1 < pool->thread_count) {
        if (node->fold == NULL)
            node->fold = fold_new(node->result.node.level, node->result.node.index);
        struct part *right = node->fold != NULL ? malloc(sizeof(*right)) : NULL;
        if (right == NULL)
            return;
        part->level--;
        part->index *= 2;
        *right = (struct part){ .node = node, .level = part->level, .index = part->index + 1 };
        node->parts++;
        part_enqueue(pool, right, true);
        pthread_cond_signal(&pool->work);
    }
}

/* The part to render next, halved as needed; NULL when there is none. */
static struct part *part_take(struct pool *pool)
{
    struct part *part = TAILQ_FIRST(&pool->waiting);
    if (part == NULL || (!part->node->begun && pool->begun_count >= pool->allowed))
        return NULL;
    part_dequeue(pool, part);
    if (!part->node->begun)
        pool->begun_count++;
    part->node->begun = true;
    part_split(pool, part);
    return part;
}

static void thread_forget_sums(struct thread *thread)
{
    for (size_t i = 0; i < sizeof(thread->sums) / sizeof(thread->sums[0]); i++) {
        node_sums_free(thread->sums[i]);
        thread->sums[i] = NULL;
    }
}

/* The thread's sums of number `slot`, made if need be, in the shape of the tile. */
static struct node_sums *thread_sums(struct thread *thread, unsigned slot, uint32_t pixels)
{
    if (thread->sums[slot] == NULL)
        thread->sums[slot] = node_sums_new(TILE_PIXELS, thread->channel_count);
    if (thread->sums[slot] != NULL)
        thread->sums[slot]->pixel_count = pixels; /* planes move together: room for the largest */
    return thread->sums[slot];
}

static void swap_sums(struct node_sums **a, struct node_sums **b)
{
    struct node_sums *old_a = *a;
    *a = *b;
    *b = old_a;
}

/* The sums of a part, which leave the thread's hands; NULL when stopped, or as err says. */
static struct node_sums *part_render(struct thread *thread, const struct part *part,
                                     struct err *err)
{
    struct pool *pool = thread->pool;
    struct node *node = part->node;
    struct pool_job *job = node->result.job;
    const struct node_id *id = &node->result.node;
    struct tile_rect rect = tile_rect(job->scene, id->tile);
    uint32_t pixels = rect.width * rect.height;
    uint64_t leaves = (uint64_t)1 << part->level;

    if (thread->channel_count != job->spec.channel_count)
        thread_forget_sums(thread);
    thread->channel_count = job->spec.channel_count;

    void **scratch = &job->scratch[thread->number];
    if (*scratch == NULL && (*scratch = job->class->thread_open(job->renderer, err)) == NULL)
        return NULL;

    struct node_sums **carry = &thread->sums[part->level + 1];
    for (uint64_t leaf = 0; leaf < leaves; leaf++) {
        if (atomic_load_explicit(&node->stopped, memory_order_relaxed))
            return NULL;
        if (thread_sums(thread, part->level + 1, pixels) == NULL)
            goto fail_memory;
        if (!job->class->leaf(job->renderer, *scratch, id->tile, id->replicate,
                              part->index * leaves + leaf, *carry, err))
            return NULL;
        atomic_fetch_add_explicit(&pool->samples, (*carry)->stats.samples, memory_order_relaxed);

        /* Carry: bit l of `leaf` says that level l holds the left sibling of what is carried */
        unsigned level = 0;
        for (; leaf >> level & 1; level++) {
            node_sums_add(thread->sums[level], *carry);
            swap_sums(&thread->sums[level], carry);
        }
        if (thread_sums(thread, level, pixels) == NULL)
            goto fail_memory;
        swap_sums(&thread->sums[level], carry);
    }
    struct node_sums *total = thread->sums[part->level];
    thread->sums[part->level] = NULL;
    return total;

fail_memory:
    err_set(err, ERR_MEMORY, "no memory for the sums of a tile");
    return NULL;
}

/* Under the mutex. The job if the part was the last of its last node. */
static struct pool_job *part_finish(struct pool *pool, struct part *part, struct node_sums *sums,
                                    const struct err *failure)
{
    struct node *node = part->node;
    struct err err = *failure;
    bool wanted = !node->dropped && node->result.err.code == ERR_OK;

    if (sums != NULL && wanted && node->fold == NULL) {
        node->result.sums = sums;
        sums = NULL;
    } else if (sums != NULL && wanted) {
        enum fold_result added = fold_add(node->fold, part->level, part->index, sums);
        if (added == FOLD_ADDED)
            sums = NULL;
        else if (added == FOLD_NO_MEMORY)
            err_set(&err, ERR_MEMORY, "no memory to join the pieces of a node");
        else
            err_set(&err, ERR_INTERNAL, "a piece of a node was rendered twice");
    }
    node_sums_free(sums);
    if (err.code != ERR_OK && !node->dropped)
        node_fail(pool, node, &err);

    part_free(part);
    return --node->parts == 0 ? node_finish(pool, node) : NULL;
}

static void *thread_main(void *argument)
{
    struct thread *thread = argument;
    struct pool *pool = thread->pool;
    profile_thread_mode();

    pthread_mutex_lock(&pool->mutex);
    while (!pool->ending) {
        struct part *part = part_take(pool);
        if (part == NULL) {
            pthread_cond_wait(&pool->work, &pool->mutex);
            continue;
        }
        pthread_mutex_unlock(&pool->mutex);

        struct err err;
        err_clear(&err);
        uint64_t begin_ns = clock_ns(CLOCK_THREAD_CPUTIME_ID);
        struct node_sums *sums = part_render(thread, part, &err);
        uint64_t core_ns = clock_ns(CLOCK_THREAD_CPUTIME_ID) - begin_ns;
        atomic_fetch_add_explicit(&pool->core_ns, core_ns, memory_order_relaxed);

        pthread_mutex_lock(&pool->mutex);
        part->node->result.core_seconds += 1e-9 * (double)core_ns;
        struct pool_job *unused = part_finish(pool, part, sums, &err);
        if (unused != NULL) {
            pthread_mutex_unlock(&pool->mutex);
            job_free(unused);
            pthread_mutex_lock(&pool->mutex);
        }
    }
    pthread_mutex_unlock(&pool->mutex);
    thread_forget_sums(thread);
    return NULL;
}

/* ---- the loop's side ---- */

static void stop_threads(struct pool *pool, unsigned started)
{
    pthread_mutex_lock(&pool->mutex);
    pool->ending = true;
    struct node *node;
    TAILQ_FOREACH(node, &pool->nodes, link)
    atomic_store_explicit(&node->stopped, true, memory_order_relaxed);
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->mutex);
    for (unsigned i = 0; i < started; i++)
        pthread_join(pool->threads[i].id, NULL);
}

struct pool *pool_new(unsigned threads, void (*wake)(void *context), void *context, struct err *err)
{
    assert(threads > 0);
    struct pool *pool = calloc(1, sizeof(*pool) + threads * sizeof(pool->threads[0]));
    if (pool == NULL)
        goto fail_alloc;
    pthread_mutex_init(&pool->mutex, NULL);
    pthread_cond_init(&pool->work, NULL);
    TAILQ_INIT(&pool->waiting);
    TAILQ_INIT(&pool->nodes);
    TAILQ_INIT(&pool->finished);
    pool->wake = wake;
    pool->context = context;
    pool->thread_count = threads;
    pool->allowed = SIZE_MAX;

    /* Signals are the event loop's business */
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    unsigned started = 0;
    for (; started < threads; started++) {
        struct thread *thread = &pool->threads[started];
        thread->pool = pool;
        thread->number = started;
        if (pthread_create(&thread->id, NULL, thread_main, thread) != 0)
            break;
    }
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (started < threads)
        goto fail_threads;
    return pool;

fail_threads:
    stop_threads(pool, started);
    pthread_cond_destroy(&pool->work);
    pthread_mutex_destroy(&pool->mutex);
    free(pool);
fail_alloc:
    err_set(err, ERR_MEMORY, "starting %u render threads", threads);
    return NULL;
}

void pool_free(struct pool *pool)
{
    if (pool == NULL)
        return;
    stop_threads(pool, pool->thread_count);

    struct node *node;
    while ((node = TAILQ_FIRST(&pool->nodes)) != NULL) {
        node_drop_waiting_parts(pool, node);
        job_free(node_forget(pool, node));
    }
    while ((node = TAILQ_FIRST(&pool->finished)) != NULL) {
        TAILQ_REMOVE(&pool->finished, node, link);
        node_free(node);
    }
    pthread_cond_destroy(&pool->work);
    pthread_mutex_destroy(&pool->mutex);
    free(pool);
}

void pool_job_close(struct pool *pool, struct pool_job *job)
{
    struct pool_job *unused = NULL;
    struct node *node, *next;
    pthread_mutex_lock(&pool->mutex);
    for (node = TAILQ_FIRST(&pool->nodes); node != NULL; node = next) {
        next = TAILQ_NEXT(node, link);
        if (node->result.job == job && !node->dropped)
            node_drop(pool, node); /* never the last reference: the owner's is still there */
    }
    for (node = TAILQ_FIRST(&pool->finished); node != NULL; node = next) {
        next = TAILQ_NEXT(node, link);
        if (node->result.job == job) {
            TAILQ_REMOVE(&pool->finished, node, link);
            node_count_less(pool, node);
            node_free(node);
        }
    }
    unused = job_release(job);
    pthread_mutex_unlock(&pool->mutex);
    job_free(unused);
}

bool pool_add(struct pool *pool, struct pool_job *job, uint64_t lease_id,
              const struct node_id *nodes, size_t count, struct err *err)
{
    struct node_list added;
    TAILQ_INIT(&added);
    struct node *node;
    for (size_t i = 0; i < count; i++) {
        assert(nodes[i].level <= NODE_LEVEL_MAX);
        node = calloc(1, sizeof(*node));
        if (node == NULL)
            goto fail;
        node->result.job = job;
        node->result.lease_id = lease_id;
        node->result.node = nodes[i];
        node->whole.node = node;
        node->whole.level = nodes[i].level;
        node->whole.index = nodes[i].index;
        node->parts = 1;
        TAILQ_INSERT_TAIL(&added, node, link);
    }

    pthread_mutex_lock(&pool->mutex);
    TAILQ_FOREACH(node, &added, link)
    part_enqueue(pool, &node->whole, false);
    TAILQ_CONCAT(&pool->nodes, &added, link);
    pool->node_count += count;
    job->references += (unsigned)count;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->mutex);
    return true;

fail:
    while ((node = TAILQ_FIRST(&added)) != NULL) {
        TAILQ_REMOVE(&added, node, link);
        free(node);
    }
    return err_set(err, ERR_MEMORY, "no memory for a lease of %zu nodes", count);
}

static bool same_node(const struct node_id *a, const struct node_id *b)
{
    return a->tile == b->tile && a->replicate == b->replicate && a->level == b->level &&
           a->index == b->index;
}

static bool is_listed(const struct node_id *node, const struct node_id *list, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (same_node(node, &list[i]))
            return true;
    return false;
}

static size_t drop_waiting(struct pool *pool, bool every_lease, uint64_t lease_id,
                           const struct node_id *nodes, size_t count)
{
    size_t dropped = 0;
    struct node *node, *next;
    pthread_mutex_lock(&pool->mutex);
    for (node = TAILQ_FIRST(&pool->nodes); node != NULL; node = next) {
        next = TAILQ_NEXT(node, link);
        if (node->begun || (!every_lease && node->result.lease_id != lease_id) ||
            (count > 0 && !is_listed(&node->result.node, nodes, count)))
            continue;
        node_drop(pool, node); /* never the last reference: the owner's is still there */
        dropped++;
    }
    pthread_mutex_unlock(&pool->mutex);
    return dropped;
}

size_t pool_revoke(struct pool *pool, uint64_t lease_id, const struct node_id *nodes, size_t count)
{
    return drop_waiting(pool, false, lease_id, nodes, count);
}

size_t pool_revoke_all(struct pool *pool)
{
    return drop_waiting(pool, true, 0, NULL, 0);
}

void pool_allow(struct pool *pool, size_t nodes)
{
    pthread_mutex_lock(&pool->mutex);
    pool->allowed = nodes;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->mutex);
}

bool pool_take(struct pool *pool, struct pool_result *out)
{
    pthread_mutex_lock(&pool->mutex);
    struct node *node = TAILQ_FIRST(&pool->finished);
    if (node != NULL) {
        TAILQ_REMOVE(&pool->finished, node, link);
        if (pool->allowed > 0)
            pool->allowed--; /* its place is taken until pool_allow says otherwise */
        node_count_less(pool, node);
    }
    pthread_mutex_unlock(&pool->mutex);
    if (node == NULL)
        return false;
    *out = node->result;
    node->result.sums = NULL;
    node_free(node);
    return true;
}

size_t pool_nodes(struct pool *pool)
{
    pthread_mutex_lock(&pool->mutex);
    size_t count = pool->node_count;
    pthread_mutex_unlock(&pool->mutex);
    return count;
}

size_t pool_leases(struct pool *pool, uint64_t *lease_ids, size_t capacity)
{
    size_t count = 0;
    struct node *node;
    pthread_mutex_lock(&pool->mutex);
    TAILQ_FOREACH(node, &pool->nodes, link)
    {
        size_t i = 0;
        if (node->dropped)
            continue;
        while (i < count && lease_ids[i] != node->result.lease_id)
            i++;
        if (i == count && count < capacity)
            lease_ids[count++] = node->result.lease_id;
    }
    pthread_mutex_unlock(&pool->mutex);
    return count;
}

uint64_t pool_samples(const struct pool *pool)
{
    return atomic_load_explicit(&pool->samples, memory_order_relaxed);
}

double pool_core_seconds(const struct pool *pool)
{
    return 1e-9 * (double)atomic_load_explicit(&pool->core_ns, memory_order_relaxed);
}
