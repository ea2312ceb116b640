/*
 * Socket addresses, as channels need them: IPv4 and IPv6, from text and to it, and whether one is
 * of this very host, where a plain channel may go. Pure. For proto/channel*.c only.
 */
#ifndef PROTO_CHANNEL_ADDRESS_H
#define PROTO_CHANNEL_ADDRESS_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/socket.h>

bool channel_address_is_loopback(const struct sockaddr *address);
unsigned channel_address_port(const struct sockaddr *address);

/* "192.0.2.7:50412" or "[2001:db8::7]:50412". */
void channel_address_text(const struct sockaddr *address, char *text, size_t size);

/* False when host is not an address but a name. */
bool channel_address_of(const char *host, unsigned port, struct sockaddr_storage *address);

#endif
