#include "master/cmd_compare.h"

#include "common/err.h"
#include "master/exr.h"
#include "master/image.h"
#include "master/measure.h"

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DONE       0
#define TOO_FAR    1
#define IMPOSSIBLE 2

struct options {
    const char *path[2];
    bool json;
    double max_relmse; /* NaN: no limit */
    uint32_t blocks;   /* side in pixels; 0: none */
    bool channels_given;
    struct measure_channels channels;
    char channel_names[256];
};

/* What is printed. */
struct findings {
    struct measure measure;
    struct digest digest[2];
    struct measure_block *blocks;
    size_t block_count;
};

static void usage(FILE *out)
{
    fputs("Usage: pathfarm compare [OPTIONS] A.exr B.exr\n"
          "\n"
          "Says how far A is from the reference B. Both must cover the same pixels.\n"
          "\n"
          "  --json            print one JSON object\n"
          "  --max-relmse X    exit with 1 when relMSE is above X (or unknown)\n"
          "  --blocks N        per-block means and standard errors, blocks of N x N pixels\n"
          "  --channels R,G,B  the three channels to compare, or one of them\n"
          "\n"
          "relMSE = mean((a - b)^2 / (b^2 + 0.01)); MAPE = mean(|a - b| / (|b| + 0.01)); FLIP is\n"
          "the mean of LDR-FLIP (Andersson et al. 2020) at 67 pixels per degree. Pixels that are\n"
          "not finite in either image are counted and left out.\n"
          "\n"
          "Exit status: 0; 1 above --max-relmse; 2 when the images cannot be compared.\n",
          out);
}

static bool parse_number(const char *text, double *number)
{
    char *end;
    errno = 0;
    *number = strtod(text, &end);
    return end != text && *end == '\0' && errno == 0 && isfinite(*number);
}

/* "R,G,B", or one name that stands for all three */
static bool parse_channels(const char *text, struct options *options)
{
    if (strlen(text) >= sizeof(options->channel_names))
        return false;
    strcpy(options->channel_names, text);
    unsigned count = 0;
    char *rest = options->channel_names;
    for (char *name; (name = strsep(&rest, ",")) != NULL; count++) {
        if (count == 3 || *name == '\0')
            return false;
        options->channels.name[count] = name;
    }
    if (count == 1)
        options->channels.name[1] = options->channels.name[2] = options->channels.name[0];
    options->channels_given = true;
    return count == 1 || count == 3;
}

/* False with the reason in err; *help when that is all that was asked for. */
static bool parse_options(int argc, char **argv, struct options *options, bool *help,
                          struct err *err)
{
    static const struct option known[] = {
        { "json", no_argument, NULL, 'j' },         { "max-relmse", required_argument, NULL, 'm' },
        { "blocks", required_argument, NULL, 'b' }, { "channels", required_argument, NULL, 'c' },
        { "help", no_argument, NULL, 'h' },         { 0 },
    };
    *options = (struct options){
        .max_relmse = NAN,
        .channels = { .name = { "R", "G", "B" } },
    };
    double side;
    optind = 1;
    for (int option; (option = getopt_long(argc, argv, "h", known, NULL)) != -1;) {
        switch (option) {
        case 'j':
            options->json = true;
            break;
        case 'm':
            if (!parse_number(optarg, &options->max_relmse) || options->max_relmse < 0)
                return err_set(err, ERR_ARGUMENT, "--max-relmse: \"%s\" is not a number >= 0",
                               optarg);
            break;
        case 'b':
            if (!parse_number(optarg, &side) || side < 1 || side > 65536 || side != floor(side))
                return err_set(err, ERR_ARGUMENT, "--blocks: \"%s\" is not a number of pixels",
                               optarg);
            options->blocks = (uint32_t)side;
            break;
        case 'c':
            if (!parse_channels(optarg, options))
                return err_set(err, ERR_ARGUMENT,
                               "--channels: \"%s\" is neither one name nor three", optarg);
            break;
        case 'h':
            *help = true;
            return true;
        default: /* getopt has said what is wrong */
            return err_set(err, ERR_ARGUMENT, "see pathfarm compare --help");
        }
    }
    if (argc - optind != 2)
        return err_set(err, ERR_ARGUMENT, "two images are needed; see pathfarm compare --help");
    options->path[0] = argv[optind];
    options->path[1] = argv[optind + 1];
    return true;
}

/* JSON knows no NaN and no infinity */
static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static json_t *triple(const double value[3])
{
    return json_pack("[ooo]", number(value[0]), number(value[1]), number(value[2]));
}

static json_t *hex(const struct digest *digest)
{
    char text[DIGEST_HEX_SIZE];
    return json_string(digest_hex(digest, text));
}

static json_t *blocks_json(const struct findings *found)
{
    json_t *blocks = json_array();
    for (size_t i = 0; i < found->block_count; i++) {
        const struct measure_block *block = &found->blocks[i];
        json_array_append_new(
            blocks,
            json_pack("{si si si si so so so so so so sI}", "x", (int)block->x, "y", (int)block->y,
                      "width", (int)block->width, "height", (int)block->height, "mean_a",
                      triple(block->mean_a), "mean_b", triple(block->mean_b), "luminance_a",
                      number(block->luminance_a), "luminance_b", number(block->luminance_b),
                      "stderr_a", number(block->stderr_a), "stderr_b", number(block->stderr_b),
                      "pixels", (json_int_t)block->pixels));
    }
    return blocks;
}

static bool print_json(const struct findings *found)
{
    const struct measure *m = &found->measure;
    json_t *root = json_pack(
        "{so so so so so so so so sI sI sI}", "rmse", number(m->rmse), "relmse", number(m->relmse),
        "mape", number(m->mape), "flip", number(m->flip), "mean_a", triple(m->mean_a), "mean_b",
        triple(m->mean_b), "pixels_sha256_a", hex(&found->digest[0]), "pixels_sha256_b",
        hex(&found->digest[1]), "pixels", (json_int_t)m->pixels, "nonfinite_a",
        (json_int_t)m->nonfinite_a, "nonfinite_b", (json_int_t)m->nonfinite_b);
    if (root != NULL && found->blocks != NULL)
        json_object_set_new(root, "blocks", blocks_json(found));
    bool printed = root != NULL && json_dumpf(root, stdout, JSON_REAL_PRECISION(17)) == 0;
    json_decref(root);
    putchar('\n');
    return printed;
}

static void print_text(const struct options *options, const struct findings *found)
{
    const struct measure *m = &found->measure;
    printf("RMSE    %.6g\nrelMSE  %.6g\nMAPE    %.6g\nFLIP    %.6g\n", m->rmse, m->relmse, m->mape,
           m->flip);
    for (int c = 0; c < 3; c++)
        printf("mean %-4s %.6g  reference %.6g  ratio %.5f\n", options->channels.name[c],
               m->mean_a[c], m->mean_b[c], m->mean_a[c] / m->mean_b[c]);
    if (m->nonfinite_a + m->nonfinite_b > 0)
        printf("left out: pixels that are not finite, %" PRIu64 " in A and %" PRIu64 " in B\n",
               m->nonfinite_a, m->nonfinite_b);
    printf("pixels  %s\n",
           digest_equal(&found->digest[0], &found->digest[1]) ? "the same bits" : "differ");
    for (size_t i = 0; i < found->block_count; i++) {
        const struct measure_block *block = &found->blocks[i];
        if (i == 0)
            printf("%6s %6s %12s %12s %10s %10s\n", "x", "y", "A", "B", "stderr A", "stderr B");
        printf("%6" PRIu32 " %6" PRIu32 " %12.6g %12.6g %10.3g %10.3g\n", block->x, block->y,
               block->luminance_a, block->luminance_b, block->stderr_a, block->stderr_b);
    }
}

/* Grey pictures have luminance only */
static void use_luminance_if_grey(const struct image *const images[2], struct options *options)
{
    for (int i = 0; i < 2; i++)
        if (options->channels_given || image_channel(images[i], "R") != NULL ||
            image_channel(images[i], "Y") == NULL)
            return;
    for (int c = 0; c < 3; c++)
        options->channels.name[c] = "Y";
}

static bool compare(struct options *options, struct findings *found, struct err *err)
{
    bool done = false;
    struct image *a = exr_image_read(options->path[0], err);
    if (a == NULL)
        return false;
    struct image *b = exr_image_read(options->path[1], err);
    if (b == NULL)
        goto fail_b;
    use_luminance_if_grey((const struct image *const[]){ a, b }, options);

    done = measure_images(a, b, &options->channels, &found->measure, err) &&
           measure_pixels_digest(a, &options->channels, &found->digest[0], err) &&
           measure_pixels_digest(b, &options->channels, &found->digest[1], err);
    if (done && options->blocks > 0) {
        found->blocks = measure_blocks(a, b, &options->channels, options->blocks,
                                       &found->block_count, err);
        done = found->blocks != NULL;
    }
    if (!done)
        err_wrap(err, "%s and %s", options->path[0], options->path[1]);
    image_free(b);
fail_b:
    image_free(a);
    return done;
}

int cmd_compare(int argc, char **argv)
{
    struct err err = { 0 };
    struct options options;
    struct findings found = { 0 };
    bool help = false;
    if (!parse_options(argc, argv, &options, &help, &err))
        goto fail;
    if (help) {
        usage(stdout);
        return DONE;
    }
    if (!compare(&options, &found, &err))
        goto fail;

    bool printed = true;
    if (options.json)
        printed = print_json(&found);
    else
        print_text(&options, &found);
    free(found.blocks);
    if (!printed || fflush(stdout) != 0) {
        err_set(&err, ERR_IO, "the result cannot be printed");
        goto fail;
    }
    /* Written so that NaN is above every limit */
    if (!isnan(options.max_relmse) && !(found.measure.relmse <= options.max_relmse))
        return TOO_FAR;
    return DONE;

fail:
    fprintf(stderr, "pathfarm compare: %s\n", err.text);
    return IMPOSSIBLE;
}
