#include "proto/assembly.h"

#include "common/err.h"
#include "common/pages.h"
#include "common/scene.h"
#include "proto/bundle.h"
#include "proto/cache.h"
#include "proto/limits.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#define END_PADDING 64 /* zero bytes after an array; Embree reads 16 */

/*
 * Objects of equal content (two empty arrays, say) have equal digests: each is asked for by digest
 * once, and what comes fills all of them.
 */
struct part {
    struct digest digest;
    uint64_t size, slice_count;
    struct digest *slices;   /* what each must hash to; NULL until slice 0 came */
    uint8_t *have;           /* one per slice */
    uint64_t asked, arrived; /* slices asked for: [0, asked) */
    void *memory;            /* mapped by us, size + END_PADDING; NULL when cached or empty */
    struct cache_object cached;
    bool complete;
    bool twin; /* shares its content with an earlier part */
};

enum {
#define X(member, count_member, type, per_count) PART_##member,
    SCENE_ARRAYS(X)
#undef X
        PART_COUNT
};

struct assembly {
    struct part parts[PART_COUNT];
    struct scene scene;
    struct job_spec spec;
    struct digest job_digest;
    uint64_t job_id;
    bool anything_came;
};

/* What Embree and vector loads may read after an array that has no elements; a kernel's idle lanes
 * read the first element of any array */
static const uint8_t nothing[1024] __attribute__((aligned(64)));

static struct part *find_part(const struct assembly *assembly, const struct digest *digest)
{
    for (int i = 0; i < PART_COUNT; i++)
        if (digest_equal(&assembly->parts[i].digest, digest))
            return (struct part *)&assembly->parts[i];
    return NULL;
}

struct assembly *assembly_new(const Pathfarm__Job *job, uint64_t quota_bytes, struct err *err)
{
    if (!bundle_check_job(job, quota_bytes, err))
        return NULL;
    struct assembly *assembly = calloc(1, sizeof(*assembly));
    if (assembly == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a scene");
        return NULL;
    }
    memcpy(&assembly->scene.settings, job->settings.data, job->settings.len);
    memcpy(&assembly->spec, job->spec.data, job->spec.len);
    memcpy(assembly->job_digest.bytes, job->digest.data, DIGEST_SIZE);
    assembly->job_id = job->job_id;
#define X(member, count_member, type, per_count) \
    assembly->scene.count_member = (uint32_t)job->objects[PART_##member]->count;
    SCENE_ARRAYS(X)
#undef X

    for (int i = 0; i < PART_COUNT; i++) {
        struct part *part = &assembly->parts[i];
        memcpy(part->digest.bytes, job->objects[i]->digest.data, DIGEST_SIZE);
        part->size = job->objects[i]->size_bytes;
        part->slice_count = digest_slice_count(part->size);
        const struct part *first = find_part(assembly, &part->digest);
        part->twin = first != part;
        if (part->twin && first->size != part->size) {
            err_set(err, ERR_MESSAGE, "two arrays of different sizes have one digest");
            goto fail;
        }
        part->complete = part->size == 0;
    }
    return assembly;

fail:
    assembly_free(assembly);
    return NULL;
}

void assembly_free(struct assembly *assembly)
{
    if (assembly == NULL)
        return;
    for (int i = 0; i < PART_COUNT; i++) {
        struct part *part = &assembly->parts[i];
        free(part->slices);
        free(part->have);
        if (part->memory != NULL)
            munmap(part->memory, part->size + END_PADDING);
        cache_unmap(&part->cached);
    }
    free(assembly);
}

void assembly_load(struct assembly *assembly, struct cache *cache)
{
    if (cache == NULL)
        return;
    for (int i = 0; i < PART_COUNT; i++) {
        struct part *part = &assembly->parts[i];
        if (!part->complete && !part->twin && part->slices == NULL)
            part->complete = cache_get(cache, &part->digest, part->size, &part->cached);
    }
}

bool assembly_want(struct assembly *assembly, uint32_t credit, Pathfarm__ObjectWanted *message)
{
    for (int i = 0; i < PART_COUNT && credit > 0; i++) {
        struct part *part = &assembly->parts[i];
        /* Without the list of slices, which slice 0 brings, no other slice can be verified */
        uint64_t known = part->slices != NULL ? part->slice_count : 1;
        if (part->complete || part->twin || part->asked >= known)
            continue;
        uint64_t first = part->asked;
        while (part->slices != NULL && first < known && part->have[first])
            first++;
        uint64_t count = known - first < credit ? known - first : credit;
        part->asked = first + count;
        if (count == 0)
            continue;
        pathfarm__object_wanted__init(message);
        message->job_id = assembly->job_id;
        message->digest.data = part->digest.bytes;
        message->digest.len = DIGEST_SIZE;
        message->first_slice = first;
        message->slice_count = (uint32_t)count;
        return true;
    }
    return false;
}

void assembly_forget_wishes(struct assembly *assembly)
{
    for (int i = 0; i < PART_COUNT; i++)
        assembly->parts[i].asked = 0;
}

/* Slice 0 brings the list of all slices; memory is taken once the list is known to be right. */
static bool begin_part(struct part *part, const Pathfarm__ObjectSlice *message, struct err *err)
{
    const ProtobufCBinaryData *list = &message->slice_digests;
    if (message->slice != 0)
        return err_set(err, ERR_MESSAGE, "slice %llu came before slice 0",
                       (unsigned long long)message->slice);
    if (list->len != part->slice_count * DIGEST_SIZE)
        return err_set(err, ERR_MESSAGE, "a list of %zu bytes for %llu slices", list->len,
                       (unsigned long long)part->slice_count);
    struct digest digest = digest_of(list->data, list->len);
    if (!digest_equal(&digest, &part->digest))
        return err_set(err, ERR_DIGEST, "the list of slices does not match the object");

    /* Pages, so that a large object costs memory only as it arrives, zeros included */
    void *memory = mmap(NULL, part->size + END_PADDING, PROT_READ | PROT_WRITE,
                        MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory != MAP_FAILED)
        pages_prefer_huge(memory, part->size);
    struct digest *slices = malloc(list->len);
    uint8_t *have = calloc(part->slice_count, 1);
    if (memory == MAP_FAILED || slices == NULL || have == NULL) {
        if (memory != MAP_FAILED)
            munmap(memory, part->size + END_PADDING);
        free(slices);
        free(have);
        return err_set(err, ERR_MEMORY, "no memory for an array of %llu bytes",
                       (unsigned long long)part->size);
    }
    memcpy(slices, list->data, list->len);
    part->memory = memory;
    part->slices = slices;
    part->have = have;
    return true;
}

static bool take_slice(struct part *part, const Pathfarm__ObjectSlice *message, const void *data,
                       size_t size, struct err *err)
{
    uint64_t slice = message->slice;
    if (slice >= part->asked || slice >= part->slice_count)
        return err_set(err, ERR_MESSAGE, "it was not asked for");
    if (message->slice_total != part->slice_count || size != digest_slice_size(part->size, slice))
        return err_set(err, ERR_MESSAGE, "%zu bytes, of %llu slices, are not its size", size,
                       (unsigned long long)message->slice_total);
    struct digest digest = digest_of(data, size);
    if (message->checksum.len != DIGEST_SIZE ||
        memcmp(message->checksum.data, digest.bytes, DIGEST_SIZE) != 0)
        return err_set(err, ERR_DIGEST, "its bytes do not match their checksum");
    if (part->slices == NULL) {
        /* The first bytes must be right before memory is taken for the rest */
        if (message->slice == 0 && message->slice_digests.len >= DIGEST_SIZE &&
            memcmp(message->slice_digests.data, digest.bytes, DIGEST_SIZE) != 0)
            return err_set(err, ERR_DIGEST, "its bytes are not those of the list");
        if (!begin_part(part, message, err))
            return false;
    }
    if (!digest_equal(&part->slices[slice], &digest))
        return err_set(err, ERR_DIGEST, "its bytes are not the object's");
    if (part->have[slice])
        return true; /* asked for twice across a reconnect */
    memcpy((uint8_t *)part->memory + slice * LIMIT_SLICE, data, size);
    part->have[slice] = 1;
    part->arrived++;
    part->complete = part->arrived == part->slice_count;
    return true;
}

bool assembly_slice(struct assembly *assembly, const Pathfarm__ObjectSlice *message,
                    const void *data, size_t size, struct err *err)
{
    struct digest digest;
    struct part *part = digest_from_bytes(&digest, message->digest.data, message->digest.len)
                            ? find_part(assembly, &digest)
                            : NULL;
    if (part == NULL)
        return err_set(err, ERR_MESSAGE, "a slice of an object that was not asked for");
    assembly->anything_came = true;
    if (part->complete)
        return true; /* as above */
    if (!take_slice(part, message, data, size, err))
        return err_wrap(err, "slice %llu of an object", (unsigned long long)message->slice);
    return true;
}

bool assembly_complete(const struct assembly *assembly)
{
    for (int i = 0; i < PART_COUNT; i++)
        if (!assembly->parts[i].complete && !assembly->parts[i].twin)
            return false;
    return true;
}

bool assembly_cached(const struct assembly *assembly)
{
    return !assembly->anything_came;
}

const struct scene *assembly_scene(struct assembly *assembly)
{
    assert(assembly_complete(assembly));
    /* Twins may share memory: nothing ever writes to a finished scene */
#define X(member, count_member, type, per_count)                                               \
    {                                                                                          \
        const struct part *part = find_part(assembly, &assembly->parts[PART_##member].digest); \
        const void *data = part->memory != NULL ? part->memory : part->cached.data;            \
        assembly->scene.member = (type *)(data != NULL ? data : nothing);                      \
    }
    SCENE_ARRAYS(X)
#undef X
    return &assembly->scene;
}

const struct job_spec *assembly_spec(const struct assembly *assembly)
{
    return &assembly->spec;
}

const struct digest *assembly_job_digest(const struct assembly *assembly)
{
    return &assembly->job_digest;
}

uint64_t assembly_job_id(const struct assembly *assembly)
{
    return assembly->job_id;
}

bool assembly_store(const struct assembly *assembly, struct cache *cache, struct err *err)
{
    if (cache == NULL)
        return true;
    for (int i = 0; i < PART_COUNT; i++) {
        const struct part *part = &assembly->parts[i];
        if (part->complete && part->memory != NULL &&
            !cache_put(cache, &part->digest, part->memory, part->size, err))
            return false;
    }
    return true;
}
