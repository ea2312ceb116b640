/*
 * `pathfarm accuracy`: what accuracy costs in time, for one scene and every way of rendering it.
 */
#ifndef MASTER_CMD_ACCURACY_H
#define MASTER_CMD_ACCURACY_H

/* argv[0] is "accuracy". The exit status. */
int cmd_accuracy(int argc, char **argv);

#endif
