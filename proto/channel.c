#include "proto/channel.h"

#include "common/err.h"
#include "proto/channel_tls.h"
#include "proto/keys.h"

#include <arpa/inet.h>
#include <netdb.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define READ_SIZE       65536
#define KEEPALIVE_S     30
#define ADDRESSES_MAX   8
#define BACKLOG         512
#define GRACE_MS        500 /* see on_stage_timer() */
#define ACCEPT_AGAIN_MS 100
#define BATCH_SMALL     4096 /* text of a batch for one short message */
#define BATCH_LARGE     65536
#define BATCH_PIECES    64
#define BATCH_RELEASES  32
#define REFERENCE_MIN   4096 /* smaller bulks are copied: a piece of its own costs more */

/*
 * Output that goes to the kernel in one write. Pieces point into `text` (heads, copies,
 * ciphertext) or at bulks, which are released when libuv is done with all of it.
 */
struct batch {
    uv_write_t request;
    struct channel *channel;
    struct batch *next;
    size_t size; /* bytes of all pieces */
    unsigned piece_count, release_count;
    uv_buf_t pieces[BATCH_PIECES];
    struct {
        void (*release)(void *context);
        void *context;
    } releases[BATCH_RELEASES];
    size_t text_used, text_capacity;
    uint8_t text[];
};

/*
 * CONNECTING -> HANDSHAKE -> OPEN -> CLOSING -> ENDED; any state may go straight to ENDED. In
 * CLOSING the output is flushed and input discarded until the peer closes too: closing a socket
 * with unread input would reset the connection and could destroy our last words on their way.
 */
enum state { CONNECTING, HANDSHAKE, OPEN, CLOSING, ENDED };

struct channel {
    enum state state;
    uv_loop_t *loop;
    unsigned holds; /* handles and requests of the loop that point here */
    uv_tcp_t tcp;
    uv_timer_t stage_timer, silence_timer;
    uv_prepare_t flusher;
    uv_getaddrinfo_t resolve;
    uv_connect_t connect;
    uv_shutdown_t shutdown;

    struct channel_limits limits;
    const struct channel_events *events;
    void *owner;
    struct channel_tls *tls;
    unsigned roles; /* of the peer */
    char host[256];
    char peer[320];

    struct sockaddr_storage addresses[ADDRESSES_MAX];
    unsigned address_count, address_next;
    unsigned port;

    struct frame_parser parser;
    struct batch *staged, **staged_end;
    struct batch *batch; /* the last staged one, which still takes pieces */
    size_t queued;
    bool drain_wanted, paused, reading, shut_down, peer_ended;
    bool stage_grace, silence_grace;
    uint32_t silence_ms;
    uint64_t heard_ms, bytes_in, bytes_out;
    struct err err; /* why it ends */

    struct channel_listener *listener; /* while it has not proved who it is */
    struct channel *pending_previous, *pending_next;
};

struct channel_listener {
    uv_loop_t *loop;
    uv_tcp_t tcp;
    uv_timer_t again;
    unsigned holds;
    struct channel_options options;
    const struct channel_listener_events *events;
    void *owner;
    struct channel *pending;
    unsigned pending_count;
    unsigned port;
    bool closing;
};

struct channel_limits channel_limits_default(void)
{
    return (struct channel_limits){
        .connect_ms = 10000,
        .handshake_ms = 10000,
        .greeting_ms = 10000,
        .silence_ms = 60000,
        .close_ms = 2000,
        .handshake_bytes = 64 * LIMIT_KIB,
        .pending_max = 256,
        .queue_bytes = 16 * LIMIT_MIB,
    };
}

/* Addresses */

static bool is_loopback(const struct sockaddr *address)
{
    if (address->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)address)->sin_addr.s_addr) >> 24 == 127;
    if (address->sa_family != AF_INET6)
        return false;
    const struct in6_addr *in6 = &((const struct sockaddr_in6 *)address)->sin6_addr;
    return IN6_IS_ADDR_LOOPBACK(in6) || (IN6_IS_ADDR_V4MAPPED(in6) && in6->s6_addr[12] == 127);
}

static unsigned address_port(const struct sockaddr *address)
{
    return ntohs(address->sa_family == AF_INET6 ? ((const struct sockaddr_in6 *)address)->sin6_port
                                                : ((const struct sockaddr_in *)address)->sin_port);
}

static void address_text(const struct sockaddr *address, char *text, size_t size)
{
    char host[INET6_ADDRSTRLEN] = "?";
    if (address->sa_family == AF_INET6)
        uv_ip6_name((const struct sockaddr_in6 *)address, host, sizeof(host));
    else
        uv_ip4_name((const struct sockaddr_in *)address, host, sizeof(host));
    snprintf(text, size, address->sa_family == AF_INET6 ? "[%s]:%u" : "%s:%u", host,
             address_port(address));
}

/* False when host is not an address but a name */
static bool address_of(const char *host, unsigned port, struct sockaddr_storage *address)
{
    return uv_ip4_addr(host, (int)port, (struct sockaddr_in *)address) == 0 ||
           uv_ip6_addr(host, (int)port, (struct sockaddr_in6 *)address) == 0;
}

bool channel_parse_address(const char *text, char *host, size_t size, unsigned *port,
                           struct err *err)
{
    const char *colon = strrchr(text, ':');
    const char *begin = text, *end = colon;
    if (colon == NULL)
        return err_set(err, ERR_ARGUMENT, "\"%s\": no port; write HOST:PORT", text);
    if (text[0] == '[') {
        begin = text + 1;
        end = colon - 1;
        if (end <= begin || *end != ']')
            return err_set(err, ERR_ARGUMENT, "\"%s\": write [ADDRESS]:PORT", text);
    } else if (memchr(text, ':', (size_t)(colon - text)) != NULL) {
        return err_set(err, ERR_ARGUMENT, "\"%s\": write [%s]:PORT for an IPv6 address", text,
                       text);
    }
    size_t length = (size_t)(end - begin);
    if (length == 0 || length >= size)
        return err_set(err, ERR_ARGUMENT, "\"%s\": the host is empty or too long", text);
    unsigned value = 0;
    const char *digit = colon + 1;
    for (; *digit >= '0' && *digit <= '9' && value <= 65535; digit++)
        value = 10 * value + (unsigned)(*digit - '0');
    if (digit == colon + 1 || *digit != '\0' || value > 65535)
        return err_set(err, ERR_ARGUMENT, "\"%s\": \"%s\" is not a port", text, colon + 1);
    memcpy(host, begin, length);
    host[length] = '\0';
    *port = value;
    return true;
}

/* The end of a channel */

static void list_remove_pending(struct channel *channel)
{
    struct channel_listener *listener = channel->listener;
    if (listener == NULL)
        return;
    if (channel->pending_previous != NULL)
        channel->pending_previous->pending_next = channel->pending_next;
    else
        listener->pending = channel->pending_next;
    if (channel->pending_next != NULL)
        channel->pending_next->pending_previous = channel->pending_previous;
    listener->pending_count--;
    channel->listener = NULL;
}

static void batch_free(struct batch *batch)
{
    for (unsigned i = 0; i < batch->release_count; i++)
        batch->releases[i].release(batch->releases[i].context);
    free(batch);
}

static void drop_staged(struct channel *channel)
{
    while (channel->staged != NULL) {
        struct batch *batch = channel->staged;
        channel->staged = batch->next;
        channel->queued -= batch->size;
        batch_free(batch);
    }
    channel->staged_end = &channel->staged;
    channel->batch = NULL;
}

static void release_hold(struct channel *channel)
{
    if (--channel->holds > 0)
        return;
    drop_staged(channel);
    struct channel_listener *listener = channel->listener;
    list_remove_pending(channel);
    if (channel->events != NULL)
        channel->events->on_close(channel->owner, channel, &channel->err);
    else if (listener != NULL && listener->events->on_refused != NULL)
        listener->events->on_refused(listener->owner, channel->peer, &channel->err);
    channel_tls_free(channel->tls);
    frame_parser_free(&channel->parser);
    free(channel);
}

static void on_handle_closed(uv_handle_t *handle)
{
    release_hold(handle->data);
}

static void close_handle(uv_handle_t *handle)
{
    if (!uv_is_closing(handle))
        uv_close(handle, on_handle_closed);
}

/* Nothing more happens but on_close. The first reason counts. */
static void finish(struct channel *channel)
{
    if (channel->state == ENDED)
        return;
    uv_cancel((uv_req_t *)&channel->resolve); /* fails where none waits: fine */
    channel->state = ENDED;
    close_handle((uv_handle_t *)&channel->tcp);
    close_handle((uv_handle_t *)&channel->stage_timer);
    close_handle((uv_handle_t *)&channel->silence_timer);
    close_handle((uv_handle_t *)&channel->flusher);
}

static void fail(struct channel *channel, enum err_code code, const char *what)
{
    if (channel->state < CLOSING)
        err_set(&channel->err, code, "%s", what);
    finish(channel);
}

static void fail_uv(struct channel *channel, const char *what, int status)
{
    if (channel->state < CLOSING)
        err_set(&channel->err, ERR_PEER, "%s: %s", what, uv_strerror(status));
    finish(channel);
}

/* Timers */

static void expire_stage(struct channel *channel)
{
    switch (channel->state) {
    case CONNECTING:
        fail(channel, ERR_TIMEOUT, "no connection in time");
        break;
    case HANDSHAKE:
        fail(channel, ERR_TIMEOUT, "no TLS handshake in time");
        break;
    case OPEN:
        fail(channel, ERR_TIMEOUT, "no greeting in time");
        break;
    case CLOSING:
    case ENDED:
        finish(channel);
        break;
    }
}

/*
 * A timer that is due may only mean that this process did not run for a while (SIGSTOP, a laptop's
 * lid) and the peer's bytes wait unread. So a deadline gives another moment before it counts.
 */
static void on_stage_timer(uv_timer_t *timer)
{
    struct channel *channel = timer->data;
    if (channel->stage_grace) {
        expire_stage(channel);
        return;
    }
    channel->stage_grace = true;
    uv_timer_start(timer, on_stage_timer, GRACE_MS, 0);
}

static void start_stage(struct channel *channel, uint32_t ms)
{
    channel->stage_grace = ms <= GRACE_MS;
    uint32_t until_grace = channel->stage_grace ? ms : ms - GRACE_MS;
    uv_timer_start(&channel->stage_timer, on_stage_timer, until_grace, 0);
}

static void on_silence_timer(uv_timer_t *timer)
{
    struct channel *channel = timer->data;
    uint64_t silent_ms = uv_now(channel->loop) - channel->heard_ms;
    if (channel->paused) {
        silent_ms = 0; /* we are the ones who do not listen */
        channel->heard_ms = uv_now(channel->loop);
    }
    if (silent_ms < channel->silence_ms) {
        channel->silence_grace = false;
        uv_timer_start(timer, on_silence_timer, channel->silence_ms - silent_ms, 0);
    } else if (!channel->silence_grace) {
        channel->silence_grace = true;
        uv_timer_start(timer, on_silence_timer, GRACE_MS, 0);
    } else {
        fail(channel, ERR_TIMEOUT, "the peer stayed silent for too long");
    }
}

void channel_set_silence(struct channel *channel, uint32_t silence_ms)
{
    channel->silence_ms = silence_ms;
    channel->silence_grace = false;
    channel->heard_ms = uv_now(channel->loop);
    if (channel->state != OPEN)
        return;
    if (silence_ms > 0)
        uv_timer_start(&channel->silence_timer, on_silence_timer, silence_ms, 0);
    else
        uv_timer_stop(&channel->silence_timer);
}

/* Output */

static void begin_closing(struct channel *channel);

static void on_written(uv_write_t *request, int status)
{
    struct batch *batch = request->data;
    struct channel *channel = batch->channel;
    channel->queued -= batch->size;
    if (status == 0)
        channel->bytes_out += batch->size;
    batch_free(batch);
    if (channel->state == ENDED)
        return;
    if (status != 0) {
        fail_uv(channel, "sending", status);
        return;
    }
    if (channel->state == OPEN && channel->drain_wanted &&
        channel->queued < channel->limits.queue_bytes / 2) {
        channel->drain_wanted = false;
        if (channel->events != NULL && channel->events->on_drain != NULL)
            channel->events->on_drain(channel->owner, channel);
    }
}

static void flush(struct channel *channel)
{
    uv_prepare_stop(&channel->flusher);
    while (channel->staged != NULL && channel->state != ENDED) {
        struct batch *batch = channel->staged;
        channel->staged = batch->next;
        batch->request.data = batch;
        int status = uv_write(&batch->request, (uv_stream_t *)&channel->tcp, batch->pieces,
                              batch->piece_count, on_written);
        if (status != 0) {
            channel->queued -= batch->size;
            batch_free(batch);
            fail_uv(channel, "sending", status);
        }
    }
    if (channel->staged == NULL) {
        channel->staged_end = &channel->staged;
        channel->batch = NULL;
    }
}

static void on_turn(uv_prepare_t *prepare)
{
    flush(prepare->data);
}

/* A batch with room for a piece, a release and at least one byte of text; NULL: no memory */
static struct batch *batch_with_room(struct channel *channel, size_t text_wanted)
{
    struct batch *batch = channel->batch;
    if (batch != NULL && batch->piece_count < BATCH_PIECES &&
        batch->release_count < BATCH_RELEASES &&
        (text_wanted == 0 || batch->text_used < batch->text_capacity))
        return batch;

    bool small = channel->staged == NULL && text_wanted <= BATCH_SMALL;
    size_t capacity = small ? BATCH_SMALL : BATCH_LARGE;
    batch = malloc(sizeof(*batch) + capacity);
    if (batch == NULL)
        return NULL;
    batch->channel = channel;
    batch->next = NULL;
    batch->size = batch->text_used = 0;
    batch->piece_count = batch->release_count = 0;
    batch->text_capacity = capacity;
    if (channel->staged == NULL)
        uv_prepare_start(&channel->flusher, on_turn);
    *channel->staged_end = batch;
    channel->staged_end = &batch->next;
    channel->batch = batch;
    return batch;
}

static bool no_memory(struct channel *channel)
{
    fail(channel, ERR_MEMORY, "no memory for output");
    return false;
}

static bool put_copy(struct channel *channel, const void *bytes, size_t size)
{
    const uint8_t *at = bytes;
    while (size > 0) {
        struct batch *batch = batch_with_room(channel, size);
        if (batch == NULL)
            return no_memory(channel);
        size_t room = batch->text_capacity - batch->text_used;
        size_t part = size < room ? size : room;
        uint8_t *to = batch->text + batch->text_used;
        memcpy(to, at, part);
        uv_buf_t *last = batch->piece_count > 0 ? &batch->pieces[batch->piece_count - 1] : NULL;
        if (last != NULL && (uint8_t *)last->base + last->len == to)
            last->len += part;
        else
            batch->pieces[batch->piece_count++] = uv_buf_init((char *)to, (unsigned)part);
        batch->text_used += part;
        batch->size += part;
        channel->queued += part;
        at += part;
        size -= part;
    }
    return true;
}

static bool put_reference(struct channel *channel, const struct channel_bulk *bulk)
{
    struct batch *batch = batch_with_room(channel, 0);
    if (batch == NULL)
        return no_memory(channel);
    batch->pieces[batch->piece_count++] = uv_buf_init((char *)bulk->data, (unsigned)bulk->size);
    batch->releases[batch->release_count].release = bulk->release;
    batch->releases[batch->release_count++].context = bulk->context;
    batch->size += bulk->size;
    channel->queued += bulk->size;
    return true;
}

/* Large bulks that must be copied get memory of their own rather than many batches */
static bool put_large_copy(struct channel *channel, const struct channel_bulk *bulk)
{
    void *copy = malloc(bulk->size);
    if (copy == NULL)
        return no_memory(channel);
    memcpy(copy, bulk->data, bulk->size);
    struct channel_bulk owned = { copy, bulk->size, free, copy };
    if (put_reference(channel, &owned))
        return true;
    free(copy);
    return false;
}

static bool put_frame(struct channel *channel, const uint8_t *head, size_t head_size,
                      const struct channel_bulk *bulk, struct err *err)
{
    if (channel->tls != NULL) {
        struct err reason = { 0 };
        if (channel_tls_write(channel->tls, head, head_size, &reason) &&
            channel_tls_write(channel->tls, bulk->data, bulk->size, &reason)) {
            if (bulk->release != NULL)
                bulk->release(bulk->context);
            return true;
        }
        fail(channel, reason.code, reason.text);
    } else if (put_copy(channel, head, head_size)) {
        if (bulk->release != NULL && bulk->size >= REFERENCE_MIN) {
            if (put_reference(channel, bulk))
                return true;
        } else if (bulk->size >= BATCH_LARGE) {
            if (put_large_copy(channel, bulk))
                return true;
        } else if (put_copy(channel, bulk->data, bulk->size)) {
            if (bulk->release != NULL)
                bulk->release(bulk->context);
            return true;
        }
    }
    if (err != NULL)
        *err = channel->err;
    return false;
}

void channel_lent(void *context)
{
    (void)context;
}

bool channel_send(struct channel *channel, const ProtobufCMessage *message,
                  const struct channel_bulk *bulk, struct err *err)
{
    static const struct channel_bulk no_bulk;
    uint8_t small[1024];
    uint8_t *head = small;
    if (bulk == NULL)
        bulk = &no_bulk;
    if (channel->state != OPEN)
        return err_set(err, ERR_PEER, "the connection is not open");
    if (channel->queued >= channel->limits.queue_bytes) {
        channel->drain_wanted = true;
        return err_set(err, ERR_LIMIT, "%zu bytes wait to be sent already", channel->queued);
    }

    size_t head_size = frame_head_size(message);
    if (head_size > sizeof(small))
        head = malloc(head_size);
    if (head == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a message of %zu bytes", head_size);
    bool sent = frame_head(message, bulk->size, head, err) &&
                put_frame(channel, head, head_size, bulk, err);
    if (head != small)
        free(head);
    if (channel->queued > channel->limits.queue_bytes / 2)
        channel->drain_wanted = true;
    return sent;
}

size_t channel_queued(const struct channel *channel)
{
    return channel->queued;
}

/* Input */

static void on_read(uv_stream_t *stream, ssize_t size, const uv_buf_t *buffer);

static void on_alloc(uv_handle_t *handle, size_t suggested, uv_buf_t *buffer)
{
    /* libuv fills it and calls on_read before it asks again, so a thread needs only one */
    static _Thread_local char bytes[READ_SIZE];
    (void)handle;
    (void)suggested;
    *buffer = uv_buf_init(bytes, sizeof(bytes));
}

static void read_or_pause(struct channel *channel)
{
    bool wanted = channel->state == CLOSING || (channel->state < CLOSING && !channel->paused);
    if (channel->state == CONNECTING || channel->state == ENDED || wanted == channel->reading)
        return;
    channel->reading = wanted;
    if (!wanted) {
        uv_read_stop((uv_stream_t *)&channel->tcp);
        return;
    }
    int status = uv_read_start((uv_stream_t *)&channel->tcp, on_alloc, on_read);
    if (status != 0)
        fail_uv(channel, "receiving", status);
}

void channel_pause(struct channel *channel, bool pause)
{
    channel->paused = pause;
    channel->heard_ms = uv_now(channel->loop);
    read_or_pause(channel);
}

static bool deliver_frame(void *context, const struct frame *frame, struct err *err)
{
    struct channel *channel = context;
    if (channel->state != OPEN)
        return false; /* closed by an earlier frame of these bytes: the rest is discarded */
    return channel->events->on_frame(channel->owner, channel, frame, err);
}

/* The peer, or the owner in its name, broke off: last words (an alert, a REFUSED) still go out. */
static void break_off(struct channel *channel, const struct err *err)
{
    if (channel->state >= CLOSING)
        return;
    channel->err = *err;
    begin_closing(channel);
}

static bool receive_plain(void *context, const void *bytes, size_t size)
{
    struct channel *channel = context;
    struct err err = { 0 };
    if (channel->state != OPEN)
        return false;
    if (!frame_parser_feed(&channel->parser, bytes, size, deliver_frame, channel, &err))
        break_off(channel, &err);
    return channel->state == OPEN;
}

static void on_end_of_input(struct channel *channel)
{
    channel->peer_ended = true;
    if (channel->state == CLOSING) {
        if (channel->shut_down)
            finish(channel);
        return;
    }
    const char *inside = frame_parser_inside(&channel->parser);
    const char *how = channel->tls != NULL && !channel_tls_ended(channel->tls)
                          ? "the connection was cut"
                          : "the peer closed the connection";
    if (channel->state == HANDSHAKE)
        err_set(&channel->err, ERR_PEER, "the peer left during the TLS handshake");
    else if (inside != NULL)
        err_set(&channel->err, ERR_PEER, "%s in the middle of a %s", how,
                inside[0] != '\0' ? inside : "frame's header");
    else
        err_set(&channel->err, ERR_PEER, "%s", how);
    finish(channel);
}

static void on_read(uv_stream_t *stream, ssize_t size, const uv_buf_t *buffer)
{
    struct channel *channel = stream->data;
    struct err err = { 0 };
    if (size == 0 || channel->state == ENDED)
        return;
    if (size < 0) {
        if (size == UV_EOF)
            on_end_of_input(channel);
        else
            fail_uv(channel, "receiving", (int)size);
        return;
    }
    channel->bytes_in += (uint64_t)size;
    channel->heard_ms = uv_now(channel->loop);
    if (channel->state == CLOSING)
        return;
    if (channel->tls == NULL) {
        receive_plain(channel, buffer->base, (size_t)size);
        return;
    }
    if (!channel_tls_feed(channel->tls, buffer->base, (size_t)size, &err))
        break_off(channel, &err);
    else if (channel->state == OPEN && channel_tls_ended(channel->tls))
        on_end_of_input(channel);
    else if (channel->state == HANDSHAKE && channel->bytes_in > channel->limits.handshake_bytes)
        fail(channel, ERR_LIMIT, "too many bytes before the end of the TLS handshake");
}

/* From one state to the next */

static bool open_channel(void *context)
{
    struct channel *channel = context;
    struct channel_listener *listener = channel->listener;
    if (channel->tls != NULL)
        channel->roles = channel_tls_peer(channel->tls);
    frame_parser_init(&channel->parser, channel->roles);
    channel->state = OPEN;
    start_stage(channel, channel->limits.greeting_ms);
    channel_set_silence(channel, channel->silence_ms);
    if (listener != NULL) {
        list_remove_pending(channel);
        listener->events->on_accept(listener->owner, channel);
        if (channel->events == NULL)
            channel_close(channel); /* nobody wants it */
    } else if (channel->events->on_open != NULL) {
        channel->events->on_open(channel->owner, channel);
    }
    return channel->state == OPEN;
}

static bool tls_send(void *context, const void *bytes, size_t size)
{
    struct channel *channel = context;
    /* Our own sends stop at the bound; beyond it only answers to a flood of the peer's can get */
    if (channel->queued > channel->limits.queue_bytes + 4 * LIMIT_SLICE) {
        fail(channel, ERR_LIMIT, "the peer asks for answers and does not read them");
        return false;
    }
    return put_copy(channel, bytes, size);
}

static const struct channel_tls_sink tls_sink = { tls_send, open_channel, receive_plain };

static void start_session(struct channel *channel)
{
    struct err err = { 0 };
    uv_tcp_nodelay(&channel->tcp, 1); /* these two are for speed and comfort: no error */
    uv_tcp_keepalive(&channel->tcp, 1, KEEPALIVE_S);
    channel->state = HANDSHAKE;
    if (channel->tls == NULL) {
        open_channel(channel);
    } else {
        start_stage(channel, channel->limits.handshake_ms);
        if (channel->listener == NULL && !channel_tls_start(channel->tls, &err))
            break_off(channel, &err);
    }
    read_or_pause(channel);
}

static void on_shut_down(uv_shutdown_t *request, int status)
{
    struct channel *channel = request->data;
    release_hold(channel);
    if (channel->state == ENDED)
        return;
    channel->shut_down = true;
    if (status != 0 || channel->peer_ended)
        finish(channel);
}

/* Flush, say that nothing more comes, and wait for the peer to close as well */
static void begin_closing(struct channel *channel)
{
    bool connected = channel->state == OPEN || channel->state == HANDSHAKE;
    channel->state = CLOSING;
    if (!connected) {
        finish(channel);
        return;
    }
    uv_timer_stop(&channel->silence_timer);
    start_stage(channel, channel->limits.close_ms);
    flush(channel);
    if (channel->state != CLOSING)
        return;
    channel->shutdown.data = channel;
    if (uv_shutdown(&channel->shutdown, (uv_stream_t *)&channel->tcp, on_shut_down) != 0) {
        finish(channel);
        return;
    }
    channel->holds++;
    read_or_pause(channel);
}

void channel_close(struct channel *channel)
{
    if (channel->state >= CLOSING)
        return;
    err_clear(&channel->err);
    if (channel->state == OPEN && channel->tls != NULL)
        channel_tls_shutdown(channel->tls);
    if (channel->state < CLOSING) /* that may have failed for lack of memory */
        begin_closing(channel);
}

void channel_fail(struct channel *channel, const struct err *err)
{
    if (channel->state >= CLOSING)
        return;
    channel->err = *err;
    flush(channel); /* what the kernel takes at once, it has */
    finish(channel);
}

/* Making channels */

static void ignore_sigpipe(void)
{
    signal(SIGPIPE, SIG_IGN); /* libuv writes without MSG_NOSIGNAL */
}

static struct channel *channel_new(uv_loop_t *loop, const struct channel_options *options,
                                   bool accepting)
{
    static pthread_once_t sigpipe_once = PTHREAD_ONCE_INIT;
    pthread_once(&sigpipe_once, ignore_sigpipe);
    struct channel *channel = calloc(1, sizeof(*channel));
    if (channel == NULL)
        return NULL;
    if (options->keys != NULL) {
        channel->tls = channel_tls_new(options->keys, accepting, options->peers, &tls_sink,
                                       channel);
        if (channel->tls == NULL)
            goto fail;
    }
    if (uv_tcp_init(loop, &channel->tcp) != 0)
        goto fail;
    uv_timer_init(loop, &channel->stage_timer); /* these three cannot fail */
    uv_timer_init(loop, &channel->silence_timer);
    uv_prepare_init(loop, &channel->flusher);
    channel->tcp.data = channel;
    channel->stage_timer.data = channel->silence_timer.data = channel->flusher.data = channel;
    channel->resolve.data = channel->connect.data = channel;
    channel->holds = 4;
    channel->loop = loop;
    channel->limits = options->limits;
    channel->silence_ms = options->limits.silence_ms;
    channel->roles = options->peers;
    channel->staged_end = &channel->staged;
    return channel;

fail:
    channel_tls_free(channel->tls);
    free(channel);
    return NULL;
}

static void connect_next(struct channel *channel);

static void on_connected(uv_connect_t *request, int status)
{
    struct channel *channel = request->data;
    if (channel->state == ENDED)
        return;
    if (status == 0) {
        err_clear(&channel->err);
        start_session(channel);
        return;
    }
    err_set(&channel->err, ERR_PEER, "connecting to %s: %s", channel->peer, uv_strerror(status));
    connect_next(channel);
}

/* A socket that failed to connect cannot be used again: close it and make another */
static void on_retry(uv_handle_t *handle)
{
    struct channel *channel = handle->data;
    int status = channel->state == ENDED ? 0 : uv_tcp_init(channel->loop, &channel->tcp);
    if (channel->state == ENDED || status != 0) {
        if (channel->state != ENDED) {
            err_set(&channel->err, ERR_IO, "making a socket: %s", uv_strerror(status));
            finish(channel); /* the socket counts as closing still, so only the rest is closed */
        }
        release_hold(channel);
        return;
    }
    channel->tcp.data = channel;
    const struct sockaddr *address =
        (const struct sockaddr *)&channel->addresses[channel->address_next++];
    address_text(address, channel->peer, sizeof(channel->peer));
    status = uv_tcp_connect(&channel->connect, &channel->tcp, address, on_connected);
    if (status != 0) {
        err_set(&channel->err, ERR_PEER, "connecting to %s: %s", channel->peer,
                uv_strerror(status));
        connect_next(channel);
    }
}

static void connect_next(struct channel *channel)
{
    if (channel->address_next == channel->address_count)
        finish(channel); /* with the error of the last one */
    else
        uv_close((uv_handle_t *)&channel->tcp, on_retry);
}

/* Keep the addresses that we may connect to, and begin with the first */
static void connect_first(struct channel *channel)
{
    unsigned kept = 0;
    for (unsigned i = 0; i < channel->address_count; i++)
        if (channel->tls != NULL || is_loopback((const struct sockaddr *)&channel->addresses[i]))
            channel->addresses[kept++] = channel->addresses[i];
    channel->address_count = kept;
    if (kept > 0) {
        connect_next(channel);
        return;
    }
    err_set(&channel->err, ERR_AUTH,
            "%s is not on this host, and without keys (pathfarm keygen) only loopback is "
            "connected to",
            channel->peer);
    finish(channel);
}

static void on_resolved(uv_getaddrinfo_t *request, int status, struct addrinfo *list)
{
    struct channel *channel = request->data;
    if (channel->state != ENDED) {
        for (struct addrinfo *info = list; info != NULL && status == 0; info = info->ai_next) {
            if (channel->address_count == ADDRESSES_MAX ||
                (info->ai_family != AF_INET && info->ai_family != AF_INET6))
                continue;
            struct sockaddr_storage *address = &channel->addresses[channel->address_count++];
            memcpy(address, info->ai_addr, info->ai_addrlen);
            if (info->ai_family == AF_INET6)
                ((struct sockaddr_in6 *)address)->sin6_port = htons((uint16_t)channel->port);
            else
                ((struct sockaddr_in *)address)->sin_port = htons((uint16_t)channel->port);
        }
        if (channel->address_count > 0) {
            connect_first(channel);
        } else {
            err_set(&channel->err, ERR_PEER, "%s: %s", channel->host,
                    status != 0 ? uv_strerror(status) : "no address");
            finish(channel);
        }
    }
    uv_freeaddrinfo(list);
    release_hold(channel);
}

struct channel *channel_connect(uv_loop_t *loop, const char *host, unsigned port,
                                const struct channel_options *options,
                                const struct channel_events *events, void *owner, struct err *err)
{
    if (port == 0 || port > 65535 || host[0] == '\0' ||
        strlen(host) >= sizeof(((struct channel *)0)->host)) {
        err_set(err, ERR_ARGUMENT, "\"%s\" port %u is nothing to connect to", host, port);
        return NULL;
    }
    struct channel *channel = channel_new(loop, options, false);
    if (channel == NULL) {
        err_set(err, ERR_MEMORY, "no memory or socket for a connection");
        return NULL;
    }
    channel->events = events;
    channel->owner = owner;
    channel->port = port;
    snprintf(channel->host, sizeof(channel->host), "%s", host);
    snprintf(channel->peer, sizeof(channel->peer), "%s:%u", host, port);
    start_stage(channel, channel->limits.connect_ms);

    if (address_of(host, port, &channel->addresses[0])) {
        channel->address_count = 1;
        connect_first(channel);
        return channel;
    }
    const struct addrinfo hints = { .ai_socktype = SOCK_STREAM, .ai_family = AF_UNSPEC };
    int status = uv_getaddrinfo(loop, &channel->resolve, on_resolved, host, NULL, &hints);
    if (status == 0)
        channel->holds++;
    else
        fail_uv(channel, host, status);
    return channel;
}

/* Listening */

static void on_connection(uv_stream_t *server, int status);

static void on_accept_again(uv_timer_t *timer)
{
    struct channel_listener *listener = timer->data;
    on_connection((uv_stream_t *)&listener->tcp, 0);
}

static void on_connection(uv_stream_t *server, int status)
{
    struct channel_listener *listener = server->data;
    if (listener->closing || status != 0)
        return; /* a peer that was gone again, or no file descriptor: libuv goes on listening */
    struct channel *channel = channel_new(listener->loop, &listener->options, true);
    if (channel == NULL) {
        /* libuv listens again only once this one was accepted, so it must be, later */
        uv_timer_start(&listener->again, on_accept_again, ACCEPT_AGAIN_MS, 0);
        return;
    }
    channel->listener = listener;
    channel->pending_next = listener->pending;
    if (listener->pending != NULL)
        listener->pending->pending_previous = channel;
    listener->pending = channel;
    listener->pending_count++;

    struct sockaddr_storage address = { 0 };
    int length = sizeof(address);
    snprintf(channel->peer, sizeof(channel->peer), "a peer");
    status = uv_accept(server, (uv_stream_t *)&channel->tcp);
    if (status == 0)
        status = uv_tcp_getpeername(&channel->tcp, (struct sockaddr *)&address, &length);
    if (status != 0) {
        fail_uv(channel, "accepting", status);
        return;
    }
    address_text((const struct sockaddr *)&address, channel->peer, sizeof(channel->peer));
    if (listener->pending_count > channel->limits.pending_max)
        fail(channel, ERR_LIMIT, "too many connections that have not said who they are");
    else if (channel->tls == NULL && !is_loopback((const struct sockaddr *)&address))
        fail(channel, ERR_AUTH, "only loopback may connect without keys (pathfarm keygen)");
    else
        start_session(channel);
}

static void on_listener_closed(uv_handle_t *handle)
{
    struct channel_listener *listener = handle->data;
    if (--listener->holds == 0)
        free(listener);
}

struct channel_listener *channel_listen(uv_loop_t *loop, const char *host, unsigned port,
                                        const struct channel_options *options,
                                        const struct channel_listener_events *events, void *owner,
                                        struct err *err)
{
    struct sockaddr_storage address = { 0 };
    int length = sizeof(address);
    if (port > 65535 || !address_of(host, port, &address)) {
        err_set(err, ERR_ARGUMENT, "\"%s\" port %u is not an address to listen on", host, port);
        return NULL;
    }
    if (options->keys == NULL && !is_loopback((const struct sockaddr *)&address)) {
        err_set(err, ERR_AUTH,
                "listening on %s needs keys (pathfarm keygen): without them only "
                "loopback is allowed",
                host);
        return NULL;
    }
    struct channel_listener *listener = calloc(1, sizeof(*listener));
    if (listener == NULL) {
        err_set(err, ERR_MEMORY, "no memory to listen on %s", host);
        return NULL;
    }
    listener->loop = loop;
    listener->options = *options;
    listener->events = events;
    listener->owner = owner;
    int status = uv_tcp_init(loop, &listener->tcp);
    if (status != 0) {
        free(listener);
        err_set(err, ERR_IO, "listening on %s port %u: %s", host, port, uv_strerror(status));
        return NULL;
    }
    uv_timer_init(loop, &listener->again);
    listener->tcp.data = listener->again.data = listener;
    listener->holds = 2;
    struct sockaddr *socket_address = (struct sockaddr *)&address;
    status = uv_tcp_bind(&listener->tcp, socket_address, 0);
    if (status == 0)
        status = uv_listen((uv_stream_t *)&listener->tcp, BACKLOG, on_connection);
    if (status == 0)
        status = uv_tcp_getsockname(&listener->tcp, socket_address, &length);
    if (status == 0) {
        listener->port = address_port(socket_address);
        return listener;
    }
    err_set(err, ERR_IO, "listening on %s port %u: %s", host, port, uv_strerror(status));
    channel_listener_close(listener);
    return NULL;
}

unsigned channel_listener_port(const struct channel_listener *listener)
{
    return listener->port;
}

void channel_listener_close(struct channel_listener *listener)
{
    if (listener == NULL || listener->closing)
        return;
    listener->closing = true;
    while (listener->pending != NULL) {
        struct channel *channel = listener->pending;
        list_remove_pending(channel);
        fail(channel, ERR_CANCELLED, "the listener closed");
    }
    uv_close((uv_handle_t *)&listener->tcp, on_listener_closed);
    uv_close((uv_handle_t *)&listener->again, on_listener_closed);
}

/* What a channel is */

void channel_set_phase(struct channel *channel, enum frame_phase phase)
{
    channel->parser.phase = phase;
    if (phase != PHASE_GREETING && channel->state == OPEN)
        uv_timer_stop(&channel->stage_timer);
}

enum frame_phase channel_phase(const struct channel *channel)
{
    return channel->parser.phase;
}

void channel_set_events(struct channel *channel, const struct channel_events *events, void *owner)
{
    channel->events = events;
    channel->owner = owner;
}

unsigned channel_peer_roles(const struct channel *channel)
{
    return channel->roles;
}

const char *channel_peer(const struct channel *channel)
{
    return channel->peer;
}

bool channel_is_tls(const struct channel *channel)
{
    return channel->tls != NULL;
}

uint64_t channel_bytes_in(const struct channel *channel)
{
    return channel->bytes_in;
}

uint64_t channel_bytes_out(const struct channel *channel)
{
    return channel->bytes_out;
}
