#include "master/dues.h"

#include "master/peers.h"

#include <stdlib.h>

#define NODES_PER_REVOKE 256

void dues_send(struct peer *peer, const ProtobufCMessage *message)
{
    struct err err;
    if (channel_send(peer->channel, message, NULL, &err))
        peer->told_ms = uv_now(peer->farm->loop);
    else
        channel_fail(peer->channel, &err);
}

void dues_acknowledge(struct peer *peer)
{
    /* Without a store a result is as durable as this process: accepted is all there is */
    Pathfarm__Accepted accepted = PATHFARM__ACCEPTED__INIT;
    accepted.accepted_through = peer->sequence;
    accepted.durable_through = peer->sequence;
    accepted.epoch = peer->farm->epoch;
    struct err err;
    if (channel_send(peer->channel, &accepted.base, NULL, &err)) {
        peer->acknowledged = peer->sequence;
        peer->told_ms = uv_now(peer->farm->loop);
    } else if (err.code != ERR_LIMIT) {
        channel_fail(peer->channel, &err);
    }
}

/* Node messages for `count` nodes, with the pointers protobuf-c wants; free() what is returned. */
static Pathfarm__Node **node_messages(const struct node_id *nodes, size_t count)
{
    Pathfarm__Node **list = malloc(count * (sizeof(Pathfarm__Node *) + sizeof(Pathfarm__Node)));
    if (list == NULL)
        return NULL;
    Pathfarm__Node *messages = (Pathfarm__Node *)(list + count);
    for (size_t i = 0; i < count; i++) {
        pathfarm__node__init(&messages[i]);
        messages[i].tile = nodes[i].tile;
        messages[i].replicate = nodes[i].replicate;
        messages[i].level = nodes[i].level;
        messages[i].index = nodes[i].index;
        list[i] = &messages[i];
    }
    return list;
}

static void send_leases(struct peer *peer, uint64_t now_ms)
{
    struct farm *farm = peer->farm;
    struct lease_order order;
    while (peer->state == PEER_READY && !farm->ended && channel_queued(peer->channel) < LIMIT_MIB &&
           scheduler_lease(farm->scheduler, peer->worker, now_ms, &order)) {
        struct err err;
        Pathfarm__Lease lease = PATHFARM__LEASE__INIT;
        lease.lease_id = order.lease_id;
        lease.job_id = PEERS_JOB_ID;
        lease.epoch = farm->epoch;
        lease.n_nodes = order.node_count;
        lease.nodes = node_messages(order.nodes, order.node_count);
        if (lease.nodes == NULL) {
            err_set(&err, ERR_MEMORY, "no memory for a lease");
            channel_fail(peer->channel, &err); /* so that its nodes go back in line */
            return;
        }
        dues_send(peer, &lease.base);
        free(lease.nodes);
    }
}

static void send_revocations(struct farm *farm)
{
    struct node_id nodes[NODES_PER_REVOKE];
    struct revocation next;
    bool more = scheduler_next_revocation(farm->scheduler, &next);
    while (more) {
        struct revocation first = next;
        size_t count = 0;
        do {
            nodes[count++] = next.node;
            more = scheduler_next_revocation(farm->scheduler, &next);
        } while (more && count < NODES_PER_REVOKE && next.owner == first.owner &&
                 next.lease_id == first.lease_id);

        struct peer *peer = first.owner;
        if (peer->channel == NULL)
            continue;
        Pathfarm__Revoke revoke = PATHFARM__REVOKE__INIT;
        revoke.lease_id = first.lease_id;
        revoke.job_id = PEERS_JOB_ID;
        revoke.nodes = node_messages(nodes, count);
        revoke.n_nodes = count;
        if (revoke.nodes != NULL) /* an empty list would mean the whole lease */
            dues_send(peer, &revoke.base);
        free(revoke.nodes);
    }
}

void dues_pump(struct farm *farm, uint64_t now_ms)
{
    struct peer *peer;
    send_revocations(farm);
    TAILQ_FOREACH(peer, &farm->peers, link)
    {
        if (peer->channel == NULL || channel_phase(peer->channel) != PHASE_WORKING)
            continue;
        if (peer->sequence > peer->acknowledged ||
            now_ms - peer->told_ms >= farm->settings.heartbeat_ms)
            dues_acknowledge(peer);
        send_leases(peer, now_ms);
    }
    transfers_pump(farm->transfers, now_ms);
}
