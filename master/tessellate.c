#include "master/tessellate.h"

#include "common/elem.h"
#include "common/err.h"
#include "master/vector.h"

#include <math.h>
#include <string.h>

#define PI          3.14159265358979323846
#define SPHERE_TURN (TESSELLATE_TURN / 2)

void tessellate_free(struct tessellation *out)
{
    growing_free(&out->positions);
    growing_free(&out->normals);
    growing_free(&out->uvs);
    growing_free(&out->triangles);
}

/* --- Vertices and triangles --------------------------------------------------------------- */

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory for the triangles of a shape");
}

bool tessellate_allows(const struct tessellation *out, double more, struct err *err)
{
    double sum = (double)out->triangles.count + more;
    if (sum <= (double)out->most && sum < UINT32_MAX / 3)
        return true;
    return err_set(err, ERR_SCENE, "the shape takes %.0f triangles: %zu are possible here", sum,
                   out->most);
}

static bool add_doubles(struct growing *array, const double *values, size_t count)
{
    if (values == NULL)
        return true;
    double *added = growing_add(array, 1, count * sizeof(double));
    if (added == NULL)
        return false;
    memcpy(added, values, count * sizeof(double));
    return true;
}

bool tessellate_vertex(struct tessellation *out, const double p[3], const double n[3],
                       const double uv[2], struct err *err)
{
    return (add_doubles(&out->positions, p, 3) && add_doubles(&out->normals, n, 3) &&
            add_doubles(&out->uvs, uv, 2)) ||
           no_memory(err);
}

bool tessellate_triangle(struct tessellation *out, uint32_t a, uint32_t b, uint32_t c,
                         struct err *err)
{
    uint32_t *added = growing_add(&out->triangles, 1, 3 * sizeof(uint32_t));
    if (added == NULL)
        return no_memory(err);
    added[0] = a;
    added[1] = b;
    added[2] = c;
    return true;
}

/* --- Grids -------------------------------------------------------------------------------- */

struct point {
    double p[3], n[3], uv[2];
};

/* A surface over columns and rows; the point between them in column `i`, row `j` */
struct grid {
    void (*at)(const struct grid *grid, uint32_t i, uint32_t j, struct point *out);
    const void *shape;
    uint32_t columns, rows;
    bool flat; /* no normals */
};

static bool same_place(const struct tessellation *out, uint32_t a, uint32_t b)
{
    const double *p = (const double *)out->positions.data + 3 * (size_t)a;
    const double *q = (const double *)out->positions.data + 3 * (size_t)b;
    return p[0] == q[0] && p[1] == q[1] && p[2] == q[2];
}

/* A triangle, unless an edge of it has no length: at a pole, say */
static bool add_corners(struct tessellation *out, uint32_t a, uint32_t b, uint32_t c,
                        struct err *err)
{
    return same_place(out, a, b) || same_place(out, b, c) || same_place(out, c, a) ||
           tessellate_triangle(out, a, b, c, err);
}

static bool add_grid(struct tessellation *out, const struct grid *grid, struct err *err)
{
    if (!tessellate_allows(out, 2.0 * grid->columns * grid->rows, err))
        return false;
    uint32_t first = (uint32_t)out->positions.count, width = grid->columns + 1;
    for (uint32_t j = 0; j <= grid->rows; j++)
        for (uint32_t i = 0; i <= grid->columns; i++) {
            struct point point;
            grid->at(grid, i, j, &point);
            if (!tessellate_vertex(out, point.p, grid->flat ? NULL : point.n, point.uv, err))
                return false;
        }
    for (uint32_t j = 0; j < grid->rows; j++)
        for (uint32_t i = 0; i < grid->columns; i++) {
            uint32_t a = first + j * width + i, b = a + 1, c = b + width, d = a + width;
            if (!add_corners(out, a, b, c, err) || !add_corners(out, a, c, d, err))
                return false;
        }
    return true;
}

static uint32_t pieces_of(double angle, double turn, uint32_t pieces)
{
    double wanted = ceil(pieces * (angle / turn) - 1e-9);
    return wanted < 1 ? 1 : wanted < pieces ? (uint32_t)wanted : pieces;
}

/* --- Shapes about an axis ----------------------------------------------------------------- */

/* Cosine and sine of the i-th angle; the last of a full turn is the first, bit by bit */
static void direction(const struct grid *grid, double phi_max, uint32_t i, double out[2])
{
    bool closes = i == grid->columns && phi_max >= 2 * PI;
    double phi = closes ? 0 : phi_max * i / grid->columns;
    out[0] = elem_cos(phi);
    out[1] = elem_sin(phi);
}

static void cylinder_at(const struct grid *grid, uint32_t i, uint32_t j, struct point *out)
{
    const struct tessellate_round *shape = grid->shape;
    double way[2];
    direction(grid, shape->phi_max, i, way);
    *out = (struct point){ .p = { shape->radius * way[0], shape->radius * way[1],
                                  j ? shape->z_max : shape->z_min },
                           .n = { way[0], way[1], 0 },
                           .uv = { (double)i / grid->columns, j } };
}

bool tessellate_cylinder(struct tessellation *out, const struct tessellate_round *shape,
                         struct err *err)
{
    struct grid grid = { cylinder_at, shape, pieces_of(shape->phi_max, 2 * PI, TESSELLATE_TURN), 1,
                         false };
    return add_grid(out, &grid, err);
}

static double polar_angle(double z, double radius)
{
    double cosine = z / radius;
    return elem_acos(cosine < -1 ? -1 : cosine > 1 ? 1 : cosine);
}

static void sphere_at(const struct grid *grid, uint32_t i, uint32_t j, struct point *out)
{
    const struct tessellate_round *shape = grid->shape;
    double low = polar_angle(shape->z_min, shape->radius);
    double high = polar_angle(shape->z_max, shape->radius);
    double v = (double)j / grid->rows, theta = low + v * (high - low), way[2];
    double sine = elem_sin(theta), cosine = elem_cos(theta), u = i;
    if (j == 0 && shape->z_min <= -shape->radius) {
        sine = 0; /* a pole: each of its vertices belongs to the one triangle right of it, */
        cosine = -1;
        u += 0.5;
    } else if (j == grid->rows && shape->z_max >= shape->radius) {
        sine = 0; /* or left of it */
        cosine = 1;
        u -= 0.5;
    }
    direction(grid, shape->phi_max, i, way);
    *out = (struct point){ .n = { sine * way[0], sine * way[1], cosine },
                           .uv = { u / grid->columns, v } };
    for (int axis = 0; axis < 3; axis++)
        out->p[axis] = shape->radius * out->n[axis];
}

bool tessellate_sphere(struct tessellation *out, const struct tessellate_round *shape,
                       struct err *err)
{
    double range = polar_angle(shape->z_min, shape->radius) -
                   polar_angle(shape->z_max, shape->radius);
    struct grid grid = { sphere_at, shape, pieces_of(shape->phi_max, 2 * PI, SPHERE_TURN),
                         pieces_of(range, PI, SPHERE_TURN / 2), false };
    return add_grid(out, &grid, err);
}

static void disk_at(const struct grid *grid, uint32_t i, uint32_t j, struct point *out)
{
    const struct tessellate_round *shape = grid->shape;
    double radius = j ? shape->inner_radius : shape->radius, u = i, way[2];
    if (radius == 0)
        u -= 0.5; /* the centre, as a pole */
    direction(grid, shape->phi_max, i, way);
    *out = (struct point){ .p = { radius * way[0], radius * way[1], shape->height },
                           .uv = { u / grid->columns, j } };
}

bool tessellate_disk(struct tessellation *out, const struct tessellate_round *shape,
                     struct err *err)
{
    struct grid grid = { disk_at, shape, pieces_of(shape->phi_max, 2 * PI, TESSELLATE_TURN), 1,
                         true };
    return add_grid(out, &grid, err);
}

/* --- Bilinear patches --------------------------------------------------------------------- */

/* What the fourth corner lacks to a parallelogram */
static struct vec twist_of(const struct tessellate_patch *patch)
{
    return vec_sub(vec_sub(vec_at(patch->p[0]), vec_at(patch->p[1])),
                   vec_sub(vec_at(patch->p[2]), vec_at(patch->p[3])));
}

/* dp/du x dp/dv, not normalised */
static struct vec patch_cross(const struct tessellate_patch *patch, double u, double v)
{
    struct vec a = vec_at(patch->p[0]), b = vec_at(patch->p[1]);
    struct vec c = vec_at(patch->p[2]), d = vec_at(patch->p[3]);
    return vec_cross(vec_blend(vec_sub(b, a), vec_sub(d, c), v),
                     vec_blend(vec_sub(c, a), vec_sub(d, b), u));
}

bool tessellate_patch_is_flat(const struct tessellate_patch *patch)
{
    struct vec n = patch_cross(patch, 0.5, 0.5);
    double size = 0;
    for (int i = 0; i < 12; i++)
        size = fmax(size, fabs(patch->p[i / 3][i % 3]));
    double out = fabs(vec_dot(twist_of(patch), n));
    return out <= 1e-6 * size * vec_length(n); /* of numbers written with seven digits */
}

static double blend(double a, double b, double c, double d, double u, double v)
{
    return (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d);
}

static void patch_at(const struct grid *grid, uint32_t i, uint32_t j, struct point *out)
{
    const struct tessellate_patch *patch = grid->shape;
    double u = (double)i / grid->columns, v = (double)j / grid->rows;
    for (int axis = 0; axis < 3; axis++)
        out->p[axis] = blend(patch->p[0][axis], patch->p[1][axis], patch->p[2][axis],
                             patch->p[3][axis], u, v);
    out->uv[0] = u;
    out->uv[1] = v;
    for (int axis = 0; patch->has_uvs && axis < 2; axis++)
        out->uv[axis] = blend(patch->uv[0][axis], patch->uv[1][axis], patch->uv[2][axis],
                              patch->uv[3][axis], u, v);
    for (int axis = 0; patch->has_normals && axis < 3; axis++)
        out->n[axis] = blend(patch->n[0][axis], patch->n[1][axis], patch->n[2][axis],
                             patch->n[3][axis], u, v);
    if (!patch->has_normals) {
        struct vec n = patch_cross(patch, u, v);
        if (vec_length(n) == 0) /* at a corner with an edge of no length: that beside it */
            n = patch_cross(patch, u + 1e-3 * (0.5 - u), v + 1e-3 * (0.5 - v));
        memcpy(out->n, (double[3]){ n.x, n.y, n.z }, sizeof(out->n));
    }
    double size = vec_length(vec_at(out->n));
    for (int axis = 0; axis < 3; axis++)
        out->n[axis] = size > 0 && isfinite(size) ? out->n[axis] / size : 0;
}

bool tessellate_patch(struct tessellation *out, const struct tessellate_patch *patch,
                      double tolerance, bool flat, struct err *err)
{
    /* A quarter of the twist is what the middle of one cell is away from both triangles */
    double cells = ceil(sqrt(vec_length(twist_of(patch)) / (4 * tolerance)) - 1e-9);
    uint32_t n = !(cells > 1)                    ? 1
                 : cells < TESSELLATE_PATCH_MOST ? (uint32_t)cells
                                                 : TESSELLATE_PATCH_MOST;
    struct grid grid = { patch_at, patch, n, n, flat && !patch->has_normals };
    return add_grid(out, &grid, err);
}
