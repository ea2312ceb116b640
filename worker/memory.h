/*
 * How much memory there is, in bytes. A container's limit counts where there is one. Linux tells;
 * where nothing can be learned the answer is UINT64_MAX ("no limit known").
 */
#ifndef WORKER_MEMORY_H
#define WORKER_MEMORY_H

#include <stdint.h>

uint64_t memory_total(void);     /* of the machine, or the limit this process is under */
uint64_t memory_available(void); /* what could be taken now without swapping */
uint64_t memory_resident(void);  /* of this process; 0 when unknown */

#endif
