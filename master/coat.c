#include "master/coat.h"

#include "common/elem.h"

#include <math.h>
#include <string.h>

#define PI                3.14159265358979323846
#define NORMALS           32  /* microfacet normals per axis of the unit square, at one direction */
#define NORMALS_IN        24  /* the same while integrating over directions too */
#define DIRECTIONS        256 /* of the diffuse flux inside */
#define DIRECTIONS_SMOOTH 8192 /* the same, where total reflection begins with a kink */
#define ANGLES            64   /* cosines inside, at which the energy of a walk is kept */
#define TURNS_MAX         2000
#define COAT_LEAST        1e-6 /* what a division by nothing is kept at */

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

/* Add energy at cosine z to the two nearest of ANGLES cosines; to none where `to` is NULL */
static void spread(double *to, double z, double energy)
{
    if (to == NULL)
        return;
    double x = fmin(fmax(z * ANGLES - 0.5, 0), ANGLES - 1);
    int i = x < ANGLES - 2 ? (int)x : ANGLES - 2;
    to[i] += (1 - (x - i)) * energy;
    to[i + 1] += (x - i) * energy;
}

/* Of light from outside at cosine mu, what arrives at the base; added to `to` by its cosine */
static double entering(double mu, double alpha, double ior, double thickness, double *to)
{
    double c_in;
    if (alpha < ALPHA_SMOOTH) {
        double reflected = fresnel(mu, ior, &c_in);
        double arrives = (1 - reflected) * attenuation(c_in, thickness);
        spread(to, c_in, arrives);
        return arrives;
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
            if (reflected < 1 && z < 0) {
                double arrives = 2 * t * (1 - reflected) * shadowing(wo.z, z, alpha) *
                                 attenuation(z, thickness);
                sum += arrives;
                spread(to, -z, arrives / (NORMALS * NORMALS));
            }
        }
    return sum / (NORMALS * NORMALS);
}

/* Of light at the interface, going up at cosine mu inside, what is reflected and arrives at the
 * base; added to `to` by its cosine */
static double returning(double mu, double alpha, double ior, double thickness, double *to)
{
    double c_out;
    if (alpha < ALPHA_SMOOTH) {
        double arrives = fresnel(mu, 1 / ior, &c_out) * attenuation(mu, thickness);
        spread(to, mu, arrives);
        return arrives;
    }
    struct direction wo = { sqrt((1 - mu) * (1 + mu)), 0, mu };
    double sum = 0;
    for (int i = 0; i < NORMALS_IN; i++)
        for (int j = 0; j < NORMALS_IN; j++) {
            double t = grid(i, NORMALS_IN);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS_IN));
            double c = dot(wo, m);
            double z = 2 * c * m.z - wo.z; /* of the mirrored direction */
            if (c > 0 && z > 0) {
                double arrives = 2 * t * fresnel(c, 1 / ior, &c_out) * shadowing(wo.z, z, alpha) *
                                 attenuation(z, thickness);
                sum += arrives;
                spread(to, z, arrives / (NORMALS_IN * NORMALS_IN));
            }
        }
    return sum / (NORMALS_IN * NORMALS_IN);
}

/* The cosine outside of entry i of a table */
static double table_cosine(int i)
{
    double root = (double)i / (COAT_TABLE_LEN - 1);
    return fmax(root * root, 1e-6);
}

/* R_in, of a diffuse flux: uniform in mu^2 */
static double returning_diffuse(double alpha, double ior, double thickness)
{
    int directions = alpha < ALPHA_SMOOTH ? DIRECTIONS_SMOOTH : DIRECTIONS;
    double sum = 0;
    for (int i = 0; i < directions; i++) {
        double mu = sqrt(grid(i, directions));
        sum += attenuation(mu, thickness) * returning(mu, alpha, ior, thickness, NULL);
    }
    return sum / directions;
}

void coat_tabulate(double alpha, double ior, double thickness, struct coat *coat)
{
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        coat->table[i] = (float)entering(table_cosine(i), alpha, ior, thickness, NULL);
    coat->inner = (float)returning_diffuse(alpha, ior, thickness);
    coat->scale = (float)(1 / (PI * ior * ior));
}

/* --- Over metal --------------------------------------------------------------------------- */

/* Of light going up at cosine mu inside, what gets out, without attenuation */
static double leaving(double mu, double alpha, double ior)
{
    double c_out;
    if (alpha < ALPHA_SMOOTH)
        return 1 - fresnel(mu, 1 / ior, &c_out);
    struct direction wo = { sqrt((1 - mu) * (1 + mu)), 0, mu };
    double sum = 0;
    for (int i = 0; i < NORMALS_IN; i++)
        for (int j = 0; j < NORMALS_IN; j++) {
            double t = grid(i, NORMALS_IN);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS_IN));
            double c = dot(wo, m);
            if (c <= 0)
                continue;
            double reflected = fresnel(c, 1 / ior, &c_out);
            double z = (c * ior - c_out) * m.z - wo.z * ior;
            if (reflected < 1 && z < 0)
                sum += 2 * t * (1 - reflected) * shadowing(wo.z, z, alpha);
        }
    return sum / (NORMALS_IN * NORMALS_IN);
}

/* Light that arrives at the metal at cosine mu: what goes up again, if it is white, by cosine */
static void reflecting(double mu, double alpha, double to[ANGLES])
{
    if (alpha < ALPHA_SMOOTH) {
        spread(to, mu, 1);
        return;
    }
    struct direction wo = { sqrt((1 - mu) * (1 + mu)), 0, mu };
    for (int i = 0; i < NORMALS_IN; i++)
        for (int j = 0; j < NORMALS_IN; j++) {
            double t = grid(i, NORMALS_IN);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS_IN));
            double z = 2 * dot(wo, m) * m.z - wo.z;
            if (z > 0)
                spread(to, z, 2 * t * shadowing(wo.z, z, alpha) / (NORMALS_IN * NORMALS_IN));
        }
}

static double weighted(const double weights[ANGLES], const double values[ANGLES])
{
    double sum = 0;
    for (int i = 0; i < ANGLES; i++)
        sum += weights[i] * values[i];
    return sum;
}

/* Of unit light that arrives at white metal at each cosine, what gets out after any number of
 * turns: the fixed point of one turn */
static void escaping(double alpha, double base_alpha, double ior, double thickness,
                     double escapes[ANGLES])
{
    double leaves[ANGLES], returns[ANGLES][ANGLES], reflects[ANGLES][ANGLES];
    memset(returns, 0, sizeof(returns));
    memset(reflects, 0, sizeof(reflects));
    for (int i = 0; i < ANGLES; i++) {
        double mu = grid(i, ANGLES), through = attenuation(mu, thickness);
        leaves[i] = through * leaving(mu, alpha, ior);
        returning(mu, alpha, ior, thickness, returns[i]);
        for (int k = 0; k < ANGLES; k++)
            returns[i][k] *= through;
        reflecting(mu, base_alpha, reflects[i]);
        escapes[i] = 0;
    }
    double change = 1;
    for (int turn = 0; turn < TURNS_MAX && change > 1e-7; turn++) {
        double up[ANGLES];
        change = 0;
        for (int i = 0; i < ANGLES; i++)
            up[i] = leaves[i] + weighted(returns[i], escapes);
        for (int i = 0; i < ANGLES; i++) {
            double more = weighted(reflects[i], up);
            change = fmax(change, more - escapes[i]);
            escapes[i] = more;
        }
    }
}

static double table_at(const float table[COAT_TABLE_LEN], double mu)
{
    double x = sqrt(mu) * (COAT_TABLE_LEN - 1);
    int i = x < COAT_TABLE_LEN - 2 ? (int)x : COAT_TABLE_LEN - 2;
    return (1 - (x - i)) * (double)table[i] + (x - i) * (double)table[i + 1];
}

/* The same energy in the lobe of the metal alone, per energy that arrives at it */
static double lobe_energy(const struct coat_metal *coat, double mu, double alpha, double ior)
{
    const float *enter = coat->rows[COAT_ENTER], *back = coat->rows[COAT_RETURN];
    double returned = table_at(back, mu);
    if (alpha < ALPHA_SMOOTH)
        return table_at(enter, mu) / fmax(1 - returned, COAT_LEAST);
    double sin2_in = (1 - mu) * (1 + mu) / (ior * ior);
    if (sin2_in >= 1)
        return 0;
    struct direction wo = { sqrt(sin2_in), 0, sqrt(1 - sin2_in) };
    double sum = 0;
    for (int i = 0; i < NORMALS; i++)
        for (int j = 0; j < NORMALS; j++) {
            double t = grid(i, NORMALS);
            struct direction m = visible_normal(wo, alpha, t, grid(j, NORMALS));
            double z = 2 * dot(wo, m) * m.z - wo.z;
            double sin2_out = (1 - z) * (1 + z) * ior * ior;
            if (z <= 0 || sin2_out >= 1)
                continue;
            double mu_out = sqrt(1 - sin2_out);
            double turns = 1 / fmax(1 - fmin(returned, table_at(back, mu_out)), COAT_LEAST);
            sum += 2 * t * shadowing(wo.z, z, alpha) * table_at(enter, mu_out) * turns;
        }
    return sum / (NORMALS * NORMALS);
}

void coat_metal_tabulate(double alpha, double base_alpha, double ior, double thickness,
                         struct coat_metal *coat)
{
    float *enter = coat->rows[COAT_ENTER], *spread_row = coat->rows[COAT_SPREAD];
    double escapes[ANGLES], total[COAT_TABLE_LEN], deflection = alpha * (ior - 1) / ior;
    double seen_alpha = sqrt(base_alpha * base_alpha + deflection * deflection / 2);
    bool mirror = alpha < ALPHA_SMOOTH && base_alpha < ALPHA_SMOOTH;
    escaping(alpha, base_alpha, ior, thickness, escapes);
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double mu = table_cosine(i), arrives[ANGLES] = { 0 };
        double sin2_in = (1 - mu) * (1 + mu) / (ior * ior), mu_in = sqrt(fmax(1 - sin2_in, 0));
        enter[i] = (float)entering(mu, alpha, ior, thickness, arrives);
        coat->rows[COAT_RETURN][i] = (float)(attenuation(mu_in, thickness) *
                                             returning(mu_in, alpha, ior, thickness, NULL));
        total[i] = weighted(arrives, escapes);
    }

    /* Where the lobe alone would return more than the walk does, less enters */
    float lower[COAT_TABLE_LEN];
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double lobe = (double)enter[i] * lobe_energy(coat, table_cosine(i), seen_alpha, ior);
        lower[i] = lobe > total[i] && !mirror ? (float)sqrt(total[i] / lobe) : 1;
    }
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        enter[i] *= lower[i];
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double lobe = (double)enter[i] * lobe_energy(coat, table_cosine(i), seen_alpha, ior);
        spread_row[i] = mirror || enter[i] < COAT_LEAST
                            ? 0
                            : (float)(fmax(total[i] - lobe, 0) / (double)enter[i]);
    }
    double sum = 0;
    for (int i = 0; i < DIRECTIONS_SMOOTH; i++) {
        double mu = sqrt(grid(i, DIRECTIONS_SMOOTH));
        sum += table_at(enter, mu) * table_at(spread_row, mu);
    }
    sum *= PI / DIRECTIONS_SMOOTH;
    coat->scale = sum > 1e-9 ? (float)(1 / sum) : 0;
    coat->inner = (float)returning_diffuse(alpha, ior, thickness);
}
