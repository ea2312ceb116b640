/*
 * What other renderers reached: points to show beside our curves. They are taken as given; only a
 * relMSE of the same picture with the same epsilon, on the same machine, compares.
 */
#ifndef MASTER_ACCURACY_PEERS_H
#define MASTER_ACCURACY_PEERS_H

#include <stdbool.h>
#include <stddef.h>

struct err;

#define ACCURACY_PEERS_MAX 64

struct accuracy_peer {
    char name[48];
    double core_s, relmse;
};

struct accuracy_peers {
    struct accuracy_peer points[ACCURACY_PEERS_MAX];
    size_t count;
};

/* Add "NAME=core_seconds,relmse". ERR_ARGUMENT says what is wrong with it. */
bool accuracy_peers_add(struct accuracy_peers *peers, const char *text, struct err *err);

/* Add the lines "NAME,core_seconds,relmse" of a file; the first may be a heading. */
bool accuracy_peers_read(struct accuracy_peers *peers, const char *path, struct err *err);

#endif
