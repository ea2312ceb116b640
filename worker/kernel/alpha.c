#include "worker/kernel/alpha.h"

#include "common/hash.h"
#include "worker/kernel/surface_point.h"

float alpha_share(const struct texture_set *textures, uint32_t alpha,
                  const struct texture_point *point)
{
    float rgb[3];
    if (alpha == 0)
        return 1;
    texture_at(textures, alpha - 1, point, rgb);
    return rgb[0] > 0 ? (rgb[0] < 1 ? rgb[0] : 1) : 0; /* not a number is nothing */
}

/* Does the hit count, of which there is that share? By a hash of the ray and of what it hits */
static bool counts(float share, uint32_t ray, uint32_t geometry, uint32_t prim, uint64_t which)
{
    if (share >= 1 || share <= 0)
        return share >= 1;
    uint64_t hash = hash64_3(ray, (uint64_t)geometry << 32 | prim, which);
    return (float)(hash >> 40) * 0x1p-24f < share;
}

bool alpha_quadric(const struct kernel_scene *ks, const struct quadric *quadric,
                   const struct alpha_hit *hit)
{
    struct texture_point point;
    surface_point_quadric(quadric, hit->o, hit->d, hit->t, &point);
    float share = alpha_share(ks->textures, quadric->alpha, &point);
    return counts(share, hit->ray, hit->geometry, hit->prim, hit->turn);
}

void alpha_filter(const struct RTCFilterFunctionNArguments *args)
{
    const struct alpha_mesh *of = args->geometryUserPtr;
    const struct mesh *mesh = &of->scene->meshes[of->mesh];
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
        struct texture_point point;
        surface_point_triangle(of->scene, mesh, hit[HIT_PRIM * N], o, d, &point);
        float share = alpha_share(of->textures, mesh->alpha, &point);
        if (!counts(share, ids[i], hit[HIT_GEOM * N], hit[HIT_PRIM * N], hit[HIT_INST * N]))
            args->valid[i] = 0;
    }
}
