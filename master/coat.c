#include "master/coat.h"

#include "common/elem.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define PI                3.14159265358979323846
#define NORMALS           32  /* microfacet normals per axis of the unit square, at one direction */
#define NORMALS_IN        24  /* the same while integrating over directions too */
#define DIRECTIONS        256 /* of the diffuse flux inside */
#define DIRECTIONS_SMOOTH 8192 /* the same, where total reflection begins with a kink */
#define ANGLES            64   /* cosines inside, at which the energy of a walk is kept */
#define TURNS_MAX         2000
#define COAT_LEAST        1e-6 /* what a division by nothing is kept at */

/* Midpoints of [0, 1] */
static double grid(int i, int count)
{
    return (i + 0.5) / count;
}

/* --- Microfacets, eight at a time --------------------------------------------------------- */

/*
 * Points of the disk that visible normals are made from: an even grid of turns, and of heights t
 * of the hemisphere above them, whose density is 2 t. Half of the turns are enough: light comes
 * in the plane x z, and the other half are mirror images across it. The weights add up to one.
 */
struct facets {
    int count; /* of eights */
    struct {
        f8 x, y, rim, weight;
    } at[NORMALS * NORMALS / 2 / LANES];
};

static struct facets facets_of(int normals)
{
    struct facets facets = { .count = normals * normals / 2 / LANES };
    for (int i = 0; i < facets.count; i++) {
        f8 t, turn, sine, cosine;
        for (int lane = 0; lane < LANES; lane++) {
            int point = i * LANES + lane;
            t[lane] = (float)grid(point / (normals / 2), normals);
            turn[lane] = (float)(grid(point % (normals / 2), normals) - 0.25);
        }
        f8_sincos_turns(turn, &sine, &cosine);
        f8 r = f8_sqrt((1 - t) * (1 + t));
        facets.at[i].x = r * cosine;
        facets.at[i].y = r * sine;
        facets.at[i].rim = f8_sqrt(f8_max(F8(0), 1 - facets.at[i].x * facets.at[i].x));
        facets.at[i].weight = 4 * t / (float)(normals * normals);
    }
    return facets;
}

/* A direction in the plane of x and z, by its cosine */
struct view {
    struct vec3x8 wo;
    f8 x, z; /* the same stretched by alpha, unit */
    float alpha;
};

static struct view view_at(double mu, double alpha)
{
    double sine = sqrt((1 - mu) * (1 + mu)), x = alpha * sine, length = sqrt(x * x + mu * mu);
    return (struct view){ vec3x8_all((float)sine, 0, (float)mu), F8((float)(x / length)),
                          F8((float)(mu / length)), (float)alpha };
}

/* Eight of the normals that are visible from there: the hemisphere of the stretched view,
 * projected to the disk, whose lower half is squeezed */
LANE_FN struct vec3x8 visible_normals(const struct facets *facets, int i, const struct view *view)
{
    f8 px = facets->at[i].x, half = (1 + view->z) * 0.5f;
    f8 py = (1 - half) * facets->at[i].rim + half * facets->at[i].y;
    f8 pz = f8_sqrt(f8_max(F8(0), 1 - px * px - py * py));
    struct vec3x8 m = { view->alpha * (pz * view->x - py * view->z), view->alpha * px,
                        f8_max(F8(1e-9f), py * view->x + pz * view->z) };
    return vec3x8_unit(m);
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

LANE_FN f8 fresnel8(f8 c, float n, f8 *c_in)
{
    *c_in = c;
    if (n == 1)
        return F8(0);
    f8 sin2_in = (1 - c) * (1 + c) / (n * n);
    f8 inside = f8_sqrt(f8_max(F8(0), 1 - sin2_in));
    f8 parallel = (n * c - inside) / (n * c + inside);
    f8 across = (c - n * inside) / (c + n * inside);
    i8 total = sin2_in >= 1;
    *c_in = f8_select(total, c, inside);
    return f8_select(total, F8(1), (parallel * parallel + across * across) * 0.5f);
}

/* Smith's Lambda for GGX, of directions at cosine z */
LANE_FN f8 lambda(f8 z, float alpha)
{
    f8 cos2 = z * z;
    return (f8_sqrt(1 + alpha * alpha * (1 - cos2) / cos2) - 1) * 0.5f;
}

/* G2(wo, wi) / G1(wo) with height-correlated G2, for a wi at cosine z */
LANE_FN f8 shadowing(const struct view *view, f8 z)
{
    f8 out = lambda(view->wo.z, view->alpha), in = lambda(z, view->alpha);
    return (1 + out) / (1 + out + in);
}

static double attenuation(double z, double thickness)
{
    return z != 0 ? elem_exp(-thickness / fabs(z)) : 0;
}

static double lanes_sum(f8 a)
{
    double sum = 0;
    for (int lane = 0; lane < LANES; lane++)
        sum += (double)a[lane];
    return sum;
}

/* --- One crossing ------------------------------------------------------------------------- */

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

#define MIRROR 0 /* in place of an index: reflects everything */

struct interface {
    double alpha, n;  /* index behind over index before it, as light comes */
    double thickness; /* of the layer that is crossed afterwards */
};

/*
 * Of light that comes to an interface at cosine mu, what goes `through` it, or back, and leaves the
 * layer after it; added to `to` by its cosine there.
 */
static double crossing_smooth(const struct interface *at, bool through, double mu, double *to)
{
    double z = mu, share = 1, c_in;
    if (at->n != MIRROR) {
        share = fresnel(mu, at->n, &c_in);
        z = through ? c_in : mu;
        share = through ? 1 - share : share;
    }
    double energy = share * attenuation(z, at->thickness);
    spread(to, z, energy);
    return energy;
}

static double crossing(const struct facets *facets, const struct interface *at, bool through,
                       double mu, double *to)
{
    if (at->alpha < ALPHA_SMOOTH)
        return crossing_smooth(at, through, mu, to);
    const struct view view = view_at(mu, at->alpha);
    const float n = (float)at->n, thickness = (float)at->thickness;
    f8 sum = F8(0);
    for (int i = 0; i < facets->count; i++) {
        struct vec3x8 m = visible_normals(facets, i, &view);
        f8 c = vec3x8_dot(view.wo, m), c_in = c, share = F8(1), z = 2 * c * m.z - view.wo.z;
        if (n != MIRROR) {
            share = fresnel8(c, n, &c_in);
            if (through) {
                share = 1 - share;
                z = view.wo.z / n - (c / n - c_in) * m.z;
            }
        }
        i8 goes = (c > 0) & (z > 0) & (share > 0);
        f8 energy = facets->at[i].weight * share * shadowing(&view, z);
        if (thickness > 0)
            energy = energy * f8_exp(-thickness / z);
        energy = f8_select(goes, energy, F8(0));
        sum = sum + energy;
        for (int lane = 0; to != NULL && lane < LANES; lane++)
            if (goes[lane])
                spread(to, (double)z[lane], (double)energy[lane]);
    }
    return lanes_sum(sum);
}

/* The cosine outside of entry i of a table */
static double table_cosine(int i)
{
    double root = (double)i / (COAT_TABLE_LEN - 1);
    return fmax(root * root, 1e-6);
}

/* R_in, of a diffuse flux: uniform in mu^2 */
static double returning_diffuse(const struct facets *facets, const struct interface *out)
{
    int directions = out->alpha < ALPHA_SMOOTH ? DIRECTIONS_SMOOTH : DIRECTIONS;
    double sum = 0;
    for (int i = 0; i < directions; i++) {
        double mu = sqrt(grid(i, directions));
        sum += attenuation(mu, out->thickness) * crossing(facets, out, false, mu, NULL);
    }
    return sum / directions;
}

void coat_tabulate(double alpha, double ior, double thickness, struct coat *coat)
{
    const struct facets fine = facets_of(NORMALS), coarse = facets_of(NORMALS_IN);
    const struct interface in = { alpha, ior, thickness }, out = { alpha, 1 / ior, thickness };
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        coat->table[i] = (float)crossing(&fine, &in, true, table_cosine(i), NULL);
    coat->inner = (float)returning_diffuse(&coarse, &out);
    coat->scale = (float)(1 / (PI * ior * ior));
}

/* --- Over metal --------------------------------------------------------------------------- */

static double weighted(const double weights[ANGLES], const double values[ANGLES])
{
    double sum = 0;
    for (int i = 0; i < ANGLES; i++)
        sum += weights[i] * values[i];
    return sum;
}

/* Of unit light that arrives at white metal at each cosine, what gets out after any number of
 * turns: the fixed point of one turn */
static void escaping(const struct facets *facets, const struct interface *out, double base_alpha,
                     double escapes[ANGLES])
{
    const struct interface bare = { out->alpha, out->n, 0 }, metal = { base_alpha, MIRROR, 0 };
    double leaves[ANGLES], returns[ANGLES][ANGLES], reflects[ANGLES][ANGLES];
    memset(returns, 0, sizeof(returns));
    memset(reflects, 0, sizeof(reflects));
    for (int i = 0; i < ANGLES; i++) {
        double mu = grid(i, ANGLES), before = attenuation(mu, out->thickness);
        leaves[i] = before * crossing(facets, &bare, true, mu, NULL);
        crossing(facets, out, false, mu, returns[i]);
        for (int k = 0; k < ANGLES; k++)
            returns[i][k] *= before;
        crossing(facets, &metal, false, mu, reflects[i]);
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

LANE_FN f8 table_at8(const float table[COAT_TABLE_LEN], f8 mu)
{
    f8 x = f8_sqrt(mu) * (float)(COAT_TABLE_LEN - 1);
    i8 i = i8_from_f8(f8_min(x, F8(COAT_TABLE_LEN - 2)));
    f8 t = x - f8_from_i8(i);
    return (1 - t) * f8_gather(table, i) + t * f8_gather(table, i + 1);
}

/* The same energy in the lobe of the metal alone, per energy that arrives at it */
static double lobe_energy(const struct facets *facets, const struct coat_metal *coat, double mu,
                          double alpha, double ior)
{
    const float *enter = coat->rows[COAT_ENTER], *back = coat->rows[COAT_RETURN];
    double returned = table_at(back, mu);
    if (alpha < ALPHA_SMOOTH)
        return table_at(enter, mu) / fmax(1 - returned, COAT_LEAST);
    double sin2_in = (1 - mu) * (1 + mu) / (ior * ior);
    if (sin2_in >= 1)
        return 0;
    const struct view view = view_at(sqrt(1 - sin2_in), alpha);
    const float n = (float)ior;
    f8 sum = F8(0);
    for (int i = 0; i < facets->count; i++) {
        struct vec3x8 m = visible_normals(facets, i, &view);
        f8 z = 2 * vec3x8_dot(view.wo, m) * m.z - view.wo.z;
        f8 sin2_out = (1 - z) * (1 + z) * (n * n);
        i8 leaves = (z > 0) & (sin2_out < 1);
        f8 mu_out = f8_sqrt(f8_select(leaves, 1 - sin2_out, F8(0)));
        f8 turned = f8_min(F8((float)returned), table_at8(back, mu_out));
        f8 energy = facets->at[i].weight * shadowing(&view, z) * table_at8(enter, mu_out) /
                    f8_max(1 - turned, F8((float)COAT_LEAST));
        sum = sum + f8_select(leaves, energy, F8(0));
    }
    return lanes_sum(sum);
}

void coat_metal_tabulate(double alpha, double base_alpha, double ior, double thickness,
                         struct coat_metal *coat)
{
    const struct facets fine = facets_of(NORMALS), coarse = facets_of(NORMALS_IN);
    const struct interface in = { alpha, ior, thickness }, out = { alpha, 1 / ior, thickness };
    float *enter = coat->rows[COAT_ENTER], *spread_row = coat->rows[COAT_SPREAD];
    double escapes[ANGLES], total[COAT_TABLE_LEN], deflection = alpha * (ior - 1) / ior;
    double seen_alpha = sqrt(base_alpha * base_alpha + deflection * deflection / 2);
    bool mirror = alpha < ALPHA_SMOOTH && base_alpha < ALPHA_SMOOTH;
    escaping(&coarse, &out, base_alpha, escapes);
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double mu = table_cosine(i), arrives[ANGLES] = { 0 };
        double sin2_in = (1 - mu) * (1 + mu) / (ior * ior), mu_in = sqrt(fmax(1 - sin2_in, 0));
        enter[i] = (float)crossing(&fine, &in, true, mu, arrives);
        coat->rows[COAT_RETURN][i] = (float)(attenuation(mu_in, thickness) *
                                             crossing(&coarse, &out, false, mu_in, NULL));
        total[i] = weighted(arrives, escapes);
    }

    /* Where the lobe alone would return more than the walk does, less enters */
    float lower[COAT_TABLE_LEN];
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double lobe = (double)enter[i] * lobe_energy(&fine, coat, table_cosine(i), seen_alpha, ior);
        lower[i] = lobe > total[i] && !mirror ? (float)sqrt(total[i] / lobe) : 1;
    }
    for (int i = 0; i < COAT_TABLE_LEN; i++)
        enter[i] *= lower[i];
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double lobe = (double)enter[i] * lobe_energy(&fine, coat, table_cosine(i), seen_alpha, ior);
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
    coat->inner = (float)returning_diffuse(&coarse, &out);
}
