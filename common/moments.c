#include "common/moments.h"

#include <math.h>

void moments_add(struct moments *m, double x)
{
    m->n++;
    double delta = x - m->mean;
    m->mean += delta / (double)m->n;
    m->m2 += delta * (x - m->mean);
}

void moments_merge(struct moments *m, const struct moments *other)
{
    if (other->n == 0)
        return;
    if (m->n == 0) {
        *m = *other;
        return;
    }
    double na = (double)m->n, nb = (double)other->n, n = na + nb;
    double delta = other->mean - m->mean;
    m->mean += delta * (nb / n);
    m->m2 += other->m2 + delta * delta * (na * (nb / n));
    m->n += other->n;
}

double moments_variance(const struct moments *m)
{
    return m->n < 2 ? INFINITY : m->m2 / (double)(m->n - 1);
}

double moments_stderr(const struct moments *m)
{
    return m->n < 2 ? INFINITY : sqrt(moments_variance(m) / (double)m->n);
}
