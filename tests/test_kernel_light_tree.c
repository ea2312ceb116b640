/*
 * The tree of lights: its probabilities sum to one and are those of its choices, no light that
 * reaches a receiver is left out, and the picture is the one that the table of lights gives. Every
 * sentence is shown to notice a tree that is wrong in a small way. Runs for some ten seconds.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"
#include "worker/kernel/light.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* ---- lights of all kinds, scattered at random */

enum { POLYGONS = 500, OTHERS = 40 };

static void random_point(struct random_lanes *r, double spread, float p[3])
{
    for (int axis = 0; axis < 3; axis++)
        p[axis] = (float)((2 * random_double(r) - 1) * spread);
}

static void random_unit(struct random_lanes *r, float w[3])
{
    struct vec3x8 d = random_direction(r);
    w[0] = d.x[0];
    w[1] = d.y[0];
    w[2] = d.z[0];
}

static void add_polygons(struct scene *scene, struct random_lanes *r, double spread, float offset)
{
    uint32_t black = scenes_diffuse(scene, 0);
    for (int i = 0; i < POLYGONS; i++) {
        float corners[4][3], middle[3], u[3], v[3];
        random_point(r, spread, middle);
        random_unit(r, u);
        random_unit(r, v);
        double size = pow(10, -2 * random_double(r));
        for (int k = 0; k < 4; k++)
            for (int axis = 0; axis < 3; axis++)
                corners[k][axis] = middle[axis] + offset +
                                   (float)size * ((k == 1 || k == 2 ? u[axis] : -u[axis]) +
                                                  (k >= 2 ? v[axis] : -v[axis]));
        scenes_polygon(scene, (const float(*)[3])corners, i % 2 ? 3 : 4, black,
                       (float)pow(10, 3 * random_double(r)));
        if (i % 5 == 0)
            scene->lights[scene->light_count - 1].flags |= LIGHT_TWO_SIDED;
    }
}

static void add_others(struct scene *scene, struct random_lanes *r, double spread)
{
    uint32_t black = scenes_diffuse(scene, 0);
    for (int i = 0; i < OTHERS; i++) {
        float at[3];
        random_point(r, spread, at);
        float radius = (float)(0.3 * random_double(r) + 0.01);
        struct quadric *q = scenes_quadric(scene, i % 2 ? QUADRIC_SPHERE : QUADRIC_DISK, at[0],
                                           at[1], at[2], radius, black, 20);
        if (i % 10 == 1)
            q->flags |= QUADRIC_FLIP_NORMAL;
        if (i % 10 == 2)
            scene->lights[q->light].flags |= LIGHT_TWO_SIDED;
        struct light delta = { .kind = i % 2 ? LIGHT_POINT : LIGHT_SPOT,
                               .radiance = { 5, 5, 5 },
                               .cos_falloff_start = (float)random_double(r),
                               .cos_falloff_end = -0.5f };
        random_point(r, spread, delta.position);
        random_unit(r, delta.direction);
        scenes_light(scene, delta);
    }
}

/* All kinds; a tenth of the lights in one spot, some at the same place, two at infinity and a sky
 */
static struct scene *mixed_scene(uint64_t seed, float offset)
{
    struct random_lanes r = { seed, 0 };
    struct scene *scene = scenes_begin(32, 32);
    add_polygons(scene, &r, 4, offset);
    if (offset == 0)
        add_others(scene, &r, 4);
    for (int i = 0; i < 40; i++)
        scenes_light(scene, (struct light){ .kind = LIGHT_POINT,
                                            .radiance = { 1, 1, 1 },
                                            .position = { 1 + (float)(i % 4) * 1e-4f, 1, 1 } });
    for (int i = 0; i < 2; i++)
        scenes_light(scene, (struct light){ .kind = LIGHT_DISTANT,
                                            .radiance = { 1, 1, 1 },
                                            .direction = { 0, 0, i ? 1 : -1 } });
    scenes_sky(scene, 0.1f);
    scenes_finish(scene);
    assert_true(scene->settings.effects & FX_LIGHT_TREE);
    return scene;
}

/* Receivers near and far, on lights and among them; every fourth without a normal */
static void random_receiver(const struct scene *scene, struct random_lanes *r, struct vec3x8 *p,
                            struct vec3x8 *n)
{
    *n = random_direction(r);
    for (int lane = 0; lane < LANES; lane++) {
        float at[3];
        random_point(r, pow(10, 3 * random_double(r) - 1), at);
        uint32_t some = (uint32_t)(random_double(r) * POLYGONS);
        const float *corner = scene->light_corners + 3 * scene->lights[some].first_corner;
        for (int axis = 0; axis < 3; axis++)
            at[axis] += corner[axis] * (lane % 2 ? 1 : 0.01f);
        p->x[lane] = at[0];
        p->y[lane] = at[1];
        p->z[lane] = at[2];
        if (lane % 4 == 3)
            n->x[lane] = n->y[lane] = n->z[lane] = 0;
    }
}

static struct vec3x8 all_lanes(const struct vec3x8 *a, int lane)
{
    return vec3x8_all(a->x[lane], a->y[lane], a->z[lane]);
}

static double pick_of(const struct kernel_scene *ks, int32_t light, const struct vec3x8 *p,
                      const struct vec3x8 *n, int lane)
{
    return (double)light_pick(ks, FX_ALL, i8_from_bits(1u << lane), *p, *n, I8(light))[lane];
}

/* ---- probabilities */

/* The largest difference from one, over random receivers */
static double worst_sum(const struct scene *scene, const struct kernel_scene *ks, int receivers)
{
    struct random_lanes r = { 3, 0 };
    double worst = 0;
    for (int i = 0; i < receivers; i++) {
        struct vec3x8 p, n;
        random_receiver(scene, &r, &p, &n);
        double sums[LANES] = { 0 };
        for (uint32_t k = 0; k < scene->light_count; k++) {
            f8 pick = light_pick(ks, FX_ALL, I8(-1), p, n, I8((int32_t)k));
            for (int lane = 0; lane < LANES; lane++)
                sums[lane] += (double)pick[lane];
        }
        for (int lane = 0; lane < LANES; lane++)
            worst = fmax(worst, fabs(sums[lane] - 1));
    }
    return worst;
}

static void probabilities_of_all_lights_sum_to_one(void **state)
{
    (void)state;
    struct scene *scene = mixed_scene(1, 0);
    struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
    double worst = worst_sum(scene, ks, 100);
    if (!(worst < 1e-5))
        fail_msg("off by %g", worst);
    /* A sky that is not sampled is never chosen */
    struct vec3x8 zero = vec3x8_all(0, 0, 0);
    assert_true(pick_of(ks, (int32_t)scene->settings.sky_light, &zero, &zero, 0) == 0);

    /* Planted: lights that believe to stand elsewhere */
    ks->light_tree.nodes[1].parent = ks->light_tree.nodes[1].parent ^ 1;
    assert_true(worst_sum(scene, ks, 10) > 1e-3);
    kernel_close(ks);
    scene_free(scene);
}

/* p of Pearson's test of one receiver's choices */
static double choices_p(const struct scene *scene, const struct kernel_scene *ks,
                        const struct vec3x8 *p, const struct vec3x8 *n, bool planted)
{
    static double mass[SCENES_CAPACITY];
    static unsigned long long counts[SCENES_CAPACITY];
    memset(counts, 0, sizeof(counts));
    const int samples = 1 << 17;
    struct random_lanes r = { 8, 0 };
    for (int k = 0; k < samples; k += LANES) {
        f8 u = random_f8(&r), chosen;
        if (planted)
            u = u * (0.9f + 0.1f * u);
        i8 light = light_choose(ks, FX_ALL, I8(-1), *p, *n, u, &chosen);
        f8 pick = light_pick(ks, FX_ALL, I8(-1), *p, *n, light);
        for (int lane = 0; lane < LANES; lane++) {
            counts[light[lane]]++;
            EXPECT_NEAR((double)chosen[lane] / (double)pick[lane], 1, 1e-6);
        }
    }
    for (uint32_t k = 0; k < scene->light_count; k++) {
        mass[k] = pick_of(ks, (int32_t)k, p, n, 0);
        if (!(mass[k] > 0) && counts[k] > 0)
            fail_msg("light %u is chosen, and says never", k);
    }
    return chi2_pooled(mass, counts, (int)scene->light_count, samples);
}

static void lights_are_chosen_as_often_as_they_say(void **state)
{
    (void)state;
    struct scene *scene = mixed_scene(2, 0);
    struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
    struct random_lanes r = { 5, 0 };
    for (int i = 0; i < 5; i++) {
        struct vec3x8 p8, n8;
        random_receiver(scene, &r, &p8, &n8);
        struct vec3x8 p = all_lanes(&p8, i), n = all_lanes(&n8, i);
        double chance = choices_p(scene, ks, &p, &n, false);
        if (!(chance > CHI2_ALPHA))
            fail_msg("receiver %d: p = %g", i, chance);
        assert_true(choices_p(scene, ks, &p, &n, true) < CHI2_CAUGHT);
    }
    kernel_close(ks);
    scene_free(scene);
}

/* ---- no light is left out */

/* Does light k send anything to the front of p? By a random point of it, in double */
static bool reaches(const struct scene *scene, uint32_t k, const double p[3], const double n[3],
                    struct random_lanes *r)
{
    const struct light *light = &scene->lights[k];
    double y[3], facing[3] = { 0, 0, 0 };
    float unit[3];
    random_unit(r, unit);
    if (light->kind == LIGHT_POLYGON) {
        double a = random_double(r), b = random_double(r) * (1 - a);
        const float *c = scene->light_corners + 3 * light->first_corner;
        for (int axis = 0; axis < 3; axis++)
            y[axis] = (double)c[axis] + a * ((double)c[3 + axis] - (double)c[axis]) +
                      b * ((double)c[6 + axis] - (double)c[axis]);
    } else if (light->kind == LIGHT_SPHERE || light->kind == LIGHT_DISK) {
        const struct quadric *q = &scene->quadrics[light->quadric];
        for (int axis = 0; axis < 3; axis++)
            y[axis] = (double)q->center[axis] +
                      (double)q->radius *
                          (double)(light->kind == LIGHT_DISK && axis == 2 ? 0 : unit[axis]);
    } else {
        for (int axis = 0; axis < 3; axis++)
            y[axis] = (double)light->position[axis];
    }
    for (int axis = 0; axis < 3; axis++)
        facing[axis] = light->kind == LIGHT_SPHERE ? (double)unit[axis]
                       : light->kind == LIGHT_SPOT ? (double)light->direction[axis]
                                                   : (double)light->normal[axis];
    double to[3], d2 = 0, front = 0, back = 0, any = 0;
    for (int axis = 0; axis < 3; axis++) {
        to[axis] = y[axis] - p[axis];
        d2 += to[axis] * to[axis];
        front += to[axis] * n[axis];
        back -= to[axis] * facing[axis];
        any += n[axis] * n[axis];
    }
    if (!(d2 > 0) || (any > 0 && !(front > 0)))
        return false;
    if (light->kind == LIGHT_POINT || light->kind == LIGHT_SPHERE)
        return true;
    if (light->kind == LIGHT_SPOT)
        return back / sqrt(d2) > (double)light->cos_falloff_end;
    return back > 0 || (light->flags & LIGHT_TWO_SIDED && back < 0);
}

/* Some light that reaches one of the receivers and would never be chosen by it */
static bool left_out(const struct scene *scene, const struct kernel_scene *ks, int receivers)
{
    struct random_lanes r = { 13, 0 };
    for (int i = 0; i < receivers; i++) {
        struct vec3x8 p8, n8;
        random_receiver(scene, &r, &p8, &n8);
        for (uint32_t k = 0; k < scene->light_count; k++) {
            if (ks->light_tree.place[k] < 0)
                continue;
            f8 pick = light_pick(ks, FX_ALL, I8(-1), p8, n8, I8((int32_t)k));
            for (int lane = 0; lane < LANES; lane++) {
                if (pick[lane] > 0)
                    continue;
                const double p[3] = { (double)p8.x[lane], (double)p8.y[lane], (double)p8.z[lane] };
                const double n[3] = { (double)n8.x[lane], (double)n8.y[lane], (double)n8.z[lane] };
                for (int tries = 0; tries < 20; tries++)
                    if (reaches(scene, k, p, n, &r))
                        return true;
            }
        }
    }
    return false;
}

static void every_light_that_reaches_a_receiver_may_be_chosen(void **state)
{
    (void)state;
    for (int far = 0; far < 2; far++) {
        struct scene *scene = mixed_scene(4, far ? 3e4f : 0);
        struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
        if (left_out(scene, ks, 100))
            fail_msg("a light that reaches its receiver is never chosen, offset %d", far);

        /* Planted: cones a little too narrow, spheres a little too small, a side forgotten */
        for (int plant = 0; plant < 3 && !far; plant++) {
            struct kernel_scene *wrong = scenes_open(scene, (struct picture_how){ 0 });
            for (uint32_t i = 0; i < wrong->light_tree.node_count; i++)
                for (int slot = 0; slot < LANES; slot++) {
                    struct light_node *node = &wrong->light_tree.nodes[i];
                    if (plant == 0 && node->cos_o[slot] < 0.9f) {
                        node->cos_o[slot] += 0.1f;
                        node->sin_o[slot] = sqrtf(1 - node->cos_o[slot] * node->cos_o[slot]);
                    }
                    if (plant == 1)
                        node->radius[slot] *= 0.9f;
                    if (plant == 2)
                        node->power[slot] = fabsf(node->power[slot]);
                }
            if (!left_out(scene, wrong, 200))
                fail_msg("planted bug %d was not noticed", plant);
            kernel_close(wrong);
        }
        kernel_close(ks);
        scene_free(scene);
    }
}

/* ---- the tree itself */

static void few_lights_need_no_tree(void **state)
{
    (void)state;
    for (int more = 0; more < 2; more++) {
        struct scene *scene = scenes_begin(8, 8);
        for (int i = 0; i < LIGHT_TREE_ABOVE + more; i++)
            scenes_light(scene, (struct light){ .kind = LIGHT_POINT, .radiance = { 1, 1, 1 } });
        for (int i = 0; i < 10; i++)
            scenes_light(scene, (struct light){ .kind = LIGHT_DISTANT, .radiance = { 1, 1, 1 } });
        scenes_finish(scene);
        struct kernel_scene *ks = scenes_open(scene, (struct picture_how){ 0 });
        assert_int_equal((scene->settings.effects & FX_LIGHT_TREE) != 0, more);
        assert_int_equal(ks->light_tree.node_count > 0, more);
        kernel_close(ks);
        scene_free(scene);
    }
}

/* Every light has its leaf, every node its parent, and the same lights make the same tree */
static void the_tree_holds_every_light_once(void **state)
{
    (void)state;
    struct scene *scene = mixed_scene(6, 0);
    struct kernel_scene *ks[2];
    for (int i = 0; i < 2; i++)
        ks[i] = scenes_open(scene, (struct picture_how){ 0 });
    const struct light_tree *tree = &ks[0]->light_tree, *again = &ks[1]->light_tree;
    assert_int_equal(tree->node_count, again->node_count);
    uint32_t leaves = 0;
    for (uint32_t i = 0; i < tree->node_count; i++)
        for (int32_t slot = 0; slot < LANES; slot++) {
            const struct light_node *node = &tree->nodes[i];
            assert_int_equal(node->child[slot], again->nodes[i].child[slot]);
            assert_true(node->power[slot] == again->nodes[i].power[slot] &&
                        node->radius[slot] == again->nodes[i].radius[slot] &&
                        node->cos_o[slot] == again->nodes[i].cos_o[slot]);
            if (node->power[slot] == 0)
                continue;
            int32_t place = LANES * (int32_t)i + slot, child = node->child[slot];
            assert_int_equal(child < 0 ? tree->place[~child] : tree->nodes[child].parent, place);
            leaves += child < 0;
        }
    assert_int_equal(leaves + tree->infinite_count + 1, scene->light_count); /* and the sky */
    for (int i = 0; i < 2; i++)
        kernel_close(ks[i]);
    scene_free(scene);
}

/* ---- pictures */

/* A room with a glossy floor and glass in it, lit by triangles of all sizes */
static struct scene *room(void)
{
    static const float low[3] = { -5, -5, -1 }, high[3] = { 5, 5, 9 };
    static const float floor[4][3] = {
        { -5, -4.9f, -1 }, { -5, -4.9f, 9 }, { 5, -4.9f, 9 }, { 5, -4.9f, -1 }
    };
    struct random_lanes r = { 21, 0 };
    struct scene *scene = scenes_begin(32, 32);
    scene->settings.max_depth = 3;
    scenes_box(scene, low, high, scenes_diffuse(scene, 0.6f), 0);
    uint32_t metal = scenes_material(scene, (struct material){ .kind = MATERIAL_CONDUCTOR,
                                                               .eta = { 0.2f, 0.2f, 0.2f },
                                                               .k = { 3, 3, 3 },
                                                               .alpha = { 0.2f, 0.2f } });
    uint32_t glass = scenes_material(
        scene,
        (struct material){ .kind = MATERIAL_DIELECTRIC, .ior = 1.5f, .alpha = { 0.3f, 0.3f } });
    scenes_quad(scene, floor, metal, 0);
    scenes_quadric(scene, QUADRIC_SPHERE, 1, -1, 6, 1.5f, glass, 0);
    uint32_t black = scenes_diffuse(scene, 0);
    for (int i = 0; i < 300; i++) {
        float middle[3], corners[3][3];
        random_point(&r, 4, middle);
        middle[2] += 4;
        for (int k = 0; k < 3; k++) {
            random_unit(&r, corners[k]);
            double size = i == 0 ? 1.5 : 0.15;
            for (int axis = 0; axis < 3; axis++)
                corners[k][axis] = middle[axis] + (float)size * corners[k][axis];
        }
        scenes_polygon(scene, (const float(*)[3])corners, 3, black, i == 0 ? 1 : 3);
        if (i % 3 == 0)
            scene->lights[scene->light_count - 1].flags |= LIGHT_TWO_SIDED;
    }
    scenes_light(scene, (struct light){ .kind = LIGHT_DISTANT,
                                        .radiance = { 0.1f, 0.1f, 0.1f },
                                        .direction = { 0, 0, 1 } });
    scenes_finish(scene);
    return scene;
}

static void without_tree(struct kernel_scene *ks)
{
    light_tree_close(&ks->light_tree);
}

static void understated(struct kernel_scene *ks) /* planted: all probabilities 10 % too small */
{
    ks->light_tree.share *= 0.9f;
}

/* A mean and its standard error, from independent pictures */
static struct tally means(const struct scene *scene, void (*alter)(struct kernel_scene *))
{
    struct tally t = { 0 };
    for (uint64_t seed = 0; seed < 12; seed++) {
        struct picture *p = picture_take(
            scene, (struct picture_how){ .samples = 32, .seed = 100 + seed, .alter = alter });
        assert_int_equal(p->failed, 0);
        tally_add(&t, p->mean);
        picture_free(p);
    }
    return t;
}

static double apart(const struct tally *a, const struct tally *b)
{
    return fabs(tally_mean(a) - tally_mean(b)) /
           sqrt(tally_variance(a) / a->n + tally_variance(b) / b->n);
}

static void the_picture_is_that_of_the_table(void **state)
{
    (void)state;
    struct scene *scene = room();
    struct tally tree = means(scene, NULL), table = means(scene, without_tree),
                 planted = means(scene, understated);
    if (!(apart(&tree, &table) < 4))
        fail_msg("%g by the tree, %g by the table: %.1f standard errors", tally_mean(&tree),
                 tally_mean(&table), apart(&tree, &table));
    assert_true(apart(&planted, &tree) > 6);
    /* And it is worth it */
    assert_true(tally_variance(&tree) < tally_variance(&table));
    scene_free(scene);
}

static void neither_lanes_nor_variants_change_a_bit(void **state)
{
    (void)state;
    struct scene *scene = room();
    struct picture *p = picture_take(scene, (struct picture_how){ .samples = 4 });
    assert_true(p->mean > 0);
    picture_expect_any_lanes(scene, p, 4);
    picture_expect_same(p, picture_take(scene, (struct picture_how){ .samples = 4, .kernel = 1 }));
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(probabilities_of_all_lights_sum_to_one),
        cmocka_unit_test(lights_are_chosen_as_often_as_they_say),
        cmocka_unit_test(every_light_that_reaches_a_receiver_may_be_chosen),
        cmocka_unit_test(few_lights_need_no_tree),
        cmocka_unit_test(the_tree_holds_every_light_once),
        cmocka_unit_test(the_picture_is_that_of_the_table),
        cmocka_unit_test(neither_lanes_nor_variants_change_a_bit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
