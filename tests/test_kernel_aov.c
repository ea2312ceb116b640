/*
 * The layers of the first hit: what analytic scenes must show, that they leave radiance alone, and
 * that lanes, kernel variants and instruction sets change none of their bits.
 */
#include "common/aov.h"
#include "tests/kernel_scenes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define SIDE 32

/* A wall at z = 5 whose right edge is at a quarter of pixel column 16, and a ball before it */
static struct scene *wall_and_ball(void)
{
    struct scene *scene = scenes_begin(SIDE, SIDE);
    uint32_t white = scenes_diffuse(scene, 0.5f), grey = scenes_diffuse(scene, 0.25f);
    float right = 5 * (2 * 16.25f / SIDE - 1);
    const float wall[4][3] = { { -9, -9, 5 }, { -9, 9, 5 }, { right, 9, 5 }, { right, -9, 5 } };
    scenes_quad(scene, wall, white, 0);
    scenes_quadric(scene, QUADRIC_SPHERE, -1, 0.5f, 3, 0.75f, grey, 0);
    scenes_sky(scene, 1);
    scenes_finish(scene);
    return scene;
}

static const double nowhere_else[3][4] = { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } };

struct how {
    uint32_t aovs, samples, lanes, kernel;
    uint64_t leaf;
};

/* One leaf of the only tile */
static struct node_sums *leaf_of(const struct scene *scene, struct how how)
{
    struct err err = { .code = ERR_OK };
    struct job_spec spec = { .seed = 3,
                             .replicates = 1,
                             .channel_count = aov_channel_count(how.aovs),
                             .aovs = how.aovs,
                             .leaf_samples = how.samples,
                             .kernel = how.kernel,
                             .depth_cap = 65536,
                             .max_lanes = how.lanes ? how.lanes : 8 };
    profile_thread_mode();
    struct kernel_scene *ks = kernel_open(scene, &spec, &err);
    if (ks == NULL)
        fail_msg("%s", err.text);
    struct kernel_thread *thread = kernel_thread_open(ks, &err);
    struct node_sums *sums = node_sums_new(SIDE * SIDE, spec.channel_count);
    assert_non_null(thread);
    assert_non_null(sums);
    if (!kernel_leaf(ks, thread, 0, 0, how.leaf, sums, &err))
        fail_msg("%s", err.text);
    kernel_thread_close(thread);
    kernel_close(ks);
    return sums;
}

static double value(const struct node_sums *sums, uint32_t aovs, enum aov aov, uint32_t component,
                    uint32_t pixel)
{
    uint32_t channel = aov_channel(aovs, aov) + component;
    return (double)sums->values[(size_t)channel * sums->pixel_count + pixel];
}

static double coverage(const struct node_sums *sums, uint32_t pixel)
{
    return (double)sums->values[(size_t)AOV_COVERAGE_CHANNEL * sums->pixel_count + pixel];
}

static void near(double got, double want, double margin, uint32_t pixel)
{
    if (!(fabs(got - want) <= margin))
        fail_msg("pixel %u: %.9g where %.9g is wanted", pixel, got, want);
}

static void every_sample_shows_its_own_hit(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 1 });
    unsigned walls = 0, balls = 0, misses = 0;
    for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
        double p[3], n[3], g[3];
        for (uint32_t axis = 0; axis < 3; axis++) {
            p[axis] = value(sums, AOV_ALL, AOV_POSITION, axis, pixel);
            n[axis] = value(sums, AOV_ALL, AOV_NORMAL, axis, pixel);
            g[axis] = value(sums, AOV_ALL, AOV_GEOMETRIC_NORMAL, axis, pixel);
            assert_true(n[axis] == g[axis]);
        }
        double depth = value(sums, AOV_ALL, AOV_DEPTH, 0, pixel);
        double rho = value(sums, AOV_ALL, AOV_ALBEDO, 1, pixel);
        uint32_t object = (uint32_t)value(sums, AOV_ALL, AOV_OBJECT, 0, pixel);
        uint32_t material = (uint32_t)value(sums, AOV_ALL, AOV_MATERIAL, 0, pixel);
        assert_true(value(sums, AOV_ALL, AOV_ALPHA, 0, pixel) == coverage(sums, pixel));
        assert_int_equal(object, material);
        if (object == 0) {
            assert_true(coverage(sums, pixel) == 0 && depth == 0 && rho == 0 && p[2] == 0);
            misses++;
            continue;
        }
        assert_true(coverage(sums, pixel) == 1);
        near(depth, p[2], 1e-6, pixel);
        /* The point lies where the pixel looks: x to the right, y upwards */
        double x = (p[0] / p[2] + 1) / 2 * SIDE, y = (1 - p[1] / p[2]) / 2 * SIDE;
        assert_true(x > pixel % SIDE - 1e-4 && x < pixel % SIDE + 1 + 1e-4);
        assert_true(y > pixel / SIDE - 1e-4 && y < pixel / SIDE + 1 + 1e-4);
        if (object == 1) {
            near(p[2], 5, 1e-5, pixel);
            near(fabs(n[2]), 1, 1e-6, pixel);
            near(rho, 0.5, 0, pixel);
            walls++;
        } else {
            const double center[3] = { -1, 0.5, 3 };
            for (int axis = 0; axis < 3; axis++)
                near(n[axis], (p[axis] - center[axis]) / 0.75, 1e-5, pixel);
            near(rho, 0.25, 0, pixel);
            balls++;
        }
    }
    assert_true(walls > 400 && balls > 50 && misses > 300);
    node_sums_free(sums);
    scene_free(scene);
}

static void an_edge_covers_its_share_of_a_pixel(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    uint32_t aovs = 1u << AOV_ALPHA | 1u << AOV_DEPTH;
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = aovs, .samples = 64 });
    for (uint32_t y = 0; y < SIDE; y++) {
        near(coverage(sums, y * SIDE + 15), 64, 0, y * SIDE + 15);
        near(coverage(sums, y * SIDE + 16), 16, 1, y * SIDE + 16);
        near(coverage(sums, y * SIDE + 17), 0, 0, y * SIDE + 17);
        near(value(sums, aovs, AOV_DEPTH, 0, y * SIDE + 16) / coverage(sums, y * SIDE + 16), 5,
             1e-5, y * SIDE + 16);
    }
    node_sums_free(sums);
    scene_free(scene);
}

static void averages_stay_in_range_under_a_negative_filter(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    scene->settings.filter = (struct filter_spec){
        .kind = FILTER_MITCHELL, .radius = { 2, 2 }, .b = 1 / 3.0f, .c = 1 / 3.0f
    };
    scene->settings.effects = scene_effects(scene);
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 16 });
    bool overshoots = false;
    for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
        double alpha = value(sums, AOV_ALL, AOV_ALPHA, 0, pixel) / 16;
        overshoots |= alpha < 0 || alpha > 1.001;
        if (coverage(sums, pixel) == 0)
            continue;
        double depth = value(sums, AOV_ALL, AOV_DEPTH, 0, pixel) / coverage(sums, pixel);
        assert_true(depth > 2.24 && depth < 5.00001);
    }
    assert_true(overshoots); /* as radiance does at edges */
    node_sums_free(sums);
    scene_free(scene);
}

static void radiance_is_the_same_with_and_without_layers(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    struct node_sums *with = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 4 });
    struct node_sums *without = leaf_of(scene, (struct how){ .samples = 4 });
    assert_int_equal(without->channel_count, 3);
    assert_memory_equal(with->values, without->values, sizeof(float) * 3 * SIDE * SIDE);
    assert_memory_equal(&with->stats, &without->stats, sizeof(with->stats));
    node_sums_free(with);
    node_sums_free(without);
    scene_free(scene);
}

static void a_layer_is_the_same_bits_whoever_asks_for_what(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    struct node_sums *all = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 4 });
    for (unsigned aov = 0; aov < AOV_COUNT; aov++) {
        uint32_t aovs = 1u << aov;
        struct node_sums *one = leaf_of(scene, (struct how){ .aovs = aovs, .samples = 4 });
        uint32_t from = aov_channel(aovs, aov), count = one->channel_count - from;
        assert_memory_equal(one->values + (size_t)from * SIDE * SIDE,
                            all->values + (size_t)aov_channel(AOV_ALL, aov) * SIDE * SIDE,
                            sizeof(float) * count * SIDE * SIDE);
        node_sums_free(one);
    }
    node_sums_free(all);
    scene_free(scene);
}

static void lanes_variants_and_instruction_sets_change_no_bit(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    uint32_t glass = scenes_material(scene,
                                     (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f });
    scenes_quadric(scene, QUADRIC_SPHERE, 2, -1, 4, 1, glass, 0);
    scenes_group_begin(scene);
    scenes_quadric(scene, QUADRIC_SPHERE, 1, 1, 4, 0.5f, 0, 0);
    scenes_group_end(scene);
    scenes_place(scene, 0, nowhere_else)->motion = scenes_glide(scene, 0.5f, 0.5f, 0);
    scenes_finish(scene);
    const struct how hows[] = {
        { .aovs = AOV_ALL, .samples = 4 },
        { .aovs = AOV_ALL, .samples = 4, .lanes = 1 },
        { .aovs = AOV_ALL, .samples = 4, .lanes = 3, .kernel = 1 },
        { .aovs = AOV_ALL, .samples = 4 }, /* without AVX2 */
    };
    struct node_sums *first = NULL;
    for (size_t i = 0; i < sizeof(hows) / sizeof(hows[0]); i++) {
        if (i == 3)
            setenv("PATHFARM_LANES", "base", 1);
        struct node_sums *sums = leaf_of(scene, hows[i]);
        unsetenv("PATHFARM_LANES");
        if (first == NULL) {
            first = sums;
            continue;
        }
        assert_memory_equal(sums->values, first->values,
                            sizeof(float) * sums->channel_count * SIDE * SIDE);
        node_sums_free(sums);
    }
    node_sums_free(first);
    scene_free(scene);
}

/* Glass, a mixture, metals and a coat, each a wall of its own scene */
static void the_albedo_is_what_a_material_scatters_in_all(void **state)
{
    (void)state;
    const struct {
        struct material material;
        double low, high; /* of the green mean */
    } rows[] = {
        { { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f }, 0.999999, 1.000001 },
        { { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f, .alpha = { 0.3f, 0.3f } }, 0.93, 1.01 },
        { { .kind = MATERIAL_MIXTURE,
            .reflectance = { 0.2f, 0.3f, 0.4f },
            .specular = { 0.1f, 0.4f, 0.2f } },
          0.69,
          0.71 },
        { { .kind = MATERIAL_CONDUCTOR, .eta = { 1, 1, 1 }, .k = { 0, 0, 0 } }, 0, 1e-8 },
        /* A coat that is not there: T = 1, and 1 / pi for the base */
        { { .kind = MATERIAL_COAT,
            .reflectance = { 0.6f, 0.6f, 0.6f },
            .ior = 1,
            .coat_scale = 0.31830989f },
          0.5999,
          0.6001 },
        { { .kind = MATERIAL_CONDUCTOR, .eta = { 0.2f, 0.2f, 0.2f }, .k = { 4, 4, 4 } },
          0.95,
          0.97 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scenes_begin(SIDE, SIDE);
        const float wall[4][3] = { { -9, -9, 5 }, { -9, 9, 5 }, { 9, 9, 5 }, { 9, -9, 5 } };
        for (int entry = 0; entry < COAT_TABLE_LEN; entry++)
            scene->coat_tables[entry] = 1;
        scene->coat_table_count = 1;
        scenes_quad(scene, wall, scenes_material(scene, rows[i].material), 0);
        scenes_sky(scene, 1);
        scenes_finish(scene);
        uint32_t aovs = 1u << AOV_ALBEDO;
        struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = aovs, .samples = 16 });
        double mean = 0;
        for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++)
            mean += value(sums, aovs, AOV_ALBEDO, 1, pixel) / 16 / (SIDE * SIDE);
        if (!(mean >= rows[i].low && mean <= rows[i].high))
            fail_msg("material %zu: albedo %.7g, not %g to %g", i, mean, rows[i].low, rows[i].high);
        node_sums_free(sums);
        scene_free(scene);
    }
}

/* ---- instances, motion */

/* A wall at z = 5 as far as the camera sees, in a group or not */
static void add_wall(struct scene *scene, bool in_group)
{
    const float wall[4][3] = { { -99, -99, 5 }, { -99, 99, 5 }, { 99, 99, 5 }, { 99, -99, 5 } };
    if (in_group)
        scenes_group_begin(scene);
    scenes_quad(scene, wall, scenes_diffuse(scene, 0.5f), 0);
    if (in_group)
        scenes_group_end(scene);
}

static double average(const struct node_sums *sums, enum aov aov, uint32_t component,
                      uint32_t pixel)
{
    return value(sums, AOV_ALL, aov, component, pixel) / coverage(sums, pixel);
}

static void what_does_not_move_has_no_motion(void **state)
{
    (void)state;
    for (int with = 0; with < 2; with++) { /* something else moves, out of sight */
        struct scene *scene = wall_and_ball();
        if (with) {
            scenes_group_begin(scene);
            scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, -9, 1, 0, 0);
            scenes_group_end(scene);
            scenes_place(scene, 0, nowhere_else)->motion = scenes_glide(scene, 1, 0, 0);
            scenes_finish(scene);
        }
        struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 4 });
        for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++)
            for (uint32_t i = 0; i < 2; i++)
                assert_true(value(sums, AOV_ALL, AOV_MOTION, i, pixel) == 0);
        node_sums_free(sums);
        scene_free(scene);
    }
}

/* Of a wall that glides by (x, y, 0): a pixel is 10 / SIDE wide there */
static void motion_of_things_is_in_pixels(void **state)
{
    (void)state;
    const struct {
        float x, y, open, close, share; /* of the way that is seen */
    } rows[] = { { 0.5f, 0.25f, 0, 1, 1 },
                 { -2, 1, 0.25f, 0.75f, 0.5f },
                 { 3, 0, -1, 0.5f, 0.5f } };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct scene *scene = scenes_begin(SIDE, SIDE);
        add_wall(scene, true);
        scenes_place(scene, 0, nowhere_else)->motion = scenes_glide(scene, rows[i].x, rows[i].y, 0);
        scene->settings.shutter[0] = rows[i].open;
        scene->settings.shutter[1] = rows[i].close;
        scenes_finish(scene);
        struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 4 });
        double scale = (double)rows[i].share * SIDE / 10;
        for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
            near(average(sums, AOV_MOTION, 0, pixel), (double)rows[i].x * scale, 1e-4, pixel);
            near(average(sums, AOV_MOTION, 1, pixel), (double)-rows[i].y * scale, 1e-4, pixel);
            near(average(sums, AOV_DEPTH, 0, pixel), 5, 1e-5, pixel);
        }
        node_sums_free(sums);
        scene_free(scene);
    }
}

/* The camera goes 2 towards the wall: what is seen moves away from the middle, and the depth of a
 * sample is that of its own time */
static void a_moving_camera_has_motion_and_a_depth_of_its_time(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(SIDE, SIDE);
    add_wall(scene, false);
    scene->settings.camera_motion = scenes_glide(scene, 0, 0, 2);
    scenes_finish(scene);
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 1 });
    double least = 9, most = 0;
    for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
        double depth = average(sums, AOV_DEPTH, 0, pixel);
        least = fmin(least, depth);
        most = fmax(most, depth);
        near(average(sums, AOV_POSITION, 2, pixel), 5, 1e-5, pixel);
        for (uint32_t axis = 0; axis < 2; axis++) {
            double p = average(sums, AOV_POSITION, axis, pixel) * (axis == 0 ? 1 : -1);
            near(average(sums, AOV_MOTION, axis, pixel), (p / 3 - p / 5) * SIDE / 2, 2e-4, pixel);
        }
        /* It is seen where it is from the place that the camera had */
        double x = (average(sums, AOV_POSITION, 0, pixel) / depth + 1) / 2 * SIDE;
        assert_true(x > pixel % SIDE - 1e-3 && x < pixel % SIDE + 1 + 1e-3);
    }
    assert_true(least >= 3 && least < 3.02 && most <= 5 && most > 4.98);
    node_sums_free(sums);
    scene_free(scene);
}

/* A camera that goes along with the wall sees it stand still; one that passes the point has lost
 * it, and so has one that looks away */
static void motion_is_what_the_camera_sees_of_it(void **state)
{
    (void)state;
    for (int row = 0; row < 3; row++) {
        struct scene *scene = scenes_begin(SIDE, SIDE);
        add_wall(scene, true);
        scenes_place(scene, 0, nowhere_else)->motion = scenes_glide(scene, 7, 3, -2);
        scene->settings.camera_motion = row == 0 ? scenes_glide(scene, 7, 3, -2)
                                                 : scenes_glide(scene, 0, 0, row == 1 ? 6 : 0);
        if (row == 2) { /* half a turn about y */
            struct motion *turn = &scene->motions[scene->motion_count - 1];
            turn->rotation[1][3] = 0;
            turn->rotation[1][1] = 1;
            turn->angle = (float)(M_PI / 2);
        }
        scenes_finish(scene);
        struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 1 });
        unsigned seen = 0;
        for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
            if (coverage(sums, pixel) == 0)
                continue;
            seen++;
            near(average(sums, AOV_MOTION, 0, pixel), 0, 1e-4, pixel);
            near(average(sums, AOV_MOTION, 1, pixel), 0, 1e-4, pixel);
        }
        assert_true(seen > SIDE);
        node_sums_free(sums);
        scene_free(scene);
    }
}

/* Behind the shapes of the world, and those of groups, come the instances */
static void every_instance_is_an_object(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(SIDE, SIDE);
    uint32_t grey = scenes_diffuse(scene, 0.5f);
    const double left[3][4] = { { 1, 0, 0, -2 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } };
    const double right[3][4] = { { 1, 0, 0, 2 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } };
    const float square[4][3] = { { -1, -2, 4 }, { -1, 0, 4 }, { 1, 0, 4 }, { 1, -2, 4 } };
    add_wall(scene, false);
    scenes_group_begin(scene);
    scenes_quad(scene, square, grey, 0);
    scenes_quadric(scene, QUADRIC_SPHERE, 0, 1.5f, 4, 0.75f, grey, 0);
    scenes_group_end(scene);
    scenes_place(scene, 0, left);
    scenes_place(scene, 0, right);
    scenes_finish(scene);
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 1 });
    unsigned found[6] = { 0 };
    for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
        unsigned object = (unsigned)value(sums, AOV_ALL, AOV_OBJECT, 0, pixel);
        assert_in_range(object, 1, 5);
        found[object]++;
        double x = average(sums, AOV_POSITION, 0, pixel);
        assert_true(object == 1 || (object == 4 ? x < 0 : x > 0));
    }
    assert_true(found[1] > 500 && found[4] > 80 && found[5] > 80);
    assert_int_equal(found[2] + found[3], 0); /* nobody sees a group itself */
    node_sums_free(sums);
    scene_free(scene);
}

static void only_the_first_samples_keep_identities(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    uint32_t aovs = 1u << AOV_OBJECT, center = 16 * SIDE + 2;
    for (uint64_t leaf = 0; leaf < 3; leaf++) {
        struct node_sums *sums = leaf_of(scene,
                                         (struct how){ .aovs = aovs, .samples = 2, .leaf = leaf });
        for (uint32_t s = 0; s < AOV_ID_SAMPLES; s++)
            near(value(sums, aovs, AOV_OBJECT, s, center), s / 2 == leaf, 0, center);
        node_sums_free(sums);
    }
    scene_free(scene);
}

static void bad_radiance_leaves_the_layers_alone(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(SIDE, SIDE);
    const float wall[4][3] = { { -9, -9, 5 }, { -9, 9, 5 }, { 9, 9, 5 }, { 9, -9, 5 } };
    scenes_quad(scene, wall, scenes_diffuse(scene, 0.5f), 1);
    scene->lights[0].radiance[0] = NAN;
    scene->lights[0].flags = LIGHT_TWO_SIDED;
    scenes_finish(scene);
    struct node_sums *sums = leaf_of(scene, (struct how){ .aovs = AOV_ALL, .samples = 4 });
    assert_true(sums->stats.nonfinite[NONFINITE_NAN] > 0);
    for (uint32_t pixel = 0; pixel < SIDE * SIDE; pixel++) {
        near(coverage(sums, pixel), 4, 0, pixel);
        near(value(sums, AOV_ALL, AOV_DEPTH, 0, pixel), 20, 1e-4, pixel);
    }
    node_sums_free(sums);
    scene_free(scene);
}

static void a_spec_that_contradicts_itself_is_refused(void **state)
{
    (void)state;
    struct scene *scene = wall_and_ball();
    const struct job_spec specs[] = {
        { .leaf_samples = 4, .max_lanes = 8, .channel_count = 4 },
        { .leaf_samples = 4, .max_lanes = 8, .channel_count = 3, .aovs = 1u << AOV_DEPTH },
        { .leaf_samples = 4, .max_lanes = 8, .channel_count = 3, .aovs = 1u << AOV_COUNT },
    };
    for (size_t i = 0; i < sizeof(specs) / sizeof(specs[0]); i++) {
        struct err err = { .code = ERR_OK };
        assert_null(kernel_open(scene, &specs[i], &err));
        assert_int_equal(err.code, ERR_ARGUMENT);
    }
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_sample_shows_its_own_hit),
        cmocka_unit_test(an_edge_covers_its_share_of_a_pixel),
        cmocka_unit_test(averages_stay_in_range_under_a_negative_filter),
        cmocka_unit_test(radiance_is_the_same_with_and_without_layers),
        cmocka_unit_test(a_layer_is_the_same_bits_whoever_asks_for_what),
        cmocka_unit_test(lanes_variants_and_instruction_sets_change_no_bit),
        cmocka_unit_test(the_albedo_is_what_a_material_scatters_in_all),
        cmocka_unit_test(what_does_not_move_has_no_motion),
        cmocka_unit_test(motion_of_things_is_in_pixels),
        cmocka_unit_test(a_moving_camera_has_motion_and_a_depth_of_its_time),
        cmocka_unit_test(motion_is_what_the_camera_sees_of_it),
        cmocka_unit_test(every_instance_is_an_object),
        cmocka_unit_test(only_the_first_samples_keep_identities),
        cmocka_unit_test(bad_radiance_leaves_the_layers_alone),
        cmocka_unit_test(a_spec_that_contradicts_itself_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
