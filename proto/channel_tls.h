/*
 * TLS 1.3 without sockets, for proto/channel*.c only: ciphertext in, plaintext out, and back. What
 * is to be sent is handed to a sink at once, which copies it; OpenSSL never owns bytes that a
 * write in flight points to, and no buffer between the two can fill up and block the handshake.
 */
#ifndef PROTO_CHANNEL_TLS_H
#define PROTO_CHANNEL_TLS_H

#include "proto/role.h"

#include <stdbool.h>
#include <stddef.h>

struct err;
struct keys;

struct channel_tls_sink {
    /* Take ciphertext for the peer; false ends the session (the owner knows why). */
    bool (*send)(void *owner, const void *bytes, size_t size);
    /* The handshake is done; false stops the feed. */
    bool (*opened)(void *owner);
    /* Plaintext from the peer, lent; false stops the feed. */
    bool (*receive)(void *owner, const void *bytes, size_t size);
};

struct channel_tls;

/* NULL when memory runs out. `sink` is kept by pointer. */
struct channel_tls *channel_tls_new(const struct keys *keys, bool accepting, unsigned peers,
                                    const struct channel_tls_sink *sink, void *owner);
void channel_tls_free(struct channel_tls *tls); /* NULL is fine */

/* Say hello, on the connecting side. */
bool channel_tls_start(struct channel_tls *tls, struct err *err);
/* Take ciphertext. False, with err set, when the peer is not acceptable or the stream is broken;
 * an alert for the peer was sent then. True also when the sink stopped the feed. */
bool channel_tls_feed(struct channel_tls *tls, const void *bytes, size_t size, struct err *err);
/* Encrypt. False with err when that is impossible. */
bool channel_tls_write(struct channel_tls *tls, const void *bytes, size_t size, struct err *err);
/* Send close_notify, if the handshake is done. */
void channel_tls_shutdown(struct channel_tls *tls);

bool channel_tls_ended(const struct channel_tls *tls); /* the peer sent close_notify */
enum role channel_tls_peer(const struct channel_tls *tls);

#endif
