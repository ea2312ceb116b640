#include "worker/jobs.h"

#include "common/scene.h"
#include "proto/assembly.h"
#include "proto/cache.h"
#include "proto/limits.h"
#include "worker/journal.h"
#include "worker/memory.h"
#include "worker/pool.h"
#include "worker/profile.h"
#include "worker/renderer.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Slices asked for and not come yet: enough to fill a line of 100 ms at 1 Gbit/s */
#define CREDIT 4

/* Jobs one master may offer; more would be a flood */
#define JOBS_MAX 256

/* What a renderer takes per triangle beyond the arrays themselves (Embree's robust BVH), for the
 * decision whether a scene fits at all */
#define RENDERER_BYTES_PER_TRIANGLE 256

TAILQ_HEAD(job_list, job);

struct jobs {
    uv_loop_t *loop;
    struct pool *pool;
    struct jobs_options options;
    struct jobs_events events;
    void *owner;
    struct job_list list;
    size_t count;
    struct job *current;  /* the one that is loading, fetching or preparing */
    uint32_t outstanding; /* slices asked for by the current job */
    uint32_t stale;       /* slices asked for by jobs that are gone since */
    bool closing;
};

static void advance(struct jobs *jobs);

static void release_assembly(void *assembly)
{
    assembly_free(assembly);
}

/* ---- the life of a job ---- */

static void closed(struct jobs *jobs)
{
    struct jobs_events events = jobs->events;
    void *owner = jobs->owner;
    free(jobs);
    events.on_closed(owner);
}

static void job_free(struct job *job)
{
    struct jobs *jobs = job->jobs;
    if (job->rendering != NULL)
        pool_job_close(jobs->pool, job->rendering); /* and the assembly with it */
    else
        assembly_free(job->assembly);
    TAILQ_REMOVE(&jobs->list, job, link);
    jobs->count--;
    free(job);
    if (jobs->closing && TAILQ_EMPTY(&jobs->list))
        closed(jobs);
}

/* Free a job now, or as soon as the thread that works on it is done. */
static void job_drop(struct job *job)
{
    struct jobs *jobs = job->jobs;
    job->offered = false;
    if (jobs->current == job && job->state == JOB_FETCHING) {
        jobs->stale += jobs->outstanding;
        jobs->outstanding = 0;
    }
    if (job->working) {
        job->unwanted = true;
        uv_cancel((uv_req_t *)&job->work); /* fails once it runs, and then after() comes later */
        return;
    }
    if (jobs->current == job)
        jobs->current = NULL;
    job_free(job);
}

static void job_settle(struct job *job, enum job_state state)
{
    struct jobs *jobs = job->jobs;
    job->state = state;
    job->load_seconds = 1e-9 * (double)(uv_hrtime() - job->begin_ns);
    if (jobs->current == job)
        jobs->current = NULL;
    if (state == JOB_FAILED) {
        assembly_free(job->assembly);
        job->assembly = NULL;
    }
    if (job->offered)
        jobs->events.on_settled(jobs->owner, job);
}

static void on_work(uv_work_t *work)
{
    struct job *job = work->data;
    job->step(job);
}

static void on_worked(uv_work_t *work, int status)
{
    struct job *job = work->data;
    struct jobs *jobs = job->jobs;
    bool closing = jobs->closing; /* then job_drop may free `jobs` */
    job->working = false;
    if (job->unwanted || status == UV_ECANCELED)
        job_drop(job);
    else
        job->after(job);
    if (!closing)
        advance(jobs);
}

/* Run step(job) on another thread, then after(job) on this one. */
static void job_work(struct job *job, void (*step)(struct job *), void (*after)(struct job *))
{
    job->step = step;
    job->after = after;
    job->work.data = job;
    job->working = true;
    uv_queue_work(job->jobs->loop, &job->work, on_work, on_worked); /* fails for NULL only */
}

/* ---- loading, fetching, preparing, storing ---- */

/* The worker's cache, for one thread and one use; NULL, said in the journal, when there is none. */
static struct cache *open_cache(const struct jobs *jobs)
{
    struct err err;
    if (jobs->options.cache_dir == NULL)
        return NULL;
    struct cache *cache = cache_open(jobs->options.cache_dir, jobs->options.cache_quota, &err);
    if (cache == NULL)
        journal_say(JOURNAL_PROBLEM, "cache not used: %s", err.text);
    return cache;
}

static void step_store(struct job *job)
{
    struct err err;
    struct cache *cache = open_cache(job->jobs);
    if (cache != NULL && !assembly_store(job->assembly, cache, &err))
        journal_say(JOURNAL_NEWS, "scene not cached: %s", err.text);
    cache_close(cache);
}

static void after_store(struct job *job)
{
    (void)job;
}

/* A spec comes from outside: what the pool and the renderers take for granted is checked here. */
static bool check_spec(const struct job_spec *spec, struct err *err)
{
    if (spec->replicates == 0 || spec->replicates > 1u << 20)
        return err_set(err, ERR_ARGUMENT, "the job has %u replicates", spec->replicates);
    if (spec->pilot_rounds > ROUND_COUNT)
        return err_set(err, ERR_ARGUMENT, "the job has a pilot of %u rounds", spec->pilot_rounds);
    if (spec->leaf_samples == 0 || spec->leaf_samples > 1u << 16 ||
        (spec->leaf_samples & (spec->leaf_samples - 1)) != 0)
        return err_set(err, ERR_ARGUMENT, "the job has leaves of %u samples", spec->leaf_samples);
    if (spec->channel_count == 0 || spec->channel_count > LIMIT_CHANNELS)
        return err_set(err, ERR_ARGUMENT, "the job has %u channels", spec->channel_count);
    if (spec->max_lanes == 0 || spec->max_lanes > 8)
        return err_set(err, ERR_ARGUMENT, "the job has %u lanes", spec->max_lanes);
    return true;
}

static void step_prepare(struct job *job)
{
    struct jobs *jobs = job->jobs;
    profile_thread_mode(); /* a renderer is prepared with the arithmetic it renders with */
    const struct scene *scene = assembly_scene(job->assembly);
    if (!scene_check(scene, &job->failure))
        return;
    job->tiles = tile_count(scene);
    job->rendering = pool_job_open(jobs->pool, jobs->options.renderer, scene, &job->spec,
                                   release_assembly, job->assembly, &job->failure);
}

static void after_prepare(struct job *job)
{
    if (job->rendering == NULL) {
        job_settle(job, JOB_FAILED);
        return;
    }
    job->cached = assembly_cached(job->assembly);
    job_settle(job, JOB_READY);
    if (!job->cached && !job->unwanted && job->jobs->options.cache_dir != NULL)
        job_work(job, step_store, after_store);
}

static void job_prepare(struct job *job)
{
    job->state = JOB_PREPARING;
    job_work(job, step_prepare, after_prepare);
}

/* Ask for as much as the credit allows. */
static void ask(struct jobs *jobs)
{
    struct job *job = jobs->current;
    Pathfarm__ObjectWanted wish;
    while (job->offered && jobs->outstanding < CREDIT &&
           assembly_want(job->assembly, CREDIT - jobs->outstanding, &wish)) {
        wish.job_id = job->id;
        jobs->outstanding += wish.slice_count;
        jobs->events.on_wish(jobs->owner, &wish);
    }
}

static void step_load(struct job *job)
{
    struct cache *cache = open_cache(job->jobs);
    assembly_load(job->assembly, cache);
    cache_close(cache);
}

static void after_load(struct job *job)
{
    if (assembly_complete(job->assembly)) {
        job_prepare(job);
        return;
    }
    job->state = JOB_FETCHING;
    job->jobs->outstanding = 0;
    ask(job->jobs);
}

/* Will the scene fit? Answered before anything is allocated for it. */
static bool check_memory(struct job *job, struct err *err)
{
    uint64_t limit = job->jobs->options.max_memory, resident = memory_resident();
    uint64_t allowed = limit == UINT64_MAX ? UINT64_MAX : limit > resident ? limit - resident : 0;
    uint64_t available = memory_available();
    if (allowed < available)
        available = allowed;
    if (job->need_bytes <= available)
        return true;
    return err_set(err, ERR_MEMORY,
                   "the job needs about %" PRIu64 " MiB and %" PRIu64 " MiB are available here",
                   job->need_bytes >> 20, available >> 20);
}

static void job_load(struct job *job)
{
    struct jobs *jobs = job->jobs;
    /* What the master no longer offers makes room */
    struct job *other, *next;
    for (other = TAILQ_FIRST(&jobs->list); other != NULL; other = next) {
        next = TAILQ_NEXT(other, link);
        if (!other->offered)
            job_drop(other);
    }
    jobs->current = job;
    job->begin_ns = uv_hrtime();
    if (!check_memory(job, &job->failure)) {
        job_settle(job, JOB_FAILED);
        return;
    }
    job->state = JOB_LOADING;
    job_work(job, step_load, after_load);
}

/* Bring the next job on its way, unless one is. */
static void advance(struct jobs *jobs)
{
    struct job *job = TAILQ_FIRST(&jobs->list);
    while (job != NULL) {
        if (jobs->current != NULL && (jobs->current->offered || jobs->current->working))
            return; /* but one that waits for slices of a master that is gone blocks nobody */
        if (job->state == JOB_QUEUED && job->offered) {
            job_load(job);
            job = TAILQ_FIRST(&jobs->list); /* it may have failed at once, and others are gone */
        } else {
            job = TAILQ_NEXT(job, link);
        }
    }
}

/* ---- the interface ---- */

struct jobs *jobs_new(uv_loop_t *loop, struct pool *pool, const struct jobs_options *options,
                      const struct jobs_events *events, void *owner)
{
    struct jobs *jobs = calloc(1, sizeof(*jobs));
    if (jobs == NULL)
        return NULL;
    jobs->loop = loop;
    jobs->pool = pool;
    jobs->options = *options;
    jobs->events = *events;
    jobs->owner = owner;
    TAILQ_INIT(&jobs->list);
    return jobs;
}

void jobs_close(struct jobs *jobs)
{
    struct job *job, *next;
    if (TAILQ_EMPTY(&jobs->list)) {
        closed(jobs);
        return;
    }
    jobs->closing = true; /* the last job_free frees `jobs` too */
    for (job = TAILQ_FIRST(&jobs->list); job != NULL; job = next) {
        next = TAILQ_NEXT(job, link);
        job_drop(job);
    }
}

/* What the offer says about sizes, as bundle_check_job found it consistent. */
static void take_sizes(struct job *job, const Pathfarm__Job *offer)
{
    uint64_t triangles = 0;
    for (size_t i = 0; i < offer->n_objects; i++) {
        job->object_bytes += offer->objects[i]->size_bytes;
        if (strcmp(offer->objects[i]->name, "triangles") == 0)
            triangles = offer->objects[i]->count;
    }
    job->need_bytes = job->object_bytes + triangles * RENDERER_BYTES_PER_TRIANGLE +
                      pool_job_memory(job->jobs->options.threads, &job->spec);
}

static bool check_profile(const struct jobs *jobs, const Pathfarm__Job *offer, struct err *err)
{
    const struct profile *ours = jobs->options.profile;
    if (offer->profile.len == 0 ||
        (offer->profile.len == sizeof(ours->digest) &&
         memcmp(offer->profile.data, ours->digest, sizeof(ours->digest)) == 0))
        return true;
    return err_set(err, ERR_PROFILE, "this worker's numeric profile (%s) is not the job's",
                   ours->text);
}

static bool take_new(struct jobs *jobs, const Pathfarm__Job *offer, struct err *err)
{
    if (jobs->count >= JOBS_MAX)
        return err_set(err, ERR_LIMIT, "more than %d jobs are offered", JOBS_MAX);
    struct job *job = calloc(1, sizeof(*job));
    if (job == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a job");
    job->jobs = jobs;
    job->assembly = assembly_new(offer, UINT64_MAX, err);
    if (job->assembly == NULL) {
        free(job);
        return false;
    }
    job->digest = *assembly_job_digest(job->assembly);
    job->spec = *assembly_spec(job->assembly);
    job->id = offer->job_id;
    job->offered = true;
    job->begin_ns = uv_hrtime();
    snprintf(job->title, sizeof(job->title), "%s", offer->title);
    take_sizes(job, offer);
    TAILQ_INSERT_TAIL(&jobs->list, job, link);
    jobs->count++;
    if (!check_profile(jobs, offer, &job->failure) || !check_spec(&job->spec, &job->failure))
        job_settle(job, JOB_FAILED);
    else
        advance(jobs);
    return true;
}

bool jobs_offer(struct jobs *jobs, const Pathfarm__Job *offer, struct err *err)
{
    struct digest digest;
    if (!digest_from_bytes(&digest, offer->digest.data, offer->digest.len))
        return err_set(err, ERR_MESSAGE, "a job digest of %zu bytes", offer->digest.len);
    if (jobs_by_id(jobs, offer->job_id) != NULL || jobs_by_digest(jobs, &digest) != NULL)
        return err_set(err, ERR_MESSAGE, "job %" PRIu64 " is offered twice", offer->job_id);

    struct job *job;
    TAILQ_FOREACH(job, &jobs->list, link)
    if (digest_equal(&job->digest, &digest) && !job->unwanted)
        break;
    if (job == NULL)
        return take_new(jobs, offer, err);
    job->offered = true;
    job->id = offer->job_id;
    if (job->state == JOB_READY)
        jobs->events.on_settled(jobs->owner, job);
    else if (job->state == JOB_FETCHING)
        ask(jobs);
    else
        advance(jobs);
    return true;
}

bool jobs_slice(struct jobs *jobs, const Pathfarm__ObjectSlice *slice, const void *data,
                size_t size, struct err *err)
{
    struct job *job = jobs->current;
    if (job == NULL || job->state != JOB_FETCHING || jobs->outstanding == 0) {
        if (jobs->stale == 0)
            return err_set(err, ERR_MESSAGE, "a slice that nobody asked for");
        jobs->stale--;
        return true;
    }
    struct err why;
    if (!assembly_slice(job->assembly, slice, data, size, &why)) {
        if (why.code == ERR_MESSAGE && jobs->stale > 0) {
            jobs->stale--; /* asked for by a job that is gone since */
            return true;
        }
        if (why.code == ERR_MEMORY) {
            job->failure = why;
            jobs->stale += jobs->outstanding - 1;
            jobs->outstanding = 0;
            job_settle(job, JOB_FAILED);
            advance(jobs);
            return true;
        }
        *err = why;
        return false;
    }
    jobs->outstanding--;
    if (assembly_complete(job->assembly))
        job_prepare(job);
    else
        ask(jobs);
    return true;
}

void jobs_done(struct jobs *jobs, struct job *job)
{
    job_drop(job);
    advance(jobs);
}

void jobs_disconnected(struct jobs *jobs)
{
    struct job *job, *next;
    jobs->outstanding = 0;
    jobs->stale = 0;
    for (job = TAILQ_FIRST(&jobs->list); job != NULL; job = next) {
        next = TAILQ_NEXT(job, link);
        job->offered = false;
        if (job->state == JOB_FETCHING)
            assembly_forget_wishes(job->assembly);
        if (job->state == JOB_FAILED || job->state == JOB_QUEUED)
            job_drop(job); /* offered again, they get another chance */
    }
}

struct job *jobs_by_id(struct jobs *jobs, uint64_t id)
{
    struct job *job;
    TAILQ_FOREACH(job, &jobs->list, link)
    if (job->offered && job->id == id)
        return job;
    return NULL;
}

struct job *jobs_by_digest(struct jobs *jobs, const struct digest *digest)
{
    struct job *job;
    TAILQ_FOREACH(job, &jobs->list, link)
    if (job->offered && digest_equal(&job->digest, digest))
        return job;
    return NULL;
}

struct job *jobs_by_rendering(struct jobs *jobs, const struct pool_job *rendering)
{
    struct job *job;
    TAILQ_FOREACH(job, &jobs->list, link)
    if (job->state == JOB_READY && job->rendering == rendering && !job->unwanted)
        return job;
    return NULL;
}
