#include "master/pictures.h"

#include "common/err.h"
#include "master/exr.h"
#include "master/film.h"
#include "master/image.h"
#include "master/png.h"
#include "proto/bundle.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct pictures {
    uv_loop_t *loop;
    const struct film *film;
    struct picture_facts facts;
    const char *exr_path, *png_path;

    uv_work_t work;
    bool busy;
    struct image *image; /* the copy that is written */
    bool written;
    struct err err;
    void (*log)(void *context, const char *line);
    void *context;
};

struct pictures *pictures_new(uv_loop_t *loop, const struct film *film,
                              const struct picture_facts *facts, const char *exr_path,
                              const char *png_path)
{
    struct pictures *p = calloc(1, sizeof(*p));
    if (p == NULL)
        return NULL;
    p->loop = loop;
    p->film = film;
    p->facts = *facts;
    p->exr_path = exr_path;
    p->png_path = png_path;
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
    free(p);
}

static bool add_facts(const struct pictures *p, struct image *image, bool complete)
{
    const struct picture_facts *f = &p->facts;
    char seed[32], spp[32], replicates[32], dof[32], scene_hex[DIGEST_HEX_SIZE],
        job_hex[DIGEST_HEX_SIZE], clamped[32];
    snprintf(seed, sizeof(seed), "%llu", (unsigned long long)f->spec->seed);
    snprintf(spp, sizeof(spp), "%llu", (unsigned long long)film_spp(p->film));
    snprintf(replicates, sizeof(replicates), "%u", f->spec->replicates);
    snprintf(dof, sizeof(dof), "%u", film_stderr_dof(f->spec->replicates));
    snprintf(clamped, sizeof(clamped), "%llu",
             (unsigned long long)exr_values_clamped(image, &f->format));
    const struct {
        const char *name, *text;
    } attributes[] = {
        { "pathfarm.command", f->command },
        { "pathfarm.build", f->build },
        { "pathfarm.profile", f->profile_text },
        { "pathfarm.sceneDigest", digest_hex(bundle_scene_digest(f->bundle), scene_hex) },
        { "pathfarm.jobDigest", digest_hex(bundle_job_digest(f->bundle), job_hex) },
        { "pathfarm.seed", seed },
        { "pathfarm.spp", spp },
        { "pathfarm.replicates", replicates },
        { "pathfarm.stderrDof", dof },
        { "pathfarm.complete", complete ? "yes" : "no" },
    };
    for (size_t i = 0; i < sizeof(attributes) / sizeof(attributes[0]); i++) {
        if (!image_set_attribute(image, attributes[i].name, attributes[i].text))
            return false;
    }
    return !f->format.half || image_set_attribute(image, "pathfarm.clampedToHalf", clamped);
}

/* Make p->image the picture, with the metadata. */
static bool copy_with_facts(struct pictures *p, const struct image *picture, bool complete,
                            struct err *err)
{
    assert(picture->width == p->image->width && picture->height == p->image->height);
    size_t bytes = (size_t)picture->width * picture->height * sizeof(float);
    for (uint32_t c = 0; c < picture->channel_count; c++)
        memcpy(p->image->channels[c].values, picture->channels[c].values, bytes);
    return add_facts(p, p->image, complete) || err_set(err, ERR_MEMORY, "no memory for a picture");
}

static bool write_both(const struct pictures *p, struct err *err)
{
    return exr_image_write_as(p->image, &p->facts.format, p->exr_path, err) &&
           png_preview_write(p->image, p->png_path, err);
}

static void write_in_pool(uv_work_t *work)
{
    struct pictures *p = work->data;
    p->written = write_both(p, &p->err);
}

static void on_written(uv_work_t *work, int status)
{
    struct pictures *p = work->data;
    p->busy = false;
    if (status == 0 && !p->written)
        p->log(p->context, p->err.text);
}

void pictures_refresh(struct pictures *p, const struct image *picture,
                      void (*log)(void *context, const char *line), void *context)
{
    if (p->busy || picture == NULL)
        return;
    struct err err;
    p->log = log;
    p->context = context;
    if (!copy_with_facts(p, picture, false, &err)) {
        log(context, err.text);
        return;
    }
    p->busy = uv_queue_work(p->loop, &p->work, write_in_pool, on_written) == 0;
}

bool pictures_busy(const struct pictures *p)
{
    return p->busy;
}

bool pictures_write(struct pictures *p, const struct image *picture, bool complete, struct err *err)
{
    assert(!p->busy);
    return copy_with_facts(p, picture, complete, err) && write_both(p, err);
}
