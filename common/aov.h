/*
 * The layers of a picture besides its radiance (arbitrary output variables): what the first hit of
 * every camera path shows. They go through the same sum tree, so a job says which it wants
 * (struct job_spec, `aovs`), and they are the same bits whatever the farm.
 *
 * Channels of a node's sums: R, G, B; with any layer the coverage, then the layers asked for, in
 * the order of AOV_MAP. Over the samples of a pixel are summed:
 *   coverage  1 where the path hit something, weighted with the magnitude of the filter
 *   alpha     the same weighted with the filter itself, as radiance is
 *   depth     along the camera's forward axis, from the camera's plane, in world units; of a camera
 *             that moves, at the sample's own time
 *   position, normal, geometric_normal, albedo
 *             of the hit, in re-centred world space, at the sample's own time
 *   motion    in pixels, x to the right and y downwards: from where the camera sees the point of
 *             the surface that was hit when the shutter opens to where it sees it when the shutter
 *             closes, through the middle of the lens. 0 where nothing moves, and where the point is
 *             behind the camera at either time
 *
 * All but alpha have the coverage's weight, so that divided by the coverage they are averages over
 * the hits, and stay in their range for filters with negative lobes. The albedo of one sample is
 * the weight f cos / pdf of its sampled direction (times eta^2 for transmission), an unbiased
 * estimate of the share of light from everywhere that the material scatters towards the camera.
 * A hit with a value that is not finite counts as none. A path that first scatters in a medium
 * shows that place, with the medium's albedo, without a normal (0) and without identities.
 *
 * Identities are not summed: channel s of AOV_OBJECT and AOV_MATERIAL holds 1 + the index that
 * sample s of its replicate hit, or 0, and only the first AOV_ID_SAMPLES samples are kept. Each
 * channel has one sample, so the tree adds zeros to it, and adds exactly. Objects are the scene's
 * meshes, then its quadrics, then its instances: what is hit inside of one is the instance.
 */
#ifndef COMMON_AOV_H
#define COMMON_AOV_H

#include <stdbool.h>
#include <stdint.h>

#define AOV_ID_SAMPLES 4         /* of each replicate */
#define AOV_ID_MAX     (1 << 24) /* identities are below: float32 holds them all exactly */

#define AOV_MAP(X) /* name, bit, what it is called in options and files, channels */ \
    X(ALPHA, 0, "alpha", 1)                                                          \
    X(DEPTH, 1, "depth", 1)                                                          \
    X(POSITION, 2, "position", 3)                                                    \
    X(NORMAL, 3, "normal", 3)                                                        \
    X(GEOMETRIC_NORMAL, 4, "geometric_normal", 3)                                    \
    X(ALBEDO, 5, "albedo", 3)                                                        \
    X(OBJECT, 6, "object", AOV_ID_SAMPLES)                                           \
    X(MATERIAL, 7, "material", AOV_ID_SAMPLES)                                       \
    X(MOTION, 8, "motion", 2)

enum aov {
#define X(name, bit, text, channels) AOV_##name = bit,
    AOV_MAP(X)
#undef X
        AOV_COUNT
};
#define AOV_ALL              ((1u << AOV_COUNT) - 1)
#define AOV_COVERAGE_CHANNEL 3

static inline bool aov_in(uint32_t aovs, enum aov aov)
{
    return (aovs >> aov & 1) != 0;
}

/* Channels of a node's sums with these layers: 3 without any. */
uint32_t aov_channel_count(uint32_t aovs);
/* The first channel of a layer that is in `aovs`. */
uint32_t aov_channel(uint32_t aovs, enum aov aov);
/* "depth" */
const char *aov_name(enum aov aov);

#endif
