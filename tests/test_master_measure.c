/*
 * The measures say what they claim to: hand-made pictures with known distances, FLIP against a
 * direct transcription of the paper, and `pathfarm compare` as scripts see it.
 */
#include "common/err.h"
#include "master/cmd_compare.h"
#include "master/exr.h"
#include "master/flip.h"
#include "master/image.h"
#include "master/measure.h"

#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static const struct measure_channels rgb = { .name = { "R", "G", "B" } };

static void expect_near(double got, double want, double tolerance, const char *what)
{
    if (!(fabs(got - want) <= tolerance))
        fail_msg("%s: got %.9g, wanted %.9g", what, got, want);
}

/* A picture of one colour. */
static struct image *flat(uint32_t width, uint32_t height, float r, float g, float b)
{
    const float colour[3] = { r, g, b };
    struct image *image = image_new(width, height);
    for (int c = 0; c < 3; c++) {
        float *values = image_add_channel(image, rgb.name[c]);
        assert_non_null(values);
        for (uint32_t p = 0; p < width * height; p++)
            values[p] = colour[c];
    }
    return image;
}

/* Repeatable noise in [0, 1). */
static struct image *noise(uint32_t width, uint32_t height, uint64_t seed)
{
    struct image *image = flat(width, height, 0, 0, 0);
    for (int c = 0; c < 3; c++)
        for (uint32_t p = 0; p < width * height; p++) {
            seed = seed * 6364136223846793005u + 1442695040888963407u;
            image->channels[c].values[p] = (float)(seed >> 40) * 0x1p-24f;
        }
    return image;
}

static void known_distances_are_measured(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *a = flat(4, 3, 1.5f, 0.5f, 0.25f), *b = flat(4, 3, 1, 0.5f, 0);
    struct measure m;
    assert_true(measure_images(a, b, &rgb, &m, &err));
    expect_near(m.rmse, sqrt((0.25 + 0 + 0.0625) / 3), 1e-12, "rmse");
    expect_near(m.relmse, (0.25 / 1.01 + 0 + 0.0625 / 0.01) / 3, 1e-12, "relmse");
    expect_near(m.mape, (0.5 / 1.01 + 0 + 0.25 / 0.01) / 3, 1e-12, "mape");
    expect_near(m.mean_a[0], 1.5, 0, "mean a");
    expect_near(m.mean_b[2], 0, 0, "mean b");
    assert_int_equal(m.pixels, 12);

    assert_true(measure_images(b, b, &rgb, &m, &err));
    expect_near(m.rmse + m.relmse + m.mape + m.flip, 0, 0, "an image and itself");
    image_free(a);
    image_free(b);
}

static void pixels_that_are_not_finite_are_counted_and_left_out(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *a = flat(4, 4, 1, 1, 1), *b = flat(4, 4, 1, 1, 1);
    image_channel(a, "G")[3] = NAN;
    image_channel(a, "B")[3] = INFINITY; /* the same pixel: counts once */
    image_channel(b, "R")[5] = -INFINITY;
    image_channel(b, "R")[3] = NAN;
    struct measure m;
    assert_true(measure_images(a, b, &rgb, &m, &err));
    assert_int_equal(m.nonfinite_a, 1);
    assert_int_equal(m.nonfinite_b, 2);
    assert_int_equal(m.pixels, 14);
    expect_near(m.relmse, 0, 0, "relmse of the rest");
    assert_true(isfinite(m.flip) && m.flip > 0);

    /* Nothing left: unknown, not zero */
    for (int p = 0; p < 16; p++)
        image_channel(a, "R")[p] = NAN;
    assert_true(measure_images(a, b, &rgb, &m, &err));
    assert_int_equal(m.pixels, 0);
    assert_true(isnan(m.relmse));
    image_free(a);
    image_free(b);
}

static void pictures_that_do_not_match_are_refused(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct measure m;
    struct image *a = flat(4, 4, 1, 1, 1), *b = flat(4, 5, 1, 1, 1), *c = flat(4, 4, 1, 1, 1);
    assert_false(measure_images(a, b, &rgb, &m, &err));
    assert_non_null(strstr(err.text, "4x4 and 4x5"));
    c->data_x = 1;
    assert_false(measure_images(a, c, &rgb, &m, &err));
    assert_non_null(strstr(err.text, "windows differ"));
    c->data_x = 0;
    const struct measure_channels none = { .name = { "R", "Z", "B" } };
    assert_false(measure_images(a, c, &none, &m, &err));
    assert_non_null(strstr(err.text, "\"Z\""));
    image_free(a);
    image_free(b);
    image_free(c);
}

static void the_digest_is_that_of_interleaved_floats(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *image = noise(5, 3, 9);
    float interleaved[45];
    for (int p = 0; p < 15; p++)
        for (int c = 0; c < 3; c++)
            interleaved[3 * p + c] = image->channels[c].values[p];
    struct digest got, want = digest_of(interleaved, sizeof(interleaved));
    assert_true(measure_pixels_digest(image, &rgb, &got, &err));
    assert_true(digest_equal(&got, &want));

    image_channel(image, "G")[7] = -0.0f; /* a bit is a bit */
    assert_true(measure_pixels_digest(image, &rgb, &got, &err));
    assert_false(digest_equal(&got, &want));
    image_free(image);
}

static void blocks_have_means_and_standard_errors(void **state)
{
    (void)state;
    struct err err = { 0 };
    struct image *a = flat(7, 5, 1, 1, 1), *b = flat(7, 5, 2, 0, 0);
    for (int c = 0; c < 3; c++) {
        char name[16];
        snprintf(name, sizeof(name), "stderr.%s", rgb.name[c]);
        float *values = image_add_channel(a, name);
        for (int p = 0; p < 35; p++)
            values[p] = 0.3f;
    }
    size_t count;
    struct measure_block *blocks = measure_blocks(a, b, &rgb, 4, &count, &err);
    assert_non_null(blocks);
    assert_int_equal(count, 4);
    assert_int_equal(blocks[3].x, 4);
    assert_int_equal(blocks[3].y, 4);
    assert_int_equal(blocks[3].width, 3);
    assert_int_equal(blocks[3].height, 1);
    expect_near(blocks[0].luminance_a, 1, 1e-12, "luminance of white");
    expect_near(blocks[0].luminance_b, 2 * 0.2126, 1e-12, "luminance of red");
    expect_near(blocks[0].stderr_a, 0.3 / 4, 1e-7, "16 independent pixels");
    expect_near(blocks[3].stderr_a, 0.3 / sqrt(3), 1e-7, "3 independent pixels");
    assert_true(isnan(blocks[0].stderr_b));
    assert_int_equal(blocks[1].pixels, 12);
    free(blocks);
    image_free(a);
    image_free(b);
}

/* ---- FLIP, transcribed: every filter a full two-dimensional sum ---- */

static void opponent(const double c[3], double o[3])
{
    /* sRGB to XYZ relative to D65, then YyCxCz */
    double x = 10135552.0 / 24577794 * c[0] + 8788810.0 / 24577794 * c[1] +
               4435075.0 / 24577794 * c[2];
    double y = 2613072.0 / 12288897 * c[0] + 8788810.0 / 12288897 * c[1] +
               887015.0 / 12288897 * c[2];
    double z = 1425312.0 / 73733382 * c[0] + 8788810.0 / 73733382 * c[1] +
               70074185.0 / 73733382 * c[2];
    x /= 0.950428545, y /= 1, z /= 1.088900371;
    o[0] = 116 * y - 16, o[1] = 500 * (x - y), o[2] = 200 * (y - z);
}

static double cube_root_or_line(double t)
{
    return t > 0.008856451679 ? cbrt(t) : 7.787037037 * t + 16.0 / 116;
}

static void lab(const double o[3], double l[3])
{
    double y = (o[0] + 16) / 116, x = y + o[1] / 500, z = y - o[2] / 200;
    x *= 0.950428545, z *= 1.088900371;
    double c[3] = {
        3.241003275 * x - 1.537398934 * y - 0.498615861 * z,
        -0.969224334 * x + 1.875930071 * y + 0.041554224 * z,
        0.055639423 * x - 0.204011202 * y + 1.057148933 * z,
    };
    for (int i = 0; i < 3; i++)
        c[i] = c[i] < 0 ? 0 : c[i] > 1 ? 1 : c[i];
    opponent(c, l);
    y = (l[0] + 16) / 116, x = y + l[1] / 500, z = y - l[2] / 200;
    x = cube_root_or_line(x), y = cube_root_or_line(y), z = cube_root_or_line(z);
    l[0] = 116 * y - 16;
    l[1] = 0.01 * l[0] * 500 * (x - y);
    l[2] = 0.01 * l[0] * 200 * (y - z);
}

static double flip_transcribed(const struct image *const image[2], double ppd)
{
    int width = (int)image[0]->width, height = (int)image[0]->height;
    static const double a1[3] = { 1, 1, 34.1 }, b1[3] = { 0.0047, 0.0053, 0.04 };
    static const double a2[3] = { 0, 0, 13.5 }, b2[3] = { 1e-5, 1e-5, 0.025 };
    int r = (int)ceil(3 * sqrt(0.04 / (2 * M_PI * M_PI)) * ppd);
    double sd = 0.5 * 0.082 * ppd;
    int fr = (int)ceil(3 * sd);

    double positive[2] = { 0, 0 }; /* the kernels' sums of one sign; the other is its mirror or: */
    double negative[2] = { 0, 0 };
    for (int y = -fr; y <= fr; y++)
        for (int x = -fr; x <= fr; x++) {
            double g = exp(-(x * x + y * y) / (2 * sd * sd));
            double k[2] = { -x * g, (x * x / (sd * sd) - 1) * g };
            for (int i = 0; i < 2; i++)
                *(k[i] > 0 ? &positive[i] : &negative[i]) += fabs(k[i]);
        }

    const double green[3] = { 0, 1, 0 }, blue[3] = { 0, 0, 1 };
    double og[3], ob[3], lg[3], lb[3];
    opponent(green, og), opponent(blue, ob), lab(og, lg), lab(ob, lb);
    double c_max = pow(fabs(lg[0] - lb[0]) + hypot(lg[1] - lb[1], lg[2] - lb[2]), 0.7);

    double total = 0;
    for (int py = 0; py < height; py++)
        for (int px = 0; px < width; px++) {
            double l[2][3], feature[2][2];
            for (int i = 0; i < 2; i++) {
                double o[3] = { 0, 0, 0 }, weight[3] = { 0, 0, 0 },
                       d[2][2] = { { 0, 0 }, { 0, 0 } };
                int reach = r > fr ? r : fr;
                for (int dy = -reach; dy <= reach; dy++)
                    for (int dx = -reach; dx <= reach; dx++) {
                        int x = px + dx, y = py + dy;
                        x = x < 0 ? 0 : x >= width ? width - 1 : x;
                        y = y < 0 ? 0 : y >= height ? height - 1 : y;
                        double c[3], at[3];
                        for (int k = 0; k < 3; k++)
                            c[k] = (double)image[i]->channels[k].values[y * width + x];
                        opponent(c, at);
                        double z2 = (dx * dx + dy * dy) / (ppd * ppd);
                        for (int k = 0; k < 3 && abs(dx) <= r && abs(dy) <= r; k++) {
                            double w = a1[k] * sqrt(M_PI / b1[k]) * exp(-M_PI * M_PI * z2 / b1[k]) +
                                       a2[k] * sqrt(M_PI / b2[k]) * exp(-M_PI * M_PI * z2 / b2[k]);
                            o[k] += w * at[k];
                            weight[k] += w;
                        }
                        if (abs(dx) > fr || abs(dy) > fr)
                            continue;
                        double g = exp(-(dx * dx + dy * dy) / (2 * sd * sd)),
                               lum = (at[0] + 16) / 116;
                        double k[4] = { -dx * g, -dy * g, (dx * dx / (sd * sd) - 1) * g,
                                        (dy * dy / (sd * sd) - 1) * g };
                        for (int j = 0; j < 4; j++)
                            d[j / 2][j % 2] += k[j] / (k[j] > 0 ? positive : negative)[j / 2] * lum;
                    }
                for (int k = 0; k < 3; k++)
                    o[k] /= weight[k];
                lab(o, l[i]);
                for (int j = 0; j < 2; j++)
                    feature[i][j] = hypot(d[j][0], d[j][1]);
            }
            double e = pow(fabs(l[0][0] - l[1][0]) + hypot(l[0][1] - l[1][1], l[0][2] - l[1][2]),
                           0.7);
            e = e < 0.4 * c_max ? 0.95 / (0.4 * c_max) * e
                                : 0.95 + (e - 0.4 * c_max) / (0.6 * c_max) * 0.05;
            double f = fmax(fabs(feature[0][0] - feature[1][0]),
                            fabs(feature[0][1] - feature[1][1]));
            total += pow(e, 1 - sqrt(f / sqrt(2)));
        }
    return total / (width * height);
}

static double flip_of(const struct image *a, const struct image *b, double ppd)
{
    const float *pa[3], *pb[3];
    for (int c = 0; c < 3; c++) {
        pa[c] = a->channels[c].values;
        pb[c] = b->channels[c].values;
    }
    return flip_mean(pa, pb, a->width, a->height, ppd);
}

static void flip_agrees_with_its_transcription(void **state)
{
    (void)state;
    struct image *a = noise(23, 17, 1), *b = noise(23, 17, 2);
    for (int c = 0; c < 3; c++) /* smooth on one side, so that all terms matter */
        for (int p = 0; p < 23 * 17; p++)
            if (p % 23 < 12)
                b->channels[c].values[p] = a->channels[c].values[p] * 0.9f + 0.02f * (float)c +
                                           (p % 23 == 5) * 0.1f;
    const struct image *const pair[2] = { a, b };
    for (int i = 0; i < 2; i++) {
        double ppd = i == 0 ? 67 : 20, want = flip_transcribed(pair, ppd);
        assert_true(want > 0.01 && want < 1);
        expect_near(flip_of(a, b, ppd), want, 2e-5, "FLIP");
        expect_near(flip_of(b, a, ppd), want, 2e-5, "FLIP is symmetric");
    }
    image_free(a);
    image_free(b);
}

static void flip_of_plain_colours_is_the_papers_map_of_their_distance(void **state)
{
    (void)state;
    struct image *white = flat(8, 8, 1, 1, 1), *black = flat(8, 8, 0, 0, 0);
    struct image *green = flat(8, 8, 0, 1, 0), *blue = flat(8, 8, 0, 0, 1);
    struct image *bright = flat(8, 8, 50, 2, 1);
    expect_near(flip_of(green, blue, 67), 1, 1e-6, "the farthest colours");
    expect_near(flip_of(white, bright, 67), 0, 1e-9, "what a display clamps away");
    double grey = flip_of(white, black, 67);
    assert_true(grey > 0.9 && grey < 1);
    image_free(white);
    image_free(black);
    image_free(green);
    image_free(blue);
    image_free(bright);
}

/* ---- the command ---- */

static char folder[] = "/tmp/pathfarm-measure-XXXXXX";

static int make_folder(void **state)
{
    (void)state;
    return mkdtemp(folder) == NULL;
}

static int remove_folder(void **state)
{
    (void)state;
    static const char *const names[] = { "a.exr", "b.exr", "c.exr", "y.exr", "out", "err" };
    for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++) {
        char path[128];
        snprintf(path, sizeof(path), "%s/%s", folder, names[i]);
        unlink(path);
    }
    return rmdir(folder);
}

static void save(struct image *image, const char *name)
{
    struct err err = { 0 };
    char path[128];
    snprintf(path, sizeof(path), "%s/%s", folder, name);
    if (!exr_image_write(image, path, &err))
        fail_msg("%s", err.text);
    image_free(image);
}

/* Run `pathfarm compare WORDS` inside the folder, stdout and stderr into files there. */
static int compare(const char *words)
{
    char line[256], *argv[16] = { "compare" }, *rest = line;
    int argc = 1;
    snprintf(line, sizeof(line), "%s", words);
    for (char *word; (word = strsep(&rest, " ")) != NULL;)
        argv[argc++] = word;

    int here = open(".", O_RDONLY | O_DIRECTORY);
    assert_int_equal(chdir(folder), 0);
    int files[2] = { open("out", O_CREAT | O_TRUNC | O_WRONLY, 0600),
                     open("err", O_CREAT | O_TRUNC | O_WRONLY, 0600) };
    int saved[2];
    fflush(NULL);
    for (int i = 0; i < 2; i++) {
        saved[i] = dup(1 + i);
        dup2(files[i], 1 + i);
    }
    int status = cmd_compare(argc, argv);
    fflush(NULL);
    for (int i = 0; i < 2; i++) {
        dup2(saved[i], 1 + i);
        close(saved[i]);
        close(files[i]);
    }
    assert_int_equal(fchdir(here), 0);
    close(here);
    return status;
}

static json_t *printed(void)
{
    char path[128];
    snprintf(path, sizeof(path), "%s/out", folder);
    json_error_t error;
    json_t *root = json_load_file(path, 0, &error);
    if (root == NULL)
        fail_msg("not JSON: %s", error.text);
    return root;
}

static void compare_prints_one_json_object(void **state)
{
    (void)state;
    save(flat(20, 10, 1.1f, 1, 1), "a.exr");
    save(flat(20, 10, 1, 1, 1), "b.exr");
    assert_int_equal(compare("a.exr b.exr --json --blocks 16"), 0);
    json_t *root = printed();
    expect_near(json_real_value(json_object_get(root, "relmse")), 0.01 / 1.01 / 3, 1e-8, "relmse");
    json_t *means = json_object_get(root, "mean_a");
    assert_int_equal(json_array_size(means), 3);
    expect_near(json_real_value(json_array_get(means, 0)), 1.1, 1e-6, "mean_a");
    assert_int_equal(strlen(json_string_value(json_object_get(root, "pixels_sha256_a"))), 64);
    assert_string_not_equal(json_string_value(json_object_get(root, "pixels_sha256_a")),
                            json_string_value(json_object_get(root, "pixels_sha256_b")));
    json_t *blocks = json_object_get(root, "blocks");
    assert_int_equal(json_array_size(blocks), 2);
    assert_int_equal(json_integer_value(json_object_get(json_array_get(blocks, 1), "x")), 16);
    assert_true(json_is_null(json_object_get(json_array_get(blocks, 1), "stderr_a")));
    json_decref(root);
}

static void the_exit_status_tells_too_far_from_impossible(void **state)
{
    (void)state;
    save(flat(20, 10, 1.1f, 1, 1), "a.exr");
    save(flat(20, 10, 1, 1, 1), "b.exr");
    save(flat(10, 20, 1, 1, 1), "c.exr");
    static const struct {
        const char *words;
        int status;
    } rows[] = {
        { "a.exr b.exr", 0 },
        { "a.exr b.exr --max-relmse 0.01", 0 },
        { "a.exr b.exr --max-relmse 0.001", 1 },
        { "--max-relmse 0 b.exr b.exr", 0 },
        { "a.exr b.exr --channels G --max-relmse 0", 0 },
        { "a.exr b.exr --channels R,G", 2 },
        { "a.exr b.exr --channels stderr.R", 2 },
        { "a.exr c.exr", 2 },
        { "a.exr absent.exr", 2 },
        { "a.exr", 2 },
        { "a.exr b.exr c.exr", 2 },
        { "a.exr b.exr --max-relmse nan", 2 },
        { "a.exr b.exr --blocks 0", 2 },
        { "a.exr b.exr --blocks 2.5", 2 },
        { "a.exr b.exr --colour", 2 },
        { "--help", 0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        int status = compare(rows[i].words);
        if (status != rows[i].status)
            fail_msg("compare %s: status %d, wanted %d", rows[i].words, status, rows[i].status);
    }
}

static void pictures_of_luminance_alone_are_compared(void **state)
{
    (void)state;
    struct image *grey = image_new(4, 4);
    image_add_channel(grey, "Y")[5] = 0.5f;
    save(grey, "y.exr");
    assert_int_equal(compare("y.exr y.exr --max-relmse 0 --json"), 0);
    json_t *root = printed();
    expect_near(json_real_value(json_array_get(json_object_get(root, "mean_b"), 2)), 0.5 / 16, 0,
                "mean_b");
    json_decref(root);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_distances_are_measured),
        cmocka_unit_test(pixels_that_are_not_finite_are_counted_and_left_out),
        cmocka_unit_test(pictures_that_do_not_match_are_refused),
        cmocka_unit_test(the_digest_is_that_of_interleaved_floats),
        cmocka_unit_test(blocks_have_means_and_standard_errors),
        cmocka_unit_test(flip_agrees_with_its_transcription),
        cmocka_unit_test(flip_of_plain_colours_is_the_papers_map_of_their_distance),
        cmocka_unit_test(compare_prints_one_json_object),
        cmocka_unit_test(the_exit_status_tells_too_far_from_impossible),
        cmocka_unit_test(pictures_of_luminance_alone_are_compared),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
