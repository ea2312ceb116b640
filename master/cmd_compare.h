/* `pathfarm compare A.exr B.exr`: how far A is from the reference B. */
#ifndef MASTER_CMD_COMPARE_H
#define MASTER_CMD_COMPARE_H

/* argv[0] is "compare". The exit status: 0; 1 above --max-relmse; 2 when it cannot be told. */
int cmd_compare(int argc, char **argv);

#endif
