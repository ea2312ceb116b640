/*
 * An array that grows, with its elements on the heap: what readers collect before they know how
 * much there is. Large ones grow by moving pages, not bytes (realloc), and always keep 16 zero
 * bytes behind the last element, so that the finished array can be handed to a scene's arena.
 */
#ifndef MASTER_GROWING_H
#define MASTER_GROWING_H

#include <stdbool.h>
#include <stddef.h>

struct growing {
    void *data;
    size_t count, capacity; /* elements */
};

/* Make room for `more` elements of `size` bytes beyond `count`; false when memory runs out. */
bool growing_reserve(struct growing *array, size_t more, size_t size);

/* Add `more` elements and return the first of them, not initialised; NULL when memory runs out. */
void *growing_add(struct growing *array, size_t more, size_t size);

/* Give back what was reserved too much, and zero the padding. */
void growing_trim(struct growing *array, size_t size);

void growing_free(struct growing *array);

#endif
