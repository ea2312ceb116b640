/*
 * The farm against workers that are played by this test, on one loop: honest ones, and each kind of
 * bad one. Whatever they do, the picture is 1 in every pixel, or the job fails with the reason.
 */
#include "common/arena.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/farm.h"
#include "master/film.h"
#include "master/image.h"
#include "proto/bundle.h"
#include "proto/channel.h"
#include "proto/node_wire.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define VERTICES 900000 /* 10.8 MB: three slices */

/* How a played worker behaves */
enum manner {
    HONEST,
    OTHER_PROFILE,
    NO_HELLO,
    DAMAGES_ONE,        /* the checksum of its first result is wrong */
    WRONG_SHAPE,        /* its first result has too few pixels */
    WRONG_COUNT,        /* ... claims other samples */
    FOREIGN_NODE,       /* ... is of a tile that is not there */
    UNFIT_FOR_IT,       /* JOB_READY: out of memory */
    CANNOT_RENDER,      /* every node fails */
    DOES_NOTHING,       /* takes leases and says no more */
    REPEATS_OTHERWISE,  /* sends its first result again, with other bits */
    WANTS_OBJECTS,      /* asks for the whole scene, twice */
    WANTS_NONSENSE,     /* asks for an object that is not there */
    LEAVES_AND_RETURNS, /* closes after its first result, and offers it again */
};

struct play;

struct worker {
    struct play *play;
    enum manner manner;
    uint64_t nonce, sequence, durable_through;
    struct channel *channel;
    unsigned results, slices;
    bool welcome, refused, closed, misbehaved, returned, said_goodbye;
    struct node_id first;
    char reason[512];
};

struct play {
    uv_loop_t loop;
    uv_timer_t too_long;
    struct scene *scene;
    struct job_spec spec;
    struct bundle *bundle;
    struct film *film;
    struct farm *farm;
    struct worker workers[4];
    unsigned worker_count, rounds_seen;
    bool ended;
    struct err why;
    char log[16384];
};

static void connect_worker(struct worker *worker);

/* ---- a worker */

static void send_frame(struct worker *worker, const ProtobufCMessage *message, const void *bulk,
                       size_t size)
{
    struct channel_bulk carried = { .data = bulk, .size = size };
    struct err err;
    if (!channel_send(worker->channel, message, bulk == NULL ? NULL : &carried, &err) &&
        err.code != ERR_PEER) /* it may have been thrown out by now */
        fail_msg("%s", err.text);
}

static void say_hello(struct worker *worker)
{
    uint8_t profile[DIGEST_SIZE] = { worker->manner == OTHER_PROFILE };
    Pathfarm__Hello hello = PATHFARM__HELLO__INIT;
    hello.protocol_min = hello.protocol_max = 1;
    hello.build = (char *)"played";
    hello.profile.data = profile;
    hello.profile.len = sizeof(profile);
    hello.profile_text = (char *)(worker->manner == OTHER_PROFILE ? "other" : "usual");
    hello.host = (char *)"here";
    hello.cores = 1;
    hello.memory_bytes = 1 << 20;
    hello.process_nonce = worker->nonce;
    send_frame(worker, &hello.base, NULL, 0);
}

/* One in every sample of every channel. */
static struct node_sums *sums_of(const struct worker *worker, const struct node_id *node)
{
    const struct job_spec *spec = &worker->play->spec;
    struct tile_rect rect = tile_rect(worker->play->scene, node->tile);
    bool odd = !worker->misbehaved;
    uint32_t pixels = rect.width * rect.height - (worker->manner == WRONG_SHAPE && odd);
    uint64_t samples = (uint64_t)spec->leaf_samples << node->level;
    struct node_sums *sums = node_sums_new(pixels, spec->channel_count);
    for (uint32_t i = 0; i < pixels * spec->channel_count; i++)
        sums->values[i] = (float)samples;
    sums->stats.samples = samples * pixels + (worker->manner == WRONG_COUNT && odd);
    sums->stats.rays_closest = 1;
    sums->stats.largest = 1;
    return sums;
}

static void send_result(struct worker *worker, const struct node_id *node, bool otherwise)
{
    struct play *play = worker->play;
    struct node_sums *sums = sums_of(worker, node);
    if (otherwise)
        sums->values[0] += 1;
    size_t size = node_wire_size(sums);
    void *bulk = malloc(size);
    assert_true(node_wire_encode(sums, bulk, size));
    node_sums_free(sums);

    uint8_t checksum[CHECKSUM_SIZE];
    digest_checksum(bulk, size, checksum);
    if (worker->manner == DAMAGES_ONE && !worker->misbehaved)
        checksum[0] ^= 1;
    struct digest job = *bundle_job_digest(play->bundle);
    Pathfarm__Node message = PATHFARM__NODE__INIT;
    message.tile = node->tile + (worker->manner == FOREIGN_NODE && !worker->misbehaved ? 99 : 0);
    message.replicate = node->replicate;
    message.level = node->level;
    message.index = node->index;
    Pathfarm__Result result = PATHFARM__RESULT__INIT;
    result.job_id = 1;
    result.job_digest.data = job.bytes;
    result.job_digest.len = DIGEST_SIZE;
    result.node = &message;
    result.checksum.data = checksum;
    result.checksum.len = CHECKSUM_SIZE;
    result.sequence = ++worker->sequence;
    result.core_seconds = 0.25;
    send_frame(worker, &result.base, bulk, size);
    free(bulk);
    worker->results++;
    worker->misbehaved = true;
}

static void send_failure(struct worker *worker, const Pathfarm__Node *node)
{
    Pathfarm__NodeFailed failed = PATHFARM__NODE_FAILED__INIT;
    failed.job_id = 1;
    failed.node = (Pathfarm__Node *)node;
    failed.code = ERR_RENDER;
    failed.reason = (char *)"it is too hard";
    send_frame(worker, &failed.base, NULL, 0);
}

static void work_on(struct worker *worker, const Pathfarm__Lease *lease)
{
    for (size_t i = 0; i < lease->n_nodes && !worker->closed; i++) {
        const Pathfarm__Node *message = lease->nodes[i];
        struct node_id node = { message->tile, message->replicate, message->level, message->index };
        if (worker->manner == DOES_NOTHING)
            return;
        if (worker->manner == CANNOT_RENDER) {
            send_failure(worker, message);
            continue;
        }
        bool first = worker->results == 0;
        send_result(worker, &node, false);
        if (first && worker->manner == REPEATS_OTHERWISE)
            send_result(worker, &node, true);
        if (first && worker->manner == LEAVES_AND_RETURNS) {
            worker->first = node;
            worker->returned = true;
            channel_close(worker->channel);
            return;
        }
    }
}

static void send_ready(struct worker *worker)
{
    Pathfarm__JobReady ready = PATHFARM__JOB_READY__INIT;
    ready.job_id = 1;
    ready.code = worker->manner == UNFIT_FOR_IT ? ERR_MEMORY : ERR_OK;
    ready.reason = (char *)(worker->manner == UNFIT_FOR_IT ? "too small for it" : "");
    send_frame(worker, &ready.base, NULL, 0);
}

static void want(struct worker *worker, const ProtobufCBinaryData *digest, uint64_t first,
                 uint32_t count)
{
    Pathfarm__ObjectWanted wanted = PATHFARM__OBJECT_WANTED__INIT;
    wanted.job_id = 1;
    wanted.digest = *digest;
    wanted.first_slice = first;
    wanted.slice_count = count;
    send_frame(worker, &wanted.base, NULL, 0);
}

static void take_job(struct worker *worker, const Pathfarm__Job *job)
{
    if (worker->manner == WANTS_OBJECTS) {
        want(worker, &job->objects[0]->digest, 0, 1);
        want(worker, &job->objects[0]->digest, 1, 2);
        want(worker, &job->objects[0]->digest, 0, 3);
        return;
    }
    if (worker->manner == WANTS_NONSENSE) {
        want(worker, &job->digest, 0, 1);
        return;
    }
    send_ready(worker);
    if (worker->returned)
        send_result(worker, &worker->first, false);
}

static bool on_frame(void *owner, struct channel *channel, const struct frame *frame,
                     struct err *err)
{
    struct worker *worker = owner;
    void *message = frame_message(frame, err);
    assert_non_null(message);
    switch (frame->kind) {
    case PATHFARM__KIND__KIND_WELCOME:
        worker->welcome = true;
        channel_set_phase(channel, PHASE_WORKING);
        break;
    case PATHFARM__KIND__KIND_REFUSED:
        worker->refused = true;
        snprintf(worker->reason, sizeof(worker->reason), "%s",
                 ((Pathfarm__Refused *)message)->reason);
        break;
    case PATHFARM__KIND__KIND_JOB:
        take_job(worker, message);
        break;
    case PATHFARM__KIND__KIND_OBJECT_SLICE: {
        const Pathfarm__ObjectSlice *slice = message;
        struct digest digest = digest_of(frame->bulk, frame->bulk_size);
        assert_memory_equal(digest.bytes, slice->checksum.data, DIGEST_SIZE);
        if (++worker->slices == 6)
            send_ready(worker);
        break;
    }
    case PATHFARM__KIND__KIND_LEASE:
        work_on(worker, message);
        break;
    case PATHFARM__KIND__KIND_ACCEPTED:
        worker->durable_through = ((Pathfarm__Accepted *)message)->durable_through;
        break;
    case PATHFARM__KIND__KIND_GOODBYE:
        worker->said_goodbye = true;
        break;
    default:
        break;
    }
    frame_message_free(message);
    return true;
}

static void on_open(void *owner, struct channel *channel)
{
    struct worker *worker = owner;
    (void)channel;
    if (worker->manner != NO_HELLO)
        say_hello(worker);
}

static void on_close(void *owner, struct channel *channel, const struct err *err)
{
    struct worker *worker = owner;
    (void)channel;
    (void)err;
    worker->channel = NULL;
    worker->closed = true;
    if (worker->returned && worker->manner == LEAVES_AND_RETURNS && !worker->play->ended) {
        worker->manner = HONEST;
        worker->sequence = 0;
        worker->closed = false;
        connect_worker(worker);
    }
}

static const struct channel_events EVENTS = { .on_open = on_open,
                                              .on_frame = on_frame,
                                              .on_close = on_close };

static void connect_worker(struct worker *worker)
{
    struct channel_options options = { .peers = ROLE_MASTER, .limits = channel_limits_default() };
    struct err err;
    worker->channel = channel_connect(&worker->play->loop, "127.0.0.1",
                                      farm_listen_port(worker->play->farm), &options, &EVENTS,
                                      worker, &err);
    assert_non_null(worker->channel);
}

/* ---- a play */

static void on_end(void *owner, const struct err *why)
{
    struct play *play = owner;
    assert_false(play->ended);
    play->ended = true;
    play->why = *why;
}

static void on_round(void *owner)
{
    ((struct play *)owner)->rounds_seen++;
}

static void say(void *owner, const char *line)
{
    struct play *play = owner;
    size_t used = strlen(play->log);
    snprintf(play->log + used, sizeof(play->log) - used, "%s\n", line);
}

static void on_too_long(uv_timer_t *timer)
{
    struct play *play = timer->data;
    fail_msg("the farm hangs; its log:\n%s", play->log);
}

static const struct farm_events FARM_EVENTS = { .on_round = on_round,
                                                .on_end = on_end,
                                                .say = say };

/* With all rounds of 256 samples at once, or by other limits. */
static struct play *play_open_with(const struct limits *limits)
{
    struct err err;
    struct play *play = calloc(1, sizeof(*play));
    uv_loop_init(&play->loop);
    play->scene = scene_new();
    struct scene_settings *s = &play->scene->settings;
    s->width = s->crop[1] = 80;
    s->height = s->crop[3] = 40;
    play->scene->vertex_count = VERTICES;
    play->scene->positions = arena_alloc(play->scene->arena, VERTICES, 3 * sizeof(float));
    for (uint32_t i = 0; i < 3 * VERTICES; i++)
        play->scene->positions[i] = (float)i;
    play->spec.channel_count = 3;
    play->spec.max_lanes = 8;
    uint64_t spp = job_shape(256, 0, &play->spec);
    unsigned rounds = job_rounds(&play->spec, spp);
    play->bundle = bundle_from_scene(play->scene, &play->spec, &err);
    play->film = film_new(play->scene, &play->spec, rounds, 0, &err);

    struct farm_settings settings = farm_defaults();
    settings.listen_host = "127.0.0.1";
    settings.heartbeat_ms = 50;
    settings.dead_after_ms = 2000; /* a loaded machine stops us for a while */
    settings.schedule.lease_leaves_max = 4;
    struct farm_job job = { .scene = play->scene,
                            .spec = &play->spec,
                            .bundle = play->bundle,
                            .film = play->film,
                            .title = "play",
                            .limits = limits != NULL ? *limits
                                                     : (struct limits){ .rounds = rounds } };
    play->farm = farm_open(&play->loop, &settings, &job, &FARM_EVENTS, play, &err);
    assert_non_null(play->farm);
    uv_timer_init(&play->loop, &play->too_long);
    play->too_long.data = play;
    uv_timer_start(&play->too_long, on_too_long, 20000, 0);
    return play;
}

static struct play *play_open(void)
{
    return play_open_with(NULL);
}

static struct worker *enter(struct play *play, enum manner manner)
{
    struct worker *worker = &play->workers[play->worker_count++];
    worker->play = play;
    worker->manner = manner;
    worker->nonce = 1000 + play->worker_count;
    connect_worker(worker);
    return worker;
}

static void until_closed(struct play *play, const struct worker *worker)
{
    while (!worker->closed)
        uv_run(&play->loop, UV_RUN_ONCE);
}

static void until_welcome(struct play *play, const struct worker *worker)
{
    while (!worker->welcome)
        uv_run(&play->loop, UV_RUN_ONCE);
}

static void until_ended(struct play *play)
{
    while (!play->ended)
        uv_run(&play->loop, UV_RUN_ONCE);
}

/* Done, and every pixel is one. */
static void assert_unharmed(struct play *play)
{
    until_ended(play);
    assert_string_equal(play->why.text, "");
    assert_int_equal(play->why.code, ERR_OK);
    const struct image *image = farm_picture(play->farm);
    const float *red = image_channel(image, "R");
    for (uint32_t p = 0; p < image->width * image->height; p++)
        assert_true(red[p] == 1);
    assert_int_equal(film_spp(play->film), 256);
    size_t rows;
    farm_ledger(play->farm, &rows);
    assert_int_equal(rows, play->rounds_seen);
}

/* The farm says goodbye to all; the workers' side is still there to be looked at. */
static void play_dismiss(struct play *play)
{
    play->ended = true;
    farm_close(play->farm);
    uv_close((uv_handle_t *)&play->too_long, NULL);
    uv_run(&play->loop, UV_RUN_DEFAULT);
    assert_int_equal(uv_loop_close(&play->loop), 0);
}

static void play_free(struct play *play)
{
    film_free(play->film);
    bundle_free(play->bundle);
    scene_free(play->scene);
    free(play);
}

static void play_close(struct play *play)
{
    play_dismiss(play);
    play_free(play);
}

static void assert_said(const struct play *play, const char *text)
{
    if (strstr(play->log, text) == NULL)
        fail_msg("\"%s\" was not said, but:\n%s", text, play->log);
}

/* ---- sentences */

static void honest_workers_finish_the_job_and_are_told(void **state)
{
    (void)state;
    struct play *play = play_open();
    struct worker *a = enter(play, HONEST), *b = enter(play, HONEST);
    assert_unharmed(play);
    play_dismiss(play);
    assert_true(a->said_goodbye && b->said_goodbye);
    assert_int_equal(a->durable_through, a->sequence);
    assert_int_equal(b->durable_through, b->sequence);
    play_free(play);
}

static void another_profile_is_turned_away_with_the_reason(void **state)
{
    (void)state;
    struct play *play = play_open();
    struct worker *honest = enter(play, HONEST);
    until_welcome(play, honest);
    struct worker *other = enter(play, OTHER_PROFILE);
    until_closed(play, other);
    assert_true(other->refused);
    assert_false(other->welcome);
    assert_non_null(strstr(other->reason, "numeric profile is \"other\", the job's is \"usual\""));
    assert_unharmed(play);
    play_close(play);
}

/* Each of these is caught, and an honest worker brings the job home. */
static void bad_workers_do_no_harm(void **state)
{
    static const struct {
        enum manner manner;
        const char *said;
        bool disconnected;
    } ROWS[] = {
        { DAMAGES_ONE, "did not match their checksum", false },
        { WRONG_SHAPE, "disconnected", true },
        { WRONG_COUNT, "samples came with", true },
        { FOREIGN_NODE, "a node that this job does not have", true },
        { UNFIT_FOR_IT, "too small for it", false },
        { REPEATS_OTHERWISE, "OTHER BITS", false },
        { WANTS_NONSENSE, "a slice was wanted that this job does not have", true },
        { DOES_NOTHING, "nothing was heard for 2000 ms", true },
    };
    (void)state;
    for (size_t i = 0; i < sizeof(ROWS) / sizeof(ROWS[0]); i++) {
        struct play *play = play_open();
        struct worker *bad = enter(play, ROWS[i].manner);
        until_welcome(play, bad);
        while (strstr(play->log, ROWS[i].said) == NULL)
            uv_run(&play->loop, UV_RUN_ONCE);
        if (ROWS[i].disconnected)
            until_closed(play, bad);
        if (!play->ended)
            enter(play, HONEST);
        assert_unharmed(play);
        assert_said(play, ROWS[i].said);
        play_close(play);
    }
}

static void the_scene_comes_in_slices_as_often_as_wanted(void **state)
{
    (void)state;
    struct play *play = play_open();
    struct worker *worker = enter(play, WANTS_OBJECTS);
    assert_unharmed(play);
    assert_int_equal(worker->slices, 6);
    play_close(play);
}

static void a_worker_that_returns_offers_its_results_again(void **state)
{
    (void)state;
    struct play *play = play_open();
    struct worker *worker = enter(play, LEAVES_AND_RETURNS);
    assert_unharmed(play);
    assert_true(worker->returned);
    struct scheduler_counts counts = farm_status(play->farm).counts;
    assert_true(counts.duplicates + counts.late >= 1);
    assert_int_equal(counts.mismatches, 0);
    assert_null(farm_workers(play->farm)->next); /* one worker, twice */
    play_close(play);
}

static void three_workers_that_cannot_render_fail_the_job(void **state)
{
    (void)state;
    struct play *play = play_open();
    for (int i = 0; i < 3; i++)
        enter(play, CANNOT_RENDER);
    until_ended(play);
    assert_int_equal(play->why.code, ERR_RENDER);
    assert_non_null(strstr(play->why.text, "it is too hard"));
    play_close(play);
}

/* Every sample is the same, so the first round meets any target, whatever has come since. */
static void a_job_by_error_ends_with_the_round_that_meets_it(void **state)
{
    (void)state;
    const struct limits limits = { .rounds = ROUND_COUNT, .relmse = 1e-6 };
    struct play *play = play_open_with(&limits);
    for (int i = 0; i < 3; i++)
        enter(play, HONEST);
    until_ended(play);
    assert_int_equal(play->why.code, ERR_OK);
    struct farm_status status = farm_status(play->farm);
    assert_int_equal(status.stopped_by, LIMIT_ERROR);
    assert_true(status.done == 1 && status.seconds_left == 0);
    size_t rows;
    const struct ledger_row *ledger = farm_ledger(play->farm, &rows);
    assert_int_equal(rows, 1);
    assert_int_equal(ledger[0].spp, 16);
    /* Of 0.25 for each node: what is in the picture, and not what came too early */
    assert_true(ledger[0].core_s == 0.25 * 6 * 4);
    assert_true(status.core_s >= ledger[0].core_s);
    assert_int_equal(film_spp(play->film), 16);
    play_close(play);
}

static void a_budget_is_not_exceeded_and_almost_used(void **state)
{
    (void)state;
    /* A node costs 0.25, whatever its size; the first eight rounds have 24 nodes each */
    const struct limits limits = { .rounds = ROUND_COUNT, .core_s = 6 * 4.5 };
    struct play *play = play_open_with(&limits);
    enter(play, HONEST);
    until_ended(play);
    assert_int_equal(play->why.code, ERR_OK);
    struct farm_status status = farm_status(play->farm);
    assert_int_equal(status.stopped_by, LIMIT_BUDGET);
    assert_true(status.core_s == 24);
    assert_int_equal(film_spp(play->film), 64);
    play_close(play);
}

static void of_two_limits_the_first_one_ends_the_job(void **state)
{
    (void)state;
    const struct limits limits = { .rounds = 3, .core_s = 1000 };
    struct play *play = play_open_with(&limits);
    enter(play, HONEST);
    until_ended(play);
    assert_int_equal(farm_status(play->farm).stopped_by, LIMIT_SPP);
    assert_int_equal(film_spp(play->film), 48);
    play_close(play);
}

static void closing_early_leaves_nothing_behind(void **state)
{
    (void)state;
    struct play *play = play_open();
    enter(play, NO_HELLO);
    until_welcome(play, enter(play, DOES_NOTHING));
    play_close(play);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(honest_workers_finish_the_job_and_are_told),
        cmocka_unit_test(another_profile_is_turned_away_with_the_reason),
        cmocka_unit_test(bad_workers_do_no_harm),
        cmocka_unit_test(the_scene_comes_in_slices_as_often_as_wanted),
        cmocka_unit_test(a_worker_that_returns_offers_its_results_again),
        cmocka_unit_test(three_workers_that_cannot_render_fail_the_job),
        cmocka_unit_test(a_job_by_error_ends_with_the_round_that_meets_it),
        cmocka_unit_test(a_budget_is_not_exceeded_and_almost_used),
        cmocka_unit_test(of_two_limits_the_first_one_ends_the_job),
        cmocka_unit_test(closing_early_leaves_nothing_behind),
    };
    return cmocka_run_group_tests_name("farm", tests, NULL, NULL);
}
