/*
 * The path kernels as a whole: closed scenes with known radiance, the same bits however they are
 * made, and the bookkeeping of what was cut and what went wrong. H numbers are those of the
 * numerics notes, section 2. Runs for about ten seconds.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };

static struct material glass(float alpha)
{
    return (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f, .alpha = { alpha, alpha } };
}

static struct scene *furnace(float rho, float Le, const float shift[3])
{
    struct scene *scene = scenes_begin(32, 32);
    float a[3], b[3];
    for (int axis = 0; axis < 3; axis++) {
        a[axis] = low[axis] + shift[axis];
        b[axis] = high[axis] + shift[axis];
        scene->settings.camera.position[axis] = shift[axis] + 0.1f;
    }
    scenes_box(scene, a, b, scenes_diffuse(scene, rho), Le);
    scenes_finish(scene);
    return scene;
}

/* A box with one small light, balls inside, and whatever materials are asked for */
static struct scene *room(struct material first, struct material second, uint32_t width,
                          uint32_t height)
{
    struct scene *scene = scenes_begin(width, height);
    uint32_t white = scenes_diffuse(scene, 0.6f);
    scenes_room(scene, white, white);
    if (first.kind != MATERIAL_DIFFUSE)
        scenes_quadric(scene, QUADRIC_SPHERE, -0.4f, -0.6f, 0.2f, 0.35f,
                       scenes_material(scene, first), 0);
    static const float flag[3][3] = { { 0.1f, -0.8f, 0.2f },
                                      { 0.8f, -0.7f, 0.4f },
                                      { 0.4f, 0.1f, 0.3f } };
    scenes_polygon(scene, flag, 3, scenes_material(scene, second), 0);
    return scene;
}

static void a_closed_furnace_has_its_radiance(void **state)
{
    (void)state;
    const float rhos[] = { 0, 0.5f, 0.8f };
    const float nowhere[3] = { 0, 0, 0 };
    for (int i = 0; i < 3; i++) {
        struct scene *scene = furnace(rhos[i], 1, nowhere);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64 });
        double want = 1 / (1 - (double)rhos[i]);
        if (picture_z(p, want) > 4.5)
            fail_msg("rho %g: %.6g, want %g, z = %g", (double)rhos[i], p->mean, want,
                     picture_z(p, want));
        if (i > 0) /* planted: an albedo 1 % too small */
            assert_true(picture_z(p, 1 / (1 - 0.99 * (double)rhos[i])) > 8);
        assert_int_equal(p->failed, 0);
        assert_int_equal(p->stats.truncated_paths, 0);
        picture_free(p);
        scene_free(scene);
    }
}

static void a_depth_limit_is_exact_and_counts_what_it_cuts(void **state) /* H47, H50 */
{
    (void)state;
    const float nowhere[3] = { 0, 0, 0 };
    for (uint32_t depth = 0; depth < 5; depth++) {
        struct scene *scene = furnace(0.8f, 1, nowhere);
        scene->settings.max_depth = depth;
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64 });
        double want = (1 - pow(0.8, depth + 1)) / 0.2;
        if (picture_z(p, want) > 4.5)
            fail_msg("depth %u: %g, want %g", depth, p->mean, want);
        /* Roulette keeps the expected energy: rho^depth of what set out */
        double cut = p->stats.truncated_energy / (double)p->stats.samples;
        EXPECT_NEAR(cut, pow(0.8, depth), 4.5 * sqrt(1.0 / (double)p->stats.samples));
        assert_true(p->stats.truncated_paths > 0);
        picture_free(p);
        scene_free(scene);
    }
}

static void roulette_keeps_the_second_moment(void **state) /* H47, H48, H49 */
{
    (void)state;
    const float nowhere[3] = { 0, 0, 0 };
    const float rhos[] = { 0.9f, 0.98f };
    for (int i = 0; i < 2; i++) {
        double rho = (double)rhos[i];
        struct scene *scene = furnace(rhos[i], 1, nowhere);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 1, .leaves = 32 });
        /* Survival with probability rho alone gives rho / (1 - rho)^2; a cap at .95 has no bound
         * beyond rho = .9747 */
        double bound = rho / ((1 - rho) * (1 - rho));
        if (!(p->variance <= 1.2 * bound))
            fail_msg("rho %g: variance %g, roulette alone has %g", rho, p->variance, bound);
        assert_true(picture_z(p, 1 / (1 - rho)) < 4.5);
        picture_free(p);
        scene_free(scene);
    }
}

static void the_furnace_is_the_same_far_from_the_origin(void **state) /* H2 */
{
    (void)state;
    /* At 1e4 rays start 1e-2 off their walls: nothing of this box of 2 gets out */
    const float shifts[][3] = { { 1e2f, 0, 0 }, { -1e3f, 2e3f, 500 }, { 1e4f, 1e4f, -1e4f } };
    for (int i = 0; i < 3; i++) {
        struct scene *scene = furnace(0.5f, 1, shifts[i]);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64 });
        if (picture_z(p, 2) > 4.5)
            fail_msg("shifted by %g: %g, z = %g", (double)shifts[i][0], p->mean, picture_z(p, 2));
        picture_free(p);
        scene_free(scene);
    }
}

static void nothing_leaks_out_of_a_dark_box(void **state) /* H2, H7 */
{
    (void)state;
    const float scales[] = { 1e-3f, 1, 1e3f };
    for (int i = 0; i < 3; i++) {
        struct scene *scene = scenes_begin(64, 64);
        float a[3], b[3];
        for (int axis = 0; axis < 3; axis++) {
            a[axis] = -scales[i];
            b[axis] = scales[i];
        }
        scenes_box(scene, a, b, scenes_diffuse(scene, 0.9f), 0);
        scenes_sky(scene, 1);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 16 });
        EXPECT_NEAR(p->largest, 0, 0);
        assert_true(p->stats.events > 10 * p->stats.samples / 2);
        picture_free(p);
        scene_free(scene);
    }
}

static void every_variant_gives_the_bits_of_everything(void **state)
{
    (void)state;
    const struct material plain = { .reflectance = { 0.5f, 0.4f, 0.3f } };
    const struct material metal = { .kind = MATERIAL_CONDUCTOR,
                                    .eta = { 0.2f, 0.9f, 1.1f },
                                    .k = { 3.9f, 2.4f, 2.1f } };
    const struct material coat = { .kind = MATERIAL_COAT,
                                   .ior = 1.5f,
                                   .alpha = { 0.2f, 0.2f },
                                   .reflectance = { 0.5f, 0.4f, 0.3f },
                                   .coat_inner = 0.6f,
                                   .coat_scale = 0.14f };
    const struct {
        const char *variant;
        struct material first, second;
    } cases[] = {
        { "lambert", plain, plain },
        { "glass_and_metal", glass(0), metal },
        { "coated", coat, coat },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct scene *scene = room(cases[i].first, cases[i].second, 40, 33);
        scene->coat_table_count = 1;
        for (int k = 0; k < COAT_TABLE_LEN; k++)
            scene->coat_tables[k] = 0.95f - 0.9f / (1 + (float)k);
        scenes_finish(scene);
        struct picture *a = picture_take(scene, (struct picture_how){ .samples = 8 });
        struct picture *b = picture_take(scene, (struct picture_how){ .samples = 8, .kernel = 1 });
        assert_string_equal(a->variant, cases[i].variant);
        assert_string_equal(b->variant, "everything");
        assert_true(a->mean > 0);
        if (!picture_same(a, b))
            fail_msg("%s and everything give different bits", a->variant);

        picture_expect_any_lanes(scene, a, 8);
        setenv("PATHFARM_LANES", "base", 1);
        struct picture *c = picture_take(scene, (struct picture_how){ .samples = 8, .kernel = 1 });
        unsetenv("PATHFARM_LANES");
        if (!picture_same(a, c))
            fail_msg("%s: without AVX2 everything gives different bits", a->variant);
        struct picture *d = picture_take(scene, (struct picture_how){ .samples = 8, .seed = 1 });
        assert_false(picture_same(a, d)); /* the comparison can fail */
        picture_free(a);
        picture_free(b);
        picture_free(c);
        picture_free(d);
        scene_free(scene);
    }
}

static void a_crop_window_has_the_pixels_of_the_whole_image(void **state)
{
    (void)state;
    const uint32_t crops[][4] = { { 32, 64, 32, 64 }, { 5, 50, 7, 69 }, { 69, 70, 0, 1 } };
    struct scene *scene = room(glass(0), glass(0.2f), 70, 70);
    scenes_finish(scene);
    struct picture *whole = picture_take(scene, (struct picture_how){ .samples = 4 });
    for (int i = 0; i < 3; i++) {
        memcpy(scene->settings.crop, crops[i], sizeof(crops[i]));
        struct picture *part = picture_take(scene, (struct picture_how){ .samples = 4 });
        for (uint32_t y = 0; y < part->height; y++)
            assert_memory_equal(part->rgb + (size_t)3 * y * part->width,
                                whole->rgb + 3 * ((y + crops[i][2]) * (size_t)70 + crops[i][0]),
                                part->width * 3 * sizeof(float));
        picture_free(part);
    }
    picture_free(whole);
    scene_free(scene);
}

static void a_thin_occluder_close_to_a_far_light_shadows(void **state) /* H3 */
{
    (void)state;
    for (int blocked = 0; blocked < 2; blocked++) {
        struct scene *scene = scenes_begin(8, 8);
        uint32_t white = scenes_diffuse(scene, 0.5f), black = scenes_diffuse(scene, 0);
        /* A floor before the camera, facing it; the light 1e4 behind the camera */
        static const float floor[4][3] = {
            { -10, -10, 2 }, { -10, 10, 2 }, { 10, 10, 2 }, { 10, -10, 2 }
        };
        scenes_quad(scene, floor, white, 0);
        const float s = 2000, z = -1e4f;
        const float light[4][3] = { { -s, -s, z }, { s, -s, z }, { s, s, z }, { -s, s, z } };
        scenes_quad(scene, light, black, 1);
        const float w = 2500, o = z + 0.5f;
        const float wall[4][3] = { { -w, -w, o }, { w, -w, o }, { w, w, o }, { -w, w, o } };
        if (blocked)
            scenes_quad(scene, wall, black, 0);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 16 });
        if (blocked)
            EXPECT_NEAR(p->largest, 0, 0);
        else
            assert_true(p->mean > 1e-3);
        picture_free(p);
        scene_free(scene);
    }
}

static void light_that_cannot_get_out_is_cut_and_counted(void **state) /* H21 */
{
    (void)state;
    struct scene *scene = scenes_begin(32, 32);
    /* From the middle of a glass box towards a corner every wall reflects totally */
    struct camera *c = &scene->settings.camera;
    *c = (struct camera){ .right = { 0.01f, -0.01f, 0 },
                          .up = { 0, 0.01f, -0.01f },
                          .forward = { 1, 1, 1 },
                          .screen = { -1, 1, -1, 1 },
                          .position = { 0.03f, 0.02f, 0.01f } };
    scenes_box(scene, low, high, scenes_material(scene, glass(0)), 0);
    /* scenes_box looks inwards; glass must have its normals outwards */
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        scene->meshes[i].flags |= MESH_FLIP_NORMAL;
    scenes_sky(scene, 1);
    scenes_finish(scene);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4, .depth_cap = 500 });
    assert_int_equal(p->stats.truncated_paths, p->stats.samples);
    EXPECT_NEAR(p->stats.truncated_energy / (double)p->stats.samples, 1, 1e-5);
    EXPECT_NEAR(p->largest, 0, 0);
    picture_free(p);
    scene_free(scene);
}

/* Wherever the camera is in a ball, so long as every direction escapes, and whatever F is */
static void radiance_in_glass_is_n_squared(void **state) /* H20 */
{
    (void)state;
    static const struct {
        float n, x, y;
    } rows[] = { { 1.5f, 0, 0 },       { 1.5f, 0.3f, -0.4f }, { 1.5f, 0, 0.65f },
                 { 1.1f, 0.5f, 0.6f }, { 2.4f, 0.2f, 0.3f },  { 1.5f, -0.6f, 0.1f } };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scenes_begin(32, 32);
        struct material body = glass(0);
        body.ior = rows[i].n;
        scenes_quadric(scene, QUADRIC_SPHERE, rows[i].x, rows[i].y, 0, 1,
                       scenes_material(scene, body), 0);
        scenes_sky(scene, 1);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64 });
        double n2 = (double)rows[i].n * (double)rows[i].n;
        for (int k = 0; k < 32 * 32; k++) /* no path is gambled away: no noise at all */
            EXPECT_NEAR(p->rgb[3 * k] / 64, n2, 1e-5 * n2);
        if (picture_z(p, n2) > 4.5)
            fail_msg("n = %g: %g, want %g", (double)rows[i].n, p->mean, n2);
        assert_true(picture_z(p, n2 * 1.0001) > 4.5);
        assert_int_equal(p->failed, 0);
        assert_int_equal(p->stats.truncated_paths, 0);
        picture_free(p);
        scene_free(scene);
    }
}

static void a_glass_ball_in_a_uniform_sky_is_invisible(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(32, 32);
    scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 2, 1.2f, scenes_material(scene, glass(0)), 0);
    scenes_sky(scene, 1);
    scenes_finish(scene);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64 });
    if (picture_z(p, 1) > 4.5)
        fail_msg("%g, want 1", p->mean);
    picture_free(p);
    scene_free(scene);
}

static struct picture *lit_from_inside(int walls, float sky, uint32_t kernel)
{
    struct scene *scene = scenes_begin(32, 32);
    if (sky > 0) /* what would shine through */
        scenes_sky(scene, sky);
    for (int i = 0; i < walls; i++)
        scenes_box(scene, low, high, scenes_diffuse(scene, 0.8f), 0);
    scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 0.6f, 0.2f, scenes_diffuse(scene, 0), 10);
    scenes_finish(scene);
    struct picture *p = picture_take(scene,
                                     (struct picture_how){ .samples = 64, .kernel = kernel });
    scene_free(scene);
    return p;
}

static void a_doubled_wall_is_one_wall(void **state) /* H12 */
{
    (void)state;
    struct picture *one = lit_from_inside(1, 0, 0), *two = lit_from_inside(2, 0, 0);
    struct picture *again = lit_from_inside(2, 0, 1), *sky = lit_from_inside(2, 100, 0);
    assert_true(picture_same(two, again));
    double pixels = (double)one->width * one->height;
    for (size_t i = 0; i < 2; i++) {
        const struct picture *other = i ? sky : two;
        double difference = 0, squares = 0;
        for (size_t k = 0; k < 3 * (size_t)pixels; k += 3) {
            double d = (double)one->rgb[k] - (double)other->rgb[k];
            difference += d / pixels;
            squares += d * d / pixels;
        }
        if (fabs(difference) > 4.5 * sqrt(squares / pixels) + 1e-9)
            fail_msg("the mean changes by %g +- %g", difference, sqrt(squares / pixels));
    }
    picture_free(one);
    picture_free(two);
    picture_free(again);
    picture_free(sky);
}

static void an_emitter_seen_directly_has_its_radiance_at_any_distance(void **state)
{
    (void)state;
    for (float z = 1e-3f; z < 2e10f; z *= 10) { /* and beyond 1e7: H13 */
        struct scene *scene = scenes_begin(8, 8);
        const float s = 1.5f * z;
        const float light[4][3] = { { -s, -s, z }, { -s, s, z }, { s, s, z }, { s, -s, z } };
        scenes_quad(scene, light, scenes_diffuse(scene, 0), 3);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4 });
        EXPECT_NEAR(p->mean, 3, 0);
        EXPECT_NEAR(p->variance, 0, 1e-12);
        picture_free(p);
        scene_free(scene);
    }
}

static void samples_that_are_not_numbers_are_counted_and_flagged(void **state) /* H60 */
{
    (void)state;
    const float nowhere[3] = { 0, 0, 0 };
    /* Not a number, overflowing on the way, less than nothing; one wall of six */
    const float radiances[] = { NAN, 3e38f, -1 };
    for (int i = 0; i < 3; i++) {
        struct scene *scene = furnace(0.5f, 1, nowhere);
        for (int k = 0; k < 3; k++)
            scene->lights[5].radiance[k] = radiances[i];
        if (i == 1)
            for (uint32_t m = 0; m < 6; m++)
                scene->lights[m].radiance[0] = 3e38f;
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4 });
        const int causes[] = { NONFINITE_NAN, NONFINITE_INF, NONFINITE_NEGATIVE };
        assert_true(p->stats.nonfinite[causes[i]] > 0);
        assert_true(p->failed > 0);
        for (size_t k = 0; k < (size_t)p->width * p->height * 3; k++)
            assert_true(p->rgb[k] >= 0 && !isinf(p->rgb[k]));
        picture_free(p);
        scene_free(scene);
    }
    /* One broken ray in a million would be seen: the sound furnace has none */
    struct scene *scene = furnace(0.5f, 1, nowhere);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 64, .leaves = 4 });
    for (int cause = 0; cause < NONFINITE_CAUSES; cause++)
        assert_int_equal(p->stats.nonfinite[cause], 0);
    assert_int_equal(p->failed, 0);
    picture_free(p);
    scene_free(scene);
}

static void rays_that_are_not_rays_are_counted(void **state) /* H5 */
{
    (void)state;
    const float nowhere[3] = { 0, 0, 0 };
    for (int i = 0; i < 3; i++) {
        struct scene *scene = furnace(0.5f, 1, nowhere);
        struct camera *c = &scene->settings.camera;
        if (i == 0)
            memset(c->right, 0, sizeof(c->right)), memset(c->up, 0, sizeof(c->up)),
                memset(c->forward, 0, sizeof(c->forward));
        if (i == 1)
            c->forward[1] = NAN;
        if (i == 2)
            c->position[0] = INFINITY;
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4 });
        assert_int_equal(p->stats.nonfinite[NONFINITE_NAN], p->stats.samples);
        assert_int_equal(p->failed, 32 * 32);
        assert_int_equal(p->stats.rays_closest, 0);
        picture_free(p);
        scene_free(scene);
    }
}

static void smooth_normals_leak_no_light(void **state) /* H15 */
{
    (void)state;
    /* A closed dark box whose normals lean far over its edges, in a bright sky */
    struct scene *scene = scenes_begin(32, 32);
    scenes_box(scene, low, high, scenes_diffuse(scene, 0.9f), 0);
    scenes_sky(scene, 1);
    for (uint32_t i = 0; i < scene->vertex_count; i++)
        for (int axis = 0; axis < 3; axis++)
            scene->normals[3 * i + (uint32_t)axis] = -scene->positions[3 * i + (uint32_t)axis] *
                                                     0.57735027f;
    scene->normal_count = scene->vertex_count;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        scene->meshes[i].flags |= MESH_NORMALS;
    scenes_finish(scene);
    assert_true(scene->settings.effects & FX_SMOOTH_NORMALS);
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 32 });
    EXPECT_NEAR(p->largest, 0, 0);
    assert_int_equal(p->failed, 0);
    picture_free(p);
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_closed_furnace_has_its_radiance),
        cmocka_unit_test(a_depth_limit_is_exact_and_counts_what_it_cuts),
        cmocka_unit_test(roulette_keeps_the_second_moment),
        cmocka_unit_test(the_furnace_is_the_same_far_from_the_origin),
        cmocka_unit_test(nothing_leaks_out_of_a_dark_box),
        cmocka_unit_test(every_variant_gives_the_bits_of_everything),
        cmocka_unit_test(a_crop_window_has_the_pixels_of_the_whole_image),
        cmocka_unit_test(a_thin_occluder_close_to_a_far_light_shadows),
        cmocka_unit_test(light_that_cannot_get_out_is_cut_and_counted),
        cmocka_unit_test(radiance_in_glass_is_n_squared),
        cmocka_unit_test(a_glass_ball_in_a_uniform_sky_is_invisible),
        cmocka_unit_test(a_doubled_wall_is_one_wall),
        cmocka_unit_test(an_emitter_seen_directly_has_its_radiance_at_any_distance),
        cmocka_unit_test(samples_that_are_not_numbers_are_counted_and_flagged),
        cmocka_unit_test(rays_that_are_not_rays_are_counted),
        cmocka_unit_test(smooth_normals_leak_no_light),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
