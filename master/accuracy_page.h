/*
 * `pathfarm accuracy` for people: one plot as a file, and a page with plots, tables and crops that
 * explains itself.
 */
#ifndef MASTER_ACCURACY_PAGE_H
#define MASTER_ACCURACY_PAGE_H

#include <stdbool.h>
#include <stdio.h>

struct accuracy_peers;
struct accuracy_study;
struct err;

/* What is said about the renders as a whole */
struct accuracy_facts {
    const char *scene, *command;
    double core_s; /* that each way of rendering had */
};

/* relMSE over core-seconds of all curves, as SVG. Failures are the stream's (ferror). */
void accuracy_page_plot(const struct accuracy_study *study, const struct accuracy_peers *peers,
                        FILE *out);

/* The page, as a file that appears whole or not at all. */
bool accuracy_page_write(const struct accuracy_study *study, const struct accuracy_peers *peers,
                         const struct accuracy_facts *facts, const char *path, struct err *err);

#endif
