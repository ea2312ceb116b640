#include "worker/memory.h"

#include <inttypes.h>
#include <stdio.h>
#include <uv.h>

/* The number in a file that has just one, as control groups do; UINT64_MAX for "max" or no file. */
static uint64_t number_in(const char *path)
{
    uint64_t number = UINT64_MAX;
    FILE *file = fopen(path, "re");
    if (file == NULL)
        return UINT64_MAX;
    if (fscanf(file, "%" SCNu64, &number) != 1)
        number = UINT64_MAX;
    fclose(file);
    return number;
}

/* A container sees its own control group at the root of this tree; elsewhere the file is absent */
static uint64_t group_limit(void)
{
    return number_in("/sys/fs/cgroup/memory.max");
}

static uint64_t group_used(void)
{
    uint64_t used = number_in("/sys/fs/cgroup/memory.current");
    return used == UINT64_MAX ? 0 : used;
}

static uint64_t machine_available(void)
{
    uint64_t kib = UINT64_MAX;
    char line[256];
    FILE *file = fopen("/proc/meminfo", "re");
    if (file == NULL)
        return UINT64_MAX;
    while (kib == UINT64_MAX && fgets(line, sizeof(line), file) != NULL)
        if (sscanf(line, "MemAvailable: %" SCNu64, &kib) != 1)
            kib = UINT64_MAX;
    fclose(file);
    return kib == UINT64_MAX ? UINT64_MAX : kib * 1024;
}

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

uint64_t memory_total(void)
{
    uint64_t machine = uv_get_total_memory();
    return smaller(machine == 0 ? UINT64_MAX : machine, group_limit());
}

uint64_t memory_available(void)
{
    uint64_t limit = group_limit(), used = group_used();
    uint64_t in_group = limit == UINT64_MAX ? UINT64_MAX : limit > used ? limit - used : 0;
    return smaller(machine_available(), in_group);
}

uint64_t memory_resident(void)
{
    size_t bytes;
    return uv_resident_set_memory(&bytes) == 0 ? bytes : 0;
}
