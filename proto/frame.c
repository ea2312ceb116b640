#include "proto/frame.h"

#include "common/bytes.h"
#include "common/err.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

/* A buffer larger than this is given back after its frame: most frames are small */
#define KEEP_BUFFER (64 * LIMIT_KIB)

struct frame_rule {
    const char *name;
    const ProtobufCMessageDescriptor *message;
    unsigned phases, senders;
    uint64_t payload_max, bulk_max;
};

static const struct frame_rule rules[] = {
#define X(kind, type, phase_bits, sender_bits, payload_cap, bulk_cap)             \
    [PATHFARM__KIND__KIND_##kind] = { .name = #kind,                              \
                                      .message = &pathfarm__##type##__descriptor, \
                                      .phases = (phase_bits),                     \
                                      .senders = (sender_bits),                   \
                                      .payload_max = (payload_cap),               \
                                      .bulk_max = (bulk_cap) },
    FRAME_MAP(X)
#undef X
};

#define RULE_COUNT (sizeof(rules) / sizeof(rules[0]))

static const struct frame_rule *rule_of(unsigned kind)
{
    return kind < RULE_COUNT && rules[kind].name != NULL ? &rules[kind] : NULL;
}

static const char *phase_name(enum frame_phase phase)
{
    switch (phase) {
    case PHASE_GREETING:
        return "before the greeting is over";
    case PHASE_WORKING:
        return "after the greeting";
    case PHASE_CLOSING:
        return "after a goodbye";
    }
    return "now";
}

static const char *sender_name(unsigned senders)
{
    switch (senders) {
    case ROLE_MASTER:
        return "a master";
    case ROLE_WORKER:
        return "a worker";
    case ROLE_USER:
        return "a user";
    default:
        return "this peer";
    }
}

const char *frame_kind_name(unsigned kind)
{
    const struct frame_rule *rule = rule_of(kind);
    return rule != NULL ? rule->name : "unknown";
}

bool frame_allowed(unsigned kind, enum frame_phase phase, unsigned senders, struct err *err)
{
    const struct frame_rule *rule = rule_of(kind);
    if (rule == NULL)
        return err_set(err, ERR_MESSAGE, "kind %u of frame is unknown", kind);
    if ((rule->senders & senders) == 0)
        return err_set(err, ERR_MESSAGE, "%s may not send %s", sender_name(senders), rule->name);
    if ((rule->phases & phase) == 0)
        return err_set(err, ERR_MESSAGE, "%s may not come %s", rule->name, phase_name(phase));
    return true;
}

bool frame_sizes_allowed(unsigned kind, uint64_t payload_size, uint64_t bulk_size, struct err *err)
{
    const struct frame_rule *rule = rule_of(kind);
    if (rule == NULL)
        return err_set(err, ERR_MESSAGE, "kind %u of frame is unknown", kind);
    if (payload_size > rule->payload_max)
        return err_set(err, ERR_LIMIT, "%s with %llu bytes of payload; at most %llu are allowed",
                       rule->name, (unsigned long long)payload_size,
                       (unsigned long long)rule->payload_max);
    if (bulk_size > rule->bulk_max)
        return err_set(err, ERR_LIMIT, "%s with %llu bytes of bulk; at most %llu are allowed",
                       rule->name, (unsigned long long)bulk_size,
                       (unsigned long long)rule->bulk_max);
    return true;
}

/*
 * Texts from the wire end up in logs and on terminals, where control characters (and the C1 set,
 * two bytes in UTF-8) could move the cursor or forge lines.
 */
static void clean_text(char *text)
{
    for (unsigned char *at = (unsigned char *)text; *at != 0; at++) {
        if (*at < 0x20 || *at == 0x7f)
            *at = ' ';
        else if (*at == 0xc2 && at[1] >= 0x80 && at[1] < 0xa0)
            at[0] = at[1] = ' ';
    }
}

static void clean_message(ProtobufCMessage *message)
{
    const ProtobufCMessageDescriptor *type = message->descriptor;
    for (unsigned i = 0; i < type->n_fields; i++) {
        const ProtobufCFieldDescriptor *field = &type->fields[i];
        bool text = field->type == PROTOBUF_C_TYPE_STRING;
        if (!text && field->type != PROTOBUF_C_TYPE_MESSAGE)
            continue;
        uint8_t *member = (uint8_t *)message + field->offset;
        void **items = (void **)member; /* a single field is its own list */
        size_t count = 1;
        if (field->label == PROTOBUF_C_LABEL_REPEATED) {
            items = *(void ***)member;
            count = *(size_t *)((uint8_t *)message + field->quantifier_offset);
        }
        for (size_t item = 0; item < count; item++) {
            if (items[item] == NULL)
                continue;
            if (text)
                clean_text(items[item]);
            else
                clean_message(items[item]);
        }
    }
}

void *frame_message(const struct frame *frame, struct err *err)
{
    const struct frame_rule *rule = rule_of(frame->kind);
    assert(rule != NULL);
    ProtobufCMessage *message = protobuf_c_message_unpack(rule->message, NULL, frame->payload_size,
                                                          frame->payload);
    if (message == NULL) {
        err_set(err, ERR_MESSAGE, "a %s that does not parse", rule->name);
        return NULL;
    }
    clean_message(message);
    return message;
}

void frame_message_free(void *message)
{
    if (message != NULL)
        protobuf_c_message_free_unpacked(message, NULL);
}

Pathfarm__Kind frame_kind_of(const ProtobufCMessage *message)
{
    for (unsigned kind = 0; kind < RULE_COUNT; kind++)
        if (rules[kind].name != NULL && rules[kind].message == message->descriptor)
            return (Pathfarm__Kind)kind;
    return PATHFARM__KIND__KIND_NONE;
}

size_t frame_head_size(const ProtobufCMessage *message)
{
    return FRAME_HEADER_SIZE + protobuf_c_message_get_packed_size(message);
}

bool frame_head(const ProtobufCMessage *message, size_t bulk_size, uint8_t *head, struct err *err)
{
    Pathfarm__Kind kind = frame_kind_of(message);
    size_t payload_size = protobuf_c_message_get_packed_size(message);
    if (!frame_sizes_allowed(kind, payload_size, bulk_size, err))
        return false;
    struct writer out = writer_of(head, FRAME_HEADER_SIZE);
    write_u32(&out, (uint32_t)payload_size);
    write_u32(&out, (uint32_t)bulk_size);
    write_u8(&out, (uint8_t)kind);
    write_u8s(&out, (const uint8_t[3]){ 0, 0, 0 }, 3);
    protobuf_c_message_pack(message, head + FRAME_HEADER_SIZE);
    return true;
}

void frame_parser_init(struct frame_parser *parser, unsigned senders)
{
    *parser = (struct frame_parser){ .phase = PHASE_GREETING, .senders = senders };
}

void frame_parser_free(struct frame_parser *parser)
{
    free(parser->buffer);
    parser->buffer = NULL;
    parser->buffer_capacity = 0;
}

const char *frame_parser_inside(const struct frame_parser *parser)
{
    if (parser->have == 0)
        return NULL;
    return parser->want == 0 ? "" : frame_kind_name(parser->header[8]);
}

/* The lengths of a frame, from a header that was judged */
static void header_lengths(const uint8_t *header, size_t *payload_size, size_t *bulk_size)
{
    struct reader in = reader_of(header, FRAME_HEADER_SIZE);
    *payload_size = read_u32(&in);
    *bulk_size = read_u32(&in);
}

static bool judge_header(struct frame_parser *parser, struct err *err)
{
    const uint8_t *header = parser->header;
    unsigned kind = header[8];
    size_t payload_size, bulk_size;
    header_lengths(header, &payload_size, &bulk_size);
    if (header[9] != 0 || header[10] != 0 || header[11] != 0)
        return err_set(err, ERR_MESSAGE, "these bytes are not a frame");
    if (!frame_allowed(kind, parser->phase, parser->senders, err) ||
        !frame_sizes_allowed(kind, payload_size, bulk_size, err))
        return false;
    parser->want = FRAME_HEADER_SIZE + payload_size + bulk_size;
    return true;
}

static bool hand_out(struct frame_parser *parser, const uint8_t *body, frame_fn *fn, void *owner,
                     struct err *err)
{
    struct frame frame = { .kind = (Pathfarm__Kind)parser->header[8] };
    header_lengths(parser->header, &frame.payload_size, &frame.bulk_size);
    frame.payload = body;
    frame.bulk = frame.bulk_size > 0 ? body + frame.payload_size : body;
    if (frame.kind == PATHFARM__KIND__KIND_GOODBYE || frame.kind == PATHFARM__KIND__KIND_REFUSED)
        parser->phase = PHASE_CLOSING;
    parser->have = parser->want = 0;
    return fn(owner, &frame, err);
}

static bool reserve(struct frame_parser *parser, struct err *err)
{
    size_t size = parser->want - FRAME_HEADER_SIZE;
    if (size <= parser->buffer_capacity)
        return true;
    free(parser->buffer);
    parser->buffer_capacity = 0;
    parser->buffer = malloc(size);
    if (parser->buffer == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a frame of %zu bytes", size);
    parser->buffer_capacity = size;
    return true;
}

static size_t smaller(size_t a, size_t b)
{
    return a < b ? a : b;
}

bool frame_parser_feed(struct frame_parser *parser, const void *bytes, size_t size, frame_fn *fn,
                       void *owner, struct err *err)
{
    const uint8_t *at = bytes, *end = at + size;
    while (at < end) {
        if (parser->have < FRAME_HEADER_SIZE) {
            size_t part = smaller((size_t)(end - at), FRAME_HEADER_SIZE - parser->have);
            memcpy(parser->header + parser->have, at, part);
            at += part;
            parser->have += part;
            if (parser->have < FRAME_HEADER_SIZE)
                return true;
            if (!judge_header(parser, err))
                return false;
        }

        size_t missing = parser->want - parser->have;
        size_t part = smaller((size_t)(end - at), missing);
        bool untouched = parser->have == FRAME_HEADER_SIZE;
        if (untouched && part == missing) {
            if (!hand_out(parser, at, fn, owner, err))
                return false;
            at += part;
            continue;
        }

        if (untouched && !reserve(parser, err))
            return false;
        memcpy(parser->buffer + parser->have - FRAME_HEADER_SIZE, at, part);
        at += part;
        parser->have += part;
        if (part == missing) {
            if (!hand_out(parser, parser->buffer, fn, owner, err))
                return false;
            if (parser->buffer_capacity > KEEP_BUFFER)
                frame_parser_free(parser);
        }
    }
    return true;
}
