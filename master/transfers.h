/*
 * Bundle objects on their way to workers. A worker asks for slices with a credit (OBJECT_WANTED);
 * only a few workers are served at a time, in turn, each as fast as its channel drains, so that a
 * hundred workers that join at once neither fill the master's memory nor hold up its leases.
 *
 * Used from the event loop only.
 */
#ifndef MASTER_TRANSFERS_H
#define MASTER_TRANSFERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/queue.h>

struct bundle;
struct channel;
struct digest;
struct err;

#define TRANSFERS_ACTIVE    4   /* peers served at a time */
#define TRANSFER_WISHES_MAX 256 /* requests one peer may have open */
#define TRANSFER_STUCK_MS   30000

struct wish;

/* One peer's end of it; part of the peer. Zeroed is idle. */
struct transfer {
    struct channel *channel;
    STAILQ_HEAD(, wish) wishes;
    unsigned wish_count;
    bool listed, active;
    uint64_t moved_ms; /* when a slice was last queued for it */
    TAILQ_ENTRY(transfer) link;
};

struct transfers;

/* The bundle, and the scene behind it, must outlive all channels. NULL when memory runs out. */
struct transfers *transfers_new(const struct bundle *bundle, size_t queue_bytes);
void transfers_free(struct transfers *t);

void transfers_join(struct transfer *transfer, struct channel *channel);
/* Take a peer's request. ERR_LIMIT: more open requests than any worker has. */
bool transfers_want(struct transfers *t, struct transfer *transfer, const struct digest *object,
                    uint64_t first_slice, uint32_t slice_count, uint64_t now_ms, struct err *err);
/* The channel has room again. */
void transfers_pump(struct transfers *t, uint64_t now_ms);
/* The peer is gone. */
void transfers_leave(struct transfers *t, struct transfer *transfer);

/* A peer that is being served but took nothing for TRANSFER_STUCK_MS, or NULL: whoever does not
 * read must not keep others waiting. */
struct channel *transfers_stuck(const struct transfers *t, uint64_t now_ms);

#endif
