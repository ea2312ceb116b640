/*
 * Pictures of textured, bumpy and partly absent surfaces. H numbers are those of the numerics
 * notes, section 2. Runs for a few seconds.
 */
#include "tests/expect.h"
#include "tests/kernel_scenes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static struct picture *take(struct scene *scene, uint32_t samples)
{
    scenes_finish(scene);
    struct err err = { .code = ERR_OK };
    if (!scene_check(scene, &err))
        fail_msg("%s", err.text);
    return picture_take(scene, (struct picture_how){ .samples = samples });
}

static void far_checks_converge_to_their_mean_with_less_noise_than_unfiltered(void **state)
{
    (void)state;
    double variance[2], mean[2], pixels = 0;
    for (int pyramid = 0; pyramid < 2; pyramid++) {
        struct scene *scene = scenes_begin(32, 32);
        uint32_t index, levels = pyramid ? 6 : 1;
        float *texel = scenes_picture(scene, 32, 32, 1, levels, TEXEL_FLOAT, &index);
        for (uint32_t l = 0; l < levels; l++)
            for (uint32_t i = 0; i < (32u >> l) * (32u >> l); i++)
                *texel++ = l > 0 ? 0.5f : (float)((i + i / 32) % 2);
        struct texture texture = texture_image(index, WRAP_REPEAT);
        texture.map[0] = texture.map[4] = 10; /* 320 checks over 32 pixels */
        scenes_texture(scene, texture);
        uint32_t material = scenes_material(
            scene, (struct material){ .texture = { [SLOT_REFLECTANCE] = 1 } });
        scenes_quad_with_uv(scene, (float[3]){ -5, -5, 5 }, (float[3]){ 0, 10, 0 },
                            (float[3]){ 10, 0, 0 }, material);
        scenes_sky(scene, 1);
        struct picture *p = take(scene, 4);
        assert_true(scene->settings.effects & FX_TEXTURE);
        variance[pyramid] = p->variance;
        mean[pyramid] = p->mean;
        pixels = p->pixels;
        assert_int_equal(p->failed, 0);
        picture_free(p);
        scene_free(scene);
    }
    EXPECT_NEAR(mean[0], 0.5, 4 * sqrt(variance[0] / pixels));
    EXPECT_NEAR(mean[1], 0.5, 4 * sqrt(variance[1] / pixels) + 1e-6);
    if (!(variance[1] < 0.01 * variance[0]))
        fail_msg("variance %g with a pyramid, %g without", variance[1], variance[0]);
}

/* White where light gets through: `layers` sheets of share alpha, black, before a white sky */
static struct scene *sheets(float alpha, int layers)
{
    struct scene *scene = scenes_begin(32, 32);
    scenes_texture(scene, texture_constant(alpha, alpha, alpha));
    uint32_t black = scenes_diffuse(scene, 0);
    for (int i = 0; i < layers; i++)
        scenes_quad_with_uv(scene, (float[3]){ -50, -50, 5 + (float)i }, (float[3]){ 0, 100, 0 },
                            (float[3]){ 100, 0, 0 }, black)
            ->alpha = 1;
    scenes_sky(scene, 1);
    return scene;
}

static void alpha_lets_its_share_of_rays_through(void **state)
{
    (void)state;
    for (int layers = 1; layers <= 3; layers++) {
        struct scene *scene = sheets(0.3f, layers);
        struct picture *p = take(scene, 64);
        double want = pow(0.7, layers), n = p->pixels * 64;
        double z = fabs(p->mean - want) / sqrt(want * (1 - want) / n);
        if (z > 4)
            fail_msg("%d layers: %g, want %g, z = %g", layers, p->mean, want, z);
        /* Planted: an alpha of .28, and layers that decide alike */
        double planted = pow(0.72, layers);
        assert_true(fabs(p->mean - planted) > 4 * sqrt(planted * (1 - planted) / n));
        assert_true(layers == 1 || fabs(p->mean - 0.7) > 0.1);
        picture_free(p);
        scene_free(scene);
    }
    const float alphas[] = { 0, -1, 1, 2 };
    for (int i = 0; i < 4; i++) {
        struct scene *scene = sheets(alphas[i], 1);
        struct picture *p = take(scene, 4);
        EXPECT_NEAR(p->mean, i < 2 ? 1 : 0, 0);
        picture_free(p);
        scene_free(scene);
    }
}

static void alpha_lets_its_share_of_shadow_rays_through(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(32, 32);
    scenes_texture(scene, texture_constant(0.3f, 0.3f, 0.3f));
    scenes_quad_with_uv(scene, (float[3]){ -50, -50, 5 }, (float[3]){ 0, 100, 0 },
                        (float[3]){ 100, 0, 0 }, scenes_diffuse(scene, 0.5f));
    /* Behind the camera, between the wall and the light */
    scenes_quad_with_uv(scene, (float[3]){ -50, -50, -1 }, (float[3]){ 0, 100, 0 },
                        (float[3]){ 100, 0, 0 }, scenes_diffuse(scene, 0))
        ->alpha = 1;
    scenes_light(
        scene,
        (struct light){ .kind = LIGHT_DISTANT, .radiance = { 2, 2, 2 }, .direction = { 0, 0, 1 } });
    struct picture *p = take(scene, 64);
    double full = 0.5 * 2 / M_PI, n = p->pixels * 64;
    EXPECT_NEAR(p->mean / full, 0.7, 4 * sqrt(0.7 * 0.3 / n));
    picture_free(p);
    scene_free(scene);
}

/* A wall of reflectance .5 before the camera whose displacement rises by `slope` per unit along x,
 * lit from over the camera's shoulder; the quad is 8 wide, so uv are an eighth */
static struct scene *slope(float rise, float light_x, float light_z)
{
    struct scene *scene = scenes_begin(16, 16);
    uint32_t ramp = scenes_texture(
        scene, (struct texture){ .kind = TEXTURE_BILERP,
                                 .map = SCENES_UV_MAP,
                                 .value = { { 0 }, { 0 }, { 8 * rise }, { 8 * rise } } });
    uint32_t material = scenes_material(scene,
                                        (struct material){ .reflectance = { 0.5f, 0.5f, 0.5f },
                                                           .texture = { [SLOT_BUMP] = ramp + 1 } });
    scenes_quad_with_uv(scene, (float[3]){ -4, 4, 3 }, (float[3]){ 8, 0, 0 },
                        (float[3]){ 0, -8, 0 }, material);
    float length = sqrtf(light_x * light_x + light_z * light_z);
    scenes_light(scene, (struct light){ .kind = LIGHT_DISTANT,
                                        .radiance = { 2, 2, 2 },
                                        .direction = { light_x / length, 0, light_z / length } });
    return scene;
}

static void a_bumpy_wall_is_as_bright_as_the_tilted_one(void **state) /* H15 */
{
    (void)state;
    for (int sign = -1; sign <= 1; sign += 2) {
        struct scene *scene = slope(0.3f * (float)sign, 0.5f, 1);
        struct picture *p = take(scene, 4);
        assert_true(scene->settings.effects & FX_BUMP);
        /* The wall faces the camera, along -z; rising along x it leans to -x */
        double want = 0.5 * 2 / M_PI * (0.3 * sign * 0.5 + 1) / sqrt(1.25 * 1.09);
        EXPECT_NEAR(p->mean, want, 1e-3);
        EXPECT_NEAR(sqrt(p->variance), 0, 1e-3);
        assert_true(fabs(p->mean - 0.5 * 2 / M_PI / sqrt(1.25)) > 0.01); /* planted: no bump */
        picture_free(p);
        scene_free(scene);
    }
    /* From behind nothing comes through, however the wall leans */
    struct scene *scene = slope(2, 1, -0.05f);
    struct picture *p = take(scene, 4);
    EXPECT_NEAR(p->largest, 0, 0);
    picture_free(p);
    scene_free(scene);
}

static void a_bumpy_dark_box_leaks_nothing(void **state) /* H15 */
{
    (void)state;
    static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };
    struct scene *scene = scenes_begin(32, 32);
    struct texture waves = texture_of_point(TEXTURE_FBM);
    waves.map[0] = waves.map[5] = waves.map[10] = 7;
    scenes_texture(scene, waves);
    uint32_t material = scenes_material(
        scene,
        (struct material){ .reflectance = { 0.9f, 0.9f, 0.9f }, .texture = { [SLOT_BUMP] = 1 } });
    scenes_box(scene, low, high, material, 0);
    scenes_sky(scene, 1);
    struct picture *p = take(scene, 16);
    EXPECT_NEAR(p->largest, 0, 0);
    assert_int_equal(p->failed, 0);
    assert_true(p->stats.events > p->stats.samples);
    picture_free(p);
    scene_free(scene);
}

static void a_mix_follows_its_texture(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(16, 16);
    scenes_texture(scene, (struct texture){ .kind = TEXTURE_CHECKERBOARD,
                                            .map = { 2, 0, 0, 0, 0, 0.5f },
                                            .value = { { 0 }, { 1, 1, 1 } } });
    uint32_t dark = scenes_diffuse(scene, 0.2f), bright = scenes_diffuse(scene, 0.8f);
    uint32_t material = scenes_material(scene,
                                        (struct material){ .kind = MATERIAL_MIX,
                                                           .mix = { dark, bright },
                                                           .texture = { [SLOT_AMOUNT] = 1 } });
    scenes_quad_with_uv(scene, (float[3]){ -4, 4, 3 }, (float[3]){ 8, 0, 0 },
                        (float[3]){ 0, -8, 0 }, material);
    scenes_sky(scene, 1);
    struct picture *p = take(scene, 16);
    for (uint32_t y = 0; y < 16; y++) {
        EXPECT_NEAR(p->rgb[3 * (16 * y + 1)] / 16, 0.2, 1e-6);
        EXPECT_NEAR(p->rgb[3 * (16 * y + 14)] / 16, 0.8, 1e-6);
    }
    picture_free(p);
    scene_free(scene);
}

/* Everything at once: a room of textured, bumpy, rough and partly absent things */
static struct scene *textured_room(void)
{
    struct scene *scene = scenes_begin(40, 33);
    uint32_t index;
    uint8_t *texel = scenes_picture(scene, 16, 16, 3, 5, TEXEL_U8_SRGB, &index);
    for (int i = 0; i < 3 * 341; i++)
        texel[i] = (uint8_t)(i * 37);
    struct texture picture = texture_image(index, WRAP_MIRROR);
    picture.map[0] = 3;
    uint32_t color = scenes_texture(scene, picture);
    struct texture noise = texture_of_point(TEXTURE_FBM);
    noise.map[0] = noise.map[5] = noise.map[10] = 3;
    uint32_t bump = scenes_texture(scene, noise);
    uint32_t marble = scenes_texture(scene, texture_of_point(TEXTURE_MARBLE));
    picture.channel = 1;
    uint32_t share = scenes_texture(scene, picture);
    uint32_t wall = scenes_material(
        scene, (struct material){
                   .texture = { [SLOT_REFLECTANCE] = marble + 1, [SLOT_BUMP] = bump + 1 } });
    uint32_t metal = scenes_material(scene,
                                     (struct material){ .kind = MATERIAL_CONDUCTOR,
                                                        .flags = MATERIAL_METAL | MATERIAL_REMAP,
                                                        .texture = { [SLOT_REFLECTANCE] = color + 1,
                                                                     [SLOT_ROUGHNESS_U] = share + 1,
                                                                     [SLOT_ROUGHNESS_V] = share + 1,
                                                                     [SLOT_NORMAL] = color + 1 } });
    uint32_t plain = scenes_diffuse(scene, 0.5f);
    uint32_t mix = scenes_material(scene,
                                   (struct material){ .kind = MATERIAL_MIX,
                                                      .mix = { metal, plain },
                                                      .texture = { [SLOT_AMOUNT] = share + 1 } });
    scenes_room(scene, wall, plain);
    scenes_quadric(scene, QUADRIC_SPHERE, -0.4f, -0.6f, 0.2f, 0.35f, mix, 0);
    scenes_quadric(scene, QUADRIC_DISK, 0.6f, 0.4f, 0.5f, 0.3f, metal, 0);
    scenes_quad_with_uv(scene, (float[3]){ 0.1f, -0.8f, 0 }, (float[3]){ 0.7f, 0.1f, 0.2f },
                        (float[3]){ -0.2f, 0.8f, 0.1f }, metal)
        ->alpha = share + 1;
    return scene;
}

static void lanes_and_instruction_sets_give_the_same_bits(void **state)
{
    (void)state;
    struct scene *scene = textured_room();
    struct picture *a = take(scene, 8);
    assert_true(a->mean > 0.01);
    assert_int_equal(a->failed, 0);
    picture_expect_any_lanes(scene, a, 8);
    struct picture *b = picture_take(scene, (struct picture_how){ .samples = 8, .seed = 1 });
    assert_false(picture_same(a, b)); /* the comparison can fail */
    picture_free(b);
    picture_free(a);
    scene_free(scene);
}

static void a_flat_map_gives_the_picture_without_a_map(void **state)
{
    (void)state;
    struct picture *pictures[2];
    for (int mapped = 0; mapped < 2; mapped++) {
        struct scene *scene = textured_room();
        uint32_t flat = scenes_texture(scene, texture_constant(0.5f, 0.5f, 1));
        for (uint32_t i = 0; i < scene->material_count; i++) {
            scene->materials[i].texture[SLOT_BUMP] = mapped ? flat + 1 : 0;
            scene->materials[i].texture[SLOT_NORMAL] = mapped ? flat + 1 : 0;
        }
        pictures[mapped] = take(scene, 4);
        scene_free(scene);
    }
    picture_expect_same(pictures[0], pictures[1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(far_checks_converge_to_their_mean_with_less_noise_than_unfiltered),
        cmocka_unit_test(alpha_lets_its_share_of_rays_through),
        cmocka_unit_test(alpha_lets_its_share_of_shadow_rays_through),
        cmocka_unit_test(a_bumpy_wall_is_as_bright_as_the_tilted_one),
        cmocka_unit_test(a_bumpy_dark_box_leaks_nothing),
        cmocka_unit_test(a_mix_follows_its_texture),
        cmocka_unit_test(lanes_and_instruction_sets_give_the_same_bits),
        cmocka_unit_test(a_flat_map_gives_the_picture_without_a_map),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
