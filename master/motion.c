#include "master/motion.h"

#include "common/elem.h"

#include <math.h>

struct parts {
    double rotation[4]; /* quaternion x, y, z, w */
    double stretch[9];
};

static struct transform linear_part(const struct transform *a)
{
    struct transform linear = *a;
    for (int i = 0; i < 3; i++)
        linear.m[i][3] = linear.m[3][i] = 0;
    return linear;
}

/* The rotation nearest to a matrix: its polar factor, by averaging with the inverse's transpose
 * (Higham 1986). A mirroring one is turned round: mirroring is the stretch's. */
static bool nearest_rotation(const struct transform *linear, struct transform *rotation)
{
    double det = transform_det3(linear), scale = elem_pow(fabs(det), -1.0 / 3);
    if (!(scale > 0) || !isfinite(scale))
        return false;
    struct transform r = *linear, inverse;
    for (int i = 0; i < 9; i++)
        r.m[i / 3][i % 3] *= det < 0 ? -scale : scale;
    double change = 1;
    for (int step = 0; step < 200 && change > 1e-14; step++) {
        if (!transform_invert(&r, &inverse))
            return false;
        change = 0;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                /* The inverse is of the step before: read it, not r, across the diagonal */
                double next = (r.m[i][j] + inverse.m[j][i]) / 2;
                change = fmax(change, fabs(next - r.m[i][j]));
                r.m[i][j] = next;
            }
    }
    *rotation = r;
    return true;
}

/* From the largest of the four squares, so that nothing small is divided by (Shepperd 1978) */
static void quaternion_of(const struct transform *rotation, double q[4])
{
    const double(*m)[4] = rotation->m;
    double trace = m[0][0] + m[1][1] + m[2][2];
    int i = m[1][1] > m[0][0] ? 1 : 0;
    i = m[2][2] > m[i][i] ? 2 : i;
    if (trace > m[i][i]) {
        q[3] = 1 + trace;
        for (int a = 0; a < 3; a++)
            q[a] = m[(a + 2) % 3][(a + 1) % 3] - m[(a + 1) % 3][(a + 2) % 3];
    } else {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        q[i] = 1 + m[i][i] - m[j][j] - m[k][k];
        q[j] = m[j][i] + m[i][j];
        q[k] = m[k][i] + m[i][k];
        q[3] = m[k][j] - m[j][k];
    }
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int a = 0; a < 4; a++)
        q[a] /= length;
}

static bool take_apart(const struct transform *a, struct parts *parts)
{
    struct transform linear = linear_part(a), rotation;
    if (!transform_is_affine(a) || !nearest_rotation(&linear, &rotation))
        return false;
    quaternion_of(&rotation, parts->rotation);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 3; k++)
                sum += rotation.m[k][i] * linear.m[k][j];
            parts->stretch[3 * i + j] = sum;
        }
    return true;
}

bool motion_decompose(const struct transform *start, const struct transform *end,
                      struct motion *out)
{
    struct parts parts[2];
    if ((transform_det3(start) < 0) != (transform_det3(end) < 0) || !take_apart(start, &parts[0]) ||
        !take_apart(end, &parts[1]))
        return false;
    /* Of the two ways round, the shorter */
    double cosine = 0, sine2 = 0;
    for (int i = 0; i < 4; i++)
        cosine += parts[0].rotation[i] * parts[1].rotation[i];
    if (cosine < 0)
        for (int i = 0; i < 4; i++)
            parts[1].rotation[i] = -parts[1].rotation[i];
    /* Half the angle from half the chord: right for the smallest angles too */
    for (int i = 0; i < 4; i++) {
        double gap = parts[1].rotation[i] - parts[0].rotation[i];
        sine2 += gap * gap / 4;
    }
    double sine = sqrt(fmin(sine2, 1));
    out->angle = (float)(2 * elem_atan2(sine, sqrt(1 - sine * sine)));
    for (int end_of = 0; end_of < 2; end_of++) {
        const struct transform *from = end_of == 0 ? start : end;
        for (int i = 0; i < 3; i++)
            out->translation[end_of][i] = (float)from->m[i][3];
        for (int i = 0; i < 4; i++)
            out->rotation[end_of][i] = (float)parts[end_of].rotation[i];
        for (int i = 0; i < 9; i++)
            out->stretch[end_of][i] = (float)parts[end_of].stretch[i];
    }
    return true;
}
