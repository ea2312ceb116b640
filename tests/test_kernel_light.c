/*
 * Light sampling: the irradiance of every shape against its closed form, sampled directions against
 * their density, and the cases where solid angles vanish or light comes from behind. H numbers are
 * those of the numerics notes, section 2. Runs for about ten seconds.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/light.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* One copy of the code each: the headers inline everything */
static __attribute__((noinline)) struct light_sample8 take(const struct kernel_scene *ks,
                                                           const struct vec3x8 *p, const f8 u[3])
{
    return light_sample(ks, FX_ALL, I8(-1), *p, vec3x8_all(0, 0, 0), u[0], u[1], u[2]);
}

static __attribute__((noinline)) f8 density(const struct kernel_scene *ks, i8 light,
                                            const struct vec3x8 *p, const struct vec3x8 *y,
                                            const struct vec3x8 *n)
{
    return light_pdf(ks, FX_ALL, I8(-1), light, *p, vec3x8_all(0, 0, 0), *y, *n);
}

static i8 choice(const struct kernel_scene *ks, f8 u)
{
    const struct vec3x8 zero = vec3x8_all(0, 0, 0);
    f8 chosen;
    return light_choose(ks, FX_ALL, I8(-1), zero, zero, u, &chosen);
}

static double pick_of(const struct kernel_scene *ks, uint32_t light)
{
    const struct vec3x8 zero = vec3x8_all(0, 0, 0);
    return (double)light_pick(ks, FX_ALL, I8(-1), zero, zero, I8((int32_t)light))[0];
}

static struct light_sample8 take_random(const struct kernel_scene *ks, const struct vec3x8 *p,
                                        struct random_lanes *r)
{
    const f8 u[3] = { random_f8(r), random_f8(r), random_f8(r) };
    return take(ks, p, u);
}

/* A scene of lights alone; the pieces a test needs are added by its fixture */
struct lights {
    struct scene *scene;
    struct kernel_scene *ks;
    uint32_t black;
};

static struct lights lights_begin(void)
{
    struct lights l = { .scene = scenes_begin(1, 1) };
    l.black = scenes_diffuse(l.scene, 0);
    return l;
}

static void lights_open(struct lights *l)
{
    scenes_finish(l->scene);
    l->ks = scenes_open(l->scene, (struct picture_how){ 0 });
}

static void lights_close(struct lights *l)
{
    kernel_close(l->ks);
    scene_free(l->scene);
}

/* ---- irradiance */

enum plant { SOUND, WEIGHT_SMALL, COSINE_DROPPED, PDF_LARGE };

/* Form factor from p with normal n: the mean of L cos / (pi pdf) */
static struct tally irradiance(const struct lights *l, const float p[3], const double n[3],
                               int samples, enum plant plant)
{
    struct random_lanes r = { 42, 0 };
    struct tally t = { 0 };
    struct vec3x8 at = vec3x8_all(p[0], p[1], p[2]);
    for (int i = 0; i < samples; i += LANES) {
        struct light_sample8 s = take_random(l->ks, &at, &r);
        for (int lane = 0; lane < LANES; lane++) {
            double cosine = (double)s.wi.x[lane] * n[0] + (double)s.wi.y[lane] * n[1] +
                            (double)s.wi.z[lane] * n[2];
            double f = (double)s.radiance.x[lane] / (M_PI * (double)s.pdf[lane]);
            if (plant == COSINE_DROPPED)
                f *= 0.5;
            else
                f *= cosine;
            f *= plant == WEIGHT_SMALL ? 0.99 : plant == PDF_LARGE ? 1 / 1.02 : 1;
            tally_add(&t, s.valid[lane] && cosine > 0 ? f : 0);
        }
    }
    return t;
}

static void expect_irradiance(struct lights *l, const char *what, const float p[3],
                              const double n[3], double want)
{
    struct tally t = irradiance(l, p, n, 200000, SOUND);
    if (!(tally_z(&t, want) < 4.5))
        fail_msg("%s: %.9g, want %.9g, z = %.1f", what, tally_mean(&t), want, tally_z(&t, want));
}

static void expect_planted_bugs_seen(struct lights *l, const float p[3], const double n[3],
                                     double want)
{
    for (int plant = WEIGHT_SMALL; plant <= PDF_LARGE; plant++) {
        struct tally t = irradiance(l, p, n, 200000, (enum plant)plant);
        if (!(tally_z(&t, want) > 6))
            fail_msg("planted bug %d: %.9g, want %.9g", plant, tally_mean(&t), want);
    }
}

/* The lights were changed: what is measured must not be what was */
static void expect_refused(struct lights *l, const char *what, const float p[3], const double n[3],
                           double was)
{
    struct tally t = irradiance(l, p, n, 200000, SOUND);
    if (!(tally_z(&t, was) > 6))
        fail_msg("%s: not noticed, %.9g against %.9g", what, tally_mean(&t), was);
}

static const float origin[3] = { 0, 0, 0 };
static const double up[3] = { 0, 0, 1 };

static void squares_have_their_form_factors(void **state)
{
    (void)state;
    struct lights l = lights_begin();
    static const float above[4][3] = {
        { -.5f, -.5f, 1 }, { -.5f, .5f, 1 }, { .5f, .5f, 1 }, { .5f, -.5f, 1 }
    };
    scenes_quad(l.scene, above, l.black, 1);
    lights_open(&l);
    expect_irradiance(&l, "square above", origin, up, 0.239456470461);
    expect_planted_bugs_seen(&l, origin, up, 0.239456470461);
    lights_close(&l);

    l = lights_begin();
    static const float beside[4][3] = {
        { .5f, 0, 0 }, { .5f, 0, 1 }, { .5f, 2, 1 }, { .5f, 2, 0 }
    };
    scenes_quad(l.scene, beside, l.black, 1);
    lights_open(&l);
    expect_irradiance(&l, "rectangle beside", origin, up, 0.135488396965);
    lights_close(&l);
}

/* All of two unit squares: random receivers, one light */
static void facing_and_adjacent_squares_exchange_what_they_must(void **state)
{
    (void)state;
    const double want[2] = { 0.199824895698, 0.200043776075 };
    static const float lights[2][4][3] = {
        { { 0, 0, 1 }, { 0, 1, 1 }, { 1, 1, 1 }, { 1, 0, 1 } },
        { { 0, 0, 0 }, { 0, 1, 0 }, { 0, 1, 1 }, { 0, 0, 1 } },
    };
    for (int i = 0; i < 2; i++) {
        struct lights l = lights_begin();
        scenes_quad(l.scene, lights[i], l.black, 1);
        lights_open(&l);
        struct random_lanes r = { 5, 0 };
        struct tally t = { 0 };
        for (int k = 0; k < 40000; k++) {
            struct vec3x8 p = { random_f8(&r) + 0x1p-25f, random_f8(&r), F8(0) };
            struct light_sample8 s = take_random(l.ks, &p, &r);
            for (int lane = 0; lane < LANES; lane++) {
                double f = (double)s.wi.z[lane] / (M_PI * (double)s.pdf[lane]);
                tally_add(&t, s.valid[lane] && f > 0 ? f : 0);
            }
        }
        if (!(tally_z(&t, want[i]) < 4.5))
            fail_msg("%g, want %g", tally_mean(&t), want[i]);
        lights_close(&l);
    }
}

static void triangles_light_as_lambert_says(void **state) /* H39 */
{
    (void)state;
    static const float triangles[5][3][3] = {
        { { -0.443432f, 0.596366f, 0.495985f },
          { -0.320397f, 0.0677699f, -0.229359f },
          { 0.0341197f, 0.11415f, -0.343049f } },
        { { 0.461963f, 0.397843f, 0.412747f },
          { -0.0381582f, 0.851323f, -0.156872f },
          { 0.195443f, 0.891957f, -0.260672f } },
        { { 0.100871f, 0.289075f, -0.422609f },
          { -0.308386f, 0.629587f, 0.423966f },
          { -0.373132f, 0.237287f, 0.351592f } },
        { { -0.17575f, 0.639397f, 0.151268f },
          { 0.318604f, 0.732996f, 0.459771f },
          { 0.139095f, 0.294498f, 0.478556f } },
        { { -0.17487f, 0.447916f, 0.367201f },
          { -0.405259f, 0.249607f, -0.354079f },
          { 0.356029f, 0.0918984f, -0.132271f } },
    };
    /* Radiance of a receiver of albedo .5 */
    const double L[5] = { 0.08983925852, 0.02292004042, 0.05341954023, 0.02053139149,
                          0.2617398589 };
    for (int i = 0; i < 5; i++) {
        struct lights l = lights_begin();
        scenes_polygon(l.scene, triangles[i], 3, l.black, 1);
        l.scene->lights[0].flags |= LIGHT_TWO_SIDED;
        lights_open(&l);
        const double n[3] = { 0, 1, 0 };
        expect_irradiance(&l, "triangle", origin, n, 2 * L[i]);
        expect_planted_bugs_seen(&l, origin, n, 2 * L[i]);
        /* A corner off by a hundredth, and another triangle's corners in the same order */
        l.scene->light_corners[8] += 0.01f;
        expect_refused(&l, "a corner moved", origin, n, 2 * L[i]);
        memcpy(l.scene->light_corners, triangles[(i + 1) % 5], sizeof(triangles[0]));
        expect_refused(&l, "another triangle", origin, n, 2 * L[i]);
        lights_close(&l);
    }
}

/* Form factor of a polygon above the horizon of the origin, by Lambert's formula */
static double lambert_polygon(const float (*corners)[3], int count, const double n[3])
{
    double total = 0;
    for (int i = 0; i < count; i++) {
        const float *a = corners[i], *b = corners[(i + 1) % count];
        double c[3], along = 0, length2 = 0, ab = 0;
        for (int k = 0; k < 3; k++) {
            int u = (k + 1) % 3, v = (k + 2) % 3;
            c[k] = (double)a[u] * (double)b[v] - (double)a[v] * (double)b[u];
            along += c[k] * n[k];
            length2 += c[k] * c[k];
            ab += (double)a[k] * (double)b[k];
        }
        total += atan2(sqrt(length2), ab) * along / sqrt(length2);
    }
    return fabs(total) / (2 * M_PI);
}

static void fans_of_triangles_light_as_lambert_says(void **state) /* H39 */
{
    (void)state;
    for (int count = 4; count <= POLYGON_MAX; count++) {
        /* Long and aslant: no two triangles of the fan are alike */
        float corners[POLYGON_MAX][3];
        for (int i = 0; i < count; i++) {
            double phi = 0.3 - 2 * M_PI * i / count;
            corners[i][0] = (float)(1.5 * cos(phi));
            corners[i][1] = (float)(0.6 * sin(phi) + 0.2);
            corners[i][2] = (float)(1 + 0.5 * cos(phi));
        }
        struct lights l = lights_begin();
        scenes_polygon(l.scene, (const float(*)[3])corners, (uint32_t)count, l.black, 1);
        lights_open(&l);
        double want = lambert_polygon((const float(*)[3])corners, count, up);
        expect_irradiance(&l, "polygon", origin, up, want);
        expect_planted_bugs_seen(&l, origin, up, want);
        l.scene->lights[0].corner_count--;
        expect_refused(&l, "a triangle of the fan is lost", origin, up, want);
        l.scene->lights[0].corner_count++;
        memcpy(l.scene->light_corners + 3, l.scene->light_corners + 6, 3 * sizeof(float));
        expect_refused(&l, "a corner twice", origin, up, want);
        lights_close(&l);
    }
}

static void disks_have_their_form_factors(void **state)
{
    (void)state;
    struct lights l = lights_begin();
    scenes_quadric(l.scene, QUADRIC_DISK, 0, 0, -1, 1, l.black, 1);
    lights_open(&l);
    expect_irradiance(&l, "disk on axis", origin, (const double[3]){ 0, 0, -1 }, 0.5);
    expect_planted_bugs_seen(&l, origin, (const double[3]){ 0, 0, -1 }, 0.5);
    expect_irradiance(&l, "disk off axis", (const float[3]){ 1, 0, 0 },
                      (const double[3]){ 0, 0, -1 }, 0.276393202250);
    lights_close(&l);
}

static void spheres_light_also_when_the_horizon_cuts_them(void **state) /* H35 */
{
    (void)state;
    const double cosines[] = { 1, 0.6, 0.3, 0, -0.3 };
    const double want[] = { .25, .15, 0.0787154307326, 0.0288344428112, 0.0037154307326 };
    for (int i = 0; i < 5; i++) {
        struct lights l = lights_begin();
        scenes_quadric(l.scene, QUADRIC_SPHERE, 0, 0, 2, 1, l.black, 1);
        lights_open(&l);
        const double n[3] = { sqrt(1 - cosines[i] * cosines[i]), 0, cosines[i] };
        expect_irradiance(&l, "sphere", origin, n, want[i]);
        if (i == 1)
            expect_planted_bugs_seen(&l, origin, n, want[i]);
        lights_close(&l);
    }
    /* Almost touching */
    struct lights l = lights_begin();
    scenes_quadric(l.scene, QUADRIC_SPHERE, 0, 0, 1.0001f, 1, l.black, 1);
    lights_open(&l);
    expect_irradiance(&l, "sphere at 1.0001", origin, (const double[3]){ 1, 0, 0 }, 0.490997812058);
    lights_close(&l);

    /* From inside, its normals inwards: all around is light */
    for (int i = 0; i < 3; i++) {
        const float z[3] = { 0, 0.5f, 0.999f };
        l = lights_begin();
        scenes_quadric(l.scene, QUADRIC_SPHERE, 0, 0, 0, 1, l.black, 1)->flags |=
            QUADRIC_FLIP_NORMAL;
        lights_open(&l);
        const float p[3] = { 0, 0, z[i] };
        struct tally t = irradiance(&l, p, (const double[3]){ 0.6, 0.8, 0 }, 400000, SOUND);
        if (!(fabs(tally_mean(&t) - 1) < 4.5 * sqrt(tally_variance(&t) / t.n) + 1e-3))
            fail_msg("inside at %g: %g, want 1", (double)z[i], tally_mean(&t));
        lights_close(&l);
    }
}

/* A wall of width 2 w and height 1 at distance d, perpendicular: EES B-4 */
static double wall_factor(double w, double d)
{
    double slant = sqrt(1 + 1 / (d * d));
    return (atan(w / d) - atan(w / d / slant) / slant) / M_PI;
}

/* The second moment of the same by points uniform in area: the mean of (cos cos' A / (pi d^2))^2 */
static double by_area_second_moment(double w, double x)
{
    struct random_lanes r = { 37, 0 };
    double sum = 0;
    const int n = 400000;
    for (int i = 0; i < n; i++) {
        double y = w * (2 * random_double(&r) - 1), z = random_double(&r);
        double d2 = x * x + y * y + z * z, f = z * x * 2 * w / (M_PI * d2 * d2);
        sum += f * f / n;
    }
    return sum;
}

static void a_wall_lights_the_floor_it_touches(void **state) /* H37 */
{
    (void)state;
    const double distances[] = { 1, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6 }, widths[] = { 1, 30, 1000 };
    EXPECT_NEAR(wall_factor(1e9, 1), 0.146446609407, 1e-9);
    EXPECT_NEAR(wall_factor(1e9, 0.1), 0.450248140490, 1e-9);
    EXPECT_NEAR(wall_factor(1e9, 1e-3), 0.49950000025, 1e-9);
    EXPECT_NEAR(wall_factor(1e9, 1e-6), 0.4999995, 1e-9);
    for (int i = 0; i < 21; i++) {
        const float x = (float)distances[i / 3], w = (float)widths[i % 3];
        if (w / x > 2e6f) /* corners opposite to the last bit: 1.6 % low, and known */
            continue;
        struct lights l = lights_begin();
        const float wall[4][3] = { { x, -w, 0 }, { x, -w, 1 }, { x, w, 1 }, { x, w, 0 } };
        scenes_quad(l.scene, wall, l.black, 1);
        lights_open(&l);
        struct tally t = irradiance(&l, origin, up, 400000, SOUND);
        double want = wall_factor((double)w, (double)x);
        EXPECT_NEAR(tally_mean(&t), want, 4.5 * sqrt(tally_variance(&t) / t.n));
        /* Sampled by solid angle, which is at most 2 pi: no sample counts more than 2 */
        assert_true(tally_variance(&t) < 1);
        /* Planted: points uniform on the wall, whose few that are close count for all */
        if (i == 6)
            assert_true(by_area_second_moment((double)w, (double)x) > 50);
        lights_close(&l);
    }
}

/* ---- directions against densities */

struct polygon_case {
    const char *what;
    int corners;
    double radius, distance, tilt; /* of a regular polygon; tilt in degrees, 90 is edge-on */
};

struct aim {
    struct lights *l;
    const struct light *light;
    float scale; /* planted: of the density */
};

/* Where direction w from the origin meets the light, and its normal there; else false */
static bool meets(const struct aim *a, const double w[3], double y[3], double n[3])
{
    if (a->light->kind == LIGHT_SPHERE) {
        const struct quadric *q = &a->l->scene->quadrics[0];
        double b = 0, c = -(double)q->radius * (double)q->radius;
        for (int k = 0; k < 3; k++) {
            b += w[k] * (double)q->center[k];
            c += (double)q->center[k] * (double)q->center[k];
        }
        double d = b * b - c;
        if (d < 0)
            return false;
        double t = c > 0 ? b - sqrt(d) : b + sqrt(d);
        for (int k = 0; k < 3; k++) {
            y[k] = t * w[k];
            n[k] = (y[k] - (double)q->center[k]) / (double)q->radius;
        }
        return t > 0;
    }
    double wn = 0, cn = 0;
    const float *c0 = a->l->scene->quadrics[0].center;
    for (int k = 0; k < 3; k++) {
        n[k] = (double)a->light->normal[k];
        wn += w[k] * n[k];
        cn += (double)c0[k] * n[k];
    }
    double t = cn / wn;
    if (!(t > 0))
        return false;
    for (int k = 0; k < 3; k++)
        y[k] = t * w[k];
    return hypot(hypot(y[0] - (double)c0[0], y[1] - (double)c0[1]), y[2] - (double)c0[2]) <=
           (double)a->l->scene->quadrics[0].radius;
}

static void aim_pdf(void *self, const struct vec3x8 *w, f8 *pdf)
{
    const struct aim *a = self;
    struct vec3x8 p = vec3x8_all(0, 0, 0), points = p, normals = vec3x8_all(0, 0, 1);
    i8 hit = I8(0);
    for (int lane = 0; lane < LANES; lane++) {
        double d[3] = { (double)w->x[lane], (double)w->y[lane], (double)w->z[lane] };
        double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        for (int k = 0; k < 3; k++)
            d[k] /= length;
        double y[3], n[3];
        if (!meets(a, d, y, n))
            continue;
        hit[lane] = -1;
        points.x[lane] = (float)y[0];
        points.y[lane] = (float)y[1];
        points.z[lane] = (float)y[2];
        normals.x[lane] = (float)n[0];
        normals.y[lane] = (float)n[1];
        normals.z[lane] = (float)n[2];
    }
    *pdf = F8(0);
    if (i8_any(hit))
        *pdf = f8_select(hit, density(a->l->ks, I8(0), &p, &points, &normals), F8(0)) * a->scale;
}

static void aim_sample(void *self, struct random_lanes *r, struct vec3x8 *w, i8 *valid)
{
    const struct aim *a = self;
    struct vec3x8 p = vec3x8_all(0, 0, 0);
    struct light_sample8 s = take_random(a->l->ks, &p, r);
    *w = s.wi;
    *valid = s.valid;
}

static void expect_density(struct aim *a, const char *what, const float axis[3], double power,
                           double slack)
{
    struct chi2_case c = { .self = a,
                           .axis = { axis[0], axis[1], axis[2] },
                           .power = power,
                           .samples = 100000,
                           .seed = 9,
                           .pdf = aim_pdf,
                           .sample = aim_sample };
    struct chi2_result r = chi2_run(&c);
    if (!(r.p > CHI2_ALPHA))
        fail_msg("%s: p = %g", what, r.p);
    /* Points on the outline may round to the other side of it */
    if (r.outside > 20)
        fail_msg("%s: %llu samples where the density is zero", what, r.outside);
    if (!chi2_scale_right(&r, c.samples, slack))
        fail_msg("%s: the density integrates to %g, %g of the samples are valid", what, r.integral,
                 r.share);
    a->scale = 1.02f;
    r = chi2_run(&c);
    if (slack < 0.015 && chi2_scale_right(&r, c.samples, slack))
        fail_msg("%s: a density 2 %% too large was not seen", what);
    a->scale = 1;
}

#define SPLIT 8 /* cells along each side of a triangle of the fan */

static double solid_angle(const double p[3][3])
{
    double l[3], dot[3], e[2][3], det = 0;
    for (int i = 0; i < 3; i++) {
        l[i] = sqrt(p[i][0] * p[i][0] + p[i][1] * p[i][1] + p[i][2] * p[i][2]);
        const double *q = p[(i + 1) % 3];
        dot[i] = p[i][0] * q[0] + p[i][1] * q[1] + p[i][2] * q[2];
        e[0][i] = p[1][i] - p[0][i];
        e[1][i] = p[2][i] - p[0][i];
    }
    for (int k = 0; k < 3; k++) {
        int u = (k + 1) % 3, v = (k + 2) % 3;
        det += p[0][k] * (e[0][u] * e[1][v] - e[0][v] * e[1][u]);
    }
    return 2 * atan2(fabs(det), l[0] * l[1] * l[2] + dot[0] * l[2] + dot[1] * l[0] + dot[2] * l[1]);
}

/* The point of a triangle at s of the way from its corner 0, and there t of the way across */
static void fan_at(const float (*c)[3], int i, double s, double t, double p[3])
{
    for (int k = 0; k < 3; k++) {
        double a = (double)c[0][k], b = (double)c[i + 1][k], d = (double)c[i + 2][k];
        p[k] = a + s * ((b - a) + t * (d - b));
    }
}

/* Where direction w leaves through triangle i of the fan: its cell, and how far inside it is */
static int fan_cell(const float (*c)[3], int i, const double w[3], double *inside)
{
    double e1[3], e2[3], h[3], q[3], A[3], det = 0, b = 0, g = 0;
    for (int k = 0; k < 3; k++) {
        A[k] = (double)c[0][k];
        e1[k] = (double)c[i + 1][k] - A[k];
        e2[k] = (double)c[i + 2][k] - A[k];
    }
    for (int k = 0; k < 3; k++) {
        int u = (k + 1) % 3, v = (k + 2) % 3;
        h[k] = w[u] * e2[v] - w[v] * e2[u];
        q[k] = e1[u] * A[v] - e1[v] * A[u]; /* -A x e1 */
    }
    for (int k = 0; k < 3; k++) {
        det += e1[k] * h[k];
        b -= A[k] * h[k];
        g += w[k] * q[k];
    }
    b /= det;
    g /= det;
    *inside = fmin(fmin(b, g), 1 - b - g);
    int row = (int)(fmin(fmax(b + g, 0), 0.999) * SPLIT);
    int column = (int)(fmin(fmax(g / (b + g), 0), 0.999) * SPLIT);
    return (i * SPLIT + row) * SPLIT + column;
}

/* p of Pearson's test over all cells; planted: another number in place of v */
static double fan_p(struct lights *l, const float (*c)[3], int corners, bool planted, double *omega)
{
    enum { CELLS = (POLYGON_MAX - 2) * SPLIT * SPLIT };
    static double mass[CELLS];
    static unsigned long long counts[CELLS];
    memset(counts, 0, sizeof(counts));
    *omega = 0;
    int cells = (corners - 2) * SPLIT * SPLIT;
    for (int cell = 0; cell < cells; cell++) {
        int i = cell / (SPLIT * SPLIT), row = cell / SPLIT % SPLIT, column = cell % SPLIT;
        double s = (double)row / SPLIT, t = (double)column / SPLIT, p[4][3];
        fan_at(c, i, s, t, p[0]);
        fan_at(c, i, s + 1.0 / SPLIT, t, p[1]);
        fan_at(c, i, s + 1.0 / SPLIT, t + 1.0 / SPLIT, p[2]);
        fan_at(c, i, s, t + 1.0 / SPLIT, p[3]);
        double halves[2][3][3];
        for (int k = 0; k < 3; k++)
            for (int half = 0; half < 2; half++) {
                halves[half][0][k] = p[0][k];
                halves[half][1][k] = p[1 + half][k];
                halves[half][2][k] = p[2 + half][k];
            }
        mass[cell] = solid_angle((const double(*)[3])halves[0]) +
                     solid_angle((const double(*)[3])halves[1]);
        *omega += mass[cell];
    }
    for (int cell = 0; cell < cells; cell++)
        mass[cell] /= *omega;
    struct random_lanes r = { 9, 0 };
    struct vec3x8 p = vec3x8_all(0, 0, 0);
    const unsigned n = 100000;
    for (unsigned k = 0; k < n; k += LANES) {
        f8 u[3] = { F8(0), random_f8(&r), random_f8(&r) };
        if (planted)
            u[2] = u[2] * u[2] * 0.1f + u[2] * 0.9f;
        struct light_sample8 s = take(l->ks, &p, u);
        for (int lane = 0; lane < LANES; lane++) {
            if (!s.valid[lane])
                fail_msg("a sample of a polygon in full view is not valid");
            EXPECT_NEAR((double)s.pdf[lane] * *omega, 1, *omega < 1e-5 ? 0.1 : 2e-4);
            const double w[3] = { (double)s.wi.x[lane], (double)s.wi.y[lane],
                                  (double)s.wi.z[lane] };
            int cell = 0;
            double best = -1, inside;
            for (int i = 0; i < corners - 2; i++) {
                int here = fan_cell(c, i, w, &inside);
                cell = inside > best ? here : cell;
                best = fmax(best, inside);
            }
            if (best < -1e-3)
                fail_msg("direction (%.9g, %.9g, %.9g) misses the polygon", w[0], w[1], w[2]);
            counts[cell]++;
        }
    }
    return chi2_pooled(mass, counts, cells, n);
}

static void directions_to_polygons_are_uniform_in_solid_angle(void **state) /* H38 */
{
    (void)state;
    static const struct polygon_case cases[] = {
        { "triangle", 3, 1, 1, 0 },
        { "quad, tilted", 4, 1, 2, 60 },
        { "pentagon", 5, 1, 1, 30 },
        { "hexagon, huge", 6, 1, 0.05, 0 },
        { "hexagon, touching", 6, 1, 1e-3, 0 },
        { "heptagon", 7, 1, 3, 20 },
        { "octagon", 8, 1, 1, 75 },
        { "triangle, small", 3, 1, 100, 10 },
        { "quad, below the limit", 4, 1, 2000, 40 },
        { "octagon, far", 8, 1, 300, 20 },
        { "triangle, vast", 3, 100, 1, 0 },
        { "quad, nearly edge-on", 4, 1, 3, 85 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        float corners[8][3];
        double tilt = cases[i].tilt * M_PI / 180, omega;
        for (int k = 0; k < cases[i].corners; k++) {
            /* Clockwise in x, y: the normal looks back at the origin */
            double phi = 0.3 - 2 * M_PI * k / cases[i].corners;
            double x = cases[i].radius * cos(phi), y = cases[i].radius * sin(phi);
            corners[k][0] = (float)(x * cos(tilt));
            corners[k][1] = (float)y;
            corners[k][2] = (float)(cases[i].distance + x * sin(tilt));
        }
        struct lights l = lights_begin();
        scenes_polygon(l.scene, (const float(*)[3])corners, (uint32_t)cases[i].corners, l.black, 1);
        lights_open(&l);
        double p = fan_p(&l, (const float(*)[3])corners, cases[i].corners, false, &omega);
        if (!(p > CHI2_ALPHA))
            fail_msg("%s: p = %g", cases[i].what, p);
        assert_true(fan_p(&l, (const float(*)[3])corners, cases[i].corners, true, &omega) <
                    CHI2_CAUGHT);
        lights_close(&l);
    }
}

static void directions_to_spheres_and_disks_follow_their_density(void **state) /* H34, H35 */
{
    (void)state;
    static const struct {
        const char *what;
        uint32_t kind;
        float z, radius;
        double power;
    } cases[] = {
        { "sphere", QUADRIC_SPHERE, 2, 1, 1.5 },
        { "sphere, far", QUADRIC_SPHERE, 1e3f, 1, 8 },
        { "sphere, close", QUADRIC_SPHERE, 1.01f, 1, 1 },
        { "sphere, inside", QUADRIC_SPHERE, 0.4f, 1, 1 },
        { "disk", QUADRIC_DISK, -1, 1, 1.5 },
        { "disk, far", QUADRIC_DISK, -3, 1, 2 },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct lights l = lights_begin();
        struct quadric *q = scenes_quadric(l.scene, cases[i].kind, 0, 0, cases[i].z,
                                           cases[i].radius, l.black, 1);
        if (cases[i].kind == QUADRIC_SPHERE && cases[i].z < cases[i].radius)
            q->flags |= QUADRIC_FLIP_NORMAL;
        lights_open(&l);
        struct aim a = { &l, &l.scene->lights[0], 1 };
        expect_density(&a, cases[i].what, (const float[3]){ 0, 0, cases[i].z }, cases[i].power,
                       1e-2);
        lights_close(&l);
    }
}

static void the_density_of_a_sampled_point_is_the_samples(void **state)
{
    (void)state;
    struct lights l = lights_begin();
    static const float quad[4][3] = { { -1, 2, -1 }, { 1, 2, -1 }, { 1, 2, 1 }, { -1, 2, 1 } };
    static const float triangle[3][3] = { { -2, -1, 3 }, { 0, 1, 3 }, { 1, -1, 4 } };
    scenes_quad(l.scene, quad, l.black, 1);
    scenes_polygon(l.scene, triangle, 3, l.black, 1);
    scenes_quadric(l.scene, QUADRIC_SPHERE, -3, 0, 0, 1, l.black, 1);
    scenes_quadric(l.scene, QUADRIC_DISK, 0, -3, -1, 0.5f, l.black, 1);
    for (int i = 0; i < 4; i++) {
        l.scene->lights[i].flags |= LIGHT_TWO_SIDED;
        l.scene->lights[i].pick = 0.1f * (float)(i + 1);
        for (int k = 0; k < 3; k++) /* tells which light a sample is of */
            l.scene->lights[i].radiance[k] = (float)(i + 1);
    }
    lights_open(&l);
    struct random_lanes r = { 77, 0 };
    double share[4] = { 0 }, n = 0, worst = 0;
    for (int i = 0; i < 20000; i++) {
        struct vec3x8 p = random_direction(&r);
        struct light_sample8 s = take_random(l.ks, &p, &r);
        i8 light = i8_from_f8(s.radiance.x) - 1;
        struct vec3x8 y = vec3x8_along(p, s.wi, s.distance), normal;
        for (int lane = 0; lane < LANES; lane++) {
            const struct light *of = &l.scene->lights[light[lane]];
            normal.x[lane] = of->normal[0];
            normal.y[lane] = of->normal[1];
            normal.z[lane] = of->normal[2];
            share[light[lane]] += 1;
            n += 1;
        }
        i8 sphere = light == 2;
        struct vec3x8 out = vec3x8_sub(y, vec3x8_all(-3, 0, 0));
        normal = vec3x8_select(sphere, out, normal);
        f8 pdf = density(l.ks, light, &p, &y, &normal);
        for (int lane = 0; lane < LANES; lane++)
            if (s.valid[lane] && fabs((double)vec3x8_dot(s.wi, normal)[lane]) > 0.02)
                worst = fmax(worst, fabs((double)pdf[lane] / (double)s.pdf[lane] - 1));
    }
    EXPECT_NEAR(worst, 0, 2e-4);
    for (int i = 0; i < 4; i++)
        EXPECT_NEAR(share[i] / n, pick_of(l.ks, (uint32_t)i), 4.5 * sqrt(0.25 / n));
    lights_close(&l);
}

/* ---- vanishing and hostile cases */

static void tiny_solid_angles_keep_their_digits(void **state) /* H34, H38 */
{
    (void)state;
    const double cases[] = { 1e-2, 1e-3, 1e-4 };
    for (int i = 0; i < 3; i++) {
        struct lights l = lights_begin();
        float leg = (float)cases[i];
        const float corners[3][3] = { { 0, 0, 1 }, { 0, leg, 1 }, { leg, 0, 1 } };
        scenes_polygon(l.scene, corners, 3, l.black, 1);
        lights_open(&l);
        struct polygon8 seen;
        polygon_seen(l.ks, FX_ALL, vec3x8_all(0, 0, 0), I8(0), I8(3), &seen);
        double leg2 = (double)leg * (double)leg;
        /* tan(Omega / 2) = det / (|c||b| + ...), for this corner */
        double h = sqrt(1 + leg2), want = 2 * atan2(leg2, h * h + 1 + 2 * h);
        EXPECT_NEAR((double)seen.omega[0] / want, 1, 1e-5);
        lights_close(&l);

        l = lights_begin();
        scenes_quadric(l.scene, QUADRIC_SPHERE, 0, 0, 1, leg, l.black, 1);
        lights_open(&l);
        struct cone8 cone = sphere_cone(vec3x8_all(0, 0, 0), vec3x8_all(0, 0, 1), F8(leg));
        EXPECT_NEAR((double)cone.one_minus_cos[0] / (leg2 / (1 + sqrt(1 - leg2))), 1, 1e-6);
        lights_close(&l);
    }
}

static void light_from_behind_or_edge_on_gives_nothing(void **state) /* H36, H10 */
{
    (void)state;
    struct lights l = lights_begin();
    static const float facing_up[4][3] = { { -1, -1, 0 }, { 1, -1, 0 }, { 1, 1, 0 }, { -1, 1, 0 } };
    static const float line[3][3] = { { 5, 0, 0 }, { 6, 0, 0 }, { 8, 0, 0 } };
    scenes_quad(l.scene, facing_up, l.black, 1);
    scenes_polygon(l.scene, line, 3, l.black, 1);
    for (int k = 0; k < 3; k++)
        l.scene->lights[1].normal[k] = k == 2;
    scenes_quadric(l.scene, QUADRIC_DISK, 0, 0, 0, 1, l.black, 1);
    lights_open(&l);
    struct random_lanes r = { 36, 0 };
    for (int i = 0; i < 20000; i++) {
        /* Below, in the plane beside and within, at a corner, and just above the plane */
        const float heights[] = { -1, 0, 0, 0, 1e-7f, 1e-30f };
        const float sides[] = { 0, 3, 0.5f, 1, 2, 0.25f };
        struct vec3x8 p = vec3x8_all(sides[i % 6], sides[i % 6], heights[i % 6]);
        struct light_sample8 s = take_random(l.ks, &p, &r);
        for (int lane = 0; lane < LANES; lane++) {
            if (!s.valid[lane])
                continue;
            if (heights[i % 6] <= 0)
                fail_msg("a light faces away and gives light, pdf %g", (double)s.pdf[lane]);
            if (!(s.pdf[lane] > 0) || isinf(s.pdf[lane]) || !(fabsf(s.wi.z[lane]) <= 1))
                fail_msg("pdf %g, wi.z %g", (double)s.pdf[lane], (double)s.wi.z[lane]);
        }
    }
    /* Densities at any place are numbers as well */
    for (int i = 0; i < 6000; i++) {
        struct vec3x8 p = vec3x8_all(0.3f, 0.2f, i % 3 == 0 ? 0 : 1e-20f);
        struct vec3x8 y = { random_f8(&r), random_f8(&r), F8(0) }, n = vec3x8_all(0, 0, 1);
        if (i % 2)
            y = p;
        f8 pdf = density(l.ks, I8(i % 3), &p, &y, &n);
        for (int lane = 0; lane < LANES; lane++)
            if (isnan(pdf[lane]) && !(i % 2))
                fail_msg("the density of light %d is not a number", i % 3);
    }
    lights_close(&l);
}

static void delta_lights_fall_off_as_they_should(void **state)
{
    (void)state;
    struct lights l = lights_begin();
    scenes_light(
        l.scene,
        (struct light){ .kind = LIGHT_POINT, .radiance = { 8, 8, 8 }, .position = { 0, 0, 2 } });
    scenes_light(l.scene, (struct light){ .kind = LIGHT_SPOT,
                                          .radiance = { 9, 9, 9 },
                                          .position = { 0, 0, 3 },
                                          .direction = { 0, 0, -1 },
                                          .cos_falloff_start = 0.9f,
                                          .cos_falloff_end = 0.5f });
    scenes_light(l.scene, (struct light){ .kind = LIGHT_DISTANT,
                                          .radiance = { 7, 7, 7 },
                                          .direction = { 0, -1, 0 } });
    lights_open(&l);
    struct vec3x8 p = vec3x8_all(0, 0, 0);
    const double want[3] = { 8.0 / 4, 9.0 / 9, 7 };
    for (int i = 0; i < 3; i++) {
        const f8 u[3] = { F8((float)(i + 0.5) / 3), F8(0.5f), F8(0.5f) };
        struct light_sample8 s = take(l.ks, &p, u);
        assert_true(s.valid[0] && s.delta[0]);
        EXPECT_NEAR(s.radiance.x[0], want[i], 1e-6);
        EXPECT_NEAR(s.pdf[0], 1 / 3.0, 1e-7);
    }
    /* The spot's smoothstep at cos = .7, halfway, and nothing outside its cone or at its tip */
    const f8 u[3] = { F8(0.5f), F8(0), F8(0) };
    struct vec3x8 half = vec3x8_all((float)(3 * sqrt(1 - 0.49) / 0.7), 0, 0);
    struct light_sample8 s = take(l.ks, &half, u);
    EXPECT_NEAR(s.radiance.x[0], 9 * 0.49 / 9 * 0.5, 1e-5);
    struct vec3x8 out = vec3x8_all(100, 0, 0), tip = vec3x8_all(0, 0, 3);
    assert_int_equal(i8_bits(take(l.ks, &out, u).valid), 0);
    assert_int_equal(i8_bits(take(l.ks, &tip, u).valid), 0);
    lights_close(&l);
}

/* Of a delta light the direction is no density's: it is the light's, and so is the distance */
static void delta_lights_shine_from_where_they_are(void **state)
{
    (void)state;
    struct lights l = lights_begin();
    const double at[3] = { 1, -2, 3 }, down[3] = { 0, 0.6, -0.8 };
    struct light spot = { .kind = LIGHT_SPOT,
                          .radiance = { 5, 5, 5 },
                          .cos_falloff_start = 0.8f,
                          .cos_falloff_end = 0.2f };
    for (int k = 0; k < 3; k++) {
        spot.position[k] = (float)at[k];
        spot.direction[k] = (float)down[k];
    }
    scenes_light(l.scene, spot);
    spot.kind = LIGHT_POINT;
    scenes_light(l.scene, spot);
    spot.kind = LIGHT_DISTANT;
    scenes_light(l.scene, spot);
    lights_open(&l);
    struct random_lanes r = { 12, 0 };
    double worst[2] = { 0, 0 }, planted = 0;
    int dark = 0;
    for (int i = 0; i < 30000; i++) {
        struct vec3x8 p = vec3x8_scale(random_direction(&r),
                                       F8((float)pow(10, 3 * random_double(&r) - 1)));
        const f8 u[3] = { F8((float)(i % 3 + 0.5) / 3), random_f8(&r), random_f8(&r) };
        struct light_sample8 s = take(l.ks, &p, u);
        for (int lane = 0; lane < LANES; lane++) {
            const double x[3] = { (double)p.x[lane], (double)p.y[lane], (double)p.z[lane] };
            const double wi[3] = { (double)s.wi.x[lane], (double)s.wi.y[lane],
                                   (double)s.wi.z[lane] };
            double d2 = 0, cosine = 0, off = 0, want = 5;
            for (int k = 0; k < 3; k++)
                d2 += (at[k] - x[k]) * (at[k] - x[k]);
            for (int k = 0; k < 3; k++) {
                double w = i % 3 == 2 ? -down[k] : (at[k] - x[k]) / sqrt(d2);
                cosine -= w * down[k];
                off = fmax(off, fabs(wi[k] - w));
            }
            if (i % 3 < 2)
                want /= d2;
            if (i % 3 == 0) {
                double t = fmin(fmax((cosine - 0.2) / 0.6, 0), 1);
                want *= t * t * (3 - 2 * t);
            }
            if (!s.valid[lane]) { /* outside of the cone, or within a rounding of its rim */
                assert_true(i % 3 == 0 && cosine < 0.2001);
                dark++;
                continue;
            }
            assert_true(s.delta[lane]);
            EXPECT_NEAR(s.pdf[lane], 1 / 3.0, 1e-7);
            if (i % 3 < 2)
                EXPECT_NEAR(s.distance[lane] / sqrt(d2), 1, 1e-5);
            double got = (double)s.radiance.x[lane];
            worst[0] = fmax(worst[0], off);
            if (cosine > 0.21)
                worst[1] = fmax(worst[1], fabs(got / want - 1));
            if (i % 3 == 0 && cosine > 0.25 && cosine < 0.75) /* a falloff that is linear */
                planted = fmax(planted, fabs(5 / d2 * (cosine - 0.2) / 0.6 / want - 1));
        }
    }
    EXPECT_NEAR(worst[0], 0, 2e-6);
    EXPECT_NEAR(worst[1], 0, 2e-3);
    assert_true(planted > 0.1 && dark > 10000);
    lights_close(&l);
}

static void lights_are_chosen_as_often_as_they_say(void **state) /* H42, H46 */
{
    (void)state;
    /* The sky in all places, where nothing may choose it; powers over many orders */
    const uint32_t counts[] = { 1, 2, 3, 5, 8, 9, 100, 4000 };
    for (size_t i = 0; i < sizeof(counts) / sizeof(counts[0]); i++) {
        struct lights l = lights_begin();
        struct random_lanes r = { counts[i], 0 };
        for (uint32_t k = 0; k < counts[i]; k++) {
            bool sky = counts[i] > 1 && k == counts[i] * (counts[i] % 3) / 2 % counts[i];
            float pick = (float)pow(10, -12 * random_double(&r) * (counts[i] > 5));
            scenes_light(l.scene, (struct light){ .kind = sky ? LIGHT_SKY : LIGHT_POINT,
                                                  .radiance = { 1, 1, 1 },
                                                  .pick = pick });
        }
        lights_open(&l);
        light_tree_close(&l.ks->light_tree); /* which has its own test: here the table is meant */
        static unsigned hits[SCENES_CAPACITY];
        memset(hits, 0, sizeof(hits));
        for (unsigned k = 0; k < 1u << 24; k += 8) {
            f8 u;
            for (unsigned lane = 0; lane < LANES; lane++)
                u[lane] = (float)(k + lane) * 0x1p-24f;
            i8 light = choice(l.ks, u);
            for (int lane = 0; lane < LANES; lane++)
                hits[light[lane]]++;
        }
        for (uint32_t k = 0; k < counts[i]; k++) {
            double says = pick_of(l.ks, k);
            double does = hits[k] * 0x1p-24;
            bool sky = l.scene->lights[k].kind == LIGHT_SKY;
            if (sky ? does > 0 || says > 0 : !(does > 0))
                fail_msg("%u lights: light %u is chosen with %g, says %g", counts[i], k, does,
                         says);
            /* Numbers come in steps of 2^-24, and so do choices */
            if (fabs(does - says) > 0x1p-23)
                fail_msg("%u lights: light %u says %g and is chosen with %g", counts[i], k, says,
                         does);
        }
        lights_close(&l);
    }
}

static void a_light_said_to_have_no_power_is_chosen_still(void **state) /* H46 */
{
    (void)state;
    for (int bright = 0; bright < 2; bright++) { /* beside one that has some, and beside none */
        struct lights l = lights_begin();
        for (int k = 0; k < 2; k++)
            scenes_light(l.scene, (struct light){ .kind = LIGHT_POINT, .radiance = { 1, 1, 1 } });
        scenes_finish(l.scene);
        l.scene->lights[0].pick = (float)bright;
        l.scene->lights[1].pick = 0;
        l.ks = scenes_open(l.scene, (struct picture_how){ 0 });
        EXPECT_NEAR(pick_of(l.ks, 1), bright ? 0.25 : 0.5, 1e-6);
        assert_int_equal(choice(l.ks, F8(0.9f))[0], 1);
        lights_close(&l);
    }
}

static void two_techniques_share_one_weight(void **state) /* H45 */
{
    (void)state;
    const float densities[] = { 1e-30f, 1e-20f, 1e-3f, 1, 0.75f, 1e3f, 1e20f, 1e30f };
    for (int i = 0; i < 8; i++)
        for (int k = 0; k < 8; k++) {
            float own = densities[i], other = densities[k];
            float sum = mis_weight(F8(own), F8(other))[0] + mis_weight(F8(other), F8(own))[0];
            EXPECT_NEAR((double)sum, 1, 4 * 0x1p-24);
        }
    assert_true(mis_weight(F8(2), F8(0))[0] == 1);
    assert_true(mis_weight(F8(2), F8(__builtin_inff()))[0] == 0);
    assert_true(mis_weight(F8(__builtin_inff()), F8(2))[0] == 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(squares_have_their_form_factors),
        cmocka_unit_test(facing_and_adjacent_squares_exchange_what_they_must),
        cmocka_unit_test(triangles_light_as_lambert_says),
        cmocka_unit_test(fans_of_triangles_light_as_lambert_says),
        cmocka_unit_test(disks_have_their_form_factors),
        cmocka_unit_test(spheres_light_also_when_the_horizon_cuts_them),
        cmocka_unit_test(a_wall_lights_the_floor_it_touches),
        cmocka_unit_test(directions_to_polygons_are_uniform_in_solid_angle),
        cmocka_unit_test(directions_to_spheres_and_disks_follow_their_density),
        cmocka_unit_test(the_density_of_a_sampled_point_is_the_samples),
        cmocka_unit_test(tiny_solid_angles_keep_their_digits),
        cmocka_unit_test(light_from_behind_or_edge_on_gives_nothing),
        cmocka_unit_test(delta_lights_fall_off_as_they_should),
        cmocka_unit_test(delta_lights_shine_from_where_they_are),
        cmocka_unit_test(lights_are_chosen_as_often_as_they_say),
        cmocka_unit_test(a_light_said_to_have_no_power_is_chosen_still),
        cmocka_unit_test(two_techniques_share_one_weight),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
