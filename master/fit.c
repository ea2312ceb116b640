#include "master/fit.h"

#include "common/elem.h"

#include <math.h>

/* Sums around the weighted mean of x, so that nothing cancels */
struct fit_sums {
    double weight, x, y;
};

struct fit_line fit_line(const double *x, const double *y, const double *error, size_t count)
{
    struct fit_sums s = { 0 };
    for (size_t i = 0; i < count; i++) {
        double w = 1 / (error[i] * error[i]);
        s.weight += w;
        s.x += w * x[i];
        s.y += w * y[i];
    }
    double mean_x = s.x / s.weight, mean_y = s.y / s.weight, xx = 0, xy = 0;
    for (size_t i = 0; i < count; i++) {
        double w = 1 / (error[i] * error[i]);
        xx += w * (x[i] - mean_x) * (x[i] - mean_x);
        xy += w * (x[i] - mean_x) * (y[i] - mean_y);
    }
    struct fit_line line = { .slope = xy / xx, .slope_error = 1 / sqrt(xx) };
    line.at_zero = mean_y - line.slope * mean_x;
    for (size_t i = 0; i < count; i++) {
        double residual = (y[i] - line.at_zero - line.slope * x[i]) / error[i];
        line.chi_square += residual * residual;
    }
    return line;
}

struct fit_line fit_power(const double *x, const double *y, const double *relative_error,
                          size_t count)
{
    if (count > FIT_MAX)
        count = FIT_MAX;
    double log_x[FIT_MAX], log_y[FIT_MAX];
    for (size_t i = 0; i < count; i++) {
        log_x[i] = elem_log(x[i]);
        log_y[i] = elem_log(y[i]);
    }
    return fit_line(log_x, log_y, relative_error, count);
}
