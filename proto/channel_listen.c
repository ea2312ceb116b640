#include "proto/channel_inside.h"

#include "proto/channel_address.h"

#include <stdio.h>
#include <stdlib.h>

#define BACKLOG         512
#define ACCEPT_AGAIN_MS 100

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

static void remember(struct channel *channel, struct channel_listener *listener)
{
    channel->listener = listener;
    channel->pending_next = listener->pending;
    if (listener->pending != NULL)
        listener->pending->pending_previous = channel;
    listener->pending = channel;
    listener->pending_count++;
}

static void forget(struct channel *channel)
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

void channel_listen_accepted(struct channel *channel)
{
    struct channel_listener *listener = channel->listener;
    forget(channel);
    listener->events->on_accept(listener->owner, channel);
}

void channel_listen_refused(struct channel *channel)
{
    struct channel_listener *listener = channel->listener;
    forget(channel);
    if (listener->events->on_refused != NULL)
        listener->events->on_refused(listener->owner, channel->peer, &channel->err);
}

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
    remember(channel, listener);

    struct sockaddr_storage address = { 0 };
    int length = sizeof(address);
    snprintf(channel->peer, sizeof(channel->peer), "a peer");
    status = uv_accept(server, (uv_stream_t *)&channel->tcp);
    if (status == 0)
        status = uv_tcp_getpeername(&channel->tcp, (struct sockaddr *)&address, &length);
    if (status != 0) {
        channel_fail_uv(channel, "accepting", status);
        return;
    }
    channel_address_text((const struct sockaddr *)&address, channel->peer, sizeof(channel->peer));
    if (listener->pending_count > channel->limits.pending_max)
        channel_fail_with(channel, ERR_LIMIT,
                          "too many connections that have not said who they are");
    else if (channel->tls == NULL &&
             !channel_address_is_loopback((const struct sockaddr *)&address))
        channel_fail_with(channel, ERR_AUTH,
                          "only loopback may connect without keys (pathfarm keygen)");
    else
        channel_start_session(channel);
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
    if (port > 65535 || !channel_address_of(host, port, &address)) {
        err_set(err, ERR_ARGUMENT, "\"%s\" port %u is not an address to listen on", host, port);
        return NULL;
    }
    if (options->keys == NULL && !channel_address_is_loopback((const struct sockaddr *)&address)) {
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
        listener->port = channel_address_port(socket_address);
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
        forget(channel);
        channel_fail_with(channel, ERR_CANCELLED, "the listener closed");
    }
    uv_close((uv_handle_t *)&listener->tcp, on_listener_closed);
    uv_close((uv_handle_t *)&listener->again, on_listener_closed);
}
