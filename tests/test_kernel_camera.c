/*
 * Camera rays and reconstruction filters. H numbers are those of the numerics notes, section 2.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/camera.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static struct scene scene_of(float lens_radius, float focal_distance)
{
    return (struct scene){ .settings = { .width = 64,
                                         .height = 48,
                                         .camera = { .position = { 1, 2, 3 },
                                                     .right = { 1, 0, 0 },
                                                     .up = { 0, 1, 0 },
                                                     .forward = { 0, 0, 1 },
                                                     .screen = { -1, 1, -0.75f, 0.75f },
                                                     .lens_radius = lens_radius,
                                                     .focal_distance = focal_distance } } };
}

static __attribute__((noinline)) struct ray8 ray_of(const struct scene *scene, const f8 *x,
                                                    const f8 *y, const f8 *u, const f8 *v)
{
    return camera_ray(scene, FX_ALL, *x, *y, *u, *v, F8(0));
}

static struct ray8 random_ray(const struct scene *scene, struct random_lanes *r, f8 x, f8 y)
{
    f8 u = random_f8(r), v = random_f8(r);
    return ray_of(scene, &x, &y, &u, &v);
}

static void a_closed_lens_is_a_pinhole_to_the_bit(void **state) /* H19 */
{
    (void)state;
    struct scene closed = scene_of(0, 2);
    struct random_lanes r = { 19, 0 };
    for (int i = 0; i < 2000; i++) {
        f8 x = random_f8(&r) * 64, y = random_f8(&r) * 48;
        struct ray8 a = random_ray(&closed, &r, x, y);
        struct ray8 b = camera_ray(&closed, FX_MESH, x, y, F8(0), F8(0), F8(0));
        assert_memory_equal(&a, &b, sizeof(a));
    }
}

/* How far rays of one film point are from its central ray in the plane `z` before the camera, at
 * most */
static double widest_at(const struct scene *open, const struct scene *closed, double z)
{
    struct random_lanes r = { 20, 0 };
    double widest = 0;
    for (int i = 0; i < 4000; i++) {
        f8 x = random_f8(&r) * 64, y = random_f8(&r) * 48;
        struct ray8 a = random_ray(open, &r, x, y), b = random_ray(closed, &r, x, y);
        for (int lane = 0; lane < LANES; lane++) {
            double ta = (z - ((double)a.o.z[lane] - 3)) / (double)a.d.z[lane];
            double tb = z / (double)b.d.z[lane];
            double gap = hypot((double)a.o.x[lane] + ta * (double)a.d.x[lane] -
                                   ((double)b.o.x[lane] + tb * (double)b.d.x[lane]),
                               (double)a.o.y[lane] + ta * (double)a.d.y[lane] -
                                   ((double)b.o.y[lane] + tb * (double)b.d.y[lane]));
            widest = fmax(widest, gap);
        }
    }
    return widest;
}

/*
 * H19: a point at distance d blurs to a disk of diameter A |d - f| / d in the plane of focus. The
 * rays of a film point spread by A |d - f| / f at d, which is that disk seen from the lens.
 */
static void a_lens_blurs_by_the_distance_to_the_plane_of_focus(void **state) /* H19 */
{
    (void)state;
    static const struct {
        double A, f, d, blur;
    } rows[] = {
        { 0.1, 2, 4, 0.05 },  { 0.1, 2, 2, 0 },  { 0.1, 4, 2, 0.1 },
        { 0.5, 1, 10, 0.45 }, { 0.02, 7, 7, 0 }, { 0.02, 30, 1, 0.58 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        float radius = (float)(rows[i].A / 2), f = (float)rows[i].f;
        struct scene open = scene_of(radius, f), closed = scene_of(0, f);
        double blur = 2 * widest_at(&open, &closed, rows[i].d) * rows[i].f / rows[i].d;
        /* The widest of 32000 is not quite the rim, and coordinates are rounded */
        EXPECT_NEAR(blur, rows[i].blur, 1e-3 * rows[i].blur + 1e-5);
        struct scene planted = scene_of(radius, f * 1.05f); /* focused a little farther */
        blur = 2 * widest_at(&planted, &closed, rows[i].d) * rows[i].f / rows[i].d;
        assert_true(fabs(blur - rows[i].blur) > 1e-3 * rows[i].blur + 1e-5);
    }
}

static void a_lens_focused_at_infinity_sends_parallel_rays(void **state) /* H19 */
{
    (void)state;
    struct scene open = scene_of(0.1f, INFINITY), closed = scene_of(0, INFINITY);
    struct random_lanes r = { 21, 0 };
    for (int i = 0; i < 1000; i++) {
        f8 x = random_f8(&r) * 64, y = random_f8(&r) * 48;
        struct ray8 a = random_ray(&open, &r, x, y), b = random_ray(&closed, &r, x, y);
        assert_memory_equal(&a.d, &b.d, sizeof(a.d));
    }
}

static void the_film_is_where_the_header_says(void **state)
{
    (void)state;
    struct scene scene = scene_of(0, INFINITY);
    struct ray8 corner = camera_ray(&scene, FX_ALL, F8(0), F8(0), F8(0), F8(0), F8(0));
    EXPECT_NEAR(corner.d.x[0] / corner.d.z[0], -1, 1e-6);
    EXPECT_NEAR(corner.d.y[0] / corner.d.z[0], 0.75, 1e-6);
    scene.settings.camera.kind = CAMERA_ORTHOGRAPHIC;
    struct ray8 flat = camera_ray(&scene, FX_ALL, F8(64), F8(48), F8(0), F8(0), F8(0));
    EXPECT_NEAR(flat.o.x[0], 2, 1e-6);
    EXPECT_NEAR(flat.o.y[0], 1.25, 1e-6);
    EXPECT_NEAR(flat.d.z[0], 1, 0);
}

/* ---- the lens disk */

static double disk_p(int planted)
{
    enum { RINGS = 16, SECTORS = 32 };
    static unsigned long long counts[RINGS * SECTORS];
    static double mass[RINGS * SECTORS];
    memset(counts, 0, sizeof(counts));
    struct random_lanes r = { 22, 0 };
    const unsigned n = 200000;
    for (unsigned i = 0; i < n; i += LANES) {
        f8 u = random_f8(&r), v = random_f8(&r);
        struct vec2x8 d = disk_from_square(u, v);
        for (int lane = 0; lane < LANES; lane++) {
            double r2 = (double)d.x[lane] * (double)d.x[lane] +
                        (double)d.y[lane] * (double)d.y[lane];
            if (!(r2 <= 1 + 1e-6))
                fail_msg("(%g, %g) is not in the disk", (double)d.x[lane], (double)d.y[lane]);
            if (planted)
                r2 = sqrt(r2); /* the radius itself uniform, a common mistake */
            double turn = atan2((double)d.y[lane], (double)d.x[lane]) / (2 * M_PI);
            int ring = (int)(r2 * RINGS), sector = (int)((turn < 0 ? turn + 1 : turn) * SECTORS);
            ring = ring < RINGS ? ring : RINGS - 1;
            counts[ring * SECTORS + (sector < SECTORS ? sector : 0)]++;
        }
    }
    for (int i = 0; i < RINGS * SECTORS; i++)
        mass[i] = 1.0 / (RINGS * SECTORS);
    return chi2_pooled(mass, counts, RINGS * SECTORS, n);
}

static void points_on_the_lens_are_uniform(void **state)
{
    (void)state;
    assert_true(disk_p(0) > CHI2_ALPHA);
    assert_true(disk_p(1) < CHI2_CAUGHT);
    struct vec2x8 center = disk_from_square(F8(0.5f), F8(0.5f));
    EXPECT_NEAR(center.x[0], 0, 0);
    EXPECT_NEAR(center.y[0], 0, 0);
}

/* ---- filters */

static const struct filter_spec filters[] = {
    { .kind = FILTER_BOX, .radius = { 0.5f, 0.5f } },
    { .kind = FILTER_BOX, .radius = { 2, 1 } },
    { .kind = FILTER_TRIANGLE, .radius = { 2, 1.5f } },
    { .kind = FILTER_GAUSSIAN, .radius = { 1.5f, 1.5f }, .sigma = 0.5f },
    { .kind = FILTER_MITCHELL, .radius = { 2, 2 }, .b = 1 / 3.0f, .c = 1 / 3.0f },
    { .kind = FILTER_MITCHELL, .radius = { 3, 2 }, .b = 0, .c = 0.5f },
    { .kind = FILTER_MITCHELL, .radius = { 2, 2 }, .b = 1, .c = 0 },
    { .kind = FILTER_SINC, .radius = { 4, 4 }, .tau = 3 },
    { .kind = FILTER_SINC, .radius = { 1, 2.7f }, .tau = 2.5f }, /* along x all is positive */
    { .kind = FILTER_SINC, .radius = { 6, 5 }, .tau = 1000 },
};
#define FILTERS (sizeof(filters) / sizeof(filters[0]))

/* Along one axis, x in units of the radius; as in pbrt-v4, section 8.8, written out again */
static double filter_value(const struct filter_spec *f, int axis, double x)
{
    double a = fabs(x), r = (double)f->radius[axis], s = (double)f->sigma, b = (double)f->b,
           c = (double)f->c, tau = (double)f->tau;
    if (f->kind == FILTER_TRIANGLE)
        return 1 - a;
    if (f->kind == FILTER_GAUSSIAN)
        return exp(-a * a * r * r / (2 * s * s)) - exp(-r * r / (2 * s * s));
    if (f->kind == FILTER_SINC)
        return a == 0 ? 1
                      : sin(M_PI * a * r) * sin(M_PI * a * r / tau) /
                            (M_PI * M_PI * a * a * r * r / tau);
    if (f->kind != FILTER_MITCHELL)
        return 1;
    a *= 2;
    if (a <= 1)
        return ((12 - 9 * b - 6 * c) * a * a * a + (-18 + 12 * b + 6 * c) * a * a + (6 - 2 * b)) /
               6;
    return ((-b - 6 * c) * a * a * a + (6 * b + 30 * c) * a * a + (-12 * b - 48 * c) * a +
            (8 * b + 24 * c)) /
           6;
}

#define BINS 24

/* The share of the filter (with its sign, over its integral) that falls in each of BINS x BINS bins
 */
static void filter_shares(const struct filter_spec *f, double shares[BINS * BINS])
{
    double axis[2][BINS] = { { 0 } }, sum[2] = { 0, 0 };
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < BINS; i++) {
            for (int j = 0; j < 100; j++)
                axis[k][i] += filter_value(f, k, 2 * (i + (j + 0.5) / 100) / BINS - 1) / 100;
            sum[k] += axis[k][i];
        }
    for (int y = 0; y < BINS; y++)
        for (int x = 0; x < BINS; x++)
            shares[y * BINS + x] = axis[0][x] * axis[1][y] / (sum[0] * sum[1]);
}

static void samples_weigh_what_the_filter_says(void **state)
{
    (void)state;
    static struct filter_table table;
    for (size_t i = 0; i < FILTERS; i++) {
        const struct filter_spec *f = &filters[i];
        filter_table_make(&table, f);
        double shares[BINS * BINS];
        filter_shares(f, shares);
        static double weights[BINS * BINS], squares[BINS * BINS];
        memset(weights, 0, sizeof(weights));
        memset(squares, 0, sizeof(squares));
        struct random_lanes r = { 23 + i, 0 };
        const unsigned n = 400000;
        const i8 lanes = { 0, 0, 0, -1, 0, 0, 0, -1 };
        for (unsigned k = 0; k < n; k += LANES) {
            i8 negative = table.has_negative ? lanes : I8(0);
            f8 lobe = random_f8(&r), u = random_f8(&r), v = random_f8(&r);
            struct vec2x8 at = filter_offset(&table, FX_ALL, negative, lobe, u, v);
            for (int lane = 0; lane < LANES; lane++) {
                double x = (double)at.x[lane] / (double)f->radius[0];
                double y = (double)at.y[lane] / (double)f->radius[1];
                if (!(fabs(x) <= 1 && fabs(y) <= 1))
                    fail_msg("filter %zu: (%g, %g) is outside", i, x, y);
                double w = !table.has_negative ? 1
                           : negative[lane]    ? (double)table.weight_negative
                                               : (double)table.weight_positive;
                if (w * filter_value(f, 0, x) * filter_value(f, 1, y) < -1e-5)
                    fail_msg("filter %zu: a sample of the wrong sign at (%g, %g)", i, x, y);
                int bx = (int)((x + 1) / 2 * BINS), by = (int)((y + 1) / 2 * BINS);
                int bin = (by < BINS ? by : BINS - 1) * BINS + (bx < BINS ? bx : BINS - 1);
                weights[bin] += w / n;
                squares[bin] += w * w / n;
            }
        }
        double statistic = 0, planted = 0, total = 0;
        int bins = 0;
        for (int b = 0; b < BINS * BINS; b++) {
            double variance = (squares[b] - weights[b] * weights[b]) / n;
            total += weights[b];
            /* Where the filter goes to zero within a few steps of the table it is a chord there */
            if (squares[b] * n < 100)
                continue;
            double error = 2e-2 * fabs(shares[b]) + 2e-5;
            double gap = fmax(0, fabs(weights[b] - shares[b]) - error);
            double wrong = fmax(
                0, fabs(weights[b] - shares[BINS * BINS - 1 - (b * 7) % (BINS * BINS)]) - error);
            statistic += gap * gap / variance;
            planted += wrong * wrong / variance;
            bins++;
        }
        EXPECT_NEAR(total, 1, 1e-6);
        if (!(stats_chi_square_survival(statistic, bins) > CHI2_ALPHA))
            fail_msg("filter %zu: chi square %g over %d bins", i, statistic, bins);
        if (f->kind != FILTER_BOX)
            assert_true(stats_chi_square_survival(planted, bins) < CHI2_CAUGHT);
    }
}

static void expect_fours(const struct filter_spec *f)
{
    static struct filter_table table;
    filter_table_make(&table, f);
    const float values[] = { 1, 0.3f, 1e-3f, 12345.678f };
    for (int i = 0; table.has_negative && i < 4; i++) {
        double sum = 0;
        for (int k = 0; k < 4; k++)
            sum += (double)(k == 3 ? table.weight_negative : table.weight_positive) *
                   (double)values[i];
        if ((float)sum != 4 * values[i])
            fail_msg("b %g, c %g, tau %g: four of %g are %.9g", (double)f->b, (double)f->c,
                     (double)f->tau, (double)values[i], sum);
    }
    if (table.has_negative && !job_in_fours(f))
        fail_msg("b %g, c %g, tau %g: this filter is not known to want samples in fours",
                 (double)f->b, (double)f->c, (double)f->tau);
}

static void four_samples_of_a_constant_image_sum_to_four(void **state)
{
    (void)state;
    for (int b = 0; b <= 10; b++)
        for (int c = 0; c <= 10; c++)
            expect_fours(&(struct filter_spec){ .kind = FILTER_MITCHELL,
                                                .radius = { 2, 2 },
                                                .b = (float)b / 10,
                                                .c = (float)c / 10 });
    static const float taus[] = { 1, 1.0001f, 1.7f, 3, 8, 1000 };
    for (int i = 0; i < 36; i++)
        expect_fours(&(struct filter_spec){ .kind = FILTER_SINC,
                                            .radius = { 0.5f + (float)(i / 6) * 3.1f, 1 },
                                            .tau = taus[i % 6] });
}

/* How many samples of a part lie where the filter has the other sign, by more than a step of the
 * integrals that made its table */
static unsigned misplaced(const struct filter_spec *f, const struct filter_part *part, double sign)
{
    unsigned count = 0;
    for (int k = 0; k < 20000; k++) {
        f8 u = (f8_from_i8(i8_lanes()) + 8 * (float)k) / 160000;
        f8 x = filter_axis_sample(part, f->radius[0], u);
        for (int lane = 0; lane < LANES; lane++) {
            double at = (double)x[lane] / (double)f->radius[0];
            count += !(fabs(at) <= 1) ||
                     sign * filter_value(f, 0, at) < -4 * (double)f->radius[0] / 65536;
        }
    }
    return count;
}

/* However its window cuts it, each stretch of one sign has a piece of the table to itself */
static void the_lobes_of_a_sinc_are_kept_apart(void **state)
{
    (void)state;
    static const struct {
        float radius, tau;
        int positive, negative;
    } rows[] = {
        { 1, 3, 1, 0 },     { 1.001f, 3, 1, 1 },
        { 2.5f, 3, 2, 1 },  { 4, 3, 2, 1 }, /* past 3 both factors are negative */
        { 4, 2.5f, 3, 2 },  { 16, 1, 1, 0 },
        { 16, 1000, 8, 8 }, { 16, 1.01f, 16, 15 },
    };
    static struct filter_table table;
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct filter_spec f = { .kind = FILTER_SINC,
                                 .radius = { rows[i].radius, rows[i].radius },
                                 .tau = rows[i].tau };
        filter_table_make(&table, &f);
        assert_int_equal(table.positive[0].lobes, rows[i].positive);
        assert_int_equal(table.negative[0].lobes, rows[i].negative);
        assert_int_equal(misplaced(&f, &table.positive[0], 1), 0);
        if (rows[i].negative > 0)
            assert_int_equal(misplaced(&f, &table.negative[0], -1), 0);

        /* Planted: one table for all, in which some samples fall between two lobes */
        table.positive[0].lobes = 1;
        table.positive[0].step[0] = FILTER_TABLE_LEN;
        if (rows[i].radius == 4)
            assert_true(misplaced(&f, &table.positive[0], 1) > 0);
    }
}

static void a_constant_image_stays_constant_under_every_filter(void **state)
{
    (void)state;
    for (size_t i = 0; i < FILTERS; i++) {
        struct scene *scene = scenes_begin(20, 20);
        scene->settings.filter = filters[i];
        static const float lenses[FILTERS] = { 0.1f, 0, 1e-3f, 5, 100, 0.1f, 0.1f };
        static const float focus[FILTERS] = { 2, 2, 1e-3f, 2, 1e6f, INFINITY, 1e-6f };
        scene->settings.camera.lens_radius = lenses[i]; /* nor does a lens change it: H19 */
        scene->settings.camera.focal_distance = focus[i];
        scenes_sky(scene, 0.7f);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4 });
        for (size_t k = 0; k < (size_t)p->width * p->height * 3; k++)
            if (p->rgb[k] != 4 * 0.7f)
                fail_msg("filter %zu: %.9g, want %.9g", i, (double)p->rgb[k], 4 * 0.7);
        picture_free(p);
        scene_free(scene);
    }
}

static void a_sinc_has_the_same_bits_in_any_number_of_lanes(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(20, 20);
    uint32_t white = scenes_diffuse(scene, 0.5f);
    scene->settings.filter = (struct filter_spec){ .kind = FILTER_SINC,
                                                   .radius = { 4, 2.5f },
                                                   .tau = 3 };
    scenes_room(scene, white, white);
    scenes_finish(scene);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 8 });
    assert_true(p->mean > 0);
    picture_expect_any_lanes(scene, p, 8);
    picture_expect_same(p, picture_take(scene, (struct picture_how){ .samples = 8, .kernel = 1 }));
    scene_free(scene);
}

static void the_pixel_box_has_the_same_bits_in_every_variant(void **state)
{
    (void)state;
    static struct filter_table table;
    filter_table_make(&table, &filters[0]);
    struct random_lanes r = { 29, 0 };
    for (int i = 0; i < 20000; i++) {
        f8 u = random_f8(&r), v = random_f8(&r);
        struct vec2x8 a = filter_offset(&table, FX_ALL, I8(0), F8(0), u, v);
        struct vec2x8 b = filter_offset(&table, FX_MESH, I8(0), F8(0), u, v);
        assert_memory_equal(&a, &b, sizeof(a));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_closed_lens_is_a_pinhole_to_the_bit),
        cmocka_unit_test(a_lens_blurs_by_the_distance_to_the_plane_of_focus),
        cmocka_unit_test(a_lens_focused_at_infinity_sends_parallel_rays),
        cmocka_unit_test(the_film_is_where_the_header_says),
        cmocka_unit_test(points_on_the_lens_are_uniform),
        cmocka_unit_test(samples_weigh_what_the_filter_says),
        cmocka_unit_test(four_samples_of_a_constant_image_sum_to_four),
        cmocka_unit_test(the_lobes_of_a_sinc_are_kept_apart),
        cmocka_unit_test(a_constant_image_stays_constant_under_every_filter),
        cmocka_unit_test(a_sinc_has_the_same_bits_in_any_number_of_lanes),
        cmocka_unit_test(the_pixel_box_has_the_same_bits_in_every_variant),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
