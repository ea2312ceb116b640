#include "master/spectrum.h"

#include "common/elem.h"

#include <string.h>

#define FIRST_NM 380
#define STEP_NM  10
#define SAMPLES  41

/* CIE 1931 2-degree colour matching functions and the relative power of D65, 380 to 780 nm */
static const struct {
    double x, y, z, d65;
} cie[SAMPLES] = {
    { .001368, .000039, .00645, 49.9755 }, { .004243, .00012, .02005, 54.6482 },
    { .01431, .000396, .06785, 82.7549 },  { .04351, .00121, .2074, 91.486 },
    { .13438, .004, .6456, 93.4318 },      { .2839, .0116, 1.3856, 86.6823 },
    { .34828, .023, 1.74706, 104.865 },    { .3362, .038, 1.77211, 117.008 },
    { .2908, .06, 1.6692, 117.812 },       { .19536, .09098, 1.28764, 114.861 },
    { .09564, .13902, .81295, 115.923 },   { .03201, .20802, .46518, 108.811 },
    { .0049, .323, .272, 109.354 },        { .0093, .503, .1582, 107.802 },
    { .06327, .71, .07825, 104.79 },       { .1655, .862, .04216, 107.689 },
    { .2904, .954, .0203, 104.405 },       { .43345, .99495, .00875, 104.046 },
    { .5945, .995, .0039, 100 },           { .7621, .952, .0021, 96.3342 },
    { .9163, .87, .00165, 95.788 },        { 1.0263, .757, .0011, 88.6856 },
    { 1.0622, .631, .0008, 90.0062 },      { 1.0026, .503, .00034, 89.5991 },
    { .85445, .381, .00019, 87.6987 },     { .6424, .265, .00005, 83.2886 },
    { .4479, .175, .00002, 83.6992 },      { .2835, .107, 0, 80.0268 },
    { .1649, .061, 0, 80.2146 },           { .0874, .032, 0, 82.2778 },
    { .04677, .017, 0, 78.2842 },          { .0227, .00821, 0, 69.7213 },
    { .011359, .004102, 0, 71.6091 },      { .00579, .002091, 0, 74.349 },
    { .002899, .001047, 0, 61.604 },       { .00144, .00052, 0, 69.8856 },
    { .00069, .000249, 0, 75.087 },        { .000332, .00012, 0, 63.5927 },
    { .000166, .00006, 0, 46.4182 },       { .000083, .00003, 0, 66.8054 },
    { .000042, .000015, 0, 63.3828 },
};

/*
 * Reflectance is not linear in eta and k: averaged ones would make aluminium 1.6 % too red, at
 * every bounce. So these are the ones that reflect, in each channel and at every angle, what the
 * metal reflects of D65. Gold is outside of sRGB: its red, above 1, is .98 here.
 */
static const struct {
    const char *name;
    double rgb[3];
} metals[] = {
    { "metal-Ag-eta", { 0.1293, 0.1253, 0.1518 } },
    { "metal-Ag-k", { 4.1093, 3.3527, 2.4176 } },
    { "metal-Al-eta", { 1.4345, 0.9302, 0.5926 } },
    { "metal-Al-k", { 7.7561, 6.6085, 5.3702 } },
    { "metal-Au-eta", { 0.1431, 0.4073, 1.5695 } },
    { "metal-Au-k", { 5.2267, 2.3480, 1.7203 } },
    { "metal-Cu-eta", { 0.1690, 0.9765, 1.2108 } },
    { "metal-Cu-k", { 3.7247, 2.6211, 2.3663 } },
    { "metal-CuZn-eta", { 0.444, 0.527, 1.094 } }, /* averaged all the same */
    { "metal-CuZn-k", { 3.695, 2.765, 1.829 } },
    { "metal-MgO-eta", { 1.73369, 1.74095, 1.75352 } }, /* Stephens and Malitson 1952 */
    { "metal-MgO-k", { 0, 0, 0 } },
    { "metal-TiO2-eta", { 2.57315, 2.65169, 2.82980 } }, /* rutile, ordinary ray: DeVore 1951 */
    { "metal-TiO2-k", { 0, 0, 0 } },
};

static const struct {
    const char *name;
    double ior;
} glasses[] = {
    { "glass-BK7", 1.51680 },   { "glass-BAF10", 1.67003 }, { "glass-FK51A", 1.48656 },
    { "glass-LASF9", 1.85025 }, { "glass-F5", 1.67270 },    { "glass-SF5", 1.67270 },
    { "glass-F10", 1.72825 },   { "glass-SF10", 1.72825 },  { "glass-F11", 1.78472 },
    { "glass-SF11", 1.78472 },
};

const char *const spectrum_names[] = {
    "metal-Ag-eta",  "metal-Ag-k",   "metal-Al-eta",   "metal-Al-k",     "metal-Au-eta",
    "metal-Au-k",    "metal-Cu-eta", "metal-Cu-k",     "metal-CuZn-eta", "metal-CuZn-k",
    "metal-MgO-eta", "metal-MgO-k",  "metal-TiO2-eta", "metal-TiO2-k",   "glass-BK7",
    "glass-BAF10",   "glass-FK51A",  "glass-LASF9",    "glass-F5",       "glass-SF5",
    "glass-F10",     "glass-SF10",   "glass-F11",      "glass-SF11",     "stdillum-D65",
    "stdillum-A",    NULL,
};

/* Linear sRGB (IEC 61966-2-1, D65) from XYZ */
static void rgb_from_xyz(const double xyz[3], double rgb[3])
{
    rgb[0] = 3.2404542 * xyz[0] - 1.5371385 * xyz[1] - 0.4985314 * xyz[2];
    rgb[1] = -0.9692660 * xyz[0] + 1.8760108 * xyz[1] + 0.0415560 * xyz[2];
    rgb[2] = 0.0556434 * xyz[0] - 0.2040259 * xyz[1] + 1.0572252 * xyz[2];
}

/* Add up values[i] times the matching functions, times D65 where `lit` */
static void xyz_of(const double values[SAMPLES], bool lit, double xyz[3])
{
    xyz[0] = xyz[1] = xyz[2] = 0;
    for (int i = 0; i < SAMPLES; i++) {
        double value = values[i] * (lit ? cie[i].d65 : 1);
        xyz[0] += value * cie[i].x;
        xyz[1] += value * cie[i].y;
        xyz[2] += value * cie[i].z;
    }
}

static bool light_of(const double values[SAMPLES], double rgb[3])
{
    double xyz[3];
    xyz_of(values, false, xyz);
    if (!(xyz[1] > 0) || !(xyz[1] < 1e300))
        return false;
    double scaled[3] = { xyz[0] / xyz[1], 1, xyz[2] / xyz[1] };
    rgb_from_xyz(scaled, rgb);
    for (int c = 0; c < 3; c++)
        rgb[c] = rgb[c] > 0 ? rgb[c] : 0;
    return true;
}

/* Averages under D65, scaled so that a constant c gives exactly c c c but for rounding */
static void average_of(const double values[SAMPLES], double rgb[3])
{
    double ones[SAMPLES], xyz[3], white_xyz[3], white[3];
    for (int i = 0; i < SAMPLES; i++)
        ones[i] = 1;
    xyz_of(values, true, xyz);
    xyz_of(ones, true, white_xyz);
    rgb_from_xyz(xyz, rgb);
    rgb_from_xyz(white_xyz, white);
    for (int c = 0; c < 3; c++)
        rgb[c] /= white[c];
}

static void resample(const double *pairs, size_t count, bool ends_in_zero, double values[SAMPLES])
{
    size_t right = 0;
    for (int i = 0; i < SAMPLES; i++) {
        double nm = FIRST_NM + STEP_NM * i;
        while (right < count && pairs[2 * right] < nm)
            right++;
        if (count == 0)
            values[i] = 0;
        else if (right == count)
            values[i] = ends_in_zero ? 0 : pairs[2 * count - 1];
        else if (pairs[2 * right] == nm)
            values[i] = pairs[2 * right + 1];
        else if (right == 0)
            values[i] = ends_in_zero ? 0 : pairs[1];
        else {
            const double *a = pairs + 2 * (right - 1), *b = pairs + 2 * right;
            double t = (nm - a[0]) / (b[0] - a[0]);
            values[i] = (1 - t) * a[1] + t * b[1];
        }
    }
}

bool spectrum_light(const double *pairs, size_t count, double rgb[3])
{
    double values[SAMPLES];
    resample(pairs, count, true, values);
    return light_of(values, rgb);
}

bool spectrum_blackbody(double kelvin, double rgb[3])
{
    if (!(kelvin >= 100 && kelvin <= 1e6))
        return false;
    double values[SAMPLES];
    const double c2 = 0.014387768775 * 1e9; /* second radiation constant, nm K */
    for (int i = 0; i < SAMPLES; i++) {
        /* Planck's law relative to 780 nm, so that cold bodies do not underflow */
        double nm = FIRST_NM + STEP_NM * i, ratio = 780 / nm;
        double x = c2 / (nm * kelvin), x780 = c2 / (780 * kelvin);
        values[i] = ratio * ratio * ratio * ratio * ratio * elem_exp(x780 - x) *
                    (1 - elem_exp(-x780)) / (1 - elem_exp(-x));
    }
    return light_of(values, rgb);
}

void spectrum_reflectance(const double *pairs, size_t count, double rgb[3])
{
    double values[SAMPLES];
    resample(pairs, count, false, values);
    average_of(values, rgb);
}

void spectrum_index(const double *pairs, size_t count, double rgb[3])
{
    spectrum_reflectance(pairs, count, rgb);
}

bool spectrum_metal(const char *name, double rgb[3])
{
    for (size_t i = 0; i < sizeof(metals) / sizeof(metals[0]); i++)
        if (strcmp(name, metals[i].name) == 0) {
            memcpy(rgb, metals[i].rgb, sizeof(metals[i].rgb));
            return true;
        }
    return false;
}

bool spectrum_glass(const char *name, double *ior)
{
    for (size_t i = 0; i < sizeof(glasses) / sizeof(glasses[0]); i++)
        if (strcmp(name, glasses[i].name) == 0) {
            *ior = glasses[i].ior;
            return true;
        }
    return false;
}

bool spectrum_illuminant(const char *name, double rgb[3])
{
    if (strcmp(name, "stdillum-A") == 0)
        return spectrum_blackbody(2855.5, rgb); /* its definition, with today's c2 */
    rgb[0] = rgb[1] = rgb[2] = 1;               /* D65 is the white of sRGB */
    return strcmp(name, "stdillum-D65") == 0;
}
