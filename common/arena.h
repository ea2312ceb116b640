/*
 * Memory that is freed all at once. A scene lives in one arena, a reader's scratch in another.
 *
 * Every allocation is zeroed, aligned to 64 bytes and followed by at least 16 readable zero bytes,
 * so that vector loads at the end of an array (Embree's, ours) stay inside it.
 * Thread: an arena belongs to one thread at a time.
 */
#ifndef COMMON_ARENA_H
#define COMMON_ARENA_H

#include <stdbool.h>
#include <stddef.h>

struct arena;

/* NULL when memory runs out. arena_free(NULL) does nothing. */
struct arena *arena_new(void);
void arena_free(struct arena *arena);

/* `count` elements of `size` bytes; NULL when memory runs out or the product overflows. */
void *arena_alloc(struct arena *arena, size_t count, size_t size);

/* A copy of `length` bytes of text, with a zero byte after them; NULL when memory runs out. */
char *arena_text(struct arena *arena, const char *text, size_t length);

/* From now on `release(memory)` is called when the arena is freed: for arrays that grew on the
 * heap, and for mapped files. On failure false is returned, and the memory is still the caller's.
 */
bool arena_adopt(struct arena *arena, void *memory, void (*release)(void *memory));

/* Forget all allocations, so that the memory can be used again. Adopted memory is released. */
void arena_reset(struct arena *arena);

#endif
