/* Goal: texels mean the same whatever they are stored as, and solid angles are those of the
 * directions. */
#include "common/direction_map.h"
#include "common/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static void expect_near(double got, double want, double by)
{
    if (!(fabs(got - want) <= by))
        fail_msg("%.12g, want %.12g", got, want);
}

static void texels_are_linear_colours(void **state)
{
    (void)state;
    uint8_t texels[4 * TEXEL_BLOCK] = { 0 };
    struct scene_picture picture = { .first_block = 1, .width = 2, .height = 2, .levels = 1 };
    double rgb[3];

    picture.channels = 2; /* grey and alpha */
    texels[TEXEL_BLOCK + 2 * 3] = 51;
    assert_true(direction_map_texel(&picture, texels, 1, 1, rgb));
    for (int c = 0; c < 3; c++)
        expect_near(rgb[c], 0.2, 1e-15);
    picture.texel = TEXEL_U8_SRGB;
    direction_map_texel(&picture, texels, 1, 1, rgb);
    expect_near(rgb[2], 0.0331047666, 1e-9);

    picture.channels = 4;
    picture.texel = TEXEL_HALF;
    const uint16_t halves[] = { 0x3c00, 0xc000, 0x0001, 0, 0x7bff, 0x7c00, 0x7e00, 0 };
    memcpy(texels + TEXEL_BLOCK, halves, sizeof(halves));
    assert_false(direction_map_texel(&picture, texels, 0, 0, rgb));
    expect_near(rgb[0], 1, 0);
    expect_near(rgb[1], 0, 0); /* -2 */
    expect_near(rgb[2], 0x1p-24, 0);
    assert_false(direction_map_texel(&picture, texels, 1, 0, rgb));
    expect_near(rgb[0], 65504, 0);
    expect_near(rgb[1], 0, 0); /* infinite */
    expect_near(rgb[2], 0, 0); /* not a number */

    picture.channels = 3;
    picture.texel = TEXEL_FLOAT;
    const float floats[] = { 0, 0, 0, 1e30f, NAN, 3 };
    memcpy(texels + TEXEL_BLOCK, floats, sizeof(floats));
    assert_true(direction_map_texel(&picture, texels, 0, 0, rgb));
    assert_false(direction_map_texel(&picture, texels, 1, 0, rgb));
    expect_near(rgb[0], (double)1e30f, 0);
    expect_near(rgb[1], 0, 0);
    expect_near(rgb[2], 3, 0);
}

/* Twice the area of the triangle of directions at three places, close together */
static double twice_triangle(uint32_t layout, const double s[3], const double t[3])
{
    double w[3][3], cross2 = 0;
    for (int i = 0; i < 3; i++)
        direction_map_direction(layout, s[i], t[i], w[i]);
    for (int k = 0; k < 3; k++) {
        int a = (k + 1) % 3, b = (k + 2) % 3;
        double c = (w[1][a] - w[0][a]) * (w[2][b] - w[0][b]) -
                   (w[1][b] - w[0][b]) * (w[2][a] - w[0][a]);
        cross2 += c * c;
    }
    return sqrt(cross2);
}

static void solid_angles_are_those_of_the_directions(void **state)
{
    (void)state;
    for (uint32_t layout = ENVIRONMENT_SQUARE; layout <= ENVIRONMENT_LAT_LONG; layout++) {
        const uint32_t n = 41;
        double sum = 0;
        for (uint32_t y = 0; y < n; y++) {
            double omega = direction_map_omega(layout, n, n, y);
            sum += n * omega;
            for (uint32_t x = 0; x < n; x++) {
                const double h = 1e-5; /* around the texel's middle, off the seams */
                double s = (x + 0.4) / n, t = (y + 0.5) / n;
                const double ss[3] = { s, s + h, s }, tt[3] = { t, t, t + h };
                double middle = twice_triangle(layout, ss, tt) / (h * h * n * n);
                expect_near(middle / omega, 1, layout == ENVIRONMENT_SQUARE ? 1e-3 : 1e-2);
                double w[3];
                direction_map_direction(layout, s, t, w);
                expect_near(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], 1, 1e-14);
            }
        }
        expect_near(sum, 16 * atan(1), 1e-12);
    }
}

static void the_square_is_pbrts(void **state)
{
    (void)state;
    static const double rows[][5] = {
        /* s, t, direction */
        { 0.5, 0.5, 0, 0, 1 }, { 1, 0.5, 1, 0, 0 }, { 0.5, 1, 0, 1, 0 }, { 0, 0.5, -1, 0, 0 },
        { 0.5, 0, 0, -1, 0 },  { 0, 0, 0, 0, -1 },  { 1, 1, 0, 0, -1 }
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        double w[3];
        direction_map_direction(ENVIRONMENT_SQUARE, rows[i][0], rows[i][1], w);
        for (int k = 0; k < 3; k++)
            expect_near(w[k], rows[i][2 + k], 1e-15);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(texels_are_linear_colours),
        cmocka_unit_test(solid_angles_are_those_of_the_directions),
        cmocka_unit_test(the_square_is_pbrts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
