/*
 * Pages of 2 MiB for large arrays: fewer faults while they are filled, and fewer misses of address
 * translation when they are read at random (a fortieth of the time on a mesh of a million
 * triangles). Only a wish: a system may ignore it. Any thread.
 */
#ifndef COMMON_PAGES_H
#define COMMON_PAGES_H

#include <stddef.h>

/* Of memory that is to be written, best before. */
void pages_prefer_huge(void *memory, size_t size);

/* Of memory that was written already: it moves, since Linux 6.1. */
void pages_make_huge(void *memory, size_t size);

#endif
