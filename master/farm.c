#include "master/farm.h"

#include "common/job.h"
#include "master/dues.h"
#include "master/film.h"
#include "master/intake.h"
#include "master/peers.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define QUEUE_BYTES (8 * LIMIT_MIB) /* two slices per peer */
#define GREETING_MS 30000 /* a local worker's micro-render, for which others wait, may be slow */

struct farm_settings farm_defaults(void)
{
    return (struct farm_settings){
        .heartbeat_ms = 1000,
        .dead_after_ms = 20000,
        .schedule = scheduler_defaults(),
    };
}

void farm_say(struct farm *farm, const char *format, ...)
{
    char line[1200];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof(line), format, args);
    va_end(args);
    if (farm->events.say != NULL)
        farm->events.say(farm->owner, line);
}

void farm_end(struct farm *farm, const struct err *why)
{
    if (farm->ended || farm->closing)
        return;
    farm->ended = true;
    struct err done = { .code = ERR_OK };
    farm->events.on_end(farm->owner, why == NULL ? &done : why);
}

static void free_if_idle(struct farm *farm)
{
    if (!farm->closing || farm->open_handles > 0 || !TAILQ_EMPTY(&farm->peers))
        return;
    while (farm->workers != NULL) {
        struct farm_worker *worker = farm->workers;
        farm->workers = worker->next;
        free(worker);
    }
    transfers_free(farm->transfers);
    intake_free(farm->intake);
    scheduler_free(farm->scheduler);
    free(farm);
}

static void on_handle_closed(uv_handle_t *handle)
{
    struct farm *farm = handle->data;
    farm->open_handles--;
    free_if_idle(farm);
}

void farm_peer_freed(struct farm *farm)
{
    if (farm->closing)
        free_if_idle(farm);
    else if (farm->local_hopeless && peers_none_left(farm))
        farm_end(farm, &farm->local_why);
}

/* ---- rounds */

static double seconds_since(const struct farm *farm, uint64_t then_ms)
{
    return (double)(uv_now(farm->loop) - then_ms) / 1000;
}

static void on_round(void *owner, unsigned round)
{
    struct farm *farm = owner;
    struct err err;
    (void)round;
    uv_update_time(farm->loop);
    if (!intake_end_round(farm->intake, seconds_since(farm, farm->opened_ms), farm->core_s, &err))
        farm_end(farm, &err);
    else if (!farm->ended && farm->events.on_round != NULL)
        farm->events.on_round(farm->owner);
}

/* With a time to fill: one more round, as soon as little is left to hand out, if it is predicted to
 * fit in. */
static void consider_another_round(struct farm *farm)
{
    const struct pieces *pieces = scheduler_pieces(farm->scheduler);
    unsigned rounds = pieces_allowed(pieces) + 1;
    if (farm->job.time_s <= 0 || farm->ended || rounds > ROUND_COUNT ||
        scheduler_seconds_unleased(farm->scheduler) >
            2e-3 * farm->settings.schedule.lease_target_ms)
        return;
    double end = seconds_since(farm, farm->opened_ms) +
                 scheduler_seconds_left(farm->scheduler, rounds);
    if (!(end <= farm->job.time_s))
        return;
    film_extend(farm->job.film, rounds);
    scheduler_allow_rounds(farm->scheduler, rounds);
}

static void work(struct farm *farm)
{
    if (farm->closing || farm->ended)
        return;
    uint64_t now_ms = uv_now(farm->loop);
    struct err why;
    consider_another_round(farm);
    if (scheduler_failed(farm->scheduler, &why))
        farm_end(farm, &why);
    else if (scheduler_done(farm->scheduler))
        farm_end(farm, NULL);
    else
        dues_pump(farm, now_ms);
}

static void on_io_done(uv_check_t *check)
{
    work(check->data);
}

static uint32_t tick_interval(const struct farm_settings *settings)
{
    uint32_t ms = 100;
    uint32_t limits[] = { settings->heartbeat_ms / 2, settings->dead_after_ms / 4,
                          settings->schedule.stall_ms / 4, settings->schedule.speculate_ms };
    for (size_t i = 0; i < sizeof(limits) / sizeof(limits[0]); i++)
        ms = limits[i] < ms ? limits[i] : ms;
    return ms < 10 ? 10 : ms;
}

static void on_tick(uv_timer_t *timer)
{
    struct farm *farm = timer->data;
    uint64_t now_ms = uv_now(farm->loop);
    uint64_t gap = now_ms - farm->tick_ms;
    farm->tick_ms = now_ms;
    /* After a sleep of our own, what peers sent meanwhile still waits to be read */
    uint64_t stalled_ms = gap > farm->settings.dead_after_ms / 2 ? gap : 0;
    scheduler_tick(farm->scheduler, now_ms);
    peers_check_deadlines(farm, now_ms, stalled_ms);
    work(farm);
}

/* ---- opening and closing */

static bool open_doors(struct farm *farm, struct err *err)
{
    static const struct channel_listener_events LOCAL = { peers_accept_local, peers_log_refused };
    static const struct channel_listener_events REMOTE = { peers_accept, peers_log_refused };
    struct channel_options options = { .peers = ROLE_WORKER, .limits = channel_limits_default() };
    options.limits.silence_ms = 0; /* peers_check_deadlines knows when the silence was our own */
    options.limits.queue_bytes = QUEUE_BYTES;
    options.limits.greeting_ms = GREETING_MS;
    if (farm->job.local_workers) {
        farm->local_door = channel_listen(farm->loop, "127.0.0.1", 0, &options, &LOCAL, farm, err);
        if (farm->local_door == NULL)
            return err_wrap(err, "listening for local workers");
    }
    if (farm->settings.listen_host != NULL) {
        options.keys = farm->settings.keys;
        farm->door = channel_listen(farm->loop, farm->settings.listen_host,
                                    farm->settings.listen_port, &options, &REMOTE, farm, err);
        if (farm->door == NULL) {
            channel_listener_close(farm->local_door);
            return err_wrap(err, "listening for workers");
        }
    }
    return true;
}

struct farm *farm_open(uv_loop_t *loop, const struct farm_settings *settings,
                       const struct farm_job *job, const struct farm_events *events, void *owner,
                       struct err *err)
{
    struct farm *farm = calloc(1, sizeof(*farm));
    if (farm == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a farm");
        return NULL;
    }
    uv_update_time(loop);
    farm->loop = loop;
    farm->settings = *settings;
    farm->settings.schedule.tiles = tile_count(job->scene);
    farm->settings.schedule.replicates = job->spec->replicates;
    farm->job = *job;
    farm->events = *events;
    farm->owner = owner;
    farm->epoch = 1;
    farm->next_worker_id = 1;
    farm->opened_ms = farm->tick_ms = uv_now(loop);
    TAILQ_INIT(&farm->peers);

    err_set(err, ERR_MEMORY, "no memory for a farm");
    farm->scheduler = scheduler_new(&farm->settings.schedule, farm->opened_ms);
    if (farm->scheduler == NULL)
        goto fail_scheduler;
    farm->intake = intake_new(job->spec, job->film, on_round, farm);
    if (farm->intake == NULL)
        goto fail_intake;
    farm->transfers = transfers_new(job->bundle, QUEUE_BYTES);
    if (farm->transfers == NULL)
        goto fail_transfers;
    if (!open_doors(farm, err))
        goto fail_doors;

    err_clear(err);
    scheduler_allow_rounds(farm->scheduler, job->rounds);
    uv_timer_init(loop, &farm->tick);
    uv_check_init(loop, &farm->after_io);
    farm->tick.data = farm->after_io.data = farm;
    farm->open_handles = 2;
    uint32_t interval = tick_interval(&farm->settings);
    uv_timer_start(&farm->tick, on_tick, interval, interval);
    uv_check_start(&farm->after_io, on_io_done);
    return farm;

fail_doors:
    transfers_free(farm->transfers);
fail_transfers:
    intake_free(farm->intake);
fail_intake:
    scheduler_free(farm->scheduler);
fail_scheduler:
    free(farm);
    return NULL;
}

void farm_close(struct farm *farm)
{
    farm->closing = true;
    channel_listener_close(farm->local_door);
    channel_listener_close(farm->door);
    uv_close((uv_handle_t *)&farm->tick, on_handle_closed);
    uv_close((uv_handle_t *)&farm->after_io, on_handle_closed);
    peers_dismiss(farm);
}

unsigned farm_local_port(const struct farm *farm)
{
    return farm->local_door == NULL ? 0 : channel_listener_port(farm->local_door);
}

unsigned farm_listen_port(const struct farm *farm)
{
    return farm->door == NULL ? 0 : channel_listener_port(farm->door);
}

void farm_local_exited(struct farm *farm, pid_t pid, int crash)
{
    peers_local_exited(farm, pid, crash);
    struct err why;
    if (scheduler_failed(farm->scheduler, &why))
        farm_end(farm, &why);
}

void farm_local_hopeless(struct farm *farm, const struct err *why)
{
    farm->local_hopeless = true;
    if (farm->local_why.code == ERR_OK) /* else it was said why a local worker cannot do it */
        farm->local_why = *why;
    peers_admit_held(farm);
    if (peers_none_left(farm))
        farm_end(farm, &farm->local_why);
}

/* ---- what others ask */

struct farm_status farm_status(const struct farm *farm)
{
    const struct pieces *pieces = scheduler_pieces(farm->scheduler);
    uint64_t done = pieces_leaves_done(pieces);
    struct farm_status status = {
        .rounds_done = scheduler_sealed(farm->scheduler),
        .wall_s = seconds_since(farm, farm->opened_ms),
        .core_s = farm->core_s,
        .nodes = farm->nodes,
        .samples = farm->samples,
        .bytes_in = farm->closed_bytes_in,
        .bytes_out = farm->closed_bytes_out,
        .counts = scheduler_counts(farm->scheduler),
    };
    const struct peer *peer;
    TAILQ_FOREACH(peer, &farm->peers, link)
    {
        if (peer->channel == NULL)
            continue;
        status.workers += peer->state == PEER_LOADING || peer->state == PEER_READY;
        status.bytes_in += channel_bytes_in(peer->channel);
        status.bytes_out += channel_bytes_out(peer->channel);
    }
    double total = (double)farm->settings.schedule.tiles * farm->settings.schedule.replicates *
                   (double)round_end(pieces_allowed(pieces) - 1);
    double left = scheduler_seconds_left(farm->scheduler, pieces_allowed(pieces));
    if (farm->job.time_s > 0) {
        double share = status.wall_s / farm->job.time_s;
        status.done = share < 1 ? share : 1;
        status.seconds_left = farm->job.time_s * (1 - status.done);
    } else {
        status.done = (double)done / total;
        status.seconds_left = isfinite(left) ? left : -1;
    }
    return status;
}

const struct farm_worker *farm_workers(const struct farm *farm)
{
    return farm->workers;
}

const struct ledger_row *farm_ledger(const struct farm *farm, size_t *count)
{
    return intake_ledger(farm->intake, count);
}

const struct image *farm_picture(const struct farm *farm)
{
    return intake_picture(farm->intake);
}

const uint8_t *farm_profile(const struct farm *farm)
{
    return farm->pinned ? farm->profile : NULL;
}

const char *farm_profile_text(const struct farm *farm)
{
    return farm->profile_text;
}
