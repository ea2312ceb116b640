#include "master/measure.h"

#include "common/err.h"
#include "master/image.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PIXELS_PER_DEGREE 67.0 /* the viewer the paper assumes: a 0.7 m wide 4K screen at 0.7 m */

static double luminance(const double rgb[3])
{
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

/* ---- LDR-FLIP: sections and symbols of the paper ---- */

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

double measure_flip(const float *const test[3], const float *const reference[3], uint32_t width,
                    uint32_t height, double pixels_per_degree)
{
    const double qc = 0.7, pc = 0.4, pt = 0.95, qf = 0.5, feature_width = 0.082;
    size_t pixels = (size_t)width * height;
    if (pixels == 0)
        return NAN;

    const double sigma = 0.5 * feature_width * pixels_per_degree;
    const int feature_radius = (int)ceil(3 * sigma);
    const int filter_radius = (int)ceil(3 * sqrt(0.04 / (2 * M_PI * M_PI)) * pixels_per_degree);
    const int radius = feature_radius > filter_radius ? feature_radius : filter_radius;

    /* image[0] is the test, image[1] the reference; features[i]: edges, points, and Y before both
     */
    struct planes image[2] = { 0 }, features[2] = { 0 }, scratch = { 0 };
    double *kernels = malloc(3 * (2 * (size_t)radius + 1) * sizeof(double));
    double result = NAN;
    bool room = planes_new(&scratch, width, height) && kernels != NULL;
    for (int i = 0; i < 2; i++)
        room = planes_new(&image[i], width, height) && planes_new(&features[i], width, height) &&
               room;
    if (!room)
        goto done;

    for (int i = 0; i < 2; i++) {
        const float *const *from = i == 0 ? test : reference;
        for (size_t p = 0; p < pixels; p++) {
            double rgb[3], opponent[3];
            for (int c = 0; c < 3; c++) /* NaN is black */
                rgb[c] = from[c][p] > 0 ? fmin((double)from[c][p], 1) : 0;
            opponent_of_rgb(rgb, opponent);
            for (int c = 0; c < 3; c++)
                image[i].plane[c][p] = (float)opponent[c];
            features[i].plane[2][p] = (float)((opponent[0] + 16) / 116);
        }

        double *across = kernels, *edge = kernels + 2 * radius + 1, *point = edge + 2 * radius + 1;
        feature_kernel(across, feature_radius, sigma, 0);
        feature_kernel(edge, feature_radius, sigma, 1);
        feature_kernel(point, feature_radius, sigma, 2);
        detect_features(features[i].plane[2], features[i].plane[0], &scratch, across, edge,
                        feature_radius);
        detect_features(features[i].plane[2], features[i].plane[1], &scratch, across, point,
                        feature_radius);
        filter_by_sensitivity(&image[i], &scratch, kernels, filter_radius, pixels_per_degree);
    }

    /* The largest colour difference there is: green against blue */
    double green[3], blue[3];
    hunt_lab((const double[3]){ 0, 1, 0 }, green);
    hunt_lab((const double[3]){ 0, 0, 1 }, blue);
    const double c_max = pow(hyab(green, blue), qc);

    double sum = 0;
    for (size_t p = 0; p < pixels; p++) {
        double lab[2][3];
        for (int i = 0; i < 2; i++) {
            double rgb[3];
            for (int c = 0; c < 3; c++)
                rgb[c] = (double)image[i].plane[c][p];
            hunt_lab(rgb, lab[i]);
        }
        /* Spread the small colour differences over [0, pt], squeeze the large ones into the rest */
        double colour = pow(hyab(lab[0], lab[1]), qc);
        colour = colour < pc * c_max ? pt / (pc * c_max) * colour
                                     : pt + (colour - pc * c_max) / (c_max - pc * c_max) * (1 - pt);

        double edges = fabs((double)features[1].plane[0][p] - (double)features[0].plane[0][p]);
        double points = fabs((double)features[1].plane[1][p] - (double)features[0].plane[1][p]);
        double feature = pow(fmax(edges, points) / sqrt(2), qf);
        sum += pow(fmin(colour, 1), 1 - fmin(feature, 1));
    }
    result = sum / (double)pixels;

done:
    for (int i = 0; i < 2; i++) {
        planes_free(&image[i]);
        planes_free(&features[i]);
    }
    planes_free(&scratch);
    free(kernels);
    return result;
}

/* ---- the plain measures ---- */

static bool find_channels(const struct image *image, const char *which,
                          const struct measure_channels *channels, const float *rgb[3],
                          struct err *err)
{
    for (int c = 0; c < 3; c++) {
        rgb[c] = image_channel(image, channels->name[c]);
        if (rgb[c] == NULL)
            return err_set(err, ERR_ARGUMENT, "%s has no channel \"%s\"", which, channels->name[c]);
    }
    return true;
}

/* Both pictures' channels, when the pictures can be laid on top of each other. */
static bool find_pair(const struct image *a, const struct image *b,
                      const struct measure_channels *channels, const float *rgb_a[3],
                      const float *rgb_b[3], struct err *err)
{
    if (a->width != b->width || a->height != b->height)
        return err_set(err, ERR_ARGUMENT,
                       "the sizes differ: %" PRIu32 "x%" PRIu32 " and %" PRIu32 "x%" PRIu32,
                       a->width, a->height, b->width, b->height);
    if (a->data_x != b->data_x || a->data_y != b->data_y)
        return err_set(err, ERR_ARGUMENT,
                       "the windows differ: they begin at %" PRId32 ",%" PRId32 " and %" PRId32
                       ",%" PRId32,
                       a->data_x, a->data_y, b->data_x, b->data_y);
    return find_channels(a, "the first image", channels, rgb_a, err) &&
           find_channels(b, "the second image", channels, rgb_b, err);
}

static bool finite_pixel(const float *const rgb[3], size_t p)
{
    return isfinite(rgb[0][p]) && isfinite(rgb[1][p]) && isfinite(rgb[2][p]);
}

bool measure_images(const struct image *a, const struct image *b,
                    const struct measure_channels *channels, struct measure *out, struct err *err)
{
    const float *rgb_a[3], *rgb_b[3];
    if (!find_pair(a, b, channels, rgb_a, rgb_b, err))
        return false;

    *out = (struct measure){ 0 };
    double squares = 0, relative_squares = 0, relative = 0;
    for (size_t p = 0; p < (size_t)a->width * a->height; p++) {
        bool fine_a = finite_pixel(rgb_a, p), fine_b = finite_pixel(rgb_b, p);
        out->nonfinite_a += !fine_a;
        out->nonfinite_b += !fine_b;
        if (!fine_a || !fine_b)
            continue;
        out->pixels++;
        for (int c = 0; c < 3; c++) {
            double x = (double)rgb_a[c][p], r = (double)rgb_b[c][p], d = x - r;
            out->mean_a[c] += x;
            out->mean_b[c] += r;
            squares += d * d;
            relative_squares += d * d / (r * r + 0.01);
            relative += fabs(d) / (fabs(r) + 0.01);
        }
    }

    double values = 3 * (double)out->pixels; /* none: 0/0 says so with NaN */
    out->rmse = sqrt(squares / values);
    out->relmse = relative_squares / values;
    out->mape = relative / values;
    for (int c = 0; c < 3; c++) {
        out->mean_a[c] /= (double)out->pixels;
        out->mean_b[c] /= (double)out->pixels;
    }
    out->flip = measure_flip(rgb_a, rgb_b, a->width, a->height, PIXELS_PER_DEGREE);
    if (isnan(out->flip))
        return err_set(err, ERR_MEMORY, "out of memory");
    return true;
}

/* The "stderr." planes of the channels; false when one is missing. */
static bool find_stderr(const struct image *image, const struct measure_channels *channels,
                        const float *planes[3])
{
    for (int c = 0; c < 3; c++) {
        char name[80];
        snprintf(name, sizeof(name), "stderr.%s", channels->name[c]);
        planes[c] = image_channel(image, name);
        if (planes[c] == NULL)
            return false;
    }
    return true;
}

struct measure_block *measure_blocks(const struct image *a, const struct image *b,
                                     const struct measure_channels *channels, uint32_t side,
                                     size_t *count, struct err *err)
{
    const float *rgb[2][3], *noise[2][3];
    if (!find_pair(a, b, channels, rgb[0], rgb[1], err))
        return NULL;
    if (side == 0) {
        err_set(err, ERR_ARGUMENT, "blocks need at least one pixel");
        return NULL;
    }
    const bool noisy[2] = { find_stderr(a, channels, noise[0]),
                            find_stderr(b, channels, noise[1]) };

    size_t across = ((size_t)a->width + side - 1) / side,
           down = ((size_t)a->height + side - 1) / side;
    struct measure_block *blocks = calloc(across * down > 0 ? across * down : 1, sizeof(*blocks));
    if (blocks == NULL) {
        err_set(err, ERR_MEMORY, "out of memory");
        return NULL;
    }
    *count = across * down;
    for (size_t i = 0; i < *count; i++) {
        struct measure_block *block = &blocks[i];
        block->x = (uint32_t)(i % across * side);
        block->y = (uint32_t)(i / across * side);
        block->width = a->width - block->x < side ? a->width - block->x : side;
        block->height = a->height - block->y < side ? a->height - block->y : side;

        double *mean[2] = { block->mean_a, block->mean_b }, variance[2] = { 0, 0 };
        for (uint32_t y = block->y; y < block->y + block->height; y++) {
            for (uint32_t x = block->x; x < block->x + block->width; x++) {
                size_t p = (size_t)y * a->width + x;
                if (!finite_pixel(rgb[0], p) || !finite_pixel(rgb[1], p))
                    continue;
                block->pixels++;
                for (int k = 0; k < 2; k++) {
                    for (int c = 0; c < 3; c++)
                        mean[k][c] += (double)rgb[k][c][p];
                    if (!noisy[k])
                        continue;
                    double error = luminance((const double[3]){
                        (double)noise[k][0][p], (double)noise[k][1][p], (double)noise[k][2][p] });
                    variance[k] += error * error;
                }
            }
        }

        double pixels = (double)block->pixels;
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++)
                mean[k][c] /= pixels;
        block->luminance_a = luminance(block->mean_a);
        block->luminance_b = luminance(block->mean_b);
        block->stderr_a = noisy[0] ? sqrt(variance[0]) / pixels : NAN;
        block->stderr_b = noisy[1] ? sqrt(variance[1]) / pixels : NAN;
    }
    return blocks;
}

bool measure_pixels_digest(const struct image *image, const struct measure_channels *channels,
                           struct digest *digest, struct err *err)
{
    const float *rgb[3];
    if (!find_channels(image, "the image", channels, rgb, err))
        return false;
    float *row = malloc((3 * (size_t)image->width + 1) * sizeof(*row));
    if (row == NULL)
        return err_set(err, ERR_MEMORY, "out of memory");

    struct digest_stream *stream = digest_begin();
    for (uint32_t y = 0; y < image->height; y++) {
        for (uint32_t x = 0; x < image->width; x++)
            for (int c = 0; c < 3; c++)
                row[3 * (size_t)x + (size_t)c] = rgb[c][(size_t)y * image->width + x];
        digest_add(stream, row, 3 * (size_t)image->width * sizeof(*row));
    }
    *digest = digest_end(stream);
    free(row);
    return true;
}
