/*
 * Colours: any way in which a parameter may say one (rgb, blackbody, a spectrum by name or in
 * pairs) becomes linear sRGB. Part of the pbrt reader.
 */
#ifndef MASTER_PBRT_COLOR_H
#define MASTER_PBRT_COLOR_H

#include "master/pbrt_params.h"

#include <stdbool.h>

/* What the colour is of: decides how a spectrum is weighed, and what values are possible. */
enum pbrt_color_kind { COLOR_REFLECTANCE, COLOR_LIGHT, COLOR_INDEX, COLOR_DENSITY };

/* False, and rgb untouched, when the parameter is absent or failed (params->failed). */
bool pbrt_color(struct pbrt_params *params, const char *name, enum pbrt_color_kind kind,
                double rgb[3]);

#endif
