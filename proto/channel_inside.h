/*
 * A channel from inside: its state, and what the files that work on it offer each other. Nothing
 * but proto/channel*.c includes this; channel.h says what a channel is.
 *
 *   channel          its life: made, opened, closed, failed, freed; TLS between the two below
 *   channel_output   bytes on their way out: batched, bounded, flushed once in a turn of the loop
 *   channel_input    bytes that come in, down to frames for the owner
 *   channel_deadline how long each stage, and silence, may last
 *   channel_connect  from a host's name to a connection
 *   channel_listen   from a listening socket to channels that have proved who they are
 *
 * A function here may end the channel, but never frees it: the loop does, once all handles and
 * requests that point to it (`holds`) are gone. So whoever calls one looks at `state` afterwards.
 * All on the loop's thread.
 */
#ifndef PROTO_CHANNEL_INSIDE_H
#define PROTO_CHANNEL_INSIDE_H

#include "common/err.h"
#include "proto/channel.h"

#include <sys/socket.h>

#define CHANNEL_ADDRESSES_MAX 8

/*
 * CONNECTING -> HANDSHAKE -> OPEN -> CLOSING -> ENDED; any state may go straight to ENDED. In
 * CLOSING the output is flushed and input discarded until the peer closes too: closing a socket
 * with unread input would reset the connection and could destroy our last words on their way.
 */
enum channel_state { CONNECTING, HANDSHAKE, OPEN, CLOSING, ENDED };

struct channel {
    enum channel_state state;
    uv_loop_t *loop;
    unsigned holds; /* handles and requests of the loop that point here */
    uv_tcp_t tcp;
    uv_shutdown_t shutdown;
    bool shut_down, peer_ended; /* our direction is closed; theirs is */
    struct err err;             /* why it ends */

    struct channel_limits limits;
    const struct channel_events *events;
    void *owner;
    struct channel_tls *tls;
    unsigned roles; /* of the peer */
    char host[256];
    char peer[320];

    /* channel_output */
    uv_prepare_t flusher;
    struct channel_batch *staged, **staged_end;
    struct channel_batch *batch; /* the last staged one, which still takes pieces */
    size_t queued;
    bool drain_wanted;
    uint64_t bytes_out;

    /* channel_input */
    struct frame_parser parser;
    bool paused, reading;
    uint64_t heard_ms, bytes_in;

    /* channel_deadline */
    uv_timer_t stage_timer, silence_timer;
    bool stage_grace, silence_grace;
    uint32_t silence_ms;

    /* channel_connect */
    uv_getaddrinfo_t resolve;
    uv_connect_t connect;
    struct sockaddr_storage addresses[CHANNEL_ADDRESSES_MAX];
    unsigned address_count, address_next;
    unsigned port;

    /* channel_listen */
    struct channel_listener *listener; /* while it has not proved who it is */
    struct channel *pending_previous, *pending_next;
};

/*
 * channel.c
 */

/* A channel in CONNECTING, its socket made and not connected; NULL: no memory or socket. From now
 * on only channel_finish and the loop free it. */
struct channel *channel_new(uv_loop_t *loop, const struct channel_options *options, bool accepting);

/* TCP is there: begin TLS or, over plain, be open. */
void channel_start_session(struct channel *channel);

/* Nothing more happens but on_close, with the reason in channel->err. */
void channel_finish(struct channel *channel);

/* The same with a reason, unless the channel is closing or ended: the first reason counts. */
void channel_fail_with(struct channel *channel, enum err_code code, const char *what);
void channel_fail_uv(struct channel *channel, const char *what, int status);

/* The peer, or the owner in its name, broke off: last words (an alert, a REFUSED) still go out. */
void channel_break_off(struct channel *channel, const struct err *err);

/* One handle or request of the loop less; the last one calls on_close and frees the channel. */
void channel_release_hold(struct channel *channel);

/*
 * channel_output.c. False: no memory, and the channel ended for it.
 */

/* Queue bytes for the kernel (a copy), or a frame, through TLS where there is one. With false the
 * bulk stays the caller's, and err has the reason. */
bool channel_output_bytes(struct channel *channel, const void *bytes, size_t size);
bool channel_output_frame(struct channel *channel, const uint8_t *head, size_t head_size,
                          const struct channel_bulk *bulk, struct err *err);

/* Hand all that is queued to the kernel now; or forget what it was not handed yet. */
void channel_output_flush(struct channel *channel);
void channel_output_drop(struct channel *channel);

/*
 * channel_input.c
 */

/* Start or stop reading as state and `paused` say; after each change of them. */
void channel_input_follow(struct channel *channel);

/* What the peer sent, TLS taken off: a channel_tls_sink's `receive`. */
bool channel_input_plain(void *context, const void *bytes, size_t size);

/*
 * channel_deadline.c
 */

/* The stage that the channel is in must be over in so many ms (phase WORKING stops the timer). */
void channel_deadline_stage(struct channel *channel, uint32_t ms);

/* From now on the peer may be silent for so long; 0: for ever. */
void channel_deadline_silence(struct channel *channel, uint32_t silence_ms);

/*
 * channel_listen.c: for channels that a listener still counts (`listener` is set).
 */

/* It has proved who it is: on_accept. Or it will not: on_refused. */
void channel_listen_accepted(struct channel *channel);
void channel_listen_refused(struct channel *channel);

#endif
