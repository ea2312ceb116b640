/*
 * Colours of pbrt-v4's spaces as linear sRGB, and white balance. All by 3x3 matrices made of the
 * chromaticities of primaries and whites; a change of white is Bradford's, as in pbrt. Pure.
 */
#ifndef MASTER_COLOR_SPACE_H
#define MASTER_COLOR_SPACE_H

#include <stdbool.h>

enum color_space { COLOR_SRGB, COLOR_REC2020, COLOR_DCI_P3, COLOR_ACES2065_1 };

/*
 * Linear numbers of a space as linear sRGB; saturated ones may be negative, or above 1. Of light, 1
 * 1 1 is the space's white, which in ACES2065-1 (D60) is not sRGB's (D65); a `surface` of 1 1 1
 * reflects everything whatever the space.
 */
void color_space_to_srgb(enum color_space space, bool surface, const double rgb[3], double out[3]);

/*
 * What a sensor balanced for daylight of that temperature (a blackbody's below 4000 K, as in pbrt)
 * makes of sRGB's white: gains of the three channels. pbrt's adaptation also mixes channels;
 * *mixing, if not NULL, is the most that one takes from another. False, and the gains are 1, below
 * 1667 K or above 25000 K, where there is no such light.
 */
bool color_space_balance(double kelvin, double gains[3], double *mixing);

#endif
