/* Where in a scene file something was said; for errors. `path` lives as long as the reader. */
#ifndef MASTER_SOURCE_POS_H
#define MASTER_SOURCE_POS_H

struct source_pos {
    const char *path;
    int line, column; /* from 1 */
};

#endif
