/*
 * A job as the master offers it: the scene's arrays (SCENE_ARRAYS) as objects named by their
 * content, its settings, and the job spec. The bundle points into the scene and copies nothing but
 * digests; the scene must outlive it and stay as it is.
 *
 *     master: bundle_from_scene -> bundle_describe (the JOB message) -> bundle_slice per wish
 *     worker: proto/assembly.h
 *
 * The job digest is SHA-256 over names, digests, sizes and counts of the objects, the settings and
 * the spec: same digest, same bits.
 *
 * Thread: made by one thread (hashing takes about a second per GiB), read-only afterwards.
 */
#ifndef PROTO_BUNDLE_H
#define PROTO_BUNDLE_H

#include "proto/digest.h"
#include "proto/pathfarm.pb-c.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct job_spec;
struct scene;

struct bundle;

/* NULL: ERR_MEMORY, or ERR_LIMIT when an array is larger than LIMIT_OBJECT. `spec` is copied. */
struct bundle *bundle_from_scene(const struct scene *scene, const struct job_spec *spec,
                                 struct err *err);
void bundle_free(struct bundle *bundle); /* NULL is fine */

const struct digest *bundle_job_digest(const struct bundle *bundle);
const struct digest *bundle_scene_digest(const struct bundle *bundle); /* without the spec */
uint64_t bundle_size(const struct bundle *bundle);                     /* bytes of all objects */

/* Set digest, objects, settings and spec of `job`; they point into the bundle. The caller adds
 * job_id, profile and title. */
void bundle_describe(const struct bundle *bundle, Pathfarm__Job *job);

/*
 * The answer to one slice of an OBJECT_WANTED: `message` is initialised and points into the
 * bundle, *data and *size are the bulk, to be sent as lent (the scene outlives the channel) or
 * copied. False for an object or slice that this bundle does not have.
 */
bool bundle_slice(const struct bundle *bundle, const struct digest *object, uint64_t slice,
                  Pathfarm__ObjectSlice *message, const void **data, size_t *size);

/*
 * What both sides compute from a JOB message. bundle_digest_job includes the spec. bundle_check_job
 * refuses (ERR_MESSAGE, ERR_LIMIT, ERR_DIGEST) a message that does not list exactly the arrays of
 * SCENE_ARRAYS with sizes that follow from their counts and a total of at most `quota_bytes`, or
 * whose digest is not that of its content.
 */
struct digest bundle_digest_job(const Pathfarm__Job *job);
bool bundle_check_job(const Pathfarm__Job *job, uint64_t quota_bytes, struct err *err);

#endif
