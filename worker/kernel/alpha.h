/*
 * Surfaces that are there in part (mesh.alpha): filters that Embree asks about every hit of such a
 * mesh. As in pbrt-v4 a hit counts where the texture is 1 or more, never where it is 0 or less, and
 * between with that probability, by a hash of the ray and of the triangle: layers behind each other
 * decide independently, and the same ray always gets the same answer.
 *
 * The hash of the ray comes with it, in its `id` (kernels write it when FX_TEXTURE is on), as the
 * ray itself is another inside of instances. (u, v) is recomputed in our own arithmetic; the
 * texture is read without a footprint.
 */
#ifndef WORKER_KERNEL_ALPHA_H
#define WORKER_KERNEL_ALPHA_H

#include "common/hash.h"
#include "worker/kernel/embree.h"
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

/* For rtcSetGeometryIntersectFilterFunction and rtcSetGeometryOccludedFilterFunction alike: hits
 * that do not count are made invalid. */
void alpha_filter(const struct RTCFilterFunctionNArguments *args);

#endif
