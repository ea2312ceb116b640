/* The cache: what comes out is what went in, or nothing; and it keeps to its quota. */
#include "common/err.h"
#include "proto/cache.h"
#include "proto/limits.h"
#include "tests/scratch.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

static char dir[256];

static int make_dir(void **state)
{
    (void)state;
    scratch_make(dir);
    return 0;
}

static int remove_dir(void **state)
{
    (void)state;
    scratch_remove(dir);
    return 0;
}

static struct cache *open_cache(uint64_t quota_bytes)
{
    struct cache *cache = cache_open(scratch_path(dir, "a/b/cache"), quota_bytes, NULL);
    assert_non_null(cache);
    return cache;
}

static const char *file_of(const struct digest *digest)
{
    char hex[DIGEST_HEX_SIZE], name[100];
    snprintf(name, sizeof(name), "a/b/cache/%s", digest_hex(digest, hex));
    return scratch_path(dir, name);
}

static struct digest put(struct cache *cache, const void *bytes, size_t size)
{
    struct digest digest = digest_of_object(bytes, size, NULL);
    assert_true(cache_put(cache, &digest, bytes, size, NULL));
    return digest;
}

static bool has(struct cache *cache, const struct digest *digest, size_t size)
{
    struct cache_object object = { 0 };
    bool found = cache_get(cache, digest, size, &object);
    cache_unmap(&object);
    return found;
}

static void an_object_comes_back_aligned_and_padded_with_zeros(void **state)
{
    (void)state;
    const size_t sizes[] = { 1, 4000, 4096, LIMIT_SLICE + 5 };
    struct cache *cache = open_cache(64 * LIMIT_MIB);
    uint8_t *bytes = malloc(LIMIT_SLICE + 5);
    for (size_t i = 0; i < LIMIT_SLICE + 5; i++)
        bytes[i] = (uint8_t)(i % 251 + 1);
    for (int i = 0; i < 4; i++) {
        struct digest digest = put(cache, bytes, sizes[i]);
        struct cache_object object;
        assert_true(cache_get(cache, &digest, sizes[i], &object));
        assert_int_equal((uintptr_t)object.data % 64, 0);
        assert_int_equal(object.size, sizes[i]);
        assert_memory_equal(object.data, bytes, sizes[i]);
        for (int after = 0; after < 16; after++)
            assert_int_equal(((const uint8_t *)object.data)[sizes[i] + (size_t)after], 0);
        cache_unmap(&object);
        assert_true(cache_put(cache, &digest, bytes, sizes[i], NULL)); /* again: fine */
    }
    free(bytes);
    cache_close(cache);
    cache_close(NULL);
}

static void another_process_finds_it_later(void **state)
{
    (void)state;
    struct cache *cache = open_cache(LIMIT_MIB);
    struct digest digest = put(cache, "scene", 5);
    cache_close(cache);
    cache = open_cache(LIMIT_MIB);
    assert_true(has(cache, &digest, 5));
    assert_false(has(cache, &digest, 6)); /* a lie about its size deletes it: rare, and safe */
    cache_close(cache);
}

static void flip(const char *path, off_t at)
{
    uint8_t byte = 0;
    int fd = open(path, O_RDWR);
    assert_int_equal(pread(fd, &byte, 1, at), 1);
    byte ^= 0x10;
    assert_int_equal(pwrite(fd, &byte, 1, at), 1);
    close(fd);
}

static void damaged_files_count_as_absent_and_go(void **state)
{
    (void)state;
    static const char content[] = "some vertices";
    for (int damage = 0; damage < 7; damage++) {
        struct cache *cache = open_cache(LIMIT_MIB);
        struct digest digest = put(cache, content, sizeof(content));
        const char *path = file_of(&digest);
        switch (damage) {
        case 0:
            flip(path, 0);
            break;
        case 1:
            flip(path, sizeof(content) - 1);
            break;
        case 2:
            flip(path, sizeof(content) + 63);
            break; /* the padding */
        case 3:
            assert_int_equal(truncate(path, 20), 0);
            break;
        case 4:
            assert_int_equal(truncate(path, 20000), 0);
            break;
        case 5:
            assert_int_equal(truncate(path, 0), 0);
            break;
        case 6: /* a link to a perfect copy elsewhere */
            assert_int_equal(rename(path, scratch_path(dir, "elsewhere")), 0);
            assert_int_equal(symlink(scratch_path(dir, "elsewhere"), path), 0);
            break;
        }
        assert_false(has(cache, &digest, sizeof(content)));
        struct stat stat_;
        assert_int_not_equal(lstat(path, &stat_), 0);
        put(cache, content, sizeof(content));
        assert_true(has(cache, &digest, sizeof(content)));
        cache_close(cache);
    }
}

static void backdate(const struct digest *digest, int seconds)
{
    struct timespec times[2];
    clock_gettime(CLOCK_REALTIME, &times[0]);
    times[0].tv_sec -= seconds;
    times[1] = times[0];
    assert_int_equal(utimensat(AT_FDCWD, file_of(digest), times, 0), 0);
}

static void the_least_recently_used_goes_first(void **state)
{
    (void)state;
    uint8_t bytes[1000] = { 0 };
    struct digest digests[4];
    struct cache *cache = open_cache(3 * (sizeof(bytes) + 64));
    for (uint8_t i = 0; i < 3; i++) {
        bytes[0] = i;
        digests[i] = put(cache, bytes, sizeof(bytes));
        backdate(&digests[i], 100 - i);
    }
    assert_true(has(cache, &digests[0], sizeof(bytes))); /* used: now the newest */
    assert_true(cache_used(cache) <= 3 * (sizeof(bytes) + 64));
    bytes[0] = 3;
    digests[3] = put(cache, bytes, sizeof(bytes));
    assert_true(cache_used(cache) <= 3 * (sizeof(bytes) + 64));
    assert_true(has(cache, &digests[0], sizeof(bytes)));
    assert_false(has(cache, &digests[1], sizeof(bytes)));
    assert_true(has(cache, &digests[2], sizeof(bytes)));
    assert_true(has(cache, &digests[3], sizeof(bytes)));
    cache_close(cache);
}

static void an_object_in_use_stays_readable_when_it_goes(void **state)
{
    (void)state;
    uint8_t bytes[1000] = { 42 };
    struct cache *cache = open_cache(sizeof(bytes) + 64);
    struct digest first = put(cache, bytes, sizeof(bytes));
    struct cache_object object;
    assert_true(cache_get(cache, &first, sizeof(bytes), &object));
    bytes[0] = 43;
    put(cache, bytes, sizeof(bytes));
    assert_false(has(cache, &first, sizeof(bytes)));
    assert_int_equal(((const uint8_t *)object.data)[0], 42);
    cache_unmap(&object);
    cache_close(cache);
}

static void what_is_larger_than_the_quota_is_not_kept(void **state)
{
    (void)state;
    uint8_t bytes[1000] = { 1 };
    struct err err = { 0 };
    struct cache *cache = open_cache(sizeof(bytes) + 63);
    struct digest digest = digest_of_object(bytes, sizeof(bytes), NULL);
    assert_false(cache_put(cache, &digest, bytes, sizeof(bytes), &err));
    assert_int_equal(err.code, ERR_LIMIT);
    cache_close(cache);
}

static void a_directory_that_others_can_use_is_refused(void **state)
{
    (void)state;
    struct err err = { 0 };
    const char *path = scratch_path(dir, "shared");
    mkdir(path, 0700);
    chmod(path, 0750);
    assert_null(cache_open(path, LIMIT_MIB, &err));
    assert_non_null(strstr(err.text, "mode 700"));
    chmod(path, 0700);
    const char *link = scratch_path(dir, "link");
    assert_int_equal(symlink(path, link), 0);
    assert_null(cache_open(link, LIMIT_MIB, &err));
    scratch_write(scratch_path(dir, "file"), "x", 1);
    assert_null(cache_open(scratch_path(dir, "file"), LIMIT_MIB, &err));
    assert_int_equal(err.code, ERR_IO);
    assert_null(cache_open("", LIMIT_MIB, &err));
}

static void a_draft_of_a_process_that_died_is_no_obstacle(void **state)
{
    (void)state;
    struct cache *cache = open_cache(LIMIT_MIB);
    scratch_write(scratch_path(dir, "a/b/cache/.draft"), "half", 4);
    struct digest digest = put(cache, "whole", 5);
    assert_true(has(cache, &digest, 5));
    assert_int_not_equal(access(scratch_path(dir, "a/b/cache/.draft"), F_OK), 0);
    cache_close(cache);
}

static void many_processes_may_write_at_once(void **state)
{
    (void)state;
    uint8_t bytes[20000];
    pid_t children[4];
    for (int child = 0; child < 4; child++) {
        children[child] = fork();
        if (children[child] != 0)
            continue;
        struct cache *cache = cache_open(scratch_path(dir, "a/b/cache"), 7 * 20064, NULL);
        bool fine = cache != NULL;
        for (int round = 0; fine && round < 30; round++) {
            memset(bytes, round % 10, sizeof(bytes));
            struct digest digest = digest_of_object(bytes, sizeof(bytes), NULL);
            struct cache_object object = { 0 };
            fine = cache_put(cache, &digest, bytes, sizeof(bytes), NULL);
            if (fine && cache_get(cache, &digest, sizeof(bytes), &object)) /* may be gone again */
                fine = memcmp(object.data, bytes, sizeof(bytes)) == 0;
            cache_unmap(&object);
        }
        _exit(fine ? 0 : 1);
    }
    for (int child = 0; child < 4; child++) {
        int status = -1;
        assert_int_equal(waitpid(children[child], &status, 0), children[child]);
        assert_int_equal(status, 0);
    }
    struct cache *cache = open_cache(LIMIT_MIB);
    assert_true(cache_used(cache) <= 7 * 20064);
    cache_close(cache);
}

static void the_default_directory_follows_the_environment(void **state)
{
    (void)state;
    char path[100];
    setenv("HOME", "/home/somebody", 1);
    setenv("XDG_CACHE_HOME", "/var/cache/somebody", 1);
    assert_true(cache_default_dir(path, sizeof(path)));
    assert_string_equal(path, "/var/cache/somebody/pathfarm");
    unsetenv("XDG_CACHE_HOME");
    assert_true(cache_default_dir(path, sizeof(path)));
    assert_string_equal(path, "/home/somebody/.cache/pathfarm");
    assert_false(cache_default_dir(path, 10));
    unsetenv("HOME");
    assert_false(cache_default_dir(path, sizeof(path)));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define CASE(test) cmocka_unit_test_setup_teardown(test, make_dir, remove_dir)
        CASE(an_object_comes_back_aligned_and_padded_with_zeros),
        CASE(another_process_finds_it_later),
        CASE(damaged_files_count_as_absent_and_go),
        CASE(the_least_recently_used_goes_first),
        CASE(an_object_in_use_stays_readable_when_it_goes),
        CASE(what_is_larger_than_the_quota_is_not_kept),
        CASE(a_directory_that_others_can_use_is_refused),
        CASE(a_draft_of_a_process_that_died_is_no_obstacle),
        CASE(many_processes_may_write_at_once),
        CASE(the_default_directory_follows_the_environment),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
