/*
 * Frames: how messages are laid out on a byte stream (see the head of proto/pathfarm.proto), and
 * the one table that says who may send which kind when, and how large.
 *
 * A parser takes bytes as they come, in pieces of any size. It judges a frame by its twelve bytes
 * of header: an unknown kind, a kind not allowed from this sender in this phase, or a length above
 * the kind's cap is refused before anything is allocated or waited for. Frames that arrive whole
 * are handed out in place; others are collected in a buffer of exactly their size.
 *
 * Phases belong to a connection: GREETING until the HELLO was accepted (master) or the WELCOME came
 * (worker), WORKING then. The side that moves on calls channel_set_phase (or sets parser->phase).
 * After GOODBYE or REFUSED the parser lets nothing more through: phase CLOSING.
 *
 * A parser belongs to one thread.
 */
#ifndef PROTO_FRAME_H
#define PROTO_FRAME_H

#include "proto/limits.h"
#include "proto/pathfarm.pb-c.h"
#include "proto/role.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

#define FRAME_HEADER_SIZE 12

enum frame_phase { PHASE_GREETING = 1, PHASE_WORKING = 2, PHASE_CLOSING = 4 };

/* Short names that only the table needs */
#define PHASES_OPEN (PHASE_GREETING | PHASE_WORKING)
#define ROLES_BOTH  (ROLE_MASTER | ROLE_WORKER)

#define FRAME_MAP(X) /* kind, message, phases, senders, payload cap, bulk cap */      \
    X(HELLO, hello, PHASE_GREETING, ROLE_WORKER, 4 * LIMIT_KIB, 0)                    \
    X(WELCOME, welcome, PHASE_GREETING, ROLE_MASTER, 4 * LIMIT_KIB, 0)                \
    X(REFUSED, refused, PHASES_OPEN, ROLES_BOTH, 4 * LIMIT_KIB, 0)                    \
    X(JOB, job, PHASE_WORKING, ROLE_MASTER, 64 * LIMIT_KIB, 0)                        \
    X(OBJECT_WANTED, object_wanted, PHASE_WORKING, ROLE_WORKER, LIMIT_KIB, 0)         \
    X(OBJECT_SLICE, object_slice, PHASE_WORKING, ROLE_MASTER, LIMIT_MIB, LIMIT_SLICE) \
    X(JOB_READY, job_ready, PHASE_WORKING, ROLE_WORKER, 4 * LIMIT_KIB, 0)             \
    X(LEASE, lease, PHASE_WORKING, ROLE_MASTER, 256 * LIMIT_KIB, 0)                   \
    X(RESULT, result, PHASE_WORKING, ROLE_WORKER, 4 * LIMIT_KIB, LIMIT_NODE_BULK)     \
    X(PROGRESS, progress, PHASE_WORKING, ROLE_WORKER, 64 * LIMIT_KIB, 0)              \
    X(REVOKE, revoke, PHASE_WORKING, ROLE_MASTER, 256 * LIMIT_KIB, 0)                 \
    X(ACCEPTED, accepted, PHASE_WORKING, ROLE_MASTER, LIMIT_KIB, 0)                   \
    X(NODE_FAILED, node_failed, PHASE_WORKING, ROLE_WORKER, 4 * LIMIT_KIB, 0)         \
    X(JOB_DONE, job_done, PHASE_WORKING, ROLE_MASTER, LIMIT_KIB, 0)                   \
    X(GOODBYE, goodbye, PHASES_OPEN, ROLES_BOTH, 4 * LIMIT_KIB, 0)

/* One received frame; its memory is lent for the length of the callback. */
struct frame {
    Pathfarm__Kind kind;
    const uint8_t *payload;
    size_t payload_size;
    const uint8_t *bulk; /* unaligned */
    size_t bulk_size;
};

/* "RESULT"; "kind 77" style names are left to the caller: "unknown" for others. */
const char *frame_kind_name(unsigned kind);

/* May a peer of one of `senders` (bits of enum role) send this kind in this phase? ERR_MESSAGE. */
bool frame_allowed(unsigned kind, enum frame_phase phase, unsigned senders, struct err *err);

/* Are both lengths within the kind's caps? ERR_LIMIT. */
bool frame_sizes_allowed(unsigned kind, uint64_t payload_size, uint64_t bulk_size, struct err *err);

/*
 * Decode the payload into its message: cast to the type of the kind (Pathfarm__Result * for
 * RESULT), free with frame_message_free. Strings come back without control characters, so they can
 * be printed; a sub-message that every sender sets (Result.node) may still be missing. NULL and
 * ERR_MESSAGE when the payload does not parse.
 */
void *frame_message(const struct frame *frame, struct err *err);
void frame_message_free(void *message); /* NULL is fine */

/*
 * Encode header and payload of a frame; its bulk, if any, follows on the wire as it is. The kind
 * follows from the message's type. The sizes are checked against the caps as the receiver will.
 */
Pathfarm__Kind frame_kind_of(const ProtobufCMessage *message);
size_t frame_head_size(const ProtobufCMessage *message);
bool frame_head(const ProtobufCMessage *message, size_t bulk_size, uint8_t *head, struct err *err);

struct frame_parser {
    enum frame_phase phase;
    unsigned senders; /* what the peer may be: bits of enum role */
    /* private */
    uint8_t header[FRAME_HEADER_SIZE];
    uint8_t *buffer; /* payload and bulk of the frame being collected */
    size_t buffer_capacity;
    size_t have, want; /* bytes of the frame, header included; want is 0 before its header came */
};

/* False, with err set, ends the connection. It may set parser->phase. */
typedef bool frame_fn(void *owner, const struct frame *frame, struct err *err);

void frame_parser_init(struct frame_parser *parser, unsigned senders);
void frame_parser_free(struct frame_parser *parser); /* what it collected; not the struct */

/* Hand out every frame that is complete with these bytes. False after a broken frame or a no. */
bool frame_parser_feed(struct frame_parser *parser, const void *bytes, size_t size, frame_fn *fn,
                       void *owner, struct err *err);

/* Kind name of the frame whose bytes are incomplete, "" for a cut header; NULL between frames. */
const char *frame_parser_inside(const struct frame_parser *parser);

#endif
