/* Goal: Loop's subdivision has its known limits: planes stay planes, a regular vertex goes where
 * the closed form says, closed surfaces stay closed, boundaries become B-splines; and meshes that
 * are no surface are refused. */
#include "common/err.h"
#include "master/subdivide.h"
#include "tests/expect.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct tessellation start(void)
{
    return (struct tessellation){ .most = 200000 };
}

static const double *position(const struct tessellation *shape, size_t vertex)
{
    return (const double *)shape->positions.data + 3 * vertex;
}

static const double *normal(const struct tessellation *shape, size_t vertex)
{
    return (const double *)shape->normals.data + 3 * vertex;
}

/* An octahedron, wound counter-clockwise seen from outside */
static const double octahedron_points[] = {
    1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1
};
static const double octahedron_faces[] = { 0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4,
                                           2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5 };
static const struct subdivide_mesh octahedron = { octahedron_points, 6, octahedron_faces, 8 };

/* A plane of n x n squares, cut along one diagonal: all inner vertices are regular */
#define SIDE 6
static void grid(double points[3 * (SIDE + 1) * (SIDE + 1)], double faces[6 * SIDE * SIDE],
                 double (*height)(double x, double y))
{
    for (int y = 0; y <= SIDE; y++)
        for (int x = 0; x <= SIDE; x++) {
            double *p = points + 3 * (y * (SIDE + 1) + x);
            p[0] = x;
            p[1] = y;
            p[2] = height(x, y);
        }
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            int a = y * (SIDE + 1) + x, b = a + 1, c = b + SIDE + 1, d = a + SIDE + 1;
            const double two[] = { a, b, c, a, c, d };
            memcpy(faces + 6 * (y * SIDE + x), two, sizeof(two));
        }
}

static double tilted(double x, double y)
{
    return .5 * x - .25 * y + 1;
}

static double parabola(double x, double y)
{
    return x * x + 3 * y * y - x * y;
}

static int compare(const void *x, const void *y)
{
    const uint32_t *a = x, *b = y;
    return a[0] != b[0] ? (a[0] < b[0] ? -1 : 1) : a[1] != b[1] ? (a[1] < b[1] ? -1 : 1) : 0;
}

/* Is every edge once each way? */
static bool is_closed(const struct tessellation *shape)
{
    size_t count = 3 * shape->triangles.count;
    uint32_t(*edges)[2] = malloc(count * sizeof(*edges)),
    (*back)[2] = malloc(count * sizeof(*back));
    assert_non_null(edges);
    assert_non_null(back);
    const uint32_t *t = shape->triangles.data;
    for (size_t i = 0; i < count; i++) {
        uint32_t a = t[i], b = t[i % 3 == 2 ? i - 2 : i + 1];
        edges[i][0] = back[i][1] = a;
        edges[i][1] = back[i][0] = b;
    }
    qsort(edges, count, sizeof(*edges), compare);
    qsort(back, count, sizeof(*back), compare);
    bool same = memcmp(edges, back, count * sizeof(*edges)) == 0;
    for (size_t i = 1; i < count; i++)
        same = same && compare(edges[i - 1], edges[i]) != 0;
    free(edges);
    free(back);
    return same;
}

static void closed_surfaces_stay_closed_and_round(void **state)
{
    (void)state;
    for (unsigned levels = 0; levels <= 5; levels++) {
        struct tessellation shape = start();
        assert_true(subdivide_loop(&shape, &octahedron, levels, NULL));
        size_t faces = (size_t)8 << 2 * levels;
        assert_int_equal(shape.triangles.count, faces);
        assert_int_equal(shape.positions.count, faces / 2 + 2); /* Euler */
        assert_true(is_closed(&shape));
        for (size_t v = 0; v < shape.positions.count; v++) {
            const double *p = position(&shape, v), *n = normal(&shape, v);
            double length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), along = 0;
            assert_true(length > .4 && length < .75);
            for (int axis = 0; axis < 3; axis++)
                along += n[axis] * p[axis] / length;
            assert_true(along < -.9); /* pbrt's side: inwards */
        }
        tessellate_free(&shape);
    }
}

/* Valence 4: beta = 3/32, and gamma = 1 / (4 + 4): the vertex and each neighbour by halves */
static void limits_of_vertices_are_those_of_the_masks(void **state)
{
    (void)state;
    struct tessellation once = start();
    assert_true(subdivide_loop(&once, &octahedron, 0, NULL));
    EXPECT_NEAR(position(&once, 0)[0], .5, 1e-12);
    EXPECT_NEAR(normal(&once, 0)[0], -1, 1e-12);
    for (unsigned levels = 1; levels < 5; levels++) { /* the limit does not depend on the levels */
        struct tessellation shape = start();
        assert_true(subdivide_loop(&shape, &octahedron, levels, NULL));
        for (size_t v = 0; v < 6; v++)
            for (int axis = 0; axis < 3; axis++) {
                EXPECT_NEAR(position(&shape, v)[axis], position(&once, v)[axis], 1e-12);
                EXPECT_NEAR(normal(&shape, v)[axis], normal(&once, v)[axis], 1e-12);
            }
        tessellate_free(&shape);
    }
    tessellate_free(&once);

    /* Regular vertex: (6 v + sum of neighbours) / 12; of x^2 + 3 y^2 - x y that is a constant more,
     * and its tangents are the function's own: normal to (dz/dx, dz/dy, -1) */
    double points[3 * (SIDE + 1) * (SIDE + 1)], faces[6 * SIDE * SIDE];
    grid(points, faces, parabola);
    struct subdivide_mesh mesh = { points, (SIDE + 1) * (SIDE + 1), faces, 2 * SIDE * SIDE };
    struct tessellation shape = start();
    assert_true(subdivide_loop(&shape, &mesh, 0, NULL));
    for (int y = 1; y < SIDE; y++)
        for (int x = 1; x < SIDE; x++) {
            const double *p = position(&shape, (size_t)(y * (SIDE + 1) + x));
            const double *n = normal(&shape, (size_t)(y * (SIDE + 1) + x));
            double sum = 6 * parabola(x, y);
            static const int ring[6][2] = { { 1, 0 },  { 1, 1 },   { 0, 1 },
                                            { -1, 0 }, { -1, -1 }, { 0, -1 } };
            for (int i = 0; i < 6; i++)
                sum += parabola(x + ring[i][0], y + ring[i][1]);
            EXPECT_NEAR(p[0], x, 1e-12);
            EXPECT_NEAR(p[1], y, 1e-12);
            EXPECT_NEAR(p[2], sum / 12, 1e-12);
            assert_true(n[2] < 0);
            EXPECT_NEAR(-n[0] / n[2], 2 * x - y, 1e-9);
            EXPECT_NEAR(-n[1] / n[2], 6 * y - x, 1e-9);
        }
    tessellate_free(&shape);
}

static void planes_stay_planes_and_boundaries_stay_where_they_are(void **state)
{
    (void)state;
    double points[3 * (SIDE + 1) * (SIDE + 1)], faces[6 * SIDE * SIDE];
    grid(points, faces, tilted);
    struct subdivide_mesh mesh = { points, (SIDE + 1) * (SIDE + 1), faces, 2 * SIDE * SIDE };
    struct tessellation shape = start();
    assert_true(subdivide_loop(&shape, &mesh, 3, NULL));
    double low = 9, high = -9, scale = sqrt(1 + .25 + .0625);
    for (size_t v = 0; v < shape.positions.count; v++) {
        const double *p = position(&shape, v), *n = normal(&shape, v);
        EXPECT_NEAR(p[2], tilted(p[0], p[1]), 1e-12);
        low = fmin(low, p[0]);
        high = fmax(high, p[0]);
        EXPECT_NEAR(n[0], .5 / scale, 1e-9); /* of all kinds of boundary vertices, too */
        EXPECT_NEAR(n[1], -.25 / scale, 1e-9);
        EXPECT_NEAR(n[2], -1 / scale, 1e-9);
    }
    EXPECT_NEAR(low, 0, 1e-12); /* straight edges are their own B-spline */
    EXPECT_NEAR(high, SIDE, 1e-12);
    tessellate_free(&shape);
}

/* A single triangle: each corner goes to 4/6 of itself and 1/6 of both others, at any level */
static void a_boundary_is_a_spline_of_its_own(void **state)
{
    (void)state;
    const double points[] = { 0, 0, 0, 5, 0, 0, 0, 5, 0 }, face[] = { 0, 1, 2 };
    struct subdivide_mesh mesh = { points, 3, face, 1 };
    for (unsigned levels = 0; levels < 4; levels++) {
        struct tessellation shape = start();
        assert_true(subdivide_loop(&shape, &mesh, levels, NULL));
        EXPECT_NEAR(position(&shape, 0)[0], 5. / 6, 1e-12);
        EXPECT_NEAR(position(&shape, 1)[0], 20. / 6, 1e-12);
        EXPECT_NEAR(position(&shape, 1)[1], 5. / 6, 1e-12);
        EXPECT_NEAR(normal(&shape, 0)[2], -1, 1e-12);
        tessellate_free(&shape);
    }
}

static void what_is_no_surface_is_refused(void **state)
{
    (void)state;
    static const double same_way[] = { 0, 1, 2, 0, 1, 3 }, three[] = { 0, 1, 2, 1, 0, 3, 0, 1, 4 };
    static const double twice[] = { 0, 1, 1 }, beyond[] = { 0, 1, 6 }, below[] = { 0, 1, -1 };
    static const struct {
        const double *faces;
        size_t count;
        unsigned levels;
        const char *says;
    } rows[] = {
        { same_way, 2, 1, "two triangles go the same way along the edge from vertex 0 to 1" },
        { three, 3, 1, "more than two triangles share the edge from vertex 0 to 1" },
        { twice, 1, 1, "triangle 0 has vertex 1 twice" },
        { beyond, 1, 1, "index 6 (number 2) is out of range: there are 6 vertices" },
        { below, 1, 1, "index -1 (number 2) is out of range" },
        { octahedron_faces, 8, 9, "takes 2097152 triangles: 200000 are possible" },
        { octahedron_faces, 8, 30, "30 levels of subdivision" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        struct tessellation shape = start();
        struct subdivide_mesh mesh = { octahedron_points, 6, rows[i].faces, rows[i].count };
        assert_false(subdivide_loop(&shape, &mesh, rows[i].levels, &err));
        if (err.code != ERR_SCENE || strstr(err.text, rows[i].says) == NULL)
            fail_msg("row %zu: \"%s\"", i, err.text);
        tessellate_free(&shape);
    }
}

/* Two triangles that share a vertex only, two back to back, and a vertex that no face has */
static void odd_surfaces_are_subdivided_all_the_same(void **state)
{
    (void)state;
    static const double bow[] = { 0, 1, 2, 0, 3, 4 }, back[] = { 0, 1, 2, 1, 0, 2 };
    const double *faces[] = { bow, back };
    for (int i = 0; i < 2; i++) {
        struct tessellation shape = start();
        struct subdivide_mesh mesh = { octahedron_points, 6, faces[i], 2 };
        assert_true(subdivide_loop(&shape, &mesh, 3, NULL));
        assert_int_equal(shape.triangles.count, 128);
        for (size_t v = 0; v < 3 * shape.positions.count; v++)
            assert_true(isfinite(((const double *)shape.positions.data)[v]) &&
                        isfinite(((const double *)shape.normals.data)[v]));
        EXPECT_NEAR(position(&shape, 5)[2], -1, 0);
        tessellate_free(&shape);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(closed_surfaces_stay_closed_and_round),
        cmocka_unit_test(limits_of_vertices_are_those_of_the_masks),
        cmocka_unit_test(planes_stay_planes_and_boundaries_stay_where_they_are),
        cmocka_unit_test(a_boundary_is_a_spline_of_its_own),
        cmocka_unit_test(what_is_no_surface_is_refused),
        cmocka_unit_test(odd_surfaces_are_subdivided_all_the_same),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
