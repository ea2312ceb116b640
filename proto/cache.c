#include "proto/cache.h"

#include "common/err.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define END_PADDING  64
#define LOCK_NAME    "lock"
#define DRAFT_NAME   ".draft" /* one is enough: it is written under the lock */
#define LOCK_TRIES   1000
#define LOCK_WAIT_MS 10

static const uint8_t padding[END_PADDING];

struct cache {
    int dir_fd, lock_fd;
    uint64_t quota_bytes;
    char dir[4096];
};

static bool io_failed(const struct cache *cache, const char *what, struct err *err)
{
    return err_set(err, ERR_IO, "cache %s: %s: %s", cache->dir, what, strerror(errno));
}

/* mkdir -p, private */
static bool make_directories(const char *dir)
{
    char path[4096];
    snprintf(path, sizeof(path), "%s", dir);
    for (char *slash = strchr(path + 1, '/'); slash != NULL; slash = strchr(slash + 1, '/')) {
        *slash = '\0';
        if (mkdir(path, 0700) != 0 && errno != EEXIST)
            return false;
        *slash = '/';
    }
    return mkdir(path, 0700) == 0 || errno == EEXIST;
}

struct cache *cache_open(const char *dir, uint64_t quota_bytes, struct err *err)
{
    struct stat stat;
    struct cache *cache = calloc(1, sizeof(*cache));
    if (cache == NULL || strlen(dir) >= sizeof(cache->dir) || dir[0] == '\0') {
        err_set(err, ERR_ARGUMENT, "cache: no memory, or \"%.100s\" is no directory", dir);
        goto fail_new;
    }
    strcpy(cache->dir, dir);
    cache->quota_bytes = quota_bytes;
    cache->dir_fd = -1;
    if (make_directories(dir))
        cache->dir_fd = open(dir, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (cache->dir_fd < 0 || fstat(cache->dir_fd, &stat) != 0) {
        io_failed(cache, "opening", err);
        goto fail_dir;
    }
    if (stat.st_uid != geteuid() || (stat.st_mode & 077) != 0) {
        err_set(err, ERR_IO, "cache %s: others own it or may use it; it must be ours, mode 700",
                dir);
        goto fail_dir;
    }
    cache->lock_fd = openat(cache->dir_fd, LOCK_NAME, O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC,
                            0600);
    if (cache->lock_fd < 0) {
        io_failed(cache, "making its lock", err);
        goto fail_dir;
    }
    return cache;

fail_dir:
    if (cache->dir_fd >= 0)
        close(cache->dir_fd);
fail_new:
    free(cache);
    return NULL;
}

void cache_close(struct cache *cache)
{
    if (cache == NULL)
        return;
    close(cache->lock_fd);
    close(cache->dir_fd);
    free(cache);
}

/* Reading */

static bool is_whole(const uint8_t *content, uint64_t size, const struct digest *digest)
{
    struct digest found = digest_of_object(content, size, NULL);
    return digest_equal(&found, digest) && memcmp(content + size, padding, END_PADDING) == 0;
}

bool cache_get(struct cache *cache, const struct digest *digest, uint64_t size,
               struct cache_object *object)
{
    char name[DIGEST_HEX_SIZE];
    struct stat stat;
    void *content = MAP_FAILED;
    digest_hex(digest, name);
    int fd = openat(cache->dir_fd, name, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0 && errno != ELOOP)
        return false;
    if (fd >= 0 && fstat(fd, &stat) == 0 && S_ISREG(stat.st_mode) &&
        (uint64_t)stat.st_size == size + END_PADDING) {
        content = mmap(NULL, size + END_PADDING, PROT_READ, MAP_PRIVATE, fd, 0);
        if (content == MAP_FAILED) { /* our trouble, not the file's */
            close(fd);
            return false;
        }
    }
    if (content != MAP_FAILED && is_whole(content, size, digest)) {
        futimens(fd, NULL); /* used now; when that fails it only goes sooner */
        close(fd);
        *object = (struct cache_object){ content, size };
        return true;
    }
    if (content != MAP_FAILED)
        munmap(content, size + END_PADDING);
    if (fd >= 0)
        close(fd);
    unlinkat(cache->dir_fd, name, 0);
    return false;
}

void cache_unmap(struct cache_object *object)
{
    if (object->data != NULL)
        munmap((void *)object->data, object->size + END_PADDING);
    *object = (struct cache_object){ 0 };
}

/* Making room */

struct entry {
    char name[DIGEST_HEX_SIZE];
    struct timespec used;
    uint64_t size;
};

struct entry_list {
    struct entry *entries;
    size_t count, capacity;
    uint64_t size;
};

static bool list_entries(const struct cache *cache, struct entry_list *list)
{
    *list = (struct entry_list){ 0 };
    int fd = openat(cache->dir_fd, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *dir = fd >= 0 ? fdopendir(fd) : NULL;
    if (dir == NULL) {
        if (fd >= 0)
            close(fd);
        return false;
    }
    bool listed = true;
    struct dirent *item;
    while (listed && (item = readdir(dir)) != NULL) {
        struct digest digest;
        struct stat stat;
        if (!digest_from_hex(&digest, item->d_name) ||
            fstatat(cache->dir_fd, item->d_name, &stat, AT_SYMLINK_NOFOLLOW) != 0)
            continue;
        if (list->count == list->capacity) {
            size_t capacity = 2 * list->capacity + 64;
            struct entry *entries = realloc(list->entries, capacity * sizeof(*entries));
            listed = entries != NULL;
            if (!listed)
                break;
            list->entries = entries;
            list->capacity = capacity;
        }
        struct entry *entry = &list->entries[list->count++];
        memcpy(entry->name, item->d_name, DIGEST_HEX_SIZE);
        entry->used = stat.st_mtim;
        entry->size = (uint64_t)stat.st_size;
        list->size += entry->size;
    }
    closedir(dir);
    return listed;
}

static int by_last_use(const void *left, const void *right)
{
    const struct timespec *a = &((const struct entry *)left)->used;
    const struct timespec *b = &((const struct entry *)right)->used;
    if (a->tv_sec != b->tv_sec)
        return a->tv_sec < b->tv_sec ? -1 : 1;
    return (a->tv_nsec > b->tv_nsec) - (a->tv_nsec < b->tv_nsec);
}

static bool make_room(struct cache *cache, uint64_t wanted, struct err *err)
{
    struct entry_list list;
    bool room = list_entries(cache, &list);
    if (!room)
        io_failed(cache, "listing", err);
    else if (list.count > 0)
        qsort(list.entries, list.count, sizeof(*list.entries), by_last_use);
    for (size_t i = 0; room && i < list.count && list.size + wanted > cache->quota_bytes; i++) {
        if (unlinkat(cache->dir_fd, list.entries[i].name, 0) == 0 || errno == ENOENT)
            list.size -= list.entries[i].size;
        else
            room = io_failed(cache, list.entries[i].name, err);
    }
    free(list.entries);
    return room;
}

uint64_t cache_used(struct cache *cache)
{
    struct entry_list list;
    list_entries(cache, &list);
    free(list.entries);
    return list.size;
}

/* Writing */

/* Not for ever: a stopped process may hold it, and what is not kept only costs time later */
static bool lock(struct cache *cache, struct err *err)
{
    for (int i = 0; i < LOCK_TRIES; i++) {
        if (flock(cache->lock_fd, LOCK_EX | LOCK_NB) == 0)
            return true;
        if (errno != EWOULDBLOCK && errno != EINTR)
            return io_failed(cache, "locking", err);
        nanosleep(&(struct timespec){ .tv_nsec = LOCK_WAIT_MS * 1000000L }, NULL);
    }
    return err_set(err, ERR_IO, "cache %s: another process has kept its lock for too long",
                   cache->dir);
}

static void unlock(struct cache *cache)
{
    flock(cache->lock_fd, LOCK_UN);
}

static bool write_all(int fd, const void *bytes, uint64_t size)
{
    const uint8_t *at = bytes;
    while (size > 0) {
        ssize_t part = write(fd, at, size < (1u << 30) ? size : 1u << 30);
        if (part < 0 && errno == EINTR)
            continue;
        if (part <= 0)
            return false;
        at += part;
        size -= (uint64_t)part;
    }
    return true;
}

static bool write_object(struct cache *cache, const char *name, const void *data, uint64_t size,
                         struct err *err)
{
    unlinkat(cache->dir_fd, DRAFT_NAME, 0); /* of a process that died */
    int fd = openat(cache->dir_fd, DRAFT_NAME, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC,
                    0600);
    if (fd < 0)
        return io_failed(cache, "writing", err);
    bool written = write_all(fd, data, size) && write_all(fd, padding, END_PADDING) &&
                   fsync(fd) == 0;
    if (!written)
        io_failed(cache, "writing", err);
    close(fd);
    if (written && renameat(cache->dir_fd, DRAFT_NAME, cache->dir_fd, name) != 0)
        written = io_failed(cache, "renaming", err);
    if (!written)
        unlinkat(cache->dir_fd, DRAFT_NAME, 0);
    else
        fsync(cache->dir_fd);
    return written;
}

/* Of the right size is good enough here: content is judged when it is read */
static bool exists(const struct cache *cache, const char *name, uint64_t size)
{
    struct stat stat;
    return fstatat(cache->dir_fd, name, &stat, AT_SYMLINK_NOFOLLOW) == 0 && S_ISREG(stat.st_mode) &&
           (uint64_t)stat.st_size == size + END_PADDING;
}

bool cache_put(struct cache *cache, const struct digest *digest, const void *data, uint64_t size,
               struct err *err)
{
    char name[DIGEST_HEX_SIZE];
    digest_hex(digest, name);
    if (size > UINT64_MAX - END_PADDING || size + END_PADDING > cache->quota_bytes)
        return err_set(err, ERR_LIMIT, "cache %s: %llu bytes are more than its quota of %llu",
                       cache->dir, (unsigned long long)size,
                       (unsigned long long)cache->quota_bytes);
    if (!lock(cache, err))
        return false;
    bool kept = exists(cache, name, size) || (make_room(cache, size + END_PADDING, err) &&
                                              write_object(cache, name, data, size, err));
    unlock(cache);
    return kept;
}

bool cache_default_dir(char *path, size_t size)
{
    const char *base = getenv("XDG_CACHE_HOME");
    const char *home = getenv("HOME");
    int length;
    if (base != NULL && base[0] == '/')
        length = snprintf(path, size, "%s/pathfarm", base);
    else if (home != NULL && home[0] == '/')
        length = snprintf(path, size, "%s/.cache/pathfarm", home);
    else
        return false;
    return length > 0 && (size_t)length < size;
}
