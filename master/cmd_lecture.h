/* `pathfarm lecture`: the experiments of the lecture on path tracing, run here, as one page. */
#ifndef MASTER_CMD_LECTURE_H
#define MASTER_CMD_LECTURE_H

/* argv[0] is "lecture". The exit status: 0; 1 when the page cannot be written; 2 when arguments are
 * wrong. */
int cmd_lecture(int argc, char **argv);

#endif
