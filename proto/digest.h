/*
 * SHA-256, which names everything that crosses the wire: objects, jobs, results, certificates.
 *
 * Objects are hashed as a list: the digest of an object is the SHA-256 of the concatenated digests
 * of its slices of LIMIT_SLICE bytes, so that one slice can be verified without the others. An
 * empty object has no slices; its digest is that of no bytes.
 *
 * Pure; any thread. Failure of the library itself (no memory) ends the process: nothing else could
 * be trusted after it.
 */
#ifndef PROTO_DIGEST_H
#define PROTO_DIGEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define DIGEST_SIZE     32
#define DIGEST_HEX_SIZE 65 /* with the zero byte */
#define CHECKSUM_SIZE   16 /* what a frame's payload carries of the digest of its bulk */

struct digest {
    uint8_t bytes[DIGEST_SIZE];
};

struct digest digest_of(const void *bytes, size_t size);

/* Over bytes that come in pieces: begin, add any number of times, end (which frees). */
struct digest_stream;
struct digest_stream *digest_begin(void);
void digest_add(struct digest_stream *stream, const void *bytes, size_t size);
struct digest digest_end(struct digest_stream *stream);

/* Slices in an object of that size. */
uint64_t digest_slice_count(uint64_t size);
/* Bytes in slice number `slice`, which must exist. */
size_t digest_slice_size(uint64_t size, uint64_t slice);
/* The object's digest; those of its slices into `slices` (NULL: not wanted). */
struct digest digest_of_object(const void *bytes, uint64_t size, struct digest *slices);

/* False when `size` is not DIGEST_SIZE: for digests that come in a message. */
bool digest_from_bytes(struct digest *digest, const void *bytes, size_t size);
bool digest_equal(const struct digest *a, const struct digest *b);
/* 64 lower-case hex digits into text, which has DIGEST_HEX_SIZE bytes. Returns text. */
const char *digest_hex(const struct digest *digest, char *text);
bool digest_from_hex(struct digest *digest, const char *text);

/* The checksum of a bulk, CHECKSUM_SIZE bytes. */
void digest_checksum(const void *bytes, size_t size, uint8_t checksum[CHECKSUM_SIZE]);
/* True when `checksum` (of `checksum_size` bytes, as it came) is that of the bulk. */
bool digest_checksum_matches(const void *bytes, size_t size, const void *checksum,
                             size_t checksum_size);

#endif
