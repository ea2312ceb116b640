/*
 * Instances and motion: what stands in several places looks as if it were copied there, whatever
 * the transform; rays that leave it do not meet it again; and what moves is where it should be at
 * each moment. H numbers are those of the numerics notes, section 2.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/hit.h"
#include "worker/kernel/instance.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* ---- scenes */

typedef double matrix[3][4];

/* Every kind of map: rigid, stretched, sheared, mirrored, tiny, far */
static const struct {
    const char *name;
    matrix m;
} maps[] = {
    { "nowhere else", { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } } },
    { "moved", { { 1, 0, 0, 4 }, { 0, 1, 0, -8 }, { 0, 0, 1, 2 } } },
    { "turned", { { .8, -.6, 0, 1 }, { .48, .64, -.6, 2 }, { .36, .48, .8, 3 } } },
    { "stretched", { { 3, 0, 0, 1 }, { 0, .1, 0, 2 }, { 0, 0, 1, 3 } } },
    { "sheared", { { 1, 2, -1, .5 }, { 0, 1, 3, .25 }, { 0, 0, 1, -2 } } },
    { "mirrored", { { -1, 0, 0, 1 }, { 0, 1.5, .5, 0 }, { 0, 0, 1, 5 } } },
    { "tiny", { { 1e-4, 0, 0, 1 }, { 0, 1e-4, 0, 2 }, { 0, 0, 2e-4, 3 } } },
    { "huge", { { 1e4, 0, 2e3, 1 }, { 0, 1e4, 0, 2 }, { 0, 3e3, 2e4, 3 } } },
    { "far", { { 1, .5, 0, 1e6 }, { -.5, 1, 0, -1e6 }, { 0, 0, 1, 1e6 } } },
};
#define MAPS (sizeof(maps) / sizeof(maps[0]))

#define SOUP 200

/* Random triangles in a group, about `at` in its own space, and one instance of it */
static struct scene *soup(const double m[3][4], float at)
{
    struct scene *scene = scenes_begin(1, 1);
    uint32_t white = scenes_diffuse(scene, 0.5f);
    struct random_lanes r = { 3, 0 };
    scenes_group_begin(scene);
    for (int i = 0; i < SOUP; i++) {
        float corners[3][3];
        double size = pow(10, -2 * random_double(&r)), middle[3];
        for (int axis = 0; axis < 3; axis++)
            middle[axis] = 2 * random_double(&r) - 1;
        for (int k = 0; k < 3; k++)
            for (int axis = 0; axis < 3; axis++)
                corners[k][axis] = at + (float)(middle[axis] + size * (random_double(&r) - 0.5));
        scenes_polygon(scene, (const float(*)[3])corners, 3, white, 0);
    }
    scenes_group_end(scene);
    scenes_place(scene, 0, m);
    scenes_finish(scene);
    return scene;
}

/* ---- rays */

/* As the path kernel does it; `object` is the surface before it came back to the world */
static __attribute__((noinline)) struct surface8 surface(const struct kernel_scene *ks,
                                                         const struct scenes_hit *found,
                                                         struct vec3x8 o, struct vec3x8 d, f8 time,
                                                         struct surface8 *object)
{
    i8 inside = found->instance != -1;
    struct hit_corners8 corners = hit_corners(ks, FX_ALL, found->hit, found->geometry, found->prim);
    struct pose8 pose = instance_pose(ks->scene, FX_ALL, false, found->instance & inside, time);
    instance_enter(inside, &pose, &o, &d);
    struct surface8 s = hit_surface(ks, FX_ALL, found->hit, found->geometry, found->prim, &corners,
                                    o, d, found->t);
    *object = s;
    instance_leave(inside, FX_ALL, &pose, &s);
    return s;
}

/* Rays about the soup in object space, through the map into the world, in double */
static void aim(struct random_lanes *r, const double m[3][4], float at, struct vec3x8 *o,
                struct vec3x8 *d)
{
    struct vec3x8 from = vec3x8_scale(random_direction(r), F8(2)), to = random_direction(r);
    float world[2][3][LANES];
    for (int lane = 0; lane < LANES; lane++) {
        const double a[3] = { (double)from.x[lane] + (double)at, (double)from.y[lane] + (double)at,
                              (double)from.z[lane] + (double)at };
        const double b[3] = { 0.5 * (double)to.x[lane] + (double)at - a[0],
                              0.5 * (double)to.y[lane] + (double)at - a[1],
                              0.5 * (double)to.z[lane] + (double)at - a[2] };
        double way[3], length2 = 0;
        for (int i = 0; i < 3; i++) {
            world[0][i][lane] = (float)(m[i][0] * a[0] + m[i][1] * a[1] + m[i][2] * a[2] + m[i][3]);
            way[i] = m[i][0] * b[0] + m[i][1] * b[1] + m[i][2] * b[2];
            length2 += way[i] * way[i];
        }
        for (int i = 0; i < 3; i++)
            world[1][i][lane] = (float)(way[i] / sqrt(length2));
    }
    *o = (struct vec3x8){ f8_load(world[0][0]), f8_load(world[0][1]), f8_load(world[0][2]) };
    *d = (struct vec3x8){ f8_load(world[1][0]), f8_load(world[1][1]), f8_load(world[1][2]) };
}

/* ---- instances */

static void points_and_normals_are_those_of_a_flattened_copy(void **state) /* H14 */
{
    (void)state;
    double worst_wrong_normal = 0;
    for (size_t i = 0; i < MAPS; i++) {
        const double(*m)[4] = maps[i].m;
        struct scene *scene = soup(m, 0);
        struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
        struct random_lanes r = { 5, 0 };
        unsigned hits = 0;
        for (int round = 0; round < 4000; round++) {
            struct vec3x8 o, d;
            struct surface8 object;
            aim(&r, m, 0, &o, &d);
            struct scenes_hit found = scenes_intersect(ks, o, d, 0, INFINITY, F8(0));
            struct surface8 s = surface(ks, &found, o, d, F8(0), &object);
            for (int lane = 0; lane < LANES; lane++) {
                if (!found.hit[lane])
                    continue;
                hits++;
                /* The triangle's corners and plane in the world, in double */
                const struct mesh *mesh = &scene->meshes[found.geometry[lane]];
                const uint32_t *t = scene->triangles + 3 * mesh->first_triangle;
                double p[3][3], e[2][3], n[3], length = 0, off = 0, size = 0, agree = 0;
                for (int k = 0; k < 3; k++)
                    for (int axis = 0; axis < 3; axis++) {
                        const float *v = scene->positions + 3 * t[k];
                        p[k][axis] = m[axis][0] * (double)v[0] + m[axis][1] * (double)v[1] +
                                     m[axis][2] * (double)v[2] + m[axis][3];
                        size = fmax(size, fabs(p[k][axis]));
                    }
                for (int axis = 0; axis < 3; axis++)
                    for (int k = 0; k < 2; k++)
                        e[k][axis] = p[k + 1][axis] - p[0][axis];
                double det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                             m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                             m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
                for (int axis = 0; axis < 3; axis++) {
                    int a = (axis + 1) % 3, b = (axis + 2) % 3;
                    n[axis] = (e[0][a] * e[1][b] - e[0][b] * e[1][a]) * (det < 0 ? -1 : 1);
                    length += n[axis] * n[axis];
                }
                const f8 point[3] = { s.p.x, s.p.y, s.p.z }, normal[3] = { s.ng.x, s.ng.y, s.ng.z };
                for (int axis = 0; axis < 3; axis++) {
                    off += n[axis] / sqrt(length) * ((double)point[axis][lane] - p[0][axis]);
                    agree += n[axis] / sqrt(length) * (double)normal[axis][lane];
                }
                /* In its plane to less than half of what a ray starts above it, and one normal */
                if (fabs(off) > 0.5 * (double)s.spawn[lane])
                    fail_msg("%s: a point is %g off its plane, spawn %g, size %g", maps[i].name,
                             off, (double)s.spawn[lane], size);
                if (!(agree > 1 - 2e-5))
                    fail_msg("%s: a normal deviates by %g", maps[i].name, 1 - agree);
                /* Planted: a normal taken along like a direction */
                const double w[3] = { (double)object.ng.x[lane], (double)object.ng.y[lane],
                                      (double)object.ng.z[lane] };
                double dot = 0, w2 = 0;
                for (int axis = 0; axis < 3; axis++) {
                    double v = m[axis][0] * w[0] + m[axis][1] * w[1] + m[axis][2] * w[2];
                    dot += v * n[axis] / sqrt(length);
                    w2 += v * v;
                }
                worst_wrong_normal = fmax(worst_wrong_normal, 1 - dot / sqrt(w2));
            }
        }
        if (hits < 3000)
            fail_msg("%s: %u hits", maps[i].name, hits);
        kernel_close(ks);
        scene_free(scene);
    }
    assert_true(worst_wrong_normal > 0.1);
}

static void rays_that_leave_an_instance_do_not_meet_it_again(void **state) /* H1 */
{
    (void)state;
    unsigned planted = 0;
    for (size_t i = 0; i < MAPS; i++)
        for (int away = 0; away < 2; away++) {
            float at = away ? 1000 : 0; /* of the group's own origin */
            struct scene *scene = soup(maps[i].m, at);
            struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
            struct random_lanes r = { 7, 0 };
            unsigned again = 0, total = 0;
            for (int round = 0; round < 12500; round++) {
                struct vec3x8 o, d, out = random_direction(&r);
                struct surface8 object;
                aim(&r, maps[i].m, at, &o, &d);
                struct scenes_hit found = scenes_intersect(ks, o, d, 0, INFINITY, F8(0));
                struct surface8 s = surface(ks, &found, o, d, F8(0), &object);
                f8 side = vec3x8_dot(out, s.ng);
                struct vec3x8 start = vec3x8_along(s.p, s.ng, f8_mulsign(s.spawn, side));
                struct scenes_hit next = scenes_intersect(ks, start, out, 0, INFINITY, F8(0));
                again += (unsigned)__builtin_popcount(
                    i8_bits(found.hit & next.hit & (next.geometry == found.geometry)));
                total += (unsigned)__builtin_popcount(i8_bits(found.hit));
                /* Planted: only the rounding in the group's own space */
                start = vec3x8_along(s.p, s.ng, f8_mulsign(object.spawn, side));
                next = scenes_intersect(ks, start, out, 0, INFINITY, F8(0));
                planted += (unsigned)__builtin_popcount(
                    i8_bits(found.hit & next.hit & (next.geometry == found.geometry)));
            }
            if (again > 0 || total < 8000)
                fail_msg("%s: %u of %u rays hit again", maps[i].name, again, total);
            kernel_close(ks);
            scene_free(scene);
        }
    assert_true(planted > 0);
}

/* A floor, a light, and an object of a triangle pair and a ball, three times: as instances or as
 * copies in the world */
static struct scene *room(bool instanced, bool moving)
{
    struct scene *scene = scenes_begin(64, 64);
    uint32_t white = scenes_diffuse(scene, 0.7f), grey = scenes_diffuse(scene, 0.4f);
    const float floor[4][3] = { { -5, -1, 1 }, { -5, -1, 9 }, { 5, -1, 9 }, { 5, -1, 1 } };
    const float lamp[4][3] = { { -1, 3, 4 }, { 1, 3, 4 }, { 1, 3, 6 }, { -1, 3, 6 } };
    scenes_quad(scene, floor, white, 0);
    scenes_quad(scene, lamp, grey, 8);
    scenes_sky(scene, 0.2f);
    static const matrix at[3] = { { { 1, 0, 0, -2 }, { 0, 1, 0, 0 }, { 0, 0, 1, 4 } },
                                  { { -1, .5, 0, 0 }, { 0, 1.5, 0, 0 }, { 0, 0, 1, 5 } },
                                  { { .5, 0, .5, 2 }, { 0, 1, 0, .25 }, { -.5, 0, .5, 4 } } };
    const float sheet[4][3] = {
        { -1, -.5f, 0 }, { -1, 1, .5f }, { 0, 1, .25f }, { 0, -.5f, -.25f }
    };
    if (instanced)
        scenes_group_begin(scene);
    for (int copy = 0; copy < (instanced ? 1 : 3); copy++) {
        matrix m = { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } }, inverse;
        if (!instanced)
            memcpy(m, at[copy], sizeof(m));
        scenes_invert((const double(*)[4])m, inverse);
        float corners[4][3];
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < 3; i++)
                corners[k][i] = (float)(m[i][0] * (double)sheet[k][0] +
                                        m[i][1] * (double)sheet[k][1] +
                                        m[i][2] * (double)sheet[k][2] + m[i][3]);
        scenes_quad(scene, (const float(*)[3])corners, grey, 0);
        if (!instanced && copy == 1) /* mirrored: the corners go the other way round */
            scene->meshes[scene->mesh_count - 1].flags = MESH_FLIP_NORMAL;
        struct quadric *q = scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 0, 0.5f, white, 0);
        for (int i = 0; i < 3; i++) {
            q->center[i] = (float)(m[i][0] * .5 + m[i][3]);
            for (int j = 0; j < 3; j++) {
                q->to_world[3 * i + j] = (float)m[i][j];
                q->to_object[3 * i + j] = (float)inverse[i][j];
            }
        }
        q->flags = 0;
    }
    if (instanced) {
        scenes_group_end(scene);
        for (int i = 0; i < 3; i++)
            scenes_place(scene, 0, at[i]);
    }
    if (moving) /* far from what is seen */
        scenes_place(scene, 0, at[0])->motion = scenes_glide(scene, 0, 500, 0);
    if (moving)
        scene->motions[0].translation[0][1] = 500;
    scenes_finish(scene);
    for (int axis = 0; axis < 3; axis++) {
        scene->settings.bounds_min[axis] = -10;
        scene->settings.bounds_max[axis] = 10;
    }
    return scene;
}

static void an_instanced_scene_looks_like_its_flattened_copy(void **state)
{
    (void)state;
    struct err err = { .code = ERR_OK };
    struct scene *instanced = room(true, false), *flat = room(false, false);
    assert_true((instanced->settings.effects & FX_INSTANCE) != 0);
    assert_true((flat->settings.effects & FX_INSTANCE) == 0);
    if (!scene_check(instanced, &err))
        fail_msg("%s", err.text);
    struct picture *a = picture_take(instanced, (struct picture_how){ .samples = 32 });
    struct picture *b = picture_take(flat, (struct picture_how){ .samples = 32 });
    /* The same numbers meet the same surfaces but for rounding: nearly every pixel is equal */
    unsigned differ = 0;
    for (size_t i = 0; i < 3 * (size_t)a->width * a->height; i++)
        differ += fabsf(a->rgb[i] - b->rgb[i]) > 1e-3f * fabsf(b->rgb[i]);
    if (differ > 3 * 64 * 64 / 500)
        fail_msg("%u of %d values differ", differ, 3 * 64 * 64);
    EXPECT_NEAR(a->mean, b->mean, 2e-4 * b->mean);
    assert_int_equal(a->failed, 0);

    /* Planted: one transform and its inverse are not of each other */
    instanced->instances[1].to_object[3] += 0.05f;
    assert_false(scene_check(instanced, &err));
    struct picture *wrong = picture_take(instanced, (struct picture_how){ .samples = 32 });
    unsigned planted = 0;
    for (size_t i = 0; i < 3 * (size_t)a->width * a->height; i++)
        planted += fabsf(wrong->rgb[i] - b->rgb[i]) > 1e-3f * fabsf(b->rgb[i]);
    assert_true(planted > 3 * 64 * 64 / 50);
    picture_free(a);
    picture_free(b);
    picture_free(wrong);
    scene_free(instanced);
    scene_free(flat);
}

static void lanes_and_motion_elsewhere_change_no_bit(void **state) /* H18 */
{
    (void)state;
    struct scene *still = room(true, false), *moving = room(true, true);
    assert_true((moving->settings.effects & FX_MOTION) != 0);
    /* The bounds, which the distance to the sky comes from, are the same */
    struct picture *a = picture_take(still, (struct picture_how){ .samples = 8 });
    struct picture *one = picture_take(still, (struct picture_how){ .samples = 8, .lanes = 1 });
    struct picture *b = picture_take(moving, (struct picture_how){ .samples = 8 });
    struct picture *c = picture_take(moving, (struct picture_how){ .samples = 8, .lanes = 1 });
    assert_true(picture_same(a, one));
    assert_true(picture_same(a, b));
    assert_true(picture_same(b, c));
    picture_free(a);
    picture_free(one);
    picture_free(b);
    picture_free(c);
    scene_free(still);
    scene_free(moving);
}

/* ---- motion */

/*
 * A black sheet one unit wide glides over a white sky: a column is dark for as long as the sheet is
 * before it. At z = 1 the view is 2 wide; the sheet's left edge goes from -1 to 0.5.
 */
static void a_gliding_sheet_covers_each_column_for_its_time(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(32, 16);
    uint32_t black = scenes_diffuse(scene, 0);
    const float sheet[4][3] = { { -1, -2, 1 }, { -.5f, -2, 1 }, { -.5f, 2, 1 }, { -1, 2, 1 } };
    scenes_sky(scene, 1);
    scenes_group_begin(scene);
    scenes_quad(scene, sheet, black, 0);
    scenes_group_end(scene);
    scenes_place(scene, 0, maps[0].m)->motion = scenes_glide(scene, 1.5f, 0, 0);
    scenes_finish(scene);
    const uint32_t samples = 256;
    for (int planted = 0; planted < 2; planted++) {
        if (planted) /* the shutter closes a little early */
            scene->settings.shutter[1] = 0.97f;
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = samples });
        double worst = 0;
        for (unsigned column = 0; column < p->width; column++) {
            double seen = 0, x = 0, want = 0;
            for (unsigned row = 0; row < p->height; row++)
                seen += (double)p->rgb[3 * (row * p->width + column)] / samples / p->height;
            /* Mean over the column of the time not covered */
            for (int k = 0; k < 1000; k++) {
                x = -1 + 2 * (column + (k + 0.5) / 1000) / p->width;
                double from = fmax(0, (x + 0.5) / 1.5), to = fmin(1, (x + 1) / 1.5);
                want += (1 - fmax(0, to - from)) / 1000;
            }
            worst = fmax(worst, fabs(seen - want));
        }
        if (planted ? worst < 0.01 : worst > 0.004)
            fail_msg("a column is %g off%s", worst, planted ? " with the bug" : "");
        assert_int_equal(p->failed, 0);
        picture_free(p);
    }
    scene_free(scene);
}

static void a_pose_is_its_keys_at_both_ends_and_a_turn_between(void **state) /* H18 */
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    double angle = 2.0; /* of the turn about z */
    struct motion *m = &scene->motions[scene->motion_count++];
    *m = (struct motion){
        .translation = { { 1, 2, 3 }, { -1, 5, 7 } },
        .rotation = { { 0, 0, 0, 1 }, { 0, 0, (float)sin(angle / 2), (float)cos(angle / 2) } },
        .stretch = { { 1, 0, 0, 0, 2, 0, 0, 0, 1 }, { -3, 0, 0, 0, 1, 0, 0, 0, 1 } },
        .angle = (float)(angle / 2)
    };
    m->stretch[0][0] = -1; /* mirrored at both ends */
    for (int i = 0; i <= 100; i++) {
        double s = i / 100.0;
        struct pose8 pose = motion_pose(scene, false, I8(0), F8((float)s));
        double c = cos(angle * s), n = sin(angle * s), sx = -1 - 2 * s, sy = 2 - s;
        const double want[12] = { c * sx, -n * sy,   0, 1 - 2 * s, n * sx, c * sy,
                                  0,      2 + 3 * s, 0, 0,         1,      3 + 4 * s };
        const struct rows8 *r = &pose.to_world;
        const float got[12] = { r->x.x[0], r->x.y[0], r->x.z[0], r->add.x[0],
                                r->y.x[0], r->y.y[0], r->y.z[0], r->add.y[0],
                                r->z.x[0], r->z.y[0], r->z.z[0], r->add.z[0] };
        for (int k = 0; k < 12; k++)
            EXPECT_NEAR(got[k], want[k], 2e-6);
        if (i == 0 || i == 100)
            for (int k = 3; k < 12; k += 4)
                assert_true(got[k] == m->translation[i / 100][k / 4]);
        /* There and back */
        struct vec3x8 p = vec3x8_all(0.3f, -2, 5);
        struct vec3x8 back = rows8_point(&pose.to_object, rows8_point(&pose.to_world, p));
        EXPECT_NEAR(vec3x8_max_abs(vec3x8_sub(back, p))[0], 0, 1e-5);
    }
    scene_free(scene);
}

/* Keys that a sum loses: (1 - s) a + s b is exactly b at the end, a + s (b - a) is not */
static void the_ends_of_a_motion_are_its_keys_to_the_bit(void **state) /* H18 */
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    struct motion *m = &scene->motions[scene->motion_count++];
    *m = (struct motion){ .translation = { { 1, 1e8f, -3 }, { 1e-9f, 0.1f, 1e7f } },
                          .rotation = { { 0, 0, 0, 1 }, { 0, 0, 0, 1 } },
                          .stretch = { { 1, 0, 0, 0, 1e6f, 0, 0, 0, 3 },
                                       { 1e-9f, 0, 0, 0, 0.7f, 0, 0, 0, 1 } } };
    bool planted = false;
    for (int end = 0; end < 2; end++) {
        struct pose8 pose = motion_pose(scene, false, I8(0), F8((float)end));
        const struct rows8 *r = &pose.to_world;
        const float moved[3] = { r->add.x[0], r->add.y[0], r->add.z[0] };
        const float stretched[3] = { r->x.x[0], r->y.y[0], r->z.z[0] };
        for (int k = 0; k < 3; k++) {
            const float *t[2] = { &m->translation[0][k], &m->translation[1][k] };
            assert_true(moved[k] == *t[end]);
            assert_true(stretched[k] == m->stretch[end][4 * k]);
            planted |= *t[0] + (float)end * (*t[1] - *t[0]) != *t[end];
        }
    }
    assert_true(planted);
    /* The last number below 1 is within its share of the end */
    struct pose8 pose = motion_pose(scene, false, I8(0), F8(0x1.fffffep-1f));
    EXPECT_NEAR(pose.to_world.add.z[0], 1e7, 2);
    scene_free(scene);
}

/* The box that Embree was given holds the shape at every moment: rays find what is there */
static void rays_of_any_time_find_what_turns(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t white = scenes_diffuse(scene, 0.5f);
    scenes_group_begin(scene);
    scenes_quadric(scene, QUADRIC_SPHERE, 3, 0, 0, 0.25f, white, 0);
    scenes_group_end(scene);
    scenes_place(scene, 0, maps[0].m)->motion = scenes_glide(scene, 0, 0, 0);
    struct motion *m = &scene->motions[0];
    m->rotation[1][2] = 1; /* half a turn about z */
    m->rotation[1][3] = 0;
    m->angle = 1.57079632679f;
    scenes_finish(scene);
    struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
    struct random_lanes r = { 11, 0 };
    unsigned again = 0;
    for (int i = 0; i < 20000; i++) {
        f8 time = random_f8(&r);
        struct vec3x8 middle;
        for (int lane = 0; lane < LANES; lane++) {
            middle.x[lane] = (float)(3 * cos(3.14159265358979 * (double)time[lane]));
            middle.y[lane] = (float)(3 * sin(3.14159265358979 * (double)time[lane]));
            middle.z[lane] = 0;
        }
        struct vec3x8 d = random_direction(&r), o = vec3x8_sub(middle, d);
        struct scenes_hit found = scenes_intersect(ks, o, d, 0, INFINITY, time);
        if (i8_bits(found.hit) != 255)
            fail_msg("round %d: %x hit", i, i8_bits(found.hit));
        struct surface8 object, s = surface(ks, &found, o, d, time, &object);
        f8 radius = f8_sqrt(vec3x8_length2(vec3x8_sub(s.p, middle)));
        EXPECT_NEAR(radius[i % 8], 0.25, 4e-6);
        struct vec3x8 out = random_direction(&r);
        f8 side = vec3x8_dot(out, s.ng);
        struct scenes_hit next = scenes_intersect(ks, vec3x8_along(s.p, s.ng, s.spawn), out, 0,
                                                  INFINITY, time);
        again += (unsigned)__builtin_popcount(i8_bits(next.hit & (side > 0)));
    }
    assert_int_equal(again, 0);
    kernel_close(ks);
    scene_free(scene);
}

/* ---- what is refused */

static void instances_that_make_no_sense_are_refused(void **state)
{
    (void)state;
    struct err err;
    static const struct {
        const char *name, *says;
    } rows[] = {
        { "group", "no group" },
        { "motion", "no motion" },
        { "inverse", "not inverse" },
        { "nan", "not finite" },
        { "gap", "does not follow" },
        { "beyond", "beyond the arrays" },
        { "behind", "behind the last" },
        { "emits", "emits" },
        { "shutter", "the shutter is open" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = room(true, false);
        err = (struct err){ .code = ERR_OK };
        assert_true(scene_check(scene, &err));
        switch (i) {
        case 0:
            scene->instances[1].group = 1;
            break;
        case 1:
            scene->instances[1].motion = 1;
            break;
        case 2:
            scene->instances[1].to_world[0] *= 1.001f;
            break;
        case 3:
            scene->instances[1].to_world[5] = NAN;
            break;
        case 4:
            scene->groups[scene->group_count++] = (struct group){ 0, 0, 0, 0 };
            break;
        case 5:
            scene->groups[0].mesh_count++;
            break;
        case 6:
            scene->groups[0].quadric_count--;
            break;
        case 7:
            scene->meshes[scene->mesh_count - 1].first_emissive = 0;
            break;
        default:
            scene->settings.shutter[1] = -1;
            break;
        }
        scene->settings.effects = scene_effects(scene);
        assert_false(scene_check(scene, &err));
        if (strstr(err.text, rows[i].says) == NULL)
            fail_msg("%s: %s", rows[i].name, err.text);
        scene_free(scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_and_normals_are_those_of_a_flattened_copy),
        cmocka_unit_test(rays_that_leave_an_instance_do_not_meet_it_again),
        cmocka_unit_test(an_instanced_scene_looks_like_its_flattened_copy),
        cmocka_unit_test(lanes_and_motion_elsewhere_change_no_bit),
        cmocka_unit_test(a_gliding_sheet_covers_each_column_for_its_time),
        cmocka_unit_test(a_pose_is_its_keys_at_both_ends_and_a_turn_between),
        cmocka_unit_test(the_ends_of_a_motion_are_its_keys_to_the_bit),
        cmocka_unit_test(rays_of_any_time_find_what_turns),
        cmocka_unit_test(instances_that_make_no_sense_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
