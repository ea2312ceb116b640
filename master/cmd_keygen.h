/* `pathfarm keygen`: make the farm's keys and certificates in a folder. */
#ifndef MASTER_CMD_KEYGEN_H
#define MASTER_CMD_KEYGEN_H

/* argv[0] is "keygen". The exit status. */
int cmd_keygen(int argc, char **argv);

#endif
