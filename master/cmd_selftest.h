/* `pathfarm selftest`: the quick numeric checks, for a user's own machine. */
#ifndef MASTER_CMD_SELFTEST_H
#define MASTER_CMD_SELFTEST_H

/* argv[0] is "selftest". 0 when all checks hold, 1 with the failed ones named on stderr. */
int cmd_selftest(int argc, char **argv);

#endif
