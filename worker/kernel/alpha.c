#include "worker/kernel/alpha.h"

#include "common/hash.h"

#include <math.h>
#include <string.h>

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

/* Triangle `prim` where the ray meets it, as hit_triangle has it */
static void point_at(const struct scene *scene, const struct mesh *mesh, uint32_t prim,
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

static bool counts(const struct alpha_mesh *of, uint32_t ray, uint32_t geometry, uint32_t prim,
                   uint32_t instance, const float o[3], const float d[3])
{
    const struct mesh *mesh = &of->scene->meshes[of->mesh];
    struct texture_point point;
    point_at(of->scene, mesh, prim, o, d, &point);
    float rgb[3];
    texture_at(of->textures, mesh->alpha - 1, &point, rgb);
    if (rgb[0] >= 1)
        return true;
    if (!(rgb[0] > 0))
        return false;
    uint64_t hash = hash64_3(ray, (uint64_t)geometry << 32 | prim, instance);
    return (float)(hash >> 40) * 0x1p-24f < rgb[0];
}

void alpha_filter(const struct RTCFilterFunctionNArguments *args)
{
    unsigned N = args->N;
    const float *rays = (const float *)args->ray;
    const uint32_t *ids = (const uint32_t *)args->ray + (size_t)RAY_ID * N;
    const uint32_t *hits = (const uint32_t *)args->hit;
    for (unsigned i = 0; i < N; i++) {
        if (args->valid[i] != -1)
            continue;
        const float *ray = rays + i;
        const float o[3] = { ray[RAY_ORG_X * N], ray[RAY_ORG_Y * N], ray[RAY_ORG_Z * N] };
        const float d[3] = { ray[RAY_DIR_X * N], ray[RAY_DIR_Y * N], ray[RAY_DIR_Z * N] };
        const uint32_t *hit = hits + i;
        if (!counts(args->geometryUserPtr, ids[i], hit[HIT_GEOM * N], hit[HIT_PRIM * N],
                    hit[HIT_INST * N], o, d))
            args->valid[i] = 0;
    }
}
