#include "master/ledger.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
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

/* Three columns, empty where the error is unknown */
static void put_error(FILE *out, enum accuracy_verdict verdict, double error,
                      struct interval error95)
{
    if (verdict == ACCURACY_KNOWN)
        fprintf(out, "%.9g,%.9g,%.9g,", error, error95.low, error95.high);
    else
        fputs(",,,", out);
}

static void put_row(FILE *out, const struct ledger_row *row)
{
    const struct accuracy *a = &row->accuracy;
    fprintf(out, "%u,%" PRIu64 ",%.9g,%.9g,", row->round, row->spp, row->core_s, row->wall_s);
    put_error(out, a->mse_verdict, a->rmse, a->rmse95);
    put_error(out, a->verdict, a->relmse, a->relmse95);
    fprintf(out, "%s,", a->verdict == ACCURACY_KNOWN ? "" : estimate_verdict_text(a->verdict));
    fprintf(out, "%.9g,%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%.9g", a->unknown_share,
            row->samples, row->rays_closest, row->rays_shadow, row->truncated_paths,
            row->truncated_energy);
    fprintf(out, ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 "\n", row->nonfinite[NONFINITE_NAN],
            row->nonfinite[NONFINITE_INF], row->nonfinite[NONFINITE_NEGATIVE]);
}

char *ledger_csv(const struct ledger_row *rows, size_t count)
{
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    if (out == NULL)
        return NULL;
    fputs("round,spp,core_seconds,wall_seconds,rmse,rmse_low,rmse_high,relmse,relmse_low,"
          "relmse_high,unknown,unknown_share,camera_paths,rays_closest,rays_shadow,"
          "truncated_paths,truncated_energy_per_path,nan,infinite,negative\n",
          out);
    for (size_t i = 0; i < count; i++)
        put_row(out, &rows[i]);
    bool whole = ferror(out) == 0;
    if (fclose(out) == 0 && whole)
        return text;
    free(text);
    return NULL;
}
