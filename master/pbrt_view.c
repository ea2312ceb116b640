#include "master/pbrt_view.h"

#include "common/elem.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define PI        3.14159265358979323846
#define COUNT(a)  (sizeof(a) / sizeof((a)[0]))
#define SIZE_MOST 65536 /* pixels along a side */
#define CENTRE    1e-6f /* pixels: a filter that is a point */

static struct scene_settings *settings_of(struct pbrt_reader *reader)
{
    return &reader->build->scene->settings;
}

void pbrt_view_start(struct pbrt_reader *reader)
{
    reader->view = (struct pbrt_view){ .kind = CAMERA_PERSPECTIVE,
                                       .world_from_camera = transform_identity(),
                                       .shutter = { 0, 1 },
                                       .fov = PI / 2,
                                       .focal_distance = 1e6,
                                       .width = 1280,
                                       .height = 720,
                                       .crop = { 0, 1, 0, 1 } };
    pbrt_sensor_start(&reader->view.sensor);
    settings_of(reader)->filter = (struct filter_spec){ .kind = FILTER_GAUSSIAN,
                                                        .radius = { 1.5f, 1.5f },
                                                        .sigma = 0.5f };
}

/* --- Camera ------------------------------------------------------------------------------- */

static const struct pbrt_name cameras[] = {
    { "perspective", CAMERA_PERSPECTIVE, NAME_OURS, NULL },
    { "orthographic", CAMERA_ORTHOGRAPHIC, NAME_OURS, NULL },
    { "realistic", 0, NAME_LATER, NULL },
    { "spherical", 0, NAME_LATER, NULL },
    { "environment", 0, NAME_OLD, "in pbrt-v4 it is \"spherical\"" },
};

bool pbrt_view_camera(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    struct pbrt_view *view = &reader->view;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "camera", cameras, COUNT(cameras), type, &found))
        return false;
    if (!transform_invert(&reader->state.ctm, &view->world_from_camera))
        return pbrt_report_error(reader, &type->pos, "the camera's transform cannot be inverted");
    if (!transform_invert(&reader->state.ctm_end, &view->world_from_camera_end))
        return pbrt_report_error(reader, &type->pos, "the camera's transform cannot be inverted");
    view->moves = pbrt_state_moves(&reader->state);
    view->medium = reader->state.outside;
    view->pos = type->pos;
    reader->spaces.camera = view->world_from_camera;
    reader->spaces.camera_end = view->world_from_camera_end;
    if (found == NULL)
        return true;
    view->kind = (enum camera_kind)found->value;

    size_t corners;
    const double *screen = pbrt_params_array(params, "screenwindow", PARAM_FLOAT, &corners);
    view->has_screen = screen != NULL;
    if (screen != NULL && (corners != 4 || screen[0] == screen[1] || screen[2] == screen[3]))
        pbrt_params_fail(params, pbrt_params_find(params, "screenwindow"),
                         "\"float screenwindow\" wants x min, x max, y min, y max");
    else if (screen != NULL)
        memcpy(view->screen, screen, sizeof(view->screen));
    view->aspect = pbrt_params_float(params, "frameaspectratio", 0);
    view->lens_radius = pbrt_params_float(params, "lensradius", 0);
    view->focal_distance = pbrt_params_float(params, "focaldistance", 1e6);
    if (view->kind == CAMERA_PERSPECTIVE) {
        double fov = pbrt_params_float(params, "fov", 90);
        double half = pbrt_params_float(params, "halffov", 0);
        fov = half > 0 ? 2 * half : fov;
        if (!(fov > 0 && fov < 180))
            pbrt_params_fail(params, pbrt_params_find(params, "fov"),
                             "a field of view of %g degrees is outside 0 to 180", fov);
        view->fov = fov * (PI / 180);
    }
    if (view->aspect < 0 || view->lens_radius < 0 || !(view->focal_distance > 0))
        pbrt_params_fail(params, NULL,
                         "frameaspectratio, lensradius and focaldistance must be positive");
    view->shutter[0] = pbrt_params_float(params, "shutteropen", 0);
    view->shutter[1] = pbrt_params_float(params, "shutterclose", 1);
    if (!(view->shutter[0] < view->shutter[1]))
        pbrt_params_fail(params, pbrt_params_find(params, "shutterclose"),
                         view->shutter[0] == view->shutter[1]
                             ? "the shutter closes at %g as it opens at %g: the film stays black"
                             : "the shutter closes at %g, before it opens at %g",
                         view->shutter[1], view->shutter[0]);
    return pbrt_params_done(params);
}

/* --- Film --------------------------------------------------------------------------------- */

enum { FILM_RGB, FILM_GBUFFER, FILM_SPECTRAL };
static const struct pbrt_name films[] = {
    { "rgb", FILM_RGB, NAME_OURS, NULL },
    { "gbuffer", FILM_GBUFFER, NAME_OURS, NULL },
    { "spectral", FILM_SPECTRAL, NAME_OURS, NULL },
    { "image", 0, NAME_OLD, "in pbrt-v4 it is \"rgb\"" },
};

static void read_size(struct pbrt_params *params, const char *name, uint32_t otherwise,
                      uint32_t *size)
{
    int64_t value = pbrt_params_integer(params, name, otherwise);
    if (value < 1 || value > SIZE_MOST)
        pbrt_params_fail(params, pbrt_params_find(params, name), "%s is %lld; 1 to %d is possible",
                         name, (long long)value, SIZE_MOST);
    else
        *size = (uint32_t)value;
}

bool pbrt_view_film(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    struct pbrt_view *view = &reader->view;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "film", films, COUNT(films), type, &found))
        return false;
    if (found->value != FILM_RGB)
        pbrt_report_note(reader, &type->pos, "film \"%s\" is read as \"rgb\"", found->text);

    read_size(params, "xresolution", 1280, &view->width);
    read_size(params, "yresolution", 720, &view->height);
    size_t count;
    const double *crop = pbrt_params_array(params, "cropwindow", PARAM_FLOAT, &count);
    if (crop != NULL && (count != 4 || !(crop[0] >= 0 && crop[0] < crop[1] && crop[1] <= 1 &&
                                         crop[2] >= 0 && crop[2] < crop[3] && crop[3] <= 1)))
        pbrt_params_fail(params, pbrt_params_find(params, "cropwindow"),
                         "\"float cropwindow\" wants x0 x1 y0 y1 with 0 <= x0 < x1 <= 1");
    else if (crop != NULL)
        memcpy(view->crop, crop, sizeof(view->crop));
    const double *bounds = pbrt_params_array(params, "pixelbounds", PARAM_INTEGER, &count);
    view->has_pixel_bounds = bounds != NULL;
    if (bounds != NULL && count != 4)
        pbrt_params_fail(params, pbrt_params_find(params, "pixelbounds"),
                         "\"integer pixelbounds\" wants x0 x1 y0 y1");
    for (size_t i = 0; bounds != NULL && i < count && i < 4; i++)
        view->pixel_bounds[i] = (int64_t)bounds[i];

    pbrt_sensor_read(params, &view->sensor);
    pbrt_params_string(params, "filename");
    pbrt_params_bool(params, "savefp16", true);
    pbrt_params_float(params, "diagonal", 35);
    if (found->value == FILM_GBUFFER)
        pbrt_params_ignore(params, "coordinatesystem");
    if (found->value == FILM_SPECTRAL) {
        pbrt_params_ignore(params, "nbuckets");
        pbrt_params_ignore(params, "lambdamin");
        pbrt_params_ignore(params, "lambdamax");
    }
    return pbrt_params_done(params);
}

/* --- Filter ------------------------------------------------------------------------------- */

static const struct pbrt_name filters[] = {
    { "box", FILTER_BOX, NAME_OURS, NULL },
    { "triangle", FILTER_TRIANGLE, NAME_OURS, NULL },
    { "gaussian", FILTER_GAUSSIAN, NAME_OURS, NULL },
    { "mitchell", FILTER_MITCHELL, NAME_OURS, NULL },
    { "sinc", FILTER_SINC, NAME_OURS, NULL },
};

bool pbrt_view_filter(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "pixel filter", filters, COUNT(filters), type, &found))
        return false;
    if (found == NULL)
        return true;
    static const double radius[] = {
        [FILTER_BOX] = 0.5,    [FILTER_TRIANGLE] = 2, [FILTER_GAUSSIAN] = 1.5,
        [FILTER_MITCHELL] = 2, [FILTER_SINC] = 4,
    };
    struct filter_spec filter = { .kind = (uint32_t)found->value };
    filter.radius[0] = (float)pbrt_params_float(params, "xradius", radius[found->value]);
    filter.radius[1] = (float)pbrt_params_float(params, "yradius", radius[found->value]);
    if (filter.kind == FILTER_GAUSSIAN)
        filter.sigma = (float)pbrt_params_float(params, "sigma", 0.5);
    if (filter.kind == FILTER_MITCHELL) {
        filter.b = (float)pbrt_params_float(params, "B", 1.0 / 3);
        filter.c = (float)pbrt_params_float(params, "C", 1.0 / 3);
    }
    if (filter.kind == FILTER_SINC)
        filter.tau = (float)pbrt_params_float(params, "tau", 3);
    int most = filter.kind == FILTER_SINC ? FILTER_SINC_RADIUS : 64;
    for (int axis = 0; axis < 2; axis++)
        if (!(filter.radius[axis] > 1e-3f && filter.radius[axis] <= (float)most))
            pbrt_params_fail(params, NULL, "a filter radius of %g pixels is outside .001 to %d",
                             filter.radius[axis], most);
    if (filter.kind == FILTER_GAUSSIAN && !(filter.sigma > 1e-3f && filter.sigma <= 1e3f))
        pbrt_params_fail(params, NULL, "a sigma of %g pixels is outside .001 to 1000",
                         filter.sigma);
    if (filter.kind == FILTER_SINC && !(filter.tau >= 1 && filter.tau <= 1e3f))
        pbrt_params_fail(params, NULL, "a tau of %g is outside 1 to 1000", filter.tau);
    if (fabsf(filter.b) > 10 || fabsf(filter.c) > 10)
        pbrt_params_fail(params, NULL, "the filter's B and C are outside -10 to 10");
    settings_of(reader)->filter = filter;
    return pbrt_params_done(params);
}

/* --- All together ------------------------------------------------------------------------- */

/* The shorter axis of the picture spans [-1, 1], times the extent of the field of view */
static void screen_of(double aspect, double extent, float screen[4])
{
    double x = aspect > 1 ? aspect : 1, y = aspect > 1 ? 1 : 1 / aspect;
    screen[0] = (float)(-x * extent);
    screen[1] = (float)(x * extent);
    screen[2] = (float)(-y * extent);
    screen[3] = (float)(y * extent);
}

static void crop_of(const double fractions[4], uint32_t width, uint32_t height, uint32_t crop[4])
{
    const uint32_t size[4] = { width, width, height, height };
    for (int i = 0; i < 4; i++)
        crop[i] = (uint32_t)ceil(fractions[i] * size[i] - 1e-6);
}

bool pbrt_view_finish(struct pbrt_reader *reader)
{
    const struct pbrt_view *view = &reader->view;
    struct scene_settings *settings = settings_of(reader);
    struct camera *camera = &settings->camera;
    settings->width = view->width;
    settings->height = view->height;

    crop_of(view->crop, view->width, view->height, settings->crop);
    if (view->has_pixel_bounds)
        for (int i = 0; i < 4; i++) {
            int64_t most = i < 2 ? view->width : view->height, value = view->pixel_bounds[i];
            settings->crop[i] = (uint32_t)(value < 0 ? 0 : value > most ? most : value);
        }
    if (settings->crop[0] >= settings->crop[1] || settings->crop[2] >= settings->crop[3])
        return err_set(reader->err, ERR_SCENE, "the film's crop window holds no pixel");

    camera->kind = view->kind;
    camera->lens_radius = (float)view->lens_radius;
    camera->focal_distance = (float)view->focal_distance;
    double extent = view->kind == CAMERA_PERSPECTIVE ? elem_tan(view->fov / 2) : 1;
    if (view->has_screen)
        for (int i = 0; i < 4; i++)
            camera->screen[i] = (float)(view->screen[i] * extent);
    else
        screen_of(view->aspect > 0 ? view->aspect : (double)view->width / view->height, extent,
                  camera->screen);
    reader->build->world_from_camera = view->world_from_camera;
    reader->build->camera_moves = view->moves;
    reader->build->world_from_camera_end = view->world_from_camera_end;
    reader->build->camera_pos = view->pos;
    const double *times = reader->spaces.times;
    for (int i = 0; i < 2; i++)
        settings->shutter[i] = (float)((view->shutter[i] - times[0]) / (times[1] - times[0]));
    if (view->no_jitter)
        settings->filter = (struct filter_spec){ .kind = FILTER_BOX, .radius = { CENTRE, CENTRE } };
    return pbrt_media_resolve(reader, view->medium, &settings->camera_medium);
}
