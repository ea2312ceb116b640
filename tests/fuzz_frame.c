/*
 * Any bytes, cut anywhere, from any sender in any phase: the frame parser and the message decoder
 * refuse them or hand out messages that encode and decode to the same again.
 *
 *     clang -fsanitize=fuzzer,address,undefined ... tests/fuzz_frame.c && ./fuzz_frame
 */
#include "common/err.h"
#include "proto/frame.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

static bool round_trip(void *owner, const struct frame *frame, struct err *err)
{
    (void)owner;
    ProtobufCMessage *message = frame_message(frame, err);
    if (message == NULL)
        return false;
    if (frame_kind_of(message) != frame->kind)
        abort();

    /* Unknown fields are kept and texts were cleaned, so compare after one turn, not at once */
    size_t head_size = frame_head_size(message);
    uint8_t *head = malloc(head_size), *again_head = malloc(head_size);
    if (frame_head(message, frame->bulk_size, head, NULL)) {
        struct frame copy = *frame;
        copy.payload = head + FRAME_HEADER_SIZE;
        copy.payload_size = head_size - FRAME_HEADER_SIZE;
        ProtobufCMessage *again = frame_message(&copy, NULL);
        if (again == NULL || frame_head_size(again) != head_size ||
            !frame_head(again, frame->bulk_size, again_head, NULL) ||
            memcmp(head, again_head, head_size) != 0)
            abort();
        frame_message_free(again);
    }
    free(again_head);
    free(head);
    frame_message_free(message);
    return true;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    if (size < 2)
        return 0;
    struct frame_parser parser;
    struct err err = { 0 };
    frame_parser_init(&parser, bytes[0] & 7);
    parser.phase = (bytes[0] & 8) != 0 ? PHASE_WORKING : PHASE_GREETING;
    size_t piece = bytes[1] + 1u;
    for (size_t at = 2; at < size; at += piece) {
        size_t part = size - at < piece ? size - at : piece;
        if (!frame_parser_feed(&parser, bytes + at, part, round_trip, NULL, &err)) {
            if (err.code == ERR_OK)
                abort();
            break;
        }
    }
    frame_parser_free(&parser);
    return 0;
}
