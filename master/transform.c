#include "master/transform.h"

#include "common/elem.h"

#include <math.h>
#include <string.h>

struct transform transform_identity(void)
{
    return transform_scale(1, 1, 1);
}

struct transform transform_translate(double x, double y, double z)
{
    return (struct transform){ { { 1, 0, 0, x }, { 0, 1, 0, y }, { 0, 0, 1, z }, { 0, 0, 0, 1 } } };
}

struct transform transform_scale(double x, double y, double z)
{
    return (struct transform){ { { x, 0, 0, 0 }, { 0, y, 0, 0 }, { 0, 0, z, 0 }, { 0, 0, 0, 1 } } };
}

struct transform transform_mul(const struct transform *a, const struct transform *b)
{
    struct transform product;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            product.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] +
                              a->m[i][2] * b->m[2][j] + a->m[i][3] * b->m[3][j];
    return product;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Scale to length 1, exactly enough for tiny and huge vectors; false for zero */
static bool unit(const double v[3], double out[3])
{
    double largest = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    if (!(largest > 0) || !isfinite(largest))
        return false;
    double x = v[0] / largest, y = v[1] / largest, z = v[2] / largest;
    double length = sqrt(x * x + y * y + z * z);
    out[0] = x / length;
    out[1] = y / length;
    out[2] = z / length;
    return true;
}

bool transform_rotate(double angle, const double axis[3], struct transform *out)
{
    double a[3];
    if (!unit(axis, a) || !(fabs(angle) < 1e6))
        return false;
    double s = elem_sin(angle), c = elem_cos(angle), t = 1 - c;
    *out = (struct transform){
        { { a[0] * a[0] * t + c, a[0] * a[1] * t - a[2] * s, a[0] * a[2] * t + a[1] * s, 0 },
          { a[0] * a[1] * t + a[2] * s, a[1] * a[1] * t + c, a[1] * a[2] * t - a[0] * s, 0 },
          { a[0] * a[2] * t - a[1] * s, a[1] * a[2] * t + a[0] * s, a[2] * a[2] * t + c, 0 },
          { 0, 0, 0, 1 } }
    };
    return true;
}

bool transform_look_at(const double eye[3], const double at[3], const double up[3],
                       struct transform *out)
{
    double forward[3], right[3], new_up[3];
    const double way[3] = { at[0] - eye[0], at[1] - eye[1], at[2] - eye[2] };
    if (!unit(way, forward) || !unit(up, new_up))
        return false;
    cross(new_up, forward, right);
    if (sqrt(right[0] * right[0] + right[1] * right[1] + right[2] * right[2]) < 1e-9 ||
        !unit(right, right))
        return false;
    cross(forward, right, new_up);
    struct transform world_from_camera = { { { right[0], new_up[0], forward[0], eye[0] },
                                             { right[1], new_up[1], forward[1], eye[1] },
                                             { right[2], new_up[2], forward[2], eye[2] },
                                             { 0, 0, 0, 1 } } };
    return transform_invert(&world_from_camera, out);
}

bool transform_invert(const struct transform *a, struct transform *out)
{
    /* Gauss-Jordan with the largest pivot of the column */
    double left[4][4],
        right[4][4] = { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 }, { 0, 0, 0, 1 } };
    memcpy(left, a->m, sizeof(left));
    for (int column = 0; column < 4; column++) {
        int pivot = column;
        for (int row = column + 1; row < 4; row++)
            if (fabs(left[row][column]) > fabs(left[pivot][column]))
                pivot = row;
        double value = left[pivot][column];
        if (value == 0 || !isfinite(value) || !isfinite(1 / value))
            return false;
        for (int j = 0; j < 4; j++) {
            double l = left[pivot][j], r = right[pivot][j];
            left[pivot][j] = left[column][j];
            right[pivot][j] = right[column][j];
            left[column][j] = l / value;
            right[column][j] = r / value;
        }
        for (int row = 0; row < 4; row++) {
            double factor = left[row][column];
            if (row == column || factor == 0)
                continue;
            for (int j = 0; j < 4; j++) {
                left[row][j] -= factor * left[column][j];
                right[row][j] -= factor * right[column][j];
            }
        }
    }
    for (int i = 0; i < 16; i++)
        if (!isfinite(right[i / 4][i % 4]))
            return false;
    memcpy(out->m, right, sizeof(right));
    return true;
}

bool transform_is_affine(const struct transform *a)
{
    return a->m[3][0] == 0 && a->m[3][1] == 0 && a->m[3][2] == 0 && a->m[3][3] == 1;
}

double transform_det3(const struct transform *a)
{
    double minor[3];
    cross(a->m[1], a->m[2], minor);
    return a->m[0][0] * minor[0] + a->m[0][1] * minor[1] + a->m[0][2] * minor[2];
}

double transform_similarity(const struct transform *a)
{
    double gram[3][3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            gram[i][j] = a->m[0][i] * a->m[0][j] + a->m[1][i] * a->m[1][j] +
                         a->m[2][i] * a->m[2][j];
    double mean = (gram[0][0] + gram[1][1] + gram[2][2]) / 3;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            if (!(fabs(gram[i][j] - (i == j ? mean : 0)) <= 1e-5 * mean))
                return 0;
    return sqrt(mean);
}
