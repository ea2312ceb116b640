#include "master/lecture_directions.h"

#include "common/elem.h"
#include "common/moments.h"
#include "common/stats.h"
#include "master/page.h"
#include "master/plot.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

#define TOLERANCE .02 /* of a sum of barycentric weights */

enum purpose { HEMISPHERE = 300, HEMISPHERE_PLOT, POLYGON, POLYGON_PLOT, EXACT, MIXTURE };

/* "0.31", or "0 (< 1e-12)" */
static const char *p_text(double p)
{
    static char text[32];
    if (p < 1e-12)
        return "0 (< 1e-12)";
    snprintf(text, sizeof(text), "%.2g", p);
    return text;
}

/* ---- the hemisphere */

static lecture_vec from_cosine(double z, double turn)
{
    double across = sqrt(fmax(0, 1 - z * z)), theta = 2 * LECTURE_PI * turn;
    return LECTURE_VEC(across * elem_cos(theta), across * elem_sin(theta), z);
}

lecture_vec lecture_directions_hemisphere(enum lecture_hemisphere how, struct lecture_dice *dice,
                                          unsigned *tries)
{
    *tries = 1;
    double r1, r2;
    switch (how) {
    case LECTURE_HEMISPHERE_SPHERICAL:
        r1 = lecture_roll(dice);
        r2 = lecture_roll(dice);
        return from_cosine(r2, r1); /* cos(acos(r2)) is r2 */
    case LECTURE_HEMISPHERE_COSINE:
        r1 = lecture_roll(dice);
        r2 = lecture_roll(dice);
        return from_cosine(sqrt(1 - r2), r1);
    default:
        break;
    }
    for (;; ++*tries) {
        double x = 2 * lecture_roll(dice) - 1, y = 2 * lecture_roll(dice) - 1;
        double z = lecture_roll(dice), square = x * x + y * y + z * z;
        bool in_ball = square <= 1 || how == LECTURE_HEMISPHERE_CUBE;
        if (in_ball && square > 0) { /* the zero vector has no direction */
            double length = sqrt(square);
            return LECTURE_VEC(x / length, y / length, z / length);
        }
    }
}

struct lecture_hemisphere_result lecture_directions_measure(enum lecture_hemisphere how, uint64_t n,
                                                            struct lecture_dice dice)
{
    enum { ROWS = 10, COLUMNS = 8 };
    unsigned long long counts[ROWS * COLUMNS] = { 0 };
    struct moments tries = { 0 }, z = { 0 }, cosine = { 0 };
    bool by_cosine = how == LECTURE_HEMISPHERE_COSINE;
    for (uint64_t i = 0; i < n; i++) {
        unsigned tried;
        lecture_vec w = lecture_directions_hemisphere(how, &dice, &tried);
        moments_add(&tries, tried);
        moments_add(&z, w[2]);
        /* The integrand is z; its density 1 / 2 pi, or z / pi */
        moments_add(&cosine, by_cosine ? LECTURE_PI : 2 * LECTURE_PI * w[2]);
        double height = by_cosine ? w[2] * w[2] : w[2]; /* uniform in [0, 1] */
        double turn = elem_atan2(w[1], w[0]) / (2 * LECTURE_PI) + .5;
        int row = (int)fmin(height * ROWS, ROWS - 1);
        int column = (int)fmin(fmax(turn, 0) * COLUMNS, COLUMNS - 1);
        counts[row * COLUMNS + column]++;
    }
    double chi_square = stats_chi_square(counts, NULL, ROWS * COLUMNS);
    return (struct lecture_hemisphere_result){
        .tries = tries.mean,
        .numbers = (double)dice.next / (double)n,
        .mean_z = z.mean,
        .p = stats_chi_square_survival(chi_square, ROWS * COLUMNS - 1),
        .integral = cosine.mean,
        .integral_error = moments_stderr(&cosine),
    };
}

/* Directions seen from above */
static void plot_hemisphere(struct lecture *lecture, enum lecture_hemisphere how,
                            const char *caption)
{
    enum { POINTS = 700 };
    static double x[POINTS], y[POINTS];
    struct lecture_dice dice = lecture_dice(lecture->seed, HEMISPHERE_PLOT, how);
    for (int i = 0; i < POINTS; i++) {
        unsigned tries;
        lecture_vec w = lecture_directions_hemisphere(how, &dice, &tries);
        x[i] = w[0];
        y[i] = w[1];
    }
    const struct plot_series series = { NULL, PLOT_DOTS, POINTS, x, y, NULL };
    page_plot(lecture->page,
              &(struct plot){ .title = "Directions from above",
                              .x = { .low = -1, .high = 1 },
                              .y = { .low = -1, .high = 1 },
                              .series = &series,
                              .series_count = 1,
                              .square = true,
                              .untitled = true },
              caption);
}

static void write_hemisphere(struct lecture *lecture)
{
    static const char *const NAMES[LECTURE_HEMISPHERE_COUNT] = {
        [LECTURE_HEMISPHERE_REJECTION] = "rejection, then normalise",
        [LECTURE_HEMISPHERE_SPHERICAL] = "spherical coordinates",
        [LECTURE_HEMISPHERE_COSINE] = "by the cosine",
        [LECTURE_HEMISPHERE_CUBE] = "normalise without rejection",
    };
    struct page *page = lecture->page;
    uint64_t n = lecture->quick ? 20000 : 1000000;
    page_section(page, "Sampling the hemisphere");
    page_text(page,
              "700 directions seen from above, where the cosine's density is even. "
              "Uniform directions crowd at the rim, for that is where the hemisphere turns away.");
    page_grid_begin(page, 190);
    for (int how = 0; how < LECTURE_HEMISPHERE_COUNT; how++)
        plot_hemisphere(lecture, how, NAMES[how]);
    page_grid_end(page);
    char caption[200];
    snprintf(caption, sizeof(caption),
             "%" PRIu64 " directions each. p: how often right directions would look as bad as "
             "these (chi-square, 80 cells).",
             n);
    page_table_begin(page, caption,
                     "way\ttries\trandom numbers\tmean z\tp\t∫ cos = π\t± standard error");
    double accepted = 0;
    for (int how = 0; how < LECTURE_HEMISPHERE_COUNT; how++) {
        struct lecture_hemisphere_result r = lecture_directions_measure(
            how, n, lecture_dice(lecture->seed, HEMISPHERE, how));
        accepted = how == LECTURE_HEMISPHERE_REJECTION ? 1 / r.tries : accepted;
        page_row(page, "%s\t%.4f\t%.3f\t%.4f\t%s\t%.5f\t%.5f", NAMES[how], r.tries, r.numbers,
                 r.mean_z, p_text(r.p), r.integral, r.integral_error);
    }
    page_table_end(page);
    page_note(page, "Result",
              "%.4f of the points in the box are accepted; theory says π/6 = 0.5236. For the "
              "integral of the cosine, the density that is the cosine has no variance at all.",
              accepted);
    page_note(page, "Trap",
              "Rejection takes a number of random numbers that varies, 5.7 on average: the points "
              "of a Halton or Sobol set then mean something else in each sample, and a path cannot "
              "be replayed from its index. The zero vector must be rejected too. And without the "
              "test for the ball, normalised points of a box lean towards its corners: the p "
              "of the last row.");
}

/* ---- a convex polygon */

static double doubled_area(const double a[2], const double b[2], const double c[2])
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* Twice the area of the i-th triangle of the fan about corner 0 */
static double fan_area(const struct lecture_polygon *p, unsigned i)
{
    return doubled_area(p->at[0], p->at[i + 1], p->at[i + 2]);
}

static double polygon_area(const struct lecture_polygon *p)
{
    double sum = 0;
    for (unsigned i = 0; i + 2 < p->corners; i++)
        sum += fan_area(p, i);
    return sum / 2;
}

static void bounds(const struct lecture_polygon *p, double low[2], double high[2])
{
    for (int axis = 0; axis < 2; axis++) {
        low[axis] = high[axis] = p->at[0][axis];
        for (unsigned i = 1; i < p->corners; i++) {
            low[axis] = fmin(low[axis], p->at[i][axis]);
            high[axis] = fmax(high[axis], p->at[i][axis]);
        }
    }
}

double lecture_directions_share(const struct lecture_polygon *polygon)
{
    double low[2], high[2];
    bounds(polygon, low, high);
    return polygon_area(polygon) / ((high[0] - low[0]) * (high[1] - low[1]));
}

static bool inside(const struct lecture_polygon *p, const double point[2])
{
    for (unsigned i = 0; i < p->corners; i++)
        if (doubled_area(p->at[i], p->at[(i + 1) % p->corners], point) < 0)
            return false;
    return true;
}

static void by_rectangle(const struct lecture_polygon *p, struct lecture_dice *dice,
                         double point[2], uint64_t *tries)
{
    double low[2], high[2];
    bounds(p, low, high);
    for (*tries = 1;; ++*tries) {
        for (int axis = 0; axis < 2; axis++)
            point[axis] = low[axis] + (high[axis] - low[axis]) * lecture_roll(dice);
        if (inside(p, point))
            return;
    }
}

static double roll_weights(unsigned corners, struct lecture_dice *dice, double *weights)
{
    double sum = 0;
    for (unsigned i = 0; i < corners; i++)
        sum += weights[i] = lecture_roll(dice);
    return sum;
}

static void by_barycentric(const struct lecture_polygon *p, struct lecture_dice *dice,
                           double point[2], uint64_t *tries)
{
    double weights[LECTURE_CORNERS], sum;
    *tries = 0;
    do {
        sum = roll_weights(p->corners, dice, weights);
        ++*tries;
    } while (fabs(sum - 1) > TOLERANCE);
    for (int axis = 0; axis < 2; axis++) {
        point[axis] = 0;
        for (unsigned i = 0; i < p->corners; i++)
            point[axis] += weights[i] / sum * p->at[i][axis];
    }
}

static void by_triangles(const struct lecture_polygon *p, struct lecture_dice *dice,
                         double point[2])
{
    /* A triangle by its area */
    double left = lecture_roll(dice) * 2 * polygon_area(p);
    unsigned i = 0;
    while (i + 3 < p->corners && left >= fan_area(p, i))
        left -= fan_area(p, i++);

    /* And a point of it: lines parallel to a side get longer towards it, hence the root */
    double root = sqrt(lecture_roll(dice)), along = lecture_roll(dice);
    for (int axis = 0; axis < 2; axis++)
        point[axis] = (1 - root) * p->at[0][axis] + root * (1 - along) * p->at[i + 1][axis] +
                      root * along * p->at[i + 2][axis];
}

void lecture_directions_polygon(enum lecture_in_polygon how, const struct lecture_polygon *polygon,
                                struct lecture_dice *dice, double point[2], uint64_t *tries)
{
    *tries = 1;
    if (how == LECTURE_POLYGON_RECTANGLE)
        by_rectangle(polygon, dice, point, tries);
    else if (how == LECTURE_POLYGON_BARYCENTRIC)
        by_barycentric(polygon, dice, point, tries);
    else
        by_triangles(polygon, dice, point);
}

#define FINE 4 /* each triangle of the fan is cut into FINE^2 equal ones */

/* The cell of a point: which triangle of the fan, and where in it */
static unsigned cell_of(const struct lecture_polygon *p, const double point[2])
{
    for (unsigned i = 0; i + 2 < p->corners; i++) {
        double b = doubled_area(p->at[0], point, p->at[i + 2]) / fan_area(p, i);
        double c = doubled_area(p->at[0], p->at[i + 1], point) / fan_area(p, i);
        if ((b < 0 && i + 3 < p->corners) || (c < 0 && i > 0))
            continue; /* in a neighbour */
        b = fmin(fmax(b * FINE, 0), FINE - 1e-9);
        c = fmin(fmax(c * FINE, 0), FINE - 1e-9);
        /* Row b has FINE - b upright triangles, and one less that stand on their heads */
        unsigned row = (unsigned)b, column = (unsigned)c;
        bool upside_down = b - row + (c - column) > 1;
        unsigned first = row * (2 * FINE - row); /* cells in the rows before */
        unsigned cell = first + 2 * column + upside_down;
        return i * FINE * FINE + (cell < FINE * FINE ? cell : FINE * FINE - 1);
    }
    return 0;
}

static struct lecture_polygon shrunk(const struct lecture_polygon *p)
{
    double centre[2] = { 0, 0 }, all = 2 * polygon_area(p);
    for (unsigned i = 0; i + 2 < p->corners; i++)
        for (int axis = 0; axis < 2; axis++)
            centre[axis] += fan_area(p, i) / all *
                            (p->at[0][axis] + p->at[i + 1][axis] + p->at[i + 2][axis]) / 3;
    struct lecture_polygon small = *p;
    for (unsigned i = 0; i < p->corners; i++)
        for (int axis = 0; axis < 2; axis++)
            small.at[i][axis] = centre[axis] + sqrt(.5) * (p->at[i][axis] - centre[axis]);
    return small;
}

struct lecture_polygon_result
lecture_directions_measure_polygon(enum lecture_in_polygon how,
                                   const struct lecture_polygon *polygon, uint64_t n,
                                   struct lecture_dice dice)
{
    unsigned long long counts[LECTURE_CORNERS * FINE * FINE] = { 0 };
    double share[LECTURE_CORNERS * FINE * FINE];
    unsigned cells = (polygon->corners - 2) * FINE * FINE;
    for (unsigned i = 0; i < cells; i++)
        share[i] = fan_area(polygon, i / (FINE * FINE)) / (FINE * FINE) / 2 / polygon_area(polygon);

    struct lecture_polygon small = shrunk(polygon);
    uint64_t tries = 0, inner = 0;
    for (uint64_t i = 0; i < n; i++) {
        double point[2];
        uint64_t tried;
        lecture_directions_polygon(how, polygon, &dice, point, &tried);
        tries += tried;
        inner += inside(&small, point);
        counts[cell_of(polygon, point)]++;
    }
    double chi_square = stats_chi_square(counts, share, (int)cells);
    return (struct lecture_polygon_result){
        .acceptance = (double)n / (double)tries,
        .inner = (double)inner / (double)n,
        .p = stats_chi_square_survival(chi_square, cells - 1),
    };
}

uint64_t lecture_directions_exact_sums(unsigned corners, uint64_t n, struct lecture_dice dice)
{
    uint64_t exact = 0;
    double weights[LECTURE_CORNERS];
    for (uint64_t i = 0; i < n; i++)
        exact += roll_weights(corners, &dice, weights) == 1;
    return exact;
}

static void plot_polygon(struct lecture *lecture, enum lecture_in_polygon how,
                         const struct lecture_polygon *polygon, const char *caption)
{
    enum { POINTS = 700 };
    static double x[POINTS], y[POINTS];
    double edge_x[LECTURE_CORNERS + 1], edge_y[LECTURE_CORNERS + 1];
    struct lecture_dice dice = lecture_dice(lecture->seed, POLYGON_PLOT, how);
    for (int i = 0; i < POINTS; i++) {
        double point[2];
        uint64_t tries;
        lecture_directions_polygon(how, polygon, &dice, point, &tries);
        x[i] = point[0];
        y[i] = point[1];
    }
    for (unsigned i = 0; i <= polygon->corners; i++) {
        edge_x[i] = polygon->at[i % polygon->corners][0];
        edge_y[i] = polygon->at[i % polygon->corners][1];
    }
    const struct plot_series series[] = {
        { NULL, PLOT_DOTS, POINTS, x, y, NULL },
        { NULL, PLOT_LINE | PLOT_GREY, polygon->corners + 1, edge_x, edge_y, NULL },
    };
    page_plot(lecture->page,
              &(struct plot){ .title = "Points of a polygon",
                              .x = { .low = -.05, .high = 1.05 },
                              .y = { .low = -.05, .high = 1.05 },
                              .series = series,
                              .series_count = 2,
                              .square = true,
                              .untitled = true },
              caption);
}

static void write_polygon(struct lecture *lecture)
{
    static const char *const NAMES[LECTURE_POLYGON_COUNT] = {
        [LECTURE_POLYGON_RECTANGLE] = "rectangle, with rejection",
        [LECTURE_POLYGON_BARYCENTRIC] = "barycentric, sum in 1 ± 0.02",
        [LECTURE_POLYGON_TRIANGULATED] = "triangles, by area",
    };
    static const struct lecture_polygon TRIANGLE = { 3, { { 0, .1 }, { 1, 0 }, { .4, .9 } } };
    static const struct lecture_polygon PENTAGON = {
        5, { { .1, .1 }, { .8, 0 }, { 1, .5 }, { .6, 1 }, { 0, .8 } }
    };
    struct page *page = lecture->page;
    uint64_t n = lecture->quick ? 4000 : 50000, sums = lecture->quick ? 100000 : 5000000;
    page_section(page, "Sampling a convex polygon");
    page_grid_begin(page, 220);
    for (int how = 0; how < LECTURE_POLYGON_COUNT; how++)
        plot_polygon(lecture, how, &PENTAGON, NAMES[how]);
    page_grid_end(page);
    char caption[200];
    snprintf(caption, sizeof(caption),
             "%" PRIu64 " points each. Inner half: share of the points in the polygon shrunk about "
             "its centroid to half its area.",
             n);
    page_table_begin(page, caption, "polygon\tway\taccepted\tinner half (0.5)\tp (chi-square)");
    for (int corners = 3; corners <= 5; corners += 2)
        for (int how = 0; how < LECTURE_POLYGON_COUNT; how++) {
            const struct lecture_polygon *polygon = corners == 3 ? &TRIANGLE : &PENTAGON;
            struct lecture_polygon_result r = lecture_directions_measure_polygon(
                how, polygon, n,
                lecture_dice(lecture->seed, POLYGON, (uint64_t)(10 * corners + how)));
            page_row(page, "%s\t%s\t%.5f\t%.4f\t%s", corners == 3 ? "triangle" : "pentagon",
                     NAMES[how], r.acceptance, r.inner, p_text(r.p));
        }
    page_table_end(page);
    page_note(
        page, "Trap",
        "Weights drawn from [0, 1] and kept only if their sum is 1, as the slide says, never "
        "end: of %" PRIu64 " sets of five weights, %" PRIu64 " had the sum 1. If a sum near 1 "
        "is accepted, points of a triangle come out right; those of any polygon with more "
        "corners crowd in its middle, where many different weights lead to the same point. "
        "The rectangle is right, and wastes what lies outside. Triangles chosen by their area "
        "take three numbers, always; that is what we do.",
        sums, lecture_directions_exact_sums(5, sums, lecture_dice(lecture->seed, EXACT, 0)));
}

/* ---- diffuse or specular */

static void write_mixture(struct lecture *lecture)
{
    static const struct mixture {
        const char *name;
        lecture_vec kd, ks;
    } ROWS[] = {
        { "mostly diffuse, red", { .6, .2, .1 }, { .1, .1, .1 } },
        { "half and half", { .3, .3, .3 }, { .3, .3, .3 } },
        { "mostly mirror", { .05, .05, .1 }, { .7, .7, .6 } },
        { "mirror", { 0, 0, 0 }, { .9, .9, .9 } },
        { "black", { 0, 0, 0 }, { 0, 0, 0 } },
    };
    struct page *page = lecture->page;
    uint64_t n = lecture->quick ? 10000 : 200000;
    page_section(page, "Diffuse, specular, or a mixture");
    page_text(page,
              "With probability p = k_{d}/(k_{d} + k_{s}) (sums over red, green and blue) the next "
              "ray is diffuse, otherwise specular; its weight is divided by the probability of the "
              "choice. The mean weight must be what the surface reflects, k_{d} + k_{s}.");
    page_table_begin(page, NULL,
                     "surface\tp\tdiffuse, measured\tred, green, blue reflected\tmean weight, "
                     "measured");
    for (size_t row = 0; row < sizeof(ROWS) / sizeof(ROWS[0]); row++) {
        const struct caster_surface surface = { .kd = ROWS[row].kd,
                                                .ks = ROWS[row].ks,
                                                .exponent = INFINITY };
        const lecture_vec up = { 0, 0, 1, 0 }, wo = { .6, 0, .8, 0 };
        struct lecture_dice dice = lecture_dice(lecture->seed, MIXTURE, row);
        lecture_vec sum = { 0, 0, 0, 0 }, total = surface.kd + surface.ks;
        uint64_t diffuse = 0;
        for (uint64_t i = 0; i < n; i++) {
            lecture_vec wi, weight;
            bool chosen;
            if (!lecture_caster_reflect(&surface, up, wo, &dice, &wi, &weight, &chosen))
                continue;
            sum += weight;
            diffuse += chosen;
        }
        double kd = surface.kd[0] + surface.kd[1] + surface.kd[2];
        double all = total[0] + total[1] + total[2];
        char p[32] = "0/0";
        if (all > 0)
            snprintf(p, sizeof(p), "%.4f", kd / all);
        sum /= (double)n;
        page_row(page, "%s\t%s\t%.4f\t%.2f, %.2f, %.2f\t%.3f, %.3f, %.3f", ROWS[row].name, p,
                 (double)diffuse / (double)n, total[0], total[1], total[2], sum[0], sum[1], sum[2]);
    }
    page_table_end(page);
    page_note(page, "Trap",
              "For a black surface p is 0/0, not a number; a comparison with it is false, the ray "
              "goes on as specular with a weight that is not a number, and the pixel is lost. We "
              "absorb the path.");
}

void lecture_directions_write(struct lecture *lecture)
{
    write_hemisphere(lecture);
    write_polygon(lecture);
    write_mixture(lecture);
}
