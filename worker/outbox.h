/*
 * Results on their way to the master. A result stays here, encoded, until the master said that it
 * is durable: until then it is offered again to whichever master the worker meets next. The box is
 * bounded by its user: no more nodes are begun than there is room for.
 *
 * A result gets its sequence number when it is sent, and a new one when it is sent again, so that
 * on every connection the numbers count up and "through" says all.
 *
 * Used from the event loop only.
 */
#ifndef WORKER_OUTBOX_H
#define WORKER_OUTBOX_H

#include "common/sumtree.h"
#include "proto/digest.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/queue.h>

struct err;

struct outbox_entry {
    TAILQ_ENTRY(outbox_entry) link;
    unsigned references;
    uint64_t sequence; /* 0: never sent */
    struct digest job;
    uint64_t lease_id;
    struct node_id node;
    double core_seconds;
    uint8_t checksum[CHECKSUM_SIZE];
    size_t size;
    uint8_t bulk[]; /* as proto/node_wire.h says */
};

struct outbox;

/* NULL when memory runs out. Freeing NULL does nothing; lent entries live until given back. */
struct outbox *outbox_new(size_t max_results);
void outbox_free(struct outbox *box);

/* Encode and keep a result. ERR_MEMORY. */
bool outbox_add(struct outbox *box, const struct digest *job, uint64_t lease_id,
                const struct node_id *node, const struct node_sums *sums, double core_seconds,
                struct err *err);

size_t outbox_count(const struct outbox *box);
size_t outbox_unsent(const struct outbox *box);
size_t outbox_room(const struct outbox *box);       /* results until it is full */
uint64_t outbox_sequence(const struct outbox *box); /* the last one given out */

/* The oldest result, not sent on this connection, of a job that is `wanted`; NULL for none. */
struct outbox_entry *
outbox_next(struct outbox *box, bool (*wanted)(void *owner, const struct digest *job), void *owner);

/* Give an entry its sequence number and count it as sent. */
void outbox_number(struct outbox *box, struct outbox_entry *entry);

/* A user more for an entry's bytes, and one less: fits channel_bulk.release. */
void outbox_lend(struct outbox_entry *entry);
void outbox_give_back(void *entry);

/* The connection is gone: everything is to be sent again. */
void outbox_rewind(struct outbox *box);

/* Forget what was sent up to a sequence number: it is durable. */
void outbox_forget_through(struct outbox *box, uint64_t sequence);

/* Forget the results of a job that is done. */
void outbox_forget_job(struct outbox *box, const struct digest *job);

/* While there is no room: forget the oldest results of jobs not wanted. Returns how many. */
size_t outbox_make_room(struct outbox *box, bool (*wanted)(void *owner, const struct digest *job),
                        void *owner);

#endif
