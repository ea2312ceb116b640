#include "worker/kernel/surface_point.h"

#include "common/elem.h"

#include <math.h>
#include <string.h>

#define TURN 6.28318530717958647692
#define AT_POLE \
    1e-5 /* of the radius: closer to the axis there is no angle, or none that is exact */

static void sub(const float a[3], const float b[3], float out[3])
{
    for (int axis = 0; axis < 3; axis++)
        out[axis] = a[axis] - b[axis];
}

static void cross(const float a[3], const float b[3], float out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static float clamp01(float x)
{
    return x > 0 ? (x < 1 ? x : 1) : 0;
}

void surface_point_triangle(const struct scene *scene, const struct mesh *mesh, uint32_t prim,
                            const float o[3], const float d[3], struct texture_point *point)
{
    static const float default_uv[3][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 } };
    const uint32_t *corner = scene->triangles + 3 * ((size_t)mesh->first_triangle + prim);
    const float *A = scene->positions + 3 * (size_t)corner[0];
    float e1[3], e2[3], h[3], q[3], from[3];
    sub(scene->positions + 3 * (size_t)corner[1], A, e1);
    sub(scene->positions + 3 * (size_t)corner[2], A, e2);
    cross(d, e2, h);
    float inv = 1 / dot(e1, h);
    sub(o, A, from);
    cross(from, e1, q);
    float u = clamp01(inv * dot(from, h));
    float v = fminf(fmaxf(inv * dot(d, q), 0), 1 - u);
    const float weight[3] = { 1 - u - v, u, v };

    memset(point, 0, sizeof(*point));
    cross(e1, e2, point->n);
    float length = sqrtf(dot(point->n, point->n));
    for (int axis = 0; axis < 3; axis++) {
        point->p[axis] = A[axis] + u * e1[axis] + v * e2[axis];
        point->n[axis] = length > 0 ? point->n[axis] / length : axis == 2;
    }
    bool has_color = mesh->flags & MESH_COLORS;
    for (int c = 0; c < 4; c++)
        point->color[c] = has_color ? 0 : 1;
    for (int i = 0; i < 3; i++) {
        const float *uv = default_uv[i];
        if (mesh->flags & MESH_UVS)
            uv = scene->uvs + 2 * (size_t)(corner[i] + mesh->uv_shift);
        for (int c = 0; c < 2; c++)
            point->uv[c] += weight[i] * uv[c];
        const float *color = scene->colors + 4 * (size_t)(corner[i] + mesh->color_shift);
        for (int c = 0; has_color && c < 4; c++)
            point->color[c] += weight[i] * color[c];
    }
}

/* m v, row-major */
static void linear(const float m[9], const float v[3], float out[3])
{
    for (int row = 0; row < 3; row++)
        out[row] = dot(m + 3 * row, v);
}

static double cosine_of(float z, float radius)
{
    double cosine = (double)z / (double)radius;
    return cosine < -1 ? -1 : cosine > 1 ? 1 : cosine;
}

/* pbrt's u and v of a point in the quadric's own space */
static void quadric_uv(const struct quadric *q, const float local[3], float uv[2])
{
    double x = (double)local[0], y = (double)local[1], radius = (double)q->radius;
    double phi_max = fmin((double)q->phi_max, TURN);
    if (x * x + y * y < AT_POLE * AT_POLE * radius * radius) {
        x = AT_POLE * radius;
        y = 0;
    }
    double phi = elem_atan2(y, x);
    uv[0] = (float)((phi < 0 ? phi + TURN : phi) / phi_max);
    if (q->kind == QUADRIC_SPHERE) {
        double from = elem_acos(cosine_of(q->z_min, q->radius));
        double to = elem_acos(cosine_of(q->z_max, q->radius));
        uv[1] = (float)((elem_acos(cosine_of(local[2], q->radius)) - from) / (to - from));
    } else {
        uv[1] = (float)((radius - sqrt(x * x + y * y)) / (radius - (double)q->inner_radius));
    }
}

void surface_point_quadric(const struct quadric *q, const float o[3], const float d[3], float t,
                           struct texture_point *point)
{
    float from[3], local[3], normal[3] = { 0, 0, 1 };
    for (int axis = 0; axis < 3; axis++)
        from[axis] = o[axis] - q->center[axis] + t * d[axis];
    linear(q->to_object, from, local);
    if (q->kind == QUADRIC_SPHERE) { /* back onto the surface */
        float length = sqrtf(dot(local, local));
        for (int axis = 0; axis < 3; axis++) {
            normal[axis] = length > 0 ? local[axis] / length : axis == 2;
            local[axis] = normal[axis] * q->radius;
        }
    } else {
        local[2] = 0;
    }

    memset(point, 0, sizeof(*point));
    quadric_uv(q, local, point->uv);
    linear(q->to_world, local, point->p);
    float length2 = 0;
    for (int axis = 0; axis < 3; axis++) {
        /* Normals go by the inverse transpose */
        const float *m = q->to_object + axis;
        point->p[axis] += q->center[axis];
        point->n[axis] = m[0] * normal[0] + m[3] * normal[1] + m[6] * normal[2];
        length2 += point->n[axis] * point->n[axis];
    }
    for (int axis = 0; axis < 3; axis++)
        point->n[axis] /= sqrtf(length2);
    for (int c = 0; c < 4; c++)
        point->color[c] = 1;
}
