#include "common/arena.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define ALIGNMENT  64
#define PADDING    16 /* zero bytes after every allocation */
#define BLOCK_SIZE (64 * 1024)

struct block {
    struct block *next;
    size_t size, used; /* of the bytes after the header */
    _Alignas(ALIGNMENT) unsigned char bytes[];
};

struct adopted {
    struct adopted *next;
    void *memory;
    void (*release)(void *memory);
};

struct arena {
    struct block *blocks; /* the one allocations come from is first */
    struct adopted *adopted;
};

struct arena *arena_new(void)
{
    return calloc(1, sizeof(struct arena));
}

static void release_adopted(struct arena *arena)
{
    while (arena->adopted != NULL) {
        struct adopted *adopted = arena->adopted;
        arena->adopted = adopted->next;
        adopted->release(adopted->memory);
        free(adopted);
    }
}

void arena_free(struct arena *arena)
{
    if (arena == NULL)
        return;
    release_adopted(arena);
    while (arena->blocks != NULL) {
        struct block *block = arena->blocks;
        arena->blocks = block->next;
        free(block);
    }
    free(arena);
}

static struct block *block_new(size_t size)
{
    size_t whole = sizeof(struct block) + size;
    struct block *block = aligned_alloc(ALIGNMENT, whole);
    if (block == NULL)
        return NULL;
    block->next = NULL;
    block->size = size;
    block->used = 0;
    return block;
}

void *arena_alloc(struct arena *arena, size_t count, size_t size)
{
    size_t wanted;
    if (__builtin_mul_overflow(count, size, &wanted) || wanted > SIZE_MAX / 2)
        return NULL;
    wanted = (wanted + PADDING + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;

    struct block *block = arena->blocks;
    if (block == NULL || block->size - block->used < wanted) {
        /* What is large gets a block of its own behind the first, whose rest stays in use */
        bool large = wanted > BLOCK_SIZE / 4;
        block = block_new(large ? wanted : BLOCK_SIZE);
        if (block == NULL)
            return NULL;
        if (large && arena->blocks != NULL) {
            block->next = arena->blocks->next;
            arena->blocks->next = block;
        } else {
            block->next = arena->blocks;
            arena->blocks = block;
        }
    }
    void *memory = block->bytes + block->used;
    block->used += wanted;
    return memset(memory, 0, wanted);
}

char *arena_text(struct arena *arena, const char *text, size_t length)
{
    char *copy = arena_alloc(arena, length + 1, 1);
    if (copy != NULL && length > 0)
        memcpy(copy, text, length);
    return copy;
}

bool arena_adopt(struct arena *arena, void *memory, void (*release)(void *memory))
{
    struct adopted *adopted = malloc(sizeof(*adopted));
    if (adopted == NULL)
        return false;
    *adopted = (struct adopted){ arena->adopted, memory, release };
    arena->adopted = adopted;
    return true;
}

void arena_reset(struct arena *arena)
{
    release_adopted(arena);

    /* Keep one ordinary block; large ones were made for one purpose */
    struct block *kept = NULL;
    while (arena->blocks != NULL) {
        struct block *block = arena->blocks;
        arena->blocks = block->next;
        if (kept == NULL && block->size == BLOCK_SIZE)
            kept = block;
        else
            free(block);
    }
    if (kept != NULL) {
        kept->next = NULL;
        kept->used = 0;
    }
    arena->blocks = kept;
}
