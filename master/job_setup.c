#include "master/job_setup.h"

#include "common/aov.h"
#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/gltf.h"
#include "master/options.h"
#include "master/pbrt.h"
#include "master/scene_notes.h"

#include <inttypes.h>
#include <stdio.h>

#define SPP_DEFAULT 16    /* pbrt's */
#define DEPTH_CAP   65536 /* the counted safety cap */

static bool apply_crop(struct scene *scene, const double crop[4], struct err *err)
{
    struct scene_settings *s = &scene->settings;
    if (crop[0] <= 1 && crop[1] <= 1 && crop[2] <= 1 && crop[3] <= 1)
        return pbrt_set_crop(scene, crop, err);
    for (int i = 0; i < 4; i++) {
        uint32_t side = i < 2 ? s->width : s->height;
        if (crop[i] > side)
            return err_set(err, ERR_ARGUMENT, "the picture has %" PRIu32 "x%" PRIu32 " pixels",
                           s->width, s->height);
        if (crop[i] != (uint32_t)crop[i])
            return err_set(err, ERR_ARGUMENT,
                           "%g is neither a fraction (all four at most 1) nor a whole pixel",
                           crop[i]);
    }
    for (int i = 0; i < 4; i++)
        s->crop[i] = (uint32_t)crop[i];
    return true;
}

static bool apply_options(struct scene *scene, const struct render_options *o, struct err *err)
{
    if (o->width > 0 && !pbrt_set_resolution(scene, o->width, o->height, err))
        return err_wrap(err, "--resolution");
    if (o->has_crop && !apply_crop(scene, o->crop, err))
        return err_wrap(err, "--crop");
    if (o->sampler >= 0)
        scene->settings.sampler = (uint32_t)o->sampler;
    if (o->has_max_depth)
        scene->settings.max_depth = o->max_depth;
    scene->settings.effects = scene_effects(scene);
    return scene_check(scene, err);
}

static bool needs_planned_samples(uint32_t sampler)
{
    return sampler == SAMPLER_STRATIFIED || sampler == SAMPLER_HAMMERSLEY;
}

/* Identities travel as float32, which tells so many apart */
static bool check_ids(const struct scene *scene, uint32_t aovs, struct err *err)
{
    uint64_t objects = (uint64_t)scene->mesh_count + scene->quadric_count + scene->instance_count;
    if ((aov_in(aovs, AOV_OBJECT) && objects >= AOV_ID_MAX) ||
        (aov_in(aovs, AOV_MATERIAL) && scene->material_count >= AOV_ID_MAX))
        return err_set(err, ERR_LIMIT, "--aov: fewer than %d objects and materials have ids",
                       AOV_ID_MAX);
    return true;
}

static bool give_pilot(struct job_setup *setup, bool planned, struct err *err)
{
    struct job_spec *spec = &setup->spec;
    if (planned)
        return err_set(err, ERR_ARGUMENT,
                       "--adaptive: this sampler must know the samples of every pixel beforehand; "
                       "use another");
    if (spec->replicates < 2)
        return err_set(err, ERR_ARGUMENT,
                       "--adaptive: the pilot needs two replicates to tell the error");
    if (!job_shape_pilot(setup->spp_asked, spec))
        return err_set(err, ERR_ARGUMENT,
                       "--adaptive pays from %" PRIu64 " samples per pixel on, to which the pilot "
                       "adds a sixteenth at most: not with %" PRIu64,
                       16 * (uint64_t)spec->replicates * spec->leaf_samples, setup->spp_asked);
    return true;
}

static bool shape(struct job_setup *setup, const struct render_options *o, struct err *err)
{
    const struct scene_settings *s = &setup->scene->settings;
    struct job_spec *spec = &setup->spec;
    *spec = (struct job_spec){
        .seed = o->seed,
        .channel_count = aov_channel_count(o->aovs),
        .aovs = o->aovs,
        .depth_cap = s->max_depth < DEPTH_CAP ? s->max_depth : DEPTH_CAP,
        .kernel = o->everything,
        .max_lanes = o->lanes,
    };
    struct limits *limits = &setup->limits;
    *limits = (struct limits){ ROUND_COUNT, o->relmse, o->time_s, 3600 * o->core_hours };
    bool open = limits_are_open(limits), planned = needs_planned_samples(s->sampler);
    if (open && planned)
        return err_set(err, ERR_ARGUMENT,
                       "%s: this sampler must know the samples beforehand; "
                       "use --spp alone, or another sampler",
                       o->relmse > 0   ? "--error"
                       : o->time_s > 0 ? "--time"
                                       : "--budget-core-hours");
    setup->spp_asked = o->spp > 0       ? o->spp
                       : open           ? 0
                       : s->sampler_spp ? s->sampler_spp
                                        : SPP_DEFAULT;
    /* A job without --spp has the shape that any --spp large enough gives, so that its result can
     * be had again by --spp */
    uint64_t spp = setup->spp_asked == 0 ? 1u << 20 : setup->spp_asked;
    setup->spp = job_in_fours(&s->filter) ? job_shape_in_fours(spp, o->replicates, spec)
                                          : job_shape(spp, o->replicates, spec);
    if (o->adaptive && !give_pilot(setup, planned, err))
        return false;
    if (setup->spp_asked == 0)
        setup->spp = 0;
    else
        limits->rounds = job_rounds(spec, setup->spp);
    spec->planned_samples = planned ? setup->spp / spec->replicates : 0;
    if (limits->relmse > 0 && spec->replicates < 2)
        return err_set(err, ERR_ARGUMENT,
                       "--error: replicates tell the error, and here is only one of them");
    return true;
}

static struct scene *read_scene(const struct render_options *o, struct scene_notes *notes,
                                struct err *err)
{
    const struct gltf_options gltf = { .lenient = o->lenient, .camera = o->camera };
    const struct pbrt_options pbrt = { .lenient = o->lenient };
    *notes = (struct scene_notes){ 0 };
    if (gltf_is(o->scene))
        return gltf_read(o->scene, &gltf, notes, err);
    if (o->camera == NULL)
        return pbrt_read(o->scene, &pbrt, notes, err);
    err_set(err, ERR_ARGUMENT, "--camera: a pbrt scene has one camera, without a name");
    return NULL;
}

bool job_setup_open(const struct render_options *options, struct job_setup *setup, struct err *err)
{
    struct scene_notes notes;
    *setup = (struct job_setup){ 0 };
    setup->scene = read_scene(options, &notes, err);
    for (size_t i = 0; i < notes.count; i++)
        fprintf(stderr, "%s\n", notes.lines[i]);
    if (notes.warnings > 0)
        fprintf(stderr, "%" PRIu64 " warnings: the picture lacks what the scene asks for\n",
                notes.warnings);
    scene_notes_free(&notes);
    if (setup->scene == NULL)
        return false;
    if (apply_options(setup->scene, options, err) && check_ids(setup->scene, options->aovs, err) &&
        shape(setup, options, err))
        return true;
    job_setup_close(setup);
    return false;
}

void job_setup_close(struct job_setup *setup)
{
    scene_free(setup->scene);
    setup->scene = NULL;
}

const char *job_setup_sampler_name(uint32_t sampler)
{
    switch (sampler) {
#define X(name, number, text) \
    case number:              \
        return text;
        SAMPLER_MAP(X)
#undef X
    }
    return "unknown";
}
