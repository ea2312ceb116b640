/*
 * LightSource, and AreaLightSource, which makes lights of the shapes after it. Part of the pbrt
 * reader. Powers and scales are worked into the radiance here, except for the power of an area
 * light, which needs its shape's area. False: the reader's err is set.
 */
#ifndef MASTER_PBRT_LIGHTS_H
#define MASTER_PBRT_LIGHTS_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

/* The parameters were read; `type` is the quoted name. */
bool pbrt_lights_add(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_lights_area(struct pbrt_reader *reader, const struct pbrt_token *type);

#endif
