/* A worker's session against masters of all manners, on loopback, in this process. */
#include "common/effects.h"
#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "proto/bundle.h"
#include "proto/cache.h"
#include "proto/channel.h"
#include "proto/limits.h"
#include "proto/node_wire.h"
#include "worker/journal.h"
#include "worker/profile.h"
#include "worker/renderer.h"
#include "worker/session.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>
#include <unistd.h>
#include <uv.h>

#include <cmocka.h>

#define PATIENCE_MS 8000

/* ---- the master's end: it serves objects by itself, and remembers all else for the script ---- */

struct letter {
    STAILQ_ENTRY(letter) link;
    Pathfarm__Kind kind;
    void *message;
    size_t bulk_size;
    uint8_t bulk[];
};

struct farm {
    uv_loop_t loop;
    uv_timer_t tick;
    struct channel_listener *listener;
    unsigned port;
    struct channel *channel; /* the newest */
    unsigned connections;
    STAILQ_HEAD(, letter) letters;
    struct scene *scene;
    struct job_spec spec;
    struct bundle *bundle;
    unsigned slices_served, slices_max; /* 0: no limit */
    struct session *session;
    bool ended;
    int status;
};

static char said[16][1600]; /* the worker's journal, newest last */
static unsigned said_count;

static void remember_line(const char *line)
{
    snprintf(said[said_count++ % 16], sizeof(said[0]), "%s", line);
}

static bool was_said(const char *words)
{
    for (unsigned i = 0; i < 16; i++)
        if (strstr(said[i], words) != NULL)
            return true;
    return false;
}

static void serve_slices(struct farm *farm, const Pathfarm__ObjectWanted *wanted)
{
    struct digest digest;
    digest_from_bytes(&digest, wanted->digest.data, wanted->digest.len);
    for (uint32_t i = 0; i < wanted->slice_count; i++) {
        Pathfarm__ObjectSlice slice;
        struct channel_bulk bulk = { .release = NULL };
        if (farm->slices_max != 0 && farm->slices_served == farm->slices_max)
            return;
        if (bundle_slice(farm->bundle, &digest, wanted->first_slice + i, &slice, &bulk.data,
                         &bulk.size))
            channel_send(farm->channel, &slice.base, &bulk, NULL);
        farm->slices_served++;
    }
}

static bool master_hears(void *owner, struct channel *channel, const struct frame *frame,
                         struct err *err)
{
    struct farm *farm = owner;
    (void)channel;
    struct letter *letter = calloc(1, sizeof(*letter) + frame->bulk_size);
    letter->kind = frame->kind;
    letter->message = frame_message(frame, err);
    letter->bulk_size = frame->bulk_size;
    if (frame->bulk_size > 0)
        memcpy(letter->bulk, frame->bulk, frame->bulk_size);
    if (letter->kind == PATHFARM__KIND__KIND_OBJECT_WANTED)
        serve_slices(farm, letter->message);
    STAILQ_INSERT_TAIL(&farm->letters, letter, link);
    return true;
}

static void master_loses(void *owner, struct channel *channel, const struct err *err)
{
    struct farm *farm = owner;
    (void)err;
    if (farm->channel == channel)
        farm->channel = NULL;
}

static void master_accepts(void *owner, struct channel *channel)
{
    static const struct channel_events events = { .on_frame = master_hears,
                                                  .on_close = master_loses };
    struct farm *farm = owner;
    farm->channel = channel;
    farm->connections++;
    channel_set_events(channel, &events, farm);
}

static void on_tick(uv_timer_t *timer)
{
    (void)timer;
}

static void session_ended(void *owner, int status)
{
    struct farm *farm = owner;
    farm->ended = true;
    farm->status = status;
}

static void forget_letters(struct farm *farm)
{
    struct letter *letter;
    while ((letter = STAILQ_FIRST(&farm->letters)) != NULL) {
        STAILQ_REMOVE_HEAD(&farm->letters, link);
        frame_message_free(letter->message);
        free(letter);
    }
}

static void letter_free(struct letter *letter)
{
    frame_message_free(letter->message);
    free(letter);
}

/* ---- scripts ---- */

static struct profile profile;

static struct session_options some_options(const struct farm *farm)
{
    struct session_options options = session_options_default();
    options.host = "127.0.0.1";
    options.port = farm->port;
    options.renderer = &renderer_simulated;
    options.profile = &profile;
    options.threads = 2;
    options.retry_min_ms = 20;
    options.retry_max_ms = 100;
    return options;
}

static void farm_open(struct farm *farm)
{
    static const struct channel_listener_events doors = { .on_accept = master_accepts };
    struct channel_options options = { .peers = ROLE_WORKER, .limits = channel_limits_default() };
    struct err err;
    memset(farm, 0, sizeof(*farm));
    memset(said, 0, sizeof(said));
    STAILQ_INIT(&farm->letters);
    uv_loop_init(&farm->loop);
    uv_timer_init(&farm->loop, &farm->tick);
    uv_timer_start(&farm->tick, on_tick, 5, 5);
    farm->listener = channel_listen(&farm->loop, "127.0.0.1", 0, &options, &doors, farm, &err);
    assert_non_null(farm->listener);
    farm->port = channel_listener_port(farm->listener);

    farm->scene = scene_new();
    assert_non_null(farm->scene);
    struct scene_settings *settings = &farm->scene->settings;
    settings->width = settings->crop[1] = 70;
    settings->height = settings->crop[3] = 40;
    settings->effects = scene_effects(farm->scene);
    farm->spec = (struct job_spec){ .seed = 3,
                                    .replicates = 4,
                                    .leaf_samples = 4,
                                    .channel_count = 3,
                                    .depth_cap = 100,
                                    .max_lanes = 8 };
    farm->bundle = bundle_from_scene(farm->scene, &farm->spec, &err);
    assert_non_null(farm->bundle);
}

static void worker_start(struct farm *farm, const struct session_options *options)
{
    struct err err;
    farm->session = session_new(&farm->loop, options, session_ended, farm, &err);
    assert_non_null(farm->session);
}

static void turn(struct farm *farm)
{
    uv_run(&farm->loop, UV_RUN_ONCE);
}

static void farm_close(struct farm *farm)
{
    uint64_t begin = uv_hrtime();
    if (farm->session != NULL && !farm->ended) {
        if (farm->channel != NULL)
            channel_close(farm->channel);
        session_drain(farm->session);
    }
    while (farm->session != NULL && !farm->ended) {
        assert_true(uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000));
        turn(farm);
    }
    session_free(farm->session);
    channel_listener_close(farm->listener);
    if (farm->channel != NULL)
        channel_close(farm->channel);
    uv_close((uv_handle_t *)&farm->tick, NULL);
    uv_run(&farm->loop, UV_RUN_DEFAULT);
    assert_int_equal(uv_loop_close(&farm->loop), 0);
    forget_letters(farm);
    bundle_free(farm->bundle);
    scene_free(farm->scene);
}

/* The next message of this kind; those before it are thrown away. */
static struct letter *expect(struct farm *farm, Pathfarm__Kind kind)
{
    uint64_t begin = uv_hrtime();
    for (;;) {
        struct letter *letter;
        while ((letter = STAILQ_FIRST(&farm->letters)) != NULL) {
            STAILQ_REMOVE_HEAD(&farm->letters, link);
            if (letter->kind == kind)
                return letter;
            letter_free(letter);
        }
        if (uv_hrtime() - begin > PATIENCE_MS * UINT64_C(1000000))
            fail_msg("no %s came", frame_kind_name(kind));
        turn(farm);
    }
}

static unsigned count(struct farm *farm, Pathfarm__Kind kind, unsigned during_ms)
{
    uint64_t begin = uv_hrtime();
    while (uv_hrtime() - begin < during_ms * UINT64_C(1000000))
        turn(farm);
    unsigned n = 0;
    struct letter *letter;
    STAILQ_FOREACH(letter, &farm->letters, link)
    n += letter->kind == kind;
    return n;
}

static void wait_for_connection(struct farm *farm, unsigned number)
{
    uint64_t begin = uv_hrtime();
    while (farm->connections < number) {
        if (uv_hrtime() - begin > PATIENCE_MS * UINT64_C(1000000))
            fail_msg("connection %u never came", number);
        turn(farm);
    }
}

static void send_welcome(struct farm *farm, uint64_t epoch, uint32_t dead_after_ms)
{
    Pathfarm__Welcome welcome = PATHFARM__WELCOME__INIT;
    welcome.protocol = 1;
    welcome.epoch = epoch;
    welcome.heartbeat_ms = 20;
    welcome.dead_after_ms = dead_after_ms;
    assert_true(channel_send(farm->channel, &welcome.base, NULL, NULL));
    channel_set_phase(farm->channel, PHASE_WORKING);
}

static void send_job(struct farm *farm, uint64_t id)
{
    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bundle_describe(farm->bundle, &job);
    job.job_id = id;
    job.title = (char[]){ "a test" };
    job.profile.data = profile.digest;
    job.profile.len = sizeof(profile.digest);
    assert_true(channel_send(farm->channel, &job.base, NULL, NULL));
}

static void greet(struct farm *farm)
{
    letter_free(expect(farm, PATHFARM__KIND__KIND_HELLO));
    send_welcome(farm, 5, 10000);
}

static void expect_ready(struct farm *farm, uint64_t id, enum err_code code)
{
    struct letter *letter = expect(farm, PATHFARM__KIND__KIND_JOB_READY);
    const Pathfarm__JobReady *ready = letter->message;
    assert_int_equal(ready->code, code);
    assert_int_equal(ready->job_id, id);
    letter_free(letter);
}

/* From a new connection to a worker that waits for leases. */
static void greet_and_load(struct farm *farm, uint64_t id)
{
    greet(farm);
    send_job(farm, id);
    expect_ready(farm, id, ERR_OK);
}

static void send_lease(struct farm *farm, uint64_t job_id, uint64_t lease_id, uint64_t epoch,
                       const struct node_id *nodes, size_t n)
{
    Pathfarm__Node messages[64], *list[64];
    Pathfarm__Lease lease = PATHFARM__LEASE__INIT;
    assert_true(n <= 64);
    for (size_t i = 0; i < n; i++) {
        pathfarm__node__init(&messages[i]);
        messages[i].tile = nodes[i].tile;
        messages[i].replicate = nodes[i].replicate;
        messages[i].level = nodes[i].level;
        messages[i].index = nodes[i].index;
        list[i] = &messages[i];
    }
    lease.lease_id = lease_id;
    lease.job_id = job_id;
    lease.epoch = epoch;
    lease.nodes = list;
    lease.n_nodes = n;
    assert_true(channel_send(farm->channel, &lease.base, NULL, NULL));
}

static void send_accepted(struct farm *farm, uint64_t accepted, uint64_t durable)
{
    Pathfarm__Accepted message = PATHFARM__ACCEPTED__INIT;
    message.accepted_through = accepted;
    message.durable_through = durable;
    message.epoch = 5;
    assert_true(channel_send(farm->channel, &message.base, NULL, NULL));
}

static struct node_sums *by_definition(struct renderer *renderer, const struct farm *farm,
                                       struct node_id id)
{
    struct tile_rect rect = tile_rect(farm->scene, id.tile);
    if (id.level == 0) {
        struct node_sums *sums = node_sums_new(rect.width * rect.height, 3);
        assert_true(renderer_simulated.leaf(renderer, renderer, id.tile, id.replicate, id.index,
                                            sums, NULL));
        return sums;
    }
    struct node_id below = { id.tile, id.replicate, id.level - 1, 2 * id.index };
    struct node_sums *left = by_definition(renderer, farm, below);
    below.index++;
    struct node_sums *right = by_definition(renderer, farm, below);
    node_sums_add(left, right);
    node_sums_free(right);
    return left;
}

/* The bytes of a RESULT are those of its node, its checksum is right, and its names are. */
static void assert_is_right(const struct farm *farm, const struct letter *letter, uint64_t job_id)
{
    const Pathfarm__Result *result = letter->message;
    assert_non_null(result->node);
    struct node_id id = { result->node->tile, result->node->replicate, result->node->level,
                          result->node->index };
    struct renderer *renderer = renderer_simulated.open(farm->scene, &farm->spec, 1, NULL);
    struct node_sums *sums = by_definition(renderer, farm, id);
    size_t size = node_wire_size(sums);
    uint8_t *want = malloc(size);
    assert_true(node_wire_encode(sums, want, size));
    assert_int_equal(letter->bulk_size, size);
    assert_memory_equal(letter->bulk, want, size);
    assert_true(digest_checksum_matches(letter->bulk, letter->bulk_size, result->checksum.data,
                                        result->checksum.len));
    assert_int_equal(result->job_id, job_id);
    assert_int_equal(result->job_digest.len, DIGEST_SIZE);
    assert_memory_equal(result->job_digest.data, bundle_job_digest(farm->bundle)->bytes,
                        DIGEST_SIZE);
    free(want);
    node_sums_free(sums);
    renderer_simulated.close(renderer);
}

static const struct node_id six_nodes[] = {
    { 0, 0, 0, 0 }, { 1, 1, 3, 0 }, { 2, 2, 2, 1 }, { 3, 3, 0, 7 }, { 4, 0, 1, 0 }, { 5, 1, 0, 0 },
};

/* ---- the tests ---- */

static void a_lease_comes_back_as_the_sums_of_its_nodes(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);

    struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_HELLO);
    const Pathfarm__Hello *hello = letter->message;
    assert_int_equal(hello->cores, 2);
    assert_int_equal(hello->profile.len, DIGEST_SIZE);
    assert_string_equal(hello->profile_text, "simulated 1");
    assert_true(hello->process_nonce != 0);
    letter_free(letter);
    send_welcome(&farm, 5, 10000);
    send_job(&farm, 77);
    expect_ready(&farm, 77, ERR_OK);
    send_lease(&farm, 77, 9, 5, six_nodes, 6);
    uint64_t sequence = 0;
    for (int i = 0; i < 6; i++) {
        letter = expect(&farm, PATHFARM__KIND__KIND_RESULT);
        const Pathfarm__Result *result = letter->message;
        assert_is_right(&farm, letter, 77);
        assert_int_equal(result->lease_id, 9);
        assert_true(result->sequence > sequence);
        sequence = result->sequence;
        letter_free(letter);
    }
    letter = expect(&farm, PATHFARM__KIND__KIND_PROGRESS);
    const Pathfarm__Progress *progress = letter->message;
    assert_true(progress->samples > 0);
    assert_true(progress->resident_bytes > 0);
    letter_free(letter);

    Pathfarm__JobDone done = PATHFARM__JOB_DONE__INIT;
    done.job_id = 77;
    assert_true(channel_send(farm.channel, &done.base, NULL, NULL));
    send_job(&farm, 78); /* the same job, from the start */
    expect_ready(&farm, 78, ERR_OK);
    assert_int_equal(farm.connections, 1);
    farm_close(&farm);
}

static void results_that_are_not_durable_are_offered_again(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);
    struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_HELLO);
    uint64_t nonce = ((Pathfarm__Hello *)letter->message)->process_nonce;
    letter_free(letter);
    send_welcome(&farm, 5, 10000);
    send_job(&farm, 1);
    expect_ready(&farm, 1, ERR_OK);
    send_lease(&farm, 1, 9, 5, six_nodes, 6);
    for (int i = 0; i < 6; i++)
        letter_free(expect(&farm, PATHFARM__KIND__KIND_RESULT));
    send_accepted(&farm, 6, 2); /* two of six are durable */
    channel_close(farm.channel);

    wait_for_connection(&farm, 2);
    letter = expect(&farm, PATHFARM__KIND__KIND_HELLO);
    const Pathfarm__Hello *hello = letter->message;
    assert_true(hello->process_nonce == nonce);
    assert_int_equal(hello->outbox_results, 4);
    letter_free(letter);
    unsigned served = farm.slices_served;
    send_welcome(&farm, 6, 10000); /* the next master: a larger epoch, another name for the job */
    send_job(&farm, 2);
    expect_ready(&farm, 2, ERR_OK);
    uint64_t last = 6;
    for (int i = 0; i < 4; i++) {
        letter = expect(&farm, PATHFARM__KIND__KIND_RESULT);
        assert_is_right(&farm, letter, 2);
        assert_true(((Pathfarm__Result *)letter->message)->sequence > last);
        last = ((Pathfarm__Result *)letter->message)->sequence;
        letter_free(letter);
    }
    assert_int_equal(count(&farm, PATHFARM__KIND__KIND_RESULT, 50), 0);
    assert_int_equal(farm.slices_served, served);
    farm_close(&farm);
}

static void a_full_outbox_holds_the_threads_until_results_are_durable(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    options.outbox_results = 3;
    worker_start(&farm, &options);
    greet_and_load(&farm, 1);
    struct node_id nodes[40];
    for (unsigned i = 0; i < 40; i++)
        nodes[i] = (struct node_id){ i % 6, i % 4, 0, i };
    send_lease(&farm, 1, 9, 5, nodes, 40);
    assert_int_equal(count(&farm, PATHFARM__KIND__KIND_RESULT, 100), 3);
    for (unsigned i = 1; i <= 40; i++) {
        letter_free(expect(&farm, PATHFARM__KIND__KIND_RESULT));
        send_accepted(&farm, i, i);
    }
    farm_close(&farm);
}

static void a_failing_node_is_reported_and_the_others_are_rendered(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    setenv("PATHFARM_SIMULATED_FAIL", "1", 1);
    worker_start(&farm, &options);
    greet_and_load(&farm, 1);
    unsetenv("PATHFARM_SIMULATED_FAIL");
    send_lease(&farm, 1, 9, 5, &six_nodes[1], 1);
    struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_NODE_FAILED);
    const Pathfarm__NodeFailed *failed = letter->message;
    assert_int_equal(failed->code, ERR_RENDER);
    assert_string_equal(failed->reason, "simulated failure of tile 1");
    assert_int_equal(failed->node->tile, 1);
    assert_int_equal(failed->lease_id, 9);
    letter_free(letter);
    send_lease(&farm, 1, 10, 5, six_nodes, 1);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_RESULT));
    farm_close(&farm);
}

static void what_cannot_be_loaded_is_said_in_job_ready(void **state)
{
    (void)state;
    static const struct {
        const char *what;
        enum err_code code;
    } cases[] = { { "a scene that lies about itself", ERR_SCENE },
                  { "a spec without lanes", ERR_ARGUMENT },
                  { "another numeric profile", ERR_PROFILE },
                  { "more memory than there is", ERR_MEMORY },
                  { "a technique to do without that nobody knows", ERR_ARGUMENT },
                  { "something in a place that is kept free", ERR_ARGUMENT } };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct farm farm;
        farm_open(&farm);
        struct session_options options = some_options(&farm);
        struct profile other = profile;
        bundle_free(farm.bundle);
        if (i == 0)
            farm.scene->settings.effects ^= 1;
        if (i == 1)
            farm.spec.max_lanes = 0;
        if (i == 2)
            other.digest[7] ^= 1;
        if (i == 3)
            options.max_memory = 1;
        if (i == 4)
            farm.spec.techniques_off = TECHNIQUE_ALL + 1;
        if (i == 5)
            farm.spec.reserved[0] = 1;
        options.profile = &other;
        farm.bundle = bundle_from_scene(farm.scene, &farm.spec, NULL);
        assert_non_null(farm.bundle);
        worker_start(&farm, &options);
        greet(&farm);
        send_job(&farm, 4);
        expect_ready(&farm, 4, cases[i].code);
        assert_int_equal(farm.connections, 1);
        farm_close(&farm);
    }
}

/* A worker keeps what it got beside its work */
static void wait_until_kept(const char *dir)
{
    struct cache *cache = cache_open(dir, LIMIT_GIB, NULL);
    assert_non_null(cache);
    while (cache_used(cache) == 0)
        usleep(1000);
    cache_close(cache);
}

static void a_cached_scene_does_not_cross_the_wire_again(void **state)
{
    (void)state;
    char dir[] = "/tmp/test_worker_session.XXXXXX";
    assert_non_null(mkdtemp(dir));
    for (int run = 0; run < 2; run++) {
        struct farm farm;
        farm_open(&farm);
        float corners[] = { 0, 0, 1, 1, 0, 1, 0, 1, 1 }; /* something to carry: spare positions */
        farm.scene->positions = corners;
        farm.scene->vertex_count = 3;
        bundle_free(farm.bundle);
        farm.bundle = bundle_from_scene(farm.scene, &farm.spec, NULL);
        struct session_options options = some_options(&farm);
        options.cache_dir = dir;
        worker_start(&farm, &options);
        greet(&farm);
        send_job(&farm, 1);
        struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_JOB_READY);
        const Pathfarm__JobReady *ready = letter->message;
        assert_int_equal(ready->code, ERR_OK);
        assert_int_equal(ready->cached, run == 1);
        assert_int_equal(farm.slices_served, run == 0 ? 1 : 0);
        letter_free(letter);
        send_lease(&farm, 1, 9, 5, six_nodes, 1);
        letter_free(expect(&farm, PATHFARM__KIND__KIND_RESULT));
        wait_until_kept(dir);
        farm_close(&farm);
    }
    char command[128];
    snprintf(command, sizeof(command), "rm -r %s", dir);
    assert_int_equal(system(command), 0);
}

static void a_large_object_comes_in_slices_over_as_many_connections_as_it_takes(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    const uint32_t vertices = 1000000; /* 12 MB: three slices */
    farm.scene->positions = calloc(3 * (size_t)vertices, sizeof(float));
    for (uint32_t i = 0; i < 3 * vertices; i++)
        farm.scene->positions[i] = (float)i;
    farm.scene->vertex_count = vertices;
    float *positions = farm.scene->positions;
    bundle_free(farm.bundle);
    farm.bundle = bundle_from_scene(farm.scene, &farm.spec, NULL);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);

    farm.slices_max = 2;
    greet(&farm);
    send_job(&farm, 1);
    uint64_t begin = uv_hrtime();
    while (farm.slices_served < 2 && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000))
        turn(&farm);
    assert_int_equal(count(&farm, PATHFARM__KIND__KIND_JOB_READY, 50), 0);
    channel_close(farm.channel);

    wait_for_connection(&farm, 2);
    farm.slices_max = 0;
    greet_and_load(&farm, 2);
    assert_int_equal(farm.slices_served, 3); /* what had come was kept */
    send_lease(&farm, 2, 9, 5, six_nodes, 1);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_RESULT));
    farm_close(&farm);
    free(positions);
}

static void a_master_out_of_turn_is_refused_and_met_again(void **state)
{
    (void)state;
    enum {
        UNKNOWN_JOB,
        NO_SUCH_TILE,
        NO_SUCH_LEVEL,
        OLD_EPOCH_LEASE,
        TWICE,
        SLICE,
        TOO_MUCH,
        CASES
    };
    static const char *const words[CASES] = {
        [UNKNOWN_JOB] = "not ready here",
        [NO_SUCH_TILE] = "which the job does not have",
        [NO_SUCH_LEVEL] = "which the job does not have",
        [OLD_EPOCH_LEASE] = "a lease of epoch 4 in epoch 5",
        [TWICE] = "offered twice",
        [SLICE] = "nobody asked for",
        [TOO_MUCH] = "accepted through 8",
    };
    for (int i = 0; i < CASES; i++) {
        struct farm farm;
        farm_open(&farm);
        struct session_options options = some_options(&farm);
        worker_start(&farm, &options);
        greet_and_load(&farm, 1);
        Pathfarm__ObjectSlice slice = PATHFARM__OBJECT_SLICE__INIT;
        switch (i) {
        case UNKNOWN_JOB:
            send_lease(&farm, 2, 9, 5, six_nodes, 1);
            break;
        case NO_SUCH_TILE:
            send_lease(&farm, 1, 9, 5, &(struct node_id){ 6, 0, 0, 0 }, 1);
            break;
        case NO_SUCH_LEVEL:
            send_lease(&farm, 1, 9, 5, &(struct node_id){ 0, 0, 41, 0 }, 1);
            break;
        case OLD_EPOCH_LEASE:
            send_lease(&farm, 1, 9, 4, six_nodes, 1);
            break;
        case TWICE:
            send_job(&farm, 2);
            break;
        case SLICE:
            assert_true(channel_send(farm.channel, &slice.base, NULL, NULL));
            break;
        case TOO_MUCH:
            send_accepted(&farm, 8, 8);
            break;
        }
        struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_REFUSED);
        assert_non_null(strstr(((Pathfarm__Refused *)letter->message)->reason, words[i]));
        letter_free(letter);
        wait_for_connection(&farm, 2);
        assert_true(was_said(words[i]));
        greet_and_load(&farm, 1);
        farm_close(&farm);
    }
}

static void an_old_master_is_refused(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);
    greet(&farm); /* epoch 5 */
    letter_free(expect(&farm, PATHFARM__KIND__KIND_PROGRESS));
    channel_close(farm.channel);
    wait_for_connection(&farm, 2);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_HELLO));
    send_welcome(&farm, 4, 10000);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_REFUSED));
    wait_for_connection(&farm, 3);
    assert_true(was_said("epoch is 4"));
    greet_and_load(&farm, 1);
    farm_close(&farm);
}

static void a_message_in_the_wrong_phase_ends_the_connection(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_HELLO));
    send_job(&farm, 1); /* before WELCOME */
    wait_for_connection(&farm, 2);
    greet(&farm);
    send_welcome(&farm, 5, 10000); /* a second one */
    wait_for_connection(&farm, 3);
    greet_and_load(&farm, 1);
    farm_close(&farm);
}

static void a_silent_master_is_left(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    worker_start(&farm, &options);
    letter_free(expect(&farm, PATHFARM__KIND__KIND_HELLO));
    send_welcome(&farm, 5, 60);
    wait_for_connection(&farm, 2);
    greet_and_load(&farm, 1);
    farm_close(&farm);
}

static void a_worker_that_is_told_to_stop_hands_in_what_it_began(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    setenv("PATHFARM_SIMULATED_US", "20000", 1);
    worker_start(&farm, &options);
    greet_and_load(&farm, 1);
    unsetenv("PATHFARM_SIMULATED_US");
    struct node_id nodes[20];
    for (unsigned i = 0; i < 20; i++)
        nodes[i] = (struct node_id){ i % 6, i % 4, 0, i };
    send_lease(&farm, 1, 9, 5, nodes, 20);
    struct letter *letter = expect(&farm, PATHFARM__KIND__KIND_RESULT);
    send_accepted(&farm, 1, 1);
    letter_free(letter);
    session_drain(farm.session);
    unsigned results = 1;
    uint64_t begin = uv_hrtime();
    bool goodbye = false;
    while (!goodbye && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000)) {
        turn(&farm);
        while ((letter = STAILQ_FIRST(&farm.letters)) != NULL) {
            STAILQ_REMOVE_HEAD(&farm.letters, link);
            if (letter->kind == PATHFARM__KIND__KIND_RESULT) {
                results++;
                send_accepted(&farm, results, results);
            }
            goodbye |= letter->kind == PATHFARM__KIND__KIND_GOODBYE;
            letter_free(letter);
        }
    }
    assert_true(goodbye);
    assert_in_range(results, 2, 10);
    while (!farm.ended)
        turn(&farm);
    assert_int_equal(farm.status, 0);
    farm_close(&farm);
}

static void with_once_the_end_of_the_connection_is_the_end(void **state)
{
    (void)state;
    for (int orderly = 0; orderly < 2; orderly++) {
        struct farm farm;
        farm_open(&farm);
        struct session_options options = some_options(&farm);
        options.once = true;
        worker_start(&farm, &options);
        greet_and_load(&farm, 1);
        Pathfarm__Goodbye goodbye = PATHFARM__GOODBYE__INIT;
        if (orderly)
            assert_true(channel_send(farm.channel, &goodbye.base, NULL, NULL));
        channel_close(farm.channel);
        uint64_t begin = uv_hrtime();
        while (!farm.ended && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000))
            turn(&farm);
        assert_true(farm.ended);
        assert_int_equal(farm.status, orderly ? 0 : 1);
        assert_int_equal(farm.connections, 1);
        farm_close(&farm);
    }
}

static void with_once_a_master_that_is_not_there_is_not_waited_for(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    options.port = 9; /* discard: nobody listens */
    options.once = true;
    options.once_connect_ms = 100;
    worker_start(&farm, &options);
    uint64_t begin = uv_hrtime();
    while (!farm.ended && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000))
        turn(&farm);
    assert_true(farm.ended);
    assert_int_equal(farm.status, 1);
    farm_close(&farm);
}

static void without_keys_a_master_elsewhere_is_refused(void **state)
{
    (void)state;
    struct farm farm;
    farm_open(&farm);
    struct session_options options = some_options(&farm);
    options.host = "192.0.2.1";
    worker_start(&farm, &options);
    uint64_t begin = uv_hrtime();
    while (!farm.ended && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000))
        turn(&farm);
    assert_true(farm.ended);
    assert_int_equal(farm.status, 1);
    assert_true(was_said("192.0.2.1"));
    assert_true(was_said("keys"));
    farm_close(&farm);
}

/* ---- a master that speaks no frames at all ---- */

struct babbler {
    uv_tcp_t server;
    uv_buf_t bytes;
    bool hang_up;
    unsigned connections;
};

struct babble {
    uv_tcp_t tcp;
    uv_write_t write;
    bool hang_up;
};

static void babble_closed(uv_handle_t *handle)
{
    free(handle->data);
}

static void babble_alloc(uv_handle_t *handle, size_t suggested, uv_buf_t *buf)
{
    static char sink[4096];
    (void)handle;
    (void)suggested;
    *buf = uv_buf_init(sink, sizeof(sink));
}

static void babble_read(uv_stream_t *stream, ssize_t size, const uv_buf_t *buf)
{
    (void)buf;
    if (size < 0 && !uv_is_closing((uv_handle_t *)stream))
        uv_close((uv_handle_t *)stream, babble_closed);
}

static void babble_written(uv_write_t *write, int status)
{
    struct babble *babble = write->data;
    (void)status;
    if (babble->hang_up && !uv_is_closing((uv_handle_t *)&babble->tcp))
        uv_close((uv_handle_t *)&babble->tcp, babble_closed);
}

static void on_babbler(uv_stream_t *server, int status)
{
    struct babbler *babbler = server->data;
    (void)status;
    struct babble *babble = calloc(1, sizeof(*babble));
    uv_tcp_init(server->loop, &babble->tcp);
    babble->tcp.data = babble->write.data = babble;
    babble->hang_up = babbler->hang_up;
    uv_accept(server, (uv_stream_t *)&babble->tcp);
    uv_read_start((uv_stream_t *)&babble->tcp, babble_alloc, babble_read);
    uv_write(&babble->write, (uv_stream_t *)&babble->tcp, &babbler->bytes, 1, babble_written);
    babbler->connections++;
}

static void garbage_and_half_messages_end_the_connection_and_nothing_else(void **state)
{
    (void)state;
    static char half[] = { 16, 0, 0, 0, 0, 0, 0, 0, PATHFARM__KIND__KIND_WELCOME, 0, 0, 0, 8 };
    static char huge[] = { -1, -1, -1, -1, -1, -1, -1, -1, PATHFARM__KIND__KIND_WELCOME, 0, 0, 0 };
    static char wrong[] = { 4, 0, 0, 0,  0,  0,  0, 0, PATHFARM__KIND__KIND_WELCOME,
                            0, 0, 0, -1, -1, -1, -1 };
    static char prose[] = "HTTP/1.1 400 Bad Request\r\n\r\n";
    static const struct {
        char *bytes;
        unsigned size;
        bool hang_up;
    } cases[] = { { half, 13, true },
                  { half, 5, true },
                  { huge, 12, false },
                  { wrong, 16, false },
                  { prose, 28, false } };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct farm farm;
        farm_open(&farm);
        struct babbler babbler = { .bytes = uv_buf_init(cases[i].bytes, cases[i].size),
                                   .hang_up = cases[i].hang_up };
        struct sockaddr_in address;
        int size = sizeof(address);
        uv_tcp_init(&farm.loop, &babbler.server);
        babbler.server.data = &babbler;
        uv_ip4_addr("127.0.0.1", 0, &address);
        assert_int_equal(uv_tcp_bind(&babbler.server, (struct sockaddr *)&address, 0), 0);
        assert_int_equal(uv_listen((uv_stream_t *)&babbler.server, 8, on_babbler), 0);
        uv_tcp_getsockname(&babbler.server, (struct sockaddr *)&address, &size);

        struct session_options options = some_options(&farm);
        options.port = ntohs(address.sin_port);
        worker_start(&farm, &options);
        uint64_t begin = uv_hrtime();
        while (babbler.connections < 3 && uv_hrtime() - begin < PATIENCE_MS * UINT64_C(1000000))
            turn(&farm);
        assert_int_equal(babbler.connections, 3);
        assert_false(farm.ended);
        uv_close((uv_handle_t *)&babbler.server, NULL);
        farm_close(&farm);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_lease_comes_back_as_the_sums_of_its_nodes),
        cmocka_unit_test(results_that_are_not_durable_are_offered_again),
        cmocka_unit_test(a_full_outbox_holds_the_threads_until_results_are_durable),
        cmocka_unit_test(a_failing_node_is_reported_and_the_others_are_rendered),
        cmocka_unit_test(what_cannot_be_loaded_is_said_in_job_ready),
        cmocka_unit_test(a_cached_scene_does_not_cross_the_wire_again),
        cmocka_unit_test(a_large_object_comes_in_slices_over_as_many_connections_as_it_takes),
        cmocka_unit_test(a_master_out_of_turn_is_refused_and_met_again),
        cmocka_unit_test(an_old_master_is_refused),
        cmocka_unit_test(a_message_in_the_wrong_phase_ends_the_connection),
        cmocka_unit_test(a_silent_master_is_left),
        cmocka_unit_test(a_worker_that_is_told_to_stop_hands_in_what_it_began),
        cmocka_unit_test(with_once_the_end_of_the_connection_is_the_end),
        cmocka_unit_test(with_once_a_master_that_is_not_there_is_not_waited_for),
        cmocka_unit_test(without_keys_a_master_elsewhere_is_refused),
        cmocka_unit_test(garbage_and_half_messages_end_the_connection_and_nothing_else),
    };
    journal_open(JOURNAL_DETAIL, remember_line);
    if (!profile_take(&renderer_simulated, &profile, NULL))
        return 1;
    return cmocka_run_group_tests(tests, NULL, NULL);
}
