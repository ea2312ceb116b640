#include "master/transfers.h"

#include "common/err.h"
#include "proto/bundle.h"
#include "proto/channel.h"

#include <stdlib.h>

struct wish {
    STAILQ_ENTRY(wish) link;
    struct digest object;
    uint64_t slice;
    uint32_t left;
};

struct transfers {
    const struct bundle *bundle;
    size_t queue_bytes;
    TAILQ_HEAD(, transfer) peers; /* with wishes; those being served first */
};

struct transfers *transfers_new(const struct bundle *bundle, size_t queue_bytes)
{
    struct transfers *t = calloc(1, sizeof(*t));
    if (t == NULL)
        return NULL;
    t->bundle = bundle;
    t->queue_bytes = queue_bytes;
    TAILQ_INIT(&t->peers);
    return t;
}

void transfers_free(struct transfers *t)
{
    free(t);
}

void transfers_join(struct transfer *transfer, struct channel *channel)
{
    *transfer = (struct transfer){ .channel = channel };
    STAILQ_INIT(&transfer->wishes);
}

static void drop_first_wish(struct transfer *transfer)
{
    struct wish *wish = STAILQ_FIRST(&transfer->wishes);
    STAILQ_REMOVE_HEAD(&transfer->wishes, link);
    transfer->wish_count--;
    free(wish);
}

void transfers_leave(struct transfers *t, struct transfer *transfer)
{
    while (transfer->wish_count > 0)
        drop_first_wish(transfer);
    if (transfer->listed)
        TAILQ_REMOVE(&t->peers, transfer, link);
    transfer->listed = transfer->active = false;
}

bool transfers_want(struct transfers *t, struct transfer *transfer, const struct digest *object,
                    uint64_t first_slice, uint32_t slice_count, uint64_t now_ms, struct err *err)
{
    if (transfer->wish_count >= TRANSFER_WISHES_MAX)
        return err_set(err, ERR_LIMIT, "more than %d open requests for slices",
                       TRANSFER_WISHES_MAX);
    struct wish *wish = malloc(sizeof(*wish));
    if (wish == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a request for slices");
    *wish = (struct wish){ .object = *object, .slice = first_slice, .left = slice_count };
    STAILQ_INSERT_TAIL(&transfer->wishes, wish, link);
    transfer->wish_count++;
    if (!transfer->listed) {
        transfer->listed = true;
        TAILQ_INSERT_TAIL(&t->peers, transfer, link);
    }
    transfers_pump(t, now_ms);
    return true;
}

/* Queue the next slice of the first wish. False: the channel cannot take it, or was ended. */
static bool send_slice(struct transfers *t, struct transfer *transfer)
{
    struct wish *wish = STAILQ_FIRST(&transfer->wishes);
    if (wish->left == 0) {
        drop_first_wish(transfer);
        return true;
    }
    Pathfarm__ObjectSlice message;
    struct channel_bulk bulk = { .release = channel_lent };
    struct err err;
    if (!bundle_slice(t->bundle, &wish->object, wish->slice, &message, &bulk.data, &bulk.size)) {
        err_set(&err, ERR_MESSAGE, "a slice was wanted that this job does not have");
        channel_fail(transfer->channel, &err);
        return false;
    }
    if (!channel_send(transfer->channel, &message.base, &bulk, &err)) {
        if (err.code != ERR_LIMIT)
            channel_fail(transfer->channel, &err);
        return false;
    }
    wish->slice++;
    wish->left--;
    return true;
}

void transfers_pump(struct transfers *t, uint64_t now_ms)
{
    unsigned active = 0;
    struct transfer *next;
    for (struct transfer *p = TAILQ_FIRST(&t->peers); p != NULL && active < TRANSFERS_ACTIVE;
         p = next) {
        next = TAILQ_NEXT(p, link);
        if (!p->active)
            p->moved_ms = now_ms;
        p->active = true;
        /* on_drain is promised once more than half of the queue was full */
        while (p->wish_count > 0 && channel_queued(p->channel) <= t->queue_bytes / 2 &&
               send_slice(t, p))
            p->moved_ms = now_ms;
        if (p->wish_count > 0) {
            active++;
        } else {
            TAILQ_REMOVE(&t->peers, p, link);
            p->listed = p->active = false;
        }
    }
}

struct channel *transfers_stuck(const struct transfers *t, uint64_t now_ms)
{
    const struct transfer *p;
    TAILQ_FOREACH(p, &t->peers, link)
    {
        if (p->active && now_ms > p->moved_ms && now_ms - p->moved_ms > TRANSFER_STUCK_MS)
            return p->channel;
    }
    return NULL;
}
