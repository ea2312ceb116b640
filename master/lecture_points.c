#include "master/lecture_points.h"

#include "common/sampler.h"
#include "common/scene.h"
#include "master/image.h"
#include "master/lecture_caster.h"
#include "master/page.h"
#include "master/plot.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum purpose { SETS = 200, PICTURE };

static const char *const NAMES[] = {
#define X(name, text) text,
    LECTURE_POINTS_MAP(X)
#undef X
};

#define MOST_POINTS 4096                        /* of which a discrepancy is measured */
#define MOST_RAYS   64                          /* per pixel */
#define SAMPLERS    LECTURE_POINTS_SLIDE_HALTON /* the slide's own come last */

/* ---- the sets */

double lecture_points_halton(uint32_t index, uint32_t base)
{
    uint64_t digits = 0, scale = 1;
    for (uint32_t i = index; i > 0; i /= base) {
        digits = digits * base + i % base;
        scale *= base;
    }
    return (double)digits / (double)scale;
}

double lecture_points_halton_integers(uint32_t index, uint32_t base)
{
    double result = 0;
    uint32_t f = 1 / base; /* the slide's line, as C reads it: 0 */
    for (uint32_t i = index; i > 0; i /= base) {
        result += f * (i % base);
        f /= base;
    }
    return result;
}

float lecture_points_halton_float(uint32_t index, uint32_t base)
{
    float result = 0, f = 1 / (float)base;
    for (uint32_t i = index; i > 0; i /= base) {
        result += f * (float)(i % base);
        f /= (float)base;
    }
    return result;
}

static void fill_slide(enum lecture_points kind, uint32_t n, double (*points)[2])
{
    for (uint32_t i = 0; i < n; i++) {
        points[i][0] = lecture_points_halton(i, 2);
        points[i][1] = kind == LECTURE_POINTS_SLIDE_HALTON ? lecture_points_halton(i, 3)
                                                           : (i + .5) / n;
    }
}

void lecture_points_fill(enum lecture_points kind, unsigned purpose, uint64_t seed, uint64_t run,
                         uint32_t n, double (*points)[2])
{
    static const unsigned KINDS[SAMPLERS] = {
        [LECTURE_POINTS_RANDOM] = SAMPLER_INDEPENDENT,
        [LECTURE_POINTS_STRATIFIED] = SAMPLER_STRATIFIED,
        [LECTURE_POINTS_HALTON] = SAMPLER_HALTON,
        [LECTURE_POINTS_HAMMERSLEY] = SAMPLER_HAMMERSLEY,
        [LECTURE_POINTS_SOBOL] = SAMPLER_SOBOL,
    };
    if (kind >= SAMPLERS) {
        fill_slide(kind, n, points);
        return;
    }
    struct sampler sampler;
    if (!sampler_init(&sampler, KINDS[kind], n, NULL))
        return; /* n = 0 */
    bool at_vertex = purpose == SAMPLE_LIGHT_POINT || purpose == SAMPLE_BSDF_DIRECTION;
    u8 dimension = sample_dimension(SAMPLE_FROM_CAMERA, U8(at_vertex), purpose);
    for (uint32_t i = 0; i < n; i += LANES) {
        struct sample_key8 key;
        for (int lane = 0; lane < LANES; lane++)
            sampler_key_lane(&key, lane, seed, 0, run, i + (uint32_t)lane);
        f8 u, v;
        sampler_2d(&sampler, 1, &key, dimension, &u, &v);
        for (uint32_t lane = 0; lane < LANES && i + lane < n; lane++) {
            points[i + lane][0] = (double)u[lane];
            points[i + lane][1] = (double)v[lane];
        }
    }
}

/* ---- discrepancy */

/* fmax, which is a call for the sake of NaN, would take most of the time here */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

static int by_x(const void *a, const void *b)
{
    const double *p = a, *q = b;
    return (p[0] > q[0]) - (p[0] < q[0]);
}

double lecture_points_star(const double (*points)[2], uint32_t n)
{
    double(*sorted)[2] = malloc((n + 1) * sizeof(*sorted)), *ys = malloc((n + 1) * sizeof(*ys));
    double worst = NAN;
    if (sorted == NULL || ys == NULL)
        goto done;
    memcpy(sorted, points, n * sizeof(*sorted));
    qsort(sorted, n, sizeof(*sorted), by_x);

    /* Boxes that end at a point's x, or just before the next one's: the y of the k points left of
     * there, sorted, are where the worst heights are. */
    worst = 0;
    for (uint32_t k = 0; k <= n; k++) {
        double next_x = k < n ? sorted[k][0] : 1, x = k > 0 ? sorted[k - 1][0] : 0;
        if (k > 0) {
            uint32_t j = k - 1;
            for (; j > 0 && ys[j - 1] > sorted[k - 1][1]; j--)
                ys[j] = ys[j - 1];
            ys[j] = sorted[k - 1][1];
        }
        for (uint32_t j = 0; j <= k; j++) {
            double next_y = j < k ? ys[j] : 1, share = j / (double)n;
            double too_few = next_x * next_y - share;            /* without its edges */
            double too_many = j > 0 ? share - x * ys[j - 1] : 0; /* with them */
            worst = larger(worst, larger(too_few, too_many));
        }
    }
done:
    free(sorted);
    free(ys);
    return worst;
}

double lecture_points_l2(const double (*points)[2], uint32_t n)
{
    double single = 0, pairs = 0;
    for (uint32_t i = 0; i < n; i++) {
        double x = points[i][0], y = points[i][1];
        single += (1 - x * x) * (1 - y * y);
        pairs += (1 - x) * (1 - y);
        for (uint32_t j = 0; j < i; j++)
            pairs += 2 * (1 - larger(x, points[j][0])) * (1 - larger(y, points[j][1]));
    }
    return sqrt(fmax(0, 1 / 9.0 - single / (2.0 * n) + pairs / ((double)n * n)));
}

/* ---- the sections */

static void write_slide_code(struct lecture *lecture)
{
    struct page *page = lecture->page;
    page_note(page, "Trap",
              "The slide's Halton begins with f = 1 / base. Read as C with integers that is 0, and "
              "every point is %g. In float, the sum of its digits' values reaches 1: Halton(2^{32} "
              "- 1, 2) = %.9g. We mirror the digits as integers and divide once: %.12f.",
              lecture_points_halton_integers(12345, 2),
              (double)lecture_points_halton_float(UINT32_MAX, 2),
              lecture_points_halton(UINT32_MAX, 2));
}

static void write_scatter(struct lecture *lecture, enum lecture_points kind)
{
    enum { N = 256 };
    static double points[N][2], x[N], y[N];
    lecture_points_fill(kind, SAMPLE_PIXEL, lecture->seed, 0, N, points);
    for (int i = 0; i < N; i++) {
        x[i] = points[i][0];
        y[i] = points[i][1];
    }
    char caption[160];
    snprintf(caption, sizeof(caption), "%s: star discrepancy %.4f, L2 %.4f", NAMES[kind],
             lecture_points_star((const double(*)[2])points, N),
             lecture_points_l2((const double(*)[2])points, N));
    const struct plot_series series = { NULL, PLOT_DOTS, N, x, y, NULL };
    page_plot(lecture->page,
              &(struct plot){ .title = NAMES[kind],
                              .x = { .low = 0, .high = 1 },
                              .y = { .low = 0, .high = 1 },
                              .series = &series,
                              .series_count = 1,
                              .square = true,
                              .untitled = true },
              caption);
}

/* Root mean square of a discrepancy over randomised sets */
static void measure(struct lecture *lecture, enum lecture_points kind, uint32_t most,
                    struct lecture_rate *star, struct lecture_rate *l2)
{
    static double points[MOST_POINTS][2];
    for (uint32_t n = 4; n <= most; n *= 4) {
        unsigned runs = kind >= SAMPLERS ? 1 : lecture->quick ? 4 : 16;
        double squares[2] = { 0, 0 };
        for (unsigned run = 0; run < runs; run++) {
            lecture_points_fill(kind, SAMPLE_PIXEL, hash64(lecture->seed, SETS), run, n, points);
            double s = lecture_points_star((const double(*)[2])points, n);
            double l = lecture_points_l2((const double(*)[2])points, n);
            squares[0] += s * s;
            squares[1] += l * l;
        }
        /* A set without chance still strays from a power law: by some 5 % of itself */
        double relative = kind >= SAMPLERS ? .05 : 1 / sqrt(2.0 * runs);
        lecture_rate_note(star, n, sqrt(squares[0] / runs), relative);
        lecture_rate_note(l2, n, sqrt(squares[1] / runs), relative);
    }
}

static void write_discrepancy(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct lecture_rate star[LECTURE_POINTS_COUNT] = { 0 }, l2[LECTURE_POINTS_COUNT] = { 0 };
    struct plot_series series[LECTURE_POINTS_COUNT];
    uint32_t most = lecture->quick ? 256 : MOST_POINTS;
    page_heading(page, "Discrepancy against the number of points");
    for (int kind = 0; kind < LECTURE_POINTS_COUNT; kind++) {
        measure(lecture, kind, most, &star[kind], &l2[kind]);
        series[kind] = (struct plot_series){
            NAMES[kind],    kind < SAMPLERS ? PLOT_LINE | PLOT_MARKERS : PLOT_DASHED | PLOT_GREY,
            l2[kind].count, l2[kind].n,
            l2[kind].rmse,  NULL
        };
    }
    series[LECTURE_POINTS_SLIDE_HAMMERSLEY].style = PLOT_LINE | PLOT_GREY;
    page_plot(page,
              &(struct plot){ .title = "L2 star discrepancy",
                              .x = { .label = "points N", .log = true },
                              .y = { .label = "L2 star discrepancy", .log = true },
                              .series = series,
                              .series_count = LECTURE_POINTS_COUNT },
              "Root mean square over randomised sets. For random points it is known: 0.3727/√N.");
    char headings[128];
    snprintf(headings, sizeof(headings),
             "set\tstar, N = 256\tstar, N = %" PRIu32 "\tslope\tL2, N = "
             "%" PRIu32 "\tslope",
             most, most);
    page_table_begin(page, "Slopes are fitted from N = 16 on.", headings);
    for (int kind = 0; kind < LECTURE_POINTS_COUNT; kind++) {
        size_t last = star[kind].count - 1;
        page_row(page, "%s\t%.5f\t%.5f\t%s\t%.6f\t%s", NAMES[kind], star[kind].rmse[3],
                 star[kind].rmse[last], lecture_slope_text(lecture_rate_fit(&star[kind], 16)),
                 l2[kind].rmse[last], lecture_slope_text(lecture_rate_fit(&l2[kind], 16)));
    }
    page_table_end(page);
    page_note(
        page, "Result",
        "Random points thin out as N^{-1/2}, strata as N^{-3/4}, and the three "
        "low-discrepancy sets nearly as N^{-1} (times a power of log N, which lowers the "
        "slope). Halton and Sobol points can be continued at will, a Hammersley set needs "
        "its N in advance. Ours are scrambled at random: every point by itself is uniform, so "
        "estimates stay unbiased and the error can be told from independent sets, which the "
        "slide's fixed sets do not allow.");
}

/* ---- differences in rendering */

static const struct caster_object *table_scene(unsigned *count)
{
#define SURFACE(r, g, b)                 \
    {                                    \
        .kd = { r, g, b }, .exponent = 1 \
    }
    static const struct caster_object OBJECTS[] = {
        { .at = { -1.2, 4, -1.2 },
          .u = { 2.4, 0, 0 },
          .v = { 0, 0, 2.4 },
          .surface = { .emission = { 14, 13, 11 }, .exponent = 1 } },
        { .at = { -40, 0, 40 },
          .u = { 80, 0, 0 },
          .v = { 0, 0, -80 },
          .surface = { .kd = { .8, .8, .75 }, .exponent = 1, .checks = .7 } },
        { .sphere = true, .radius = .8, .at = { -.9, .8, .2 }, .surface = SURFACE(.8, .35, .25) },
        { .sphere = true, .radius = .5, .at = { .7, .5, 1 }, .surface = SURFACE(.3, .5, .8) },
    };
#undef SURFACE
    *count = sizeof(OBJECTS) / sizeof(OBJECTS[0]);
    return OBJECTS;
}

/* Direct light only. Each ray takes two points: a place in the pixel, and one on the light. */
static void expose(struct caster_film *film, const struct caster_scene *scene,
                   enum lecture_points kind, uint32_t samples, uint64_t seed)
{
    const struct caster_how how = { .light_sampling = true, .max_depth = 1 };
    double points[2 * MOST_RAYS][2];
    struct caster_counts counts = { 0 };
    assert(samples <= MOST_RAYS);
    for (unsigned y = 0; film->sums != NULL && y < film->height; y++)
        for (unsigned x = 0; x < film->width; x++) {
            uint64_t pixel = (uint64_t)y * film->width + x;
            double(*on_light)[2] = points + samples;
            lecture_points_fill(kind, SAMPLE_PIXEL, seed, pixel, samples, points);
            lecture_points_fill(kind, SAMPLE_LIGHT_POINT, seed, pixel, samples, on_light);
            for (uint32_t i = 0; i < samples; i++) {
                const double given[4] = { points[i][0], points[i][1], on_light[i][0],
                                          on_light[i][1] };
                struct lecture_dice dice = { .given = given, .given_count = 4 };
                lecture_vec d = lecture_caster_camera(scene, film, x, y, &dice);
                lecture_vec light = lecture_caster_radiance(scene, &how, scene->eye, d, 0, &dice,
                                                            &counts);
                for (unsigned c = 0; c < 3; c++)
                    film->sums[3 * pixel + c] += light[c];
            }
        }
    film->samples += samples;
}

static void write_rendering(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct caster_scene scene = {
        .light = 0, .eye = { 0, 1.6, 6 }, .target = { -.1, .6, 0 }, .tan_half_fov = .3
    };
    scene.objects = table_scene(&scene.object_count);
    unsigned size = lecture->quick ? 24 : 96;
    struct lecture_rate rates[SAMPLERS] = { 0 };
    struct plot_series series[SAMPLERS];
    char names[SAMPLERS][80];
    enum { SHOWN = 4 };
    page_heading(page, "Differences in rendering");
    page_text(page,
              "The same picture, %d rays per pixel, with the place in the pixel and the point on "
              "the light taken from each kind of set: an edge of shadow is an integral over the "
              "light, an edge of a check one over the pixel. The errors are from two pictures with "
              "numbers of their own: their distance over √2.",
              SHOWN);
    page_grid_begin(page, 150);
    for (int kind = 0; kind < SAMPLERS; kind++) {
        for (uint32_t n = 1; n <= (lecture->quick ? 16u : MOST_RAYS); n *= 4) {
            struct caster_film film[2] = { lecture_caster_film(size, size),
                                           lecture_caster_film(size, size) };
            for (uint64_t i = 0; i < 2; i++)
                expose(&film[i], &scene, kind, n, hash64_4(lecture->seed, PICTURE, n, i));
            double rmse = lecture_caster_rmse(&film[0], &film[1]);
            /* Pixels are independent, but few of them have most of the error */
            lecture_rate_note(&rates[kind], n, rmse, 3.0 / size);
            if (n == SHOWN) {
                struct image *image = lecture_caster_image(&film[0]);
                page_picture(page, image, "%s, %d rays: error %.3g", NAMES[kind], SHOWN, rmse);
                image_free(image);
            }
            lecture_caster_film_free(&film[0]);
            lecture_caster_film_free(&film[1]);
        }
        snprintf(names[kind], sizeof(names[kind]), "%s: slope %s", NAMES[kind],
                 lecture_slope_text(lecture_rate_fit(&rates[kind], 4)));
        series[kind] = (struct plot_series){ names[kind],       PLOT_LINE | PLOT_MARKERS,
                                             rates[kind].count, rates[kind].n,
                                             rates[kind].rmse,  NULL };
    }
    page_grid_end(page);
    page_plot(page,
              &(struct plot){ .title = "Error of the picture",
                              .x = { .label = "rays per pixel", .log = true },
                              .y = { .label = "root mean square error", .log = true },
                              .series = series,
                              .series_count = SAMPLERS },
              NULL);
    page_note(page, "Result",
              "The gain is real but smaller than for the discrepancy: where edges of checks and of "
              "shadows cross a pixel, four dimensions count, and a discontinuity costs every set "
              "its rate.");
}

void lecture_points_write(struct lecture *lecture)
{
    struct page *page = lecture->page;
    page_section(page, "Random numbers");
    page_text(page,
              "256 points each. The first five are the samplers of `{pathfarm render} "
              "(`{--sampler}), the last two are the slides' own formulas. Discrepancy is measured "
              "with boxes from the corner (0, 0): the slide's sliding box is at most four times as "
              "bad. *{Star} is the largest difference between a box's area and its share of the "
              "points, *{L2} the root mean square over all boxes.");
    page_grid_begin(page, 190);
    for (int kind = 0; kind < LECTURE_POINTS_COUNT; kind++)
        write_scatter(lecture, kind);
    page_grid_end(page);
    page_note(page, "Trap",
              "Low discrepancy by itself is not good, as the slide says: its Hammersley set is "
              "very even, and so regular that the same pattern in every pixel shows as aliasing. "
              "Scrambling "
              "keeps the evenness and breaks the pattern.");
    write_slide_code(lecture);
    write_discrepancy(lecture);
    write_rendering(lecture);
}
