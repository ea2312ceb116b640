#include "master/gltf_view.h"

#include "common/elem.h"
#include "master/gltf.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define PI            3.14159265358979323846
#define ROWS          720
#define ASPECT        (16.0 / 9)
#define ASPECT_MOST   50.0     /* either way */
#define FRAMED_HALF   (PI / 8) /* half the field of view of the view of everything */
#define FRAMED_MARGIN 1.05

/* --- Cameras ------------------------------------------------------------------------------ */

/* Is it the one that is asked for: by its node's name, its own, or its number? */
static bool is_wanted(const struct gltf_reader *reader, const char *node, const char *camera,
                      uint32_t index)
{
    const char *wanted = reader->options->camera;
    char number[16];
    snprintf(number, sizeof(number), "%u", index);
    return wanted == NULL || (node != NULL && strcmp(node, wanted) == 0) ||
           (camera != NULL && strcmp(camera, wanted) == 0) || strcmp(number, wanted) == 0;
}

static void add_name(struct gltf_view *view, const char *name)
{
    size_t length = strlen(view->names);
    snprintf(view->names + length, sizeof(view->names) - length, "%s\"%.60s\"",
             length > 0 ? ", " : "", name);
}

static bool read_projection(struct gltf_reader *reader, const struct gltf_item *camera)
{
    struct gltf_view *view = &reader->view;
    const char *type = gltf_json_text(reader, camera, "type");
    if (reader->failed || type == NULL)
        return gltf_report_error(reader, camera->where, "it has no type");
    if (strcmp(type, "perspective") == 0) {
        struct gltf_item item = gltf_json_child(reader, camera, "perspective");
        double fov = gltf_json_number(reader, &item, "yfov", 0, 1e-6, PI - 1e-6);
        if (fov == 0)
            return gltf_report_error(reader, camera->where, "it has no field of view");
        view->kind = CAMERA_PERSPECTIVE;
        view->half_height = elem_tan(fov / 2);
        view->aspect = gltf_json_number(reader, &item, "aspectRatio", 0, 1 / ASPECT_MOST,
                                        ASPECT_MOST);
    } else if (strcmp(type, "orthographic") == 0) {
        struct gltf_item item = gltf_json_child(reader, camera, "orthographic");
        double x = fabs(gltf_json_number(reader, &item, "xmag", 0, -1e12, 1e12));
        double y = fabs(gltf_json_number(reader, &item, "ymag", 0, -1e12, 1e12));
        if (!(x > 1e-12 && y > 1e-12 && x < ASPECT_MOST * y && y < ASPECT_MOST * x))
            return gltf_report_error(reader, camera->where, "a view of %g by %g", 2 * x, 2 * y);
        view->kind = CAMERA_ORTHOGRAPHIC;
        view->half_height = y;
        view->aspect = x / y;
    } else {
        return gltf_report_error(reader, camera->where, "there is no camera \"%s\"", type);
    }
    return !reader->failed;
}

/* Columns right, up and forward of unit length: a node's scale does not change the view */
static bool look_along(struct gltf_reader *reader, const struct gltf_item *node,
                       const struct transform *to_world)
{
    struct transform *m = &reader->view.world_from_camera;
    *m = *to_world;
    for (int column = 0; column < 3; column++) {
        double x = m->m[0][column], y = m->m[1][column], z = m->m[2][column];
        double length = sqrt(x * x + y * y + z * z);
        if (!(length > 0))
            return gltf_report_error(reader, node->where, "its camera is scaled to nothing");
        for (int row = 0; row < 3; row++)
            m->m[row][column] *= (column == 2 ? -1 : 1) / length;
    }
    return true;
}

bool gltf_view_camera(struct gltf_reader *reader, const struct gltf_item *node,
                      const struct transform *to_world)
{
    struct gltf_view *view = &reader->view;
    struct gltf_item camera;
    uint32_t number = gltf_json_index(reader, node, "camera");
    if (reader->failed || number == SCENE_NONE)
        return !reader->failed;
    if (!gltf_json_find(reader, "cameras", number, node, &camera))
        return false;
    const char *node_name = gltf_json_text(reader, node, "name");
    const char *name = gltf_json_text(reader, &camera, "name");
    char shown[80];
    if (node_name != NULL || name != NULL)
        snprintf(shown, sizeof(shown), "%.79s", node_name != NULL ? node_name : name);
    else
        snprintf(shown, sizeof(shown), "%u", number);
    view->cameras++;
    add_name(view, shown);
    if (reader->failed || view->found || !is_wanted(reader, node_name, name, number))
        return !reader->failed;
    view->found = true;
    memcpy(view->name, shown, sizeof(shown));
    return read_projection(reader, &camera) && look_along(reader, node, to_world);
}

/* --- The view of everything --------------------------------------------------------------- */

void gltf_view_enclose(struct gltf_reader *reader, const double min[3], const double max[3],
                       const struct transform *to_world)
{
    struct gltf_view *view = &reader->view;
    for (int corner = 0; corner < 8; corner++) {
        double p[3];
        for (int axis = 0; axis < 3; axis++)
            p[axis] = corner >> axis & 1 ? max[axis] : min[axis];
        transform_point(to_world, p, p);
        for (int axis = 0; axis < 3; axis++) {
            bool first = !view->has_bounds;
            view->min[axis] = first ? p[axis] : fmin(view->min[axis], p[axis]);
            view->max[axis] = first ? p[axis] : fmax(view->max[axis], p[axis]);
        }
        view->has_bounds = true;
    }
}

/* From the front, a little from the right and from above; as near as all corners of the bounds
 * allow */
static void frame(struct gltf_view *view)
{
    const double back[3] = { 0.34299717028502, 0.38348249442369, 0.85749292571254 }; /* unit */
    double flat = sqrt(back[0] * back[0] + back[2] * back[2]);
    const double right[3] = { back[2] / flat, 0, -back[0] / flat };
    const double up[3] = { back[1] * right[2], flat, -back[1] * right[0] };
    double middle[3] = { 0, 0, 0 }, half[3] = { 0, 0, 0 }, distance = 0;
    view->kind = CAMERA_PERSPECTIVE;
    view->half_height = elem_tan(FRAMED_HALF);
    view->aspect = ASPECT;
    for (int axis = 0; view->has_bounds && axis < 3; axis++) {
        middle[axis] = (view->min[axis] + view->max[axis]) / 2;
        half[axis] = (view->max[axis] - view->min[axis]) / 2;
    }
    for (int corner = 0; corner < 8; corner++) {
        double x = 0, y = 0, z = 0; /* of the corner, along right, up and back */
        for (int axis = 0; axis < 3; axis++) {
            double c = corner >> axis & 1 ? half[axis] : -half[axis];
            x += c * right[axis];
            y += c * up[axis];
            z += c * back[axis];
        }
        /* In the square that the picture holds in whatever shape it is taken */
        distance = fmax(distance, z + FRAMED_MARGIN * fmax(fabs(x), fabs(y)) / view->half_height);
    }
    distance = distance > 0 ? distance : 1;
    view->world_from_camera = transform_identity();
    for (int axis = 0; axis < 3; axis++) {
        double *row = view->world_from_camera.m[axis];
        row[0] = right[axis];
        row[1] = up[axis];
        row[2] = -back[axis];
        row[3] = middle[axis] + distance * back[axis];
    }
}

/* --- All together ------------------------------------------------------------------------- */

bool gltf_view_finish(struct gltf_reader *reader)
{
    struct gltf_view *view = &reader->view;
    struct scene_settings *settings = &reader->build->scene->settings;
    const char *wanted = reader->options->camera;
    if (!view->found && wanted != NULL)
        return gltf_report_error(reader, "", "there is no camera \"%s\"; there %s %s", wanted,
                                 view->cameras > 1 ? "are" : "is",
                                 view->cameras > 0 ? view->names : "none");
    if (view->cameras > 1 && wanted == NULL)
        gltf_report_note(reader, "", "camera \"%s\" of %s; --camera chooses", view->name,
                         view->names);
    if (!view->found) {
        gltf_report_note(reader, "", "there is no camera: a view from the front shows everything");
        frame(view);
    }
    double aspect = view->aspect > 0 ? view->aspect : ASPECT;
    settings->width = (uint32_t)floor(ROWS * aspect + 0.5);
    settings->height = ROWS;
    settings->crop[1] = settings->width;
    settings->crop[3] = settings->height;
    settings->filter = (struct filter_spec){ .kind = FILTER_GAUSSIAN,
                                             .radius = { 1.5f, 1.5f },
                                             .sigma = 0.5f };
    double half_width = view->half_height * settings->width / settings->height;
    const double screen[4] = { -half_width, half_width, -view->half_height, view->half_height };
    settings->camera.kind = view->kind;
    for (int i = 0; i < 4; i++)
        settings->camera.screen[i] = (float)screen[i];
    reader->build->world_from_camera = view->world_from_camera;
    return true;
}
