/*
 * The farm's end of one connection: a worker's session from HELLO to GOODBYE, and the handlers of
 * all its messages in one table. A peer that breaks the protocol is disconnected with a logged
 * reason; its nodes go back in line, and nobody else notices.
 *
 * Shared by farm.c, peers.c and dues.c only. Used from the event loop only.
 */
#ifndef MASTER_PEERS_H
#define MASTER_PEERS_H

#include "master/farm.h"
#include "master/spending.h"
#include "master/transfers.h"
#include "proto/channel.h"

#include <sys/queue.h>

#define PEERS_JOB_ID 1 /* on every connection: a render has one job */

enum peer_state {
    PEER_GREETING, /* no HELLO yet */
    PEER_HELD,     /* greeted; waits until a local worker has pinned the profile */
    PEER_LOADING,  /* welcome, and loading the scene */
    PEER_READY,    /* renders */
    PEER_UNFIT,    /* connected, but not for this job */
    PEER_GONE,     /* disconnected; a local one waits for news of how its process ended */
};

struct peer {
    struct farm *farm;
    struct channel *channel; /* NULL once closed */
    enum peer_state state;
    bool local;
    pid_t pid; /* of a local one; else -1 */
    int crash; /* the signal that its process died of */
    uint8_t profile[DIGEST_SIZE];
    char profile_text[256];
    uint32_t protocol_min, protocol_max;
    uint64_t memory_bytes;
    struct farm_worker *record;
    struct sched_worker *worker;     /* while it may render */
    uint64_t sequence, acknowledged; /* of its results */
    double core_seconds_before;
    uint64_t heard_ms, told_ms;
    uint64_t bytes_in_seen;
    uint64_t gone_ms;
    struct transfer transfer;
    TAILQ_ENTRY(peer) link;
};

TAILQ_HEAD(peer_list, peer);

struct farm {
    uv_loop_t *loop;
    struct farm_settings settings;
    struct farm_job job;
    struct farm_events events;
    void *owner;

    struct scheduler *scheduler;
    struct intake *intake;
    struct transfers *transfers;
    struct channel_listener *local_door, *door;
    uv_timer_t tick;
    uv_check_t after_io;
    unsigned open_handles;

    struct peer_list peers;
    unsigned peer_count;
    struct farm_worker *workers;
    unsigned worker_count;
    uint64_t epoch;
    bool pinned;
    uint8_t profile[DIGEST_SIZE];
    char profile_text[256];
    bool local_hopeless;
    struct err local_why;

    uint64_t opened_ms, tick_ms;
    uint64_t next_worker_id;
    struct spending spending;
    enum limit stopped_by;
    uint64_t nodes, samples;
    uint64_t closed_bytes_in, closed_bytes_out;
    bool ended;   /* on_end was called */
    bool closing; /* farm_close was called */
};

/* For channel_listener_events.on_accept of either door. */
void peers_accept_local(void *farm, struct channel *channel);
void peers_accept(void *farm, struct channel *channel);
void peers_log_refused(void *farm, const char *address, const struct err *err);

/* No local worker is waited for (any more): welcome those that were held back until one came. */
void peers_admit_held(struct farm *farm);

/* Disconnect whoever is silent for too long. `stalled_ms`: the master itself slept so long. */
void peers_check_deadlines(struct farm *farm, uint64_t now_ms, uint64_t stalled_ms);
/* The process of a local peer has ended. */
void peers_local_exited(struct farm *farm, pid_t pid, int crash);
/* Nobody renders, loads, or may yet. */
bool peers_none_left(const struct farm *farm);
/* Say goodbye to all. */
void peers_dismiss(struct farm *farm);

/* farm.c's part for the others. */
void farm_say(struct farm *farm, const char *format, ...) __attribute__((format(printf, 2, 3)));
void farm_end(struct farm *farm, const struct err *why); /* NULL: done */
void farm_peer_freed(struct farm *farm);

#endif
