/*
 * A job as a worker receives it: the scene put together from the cache and from slices.
 *
 *     assembly_new(job)      the JOB message was checked; nothing allocated for arrays yet
 *     assembly_load(cache)   take what the cache has (rehashed)
 *     assembly_want          while true: send OBJECT_WANTED
 *     assembly_slice         per OBJECT_SLICE: verified, then copied to its place
 *     assembly_scene         once assembly_complete: the scene, not yet checked by scene_check
 *     assembly_store(cache)  keep what came over the wire for the next time
 *
 * Memory for an object is taken only when its slice 0 came and its list of slice digests matched
 * the object's digest. Arrays are 64-byte aligned and followed by at least 16 zero bytes, because
 * Embree reads past the end.
 *
 * Thread: one at a time. load and store read, hash and write whole objects: call them where that
 * may take seconds. Once complete, store may run beside readers of the scene.
 */
#ifndef PROTO_ASSEMBLY_H
#define PROTO_ASSEMBLY_H

#include "common/job.h"
#include "proto/digest.h"
#include "proto/pathfarm.pb-c.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct cache;
struct err;
struct scene;

struct assembly;

/* NULL: the message is wrong (see bundle_check_job), too large for the quota, or no memory. */
struct assembly *assembly_new(const Pathfarm__Job *job, uint64_t quota_bytes, struct err *err);
void assembly_free(struct assembly *assembly); /* the scene with it; NULL is fine */

/* Take from the cache (NULL: no cache) every object it has. */
void assembly_load(struct assembly *assembly, struct cache *cache);

/*
 * What to ask the master for next: message is initialised and filled; at most `credit` slices, and
 * slice 0 of an object alone first. False when nothing can be asked for now: everything is asked
 * for, or came. Slices that were asked for and lost (a reconnect) are asked for again after
 * assembly_forget_wishes.
 */
bool assembly_want(struct assembly *assembly, uint32_t credit, Pathfarm__ObjectWanted *message);
void assembly_forget_wishes(struct assembly *assembly);

/* Take a slice. ERR_DIGEST when it is damaged, ERR_MESSAGE when it was not wanted, ERR_MEMORY. */
bool assembly_slice(struct assembly *assembly, const Pathfarm__ObjectSlice *message,
                    const void *data, size_t size, struct err *err);

bool assembly_complete(const struct assembly *assembly);
bool assembly_cached(const struct assembly *assembly); /* nothing had to cross the wire */

/* Complete only. Owned by the assembly (never scene_free it). */
const struct scene *assembly_scene(struct assembly *assembly);
const struct job_spec *assembly_spec(const struct assembly *assembly);
const struct digest *assembly_job_digest(const struct assembly *assembly);
uint64_t assembly_job_id(const struct assembly *assembly);

/* Put what came over the wire into the cache; a full cache is not an error worth more than a log
 * line. */
bool assembly_store(const struct assembly *assembly, struct cache *cache, struct err *err);

#endif
