/*
 * What the film's sensor makes of light: Film's "sensor", "iso", "whitebalance", and the time that
 * the shutter is open. Part of the pbrt reader.
 *
 * As in pbrt-v4 the picture is brighter by (shutterclose - shutteropen) * iso / 100, and white
 * balance adapts daylight of a temperature to white. Both become gains of all lights, which for
 * brightness is the same; pbrt's adaptation also mixes channels a little, which saturated colours
 * show (a note says by how much). Named cameras render as "cie1931" does: their curves are made to
 * come close to it, and are not ours to copy.
 */
#ifndef MASTER_PBRT_SENSOR_H
#define MASTER_PBRT_SENSOR_H

#include "master/pbrt_params.h"
#include "master/source_pos.h"

#include <stdbool.h>

struct pbrt_reader;

struct pbrt_sensor {
    double brightness; /* without the shutter's time */
    bool own_exposure; /* ... which does not count, then */
    double gains[3];   /* of the white balance */
};

void pbrt_sensor_start(struct pbrt_sensor *sensor);

/* Read Film's parameters that are the sensor's; failures are the list's. */
void pbrt_sensor_read(struct pbrt_params *params, struct pbrt_sensor *sensor);

/* At the end: everything that gives light gives so much more or less. */
void pbrt_sensor_finish(struct pbrt_reader *reader);

#endif
