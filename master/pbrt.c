#include "master/pbrt.h"

#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt_directives.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* --- Reading ------------------------------------------------------------------------------ */

static bool reader_open(struct pbrt_reader *reader, bool lenient, struct err *err)
{
    *reader = (struct pbrt_reader){ .err = err, .report = { .lenient = lenient } };
    reader->lexer = pbrt_lexer_new();
    reader->build = scene_build_new();
    reader->params.reader = reader;
    pbrt_state_start(reader);
    pbrt_transforms_start(&reader->spaces);
    if (reader->lexer == NULL || reader->build == NULL)
        return pbrt_report_no_memory(reader);
    pbrt_view_start(reader);
    return pbrt_materials_start(reader);
}

/* Also what reader_open left half done */
static void reader_close(struct pbrt_reader *reader)
{
    pbrt_materials_free(&reader->materials);
    pbrt_textures_free(&reader->textures);
    pbrt_media_free(&reader->media);
    pbrt_objects_free(&reader->objects);
    pbrt_transforms_free(&reader->spaces);
    pbrt_state_free(&reader->stack);
    pbrt_params_free(&reader->params);
    scene_pictures_free(&reader->pictures);
    scene_build_free(reader->build);
    pbrt_lexer_free(reader->lexer);
    scene_notes_draft_free(&reader->report.notes);
}

static void note_counts(struct pbrt_reader *reader, const struct build_counts *counts,
                        const struct scene *scene, const char *name)
{
    const struct source_pos pos = { name, 0, 0 };
    if (counts->degenerate_triangles > 0)
        pbrt_report_note(reader, &pos, "%llu triangles without area were left out",
                         (unsigned long long)counts->degenerate_triangles);
    if (scene->light_count == 0)
        pbrt_report_note(reader, &pos, "the scene has no light: the picture will be black");
    if (scene->triangle_count == 0 && scene->quadric_count == 0)
        pbrt_report_note(reader, &pos, "the scene has no shape");
}

static struct scene *finish(struct pbrt_reader *reader, const char *name)
{
    struct build_counts counts;
    if (!pbrt_view_finish(reader) || !pbrt_materials_finish(reader) || !pbrt_media_finish(reader))
        return NULL;
    pbrt_textures_finish(reader);
    pbrt_sensor_finish(reader);
    struct scene *scene = scene_build_finish(reader->build, &counts, reader->err);
    if (scene == NULL)
        return NULL;
    note_counts(reader, &counts, scene, name);
    pbrt_media_note(reader, scene);
    return scene;
}

static struct scene *read_from(const char *path, const char *text, size_t length, const char *name,
                               const struct pbrt_options *options, struct scene_notes *notes,
                               struct err *err)
{
    struct pbrt_reader reader;
    struct scene *scene = NULL;
    if (reader_open(&reader, options != NULL && options->lenient, err)) {
        bool opened = path != NULL ? pbrt_lexer_open(reader.lexer, path, NULL, err)
                                   : pbrt_lexer_open_text(reader.lexer, text, length, name, err);
        if (opened && pbrt_directives_run(&reader))
            scene = finish(&reader, path != NULL ? path : name != NULL ? name : "text");
    }
    if (notes != NULL)
        *notes = scene_notes_of(&reader.report.notes, reader.report.warnings);
    reader_close(&reader);
    return scene;
}

struct scene *pbrt_read(const char *path, const struct pbrt_options *options,
                        struct scene_notes *notes, struct err *err)
{
    return read_from(path, NULL, 0, NULL, options, notes, err);
}

struct scene *pbrt_read_text(const char *text, size_t length, const char *name,
                             const struct pbrt_options *options, struct scene_notes *notes,
                             struct err *err)
{
    return read_from(NULL, text, length, name, options, notes, err);
}

/* --- Changes afterwards ------------------------------------------------------------------- */

bool pbrt_set_crop(struct scene *scene, const double crop[4], struct err *err)
{
    struct scene_settings *settings = &scene->settings;
    const uint32_t size[4] = { settings->width, settings->width, settings->height,
                               settings->height };
    uint32_t pixels[4];
    for (int i = 0; i < 4; i++) {
        if (!(crop[i] >= 0 && crop[i] <= 1))
            return err_set(err, ERR_ARGUMENT, "a crop window of %g is outside 0 to 1", crop[i]);
        pixels[i] = (uint32_t)ceil(crop[i] * size[i] - 1e-6); /* a fraction may be rounded */
    }
    if (pixels[0] >= pixels[1] || pixels[2] >= pixels[3])
        return err_set(err, ERR_ARGUMENT, "the crop window %g %g %g %g holds no pixel", crop[0],
                       crop[1], crop[2], crop[3]);
    memcpy(settings->crop, pixels, sizeof(pixels));
    return true;
}

/* Stretch [low, high] about its middle to a length */
static void stretch(float side[2], double length)
{
    double middle = ((double)side[0] + side[1]) / 2;
    double half = side[1] >= side[0] ? length / 2 : -length / 2;
    side[0] = (float)(middle - half);
    side[1] = (float)(middle + half);
}

bool pbrt_set_resolution(struct scene *scene, uint32_t width, uint32_t height, struct err *err)
{
    struct scene_settings *settings = &scene->settings;
    float *screen = settings->camera.screen;
    if (width < 1 || width > 65536 || height < 1 || height > 65536)
        return err_set(err, ERR_ARGUMENT, "a resolution of %ux%u is outside 1..65536", width,
                       height);
    double crop[4];
    for (int i = 0; i < 4; i++)
        crop[i] = (double)settings->crop[i] / (i < 2 ? settings->width : settings->height);

    double x = fabs((double)screen[1] - screen[0]), y = fabs((double)screen[3] - screen[2]);
    double shape = (double)settings->width / settings->height;
    if (fabs(x - y * shape) <= 1e-5 * x) {
        double shorter = fmin(x, y), aspect = (double)width / height;
        stretch(screen, aspect > 1 ? shorter * aspect : shorter);
        stretch(screen + 2, aspect > 1 ? shorter : shorter / aspect);
    }
    settings->width = width;
    settings->height = height;
    if (pbrt_set_crop(scene, crop, NULL))
        return true;
    const uint32_t all[4] = { 0, width, 0, height }; /* the window fell between pixels */
    memcpy(settings->crop, all, sizeof(all));
    return true;
}
