#include "proto/channel_inside.h"

#include "proto/channel_tls.h"

#include <stdlib.h>
#include <string.h>

#define BATCH_SMALL    4096 /* text of a batch for one short message */
#define BATCH_LARGE    65536
#define BATCH_PIECES   64
#define BATCH_RELEASES 32
#define REFERENCE_MIN  4096 /* smaller bulks are copied: a piece of its own costs more */

/*
 * Output that goes to the kernel in one write. Pieces point into `text` (heads, copies,
 * ciphertext) or at bulks, which are released when libuv is done with all of it.
 */
struct channel_batch {
    uv_write_t request;
    struct channel *channel;
    struct channel_batch *next;
    size_t size; /* bytes of all pieces */
    unsigned piece_count, release_count;
    uv_buf_t pieces[BATCH_PIECES];
    struct {
        void (*release)(void *context);
        void *context;
    } releases[BATCH_RELEASES];
    size_t text_used, text_capacity;
    uint8_t text[];
};

static void batch_free(struct channel_batch *batch)
{
    for (unsigned i = 0; i < batch->release_count; i++)
        batch->releases[i].release(batch->releases[i].context);
    free(batch);
}

void channel_output_drop(struct channel *channel)
{
    while (channel->staged != NULL) {
        struct channel_batch *batch = channel->staged;
        channel->staged = batch->next;
        channel->queued -= batch->size;
        batch_free(batch);
    }
    channel->staged_end = &channel->staged;
    channel->batch = NULL;
}

static void on_written(uv_write_t *request, int status)
{
    struct channel_batch *batch = request->data;
    struct channel *channel = batch->channel;
    channel->queued -= batch->size;
    if (status == 0)
        channel->bytes_out += batch->size;
    batch_free(batch);
    if (channel->state == ENDED)
        return;
    if (status != 0) {
        channel_fail_uv(channel, "sending", status);
        return;
    }
    if (channel->state == OPEN && channel->drain_wanted &&
        channel->queued < channel->limits.queue_bytes / 2) {
        channel->drain_wanted = false;
        if (channel->events != NULL && channel->events->on_drain != NULL)
            channel->events->on_drain(channel->owner, channel);
    }
}

void channel_output_flush(struct channel *channel)
{
    uv_prepare_stop(&channel->flusher);
    while (channel->staged != NULL && channel->state != ENDED) {
        struct channel_batch *batch = channel->staged;
        channel->staged = batch->next;
        batch->request.data = batch;
        int status = uv_write(&batch->request, (uv_stream_t *)&channel->tcp, batch->pieces,
                              batch->piece_count, on_written);
        if (status != 0) {
            channel->queued -= batch->size;
            batch_free(batch);
            channel_fail_uv(channel, "sending", status);
        }
    }
    if (channel->staged == NULL) {
        channel->staged_end = &channel->staged;
        channel->batch = NULL;
    }
}

static void on_turn(uv_prepare_t *prepare)
{
    channel_output_flush(prepare->data);
}

/* A batch with room for a piece, a release and at least one byte of text; NULL: no memory */
static struct channel_batch *batch_with_room(struct channel *channel, size_t text_wanted)
{
    struct channel_batch *batch = channel->batch;
    if (batch != NULL && batch->piece_count < BATCH_PIECES &&
        batch->release_count < BATCH_RELEASES &&
        (text_wanted == 0 || batch->text_used < batch->text_capacity))
        return batch;

    bool small = channel->staged == NULL && text_wanted <= BATCH_SMALL;
    size_t capacity = small ? BATCH_SMALL : BATCH_LARGE;
    batch = malloc(sizeof(*batch) + capacity);
    if (batch == NULL)
        return NULL;
    batch->channel = channel;
    batch->next = NULL;
    batch->size = batch->text_used = 0;
    batch->piece_count = batch->release_count = 0;
    batch->text_capacity = capacity;
    if (channel->staged == NULL)
        uv_prepare_start(&channel->flusher, on_turn);
    *channel->staged_end = batch;
    channel->staged_end = &batch->next;
    channel->batch = batch;
    return batch;
}

static bool no_memory(struct channel *channel)
{
    channel_fail_with(channel, ERR_MEMORY, "no memory for output");
    return false;
}

bool channel_output_bytes(struct channel *channel, const void *bytes, size_t size)
{
    const uint8_t *at = bytes;
    while (size > 0) {
        struct channel_batch *batch = batch_with_room(channel, size);
        if (batch == NULL)
            return no_memory(channel);
        size_t room = batch->text_capacity - batch->text_used;
        size_t part = size < room ? size : room;
        uint8_t *to = batch->text + batch->text_used;
        memcpy(to, at, part);
        uv_buf_t *last = batch->piece_count > 0 ? &batch->pieces[batch->piece_count - 1] : NULL;
        if (last != NULL && (uint8_t *)last->base + last->len == to)
            last->len += part;
        else
            batch->pieces[batch->piece_count++] = uv_buf_init((char *)to, (unsigned)part);
        batch->text_used += part;
        batch->size += part;
        channel->queued += part;
        at += part;
        size -= part;
    }
    return true;
}

static bool put_reference(struct channel *channel, const struct channel_bulk *bulk)
{
    struct channel_batch *batch = batch_with_room(channel, 0);
    if (batch == NULL)
        return no_memory(channel);
    batch->pieces[batch->piece_count++] = uv_buf_init((char *)bulk->data, (unsigned)bulk->size);
    batch->releases[batch->release_count].release = bulk->release;
    batch->releases[batch->release_count++].context = bulk->context;
    batch->size += bulk->size;
    channel->queued += bulk->size;
    return true;
}

/* Large bulks that must be copied get memory of their own rather than many batches */
static bool put_large_copy(struct channel *channel, const struct channel_bulk *bulk)
{
    void *copy = malloc(bulk->size);
    if (copy == NULL)
        return no_memory(channel);
    memcpy(copy, bulk->data, bulk->size);
    struct channel_bulk owned = { copy, bulk->size, free, copy };
    if (put_reference(channel, &owned))
        return true;
    free(copy);
    return false;
}

bool channel_output_frame(struct channel *channel, const uint8_t *head, size_t head_size,
                          const struct channel_bulk *bulk, struct err *err)
{
    if (channel->tls != NULL) {
        struct err reason = { 0 };
        if (channel_tls_write(channel->tls, head, head_size, &reason) &&
            channel_tls_write(channel->tls, bulk->data, bulk->size, &reason)) {
            if (bulk->release != NULL)
                bulk->release(bulk->context);
            return true;
        }
        channel_fail_with(channel, reason.code, reason.text);
    } else if (channel_output_bytes(channel, head, head_size)) {
        if (bulk->release != NULL && bulk->size >= REFERENCE_MIN) {
            if (put_reference(channel, bulk))
                return true;
        } else if (bulk->size >= BATCH_LARGE) {
            if (put_large_copy(channel, bulk))
                return true;
        } else if (channel_output_bytes(channel, bulk->data, bulk->size)) {
            if (bulk->release != NULL)
                bulk->release(bulk->context);
            return true;
        }
    }
    if (err != NULL)
        *err = channel->err;
    return false;
}
