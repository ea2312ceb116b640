#include "master/accuracy_measure.h"

#include "common/err.h"
#include "master/image.h"

#include <math.h>

#define CHANNELS 3

static const char *const COLORS[CHANNELS] = { "R", "G", "B" };
static const char *const ERRORS[CHANNELS] = { "stderr.R", "stderr.G", "stderr.B" };

static double relative(double value)
{
    return 1 / (value * value + ACCURACY_EPSILON);
}

/* Sums over pixels. The error of a mean over few pixels of many is that of all: no correction. */
struct sums {
    double n, relmse, variance, bias2, bias2_squares, relmse_noise;
};

/* The variance of a reference's pixel in one channel; 0 where it does not say */
static double reference_variance(const float *error, size_t pixel)
{
    double e = error == NULL ? 0 : (double)error[pixel];
    return isfinite(e) ? e * e : 0;
}

/* One pixel; false when it is not finite somewhere. `values` are the planes of picture s at
 * [s * CHANNELS]. */
static bool add_pixel(struct sums *sums, const float *const *values, size_t count,
                      const float *const *truth, const float *const *errors, size_t pixel)
{
    double mean_error = 0, error_squares = 0, variance = 0, noise = 0;
    for (size_t s = 0; s < count; s++) {
        double error = 0; /* squared, of this picture */
        for (int c = 0; c < CHANNELS; c++) {
            double r = (double)truth[c][pixel], d = (double)values[s * CHANNELS + c][pixel] - r;
            error += d * d * relative(r) / CHANNELS;
        }
        if (!isfinite(error))
            return false;
        double step = error - mean_error;
        mean_error += step / (double)(s + 1);
        error_squares += step * (error - mean_error);
    }
    for (int c = 0; c < CHANNELS; c++) {
        double mean = 0, squares = 0, r = (double)truth[c][pixel];
        for (size_t s = 0; s < count; s++) {
            double x = (double)values[s * CHANNELS + c][pixel], step = x - mean;
            mean += step / (double)(s + 1);
            squares += step * (x - mean);
        }
        if (count > 1)
            variance += squares / (double)(count - 1) * relative(r) / CHANNELS;
        noise += reference_variance(errors[c], pixel) * relative(r) / CHANNELS;
    }
    double bias2 = mean_error - noise - variance, step = bias2 - sums->bias2;
    sums->n++;
    sums->bias2 += step / sums->n;
    sums->bias2_squares += step * (bias2 - sums->bias2);
    sums->relmse += (mean_error - noise - sums->relmse) / sums->n;
    sums->variance += (variance - sums->variance) / sums->n;
    if (count > 1)
        sums->relmse_noise += error_squares / (double)(count - 1) / (double)count;
    return true;
}

/* The planes of three channels. False with ERR_ARGUMENT when one is missing. */
static bool planes_of(const struct image *image, const float **planes, struct err *err)
{
    for (int c = 0; c < CHANNELS; c++) {
        planes[c] = image_channel(image, COLORS[c]);
        if (planes[c] == NULL)
            return err_set(err, ERR_ARGUMENT, "a picture without channel %s", COLORS[c]);
    }
    return true;
}

static bool same_window(const struct image *a, const struct image *b)
{
    return a->width == b->width && a->height == b->height && a->data_x == b->data_x &&
           a->data_y == b->data_y;
}

bool accuracy_measure_pictures(const struct image *const *pictures, size_t count,
                               const struct image *reference, struct accuracy_point *out,
                               struct err *err)
{
    enum { PICTURES_MAX = 64 };
    const float *values[PICTURES_MAX * CHANNELS], *truth[CHANNELS], *errors[CHANNELS];
    if (count == 0 || count > PICTURES_MAX)
        return err_set(err, ERR_ARGUMENT, "%zu pictures; 1 to %d can be measured", count,
                       PICTURES_MAX);
    for (size_t s = 0; s < count; s++) {
        if (!same_window(pictures[s], reference))
            return err_set(err, ERR_ARGUMENT, "a picture of %ux%u pixels, and a reference of %ux%u",
                           pictures[s]->width, pictures[s]->height, reference->width,
                           reference->height);
        if (!planes_of(pictures[s], values + s * CHANNELS, err))
            return false;
    }
    if (!planes_of(reference, truth, err))
        return err_wrap(err, "the reference");
    for (int c = 0; c < CHANNELS; c++)
        errors[c] = image_channel(reference, ERRORS[c]);

    struct sums sums = { 0 };
    const size_t pixels = (size_t)reference->width * reference->height;
    for (size_t pixel = 0; pixel < pixels; pixel++)
        add_pixel(&sums, values, count, truth, errors, pixel);
    bool several = count > 1;
    *out = (struct accuracy_point){
        .relmse = sums.n > 0 ? sums.relmse : NAN,
        .relmse_error = several ? sqrt(sums.relmse_noise) / sums.n : NAN,
        .variance = several ? sums.variance : NAN,
        .bias2 = several ? sums.bias2 : NAN,
        .bias2_error = several && sums.n > 1 ? sqrt(sums.bias2_squares / (sums.n - 1) / sums.n)
                                             : NAN,
        .pixels = (uint64_t)sums.n,
        .skipped = pixels - (uint64_t)sums.n,
    };
    return true;
}

double accuracy_measure_reference(const struct image *reference)
{
    const float *truth[CHANNELS], *errors[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) {
        truth[c] = image_channel(reference, COLORS[c]);
        errors[c] = image_channel(reference, ERRORS[c]);
        if (truth[c] == NULL || errors[c] == NULL)
            return NAN;
    }
    double sum = 0, n = 0;
    for (size_t pixel = 0; pixel < (size_t)reference->width * reference->height; pixel++)
        for (int c = 0; c < CHANNELS; c++) {
            double r = (double)truth[c][pixel], e = (double)errors[c][pixel];
            if (!isfinite(r) || !isfinite(e))
                continue;
            sum += e * e * relative(r);
            n++;
        }
    return n > 0 ? sum / n : NAN;
}
