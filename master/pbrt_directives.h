/*
 * The directives of pbrt-v4 in one table: where each may stand, what follows it, and the function
 * that carries it out. Part of the pbrt reader, and its main loop.
 */
#ifndef MASTER_PBRT_DIRECTIVES_H
#define MASTER_PBRT_DIRECTIVES_H

#include <stdbool.h>

struct pbrt_reader;

/* Carry out all directives up to the end of the text that the lexer is in. False: the reader's err
 * is set. */
bool pbrt_directives_run(struct pbrt_reader *reader);

#endif
