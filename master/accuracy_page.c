#include "master/accuracy_page.h"

#include "common/err.h"
#include "master/accuracy_peers.h"
#include "master/accuracy_run.h"
#include "master/image.h"
#include "master/page.h"
#include "master/plot.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#define COLOURS 6 /* of plot.h; after so many curves they come again, dashed */

/* ---- numbers as texts, in buffers of the caller */

struct text {
    char text[64];
};

static struct text number_text(double value, const char *format)
{
    struct text t = { "—" };
    if (isfinite(value))
        snprintf(t.text, sizeof(t.text), format, value);
    return t;
}

/* "0.0123 ± 0.0004": the error with two digits, the value with as many decimals */
static struct text value_text(double value, double error)
{
    struct text t = { "—" };
    if (!isfinite(value))
        return t;
    if (!isfinite(error) || error <= 0) {
        snprintf(t.text, sizeof(t.text), "%.3g", value);
        return t;
    }
    int places = 1 - (int)floor(log10(error));
    if (places > 6) /* as powers of ten */
        snprintf(t.text, sizeof(t.text), "%.1e ± %.0e", value, error);
    else
        snprintf(t.text, sizeof(t.text), "%.*f ± %.*f", places < 0 ? 0 : places, value,
                 places < 0 ? 0 : places, error);
    return t;
}

static struct text speedup_text(const struct accuracy_curve *curve,
                                const struct accuracy_curve *base)
{
    if (curve == base)
        return (struct text){ "1" };
    if (isfinite(curve->speedup_below))
        return number_text(curve->speedup_below, "below %.2g");
    return value_text(curve->speedup.value, curve->speedup.error);
}

static struct text slope_text(const struct accuracy_curve *curve)
{
    struct text t = { "—" };
    if (isfinite(curve->slope.value))
        snprintf(t.text, sizeof(t.text), "%.2f ± %.2f", curve->slope.value, curve->slope.error);
    return t;
}

/* ---- plots */

/* A curve as a series of numbers */
struct line {
    double x[ACCURACY_RUNGS_MAX], y[ACCURACY_RUNGS_MAX], error[ACCURACY_RUNGS_MAX];
    char name[96];
};

enum { SERIES_MAX = ACCURACY_SETUPS_MAX + ACCURACY_PEERS_MAX + 1 };

struct figure {
    struct line lines[ACCURACY_SETUPS_MAX];
    struct plot_series series[SERIES_MAX];
    size_t count;
    double theory_x[2], theory_y[2];
    double peer_x[ACCURACY_PEERS_MAX], peer_y[ACCURACY_PEERS_MAX];
};

static void add_curve(struct figure *figure, const struct accuracy_curve *curve)
{
    struct line *line = &figure->lines[figure->count];
    for (size_t i = 0; i < curve->count; i++) {
        line->x[i] = curve->rungs[i].facts.core_s;
        line->y[i] = curve->rungs[i].point.relmse;
        line->error[i] = ACCURACY_BAND * curve->rungs[i].point.relmse_error;
    }
    if (isfinite(curve->slope.value))
        snprintf(line->name, sizeof(line->name), "%s: %s", curve->setup->name,
                 slope_text(curve).text);
    else
        snprintf(line->name, sizeof(line->name), "%s", curve->setup->name);
    bool again = figure->count / COLOURS % 2 == 1;
    figure->series[figure->count++] = (struct plot_series){
        .name = line->name,
        .style = (again ? PLOT_DASHED : PLOT_LINE) | PLOT_MARKERS,
        .count = curve->count,
        .x = line->x,
        .y = line->y,
        .error = line->error,
    };
}

/* What independent samples would do that end where the first curve does */
static void add_theory(struct figure *figure, const struct accuracy_curve *curve)
{
    const struct accuracy_rung *last = accuracy_curve_last(curve);
    if (last == NULL)
        return;
    figure->theory_x[0] = curve->rungs[0].facts.core_s;
    figure->theory_x[1] = last->facts.core_s;
    figure->theory_y[0] = last->point.relmse * last->facts.core_s / figure->theory_x[0];
    figure->theory_y[1] = last->point.relmse;
    figure->series[figure->count++] = (struct plot_series){ .name = "independent samples: -1",
                                                            .style = PLOT_DASHED | PLOT_GREY,
                                                            .count = 2,
                                                            .x = figure->theory_x,
                                                            .y = figure->theory_y };
}

/* The points of one name are one series */
static void add_peers(struct figure *figure, const struct accuracy_peers *peers)
{
    bool added[ACCURACY_PEERS_MAX] = { false };
    size_t used = 0;
    for (size_t i = 0; i < peers->count; i++) {
        const char *name = peers->points[i].name;
        const size_t first = used;
        for (size_t k = i; k < peers->count; k++) {
            if (added[k] || strcmp(peers->points[k].name, name) != 0)
                continue;
            added[k] = true;
            figure->peer_x[used] = peers->points[k].core_s;
            figure->peer_y[used++] = peers->points[k].relmse;
        }
        if (used > first)
            figure->series[figure->count++] = (struct plot_series){ .name = name,
                                                                    .style = PLOT_MARKERS,
                                                                    .count = used - first,
                                                                    .x = figure->peer_x + first,
                                                                    .y = figure->peer_y + first };
    }
}

/* The curves of one group beside the first, or all of them; and peers, if given */
static void fill_figure(struct figure *figure, const struct accuracy_study *study,
                        const char *group, const struct accuracy_peers *peers)
{
    figure->count = 0;
    for (size_t i = 0; i < study->curve_count; i++) {
        const struct accuracy_curve *curve = &study->curves[i];
        if (curve->count > 0 &&
            (i == 0 || group == NULL || strcmp(curve->setup->group, group) == 0))
            add_curve(figure, curve);
    }
    if (peers != NULL)
        add_peers(figure, peers);
    add_theory(figure, &study->curves[0]);
}

static struct plot plot_of(const struct figure *figure, const char *title, bool untitled)
{
    return (struct plot){
        .title = title,
        .x = { .label = "core-seconds", .log = true },
        .y = { .label = "relMSE", .log = true },
        .series = figure->series,
        .series_count = figure->count,
        .untitled = untitled,
    };
}

void accuracy_page_plot(const struct accuracy_study *study, const struct accuracy_peers *peers,
                        FILE *out)
{
    struct figure figure;
    fill_figure(&figure, study, NULL, peers);
    struct plot plot = plot_of(&figure, "Error against time, and slopes", false);
    plot_write(&plot, out);
    putc('\n', out);
}

/* ---- the page */

struct writer {
    struct page *page;
    const struct accuracy_study *study;
    const struct accuracy_peers *peers;
    const struct accuracy_facts *facts;
};

/* The longest time that all curves reached */
static double common_time(const struct accuracy_study *study)
{
    double time = INFINITY;
    for (size_t i = 0; i < study->curve_count; i++)
        if (study->curves[i].count > 0)
            time = fmin(time, accuracy_curve_last(&study->curves[i])->facts.core_s);
    return time;
}

/* Is there a curve of that name? */
static bool shows(const struct accuracy_study *study, const char *name)
{
    for (size_t i = 0; i < study->curve_count; i++)
        if (study->curves[i].count > 0 && strcmp(study->curves[i].setup->name, name) == 0)
            return true;
    return false;
}

/* ... or one without some technique? */
static bool switches(const struct accuracy_study *study)
{
    for (size_t i = 0; i < study->curve_count; i++)
        if (study->curves[i].count > 0 && study->curves[i].setup->techniques_off != 0)
            return true;
    return false;
}

static void write_summary(const struct writer *w)
{
    const struct accuracy_study *study = w->study;
    const double time = common_time(study);
    char caption[256];
    page_section(w->page, "What each technique is worth");
    page_text(w->page,
              "All of these converge to the same picture. They differ in how noisy it is after the "
              "same work. *{Speed} is how many times sooner than the default a configuration comes "
              "to the smallest error that both reached: below 1 is slower, — is too uncertain to "
              "tell.");
    snprintf(caption, sizeof(caption),
             "relMSE after %.3g core-seconds, and speed at equal error; ± is one standard error",
             time);
    page_table_begin(w->page, caption, "configuration\trelMSE\tspeed\twhat it is");
    for (size_t i = 0; i < study->curve_count; i++) {
        const struct accuracy_curve *curve = &study->curves[i];
        if (curve->count == 0)
            continue;
        struct accuracy_value error = accuracy_curve_error(curve, time);
        page_row(w->page, "%s\t%s\t%s\t%s", curve->setup->name,
                 value_text(error.value, error.error).text,
                 speedup_text(curve, &study->curves[0]).text, curve->setup->what);
    }
    page_table_end(w->page);
    if (shows(study, "everything") && switches(study))
        page_note(w->page, "Mind",
                  "Techniques are switched off in the kernel for everything: hold those rows "
                  "against the row `{everything}, which does nothing else.");
    for (size_t i = 0; i < study->curve_count; i++)
        if (study->curves[i].cut && study->curves[i].count > 0)
            page_note(w->page, "Mind",
                      "In `{%s} paths end after " ACCURACY_DEPTH_TEXT
                      " events, as the scene has no limit of its own; how much light that cuts is "
                      "told below as cut energy.",
                      study->curves[i].setup->name);
    for (size_t i = 0; i < study->curve_count; i++)
        if (study->curves[i].refusal != NULL)
            page_note(w->page, "Left out", "%s: %s.", study->curves[i].setup->name,
                      study->curves[i].refusal);
}

static void write_plots(const struct writer *w)
{
    static const struct {
        const char *group, *title;
    } GROUPS[] = {
        { "sampler", "Samplers: where the samples are" },
        { "technique", "Techniques: how light is found" },
        { "replicates", "Replicates: how many independent sequences share the samples" },
        { "kernel", "Kernels: only the scene's effects, or code for everything" },
    };
    page_section(w->page, "Error against time");
    page_text(w->page,
              "Both axes are logarithmic; lower and further left is better. Bars are 95 %% "
              "intervals. Beside each name is the slope of its curve: independent samples fall "
              "with -1 (half the error for twice the time), well distributed ones faster.");
    struct figure figure;
    for (size_t g = 0; g < sizeof(GROUPS) / sizeof(GROUPS[0]); g++) {
        fill_figure(&figure, w->study, GROUPS[g].group, NULL);
        if (figure.count < 3) /* nothing but the default and the theory */
            continue;
        struct plot plot = plot_of(&figure, GROUPS[g].title, true);
        page_heading(w->page, GROUPS[g].title);
        page_plot(w->page, &plot, NULL);
    }
    if (w->peers->count > 0) {
        fill_figure(&figure, w->study, NULL, w->peers);
        struct plot plot = plot_of(&figure, "All, and other renderers", true);
        page_heading(w->page, plot.title);
        page_plot(w->page, &plot,
                  "Points of other renderers are as given: they compare if they "
                  "are of the same picture, epsilon and machine.");
    }
}

static void write_tables(const struct writer *w)
{
    const struct accuracy_study *study = w->study;
    page_section(w->page, "Every figure");
    page_text(w->page,
              "At the end of each ladder of sample counts, within %.3g core-seconds. All rungs are "
              "in accuracy.csv.",
              w->facts->core_s);
    page_table_begin(w->page, "How far from the truth",
                     "configuration\trelMSE\t95 % band\tbias^{2}\tslope\tcut energy\tnon-finite");
    for (size_t i = 0; i < study->curve_count; i++) {
        const struct accuracy_curve *curve = &study->curves[i];
        const struct accuracy_rung *rung = accuracy_curve_last(curve);
        if (rung == NULL)
            continue;
        const struct accuracy_point *p = &rung->point;
        const double band = ACCURACY_BAND * p->relmse_error;
        page_row(w->page, "%s\t%.3g\t%.3g to %.3g\t%s\t%s\t%.2g\t%" PRIu64, curve->setup->name,
                 p->relmse, p->relmse - band, p->relmse + band,
                 value_text(p->bias2, p->bias2_error).text, slope_text(curve).text,
                 rung->facts.truncated_energy, rung->facts.nonfinite);
    }
    page_table_end(w->page);
    page_table_begin(w->page, "What it took", "configuration\tspp\tK\tcore s\twall s\tTTUV\tspeed");
    for (size_t i = 0; i < study->curve_count; i++) {
        const struct accuracy_curve *curve = &study->curves[i];
        const struct accuracy_rung *rung = accuracy_curve_last(curve);
        if (rung != NULL)
            page_row(w->page, "%s\t%" PRIu64 "\t%" PRIu32 "\t%.3g\t%.3g\t%.3g\t%s",
                     curve->setup->name, rung->facts.spp, rung->facts.replicates,
                     rung->facts.core_s, rung->facts.wall_s, accuracy_curve_ttuv(rung),
                     speedup_text(curve, &study->curves[0]).text);
    }
    page_table_end(w->page);
}

static void write_meanings(const struct writer *w)
{
    const struct accuracy_study *study = w->study;
    page_section(w->page, "How to read this");
    page_table_begin(w->page, NULL, "\t");
    page_row(w->page, "spp, K\tsamples per pixel, and the replicates that share them");
    page_row(w->page, "core s, wall s\tprocessor time of the render threads, which is what is "
                      "compared; and by the clock, starting up included");
    page_row(w->page,
             "relMSE\tmean of (x - r)^{2} / (r^{2} + %g) over pixels and channels, r the "
             "reference; what the reference's own noise adds is taken off",
             ACCURACY_EPSILON);
    page_row(w->page, "the 95 %% band\tof relMSE, from how pixels differ between %u seeds",
             study->curves[0].seeds);
    page_row(w->page, "bias^{2}\tthe part of relMSE that more samples would not remove: relMSE "
                      "minus the variance between seeds. Zero within its error is what all "
                      "should have; it may come out negative");
    page_row(w->page, "TTUV\ttime to unit variance: core-seconds until the relative variance "
                      "would be one. Smaller is better");
    page_row(w->page, "slope\tof ln relMSE over ln core-seconds, fitted to the samples with as "
                      "many replicates as the last");
    page_row(
        w->page,
        "speed\tcore-seconds of the default over those of a configuration, both at the "
        "smallest error that both reached; logarithms are interpolated between "
        "numbers of samples. ± takes the pictures as independent. They share their "
        "seeds, so where two are alike it says too much. “below” is a bound: this "
        "one ends above where the default begins. — is where errors are too uncertain to tell");
    page_row(w->page, "cut energy\tthroughput of paths that the depth limit cut, per camera path: "
                      "it compares with pixel values");
    page_row(w->page, "non-finite\tsamples that were no numbers and were left out");
    page_table_end(w->page);
    if (study->reference_spp > 0)
        page_text(w->page,
                  "The reference has %" PRIu64 " samples per pixel of the default, from seeds that "
                  "none of the pictures has, and took %.3g core-seconds. Its own relMSE is about "
                  "%.2g.",
                  study->reference_spp, study->reference_core_s, study->reference_variance);
    else if (isfinite(study->reference_variance))
        page_text(w->page, "The reference came from a file; its own relMSE is about %.2g.",
                  study->reference_variance);
    else
        page_note(w->page, "Caution",
                  "The reference does not say how noisy it is (channels stderr.R, ...): errors and "
                  "biases here include its own.");
    page_text(w->page, "Picture: %" PRIu32 " x %" PRIu32 " pixels of `{%s}. Made by:",
              study->reference->width, study->reference->height, w->facts->scene);
    page_code(w->page, w->facts->command);
}

static void write_crops(const struct writer *w)
{
    const struct accuracy_study *study = w->study;
    page_section(w->page, "To look at");
    page_text(w->page,
              "The same %" PRIu32 " x %" PRIu32 " pixels, where the picture is noisiest, with more "
              "and more paths per pixel. At equal samples, not equal time.",
              study->window.side, study->window.side);
    for (size_t i = 0; i < study->curve_count; i++) {
        const struct accuracy_curve *curve = &study->curves[i];
        if (curve->crops[0] == NULL)
            continue;
        page_heading(w->page, curve->setup->name);
        page_grid_begin(w->page, 130);
        for (int k = 0; k < ACCURACY_CROPS_MAX && curve->crops[k] != NULL; k++)
            page_picture(w->page, curve->crops[k], "%" PRIu64 " per pixel", curve->crop_spp[k]);
        page_picture(w->page, study->window_reference, "reference");
        page_grid_end(w->page);
    }
}

bool accuracy_page_write(const struct accuracy_study *study, const struct accuracy_peers *peers,
                         const struct accuracy_facts *facts, const char *path, struct err *err)
{
    char title[512], lead[512];
    const char *slash = strrchr(facts->scene, '/');
    snprintf(title, sizeof(title), "What accuracy costs in time: %s",
             slash == NULL ? facts->scene : slash + 1);
    snprintf(lead, sizeof(lead),
             "The same picture in %zu ways, each with about %.3g core-seconds, against an "
             "independent reference.",
             study->curve_count, facts->core_s);
    struct writer w = { page_new(title, lead), study, peers, facts };
    if (w.page == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the page");
    write_summary(&w);
    write_plots(&w);
    write_tables(&w);
    write_crops(&w);
    write_meanings(&w);
    bool saved = page_save(w.page, path, err);
    page_free(w.page);
    return saved;
}
