#include "master/coat.h"

#include "common/elem.h"

#include <math.h>

#define PI                3.14159265358979323846
#define NORMALS           32  /* microfacet normals per axis of the unit square, at one direction */
#define NORMALS_IN        24  /* the same while integrating over directions too */
#define DIRECTIONS        256 /* of the diffuse flux inside */
#define DIRECTIONS_SMOOTH 8192 /* the same, where total reflection begins with a kink */

struct direction {
    double x, y, z;
};

static double dot(struct direction a, struct direction b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static struct direction unit(double x, double y, double z)
{
    double length = sqrt(x * x + y * y + z * z);
    return (struct direction){ x / length, y / length, z / length };
}

/* Reflectance at cosine `c` > 0, going from index 1 into index `n`; *c_in is Snell's cosine */
static double fresnel(double c, double n, double *c_in)
{
    *c_in = c;
    if (n == 1)
        return 0;
    double sin2_in = (1 - c) * (1 + c) / (n * n);
    if (sin2_in >= 1)
        return 1;
    *c_in = sqrt(1 - sin2_in);
    double parallel = (n * c - *c_in) / (n * c + *c_in);
    double across = (c - n * *c_in) / (c + n * *c_in);
    return (parallel * parallel + across * across) / 2;
}

/* Smith's Lambda for GGX, of a direction at cosine z */
static double lambda(double z, double alpha)
{
    double cos2 = z * z;
    return cos2 > 0 ? (sqrt(1 + alpha * alpha * (1 - cos2) / cos2) - 1) / 2 : INFINITY;
}

/* G2(wo, wi) / G1(wo) with height-correlated G2; cosines' signs do not matter */
static double shadowing(double z_out, double z_in, double alpha)
{
    double out = lambda(z_out, alpha), in = lambda(z_in, alpha);
    return (1 + out) / (1 + out + in);
}

/* The visible microfacet normal for a point of a disk (height t above it on the hemisphere, turn
 * v), seen along wo (z > 0): the hemisphere of the stretched view, projected to the disk, whose
 * lower half is squeezed. Uniform points of the disk have density 2 t in t. */
static struct direction visible_normal(struct direction wo, double alpha, double t, double v)
{
    struct direction view = unit(alpha * wo.x, alpha * wo.y, wo.z);
    struct direction across = view.z < 0.99999 ? unit(-view.y, view.x, 0)
                                               : (struct direction){ 1, 0, 0 };
    struct direction other = { view.y * across.z - view.z * across.y,
                               view.z * across.x - view.x * across.z,
                               view.x * across.y - view.y * across.x };
    double r = sqrt((1 - t) * (1 + t));
    double px = r * elem_cos(2 * PI * v), py = r * elem_sin(2 * PI * v);
    double half = (1 + view.z) / 2, rim = sqrt(fmax(0, 1 - px * px));
    py = (1 - half) * rim + half * py;
    double pz = sqrt(fmax(0, 1 - px * px - py * py));
    double x = px * across.x + py * other.x + pz * view.x;
    double y = px * across.y + py * other.y + pz * view.y;
    double z = px * across.z + py * other.z + pz * view.z;
    return unit(alpha * x, alpha * y, fmax(1e-9, z));
}

static double attenuation(double z, double thickness)
{
    return z != 0 ? elem_exp(-thickness / fabs(z)) : 0;
}

/* Midpoints of [0, 1] */
static double grid(int i, int count)
{
    return (i + 0.5) / count;
}

static double entering(double mu, double alpha, double ior, double thickness)
{
    double c_in;
    if (alpha < ALPHA_SMOOTH) {
        double reflected = fresnel(mu, ior, &c_in);
        return (1 - reflected) * attenuation(c_in, thickness);
    }
    struct direction wo = { sqrt((1 - mu) * (1 + mu)), 0, mu };
    double sum = 0;
    for (int i = 0; i < NORMALS; i++)
        for (int j = 0; j < NORMALS; j++) {
            double t = grid(i, NORMALS);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS));
            double c = dot(wo, m);
            if (c <= 0)
                continue;
            double reflected = fresnel(c, ior, &c_in);
            double z = (c / ior - c_in) * m.z - wo.z / ior; /* of the refracted direction */
            if (reflected < 1 && z < 0)
                sum += 2 * t * (1 - reflected) * shadowing(wo.z, z, alpha) *
                       attenuation(z, thickness);
        }
    return sum / (NORMALS * NORMALS);
}

/* Of light going up at cosine mu inside the coat, what is reflected and arrives at the base */
static double returning(double mu, double alpha, double ior, double thickness)
{
    double c_out;
    if (alpha < ALPHA_SMOOTH)
        return fresnel(mu, 1 / ior, &c_out) * attenuation(mu, thickness);
    struct direction wo = { sqrt((1 - mu) * (1 + mu)), 0, mu };
    double sum = 0;
    for (int i = 0; i < NORMALS_IN; i++)
        for (int j = 0; j < NORMALS_IN; j++) {
            double t = grid(i, NORMALS_IN);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS_IN));
            double c = dot(wo, m);
            double z = 2 * c * m.z - wo.z; /* of the mirrored direction */
            if (c > 0 && z > 0)
                sum += 2 * t * fresnel(c, 1 / ior, &c_out) * shadowing(wo.z, z, alpha) *
                       attenuation(z, thickness);
        }
    return sum / (NORMALS_IN * NORMALS_IN);
}

void coat_tabulate(double alpha, double ior, double thickness, struct coat *coat)
{
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double root = (double)i / (COAT_TABLE_LEN - 1);
        double mu = fmax(root * root, 1e-6);
        coat->table[i] = (float)entering(mu, alpha, ior, thickness);
    }
    /* A diffuse flux is uniform in mu^2 */
    int directions = alpha < ALPHA_SMOOTH ? DIRECTIONS_SMOOTH : DIRECTIONS;
    double sum = 0;
    for (int i = 0; i < directions; i++) {
        double mu = sqrt(grid(i, directions));
        sum += attenuation(mu, thickness) * returning(mu, alpha, ior, thickness);
    }
    coat->inner = (float)(sum / directions);
    coat->scale = (float)(1 / (PI * ior * ior));
}
