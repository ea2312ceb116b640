#include "proto/channel_inside.h"

#include "proto/channel_tls.h"

#define READ_SIZE 65536

static bool deliver_frame(void *context, const struct frame *frame, struct err *err)
{
    struct channel *channel = context;
    if (channel->state != OPEN)
        return false; /* closed by an earlier frame of these bytes: the rest is discarded */
    return channel->events->on_frame(channel->owner, channel, frame, err);
}

bool channel_input_plain(void *context, const void *bytes, size_t size)
{
    struct channel *channel = context;
    struct err err = { 0 };
    if (channel->state != OPEN)
        return false;
    if (!frame_parser_feed(&channel->parser, bytes, size, deliver_frame, channel, &err))
        channel_break_off(channel, &err);
    return channel->state == OPEN;
}

static void on_end_of_input(struct channel *channel)
{
    channel->peer_ended = true;
    if (channel->state == CLOSING) {
        if (channel->shut_down)
            channel_finish(channel);
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
    channel_finish(channel);
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
            channel_fail_uv(channel, "receiving", (int)size);
        return;
    }
    channel->bytes_in += (uint64_t)size;
    channel->heard_ms = uv_now(channel->loop);
    if (channel->state == CLOSING)
        return;
    if (channel->tls == NULL) {
        channel_input_plain(channel, buffer->base, (size_t)size);
        return;
    }
    if (!channel_tls_feed(channel->tls, buffer->base, (size_t)size, &err))
        channel_break_off(channel, &err);
    else if (channel->state == OPEN && channel_tls_ended(channel->tls))
        on_end_of_input(channel);
    else if (channel->state == HANDSHAKE && channel->bytes_in > channel->limits.handshake_bytes)
        channel_fail_with(channel, ERR_LIMIT, "too many bytes before the end of the TLS handshake");
}

static void on_alloc(uv_handle_t *handle, size_t suggested, uv_buf_t *buffer)
{
    /* libuv fills it and calls on_read before it asks again, so a thread needs only one */
    static _Thread_local char bytes[READ_SIZE];
    (void)handle;
    (void)suggested;
    *buffer = uv_buf_init(bytes, sizeof(bytes));
}

void channel_input_follow(struct channel *channel)
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
        channel_fail_uv(channel, "receiving", status);
}
