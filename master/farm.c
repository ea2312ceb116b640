#include "master/farm.h"

#include "common/job.h"
#include "common/scene.h"
#include "master/dues.h"
#include "master/film.h"
#include "master/intake.h"
#include "master/peers.h"
#include "master/tile_plan.h"

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

/* Rounds to begin with, once they are planned. */
static unsigned first_rounds(const struct farm_job *job)
{
    return limits_are_open(&job->limits) ? job->spec->pilot_rounds + 1 : job->limits.rounds;
}

/* The pilot is in: plan the rest, and let it be rendered. */
static void plan_tiles(struct farm *farm)
{
    struct err err;
    const struct tile_plan *plan = film_plan(farm->job.film);
    unsigned rounds = farm->job.limits.rounds;
    if (!film_make_plan(farm->job.film, rounds < ROUND_COUNT ? rounds : 0, &err)) {
        farm_end(farm, &err);
        return;
    }
    farm_say(farm,
             "adaptive: %u of %u tiles get twice the samples or more, %u half of them or less; "
             "predicted gain %.2f",
             tile_plan_count_from(plan, 1), plan->tiles, tile_plan_count_to(plan, -1),
             plan->predicted_gain);
    scheduler_allow_rounds(farm->scheduler, first_rounds(&farm->job));
}

static void on_round(void *owner, unsigned round)
{
    struct farm *farm = owner;
    struct err err;
    uv_update_time(farm->loop);
    if (!intake_end_round(farm->intake, seconds_since(farm, farm->opened_ms),
                          spending_until(&farm->spending, round + 1), &err)) {
        farm_end(farm, &err);
        return;
    }
    if (!film_has_picture(farm->job.film)) {
        if (round + 1 == film_plan(farm->job.film)->pilot_rounds)
            plan_tiles(farm);
        return;
    }
    if (!farm->ended && farm->events.on_round != NULL)
        farm->events.on_round(farm->owner);
    size_t count;
    const struct ledger_row *rows = farm_ledger(farm, &count);
    if (!farm->ended && limits_met(&farm->job.limits, &rows[count - 1])) {
        intake_stop(farm->intake);
        farm->stopped_by = LIMIT_ERROR;
        farm_end(farm, NULL);
    }
}

/* What the farm expects to spend until so many rounds have ended. */
static double core_s_left(const struct farm *farm, unsigned rounds)
{
    const struct scheduler_settings *s = &farm->settings.schedule;
    double leaves = (double)pieces_leaves_done(scheduler_pieces(farm->scheduler));
    return spending_left(&farm->spending, scheduler_sealed(farm->scheduler), rounds,
                         leaves / ((double)s->tiles * farm->job.spec->replicates));
}

/* Would the picture of the allowed rounds be one too few? Ahead of the verdict on it only where
 * that is likely, or nothing is known yet: what is rendered beyond the last round is lost. */
static bool wants_another_round(const struct farm *farm, unsigned allowed)
{
    unsigned sealed = scheduler_sealed(farm->scheduler);
    if (farm->job.limits.relmse <= 0 || sealed == allowed)
        return true;
    size_t count;
    const struct ledger_row *rows = farm_ledger(farm, &count);
    struct predict_job job = farm_predict_job(farm);
    double chance = predict_chance(&job, rows, count, allowed);
    return isnan(chance) ? allowed < sealed + 2 : chance < 0.5;
}

/* Where rounds are decided on one by one: one more, as soon as little is left to hand out. What
 * forbids it, or LIMIT_NONE. */
static enum limit consider_another_round(struct farm *farm)
{
    const struct pieces *pieces = scheduler_pieces(farm->scheduler);
    unsigned rounds = pieces_allowed(pieces) + 1;
    if (!limits_are_open(&farm->job.limits))
        return LIMIT_SPP;
    if (farm->ended || !film_plan(farm->job.film)->made ||
        scheduler_seconds_unleased(farm->scheduler) >
            2e-3 * farm->settings.schedule.lease_target_ms ||
        !wants_another_round(farm, rounds - 1))
        return LIMIT_NONE;

    double left = core_s_left(farm, rounds);
    struct outlook outlook = {
        .rounds = rounds,
        .elapsed_s = farm->job.elapsed_s + seconds_since(farm, farm->opened_ms),
        .left_s = left / spending_pace(&farm->spending),
        .spent_core_s = farm->spending.core_s,
        .left_core_s = left,
    };
    enum limit against = limits_against(&farm->job.limits, &outlook);
    if (against == LIMIT_NONE) {
        film_extend(farm->job.film, rounds);
        scheduler_allow_rounds(farm->scheduler, rounds);
    }
    return against;
}

static void work(struct farm *farm)
{
    if (farm->closing || farm->ended)
        return;
    uint64_t now_ms = uv_now(farm->loop);
    struct err why;
    enum limit against = consider_another_round(farm);
    if (scheduler_failed(farm->scheduler, &why)) {
        farm_end(farm, &why);
    } else if (scheduler_done(farm->scheduler)) {
        farm->stopped_by = against;
        farm_end(farm, NULL);
    } else {
        dues_pump(farm, now_ms);
    }
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
    spending_tick(&farm->spending, now_ms);
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
    farm->settings.schedule.replicates = job_sequences(job->spec);
    farm->settings.schedule.plan = film_plan(job->film);
    farm->job = *job;
    farm->events = *events;
    farm->owner = owner;
    farm->epoch = 1;
    farm->next_worker_id = 1;
    farm->opened_ms = farm->tick_ms = uv_now(loop);
    spending_begin(&farm->spending, farm->opened_ms);
    farm->spending.pilot_rounds = job->spec->pilot_rounds;
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
    unsigned pilot = job->spec->pilot_rounds; /* what comes after it is not planned yet */
    scheduler_allow_rounds(farm->scheduler, pilot > 0 ? pilot : first_rounds(job));
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

/* Share done and seconds left, by the limit that will probably end the job. */
static void foresee(const struct farm *farm, struct farm_status *status)
{
    const struct limits *limits = &farm->job.limits;
    const struct pieces *pieces = scheduler_pieces(farm->scheduler);
    double left_s = INFINITY;
    if (farm->stopped_by != LIMIT_NONE) {
        status->done = 1;
        status->seconds_left = 0;
        return;
    }
    status->done = -1;
    if (limits->rounds < ROUND_COUNT) {
        status->done = (double)pieces_leaves_done(pieces) /
                       (double)pieces_leaves(pieces, limits->rounds);
        left_s = scheduler_seconds_left(farm->scheduler, limits->rounds);
    }
    size_t count;
    const struct ledger_row *rows = farm_ledger(farm, &count);
    struct predict_job job = farm_predict_job(farm);
    struct prediction prediction;
    if (limits->relmse > 0 && predict_end(&job, rows, count, &prediction)) {
        double left = prediction.wall_s.mid - status->wall_s;
        left_s = fmin(left_s, left > 0 ? left : 0);
        status->done = fmax(status->done, status->core_s / prediction.core_s.mid);
    }
    if (limits->core_s > 0) {
        left_s = fmin(left_s, (limits->core_s - status->core_s) / spending_pace(&farm->spending));
        status->done = fmax(status->done, status->core_s / limits->core_s);
    }
    if (limits->time_s > 0) {
        double elapsed_s = farm->job.elapsed_s + status->wall_s;
        left_s = fmin(left_s, limits->time_s - elapsed_s);
        status->done = fmax(status->done, elapsed_s / limits->time_s);
    }
    status->done = fmin(status->done, 1);
    status->seconds_left = !isfinite(left_s) ? -1 : left_s > 0 ? left_s : 0;
}

struct farm_status farm_status(const struct farm *farm)
{
    struct farm_status status = {
        .rounds_done = scheduler_sealed(farm->scheduler),
        .wall_s = seconds_since(farm, farm->opened_ms),
        .core_s = farm->spending.core_s,
        .stopped_by = farm->stopped_by,
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
    foresee(farm, &status);
    return status;
}

struct predict_job farm_predict_job(const struct farm *farm)
{
    return (struct predict_job){
        .spec = *farm->job.spec,
        .sampler = farm->job.scene->settings.sampler,
        .relmse = farm->job.limits.relmse,
    };
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
