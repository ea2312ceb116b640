/*
 * The report of a render (--report), collected from all who know a part of it.
 */
#ifndef MASTER_RENDER_SUMMARY_H
#define MASTER_RENDER_SUMMARY_H

#include <stdbool.h>

struct bundle;
struct err;
struct farm;
struct film;
struct job_setup;

struct render_summary {
    const char *command, *build, *scene_name;
    const struct job_setup *setup;
    const struct bundle *bundle;
    const struct film *film;
    const struct farm *farm;
};

/* Write the file. False: ERR_MEMORY or ERR_IO. */
bool render_summary_write(const struct render_summary *summary, const char *path, struct err *err);

#endif
