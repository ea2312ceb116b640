/* Keys: what keygen writes can be loaded, and what is unsafe or does not belong is refused. */
#include "common/err.h"
#include "proto/keys.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static char dir[256];

static int make_keys(void **state)
{
    (void)state;
    scratch_make(dir);
    return keys_generate(scratch_path(dir, "farm"), false, NULL) ? 0 : -1;
}

static int remove_keys(void **state)
{
    (void)state;
    scratch_remove(dir);
    return 0;
}

static const char *farm(const char *name)
{
    static char path[2][700];
    static unsigned next;
    snprintf(path[next % 2], sizeof(path[0]), "%s/farm/%s", dir, name);
    return path[next++ % 2];
}

static void expect_refused(enum role role, const char *says)
{
    struct err err = { 0 };
    struct keys *keys = keys_load(farm("."), role, &err);
    assert_null(keys);
    assert_int_equal(err.code, ERR_AUTH);
    if (strstr(err.text, says) == NULL)
        fail_msg("\"%s\" does not say \"%s\"", err.text, says);
}

static void every_role_loads_what_keygen_wrote(void **state)
{
    (void)state;
    const enum role roles[] = { ROLE_MASTER, ROLE_WORKER, ROLE_USER };
    for (int i = 0; i < 3; i++) {
        struct keys *keys = keys_load(farm("."), roles[i], NULL);
        assert_non_null(keys);
        assert_int_equal(keys_role(keys), roles[i]);
        keys_free(keys);
    }
    keys_free(NULL);
}

static void private_keys_are_private_whatever_the_umask(void **state)
{
    (void)state;
    struct stat stat_;
    mode_t mask = umask(0);
    assert_true(keys_generate(scratch_path(dir, "open"), false, NULL));
    umask(mask);
    assert_int_equal(stat(scratch_path(dir, "open/worker.key"), &stat_), 0);
    assert_int_equal(stat_.st_mode & 0777, 0600);
    assert_int_equal(stat(scratch_path(dir, "open/worker.crt"), &stat_), 0);
    assert_int_equal(stat_.st_mode & 0777, 0644);
    assert_int_equal(stat(scratch_path(dir, "open"), &stat_), 0);
    assert_int_equal(stat_.st_mode & 0777, 0700);
}

static void existing_keys_are_overwritten_only_when_told(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct stat before, after;
    stat(farm("master.key"), &before);
    assert_false(keys_generate(farm("."), false, &err));
    assert_int_equal(err.code, ERR_ARGUMENT);
    assert_non_null(strstr(err.text, "exists"));
    stat(farm("master.key"), &after);
    assert_int_equal(before.st_ino, after.st_ino);
    assert_true(keys_generate(farm("."), true, NULL));
    stat(farm("master.key"), &after);
    assert_int_not_equal(before.st_ino, after.st_ino);
    struct keys *keys = keys_load(farm("."), ROLE_MASTER, NULL);
    assert_non_null(keys);
    keys_free(keys);
}

static void one_existing_file_is_enough_to_write_nothing(void **state)
{
    (void)state;
    mkdir(scratch_path(dir, "half"), 0700);
    scratch_write(scratch_path(dir, "half/user.crt"), "mine", 4);
    assert_false(keys_generate(scratch_path(dir, "half"), false, NULL));
    assert_int_not_equal(access(scratch_path(dir, "half/master.key"), F_OK), 0);
}

static void unsafe_files_are_refused(void **state)
{
    (void)state;
    chmod(farm("worker.key"), 0644);
    expect_refused(ROLE_WORKER, "worker.key: mode 644 lets others read it; chmod 600 it");
    chmod(farm("worker.key"), 0640);
    expect_refused(ROLE_WORKER, "mode 640 lets others read it");
    chmod(farm("worker.key"), 0600);
    chmod(farm("master.crt"), 0666);
    expect_refused(ROLE_WORKER, "master.crt: mode 666 lets others write it");
    chmod(farm("master.crt"), 0644);
    chmod(farm("trusted"), 0777);
    expect_refused(ROLE_WORKER, "trusted: mode 777 lets others write into it");
    chmod(farm("trusted"), 0700);
    chmod(farm("."), 0770);
    expect_refused(ROLE_WORKER, "mode 770 lets others write into it");
    chmod(farm("."), 0700);
}

static void missing_and_foreign_files_are_refused(void **state)
{
    (void)state;
    struct err err = { 0 };
    assert_null(keys_load(scratch_path(dir, "nowhere"), ROLE_MASTER, &err));
    assert_non_null(strstr(err.text, "pathfarm keygen"));

    rename(farm("worker.key"), farm("away"));
    expect_refused(ROLE_WORKER, "worker.key: No such file");
    mkdir(farm("worker.key"), 0700);
    expect_refused(ROLE_WORKER, "worker.key: not a file");
    rmdir(farm("worker.key"));
    scratch_write(farm("worker.key"), "", 0);
    chmod(farm("worker.key"), 0600);
    expect_refused(ROLE_WORKER, "worker.key: not a key");
    scratch_write(farm("worker.key"), "-----BEGIN PRIVATE KEY-----\nAAAA\n", 33);
    expect_refused(ROLE_WORKER, "worker.key: not a private key");
    rename(farm("away"), farm("worker.key"));

    rename(farm("master.crt"), farm("away"));
    expect_refused(ROLE_WORKER, "no certificate of a master to trust");
    rename(farm("worker.crt"), farm("master.crt"));
    expect_refused(ROLE_WORKER, "worker.crt: No such file");
    rename(farm("master.crt"), farm("worker.crt"));
    rename(farm("away"), farm("master.crt"));

    rename(farm("worker.key"), farm("away"));
    rename(farm("user.key"), farm("worker.key"));
    expect_refused(ROLE_WORKER, "belongs to another key");
    rename(farm("worker.key"), farm("user.key"));
    rename(farm("away"), farm("worker.key"));

    rename(farm("worker.crt"), farm("away"));
    rename(farm("user.crt"), farm("worker.crt"));
    expect_refused(ROLE_WORKER, "not the certificate of a worker");
    rename(farm("worker.crt"), farm("user.crt"));
    rename(farm("away"), farm("worker.crt"));
}

static void a_trusted_certificate_must_be_readable_as_one(void **state)
{
    (void)state;
    scratch_write(farm("trusted/readme.txt"), "not a certificate, and not called one", 37);
    struct keys *keys = keys_load(farm("."), ROLE_MASTER, NULL);
    assert_non_null(keys);
    keys_free(keys);
    scratch_write(farm("trusted/worker-7.crt"), "garbage", 7);
    expect_refused(ROLE_MASTER, "worker-7.crt: not a certificate");
    unlink(farm("trusted/worker-7.crt"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_role_loads_what_keygen_wrote),
        cmocka_unit_test(private_keys_are_private_whatever_the_umask),
        cmocka_unit_test(existing_keys_are_overwritten_only_when_told),
        cmocka_unit_test(one_existing_file_is_enough_to_write_nothing),
        cmocka_unit_test(unsafe_files_are_refused),
        cmocka_unit_test(missing_and_foreign_files_are_refused),
        cmocka_unit_test(a_trusted_certificate_must_be_readable_as_one),
    };
    return cmocka_run_group_tests(tests, make_keys, remove_keys);
}
