/*
 * What the farm owes its peers, and when: acknowledgements of results, leases to whoever has room
 * for one, revocations, slices of the scene, and signs of life. Used from the event loop only.
 */
#ifndef MASTER_DUES_H
#define MASTER_DUES_H

#include <protobuf-c/protobuf-c.h>
#include <stdint.h>

struct farm;
struct peer;

/* Send all that is due now. */
void dues_pump(struct farm *farm, uint64_t now_ms);

/* Say which results have arrived. Sent again later when the peer's queue is full. */
void dues_acknowledge(struct peer *peer);

/* Send what the peer cannot do without: failing to ends its session. */
void dues_send(struct peer *peer, const ProtobufCMessage *message);

#endif
