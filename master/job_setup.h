/*
 * From a command line to a job: the scene as the options change it, and the numbers that decide
 * the bits. What `render` and `plan` have in common.
 */
#ifndef MASTER_JOB_SETUP_H
#define MASTER_JOB_SETUP_H

#include "common/job.h"
#include "master/limits.h"

#include <stdbool.h>
#include <stdint.h>

struct err;
struct render_options;
struct scene;

struct job_setup {
    struct scene *scene;
    struct job_spec spec;
    uint64_t spp_asked;   /* 0: as many as other limits allow */
    uint64_t spp;         /* after whole rounds; 0: the same */
    struct limits limits; /* when it ends */
};

/* Read the scene and apply the options; what the reader has to say goes to stderr. On failure there
 * is nothing to free. */
bool job_setup_open(const struct render_options *options, struct job_setup *setup, struct err *err);
void job_setup_close(struct job_setup *setup);

const char *job_setup_sampler_name(uint32_t sampler); /* "sobol" */

#endif
