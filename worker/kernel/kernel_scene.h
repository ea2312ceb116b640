/*
 * A scene made ready for the kernels: the Embree scene over the model's own arrays, light choice
 * tables, filter tables and the sampler. Read-only once opened, shared by all render threads.
 */
#ifndef WORKER_KERNEL_KERNEL_SCENE_H
#define WORKER_KERNEL_KERNEL_SCENE_H

#include "common/job.h"
#include "common/path_dfa.h"
#include "common/sampler.h"
#include "common/scene.h"
#include "worker/kernel/embree.h"
#include "worker/kernel/environment.h"
#include "worker/kernel/filter.h"
#include "worker/kernel/light_tree.h"
#include "worker/kernel/textured.h"

#include <stdint.h>

/*
 * How far a spawned ray starts from its surface, in units of the largest coordinate involved: 16
 * roundings. Hit points are computed barycentrically, so they are within a few roundings of their
 * plane; the test of NUMERICS H1 finds no self-hit in 1e6 rays at any distance from the origin.
 */
#define SPAWN_ULPS 0x1p-20f

struct alpha_mesh;
struct emission;
struct first_hit;
struct kernel_thread;
struct path_stats;
struct ray_log;

/* What Embree's callbacks for the spheres and disks of a group, or of the world, are given */
struct kernel_quadrics {
    const struct kernel_scene *ks;
    const struct quadric *first;
};

/* A group of shapes in its own space */
struct kernel_group {
    struct RTCBounds bounds;
    RTCScene rtc;
    struct kernel_quadrics quadrics;
};

struct kernel_scene {
    const struct scene *scene;
    struct job_spec spec;
    unsigned fx; /* what the chosen variant may use; a superset of the scene's effects */
    uint32_t max_depth;
    RTCDevice device;
    RTCScene rtc;
    int32_t quadric_geometry;        /* geomID of all quadrics; meshes have their index */
    struct kernel_group *groups;     /* one per group of the scene */
    struct kernel_quadrics quadrics; /* of the world */
    struct sampler sampler;
    struct filter_table filter;
    struct path_dfa dfa;

    /* Lights that are sampled: all but the constant sky, which scattering finds by itself */
    uint32_t light_count;
    int32_t light_steps; /* largest power of two below light_count */
    float *light_cdf;    /* light_count + 1 entries, from 0 to 1 */
    float *light_pmf;    /* differences of light_cdf */
    float *light_extent; /* largest coordinate or radius: its points are rounded relative to this */
    struct light_tree light_tree; /* by which they are chosen instead, when there are many */
    int32_t polygon_fans;         /* triangles of the widest polygon's fan, at least 2 */
    int lights_sampled;           /* any light with pmf > 0 */
    float far_distance;           /* beyond everything in the scene */
    struct environment_table *environments; /* scene->environment_count */
    struct emission *emission; /* of each light; NULL when none changes over its surface */

    /* Textures */
    struct texture_set *textures;
    int32_t *textured; /* of each material, enum textured_part; of a mix, of all that it mixes */
    struct alpha_mesh *alpha_meshes; /* one per mesh; NULL when no mesh has an alpha texture */
    int has_alpha;                   /* some mesh or quadric has one */
    float footprint_size, footprint_angle; /* width of the footprint, at and with distance */

    void (*leaf)(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile,
                 uint32_t replicate, uint64_t leaf, struct path_stats *stats);
    const char *variant; /* name of the kernel variant, as printed */
};

/* Scratch of one render thread: the radiance of every sample of a leaf, planar r, g, b */
struct kernel_thread {
    float *radiance;
    uint32_t slot_count;                /* capacity in samples, a multiple of 8 */
    struct first_hit *first_hits;       /* of every sample; NULL when no layer wants them */
    struct ray_log *log;                /* NULL, or where the rays are recorded */
    struct texture_point points[LANES]; /* where lanes evaluate textures, */
    struct material materials[LANES];   /* and what they make of the materials there */
};

/* What a leaf counts while it runs */
struct path_stats {
    uint64_t rays_closest, rays_shadow, events, truncated_paths;
    double truncated_energy;
};

#endif
