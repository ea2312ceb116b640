#include "master/growing.h"

#include "common/pages.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PADDING 16
#define LARGE   ((size_t)16 << 20) /* bytes from which on pages are wished for */

static bool resize(struct growing *array, size_t capacity, size_t size)
{
    size_t bytes;
    if (__builtin_mul_overflow(capacity, size, &bytes) || bytes > SIZE_MAX / 2)
        return false;
    void *data = realloc(array->data, bytes + PADDING);
    if (data == NULL)
        return false;
    array->data = data;
    array->capacity = capacity;
    if (bytes >= LARGE)
        pages_prefer_huge(data, bytes);
    return true;
}

bool growing_reserve(struct growing *array, size_t more, size_t size)
{
    if (more > SIZE_MAX / 2 - array->count)
        return false;
    size_t wanted = array->count + more;
    if (wanted <= array->capacity && array->data != NULL)
        return true;
    size_t roomy = array->capacity + array->capacity / 2 + 4;
    return resize(array, wanted > roomy ? wanted : roomy, size);
}

void *growing_add(struct growing *array, size_t more, size_t size)
{
    if (!growing_reserve(array, more, size))
        return NULL;
    unsigned char *added = (unsigned char *)array->data + array->count * size;
    array->count += more;
    return added;
}

void growing_trim(struct growing *array, size_t size)
{
    if (array->data == NULL)
        return;
    resize(array, array->count, size); /* when it fails the larger piece serves as well */
    memset((unsigned char *)array->data + array->count * size, 0, PADDING);
}

void growing_free(struct growing *array)
{
    free(array->data);
    *array = (struct growing){ 0 };
}
