/*
 * Fresnel reflectance for unpolarised light, eight at a time.
 */
#ifndef WORKER_KERNEL_FRESNEL_H
#define WORKER_KERNEL_FRESNEL_H

#include "common/lane.h"

/*
 * Dielectric: c = |cos theta_i|, eta = n_transmitted / n_incident. Also gives |cos theta_t|, 0
 * under total internal reflection (where F is 1). sin^2 is taken as (1 - c)(1 + c), so that nothing
 * cancels near c = 1, and eta = 1 is exactly transparent at every angle (NUMERICS H22, H23).
 */
LANE_FN f8 fresnel_dielectric(f8 c, f8 eta, f8 *cos_t)
{
    f8 sin2_t = (1 - c) * (1 + c) / (eta * eta);
    i8 total = sin2_t >= 1;
    f8 ct = f8_sqrt(f8_max(1 - sin2_t, F8(0)));
    f8 parallel = (eta * c - ct) / (eta * c + ct);
    f8 across = (c - eta * ct) / (c + eta * ct);
    f8 F = (parallel * parallel + across * across) * 0.5f;
    F = f8_select(total, F8(1), F);
    i8 same = eta == 1;
    *cos_t = f8_select(same, c, f8_select(total, F8(0), ct));
    return f8_select(same, F8(0), f8_min(F, F8(1)));
}

/*
 * Conductor with complex index eta + i k, relative to the outside: the exact equations as in Born
 * and Wolf, Principles of Optics, section 14.2. With k = 0 it equals the dielectric (H31).
 */
LANE_FN f8 fresnel_conductor(f8 c, f8 eta, f8 k)
{
    f8 c2 = c * c;
    f8 s2 = (1 - c) * (1 + c);
    f8 t0 = (eta - k) * (eta + k) - s2;
    f8 a2_b2 = f8_sqrt(t0 * t0 + 4 * eta * eta * k * k);
    f8 a = f8_sqrt(f8_max((a2_b2 + t0) * 0.5f, F8(0)));
    f8 t1 = a2_b2 + c2;
    f8 t2 = 2 * a * c;
    f8 across = (t1 - t2) / (t1 + t2);
    f8 t3 = c2 * a2_b2 + s2 * s2;
    f8 t4 = t2 * s2;
    f8 parallel = across * (t3 - t4) / (t3 + t4);
    f8 F = (parallel + across) * 0.5f;
    return f8_clamp(f8_select(t1 + t2 > 0, F, F8(1)), 0, 1);
}

#endif
