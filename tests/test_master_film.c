/*
 * The film gives the same bits for the same leaves, however they came; its standard errors and the
 * error estimate of the whole image say what they mean.
 */
#include "common/elem.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/estimate.h"
#include "master/film.h"
#include "master/image.h"
#include "tests/random_stream.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const char *const NAMES[] = { "R", "G", "B", "stderr.R", "stderr.G", "stderr.B", "samples" };

/* 70 x 45 pixels of a larger image: six tiles, all but one cut */
static struct scene small_scene(void)
{
    return (struct scene){ .settings = { .width = 100, .height = 80, .crop = { 11, 81, 7, 52 } } };
}

static struct job_spec spec_of(uint32_t replicates, uint32_t leaf_samples)
{
    return (struct job_spec){ .replicates = replicates,
                              .leaf_samples = leaf_samples,
                              .channel_count = 3 };
}

static struct film *new_film(const struct scene *scene, const struct job_spec *spec,
                             unsigned rounds)
{
    struct err err = { 0 };
    struct film *film = film_new(scene, spec, rounds, 0, &err);
    if (film == NULL)
        fail_msg("%s", err.text);
    return film;
}

static struct node_sums *leaf_sums(const struct film *film, uint32_t leaf_samples,
                                   const struct node_id *id)
{
    uint32_t pixels = film_tile_pixels(film, id->tile);
    struct node_sums *sums = node_sums_new(pixels, 3);
    assert_non_null(sums);
    uint64_t seed = random_hash(id->index * 1000003 + id->tile * 64 + id->replicate);
    for (uint32_t i = 0; i < 3 * pixels; i++) {
        uint64_t bits = random_hash(seed + i);
        sums->values[i] = (float)(bits >> 40) * 0x1p-24f * (float)(1u << bits % 8);
    }
    sums->stats.samples = (uint64_t)leaf_samples * pixels;
    sums->stats.truncated_energy = (double)(seed % 1000) / 3;
    sums->stats.largest = 1;
    return sums;
}

static struct node_sums *node_of(const struct film *film, uint32_t leaf_samples, struct node_id id)
{
    if (id.level == 0)
        return leaf_sums(film, leaf_samples, &id);
    id.level--;
    id.index *= 2;
    struct node_sums *left = node_of(film, leaf_samples, id);
    id.index++;
    struct node_sums *right = node_of(film, leaf_samples, id);
    node_sums_add(left, right);
    node_sums_free(right);
    return left;
}

/* Every leaf of rounds [from, to), in order. */
static void fill_in_order(struct film *film, const struct job_spec *spec, unsigned from,
                          unsigned to)
{
    uint64_t first = from == 0 ? 0 : round_end(from - 1);
    for (uint64_t leaf = first; leaf < round_end(to - 1); leaf++)
        for (uint32_t tile = 0; tile < film_tiles(film); tile++)
            for (uint32_t k = 0; k < spec->replicates; k++) {
                struct node_id id = { tile, k, 0, leaf };
                enum film_result result = film_accept(film, &id,
                                                      leaf_sums(film, spec->leaf_samples, &id));
                assert_true(result == FILM_ADDED || result == FILM_SEALED);
            }
}

static size_t cut(struct node_id id, uint64_t *random, struct node_id *pieces)
{
    if (id.level == 0 || random_uniform(random) < 0.4) {
        *pieces = id;
        return 1;
    }
    id.level--;
    id.index *= 2;
    size_t left = cut(id, random, pieces);
    id.index++;
    return left + cut(id, random, pieces + left);
}

/* Rounds [from, to) in random pieces, shuffled over tiles, replicates and rounds, some twice. */
static void fill_at_random(struct film *film, const struct job_spec *spec, unsigned from,
                           unsigned to, uint64_t *random)
{
    size_t most = film_tiles(film) * spec->replicates * round_end(to - 1), count = 0;
    struct node_id *pieces = malloc(most * sizeof(*pieces));
    for (uint32_t tile = 0; tile < film_tiles(film); tile++)
        for (uint32_t k = 0; k < spec->replicates; k++)
            for (unsigned round = from; round < to; round++) {
                struct node_id id = { .tile = tile, .replicate = k };
                round_node(round, &id.level, &id.index);
                count += cut(id, random, pieces + count);
            }
    for (size_t i = count; i > 1; i--) {
        size_t j = (size_t)(random_uniform(random) * (double)i);
        struct node_id swapped = pieces[i - 1];
        pieces[i - 1] = pieces[j];
        pieces[j] = swapped;
    }
    for (size_t i = 0; i < count; i++) {
        struct node_sums *sums = node_of(film, spec->leaf_samples, pieces[i]);
        assert_int_equal(film_check(film, &pieces[i]), FILM_ADDED);
        enum film_result result = film_accept(film, &pieces[i], sums);
        assert_true(result == FILM_ADDED || result == FILM_SEALED);
        if (random_uniform(random) < 0.1) {
            sums = node_of(film, spec->leaf_samples, pieces[i]);
            assert_int_equal(film_accept(film, &pieces[i], sums), FILM_DUPLICATE);
            node_sums_free(sums);
        }
    }
    free(pieces);
}

static struct image *image_of(const struct film *film, uint32_t width, uint32_t height,
                              struct estimate *estimate)
{
    struct err err = { 0 };
    struct image *image = image_new(width, height);
    if (!film_image(film, image, estimate, &err))
        fail_msg("%s", err.text);
    return image;
}

static void assert_same_films(const struct film *a, const struct film *b)
{
    struct image *one = image_of(a, 70, 45, NULL), *other = image_of(b, 70, 45, NULL);
    for (size_t i = 0; i < sizeof(NAMES) / sizeof(*NAMES); i++)
        assert_memory_equal(image_channel(one, NAMES[i]), image_channel(other, NAMES[i]),
                            70 * 45 * sizeof(float));
    struct node_stats left, right;
    film_stats(a, &left);
    film_stats(b, &right);
    assert_memory_equal(&left, &right, sizeof(left));
    image_free(one);
    image_free(other);
}

static void any_order_and_any_pieces_give_the_same_picture(void **state) /* H59 */
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(3, 2);
    const unsigned rounds = 18; /* 20 leaves */
    struct film *serial = new_film(&scene, &spec, rounds);
    fill_in_order(serial, &spec, 0, rounds);
    assert_int_equal(film_rounds(serial), rounds);
    assert_int_equal(film_spp(serial), 3 * 2 * 20);
    uint64_t random = 3;
    for (int trial = 0; trial < 3; trial++) {
        struct film *film = new_film(&scene, &spec, rounds);
        fill_at_random(film, &spec, 0, rounds, &random);
        assert_true(film_round_complete(film, rounds - 1) && !film_round_complete(film, rounds));
        assert_int_equal(film_held(film), 0);
        assert_same_films(film, serial);
        film_free(film);
    }
    film_free(serial);
}

static void a_64_spp_film_extended_to_256_is_a_256_spp_film(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(0, 0);
    assert_int_equal(job_shape(64, 0, &spec), 64);
    unsigned first = job_rounds(&spec, 64), all = job_rounds(&spec, 256);
    uint64_t random = 5;

    struct film *extended = new_film(&scene, &spec, first);
    fill_at_random(extended, &spec, 0, first, &random);
    assert_int_equal(film_spp(extended), 64);
    struct node_id beyond = { .index = round_end(first - 1) };
    assert_int_equal(film_check(extended, &beyond), FILM_FOREIGN);
    image_free(image_of(extended, 70, 45, NULL));
    film_extend(extended, all);
    assert_int_equal(film_check(extended, &beyond), FILM_ADDED);
    fill_at_random(extended, &spec, first, all, &random);

    struct film *straight = new_film(&scene, &spec, all);
    fill_in_order(straight, &spec, 0, all);
    assert_int_equal(film_spp(straight), 256);
    assert_same_films(extended, straight);
    film_free(extended);
    film_free(straight);
}

static void nodes_that_do_not_belong_are_refused_and_change_nothing(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(2, 4);
    struct film *film = new_film(&scene, &spec, 20);
    struct node_id leaf = { .index = 0 };
    assert_int_equal(film_accept(film, &leaf, leaf_sums(film, 4, &leaf)), FILM_SEALED);
    assert_int_equal(film_pair_rounds(film, 0, 0), 1);

    static const struct {
        const char *what;
        struct node_id id;
        enum film_result want;
    } rows[] = {
        { "a leaf of a sealed round", { 0, 0, 0, 0 }, FILM_DUPLICATE },
        { "a tile that is not there", { 6, 0, 0, 1 }, FILM_FOREIGN },
        { "a replicate that is not there", { 0, 2, 0, 1 }, FILM_FOREIGN },
        { "a node across the end of a round", { 0, 0, 1, 1 }, FILM_FOREIGN },
        { "a round nobody asked for", { 0, 0, 0, 1000 }, FILM_FOREIGN },
        { "an index near 2^32", { 0, 0, 0, (uint64_t)1 << 32 }, FILM_FOREIGN },
        { "an index near 2^40", { 0, 0, 0, (uint64_t)1 << 40 }, FILM_FOREIGN },
        { "the largest numbers", { UINT32_MAX, UINT32_MAX, UINT32_MAX, UINT64_MAX }, FILM_FOREIGN },
    };
    struct node_sums *sums = leaf_sums(film, 4, &leaf);
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++)
        if (film_check(film, &rows[i].id) != rows[i].want ||
            film_accept(film, &rows[i].id, sums) != rows[i].want)
            fail_msg("%s", rows[i].what);

    struct node_id next = { .index = 1 };
    sums->stats.samples--;
    assert_int_equal(film_accept(film, &next, sums), FILM_FOREIGN); /* a sample short */
    sums->stats.samples++;
    struct node_id other_shape = { .tile = 2, .index = 0 };
    assert_int_equal(film_accept(film, &other_shape, sums), FILM_FOREIGN); /* not 32 pixels wide */
    assert_int_equal(film_accept(film, &next, sums), FILM_SEALED);
    assert_int_equal(film_held(film), 0);
    film_free(film);
}

static void between_rounds_each_tile_shows_what_it_has(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(2, 4);
    struct film *film = new_film(&scene, &spec, 4);
    fill_in_order(film, &spec, 0, 2);
    struct node_id ahead = { .tile = 1, .replicate = 1, .index = 2 };
    assert_int_equal(film_accept(film, &ahead, leaf_sums(film, 4, &ahead)), FILM_SEALED);
    struct node_id early = { .tile = 0, .replicate = 0, .index = 3 }; /* round 2 is missing */
    assert_int_equal(film_accept(film, &early, leaf_sums(film, 4, &early)), FILM_ADDED);
    assert_int_equal(film_held(film), 1);
    assert_int_equal(film_rounds(film), 2);

    struct image *image = image_of(film, 70, 45, NULL);
    const float *samples = image_channel(image, "samples");
    assert_true(samples[0] == 16 && samples[32] == 20 && samples[64] == 16);
    assert_int_equal(image->data_x, 11);
    assert_int_equal(image->data_y, 7);
    assert_int_equal(image->display_width, 100);

    /* Pixel (3, 2) of the second tile by hand, and the variance of the nine about it */
    double variance = 0, mean[2];
    float middle = 0;
    for (uint32_t i = 0; i < 9; i++) {
        size_t p = (1 + i / 3) * 32 + 2 + i % 3;
        for (uint32_t k = 0; k < 2; k++) {
            struct node_sums *sums[3];
            for (uint64_t leaf = 0; leaf < 2 + k; leaf++) {
                struct node_id id = { 1, k, 0, leaf };
                sums[leaf] = leaf_sums(film, 4, &id);
            }
            float total = sums[0]->values[p] + sums[1]->values[p];
            if (k == 1)
                total = sums[2]->values[p] + total;
            mean[k] = (double)total / (4.0 * (2 + k));
            for (uint64_t leaf = 0; leaf < 2 + k; leaf++)
                node_sums_free(sums[leaf]);
        }
        variance += (mean[0] - mean[1]) * (mean[0] - mean[1]) / 4 / 9;
        if (i == 4)
            middle = (float)((mean[0] + mean[1]) / 2);
    }
    size_t at = 2 * 70 + 32 + 3;
    assert_true(image_channel(image, "R")[at] == middle);
    assert_true(fabs(image_channel(image, "stderr.R")[at] / sqrt(variance) - 1) < 1e-6);

    struct err err = { 0 }; /* an image is refreshed in place, and must be of the right size */
    assert_true(film_image(film, image, NULL, &err));
    assert_int_equal(image->channel_count, 7);
    struct image *other = image_new(69, 45);
    assert_false(film_image(film, other, NULL, &err));
    image_free(other);
    image_free(image);
    film_free(film);
}

static void one_replicate_or_a_lost_sample_means_an_unknown_error(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct estimate *estimate = estimate_new();
    for (uint32_t k = 1; k <= 4; k += 3) {
        struct job_spec spec = spec_of(k, 4);
        struct film *film = new_film(&scene, &spec, 2);
        fill_in_order(film, &spec, 0, 1);
        for (uint32_t tile = 0; tile < 6; tile++)
            for (uint32_t r = 0; r < k; r++) {
                struct node_id id = { tile, r, 0, 1 };
                struct node_sums *sums = leaf_sums(film, 4, &id);
                if (tile == 0 && r == 0) {
                    sums->failed[1] = 1u << 5; /* pixel (5, 1) */
                    sums->stats.nonfinite[NONFINITE_NAN] = 1;
                }
                film_accept(film, &id, sums);
            }
        struct image *image = image_of(film, 70, 45, estimate);
        struct accuracy accuracy = estimate_result(estimate);
        const float *error = image_channel(image, "stderr.G");
        assert_true(isinf(error[70 + 5]));
        assert_true(k == 1 ? isinf(error[0]) : isfinite(error[0]));
        assert_int_equal(accuracy.verdict, k == 1 ? ACCURACY_NO_REPLICATES : ACCURACY_NONFINITE);
        assert_true(accuracy.unknown_share >= (k == 1 ? 1 : 1 / (70. * 45)));
        assert_true(isfinite(image_channel(image, "G")[70 + 5]));
        image_free(image);
        film_free(film);
    }
    estimate_free(estimate);
}

static void memory_is_known_beforehand_and_a_limit_is_kept(void **state)
{
    (void)state;
    struct scene scene = { .settings = {
                               .width = 1920, .height = 1080, .crop = { 0, 1920, 0, 1080 } } };
    struct job_spec spec = spec_of(4, 4);
    uint64_t bytes = film_memory_bytes(&scene, &spec);
    assert_in_range(bytes, 300000000, 600000000);
    struct err err = { 0 };
    assert_null(film_new(&scene, &spec, 8, bytes - 1, &err));
    assert_int_equal(err.code, ERR_LIMIT);
    assert_non_null(strstr(err.text, "MB"));
    struct film *film = film_new(&scene, &spec, 8, bytes, &err);
    assert_non_null(film);
    film_free(film);

    spec.channel_count = 1;
    assert_null(film_new(&scene, &spec, 8, 0, &err));
    assert_int_equal(err.code, ERR_ARGUMENT);
}

/* Film of one round whose replicate means are normal with mean 3 and standard deviation 0.5. */
static struct film *normal_film(const struct scene *scene, const struct job_spec *spec,
                                uint64_t *random)
{
    struct film *film = new_film(scene, spec, 1);
    for (uint32_t tile = 0; tile < film_tiles(film); tile++)
        for (uint32_t k = 0; k < spec->replicates; k++) {
            struct node_id id = { tile, k, 0, 0 };
            struct node_sums *sums = leaf_sums(film, spec->leaf_samples, &id);
            for (uint32_t i = 0; i < 3 * sums->pixel_count; i++)
                sums->values[i] = (float)(spec->leaf_samples * (3 + 0.5 * random_normal(random)));
            assert_int_equal(film_accept(film, &id, sums), FILM_SEALED);
        }
    return film;
}

/* z of "the mean squared standard error is sigma^2 / K", the stderr scaled by `planted`. */
static double stderr_statistic(const struct image *image, uint32_t k, double planted)
{
    double sum = 0, count = 0;
    for (int c = 0; c < 3; c++) {
        const float *error = image_channel(image, NAMES[3 + c]);
        for (uint32_t p = 0; p < image->width * image->height; p++, count++)
            sum += planted * planted * error[p] * error[p];
    }
    double ratio = sum / count / (0.25 / k);
    return (ratio - 1) / sqrt(2 / (count * (k - 1)));
}

static void the_standard_error_is_that_of_known_replicates(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(4, 4);
    uint64_t random = 11;
    struct film *film = normal_film(&scene, &spec, &random);
    struct image *image = image_of(film, 70, 45, NULL);

    assert_true(fabs(stderr_statistic(image, 4, 1)) < 4);
    /* The planted bug, variance over K in place of K - 1, is caught */
    assert_true(fabs(stderr_statistic(image, 4, sqrt(3.0 / 4))) > 4);

    int inside = 0, count = 0; /* Student's t with the stated degrees of freedom covers 95 % */
    for (int c = 0; c < 3; c++)
        for (uint32_t p = 0; p < 70 * 45; p++, count++)
            inside += fabs(image_channel(image, NAMES[c])[p] - 3.0) <=
                      estimate_student(film_stderr_dof(4)) * image_channel(image, NAMES[3 + c])[p];
    double z = (inside - 0.95 * count) / sqrt(0.95 * 0.05 * count);
    assert_true(fabs(z) < 4);
    image_free(image);
    film_free(film);
}

static void the_film_hands_its_replicates_to_the_estimate(void **state)
{
    (void)state;
    struct scene scene = small_scene();
    struct job_spec spec = spec_of(4, 4);
    uint64_t random = 12;
    struct film *film = normal_film(&scene, &spec, &random);
    struct estimate *estimate = estimate_new();
    struct err err = { 0 };
    assert_true(film_image(film, NULL, estimate, &err));
    struct accuracy accuracy = estimate_result(estimate);
    assert_int_equal(accuracy.verdict, ACCURACY_KNOWN);
    assert_int_equal(accuracy.replicates, 4);
    assert_true(fabs(accuracy.rmse / 0.25 - 1) < 0.05);
    assert_true(fabs(accuracy.relmse / (0.0625 / 9.01) - 1) < 0.1);
    assert_true(accuracy.relmse95.low < accuracy.relmse);
    assert_true(accuracy.relmse < accuracy.relmse95.high);
    assert_true(accuracy.unknown_share == 0);
    estimate_free(estimate);
    film_free(film);
}

/* A synthetic image of two tiles: truth, noise, and what its estimate and its real error say. */
struct trial {
    struct accuracy accuracy;
    double mse, relmse;
};

enum truth { RAMP, EDGES, DIM };

static double truth_at(enum truth truth, uint32_t channel, uint32_t p)
{
    uint32_t x = p % TILE_SIZE, y = p / TILE_SIZE;
    if (truth == RAMP)
        return 0.05 + 0.05 * x * (1 + channel);
    if (truth == EDGES)
        return (x / 8 + y / 8) % 2 == 0 ? 2 : 0.05;
    return 0.02 + 0.002 * y;
}

static struct trial run_trial(struct estimate *estimate, enum truth truth, uint32_t replicates,
                              double noise, bool skewed, uint64_t *random)
{
    static double means[8 * 3 * TILE_PIXELS];
    static const uint32_t failed[TILE_PIXELS / 32];
    struct trial trial = { 0 };
    estimate_begin(estimate, replicates);
    for (int tile = 0; tile < 2; tile++) {
        double light = 0;
        for (uint32_t p = 0; p < TILE_PIXELS; p++) {
            double mean[3] = { 0 };
            for (uint32_t k = 0; k < replicates; k++) { /* all channels alike: the hard case */
                double z = skewed ? -elem_log(random_uniform(random)) - 1 : random_normal(random);
                for (uint32_t c = 0; c < 3; c++) {
                    double x = truth_at(truth, c, p) * (1 + noise * sqrt(replicates) * z);
                    means[(k * 3 + c) * TILE_PIXELS + p] = x;
                    mean[c] += x / replicates;
                }
            }
            for (uint32_t c = 0; c < 3; c++) {
                double r = truth_at(truth, c, p), squared = (mean[c] - r) * (mean[c] - r);
                trial.mse += squared / (2 * 3 * TILE_PIXELS);
                trial.relmse += squared / (r * r + 0.01) / (2 * 3 * TILE_PIXELS);
                light += mean[c] / 3 * 64;
            }
        }
        struct tile_means tile_means = { TILE_SIZE, TILE_SIZE, replicates, means,
                                         64,        failed,    light,      light * 1e-4 };
        estimate_tile(estimate, &tile_means);
    }
    trial.accuracy = estimate_result(estimate);
    return trial;
}

static bool covers(struct interval interval, double truth)
{
    return interval.low <= truth && truth <= interval.high;
}

static void the_95_percent_intervals_cover_95_percent(void **state)
{
    (void)state;
    static const struct {
        const char *what;
        enum truth truth;
        uint32_t replicates;
        double noise;
        bool skewed;
    } rows[] = {
        { "a ramp, normal noise", RAMP, 4, 0.03, false },
        { "a ramp, exponential noise", RAMP, 4, 0.03, true },
        { "edges, normal noise", EDGES, 4, 0.03, false },
        { "a dim image, 15 % noise", DIM, 4, 0.15, false },
        { "two replicates", RAMP, 2, 0.02, false },
        { "eight replicates", RAMP, 8, 0.03, false },
    };
    enum { TRIALS = 350 }; /* of each, 2,100 in all */
    struct estimate *estimate = estimate_new();
    uint64_t random = 95;
    int all = 0, all_mse = 0;
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++) {
        int covered = 0, covered_mse = 0;
        double estimated = 0, real = 0;
        for (int t = 0; t < TRIALS; t++) {
            struct trial trial = run_trial(estimate, rows[i].truth, rows[i].replicates,
                                           rows[i].noise, rows[i].skewed, &random);
            assert_int_equal(trial.accuracy.verdict, ACCURACY_KNOWN);
            covered += covers(trial.accuracy.relmse95, trial.relmse);
            covered_mse += covers(trial.accuracy.mse95, trial.mse);
            estimated += trial.accuracy.relmse;
            real += trial.relmse;
        }
        print_message("%-26s relMSE covered %.3f, MSE %.3f, estimate / truth %.4f\n", rows[i].what,
                      (double)covered / TRIALS, (double)covered_mse / TRIALS, estimated / real);
        assert_in_range(covered, 0.90 * TRIALS, TRIALS); /* one row's trials say +- 3 % at best */
        assert_in_range(covered_mse, 0.90 * TRIALS, TRIALS);
        assert_true(fabs(estimated / real - 1) < 0.01);
        all += covered;
        all_mse += covered_mse;
    }
    double trials = TRIALS * (double)(sizeof(rows) / sizeof(*rows));
    assert_true(all >= 0.92 * trials && all <= 0.98 * trials);
    assert_true(all_mse >= 0.92 * trials && all_mse <= 0.98 * trials);
    estimate_free(estimate);
}

static void two_replicates_do_not_vouch_for_a_noisy_picture(void **state)
{
    (void)state;
    struct estimate *estimate = estimate_new();
    uint64_t random = 2;
    struct trial trial = run_trial(estimate, RAMP, 2, 0.08, true, &random);
    assert_int_equal(trial.accuracy.verdict, ACCURACY_TWO_REPLICATES);
    estimate_free(estimate);
}

static void much_noise_widens_the_interval_rather_than_missing(void **state)
{
    (void)state;
    struct estimate *estimate = estimate_new();
    uint64_t random = 30;
    int covered = 0;
    for (int t = 0; t < 60; t++) {
        enum truth truth = t % 2 ? RAMP : EDGES;
        struct trial trial = run_trial(estimate, truth, 4, 0.15, t % 3 == 0, &random);
        covered += covers(trial.accuracy.relmse95, trial.relmse);
    }
    assert_in_range(covered, 55, 60);
    estimate_free(estimate);
}

static void a_few_samples_that_hold_the_sum_make_the_error_unknown(void **state)
{
    (void)state;
    static double means[4 * 3 * TILE_PIXELS];
    static const uint32_t failed[TILE_PIXELS / 32];
    struct estimate *estimate = estimate_new();
    struct tile_means tile = { .width = TILE_SIZE,
                               .height = TILE_SIZE,
                               .replicates = 4,
                               .means = means,
                               .samples = 256,
                               .failed = failed };

    /* A firefly: one sample of 10,000 in one replicate of one pixel, small against the sum */
    uint64_t random = 1;
    for (size_t i = 0; i < 4 * 3 * TILE_PIXELS; i++)
        means[i] = 1 + 0.01 * random_normal(&random);
    for (int c = 0; c < 3; c++)
        means[c * TILE_PIXELS + 77] += 10000.0 / 64;
    tile.largest = 10000;
    tile.luminance = 256.0 * TILE_PIXELS + 10000;
    estimate_begin(estimate, 4);
    estimate_tile(estimate, &tile);
    assert_int_equal(estimate_result(estimate).verdict, ACCURACY_FEW_SAMPLES);
    assert_true(estimate_result(estimate).unknown_share == 1. / TILE_PIXELS); /* it alone */

    /* The same in one tile of eight, without saying which sample it was */
    estimate_begin(estimate, 4);
    for (int i = 0; i < 8; i++) {
        tile.largest = 5;
        estimate_tile(estimate, &tile);
        for (int c = 0; i == 0 && c < 3; c++)
            means[c * TILE_PIXELS + 77] -= 10000.0 / 64;
    }
    assert_int_equal(estimate_result(estimate).verdict, ACCURACY_FEW_SAMPLES);
    assert_int_equal(estimate_result(estimate).mse_verdict, ACCURACY_FEW_PIXELS);

    memset(means, 0, sizeof(means));
    tile.largest = tile.luminance = 0;
    estimate_begin(estimate, 4);
    estimate_tile(estimate, &tile);
    assert_int_equal(estimate_result(estimate).verdict, ACCURACY_BLACK);
    estimate_free(estimate);
}

static void quantiles_are_those_of_the_tables(void **state)
{
    (void)state;
    static const double student[][2] = { { 1, 12.706 },  { 3, 3.182 },    { 10, 2.228 },
                                         { 30, 2.0423 }, { 100, 1.9840 }, { 1e9, 1.95996 } };
    for (size_t i = 0; i < sizeof(student) / sizeof(*student); i++)
        assert_true(fabs(estimate_student(student[i][0]) - student[i][1]) < 1e-3);
    static const double f[][4] = { /* n, m, 2.5 %, 97.5 % */
                                   { 10, 30, 0.3019, 2.5112 },
                                   { 20, 60, 0.4490, 1.9445 },
                                   { 100, 300, 0.7191, 1.3519 }
    };
    for (size_t i = 0; i < sizeof(f) / sizeof(*f); i++) {
        struct interval got = estimate_f95(f[i][0], f[i][1], 1.959964);
        if (fabs(got.low - f[i][2]) > 0.01 || fabs(got.high - f[i][3]) > 0.01)
            fail_msg("F(%g, %g): %g, %g", f[i][0], f[i][1], got.low, got.high);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(any_order_and_any_pieces_give_the_same_picture),
        cmocka_unit_test(a_64_spp_film_extended_to_256_is_a_256_spp_film),
        cmocka_unit_test(nodes_that_do_not_belong_are_refused_and_change_nothing),
        cmocka_unit_test(between_rounds_each_tile_shows_what_it_has),
        cmocka_unit_test(one_replicate_or_a_lost_sample_means_an_unknown_error),
        cmocka_unit_test(memory_is_known_beforehand_and_a_limit_is_kept),
        cmocka_unit_test(the_standard_error_is_that_of_known_replicates),
        cmocka_unit_test(the_film_hands_its_replicates_to_the_estimate),
        cmocka_unit_test(the_95_percent_intervals_cover_95_percent),
        cmocka_unit_test(two_replicates_do_not_vouch_for_a_noisy_picture),
        cmocka_unit_test(much_noise_widens_the_interval_rather_than_missing),
        cmocka_unit_test(a_few_samples_that_hold_the_sum_make_the_error_unknown),
        cmocka_unit_test(quantiles_are_those_of_the_tables),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
