#include "master/transform.h"

#include "common/elem.h"
#include "master/vector.h"

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

bool transform_rotate(double angle, const double axis[3], struct transform *out)
{
    struct vec a;
    if (!vec_unit(vec_at(axis), &a) || !(fabs(angle) < 1e6))
        return false;
    double s = elem_sin(angle), c = elem_cos(angle), t = 1 - c;
    *out = (struct transform){
        { { a.x * a.x * t + c, a.x * a.y * t - a.z * s, a.x * a.z * t + a.y * s, 0 },
          { a.x * a.y * t + a.z * s, a.y * a.y * t + c, a.y * a.z * t - a.x * s, 0 },
          { a.x * a.z * t - a.y * s, a.y * a.z * t + a.x * s, a.z * a.z * t + c, 0 },
          { 0, 0, 0, 1 } }
    };
    return true;
}

bool transform_look_at(const double eye[3], const double at[3], const double up[3],
                       struct transform *out)
{
    struct vec forward, right, new_up;
    if (!vec_unit(vec_sub(vec_at(at), vec_at(eye)), &forward) || !vec_unit(vec_at(up), &new_up))
        return false;
    right = vec_cross(new_up, forward);
    if (vec_length(right) < 1e-9 || !vec_unit(right, &right))
        return false;
    new_up = vec_cross(forward, right);
    struct transform world_from_camera = { { { right.x, new_up.x, forward.x, eye[0] },
                                             { right.y, new_up.y, forward.y, eye[1] },
                                             { right.z, new_up.z, forward.z, eye[2] },
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
    return vec_dot(vec_at(a->m[0]), vec_cross(vec_at(a->m[1]), vec_at(a->m[2])));
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
