#include "worker/outbox.h"

#include "common/err.h"
#include "proto/node_wire.h"

#include <stdlib.h>

TAILQ_HEAD(entry_list, outbox_entry);

struct outbox {
    struct entry_list unsent, sent; /* both oldest first */
    size_t unsent_count, sent_count;
    size_t max_results;
    uint64_t sequence;
};

struct outbox *outbox_new(size_t max_results)
{
    struct outbox *box = calloc(1, sizeof(*box));
    if (box == NULL)
        return NULL;
    TAILQ_INIT(&box->unsent);
    TAILQ_INIT(&box->sent);
    box->max_results = max_results;
    return box;
}

void outbox_lend(struct outbox_entry *entry)
{
    entry->references++;
}

void outbox_give_back(void *context)
{
    struct outbox_entry *entry = context;
    if (--entry->references == 0)
        free(entry);
}

static void forget(struct entry_list *list, size_t *count, struct outbox_entry *entry)
{
    TAILQ_REMOVE(list, entry, link);
    --*count;
    outbox_give_back(entry);
}

void outbox_free(struct outbox *box)
{
    if (box == NULL)
        return;
    outbox_rewind(box);
    while (!TAILQ_EMPTY(&box->unsent))
        forget(&box->unsent, &box->unsent_count, TAILQ_FIRST(&box->unsent));
    free(box);
}

bool outbox_add(struct outbox *box, const struct digest *job, uint64_t lease_id,
                const struct node_id *node, const struct node_sums *sums, double core_seconds,
                struct err *err)
{
    size_t size = node_wire_size(sums);
    struct outbox_entry *entry = malloc(sizeof(*entry) + size);
    if (entry == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a result of %zu bytes", size);
    *entry = (struct outbox_entry){
        .references = 1,
        .job = *job,
        .lease_id = lease_id,
        .node = *node,
        .core_seconds = core_seconds,
        .size = size,
    };
    if (!node_wire_encode(sums, entry->bulk, size)) {
        free(entry);
        return err_set(err, ERR_INTERNAL, "a result of %zu bytes was not encoded", size);
    }
    digest_checksum(entry->bulk, size, entry->checksum);
    TAILQ_INSERT_TAIL(&box->unsent, entry, link);
    box->unsent_count++;
    return true;
}

size_t outbox_count(const struct outbox *box)
{
    return box->unsent_count + box->sent_count;
}

size_t outbox_unsent(const struct outbox *box)
{
    return box->unsent_count;
}

size_t outbox_room(const struct outbox *box)
{
    size_t count = outbox_count(box);
    return count < box->max_results ? box->max_results - count : 0;
}

uint64_t outbox_sequence(const struct outbox *box)
{
    return box->sequence;
}

struct outbox_entry *outbox_next(struct outbox *box,
                                 bool (*wanted)(void *owner, const struct digest *job), void *owner)
{
    struct outbox_entry *entry;
    TAILQ_FOREACH(entry, &box->unsent, link)
    if (wanted(owner, &entry->job))
        return entry;
    return NULL;
}

void outbox_number(struct outbox *box, struct outbox_entry *entry)
{
    entry->sequence = ++box->sequence;
    TAILQ_REMOVE(&box->unsent, entry, link);
    TAILQ_INSERT_TAIL(&box->sent, entry, link);
    box->unsent_count--;
    box->sent_count++;
}

void outbox_rewind(struct outbox *box)
{
    struct outbox_entry *entry;
    while ((entry = TAILQ_LAST(&box->sent, entry_list)) != NULL) {
        TAILQ_REMOVE(&box->sent, entry, link);
        TAILQ_INSERT_HEAD(&box->unsent, entry, link);
    }
    box->unsent_count += box->sent_count;
    box->sent_count = 0;
}

void outbox_forget_through(struct outbox *box, uint64_t sequence)
{
    struct outbox_entry *entry;
    while ((entry = TAILQ_FIRST(&box->sent)) != NULL && entry->sequence <= sequence)
        forget(&box->sent, &box->sent_count, entry);
}

static void forget_job_in(struct entry_list *list, size_t *count, const struct digest *job)
{
    struct outbox_entry *entry, *next;
    for (entry = TAILQ_FIRST(list); entry != NULL; entry = next) {
        next = TAILQ_NEXT(entry, link);
        if (digest_equal(&entry->job, job))
            forget(list, count, entry);
    }
}

void outbox_forget_job(struct outbox *box, const struct digest *job)
{
    forget_job_in(&box->sent, &box->sent_count, job);
    forget_job_in(&box->unsent, &box->unsent_count, job);
}

size_t outbox_make_room(struct outbox *box, bool (*wanted)(void *owner, const struct digest *job),
                        void *owner)
{
    size_t dropped = 0;
    struct outbox_entry *entry, *next;
    for (entry = TAILQ_FIRST(&box->unsent); entry != NULL && outbox_room(box) == 0; entry = next) {
        next = TAILQ_NEXT(entry, link);
        if (wanted(owner, &entry->job))
            continue;
        forget(&box->unsent, &box->unsent_count, entry);
        dropped++;
    }
    return dropped;
}
