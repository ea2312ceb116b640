#include "worker/kernel/ray_log.h"

void ray_log_add(struct ray_log *log, const struct RTCRay8 *ray, unsigned lanes, bool shadow)
{
    for (; lanes != 0; lanes &= lanes - 1) {
        int lane = __builtin_ctz(lanes);
        if (log->count == log->capacity) {
            log->dropped++;
            continue;
        }
        log->rays[log->count++] = (struct logged_ray){
            .o = { ray->org_x[lane], ray->org_y[lane], ray->org_z[lane] },
            .d = { ray->dir_x[lane], ray->dir_y[lane], ray->dir_z[lane] },
            .tfar = ray->tfar[lane],
            .shadow = shadow,
        };
    }
}
