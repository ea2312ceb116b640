/*
 * The pictures of LightSource "infinite", "goniometric" and "projection": what a light sends in
 * every direction. Part of the pbrt reader.
 */
#ifndef MASTER_PBRT_ENVIRONMENTS_H
#define MASTER_PBRT_ENVIRONMENTS_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>
#include <stdint.h>

struct light;
struct pbrt_reader;

enum pbrt_environment_kind { PBRT_INFINITE, PBRT_GONIOMETRIC, PBRT_PROJECTION };

struct pbrt_environment {
    enum pbrt_environment_kind kind;
    const struct pbrt_token *filename;
    double scale[3]; /* of the picture's values */
    double wanted;   /* illuminance, or power of the others, in place of a scale; 0: not given */
    double fov;      /* projection: of the picture's shorter side, radians */
};

/* A light's picture file, as an index into the scene's pictures; `single` for one channel. */
bool pbrt_environments_read(struct pbrt_reader *reader, const struct pbrt_token *filename,
                            bool single, uint32_t *index);

/* Read the picture and make it the scene's next environment, turned as the current transform says,
 * and the light's: its radiance becomes the mean over all directions. */
bool pbrt_environments_add(struct pbrt_reader *reader, const struct pbrt_environment *wish,
                           struct light *light);

#endif
