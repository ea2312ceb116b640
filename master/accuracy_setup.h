/*
 * The ways of rendering that `pathfarm accuracy` compares: a table, a row each. All converge to the
 * same picture (but for a depth limit, which says what it cuts) and differ in noise and cost.
 */
#ifndef MASTER_ACCURACY_SETUP_H
#define MASTER_ACCURACY_SETUP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct scene;

#define ACCURACY_SETUPS_MAX 32
#define ACCURACY_ARGUMENTS  6

struct accuracy_setup {
    const char *name;                          /* in lists, tables and plots */
    const char *group;                         /* what it is one choice of */
    const char *what;                          /* a phrase */
    const char *arguments[ACCURACY_ARGUMENTS]; /* of `pathfarm render`; up to the first NULL */
    uint32_t techniques_off;                   /* that they ask for: not every scene can */
};

/* The first row is what all others are held against. */
extern const struct accuracy_setup accuracy_setup_table[];
extern const size_t accuracy_setup_count;

/*
 * Choose rows by "NAME,..." or, with NULL, all; in the order of the table, the first always among
 * them. ERR_ARGUMENT names what is not there, and the nearest that is.
 */
bool accuracy_setup_choose(const char *list, const struct accuracy_setup *chosen[], size_t *count,
                           struct err *err);

/* Why a scene cannot be rendered so, or NULL. */
const char *accuracy_setup_refusal(const struct accuracy_setup *setup, const struct scene *scene);

#endif
