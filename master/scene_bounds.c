#include "master/scene_bounds.h"

#include <math.h>
#include <string.h>

struct scene_bounds scene_bounds_empty(void)
{
    return (struct scene_bounds){ { INFINITY, INFINITY, INFINITY },
                                  { -INFINITY, -INFINITY, -INFINITY } };
}

bool scene_bounds_is_empty(const struct scene_bounds *bounds)
{
    return !(bounds->min[0] <= bounds->max[0]);
}

void scene_bounds_add(struct scene_bounds *bounds, const double p[3])
{
    /* Comparisons, which NaN fails: fmin and fmax are calls */
    for (int axis = 0; axis < 3; axis++) {
        if (p[axis] < bounds->min[axis])
            bounds->min[axis] = p[axis];
        if (p[axis] > bounds->max[axis])
            bounds->max[axis] = p[axis];
    }
}

void scene_bounds_quadric_center(const struct build_quadric *built, double center[3])
{
    const double object[3] = { 0, 0, built->height };
    transform_point(&built->place.to_world, object, center);
}

void scene_bounds_add_quadric(struct scene_bounds *bounds, const struct build_quadric *built)
{
    const struct transform *m = &built->place.to_world;
    double center[3], low[3], high[3];
    scene_bounds_quadric_center(built, center);
    for (int axis = 0; axis < 3; axis++) {
        double x = m->m[axis][0], y = m->m[axis][1];
        double z = built->quadric.kind == QUADRIC_SPHERE ? m->m[axis][2] : 0;
        double reach = built->quadric.radius * sqrt(x * x + y * y + z * z);
        low[axis] = center[axis] - reach;
        high[axis] = center[axis] + reach;
    }
    scene_bounds_add(bounds, low);
    scene_bounds_add(bounds, high);
}

void scene_bounds_add_mesh(struct scene_bounds *bounds, const struct scene_build *build,
                           const struct build_mesh *mesh)
{
    struct scene_bounds here = *bounds;
    for (uint32_t v = 0; v < mesh->range.vertex_count; v++) {
        double world[3];
        scene_bounds_vertex(build, mesh, v, world);
        scene_bounds_add(&here, world);
    }
    *bounds = here;
}

void scene_bounds_add_box(struct scene_bounds *bounds, const struct scene_bounds *box,
                          const struct transform *to_world)
{
    if (scene_bounds_is_empty(box))
        return;
    for (int corner = 0; corner < 8; corner++) {
        double p[3];
        for (int axis = 0; axis < 3; axis++)
            p[axis] = corner >> axis & 1 ? box->max[axis] : box->min[axis];
        transform_point(to_world, p, p);
        scene_bounds_add(bounds, p);
    }
}

void scene_bounds_center(const struct scene_bounds *bounds, double center[3])
{
    double extent = 0;
    for (int axis = 0; axis < 3; axis++)
        extent = fmax(extent, bounds->max[axis] - bounds->min[axis]);
    int exponent;
    frexp(extent, &exponent);
    double grid = extent > 1e-30 ? ldexp(1, exponent) : 0;
    for (int axis = 0; axis < 3; axis++) {
        double middle = bounds->min[axis] / 2 + bounds->max[axis] / 2;
        center[axis] = grid > 0 ? floor(middle / grid + 0.5) * grid : middle;
    }
}
