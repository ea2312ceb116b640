#include "proto/channel.h"

#include "common/err.h"
#include "proto/channel_inside.h"
#include "proto/channel_tls.h"

#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>

#define KEEPALIVE_S 30

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

/* The beginning */

static bool open_channel(void *context)
{
    struct channel *channel = context;
    if (channel->tls != NULL)
        channel->roles = channel_tls_peer(channel->tls);
    frame_parser_init(&channel->parser, channel->roles);
    channel->state = OPEN;
    channel_deadline_stage(channel, channel->limits.greeting_ms);
    channel_deadline_silence(channel, channel->silence_ms);
    if (channel->listener != NULL) {
        channel_listen_accepted(channel);
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
        channel_fail_with(channel, ERR_LIMIT, "the peer asks for answers and does not read them");
        return false;
    }
    return channel_output_bytes(channel, bytes, size);
}

static const struct channel_tls_sink tls_sink = { tls_send, open_channel, channel_input_plain };

static void ignore_sigpipe(void)
{
    signal(SIGPIPE, SIG_IGN); /* libuv writes without MSG_NOSIGNAL */
}

struct channel *channel_new(uv_loop_t *loop, const struct channel_options *options, bool accepting)
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

void channel_start_session(struct channel *channel)
{
    struct err err = { 0 };
    uv_tcp_nodelay(&channel->tcp, 1); /* these two are for speed and comfort: no error */
    uv_tcp_keepalive(&channel->tcp, 1, KEEPALIVE_S);
    channel->state = HANDSHAKE;
    if (channel->tls == NULL) {
        open_channel(channel);
    } else {
        channel_deadline_stage(channel, channel->limits.handshake_ms);
        if (channel->listener == NULL && !channel_tls_start(channel->tls, &err))
            channel_break_off(channel, &err);
    }
    channel_input_follow(channel);
}

/* The end */

void channel_release_hold(struct channel *channel)
{
    if (--channel->holds > 0)
        return;
    channel_output_drop(channel);
    if (channel->events != NULL)
        channel->events->on_close(channel->owner, channel, &channel->err);
    else if (channel->listener != NULL)
        channel_listen_refused(channel);
    channel_tls_free(channel->tls);
    frame_parser_free(&channel->parser);
    free(channel);
}

static void on_handle_closed(uv_handle_t *handle)
{
    channel_release_hold(handle->data);
}

static void close_handle(uv_handle_t *handle)
{
    if (!uv_is_closing(handle))
        uv_close(handle, on_handle_closed);
}

void channel_finish(struct channel *channel)
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

void channel_fail_with(struct channel *channel, enum err_code code, const char *what)
{
    if (channel->state < CLOSING)
        err_set(&channel->err, code, "%s", what);
    channel_finish(channel);
}

void channel_fail_uv(struct channel *channel, const char *what, int status)
{
    if (channel->state < CLOSING)
        err_set(&channel->err, ERR_PEER, "%s: %s", what, uv_strerror(status));
    channel_finish(channel);
}

static void on_shut_down(uv_shutdown_t *request, int status)
{
    struct channel *channel = request->data;
    channel_release_hold(channel);
    if (channel->state == ENDED)
        return;
    channel->shut_down = true;
    if (status != 0 || channel->peer_ended)
        channel_finish(channel);
}

/* Flush, say that nothing more comes, and wait for the peer to close as well */
static void begin_closing(struct channel *channel)
{
    bool connected = channel->state == OPEN || channel->state == HANDSHAKE;
    channel->state = CLOSING;
    if (!connected) {
        channel_finish(channel);
        return;
    }
    uv_timer_stop(&channel->silence_timer);
    channel_deadline_stage(channel, channel->limits.close_ms);
    channel_output_flush(channel);
    if (channel->state != CLOSING)
        return;
    channel->shutdown.data = channel;
    if (uv_shutdown(&channel->shutdown, (uv_stream_t *)&channel->tcp, on_shut_down) != 0) {
        channel_finish(channel);
        return;
    }
    channel->holds++;
    channel_input_follow(channel);
}

void channel_break_off(struct channel *channel, const struct err *err)
{
    if (channel->state >= CLOSING)
        return;
    channel->err = *err;
    begin_closing(channel);
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
    channel_output_flush(channel); /* what the kernel takes at once, it has */
    channel_finish(channel);
}

/* Frames */

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
                channel_output_frame(channel, head, head_size, bulk, err);
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

void channel_pause(struct channel *channel, bool pause)
{
    channel->paused = pause;
    channel->heard_ms = uv_now(channel->loop);
    channel_input_follow(channel);
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

void channel_set_silence(struct channel *channel, uint32_t silence_ms)
{
    channel_deadline_silence(channel, silence_ms);
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
