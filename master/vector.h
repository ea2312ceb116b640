/*
 * Vectors of three doubles, for what is computed as scenes are read. Elementwise IEEE arithmetic in
 * the order written here, as bits of the scene depend on it.
 */
#ifndef MASTER_VECTOR_H
#define MASTER_VECTOR_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>

struct vec {
    double x, y, z;
};

static inline struct vec vec_at(const double p[3])
{
    return (struct vec){ p[0], p[1], p[2] };
}

static inline struct vec vec_add(struct vec a, struct vec b)
{
    return (struct vec){ a.x + b.x, a.y + b.y, a.z + b.z };
}

static inline struct vec vec_sub(struct vec a, struct vec b)
{
    return (struct vec){ a.x - b.x, a.y - b.y, a.z - b.z };
}

static inline struct vec vec_scale(struct vec a, double s)
{
    return (struct vec){ a.x * s, a.y * s, a.z * s };
}

/* From a at t = 0 to b at 1 */
static inline struct vec vec_blend(struct vec a, struct vec b, double t)
{
    return vec_add(vec_scale(a, 1 - t), vec_scale(b, t));
}

static inline double vec_dot(struct vec a, struct vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct vec vec_cross(struct vec a, struct vec b)
{
    return (struct vec){ a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x };
}

static inline double vec_length(struct vec a)
{
    return sqrt(vec_dot(a, a));
}

/* Scale to length 1, exactly enough for tiny and huge vectors; false for zero */
static inline bool vec_unit(struct vec a, struct vec *unit)
{
    double largest = fmax(fabs(a.x), fmax(fabs(a.y), fabs(a.z)));
    if (!(largest > 0) || !isfinite(largest))
        return false;
    a = (struct vec){ a.x / largest, a.y / largest, a.z / largest };
    double length = vec_length(a);
    *unit = (struct vec){ a.x / length, a.y / length, a.z / length };
    return true;
}

/* The diagonal of the box about one point or more */
static inline double vec_extent(const double *points, size_t count)
{
    struct vec low = vec_at(points), high = low;
    for (size_t i = 1; i < count; i++) {
        struct vec p = vec_at(points + 3 * i);
        low = (struct vec){ fmin(low.x, p.x), fmin(low.y, p.y), fmin(low.z, p.z) };
        high = (struct vec){ fmax(high.x, p.x), fmax(high.y, p.y), fmax(high.z, p.z) };
    }
    return vec_length(vec_sub(high, low));
}

#endif
