#include "proto/channel_inside.h"

#include "proto/channel_address.h"

#include <arpa/inet.h>
#include <netdb.h>
#include <stdio.h>
#include <string.h>

static void connect_next(struct channel *channel);

static void on_connected(uv_connect_t *request, int status)
{
    struct channel *channel = request->data;
    if (channel->state == ENDED)
        return;
    if (status == 0) {
        err_clear(&channel->err);
        channel_start_session(channel);
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
            channel_finish(
                channel); /* the socket counts as closing still, so only the rest is closed */
        }
        channel_release_hold(channel);
        return;
    }
    channel->tcp.data = channel;
    const struct sockaddr *address =
        (const struct sockaddr *)&channel->addresses[channel->address_next++];
    channel_address_text(address, channel->peer, sizeof(channel->peer));
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
        channel_finish(channel); /* with the error of the last one */
    else
        uv_close((uv_handle_t *)&channel->tcp, on_retry);
}

/* Keep the addresses that we may connect to, and begin with the first */
static void connect_first(struct channel *channel)
{
    unsigned kept = 0;
    for (unsigned i = 0; i < channel->address_count; i++)
        if (channel->tls != NULL ||
            channel_address_is_loopback((const struct sockaddr *)&channel->addresses[i]))
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
    channel_finish(channel);
}

static void on_resolved(uv_getaddrinfo_t *request, int status, struct addrinfo *list)
{
    struct channel *channel = request->data;
    if (channel->state != ENDED) {
        for (struct addrinfo *info = list; info != NULL && status == 0; info = info->ai_next) {
            if (channel->address_count == CHANNEL_ADDRESSES_MAX ||
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
            channel_finish(channel);
        }
    }
    uv_freeaddrinfo(list);
    channel_release_hold(channel);
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
    channel_deadline_stage(channel, channel->limits.connect_ms);

    if (channel_address_of(host, port, &channel->addresses[0])) {
        channel->address_count = 1;
        connect_first(channel);
        return channel;
    }
    const struct addrinfo hints = { .ai_socktype = SOCK_STREAM, .ai_family = AF_UNSPEC };
    int status = uv_getaddrinfo(loop, &channel->resolve, on_resolved, host, NULL, &hints);
    if (status == 0)
        channel->holds++;
    else
        channel_fail_uv(channel, host, status);
    return channel;
}
