#include "master/pictures.h"

#include "common/err.h"
#include "master/atomic_file.h"
#include "master/exr.h"
#include "master/film.h"
#include "master/heat.h"
#include "master/image.h"
#include "master/ledger.h"
#include "master/png.h"
#include "master/tile_plan.h"
#include "proto/bundle.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct pictures {
    uv_loop_t *loop;
    const struct film *film;
    struct picture_facts facts;
    struct picture_paths paths;

    uv_work_t work;
    bool busy;
    struct image *image; /* the copy that is written */
    char *ledger;        /* its ledger as CSV */
    bool written;
    struct err err;
    void (*log)(void *context, const char *line);
    void *context;
};

struct pictures *pictures_new(uv_loop_t *loop, const struct film *film,
                              const struct picture_facts *facts, const struct picture_paths *paths)
{
    struct pictures *p = calloc(1, sizeof(*p));
    if (p == NULL)
        return NULL;
    p->loop = loop;
    p->film = film;
    p->facts = *facts;
    p->paths = *paths;
    p->work.data = p;
    p->image = film_image_new(film);
    if (p->image == NULL) {
        pictures_free(p);
        return NULL;
    }
    return p;
}

void pictures_free(struct pictures *p)
{
    if (p == NULL)
        return;
    image_free(p->image);
    free(p->ledger);
    free(p);
}

/* The last row of the ledger, figure by figure, and all of it. An error that is unknown is no
 * number. */
static bool add_ledger(const struct pictures *p, struct image *image, const struct ledger_row *row)
{
    const struct accuracy *a = &row->accuracy;
    bool known = a->verdict == ACCURACY_KNOWN, known_mse = a->mse_verdict == ACCURACY_KNOWN;
    const struct {
        const char *name;
        double value;
    } numbers[] = {
        { "pathfarm.rmse", known_mse ? a->rmse : NAN },
        { "pathfarm.rmseLow", known_mse ? a->rmse95.low : NAN },
        { "pathfarm.rmseHigh", known_mse ? a->rmse95.high : NAN },
        { "pathfarm.relMSE", known ? a->relmse : NAN },
        { "pathfarm.relMSELow", known ? a->relmse95.low : NAN },
        { "pathfarm.relMSEHigh", known ? a->relmse95.high : NAN },
        { "pathfarm.unknownShare", a->unknown_share },
        { "pathfarm.coreSeconds", row->core_s },
        { "pathfarm.wallSeconds", row->wall_s },
        { "pathfarm.truncatedEnergy", row->truncated_energy },
    };
    bool fine = image_set_attribute(image, "pathfarm.error", estimate_verdict_text(a->verdict)) &&
                image_set_attribute(image, "pathfarm.ledger", p->ledger) &&
                image_note(image, "pathfarm.nonfinite", "nan %llu, infinite %llu, negative %llu",
                           (unsigned long long)row->nonfinite[NONFINITE_NAN],
                           (unsigned long long)row->nonfinite[NONFINITE_INF],
                           (unsigned long long)row->nonfinite[NONFINITE_NEGATIVE]);
    for (size_t i = 0; i < sizeof(numbers) / sizeof(numbers[0]) && fine; i++)
        fine = isnan(numbers[i].value)
                   ? image_set_attribute(image, numbers[i].name, "unknown")
                   : image_note(image, numbers[i].name, "%.9g", numbers[i].value);
    return fine;
}

/* The plan of --adaptive in short: the report has all of it, and `samples` shows it. */
static bool add_plan(const struct tile_plan *plan, struct image *image)
{
    char hex[DIGEST_HEX_SIZE], text[256];
    if (plan->pilot_rounds == 0)
        return true;
    struct digest digest = digest_of(plan->octaves, plan->tiles);
    snprintf(text, sizeof(text),
             "pilot of %llu leaves with weight %.9g; %u of %u tiles twice or more, "
             "%u half or less; predicted gain %.2f; sha256 of log2 of the factors %s",
             (unsigned long long)round_end(plan->pilot_rounds - 1), plan->pilot_weight,
             tile_plan_count_from(plan, 1), plan->tiles, tile_plan_count_to(plan, -1),
             plan->predicted_gain, digest_hex(&digest, hex));
    return image_set_attribute(image, "pathfarm.adaptive", text);
}

static bool add_facts(const struct pictures *p, struct image *image,
                      const struct picture_moment *moment)
{
    const struct picture_facts *f = &p->facts;
    char scene_hex[DIGEST_HEX_SIZE], job_hex[DIGEST_HEX_SIZE];
    const struct {
        const char *name, *text;
    } attributes[] = {
        { "pathfarm.command", f->command },
        { "pathfarm.build", f->build },
        { "pathfarm.profile", f->profile_text },
        { "pathfarm.sceneDigest", digest_hex(bundle_scene_digest(f->bundle), scene_hex) },
        { "pathfarm.jobDigest", digest_hex(bundle_job_digest(f->bundle), job_hex) },
        { "pathfarm.stoppedBy", limits_text(moment->stopped_by) },
        { "pathfarm.complete", moment->complete ? "yes" : "no" },
    };
    for (size_t i = 0; i < sizeof(attributes) / sizeof(attributes[0]); i++) {
        if (!image_set_attribute(image, attributes[i].name, attributes[i].text))
            return false;
    }
    return image_note(image, "pathfarm.seed", "%llu", (unsigned long long)f->spec->seed) &&
           image_note(image, "pathfarm.spp", "%llu", (unsigned long long)film_spp(p->film)) &&
           image_note(image, "pathfarm.replicates", "%u", f->spec->replicates) &&
           image_note(image, "pathfarm.stderrDof", "%u", film_stderr_dof(f->spec->replicates)) &&
           add_plan(film_plan(p->film), image) &&
           (!f->format.half ||
            image_note(image, "pathfarm.clampedToHalf", "%llu",
                       (unsigned long long)exr_values_clamped(image, &f->format))) &&
           (moment->row_count == 0 || add_ledger(p, image, &moment->rows[moment->row_count - 1]));
}

/* Make p->image the picture, with the metadata. */
static bool copy_with_facts(struct pictures *p, const struct picture_moment *moment,
                            struct err *err)
{
    const struct image *picture = moment->picture;
    assert(picture->width == p->image->width && picture->height == p->image->height);
    size_t bytes = (size_t)picture->width * picture->height * sizeof(float);
    for (uint32_t c = 0; c < picture->channel_count; c++)
        memcpy(p->image->channels[c].values, picture->channels[c].values, bytes);
    free(p->ledger);
    p->ledger = ledger_csv(moment->rows, moment->row_count);
    return (p->ledger != NULL && add_facts(p, p->image, moment)) ||
           err_set(err, ERR_MEMORY, "no memory for a picture");
}

static bool write_all(const struct pictures *p, struct err *err)
{
    const struct picture_paths *to = &p->paths;
    return exr_image_write_as(p->image, &p->facts.format, to->exr, err) &&
           png_preview_write(p->image, to->png, err) &&
           (to->heat == NULL || heat_write(p->image, to->heat, err)) &&
           (to->ledger == NULL || atomic_file_write(to->ledger, p->ledger, strlen(p->ledger), err));
}

static void write_in_pool(uv_work_t *work)
{
    struct pictures *p = work->data;
    p->written = write_all(p, &p->err);
}

static void on_written(uv_work_t *work, int status)
{
    struct pictures *p = work->data;
    p->busy = false;
    if (status == 0 && !p->written)
        p->log(p->context, p->err.text);
}

void pictures_refresh(struct pictures *p, const struct picture_moment *moment,
                      void (*log)(void *context, const char *line), void *context)
{
    if (p->busy || moment->picture == NULL)
        return;
    struct err err;
    p->log = log;
    p->context = context;
    if (!copy_with_facts(p, moment, &err)) {
        log(context, err.text);
        return;
    }
    p->busy = uv_queue_work(p->loop, &p->work, write_in_pool, on_written) == 0;
}

bool pictures_busy(const struct pictures *p)
{
    return p->busy;
}

bool pictures_write(struct pictures *p, const struct picture_moment *moment, struct err *err)
{
    assert(!p->busy);
    return copy_with_facts(p, moment, err) && write_all(p, err);
}
