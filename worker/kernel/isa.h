/*
 * Names in what is compiled once per instruction set: KERNEL_NAME(f) is f_avx2 or f_base, as the
 * build says by KERNEL_ISA.
 */
#ifndef WORKER_KERNEL_ISA_H
#define WORKER_KERNEL_ISA_H

#define KERNEL_NAME(name)        KERNEL_NAME_2(name, KERNEL_ISA)
#define KERNEL_NAME_2(name, isa) KERNEL_NAME_3(name, isa)
#define KERNEL_NAME_3(name, isa) name##_##isa

#endif
