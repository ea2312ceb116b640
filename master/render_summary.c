#include "master/render_summary.h"

#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/farm.h"
#include "master/film.h"
#include "master/job_setup.h"
#include "master/ledger.h"
#include "master/report.h"
#include "proto/bundle.h"

#include <stdlib.h>
#include <string.h>

static size_t fill_workers(const struct farm *farm, struct report_worker *workers)
{
    size_t count = 0;
    for (const struct farm_worker *w = farm_workers(farm); w != NULL; w = w->next) {
        if (workers != NULL)
            workers[count] = (struct report_worker){
                .host = w->host,
                .build = w->build,
                .cores = w->cores,
                .nodes = w->nodes,
                .samples = w->samples,
                .core_seconds = w->core_seconds,
                .cached = w->cached,
                .lost = !w->connected,
            };
        count++;
    }
    return count;
}

bool render_summary_write(const struct render_summary *s, const char *path, struct err *err)
{
    size_t row_count;
    const struct ledger_row *rows = farm_ledger(s->farm, &row_count);
    size_t worker_count = fill_workers(s->farm, NULL);
    struct report_worker *workers = calloc(worker_count + 1, sizeof(*workers));
    if (workers == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the report");
    fill_workers(s->farm, workers);

    const struct scene_settings *settings = &s->setup->scene->settings;
    struct farm_status status = farm_status(s->farm);
    char effects[1024];
    struct render_report report = {
        .command = s->command,
        .build = s->build,
        .profile = farm_profile_text(s->farm),
        .scene = s->scene_name,
        .seed = s->setup->spec.seed,
        .replicates = s->setup->spec.replicates,
        .width = settings->width,
        .height = settings->height,
        .sampler = job_setup_sampler_name(settings->sampler),
        .effects = effects_text(settings->effects, effects, sizeof(effects)),
        .spp_asked = s->setup->spp_asked,
        .spp = film_spp(s->film),
        .asked = &s->setup->limits,
        .stopped_by = status.stopped_by,
        .predicted = farm_predict_job(s->farm),
        .plan = film_plan(s->film),
        .wall_seconds = status.wall_s,
        .core_seconds = status.core_s,
        .bytes_sent = status.bytes_out,
        .bytes_received = status.bytes_in,
        .workers = workers,
        .worker_count = worker_count,
        .nodes_accepted = status.nodes,
        .nodes_reissued = status.counts.nodes_reissued,
        .nodes_speculated = status.counts.nodes_speculated,
        .nodes_duplicate = status.counts.duplicates + status.counts.late,
        .nodes_mismatched = status.counts.mismatches,
        .ledger = rows,
        .ledger_count = row_count,
    };
    memcpy(report.crop, settings->crop, sizeof(report.crop));
    report.scene_digest = *bundle_scene_digest(s->bundle);
    report.job_digest = *bundle_job_digest(s->bundle);
    film_stats(s->film, &report.stats);
    if (row_count > 0)
        report.accuracy = rows[row_count - 1].accuracy;
    bool ok = report_write(&report, path, err);
    free(workers);
    return ok;
}
