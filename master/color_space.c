#include "master/color_space.h"

#include <math.h>
#include <string.h>

/* x and y of red, green, blue and white */
static const double chromaticities[][4][2] = {
    [COLOR_SRGB] = { { .64, .33 }, { .3, .6 }, { .15, .06 }, { .3127, .329 } },
    [COLOR_REC2020] = { { .708, .292 }, { .17, .797 }, { .131, .046 }, { .3127, .329 } },
    [COLOR_DCI_P3] = { { .68, .32 }, { .265, .69 }, { .15, .06 }, { .3127, .329 } },
    [COLOR_ACES2065_1] = { { .7347, .2653 }, { 0, 1 }, { .0001, -.077 }, { .32168, .33767 } },
};

struct matrix {
    double m[3][3];
};

static const struct matrix bradford = {
    { { .8951, .2664, -.1614 }, { -.7502, 1.7135, .0367 }, { .0389, -.0685, 1.0296 } }
};

static struct matrix product(const struct matrix *a, const struct matrix *b)
{
    struct matrix out;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] +
                          a->m[i][2] * b->m[2][j];
    return out;
}

static void apply(const struct matrix *a, const double v[3], double out[3])
{
    double copy[3] = { v[0], v[1], v[2] };
    for (int i = 0; i < 3; i++)
        out[i] = a->m[i][0] * copy[0] + a->m[i][1] * copy[1] + a->m[i][2] * copy[2];
}

/* By cofactors; none of ours is singular */
static struct matrix inverse(const struct matrix *a)
{
    struct matrix out;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int r = (j + 1) % 3, s = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            out.m[i][j] = a->m[r][c] * a->m[s][d] - a->m[r][d] * a->m[s][c];
        }
    double determinant = a->m[0][0] * out.m[0][0] + a->m[0][1] * out.m[1][0] +
                         a->m[0][2] * out.m[2][0];
    for (int i = 0; i < 9; i++)
        out.m[i / 3][i % 3] /= determinant;
    return out;
}

static void xyz_of(const double xy[2], double xyz[3])
{
    xyz[0] = xy[0] / xy[1];
    xyz[1] = 1;
    xyz[2] = (1 - xy[0] - xy[1]) / xy[1];
}

/* The primaries' XYZ, scaled so that they add up to the white's */
static struct matrix xyz_from(enum color_space space)
{
    const double(*xy)[2] = chromaticities[space];
    struct matrix columns;
    double white[3], share[3];
    for (int c = 0; c < 3; c++) {
        columns.m[0][c] = xy[c][0];
        columns.m[1][c] = xy[c][1];
        columns.m[2][c] = 1 - xy[c][0] - xy[c][1];
    }
    struct matrix solve = inverse(&columns);
    xyz_of(xy[3], white);
    apply(&solve, white, share);
    for (int i = 0; i < 9; i++)
        columns.m[i / 3][i % 3] *= share[i % 3];
    return columns;
}

/* XYZ under one white as they would look under another */
static struct matrix adapt(const double from[2], const double to[2])
{
    double source[3], target[3];
    xyz_of(from, source);
    xyz_of(to, target);
    apply(&bradford, source, source);
    apply(&bradford, target, target);
    struct matrix scaled = bradford, back = inverse(&bradford);
    for (int i = 0; i < 9; i++)
        scaled.m[i / 3][i % 3] *= target[i / 3] / source[i / 3];
    return product(&back, &scaled);
}

void color_space_to_srgb(enum color_space space, bool surface, const double rgb[3], double out[3])
{
    if (space == COLOR_SRGB) {
        memmove(out, rgb, 3 * sizeof(double));
        return;
    }
    struct matrix to_xyz = xyz_from(space), srgb = xyz_from(COLOR_SRGB);
    struct matrix from_xyz = inverse(&srgb);
    apply(&to_xyz, rgb, out);
    if (surface) {
        struct matrix white = adapt(chromaticities[space][3], chromaticities[COLOR_SRGB][3]);
        apply(&white, out, out);
    }
    apply(&from_xyz, out, out);
}

/* CIE 15's daylight locus, and for lower temperatures Kim et al.'s fit of Planck's */
static void chromaticity(double kelvin, double xy[2])
{
    double t = 1e3 / kelvin, x;
    if (kelvin >= 4000) {
        t *= 1.4380 / 1.4388; /* the constant of radiation was another when the locus was fitted */
        x = kelvin <= 7000 ? ((-4.6070 * t + 2.9678) * t + 0.09911) * t + 0.244063
                           : ((-2.0064 * t + 1.9018) * t + 0.24748) * t + 0.237040;
        xy[1] = (-3 * x + 2.870) * x - 0.275;
    } else {
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910;
        xy[1] = kelvin <= 2222 ? ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
                               : ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867;
    }
    xy[0] = x;
}

bool color_space_balance(double kelvin, double gains[3], double *mixing)
{
    const double white[3] = { 1, 1, 1 };
    double xy[2], most = 0;
    gains[0] = gains[1] = gains[2] = 1;
    if (mixing != NULL)
        *mixing = 0;
    if (!(kelvin >= 1667 && kelvin <= 25000))
        return false;
    chromaticity(kelvin, xy);
    struct matrix balance = adapt(xy, chromaticities[COLOR_SRGB][3]);
    struct matrix to_xyz = xyz_from(COLOR_SRGB), from_xyz = inverse(&to_xyz);
    balance = product(&balance, &to_xyz);
    balance = product(&from_xyz, &balance);
    apply(&balance, white, gains);
    for (int i = 0; i < 9; i++)
        if (i % 4 != 0)
            most = fmax(most, fabs(balance.m[i / 3][i % 3]));
    if (mixing != NULL)
        *mixing = most;
    return true;
}
