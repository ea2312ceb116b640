/*
 * Surfaces that are there in part (mesh.alpha, quadric.alpha): Embree asks about every hit of one.
 * As in pbrt-v4 a hit counts where the texture is 1 or more, never where it is 0 or less, and
 * between with that probability, by a hash of the ray and of the primitive: layers behind each
 * other decide independently, and the same ray always gets the same answer.
 *
 * The hash of the ray comes with it, in its `id` (kernels write it when something has an alpha), as
 * the ray itself is another inside of instances; there it is hashed again, with the instance. (u,
 * v) is recomputed in our own arithmetic; the texture is read without a footprint. Of points it
 * sees those of the shape's own space: inside of instances, as in pbrt-v4, not the world's.
 */
#ifndef WORKER_KERNEL_ALPHA_H
#define WORKER_KERNEL_ALPHA_H

#include "common/hash.h"
#include "worker/kernel/embree.h"
#include "worker/kernel/kernel_scene.h"
#include "worker/kernel/texture.h"

/* What tells a ray from others */
LANE_FN u8 alpha_ray_id(struct vec3x8 o, struct vec3x8 d)
{
    u8 hash = u8_hash((u8)o.x);
    hash = u8_hash(hash ^ (u8)o.y);
    hash = u8_hash(hash ^ (u8)o.z);
    hash = u8_hash(hash ^ (u8)d.x);
    hash = u8_hash(hash ^ (u8)d.y);
    return u8_hash(hash ^ (u8)d.z);
}

/* What the geometry's user data points to */
struct alpha_mesh {
    const struct scene *scene;
    const struct texture_set *textures;
    uint32_t mesh;
};

/* How much is there, from 0 to 1; `alpha` as in struct mesh. */
float alpha_share(const struct texture_set *textures, uint32_t alpha,
                  const struct texture_point *point);

/* For rtcSetGeometryIntersectFilterFunction and rtcSetGeometryOccludedFilterFunction alike: hits
 * that do not count are made invalid. */
void alpha_filter(const struct RTCFilterFunctionNArguments *args);

/* A ray that meets a quadric at o + t d: for the first time (turn 0) or the second. */
struct alpha_hit {
    float o[3], d[3], t;
    uint32_t ray; /* its id */
    uint32_t geometry, prim, turn;
};
bool alpha_quadric(const struct kernel_scene *ks, const struct quadric *quadric,
                   const struct alpha_hit *hit);

#endif
