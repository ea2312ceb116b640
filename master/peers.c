#include "master/peers.h"

#include "common/job.h"
#include "master/dues.h"
#include "master/film.h"
#include "master/intake.h"
#include "master/tile_plan.h"
#include "proto/bundle.h"
#include "proto/node_wire.h"
#include "proto/version.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NODE_CREDIT_MIN 64
#define NODE_CREDIT_MAX 8192
#define LOCAL_NEWS_MS   2000  /* how long a lost local worker's end is waited for */
#define PEERS_MAX       4096  /* connections, and */
#define RECORDS_MAX     65536 /* different worker processes: hostile ones fill no memory */

static const char *name_of(const struct peer *peer)
{
    return channel_peer(peer->channel);
}

static void set_bytes(ProtobufCBinaryData *out, const void *bytes, size_t size)
{
    out->data = (uint8_t *)bytes; /* only read by the encoder */
    out->len = size;
}

/* ---- the end of a session */

static void stop_rendering(struct peer *peer)
{
    if (peer->worker != NULL)
        scheduler_worker_left(peer->farm->scheduler, peer->worker, peer->crash != 0);
    peer->worker = NULL;
}

static void peer_free(struct peer *peer)
{
    struct farm *farm = peer->farm;
    stop_rendering(peer);
    TAILQ_REMOVE(&farm->peers, peer, link);
    farm->peer_count--;
    free(peer);
    farm_peer_freed(farm);
}

static void on_close(void *owner, struct channel *channel, const struct err *err)
{
    struct peer *peer = owner;
    struct farm *farm = peer->farm;
    if (err->code != ERR_OK && !farm->closing)
        farm_say(farm, "%s: disconnected: %s", channel_peer(channel), err->text);
    farm->closed_bytes_in += channel_bytes_in(channel);
    farm->closed_bytes_out += channel_bytes_out(channel);
    transfers_leave(farm->transfers, &peer->transfer);
    if (peer->record != NULL)
        peer->record->connected = false;
    peer->channel = NULL;

    /* A crash counts against the nodes it held, so hear first how its process ended */
    bool news_to_come = peer->local && peer->worker != NULL && peer->crash == 0 && !farm->closing;
    peer->state = PEER_GONE;
    peer->gone_ms = uv_now(farm->loop);
    if (!news_to_come)
        peer_free(peer);
}

/* Tell the peer why, and let it go. */
static void turn_away(struct peer *peer, const struct err *why)
{
    Pathfarm__Refused refused = PATHFARM__REFUSED__INIT;
    refused.code = why->code;
    refused.reason = (char *)why->text;
    farm_say(peer->farm, "%s: turned away: %s", name_of(peer), why->text);
    peer->state = PEER_UNFIT;
    dues_send(peer, &refused.base);
    channel_close(peer->channel);
}

static void say_goodbye(struct peer *peer, const char *reason, bool reconnect)
{
    Pathfarm__Goodbye goodbye = PATHFARM__GOODBYE__INIT;
    goodbye.reason = (char *)reason;
    goodbye.reconnect = reconnect;
    dues_send(peer, &goodbye.base);
    channel_close(peer->channel);
}

/* Not for this job. A local worker is of no other use. */
static void set_unfit(struct peer *peer, const struct err *why)
{
    farm_say(peer->farm, "%s: cannot work on this job: %s", name_of(peer), why->text);
    stop_rendering(peer);
    peer->state = PEER_UNFIT;
    if (peer->local) {
        peer->farm->local_why = *why;
        say_goodbye(peer, why->text, false);
    }
}

/* ---- greeting */

static struct farm_worker *record_of(struct farm *farm, const Pathfarm__Hello *hello)
{
    struct farm_worker *record = farm->workers;
    while (record != NULL && record->nonce != hello->process_nonce)
        record = record->next;
    if (record == NULL) {
        record = farm->worker_count < RECORDS_MAX ? calloc(1, sizeof(*record)) : NULL;
        if (record == NULL)
            return NULL;
        farm->worker_count++;
        record->nonce = hello->process_nonce;
        record->next = farm->workers;
        farm->workers = record;
    }
    snprintf(record->host, sizeof(record->host), "%s", hello->host);
    snprintf(record->build, sizeof(record->build), "%s", hello->build);
    record->cores = hello->cores;
    record->connected = true;
    return record;
}

/* A worker that reconnects may be faster than the news that its old connection is dead. */
static void drop_older_session(struct peer *peer)
{
    struct peer *other, *next;
    for (other = TAILQ_FIRST(&peer->farm->peers); other != NULL; other = next) {
        next = TAILQ_NEXT(other, link);
        if (other == peer || other->record != peer->record)
            continue;
        stop_rendering(other);
        other->record = NULL;
        if (other->channel != NULL) {
            struct err err;
            err_set(&err, ERR_PEER, "the same worker has connected again");
            channel_fail(other->channel, &err);
        }
    }
}

static void welcome(struct peer *peer)
{
    struct farm *farm = peer->farm;
    struct err err;
    uint32_t protocol;
    if (!version_choose(peer->protocol_min, peer->protocol_max, &protocol, &err)) {
        turn_away(peer, &err);
        return;
    }
    if (!farm->pinned) {
        farm->pinned = true;
        memcpy(farm->profile, peer->profile, DIGEST_SIZE);
        snprintf(farm->profile_text, sizeof(farm->profile_text), "%s", peer->profile_text);
    }
    if (memcmp(farm->profile, peer->profile, DIGEST_SIZE) != 0) {
        err_set(&err, ERR_PROFILE,
                "its numeric profile is \"%s\", the job's is \"%s\": the pictures would differ",
                peer->profile_text, farm->profile_text);
        turn_away(peer, &err);
        return;
    }

    Pathfarm__Welcome message = PATHFARM__WELCOME__INIT;
    message.protocol = protocol;
    message.epoch = farm->epoch;
    message.worker_id = farm->next_worker_id++;
    message.heartbeat_ms = farm->settings.heartbeat_ms;
    message.dead_after_ms = farm->settings.dead_after_ms;
    message.build = PATHFARM_VERSION;
    peer->state = PEER_LOADING;
    dues_send(peer, &message.base);
    channel_set_phase(peer->channel, PHASE_WORKING);

    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bundle_describe(farm->job.bundle, &job);
    job.job_id = PEERS_JOB_ID;
    set_bytes(&job.profile, farm->profile, DIGEST_SIZE);
    job.title = (char *)farm->job.title;
    dues_send(peer, &job.base);
    farm_say(farm, "%s: %s joined, %u cores, %s%s", name_of(peer), peer->record->host,
             peer->record->cores, peer->profile_text, channel_is_tls(peer->channel) ? ", TLS" : "");
}

static bool on_hello(struct peer *peer, const void *payload, const struct frame *frame,
                     struct err *err)
{
    const Pathfarm__Hello *hello = payload;
    struct farm *farm = peer->farm;
    (void)frame;
    if (peer->state != PEER_GREETING)
        return err_set(err, ERR_MESSAGE, "a second HELLO");
    if (hello->profile.len != DIGEST_SIZE)
        return err_set(err, ERR_MESSAGE, "a numeric profile of %zu bytes", hello->profile.len);
    peer->record = record_of(farm, hello);
    if (peer->record == NULL)
        return err_set(err, ERR_MEMORY, "no room for another worker");
    peer->record->pid = peer->pid;
    peer->protocol_min = hello->protocol_min;
    peer->protocol_max = hello->protocol_max;
    peer->memory_bytes = hello->memory_bytes;
    memcpy(peer->profile, hello->profile.data, DIGEST_SIZE);
    snprintf(peer->profile_text, sizeof(peer->profile_text), "%s", hello->profile_text);
    drop_older_session(peer);

    if (farm->job.local_workers && !farm->pinned && !peer->local && !farm->local_hopeless) {
        peer->state = PEER_HELD;
        return true;
    }
    welcome(peer);
    if (farm->pinned)
        peers_admit_held(farm);
    return true;
}

void peers_admit_held(struct farm *farm)
{
    struct peer *peer;
    TAILQ_FOREACH(peer, &farm->peers, link)
    {
        if (peer->state == PEER_HELD && peer->channel != NULL)
            welcome(peer);
    }
}

/* ---- the scene */

static bool on_object_wanted(struct peer *peer, const void *payload, const struct frame *frame,
                             struct err *err)
{
    const Pathfarm__ObjectWanted *wanted = payload;
    struct digest object;
    (void)frame;
    if (!digest_from_bytes(&object, wanted->digest.data, wanted->digest.len))
        return err_set(err, ERR_MESSAGE, "an object digest of %zu bytes", wanted->digest.len);
    return transfers_want(peer->farm->transfers, &peer->transfer, &object, wanted->first_slice,
                          wanted->slice_count, uv_now(peer->farm->loop), err);
}

/* How many nodes a worker may hold: an eighth of its memory. */
static uint64_t node_credit(const struct peer *peer)
{
    uint64_t size = node_sums_size(TILE_PIXELS, peer->farm->job.spec->channel_count);
    uint64_t credit = peer->memory_bytes / 8 / size;
    return credit < NODE_CREDIT_MIN   ? NODE_CREDIT_MIN
           : credit > NODE_CREDIT_MAX ? NODE_CREDIT_MAX
                                      : credit;
}

/* A code from the wire: one that nobody gave out counts as a bug of the sender. */
static struct err reported(uint32_t code, const char *reason)
{
    struct err err;
    enum err_code known = ERR_INTERNAL;
    err_from_wire(code, &known);
    err_set(&err, known, "%s", reason[0] != '\0' ? reason : err_meaning(known));
    return err;
}

static bool on_job_ready(struct peer *peer, const void *payload, const struct frame *frame,
                         struct err *err)
{
    const Pathfarm__JobReady *ready = payload;
    struct farm *farm = peer->farm;
    (void)frame;
    if (peer->state != PEER_LOADING || ready->job_id != PEERS_JOB_ID)
        return err_set(err, ERR_MESSAGE, "JOB_READY for no job that it loads");
    if (ready->code != ERR_OK) {
        struct err why = reported(ready->code, ready->reason);
        if (err_reaction(why.code) == GIVE_UP) {
            err_wrap(&why, "worker %s", peer->record->host);
            farm_end(farm, &why);
        }
        set_unfit(peer, &why);
        return true;
    }
    peer->worker = scheduler_worker_joined(farm->scheduler, peer->record->nonce,
                                           peer->record->cores, node_credit(peer), peer,
                                           uv_now(farm->loop));
    if (peer->worker == NULL)
        return err_set(err, ERR_MEMORY, "no memory for another worker");
    peer->state = PEER_READY;
    peer->record->cached = ready->cached;
    return true;
}

/* ---- results */

/* Seconds as a worker claims them: nothing a plain sum could choke on. */
static double plausible(double seconds)
{
    return isfinite(seconds) && seconds >= 0 && seconds < 1e9 ? seconds : 0;
}

static void accept_sums(struct peer *peer, const struct node_id *node, struct node_sums *sums)
{
    struct farm *farm = peer->farm;
    struct err err;
    farm->nodes++;
    farm->samples += sums->stats.samples;
    peer->record->nodes++;
    peer->record->samples += sums->stats.samples;
    if (!intake_add(farm->intake, node, sums, &err))
        farm_end(farm, &err);
}

static bool on_result(struct peer *peer, const void *payload, const struct frame *frame,
                      struct err *err)
{
    const Pathfarm__Result *result = payload;
    struct farm *farm = peer->farm;
    const struct digest *job = bundle_job_digest(farm->job.bundle);
    if (result->node == NULL)
        return err_set(err, ERR_MESSAGE, "a result for no node");
    if (result->sequence <= peer->sequence)
        return err_set(err, ERR_MESSAGE, "result %llu after %llu",
                       (unsigned long long)result->sequence, (unsigned long long)peer->sequence);
    peer->sequence = result->sequence;
    if (result->job_digest.len != DIGEST_SIZE ||
        memcmp(result->job_digest.data, job->bytes, DIGEST_SIZE) != 0)
        return true; /* of another job: refused for good */

    struct node_id node = { result->node->tile, result->node->replicate, result->node->level,
                            result->node->index };
    unsigned round;
    if (!tile_plan_job_round(film_plan(farm->job.film), &node, &round))
        return err_set(err, ERR_MESSAGE, "a result for a node that this job does not have");
    struct err why;
    if (!digest_checksum_matches(frame->bulk, frame->bulk_size, result->checksum.data,
                                 result->checksum.len)) {
        err_set(&why, ERR_DIGEST, "the sums of a node did not match their checksum");
        farm_say(farm, "%s: %s", name_of(peer), why.text);
        if (peer->worker != NULL)
            scheduler_node_failed(farm->scheduler, peer->worker, &node, &why);
        return true;
    }
    struct tile_rect rect = tile_rect(farm->job.scene, node.tile);
    struct node_sums *sums = node_wire_decode(frame->bulk, frame->bulk_size,
                                              rect.width * rect.height,
                                              farm->job.spec->channel_count, err);
    if (sums == NULL)
        return false;
    if (!intake_check(farm->intake, &node, sums, err)) {
        node_sums_free(sums);
        return false;
    }

    double core_s = plausible(result->core_seconds);
    spending_add(&farm->spending, core_s);
    peer->record->core_seconds += core_s;
    switch (scheduler_result(farm->scheduler, peer->worker, &node, result->checksum.data,
                             uv_now(farm->loop))) {
    case RESULT_ACCEPTED:
        spending_take(&farm->spending, round, core_s);
        accept_sums(peer, &node, sums);
        return true;
    case RESULT_MISMATCH:
        farm_say(farm,
                 "%s: OTHER BITS than another worker's for tile %u, replicate %u, level %u, "
                 "index %llu: one of the two computes wrongly, the first was kept",
                 name_of(peer), node.tile, node.replicate, node.level,
                 (unsigned long long)node.index);
        break;
    case RESULT_DUPLICATE:
    case RESULT_LATE:
    case RESULT_REFUSED:
        break;
    }
    node_sums_free(sums);
    return true;
}

static bool on_node_failed(struct peer *peer, const void *payload, const struct frame *frame,
                           struct err *err)
{
    const Pathfarm__NodeFailed *failed = payload;
    (void)frame;
    if (failed->node == NULL)
        return err_set(err, ERR_MESSAGE, "a failure of no node");
    if (peer->worker == NULL || failed->job_id != PEERS_JOB_ID)
        return true;
    struct err why = reported(failed->code, failed->reason);
    struct node_id node = { failed->node->tile, failed->node->replicate, failed->node->level,
                            failed->node->index };
    farm_say(peer->farm, "%s: failed at tile %u, replicate %u, level %u, index %llu: %s",
             name_of(peer), node.tile, node.replicate, node.level, (unsigned long long)node.index,
             why.text);
    scheduler_node_failed(peer->farm->scheduler, peer->worker, &node, &why);
    if (err_reaction(why.code) == GIVE_UP)
        farm_end(peer->farm, &why);
    else if (err_reaction(why.code) == UNFIT)
        set_unfit(peer, &why);
    return true;
}

static bool on_progress(struct peer *peer, const void *payload, const struct frame *frame,
                        struct err *err)
{
    const Pathfarm__Progress *progress = payload;
    (void)frame;
    (void)err;
    if (peer->worker != NULL)
        scheduler_worker_progress(peer->farm->scheduler, peer->worker, progress->samples,
                                  uv_now(peer->farm->loop));
    return true;
}

static bool on_refused(struct peer *peer, const void *payload, const struct frame *frame,
                       struct err *err)
{
    const Pathfarm__Refused *refused = payload;
    (void)frame;
    (void)err;
    farm_say(peer->farm, "%s: the worker refuses: %s", name_of(peer), refused->reason);
    channel_close(peer->channel);
    return true;
}

static bool on_goodbye(struct peer *peer, const void *payload, const struct frame *frame,
                       struct err *err)
{
    const Pathfarm__Goodbye *goodbye = payload;
    (void)frame;
    (void)err;
    farm_say(peer->farm, "%s: the worker leaves: %s", name_of(peer), goodbye->reason);
    channel_close(peer->channel);
    return true;
}

/* Which kinds a worker may send, and when, is proto/frame.h's table. */
typedef bool handler(struct peer *peer, const void *payload, const struct frame *frame,
                     struct err *err);
static handler *const HANDLERS[] = {
    [PATHFARM__KIND__KIND_HELLO] = on_hello,
    [PATHFARM__KIND__KIND_REFUSED] = on_refused,
    [PATHFARM__KIND__KIND_OBJECT_WANTED] = on_object_wanted,
    [PATHFARM__KIND__KIND_JOB_READY] = on_job_ready,
    [PATHFARM__KIND__KIND_RESULT] = on_result,
    [PATHFARM__KIND__KIND_PROGRESS] = on_progress,
    [PATHFARM__KIND__KIND_NODE_FAILED] = on_node_failed,
    [PATHFARM__KIND__KIND_GOODBYE] = on_goodbye,
};

static bool on_frame(void *owner, struct channel *channel, const struct frame *frame,
                     struct err *err)
{
    struct peer *peer = owner;
    (void)channel;
    size_t kind = (size_t)frame->kind;
    if (kind >= sizeof(HANDLERS) / sizeof(HANDLERS[0]) || HANDLERS[kind] == NULL)
        return err_set(err, ERR_MESSAGE, "a worker does not send %s", frame_kind_name(frame->kind));
    void *message = frame_message(frame, err);
    if (message == NULL)
        return false;
    bool ok = HANDLERS[kind](peer, message, frame, err);
    frame_message_free(message);
    return ok;
}

static void on_drain(void *owner, struct channel *channel)
{
    struct peer *peer = owner;
    (void)channel;
    transfers_pump(peer->farm->transfers, uv_now(peer->farm->loop));
}

static const struct channel_events EVENTS = {
    .on_frame = on_frame,
    .on_drain = on_drain,
    .on_close = on_close,
};

/* ---- doors */

static void close_unheard(void *owner, struct channel *channel, const struct err *err)
{
    (void)owner;
    (void)channel;
    (void)err;
}

static bool read_unheard(void *owner, struct channel *channel, const struct frame *frame,
                         struct err *err)
{
    (void)owner;
    (void)channel;
    (void)frame;
    return err_set(err, ERR_AUTH, "not one of our processes");
}

static const struct channel_events STRANGER = { .on_frame = read_unheard,
                                                .on_close = close_unheard };

static void drop_stranger(struct farm *farm, struct channel *channel, const struct err *why)
{
    farm_say(farm, "%s: turned away: %s", channel_peer(channel), why->text);
    channel_set_events(channel, &STRANGER, NULL);
    channel_fail(channel, why);
}

static void accept_peer(struct farm *farm, struct channel *channel, pid_t pid)
{
    struct peer *peer = farm->peer_count < PEERS_MAX ? calloc(1, sizeof(*peer)) : NULL;
    if (peer == NULL) {
        struct err err;
        err_set(&err, ERR_MEMORY, "no room for another worker");
        drop_stranger(farm, channel, &err);
        return;
    }
    peer->farm = farm;
    peer->channel = channel;
    peer->pid = pid;
    peer->local = pid != -1;
    peer->heard_ms = peer->told_ms = uv_now(farm->loop);
    transfers_join(&peer->transfer, channel);
    TAILQ_INSERT_TAIL(&farm->peers, peer, link);
    farm->peer_count++;
    channel_set_events(channel, &EVENTS, peer);
}

void peers_accept_local(void *owner, struct channel *channel)
{
    struct farm *farm = owner;
    pid_t pid = farm->events.local_pid(farm->owner, channel_peer(channel));
    if (pid == -1) {
        struct err err;
        err_set(&err, ERR_AUTH, "only local workers of this render may come in here");
        drop_stranger(farm, channel, &err);
        return;
    }
    accept_peer(farm, channel, pid);
}

void peers_accept(void *owner, struct channel *channel)
{
    accept_peer(owner, channel, -1);
}

void peers_log_refused(void *owner, const char *address, const struct err *err)
{
    farm_say(owner, "%s: turned away: %s", address, err->text);
}

/* ---- deadlines and the end */

void peers_check_deadlines(struct farm *farm, uint64_t now_ms, uint64_t stalled_ms)
{
    struct peer *peer, *next;
    struct err err;
    for (peer = TAILQ_FIRST(&farm->peers); peer != NULL; peer = next) {
        next = TAILQ_NEXT(peer, link);
        peer->heard_ms += stalled_ms;
        if (peer->channel == NULL) {
            if (now_ms - peer->gone_ms > LOCAL_NEWS_MS)
                peer_free(peer);
            continue;
        }
        if (channel_bytes_in(peer->channel) != peer->bytes_in_seen) {
            peer->bytes_in_seen = channel_bytes_in(peer->channel);
            peer->heard_ms = now_ms;
        }
        bool greeted = channel_phase(peer->channel) == PHASE_WORKING; /* else the channel knows */
        if (greeted && now_ms > peer->heard_ms + farm->settings.dead_after_ms) {
            err_set(&err, ERR_TIMEOUT, "nothing was heard for %u ms", farm->settings.dead_after_ms);
            channel_fail(peer->channel, &err);
        }
    }
    struct channel *stuck = transfers_stuck(farm->transfers, now_ms);
    if (stuck != NULL) {
        err_set(&err, ERR_TIMEOUT, "it asked for the scene and does not take it");
        channel_fail(stuck, &err);
    }
}

void peers_local_exited(struct farm *farm, pid_t pid, int crash)
{
    struct peer *peer, *next;
    for (peer = TAILQ_FIRST(&farm->peers); peer != NULL; peer = next) {
        next = TAILQ_NEXT(peer, link);
        if (!peer->local || peer->pid != pid)
            continue;
        peer->crash = crash;
        if (peer->channel == NULL)
            peer_free(peer);
    }
}

bool peers_none_left(const struct farm *farm)
{
    const struct peer *peer;
    TAILQ_FOREACH(peer, &farm->peers, link)
    {
        if (peer->channel != NULL && peer->state != PEER_UNFIT && peer->state != PEER_GREETING)
            return false;
    }
    return true;
}

void peers_dismiss(struct farm *farm)
{
    struct peer *peer, *next;
    for (peer = TAILQ_FIRST(&farm->peers); peer != NULL; peer = next) {
        next = TAILQ_NEXT(peer, link);
        if (peer->channel == NULL) {
            peer_free(peer);
            continue;
        }
        if (channel_phase(peer->channel) == PHASE_WORKING) {
            dues_acknowledge(peer);
            Pathfarm__JobDone done = PATHFARM__JOB_DONE__INIT;
            done.job_id = PEERS_JOB_ID;
            done.keep_cached = true;
            dues_send(peer, &done.base);
        }
        say_goodbye(peer, "the render is over", !peer->local);
    }
}
