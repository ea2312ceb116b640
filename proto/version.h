/*
 * Versions of the wire protocol. HELLO carries the range a worker speaks; the master answers with
 * the newest version both know (WELCOME.protocol), or refuses with a sentence that says which
 * side is older.
 */
#ifndef PROTO_VERSION_H
#define PROTO_VERSION_H

#include <stdbool.h>
#include <stdint.h>

struct err;

#define PROTOCOL_MIN 1
#define PROTOCOL_MAX 1

/* The newest version in both ranges; ERR_MESSAGE when there is none or the range is upside down. */
bool version_choose(uint32_t peer_min, uint32_t peer_max, uint32_t *chosen, struct err *err);

#endif
