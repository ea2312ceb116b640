#include "master/cmd_plan.h"

#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/film.h"
#include "master/job_setup.h"
#include "master/options.h"
#include "proto/bundle.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

static void print_lights(const struct scene *scene)
{
    static const char *const NAMES[LIGHT_KINDS] = {
        [LIGHT_POLYGON] = "polygon", [LIGHT_SPHERE] = "sphere", [LIGHT_DISK] = "disk",
        [LIGHT_POINT] = "point",     [LIGHT_SPOT] = "spot",     [LIGHT_DISTANT] = "distant",
        [LIGHT_SKY] = "sky",
    };
    uint32_t counts[LIGHT_KINDS] = { 0 };
    for (uint32_t i = 0; i < scene->light_count; i++)
        counts[scene->lights[i].kind]++;
    printf("lights      %" PRIu32, scene->light_count);
    const char *before = ": ";
    for (int kind = 0; kind < LIGHT_KINDS; kind++) {
        if (counts[kind] == 0)
            continue;
        printf("%s%" PRIu32 " %s", before, counts[kind], NAMES[kind]);
        before = ", ";
    }
    printf("\n");
}

static void print_plan(const struct job_setup *setup, const struct bundle *bundle)
{
    const struct scene *scene = setup->scene;
    const struct scene_settings *s = &scene->settings;
    char effects[1024], left_out[1024], hex[DIGEST_HEX_SIZE];
    printf("picture     %" PRIu32 "x%" PRIu32 ", pixels %" PRIu32 "..%" PRIu32 " by %" PRIu32
           "..%" PRIu32 ", %" PRIu32 " tiles\n",
           s->width, s->height, s->crop[0], s->crop[1], s->crop[2], s->crop[3], tile_count(scene));
    if (setup->spp > 0)
        printf("samples     %" PRIu64 " per pixel", setup->spp);
    else
        printf("samples     by time");
    printf(", %" PRIu32 " replicates, leaves of %" PRIu32 ", sampler %s\n", setup->spec.replicates,
           setup->spec.leaf_samples, job_setup_sampler_name(s->sampler));
    printf("geometry    %" PRIu32 " triangles in %" PRIu32 " meshes, %" PRIu32
           " spheres and disks, %" PRIu32 " materials\n",
           scene->triangle_count, scene->mesh_count, scene->quadric_count, scene->material_count);
    print_lights(scene);
    printf("effects     %s\n", effects_text(s->effects, effects, sizeof(effects)));
    printf("left out    %s\n", effects_text(FX_ALL & ~s->effects, left_out, sizeof(left_out)));
    if (setup->spec.kernel != 0 || setup->spec.techniques_off != 0)
        printf("kernel      the variant for everything\n");
    else
        printf("kernel      the first variant that covers mask 0x%05" PRIx32 "\n", s->effects);
    printf("scene       %s, %.1f MiB for each worker\n",
           digest_hex(bundle_scene_digest(bundle), hex),
           (double)bundle_size(bundle) / (1024 * 1024));
    printf("film        %.1f MiB in the master\n",
           (double)film_memory_bytes(scene, &setup->spec) / (1024 * 1024));
}

int cmd_plan(int argc, char **argv)
{
    struct render_options options;
    struct job_setup setup;
    struct err err = { 0 };
    switch (options_parse(argc, argv, false, &options, &err)) {
    case OPTIONS_HELP:
        printf("pathfarm plan SCENE [options of render]\n");
        return 0;
    case OPTIONS_WRONG:
        goto fail;
    case OPTIONS_GO:
        break;
    }
    if (!job_setup_open(&options, &setup, &err))
        goto fail;
    struct bundle *bundle = bundle_from_scene(setup.scene, &setup.spec, &err);
    if (bundle == NULL)
        goto fail_bundle;
    print_plan(&setup, bundle);
    bundle_free(bundle);
    job_setup_close(&setup);
    return 0;

fail_bundle:
    job_setup_close(&setup);
fail:
    fprintf(stderr, "%s\n", err.text);
    return 2;
}
