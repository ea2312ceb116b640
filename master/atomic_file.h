/*
 * Files that appear whole or not at all. The bytes go to a temporary file beside the target, which
 * is synced and renamed over it; whoever dies on the way leaves the old target as it was. The
 * temporary is removed on failure.
 *
 * Blocks on the disk: not for a thread that must answer quickly with large files.
 */
#ifndef MASTER_ATOMIC_FILE_H
#define MASTER_ATOMIC_FILE_H

#include <stdbool.h>
#include <stddef.h>

struct err;

struct atomic_file {
    char *target;
    char *temporary; /* where the bytes go meanwhile; libraries may open it by this name */
    int fd;          /* open for writing, on the temporary */
};

/*
 * Begin. A symbolic link is followed; a target that is neither a regular file nor absent is refused
 * (a rename would replace the device or pipe). On failure nothing is left to abort.
 */
bool atomic_file_open(struct atomic_file *file, const char *path, struct err *err);

/* Sync, rename, sync the folder. Ends the file either way; on failure the target is untouched. */
bool atomic_file_commit(struct atomic_file *file, struct err *err);

/* End without a trace. */
void atomic_file_abort(struct atomic_file *file);

/* All three steps for bytes in memory. */
bool atomic_file_write(const char *path, const void *bytes, size_t size, struct err *err);

#endif
