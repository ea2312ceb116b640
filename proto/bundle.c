#include "proto/bundle.h"

#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "proto/limits.h"

#include <stdlib.h>
#include <string.h>

struct array {
    const void *data;
    struct digest digest;
    struct digest *slices;
    uint64_t size, count;
};

/* Position of each array in the manifest */
enum {
#define X(member, count_member, type, per_count) ARRAY_##member,
    SCENE_ARRAYS(X)
#undef X
        ARRAY_COUNT
};

static const struct {
    const char *name;
    uint64_t element_size;
} array_types[ARRAY_COUNT] = {
#define X(member, count_member, type, per_count) { #member, (per_count) * sizeof(type) },
    SCENE_ARRAYS(X)
#undef X
};

struct bundle {
    struct array arrays[ARRAY_COUNT];
    struct scene_settings settings;
    struct job_spec spec;
    struct digest job_digest, scene_digest;
    Pathfarm__Object objects[ARRAY_COUNT];
    Pathfarm__Object *object_list[ARRAY_COUNT];
};

static ProtobufCBinaryData view(const void *data, size_t size)
{
    /* protobuf-c has no const, but only reads what it packs */
    return (ProtobufCBinaryData){ .len = size, .data = (uint8_t *)data };
}

/* Canonical serialisation: every variable length is preceded by its length as u64 */

static void add_u64(struct digest_stream *stream, uint64_t value)
{
    digest_add(stream, &value, sizeof(value)); /* little-endian, see common/bytes.h */
}

static void add_bytes(struct digest_stream *stream, const void *bytes, size_t size)
{
    add_u64(stream, size);
    if (size > 0)
        digest_add(stream, bytes, size);
}

static struct digest digest_job(const Pathfarm__Job *job, bool with_spec)
{
    struct digest_stream *stream = digest_begin();
    add_u64(stream, job->n_objects);
    for (size_t i = 0; i < job->n_objects; i++) {
        const Pathfarm__Object *object = job->objects[i];
        add_bytes(stream, object->name, strlen(object->name));
        add_bytes(stream, object->digest.data, object->digest.len);
        add_u64(stream, object->size_bytes);
        add_u64(stream, object->count);
    }
    add_bytes(stream, job->settings.data, job->settings.len);
    if (with_spec)
        add_bytes(stream, job->spec.data, job->spec.len);
    return digest_end(stream);
}

struct digest bundle_digest_job(const Pathfarm__Job *job)
{
    return digest_job(job, true);
}

static bool hash_array(struct array *array, const char *name, struct err *err)
{
    if (array->size > LIMIT_OBJECT)
        return err_set(err, ERR_LIMIT, "the scene's %s take %llu bytes; %llu is the most", name,
                       (unsigned long long)array->size, (unsigned long long)LIMIT_OBJECT);
    array->slices = calloc(digest_slice_count(array->size) + 1, sizeof(*array->slices));
    if (array->slices == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the digests of the scene's %s", name);
    array->digest = digest_of_object(array->data, array->size, array->slices);
    return true;
}

struct bundle *bundle_from_scene(const struct scene *scene, const struct job_spec *spec,
                                 struct err *err)
{
    struct bundle *bundle = calloc(1, sizeof(*bundle));
    if (bundle == NULL) {
        err_set(err, ERR_MEMORY, "no memory for a bundle");
        return NULL;
    }
    bundle->settings = scene->settings;
    bundle->spec = *spec;
#define X(member, count_member, type, per_count)         \
    bundle->arrays[ARRAY_##member].data = scene->member; \
    bundle->arrays[ARRAY_##member].count = scene->count_member;
    SCENE_ARRAYS(X)
#undef X

    for (int i = 0; i < ARRAY_COUNT; i++) {
        struct array *array = &bundle->arrays[i];
        array->size = array->count * array_types[i].element_size;
        if (!hash_array(array, array_types[i].name, err))
            goto fail;
        Pathfarm__Object *object = &bundle->objects[i];
        pathfarm__object__init(object);
        object->name = (char *)array_types[i].name;
        object->digest = view(array->digest.bytes, DIGEST_SIZE);
        object->size_bytes = array->size;
        object->count = array->count;
        bundle->object_list[i] = object;
    }

    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bundle_describe(bundle, &job);
    bundle->scene_digest = digest_job(&job, false);
    bundle->job_digest = digest_job(&job, true);
    return bundle;

fail:
    bundle_free(bundle);
    return NULL;
}

void bundle_free(struct bundle *bundle)
{
    if (bundle == NULL)
        return;
    for (int i = 0; i < ARRAY_COUNT; i++)
        free(bundle->arrays[i].slices);
    free(bundle);
}

const struct digest *bundle_job_digest(const struct bundle *bundle)
{
    return &bundle->job_digest;
}

const struct digest *bundle_scene_digest(const struct bundle *bundle)
{
    return &bundle->scene_digest;
}

uint64_t bundle_size(const struct bundle *bundle)
{
    uint64_t size = 0;
    for (int i = 0; i < ARRAY_COUNT; i++)
        size += bundle->arrays[i].size;
    return size;
}

void bundle_describe(const struct bundle *bundle, Pathfarm__Job *job)
{
    job->digest = view(bundle->job_digest.bytes, DIGEST_SIZE);
    job->n_objects = ARRAY_COUNT;
    job->objects = (Pathfarm__Object **)bundle->object_list;
    job->settings = view(&bundle->settings, sizeof(bundle->settings));
    job->spec = view(&bundle->spec, sizeof(bundle->spec));
}

bool bundle_slice(const struct bundle *bundle, const struct digest *object, uint64_t slice,
                  Pathfarm__ObjectSlice *message, const void **data, size_t *size)
{
    for (int i = 0; i < ARRAY_COUNT; i++) {
        const struct array *array = &bundle->arrays[i];
        uint64_t slice_count = digest_slice_count(array->size);
        if (slice >= slice_count || !digest_equal(&array->digest, object))
            continue;
        pathfarm__object_slice__init(message);
        message->digest = view(array->digest.bytes, DIGEST_SIZE);
        message->slice = slice;
        message->checksum = view(array->slices[slice].bytes, DIGEST_SIZE);
        message->slice_total = slice_count;
        if (slice == 0)
            message->slice_digests = view(array->slices, slice_count * DIGEST_SIZE);
        *data = (const uint8_t *)array->data + slice * LIMIT_SLICE;
        *size = digest_slice_size(array->size, slice);
        return true;
    }
    return false;
}

static bool check_object(const Pathfarm__Object *object, int i, struct err *err)
{
    if (strcmp(object->name, array_types[i].name) != 0)
        return err_set(err, ERR_MESSAGE, "\"%.40s\" where \"%s\" is expected", object->name,
                       array_types[i].name);
    if (object->digest.len != DIGEST_SIZE)
        return err_set(err, ERR_MESSAGE, "the digest of \"%s\" has %zu bytes", object->name,
                       object->digest.len);
    if (object->count > UINT32_MAX ||
        object->size_bytes != object->count * array_types[i].element_size)
        return err_set(err, ERR_MESSAGE, "\"%s\": %llu elements do not take %llu bytes",
                       object->name, (unsigned long long)object->count,
                       (unsigned long long)object->size_bytes);
    if (object->size_bytes > LIMIT_OBJECT)
        return err_set(err, ERR_LIMIT, "\"%s\" has %llu bytes; %llu is the most", object->name,
                       (unsigned long long)object->size_bytes, (unsigned long long)LIMIT_OBJECT);
    return true;
}

bool bundle_check_job(const Pathfarm__Job *job, uint64_t quota_bytes, struct err *err)
{
    uint64_t total = 0;
    if (job->n_objects != ARRAY_COUNT) {
        err_set(err, ERR_MESSAGE, "%zu arrays; a scene has %d", job->n_objects, ARRAY_COUNT);
        goto fail;
    }
    for (int i = 0; i < ARRAY_COUNT; i++) {
        if (!check_object(job->objects[i], i, err))
            goto fail;
        total += job->objects[i]->size_bytes; /* eleven times LIMIT_OBJECT at most */
    }
    if (total > quota_bytes) {
        err_set(err, ERR_LIMIT, "the scene's arrays take %llu bytes, the quota is %llu",
                (unsigned long long)total, (unsigned long long)quota_bytes);
        goto fail;
    }
    if (job->settings.len != sizeof(struct scene_settings) ||
        job->spec.len != sizeof(struct job_spec)) {
        err_set(err, ERR_MESSAGE, "settings of %zu and a spec of %zu bytes, not %zu and %zu",
                job->settings.len, job->spec.len, sizeof(struct scene_settings),
                sizeof(struct job_spec));
        goto fail;
    }
    struct digest digest = bundle_digest_job(job);
    struct digest claimed;
    if (!digest_from_bytes(&claimed, job->digest.data, job->digest.len) ||
        !digest_equal(&claimed, &digest)) {
        err_set(err, ERR_DIGEST, "its digest is not that of its content");
        goto fail;
    }
    return true;

fail:
    return err_wrap(err, "job offered by the master");
}
