/*
 * A directory for one test, removed afterwards with all that is in it.
 */
#ifndef TESTS_SCRATCH_H
#define TESTS_SCRATCH_H

#include <assert.h>
#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static inline int scratch_remove_one(const char *path, const struct stat *stat, int flag,
                                     struct FTW *where)
{
    (void)stat;
    (void)flag;
    (void)where;
    return remove(path);
}

/* Make a fresh directory (mode 0700) and write its path into `path`. */
static inline void scratch_make(char path[static 256])
{
    const char *base = getenv("TMPDIR");
    snprintf(path, 256, "%.200s/pathfarm-test-XXXXXX", base != NULL ? base : "/tmp");
    if (mkdtemp(path) == NULL)
        abort();
}

static inline void scratch_remove(const char *path)
{
    nftw(path, scratch_remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

/* "path/name" in a buffer that the next call but three uses again */
static inline const char *scratch_path(const char *path, const char *name)
{
    static char buffers[4][600];
    static unsigned next;
    char *buffer = buffers[next++ % 4];
    snprintf(buffer, sizeof(buffers[0]), "%s/%s", path, name);
    return buffer;
}

static inline void scratch_write(const char *path, const void *bytes, size_t size)
{
    FILE *file = fopen(path, "wb");
    if (file == NULL || fwrite(bytes, 1, size, file) != size || fclose(file) != 0)
        abort();
}

#endif
