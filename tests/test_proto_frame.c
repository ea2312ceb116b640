/* Frames: any cutting of the stream gives the same frames, and no broken one gets through. */
#include "common/bytes.h"
#include "common/err.h"
#include "proto/frame.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

struct seen {
    unsigned count;
    Pathfarm__Kind kinds[16];
    size_t payload_sizes[16], bulk_sizes[16];
    uint64_t sums[16]; /* of the bytes of payload and bulk */
    unsigned stop_at;  /* say no to this frame, counted from 1 */
};

static bool note_frame(void *owner, const struct frame *frame, struct err *err)
{
    struct seen *seen = owner;
    unsigned i = seen->count++;
    assert_true(i < 16);
    seen->kinds[i] = frame->kind;
    seen->payload_sizes[i] = frame->payload_size;
    seen->bulk_sizes[i] = frame->bulk_size;
    seen->sums[i] = 0;
    for (size_t at = 0; at < frame->payload_size; at++)
        seen->sums[i] = seen->sums[i] * 31 + frame->payload[at];
    for (size_t at = 0; at < frame->bulk_size; at++)
        seen->sums[i] = seen->sums[i] * 31 + frame->bulk[at];
    if (seen->count == seen->stop_at)
        return err_set(err, ERR_RENDER, "enough");
    return true;
}

static size_t put_frame(uint8_t *to, const ProtobufCMessage *message, const void *bulk, size_t size)
{
    size_t head = frame_head_size(message);
    assert_true(frame_head(message, size, to, NULL));
    if (size > 0)
        memcpy(to + head, bulk, size);
    return head + size;
}

/* Frames with and without payload and bulk, as a worker that is WORKING sends them */
static size_t put_stream(uint8_t *to)
{
    static uint8_t bulk[700];
    size_t size = 0;
    for (size_t i = 0; i < sizeof(bulk); i++)
        bulk[i] = (uint8_t)(i * 7);
    Pathfarm__Progress empty = PATHFARM__PROGRESS__INIT;
    Pathfarm__Node node = PATHFARM__NODE__INIT;
    node.index = 77;
    Pathfarm__Result result = PATHFARM__RESULT__INIT;
    result.node = &node;
    result.sequence = 5;
    size += put_frame(to + size, &empty.base, NULL, 0);
    size += put_frame(to + size, &result.base, bulk, sizeof(bulk));
    size += put_frame(to + size, &result.base, NULL, 0);
    empty.samples = 1;
    size += put_frame(to + size, &empty.base, NULL, 0);
    size += put_frame(to + size, &result.base, bulk, 1);
    return size;
}

static void feed_in_pieces(const uint8_t *stream, size_t size, size_t piece, struct seen *seen)
{
    struct frame_parser parser;
    struct err err = { 0 };
    frame_parser_init(&parser, ROLE_WORKER);
    parser.phase = PHASE_WORKING;
    for (size_t at = 0; at < size; at += piece) {
        size_t part = size - at < piece ? size - at : piece;
        /* A copy of its own, so that the sanitizer sees every byte too many */
        uint8_t *copy = malloc(part);
        memcpy(copy, stream + at, part);
        assert_true(frame_parser_feed(&parser, copy, part, note_frame, seen, &err));
        free(copy);
    }
    assert_null(frame_parser_inside(&parser));
    frame_parser_free(&parser);
}

static void every_way_to_cut_a_stream_gives_the_same_frames(void **state)
{
    (void)state;
    uint8_t stream[4096];
    size_t size = put_stream(stream);
    struct seen whole = { 0 };
    feed_in_pieces(stream, size, size, &whole);
    assert_int_equal(whole.count, 5);
    assert_int_equal(whole.kinds[1], PATHFARM__KIND__KIND_RESULT);
    assert_int_equal(whole.bulk_sizes[1], 700);
    assert_int_equal(whole.payload_sizes[0], 0);
    for (size_t piece = 1; piece < size; piece++) {
        struct seen cut = { 0 };
        feed_in_pieces(stream, size, piece, &cut);
        assert_memory_equal(&cut, &whole, sizeof(whole));
    }
}

static void the_parser_says_which_frame_is_incomplete(void **state)
{
    (void)state;
    uint8_t stream[4096];
    struct seen seen = { 0 };
    put_stream(stream);
    struct frame_parser parser;
    frame_parser_init(&parser, ROLE_WORKER);
    parser.phase = PHASE_WORKING;
    assert_null(frame_parser_inside(&parser));
    assert_true(frame_parser_feed(&parser, stream, 12 + 3, note_frame, &seen, NULL));
    assert_string_equal(frame_parser_inside(&parser), "");
    assert_true(frame_parser_feed(&parser, stream + 15, 40, note_frame, &seen, NULL));
    assert_string_equal(frame_parser_inside(&parser), "RESULT");
    frame_parser_free(&parser);
}

static void put_header(uint8_t *to, uint32_t payload, uint32_t bulk, uint8_t kind, uint8_t last)
{
    struct writer out = writer_of(to, FRAME_HEADER_SIZE);
    write_u32(&out, payload);
    write_u32(&out, bulk);
    write_u8s(&out, (const uint8_t[]){ kind, 0, 0, last }, 4);
}

static void broken_headers_are_refused_before_anything_is_allocated(void **state)
{
    (void)state;
    static const struct {
        const char *says;
        enum frame_phase phase;
        unsigned senders;
        uint32_t payload, bulk;
        uint8_t kind, last;
        enum err_code code;
    } cases[] = {
        { "kind 0 of frame is unknown", PHASE_WORKING, ROLE_WORKER, 0, 0, 0, 0, ERR_MESSAGE },
        { "kind 16 of frame is unknown", PHASE_WORKING, ROLE_WORKER, 0, 0, 16, 0, ERR_MESSAGE },
        { "kind 255 of frame is unknown", PHASE_WORKING, ROLE_WORKER, 0, 0, 255, 0, ERR_MESSAGE },
        { "not a frame", PHASE_WORKING, ROLE_WORKER, 0, 0, PATHFARM__KIND__KIND_RESULT, 1,
          ERR_MESSAGE },
        { "RESULT with 4097 bytes of payload", PHASE_WORKING, ROLE_WORKER, 4097, 0,
          PATHFARM__KIND__KIND_RESULT, 0, ERR_LIMIT },
        { "RESULT with 4294967295 bytes of bulk", PHASE_WORKING, ROLE_WORKER, 0, UINT32_MAX,
          PATHFARM__KIND__KIND_RESULT, 0, ERR_LIMIT },
        { "HELLO with 4294967295 bytes of payload", PHASE_GREETING, ROLE_WORKER, UINT32_MAX, 0,
          PATHFARM__KIND__KIND_HELLO, 0, ERR_LIMIT },
        { "HELLO with 1 bytes of bulk", PHASE_GREETING, ROLE_WORKER, 0, 1,
          PATHFARM__KIND__KIND_HELLO, 0, ERR_LIMIT },
        { "RESULT may not come before the greeting", PHASE_GREETING, ROLE_WORKER, 0, 0,
          PATHFARM__KIND__KIND_RESULT, 0, ERR_MESSAGE },
        { "HELLO may not come after the greeting", PHASE_WORKING, ROLE_WORKER, 0, 0,
          PATHFARM__KIND__KIND_HELLO, 0, ERR_MESSAGE },
        { "PROGRESS may not come after a goodbye", PHASE_CLOSING, ROLE_WORKER, 0, 0,
          PATHFARM__KIND__KIND_PROGRESS, 0, ERR_MESSAGE },
        { "a worker may not send LEASE", PHASE_WORKING, ROLE_WORKER, 0, 0,
          PATHFARM__KIND__KIND_LEASE, 0, ERR_MESSAGE },
        { "a master may not send RESULT", PHASE_WORKING, ROLE_MASTER, 0, 0,
          PATHFARM__KIND__KIND_RESULT, 0, ERR_MESSAGE },
        { "a user may not send RESULT", PHASE_WORKING, ROLE_USER, 0, 0, PATHFARM__KIND__KIND_RESULT,
          0, ERR_MESSAGE },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        uint8_t header[FRAME_HEADER_SIZE];
        struct seen seen = { 0 };
        struct err err = { 0 };
        struct frame_parser parser;
        put_header(header, cases[i].payload, cases[i].bulk, cases[i].kind, cases[i].last);
        frame_parser_init(&parser, cases[i].senders);
        parser.phase = cases[i].phase;
        assert_false(frame_parser_feed(&parser, header, sizeof(header), note_frame, &seen, &err));
        assert_int_equal(seen.count, 0);
        assert_null(parser.buffer);
        assert_int_equal(err.code, cases[i].code);
        if (strstr(err.text, cases[i].says) == NULL)
            fail_msg("case %zu: \"%s\" does not say \"%s\"", i, err.text, cases[i].says);
        frame_parser_free(&parser);
    }
}

static void nothing_follows_a_goodbye(void **state)
{
    (void)state;
    uint8_t stream[256];
    struct seen seen = { 0 };
    struct err err = { 0 };
    Pathfarm__Goodbye goodbye = PATHFARM__GOODBYE__INIT;
    Pathfarm__Progress progress = PATHFARM__PROGRESS__INIT;
    size_t size = put_frame(stream, &goodbye.base, NULL, 0);
    size += put_frame(stream + size, &progress.base, NULL, 0);
    struct frame_parser parser;
    frame_parser_init(&parser, ROLE_WORKER);
    parser.phase = PHASE_WORKING;
    assert_false(frame_parser_feed(&parser, stream, size, note_frame, &seen, &err));
    assert_int_equal(seen.count, 1);
    assert_non_null(strstr(err.text, "after a goodbye"));
    frame_parser_free(&parser);
}

static void a_receiver_that_says_no_ends_the_feed_with_its_reason(void **state)
{
    (void)state;
    uint8_t stream[4096];
    struct seen seen = { .stop_at = 2 };
    struct err err = { 0 };
    size_t size = put_stream(stream);
    struct frame_parser parser;
    frame_parser_init(&parser, ROLE_WORKER);
    parser.phase = PHASE_WORKING;
    assert_false(frame_parser_feed(&parser, stream, size, note_frame, &seen, &err));
    assert_int_equal(seen.count, 2);
    assert_int_equal(err.code, ERR_RENDER);
    frame_parser_free(&parser);
}

static void a_message_comes_back_from_its_frame(void **state)
{
    (void)state;
    uint8_t bytes[512];
    Pathfarm__Hello hello = PATHFARM__HELLO__INIT;
    hello.build = "0.1.0 \033[2Jgcc\nfake log line\xc2\x9b";
    hello.host = "render-7 \xc3\xa9";
    hello.cores = 64;
    size_t size = put_frame(bytes, &hello.base, NULL, 0);
    struct frame frame = { .kind = PATHFARM__KIND__KIND_HELLO,
                           .payload = bytes + FRAME_HEADER_SIZE,
                           .payload_size = size - FRAME_HEADER_SIZE };
    Pathfarm__Hello *back = frame_message(&frame, NULL);
    assert_non_null(back);
    assert_int_equal(back->cores, 64);
    assert_string_equal(back->build, "0.1.0  [2Jgcc fake log line  "); /* safe on a terminal */
    assert_string_equal(back->host, "render-7 \xc3\xa9");
    frame_message_free(back);
}

static void texts_are_cleaned_at_any_depth(void **state)
{
    (void)state;
    uint8_t bytes[512];
    Pathfarm__Object object = PATHFARM__OBJECT__INIT, *list[] = { &object, &object };
    Pathfarm__Job job = PATHFARM__JOB__INIT;
    object.name = "a\rb";
    job.objects = list;
    job.n_objects = 2;
    size_t size = put_frame(bytes, &job.base, NULL, 0);
    struct frame frame = { .kind = PATHFARM__KIND__KIND_JOB,
                           .payload = bytes + FRAME_HEADER_SIZE,
                           .payload_size = size - FRAME_HEADER_SIZE };
    Pathfarm__Job *back = frame_message(&frame, NULL);
    assert_non_null(back);
    assert_string_equal(back->objects[1]->name, "a b");
    frame_message_free(back);
}

static void a_payload_that_does_not_parse_is_an_error(void **state)
{
    (void)state;
    const uint8_t garbage[] = { 0xff, 0xff, 0xff, 0xff, 0xff };
    struct frame frame = { .kind = PATHFARM__KIND__KIND_LEASE,
                           .payload = garbage,
                           .payload_size = sizeof(garbage) };
    struct err err = { 0 };
    assert_null(frame_message(&frame, &err));
    assert_int_equal(err.code, ERR_MESSAGE);
    frame_message_free(NULL);
}

static void a_frame_above_its_cap_is_not_made(void **state)
{
    (void)state;
    struct err err = { 0 };
    static char reason[5000];
    static uint8_t head[6000];
    memset(reason, 'x', sizeof(reason) - 1);
    Pathfarm__Refused refused = PATHFARM__REFUSED__INIT;
    refused.reason = reason;
    assert_false(frame_head(&refused.base, 0, head, &err));
    assert_int_equal(err.code, ERR_LIMIT);
    Pathfarm__ObjectSlice slice = PATHFARM__OBJECT_SLICE__INIT;
    assert_true(frame_head(&slice.base, LIMIT_SLICE, head, NULL));
    assert_false(frame_head(&slice.base, LIMIT_SLICE + 1, head, NULL));
}

static void the_largest_messages_that_limits_allow_fit_their_frames(void **state)
{
    (void)state;
    Pathfarm__Node node = PATHFARM__NODE__INIT;
    node.tile = node.replicate = node.level = UINT32_MAX;
    node.index = UINT64_MAX;
    Pathfarm__Lease lease = PATHFARM__LEASE__INIT;
    Pathfarm__Node **nodes = malloc(LIMIT_LEASE_NODES * sizeof(*nodes));
    for (int i = 0; i < LIMIT_LEASE_NODES; i++)
        nodes[i] = &node;
    lease.lease_id = lease.job_id = lease.epoch = UINT64_MAX;
    lease.nodes = nodes;
    lease.n_nodes = LIMIT_LEASE_NODES;
    assert_true(frame_sizes_allowed(PATHFARM__KIND__KIND_LEASE,
                                    protobuf_c_message_get_packed_size(&lease.base), 0, NULL));
    free(nodes);

    Pathfarm__Progress progress = PATHFARM__PROGRESS__INIT;
    uint64_t *leases = malloc(LIMIT_PROGRESS_LEASES * sizeof(*leases));
    memset(leases, 0xff, LIMIT_PROGRESS_LEASES * sizeof(*leases));
    progress.leases = leases;
    progress.n_leases = LIMIT_PROGRESS_LEASES;
    assert_true(frame_sizes_allowed(PATHFARM__KIND__KIND_PROGRESS,
                                    protobuf_c_message_get_packed_size(&progress.base), 0, NULL));
    free(leases);

    Pathfarm__ObjectSlice slice = PATHFARM__OBJECT_SLICE__INIT;
    size_t list_size = 32 * LIMIT_OBJECT_SLICES;
    slice.slice_digests = (ProtobufCBinaryData){ .len = list_size, .data = calloc(1, list_size) };
    assert_true(frame_sizes_allowed(PATHFARM__KIND__KIND_OBJECT_SLICE,
                                    protobuf_c_message_get_packed_size(&slice.base) + 200,
                                    LIMIT_SLICE, NULL));
    free(slice.slice_digests.data);
}

static void every_kind_of_the_schema_has_a_rule(void **state)
{
    (void)state;
    for (unsigned i = 1; i < pathfarm__kind__descriptor.n_values; i++) {
        unsigned kind = (unsigned)pathfarm__kind__descriptor.values[i].value;
        const char *name = pathfarm__kind__descriptor.values[i].name; /* "KIND_HELLO" */
        assert_string_equal(frame_kind_name(kind), name + 5);
    }
    assert_string_equal(frame_kind_name(0), "unknown");
    assert_string_equal(frame_kind_name(1000), "unknown");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_way_to_cut_a_stream_gives_the_same_frames),
        cmocka_unit_test(the_parser_says_which_frame_is_incomplete),
        cmocka_unit_test(broken_headers_are_refused_before_anything_is_allocated),
        cmocka_unit_test(nothing_follows_a_goodbye),
        cmocka_unit_test(a_receiver_that_says_no_ends_the_feed_with_its_reason),
        cmocka_unit_test(a_message_comes_back_from_its_frame),
        cmocka_unit_test(texts_are_cleaned_at_any_depth),
        cmocka_unit_test(a_payload_that_does_not_parse_is_an_error),
        cmocka_unit_test(a_frame_above_its_cap_is_not_made),
        cmocka_unit_test(the_largest_messages_that_limits_allow_fit_their_frames),
        cmocka_unit_test(every_kind_of_the_schema_has_a_rule),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
