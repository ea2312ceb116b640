#include "master/accuracy_csv.h"

#include "master/accuracy_peers.h"
#include "master/accuracy_run.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

static const char HEADING[] =
    "configuration,group,spp,replicates,seeds,core_seconds,wall_seconds,relmse,relmse_stderr,"
    "relmse_low95,relmse_high95,variance,bias2,bias2_stderr,ttuv_core_seconds,truncated_energy,"
    "truncated_paths,nonfinite_samples,skipped_pixels,slope,slope_stderr,speedup,speedup_stderr\n";

/* Names may hold anything */
static void write_text(FILE *out, const char *text)
{
    if (strpbrk(text, ",\"\r\n") == NULL) {
        fputs(text, out);
        return;
    }
    putc('"', out);
    for (; *text != '\0'; text++) {
        if (*text == '"')
            putc('"', out);
        putc(*text, out);
    }
    putc('"', out);
}

static void write_number(FILE *out, double value)
{
    putc(',', out);
    if (isfinite(value))
        fprintf(out, "%.9g", value);
}

static void write_value(FILE *out, struct accuracy_value value)
{
    write_number(out, value.value);
    write_number(out, value.error);
}

static void write_rung(const struct accuracy_curve *curve, const struct accuracy_rung *rung,
                       FILE *out)
{
    const struct render_facts *facts = &rung->facts;
    const struct accuracy_point *point = &rung->point;
    write_text(out, curve->setup->name);
    fprintf(out, ",%s,%" PRIu64 ",%" PRIu32 ",%u", curve->setup->group, facts->spp,
            facts->replicates, curve->seeds);
    write_number(out, facts->core_s);
    write_number(out, facts->wall_s);
    write_number(out, point->relmse);
    write_number(out, point->relmse_error);
    write_number(out, point->relmse - ACCURACY_BAND * point->relmse_error);
    write_number(out, point->relmse + ACCURACY_BAND * point->relmse_error);
    write_number(out, point->variance);
    write_number(out, point->bias2);
    write_number(out, point->bias2_error);
    write_number(out, accuracy_curve_ttuv(rung));
    write_number(out, facts->truncated_energy);
    fprintf(out, ",%" PRIu64 ",%" PRIu64 ",%" PRIu64, facts->truncated_paths, facts->nonfinite,
            point->skipped);
    write_value(out, curve->slope);
    write_value(out, curve->speedup);
    putc('\n', out);
}

void accuracy_csv_write(const struct accuracy_study *study, const struct accuracy_peers *peers,
                        FILE *out)
{
    fputs(HEADING, out);
    for (size_t i = 0; i < study->curve_count; i++)
        for (size_t k = 0; k < study->curves[i].count; k++)
            write_rung(&study->curves[i], &study->curves[i].rungs[k], out);
    for (size_t i = 0; i < peers->count; i++) {
        write_text(out, peers->points[i].name);
        fputs(",peer,,,", out);
        write_number(out, peers->points[i].core_s);
        putc(',', out);
        write_number(out, peers->points[i].relmse);
        fputs(",,,,,,,,,,,,,,,\n", out);
    }
}
