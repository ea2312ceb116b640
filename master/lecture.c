#include "master/lecture.h"

#include "common/err.h"
#include "common/moments.h"
#include "master/lecture_directions.h"
#include "master/lecture_integrals.h"
#include "master/lecture_light.h"
#include "master/lecture_points.h"
#include "master/lecture_roulette.h"
#include "master/page.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

void lecture_rate_note(struct lecture_rate *rate, uint64_t n, double rmse, double relative_error)
{
    if (rate->count == LECTURE_RATE_MAX)
        return;
    rate->n[rate->count] = (double)n;
    rate->rmse[rate->count] = rmse;
    rate->error[rate->count++] = rmse * relative_error;
}

void lecture_rate_add(struct lecture_rate *rate, lecture_estimate *estimate, const void *self,
                      double truth, uint64_t n, unsigned runs, struct lecture_dice dice)
{
    struct moments squares = { 0 };
    for (unsigned run = 0; run < runs; run++) {
        struct lecture_dice own = lecture_dice(dice.key, n, run);
        double error = estimate(self, n, &own) - truth;
        moments_add(&squares, error * error);
    }
    lecture_rate_note(rate, n, sqrt(squares.mean), 1 / sqrt(2.0 * runs));
}

struct fit_line lecture_rate_fit(const struct lecture_rate *rate, double from)
{
    size_t first = 0;
    double relative[LECTURE_RATE_MAX];
    for (size_t i = 0; i < rate->count; i++)
        relative[i] = rate->error[i] / rate->rmse[i];
    while (first < rate->count && rate->n[first] < from)
        first++;
    return fit_power(rate->n + first, rate->rmse + first, relative + first, rate->count - first);
}

const char *lecture_slope_text(struct fit_line fit)
{
    static char texts[4][32];
    static unsigned next;
    char *text = texts[next++ % 4];
    snprintf(text, sizeof(texts[0]), "%.3f ± %.3f", fit.slope, fit.slope_error);
    return text;
}

bool lecture_make(struct lecture *lecture, struct err *err)
{
    char lead[700];
    snprintf(
        lead, sizeof(lead),
        "Every experiment of J. Kautz's lecture *{Introduction to Path Tracing} (University "
        "College London), run by `{pathfarm lecture%s --seed %" PRIu64
        "} of version %s. Boxes marked "
        "*{Trap} say where a slide, taken at its word, goes wrong. Everything here is computed "
        "anew by a small ray tracer made for reading; the renderer itself works the same way, "
        "many paths at a time.",
        lecture->quick ? " --quick" : "", lecture->seed, PATHFARM_VERSION);
    lecture->page = page_new("The lecture, run", lead);
    if (lecture->page == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the page");
    lecture_integrals_write(lecture);
    lecture_points_write(lecture);
    lecture_directions_write(lecture);
    lecture_light_write(lecture);
    lecture_roulette_write(lecture);
    return true;
}
