#include "worker/kernel/portal.h"

#include "common/err.h"
#include "common/scene.h"
#include "worker/kernel/environment.h"

#include <math.h>
#include <stdlib.h>

#define CELLS_MIN 16
#define CELLS_MAX 512
#define SIDE      4   /* places along each side of a cell that are looked at */
#define EVEN      0.1 /* of the mean radiance, that every direction has besides */
#define PDF_LEAST 1e-30f

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Solid angle per area of (s, t) */
static double spread(double x, double y, double z)
{
    double root = sqrt((x * x + z * z) * (y * y + z * z)) / z;
    return root * root * root;
}

/* The direction at (s, t), both inside of (-1, 1) */
static void local_direction(double s, double t, double w[3])
{
    double x = s / sqrt((1 - s) * (1 + s)), y = t / sqrt((1 - t) * (1 + t));
    double scale = 1 / sqrt(x * x + y * y + 1);
    w[0] = x * scale;
    w[1] = y * scale;
    w[2] = scale;
}

static void world_direction(const struct portal *portal, const double local[3], double w[3])
{
    for (int axis = 0; axis < 3; axis++)
        w[axis] = portal->axes[0][axis] * local[0] + portal->axes[1][axis] * local[1] +
                  portal->axes[2][axis] * local[2];
}

/* ---- opening */

/* Luminance times spread at SIDE x SIDE places of a cell, and the mean of the spread alone */
static void look_at(const struct portal *portal, const struct environment_table *table, uint32_t i,
                    uint32_t k, double *bright, double *wide)
{
    *bright = *wide = 0;
    for (uint32_t first = 0; first < SIDE * SIDE; first += LANES) {
        struct vec3x8 w;
        double spreads[LANES];
        for (uint32_t lane = 0; lane < LANES; lane++) {
            uint32_t place = first + lane;
            double s = (i + (place % SIDE + 0.5) / SIDE) / portal->size;
            double t = (k + (double)(place / SIDE + 0.5) / SIDE) / portal->size;
            double local[3], world[3];
            local_direction(2 * s - 1, 2 * t - 1, local);
            world_direction(portal, local, world);
            w.x[lane] = (float)world[0];
            w.y[lane] = (float)world[1];
            w.z[lane] = (float)world[2];
            spreads[lane] = spread(local[0], local[1], local[2]);
        }
        struct vec3x8 L = environment_radiance(table, w);
        for (uint32_t lane = 0; lane < LANES; lane++) {
            double luminance = 0.2126 * (double)L.x[lane] + 0.7152 * (double)L.y[lane] +
                               0.0722 * (double)L.z[lane];
            *bright += luminance * spreads[lane] / (SIDE * SIDE);
            *wide += spreads[lane] / (SIDE * SIDE);
        }
    }
}

/* Weights of the cells into where their sums will be; returns the mean radiance */
static double weigh(struct portal *portal, const struct environment_table *table, double *wide)
{
    const uint32_t n = portal->size;
    double bright = 0, all = 0;
    for (uint32_t k = 0; k < n; k++)
        for (uint32_t i = 0; i < n; i++) {
            double *weight = &portal->sums[(size_t)(k + 1) * (n + 1) + i + 1];
            look_at(portal, table, i, k, weight, &wide[(size_t)k * n + i]);
            bright += *weight;
            all += wide[(size_t)k * n + i];
        }
    return bright / all;
}

static void set_frame(struct portal *portal, const struct scene *scene, const struct light *light)
{
    const float *corner = scene->light_corners + 3 * (size_t)light->first_corner;
    for (int axis = 0; axis < 3; axis++) {
        portal->corner[0][axis] = (double)corner[axis];
        portal->corner[1][axis] = (double)corner[6 + axis];
        portal->axes[0][axis] = (double)corner[3 + axis] - (double)corner[axis];
        portal->axes[1][axis] = (double)corner[9 + axis] - (double)corner[axis];
    }
    /* At right angles to each other, whatever rounding says */
    double *x = portal->axes[0], *y = portal->axes[1], *z = portal->axes[2];
    double along = dot(x, y) / dot(x, x);
    for (int axis = 0; axis < 3; axis++)
        y[axis] -= along * x[axis];
    double x_length = sqrt(dot(x, x)), y_length = sqrt(dot(y, y));
    for (int axis = 0; axis < 3; axis++) {
        x[axis] /= x_length;
        y[axis] /= y_length;
    }
    for (int axis = 0; axis < 3; axis++)
        z[axis] = y[(axis + 1) % 3] * x[(axis + 2) % 3] - y[(axis + 2) % 3] * x[(axis + 1) % 3];
}

bool portal_open(struct portal *portal, const struct scene *scene,
                 const struct environment_table *table, struct err *err)
{
    set_frame(portal, scene, &scene->lights[table->light]);
    int32_t n = table->height < CELLS_MIN   ? CELLS_MIN
                : table->height > CELLS_MAX ? CELLS_MAX
                                            : table->height;
    portal->size = (uint32_t)n;
    size_t row = (size_t)n + 1;
    double *wide = malloc((size_t)n * (size_t)n * sizeof(*wide));
    portal->sums = calloc(row * row, sizeof(*portal->sums));
    if (wide == NULL || portal->sums == NULL) {
        free(wide);
        return err_set(err, ERR_MEMORY, "no memory for a portal");
    }
    double mean = weigh(portal, table, wide), even = mean > 0 ? EVEN * mean : 1;
    for (size_t k = 1; k < row; k++)
        for (size_t i = 1; i < row; i++) {
            double *sum = &portal->sums[k * row + i];
            *sum += even * wide[(k - 1) * (size_t)n + i - 1] + *(sum - 1);
        }
    for (size_t k = 1; k < row; k++)
        for (size_t i = 1; i < row; i++)
            portal->sums[k * row + i] += portal->sums[(k - 1) * row + i];
    free(wide);
    return true;
}

void portal_close(struct portal *portal)
{
    free(portal->sums);
    portal->sums = NULL;
}

/* ---- what is seen of it from p */

/* The rectangle, in cells; false where p is not in front */
struct window {
    double low[2], high[2];
};

static bool window_from(const struct portal *portal, const float p[3], struct window *window)
{
    for (int which = 0; which < 2; which++) {
        double d[3], local[3];
        for (int axis = 0; axis < 3; axis++)
            d[axis] = portal->corner[which][axis] - (double)p[axis];
        for (int axis = 0; axis < 3; axis++)
            local[axis] = dot(portal->axes[axis], d);
        if (!(local[2] > 0))
            return false;
        double *bound = which == 0 ? window->low : window->high;
        for (int k = 0; k < 2; k++) {
            double sine = local[k] / sqrt(local[k] * local[k] + local[2] * local[2]);
            bound[k] = (sine + 1) / 2 * portal->size;
        }
    }
    return window->low[0] < window->high[0] && window->low[1] < window->high[1];
}

static uint32_t cell_of(const struct portal *portal, double place)
{
    uint32_t cell = (uint32_t)place;
    return cell < portal->size ? cell : portal->size - 1;
}

/* The sums up to column i, interpolated between rows */
static double column_sum(const struct portal *portal, uint32_t i, double y)
{
    uint32_t k = cell_of(portal, y);
    const double *below = portal->sums + (size_t)k * (portal->size + 1) + i;
    return below[0] + (below[portal->size + 1] - below[0]) * (y - k);
}

/* The weight of everything to the left of x within the rows from low to high */
static double weight_left(const struct portal *portal, double x, double low, double high)
{
    uint32_t i = cell_of(portal, x);
    double at = column_sum(portal, i, high) - column_sum(portal, i, low);
    double next = column_sum(portal, i + 1, high) - column_sum(portal, i + 1, low);
    return at + (next - at) * (x - i);
}

static double weight_of(const struct portal *portal, const struct window *w)
{
    return weight_left(portal, w->high[0], w->low[1], w->high[1]) -
           weight_left(portal, w->low[0], w->low[1], w->high[1]);
}

static double cell_weight(const struct portal *portal, uint32_t i, uint32_t k)
{
    const double *sum = portal->sums + (size_t)k * (portal->size + 1) + i;
    return (sum[portal->size + 2] - sum[portal->size + 1]) - (sum[1] - sum[0]);
}

/* Per solid angle, in the direction of a cell's weight and spread */
static float density(const struct portal *portal, double weight, double total,
                     const double local[3])
{
    double cell = 4 / ((double)portal->size * portal->size);
    double pdf = weight / (total * cell * spread(local[0], local[1], local[2]));
    return pdf > (double)PDF_LEAST ? (pdf < 1e30 ? (float)pdf : 1e30f) : PDF_LEAST;
}

static double share_of(double target, double low, double high)
{
    double share = high > low ? (target - low) / (high - low) : 0.5;
    return share > 0 ? (share < 1 ? share : 1) : 0;
}

bool portal_sample(const struct portal *portal, const float p[3], float u, float v, float w[3],
                   float *pdf)
{
    struct window window;
    if (!window_from(portal, p, &window))
        return false;
    const double *low = window.low, *high = window.high;
    double before = weight_left(portal, low[0], low[1], high[1]);
    double total = weight_left(portal, high[0], low[1], high[1]) - before;
    if (!(total > 0))
        return false;

    /* The column that holds the share u of the weight, and a place in it */
    double target = before + (double)u * total;
    uint32_t first = cell_of(portal, low[0]), last = cell_of(portal, high[0]);
    while (first < last) {
        uint32_t middle = last - (last - first) / 2;
        bool beyond = weight_left(portal, middle, low[1], high[1]) > target;
        last = beyond ? middle - 1 : last;
        first = beyond ? first : middle;
    }
    uint32_t i = first;
    double left = fmax(i, low[0]), right = fmin(i + 1.0, high[0]);
    double x = left + (right - left) * share_of(target, weight_left(portal, left, low[1], high[1]),
                                                weight_left(portal, right, low[1], high[1]));

    /* The same in that column */
    double bottom = column_sum(portal, i + 1, low[1]) - column_sum(portal, i, low[1]);
    double top = column_sum(portal, i + 1, high[1]) - column_sum(portal, i, high[1]);
    target = bottom + (double)v * (top - bottom);
    first = cell_of(portal, low[1]);
    last = cell_of(portal, high[1]);
    while (first < last) {
        uint32_t middle = last - (last - first) / 2;
        bool beyond = column_sum(portal, i + 1, middle) - column_sum(portal, i, middle) > target;
        last = beyond ? middle - 1 : last;
        first = beyond ? first : middle;
    }
    double from = fmax(first, low[1]), to = fmin(first + 1.0, high[1]);
    double y = from +
               (to - from) * share_of(target,
                                      column_sum(portal, i + 1, from) - column_sum(portal, i, from),
                                      column_sum(portal, i + 1, to) - column_sum(portal, i, to));

    double local[3], world[3], edge = 1 - 0x1p-40;
    local_direction(fmin(fmax(2 * x / portal->size - 1, -edge), edge),
                    fmin(fmax(2 * y / portal->size - 1, -edge), edge), local);
    world_direction(portal, local, world);
    for (int axis = 0; axis < 3; axis++)
        w[axis] = (float)world[axis];
    *pdf = density(portal, cell_weight(portal, i, first), total, local);
    return true;
}

float portal_pdf(const struct portal *portal, const float p[3], const float w[3])
{
    const double d[3] = { (double)w[0], (double)w[1], (double)w[2] };
    double local[3], place[2];
    struct window window;
    for (int axis = 0; axis < 3; axis++)
        local[axis] = dot(portal->axes[axis], d);
    if (!(local[2] > 0) || !window_from(portal, p, &window))
        return 0;
    for (int k = 0; k < 2; k++) {
        double sine = local[k] / sqrt(local[k] * local[k] + local[2] * local[2]);
        place[k] = (sine + 1) / 2 * portal->size;
        if (!(place[k] >= window.low[k] && place[k] <= window.high[k]))
            return 0;
    }
    double weight = cell_weight(portal, cell_of(portal, place[0]), cell_of(portal, place[1]));
    return density(portal, weight, weight_of(portal, &window), local);
}
