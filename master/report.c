#include "master/report.h"

#include "common/err.h"
#include "common/sumtree.h"
#include "master/atomic_file.h"
#include "master/tile_plan.h"

#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* JSON knows no NaN: what is not finite is null */
static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

/* jansson's integers are signed; what does not fit (a seed may not) becomes a string */
static json_t *count(uint64_t value)
{
    if (value <= INT64_MAX)
        return json_integer((json_int_t)value);
    char digits[32];
    snprintf(digits, sizeof(digits), "%" PRIu64, value);
    return json_string(digits);
}

static json_t *text(const char *value)
{
    json_t *string = value != NULL ? json_string(value) : json_null();
    /* A file name need not be UTF-8 */
    return string != NULL ? string : json_string("(not UTF-8)");
}

static json_t *digest_text(const struct digest *value)
{
    char hex[DIGEST_HEX_SIZE];
    return json_string(digest_hex(value, hex));
}

/* Every json_object_set_new below takes the value over and fails only without memory. */
static bool put(json_t *object, const char *key, json_t *value)
{
    return json_object_set_new(object, key, value) == 0;
}

static json_t *interval(struct interval value)
{
    return json_pack("[oo]", number(value.low), number(value.high));
}

/* An unknown error is null, never a number that somebody might believe. */
static bool put_accuracy(json_t *object, const struct accuracy *accuracy)
{
    bool known = accuracy->verdict == ACCURACY_KNOWN;
    json_t *error = json_object();
    bool fine = put(error, "unknown", json_boolean(!known));
    if (!known)
        fine &= put(error, "why", text(estimate_verdict_text(accuracy->verdict)));
    fine &= put(error, "rmse", known ? number(accuracy->rmse) : json_null());
    fine &= put(error, "rmse_95", known ? interval(accuracy->rmse95) : json_null());
    fine &= put(error, "relmse", known ? number(accuracy->relmse) : json_null());
    fine &= put(error, "relmse_95", known ? interval(accuracy->relmse95) : json_null());
    fine &= put(error, "unknown_share", number(accuracy->unknown_share));
    fine &= put(error, "effective_values", number(accuracy->effective_values));
    return put(object, "error", error) && fine;
}

/* Non-finite samples by cause, and what the depth limits cut. */
static bool put_losses(json_t *object, const uint64_t nonfinite[NONFINITE_CAUSES],
                       uint64_t truncated_paths, double truncated_energy)
{
    json_t *lost = json_object();
    bool fine = put(lost, "nan", count(nonfinite[NONFINITE_NAN]));
    fine &= put(lost, "infinite", count(nonfinite[NONFINITE_INF]));
    fine &= put(lost, "negative", count(nonfinite[NONFINITE_NEGATIVE]));
    fine &= put(object, "nonfinite_samples", lost);

    json_t *truncated = json_object();
    fine &= put(truncated, "paths", count(truncated_paths));
    fine &= put(truncated, "energy_per_path", number(truncated_energy));
    return put(object, "truncated", truncated) && fine;
}

static bool put_rays(json_t *object, uint64_t closest, uint64_t shadow)
{
    json_t *rays = json_object();
    bool fine = put(rays, "closest", count(closest));
    fine &= put(rays, "shadow", count(shadow));
    return put(object, "rays", rays) && fine;
}

static bool put_job(json_t *root, const struct render_report *report)
{
    bool fine = put(root, "command", text(report->command));
    fine &= put(root, "build", text(report->build));
    fine &= put(root, "profile", text(report->profile));
    fine &= put(root, "scene", text(report->scene));
    fine &= put(root, "scene_digest", digest_text(&report->scene_digest));
    fine &= put(root, "job_digest", digest_text(&report->job_digest));
    fine &= put(root, "seed", count(report->seed));
    fine &= put(root, "replicates", count(report->replicates));
    fine &= put(root, "width", count(report->width));
    fine &= put(root, "height", count(report->height));
    json_t *crop = json_array();
    for (int i = 0; i < 4; i++)
        fine &= json_array_append_new(crop, count(report->crop[i])) == 0;
    fine &= put(root, "crop", crop);
    if (report->sampler != NULL)
        fine &= put(root, "sampler", text(report->sampler));
    if (report->paths != NULL)
        fine &= put(root, "paths", text(report->paths));
    if (report->effects != NULL)
        fine &= put(root, "effects", text(report->effects));
    return fine;
}

static bool put_work(json_t *root, const struct render_report *report)
{
    const struct node_stats *stats = &report->stats;
    bool fine = put(root, "spp_asked", count(report->spp_asked));
    fine &= put(root, "spp", count(report->spp));
    fine &= put(root, "wall_seconds", number(report->wall_seconds));
    fine &= put(root, "core_seconds", number(report->core_seconds));
    fine &= put(root, "camera_paths", count(stats->samples));
    fine &= put(root, "scattering_events", count(stats->events));

    fine &= put_rays(root, stats->rays_closest, stats->rays_shadow);

    json_t *bytes = json_object();
    fine &= put(bytes, "sent", count(report->bytes_sent));
    fine &= put(bytes, "received", count(report->bytes_received));
    fine &= put(root, "bytes_on_wire", bytes);

    double paths = (double)stats->samples;
    fine &= put_losses(root, stats->nonfinite, stats->truncated_paths,
                       paths > 0 ? stats->truncated_energy / paths : 0);
    fine &= put(root, "largest_sample", number((double)stats->largest));
    return put_accuracy(root, &report->accuracy) && fine;
}

/* A limit that is not set is null, as is one that nothing was stopped by. */
static bool put_limits(json_t *root, const struct render_report *report)
{
    const struct limits *asked = report->asked;
    json_t *limits = json_object();
    bool fine = put(limits, "spp", report->spp_asked > 0 ? count(report->spp_asked) : json_null());
    fine &= put(limits, "error", asked->relmse > 0 ? number(asked->relmse) : json_null());
    fine &= put(limits, "time", asked->time_s > 0 ? number(asked->time_s) : json_null());
    fine &= put(limits, "budget_core_hours",
                asked->core_s > 0 ? number(asked->core_s / 3600) : json_null());
    fine &= put(root, "limits", limits);
    bool stopped = report->stopped_by != LIMIT_NONE;
    return put(root, "stopped_by", stopped ? text(limits_text(report->stopped_by)) : json_null()) &&
           fine;
}

static json_t *band(const struct predict_band *band)
{
    return json_pack("[ooo]", number(band->low), number(band->mid), number(band->high));
}

/* What was predicted after each round, had the rows so far been all: totals at the end, as the low
 * end of the band, the middle, and the high end. */
static bool put_predictions(json_t *root, const struct render_report *report)
{
    bool fine = true;
    json_t *predictions = json_array();
    for (size_t i = 0; i < report->ledger_count; i++) {
        struct prediction p;
        const struct ledger_row *now = &report->ledger[i];
        if (limits_met(report->asked, now) ||
            !predict_end(&report->predicted, report->ledger, i + 1, &p))
            continue;
        json_t *row = json_object();
        fine &= put(row, "at_spp", count(now->spp));
        fine &= put(row, "at_core_seconds", number(now->core_s));
        fine &= put(row, "at_wall_seconds", number(now->wall_s));
        fine &= put(row, "spp", band(&p.spp));
        fine &= put(row, "core_seconds", band(&p.core_s));
        fine &= put(row, "wall_seconds", band(&p.wall_s));
        fine &= put(row, "slope", number(p.slope));
        fine &= put(row, "slope_stderr", number(p.slope_stderr));
        fine &= json_array_append_new(predictions, row) == 0;
    }
    return put(root, "predictions", predictions) && fine;
}

/* The plan of --adaptive; lists have an element per tile, row by row. */
static bool put_plan(json_t *root, const struct render_report *report)
{
    const struct tile_plan *plan = report->plan;
    if (plan == NULL || plan->pilot_rounds == 0)
        return true;
    json_t *adaptive = json_object();
    bool fine = put(adaptive, "pilot_leaves", count(round_end(plan->pilot_rounds - 1)));
    fine &= put(adaptive, "pilot_weight", number(plan->pilot_weight));
    fine &= put(adaptive, "planned", json_boolean(plan->made));
    fine &= put(adaptive, "predicted_gain",
                plan->made ? number(plan->predicted_gain) : json_null());
    fine &= put(adaptive, "tiles_across", count(plan->across));
    json_t *factors = json_array(), *errors = json_array(), *work = json_array();
    for (uint32_t tile = 0; plan->made && tile < plan->tiles; tile++) {
        const struct tile_look *look = &plan->looks[tile];
        double samples = look->samples > 0 ? (double)look->samples : 1;
        fine &= json_array_append_new(factors, number(tile_plan_factor(plan, tile))) == 0;
        fine &= json_array_append_new(errors, number(look->error / (3.0 * look->pixels))) == 0;
        fine &= json_array_append_new(work, number(look->work / samples)) == 0;
    }
    fine &= put(adaptive, "factors", factors);
    fine &= put(adaptive, "pilot_relmse", errors);
    fine &= put(adaptive, "work_per_sample", work);
    return put(root, "adaptive", adaptive) && fine;
}

static bool put_farm(json_t *root, const struct render_report *report)
{
    bool fine = true;
    json_t *workers = json_array();
    for (size_t i = 0; i < report->worker_count; i++) {
        const struct report_worker *worker = &report->workers[i];
        json_t *row = json_object();
        fine &= put(row, "host", text(worker->host));
        fine &= put(row, "build", text(worker->build));
        fine &= put(row, "cores", count(worker->cores));
        fine &= put(row, "nodes", count(worker->nodes));
        fine &= put(row, "camera_paths", count(worker->samples));
        fine &= put(row, "core_seconds", number(worker->core_seconds));
        fine &= put(row, "cached", json_boolean(worker->cached));
        fine &= put(row, "lost", json_boolean(worker->lost));
        fine &= json_array_append_new(workers, row) == 0;
    }
    fine &= put(root, "workers", workers);

    json_t *nodes = json_object();
    fine &= put(nodes, "accepted", count(report->nodes_accepted));
    fine &= put(nodes, "reissued", count(report->nodes_reissued));
    fine &= put(nodes, "speculated", count(report->nodes_speculated));
    fine &= put(nodes, "duplicates", count(report->nodes_duplicate));
    fine &= put(nodes, "mismatches", count(report->nodes_mismatched));
    fine &= put(root, "nodes", nodes);

    json_t *ledger = json_array();
    for (size_t i = 0; i < report->ledger_count; i++) {
        const struct ledger_row *round = &report->ledger[i];
        json_t *row = json_object();
        fine &= put(row, "round", count(round->round));
        fine &= put(row, "spp", count(round->spp));
        fine &= put(row, "wall_seconds", number(round->wall_s));
        fine &= put(row, "core_seconds", number(round->core_s));
        fine &= put(row, "camera_paths", count(round->samples));
        fine &= put_rays(row, round->rays_closest, round->rays_shadow);
        fine &= put_losses(row, round->nonfinite, round->truncated_paths, round->truncated_energy);
        fine &= put_accuracy(row, &round->accuracy);
        fine &= json_array_append_new(ledger, row) == 0;
    }
    return put(root, "ledger", ledger) && fine;
}

char *report_json(const struct render_report *report)
{
    json_t *root = json_object();
    char *json = NULL;
    bool fine = put_job(root, report) && put_work(root, report) && put_plan(root, report);
    if (fine && report->asked != NULL)
        fine = put_limits(root, report);
    if (fine && report->asked != NULL && report->asked->relmse > 0)
        fine = put_predictions(root, report);
    if (fine && put_farm(root, report))
        json = json_dumps(root, JSON_INDENT(2) | JSON_REAL_PRECISION(12));
    json_decref(root);
    return json;
}

bool report_write(const struct render_report *report, const char *path, struct err *err)
{
    char *json = report_json(report);
    if (json == NULL)
        return err_set(err, ERR_MEMORY, "%s: out of memory", path);
    bool written = atomic_file_write(path, json, strlen(json), err);
    free(json);
    return written;
}
