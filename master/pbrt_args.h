/*
 * What follows the word of a directive: a name in quotes, a fixed number of numbers, or a type in
 * quotes and a parameter list. Part of the pbrt reader. `directive` is the word's token, for the
 * error, which says what that directive wants. False: the reader's err is set.
 */
#ifndef MASTER_PBRT_ARGS_H
#define MASTER_PBRT_ARGS_H

#include "master/pbrt_state.h"

#include <stdbool.h>

bool pbrt_args_string(struct pbrt_reader *reader, const struct pbrt_token *directive,
                      struct pbrt_token *token);

/* `count` finite numbers, in brackets or without. */
bool pbrt_args_numbers(struct pbrt_reader *reader, const struct pbrt_token *directive, int count,
                       double *values);

/* The type, and into reader->params its parameters, with those that Attribute gave `target`. */
bool pbrt_args_typed(struct pbrt_reader *reader, const struct pbrt_token *directive,
                     enum pbrt_target target, struct pbrt_token *type);

#endif
