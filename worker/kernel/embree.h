/*
 * Embree 3 or 4 behind one small header: the kernel writes rtc_intersect8 and rtc_occluded8.
 */
#ifndef WORKER_KERNEL_EMBREE_H
#define WORKER_KERNEL_EMBREE_H

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

/*
 * The rows of what Embree calls RTCRayN and RTCHitN in its callbacks: N values each, one row after
 * the other (its accessors exist in C++ only; the order is that of struct RTCRay and RTCHit).
 */
enum ray_row {
    RAY_ORG_X,
    RAY_ORG_Y,
    RAY_ORG_Z,
    RAY_TNEAR,
    RAY_DIR_X,
    RAY_DIR_Y,
    RAY_DIR_Z,
    RAY_TIME,
    RAY_TFAR,
    RAY_MASK,
    RAY_ID,
    RAY_FLAGS,
    RAY_ROWS
};
enum hit_row { HIT_NG_X, HIT_NG_Y, HIT_NG_Z, HIT_U, HIT_V, HIT_PRIM, HIT_GEOM, HIT_INST };

static inline __attribute__((always_inline, unused)) void
rtc_intersect8(const int *valid, RTCScene scene, struct RTCRayHit8 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect8(valid, scene, rays, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect8(valid, scene, &context, rays);
#endif
}

/* The same of rays that go nearly one way: Embree leads them through its tree together */
static inline __attribute__((always_inline, unused)) void
rtc_intersect_together8(const int *valid, RTCScene scene, struct RTCRayHit8 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    struct RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
    rtcIntersect8(valid, scene, rays, &arguments);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcIntersect8(valid, scene, &context, rays);
#endif
}

static inline __attribute__((always_inline, unused)) void
rtc_occluded8(const int *valid, RTCScene scene, struct RTCRay8 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    rtcOccluded8(valid, scene, rays, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded8(valid, scene, &context, rays);
#endif
}

/* The same from inside a callback, which was given the arguments `outer` */
static inline __attribute__((always_inline, unused)) void
rtc_intersect_inside8(const int *valid, RTCScene scene,
                      const struct RTCIntersectFunctionNArguments *outer, struct RTCRayHit8 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    struct RTCIntersectArguments inner;
    rtcInitIntersectArguments(&inner);
    inner.context = outer->context;
    rtcIntersect8(valid, scene, rays, &inner);
#else
    rtcIntersect8(valid, scene, outer->context, rays);
#endif
}

static inline __attribute__((always_inline, unused)) void
rtc_occluded_inside8(const int *valid, RTCScene scene,
                     const struct RTCOccludedFunctionNArguments *outer, struct RTCRay8 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    struct RTCOccludedArguments inner;
    rtcInitOccludedArguments(&inner);
    inner.context = outer->context;
    rtcOccluded8(valid, scene, rays, &inner);
#else
    rtcOccluded8(valid, scene, outer->context, rays);
#endif
}

#endif
