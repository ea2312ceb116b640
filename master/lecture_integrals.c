#include "master/lecture_integrals.h"

#include "common/elem.h"
#include "common/moments.h"
#include "master/page.h"
#include "master/plot.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

#define E 2.71828182845904523536

enum purpose { DIE = 100, POLYNOMIAL, OWN_PDF, WAVE, WAVE_ROW, PI_RANDOM, PI_CELLS, SMOOTH, DISC };

/* The table on the slide: N, "Unstratified", "Stratified" */
static const struct printed {
    uint64_t n;
    double random, stratified;
} PRINTED[] = {
    { 1, 2.75039, 2.70457 },    { 10, 1.9893, 1.72858 },     { 100, 1.79139, 1.77925 },
    { 1000, 1.75146, 1.77606 }, { 10000, 1.77313, 1.77610 }, { 100000, 1.77862, 1.77610 },
    { 1000000, 0, 0 }, /* not on the slide */
};
enum { PRINTED_COUNT = sizeof(PRINTED) / sizeof(PRINTED[0]) };

double lecture_integrals_5x4(double x)
{
    return 5 * x * x * x * x;
}

double lecture_integrals_wave(double x)
{
    return elem_exp(elem_sin(3 * x * x));
}

static double wave_slope(double x)
{
    return lecture_integrals_wave(x) * elem_cos(3 * x * x) * 6 * x;
}

double lecture_integrals_random(const void *self, uint64_t n, struct lecture_dice *dice)
{
    const struct lecture_integrand *of = self;
    double width = of->high - of->low, sum = 0;
    for (uint64_t i = 0; i < n; i++)
        sum += of->f(of->low + width * lecture_roll(dice)); /* f / p with p = 1 / width */
    return width * sum / (double)n;
}

double lecture_integrals_stratified(const void *self, uint64_t n, struct lecture_dice *dice)
{
    const struct lecture_integrand *of = self;
    double width = of->high - of->low, sum = 0;
    for (uint64_t i = 0; i < n; i++)
        sum += of->f(of->low + width * (((double)i + lecture_roll(dice)) / (double)n));
    return width * sum / (double)n;
}

struct moments lecture_integrals_importance(uint64_t n, struct lecture_dice *dice)
{
    struct moments values = { 0 };
    for (uint64_t i = 0; i < n; i++) {
        double u = 1 - lecture_roll(dice); /* in (0, 1]: at 0, f / p would be 0 / 0 */
        double x = elem_pow(u, .2), p = 5 * x * x * x * x;
        moments_add(&values, lecture_integrals_5x4(x) / p);
    }
    return values;
}

static double simpson(double (*f)(double), bool squared, double minus)
{
    const int steps = 20000; /* error below 1e-15 for functions as tame as these */
    double sum = 0;
    for (int i = 0; i <= steps; i++) {
        double y = f(i / (double)steps) - minus;
        sum += (i == 0 || i == steps ? 1 : i % 2 == 1 ? 4 : 2) * (squared ? y * y : y);
    }
    return sum / (3.0 * steps);
}

struct lecture_wave lecture_integrals_wave_theory(void)
{
    struct lecture_wave wave = { .integral = simpson(lecture_integrals_wave, false, 0) };
    wave.sigma = sqrt(simpson(lecture_integrals_wave, true, wave.integral));
    wave.stratified_scale = sqrt(simpson(wave_slope, true, 0) / 12);
    return wave;
}

/* ---- two dimensions */

static double in_disc(double x, double y)
{
    return x * x + y * y <= 1 ? 4 : 0; /* the quarter of the square of side 2, so pi on average */
}

static double smooth(double x, double y)
{
    return elem_exp(x + y);
}

static double over_cells(double (*f)(double, double), uint64_t n, struct lecture_dice *dice)
{
    uint64_t side = (uint64_t)sqrt((double)n);
    double sum = 0, width = 1 / (double)side;
    for (uint64_t j = 0; j < side; j++)
        for (uint64_t i = 0; i < side; i++) {
            double x = ((double)i + lecture_roll(dice)) * width;
            double y = ((double)j + lecture_roll(dice)) * width;
            sum += f(x, y);
        }
    return sum * width * width;
}

double lecture_integrals_pi_random(const void *self, uint64_t n, struct lecture_dice *dice)
{
    (void)self;
    double sum = 0;
    for (uint64_t i = 0; i < n; i++) {
        double x = lecture_roll(dice), y = lecture_roll(dice);
        sum += in_disc(x, y);
    }
    return sum / (double)n;
}

double lecture_integrals_pi_stratified(const void *self, uint64_t n, struct lecture_dice *dice)
{
    (void)self;
    return over_cells(in_disc, n, dice);
}

double lecture_integrals_smooth_stratified(const void *self, uint64_t n, struct lecture_dice *dice)
{
    (void)self;
    return over_cells(smooth, n, dice);
}

unsigned lecture_integrals_rand_ones(void)
{
    unsigned ones = 0;
    const int32_t rand_max = INT32_MAX;
    for (int32_t r = rand_max - 1000; r < rand_max; r++)
        ones += (float)r / (float)rand_max == 1;
    return ones + ((float)rand_max / (float)rand_max == 1);
}

/* ---- the sections */

static void write_die(struct lecture *lecture)
{
    page_heading(lecture->page, "The die, and the rule behind everything");
    page_text(lecture->page,
              "An expected value is estimated by the mean of samples; the estimate is itself "
              "random, and its standard deviation falls as 1/√*{N}. The lecture's die has the "
              "expected value 3.5:");
    page_table_begin(lecture->page, NULL,
                     "N rolls\tmean\tstandard error, σ/√N\terror in standard errors");
    double sigma = sqrt(35 / 12.0);
    uint64_t most = lecture->quick ? 10000 : 1000000;
    struct lecture_dice dice = lecture_dice(lecture->seed, DIE, 0);
    double sum = 0;
    for (uint64_t i = 1, due = 10; i <= most; i++) {
        sum += 1 + floor(6 * lecture_roll(&dice));
        if (i < due)
            continue;
        double mean = sum / (double)i, error = sigma / sqrt((double)i);
        page_row(lecture->page, "%" PRIu64 "\t%.5f\t%.5f\t%+.2f", i, mean, error,
                 (mean - 3.5) / error);
        due *= 10;
    }
    page_table_end(lecture->page);
    page_text(lecture->page,
              "The last column is how all estimates on this page are judged: beyond ±3 would be "
              "suspicious, beyond ±4 wrong.");
}

static void write_polynomial(struct lecture *lecture)
{
    struct page *page = lecture->page;
    const struct lecture_integrand unit = { lecture_integrals_5x4, 0, 1 };
    const struct lecture_integrand twice = { lecture_integrals_5x4, 0, 2 };
    const double sigma_unit = 4 / 3.0, sigma_twice = 128 / 3.0; /* variances 16/9 and 16384/9 */

    page_heading(page, "∫ 5x^{4} dx: uniform samples, and samples of its own density");
    page_text(
        page,
        "Over [0, 1] the integral is 1, over [0, 2] it is 32. With uniform samples the "
        "density is p = 1 and p = 1/2; the standard deviation of one sample is 4/3 and 128/3. "
        "With the density p(x) = 5x^{4}, drawn by the inverse of its distribution, x = "
        "u^{1/5}, every sample gives f/p = 1: the variance is zero.");
    page_table_begin(page, NULL,
                     "N\t[0, 1] uniform\tσ/√N\terror in σ/√N\t[0, 2] uniform\tσ/√N\terror in "
                     "σ/√N\t[0, 1] by own density\tvariance of its samples");
    for (uint64_t n = 1; n <= (lecture->quick ? 10000u : 1000000u); n *= 10) {
        struct lecture_dice dice = lecture_dice(lecture->seed, POLYNOMIAL, n);
        double one = lecture_integrals_random(&unit, n, &dice);
        double two = lecture_integrals_random(&twice, n, &dice);
        struct lecture_dice own = lecture_dice(lecture->seed, OWN_PDF, n);
        struct moments importance = lecture_integrals_importance(n, &own);
        double root = sqrt((double)n);
        char variance[32] = "-";
        if (n > 1)
            snprintf(variance, sizeof(variance), "%g", moments_variance(&importance));
        page_row(page, "%" PRIu64 "\t%.5f\t%.5f\t%+.2f\t%.4f\t%.4f\t%+.2f\t%.5f\t%s", n, one,
                 sigma_unit / root, (one - 1) / sigma_unit * root, two, sigma_twice / root,
                 (two - 32) / sigma_twice * root, importance.mean, variance);
    }
    page_table_end(page);
    page_note(page, "Trap",
              "u must not be 0 here: x would be 0, and f/p would be 0/0. We draw u from (0, 1] "
              "by taking 1 - u.");
}

static void write_rand(struct lecture *lecture)
{
    page_heading(lecture->page, "The lecture's uniform()");
    page_code(lecture->page, "return((float)rand()/((float)(RAND_MAX)));");
    page_note(
        lecture->page, "Trap",
        "This returns exactly 1.0 for %u of the 2^{31} outputs of rand(): some 30 times in a "
        "thousand million, the end of [0, 1) is hit, where an index floor(u n) lies beyond its "
        "array and a logarithm of 1 - u is infinite. It also has a hidden state shared by "
        "threads, and RAND_MAX may be 32767. Our numbers are hashes of what they are for "
        "(seed, experiment, number) and lie in [0, 1 - 2^{-53}].",
        lecture_integrals_rand_ones());
}

static void plot_wave(struct lecture *lecture)
{
    enum { STEPS = 200 };
    static double x[STEPS + 1], y[STEPS + 1];
    for (int i = 0; i <= STEPS; i++) {
        x[i] = i / (double)STEPS;
        y[i] = lecture_integrals_wave(x[i]);
    }
    double ends[2] = { 0, 1 }, top[2] = { E, E };
    double impossible = 2.75039, middle = .5;
    const struct plot_series series[] = {
        { "f(x)", PLOT_LINE, STEPS + 1, x, y, NULL },
        { "printed for N = 1: no x gives this", PLOT_MARKERS, 1, &middle, &impossible, NULL },
        { "largest value, e = 2.71828...", PLOT_DASHED | PLOT_GREY, 2, ends, top, NULL },
    };
    page_plot(lecture->page,
              &(struct plot){ .title = "f(x) = e^{sin(3x²)}",
                              .x = { .label = "x", .low = 0, .high = 1 },
                              .y = { .label = "f(x)", .low = 0, .high = 3 },
                              .series = series,
                              .series_count = 3 },
              NULL);
}

/* The slide's numbers beside ours, each with its distance from the truth in standard errors */
static void write_wave_table(struct lecture *lecture, const struct lecture_wave *wave)
{
    struct page *page = lecture->page;
    const struct lecture_integrand unit = { lecture_integrals_wave, 0, 1 };
    page_table_begin(page,
                     "One estimate each. In brackets: distance from the true value in standard "
                     "errors of the theory.",
                     "N\tunstratified, on the slide\tunstratified, here\tstratified, on the "
                     "slide\tstratified, here");
    for (int i = 0; i < PRINTED_COUNT; i++) {
        uint64_t n = PRINTED[i].n;
        if (lecture->quick && n > 10000)
            break;
        struct lecture_dice dice = lecture_dice(lecture->seed, WAVE_ROW, n);
        double random = lecture_integrals_random(&unit, n, &dice);
        double stratified = lecture_integrals_stratified(&unit, n, &dice);
        double sigma = wave->sigma / sqrt((double)n);
        double strata = n == 1 ? sigma : wave->stratified_scale / ((double)n * sqrt((double)n));
        char slide[2][64] = { "not there", "not there" };
        if (PRINTED[i].random > 0) {
            snprintf(slide[0], sizeof(slide[0]), "%g (impossible)", PRINTED[i].random);
            if (PRINTED[i].random < E)
                snprintf(slide[0], sizeof(slide[0]), "%g (%+.1f)", PRINTED[i].random,
                         (PRINTED[i].random - wave->integral) / sigma);
            snprintf(slide[1], sizeof(slide[1]), "%.5f (%+.1f)", PRINTED[i].stratified,
                     (PRINTED[i].stratified - wave->integral) / strata);
            if (strata < 5e-6) /* half of its last digit */
                snprintf(slide[1], sizeof(slide[1]), "%.5f (rounded)", PRINTED[i].stratified);
        }
        page_row(page, "%" PRIu64 "\t%s\t%.5f (%+.1f)\t%s\t%.9f (%+.1f)", n, slide[0], random,
                 (random - wave->integral) / sigma, slide[1], stratified,
                 (stratified - wave->integral) / strata);
    }
    page_table_end(page);
}

/* RMSE of both ways from many estimates; their slopes on the page */
static void write_wave_rates(struct lecture *lecture, const struct lecture_wave *wave)
{
    struct page *page = lecture->page;
    const struct lecture_integrand unit = { lecture_integrals_wave, 0, 1 };
    struct lecture_rate random = { 0 }, stratified = { 0 };
    double theory[2][LECTURE_RATE_MAX];
    uint64_t most = lecture->quick ? 10000 : 1000000, work = lecture->quick ? 400000 : 40000000;
    for (uint64_t n = 1; n <= most; n *= 10) {
        unsigned runs = (unsigned)(work / n < 1000 ? work / n : 1000);
        theory[0][random.count] = wave->sigma / sqrt((double)n);
        theory[1][random.count] = wave->stratified_scale / ((double)n * sqrt((double)n));
        lecture_rate_add(&random, lecture_integrals_random, &unit, wave->integral, n, runs,
                         lecture_dice(lecture->seed, WAVE, 0));
        lecture_rate_add(&stratified, lecture_integrals_stratified, &unit, wave->integral, n, runs,
                         lecture_dice(lecture->seed, WAVE, 1));
    }
    struct fit_line slope[2] = { lecture_rate_fit(&random, 100),
                                 lecture_rate_fit(&stratified, 100) };
    char names[2][64];
    snprintf(names[0], sizeof(names[0]), "random: slope %s", lecture_slope_text(slope[0]));
    snprintf(names[1], sizeof(names[1]), "stratified: slope %s", lecture_slope_text(slope[1]));
    const struct plot_series series[] = {
        { names[0], PLOT_MARKERS, random.count, random.n, random.rmse, random.error },
        { names[1], PLOT_MARKERS, stratified.count, stratified.n, stratified.rmse,
          stratified.error },
        { "theory: 0.600 N^{-1/2}", PLOT_DASHED | PLOT_GREY, random.count, random.n, theory[0],
          NULL },
        { "theory: 1.161 N^{-3/2}", PLOT_LINE | PLOT_GREY, random.count, random.n, theory[1],
          NULL },
    };
    page_plot(page,
              &(struct plot){ .title = "Error of the integral of e^{sin(3x²)}",
                              .x = { .label = "samples N", .log = true },
                              .y = { .label = "root mean square error", .log = true },
                              .series = series,
                              .series_count = 4 },
              "Each point is the error of many estimates (1000, fewer where N is large), with "
              "its standard error; slopes are fitted from N = 100 on.");
    page_table_begin(page, NULL, "N\trandom: RMSE\ttheory\tratio\tstratified: RMSE\ttheory\tratio");
    for (size_t i = 0; i < random.count; i++)
        page_row(page, "%.0f\t%.4g\t%.4g\t%.3f\t%.4g\t%.4g\t%.3f", random.n[i], random.rmse[i],
                 theory[0][i], random.rmse[i] / theory[0][i], stratified.rmse[i], theory[1][i],
                 stratified.rmse[i] / theory[1][i]);
    page_table_end(page);
    page_note(page, "Trap",
              "The slide says O(1/N) for the stratified column. In one dimension a smooth function "
              "does better, N^{-3/2}: each of N strata is 1/N wide, the function varies in it by "
              "|f'|/N, and N such errors average out as 1/√N. Measured: %s. (For one sample there "
              "is only one stratum; the law holds once strata are narrower than the waves of f.)",
              lecture_slope_text(slope[1]));
}

static void write_wave(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct lecture_wave wave = lecture_integrals_wave_theory();
    page_heading(page, "∫ e^{sin(3x²)} dx over [0, 1]: random against stratified");
    page_text(page,
              "The true value is %.12f (Simpson's rule with 20,000 steps). One random sample has "
              "the standard deviation σ = %.12f, so N of them have the error %.6f/√N. With one "
              "sample in each of N strata the error is √(∫f'²/12) N^{-3/2} = %.11f N^{-3/2}.",
              wave.integral, wave.sigma, wave.sigma, wave.stratified_scale);
    plot_wave(lecture);
    page_note(
        page, "Trap",
        "The slide's first row, 2.75039 for one unstratified sample, is impossible: no value "
        "of f is above e = 2.718281828. All other numbers are possible: the largest deviation, "
        "+2.7 standard errors, is there by chance in one of fourteen such tables.");
    write_wave_table(lecture, &wave);
    page_note(page, "Trap",
              "The slide's last stratified rows, twice 1.77610, look as if nothing improved any "
              "more. It is the true value 1.776099 rounded to five decimals; at N = 100,000 the "
              "error to expect is %.1e.",
              wave.stratified_scale / (1e5 * sqrt(1e5)));
    write_wave_rates(lecture, &wave);
}

/* Points of the square of side 2, by whether they lie in the disc; random, or one in each cell */
static void plot_disc(struct lecture *lecture, bool cells)
{
    enum { SIDE = 32, POINTS = SIDE * SIDE };
    static double x[2][POINTS], y[2][POINTS];
    size_t count[2] = { 0, 0 };
    struct lecture_dice dice = lecture_dice(lecture->seed, DISC, cells);
    for (int i = 0; i < POINTS; i++) {
        double a = lecture_roll(&dice), b = lecture_roll(&dice);
        if (cells) {
            a = (i % SIDE + a) / SIDE;
            b = (i / SIDE + b) / SIDE;
        }
        a = 2 * a - 1;
        b = 2 * b - 1;
        int inside = a * a + b * b <= 1;
        x[inside][count[inside]] = a;
        y[inside][count[inside]++] = b;
    }
    const struct plot_series series[] = {
        { NULL, PLOT_DOTS, count[1], x[1], y[1], NULL },
        { NULL, PLOT_DOTS, count[0], x[0], y[0], NULL },
    };
    char caption[160];
    snprintf(caption, sizeof(caption), "%d %s, r = %zu of them in the disc: 4r/n = %.4f", POINTS,
             cells ? "points, one in each of 32 × 32 cells" : "random points", count[1],
             4 * (double)count[1] / POINTS);
    page_plot(lecture->page,
              &(struct plot){ .title = "Points in a square and in its disc",
                              .x = { .low = -1, .high = 1 },
                              .y = { .low = -1, .high = 1 },
                              .series = series,
                              .series_count = 2,
                              .square = true,
                              .untitled = true },
              caption);
}

static void write_pi(struct lecture *lecture)
{
    struct page *page = lecture->page;
    page_heading(page, "π by hit and miss, and what strata do in two dimensions");
    page_text(page,
              "Of n points in the square of side 2, r fall into the circle, and 4r/n tends to π. "
              "One point has the variance π(4 - π) = 2.69677, so the error is 1.642/√n: each "
              "further digit costs a hundred times the points.");
    struct lecture_rate random = { 0 }, cells = { 0 }, smooth_cells = { 0 };
    page_grid_begin(page, 280);
    plot_disc(lecture, false);
    plot_disc(lecture, true);
    page_grid_end(page);
    page_table_begin(
        page, NULL,
        "n\t4r/n, random\terror in standard errors\t4r/n, a point in each of n cells\terror");
    for (uint64_t n = 4; n <= (lecture->quick ? 16384u : 1048576u); n *= 4) {
        struct lecture_dice dice = lecture_dice(lecture->seed, PI_RANDOM, n);
        double one = lecture_integrals_pi_random(NULL, n, &dice);
        double two = lecture_integrals_pi_stratified(NULL, n, &dice);
        page_row(page, "%" PRIu64 "\t%.5f\t%+.2f\t%.5f\t%+.5f", n, one,
                 (one - LECTURE_PI) / sqrt(LECTURE_PI * (4 - LECTURE_PI) / (double)n), two,
                 two - LECTURE_PI);
        if (n < 16 || n > 65536)
            continue;
        unsigned runs = lecture->quick ? 50 : n > 10000 ? 100 : 400;
        lecture_rate_add(&random, lecture_integrals_pi_random, NULL, LECTURE_PI, n, runs,
                         lecture_dice(lecture->seed, PI_CELLS, 0));
        lecture_rate_add(&cells, lecture_integrals_pi_stratified, NULL, LECTURE_PI, n, runs,
                         lecture_dice(lecture->seed, PI_CELLS, 1));
        lecture_rate_add(&smooth_cells, lecture_integrals_smooth_stratified, NULL,
                         (E - 1) * (E - 1), n, runs, lecture_dice(lecture->seed, SMOOTH, 0));
    }
    page_table_end(page);
    const struct lecture_rate *rates[3] = { &random, &cells, &smooth_cells };
    static const char *const what[3] = { "π, random points", "π, points in cells",
                                         "∫e^{x+y}, points in cells" };
    static const char *const theory[3] = { "-1/2", "-3/4", "-1" };
    struct plot_series series[3];
    char names[3][96];
    for (int i = 0; i < 3; i++) {
        snprintf(names[i], sizeof(names[i]), "%s: slope %s (theory: %s)", what[i],
                 lecture_slope_text(lecture_rate_fit(rates[i], 256)), theory[i]);
        series[i] = (struct plot_series){ names[i],    PLOT_MARKERS | PLOT_LINE, rates[i]->count,
                                          rates[i]->n, rates[i]->rmse,           rates[i]->error };
    }
    page_plot(page,
              &(struct plot){ .title = "What strata are worth in two dimensions",
                              .x = { .label = "points", .log = true },
                              .y = { .label = "root mean square error", .log = true },
                              .series = series,
                              .series_count = 3 },
              "Slopes are fitted from 256 points on.");
    page_note(page, "Result",
              "What strata are worth depends on the dimension and on the function: N^{-3/2} for a "
              "smooth one in one dimension, N^{-1} in two (that is the slide's O(1/N)), and only "
              "N^{-3/4} where an edge crosses the cells, as in most pixels worth looking at.");
}

void lecture_integrals_write(struct lecture *lecture)
{
    page_section(lecture->page, "Monte Carlo integration");
    write_die(lecture);
    write_polynomial(lecture);
    write_rand(lecture);
    page_section(lecture->page, "Variance reduction by strata");
    write_wave(lecture);
    write_pi(lecture);
}
