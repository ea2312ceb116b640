#include "master/lecture_roulette.h"

#include "common/moments.h"
#include "master/lecture_light.h"
#include "master/page.h"
#include "master/plot.h"

#include <math.h>
#include <stdio.h>

enum purpose { FURNACE = 500, PICTURE, CAPPED, WHOLE };

/* With X = 1 + B (albedo / q) X', B being 1 with probability q, mean and mean square follow */
struct lecture_furnace lecture_roulette_theory(double albedo, double q)
{
    double mean = 1 / (1 - albedo), left = 1 - albedo * albedo / q;
    return (struct lecture_furnace){
        .mean = mean,
        .variance = left > 0 ? (1 + 2 * albedo * mean) / left - mean * mean : INFINITY,
        .walls = 1 / (1 - q),
    };
}

struct lecture_furnace lecture_roulette_measure(double albedo, double q, uint64_t n,
                                                struct lecture_dice dice, double *error)
{
    struct moments sums = { 0 };
    uint64_t walls = 0;
    for (uint64_t i = 0; i < n; i++) {
        double weight = 1, sum = 1;
        for (walls++; lecture_roll(&dice) < q; walls++) {
            weight *= albedo / q;
            sum += weight;
        }
        moments_add(&sums, sum);
    }
    *error = moments_stderr(&sums);
    return (struct lecture_furnace){ sums.mean, moments_variance(&sums),
                                     (double)walls / (double)n };
}

/* ---- in the furnace */

static void plot_variance(struct lecture *lecture)
{
    enum { STEPS = 69, CURVES = 2, MEASURED = 6 };
    static const double ALBEDO[CURVES] = { .5, .8 };
    double q[STEPS], variance[CURVES][STEPS], work[CURVES][STEPS];
    double at[CURVES][MEASURED], measured[CURVES][MEASURED];
    for (int a = 0; a < CURVES; a++) {
        for (int i = 0; i < STEPS; i++) {
            q[i] = .3 + .01 * i;
            struct lecture_furnace f = lecture_roulette_theory(ALBEDO[a], q[i]);
            variance[a][i] = f.variance;
            work[a][i] = f.variance * f.walls;
        }
        for (int i = 0; i < MEASURED; i++) {
            /* Where a variance is only just finite, measuring it takes forever */
            double low = ALBEDO[a] * ALBEDO[a] + .15, error;
            at[a][i] = low + (.95 - low) * i / (MEASURED - 1);
            measured[a][i] = lecture_roulette_measure(
                                 ALBEDO[a], at[a][i], lecture->quick ? 2000 : 200000,
                                 lecture_dice(lecture->seed, FURNACE, (uint64_t)(100 * a + i)),
                                 &error)
                                 .variance;
        }
    }
    const struct plot_series series[] = {
        { "albedo 0.5: variance, theory", PLOT_LINE, STEPS, q, variance[0], NULL },
        { "measured", PLOT_MARKERS | PLOT_SAME, MEASURED, at[0], measured[0], NULL },
        { "variance × walls, theory", PLOT_DASHED | PLOT_SAME, STEPS, q, work[0], NULL },
        { "albedo 0.8: variance, theory", PLOT_LINE, STEPS, q, variance[1], NULL },
        { "measured", PLOT_MARKERS | PLOT_SAME, MEASURED, at[1], measured[1], NULL },
        { "variance × walls, theory", PLOT_DASHED | PLOT_SAME, STEPS, q, work[1], NULL },
    };
    page_plot(
        lecture->page,
        &(struct plot){ .title = "What a survival probability costs",
                        .x = { .label = "survival probability q", .low = .3, .high = 1 },
                        .y = { .label = "variance", .log = true, .low = .05, .high = 1000 },
                        .series = series,
                        .series_count = 6 },
        "Solid: of one path, with what was measured. Dashed: times the walls it hits, that is "
        "for a given number of rays. The left ends rise to infinity at q = albedo².");
}

static void write_furnace(struct lecture *lecture)
{
    static const double Q[] = { .2, .3, .4, .5, .6, .8, .95 };
    struct page *page = lecture->page;
    uint64_t n = lecture->quick ? 10000 : 1000000;
    page_text(page,
              "After each reflection a path survives with probability q, and survivors are "
              "weighted by 1/q. In a furnace (walls that emit 1 and reflect 0.5 of it) the light "
              "is 1/(1 - 0.5) = 2 everywhere, whatever q:");
    page_table_begin(page, NULL,
                     "q\tmean (2)\t± standard error\terror in them\tvariance\ttheory\twalls per "
                     "path\ttheory\tvariance × walls");
    for (size_t i = 0; i < sizeof(Q) / sizeof(Q[0]); i++) {
        double error;
        struct lecture_furnace got = lecture_roulette_measure(
            .5, Q[i], n, lecture_dice(lecture->seed, FURNACE, 1000 + i), &error);
        struct lecture_furnace want = lecture_roulette_theory(.5, Q[i]);
        char theory[2][32] = { "infinite", "infinite" };
        if (isfinite(want.variance)) {
            snprintf(theory[0], sizeof(theory[0]), "%.3f", want.variance);
            snprintf(theory[1], sizeof(theory[1]), "%.2f", want.variance * want.walls);
        }
        page_row(page, "%.2f\t%.4f\t%.4f\t%+.2f\t%.3f\t%s\t%.3f\t%.3f\t%s", Q[i], got.mean, error,
                 (got.mean - want.mean) / error, got.variance, theory[0], got.walls, want.walls,
                 theory[1]);
    }
    page_table_end(page);
    page_note(page, "Result",
              "Unbiased for every q, but the variance is finite only if albedo² < q: below q = "
              "0.25 here, a few paths with huge weights carry the mean, and its standard error "
              "cannot be told. Survival by the albedo, q = 0.5, keeps all weights at 1. A furnace "
              "rewards long paths, since "
              "every wall adds to the sum: for a given number of rays the variance still falls "
              "towards q = 1. In a picture the first wall matters most, see below.");
    plot_variance(lecture);
    page_note(page, "Trap",
              "The slide ends a path if r > q. With r in [0, 1) and q = 0, r = 0 survives, and "
              "its weight is divided by 0. Ours survives if r < q: never with q = 0, always with "
              "q = 1.");
}

/* ---- in the room */

static void write_picture(struct lecture *lecture)
{
    static const double Q[] = { 0, .9, .7, .5, .3 };
    struct page *page = lecture->page;
    struct caster_scene room = lecture_light_room(false);
    unsigned size = lecture->quick ? 12 : 48;
    uint64_t paths = lecture->quick ? 4 : 64;
    page_heading(page, "Russian roulette in a picture");
    page_table_begin(page,
                     "The diffuse room with light sampling. Error × √rays: the error for a given "
                     "number of rays.",
                     "survival\tmean of the picture\t± standard error\trays per path\terror of the "
                     "picture\terror × √rays");
    for (size_t i = 0; i < sizeof(Q) / sizeof(Q[0]); i++) {
        const struct caster_how how = { .light_sampling = true, .survival = Q[i] };
        struct lecture_pair pair = lecture_light_pair(&room, &how, size, paths,
                                                      hash64_3(lecture->seed, PICTURE, i));
        char survival[32] = "the reflectance";
        if (Q[i] > 0)
            snprintf(survival, sizeof(survival), "q = %.1f", Q[i]);
        double rays = lecture_light_rays(&pair), rmse = lecture_light_rmse(&pair);
        page_row(page, "%s\t%.5f\t%.5f\t%.2f\t%.4f\t%.4f", survival, lecture_light_mean(&pair),
                 lecture_light_mean_error(&pair), rays, rmse, rmse * sqrt(rays * (double)paths));
        lecture_light_pair_free(&pair);
    }
    page_table_end(page);
    page_note(page, "Result",
              "The mean is the same within its errors. Long paths are less noisy, and cost more "
              "rays than that is worth; paths too short carry large weights. Survival by the "
              "reflectance is near the best, without a number to choose.");
}

static void write_caps(struct lecture *lecture)
{
    static const unsigned CAPS[] = { 1, 2, 3, 5, 8 };
    struct page *page = lecture->page;
    struct caster_scene room = lecture_light_room(false);
    unsigned size = lecture->quick ? 12 : 48;
    uint64_t paths = lecture->quick ? 8 : 128;
    const struct caster_how whole = { .light_sampling = true };
    struct lecture_pair all = lecture_light_pair(&room, &whole, size, 4 * paths,
                                                 hash64(lecture->seed, WHOLE));
    page_heading(page, "A largest depth is a bias");
    page_table_begin(page, "The same room, paths cut off after so many reflections.",
                     "reflections\tmean of the picture\t± standard error\tlight that is missing");
    for (size_t i = 0; i < sizeof(CAPS) / sizeof(CAPS[0]); i++) {
        const struct caster_how how = { .light_sampling = true,
                                        .max_depth = CAPS[i],
                                        .survival = 1 };
        struct lecture_pair pair = lecture_light_pair(&room, &how, size, paths,
                                                      hash64_3(lecture->seed, CAPPED, i));
        page_row(page, "at most %u\t%.5f\t%.5f\t%.1f %%", CAPS[i], lecture_light_mean(&pair),
                 lecture_light_mean_error(&pair),
                 100 * (1 - lecture_light_mean(&pair) / lecture_light_mean(&all)));
        lecture_light_pair_free(&pair);
    }
    page_row(page, "no limit\t%.5f\t%.5f\t-", lecture_light_mean(&all),
             lecture_light_mean_error(&all));
    page_table_end(page);
    page_note(page, "Trap",
              "A path tracer with a largest depth is not unbiased, however many paths it takes. "
              "`{pathfarm render} reports the energy that a depth limit cut off.");
    lecture_light_pair_free(&all);
}

void lecture_roulette_write(struct lecture *lecture)
{
    page_section(lecture->page, "Russian roulette");
    write_furnace(lecture);
    write_picture(lecture);
    write_caps(lecture);
}
