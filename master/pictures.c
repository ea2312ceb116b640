#include "master/pictures.h"

#include "common/err.h"
#include "master/exr.h"
#include "master/film.h"
#include "master/image.h"
#include "master/png.h"
#include "proto/bundle.h"

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
    struct image *image; /* being written */
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
    return p;
}

void pictures_free(struct pictures *p)
{
    free(p);
}

static bool add_facts(const struct pictures *p, struct image *image, bool complete)
{
    const struct picture_facts *f = &p->facts;
    char seed[32], spp[32], replicates[32], dof[32], scene_hex[DIGEST_HEX_SIZE],
        job_hex[DIGEST_HEX_SIZE];
    snprintf(seed, sizeof(seed), "%llu", (unsigned long long)f->spec->seed);
    snprintf(spp, sizeof(spp), "%llu", (unsigned long long)film_spp(p->film));
    snprintf(replicates, sizeof(replicates), "%u", f->spec->replicates);
    snprintf(dof, sizeof(dof), "%u", f->spec->replicates - 1);
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
    return true;
}

/* The picture again, with the metadata; NULL and err when memory runs out. */
static struct image *copy_with_facts(const struct pictures *p, const struct image *picture,
                                     bool complete, struct err *err)
{
    struct image *copy = image_new(picture->width, picture->height);
    if (copy == NULL)
        goto fail;
    copy->data_x = picture->data_x;
    copy->data_y = picture->data_y;
    copy->display_width = picture->display_width;
    copy->display_height = picture->display_height;
    for (uint32_t c = 0; c < picture->channel_count; c++) {
        float *values = image_add_channel(copy, picture->channels[c].name);
        if (values == NULL)
            goto fail;
        memcpy(values, picture->channels[c].values,
               (size_t)picture->width * picture->height * sizeof(float));
    }
    if (!add_facts(p, copy, complete))
        goto fail;
    return copy;

fail:
    image_free(copy);
    err_set(err, ERR_MEMORY, "no memory for a picture");
    return NULL;
}

static bool write_both(const struct pictures *p, const struct image *image, struct err *err)
{
    return exr_image_write(image, p->exr_path, err) && png_preview_write(image, p->png_path, err);
}

static void write_in_pool(uv_work_t *work)
{
    struct pictures *p = work->data;
    p->written = write_both(p, p->image, &p->err);
}

static void on_written(uv_work_t *work, int status)
{
    struct pictures *p = work->data;
    p->busy = false;
    image_free(p->image);
    p->image = NULL;
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
    p->image = copy_with_facts(p, picture, false, &err);
    if (p->image == NULL) {
        log(context, err.text);
        return;
    }
    p->busy = uv_queue_work(p->loop, &p->work, write_in_pool, on_written) == 0;
    if (!p->busy) {
        image_free(p->image);
        p->image = NULL;
    }
}

bool pictures_busy(const struct pictures *p)
{
    return p->busy;
}

bool pictures_write(struct pictures *p, const struct image *picture, bool complete, struct err *err)
{
    struct image *image = copy_with_facts(p, picture, complete, err);
    if (image == NULL)
        return false;
    bool ok = write_both(p, image, err);
    image_free(image);
    return ok;
}
