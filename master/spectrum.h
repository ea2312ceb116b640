/*
 * From wavelengths to linear sRGB: blackbodies, sampled spectra, and the named metals and glasses
 * of pbrt-v4. Arithmetic is + - * / and common/elem.h, so the colours have the same bits on every
 * machine. Pure; any thread.
 *
 * Sources: CIE 1931 2-degree observer and illuminant D65 (CIE 15, tables at 10 nm); metals from
 * Palik, Handbook of Optical Constants of Solids (Al, Ag, Au), and the SOPRA tables (Cu, CuZn,
 * MgO, TiO2), as numbers per channel that reflect the same colour; glasses from the manufacturers'
 * data sheets (Schott, CDGM, Hikari), at the sodium d line, 587.56 nm.
 */
#ifndef MASTER_SPECTRUM_H
#define MASTER_SPECTRUM_H

#include <stdbool.h>
#include <stddef.h>

/*
 * Spectra are piecewise linear: `count` pairs of wavelength (nm, ascending) and value. Beyond its
 * ends a light has no power (as in pbrt-v4), and a reflectance or an index stays as it was there.
 */

/* Light of that spectrum, scaled to luminance 1. False when it has none in the visible. */
bool spectrum_light(const double *pairs, size_t count, double rgb[3]);

/* A blackbody, scaled to luminance 1; out-of-gamut negatives are zero. 100 K to 1e6 K. */
bool spectrum_blackbody(double kelvin, double rgb[3]);

/* The colour of a reflectance under D65 (a constant c gives c c c). */
void spectrum_reflectance(const double *pairs, size_t count, double rgb[3]);

/* An index of refraction or absorption per channel, averaged with the matching functions. */
void spectrum_index(const double *pairs, size_t count, double rgb[3]);

/* "metal-Cu-eta", "metal-Cu-k", ...; false when there is none of that name. */
bool spectrum_metal(const char *name, double rgb[3]);

/* "glass-BK7", ...: index of refraction at the d line; false when there is none of that name. */
bool spectrum_glass(const char *name, double *ior);

/* "stdillum-D65" and "stdillum-A", at luminance 1; false when there is none of that name. */
bool spectrum_illuminant(const char *name, double rgb[3]);

/* Every name that the three above know, NULL-terminated: for "did you mean". */
extern const char *const spectrum_names[];

#endif
