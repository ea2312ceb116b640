/*
 * A scene crosses from bundle to assembly unchanged, over the wire or through the cache, and no
 * damaged or invented byte of it is taken.
 */
#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "proto/assembly.h"
#include "proto/bundle.h"
#include "proto/cache.h"
#include "proto/frame.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>

#include <cmocka.h>

#define VERTICES  800000u /* three slices of positions */
#define TRIANGLES 50u

static char dir[256];
static float *positions;
static uint32_t triangles[3 * TRIANGLES];
static struct mesh meshes[2] = { { .material = 1, .triangle_count = 20 }, { .material = 2 } };
static struct material materials[1] = { { .ior = 1.5f } };
static float light_corners[3 * VERTICES / 1000];
static struct scene scene;
static const struct job_spec spec = {
    .seed = 7, .replicates = 4, .leaf_samples = 4, .channel_count = 3
};

static int prepare(void **state)
{
    (void)state;
    scratch_make(dir);
    positions = malloc(3 * VERTICES * sizeof(float));
    for (uint32_t i = 0; i < 3 * VERTICES; i++)
        positions[i] = (float)i * 0.37f;
    for (uint32_t i = 0; i < 3 * TRIANGLES; i++)
        triangles[i] = i * 7;
    scene.positions = positions;
    scene.vertex_count = VERTICES;
    scene.triangles = triangles;
    scene.triangle_count = TRIANGLES;
    scene.meshes = meshes;
    scene.mesh_count = 2;
    scene.materials = materials;
    scene.material_count = 1;
    scene.light_corners = light_corners;
    scene.light_corner_count = VERTICES / 1000;
    scene.normals = light_corners; /* equal content under two names */
    scene.normal_count = VERTICES / 1000;
    scene.settings.width = 640;
    scene.settings.center[1] = 1e6;
    return 0;
}

static int tidy(void **state)
{
    (void)state;
    free(positions);
    scratch_remove(dir);
    return 0;
}

static struct bundle *make_bundle(void)
{
    struct bundle *bundle = bundle_from_scene(&scene, &spec, NULL);
    assert_non_null(bundle);
    return bundle;
}

/* The JOB message as it comes out of a frame at the other end */
static Pathfarm__Job *job_over_the_wire(const struct bundle *bundle)
{
    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bundle_describe(bundle, &job);
    job.job_id = 9;
    size_t size = frame_head_size(&job.base);
    uint8_t *bytes = malloc(size);
    assert_true(frame_head(&job.base, 0, bytes, NULL));
    struct frame frame = { .kind = PATHFARM__KIND__KIND_JOB,
                           .payload = bytes + FRAME_HEADER_SIZE,
                           .payload_size = size - FRAME_HEADER_SIZE };
    Pathfarm__Job *back = frame_message(&frame, NULL);
    assert_non_null(back);
    free(bytes);
    return back;
}

static struct assembly *make_assembly(const struct bundle *bundle)
{
    Pathfarm__Job *job = job_over_the_wire(bundle);
    struct assembly *assembly = assembly_new(job, LIMIT_GIB, NULL);
    assert_non_null(assembly);
    frame_message_free(job);
    return assembly;
}

static bool answer(const struct bundle *bundle, struct assembly *assembly,
                   const Pathfarm__ObjectWanted *wanted, uint64_t slice, struct err *err)
{
    struct digest digest;
    Pathfarm__ObjectSlice message;
    const void *data;
    size_t size;
    assert_true(digest_from_bytes(&digest, wanted->digest.data, wanted->digest.len));
    assert_true(bundle_slice(bundle, &digest, slice, &message, &data, &size));
    return assembly_slice(assembly, &message, data, size, err);
}

/* Ask and answer until nothing is missing; the number of slices that crossed */
static unsigned transfer(const struct bundle *bundle, struct assembly *assembly, uint32_t credit)
{
    unsigned slices = 0;
    Pathfarm__ObjectWanted wanted;
    while (assembly_want(assembly, credit, &wanted)) {
        assert_true(wanted.slice_count >= 1 && wanted.slice_count <= credit);
        assert_int_equal(wanted.job_id, 9);
        for (uint32_t i = 0; i < wanted.slice_count; i++, slices++)
            assert_true(answer(bundle, assembly, &wanted, wanted.first_slice + i, NULL));
    }
    return slices;
}

static void expect_the_scene(struct assembly *assembly)
{
    assert_true(assembly_complete(assembly));
    const struct scene *got = assembly_scene(assembly);
    assert_memory_equal(&got->settings, &scene.settings, sizeof(scene.settings));
    assert_memory_equal(assembly_spec(assembly), &spec, sizeof(spec));
#define X(member, count_member, type, per_count)                               \
    {                                                                          \
        size_t size = (size_t)scene.count_member * (per_count) * sizeof(type); \
        const uint8_t *bytes = (const uint8_t *)got->member;                   \
        assert_int_equal(got->count_member, scene.count_member);               \
        assert_int_equal((uintptr_t)bytes % 64, 0);                            \
        if (size > 0)                                                          \
            assert_memory_equal(bytes, scene.member, size);                    \
        for (size_t after = 0; after < 16; after++)                            \
            assert_int_equal(bytes[size + after], 0);                          \
    }
    SCENE_ARRAYS(X)
#undef X
}

static void a_scene_crosses_the_wire_unchanged(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    for (uint32_t credit = 1; credit <= 8; credit *= 8) {
        struct assembly *assembly = make_assembly(bundle);
        assert_false(assembly_complete(assembly));
        /* positions in three slices, light_corners once for both names, and three small ones */
        assert_int_equal(transfer(bundle, assembly, credit), 3 + 1 + 3);
        expect_the_scene(assembly);
        assert_false(assembly_cached(assembly));
        assert_true(digest_equal(assembly_job_digest(assembly), bundle_job_digest(bundle)));
        assert_int_equal(assembly_job_id(assembly), 9);
        assembly_free(assembly);
    }
    bundle_free(bundle);
    bundle_free(NULL);
    assembly_free(NULL);
}

static void the_second_time_it_comes_from_the_cache(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    struct cache *cache = cache_open(scratch_path(dir, "cache"), LIMIT_GIB, NULL);
    struct assembly *first = make_assembly(bundle), *second = make_assembly(bundle);
    assembly_load(first, cache);
    assert_true(transfer(bundle, first, 4) > 0);
    assert_true(assembly_store(first, cache, NULL));
    assembly_free(first);
    assembly_load(second, cache);
    assert_int_equal(transfer(bundle, second, 4), 0);
    assert_true(assembly_cached(second));
    cache_close(cache);
    expect_the_scene(second);
    assert_true(assembly_store(second, NULL, NULL));
    assembly_free(second);
    bundle_free(bundle);
}

static void a_bit_flipped_in_the_cache_brings_that_object_over_the_wire_again(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    struct cache *cache = cache_open(scratch_path(dir, "flipped"), LIMIT_GIB, NULL);
    struct assembly *assembly = make_assembly(bundle);
    transfer(bundle, assembly, 4);
    assert_true(assembly_store(assembly, cache, NULL));
    assembly_free(assembly);

    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bundle_describe(bundle, &job);
    struct digest digest;
    char hex[DIGEST_HEX_SIZE], path[600];
    digest_from_bytes(&digest, job.objects[0]->digest.data, DIGEST_SIZE); /* positions */
    snprintf(path, sizeof(path), "%s/%s", scratch_path(dir, "flipped"), digest_hex(&digest, hex));
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    fseek(file, 5000000, SEEK_SET);
    int byte = fgetc(file);
    fseek(file, 5000000, SEEK_SET);
    fputc(byte ^ 1, file);
    fclose(file);

    assembly = make_assembly(bundle);
    assembly_load(assembly, cache);
    assert_int_equal(transfer(bundle, assembly, 4), 3);
    expect_the_scene(assembly);
    assembly_free(assembly);
    cache_close(cache);
    bundle_free(bundle);
}

static void wishes_that_were_lost_are_asked_for_again(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    struct assembly *assembly = make_assembly(bundle);
    Pathfarm__ObjectWanted wanted;
    unsigned wishes = 0;
    while (assembly_want(assembly, 4, &wanted)) /* nobody answers */
        wishes++;
    assert_int_equal(wishes, 5); /* slice 0 of each object */
    assembly_forget_wishes(assembly);
    assert_true(assembly_want(assembly, 4, &wanted));
    assert_true(answer(bundle, assembly, &wanted, 0, NULL));
    assert_true(answer(bundle, assembly, &wanted, 0, NULL)); /* twice does no harm */
    assembly_forget_wishes(assembly);
    assert_int_equal(transfer(bundle, assembly, 4), 2 + 4);
    expect_the_scene(assembly);
    assembly_free(assembly);
    bundle_free(bundle);
}

static void damaged_and_invented_slices_are_refused_with_a_reason(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    static uint8_t bad[LIMIT_SLICE], list[3 * DIGEST_SIZE], forged[DIGEST_SIZE];
    for (int how = 0; how < 10; how++) {
        static const struct {
            const char *says;
            enum err_code code;
        } cases[] = {
            { "do not match their checksum", ERR_DIGEST },
            { "not those of the list", ERR_DIGEST },
            { "list of slices does not match", ERR_DIGEST },
            { "a list of 64 bytes", ERR_MESSAGE },
            { "not its size", ERR_MESSAGE },
            { "not its size", ERR_MESSAGE },
            { "not asked for", ERR_MESSAGE },
            { "object that was not asked for", ERR_MESSAGE },
            { "object that was not asked for", ERR_MESSAGE },
            { "do not match their checksum", ERR_DIGEST },
        };
        struct assembly *assembly = make_assembly(bundle);
        Pathfarm__ObjectWanted wanted;
        Pathfarm__ObjectSlice message;
        struct digest digest;
        struct err err = { 0 };
        const void *data;
        size_t size;
        assert_true(assembly_want(assembly, 4, &wanted));
        digest_from_bytes(&digest, wanted.digest.data, wanted.digest.len);
        assert_true(bundle_slice(bundle, &digest, how == 6 ? 1 : 0, &message, &data, &size));
        memcpy(bad, data, size);
        if (how != 6)
            memcpy(list, message.slice_digests.data, sizeof(list));
        switch (how) {
        case 0:
            bad[77] ^= 1;
            break;
        case 1: /* damaged, with a checksum to match */
        case 2: /* and a list to match as well */
            bad[77] ^= 1;
            digest = digest_of(bad, size);
            memcpy(forged, digest.bytes, DIGEST_SIZE);
            message.checksum.data = forged;
            if (how == 2) {
                memcpy(list, forged, DIGEST_SIZE);
                message.slice_digests.data = list;
            }
            break;
        case 3:
            message.slice_digests.len = 2 * DIGEST_SIZE;
            break;
        case 4:
            size--;
            break;
        case 5:
            message.slice_total++;
            break;
        case 6:
            break; /* slice 1, of which no list is known */
        case 7:
            memset(forged, 1, DIGEST_SIZE);
            message.digest.data = forged;
            break;
        case 8:
            message.digest.len = 0;
            break;
        case 9:
            message.checksum.len = 0;
            break;
        }
        assert_false(assembly_slice(assembly, &message, bad, size, &err));
        assert_int_equal(err.code, cases[how].code);
        if (strstr(err.text, cases[how].says) == NULL)
            fail_msg("case %d: \"%s\" does not say \"%s\"", how, err.text, cases[how].says);
        assembly_forget_wishes(assembly); /* and the real ones are still welcome */
        transfer(bundle, assembly, 4);
        expect_the_scene(assembly);
        assembly_free(assembly);
    }
    bundle_free(bundle);
}

static void jobs_that_do_not_add_up_are_refused_with_a_reason(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    static const char *const says[] = {
        "; a scene has ",
        "where \"positions\" is expected",
        "do not take",
        "do not take",
        "has 31 bytes",
        "settings of",
        "settings of",
        "digest is not that of its content",
        "digest is not that of its content",
        "the quota is",
    };
    for (size_t how = 0; how < sizeof(says) / sizeof(says[0]); how++) {
        Pathfarm__Job *job = job_over_the_wire(bundle);
        Pathfarm__Object *first = job->objects[0];
        struct err err = { 0 };
        uint64_t quota = LIMIT_GIB;
        size_t object_count = job->n_objects;
        switch (how) {
        case 0:
            job->n_objects = 10;
            break;
        case 1:
            first->name[0] = 'q';
            break;
        case 2:
            first->size_bytes++;
            break;
        case 3:
            first->count = UINT64_C(1) << 40;
            first->size_bytes = first->count * 12;
            break;
        case 4:
            first->digest.len = 31;
            break;
        case 5:
            job->settings.len--;
            break;
        case 6:
            job->spec.len = 0;
            break;
        case 7:
            job->digest.data[0] ^= 1;
            break;
        case 8:
            job->spec.data[0] ^= 1;
            break;
        case 9:
            quota = bundle_size(bundle) - 1;
            break;
        }
        assert_null(assembly_new(job, quota, &err));
        if (strstr(err.text, says[how]) == NULL)
            fail_msg("case %zu: \"%s\" does not say \"%s\"", how, err.text, says[how]);
        job->n_objects = object_count;
        frame_message_free(job);
    }
    bundle_free(bundle);
}

static void a_huge_object_is_refused_before_memory_is_taken(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    Pathfarm__Job *job = job_over_the_wire(bundle);
    struct err err = { 0 };
    job->objects[7]->count = UINT32_MAX; /* coat tables of 256 bytes: a TiB */
    job->objects[7]->size_bytes = UINT32_MAX * UINT64_C(256);
    struct digest digest = bundle_digest_job(job);
    memcpy(job->digest.data, digest.bytes, DIGEST_SIZE);
    assert_null(assembly_new(job, UINT64_MAX, &err));
    assert_int_equal(err.code, ERR_LIMIT);
    assert_non_null(strstr(err.text, "coat_tables"));
    frame_message_free(job);
    bundle_free(bundle);
}

static void the_job_digest_names_everything_that_decides_bits(void **state)
{
    (void)state;
    struct bundle *one = make_bundle(), *two = make_bundle();
    assert_true(digest_equal(bundle_job_digest(one), bundle_job_digest(two)));
    bundle_free(two);

    struct job_spec other_spec = spec;
    other_spec.seed++;
    two = bundle_from_scene(&scene, &other_spec, NULL);
    assert_false(digest_equal(bundle_job_digest(one), bundle_job_digest(two)));
    assert_true(digest_equal(bundle_scene_digest(one), bundle_scene_digest(two)));
    bundle_free(two);

    struct scene other = scene;
    other.settings.camera.position[0] = 1;
    two = bundle_from_scene(&other, &spec, NULL);
    assert_false(digest_equal(bundle_scene_digest(one), bundle_scene_digest(two)));
    bundle_free(two);

    other = scene;
    other.vertex_count--;
    two = bundle_from_scene(&other, &spec, NULL);
    assert_false(digest_equal(bundle_scene_digest(one), bundle_scene_digest(two)));
    bundle_free(two);
    bundle_free(one);
}

static void a_bundle_answers_only_for_what_it_has(void **state)
{
    (void)state;
    struct bundle *bundle = make_bundle();
    Pathfarm__Job job = PATHFARM__JOB__INIT;
    Pathfarm__ObjectSlice message;
    struct digest digest, unknown = { { 1 } }, empty = digest_of(NULL, 0);
    const void *data;
    size_t size;
    bundle_describe(bundle, &job);
    digest_from_bytes(&digest, job.objects[0]->digest.data, DIGEST_SIZE);
    assert_true(bundle_slice(bundle, &digest, 2, &message, &data, &size));
    assert_int_equal(message.slice_digests.len, 0); /* the list comes with slice 0 only */
    assert_int_equal(size, 12 * VERTICES - 2 * LIMIT_SLICE);
    assert_false(bundle_slice(bundle, &digest, 3, &message, &data, &size));
    assert_false(bundle_slice(bundle, &digest, UINT64_MAX, &message, &data, &size));
    assert_false(bundle_slice(bundle, &unknown, 0, &message, &data, &size));
    assert_false(bundle_slice(bundle, &empty, 0, &message, &data, &size));
    bundle_free(bundle);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_scene_crosses_the_wire_unchanged),
        cmocka_unit_test(the_second_time_it_comes_from_the_cache),
        cmocka_unit_test(a_bit_flipped_in_the_cache_brings_that_object_over_the_wire_again),
        cmocka_unit_test(wishes_that_were_lost_are_asked_for_again),
        cmocka_unit_test(damaged_and_invented_slices_are_refused_with_a_reason),
        cmocka_unit_test(jobs_that_do_not_add_up_are_refused_with_a_reason),
        cmocka_unit_test(a_huge_object_is_refused_before_memory_is_taken),
        cmocka_unit_test(the_job_digest_names_everything_that_decides_bits),
        cmocka_unit_test(a_bundle_answers_only_for_what_it_has),
    };
    return cmocka_run_group_tests(tests, prepare, tidy);
}
