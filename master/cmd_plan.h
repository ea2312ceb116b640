/* `pathfarm plan SCENE`: what rendering a scene would involve, without doing it. */
#ifndef MASTER_CMD_PLAN_H
#define MASTER_CMD_PLAN_H

/* argv[0] is "plan". The exit status: 0, or 2 when arguments or scene are wrong. */
int cmd_plan(int argc, char **argv);

#endif
