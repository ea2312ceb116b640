/*
 * A channel carries frames to one peer and back over TCP: plain on loopback, TLS 1.3 with mutual
 * authentication anywhere. The caller sees no difference, and no sockets.
 *
 * Life: a channel comes from channel_connect or, through a listener, from accepting. It belongs to
 * the loop; the caller holds a pointer that is good until on_close returns. on_close is called
 * exactly once, last, from the loop, never from within another channel_ function, whatever ended
 * the channel. Every function may be called from inside every callback.
 *
 * Sending: channel_send takes a message and optionally a bulk. Frames sent during one turn of the
 * loop go out together. The output queue is bounded: above limits.queue_bytes a send is refused,
 * and on_drain says when less than half of that is left; a sender that makes work for itself asks
 * channel_queued first. A single frame may overshoot the bound.
 *
 * Thread: everything on the loop's thread. Not to be called from a uv_prepare_t callback, which
 * would leave the frames queued for one turn.
 *
 * SIGPIPE is ignored from the first channel on: a peer that is gone is an error, not a signal.
 */
#ifndef PROTO_CHANNEL_H
#define PROTO_CHANNEL_H

#include "proto/frame.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <uv.h>

struct err;
struct keys;

/* How long to wait and how much to hold. channel_limits_default() has sane ones. */
struct channel_limits {
    uint32_t connect_ms;      /* name look-up and TCP, over all addresses of the name */
    uint32_t handshake_ms;    /* TLS, from TCP on */
    uint32_t greeting_ms;     /* from then until phase WORKING */
    uint32_t silence_ms;      /* a peer from which nothing comes for so long is gone; 0: never */
    uint32_t close_ms;        /* to flush what is queued after channel_close */
    uint32_t handshake_bytes; /* that a peer may send before it has proved who it is */
    uint32_t pending_max;     /* accepted connections that have not yet done so, per listener */
    size_t queue_bytes;       /* output queue */
};
struct channel_limits channel_limits_default(void);

struct channel_options {
    const struct keys *keys; /* NULL: plain, loopback only; else TLS. Must outlive a listener */
    unsigned peers;          /* what the peer may be: bits of enum role. Over TLS its certificate
                                must say one of them; over plain it counts as all of them */
    struct channel_limits limits;
};

struct channel;

struct channel_events {
    /* Connecting side only: the channel is up (over TLS: the peer is the master we trust; it may
     * still turn us away, and "connected" means WELCOME was received). May be NULL. */
    void (*on_open)(void *owner, struct channel *channel);

    /* A frame that is allowed in this phase. Its memory is lent until return. False, with err
     * set, ends the channel with that error. */
    bool (*on_frame)(void *owner, struct channel *channel, const struct frame *frame,
                     struct err *err);

    /* The queue was full, or above half, and is now below half. May be NULL. */
    void (*on_drain)(void *owner, struct channel *channel);

    /* The end. err->code is ERR_OK after channel_close of our own; ERR_PEER when the peer ended it
     * (whether that was orderly, its GOODBYE has said). When the peer broke the protocol, or
     * on_frame said no, what was queued (a REFUSED) is flushed first, close_ms at most. */
    void (*on_close)(void *owner, struct channel *channel, const struct err *err);
};

/*
 * Connect to host:port; host is a name or an address. Every failure after the return comes as
 * on_close. NULL and err only for a wrong argument or no memory. `events` is kept by pointer.
 */
struct channel *channel_connect(uv_loop_t *loop, const char *host, unsigned port,
                                const struct channel_options *options,
                                const struct channel_events *events, void *owner, struct err *err);

/* Queue a REFUSED or GOODBYE first where the peer should know why. Flushes, then closes, waiting
 * at most close_ms; no on_frame after this. Again, or on a failed channel: does nothing. */
void channel_close(struct channel *channel);
/* End it at once with this error, for on_close. */
void channel_fail(struct channel *channel, const struct err *err);

/*
 * The bytes after the payload. `release(context)` is called once they are no longer needed, which
 * may be before channel_send returns (TLS) or when the channel ends. With release NULL they are
 * copied; with channel_lent they must stay as they are until on_close.
 */
struct channel_bulk {
    const void *data;
    size_t size;
    void (*release)(void *context);
    void *context;
};
void channel_lent(void *context); /* does nothing */

/*
 * Queue a frame; its kind follows from the type of the message (&result.base). `bulk` may be NULL.
 * False, and the bulk stays the caller's, when the queue is full (ERR_LIMIT: again after
 * on_drain), when a size is above its cap (ERR_ARGUMENT), or when the channel is not open
 * (ERR_PEER).
 */
bool channel_send(struct channel *channel, const ProtobufCMessage *message,
                  const struct channel_bulk *bulk, struct err *err);

/* Bytes queued and not yet taken by the kernel. */
size_t channel_queued(const struct channel *channel);

/* Stop and go on reading; frames that were read already still come. */
void channel_pause(struct channel *channel, bool pause);

void channel_set_phase(struct channel *channel, enum frame_phase phase);
enum frame_phase channel_phase(const struct channel *channel);
/* Replaces limits.silence_ms from now on (WELCOME tells the worker the master's). */
void channel_set_silence(struct channel *channel, uint32_t silence_ms);
/* Hand the channel to another owner: what on_accept must do. */
void channel_set_events(struct channel *channel, const struct channel_events *events, void *owner);

/* What the peer is: one bit over TLS, options.peers over plain. */
unsigned channel_peer_roles(const struct channel *channel);
/* "192.0.2.7:50412", for people; the host that was asked for while there is no connection. */
const char *channel_peer(const struct channel *channel);
bool channel_is_tls(const struct channel *channel);
/* Bytes on the wire so far, TLS records included. */
uint64_t channel_bytes_in(const struct channel *channel);
uint64_t channel_bytes_out(const struct channel *channel);

/*
 * Accept channels. on_accept gets each one that has proved who it is (over plain: each that comes
 * from loopback), in phase GREETING; one to which it gives no events (channel_set_events) is
 * closed. on_refused (may be NULL) hears of the others, for the log. Those still on their way when
 * the listener closes are dropped.
 */
struct channel_listener;

struct channel_listener_events {
    void (*on_accept)(void *owner, struct channel *channel);
    void (*on_refused)(void *owner, const char *peer, const struct err *err);
};

/* Port 0: any free one. host: an address ("127.0.0.1", "0.0.0.0", "::"). NULL and err on failure:
 * also for a plain listener on an address that is not loopback. */
struct channel_listener *channel_listen(uv_loop_t *loop, const char *host, unsigned port,
                                        const struct channel_options *options,
                                        const struct channel_listener_events *events, void *owner,
                                        struct err *err);
unsigned channel_listener_port(const struct channel_listener *listener);
/* No more callbacks. Freed by the loop. Channels that were handed out live on. NULL is fine. */
void channel_listener_close(struct channel_listener *listener);

/* "HOST:PORT", "[V6]:PORT" into host (size bytes) and port; ERR_ARGUMENT says what is wrong. */
bool channel_parse_address(const char *text, char *host, size_t size, unsigned *port,
                           struct err *err);

#endif
