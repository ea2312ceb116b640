#include "proto/version.h"

#include "common/err.h"

bool version_choose(uint32_t peer_min, uint32_t peer_max, uint32_t *chosen, struct err *err)
{
    if (peer_min > peer_max)
        return err_set(err, ERR_MESSAGE, "protocol versions %u to %u are no range", peer_min,
                       peer_max);
    if (peer_max < PROTOCOL_MIN)
        return err_set(err, ERR_MESSAGE,
                       "the peer is too old: it speaks protocol %u to %u, this side %u to %u",
                       peer_min, peer_max, PROTOCOL_MIN, PROTOCOL_MAX);
    if (peer_min > PROTOCOL_MAX)
        return err_set(err, ERR_MESSAGE,
                       "this side is too old: it speaks protocol %u to %u, the peer %u to %u",
                       PROTOCOL_MIN, PROTOCOL_MAX, peer_min, peer_max);
    *chosen = peer_max < PROTOCOL_MAX ? peer_max : PROTOCOL_MAX;
    return true;
}
