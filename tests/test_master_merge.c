/*
 * Pictures of one job with different seeds become one that is as good as all their samples, and
 * pictures that do not belong together are refused; the heat map shows relative standard errors.
 */
#include "common/err.h"
#include "master/heat.h"
#include "master/image.h"
#include "master/merge.h"
#include "master/picture_file.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tests/expect.h"

#define WIDTH  3
#define HEIGHT 2
#define PIXELS (WIDTH * HEIGHT)

static void fill(struct image *image, const char *name, float value)
{
    float *values = image_channel(image, name);
    if (values == NULL)
        values = image_add_channel(image, name);
    assert_non_null(values);
    for (int p = 0; p < PIXELS; p++)
        values[p] = value;
}

static void set(struct image *image, const char *name, int pixel, float value)
{
    image_channel(image, name)[pixel] = value;
}

static float at(const struct image *image, const char *name, int pixel)
{
    return image_channel(image, name)[pixel];
}

/* A picture of `samples` samples: every colour is `value`, known to `error`. */
static struct image *picture(const char *seed, float samples, float value, float error)
{
    static const char *const COLORS[] = { "R", "G", "B" };
    static const char *const ERRORS[] = { "stderr.R", "stderr.G", "stderr.B" };
    struct image *image = image_new(WIDTH, HEIGHT);
    image->display_width = 10;
    image->data_x = 4;
    for (int c = 0; c < 3; c++) {
        fill(image, COLORS[c], value);
        fill(image, ERRORS[c], error);
    }
    fill(image, "samples", samples);
    image_set_attribute(image, "pathfarm.sceneDigest", "abc");
    image_set_attribute(image, "pathfarm.seed", seed);
    image_note(image, "pathfarm.spp", "%g", (double)samples);
    image_set_attribute(image, "pathfarm.replicates", "4");
    image_set_attribute(image, "pathfarm.stderrDof", "3");
    image_set_attribute(image, "pathfarm.profile", "usual");
    image_set_attribute(image, "pathfarm.coreSeconds", "1.5");
    image_set_attribute(image, "pathfarm.ledger", "round,spp\n");
    image_set_attribute(image, "pathfarm.complete", "yes");
    image_set_attribute(image, "type", "scanlineimage");
    return image;
}

/* Merge and release pictures. */
static struct image *merged(struct image *const *images, int count)
{
    struct err err = { .code = ERR_OK };
    struct merge *merge = merge_new();
    for (int i = 0; i < count; i++) {
        if (!merge_add(merge, images[i], "it", &err))
            fail_msg("%s", err.text);
        image_free(images[i]);
    }
    struct image *image = merge_take(merge, "pathfarm merge", "test", &err);
    assert_non_null(image);
    merge_free(merge);
    return image;
}

static void expect_attribute(const struct image *image, const char *name, const char *want)
{
    const char *text = image_attribute(image, name);
    if (want == NULL ? text != NULL : text == NULL || strcmp(text, want) != 0)
        fail_msg("%s is %s", name, text == NULL ? "missing" : text);
}

static void equal_pictures_are_averaged_and_their_freedom_adds_up(void **state)
{
    (void)state;
    struct image *images[] = { picture("1", 16, 1, 0.3f), picture("2", 16, 2, 0.4f),
                               picture("18446744073709551615", 16, 6, 0) };
    struct image *image = merged(images, 3);
    EXPECT_NEAR(at(image, "G", 5), 3, 1e-6);
    EXPECT_NEAR(at(image, "stderr.G", 5), 0.5 / 3, 1e-6);
    assert_true(at(image, "samples", 0) == 48);
    assert_true(image->display_width == 10 && image->data_x == 4);
    expect_attribute(image, "pathfarm.seeds", "1,2,18446744073709551615");
    expect_attribute(image, "pathfarm.seed", NULL);
    expect_attribute(image, "pathfarm.ledger", NULL);
    expect_attribute(image, "pathfarm.spp", "48");
    expect_attribute(image, "pathfarm.replicates", "12");
    expect_attribute(image, "pathfarm.merged", "3");
    expect_attribute(image, "pathfarm.coreSeconds", "4.5");
    expect_attribute(image, "pathfarm.profile", "usual");
    expect_attribute(image, "pathfarm.complete", "yes");
    expect_attribute(image, "pathfarm.sceneDigest", "abc");
    expect_attribute(image, "type", NULL); /* the file format's, its writer's to set */
    /* (9 + 16)^2 / (81 / 3 + 256 / 3) */
    EXPECT_NEAR(atof(image_attribute(image, "pathfarm.stderrDof")), 625 * 3 / 337.0, 1e-4);
    image_free(image);

    struct image *alike[] = { picture("1", 16, 1, 0.25f), picture("2", 16, 2, 0.25f) };
    image = merged(alike, 2);
    expect_attribute(image, "pathfarm.stderrDof", "6");
    image_free(image);
}

static void samples_are_the_weights_pixel_by_pixel(void **state)
{
    (void)state;
    struct image *images[] = { picture("1", 16, 1, 0.5f), picture("2", 48, 5, 0.25f) };
    set(images[1], "samples", 2, 16);
    set(images[1], "samples", 3, 0);
    set(images[0], "stderr.R", 4, INFINITY);
    image_set_attribute(images[1], "pathfarm.profile", "other");
    image_set_attribute(images[1], "pathfarm.complete", "no");
    struct image *image = merged(images, 2);
    EXPECT_NEAR(at(image, "R", 0), 4, 1e-6);
    EXPECT_NEAR(at(image, "stderr.R", 0), sqrt(0.25 * 0.25 * 0.25 + 0.5625 * 0.0625), 1e-6);
    EXPECT_NEAR(at(image, "R", 2), 3, 1e-6);
    EXPECT_NEAR(at(image, "R", 3), 1, 1e-6);
    EXPECT_NEAR(at(image, "stderr.R", 3), 0.5, 1e-6);
    assert_true(isinf(at(image, "stderr.R", 4)) && isfinite(at(image, "stderr.G", 4)));
    assert_true(at(image, "samples", 0) == 64 && at(image, "samples", 2) == 32);
    expect_attribute(image, "pathfarm.profile", NULL);
    expect_attribute(image, "pathfarm.complete", "no");
    image_free(image);
}

static void a_merged_picture_can_be_merged_again(void **state)
{
    (void)state;
    struct image *first[] = { picture("1", 16, 1, 0.5f), picture("2", 16, 2, 0.5f) };
    struct image *second[] = { merged(first, 2), picture("3", 32, 5, 0.5f) };
    struct image *image = merged(second, 2);
    EXPECT_NEAR(at(image, "B", 0), (1 + 2 + 2 * 5) / 4.0, 1e-6);
    expect_attribute(image, "pathfarm.seeds", "1,2,3");
    expect_attribute(image, "pathfarm.replicates", "12");

    struct err err = { .code = ERR_OK };
    struct image *again = picture("2", 16, 1, 0.5f);
    struct merge *merge = merge_new();
    assert_true(merge_add(merge, image, "all", &err));
    assert_false(merge_add(merge, again, "b.exr", &err));
    assert_non_null(strstr(err.text, "b.exr: seed 2 was merged already"));
    merge_free(merge);
    image_free(again);
    image_free(image);
}

static void layers_are_averages_over_what_was_hit(void **state)
{
    (void)state;
    struct image *images[] = { picture("1", 16, 1, 0), picture("2", 48, 1, 0) };
    for (int i = 0; i < 2; i++) {
        fill(images[i], "A", i == 0 ? 1 : 0.5f);
        fill(images[i], "depth.Z", i == 0 ? 10 : 20);
        fill(images[i], "motion.X", 0);
        fill(images[i], "normal.Y", i == 0 ? -1 : 1);
    }
    /* Nothing was hit in one of them, or in both */
    for (int p = 1; p <= 2; p++)
        for (int i = 2 - p; i < 2; i++) {
            set(images[i], "A", p, 0);
            set(images[i], "depth.Z", p, 0);
            set(images[i], "normal.Y", p, 0);
        }
    struct image *image = merged(images, 2);
    EXPECT_NEAR(at(image, "A", 0), 40.0 / 64, 1e-6);
    EXPECT_NEAR(at(image, "depth.Z", 0), (16 * 10 + 24 * 20) / 40.0, 1e-5);
    EXPECT_NEAR(at(image, "normal.Y", 0), (24 - 16) / 40.0, 1e-6);
    EXPECT_NEAR(at(image, "depth.Z", 1), 10, 1e-5);
    EXPECT_NEAR(at(image, "A", 1), 0.25, 1e-6);
    assert_true(at(image, "depth.Z", 2) == 0 && at(image, "motion.X", 0) == 0);
    image_free(image);
}

/* Pairs of identity and coverage into the ranks of a pixel. */
static void rank(struct image *image, int pixel, const float (*pairs)[2], int count)
{
    for (int i = 0; i < 12; i++) {
        char name[32];
        snprintf(name, sizeof(name), "CryptoMaterial%02d.%c", i / 4, "RGBA"[i % 4]);
        if (image_channel(image, name) == NULL)
            image_add_channel(image, name);
        set(image, name, pixel, i / 2 < count ? pairs[i / 2][i % 2] : 0);
    }
}

static void identities_are_ranked_again(void **state)
{
    (void)state;
    struct image *images[] = { picture("1", 64, 1, 0), picture("2", 16, 1, 0) };
    rank(images[0], 0, (const float[][2]){ { 7, 0.75f }, { -3, 0.25f } }, 2);
    rank(images[1], 0, (const float[][2]){ { -3, 0.5f }, { 9, 0.5f } }, 2);
    static const float many[2][6][2] = {
        { { 1, .3f }, { 2, .2f }, { 3, .2f }, { 4, .1f }, { 5, .05f }, { 6, .1f } },
        { { 11, .3f }, { 2, .2f }, { 13, .2f }, { 6, .1f }, { 15, .1f }, { 16, .1f } },
    };
    rank(images[0], 1, many[0], 6);
    rank(images[1], 1, many[1], 6);
    image_set_attribute(images[0], "cryptomatte/1234567/name", "CryptoMaterial");
    struct image *image = merged(images, 2);
    /* As many samples of each replicate count, however many there are in all */
    assert_true(at(image, "CryptoMaterial00.R", 0) == -3 &&
                at(image, "CryptoMaterial00.B", 0) == 7);
    EXPECT_NEAR(at(image, "CryptoMaterial00.G", 0), 0.375, 1e-6);
    EXPECT_NEAR(at(image, "CryptoMaterial00.A", 0), 0.375, 1e-6);
    EXPECT_NEAR(at(image, "CryptoMaterial01.G", 0), 0.25, 1e-6);
    assert_true(at(image, "CryptoMaterial01.B", 0) == 0 && at(image, "CryptoMaterial01.A", 0) == 0);
    /* Ten together: the six that cover most, and of those that cover as much the lower ones */
    static const float want[6][2] = { { 2, 0.2f }, { 1, 0.15f }, { 11, 0.15f },
                                      { 3, 0.1f }, { 6, 0.1f },  { 13, 0.1f } };
    for (int i = 0; i < 12; i++) {
        char name[32];
        snprintf(name, sizeof(name), "CryptoMaterial%02d.%c", i / 4, "RGBA"[i % 4]);
        EXPECT_NEAR(at(image, name, 1), want[i / 2][i % 2], 1e-6);
    }
    expect_attribute(image, "cryptomatte/1234567/name", "CryptoMaterial");
    image_free(image);
}

static void pictures_that_do_not_belong_together_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const char *const WORDS[] = { "another scene",
                                         "5x2 pixels, not 10x2",
                                         "another crop window",
                                         "no channel depth.Z",
                                         "a channel heat.X",
                                         "seed 1 was merged already",
                                         "only pictures that pathfarm rendered" };
    for (size_t i = 0; i < sizeof(WORDS) / sizeof(WORDS[0]); i++) {
        struct err err = { .code = ERR_OK };
        struct image *first = picture("1", 16, 1, 0);
        struct image *other = picture(i == 5 ? "1" : "2", 16, 1, 0);
        fill(first, "depth.Z", 1);
        if (i != 3)
            fill(other, "depth.Z", 1);
        switch (i) {
        case 0:
            image_set_attribute(other, "pathfarm.sceneDigest", "abd");
            break;
        case 1:
            other->display_width = 5;
            break;
        case 2:
            other->data_x++;
            break;
        case 4:
            fill(other, "heat.X", 1);
            break;
        case 6:
            image_free(other);
            other = image_new(WIDTH, HEIGHT);
            break;
        default:
            break;
        }
        struct merge *merge = merge_new();
        assert_true(merge_add(merge, first, "a.exr", &err));
        assert_false(merge_add(merge, other, "b.exr", &err));
        assert_int_equal(err.code, ERR_ARGUMENT);
        assert_memory_equal(err.text, "b.exr: ", 7);
        if (strstr(err.text, WORDS[i]) == NULL)
            fail_msg("\"%s\" was said, not \"%s\"", err.text, WORDS[i]);
        merge_free(merge);
        image_free(first);
        image_free(other);
    }
    struct err err = { .code = ERR_OK };
    struct image *odd = picture("1", 16, 1, 0);
    struct merge *merge = merge_new();
    fill(odd, "fog", 1);
    assert_false(merge_add(merge, odd, "a.exr", &err));
    assert_non_null(strstr(err.text, "nobody knows how to merge channels fog"));
    merge_free(merge);
    image_free(odd);
}

/* ---- the heat map ---- */

static void heat_is_the_relative_error_pooled_over_neighbours(void **state)
{
    (void)state;
    struct err err = { .code = ERR_OK };
    float values[PIXELS];
    struct image *image = picture("1", 16, 2, 0.1f);
    assert_true(heat_values(image, values, &err));
    EXPECT_NEAR(values[0], sqrt(0.01 / 4.01), 1e-6);
    set(image, "stderr.G", 0, INFINITY);
    assert_true(heat_values(image, values, &err));
    assert_true(isnan(values[0]));
    EXPECT_NEAR(values[1], sqrt(0.01 / 4.01), 1e-6);
    fill(image, "R", 0);
    fill(image, "G", 0);
    fill(image, "B", 0);
    fill(image, "stderr.G", 0.1f);
    set(image, "stderr.R", 5, 0.4f); /* black, noisy; as many neighbours as there are */
    assert_true(heat_values(image, values, &err));
    EXPECT_NEAR(values[5], sqrt((3 * 1 + (1 + 1 + 16) / 3.0) / 4), 1e-6);
    EXPECT_NEAR(values[0], 1, 1e-6);

    struct image *bare = image_new(WIDTH, HEIGHT);
    assert_false(heat_values(bare, values, &err));
    assert_non_null(strstr(err.text, "no channel R"));
    image_free(bare);
    image_free(image);
}

static void colours_get_lighter_with_the_error_and_unknown_is_none_of_them(void **state)
{
    (void)state;
    uint8_t unknown[3], rgb[3], end[3];
    heat_color(NAN, unknown);
    double before = -1;
    for (int i = 0; i <= 60; i++) {
        heat_color((float)(HEAT_LOWEST * pow(HEAT_HIGHEST / HEAT_LOWEST, i / 60.0)), rgb);
        double luma = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        assert_true(luma > before);
        before = luma;
        int apart = 0;
        for (int c = 0; c < 3; c++)
            apart += abs(rgb[c] - unknown[c]);
        assert_true(apart > 100);
    }
    heat_color(100, end);
    assert_memory_equal(rgb, end, 3);
    heat_color(0, rgb);
    assert_true(rgb[0] + rgb[1] + rgb[2] == 0);
}

static void the_map_has_the_picture_above_and_the_scale_below(void **state)
{
    (void)state;
    char folder[256];
    struct err err = { .code = ERR_OK };
    scratch_make(folder);
    const char *path = scratch_path(folder, "heat.png");
    struct image *image = picture("1", 16, 2, 0.1f);
    set(image, "stderr.B", 0, INFINITY);
    if (!heat_write(image, path, &err))
        fail_msg("%s", err.text);
    struct picture *map = picture_file_read(path, NULL, &err);
    assert_non_null(map);
    assert_int_equal(map->channels, 3);
    assert_true(map->width >= 10 && map->height > HEIGHT + 10);
    const uint8_t *rgb = map->pixels;
    uint8_t known[3], unknown[3];
    heat_color((float)sqrt(0.01 / 4.01), known);
    heat_color(NAN, unknown);
    assert_true(rgb[0] + rgb[1] + rgb[2] == 0); /* outside of the crop window */
    assert_memory_equal(rgb + 3 * 4, unknown, 3);
    assert_memory_equal(rgb + 3 * 5, known, 3);
    picture_file_free(map);
    image_free(image);
    scratch_remove(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(equal_pictures_are_averaged_and_their_freedom_adds_up),
        cmocka_unit_test(samples_are_the_weights_pixel_by_pixel),
        cmocka_unit_test(a_merged_picture_can_be_merged_again),
        cmocka_unit_test(layers_are_averages_over_what_was_hit),
        cmocka_unit_test(identities_are_ranked_again),
        cmocka_unit_test(pictures_that_do_not_belong_together_are_refused_with_a_reason),
        cmocka_unit_test(heat_is_the_relative_error_pooled_over_neighbours),
        cmocka_unit_test(colours_get_lighter_with_the_error_and_unknown_is_none_of_them),
        cmocka_unit_test(the_map_has_the_picture_above_and_the_scale_below),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
