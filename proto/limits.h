/*
 * The sizes that everything on the wire is held to. A length that comes from outside is compared
 * with these before anything is allocated for it.
 */
#ifndef PROTO_LIMITS_H
#define PROTO_LIMITS_H

#include "common/sumtree.h"

#include <stdint.h>

#define LIMIT_KIB UINT64_C(1024)
#define LIMIT_MIB (1024 * LIMIT_KIB)
#define LIMIT_GIB (1024 * LIMIT_MIB)

/* Channels of one node's layers: beauty, AOVs, path classes */
#define LIMIT_CHANNELS 512

/* Nodes named by one LEASE or REVOKE frame: 31 bytes each at most, so they fit the frame's cap */
#define LIMIT_LEASE_NODES 8000

/* Leases named by one PROGRESS frame */
#define LIMIT_PROGRESS_LEASES 4000

/* Bytes of a reason, title or host name that the sender should cut at; caps leave more room */
#define LIMIT_TEXT 1000

/* A bundle object crosses the wire, and is hashed, in slices of this many bytes */
#define LIMIT_SLICE (4 * LIMIT_MIB)

/* One bundle object; its list of slice digests must fit the OBJECT_SLICE payload */
#define LIMIT_OBJECT        (64 * LIMIT_GIB)
#define LIMIT_OBJECT_SLICES (LIMIT_OBJECT / LIMIT_SLICE)

/* Bulk of a RESULT: proto/node_wire.h asserts that its largest node fits */
#define LIMIT_NODE_BULK (4 * (uint64_t)TILE_PIXELS * LIMIT_CHANNELS + 512)

#endif
