/*
 * Names that scene text may use, in one table per kind of thing: those we render, those pbrt-v4
 * has and we do not yet, and those of pbrt-v3 with what became of them. Part of the pbrt reader.
 */
#ifndef MASTER_PBRT_NAMES_H
#define MASTER_PBRT_NAMES_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>
#include <stddef.h>

struct pbrt_reader;

enum pbrt_name_state {
    NAME_OURS,
    NAME_LATER, /* pbrt-v4 has it */
    NAME_OLD,   /* pbrt-v3 had it; `hint` says what to write now */
};

struct pbrt_name {
    const char *text;
    int value; /* the caller's */
    enum pbrt_name_state state;
    const char *hint;
};

/* The entry that is spelled like the token, or NULL. */
const struct pbrt_name *pbrt_names_find(const struct pbrt_name *names, size_t count,
                                        const struct pbrt_token *token);

/* The nearest by edit distance among entries that are NAME_OURS; NULL when there is none. */
const char *pbrt_names_nearest(const struct pbrt_name *names, size_t count,
                               const struct pbrt_token *token);

/* Steps from a string to a name of `length` characters: what "nearest" means. */
size_t pbrt_names_distance(const char *string, const char *text, size_t length);

/* The same among plain strings. */
const char *pbrt_names_nearest_of(const char *const *names, size_t count, const char *text,
                                  size_t length);

/* Look a name up and report what is wrong with it. False: an error. True and *found NULL: known to
 * pbrt, not to us, and we are lenient. `kind` is "material", "shape", ... */
bool pbrt_names_choose(struct pbrt_reader *reader, const char *kind, const struct pbrt_name *names,
                       size_t count, const struct pbrt_token *token,
                       const struct pbrt_name **found);

#endif
