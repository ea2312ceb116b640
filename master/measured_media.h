/*
 * Media that were measured, by the names that pbrt-v4 has for them: reduced scattering and
 * absorption in 1/mm, in linear sRGB. Sources: Jensen, Marschner, Levoy and Hanrahan, "A Practical
 * Model for Subsurface Light Transport" (SIGGRAPH 2001); Narasimhan, Gupta, Donner, Ramamoorthi,
 * Nayar and Jensen, "Acquiring Scattering Properties of Participating Media by Dilution" (SIGGRAPH
 * 2006). Pure; any thread.
 */
#ifndef MASTER_MEASURED_MEDIA_H
#define MASTER_MEASURED_MEDIA_H

#include <stddef.h>

struct measured_medium {
    const char *name;
    double sigma_s[3], sigma_a[3];
};

extern const struct measured_medium measured_media[];
extern const size_t measured_media_count;

#endif
