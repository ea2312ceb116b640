#include "worker/kernel/first_hit.h"

#include "common/aov.h"
#include "worker/kernel/instance.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Where the values of a sample are, and how many there are */
enum {
    DEPTH = 0,
    POSITION = 1,
    NORMAL = 4,
    GEOMETRIC_NORMAL = 7,
    ALBEDO = 10,
    MOTION = 13, /* never decides whether a sample counts */
    VALUES = 15,
};

/* Sums over the samples of one pixel */
struct totals {
    double coverage, alpha;
    double values[VALUES];
    uint32_t object[AOV_ID_SAMPLES], material[AOV_ID_SAMPLES]; /* 1 + index, or 0 */
};

/* The camera at one moment */
struct view {
    double position[3], forward[3];
    double inverse[3][3]; /* its right, up and forward of a direction of the world */
};

static struct view view_of(double axes[3][3], const double position[3])
{
    struct view view;
    double det = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const double *a = axes[(i + 1) % 3], *b = axes[(i + 2) % 3];
            int u = (j + 1) % 3, v = (j + 2) % 3;
            view.inverse[i][j] = a[u] * b[v] - a[v] * b[u];
        }
    for (int j = 0; j < 3; j++)
        det += axes[0][j] * view.inverse[0][j];
    for (int i = 0; i < 9; i++)
        view.inverse[i / 3][i % 3] /= det;
    memcpy(view.position, position, sizeof(view.position));
    memcpy(view.forward, axes[2], sizeof(view.forward));
    return view;
}

static struct view view_at(const struct scene *scene, float time)
{
    const struct camera *camera = &scene->settings.camera;
    double axes[3][3], position[3];
    if (scene->settings.camera_motion != 0) {
        i8 motion = I8((int32_t)scene->settings.camera_motion - 1);
        const struct rows8 m = motion_pose(scene, true, motion, F8(time)).to_world;
        const struct vec3x8 *rows[3] = { &m.x, &m.y, &m.z };
        const f8 *add[3] = { &m.add.x, &m.add.y, &m.add.z };
        for (int i = 0; i < 3; i++) {
            axes[0][i] = (double)rows[i]->x[0];
            axes[1][i] = (double)rows[i]->y[0];
            axes[2][i] = (double)rows[i]->z[0];
            position[i] = (double)(*add[i])[0];
        }
        return view_of(axes, position);
    }
    for (int i = 0; i < 3; i++) {
        axes[0][i] = (double)camera->right[i];
        axes[1][i] = (double)camera->up[i];
        axes[2][i] = (double)camera->forward[i];
        position[i] = (double)camera->position[i];
    }
    return view_of(axes, position);
}

/* What is the same for all samples */
struct looks {
    const struct scene *scene;
    float open, close; /* the shutter, where the motions are */
    struct view first, last;
    bool wants_motion;
};

static struct looks looks_of(const struct kernel_scene *ks)
{
    const float *shutter = ks->scene->settings.shutter;
    struct looks looks = { .scene = ks->scene,
                           .open = fminf(fmaxf(shutter[0], 0), 1),
                           .close = fminf(fmaxf(shutter[1], 0), 1),
                           .wants_motion = aov_in(ks->spec.aovs, AOV_MOTION) };
    looks.first = view_at(ks->scene, looks.open);
    looks.last = view_at(ks->scene, looks.close);
    return looks;
}

static double depth(const struct view *view, const float p[3])
{
    double length2 = 0, along = 0;
    for (int axis = 0; axis < 3; axis++) {
        double forward = view->forward[axis];
        length2 += forward * forward;
        along += forward * ((double)p[axis] - view->position[axis]);
    }
    return along / sqrt(length2);
}

/* Where the point that was hit is when the shutter opens and when it closes */
static void points_of(const struct looks *looks, const struct first_hit *hit, double ends[2][3])
{
    const struct scene *scene = looks->scene;
    for (int axis = 0; axis < 3; axis++)
        ends[0][axis] = ends[1][axis] = (double)hit->p[axis];
    int32_t instance = (int32_t)hit->object - first_hit_instance(scene);
    if (instance < 0 || scene->instances[instance].motion == 0)
        return;
    f8 times = { hit->time, looks->open, looks->close };
    struct pose8 pose = instance_pose(scene, FX_ALL, true, I8(instance), times);
    struct vec3x8 p = rows8_point(&pose.to_object, vec3x8_all(hit->p[0], hit->p[1], hit->p[2]));
    p = rows8_point(&pose.to_world, vec3x8_all(p.x[0], p.y[0], p.z[0]));
    for (int end = 0; end < 2; end++) {
        ends[end][0] = (double)p.x[1 + end];
        ends[end][1] = (double)p.y[1 + end];
        ends[end][2] = (double)p.z[1 + end];
    }
}

/* Where a point is seen, in pixels; false when it is behind the camera */
static bool film_point(const struct scene_settings *settings, const struct view *view,
                       const double p[3], double film[2])
{
    const float *screen = settings->camera.screen;
    double at[3], z = 1;
    for (int i = 0; i < 3; i++)
        at[i] = view->inverse[i][0] * (p[0] - view->position[0]) +
                view->inverse[i][1] * (p[1] - view->position[1]) +
                view->inverse[i][2] * (p[2] - view->position[2]);
    if (settings->camera.kind == CAMERA_PERSPECTIVE)
        z = at[2];
    double width = (double)screen[1] - (double)screen[0],
           height = (double)screen[3] - (double)screen[2];
    film[0] = at[0] / z / width * settings->width;
    film[1] = -at[1] / z / height * settings->height;
    return z > 0;
}

static void motion_of(const struct looks *looks, const struct first_hit *hit, double motion[2])
{
    const struct scene_settings *settings = &looks->scene->settings;
    double ends[2][3], from[2], to[2];
    points_of(looks, hit, ends);
    bool seen = film_point(settings, &looks->first, ends[0], from) &&
                film_point(settings, &looks->last, ends[1], to);
    for (int i = 0; i < 2; i++) {
        double moved = seen ? to[i] - from[i] : 0;
        motion[i] = isfinite(moved) ? moved : 0;
    }
}

/* False when there is nothing to show */
static bool values_of(const struct looks *looks, const struct first_hit *hit, double *values)
{
    if (hit->seen == 0)
        return false;
    values[DEPTH] = depth(&looks->first, hit->p);
    if (looks->scene->settings.camera_motion != 0) {
        struct view now = view_at(looks->scene, hit->time);
        values[DEPTH] = depth(&now, hit->p);
    }
    for (int axis = 0; axis < 3; axis++) {
        values[POSITION + axis] = (double)hit->p[axis];
        values[NORMAL + axis] = (double)hit->ns[axis];
        values[GEOMETRIC_NORMAL + axis] = (double)hit->ng[axis];
        values[ALBEDO + axis] = (double)hit->albedo[axis];
    }
    for (int i = 0; i < MOTION; i++)
        if (!isfinite(values[i]))
            return false;
    values[MOTION] = values[MOTION + 1] = 0;
    if (looks->wants_motion)
        motion_of(looks, hit, values + MOTION);
    return true;
}

static struct totals totals_of(const struct kernel_scene *ks, const struct looks *looks,
                               const struct first_hit *hits, uint64_t first_sample)
{
    struct totals totals = { .coverage = 0 };
    for (uint32_t k = 0; k < ks->spec.leaf_samples; k++) {
        double values[VALUES];
        if (!values_of(looks, &hits[k], values))
            continue;
        uint64_t sample = first_sample + k;
        double weight = 1;
        if (ks->filter.has_negative)
            weight = (double)(sample % 4 == 3 ? ks->filter.weight_negative
                                              : ks->filter.weight_positive);
        totals.alpha += weight;
        totals.coverage += fabs(weight);
        for (int i = 0; i < VALUES; i++)
            totals.values[i] += fabs(weight) * values[i];
        if (sample < AOV_ID_SAMPLES) {
            totals.object[sample] = hits[k].object + 1;
            totals.material[sample] = hits[k].material + 1;
        }
    }
    return totals;
}

/* `count` sums of one pixel into the planes of a layer, if it is asked for */
static void put(struct node_sums *sums, uint32_t aovs, enum aov aov, uint32_t pixel,
                const double *values, uint32_t count)
{
    if (!aov_in(aovs, aov))
        return;
    float *plane = sums->values + (size_t)aov_channel(aovs, aov) * sums->pixel_count;
    for (uint32_t c = 0; c < count; c++)
        plane[(size_t)c * sums->pixel_count + pixel] = (float)values[c];
}

static void put_ids(struct node_sums *sums, uint32_t aovs, enum aov aov, uint32_t pixel,
                    const uint32_t ids[AOV_ID_SAMPLES])
{
    double values[AOV_ID_SAMPLES];
    for (int s = 0; s < AOV_ID_SAMPLES; s++)
        values[s] = (double)ids[s];
    put(sums, aovs, aov, pixel, values, AOV_ID_SAMPLES);
}

void first_hit_sum(const struct kernel_scene *ks, const struct first_hit *hits,
                   uint64_t first_sample, struct node_sums *sums)
{
    const struct looks looks = looks_of(ks);
    uint32_t aovs = ks->spec.aovs;
    for (uint32_t pixel = 0; pixel < sums->pixel_count; pixel++) {
        struct totals totals = totals_of(ks, &looks, hits + (size_t)pixel * ks->spec.leaf_samples,
                                         first_sample);
        sums->values[(size_t)AOV_COVERAGE_CHANNEL * sums->pixel_count + pixel] =
            (float)totals.coverage;
        put(sums, aovs, AOV_ALPHA, pixel, &totals.alpha, 1);
        put(sums, aovs, AOV_DEPTH, pixel, totals.values + DEPTH, 1);
        put(sums, aovs, AOV_POSITION, pixel, totals.values + POSITION, 3);
        put(sums, aovs, AOV_NORMAL, pixel, totals.values + NORMAL, 3);
        put(sums, aovs, AOV_GEOMETRIC_NORMAL, pixel, totals.values + GEOMETRIC_NORMAL, 3);
        put(sums, aovs, AOV_ALBEDO, pixel, totals.values + ALBEDO, 3);
        put(sums, aovs, AOV_MOTION, pixel, totals.values + MOTION, 2);
        put_ids(sums, aovs, AOV_OBJECT, pixel, totals.object);
        put_ids(sums, aovs, AOV_MATERIAL, pixel, totals.material);
    }
}
