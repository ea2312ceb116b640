#include "master/cmd_render.h"

#include "common/err.h"
#include "common/scene.h"
#include "master/farm.h"
#include "master/film.h"
#include "master/job_setup.h"
#include "master/ledger.h"
#include "master/local_workers.h"
#include "master/options.h"
#include "master/pictures.h"
#include "master/progress.h"
#include "master/render_summary.h"
#include "master/tev.h"
#include "proto/bundle.h"
#include "proto/keys.h"

#include <inttypes.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define GRACE_MS          3000 /* for local workers to leave by themselves */
#define TEV_GRACE_MS      2000
#define PROGRESS_MS       250
#define PREDICTION_MS     1000 /* between lines of a log; short jobs have rounds faster than that */
#define FULL_LEASES_S     30   /* --time from which leases are as long as usual */
#define SHORTEST_LEASE_MS 50
#define BUILD             "pathfarm " PATHFARM_VERSION ", " __VERSION__

struct render {
    struct render_options options;
    struct job_setup setup;
    struct bundle *bundle;
    struct film *film;
    struct keys *keys;
    char *command;

    uv_loop_t loop;
    uv_signal_t interrupt, terminate;
    uv_timer_t show, refresh;
    struct farm *farm;
    struct local_workers *local;
    struct pictures *pictures;
    struct tev *tev;
    struct progress progress;
    uint64_t shown_samples;
    double shown_s, mpaths_per_s;
    uint64_t began_ms, predicted_ms;
    char needs[160]; /* what is predicted for --error */

    bool ended, interrupted;
    struct err why; /* ERR_OK: done */
};

/* ---- what the farm and the local workers tell */

static void say(void *owner, const char *line)
{
    struct render *r = owner;
    if (!r->options.quiet || r->options.verbose)
        progress_say(&r->progress, "%s", line);
}

static struct progress_state progress_of(struct render *r)
{
    struct farm_status status = farm_status(r->farm);
    double seconds = status.wall_s - r->shown_s;
    if (seconds > 0.5 || (seconds > 0 && r->ended && r->mpaths_per_s == 0)) {
        double now = (double)(status.samples - r->shown_samples) / seconds * 1e-6;
        r->mpaths_per_s = r->mpaths_per_s == 0 ? now : 0.7 * r->mpaths_per_s + 0.3 * now;
        r->shown_samples = status.samples;
        r->shown_s = status.wall_s;
    }
    size_t rows;
    const struct ledger_row *ledger = farm_ledger(r->farm, &rows);
    bool known = rows > 0 && ledger[rows - 1].accuracy.verdict == ACCURACY_KNOWN;
    return (struct progress_state){
        .done = status.done,
        .spp = film_spp(r->film),
        .mpaths_per_s = r->mpaths_per_s,
        .workers = status.workers,
        .error = known ? ledger[rows - 1].accuracy.rmse : NAN,
        .seconds_left = status.seconds_left,
    };
}

static void on_show(uv_timer_t *timer)
{
    struct render *r = timer->data;
    if (r->ended || r->options.quiet)
        return;
    struct progress_state state = progress_of(r);
    progress_show(&r->progress, &state, uv_now(&r->loop));
}

static struct picture_moment moment_of(const struct render *r, bool complete)
{
    struct picture_moment moment = {
        .picture = farm_picture(r->farm),
        .stopped_by = farm_status(r->farm).stopped_by,
        .complete = complete,
    };
    moment.rows = farm_ledger(r->farm, &moment.row_count);
    return moment;
}

static void on_refresh(uv_timer_t *timer)
{
    struct render *r = timer->data;
    struct picture_moment moment = moment_of(r, false);
    if (!r->ended)
        pictures_refresh(r->pictures, &moment, say, r);
}

/* What the target needs: on the line that is rewritten, or a line of the log now and then. */
static void tell_prediction(struct render *r)
{
    size_t count;
    const struct ledger_row *rows = farm_ledger(r->farm, &count), *now = &rows[count - 1];
    struct predict_job job = farm_predict_job(r->farm);
    struct prediction prediction;
    r->progress.note = NULL;
    if (job.relmse <= 0 || limits_met(&r->setup.limits, now) ||
        !predict_end(&job, rows, count, &prediction))
        return;
    r->progress.note = predict_text(&prediction, now, job.relmse, r->needs, sizeof(r->needs));
    if (r->options.quiet || r->progress.terminal || uv_now(&r->loop) < r->predicted_ms)
        return;
    progress_say(&r->progress, "after %" PRIu64 " spp: relMSE %.3g; %s (90 %%)", now->spp,
                 now->accuracy.relmse, r->needs);
    r->predicted_ms = uv_now(&r->loop) + PREDICTION_MS;
}

static void on_round(void *owner)
{
    struct render *r = owner;
    tev_update(r->tev, farm_picture(r->farm));
    tell_prediction(r);
}

static void on_end(void *owner, const struct err *why)
{
    struct render *r = owner;
    r->ended = true;
    r->why = *why;
}

static pid_t local_pid(void *owner, const char *peer_address)
{
    const struct render *r = owner;
    return r->local == NULL ? -1 : local_workers_pid(r->local, peer_address);
}

static void on_local_exit(void *owner, pid_t pid, int crash)
{
    const struct render *r = owner;
    farm_local_exited(r->farm, pid, crash);
}

static void on_local_hopeless(void *owner, const struct err *why)
{
    const struct render *r = owner;
    farm_local_hopeless(r->farm, why);
}

static bool was_useful(void *owner, pid_t pid)
{
    const struct render *r = owner;
    for (const struct farm_worker *w = farm_workers(r->farm); w != NULL; w = w->next) {
        if (w->pid == pid && w->nodes > 0)
            return true;
    }
    return false;
}

/* The second signal ends the process as it always did; local workers die with it. */
static void on_signal(uv_signal_t *handle, int number)
{
    struct render *r = handle->data;
    uv_signal_stop(&r->interrupt);
    uv_signal_stop(&r->terminate);
    r->interrupted = true;
    if (r->ended)
        return;
    r->ended = true;
    err_set(&r->why, ERR_CANCELLED, "stopped by signal %d (%s)", number, strsignal(number));
}

/* ---- before */

static struct farm_settings farm_settings_of(const struct render *r)
{
    const struct render_options *o = &r->options;
    struct farm_settings s = farm_defaults();
    s.listen_host = o->listens ? o->listen_host : NULL;
    s.listen_port = o->listen_port;
    s.keys = r->keys;
    s.heartbeat_ms = o->heartbeat_ms > 0 ? o->heartbeat_ms : s.heartbeat_ms;
    s.dead_after_ms = o->dead_after_ms > 0 ? o->dead_after_ms : s.dead_after_ms;
    if (o->lease_ms > 0)
        s.schedule.lease_target_ms = o->lease_ms;
    else if (o->time_s > 0 && o->time_s < FULL_LEASES_S) /* short times are met by small leases */
        s.schedule.lease_target_ms = (uint32_t)fmax(
            s.schedule.lease_target_ms * o->time_s / FULL_LEASES_S, SHORTEST_LEASE_MS);
    s.schedule.speculate_ms = s.schedule.lease_target_ms / 2;
    if (o->leases_in_flight > 0)
        s.schedule.leases_per_worker = o->leases_in_flight;
    s.schedule.stall_ms = o->stall_ms > 0 ? o->stall_ms : s.schedule.stall_ms;
    s.schedule.lease_leaves_min = o->lease_leaves_min;
    s.schedule.lease_leaves_max = o->lease_leaves_max;
    return s;
}

static uint64_t memory_bytes(void)
{
    return (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGE_SIZE);
}

static uint32_t threads_per_worker(const struct render_options *o)
{
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
    if (o->threads > 0 || o->workers == 0)
        return o->threads;
    uint32_t share = (uint32_t)(cores < 1 ? 1 : cores) / o->workers;
    return share == 0 ? 1 : share;
}

static bool start_local_workers(struct render *r, struct err *err)
{
    static const struct local_events EVENTS = { on_local_exit, on_local_hopeless, was_useful, say };
    const struct render_options *o = &r->options;
    struct local_settings settings = {
        .count = o->workers,
        .threads = threads_per_worker(o),
        .port = farm_local_port(r->farm),
        .cache_dir = o->cache,
        .no_cache = o->no_cache,
        .verbose = o->verbose,
    };
    if (o->workers == 0)
        return true;
    r->local = local_workers_start(&r->loop, &settings, &EVENTS, r, err);
    return r->local != NULL || err_wrap(err, "starting local workers");
}

static bool open_farm(struct render *r, struct err *err)
{
    static const struct farm_events EVENTS = { on_round, on_end, say, local_pid };
    struct farm_settings settings = farm_settings_of(r);
    struct farm_job job = {
        .scene = r->setup.scene,
        .spec = &r->setup.spec,
        .bundle = r->bundle,
        .film = r->film,
        .title = r->options.scene,
        .limits = r->setup.limits,
        .elapsed_s = (double)(uv_hrtime() / 1000000 - r->began_ms) / 1000,
        .local_workers = r->options.workers > 0,
    };
    r->farm = farm_open(&r->loop, &settings, &job, &EVENTS, r, err);
    if (r->farm == NULL)
        return false;
    if (r->options.listens)
        progress_say(&r->progress, "listening on %s:%u%s", r->options.listen_host,
                     farm_listen_port(r->farm), r->keys == NULL ? "" : " (TLS)");
    return true;
}

static void start_timers(struct render *r)
{
    uv_signal_t *signals[] = { &r->interrupt, &r->terminate };
    const int numbers[] = { SIGINT, SIGTERM };
    for (int i = 0; i < 2; i++) {
        uv_signal_init(&r->loop, signals[i]);
        signals[i]->data = r;
        uv_signal_start(signals[i], on_signal, numbers[i]);
    }
    uv_timer_init(&r->loop, &r->show);
    uv_timer_init(&r->loop, &r->refresh);
    r->show.data = r->refresh.data = r;
    uv_timer_start(&r->show, on_show, PROGRESS_MS, PROGRESS_MS);
    if (r->options.write_every_s > 0) {
        uint64_t ms = (uint64_t)(r->options.write_every_s * 1000);
        uv_timer_start(&r->refresh, on_refresh, ms == 0 ? 1 : ms, ms == 0 ? 1 : ms);
    }
}

static void log_tev(void *owner, const char *text)
{
    say(owner, text);
}

static void open_guests(struct render *r)
{
    if (r->options.has_tev)
        r->tev = tev_open(&r->loop, r->options.tev_host, r->options.tev_port, r->options.output,
                          log_tev, r);
}

/* ---- after */

/* Why the job ended where it did, behind "N samples per pixel"; "" where only samples were asked
 * for. */
static const char *ending(const struct render *r, char *text, size_t capacity)
{
    const struct limits *limits = &r->setup.limits;
    enum limit by = farm_status(r->farm).stopped_by;
    size_t count;
    const struct ledger_row *rows = farm_ledger(r->farm, &count);
    const struct accuracy *accuracy = &rows[count - 1].accuracy;
    text[0] = '\0';
    if (!limits_are_open(limits))
        return text;
    int length = snprintf(text, capacity, ", stopped by --%s", limits_text(by));
    if (limits->relmse <= 0)
        return text;
    text += length;
    capacity -= (size_t)length;
    const char *reached = by == LIMIT_ERROR ? "" : "the target was not reached, ";
    if (accuracy->verdict == ACCURACY_KNOWN)
        snprintf(text, capacity, ": %srelMSE %.3g, %.3g to %.3g (95 %%)", reached, accuracy->relmse,
                 accuracy->relmse95.low, accuracy->relmse95.high);
    else
        snprintf(text, capacity, ": %sthe error is unknown (%s)", reached,
                 estimate_verdict_text(accuracy->verdict));
    return text - length;
}

/* The picture of the sealed rounds, and the report. True when everything asked for was done. */
static bool finish(struct render *r)
{
    bool done = r->why.code == ERR_OK;
    char why[256];
    struct err err;
    struct progress_state last = progress_of(r);
    if (!r->options.quiet)
        progress_close(&r->progress, &last);
    if (!done)
        fprintf(stderr, "%s\n", r->why.text);

    while (pictures_busy(r->pictures))
        uv_run(&r->loop, UV_RUN_ONCE);
    if (farm_picture(r->farm) == NULL) {
        fprintf(stderr, "no round was finished: nothing is written\n");
        return false;
    }
    struct picture_moment moment = moment_of(r, done);
    if (!pictures_write(r->pictures, &moment, &err)) {
        fprintf(stderr, "%s\n", err.text);
        return false;
    }
    uint64_t clamped = exr_values_clamped(farm_picture(r->farm), &r->options.exr);
    if (clamped > 0)
        fprintf(stderr, "%s: %" PRIu64 " values were too large for half and became 65504\n",
                r->options.output, clamped);
    if (!done)
        fprintf(stderr, "%s holds the %" PRIu64 " samples per pixel that were finished\n",
                r->options.output, film_spp(r->film));
    else if (!r->options.quiet)
        fprintf(stderr, "%s, %s: %" PRIu64 " samples per pixel%s\n", r->options.output,
                r->options.png, film_spp(r->film), ending(r, why, sizeof(why)));
    if (r->options.report != NULL) {
        struct render_summary summary = {
            .command = r->command,
            .build = BUILD,
            .scene_name = r->options.scene,
            .setup = &r->setup,
            .bundle = r->bundle,
            .film = r->film,
            .farm = r->farm,
        };
        if (!render_summary_write(&summary, r->options.report, &err)) {
            fprintf(stderr, "%s\n", err.text);
            return false;
        }
    }
    return done;
}

static void close_all(struct render *r)
{
    farm_close(r->farm);
    if (r->local != NULL)
        local_workers_stop(r->local, GRACE_MS);
    if (r->tev != NULL)
        tev_close(r->tev, TEV_GRACE_MS);
    uv_close((uv_handle_t *)&r->interrupt, NULL);
    uv_close((uv_handle_t *)&r->terminate, NULL);
    uv_close((uv_handle_t *)&r->show, NULL);
    uv_close((uv_handle_t *)&r->refresh, NULL);
    uv_run(&r->loop, UV_RUN_DEFAULT);
    uv_loop_close(&r->loop);
}

static int run(struct render *r)
{
    struct err err;
    uv_loop_init(&r->loop);
    progress_open(&r->progress, stderr, isatty(STDERR_FILENO) == 1, uv_now(&r->loop));
    struct picture_facts facts = {
        .command = r->command,
        .build = BUILD,
        .bundle = r->bundle,
        .spec = &r->setup.spec,
        .format = r->options.exr,
    };
    if (!open_farm(r, &err))
        goto fail_farm;
    facts.profile_text = farm_profile_text(r->farm);
    const struct picture_paths paths = {
        .exr = r->options.output,
        .png = r->options.png,
        .heat = r->options.heat,
        .ledger = r->options.ledger,
    };
    r->pictures = pictures_new(&r->loop, r->film, &facts, &paths);
    if (r->pictures == NULL) {
        err_set(&err, ERR_MEMORY, "no memory for pictures");
        goto fail_pictures;
    }
    if (!film_take_memory(r->film, r->setup.limits.rounds, &err))
        goto fail_memory;
    start_timers(r);
    open_guests(r);
    if (!start_local_workers(r, &err))
        on_end(r, &err);

    while (!r->ended)
        uv_run(&r->loop, UV_RUN_ONCE);
    bool done = finish(r);
    close_all(r);
    pictures_free(r->pictures);
    return done ? 0 : 1;

fail_memory:
    pictures_free(r->pictures);
fail_pictures:
    farm_close(r->farm);
fail_farm:
    uv_run(&r->loop, UV_RUN_DEFAULT);
    uv_loop_close(&r->loop);
    fprintf(stderr, "%s\n", err.text);
    return err.code == ERR_ARGUMENT || err.code == ERR_AUTH ? 2 : 1;
}

/* The command line again, for the metadata; the caller's to free. */
static char *joined(int argc, char **argv)
{
    size_t size = sizeof("pathfarm");
    for (int i = 0; i < argc; i++)
        size += strlen(argv[i]) + 1;
    char *text = malloc(size);
    if (text == NULL)
        return NULL;
    char *end = stpcpy(text, "pathfarm");
    for (int i = 0; i < argc; i++) {
        *end++ = ' ';
        end = stpcpy(end, argv[i]);
    }
    return text;
}

static void print_help(void)
{
    printf("pathfarm render SCENE -o OUT.exr [options]\n\n");
    options_help();
    printf("\nExit status: 0 done, 1 the job failed, 2 the arguments or the scene are wrong.\n");
}

int cmd_render(int argc, char **argv)
{
    struct render *r = calloc(1, sizeof(*r));
    struct err err = { 0 };
    int status = 2;
    if (r == NULL) {
        fprintf(stderr, "no memory\n");
        return 1;
    }
    r->began_ms = uv_hrtime() / 1000000;
    switch (options_parse(argc, argv, true, &r->options, &err)) {
    case OPTIONS_HELP:
        print_help();
        status = 0;
        goto done;
    case OPTIONS_WRONG:
        goto fail;
    case OPTIONS_GO:
        break;
    }
    if (r->options.keys != NULL) {
        r->keys = keys_load(r->options.keys, ROLE_MASTER, &err);
        if (r->keys == NULL)
            goto fail;
    }
    if (!job_setup_open(&r->options, &r->setup, &err))
        goto fail;
    if (r->setup.spp != r->setup.spp_asked && !r->options.quiet)
        fprintf(stderr, "%" PRIu64 " samples per pixel: %" PRIu64 " rounded up to a whole round\n",
                r->setup.spp, r->setup.spp_asked);
    r->command = joined(argc, argv);
    r->bundle = bundle_from_scene(r->setup.scene, &r->setup.spec, &err);
    if (r->bundle == NULL)
        goto fail;
    unsigned rounds = limits_are_open(&r->setup.limits) ? r->setup.spec.pilot_rounds + 1
                                                        : r->setup.limits.rounds;
    r->film = film_new(r->setup.scene, &r->setup.spec, rounds, memory_bytes() / 4 * 3, &err);
    if (r->film == NULL)
        goto fail;
    status = run(r);
    goto done;

fail:
    fprintf(stderr, "%s\n", err.text);
    status = err.code == ERR_MEMORY ? 1 : 2;
done:
    film_free(r->film);
    bundle_free(r->bundle);
    job_setup_close(&r->setup);
    keys_free(r->keys);
    free(r->command);
    free(r);
    return status;
}
