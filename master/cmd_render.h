/* `pathfarm render SCENE -o OUT.exr`: one job, from start to end, by this process's workers. */
#ifndef MASTER_CMD_RENDER_H
#define MASTER_CMD_RENDER_H

/* argv[0] is "render". The exit status: 0 done, 1 the job failed, 2 arguments or scene wrong. */
int cmd_render(int argc, char **argv);

#endif
