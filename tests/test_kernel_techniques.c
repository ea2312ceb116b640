/*
 * Techniques switched off, alone and together (common/job.h): the picture converges to the same. On
 * a surface that every kind of light falls onto, by every kind of way, they are held against each
 * other; in a closed box whose walls all emit, against the closed form. Each light on each material
 * is in test_kernel_direct, test_kernel_environment and test_kernel_emission.
 */
#include "tests/expect.h"
#include "tests/kernel_scenes.h"
#include "tests/techniques.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

enum { COMBINATIONS = TECHNIQUE_ALL + 1 };

enum surroundings { CLEAR, FOG, MANY_LIGHTS, SURROUNDINGS };
static const char *const names[SURROUNDINGS] = { "clear air", "fog", "many lights" };

/*
 * A grey speck with a metal wall beside it, below a quad and a ball that emit, a ball of glass
 * before the quad, and a sky; paths scatter at most six times
 */
static struct scene *place(enum surroundings surroundings)
{
    static const float wall[4][3] = { { 1, -2, -1 }, { 1, 2, -1 }, { 1, 2, 3 }, { 1, -2, 3 } };
    struct scene *scene = scenes_begin(16, 16);
    const struct material metal = { .kind = MATERIAL_CONDUCTOR,
                                    .eta = { 0.2f, 0.2f, 0.2f },
                                    .k = { 3.9f, 3.9f, 3.9f },
                                    .alpha = { 0.3f, 0.3f } };
    const struct material glass = { .kind = MATERIAL_DIELECTRIC, .ior = 1.5f };
    technique_receiver(scene, scenes_diffuse(scene, 0.6f), (float[3]){ 0, -0.8f, 0.6f },
                       (float[3]){ 0, 0.8f, -0.6f });
    scene->settings.max_depth = 6;
    scenes_quad(scene, wall, scenes_material(scene, metal), 0);
    scenes_quadric(scene, QUADRIC_SPHERE, -0.4f, 0, 0.8f, 0.3f, scenes_material(scene, glass), 0);
    scenes_quadric(scene, QUADRIC_SPHERE, 0.3f, 1.2f, 0.5f, 0.3f, scenes_diffuse(scene, 0.5f), 2);

    const int across = surroundings == MANY_LIGHTS ? 9 : 1;
    for (int i = 0; i < across * across; i++) {
        float x = -1.4f + (float)(i % across) * 1.8f / (float)across,
              y = -0.9f + (float)(i / across) * 1.8f / (float)across, side = 1.6f / (float)across;
        const float quad[4][3] = { { x, y, 1.6f },
                                   { x, y + side, 1.6f },
                                   { x + side, y + side, 1.6f },
                                   { x + side, y, 1.6f } };
        scenes_quad(scene, quad, scenes_diffuse(scene, 0.5f), 1);
    }
    scenes_sky(scene, 0.3f);
    if (surroundings == FOG) {
        scene->media[scene->medium_count++] = (struct medium){ .sigma_a = { 0.1f, 0.1f, 0.1f },
                                                               .sigma_s = { 0.6f, 0.6f, 0.6f },
                                                               .g = 0.5f };
        scene->settings.camera_medium = scene->medium_count;
        /* The wall is in the fog, too; glass and lights have none inside */
        for (uint32_t i = 0; i < scene->quadric_count; i++)
            scene->quadrics[i].outside = scene->medium_count;
    }
    scenes_finish(scene);
    return scene;
}

static const struct picture_how how = { .samples = 64, .leaves = 4 };

static void every_combination_finds_the_same_light(void **state)
{
    (void)state;
    for (int s = 0; s < SURROUNDINGS; s++) {
        struct scene *scene = place((enum surroundings)s);
        struct estimate want = estimate_take(scene, BOTH, how);
        assert_true(want.mean > 0);
        for (uint32_t off = 1; off < COMBINATIONS; off++) {
            struct estimate e = technique_switched(scene, off, how);
            if (!(estimate_apart(e, want) < 4))
                fail_msg("in %s, without %#x: %g +- %g, want %g +- %g", names[s], off, e.mean,
                         e.error, want.mean, want.error);
        }
        scene_free(scene);
    }
}

/* Planted: light samples and hits of lights both count in full */
static void count_twice(struct kernel_scene *ks)
{
    ks->spec.techniques_off = TECHNIQUE_LIGHT_SAMPLING | TECHNIQUE_MIS;
    ks->lights_sampled = true;
}

/* Planted: no light sampling, and hits weighed as if there were */
static void count_a_part(struct kernel_scene *ks)
{
    ks->lights_sampled = false;
}

/* Planted: no light sampling, and hits left to it */
static void count_never(struct kernel_scene *ks)
{
    ks->spec.techniques_off = TECHNIQUE_MIS;
    ks->lights_sampled = false;
}

static void light_that_counts_twice_or_in_part_is_noticed(void **state)
{
    (void)state;
    void (*const plants[])(struct kernel_scene *) = { count_twice, count_a_part, count_never };
    struct scene *scene = place(CLEAR);
    struct estimate want = estimate_take(scene, BOTH, how);
    for (int i = 0; i < 3; i++) {
        struct picture_how planted = how;
        planted.alter = plants[i];
        struct estimate e = estimate_take(scene, BOTH_PLANTED, planted);
        if (!(estimate_apart(e, want) > 8))
            fail_msg("plant %d: %g +- %g against %g +- %g", i, e.mean, e.error, want.mean,
                     want.error);
    }
    scene_free(scene);
}

/* Switched on again, nothing has changed: the same bits from the variant that has the switches */
static void with_all_switched_on_the_bits_are_those_of_any_variant(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(32, 32);
    scenes_room(scene, scenes_diffuse(scene, 0.6f), scenes_diffuse(scene, 0.2f));
    scenes_finish(scene);
    struct picture *special = picture_take(scene, (struct picture_how){ .samples = 16 });
    struct picture *all = picture_take(scene, (struct picture_how){ .samples = 16, .kernel = 1 });
    assert_string_not_equal(special->variant, all->variant);
    assert_true(picture_same(special, all));
    for (uint32_t off = 1; off <= TECHNIQUE_MIS; off++) { /* and off, they have */
        struct picture *p = picture_take(
            scene, (struct picture_how){ .samples = 16, .techniques_off = off });
        assert_string_equal(p->variant, all->variant);
        assert_false(picture_same(p, all));
        picture_free(p);
    }
    picture_free(special);
    picture_free(all);
    scene_free(scene);
}

/* Walls of albedo rho that all emit 1, and at most `depth` events: rho^0 + ... + rho^depth */
static void without_roulette_a_furnace_is_exact_and_what_the_limit_cuts_is_counted(void **state)
{
    (void)state;
    static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };
    const double rho = 0.75;
    for (uint32_t depth = 1; depth <= 24; depth += 23) {
        struct scene *scene = scenes_begin(16, 16);
        scenes_box(scene, low, high, scenes_diffuse(scene, (float)rho), 1);
        scenes_finish(scene);
        struct picture_how furnace = { .samples = 16,
                                       .depth_cap = depth,
                                       .techniques_off = TECHNIQUE_ROULETTE |
                                                         TECHNIQUE_LIGHT_SAMPLING };
        struct picture *p = picture_take(scene, furnace);
        EXPECT_NEAR(p->mean, (1 - pow(rho, depth + 1)) / (1 - rho), 1e-5);
        EXPECT_NEAR(p->variance, 0, 1e-10);
        assert_int_equal(p->stats.truncated_paths, p->stats.samples);
        EXPECT_NEAR(p->stats.truncated_energy / (double)p->stats.samples, pow(rho, depth), 1e-5);
        picture_free(p);

        furnace.techniques_off =
            TECHNIQUE_LIGHT_SAMPLING; /* roulette is noise, and shorter paths */
        p = picture_take(scene, furnace);
        assert_true(depth == 1 || p->variance > 1e-3);
        assert_true(depth == 1 || p->stats.truncated_paths < p->stats.samples / 2);
        picture_free(p);
        scene_free(scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_combination_finds_the_same_light),
        cmocka_unit_test(light_that_counts_twice_or_in_part_is_noticed),
        cmocka_unit_test(with_all_switched_on_the_bits_are_those_of_any_variant),
        cmocka_unit_test(without_roulette_a_furnace_is_exact_and_what_the_limit_cuts_is_counted),
    };
    profile_thread_mode();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
