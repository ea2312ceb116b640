/* Goal: what is made of triangles at load lies on the shape it stands for, has its area, normals
 * and (u, v), and leaves no gaps. */
#include "common/elem.h"
#include "common/err.h"
#include "master/curve_mesh.h"
#include "master/tessellate.h"
#include "tests/expect.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static struct tessellation start(void)
{
    return (struct tessellation){ .most = 100000 };
}

static const double *position(const struct tessellation *shape, size_t vertex)
{
    return (const double *)shape->positions.data + 3 * vertex;
}

static const double *normal(const struct tessellation *shape, size_t vertex)
{
    return (const double *)shape->normals.data + 3 * vertex;
}

static const double *uv(const struct tessellation *shape, size_t vertex)
{
    return (const double *)shape->uvs.data + 2 * vertex;
}

static const uint32_t *triangle(const struct tessellation *shape, size_t index)
{
    return (const uint32_t *)shape->triangles.data + 3 * index;
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Twice the area times the normal */
static void face_normal(const struct tessellation *shape, size_t index, double n[3])
{
    const uint32_t *t = triangle(shape, index);
    const double *a = position(shape, t[0]), *b = position(shape, t[1]), *c = position(shape, t[2]);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        n[i] = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j]);
    }
}

static double area_of(const struct tessellation *shape)
{
    double sum = 0, n[3];
    for (size_t i = 0; i < shape->triangles.count; i++) {
        face_normal(shape, i, n);
        sum += sqrt(dot(n, n)) / 2;
    }
    return sum;
}

/* Every triangle has area, and its corners' normals are unit and on its front side */
static void expect_front_sides(const struct tessellation *shape)
{
    for (size_t i = 0; i < shape->triangles.count; i++) {
        double n[3];
        face_normal(shape, i, n);
        assert_true(dot(n, n) > 0);
        for (int corner = 0; corner < 3 && shape->normals.count > 0; corner++) {
            const double *m = normal(shape, triangle(shape, i)[corner]);
            EXPECT_NEAR(dot(m, m), 1, 1e-12);
            assert_true(dot(n, m) > 0);
        }
    }
}

static void cylinders_have_their_area_and_stay_within_the_tolerance(void **state)
{
    (void)state;
    static const struct tessellate_round rows[] = {
        { .radius = 1, .phi_max = 2 * PI, .z_min = -1, .z_max = 1 },
        { .radius = .01, .phi_max = 1, .z_min = 5, .z_max = 9 },
        { .radius = 300, .phi_max = 4, .z_min = 0, .z_max = .5 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct tessellation shape = start();
        assert_true(tessellate_cylinder(&shape, &rows[i], NULL));
        double want = rows[i].radius * rows[i].phi_max * (rows[i].z_max - rows[i].z_min);
        EXPECT_NEAR(area_of(&shape) / want, 1, 1.1e-4);
        expect_front_sides(&shape);
        for (size_t v = 0; v < shape.positions.count; v++) {
            const double *p = position(&shape, v), *n = normal(&shape, v), *st = uv(&shape, v);
            EXPECT_NEAR(sqrt(p[0] * p[0] + p[1] * p[1]), rows[i].radius, 1e-12 * rows[i].radius);
            EXPECT_NEAR(n[0] * rows[i].radius, p[0], 1e-9);
            EXPECT_NEAR(p[0], rows[i].radius * elem_cos(st[0] * rows[i].phi_max), 1e-9);
            EXPECT_NEAR(p[1], rows[i].radius * elem_sin(st[0] * rows[i].phi_max), 1e-9);
            EXPECT_NEAR(p[2], rows[i].z_min + st[1] * (rows[i].z_max - rows[i].z_min), 1e-12);
        }
        /* The middle of a chord is what is farthest away */
        const double *a = position(&shape, 0), *b = position(&shape, 1);
        double middle = sqrt((a[0] + b[0]) * (a[0] + b[0]) + (a[1] + b[1]) * (a[1] + b[1])) / 2;
        assert_true(middle > (1 - 3.1e-4) * rows[i].radius);
        tessellate_free(&shape);
    }
}

static void a_full_turn_closes_bit_by_bit(void **state)
{
    (void)state;
    struct tessellation shape = start();
    const struct tessellate_round round = {
        .radius = 3, .phi_max = 2 * PI, .z_min = 0, .z_max = 1
    };
    assert_true(tessellate_cylinder(&shape, &round, NULL));
    assert_int_equal(shape.positions.count, 2 * (TESSELLATE_TURN + 1));
    for (size_t row = 0; row < 2; row++) {
        size_t first = row * (TESSELLATE_TURN + 1);
        assert_memory_equal(position(&shape, first), position(&shape, first + TESSELLATE_TURN),
                            3 * sizeof(double));
        EXPECT_NEAR(uv(&shape, first)[0], 0, 0);
        EXPECT_NEAR(uv(&shape, first + TESSELLATE_TURN)[0], 1, 0);
    }
    tessellate_free(&shape);
}

/* 2 pi r times the height between the cuts, whatever they are; the volume of a whole one */
static void spheres_have_their_area_and_pbrts_parameters(void **state)
{
    (void)state;
    static const struct tessellate_round rows[] = {
        { .radius = 1, .phi_max = 2 * PI, .z_min = -1, .z_max = 1 },
        { .radius = 2, .phi_max = 2 * PI, .z_min = -.5, .z_max = 2 },
        { .radius = 5, .phi_max = 1.5, .z_min = -4, .z_max = 3 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct tessellation shape = start();
        double r = rows[i].radius, low = elem_acos(rows[i].z_min / r);
        double high = elem_acos(rows[i].z_max / r);
        assert_true(tessellate_sphere(&shape, &rows[i], NULL));
        EXPECT_NEAR(area_of(&shape) / (rows[i].phi_max * r * (rows[i].z_max - rows[i].z_min)), 1,
                    2.5e-3);
        expect_front_sides(&shape);
        for (size_t v = 0; v < shape.positions.count; v++) {
            const double *p = position(&shape, v), *st = uv(&shape, v);
            EXPECT_NEAR(sqrt(dot(p, p)), r, 1e-12 * r);
            EXPECT_NEAR(p[2], r * elem_cos(low + st[1] * (high - low)), 1e-9);
            if (fabs(p[2]) < .999 * r)
                EXPECT_NEAR(elem_atan2(p[1], p[0]) - rows[i].phi_max * st[0],
                            rows[i].phi_max * st[0] > PI + 1e-6 ? -2 * PI : 0,
                            p[1] == 0 ? 7 : 1e-9); /* the seam is either */
        }
        tessellate_free(&shape);
    }
    struct tessellation ball = start();
    double volume = 0;
    assert_true(tessellate_sphere(&ball, &rows[0], NULL));
    for (size_t i = 0; i < ball.triangles.count; i++) {
        double n[3];
        face_normal(&ball, i, n);
        volume += dot(n, position(&ball, triangle(&ball, i)[0])) / 6;
    }
    EXPECT_NEAR(volume, 4 * PI / 3, 2e-2);
    tessellate_free(&ball);
}

static void disks_have_their_area_and_face_up(void **state)
{
    (void)state;
    static const struct tessellate_round rows[] = {
        { .radius = 1, .phi_max = 2 * PI, .height = 2 },
        { .radius = 3, .phi_max = 2 * PI, .inner_radius = 1 },
        { .radius = 3, .phi_max = .7, .inner_radius = 2.5, .height = -1 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct tessellation shape = start();
        double r = rows[i].radius, inner = rows[i].inner_radius;
        assert_true(tessellate_disk(&shape, &rows[i], NULL));
        EXPECT_NEAR(area_of(&shape) / (rows[i].phi_max / 2 * (r * r - inner * inner)), 1, 5e-4);
        assert_int_equal(shape.normals.count, 0);
        for (size_t t = 0; t < shape.triangles.count; t++) {
            double n[3];
            face_normal(&shape, t, n);
            assert_true(n[2] > 0);
        }
        for (size_t v = 0; v < shape.positions.count; v++) {
            const double *p = position(&shape, v);
            EXPECT_NEAR(p[2], rows[i].height, 0);
            EXPECT_NEAR(r - uv(&shape, v)[1] * (r - inner), sqrt(p[0] * p[0] + p[1] * p[1]), 1e-9);
        }
        tessellate_free(&shape);
    }
}

static void a_flat_patch_is_two_triangles_and_a_skew_one_keeps_the_tolerance(void **state)
{
    (void)state;
    struct tessellate_patch square = { .p = {
                                           { 0, 0, 0 }, { 2, 0, 0 }, { 0, 3, 0 }, { 2, 3, 0 } } };
    struct tessellation shape = start();
    assert_true(tessellate_patch_is_flat(&square));
    assert_true(tessellate_patch(&shape, &square, 1e-3, true, NULL));
    assert_int_equal(shape.triangles.count, 2);
    assert_int_equal(shape.normals.count, 0);
    EXPECT_NEAR(area_of(&shape), 6, 1e-12);
    EXPECT_NEAR(uv(&shape, 1)[0], 1, 0);
    EXPECT_NEAR(uv(&shape, 2)[1], 1, 0);
    tessellate_free(&shape);

    /* z = x y: the normal at (x, y) is (-y, -x, 1) */
    struct tessellate_patch skew = { .p = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 1, 1, 1 } } };
    const double tolerance = 1e-3;
    shape = start();
    assert_false(tessellate_patch_is_flat(&skew));
    assert_true(tessellate_patch(&shape, &skew, tolerance, false, NULL));
    expect_front_sides(&shape);
    EXPECT_NEAR(area_of(&shape), 1.280789, 2e-3);
    for (size_t v = 0; v < shape.positions.count; v++) {
        const double *p = position(&shape, v), *n = normal(&shape, v), *st = uv(&shape, v);
        EXPECT_NEAR(p[2], p[0] * p[1], 1e-12);
        EXPECT_NEAR(p[0], st[0], 1e-12);
        EXPECT_NEAR(n[0] / n[2], -p[1], 1e-9);
        EXPECT_NEAR(n[1] / n[2], -p[0], 1e-9);
    }
    for (size_t t = 0; t < shape.triangles.count; t++) { /* worst in the middle of the diagonal */
        const double *a = position(&shape, triangle(&shape, t)[0]);
        const double *b = position(&shape, triangle(&shape, t)[1]);
        const double *c = position(&shape, triangle(&shape, t)[2]);
        for (int side = 0; side < 3; side++) {
            const double *p = side == 0 ? a : side == 1 ? b : c;
            const double *q = side == 0 ? b : side == 1 ? c : a;
            double x = (p[0] + q[0]) / 2, y = (p[1] + q[1]) / 2;
            EXPECT_NEAR((p[2] + q[2]) / 2, x * y, tolerance);
        }
    }
    tessellate_free(&shape);
}

static void a_patch_with_normals_and_uvs_interpolates_them(void **state)
{
    (void)state;
    struct tessellate_patch patch = { .p = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 2, 2, 0 } },
                                      .has_normals = true,
                                      .has_uvs = true,
                                      .n = { { 0, 0, 2 }, { 1, 0, 1 }, { 0, 1, 1 }, { 0, 0, 1 } },
                                      .uv = { { 3, 3 }, { 4, 3 }, { 3, 5 }, { 4, 5 } } };
    struct tessellation shape = start();
    assert_true(tessellate_patch(&shape, &patch, 1e-2, true, NULL));
    assert_true(shape.triangles.count > 2);
    assert_int_equal(shape.normals.count, shape.positions.count);
    EXPECT_NEAR(uv(&shape, 0)[0], 3, 0);
    size_t last = shape.positions.count - 1;
    EXPECT_NEAR(uv(&shape, last)[1], 5, 1e-12);
    EXPECT_NEAR(position(&shape, last)[0], 2, 1e-12);
    EXPECT_NEAR(normal(&shape, 0)[2], 1, 1e-12);
    tessellate_free(&shape);

    /* A triangle: one edge has no length, and neither its normals nor its triangles are missing */
    struct tessellate_patch triangle = { .p = {
                                             { 0, 0, 0 }, { 0, 0, 0 }, { 0, 1, 0 }, { 1, 0, 0 } } };
    shape = start();
    assert_true(tessellate_patch(&shape, &triangle, 1e-2, false, NULL));
    EXPECT_NEAR(area_of(&shape), .5, 1e-9);
    EXPECT_NEAR(fabs(normal(&shape, 0)[2]), 1, 1e-9);
    tessellate_free(&shape);
}

static void what_has_no_area_gives_nothing_and_too_much_is_refused(void **state)
{
    (void)state;
    struct err err = { .text = "" };
    struct tessellation shape = start();
    struct tessellate_patch point = { .has_normals = false };
    assert_true(tessellate_patch(&shape, &point, 0, false, NULL));
    assert_int_equal(shape.triangles.count, 0);
    shape.most = 100;
    const struct tessellate_round round = { .radius = 1, .phi_max = 2 * PI, .z_max = 1 };
    assert_false(tessellate_cylinder(&shape, &round, &err));
    assert_int_equal(err.code, ERR_SCENE);
    assert_non_null(strstr(err.text, "256 triangles: 100 are possible"));
    tessellate_free(&shape);
}

/* --- Curves ------------------------------------------------------------------------------- */

static const double straight[] = { 0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0 };

static void a_straight_tube_has_a_cylinders_area_and_width(void **state)
{
    (void)state;
    struct curve curve = { .points = straight, .point_count = 4, .degree = 3, .width = { .5, .5 } };
    struct tessellation shape = start();
    assert_int_equal(curve_mesh_segments(&curve, NULL), 1);
    assert_true(curve_mesh_add(&shape, &curve, NULL));
    expect_front_sides(&shape);
    EXPECT_NEAR(area_of(&shape), PI * .5 * 3, 1e-9); /* by construction: as long around */
    double low = 9, high = -9;
    for (size_t v = 0; v < shape.positions.count; v++) {
        const double *p = position(&shape, v), *n = normal(&shape, v);
        low = fmin(low, p[0]);
        high = fmax(high, p[0]);
        EXPECT_NEAR(sqrt(p[1] * p[1] + p[2] * p[2]), .25, 1e-3 * 3.5);
        EXPECT_NEAR(n[0], 0, 1e-12);
        EXPECT_NEAR(p[0], 3 * uv(&shape, v)[0], 1e-12);
    }
    EXPECT_NEAR(low, 0, 0);
    EXPECT_NEAR(high, 3, 1e-12);
    tessellate_free(&shape);

    /* A cone: pi r times the slanted side; its normals lean forward */
    curve.width[1] = 0;
    shape = start();
    assert_true(curve_mesh_add(&shape, &curve, NULL));
    expect_front_sides(&shape);
    EXPECT_NEAR(area_of(&shape) / (PI * .25 * sqrt(9 + .0625)), 1, 1e-3);
    EXPECT_NEAR(normal(&shape, 0)[0], .25 / sqrt(9 + .0625), 1e-9);
    tessellate_free(&shape);
}

static void bent_curves_follow_their_middle_line(void **state)
{
    (void)state;
    /* A quarter of a circle, as cubics come: within 3e-4 of it */
    const double k = .5522847498;
    const double quarter[] = { 1, 0, 0, 1, k, 0, k, 1, 0, 0, 1, 0 };
    struct curve curve = { .points = quarter, .point_count = 4, .degree = 3, .width = { .1, .1 } };
    struct tessellation shape = start();
    assert_true(curve_mesh_add(&shape, &curve, NULL));
    expect_front_sides(&shape);
    EXPECT_NEAR(area_of(&shape) / (PI * .1 * PI / 2), 1, 5e-3);
    for (size_t v = 0; v < shape.positions.count; v++) {
        const double *p = position(&shape, v);
        double ring = sqrt(p[0] * p[0] + p[1] * p[1]) - 1;
        EXPECT_NEAR(sqrt(ring * ring + p[2] * p[2]), .05, 2e-3);
    }
    tessellate_free(&shape);
}

/* The same parabola written in all four ways is the same triangles; several segments join */
static void all_bases_and_degrees_say_the_same_curve(void **state)
{
    (void)state;
    static const double ways[4][12] = {
        { 0, 0, 0, 1, 2, 0, 2, 0, 0 },                              /* Bezier, degree 2 */
        { 0, 0, 0, 2. / 3, 4. / 3, 0, 4. / 3, 4. / 3, 0, 2, 0, 0 }, /* degree 3 */
        { -1, -2, 0, 1, 2, 0, 3, -2, 0 },                           /* B-spline, degree 2 */
        { 0 },
    };
    static const struct {
        size_t points;
        int degree;
        bool bspline;
    } kinds[] = { { 3, 2, false }, { 4, 3, false }, { 3, 2, true } };
    struct tessellation first = start();
    for (size_t i = 0; i < 3; i++) {
        struct tessellation shape = start();
        struct curve curve = { .points = ways[i],
                               .point_count = kinds[i].points,
                               .degree = kinds[i].degree,
                               .bspline = kinds[i].bspline,
                               .width = { .01, .01 } };
        assert_true(curve_mesh_add(i == 0 ? &first : &shape, &curve, NULL));
        const struct tessellation *made = i == 0 ? &first : &shape;
        size_t last = made->positions.count - 1;
        EXPECT_NEAR(position(made, 0)[0], 0, .01);
        EXPECT_NEAR(position(made, last)[0], 2, .01);
        for (size_t v = 0; v < made->positions.count; v++) { /* y = x (2 - x) */
            const double *p = position(made, v);
            EXPECT_NEAR(p[1], p[0] * (2 - p[0]), .02);
        }
        tessellate_free(&shape);
    }
    tessellate_free(&first);

    /* A cubic B-spline of points in a row is the line between the second and the last but one */
    const double row[] = { 0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0, 4, 0, 0, 5, 0, 0 };
    struct curve spline = {
        .points = row, .point_count = 6, .degree = 3, .bspline = true, .width = { .2, .4 }
    };
    struct tessellation shape = start();
    assert_int_equal(curve_mesh_segments(&spline, NULL), 3);
    assert_true(curve_mesh_add(&shape, &spline, NULL));
    double low = 9, high = -9;
    for (size_t v = 0; v < shape.positions.count; v++) {
        const double *p = position(&shape, v);
        low = fmin(low, p[0]);
        high = fmax(high, p[0]);
        EXPECT_NEAR(sqrt(p[1] * p[1] + p[2] * p[2]), .1 + .1 * (p[0] - 1) / 3, .01);
    }
    EXPECT_NEAR(low, 1, 1e-12);
    EXPECT_NEAR(high, 4, 1e-12);
    tessellate_free(&shape);
}

/* Tubes do not twist on their way, and corners leave no gap */
static void frames_turn_no_more_than_the_curve(void **state)
{
    (void)state;
    const double corner[] = { 0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0, 3, 1, 0, 3, 2, 0, 3, 3, 0 };
    struct curve curve = { .points = corner, .point_count = 7, .degree = 3, .width = { .1, .1 } };
    struct tessellation shape = start();
    assert_int_equal(curve_mesh_segments(&curve, NULL), 2);
    assert_true(curve_mesh_add(&shape, &curve, NULL));
    expect_front_sides(&shape);
    /* The end of the first segment and the start of the second are one ring */
    size_t ring = 0;
    while (uv(&shape, ring)[1] < 1)
        ring++;
    ring++;
    size_t rings = shape.positions.count / ring;
    bool joined = false;
    for (size_t i = 0; i + 1 < rings; i++)
        joined = joined || memcmp(position(&shape, i * ring), position(&shape, (i + 1) * ring),
                                  ring * 3 * sizeof(double)) == 0;
    assert_true(joined);
    tessellate_free(&shape);
}

static void a_ribbon_lies_across_its_normal(void **state)
{
    (void)state;
    const double normals[] = { 0, 0, 1, 0, 1, 0 };
    struct curve curve = { .points = straight,
                           .point_count = 4,
                           .degree = 3,
                           .ribbon = true,
                           .width = { .5, .5 },
                           .normals = normals,
                           .normal_count = 2 };
    struct tessellation shape = start();
    assert_true(curve_mesh_add(&shape, &curve, NULL));
    expect_front_sides(&shape);
    /* n x t = z x x = y: v grows along y; and at the end along y x x = -z */
    EXPECT_NEAR(position(&shape, 0)[1], -.25, 1e-12);
    EXPECT_NEAR(position(&shape, 1)[1], .25, 1e-12);
    EXPECT_NEAR(normal(&shape, 0)[2], 1, 1e-12);
    size_t last = shape.positions.count - 1;
    EXPECT_NEAR(position(&shape, last)[2], -.25, 1e-12);
    EXPECT_NEAR(normal(&shape, last)[1], 1, 1e-12);
    EXPECT_NEAR(uv(&shape, last)[0], 1, 0);
    tessellate_free(&shape);
}

static void odd_curves_are_refused_or_give_nothing(void **state)
{
    (void)state;
    static const double same[12] = { 0 };
    static const struct {
        struct curve curve;
        const char *says; /* NULL: no triangles, no error */
    } rows[] = {
        { { .points = straight, .point_count = 4, .degree = 4 }, "degree 4" },
        { { .points = straight, .point_count = 3, .degree = 3 }, "3 points: a Bezier" },
        { { .points = straight, .point_count = 4, .degree = 2 }, "4 points: a Bezier" },
        { { .points = straight, .point_count = 2, .degree = 2, .bspline = true },
          "2 points: a B-spline" },
        { { .points = straight, .point_count = 4, .degree = 3, .ribbon = true },
          "0 normals for a ribbon of 1 segments" },
        { { .points = straight, .point_count = 4, .degree = 3 }, NULL },
        { { .points = same, .point_count = 4, .degree = 3, .width = { 1, 1 } }, NULL },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        struct tessellation shape = start();
        bool made = curve_mesh_add(&shape, &rows[i].curve, &err);
        if (made != (rows[i].says == NULL) ||
            (rows[i].says != NULL && strstr(err.text, rows[i].says) == NULL))
            fail_msg("row %zu: \"%s\"", i, err.text);
        assert_int_equal(shape.triangles.count, 0);
        tessellate_free(&shape);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cylinders_have_their_area_and_stay_within_the_tolerance),
        cmocka_unit_test(a_full_turn_closes_bit_by_bit),
        cmocka_unit_test(spheres_have_their_area_and_pbrts_parameters),
        cmocka_unit_test(disks_have_their_area_and_face_up),
        cmocka_unit_test(a_flat_patch_is_two_triangles_and_a_skew_one_keeps_the_tolerance),
        cmocka_unit_test(a_patch_with_normals_and_uvs_interpolates_them),
        cmocka_unit_test(what_has_no_area_gives_nothing_and_too_much_is_refused),
        cmocka_unit_test(a_straight_tube_has_a_cylinders_area_and_width),
        cmocka_unit_test(bent_curves_follow_their_middle_line),
        cmocka_unit_test(all_bases_and_degrees_say_the_same_curve),
        cmocka_unit_test(frames_turn_no_more_than_the_curve),
        cmocka_unit_test(a_ribbon_lies_across_its_normal),
        cmocka_unit_test(odd_curves_are_refused_or_give_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
