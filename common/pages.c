#include "common/pages.h"

#include <linux/mman.h>
#include <stdint.h>
#include <sys/mman.h>

#define HUGE_PAGE ((uintptr_t)2 << 20)

static void advise(void *memory, size_t size, int advice)
{
    uintptr_t first = ((uintptr_t)memory + HUGE_PAGE - 1) & ~(HUGE_PAGE - 1);
    uintptr_t end = ((uintptr_t)memory + size) & ~(HUGE_PAGE - 1);
    if (memory != NULL && first < end)
        madvise((void *)first, end - first, advice);
}

void pages_prefer_huge(void *memory, size_t size)
{
    advise(memory, size, MADV_HUGEPAGE);
}

void pages_make_huge(void *memory, size_t size)
{
    advise(memory, size, MADV_HUGEPAGE);
#if defined(MADV_COLLAPSE)
    advise(memory, size, MADV_COLLAPSE);
#endif
}
