#include "master/albedo.h"

#include <math.h>

#define PI    3.14159265358979323846
#define STEPS 256 /* of the cosine */

/* --- Fresnel ------------------------------------------------------------------------------ */

static double dielectric(double mu, double ior)
{
    double sine2 = (1 - mu * mu) / (ior * ior);
    if (sine2 >= 1)
        return 1;
    double inside = sqrt(1 - sine2);
    double parallel = (ior * mu - inside) / (ior * mu + inside);
    double across = (mu - ior * inside) / (mu + ior * inside);
    return (parallel * parallel + across * across) / 2;
}

static double conductor(double mu, double eta, double k)
{
    double sine2 = 1 - mu * mu, cosine2 = mu * mu;
    double t0 = eta * eta - k * k - sine2;
    double a2b2 = sqrt(t0 * t0 + 4 * eta * eta * k * k);
    double a = sqrt(fmax(0, (a2b2 + t0) / 2));
    double t1 = a2b2 + cosine2, t2 = 2 * a * mu;
    double across = (t1 - t2) / (t1 + t2);
    double t3 = cosine2 * a2b2 + sine2 * sine2, t4 = t2 * sine2;
    return across * (1 + (t3 - t4) / (t3 + t4)) / 2;
}

/* Means over the hemisphere: 2 mu dmu */
static double mean_dielectric(double ior)
{
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        double mu = (i + 0.5) / STEPS;
        sum += 2 * mu * dielectric(mu, ior) / STEPS;
    }
    return sum;
}

static double mean_conductor(double eta, double k)
{
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        double mu = (i + 0.5) / STEPS;
        sum += 2 * mu * conductor(mu, eta, k) / STEPS;
    }
    return sum;
}

/* --- Coats -------------------------------------------------------------------------------- */

/* A row is linear in sqrt(mu) between entries at mu = (i / (COAT_TABLE_LEN - 1))^2 */
static double mean_row(const float *row)
{
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        double mu = (i + 0.5) / STEPS, at = sqrt(mu) * (COAT_TABLE_LEN - 1);
        int low = (int)at < COAT_TABLE_LEN - 2 ? (int)at : COAT_TABLE_LEN - 2;
        double t = at - low;
        sum += 2 * mu * ((1 - t) * (double)row[low] + t * (double)row[low + 1]) / STEPS;
    }
    return sum;
}

/* Coats come in COAT_ALPHAS widths where a texture makes the width: the middle one stands for all
 */
static const float *rows_of(const struct material *material, const float *tables, int rows)
{
    int width = material->flags & MATERIAL_COATS ? COAT_ALPHAS / 2 : 0;
    return tables + ((size_t)material->coat_table + (size_t)(width * rows)) * COAT_TABLE_LEN;
}

static void coat(const struct material *material, const float *tables, double rgb[3])
{
    double n = (double)material->ior, enters = mean_row(rows_of(material, tables, 1));
    double reflects = mean_dielectric(n), inner = fmin((double)material->coat_inner, 1);
    for (int c = 0; c < 3; c++) {
        double base = (double)material->reflectance[c];
        rgb[c] = reflects + enters * enters * base / (n * n * (1 - base * inner));
    }
}

/* What enters, is reflected by the metal and leaves, again and again */
static void coated_conductor(const struct material *material, const float *tables, double rgb[3])
{
    double n = (double)material->ior, reflects = mean_dielectric(n);
    double enters = mean_row(rows_of(material, tables, COAT_METAL_ROWS));
    for (int c = 0; c < 3; c++) {
        double metal = mean_conductor((double)material->eta[c] / n, (double)material->k[c] / n);
        double returns = fmin(
            mean_row(rows_of(material, tables, COAT_METAL_ROWS) + COAT_RETURN * COAT_TABLE_LEN),
            0.99);
        rgb[c] = reflects + enters * metal * (1 - returns) / (1 - metal * returns);
    }
}

void albedo_of(const struct material *material, const float *coat_tables, double rgb[3])
{
    double n = (double)material->ior, reflects;
    for (int c = 0; c < 3; c++)
        rgb[c] = (double)material->reflectance[c];
    switch (material->kind) {
    case MATERIAL_MIXTURE:
    case MATERIAL_DIFFUSE_TRANSMISSION:
        for (int c = 0; c < 3; c++)
            rgb[c] += (double)material->specular[c];
        break;
    case MATERIAL_CONDUCTOR:
        for (int c = 0; c < 3; c++)
            rgb[c] = mean_conductor((double)material->eta[c], (double)material->k[c]);
        break;
    case MATERIAL_DIELECTRIC:
        reflects = mean_dielectric(n);
        for (int c = 0; c < 3; c++)
            rgb[c] = reflects + (1 - reflects) / (n * n);
        break;
    case MATERIAL_THIN_DIELECTRIC:
        rgb[0] = rgb[1] = rgb[2] = 1;
        break;
    case MATERIAL_COAT:
        coat(material, coat_tables, rgb);
        break;
    case MATERIAL_COATED_CONDUCTOR:
        coated_conductor(material, coat_tables, rgb);
        break;
    default:
        break;
    }
    for (int c = 0; c < 3; c++)
        rgb[c] = fmin(fmax(rgb[c], 0), 1);
}
