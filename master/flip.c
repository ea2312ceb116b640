#include "master/flip.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Three planes of one size: an image in some colour space. */
struct planes {
    uint32_t width, height;
    float *plane[3];
};

static bool planes_new(struct planes *planes, uint32_t width, uint32_t height)
{
    size_t pixels = (size_t)width * height;
    *planes = (struct planes){ .width = width, .height = height };
    planes->plane[0] = malloc(3 * pixels * sizeof(float));
    if (planes->plane[0] == NULL)
        return false;
    planes->plane[1] = planes->plane[0] + pixels;
    planes->plane[2] = planes->plane[1] + pixels;
    return true;
}

static void planes_free(struct planes *planes)
{
    free(planes->plane[0]);
}

/* ---- colours ---- */

/* Linear sRGB <-> XYZ, D65, rows sum to the white point */
static const double xyz_of_rgb[3][3] = {
    { 10135552.0 / 24577794.0, 8788810.0 / 24577794.0, 4435075.0 / 24577794.0 },
    { 2613072.0 / 12288897.0, 8788810.0 / 12288897.0, 887015.0 / 12288897.0 },
    { 1425312.0 / 73733382.0, 8788810.0 / 73733382.0, 70074185.0 / 73733382.0 },
};
static const double rgb_of_xyz[3][3] = {
    { 3.241003275, -1.537398934, -0.498615861 },
    { -0.969224334, 1.875930071, 0.041554224 },
    { 0.055639423, -0.204011202, 1.057148933 },
};

static void transform(const double matrix[3][3], const double in[3], double out[3])
{
    for (int row = 0; row < 3; row++)
        out[row] = matrix[row][0] * in[0] + matrix[row][1] * in[1] + matrix[row][2] * in[2];
}

/* XYZ relative to the white point, so that white is (1, 1, 1) */
static void relative_xyz(const double rgb[3], double xyz[3])
{
    transform(xyz_of_rgb, rgb, xyz);
    for (int i = 0; i < 3; i++)
        xyz[i] /= xyz_of_rgb[i][0] + xyz_of_rgb[i][1] + xyz_of_rgb[i][2];
}

/* YyCxCz, the linearised CIELAB in which the contrast sensitivity functions are given */
static void opponent_of_rgb(const double rgb[3], double opponent[3])
{
    double xyz[3];
    relative_xyz(rgb, xyz);
    opponent[0] = 116 * xyz[1] - 16;
    opponent[1] = 500 * (xyz[0] - xyz[1]);
    opponent[2] = 200 * (xyz[1] - xyz[2]);
}

static void rgb_of_opponent(const double opponent[3], double rgb[3])
{
    double y = (opponent[0] + 16) / 116;
    double xyz[3] = { y + opponent[1] / 500, y, y - opponent[2] / 200 };
    for (int i = 0; i < 3; i++)
        xyz[i] *= xyz_of_rgb[i][0] + xyz_of_rgb[i][1] + xyz_of_rgb[i][2];
    transform(rgb_of_xyz, xyz, rgb);
}

static double lab_curve(double t)
{
    const double delta = 6.0 / 29;
    return t > delta * delta * delta ? cbrt(t) : t / (3 * delta * delta) + 4.0 / 29;
}

/* CIELAB with Hunt's adjustment: chroma counts less where it is dark */
static void hunt_lab(const double rgb[3], double lab[3])
{
    double xyz[3];
    relative_xyz(rgb, xyz);
    double x = lab_curve(xyz[0]), y = lab_curve(xyz[1]), z = lab_curve(xyz[2]);
    lab[0] = 116 * y - 16;
    lab[1] = 0.01 * lab[0] * 500 * (x - y);
    lab[2] = 0.01 * lab[0] * 200 * (y - z);
}

static double hyab(const double a[3], const double b[3])
{
    double da = a[1] - b[1], db = a[2] - b[2];
    return fabs(a[0] - b[0]) + sqrt(da * da + db * db);
}

/* ---- what the eye sees; symbols of the paper ---- */

/* Convolve a plane with a kernel of 2 radius + 1 taps along x, or along y; edges are repeated. */
static void convolve(const float *in, float *out, uint32_t width, uint32_t height,
                     const double *kernel, int radius, bool along_x)
{
    for (uint32_t y = 0; y < height; y++) {
        for (uint32_t x = 0; x < width; x++) {
            double sum = 0;
            for (int k = -radius; k <= radius; k++) {
                int64_t at = (int64_t)(along_x ? x : y) + k;
                int64_t last = (int64_t)(along_x ? width : height) - 1;
                at = at < 0 ? 0 : at > last ? last : at;
                size_t from = along_x ? (size_t)y * width + (size_t)at : (size_t)at * width + x;
                sum += kernel[k + radius] * (double)in[from];
            }
            out[(size_t)y * width + x] = (float)sum;
        }
    }
}

/*
 * Contrast sensitivity: in the spatial domain a sum of two Gaussians
 * a sqrt(pi/b) exp(-pi^2 d^2 / b) per opponent channel, d in degrees (equation 2, table 1).
 */
static const struct {
    double a[2], b[2];
} sensitivity[3] = {
    { { 1, 0 }, { 0.0047, 1e-5 } },
    { { 1, 0 }, { 0.0053, 1e-5 } },
    { { 34.1, 13.5 }, { 0.04, 0.025 } },
};

/*
 * Filter the opponent planes as the eye does and leave linear RGB in [0, 1] in `image`. A sum of
 * two Gaussians is not separable, each of them is. `scratch` has two planes' room to spare.
 */
static void filter_by_sensitivity(struct planes *image, struct planes *scratch, double *kernel,
                                  int radius, double pixels_per_degree)
{
    uint32_t width = image->width, height = image->height;
    size_t pixels = (size_t)width * height;
    for (int c = 0; c < 3; c++) {
        double total = 0, weight[2];
        for (int g = 0; g < 2; g++) {
            double line = 0;
            for (int k = -radius; k <= radius; k++)
                line += exp(-M_PI * M_PI * k * k /
                            (pixels_per_degree * pixels_per_degree * sensitivity[c].b[g]));
            weight[g] = sensitivity[c].a[g] * sqrt(M_PI / sensitivity[c].b[g]) * line * line;
            total += weight[g];
        }

        float *sum = scratch->plane[0];
        memset(sum, 0, pixels * sizeof(float));
        for (int g = 0; g < 2; g++) {
            if (weight[g] == 0)
                continue;
            double line = 0;
            for (int k = -radius; k <= radius; k++)
                line += kernel[k + radius] = exp(
                    -M_PI * M_PI * k * k /
                    (pixels_per_degree * pixels_per_degree * sensitivity[c].b[g]));
            for (int k = 0; k <= 2 * radius; k++)
                kernel[k] /= line;
            convolve(image->plane[c], scratch->plane[1], width, height, kernel, radius, true);
            convolve(scratch->plane[1], scratch->plane[2], width, height, kernel, radius, false);
            for (size_t p = 0; p < pixels; p++)
                sum[p] += (float)(weight[g] / total) * scratch->plane[2][p];
        }
        memcpy(image->plane[c], sum, pixels * sizeof(float));
    }

    for (size_t p = 0; p < pixels; p++) {
        double opponent[3], rgb[3];
        for (int c = 0; c < 3; c++)
            opponent[c] = (double)image->plane[c][p];
        rgb_of_opponent(opponent, rgb);
        for (int c = 0; c < 3; c++)
            image->plane[c][p] = (float)fmin(fmax(rgb[c], 0), 1);
    }
}

/*
 * The derivative kernels of the feature detectors along one axis: order 1 for edges, 2 for points,
 * order 0 the Gaussian across. Positive and negative taps are normalised to 1 each.
 */
static void feature_kernel(double *kernel, int radius, double sigma, int order)
{
    double positive = 0, negative = 0;
    for (int k = -radius; k <= radius; k++) {
        double g = exp(-k * k / (2 * sigma * sigma));
        double tap = order == 0 ? g : order == 1 ? -k * g : (k * k / (sigma * sigma) - 1) * g;
        kernel[k + radius] = tap;
        positive += fmax(tap, 0);
        negative -= fmin(tap, 0);
    }
    for (int k = 0; k <= 2 * radius; k++)
        kernel[k] /= kernel[k] > 0 ? positive : negative > 0 ? negative : 1;
}

/* The strength of edges (order 1) or points (order 2) of a plane of Y in [0, 1], into `strength`.
 */
static void detect_features(const float *y, float *strength, struct planes *scratch,
                            const double *across, const double *along, int radius)
{
    uint32_t width = scratch->width, height = scratch->height;
    convolve(y, scratch->plane[0], width, height, across, radius, false);
    convolve(scratch->plane[0], scratch->plane[1], width, height, along, radius, true);
    convolve(y, scratch->plane[0], width, height, across, radius, true);
    convolve(scratch->plane[0], scratch->plane[2], width, height, along, radius, false);
    for (size_t p = 0; p < (size_t)width * height; p++) {
        double dx = (double)scratch->plane[1][p], dy = (double)scratch->plane[2][p];
        strength[p] = (float)sqrt(dx * dx + dy * dy);
    }
}

/* What an eye makes of a picture of so many pixels per degree; and memory to compute it in */
struct eye {
    double pixels_per_degree, sigma; /* sigma: half the width of a feature, in pixels */
    int feature_radius, filter_radius;
    double *kernels; /* three of them, wide enough for either radius */
    struct planes scratch;
};

/* A picture as it is seen: colours, and the strength of edges and of points with Y before both */
struct seen {
    struct planes colours, features;
};

static bool eye_open(struct eye *eye, uint32_t width, uint32_t height, double pixels_per_degree)
{
    const double feature_width = 0.082; /* degrees */
    eye->pixels_per_degree = pixels_per_degree;
    eye->sigma = 0.5 * feature_width * pixels_per_degree;
    eye->feature_radius = (int)ceil(3 * eye->sigma);
    eye->filter_radius = (int)ceil(3 * sqrt(0.04 / (2 * M_PI * M_PI)) * pixels_per_degree);
    int radius = eye->feature_radius > eye->filter_radius ? eye->feature_radius
                                                          : eye->filter_radius;
    eye->kernels = malloc(3 * (2 * (size_t)radius + 1) * sizeof(double));
    return planes_new(&eye->scratch, width, height) && eye->kernels != NULL;
}

static void eye_close(struct eye *eye)
{
    planes_free(&eye->scratch);
    free(eye->kernels);
}

static void see(struct eye *eye, const float *const from[3], struct seen *seen)
{
    size_t pixels = (size_t)seen->colours.width * seen->colours.height;
    float **features = seen->features.plane;
    for (size_t p = 0; p < pixels; p++) {
        double rgb[3], opponent[3];
        for (int c = 0; c < 3; c++) /* NaN is black */
            rgb[c] = from[c][p] > 0 ? fmin((double)from[c][p], 1) : 0;
        opponent_of_rgb(rgb, opponent);
        for (int c = 0; c < 3; c++)
            seen->colours.plane[c][p] = (float)opponent[c];
        features[2][p] = (float)((opponent[0] + 16) / 116);
    }

    int radius = eye->feature_radius;
    double *across = eye->kernels, *edge = across + 2 * radius + 1, *point = edge + 2 * radius + 1;
    feature_kernel(across, radius, eye->sigma, 0);
    feature_kernel(edge, radius, eye->sigma, 1);
    feature_kernel(point, radius, eye->sigma, 2);
    detect_features(features[2], features[0], &eye->scratch, across, edge, radius);
    detect_features(features[2], features[1], &eye->scratch, across, point, radius);
    filter_by_sensitivity(&seen->colours, &eye->scratch, eye->kernels, eye->filter_radius,
                          eye->pixels_per_degree);
}

/* ---- the difference ---- */

static double mean_difference(const struct seen *test, const struct seen *reference)
{
    const double qc = 0.7, pc = 0.4, pt = 0.95, qf = 0.5;
    const struct seen *const seen[2] = { test, reference };
    size_t pixels = (size_t)test->colours.width * test->colours.height;

    /* The largest colour difference there is: green against blue */
    double green[3], blue[3];
    hunt_lab((const double[3]){ 0, 1, 0 }, green);
    hunt_lab((const double[3]){ 0, 0, 1 }, blue);
    const double c_max = pow(hyab(green, blue), qc);

    double sum = 0;
    for (size_t p = 0; p < pixels; p++) {
        double lab[2][3], feature = 0;
        for (int i = 0; i < 2; i++) {
            double rgb[3];
            for (int c = 0; c < 3; c++)
                rgb[c] = (double)seen[i]->colours.plane[c][p];
            hunt_lab(rgb, lab[i]);
        }
        /* Spread the small colour differences over [0, pt], squeeze the large ones into the rest */
        double colour = pow(hyab(lab[0], lab[1]), qc);
        colour = colour < pc * c_max ? pt / (pc * c_max) * colour
                                     : pt + (colour - pc * c_max) / (c_max - pc * c_max) * (1 - pt);

        for (int f = 0; f < 2; f++) /* edges, points */
            feature = fmax(feature, fabs((double)reference->features.plane[f][p] -
                                         (double)test->features.plane[f][p]));
        feature = pow(feature / sqrt(2), qf);
        sum += pow(fmin(colour, 1), 1 - fmin(feature, 1));
    }
    return sum / (double)pixels;
}

double flip_mean(const float *const test[3], const float *const reference[3], uint32_t width,
                 uint32_t height, double pixels_per_degree)
{
    struct eye eye = { 0 };
    struct seen seen[2] = { 0 };
    double result = NAN;
    if (width == 0 || height == 0)
        return result;
    bool room = eye_open(&eye, width, height, pixels_per_degree);
    for (int i = 0; i < 2; i++)
        room = planes_new(&seen[i].colours, width, height) &&
               planes_new(&seen[i].features, width, height) && room;
    if (room) {
        see(&eye, test, &seen[0]);
        see(&eye, reference, &seen[1]);
        result = mean_difference(&seen[0], &seen[1]);
    }
    for (int i = 0; i < 2; i++) {
        planes_free(&seen[i].colours);
        planes_free(&seen[i].features);
    }
    eye_close(&eye);
    return result;
}
