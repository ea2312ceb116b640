/*
 * Adaptive pictures of rays: with real sample sequences, too, the pilot's are others than those
 * that make the picture, and the mean of many adaptive renders is that of renders without a plan.
 */
#include "master/film.h"
#include "master/image.h"
#include "master/tile_plan.h"
#include "tests/kernel_scenes.h"

#define WIDTH   96
#define HEIGHT  4
#define TILES   3
#define RENDERS 600
#define ROUNDS  8 /* beyond the pilot's */

/* A lamp in a room, seen from below: tiles with walls alone, and one with the lamp's edge */
static struct scene *room(void)
{
    struct scene *scene = scenes_begin(WIDTH, HEIGHT);
    uint32_t wall = scenes_diffuse(scene, 0.6f);
    const float floor[4][3] = { { -4, -1, 0 }, { -4, -1, 6 }, { 4, -1, 6 }, { 4, -1, 0 } };
    const float back[4][3] = { { -4, -1, 3 }, { -4, 2, 3 }, { 4, 2, 3 }, { 4, -1, 3 } };
    const float lamp[4][3] = {
        { 1.5f, -0.1f, 2.9f }, { 1.5f, 0.3f, 2.9f }, { 1.8f, 0.3f, 2.9f }, { 1.8f, -0.1f, 2.9f }
    };
    scenes_quad(scene, floor, wall, 0);
    scenes_quad(scene, back, wall, 0);
    scenes_quad(scene, lamp, wall, 8);
    scenes_finish(scene);
    return scene;
}

static void render_to(struct film *film, struct kernel_scene *ks, struct kernel_thread *thread,
                      unsigned rounds)
{
    const struct tile_plan *plan = film_plan(film);
    struct err err;
    for (uint32_t tile = 0; tile < TILES; tile++)
        for (uint32_t s = 0; s < tile_plan_sequences(plan); s++) {
            unsigned done = film_pair_rounds(film, tile, s);
            unsigned own = tile_plan_pair_rounds(plan, tile, s, rounds);
            uint64_t leaf = done == 0 ? 0 : round_end(done - 1);
            for (; own > 0 && leaf < round_end(own - 1); leaf++) {
                struct node_id node = { .tile = tile, .replicate = s, .index = leaf };
                struct node_sums *sums = node_sums_new(film_tile_pixels(film, tile), 3);
                assert_true(kernel_leaf(ks, thread, tile, s, leaf, sums, &err));
                enum film_result result = film_accept(film, &node, sums);
                assert_true(result == FILM_ADDED || result == FILM_SEALED);
            }
        }
    assert_int_equal(film_rounds(film), rounds);
}

/* Add each tile's mean to the sums, and set the bits of the factors. */
static void render(const struct scene *scene, uint64_t seed, bool adaptive, double sum[TILES],
                   double squares[TILES], unsigned factors[TILES])
{
    struct job_spec spec = { .seed = seed,
                             .replicates = 2,
                             .leaf_samples = 1,
                             .channel_count = 3,
                             .depth_cap = 8,
                             .max_lanes = 8,
                             .pilot_rounds = adaptive ? 1 : 0,
                             .pilot_weight = adaptive ? 65536 / 16 : 0 };
    struct err err;
    struct film *film = film_new(scene, &spec, spec.pilot_rounds + ROUNDS, 0, &err);
    struct kernel_scene *ks = kernel_open(scene, &spec, &err);
    struct kernel_thread *thread = kernel_thread_open(ks, &err);
    if (adaptive) {
        render_to(film, ks, thread, 1);
        assert_true(film_make_plan(film, 1 + ROUNDS, &err));
    }
    render_to(film, ks, thread, spec.pilot_rounds + ROUNDS);
    struct image *image = image_new(WIDTH, HEIGHT);
    assert_true(film_image(film, image, NULL, &err));
    const float *green = image_channel(image, "G");
    for (uint32_t tile = 0; tile < TILES; tile++) {
        double mean = 0;
        for (uint32_t p = 0; p < 32 * HEIGHT; p++)
            mean += (double)green[p / 32 * WIDTH + 32 * tile + p % 32] / (32 * HEIGHT);
        sum[tile] += mean / RENDERS;
        squares[tile] += mean * mean / RENDERS;
        int octave = adaptive ? film_plan(film)->octaves[tile] : 0;
        factors[tile] |= 1u << (octave - TILE_PLAN_OCTAVE_MIN);
    }
    image_free(image);
    kernel_thread_close(thread);
    kernel_close(ks);
    film_free(film);
}

static void adaptive_pictures_are_right_on_average(void **state)
{
    (void)state;
    profile_thread_mode();
    struct scene *scene = room();
    double sum[2][TILES] = { 0 }, squares[2][TILES] = { 0 };
    unsigned factors[2][TILES] = { 0 };
    for (uint64_t seed = 0; seed < RENDERS; seed++)
        for (int adaptive = 0; adaptive < 2; adaptive++)
            render(scene, 2 * seed + (uint64_t)adaptive, adaptive == 1, sum[adaptive],
                   squares[adaptive], factors[adaptive]);
    unsigned changing = 0;
    for (uint32_t tile = 0; tile < TILES; tile++) {
        double variance = 0;
        for (int i = 0; i < 2; i++)
            variance += (squares[i][tile] - sum[i][tile] * sum[i][tile]) / RENDERS;
        double distance = sum[1][tile] - sum[0][tile];
        if (!(fabs(distance) < 4 * sqrt(variance)))
            fail_msg("tile %u: %g without a plan, off by %g +- %g", tile, sum[0][tile], distance,
                     sqrt(variance));
        assert_true(sqrt(variance) < 0.02 * sum[0][tile]); /* or it says little */
        changing += __builtin_popcount(factors[1][tile]) > 1;
    }
    assert_true(changing > 0); /* the plans differ from pilot to pilot */
    scene_free(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(adaptive_pictures_are_right_on_average),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
