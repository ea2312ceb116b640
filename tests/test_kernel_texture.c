/*
 * Textures: every kind and mapping against closed forms or a slow computation in double, and what
 * they make of materials, normals and the coordinates of shapes. Pictures of what has textures are
 * test_kernel_textured's. H numbers are those of the numerics notes, section 2.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/hit.h"
#include "worker/kernel/noise.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define WHITE_COLOR \
    {               \
        1, 1, 1, 1  \
    }

/* ---- scenes of textures */

/* One value per level, so that what is read says which levels it came from */
static uint32_t picture_of_level_numbers(struct scene *scene, uint32_t size, uint32_t levels)
{
    uint32_t index;
    float *texel = scenes_picture(scene, size, size, 1, levels, TEXEL_FLOAT, &index);
    for (uint32_t l = 0; l < levels; l++)
        for (uint32_t i = 0; i < (size >> l) * (size >> l); i++)
            *texel++ = (float)l;
    return index;
}

static struct texture_set *set_of(struct scene *scene)
{
    struct err err = { .code = ERR_OK };
    profile_thread_mode();
    struct texture_set *set = texture_set_open(scene, &err);
    if (set == NULL)
        fail_msg("%s", err.text);
    return set;
}

static const struct texture_point nowhere = {
    .n = { 0, 0, 1 }, .dpdu = { 1, 0, 0 }, .dpdv = { 0, 1, 0 }, .color = WHITE_COLOR
};

static struct texture_point at_uv(float u, float v)
{
    struct texture_point point = nowhere;
    point.uv[0] = u;
    point.uv[1] = v;
    return point;
}

static struct texture_point at_p(double x, double y, double z)
{
    struct texture_point point = nowhere;
    point.p[0] = (float)x;
    point.p[1] = (float)y;
    point.p[2] = (float)z;
    return point;
}

/* The value of one texture of no children, at one point */
static float value_at(struct texture texture, const struct texture_point *point)
{
    struct scene *scene = scenes_begin(1, 1);
    scenes_texture(scene, texture);
    struct texture_set *set = set_of(scene);
    float rgb[3];
    texture_at(set, 0, point, rgb);
    texture_set_close(set);
    scene_free(scene);
    return rgb[0];
}

static float red_at(const struct texture_set *set, uint32_t texture,
                    const struct texture_point *point)
{
    float rgb[3];
    texture_at(set, texture, point, rgb);
    return rgb[0];
}

/* ---- trees */

static void trees_are_evaluated_children_first(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t a = scenes_texture(scene, texture_constant(0.2f, 0.4f, 0.6f));
    uint32_t b = scenes_texture(scene, texture_constant(0.5f, 0.25f, 2));
    uint32_t scaled = scenes_texture(
        scene, (struct texture){ .kind = TEXTURE_SCALE, .child = { a + 1, b + 1 } });
    uint32_t mixed = scenes_texture(
        scene, (struct texture){ .kind = TEXTURE_MIX,
                                 .child = { scaled + 1, 0, 0 },
                                 .value = { { 9, 9, 9 }, { 1, 1, 1 }, { 0.25f, 0.25f, 0.25f } } });
    uint32_t inverse = scenes_texture(scene, (struct texture){ .kind = TEXTURE_SCALE,
                                                               .flags = TEXTURE_INVERT,
                                                               .child = { mixed + 1 },
                                                               .value = { { 0 }, { 1, 1, 1 } } });
    struct texture_set *set = set_of(scene);
    const double want[3] = { 0.75 * 0.1 + 0.25, 0.75 * 0.1 + 0.25, 0.75 * 1.2 + 0.25 };
    float rgb[3];
    texture_at(set, mixed, &nowhere, rgb);
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(rgb[c], want[c], 1e-6);
    texture_at(set, inverse, &nowhere, rgb);
    for (int c = 0; c < 3; c++)
        EXPECT_NEAR(rgb[c], fmax(0, 1 - want[c]), 1e-6); /* never below 0: the blue one */
    assert_false(texture_uses_p(set, mixed));
    texture_set_close(set);
    scene_free(scene);
}

static void deep_trees_cost_no_more_than_their_nodes_and_too_deep_ones_are_refused(void **state)
{
    (void)state;
    for (uint32_t depth = TEXTURE_STEPS; depth <= TEXTURE_STEPS + 1; depth++) {
        struct scene *scene = scenes_begin(1, 1);
        scenes_texture(scene, texture_constant(0.3f, 0.3f, 0.3f));
        while (scene->texture_count < depth) /* 2^63 paths lead down to the first */
            scenes_texture(
                scene, (struct texture){ .kind = TEXTURE_MIX,
                                         .child = { scene->texture_count, scene->texture_count },
                                         .value = { { 0 }, { 0 }, { 0.5f, 0.5f, 0.5f } } });
        struct err err = { .code = ERR_OK };
        struct texture_set *set = texture_set_open(scene, &err);
        if (depth <= TEXTURE_STEPS) {
            assert_non_null(set);
            EXPECT_NEAR(red_at(set, depth - 1, &nowhere), 0.3, 1e-6);
        } else {
            assert_null(set);
            assert_int_equal(err.code, ERR_SCENE);
        }
        texture_set_close(set);
        scene_free(scene);
    }
}

static void bilerp_vertex_colours_and_directions_have_their_formulas(void **state)
{
    (void)state;
    struct texture bilerp = { .kind = TEXTURE_BILERP,
                              .map = SCENES_UV_MAP,
                              .value = { { 1 }, { 2 }, { 4 }, { 8 } } };
    struct texture_point point = at_uv(0.25f, 0.75f);
    EXPECT_NEAR(value_at(bilerp, &point), 0.75 * (0.25 * 1 + 0.75 * 2) + 0.25 * (1 + 6), 1e-6);
    point = at_uv(0, 1);
    EXPECT_NEAR(value_at(bilerp, &point), 2, 0); /* v01 is at v = 1 */

    struct texture color = { .kind = TEXTURE_VERTEX_COLOR, .channel = SCENE_NONE };
    point.color[0] = 0.3f;
    point.color[3] = 0.7f;
    EXPECT_NEAR(value_at(color, &point), 0.3f, 0);
    color.channel = 3;
    EXPECT_NEAR(value_at(color, &point), 0.7f, 0);

    struct texture direction = { .kind = TEXTURE_DIRECTION,
                                 .value = { { 1 }, { 0 }, { 0.6f, 0, -0.8f } } };
    EXPECT_NEAR(value_at(direction, &nowhere), 0.8f, 1e-7);
}

/* ---- pictures */

/* The texel of number i of an endless row: what wrapping means */
static double endless(const float *row, int size, uint32_t wrap, long i)
{
    long period = wrap == WRAP_MIRROR ? 2 * size : size;
    long k = ((i % period) + period) % period;
    if (wrap == WRAP_MIRROR && k >= size)
        k = 2 * size - 1 - k;
    if (wrap == WRAP_CLAMP)
        k = i < 0 ? 0 : i >= size ? size - 1 : i;
    if (wrap == WRAP_BLACK && (i < 0 || i >= size))
        return 0;
    return (double)row[k];
}

static void pictures_wrap_as_endless_rows_do(void **state) /* H17 */
{
    (void)state;
    static const float row[5] = { 0.1f, 0.9f, 0.4f, 0.7f, 0.2f };
    const double us[] = { 0,    1,    0.5,   0.05,  0.95,  -0.05,  1.05, -0.25, 1.25,
                          -1.3, 2.71, -7.77, -1e-5, 0.125, 31.999, -1,   2,     3 };
    for (uint32_t wrap = WRAP_REPEAT; wrap <= WRAP_MIRROR; wrap++)
        for (int nearest = 0; nearest < 2; nearest++) {
            struct scene *scene = scenes_begin(1, 1);
            uint32_t index;
            memcpy(scenes_picture(scene, 5, 1, 1, 1, TEXEL_FLOAT, &index), row, sizeof(row));
            struct texture texture = texture_image(index, wrap);
            texture.wrap[1] = WRAP_CLAMP;
            texture.flags = nearest ? TEXTURE_NEAREST : 0;
            scenes_texture(scene, texture);
            struct texture_set *set = set_of(scene);
            for (size_t i = 0; i < sizeof(us) / sizeof(us[0]); i++) {
                struct texture_point point = at_uv((float)us[i], 0.5f);
                double x = (double)(float)us[i] * 5 - (nearest ? 0 : 0.5), f = x - floor(x);
                long k = (long)floor(x);
                double want = endless(row, 5, wrap, k);
                if (!nearest)
                    want = (1 - f) * want + f * endless(row, 5, wrap, k + 1);
                double got = (double)red_at(set, 0, &point);
                if (!(fabs(got - want) < 2e-5))
                    fail_msg("wrap %u, nearest %d, u %g: %g, want %g", wrap, nearest, us[i], got,
                             want);
            }
            /* Whatever the coordinates, a value that the picture has */
            const float wild[] = {
                1e8f, -1e8f, 3e38f, -3e38f, __builtin_inff(), __builtin_nanf("")
            };
            for (size_t i = 0; i < sizeof(wild) / sizeof(wild[0]); i++) {
                struct texture_point point = at_uv(wild[i], wild[5 - i]);
                float got = red_at(set, 0, &point);
                assert_true(got >= 0 && got <= 0.9f);
            }
            texture_set_close(set);
            scene_free(scene);
        }
}

/* Coordinates and points that are huge or none: every kind of texture has a value there, made of
 * what it is made of at sound ones */
static void wild_coordinates_find_sound_values(void **state) /* H17 */
{
    (void)state;
    static const float wild[] = { 1,
                                  0x1.fffffep-1f,
                                  -0.0f,
                                  -1e-30f,
                                  1e8f,
                                  -1e8f,
                                  16777216,
                                  3e38f,
                                  -3e38f,
                                  __builtin_inff(),
                                  -__builtin_inff(),
                                  __builtin_nanf("") };
    enum { WILD = sizeof(wild) / sizeof(wild[0]) };
    static const uint32_t kinds[] = { TEXTURE_IMAGE, TEXTURE_CHECKERBOARD, TEXTURE_DOTS,
                                      TEXTURE_MARBLE };
    for (size_t k = 0; k < sizeof(kinds) / sizeof(kinds[0]); k++)
        for (uint32_t mapping = MAPPING_UV; mapping <= MAPPING_POINT; mapping++) {
            bool noise = kinds[k] == TEXTURE_MARBLE;
            if ((mapping == MAPPING_POINT) != noise)
                continue;
            struct scene *scene = scenes_begin(1, 1);
            struct texture texture = { .kind = kinds[k],
                                       .map = SCENES_UV_MAP,
                                       .value = { { 0.25f }, { 0.75f } } };
            uint32_t index;
            float *texels = scenes_picture(scene, 4, 4, 1, 3, TEXEL_FLOAT, &index);
            for (int i = 0; i < 21; i++)
                texels[i] = i % 2 ? 0.25f : 0.75f;
            if (kinds[k] == TEXTURE_IMAGE)
                texture = texture_image(index, WRAP_REPEAT);
            if (noise)
                texture = texture_of_point(kinds[k]);
            const float point_map[12] = SCENES_POINT_MAP;
            if (mapping != MAPPING_UV)
                memcpy(texture.map, point_map, sizeof(point_map));
            texture.mapping = mapping;
            scenes_texture(scene, texture);
            struct texture_set *set = set_of(scene);
            for (int i = 0; i < WILD * WILD * 4; i++) {
                struct texture_point point = at_uv(wild[i % WILD], wild[i / WILD % WILD]);
                const float widths[] = { 0, 1e-3f, 1e8f, __builtin_inff() };
                point.width = widths[i / WILD / WILD];
                for (int axis = 0; axis < 3; axis++)
                    point.p[axis] = wild[(i + 5 * axis) % WILD];
                float got = red_at(set, 0, &point);
                if (!(got >= (noise ? 0 : 0.249f) && got <= (noise ? 1 : 0.751f)))
                    fail_msg("kind %u, mapping %u at (%g, %g), width %g: %g", kinds[k], mapping,
                             (double)point.uv[0], (double)point.uv[1], (double)point.width,
                             (double)got);
            }
            texture_set_close(set);
            scene_free(scene);
        }
}

static void pictures_stand_upright(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t index;
    const float rows[4] = { 1, 2, 3, 4 }; /* top left, top right, bottom left, bottom right */
    memcpy(scenes_picture(scene, 2, 2, 1, 1, TEXEL_FLOAT, &index), rows, sizeof(rows));
    scenes_texture(scene, texture_image(index, WRAP_CLAMP));
    struct texture_set *set = set_of(scene);
    struct texture_point bottom_left = at_uv(0, 0), top_right = at_uv(1, 1);
    EXPECT_NEAR(red_at(set, 0, &bottom_left), 3, 0);
    EXPECT_NEAR(red_at(set, 0, &top_right), 2, 0);
    texture_set_close(set);
    scene_free(scene);
}

static void texels_are_decoded_exactly(void **state)
{
    (void)state;
    profile_thread_mode(); /* denormals are zero here, and halves must not be */
    for (uint32_t bits = 0; bits < 65536; bits++) {
        int exponent = bits >> 10 & 31;
        double mantissa = bits & 1023;
        double want = exponent == 0 ? ldexp(mantissa, -24) : ldexp(1024 + mantissa, exponent - 25);
        if (exponent == 31)
            want = mantissa == 0 ? (double)INFINITY : (double)NAN;
        if (bits & 0x8000)
            want = -want;
        float got = texture_half((uint16_t)bits);
        if (!((double)got == want || (isnan(got) && isnan(want))))
            fail_msg("half %#x: %g, want %g", bits, (double)got, want);
    }
    for (int srgb = 0; srgb < 2; srgb++) {
        struct scene *scene = scenes_begin(1, 1);
        uint32_t index;
        uint8_t *texels = scenes_picture(scene, 256, 1, 4, 1, srgb ? TEXEL_U8_SRGB : TEXEL_U8,
                                         &index);
        for (int i = 0; i < 256; i++) {
            texels[4 * i] = (uint8_t)i;
            texels[4 * i + 1] = (uint8_t)(255 - i);
            texels[4 * i + 3] = (uint8_t)i;
        }
        struct texture texture = texture_image(index, WRAP_CLAMP);
        texture.flags = TEXTURE_NEAREST;
        scenes_texture(scene, texture);
        texture.channel = 3;
        scenes_texture(scene, texture);
        texture.channel = 1;
        scenes_texture(scene, texture);
        struct texture_set *set = set_of(scene);
        for (int i = 0; i < 256; i++) {
            struct texture_point point = at_uv(((float)i + 0.5f) / 256, 0.5f);
            double v = i / 255.0, back = 1 - v;
            double curve = v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
            double other = back <= 0.04045 ? back / 12.92 : pow((back + 0.055) / 1.055, 2.4);
            float rgb[3];
            texture_at(set, 0, &point, rgb);
            EXPECT_NEAR(rgb[0], srgb ? curve : v, 6e-8);
            EXPECT_NEAR(rgb[2], 0, 0);
            EXPECT_NEAR(red_at(set, 1, &point), v, 6e-8); /* alpha knows no curve */
            EXPECT_NEAR(red_at(set, 2, &point), srgb ? other : back, 6e-8);
        }
        texture_set_close(set);
        scene_free(scene);
    }
}

static void grey_and_absent_alpha_are_what_they_mean(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t index;
    float *texel = scenes_picture(scene, 1, 1, 2, 1, TEXEL_FLOAT, &index);
    texel[0] = 0.25f;
    texel[1] = 0.5f;
    for (uint32_t channel = 0; channel < 4; channel++) {
        struct texture texture = texture_image(index, WRAP_REPEAT);
        texture.channel = channel;
        scenes_texture(scene, texture);
    }
    scenes_texture(scene, texture_image(index, WRAP_REPEAT));
    float *plain = scenes_picture(scene, 1, 1, 3, 1, TEXEL_FLOAT, &index);
    plain[2] = 0.75f;
    struct texture texture = texture_image(index, WRAP_REPEAT);
    texture.channel = 3;
    scenes_texture(scene, texture);
    struct texture_set *set = set_of(scene);
    const double want[] = { 0.25, 0.25, 0.25, 0.5, 0.25, 1 };
    for (uint32_t i = 0; i < 6; i++)
        EXPECT_NEAR(red_at(set, i, &nowhere), want[i], 0);
    texture_set_close(set);
    scene_free(scene);
}

static void levels_are_chosen_by_the_footprint(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    scenes_texture(scene, texture_image(picture_of_level_numbers(scene, 64, 7), WRAP_REPEAT));
    struct texture_set *set = set_of(scene);
    for (double width = 1e-4; width < 100; width *= 1.37) {
        struct texture_point point = at_uv(0.3f, 0.8f);
        point.width = (float)width;
        /* In texels of the full size; dpdu is 1 long */
        double texels = 2 * (double)point.width * 64, level = 0;
        if (texels > 1) {
            int whole = (int)floor(log2(texels));
            level = whole >= 6 ? 6 : whole + (texels / ldexp(1, whole) - 1);
        }
        EXPECT_NEAR(red_at(set, 0, &point), level, 1e-5);
        /* Twice as many texels across the same surface, or half the surface: a level more */
        if (texels > 1 && texels < 16) {
            point.dpdu[0] = 0.5f;
            point.dpdv[1] = 0.5f;
            EXPECT_NEAR(red_at(set, 0, &point), level + 1, 1e-5);
        }
    }
    texture_set_close(set);
    scene_free(scene);
}

/* ---- mappings: where they lead, and how wide their footprint is */

static void mapping_in_double(const struct texture *t, const double uv[2], const double p[3],
                              double st[2])
{
    double q[3];
    for (int row = 0; row < 3; row++) {
        q[row] = (double)t->map[4 * row + 3];
        for (int axis = 0; axis < 3; axis++)
            q[row] += (double)t->map[4 * row + axis] * p[axis];
    }
    double phi = atan2(q[1], q[0]), length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
    switch (t->mapping) {
    case MAPPING_UV:
        for (int i = 0; i < 2; i++)
            st[i] = (double)t->map[3 * i] * uv[0] + (double)t->map[3 * i + 1] * uv[1] +
                    (double)t->map[3 * i + 2];
        break;
    case MAPPING_SPHERICAL:
        st[0] = acos(q[2] / length) / M_PI;
        st[1] = (phi < 0 ? phi + 2 * M_PI : phi) / (2 * M_PI);
        break;
    case MAPPING_CYLINDRICAL:
        st[0] = phi / (2 * M_PI) + 0.5;
        st[1] = q[2];
        break;
    default:
        st[0] = q[0];
        st[1] = q[1];
    }
}

static void mappings_lead_where_they_say_and_know_their_footprint(void **state)
{
    (void)state;
    struct random_lanes r = { 11, 0 };
    for (uint32_t mapping = MAPPING_UV; mapping <= MAPPING_CYLINDRICAL; mapping++)
        for (int round = 0; round < 200; round++) {
            struct scene *scene = scenes_begin(1, 1);
            struct texture t = texture_image(picture_of_level_numbers(scene, 64, 7), WRAP_REPEAT);
            t.mapping = mapping;
            for (int i = 0; i < 12; i++)
                t.map[i] = (float)(2 * random_double(&r) - 1);
            scenes_texture(scene, t);
            struct texture s_alone = t;
            s_alone.kind = TEXTURE_BILERP; /* s, and t: u or v of the mapping itself */
            s_alone.value[2][0] = s_alone.value[3][0] = 1;
            scenes_texture(scene, s_alone);
            struct texture t_alone = t;
            t_alone.kind = TEXTURE_BILERP;
            t_alone.value[1][0] = t_alone.value[3][0] = 1;
            scenes_texture(scene, t_alone);
            struct texture_set *set = set_of(scene);

            /* A skew patch: uv and p move together */
            struct texture_point point = nowhere;
            double uv[2], p[3], du[3], dv[3], n[3];
            for (int axis = 0; axis < 3; axis++) {
                point.p[axis] = (float)(4 * random_double(&r) - 2);
                point.dpdu[axis] = (float)(2 * random_double(&r) - 1);
                point.dpdv[axis] = (float)(2 * random_double(&r) - 1);
                p[axis] = (double)point.p[axis];
                du[axis] = (double)point.dpdu[axis];
                dv[axis] = (double)point.dpdv[axis];
            }
            for (int i = 0; i < 2; i++)
                uv[i] = (double)(point.uv[i] = (float)random_double(&r));
            for (int axis = 0; axis < 3; axis++)
                n[axis] = du[(axis + 1) % 3] * dv[(axis + 2) % 3] -
                          du[(axis + 2) % 3] * dv[(axis + 1) % 3];
            double area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            if (area < 0.05) {
                texture_set_close(set);
                scene_free(scene);
                continue;
            }
            for (int axis = 0; axis < 3; axis++)
                point.n[axis] = (float)(n[axis] / area);
            double st[2];
            mapping_in_double(&t, uv, p, st);
            EXPECT_NEAR(red_at(set, 1, &point), st[0], 2e-5 * (1 + fabs(st[0]) + fabs(st[1])));
            EXPECT_NEAR(red_at(set, 2, &point), st[1], 2e-5 * (1 + fabs(st[0]) + fabs(st[1])));

            /* The gradient along the surface from differences in u and v, through the metric */
            double slope[2][2]; /* [s or t][by u or v] */
            for (int k = 0; k < 2; k++) {
                const double h = 1e-6;
                const double *by = k == 0 ? du : dv;
                double uv2[2] = { uv[0] + (k == 0 ? h : 0), uv[1] + (k == 1 ? h : 0) };
                double p2[3] = { p[0] + h * by[0], p[1] + h * by[1], p[2] + h * by[2] }, st2[2];
                mapping_in_double(&t, uv2, p2, st2);
                for (int i = 0; i < 2; i++) {
                    double step = st2[i] - st[i];
                    slope[i][k] = (step - rint(step)) / h; /* angles begin again */
                }
            }
            double E = du[0] * du[0] + du[1] * du[1] + du[2] * du[2];
            double F = du[0] * dv[0] + du[1] * dv[1] + du[2] * dv[2];
            double G = dv[0] * dv[0] + dv[1] * dv[1] + dv[2] * dv[2];
            double steepest = 0;
            for (int i = 0; i < 2; i++) {
                double a = slope[i][0], b = slope[i][1];
                steepest = fmax(steepest,
                                sqrt((a * a * G - 2 * a * b * F + b * b * E) / (E * G - F * F)));
            }
            /* As wide as to be between the first two levels: 1.5 texels are half way */
            point.width = (float)(1.5 / (2 * 64 * steepest));
            EXPECT_NEAR(red_at(set, 0, &point), 0.5, 2e-3);
            texture_set_close(set);
            scene_free(scene);
        }
}

/* ---- formulas */

static void perlin_noise_has_its_published_values(void **state)
{
    (void)state;
    const float known[3] = { 3.14f, 42, 7 };
    EXPECT_NEAR(noise_at(known), 0.13691995878400012, 3e-7);
    struct random_lanes r = { 5, 0 };
    double sum = 0, least = 0, most = 0;
    for (int i = 0; i < 20000; i++) {
        float p[3], whole[3], far[3], up[3];
        for (int axis = 0; axis < 3; axis++) {
            p[axis] = (float)(64 * random_double(&r) - 32);
            whole[axis] = rintf(p[axis]);
            far[axis] = whole[axis] + 256; /* the lattice repeats */
            up[axis] = whole[axis] + 0.5f;
        }
        EXPECT_NEAR(noise_at(whole), 0, 0);
        far[0] = up[0] + 256;
        far[1] = up[1] - 512;
        far[2] = up[2];
        EXPECT_NEAR(noise_at(far), noise_at(up), 0);
        double value = (double)noise_at(p);
        sum += value;
        least = fmin(least, value);
        most = fmax(most, value);
    }
    EXPECT_NEAR(sum / 20000, 0, 0.01);
    assert_true(least > -1.05 && least < -0.5 && most < 1.05 && most > 0.5);
    const float wild[3] = { 3e38f, __builtin_nanf(""), -__builtin_inff() };
    assert_true(fabsf(noise_at(wild)) <= 1.05f);
}

static void noises_are_their_sums_and_fade_out_under_wide_footprints(void **state)
{
    (void)state;
    const float p[3] = { 1.3f, -2.7f, 0.45f };
    double fbm = 0, turbulence = 0, strength = 1;
    float lambda = 1;
    for (int i = 0; i < 6; i++) {
        const float q[3] = { lambda * p[0], lambda * p[1], lambda * p[2] };
        fbm += strength * (double)noise_at(q);
        turbulence += strength * fabs((double)noise_at(q));
        strength *= 0.5;
        lambda *= 1.99f;
    }
    struct texture_point point = at_p((double)p[0], (double)p[1], (double)p[2]);
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_FBM), &point), fbm, 1e-6);
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_WRINKLED), &point), turbulence + 0.2 * strength,
                1e-6);
    const float far[3] = { 0.1f * p[0], 0.1f * p[1], 0.1f * p[2] };
    double windy = fabs((double)noise_fbm(far, 0, 0.5f, 3)) * (double)noise_fbm(p, 0, 0.5f, 6);
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_WINDY), &point), windy, 1e-6);

    point.width = 10;
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_FBM), &point), 0, 0);
    /* Six octaves at their mean, and the first of them once more */
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_WRINKLED), &point),
                0.2 * (1 + 2 * (1 - 1 / 64.0)), 1e-6);
    /* A footprint of 1/8: two octaves are wider than twice that, and nothing of the third is left
     */
    point.width = 0.125f;
    const float fine[3] = { 1.99f * p[0], 1.99f * p[1], 1.99f * p[2] };
    EXPECT_NEAR(value_at(texture_of_point(TEXTURE_FBM), &point),
                (double)noise_at(p) + 0.5 * (double)noise_at(fine), 1e-6);
}

static void dots_and_marble_stay_in_their_bounds(void **state)
{
    (void)state;
    struct texture dots = { .kind = TEXTURE_DOTS, .map = SCENES_UV_MAP, .value = { { 1 }, { 0 } } };
    struct texture marble = texture_of_point(TEXTURE_MARBLE);
    struct scene *scene = scenes_begin(1, 1);
    scenes_texture(scene, dots);
    scenes_texture(scene, marble);
    struct texture_set *set = set_of(scene);
    struct random_lanes r = { 7, 0 };
    double inside = 0;
    const int n = 40000;
    float rgb[3], least = 1, most = 0;
    for (int i = 0; i < n; i++) {
        struct texture_point point = at_p(20 * random_double(&r), 20 * random_double(&r), 3);
        point.uv[0] = (float)(200 * random_double(&r) - 100);
        point.uv[1] = (float)(200 * random_double(&r) - 100);
        float dot = red_at(set, 0, &point);
        assert_true(dot == 0 || dot == 1);
        inside += (double)dot;
        texture_at(set, 1, &point, rgb);
        least = fminf(least, rgb[0]);
        most = fmaxf(most, rgb[0]);
    }
    /* About half of the cells have a dot of radius .35 */
    EXPECT_NEAR(inside / n, 0.5 * M_PI * 0.35 * 0.35, 0.05);
    assert_true(least > 1.5f * 0.2f && most <= 1.5f * 0.6f + 1e-5f && most > 1.2f * least);
    struct texture_point wild = at_p(3e38, -3e38, 1e30);
    texture_at(set, 1, &wild, rgb);
    assert_true(rgb[0] >= 0 && rgb[0] <= 0.91f);
    texture_set_close(set);
    scene_free(scene);
}

/* The square wave of period 2 seen through a triangle of radius r, summed in small steps */
static double wave_by_steps(double x, double r)
{
    const int n = 20000;
    double sum = 0, weight = 0;
    for (int i = 0; i < n; i++) {
        double t = r * (2 * (i + 0.5) / n - 1), w = r - fabs(t);
        sum += w * (fmod(fabs(floor(x + t)), 2) == 0 ? 1 : -1);
        weight += w;
    }
    return sum / weight;
}

static void checkerboards_are_squares_seen_through_a_triangle(void **state)
{
    (void)state;
    struct texture board = { .kind = TEXTURE_CHECKERBOARD,
                             .map = SCENES_UV_MAP,
                             .value = { { 0 }, { 1 } } };
    const double places[][2] = { { 0.5, 0.5 },   { 1.5, 0.5 },   { -0.5, 0.5 }, { -0.5, -1.5 },
                                 { 0.98, 0.25 }, { 2, 1e-4 },    { -3, 4 },     { 7.3, -2.6 },
                                 { 1e-7, 0.5 },  { 0.9999, 3.3 } };
    const double widths[] = { 0, 1e-6, 0.01, 0.2, 0.32, 0.34, 0.6, 1.4, 20, 1e5 };
    for (size_t i = 0; i < sizeof(places) / sizeof(places[0]); i++)
        for (size_t k = 0; k < sizeof(widths) / sizeof(widths[0]); k++) {
            struct texture_point point = at_uv((float)places[i][0], (float)places[i][1]);
            point.width = (float)widths[k];
            double r = 1.5 * (double)point.width, x = (double)point.uv[0], y = (double)point.uv[1];
            double want;
            if (r > 0)
                want = 0.5 - 0.5 * wave_by_steps(x, r) * wave_by_steps(y, r);
            else
                want = fmod(fabs(floor(x) + floor(y)), 2);
            double got = (double)value_at(board, &point);
            if (!(fabs(got - want) < 2e-3))
                fail_msg("(%g, %g) of width %g: %g, want %g", x, y, widths[k], got, want);
        }
    struct texture cubes = board;
    cubes.flags = TEXTURE_THREE_SPACE;
    cubes.mapping = MAPPING_POINT;
    const float point_map[12] = SCENES_POINT_MAP;
    memcpy(cubes.map, point_map, sizeof(point_map));
    struct texture_point even = at_p(0.5, 1.5, -0.5), odd = at_p(0.5, 1.5, 0.5);
    EXPECT_NEAR(value_at(cubes, &even), 0, 0);
    EXPECT_NEAR(value_at(cubes, &odd), 1, 0);
    odd.width = 100;
    EXPECT_NEAR(value_at(cubes, &odd), 0.5, 1e-3);
}

/* ---- materials and normals */

static void materials_take_what_textures_give_within_bounds(void **state) /* H29 */
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t color = scenes_texture(scene, texture_constant(0.25f, 1.5f, -1));
    uint32_t none = scenes_texture(scene,
                                   texture_constant(__builtin_nanf(""), __builtin_inff(), 0.5f));
    uint32_t rough = scenes_texture(scene, texture_constant(0.09f, 0.09f, 0.09f));
    uint32_t tiny = scenes_texture(scene, texture_constant(1e-7f, 1e-7f, 1e-7f));
    struct texture_set *set = set_of(scene);

    struct material diffuse = { .texture = { [SLOT_REFLECTANCE] = color + 1 } };
    assert_int_equal(textured_parts(&diffuse), TEXTURED_VALUES);
    textured_material(set, &nowhere, &diffuse);
    EXPECT_NEAR(diffuse.reflectance[0], 0.25f, 0);
    EXPECT_NEAR(diffuse.reflectance[1], 1, 0);
    EXPECT_NEAR(diffuse.reflectance[2], 0, 0);
    diffuse.texture[SLOT_REFLECTANCE] = none + 1;
    textured_material(set, &nowhere, &diffuse);
    EXPECT_NEAR(diffuse.reflectance[0], 0, 0);
    EXPECT_NEAR(diffuse.reflectance[1], 1, 0);

    struct material metal = { .kind = MATERIAL_CONDUCTOR,
                              .flags = MATERIAL_METAL | MATERIAL_REMAP,
                              .texture = { [SLOT_REFLECTANCE] = color + 1,
                                           [SLOT_ROUGHNESS_U] = rough + 1,
                                           [SLOT_ROUGHNESS_V] = rough + 1 } };
    textured_material(set, &nowhere, &metal);
    EXPECT_NEAR(metal.eta[0], 1, 0);
    EXPECT_NEAR(metal.k[0], 2 * sqrt(0.25) / sqrt(0.75), 1e-6);
    assert_true(isfinite(metal.k[1]) && metal.k[1] > 100); /* nearly all, never all */
    EXPECT_NEAR(metal.alpha[0], 0.3, 1e-6);
    metal.flags = 0;
    textured_material(set, &nowhere, &metal);
    EXPECT_NEAR(metal.alpha[1], 0.09f, 0);

    /* Both axes below ALPHA_SMOOTH: smooth. One alone: very narrow, but not nothing */
    metal.texture[SLOT_ROUGHNESS_U] = tiny + 1;
    textured_material(set, &nowhere, &metal);
    assert_true(metal.alpha[0] > 0 && metal.alpha[0] < ALPHA_SMOOTH && metal.alpha[1] > 0.08f);
    metal.texture[SLOT_ROUGHNESS_V] = tiny + 1;
    textured_material(set, &nowhere, &metal);
    EXPECT_NEAR(metal.alpha[0], 0, 0);
    EXPECT_NEAR(metal.alpha[1], 0, 0);

    struct material mixture = { .kind = MATERIAL_MIXTURE,
                                .texture = {
                                    [SLOT_REFLECTANCE] = color + 1, [SLOT_SPECULAR] = color + 1 } };
    textured_material(set, &nowhere, &mixture);
    for (int c = 0; c < 3; c++)
        assert_true(mixture.reflectance[c] + mixture.specular[c] <= 1);

    struct material mix = { .kind = MATERIAL_MIX, .texture = { [SLOT_AMOUNT] = color + 1 } };
    EXPECT_NEAR(textured_amount(set, &nowhere, &mix), 0.25f, 0);
    texture_set_close(set);
    scene_free(scene);
}

static void flat_maps_change_no_bit_and_others_tilt_along_their_axes(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    uint32_t flat = scenes_texture(scene, texture_constant(0.5f, 0.5f, 1));
    uint32_t leaning = scenes_texture(scene, texture_constant(0.8f, 0.5f, 0.9f));
    uint32_t up = scenes_texture(scene, texture_constant(0.5f, 0.8f, 0.9f));
    struct texture_set *set = set_of(scene);
    struct texture_point point = nowhere;
    const float wo[3] = { 0.1f, 0.2f, 0.97f };
    float ns[3] = { 0.12345f, -0.3f, 0.9f }, before[3];
    double length = sqrt((double)(ns[0] * ns[0] + ns[1] * ns[1] + ns[2] * ns[2]));
    for (int axis = 0; axis < 3; axis++)
        before[axis] = ns[axis] = (float)((double)ns[axis] / length);
    struct material material = { .texture = { [SLOT_NORMAL] = flat + 1, [SLOT_BUMP] = flat + 1 } };
    assert_int_equal(textured_parts(&material), TEXTURED_NORMALS);
    textured_normal(set, &point, &material, wo, ns);
    assert_memory_equal(ns, before, sizeof(ns));

    /* The map's x leans along dpdu, its y to the side of dpdv, mirrored or not */
    const float want_x = 0.6f / sqrtf(0.36f + 0.64f);
    material = (struct material){ .texture = { [SLOT_NORMAL] = leaning + 1 } };
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        float n[3] = { 0, 0, 1 }, m[3] = { 0, 0, 1 };
        point.dpdv[1] = mirrored ? -2 : 2;
        material.texture[SLOT_NORMAL] = leaning + 1;
        textured_normal(set, &point, &material, wo, n);
        EXPECT_NEAR(n[0], want_x, 1e-6);
        EXPECT_NEAR(n[1], 0, 1e-6);
        material.texture[SLOT_NORMAL] = up + 1;
        textured_normal(set, &point, &material, wo, m);
        EXPECT_NEAR(m[1], mirrored ? -want_x : want_x, 1e-6);
    }
    material.flags = MATERIAL_NORMAL_SCALED;
    material.normal_scale = 0;
    float n[3] = { 0, 0, 1 };
    textured_normal(set, &point, &material, wo, n);
    EXPECT_NEAR(n[2], 1, 0);
    texture_set_close(set);
    scene_free(scene);
}

static void a_bump_that_is_a_slope_is_the_tilted_plane(void **state)
{
    (void)state;
    struct random_lanes r = { 19, 0 };
    for (int round = 0; round < 300; round++) {
        struct scene *scene = scenes_begin(1, 1);
        double a = 2 * random_double(&r) - 1, b = 2 * random_double(&r) - 1;
        scenes_texture(
            scene, (struct texture){
                       .kind = TEXTURE_BILERP,
                       .map = SCENES_UV_MAP,
                       .value = { { 0 }, { (float)b }, { (float)a }, { (float)a + (float)b } } });
        struct texture_set *set = set_of(scene);
        struct texture_point point = at_uv((float)random_double(&r), (float)random_double(&r));
        if (round % 2)
            point.width = 0.01f;
        double du[3], dv[3], n[3];
        for (int axis = 0; axis < 3; axis++) {
            point.dpdu[axis] = (float)(4 * random_double(&r) - 2);
            point.dpdv[axis] = (float)(4 * random_double(&r) - 2);
            du[axis] = (double)point.dpdu[axis];
            dv[axis] = (double)point.dpdv[axis];
        }
        for (int axis = 0; axis < 3; axis++)
            n[axis] = du[(axis + 1) % 3] * dv[(axis + 2) % 3] -
                      du[(axis + 2) % 3] * dv[(axis + 1) % 3];
        double area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        double side = round % 3 ? 1 : -1; /* the normal may be the other one */
        if (area > 0.5) {
            /* The plane through p + h n: its tangents are dpdu + a n and dpdv + b n */
            double tu[3], tv[3], want[3], sum = 0;
            float wo[3], ns[3];
            for (int axis = 0; axis < 3; axis++) {
                double unit = side * n[axis] / area;
                tu[axis] = du[axis] + a * unit;
                tv[axis] = dv[axis] + b * unit;
                point.n[axis] = ns[axis] = wo[axis] = (float)unit;
            }
            for (int axis = 0; axis < 3; axis++) {
                want[axis] = side * (tu[(axis + 1) % 3] * tv[(axis + 2) % 3] -
                                     tu[(axis + 2) % 3] * tv[(axis + 1) % 3]);
                sum += want[axis] * want[axis];
            }
            struct material material = { .texture = { [SLOT_BUMP] = 1 } };
            textured_normal(set, &point, &material, wo, ns);
            double cosine = 0;
            for (int axis = 0; axis < 3; axis++)
                cosine += want[axis] / sqrt(sum) * (double)point.n[axis];
            for (int axis = 0; cosine > 0.05 && axis < 3; axis++) /* less is turned back */
                EXPECT_NEAR(ns[axis], want[axis] / sqrt(sum), 3e-3);
            double seen = 0;
            for (int axis = 0; axis < 3; axis++)
                seen += (double)ns[axis] * (double)wo[axis];
            assert_true(seen > 0.015);
        }
        texture_set_close(set);
        scene_free(scene);
    }
}

/* ---- texture coordinates of shapes */

static void quadrics_have_pbrts_coordinates(void **state)
{
    (void)state;
    struct random_lanes r = { 23, 0 };
    for (int round = 0; round < 400; round++) {
        struct quadric q = { .kind = (uint32_t)round % 2 ? QUADRIC_DISK : QUADRIC_SPHERE,
                             .radius = (float)(0.5 + random_double(&r)),
                             .phi_max = round % 3 ? 7 : (float)(1 + 4 * random_double(&r)) };
        q.z_min = -q.radius * (float)random_double(&r);
        q.z_max = q.radius * (float)random_double(&r);
        q.inner_radius = q.kind == QUADRIC_DISK ? 0.3f * q.radius : 0;
        for (int i = 0; i < 9; i++)
            q.to_world[i] = (float)(2 * random_double(&r) - 1);
        double phi_max = fmin((double)q.phi_max, 2 * M_PI), R = (double)q.radius;
        double t0 = acos((double)q.z_min / R), t1 = acos((double)q.z_max / R);
        double uv[2] = { 0.05 + 0.9 * random_double(&r), 0.05 + 0.9 * random_double(&r) };
        double place[3][3]; /* at (u, v), a little further in u, and in v */
        const double h = 1e-6;
        for (int k = 0; k < 3; k++) {
            double phi = (uv[0] + (k == 1 ? h : 0)) * phi_max, v = uv[1] + (k == 2 ? h : 0);
            double theta = t0 + v * (t1 - t0);
            double radius = q.kind == QUADRIC_SPHERE ? R * sin(theta)
                                                     : R - v * (R - (double)q.inner_radius);
            place[k][0] = radius * cos(phi);
            place[k][1] = radius * sin(phi);
            place[k][2] = q.kind == QUADRIC_SPHERE ? R * cos(theta) : 0;
        }
        struct surface8 s = { .u = F8(0) };
        hit_quadric_uv(&q, I8(-1),
                       vec3x8_all((float)place[0][0], (float)place[0][1], (float)place[0][2]), &s);
        EXPECT_NEAR(s.u[3], uv[0], 2e-5);
        EXPECT_NEAR(s.v[3], uv[1], 2e-5 / (t0 - t1) + 1e-5);
        const f8 *got[2] = { &s.dpdu.x, &s.dpdv.x };
        for (int k = 0; k < 2; k++)
            for (int axis = 0; axis < 3; axis++) {
                double want = 0;
                for (int i = 0; i < 3; i++)
                    want += (double)q.to_world[3 * axis + i] * (place[k + 1][i] - place[0][i]) / h;
                EXPECT_NEAR(got[k][axis][0], want, 1e-3);
            }
    }
}

static void triangles_interpolate_coordinates_and_colours(void **state)
{
    (void)state;
    struct scene *scene = scenes_begin(1, 1);
    /* Before it another, so that shifts count; and one without coordinates */
    scenes_quad_with_uv(scene, (float[3]){ 9, 9, 9 }, (float[3]){ 1, 0, 0 }, (float[3]){ 0, 1, 0 },
                        scenes_diffuse(scene, 1));
    struct mesh *mesh = scenes_quad_with_uv(scene, (float[3]){ -1, -1, 2 }, (float[3]){ 4, 0, 0 },
                                            (float[3]){ 0, 3, 1 }, 0);
    mesh->flags |= MESH_COLORS;
    mesh->color_shift = 0u - mesh->first_vertex;
    for (uint32_t i = 0; i < 16; i++)
        scene->colors[i] = i % 4 == 3 ? 1 : (float)(i / 4);
    scene->color_count = 4;
    for (int with = 0; with < 2; with++) {
        if (with == 0)
            mesh->flags &= ~(unsigned)(MESH_UVS | MESH_COLORS);
        else
            mesh->flags |= MESH_UVS | MESH_COLORS;
        /* Triangle 1: corners 0, 2, 3 */
        struct hit_corners8 at = { I8(1), I8(1), I8(4), I8(6), I8(7) };
        struct surface8 s = { .ng = vec3x8_all(0, 0, 1) };
        for (int c = 0; c < 4; c++)
            s.color[c] = F8(1);
        struct vec3x8 e1 = vec3x8_all(4, 3, 1), e2 = vec3x8_all(0, 3, 1);
        hit_triangle_uv(scene, I8((int32_t)mesh->flags), &at, e1, e2, F8(0.25f), F8(0.5f), &s);
        EXPECT_NEAR(s.u[0], with ? 0.25 : 0.75, 1e-6);
        EXPECT_NEAR(s.v[0], with ? 0.75 : 0.5, 1e-6);
        EXPECT_NEAR(s.dpdu.x[0], 4, 1e-6);
        EXPECT_NEAR(s.dpdu.y[0], with ? 0 : 3, 1e-6);
        EXPECT_NEAR(s.dpdv.x[0], with ? 0 : -4, 1e-6);
        EXPECT_NEAR(s.dpdv.y[0], with ? 3 : 0, 1e-6);
        EXPECT_NEAR(s.color[0][0], with ? 0.25 * 2 + 0.5 * 3 : 1, 1e-6);
        EXPECT_NEAR(s.color[3][0], 1, 1e-6);
    }
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(trees_are_evaluated_children_first),
        cmocka_unit_test(deep_trees_cost_no_more_than_their_nodes_and_too_deep_ones_are_refused),
        cmocka_unit_test(bilerp_vertex_colours_and_directions_have_their_formulas),
        cmocka_unit_test(pictures_wrap_as_endless_rows_do),
        cmocka_unit_test(wild_coordinates_find_sound_values),
        cmocka_unit_test(pictures_stand_upright),
        cmocka_unit_test(texels_are_decoded_exactly),
        cmocka_unit_test(grey_and_absent_alpha_are_what_they_mean),
        cmocka_unit_test(levels_are_chosen_by_the_footprint),
        cmocka_unit_test(mappings_lead_where_they_say_and_know_their_footprint),
        cmocka_unit_test(perlin_noise_has_its_published_values),
        cmocka_unit_test(noises_are_their_sums_and_fade_out_under_wide_footprints),
        cmocka_unit_test(dots_and_marble_stay_in_their_bounds),
        cmocka_unit_test(checkerboards_are_squares_seen_through_a_triangle),
        cmocka_unit_test(materials_take_what_textures_give_within_bounds),
        cmocka_unit_test(flat_maps_change_no_bit_and_others_tilt_along_their_axes),
        cmocka_unit_test(a_bump_that_is_a_slope_is_the_tilted_plane),
        cmocka_unit_test(quadrics_have_pbrts_coordinates),
        cmocka_unit_test(triangles_interpolate_coordinates_and_colours),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
