/*
 * The bulk of a RESULT: a node's statistics and sums. Little-endian:
 *
 *   u32 pixels | u32 channels | u32 flags | u32 zero | statistics | failed bits if flag 1 | values
 *
 * Values are float32, planar as in memory, and keep every bit. Pure; any thread.
 */
#ifndef PROTO_NODE_WIRE_H
#define PROTO_NODE_WIRE_H

#include "common/sumtree.h"

#include <stdbool.h>
#include <stddef.h>

struct err;

/* Bytes that node_wire_encode writes for these sums, and for the largest of that shape. */
size_t node_wire_size(const struct node_sums *sums);
size_t node_wire_size_max(uint32_t pixel_count, uint32_t channel_count);

/* Write node_wire_size(sums) bytes; false, with nothing promised about them, when `size` is not
 * that. */
bool node_wire_encode(const struct node_sums *sums, void *bulk, size_t size);

/*
 * New sums (node_sums_new) of exactly the expected shape. ERR_MESSAGE for any other shape, a
 * wrong length, an unknown flag, a failed bit of a pixel that is not there, or statistics that no
 * leaf can have; ERR_MEMORY.
 */
struct node_sums *node_wire_decode(const void *bulk, size_t size, uint32_t pixel_count,
                                   uint32_t channel_count, struct err *err);

#endif
