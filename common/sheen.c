#include "common/sheen.h"

#include <math.h>

#define PI      3.14159265358979323846
#define COSINES 48    /* of wi, over which is integrated */
#define TURNS   2     /* of wi about the normal: times LANES, over half of the circle */
#define SPARE   0.995 /* see sheen.h */

/* Cosines of both directions, closer together towards the surface, where fibres are seen best */
static double cosine_at(double root)
{
    return fmax(root * root, (double)SHEEN_COSINE_LEAST);
}

/* The mean of D over all turns between two directions; `turns` are their cosines */
static double mean_density(const f8 turns[TURNS], double co, double ci, float alpha)
{
    const double so2 = (1 - co) * (1 + co), si2 = (1 - ci) * (1 + ci);
    const float up2 = (float)((co + ci) * (co + ci)), twice = (float)(2 * sqrt(so2 * si2));
    f8 sum = F8(0);
    for (int k = 0; k < TURNS; k++) {
        f8 across2 = (float)(so2 + si2) + twice * turns[k];
        sum = sum + sheen_density(across2 / (across2 + up2), F8(alpha));
    }
    double total = 0;
    for (int lane = 0; lane < LANES; lane++)
        total += (double)sum[lane];
    return total / (TURNS * LANES);
}

static double row_at(const float row[COAT_TABLE_LEN], double mu)
{
    double x = sqrt(mu) * (COAT_TABLE_LEN - 1);
    int i = x < COAT_TABLE_LEN - 2 ? (int)x : COAT_TABLE_LEN - 2;
    return (1 - (x - i)) * (double)row[i] + (x - i) * (double)row[i + 1];
}

static void tabulate(const f8 turns[TURNS], float alpha, float albedo[COAT_TABLE_LEN],
                     float bound[COAT_TABLE_LEN])
{
    /* f cos(wi) over the hemisphere, before the bound, by the cosines of wo and wi */
    double shares[COAT_TABLE_LEN][COSINES], ci[COSINES], lambda[COSINES];
    for (int k = 0; k < COSINES; k++) {
        ci[k] = cosine_at((k + 0.5) / COSINES);
        lambda[k] = (double)sheen_lambda(F8((float)ci[k]), F8(alpha))[0];
    }
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double co = cosine_at((double)i / (COAT_TABLE_LEN - 1)), sum = 0;
        double shadowed = 1 + (double)sheen_lambda(F8((float)co), F8(alpha))[0];
        for (int k = 0; k < COSINES; k++) {
            double area = 2 * PI * 2 * (k + 0.5) / (COSINES * COSINES);
            shares[i][k] = area * mean_density(turns, co, ci[k], alpha) /
                           (4 * co * (shadowed + lambda[k]));
            sum += shares[i][k];
        }
        bound[i] = sum > SPARE ? (float)(SPARE / sum) : 1;
    }
    for (int i = 0; i < COAT_TABLE_LEN; i++) {
        double sum = 0;
        for (int k = 0; k < COSINES; k++)
            sum += shares[i][k] * fmin((double)bound[i], row_at(bound, ci[k]));
        albedo[i] = (float)fmin(sum / SPARE, 1);
    }
}

void sheen_tabulate(float rows[SHEEN_ROWS][COAT_TABLE_LEN])
{
    f8 turns[TURNS], sine;
    for (int k = 0; k < TURNS; k++) {
        f8 turn = (f8_from_i8(i8_lanes() + k * LANES) + 0.5f) * (0.5f / (TURNS * LANES));
        f8_sincos_turns(turn, &sine, &turns[k]);
    }
    for (int j = 0; j < SHEEN_ALPHAS; j++) {
        float root = (float)(j + SHEEN_FIRST) / (SHEEN_FIRST + SHEEN_ALPHAS - 1);
        float width = root * root;
        tabulate(turns, width * width, rows[j], rows[SHEEN_ALPHAS + j]);
    }
}
