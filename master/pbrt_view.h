/*
 * How the picture is taken: Camera, Film (with its sensor) and PixelFilter. Part of the pbrt
 * reader. They may come in any order and depend on each other (the film's shape makes the screen),
 * so they are kept and put together after the last. False: the reader's err is set.
 */
#ifndef MASTER_PBRT_VIEW_H
#define MASTER_PBRT_VIEW_H

#include "common/scene.h"
#include "master/pbrt_lexer.h"
#include "master/pbrt_sensor.h"
#include "master/transform.h"

#include <stdbool.h>
#include <stdint.h>

struct pbrt_reader;

struct pbrt_view {
    enum camera_kind kind;
    struct transform world_from_camera, world_from_camera_end;
    bool moves;      /* from the one to the other */
    uint32_t medium; /* around the camera, as in struct pbrt_state */
    double shutter[2];
    struct pbrt_sensor sensor;
    bool no_jitter; /* samples stand in the middle of their pixels */
    struct source_pos pos;
    double fov;    /* radians */
    double aspect; /* 0: the film's */
    bool has_screen;
    double screen[4];
    double lens_radius, focal_distance;
    uint32_t width, height;
    double crop[4];
    bool has_pixel_bounds;
    int64_t pixel_bounds[4];
};

/* pbrt's defaults. */
void pbrt_view_start(struct pbrt_reader *reader);

/* The parameters were read; `type` is the quoted name. */
bool pbrt_view_camera(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_film(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_view_filter(struct pbrt_reader *reader, const struct pbrt_token *type);

/* All together into the scene. */
bool pbrt_view_finish(struct pbrt_reader *reader);

#endif
