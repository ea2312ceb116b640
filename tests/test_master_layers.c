/*
 * The layers of the picture: averages over hits and ranks of identities from the film's sums, and
 * how they are stored: half, and every compression.
 */
#include "common/aov.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/cryptomatte.h"
#include "master/exr.h"
#include "master/film.h"
#include "master/image.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#define PIXELS 6 /* three by two, at (10, 20) of a larger picture */

static struct mesh meshes[3];
static struct group groups[2];
static struct instance instances[3] = { { .group = 1 }, { .group = 0 }, { .group = 1 } };
static struct scene_name group_names[1] = { { 1, "tree" } };
static struct scene_name names[1] = { { 1, "red \"velvet\"" } };

static struct scene small_scene(void)
{
    return (struct scene){ .settings = { .width = 50,
                                         .height = 40,
                                         .crop = { 10, 13, 20, 22 },
                                         .center = { 1e6, 0, -3 } },
                           .meshes = meshes,
                           .mesh_count = 3,
                           .material_count = 2,
                           .groups = groups,
                           .group_count = 2,
                           .instances = instances,
                           .instance_count = 3,
                           .group_names = group_names,
                           .group_name_count = 1,
                           .material_names = names,
                           .material_name_count = 1 };
}

/* A film of two replicates with everything zero in its first leaves, but for what `fill` puts in */
static struct image *picture_of(uint32_t aovs,
                                void (*fill)(struct node_sums *sums, uint32_t replicate))
{
    struct err err = { 0 };
    struct scene scene = small_scene();
    struct job_spec spec = {
        .replicates = 2, .leaf_samples = 4, .channel_count = aov_channel_count(aovs), .aovs = aovs
    };
    struct film *film = film_new(&scene, &spec, 1, 0, &err);
    if (film == NULL)
        fail_msg("%s", err.text);
    for (uint32_t k = 0; k < 2; k++) {
        struct node_sums *sums = node_sums_new(PIXELS, spec.channel_count);
        assert_non_null(sums);
        sums->stats.samples = 4 * PIXELS;
        fill(sums, k);
        struct node_id id = { .replicate = k };
        assert_int_equal(film_accept(film, &id, sums), FILM_SEALED);
    }
    struct image *image = film_image_new(film);
    assert_non_null(image);
    if (!film_image(film, image, NULL, &err))
        fail_msg("%s", err.text);
    film_free(film);
    return image;
}

#define GEOMETRY (1u << AOV_ALPHA | 1u << AOV_DEPTH | 1u << AOV_POSITION)

/* Pixel 4: three hits of four in replicate 0, one in replicate 1 */
static void fill_geometry(struct node_sums *sums, uint32_t replicate)
{
    float hits = replicate == 0 ? 3 : 1;
    const struct {
        uint32_t channel;
        float sum;
    } rows[] = {
        { AOV_COVERAGE_CHANNEL, hits },
        { aov_channel(GEOMETRY, AOV_ALPHA), hits },
        { aov_channel(GEOMETRY, AOV_DEPTH), replicate == 0 ? 30 : 14 },
        { aov_channel(GEOMETRY, AOV_POSITION), replicate == 0 ? 6 : -4 },
        { aov_channel(GEOMETRY, AOV_POSITION) + 1, 0 },
        { aov_channel(GEOMETRY, AOV_POSITION) + 2, replicate == 0 ? 1 : 1 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        sums->values[rows[i].channel * PIXELS + 4] = rows[i].sum;
}

static void layers_are_averages_over_the_hits_in_world_space(void **state)
{
    (void)state;
    struct image *image = picture_of(GEOMETRY, fill_geometry);
    assert_true(image_channel(image, "A")[4] == 0.5f);
    assert_true(image_channel(image, "depth.Z")[4] == 11);
    assert_true(image_channel(image, "position.X")[4] == 1000000.5f);
    assert_true(image_channel(image, "position.Y")[4] == 0);
    assert_true(image_channel(image, "position.Z")[4] == -2.5f);
    assert_null(image_channel(image, "normal.X"));
    for (size_t pixel = 0; pixel < PIXELS; pixel++) {
        if (pixel == 4)
            continue;
        assert_true(image_channel(image, "A")[pixel] == 0);
        assert_true(image_channel(image, "depth.Z")[pixel] == 0);
        assert_true(image_channel(image, "position.X")[pixel] == 0); /* not the centre's */
    }
    image_free(image);
}

#define IDS (1u << AOV_OBJECT)

static void fill_ids(struct node_sums *sums, uint32_t replicate)
{
    static const float seen[2][AOV_ID_SAMPLES] = { { 2, 0, 3, 2 }, { 2, 3, 0, 1 } };
    for (uint32_t s = 0; s < AOV_ID_SAMPLES; s++)
        sums->values[(aov_channel(IDS, AOV_OBJECT) + s) * PIXELS + 1] = seen[replicate][s];
}

static void identities_are_ranked_by_their_coverage(void **state)
{
    (void)state;
    struct image *image = picture_of(IDS, fill_ids);
    const struct {
        const char *channel;
        float value;
    } rows[] = {
        { "CryptoObject00.R", cryptomatte_id("object 1") },
        { "CryptoObject00.G", 3 / 8.f },
        { "CryptoObject00.B", cryptomatte_id("object 2") },
        { "CryptoObject00.A", 2 / 8.f },
        { "CryptoObject01.R", cryptomatte_id("object 0") },
        { "CryptoObject01.G", 1 / 8.f },
        { "CryptoObject01.B", 0 },
        { "CryptoObject02.A", 0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        assert_non_null(image_channel(image, rows[i].channel));
        if (image_channel(image, rows[i].channel)[1] != rows[i].value)
            fail_msg("%s is %.9g", rows[i].channel,
                     (double)image_channel(image, rows[i].channel)[1]);
        assert_true(image_channel(image, rows[i].channel)[0] == 0);
    }

    /* What readers look for; the key is the beginning of the layer name's hash */
    char key[16], name[64], want[64];
    snprintf(key, sizeof(key), "%08x", cryptomatte_hash("CryptoObject", 12));
    key[7] = '\0';
    snprintf(name, sizeof(name), "cryptomatte/%s/name", key);
    assert_string_equal(image_attribute(image, name), "CryptoObject");
    snprintf(name, sizeof(name), "cryptomatte/%s/conversion", key);
    assert_string_equal(image_attribute(image, name), "uint32_to_float32");
    snprintf(name, sizeof(name), "cryptomatte/%s/hash", key);
    assert_string_equal(image_attribute(image, name), "MurmurHash3_32");
    snprintf(name, sizeof(name), "cryptomatte/%s/manifest", key);
    uint32_t bits;
    float id = cryptomatte_id("object 2");
    memcpy(&bits, &id, sizeof(bits));
    snprintf(want, sizeof(want), "\"object 2\":\"%08x\"", bits);
    assert_non_null(strstr(image_attribute(image, name), want));
    image_free(image);
}

/* Behind three meshes */
static void fill_instances(struct node_sums *sums, uint32_t replicate)
{
    static const float seen[2][AOV_ID_SAMPLES] = { { 4, 4, 4, 4 }, { 6, 6, 6, 5 } };
    for (uint32_t s = 0; s < AOV_ID_SAMPLES; s++)
        sums->values[(aov_channel(IDS, AOV_OBJECT) + s) * PIXELS] = seen[replicate][s];
}

static void every_instance_has_an_identity_of_its_own(void **state)
{
    (void)state;
    struct image *image = picture_of(IDS, fill_instances);
    assert_true(image_channel(image, "CryptoObject00.R")[0] == cryptomatte_id("tree#0"));
    assert_true(image_channel(image, "CryptoObject00.B")[0] == cryptomatte_id("tree#2"));
    assert_true(image_channel(image, "CryptoObject01.R")[0] == cryptomatte_id("instance#1"));
    assert_true(image_channel(image, "CryptoObject01.G")[0] == 1 / 8.f);
    image_free(image);
}

#define MOVES (1u << AOV_MOTION)

/* Two hits in replicate 0, six in replicate 1 */
static void fill_motion(struct node_sums *sums, uint32_t replicate)
{
    sums->values[AOV_COVERAGE_CHANNEL * PIXELS + 2] = replicate == 0 ? 2 : 6;
    sums->values[aov_channel(MOVES, AOV_MOTION) * PIXELS + 2] = replicate == 0 ? 4 : 12;
    sums->values[(aov_channel(MOVES, AOV_MOTION) + 1) * PIXELS + 2] = replicate == 0 ? -1 : 5;
}

static void motion_is_an_average_over_the_hits(void **state)
{
    (void)state;
    struct image *image = picture_of(MOVES, fill_motion);
    assert_true(image_channel(image, "motion.X")[2] == 2);
    assert_true(image_channel(image, "motion.Y")[2] == 0.5f);
    assert_true(image_channel(image, "motion.X")[3] == 0);
    image_free(image);
}

static void names_hash_as_everywhere(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint32_t hash;
    } rows[] = {
        { "", 0 },
        { "hello", 0x248bfa47 },
        { "hello, world", 0x149bbb7f },
        { "The quick brown fox jumps over the lazy dog", 0x2e4ff723 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        assert_int_equal(cryptomatte_hash(rows[i].name, strlen(rows[i].name)), rows[i].hash);
    for (int i = 0; i < 100000; i++) {
        char name[32];
        snprintf(name, sizeof(name), "thing %d", i);
        assert_true(isnormal(cryptomatte_id(name)));
    }
    assert_true(cryptomatte_id("") == 0x1p-126f); /* no bits at all: the exponent is lifted */
}

static void only_the_six_that_cover_most_are_kept(void **state)
{
    (void)state;
    uint32_t samples[] = { 9, 8, 7, 7, 1, 2, 3, 4, 0, 9, 9, 0 };
    uint32_t index[CRYPTOMATTE_RANKS];
    float coverage[CRYPTOMATTE_RANKS];
    cryptomatte_rank(samples, 12, index, coverage);
    const uint32_t want[CRYPTOMATTE_RANKS] = { 9, 7, 1, 2, 3, 4 };
    assert_memory_equal(index, want, sizeof(want));
    assert_true(coverage[0] == 3 / 12.f && coverage[1] == 2 / 12.f && coverage[5] == 1 / 12.f);
    cryptomatte_rank(samples, 0, index, coverage);
    assert_true(index[0] == 0 && coverage[0] == 0);
}

#define MATERIALS (1u << AOV_MATERIAL)

static void fill_materials(struct node_sums *sums, uint32_t replicate)
{
    for (uint32_t s = 0; s < AOV_ID_SAMPLES; s++)
        sums->values[(aov_channel(MATERIALS, AOV_MATERIAL) + s) * PIXELS] = (float)(1 + replicate);
}

static void materials_keep_the_names_of_the_file(void **state)
{
    (void)state;
    struct image *image = picture_of(MATERIALS, fill_materials);
    assert_true(image_channel(image, "CryptoMaterial00.R")[0] == cryptomatte_id("material 0"));
    assert_true(image_channel(image, "CryptoMaterial00.G")[0] == 0.5f);
    assert_true(image_channel(image, "CryptoMaterial00.B")[0] == cryptomatte_id("red \"velvet\""));
    image_free(image);
}

/* ---- files */

static struct image *odd_image(void)
{
    struct image *image = image_new(37, 41); /* several chunks, the last one cut */
    float *r = image_add_channel(image, "R"), *z = image_add_exact_channel(image, "depth.Z");
    assert_non_null(r);
    assert_non_null(z);
    for (size_t p = 0; p < 37 * 41; p++) {
        r[p] = (float)(p % 97) * 0.37f - 5;
        z[p] = (float)p * 1e5f + 0.1f;
    }
    const float special[] = {
        1 + 0x1p-11f, 1 + 0x3p-11f, 70000, -1e30f, INFINITY, 65519, 0x1p-26f
    };
    memcpy(r, special, sizeof(special));
    memcpy(r + 37 * 40, special, sizeof(special));
    return image;
}

static struct image *through_a_file(const struct image *image, struct exr_format format)
{
    char path[] = "/tmp/pathfarm-layers-XXXXXX";
    struct err err = { 0 };
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    close(fd);
    if (!exr_image_write_as(image, &format, path, &err))
        fail_msg("%s", err.text);
    struct image *back = exr_image_read(path, &err);
    if (back == NULL)
        fail_msg("%s", err.text);
    unlink(path);
    return back;
}

static void every_compression_keeps_every_bit(void **state)
{
    (void)state;
    struct image *image = odd_image();
    for (int packing = 0; packing <= EXR_PACKING_NONE; packing++) {
        struct image *back = through_a_file(image, (struct exr_format){ .packing = packing });
        for (uint32_t c = 0; c < image->channel_count; c++)
            assert_memory_equal(image_channel(back, image->channels[c].name),
                                image->channels[c].values, sizeof(float) * 37 * 41);
        image_free(back);
    }
    image_free(image);
}

static void half_rounds_to_even_and_never_overflows(void **state)
{
    (void)state;
    struct image *image = odd_image();
    for (int packing = 0; packing <= EXR_PACKING_NONE; packing++) {
        struct exr_format format = { .half = true, .packing = packing };
        struct image *back = through_a_file(image, format);
        const float *from = image_channel(image, "R"), *r = image_channel(back, "R");
        const float want[] = { 1, 1 + 0x1p-9f, 65504, -65504, INFINITY, 65504, 0 };
        assert_memory_equal(r, want, sizeof(want));
        assert_memory_equal(r + 37 * 40, want, sizeof(want));
        for (size_t p = 7; p < 37 * 40; p++)
            assert_true(fabsf(r[p] - from[p]) <= fabsf(from[p]) * 0x1p-11f);
        assert_memory_equal(image_channel(back, "depth.Z"), image_channel(image, "depth.Z"),
                            sizeof(float) * 37 * 41);
        assert_int_equal(exr_values_clamped(image, &format), 6);
        image_free(back);
    }
    const struct exr_format full = { .half = false };
    assert_int_equal(exr_values_clamped(image, &full), 0);
    image_free(image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(layers_are_averages_over_the_hits_in_world_space),
        cmocka_unit_test(identities_are_ranked_by_their_coverage),
        cmocka_unit_test(materials_keep_the_names_of_the_file),
        cmocka_unit_test(every_instance_has_an_identity_of_its_own),
        cmocka_unit_test(motion_is_an_average_over_the_hits),
        cmocka_unit_test(names_hash_as_everywhere),
        cmocka_unit_test(only_the_six_that_cover_most_are_kept),
        cmocka_unit_test(every_compression_keeps_every_bit),
        cmocka_unit_test(half_rounds_to_even_and_never_overflows),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
