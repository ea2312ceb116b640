#include "worker/session.h"

#include "common/err.h"
#include "common/hash.h"
#include "common/job.h"
#include "proto/channel.h"
#include "proto/frame.h"
#include "proto/version.h"
#include "worker/jobs.h"
#include "worker/journal.h"
#include "worker/memory.h"
#include "worker/outbox.h"
#include "worker/pool.h"
#include "worker/profile.h"
#include "worker/renderer.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* A master may keep a worker waiting while its own first one pins the numeric profile */
#define GREETING_MS 120000

/* How long a draining worker finishes what it began and waits to hear that it was accepted; about
 * a second of work is what it holds */
#define DRAIN_MS 10000

/* Heartbeats come no faster than this, whatever the master wants */
#define BEAT_MIN_MS 10

/* A connection that lasted so long was a good one: the next attempts begin with short pauses */
#define GOOD_MS 5000

/* What a master may ask for at most; more would be a flood */
#define NODES_MAX 65536

/* Leaves a node may reach up to: sample numbers stay far below 64 bits */
#define LEAF_BITS 48

struct session {
    uv_loop_t *loop;
    struct session_options options;
    void (*on_end)(void *owner, int status);
    void *owner;

    struct pool *pool;
    struct jobs *jobs;
    struct outbox *outbox;
    struct channel *channel; /* NULL while there is none */
    uv_async_t finished;     /* the pool has something */
    uv_timer_t retry;        /* the next attempt to connect */
    uv_timer_t heartbeat;
    uv_timer_t deadline; /* of the first connection (--once), or of draining */
    unsigned open_handles;

    uint64_t nonce;   /* names this process to masters */
    uint64_t epoch;   /* the largest seen */
    unsigned attempt; /* since the last connection that was good for something */
    bool opened;      /* ever, on any connection */
    bool draining, ending;
    int status;

    /* Of this connection */
    bool closing;        /* it was told to close: nothing more is sent or heard */
    struct err broken;   /* why this side ends it; ERR_OK: it does not */
    uint64_t welcome_ms; /* 0: not yet */
    uint64_t sent_through, accepted_through; /* sequence numbers of results */

    uint64_t leases[LIMIT_PROGRESS_LEASES];
};

static void on_deadline(uv_timer_t *timer);
static void session_connect(struct session *session);
static void session_end(struct session *session, int status);

/* ---- sending ---- */

static bool is_working(const struct session *session)
{
    return session->channel != NULL && !session->closing &&
           channel_phase(session->channel) == PHASE_WORKING;
}

/* protobuf-c's messages have no const, but sending only reads them */
static char *unconst(const char *text)
{
    return (char *)(uintptr_t)text;
}

static void set_bytes(ProtobufCBinaryData *field, const void *bytes, size_t size)
{
    field->data = (uint8_t *)(uintptr_t)bytes;
    field->len = size;
}

/* Control messages always find room: results leave half of the queue free. */
static void send_message(struct session *session, const ProtobufCMessage *message)
{
    struct err err;
    if (!channel_send(session->channel, message, NULL, &err))
        channel_fail(session->channel, &err);
}

static void hang_up(struct session *session)
{
    session->closing = true;
    channel_close(session->channel);
}

static void send_hello(struct session *session)
{
    char host[256] = "", build[128];
    gethostname(host, sizeof(host) - 1);
    snprintf(build, sizeof(build), "pathfarm %s, %s", PATHFARM_VERSION, __VERSION__);
    uint64_t total = memory_total();

    Pathfarm__Hello hello = PATHFARM__HELLO__INIT;
    hello.protocol_min = PROTOCOL_MIN;
    hello.protocol_max = PROTOCOL_MAX;
    hello.build = build;
    set_bytes(&hello.profile, session->options.profile->digest,
              sizeof(session->options.profile->digest));
    hello.profile_text = unconst(session->options.profile->text);
    hello.host = host;
    hello.cores = session->options.threads;
    hello.memory_bytes = session->options.max_memory < total ? session->options.max_memory : total;
    hello.process_nonce = session->nonce;
    hello.outbox_results = outbox_count(session->outbox);
    send_message(session, &hello.base);
}

static void send_job_ready(struct session *session, const struct job *job)
{
    Pathfarm__JobReady ready = PATHFARM__JOB_READY__INIT;
    ready.job_id = job->id;
    ready.memory_bytes = memory_resident();
    ready.load_seconds = job->load_seconds;
    ready.cached = job->cached;
    if (job->state == JOB_FAILED) {
        ready.code = job->failure.code;
        ready.reason = unconst(job->failure.text);
    }
    send_message(session, &ready.base);
}

static void send_node_failed(struct session *session, const struct job *job, uint64_t lease_id,
                             const struct node_id *id, const struct err *why)
{
    journal_say(JOURNAL_NEWS, "tile %u, replicate %u, level %u, index %" PRIu64 " failed: %s",
                id->tile, id->replicate, id->level, id->index, why->text);
    if (!is_working(session) || !job->offered)
        return; /* a master that lost us has put the node back in line */
    Pathfarm__Node node = PATHFARM__NODE__INIT;
    node.tile = id->tile;
    node.replicate = id->replicate;
    node.level = id->level;
    node.index = id->index;
    Pathfarm__NodeFailed failed = PATHFARM__NODE_FAILED__INIT;
    failed.lease_id = lease_id;
    failed.job_id = job->id;
    failed.node = &node;
    failed.code = why->code;
    failed.reason = unconst(why->text);
    send_message(session, &failed.base);
}

static bool send_result(struct session *session, struct outbox_entry *entry, struct err *err)
{
    Pathfarm__Node node = PATHFARM__NODE__INIT;
    node.tile = entry->node.tile;
    node.replicate = entry->node.replicate;
    node.level = entry->node.level;
    node.index = entry->node.index;
    Pathfarm__Result result = PATHFARM__RESULT__INIT;
    result.lease_id = entry->lease_id;
    result.job_id = jobs_by_digest(session->jobs, &entry->job)->id;
    set_bytes(&result.job_digest, entry->job.bytes, sizeof(entry->job.bytes));
    result.node = &node;
    set_bytes(&result.checksum, entry->checksum, sizeof(entry->checksum));
    result.sequence = entry->sequence;
    result.core_seconds = entry->core_seconds;

    struct channel_bulk bulk = {
        .data = entry->bulk, .size = entry->size, .release = outbox_give_back, .context = entry
    };
    outbox_lend(entry);
    if (channel_send(session->channel, &result.base, &bulk, err))
        return true;
    outbox_give_back(entry);
    return false;
}

static bool is_wanted(void *owner, const struct digest *digest)
{
    const struct session *session = owner;
    const struct job *job = jobs_by_digest(session->jobs, digest);
    return job != NULL && job->state == JOB_READY;
}

/* Begin no node that has no place in the outbox, or that a draining worker would hand back. */
static void make_allowance(struct session *session)
{
    pool_allow(session->pool, session->draining ? 0 : outbox_room(session->outbox));
}

/* Send results while the channel takes them; on_drain goes on with the rest. */
static void flush(struct session *session)
{
    struct outbox_entry *entry;
    struct err err;
    size_t room = channel_limits_default().queue_bytes / 2;
    while (is_working(session) && channel_queued(session->channel) < room &&
           (entry = outbox_next(session->outbox, is_wanted, session)) != NULL) {
        outbox_number(session->outbox, entry);
        if (!send_result(session, entry, &err)) {
            channel_fail(session->channel, &err);
            return;
        }
        session->sent_through = entry->sequence;
    }
}

/* ---- draining ---- */

static void say_goodbye(struct session *session, const char *reason)
{
    Pathfarm__Goodbye goodbye = PATHFARM__GOODBYE__INIT;
    goodbye.reason = unconst(reason);
    send_message(session, &goodbye.base);
    session_end(session, 0);
}

static bool all_is_handed_in(struct session *session)
{
    return pool_nodes(session->pool) == 0 &&
           outbox_next(session->outbox, is_wanted, session) == NULL &&
           session->accepted_through >= session->sent_through;
}

static void check_drained(struct session *session)
{
    if (!session->draining || session->ending)
        return;
    if (!is_working(session))
        session_end(session, 0);
    else if (all_is_handed_in(session))
        say_goodbye(session, "the worker was told to stop");
}

void session_drain(struct session *session)
{
    if (session->draining || session->ending)
        return;
    session->draining = true;
    size_t dropped = pool_revoke_all(session->pool);
    journal_say(JOURNAL_NEWS, "stopping: %zu nodes to finish, %zu handed back",
                pool_nodes(session->pool), dropped);
    make_allowance(session);
    uv_timer_stop(&session->retry);
    uv_timer_start(&session->deadline, on_deadline, DRAIN_MS, 0);
    check_drained(session);
}

/* ---- what the pool and the jobs say ---- */

static void take_result(struct session *session, struct pool_result *result)
{
    struct job *job = jobs_by_rendering(session->jobs, result->job);
    if (job == NULL)
        return; /* pool_job_close dropped its nodes; nothing comes of them any more */
    struct err err = result->err;
    if (result->sums == NULL ||
        !outbox_add(session->outbox, &job->digest, result->lease_id, &result->node, result->sums,
                    result->core_seconds, &err))
        send_node_failed(session, job, result->lease_id, &result->node, &err);
}

static void on_finished(uv_async_t *async)
{
    struct session *session = async->data;
    struct pool_result result;
    if (session->pool == NULL || session->jobs == NULL)
        return;
    while (pool_take(session->pool, &result)) {
        take_result(session, &result);
        node_sums_free(result.sums);
    }
    flush(session);
    make_allowance(session);
    check_drained(session);
}

static void on_settled(void *owner, struct job *job)
{
    struct session *session = owner;
    if (job->state == JOB_READY)
        journal_say(JOURNAL_NEWS, "job \"%s\" is ready after %.2f s%s", job->title,
                    job->load_seconds, job->cached ? " (cached)" : "");
    else
        journal_say(JOURNAL_PROBLEM, "job \"%s\" cannot be rendered here: %s", job->title,
                    job->failure.text);
    if (!is_working(session))
        return;
    send_job_ready(session, job);
    flush(session);
}

static void on_wish(void *owner, const Pathfarm__ObjectWanted *wish)
{
    struct session *session = owner;
    if (is_working(session))
        send_message(session, &wish->base);
}

/* ---- what the master says ---- */

static void on_heartbeat(uv_timer_t *timer)
{
    struct session *session = timer->data;
    if (!is_working(session))
        return;
    Pathfarm__Progress progress = PATHFARM__PROGRESS__INIT;
    progress.samples = pool_samples(session->pool);
    progress.leases = session->leases;
    progress.n_leases = pool_leases(session->pool, session->leases, LIMIT_PROGRESS_LEASES);
    progress.resident_bytes = memory_resident();
    progress.core_seconds = pool_core_seconds(session->pool);
    send_message(session, &progress.base);
}

static bool on_welcome(struct session *session, const void *message, const struct frame *frame,
                       struct err *err)
{
    const Pathfarm__Welcome *welcome = message;
    (void)frame;
    if (welcome->protocol < PROTOCOL_MIN || welcome->protocol > PROTOCOL_MAX)
        return err_set(err, ERR_MESSAGE, "the master chose protocol %u, this worker speaks %d..%d",
                       welcome->protocol, PROTOCOL_MIN, PROTOCOL_MAX);
    if (welcome->epoch < session->epoch)
        return err_set(err, ERR_MESSAGE,
                       "the master's epoch is %" PRIu64 ", and %" PRIu64
                       " was seen before: it is an old one come back",
                       welcome->epoch, session->epoch);
    session->epoch = welcome->epoch;
    session->welcome_ms = uv_now(session->loop);
    channel_set_phase(session->channel, PHASE_WORKING);
    if (welcome->dead_after_ms > 0)
        channel_set_silence(session->channel, welcome->dead_after_ms);
    uint32_t beat_ms = welcome->heartbeat_ms < BEAT_MIN_MS ? BEAT_MIN_MS : welcome->heartbeat_ms;
    uv_timer_start(&session->heartbeat, on_heartbeat, beat_ms, beat_ms);
    journal_say(JOURNAL_NEWS, "connected to %s (pathfarm %s)%s", channel_peer(session->channel),
                welcome->build, channel_is_tls(session->channel) ? ", TLS" : "");
    return true;
}

static bool on_refused(struct session *session, const void *message, const struct frame *frame,
                       struct err *err)
{
    const Pathfarm__Refused *refused = message;
    (void)session;
    (void)frame;
    enum err_code code = ERR_PEER;
    err_from_wire(refused->code, &code);
    return err_set(err, code, "the master refuses: %s", refused->reason);
}

static bool on_job(struct session *session, const void *message, const struct frame *frame,
                   struct err *err)
{
    (void)frame;
    return jobs_offer(session->jobs, message, err);
}

static bool on_object_slice(struct session *session, const void *message, const struct frame *frame,
                            struct err *err)
{
    return jobs_slice(session->jobs, message, frame->bulk, frame->bulk_size, err);
}

/* Nodes as a message names them; free() what is returned. NULL and err when memory runs out. */
static struct node_id *nodes_of(Pathfarm__Node *const *nodes, size_t count, struct err *err)
{
    struct node_id *list = calloc(count + 1, sizeof(*list));
    if (list == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a list of %zu nodes", count);
        return NULL;
    }
    for (size_t i = 0; i < count; i++)
        list[i] = (struct node_id){ .tile = nodes[i]->tile,
                                    .replicate = nodes[i]->replicate,
                                    .level = nodes[i]->level,
                                    .index = nodes[i]->index };
    return list;
}

static bool check_nodes(const struct job *job, const struct node_id *nodes, size_t count,
                        struct err *err)
{
    for (size_t i = 0; i < count; i++)
        if (nodes[i].tile >= job->tiles || nodes[i].replicate >= job_sequences(&job->spec) ||
            nodes[i].level > NODE_LEVEL_MAX || nodes[i].index >> (LEAF_BITS - nodes[i].level) != 0)
            return err_set(err, ERR_MESSAGE,
                           "a lease of tile %u, replicate %u, level %u, index %" PRIu64
                           ", which the job does not have",
                           nodes[i].tile, nodes[i].replicate, nodes[i].level, nodes[i].index);
    return true;
}

static bool on_lease(struct session *session, const void *message, const struct frame *frame,
                     struct err *err)
{
    const Pathfarm__Lease *lease = message;
    const struct job *job = jobs_by_id(session->jobs, lease->job_id);
    (void)frame;
    if (lease->epoch != session->epoch)
        return err_set(err, ERR_MESSAGE, "a lease of epoch %" PRIu64 " in epoch %" PRIu64,
                       lease->epoch, session->epoch);
    if (job == NULL || job->state != JOB_READY)
        return err_set(err, ERR_MESSAGE, "a lease for job %" PRIu64 ", which is not ready here",
                       lease->job_id);
    if (lease->n_nodes > LIMIT_LEASE_NODES || pool_nodes(session->pool) > NODES_MAX)
        return err_set(err, ERR_LIMIT, "leases of too many nodes");
    if (session->draining)
        return true; /* the goodbye to come hands it back */

    struct node_id *nodes = nodes_of(lease->nodes, lease->n_nodes, err);
    if (nodes == NULL)
        return false;
    bool added = check_nodes(job, nodes, lease->n_nodes, err) &&
                 pool_add(session->pool, job->rendering, lease->lease_id, nodes, lease->n_nodes,
                          err);
    free(nodes);
    if (!added)
        return false;

    /* Old results of jobs that this master does not offer must not block its leases */
    size_t dropped = outbox_make_room(session->outbox, is_wanted, session);
    if (dropped > 0)
        journal_say(JOURNAL_NEWS, "%zu results that nobody asks for were dropped", dropped);
    make_allowance(session);
    journal_say(JOURNAL_DETAIL, "lease %" PRIu64 ": %zu nodes", lease->lease_id, lease->n_nodes);
    return true;
}

static bool on_revoke(struct session *session, const void *message, const struct frame *frame,
                      struct err *err)
{
    const Pathfarm__Revoke *revoke = message;
    (void)frame;
    struct node_id *nodes = nodes_of(revoke->nodes, revoke->n_nodes, err);
    if (nodes == NULL)
        return false;
    size_t dropped = pool_revoke(session->pool, revoke->lease_id, nodes, revoke->n_nodes);
    free(nodes);
    journal_say(JOURNAL_DETAIL, "lease %" PRIu64 ": %zu nodes revoked, %zu of them in time",
                revoke->lease_id, revoke->n_nodes, dropped);
    return true;
}

static bool on_accepted(struct session *session, const void *message, const struct frame *frame,
                        struct err *err)
{
    const Pathfarm__Accepted *accepted = message;
    (void)frame;
    if (accepted->epoch != session->epoch)
        return err_set(err, ERR_MESSAGE, "results accepted in epoch %" PRIu64 ", not %" PRIu64,
                       accepted->epoch, session->epoch);
    if (accepted->accepted_through > outbox_sequence(session->outbox) ||
        accepted->durable_through > accepted->accepted_through)
        return err_set(err, ERR_MESSAGE,
                       "results accepted through %" PRIu64 ", durable through %" PRIu64
                       ", of %" PRIu64 " sent",
                       accepted->accepted_through, accepted->durable_through,
                       outbox_sequence(session->outbox));
    session->accepted_through = accepted->accepted_through;
    outbox_forget_through(session->outbox, accepted->durable_through);
    make_allowance(session);
    check_drained(session);
    return true;
}

static bool on_job_done(struct session *session, const void *message, const struct frame *frame,
                        struct err *err)
{
    const Pathfarm__JobDone *done = message;
    struct job *job = jobs_by_id(session->jobs, done->job_id);
    (void)frame;
    (void)err;
    if (job == NULL)
        return true; /* forgotten already is as good */
    journal_say(JOURNAL_NEWS, "job \"%s\" is done", job->title);
    outbox_forget_job(session->outbox, &job->digest);
    jobs_done(session->jobs, job);
    make_allowance(session);
    check_drained(session);
    return true;
}

static bool on_goodbye(struct session *session, const void *message, const struct frame *frame,
                       struct err *err)
{
    const Pathfarm__Goodbye *goodbye = message;
    (void)frame;
    (void)err;
    journal_say(JOURNAL_NEWS, "the master says goodbye: %s", goodbye->reason);
    if (session->options.once || session->draining)
        session_end(session, 0);
    else
        hang_up(session);
    return true;
}

/* Who may send what when is proto/frame.h's table; this one says what is done about it. */
typedef bool handler(struct session *session, const void *message, const struct frame *frame,
                     struct err *err);
static handler *const handlers[] = {
    [PATHFARM__KIND__KIND_WELCOME] = on_welcome,
    [PATHFARM__KIND__KIND_REFUSED] = on_refused,
    [PATHFARM__KIND__KIND_JOB] = on_job,
    [PATHFARM__KIND__KIND_OBJECT_SLICE] = on_object_slice,
    [PATHFARM__KIND__KIND_LEASE] = on_lease,
    [PATHFARM__KIND__KIND_REVOKE] = on_revoke,
    [PATHFARM__KIND__KIND_ACCEPTED] = on_accepted,
    [PATHFARM__KIND__KIND_JOB_DONE] = on_job_done,
    [PATHFARM__KIND__KIND_GOODBYE] = on_goodbye,
};

/* Tell the master why, unless it was the one who ended it, and close. */
static void break_off(struct session *session, const struct err *why, bool tell)
{
    session->broken = *why;
    if (tell) {
        Pathfarm__Refused refused = PATHFARM__REFUSED__INIT;
        refused.code = why->code;
        refused.reason = unconst(why->text);
        channel_send(session->channel, &refused.base, NULL, NULL); /* only a courtesy */
    }
    hang_up(session);
}

static bool on_frame(void *owner, struct channel *channel, const struct frame *frame,
                     struct err *err)
{
    struct session *session = owner;
    (void)channel;
    if (session->closing)
        return true;
    size_t kind = (size_t)frame->kind;
    if (kind >= sizeof(handlers) / sizeof(handlers[0]) || handlers[kind] == NULL)
        return err_set(err, ERR_MESSAGE, "a master does not send %s", frame_kind_name(frame->kind));
    void *message = frame_message(frame, err);
    if (message == NULL)
        return false;
    struct err why;
    bool ok = handlers[kind](session, message, frame, &why);
    frame_message_free(message);
    if (!ok)
        break_off(session, &why, kind != PATHFARM__KIND__KIND_REFUSED);
    return true;
}

/* ---- connecting and reconnecting ---- */

static void on_open(void *owner, struct channel *channel)
{
    struct session *session = owner;
    (void)channel;
    session->opened = true;
    if (!session->draining)
        uv_timer_stop(&session->deadline);
    send_hello(session);
}

static void on_drain(void *owner, struct channel *channel)
{
    (void)channel;
    flush(owner);
}

static void on_retry(uv_timer_t *timer)
{
    session_connect(timer->data);
}

/* Twice as long after every failure, and spread, so that a farm's workers do not come all at once
 * when their master is back. */
static uint64_t retry_pause_ms(struct session *session)
{
    uint64_t pause_ms = session->options.retry_min_ms;
    for (unsigned i = 0; i < session->attempt && pause_ms < session->options.retry_max_ms; i++)
        pause_ms *= 2;
    if (pause_ms > session->options.retry_max_ms)
        pause_ms = session->options.retry_max_ms;
    session->attempt++;
    double spread = hash64_unit(hash64(session->nonce, uv_hrtime()));
    return (uint64_t)((double)pause_ms * (0.5 + 0.5 * spread));
}

static void schedule_retry(struct session *session, const struct err *why)
{
    uint64_t pause_ms = retry_pause_ms(session);
    /* A master that is not there is news once, not every half minute */
    bool away = why->code == ERR_PEER || why->code == ERR_TIMEOUT;
    enum journal_level level = !away                   ? JOURNAL_PROBLEM
                               : session->attempt <= 1 ? JOURNAL_NEWS
                                                       : JOURNAL_DETAIL;
    journal_say(level, "%s; trying again in %.1f s", why->text, 1e-3 * (double)pause_ms);
    uv_timer_start(&session->retry, on_retry, pause_ms, 0);
}

static void on_close(void *owner, struct channel *channel, const struct err *err)
{
    struct session *session = owner;
    struct err why = session->broken.code != ERR_OK ? session->broken : *err;
    (void)channel;
    if (why.code == ERR_OK)
        err_set(&why, ERR_PEER, "the connection is closed");
    if (session->welcome_ms != 0 && uv_now(session->loop) - session->welcome_ms >= GOOD_MS)
        session->attempt = 0;
    session->channel = NULL;
    session->closing = false;
    err_clear(&session->broken);
    session->welcome_ms = 0;
    session->sent_through = session->accepted_through = 0;
    uv_timer_stop(&session->heartbeat);
    pool_revoke_all(session->pool); /* the master has put them back in line */
    outbox_rewind(session->outbox);
    if (session->ending) {
        session_end(session, session->status);
        return;
    }
    jobs_disconnected(session->jobs);
    if (session->draining) {
        session_end(session, 0);
        return;
    }
    /* Without keys a master elsewhere will not do tomorrow either */
    bool hopeless = !session->opened && why.code == ERR_AUTH && session->options.keys == NULL;
    if (hopeless || (session->options.once && session->opened)) {
        journal_say(JOURNAL_PROBLEM, "%s", why.text);
        session_end(session, 1);
        return;
    }
    schedule_retry(session, &why);
}

static const struct channel_events channel_callbacks = {
    .on_open = on_open,
    .on_frame = on_frame,
    .on_drain = on_drain,
    .on_close = on_close,
};

static void session_connect(struct session *session)
{
    struct channel_options options = {
        .keys = session->options.keys,
        .peers = ROLE_MASTER,
        .limits = channel_limits_default(),
    };
    options.limits.greeting_ms = GREETING_MS;
    struct err err;
    session->channel = channel_connect(session->loop, session->options.host, session->options.port,
                                       &options, &channel_callbacks, session, &err);
    if (session->channel != NULL)
        return;
    if (err.code == ERR_MEMORY) {
        schedule_retry(session, &err);
        return;
    }
    journal_say(JOURNAL_PROBLEM, "%s", err.text);
    session_end(session, 2);
}

static void on_deadline(uv_timer_t *timer)
{
    struct session *session = timer->data;
    if (session->draining) {
        if (is_working(session))
            say_goodbye(session, "the worker was told to stop and could not finish in time");
        else
            session_end(session, 0);
        return;
    }
    journal_say(JOURNAL_PROBLEM, "no connection to %s port %u within %.1f s", session->options.host,
                session->options.port, 1e-3 * session->options.once_connect_ms);
    session_end(session, 1);
}

/* ---- beginning and end ---- */

static void on_handle_closed(uv_handle_t *handle)
{
    struct session *session = handle->data;
    if (--session->open_handles == 0)
        session->on_end(session->owner, session->status);
}

static void on_jobs_closed(void *owner)
{
    struct session *session = owner;
    session->jobs = NULL;
    pool_free(session->pool);
    session->pool = NULL;
    outbox_free(session->outbox);
    session->outbox = NULL;
    uv_close((uv_handle_t *)&session->finished, on_handle_closed);
    uv_close((uv_handle_t *)&session->retry, on_handle_closed);
    uv_close((uv_handle_t *)&session->heartbeat, on_handle_closed);
    uv_close((uv_handle_t *)&session->deadline, on_handle_closed);
}

/* Close the channel, then (called again by on_close) everything else. */
static void session_end(struct session *session, int status)
{
    session->ending = true;
    session->status = status;
    uv_timer_stop(&session->retry);
    uv_timer_stop(&session->deadline);
    if (session->channel != NULL)
        hang_up(session);
    else
        jobs_close(session->jobs);
}

static void wake(void *finished)
{
    uv_async_send(finished);
}

struct session_options session_options_default(void)
{
    return (struct session_options){
        .cache_quota = 16 * LIMIT_GIB,
        .max_memory = UINT64_MAX,
        .outbox_results = 4096,
        .once_connect_ms = 5000,
        .retry_min_ms = 250,
        .retry_max_ms = 30000,
    };
}

struct session *session_new(uv_loop_t *loop, const struct session_options *options,
                            void (*on_end)(void *owner, int status), void *owner, struct err *err)
{
    static const struct jobs_events jobs_callbacks = { .on_settled = on_settled,
                                                       .on_wish = on_wish,
                                                       .on_closed = on_jobs_closed };
    struct jobs_options jobs_options = {
        .renderer = options->renderer,
        .profile = options->profile,
        .threads = options->threads,
        .cache_dir = options->cache_dir,
        .cache_quota = options->cache_quota,
        .max_memory = options->max_memory,
    };
    struct session *session = calloc(1, sizeof(*session));
    if (session == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a session");
        goto fail_alloc;
    }
    session->loop = loop;
    session->options = *options;
    session->on_end = on_end;
    session->owner = owner;
    if (uv_random(NULL, NULL, &session->nonce, sizeof(session->nonce), 0, NULL) != 0) {
        err_set(err, ERR_IO, "the system has no random numbers");
        goto fail_pool;
    }
    session->pool = pool_new(options->threads, wake, &session->finished, err);
    if (session->pool == NULL)
        goto fail_pool;
    session->jobs = jobs_new(loop, session->pool, &jobs_options, &jobs_callbacks, session);
    session->outbox = outbox_new(options->outbox_results);
    if (session->jobs == NULL || session->outbox == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a session");
        goto fail_parts;
    }
    int status = uv_async_init(loop, &session->finished, on_finished);
    if (status != 0) {
        err_set(err, ERR_IO, "event loop: %s", uv_strerror(status));
        goto fail_parts;
    }
    uv_timer_init(loop, &session->retry);
    uv_timer_init(loop, &session->heartbeat);
    uv_timer_init(loop, &session->deadline);
    session->finished.data = session->retry.data = session;
    session->heartbeat.data = session->deadline.data = session;
    session->open_handles = 4;

    make_allowance(session);
    if (options->once)
        uv_timer_start(&session->deadline, on_deadline, options->once_connect_ms, 0);
    session_connect(session);
    return session;

fail_parts:
    outbox_free(session->outbox);
    free(session->jobs); /* nothing is in it yet */
    pool_free(session->pool);
fail_pool:
    free(session);
fail_alloc:
    return NULL;
}

void session_free(struct session *session)
{
    free(session);
}
