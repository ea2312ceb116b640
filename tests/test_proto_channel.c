/*
 * The channel over real loopback sockets, plain and TLS: frames arrive whole and in order, the
 * output queue is bounded, every end is reported once with its reason, and strangers are kept out.
 */
#include "common/err.h"
#include "proto/channel.h"
#include "proto/keys.h"
#include "tests/scratch.h"

#include <arpa/inet.h>
#include <openssl/ssl.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#define PATIENCE_MS 20000

/* Both ends of one connection, and what happened at each */
struct end {
    struct channel *channel;
    unsigned frames, drains, opens, closes;
    uint64_t bulk_bytes;
    uint64_t next; /* sequence expected next */
    bool close_on_open, close_on_frame, fail_on_frame, refuse_on_frame, stay_greeting;
    struct err err;
};

struct pair {
    uv_loop_t loop;
    uv_timer_t guard;
    bool late;
    struct channel_listener *listener;
    struct end master, worker;
    unsigned refusals;
    char refused_peer[128];
    struct err refusal;
    unsigned released;
};

static char dir[256];
static struct keys *master_keys, *worker_keys, *user_keys;
static uint8_t bulk[LIMIT_SLICE];

static uint64_t sequence_of(const struct frame *frame)
{
    uint64_t sequence = 0;
    if (frame->kind == PATHFARM__KIND__KIND_RESULT) {
        Pathfarm__Result *result = frame_message(frame, NULL);
        assert_non_null(result);
        sequence = result->sequence;
        frame_message_free(result);
    } else if (frame->kind == PATHFARM__KIND__KIND_OBJECT_SLICE) {
        Pathfarm__ObjectSlice *slice = frame_message(frame, NULL);
        assert_non_null(slice);
        sequence = slice->slice;
        frame_message_free(slice);
    }
    return sequence;
}

static bool on_frame(void *owner, struct channel *channel, const struct frame *frame,
                     struct err *err)
{
    struct end *end = owner;
    assert_ptr_equal(channel, end->channel);
    assert_int_equal(end->closes, 0);
    end->frames++;
    end->bulk_bytes += frame->bulk_size;
    if (frame->kind == PATHFARM__KIND__KIND_HELLO)
        channel_set_phase(channel, PHASE_WORKING);
    if (frame->bulk_size > 0) {
        uint64_t sequence = sequence_of(frame);
        assert_int_equal(sequence, end->next);
        end->next++;
        assert_memory_equal(frame->bulk, bulk + sequence % 64, frame->bulk_size);
    }
    if (end->close_on_frame) {
        channel_close(channel);
        channel_close(channel);
    }
    if (end->fail_on_frame)
        channel_fail(channel, &(struct err){ .code = ERR_CANCELLED, .text = "done with it" });
    if (end->refuse_on_frame)
        return err_set(err, ERR_RENDER, "not this frame");
    return true;
}

static void on_open(void *owner, struct channel *channel)
{
    struct end *end = owner;
    end->opens++;
    if (!end->stay_greeting)
        channel_set_phase(channel, PHASE_WORKING);
    if (end->close_on_open)
        channel_close(channel);
}

static void on_drain(void *owner, struct channel *channel)
{
    (void)channel;
    ((struct end *)owner)->drains++;
}

static void on_close(void *owner, struct channel *channel, const struct err *err)
{
    struct end *end = owner;
    assert_ptr_equal(channel, end->channel);
    end->closes++;
    end->err = *err;
    end->channel = NULL;
}

static const struct channel_events events = { on_open, on_frame, on_drain, on_close };

static void on_accept(void *owner, struct channel *channel)
{
    struct pair *pair = owner;
    assert_int_equal(channel_phase(channel), PHASE_GREETING);
    pair->master.channel = channel;
    channel_set_events(channel, &events, &pair->master);
    if (!pair->master.stay_greeting)
        channel_set_phase(channel, PHASE_WORKING);
    if (pair->master.close_on_open)
        channel_close(channel);
}

static void on_refused(void *owner, const char *peer, const struct err *err)
{
    struct pair *pair = owner;
    pair->refusals++;
    snprintf(pair->refused_peer, sizeof(pair->refused_peer), "%s", peer);
    pair->refusal = *err;
}

static const struct channel_listener_events listener_events = { on_accept, on_refused };

static void on_guard(uv_timer_t *timer)
{
    ((struct pair *)timer->data)->late = true;
}

static bool is_tls(void **state)
{
    return *(const bool *)*state;
}

static struct channel_options options(const struct keys *keys, unsigned peers)
{
    return (struct channel_options){ keys, peers, channel_limits_default() };
}

static void pair_init(struct pair *pair)
{
    *pair = (struct pair){ 0 };
    uv_loop_init(&pair->loop);
    uv_timer_init(&pair->loop, &pair->guard);
    pair->guard.data = pair;
    uv_timer_start(&pair->guard, on_guard, PATIENCE_MS, 0);
    uv_unref((uv_handle_t *)&pair->guard);
}

static void pair_listen(struct pair *pair, const struct channel_options *options)
{
    pair->listener = channel_listen(&pair->loop, "127.0.0.1", 0, options, &listener_events, pair,
                                    NULL);
    assert_non_null(pair->listener);
    assert_int_not_equal(channel_listener_port(pair->listener), 0);
}

static void pair_connect(struct pair *pair, const struct channel_options *options)
{
    pair->worker.channel = channel_connect(&pair->loop, "127.0.0.1",
                                           channel_listener_port(pair->listener), options, &events,
                                           &pair->worker, NULL);
    assert_non_null(pair->worker.channel);
}

#define RUN_UNTIL(pair, condition)                      \
    do {                                                \
        while (!(condition) && !(pair)->late)           \
            uv_run(&(pair)->loop, UV_RUN_ONCE);         \
        if (!(condition))                               \
            fail_msg("in vain waited for " #condition); \
    } while (0)

static void pair_open(struct pair *pair, bool tls, size_t queue_bytes)
{
    struct channel_options master = options(tls ? master_keys : NULL, ROLE_WORKER);
    struct channel_options worker = options(tls ? worker_keys : NULL, ROLE_MASTER);
    if (queue_bytes > 0)
        master.limits.queue_bytes = worker.limits.queue_bytes = queue_bytes;
    pair_init(pair);
    pair_listen(pair, &master);
    pair_connect(pair, &worker);
    RUN_UNTIL(pair, pair->master.channel != NULL && pair->worker.opens == 1);
}

/* Close what is open, and see that the loop has nothing left */
static void pair_end(struct pair *pair)
{
    if (pair->worker.channel != NULL)
        channel_close(pair->worker.channel);
    if (pair->master.channel != NULL)
        channel_close(pair->master.channel);
    channel_listener_close(pair->listener);
    uv_close((uv_handle_t *)&pair->guard, NULL);
    uv_run(&pair->loop, UV_RUN_DEFAULT);
    assert_int_equal(uv_loop_close(&pair->loop), 0);
    assert_true(pair->worker.closes <= 1 && pair->master.closes <= 1);
    assert_null(pair->worker.channel);
    assert_null(pair->master.channel);
}

static void count_release(void *context)
{
    ++*(unsigned *)context;
}

static bool send_result(struct pair *pair, uint64_t sequence, size_t size, struct err *err)
{
    Pathfarm__Node node = PATHFARM__NODE__INIT;
    Pathfarm__Result result = PATHFARM__RESULT__INIT;
    result.node = &node;
    result.sequence = sequence;
    struct channel_bulk data = { bulk + sequence % 64, size, count_release, &pair->released };
    if (sequence % 3 == 0) /* a third is copied */
        data.release = NULL;
    return channel_send(pair->worker.channel, &result.base, &data, err);
}

static bool send_slice(struct pair *pair, uint64_t slice, size_t size, struct err *err)
{
    Pathfarm__ObjectSlice message = PATHFARM__OBJECT_SLICE__INIT;
    message.slice = slice;
    struct channel_bulk data = { bulk + slice % 64, size, channel_lent, NULL };
    return channel_send(pair->master.channel, &message.base, &data, err);
}

static void send_accepted(struct pair *pair)
{
    Pathfarm__Accepted accepted = PATHFARM__ACCEPTED__INIT;
    assert_true(channel_send(pair->master.channel, &accepted.base, NULL, NULL));
}

static void thousands_of_results_arrive_in_order(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    const uint64_t count = 3000;
    uint64_t sent = 0;
    while (sent < count) {
        while (sent < count && channel_queued(pair.worker.channel) < 4 * LIMIT_MIB) {
            assert_true(send_result(&pair, sent, sent % 100 == 99 ? 1 : 12288 + sent % 5, NULL));
            sent++;
        }
        uv_run(&pair.loop, UV_RUN_ONCE);
        if (pair.master.frames % 2 == 1)
            send_accepted(&pair);
    }
    RUN_UNTIL(&pair, pair.master.frames == count);
    assert_int_equal(pair.master.next, count);
    RUN_UNTIL(&pair, channel_queued(pair.worker.channel) == 0);
    assert_int_equal(pair.released, count - count / 3);
    assert_true(channel_bytes_out(pair.worker.channel) >= pair.master.bulk_bytes);
    assert_int_equal(channel_bytes_out(pair.worker.channel), channel_bytes_in(pair.master.channel));
    assert_int_equal(channel_is_tls(pair.master.channel), is_tls(state));
    assert_int_equal(channel_peer_roles(pair.master.channel), ROLE_WORKER);
    assert_int_equal(channel_peer_roles(pair.worker.channel), ROLE_MASTER);
    assert_memory_equal(channel_peer(pair.master.channel), "127.0.0.1:", 10);
    pair_end(&pair);
}

/* Before the listening side has even judged its certificate */
static void a_peer_may_send_much_as_soon_as_it_is_open(void **state)
{
    struct pair pair;
    struct channel_options master = options(is_tls(state) ? master_keys : NULL, ROLE_WORKER);
    struct channel_options worker = options(is_tls(state) ? worker_keys : NULL, ROLE_MASTER);
    pair_init(&pair);
    pair_listen(&pair, &master);
    pair_connect(&pair, &worker);
    RUN_UNTIL(&pair, pair.worker.opens == 1);
    for (uint64_t i = 0; i < 100; i++)
        assert_true(send_result(&pair, i, 12288, NULL));
    RUN_UNTIL(&pair, pair.master.frames == 100);
    pair_end(&pair);
}

static void big_bulks_arrive_both_ways_of_owning_them(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    assert_true(send_slice(&pair, 0, LIMIT_SLICE - 64, NULL));
    assert_true(send_slice(&pair, 1, LIMIT_SLICE - 64, NULL));
    assert_true(send_slice(&pair, 2, LIMIT_SLICE - 64, NULL));
    assert_true(send_result(&pair, 0, LIMIT_NODE_BULK, NULL)); /* copied */
    assert_true(send_result(&pair, 1, LIMIT_NODE_BULK, NULL)); /* handed over */
    RUN_UNTIL(&pair, pair.worker.frames == 3 && pair.master.frames == 2);
    assert_int_equal(pair.worker.bulk_bytes, 3 * (LIMIT_SLICE - 64));
    pair_end(&pair);
    assert_int_equal(pair.released, 1);
}

static void a_full_queue_refuses_and_says_when_it_has_drained(void **state)
{
    struct pair pair;
    struct err err = { 0 };
    pair_open(&pair, is_tls(state), LIMIT_MIB);
    channel_pause(pair.master.channel, true);
    uint64_t sent = 0;
    /* The kernel takes a few MiB; then the queue fills up */
    while (send_result(&pair, sent, 65536, &err)) {
        sent++;
        uv_run(&pair.loop, UV_RUN_NOWAIT);
        assert_true(sent < 1000);
    }
    assert_int_equal(err.code, ERR_LIMIT);
    assert_true(channel_queued(pair.worker.channel) >= LIMIT_MIB);
    assert_true(channel_queued(pair.worker.channel) < LIMIT_MIB + 2 * 65536);
    unsigned before = pair.worker.drains;
    channel_pause(pair.master.channel, false);
    RUN_UNTIL(&pair, pair.worker.drains > before);
    assert_true(channel_queued(pair.worker.channel) < LIMIT_MIB / 2);
    assert_true(send_result(&pair, sent++, 65536, NULL));
    RUN_UNTIL(&pair, pair.master.frames == sent);
    pair_end(&pair);
}

static void a_close_flushes_what_was_sent_before_it(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    for (uint64_t i = 0; i < 300; i++)
        assert_true(send_result(&pair, i, 20000, NULL));
    channel_close(pair.worker.channel);
    struct err err = { 0 };
    assert_false(send_result(&pair, 300, 1, &err));
    assert_int_equal(err.code, ERR_PEER);
    RUN_UNTIL(&pair, pair.master.closes == 1 && pair.worker.closes == 1);
    assert_int_equal(pair.master.frames, 300);
    assert_int_equal(pair.worker.err.code, ERR_OK);
    assert_int_equal(pair.master.err.code, ERR_PEER);
    assert_string_equal(pair.master.err.text, "the peer closed the connection");
    assert_int_equal(pair.released, 200);
    pair_end(&pair);
}

static void both_ends_may_close_at_once(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    assert_true(send_result(&pair, 0, 20000, NULL));
    channel_close(pair.worker.channel);
    channel_close(pair.master.channel);
    RUN_UNTIL(&pair, pair.master.closes == 1 && pair.worker.closes == 1);
    assert_int_equal(pair.worker.err.code, ERR_OK);
    assert_int_equal(pair.master.err.code, ERR_OK);
    assert_int_equal(pair.master.frames, 0); /* closed: it hears nothing more */
    pair_end(&pair);
}

static void callbacks_may_end_the_channel(void **state)
{
    struct pair pair;
    struct end *master = &pair.master;
    for (int how = 0; how < 3; how++) {
        pair_open(&pair, is_tls(state), 0);
        master->close_on_frame = how == 0;
        master->fail_on_frame = how == 1;
        master->refuse_on_frame = how == 2;
        for (uint64_t i = 0; i < 5; i++)
            assert_true(send_result(&pair, i, 100, NULL));
        RUN_UNTIL(&pair, master->closes == 1 && pair.worker.closes == 1);
        assert_int_equal(master->frames, 1);
        assert_int_equal(master->err.code, how == 0   ? ERR_OK
                                           : how == 1 ? ERR_CANCELLED
                                                      : ERR_RENDER);
        assert_int_equal(pair.worker.err.code, ERR_PEER);
        pair_end(&pair);
    }
}

static void a_channel_may_be_closed_as_soon_as_it_opens(void **state)
{
    struct pair pair;
    for (int which = 0; which < 2; which++) {
        struct channel_options master = options(is_tls(state) ? master_keys : NULL, ROLE_WORKER);
        struct channel_options worker = options(is_tls(state) ? worker_keys : NULL, ROLE_MASTER);
        pair_init(&pair);
        pair.master.close_on_open = which == 0;
        pair.worker.close_on_open = which == 1;
        pair_listen(&pair, &master);
        pair_connect(&pair, &worker);
        RUN_UNTIL(&pair, pair.worker.closes == 1);
        pair_end(&pair);
    }
}

static void a_channel_may_be_closed_while_it_connects(void **state)
{
    struct pair pair;
    struct channel_options master = options(is_tls(state) ? master_keys : NULL, ROLE_WORKER);
    struct channel_options worker = options(is_tls(state) ? worker_keys : NULL, ROLE_MASTER);
    pair_init(&pair);
    pair_listen(&pair, &master);
    pair_connect(&pair, &worker);
    channel_close(pair.worker.channel);
    RUN_UNTIL(&pair, pair.worker.closes == 1);
    assert_int_equal(pair.worker.opens, 0);
    assert_int_equal(pair.worker.err.code, ERR_OK);

    pair.worker.channel = channel_connect(&pair.loop, "localhost", 1, &worker, &events,
                                          &pair.worker, NULL);
    channel_close(pair.worker.channel); /* the name is being looked up */
    RUN_UNTIL(&pair, pair.worker.closes == 2);
    pair.worker.closes = 1;
    pair_end(&pair);
}

static void a_connection_cut_inside_a_frame_says_so(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    channel_pause(pair.worker.channel, true);
    for (int i = 0; i < 4; i++) /* more than the kernel takes */
        assert_true(send_slice(&pair, (uint64_t)i, LIMIT_SLICE - 64, NULL));
    channel_fail(pair.master.channel, &(struct err){ .code = ERR_CANCELLED, .text = "enough" });
    RUN_UNTIL(&pair, pair.master.closes == 1);
    assert_string_equal(pair.master.err.text, "enough");
    channel_pause(pair.worker.channel, false);
    RUN_UNTIL(&pair, pair.worker.closes == 1);
    assert_int_equal(pair.worker.err.code, ERR_PEER);
    assert_non_null(strstr(pair.worker.err.text, "in the middle of a OBJECT_SLICE"));
    pair_end(&pair);
}

static void a_silent_peer_is_given_up(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    channel_set_silence(pair.master.channel, 30);
    RUN_UNTIL(&pair, pair.master.closes == 1);
    assert_int_equal(pair.master.err.code, ERR_TIMEOUT);
    assert_non_null(strstr(pair.master.err.text, "silent"));
    pair_end(&pair);
}

static void a_greeting_must_come_first_and_in_time(void **state)
{
    struct pair pair;
    struct channel_options master = options(is_tls(state) ? master_keys : NULL, ROLE_WORKER);
    struct channel_options worker = options(is_tls(state) ? worker_keys : NULL, ROLE_MASTER);
    master.limits.greeting_ms = 60;
    for (int silent = 0; silent < 2; silent++) {
        pair_init(&pair);
        pair.master.stay_greeting = true;
        pair_listen(&pair, &master);
        pair_connect(&pair, &worker);
        RUN_UNTIL(&pair, pair.worker.opens == 1);
        if (!silent)
            assert_true(send_result(&pair, 0, 100, NULL));
        RUN_UNTIL(&pair, pair.master.closes == 1);
        assert_int_equal(pair.master.frames, 0);
        assert_int_equal(pair.master.err.code, silent ? ERR_TIMEOUT : ERR_MESSAGE);
        pair_end(&pair);
    }

    pair_init(&pair);
    pair.master.stay_greeting = true;
    pair_listen(&pair, &master);
    pair_connect(&pair, &worker);
    RUN_UNTIL(&pair, pair.worker.opens == 1);
    Pathfarm__Hello hello = PATHFARM__HELLO__INIT;
    hello.build = "test";
    assert_true(channel_send(pair.worker.channel, &hello.base, NULL, NULL));
    assert_true(send_result(&pair, 0, 100, NULL));
    RUN_UNTIL(&pair, pair.master.frames == 2); /* HELLO moved it on to WORKING */
    pair_end(&pair);
}

static void a_frame_of_the_wrong_role_ends_the_channel(void **state)
{
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    Pathfarm__Lease lease = PATHFARM__LEASE__INIT;
    assert_true(channel_send(pair.worker.channel, &lease.base, NULL, NULL));
    RUN_UNTIL(&pair, pair.master.closes == 1);
    assert_int_equal(pair.master.err.code, ERR_MESSAGE);
    assert_string_equal(pair.master.err.text, "a worker may not send LEASE");
    pair_end(&pair);
}

/* Strangers */

static int raw_connect(const struct pair *pair)
{
    unsigned port = channel_listener_port(pair->listener);
    struct sockaddr_in address = { .sin_family = AF_INET,
                                   .sin_port = htons((uint16_t)port),
                                   .sin_addr.s_addr = htonl(INADDR_LOOPBACK) };
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&address, sizeof(address)), 0);
    return fd;
}

static void garbage_is_refused_and_harms_nobody(void **state)
{
    static const char *const garbage[] = {
        "GET / HTTP/1.1\r\nHost: farm\r\n\r\n",
        "\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 and no more of a ClientHello",
        "\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff",
        "x",
    };
    struct pair pair;
    pair_open(&pair, is_tls(state), 0);
    for (size_t i = 0; i < sizeof(garbage) / sizeof(garbage[0]); i++) {
        struct end quiet = pair.master; /* over plain, a stranger is accepted first */
        pair.master = (struct end){ .stay_greeting = true };
        unsigned before = pair.refusals;
        int fd = raw_connect(&pair);
        assert_true(write(fd, garbage[i], strlen(garbage[i])) > 0);
        shutdown(fd, SHUT_WR);
        RUN_UNTIL(&pair, pair.refusals > before || pair.master.closes == 1);
        assert_int_equal(pair.master.frames, 0);
        assert_int_not_equal(is_tls(state) ? pair.refusal.code : pair.master.err.code, ERR_OK);
        close(fd);
        pair.master = quiet;
    }
    assert_true(send_result(&pair, 0, 12288, NULL)); /* the worker next door works on */
    RUN_UNTIL(&pair, pair.master.frames == 1);
    pair_end(&pair);
}

static void half_a_header_and_half_a_frame_are_errors(void **state)
{
    static const struct {
        uint8_t bytes[20];
        size_t size;
        const char *says;
    } cases[] = {
        { { 9, 0, 0, 0, 0 }, 5, "in the middle of a frame's header" },
        { { 9, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 8, 1 }, 14, "in the middle of a HELLO" },
    };
    (void)state;
    struct channel_options master = options(NULL, ROLE_WORKER);
    for (size_t i = 0; i < 2; i++) {
        struct pair pair;
        pair_init(&pair);
        pair.master.stay_greeting = true;
        pair_listen(&pair, &master);
        int fd = raw_connect(&pair);
        assert_int_equal(write(fd, cases[i].bytes, cases[i].size), (ssize_t)cases[i].size);
        close(fd);
        RUN_UNTIL(&pair, pair.master.closes == 1);
        assert_int_equal(pair.master.err.code, ERR_PEER);
        assert_non_null(strstr(pair.master.err.text, cases[i].says));
        pair_end(&pair);
    }
}

static void a_handshake_is_bounded_in_time_bytes_and_number(void **state)
{
    (void)state;
    struct pair pair;
    struct channel_options master = options(master_keys, ROLE_WORKER);
    struct channel_options worker = options(worker_keys, ROLE_MASTER);
    master.limits.handshake_ms = 40;
    master.limits.pending_max = 2;
    pair_init(&pair);
    pair_listen(&pair, &master);
    int fds[3];
    for (int i = 0; i < 3; i++)
        fds[i] = raw_connect(&pair);
    RUN_UNTIL(&pair, pair.refusals == 1);
    assert_int_equal(pair.refusal.code, ERR_LIMIT);
    RUN_UNTIL(&pair, pair.refusals == 3);
    assert_int_equal(pair.refusal.code, ERR_TIMEOUT);
    assert_memory_equal(pair.refused_peer, "127.0.0.1:", 10);
    for (int i = 0; i < 3; i++)
        close(fds[i]);
    pair_end(&pair);

    master.limits.handshake_ms = 10000;
    master.limits.handshake_bytes = 100;
    pair_init(&pair);
    pair_listen(&pair, &master);
    pair_connect(&pair, &worker);
    RUN_UNTIL(&pair, pair.refusals == 1 && pair.worker.closes == 1);
    assert_int_equal(pair.refusal.code, ERR_LIMIT);
    pair_end(&pair);
}

static void a_listener_that_closes_drops_those_at_its_door(void **state)
{
    (void)state;
    struct pair pair;
    struct channel_options master = options(master_keys, ROLE_WORKER);
    pair_init(&pair);
    pair_listen(&pair, &master);
    int fd = raw_connect(&pair);
    for (int i = 0; i < 3; i++)
        uv_run(&pair.loop, UV_RUN_NOWAIT);
    pair_end(&pair);
    assert_int_equal(pair.refusals, 0);
    close(fd);
}

/* The worker's side tells the user why; the master's log does too */
static void expect_turned_away(const struct channel_options *master,
                               const struct channel_options *worker, const char *master_says,
                               const char *worker_says)
{
    struct pair pair;
    pair_init(&pair);
    pair_listen(&pair, master);
    pair_connect(&pair, worker);
    RUN_UNTIL(&pair, pair.refusals == 1 && pair.worker.closes == 1);
    assert_null(pair.master.channel);
    if (strstr(pair.refusal.text, master_says) == NULL)
        fail_msg("\"%s\" does not say \"%s\"", pair.refusal.text, master_says);
    if (strstr(pair.worker.err.text, worker_says) == NULL)
        fail_msg("\"%s\" does not say \"%s\"", pair.worker.err.text, worker_says);
    pair_end(&pair);
}

static void copy_file(const char *from, const char *to)
{
    char bytes[8192];
    FILE *file = fopen(from, "rb");
    assert_non_null(file);
    size_t size = fread(bytes, 1, sizeof(bytes), file);
    fclose(file);
    scratch_write(to, bytes, size);
}

static void certificates_decide_who_comes_in(void **state)
{
    (void)state;
    struct channel_options master = options(master_keys, ROLE_WORKER);
    struct channel_options user = options(user_keys, ROLE_MASTER);
    expect_turned_away(&master, &user, "a user's, which has no business here", "TLS");

    /* A worker with a key of its own making that knows the master's certificate */
    assert_true(keys_generate(scratch_path(dir, "other"), false, NULL));
    copy_file(scratch_path(dir, "farm/master.crt"), scratch_path(dir, "other/trusted/m.crt"));
    struct keys *stranger = keys_load(scratch_path(dir, "other"), ROLE_WORKER, NULL);
    struct channel_options other = options(stranger, ROLE_MASTER);
    expect_turned_away(&master, &other, "is not one this farm trusts", "TLS");

    /* The same worker once the farm trusts it */
    copy_file(scratch_path(dir, "other/worker.crt"), scratch_path(dir, "farm/trusted/w7.crt"));
    struct keys *wiser = keys_load(scratch_path(dir, "farm"), ROLE_MASTER, NULL);
    unlink(scratch_path(dir, "farm/trusted/w7.crt"));
    struct channel_options wise = options(wiser, ROLE_WORKER);
    struct pair pair;
    pair_init(&pair);
    pair_listen(&pair, &wise);
    pair_connect(&pair, &other);
    RUN_UNTIL(&pair, pair.master.channel != NULL);
    keys_free(stranger); /* channels do not need them any more */
    pair_end(&pair);
    keys_free(wiser);

    /* Somebody else's master */
    struct keys *impostor = keys_load(scratch_path(dir, "other"), ROLE_MASTER, NULL);
    struct channel_options false_master = options(impostor, ROLE_WORKER);
    struct channel_options worker = options(worker_keys, ROLE_MASTER);
    expect_turned_away(&false_master, &worker, "TLS", "is not one this farm trusts");
    keys_free(impostor);

    /* A worker that plays the master */
    struct channel_options false_worker = options(worker_keys, ROLE_WORKER);
    expect_turned_away(&false_worker, &worker, "TLS", "is not one this farm trusts");
}

static void plain_and_tls_do_not_mix(void **state)
{
    (void)state;
    struct pair pair;
    for (int tls_master = 0; tls_master < 2; tls_master++) {
        struct channel_options master = options(tls_master ? master_keys : NULL, ROLE_WORKER);
        struct channel_options worker = options(tls_master ? NULL : worker_keys, ROLE_MASTER);
        pair_init(&pair);
        pair.master.stay_greeting = true;
        pair.worker.stay_greeting = true;
        pair_listen(&pair, &master);
        pair_connect(&pair, &worker);
        if (tls_master) {
            RUN_UNTIL(&pair, pair.worker.opens == 1); /* as far as it can tell */
            Pathfarm__Hello hello = PATHFARM__HELLO__INIT;
            assert_true(channel_send(pair.worker.channel, &hello.base, NULL, NULL));
        }
        RUN_UNTIL(&pair, pair.worker.closes == 1);
        assert_int_not_equal(pair.worker.err.code, ERR_OK);
        RUN_UNTIL(&pair, pair.refusals + pair.master.closes == 1);
        pair_end(&pair);
    }
}

/* A TLS client of OpenSSL's own, on a thread, that is not one of ours */
struct stranger {
    int fd;
    int version_max;
    bool certificate;
    bool got_in;
};

static void *run_stranger(void *context)
{
    struct stranger *stranger = context;
    SSL_CTX *ssl_context = SSL_CTX_new(TLS_client_method());
    SSL_CTX_set_max_proto_version(ssl_context, stranger->version_max);
    if (stranger->certificate) {
        SSL_CTX_use_certificate_file(ssl_context, scratch_path(dir, "farm/worker.crt"),
                                     SSL_FILETYPE_PEM);
        SSL_CTX_use_PrivateKey_file(ssl_context, scratch_path(dir, "farm/worker.key"),
                                    SSL_FILETYPE_PEM);
    }
    SSL *ssl = SSL_new(ssl_context);
    SSL_set_fd(ssl, stranger->fd);
    char byte;
    /* TLS 1.3: the client is done before the server has judged it; a read tells */
    stranger->got_in = SSL_connect(ssl) == 1 && SSL_write(ssl, "x", 1) == 1 &&
                       SSL_read(ssl, &byte, 1) == 1;
    SSL_free(ssl);
    SSL_CTX_free(ssl_context);
    shutdown(stranger->fd, SHUT_RDWR);
    return NULL;
}

static void no_certificate_or_an_old_tls_is_refused(void **state)
{
    (void)state;
    static const struct {
        bool certificate;
        int version_max;
        const char *says;
    } cases[] = {
        { false, TLS1_3_VERSION, "peer did not return a certificate" },
        { true, TLS1_2_VERSION, "unsupported protocol" },
    };
    for (size_t i = 0; i < 2; i++) {
        struct pair pair;
        struct channel_options master = options(master_keys, ROLE_WORKER);
        pair_init(&pair);
        pair_listen(&pair, &master);
        struct stranger stranger = { raw_connect(&pair), cases[i].version_max, cases[i].certificate,
                                     true };
        pthread_t thread;
        assert_int_equal(pthread_create(&thread, NULL, run_stranger, &stranger), 0);
        RUN_UNTIL(&pair, pair.refusals == 1);
        pthread_join(thread, NULL);
        close(stranger.fd);
        assert_false(stranger.got_in);
        assert_int_equal(pair.refusal.code, ERR_AUTH);
        if (strstr(pair.refusal.text, cases[i].says) == NULL)
            fail_msg("\"%s\" does not say \"%s\"", pair.refusal.text, cases[i].says);
        pair_end(&pair);
    }
}

static void plaintext_leaves_no_host(void **state)
{
    (void)state;
    struct pair pair;
    struct err err = { 0 };
    struct channel_options plain = options(NULL, ROLE_WORKER | ROLE_MASTER);
    pair_init(&pair);
    assert_null(channel_listen(&pair.loop, "0.0.0.0", 0, &plain, &listener_events, &pair, &err));
    assert_int_equal(err.code, ERR_AUTH);
    assert_null(channel_listen(&pair.loop, "::", 0, &plain, &listener_events, &pair, &err));
    assert_int_equal(err.code, ERR_AUTH);
    const char *const hosts[] = { "192.0.2.1", "2001:db8::1", "::ffff:192.0.2.1", "0.0.0.0" };
    for (int i = 0; i < 4; i++) {
        pair.worker = (struct end){ 0 };
        pair.worker.channel = channel_connect(&pair.loop, hosts[i], 7000, &plain, &events,
                                              &pair.worker, NULL);
        assert_int_equal(pair.worker.closes, 0); /* never from inside the call */
        RUN_UNTIL(&pair, pair.worker.closes == 1);
        assert_int_equal(pair.worker.err.code, ERR_AUTH);
        assert_non_null(strstr(pair.worker.err.text, "only loopback"));
    }
    pair_end(&pair);
}

static void a_closed_port_and_a_name_that_is_none_are_reported(void **state)
{
    (void)state;
    struct pair pair;
    struct channel_options plain = options(NULL, ROLE_MASTER);
    pair_init(&pair);
    pair_listen(&pair, &plain);
    unsigned port = channel_listener_port(pair.listener);
    channel_listener_close(pair.listener);
    pair.listener = NULL;
    uv_run(&pair.loop, UV_RUN_NOWAIT);
    pair.worker.channel = channel_connect(&pair.loop, "127.0.0.1", port, &plain, &events,
                                          &pair.worker, NULL);
    RUN_UNTIL(&pair, pair.worker.closes == 1);
    assert_int_equal(pair.worker.err.code, ERR_PEER);
    assert_non_null(strstr(pair.worker.err.text, "connection refused"));
    struct err err = { 0 };
    assert_null(channel_connect(&pair.loop, "", 1, &plain, &events, &pair.worker, &err));
    assert_null(channel_connect(&pair.loop, "127.0.0.1", 0, &plain, &events, &pair.worker, &err));
    assert_int_equal(err.code, ERR_ARGUMENT);
    pair_end(&pair);
}

static void a_name_is_looked_up_and_its_addresses_tried_in_turn(void **state)
{
    (void)state;
    struct pair pair;
    struct channel_options master = options(NULL, ROLE_WORKER);
    struct channel_options worker = options(NULL, ROLE_MASTER);
    pair_init(&pair);
    pair_listen(&pair, &master); /* IPv4 only: localhost may be ::1 first */
    pair.worker.channel = channel_connect(&pair.loop, "localhost",
                                          channel_listener_port(pair.listener), &worker, &events,
                                          &pair.worker, NULL);
    RUN_UNTIL(&pair, pair.worker.opens == 1 && pair.master.channel != NULL);
    pair_end(&pair);
}

static void addresses_are_read_or_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *text, *host;
        unsigned port;
    } cases[] = {
        { "farm.example:7000", "farm.example", 7000 },
        { "127.0.0.1:0", "127.0.0.1", 0 },
        { "[::1]:65535", "::1", 65535 },
        { "farm", NULL, 0 },
        { ":7000", NULL, 0 },
        { "farm:", NULL, 0 },
        { "farm:70000", NULL, 0 },
        { "farm:7x", NULL, 0 },
        { "::1:7000", NULL, 0 },
        { "[]:7000", NULL, 0 },
        { "[::1:7000", NULL, 0 },
        { "[", NULL, 0 },
        { "[:", NULL, 0 },
        { "", NULL, 0 },
        { "a-host-name-that-does-not-fit:7000", NULL, 0 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        char host[20];
        unsigned port = 1;
        struct err err = { 0 };
        bool read = channel_parse_address(cases[i].text, host, sizeof(host), &port, &err);
        assert_int_equal(read, cases[i].host != NULL);
        if (read) {
            assert_string_equal(host, cases[i].host);
            assert_int_equal(port, cases[i].port);
        } else {
            assert_int_equal(err.code, ERR_ARGUMENT);
            assert_non_null(strstr(err.text, cases[i].text));
        }
    }
}

static int prepare(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof(bulk); i++)
        bulk[i] = (uint8_t)(i * 2654435761u >> 13);
    scratch_make(dir);
    if (!keys_generate(scratch_path(dir, "farm"), false, NULL))
        return -1;
    master_keys = keys_load(scratch_path(dir, "farm"), ROLE_MASTER, NULL);
    worker_keys = keys_load(scratch_path(dir, "farm"), ROLE_WORKER, NULL);
    user_keys = keys_load(scratch_path(dir, "farm"), ROLE_USER, NULL);
    return master_keys != NULL && worker_keys != NULL && user_keys != NULL ? 0 : -1;
}

static int tidy(void **state)
{
    (void)state;
    keys_free(master_keys);
    keys_free(worker_keys);
    keys_free(user_keys);
    scratch_remove(dir);
    return 0;
}

#define BOTH_WAYS(test)                                              \
    { #test " (plain)", test, NULL, NULL, (void *)&(static_plain) }, \
    {                                                                \
#test " (TLS)", test, NULL, NULL, (void *)&(static_tls)      \
    }

static const bool static_plain = false, static_tls = true;

int main(void)
{
    const struct CMUnitTest tests[] = {
        BOTH_WAYS(thousands_of_results_arrive_in_order),
        BOTH_WAYS(a_peer_may_send_much_as_soon_as_it_is_open),
        BOTH_WAYS(big_bulks_arrive_both_ways_of_owning_them),
        BOTH_WAYS(a_full_queue_refuses_and_says_when_it_has_drained),
        BOTH_WAYS(a_close_flushes_what_was_sent_before_it),
        BOTH_WAYS(both_ends_may_close_at_once),
        BOTH_WAYS(callbacks_may_end_the_channel),
        BOTH_WAYS(a_channel_may_be_closed_as_soon_as_it_opens),
        BOTH_WAYS(a_channel_may_be_closed_while_it_connects),
        BOTH_WAYS(a_connection_cut_inside_a_frame_says_so),
        BOTH_WAYS(a_silent_peer_is_given_up),
        BOTH_WAYS(a_greeting_must_come_first_and_in_time),
        BOTH_WAYS(a_frame_of_the_wrong_role_ends_the_channel),
        BOTH_WAYS(garbage_is_refused_and_harms_nobody),
        cmocka_unit_test(half_a_header_and_half_a_frame_are_errors),
        cmocka_unit_test(a_handshake_is_bounded_in_time_bytes_and_number),
        cmocka_unit_test(a_listener_that_closes_drops_those_at_its_door),
        cmocka_unit_test(certificates_decide_who_comes_in),
        cmocka_unit_test(plain_and_tls_do_not_mix),
        cmocka_unit_test(no_certificate_or_an_old_tls_is_refused),
        cmocka_unit_test(plaintext_leaves_no_host),
        cmocka_unit_test(a_closed_port_and_a_name_that_is_none_are_reported),
        cmocka_unit_test(a_name_is_looked_up_and_its_addresses_tried_in_turn),
        cmocka_unit_test(addresses_are_read_or_refused_with_a_reason),
    };
    return cmocka_run_group_tests(tests, prepare, tidy);
}
