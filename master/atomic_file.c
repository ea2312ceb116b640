#include "master/atomic_file.h"

#include "common/err.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <libgen.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

/* Where the file really goes: links followed. NULL with err when it must not be replaced. */
static char *resolve(const char *path, struct err *err)
{
    struct stat status;
    if (stat(path, &status) == 0 && !S_ISREG(status.st_mode)) {
        err_set(err, ERR_ARGUMENT, "%s: not a regular file", path);
        return NULL;
    }
    char *target = realpath(path, NULL);
    if (target == NULL && errno == ENOENT)
        target = strdup(path);
    if (target == NULL)
        err_set(err, ERR_IO, "%s: %s", path, strerror(errno));
    return target;
}

/*
 * "folder/.name.RANDOM.tmp": hidden, and nobody else's, on whatever machine they share the folder.
 * Caller frees; NULL when memory or random numbers run out.
 */
static char *temporary_name(const char *target)
{
    const char *slash = strrchr(target, '/');
    const char *name = slash != NULL ? slash + 1 : target;
    uint64_t random;
    if (getrandom(&random, sizeof(random), 0) != sizeof(random))
        return NULL;
    char *temporary;
    if (asprintf(&temporary, "%.*s.%s.%016" PRIx64 ".tmp", (int)(name - target), target, name,
                 random) < 0)
        return NULL;
    return temporary;
}

bool atomic_file_open(struct atomic_file *file, const char *path, struct err *err)
{
    *file = (struct atomic_file){ .fd = -1 };
    file->target = resolve(path, err);
    if (file->target == NULL)
        return false;

    file->temporary = temporary_name(file->target);
    if (file->temporary == NULL) {
        err_set(err, ERR_MEMORY, "%s: out of memory", path);
        goto fail_name;
    }
    file->fd = open(file->temporary, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file->fd < 0) {
        err_set(err, ERR_IO, "%s: cannot be written: %s", path, strerror(errno));
        goto fail_open;
    }
    return true;

fail_open:
    free(file->temporary);
fail_name:
    free(file->target);
    return false;
}

/* The rename is on the disk only when the folder is. */
static bool sync_folder(const char *path)
{
    char *copy = strdup(path);
    if (copy == NULL)
        return false;
    int fd = open(dirname(copy), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    free(copy);
    if (fd < 0)
        return false;
    /* Some network file systems cannot sync a folder; there the rename alone has to do */
    bool done = fsync(fd) == 0 || errno == EINVAL || errno == ENOTSUP;
    close(fd);
    return done;
}

bool atomic_file_commit(struct atomic_file *file, struct err *err)
{
    if (fsync(file->fd) != 0)
        goto fail;
    int fd = file->fd;
    file->fd = -1;
    if (close(fd) != 0)
        goto fail;
    if (rename(file->temporary, file->target) != 0)
        goto fail;

    bool synced = sync_folder(file->target);
    if (!synced)
        err_set(err, ERR_IO, "%s: its folder cannot be synced: %s", file->target, strerror(errno));
    free(file->temporary);
    free(file->target);
    return synced;

fail:
    err_set(err, ERR_IO, "%s: cannot be written: %s", file->target, strerror(errno));
    atomic_file_abort(file);
    return false;
}

void atomic_file_abort(struct atomic_file *file)
{
    if (file->fd >= 0)
        close(file->fd);
    unlink(file->temporary);
    free(file->temporary);
    free(file->target);
}

bool atomic_file_write(const char *path, const void *bytes, size_t size, struct err *err)
{
    struct atomic_file file;
    if (!atomic_file_open(&file, path, err))
        return false;
    for (size_t done = 0; done < size;) {
        ssize_t written = write(file.fd, (const char *)bytes + done, size - done);
        if (written < 0 && errno == EINTR)
            continue;
        if (written < 0) {
            err_set(err, ERR_IO, "%s: cannot be written: %s", path, strerror(errno));
            atomic_file_abort(&file);
            return false;
        }
        done += (size_t)written;
    }
    return atomic_file_commit(&file, err);
}
