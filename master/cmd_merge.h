/* `pathfarm merge A.exr B.exr ... -o OUT.exr`: pictures of one job with different seeds, joined. */
#ifndef MASTER_CMD_MERGE_H
#define MASTER_CMD_MERGE_H

/* The command with its arguments, argv[0] being its name; returns the exit status. */
int cmd_merge(int argc, char **argv);

#endif
