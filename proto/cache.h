/*
 * A worker's objects on disk, so that a scene crosses the wire once per host. One file per object,
 * named by its digest in hex: the content and 64 zero bytes (Embree reads past the end of arrays,
 * and the mapped file is what it reads).
 *
 * The directory has mode 0700 and belongs to us, or is refused. Files appear by rename, complete or
 * not at all, and are hashed again at every load: a damaged one is deleted and counts as absent.
 * Least recently used objects go when the quota is reached; those in use stay readable, as they are
 * mapped. Several processes may share the directory.
 *
 * Thread: a struct cache may be used by one thread at a time; open another for another thread.
 */
#ifndef PROTO_CACHE_H
#define PROTO_CACHE_H

#include "proto/digest.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

struct cache;

/* The directory and its parents are made when missing. */
struct cache *cache_open(const char *dir, uint64_t quota_bytes, struct err *err);
void cache_close(struct cache *cache); /* mapped objects stay; NULL is fine */

struct cache_object {
    const void *data; /* read-only, 64-byte aligned, at least 16 zero bytes after the end */
    uint64_t size;
};

/* Map a verified object of exactly that size. False: absent (or damaged, and deleted). */
bool cache_get(struct cache *cache, const struct digest *digest, uint64_t size,
               struct cache_object *object);
void cache_unmap(struct cache_object *object);

/* Keep a copy of an object whose digest is known to be right. True when it was there already.
 * ERR_LIMIT when it is larger than the quota, ERR_IO. */
bool cache_put(struct cache *cache, const struct digest *digest, const void *data, uint64_t size,
               struct err *err);

/* Bytes the files take now. */
uint64_t cache_used(struct cache *cache);

/* $XDG_CACHE_HOME/pathfarm or ~/.cache/pathfarm into path; false when there is no home. */
bool cache_default_dir(char *path, size_t size);

#endif
