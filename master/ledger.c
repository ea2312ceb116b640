#include "master/ledger.h"

#include "common/elem.h"

#include <math.h>
#include <string.h>

struct ledger_row ledger_row_of(unsigned round, uint64_t spp, double wall_s, double core_s,
                                const struct accuracy *accuracy, const struct node_stats *stats)
{
    struct ledger_row row = {
        .round = round,
        .spp = spp,
        .wall_s = wall_s,
        .core_s = core_s,
        .accuracy = *accuracy,
        .samples = stats->samples,
        .rays_closest = stats->rays_closest,
        .rays_shadow = stats->rays_shadow,
        .truncated_paths = stats->truncated_paths,
    };
    memcpy(row.nonfinite, stats->nonfinite, sizeof(row.nonfinite));
    if (stats->samples > 0)
        row.truncated_energy = stats->truncated_energy / (double)stats->samples;
    return row;
}

static bool fits(const struct ledger_row *row)
{
    return row->accuracy.verdict == ACCURACY_KNOWN && row->accuracy.relmse > 0 && row->spp > 0;
}

struct error_fit ledger_fit(const struct ledger_row *rows, size_t count)
{
    double n = 0, mean_x = 0, mean_y = 0;
    for (size_t i = 0; i < count; i++) {
        if (!fits(&rows[i]))
            continue;
        n++;
        mean_x += (elem_log((double)rows[i].spp) - mean_x) / n;
        mean_y += (elem_log(rows[i].accuracy.relmse) - mean_y) / n;
    }
    double xx = 0, xy = 0, yy = 0;
    for (size_t i = 0; i < count; i++) {
        if (!fits(&rows[i]))
            continue;
        double x = elem_log((double)rows[i].spp) - mean_x;
        double y = elem_log(rows[i].accuracy.relmse) - mean_y;
        xx += x * x;
        xy += x * y;
        yy += y * y;
    }
    struct error_fit fit = { (size_t)n, NAN, NAN, NAN };
    if (n < 3 || !(xx > 0))
        return fit;
    fit.slope = xy / xx;
    fit.intercept = mean_y - fit.slope * mean_x;
    double residual = yy - fit.slope * xy;
    fit.slope_stderr = residual > 0 ? sqrt(residual / (n - 2) / xx) : 0;
    return fit;
}

double ledger_spp_for(const struct error_fit *fit, double relmse)
{
    if (!(fit->slope < 0) || !(relmse > 0))
        return INFINITY;
    return elem_exp((elem_log(relmse) - fit->intercept) / fit->slope);
}

double ledger_seconds_left(const struct ledger_row *rows, size_t count, double spp)
{
    if (count == 0 || rows[count - 1].spp == 0)
        return INFINITY;
    const struct ledger_row *last = &rows[count - 1];
    double since_s = 0, since_spp = 0; /* without an earlier row the pace includes the start-up */
    for (size_t i = count - 1; i-- > 0;)
        if (rows[i].spp <= last->spp / 2 || i == 0) {
            since_s = rows[i].wall_s;
            since_spp = (double)rows[i].spp;
            break;
        }
    double done = (double)last->spp - since_spp, left = spp - (double)last->spp;
    if (left <= 0)
        return 0;
    return done > 0 ? left * (last->wall_s - since_s) / done : INFINITY;
}
