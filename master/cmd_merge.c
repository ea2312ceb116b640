#include "master/cmd_merge.h"

#include "common/err.h"
#include "master/exr.h"
#include "master/heat.h"
#include "master/image.h"
#include "master/merge.h"
#include "master/png.h"

#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DONE       0
#define FAILED     1
#define IMPOSSIBLE 2

#define BUILD "pathfarm " PATHFARM_VERSION ", " __VERSION__

struct options {
    const char *output, *png, *heat;
    char **paths;
    int count;
};

static void usage(FILE *out)
{
    fputs("Usage: pathfarm merge A.exr B.exr ... -o OUT.exr [OPTIONS]\n"
          "\n"
          "Joins pictures of one job that were rendered with different seeds, weighted by their\n"
          "samples, into one that is as good as all of them together. A PNG goes beside it.\n"
          "\n"
          "  -o OUT.exr       the joined picture\n"
          "  --png FILE       write the PNG there instead\n"
          "  --heat FILE.png  the relative standard error of every pixel, in colours\n"
          "\n"
          "Exit status: 0; 1 when the pictures cannot be read or written; 2 when they do not\n"
          "belong together.\n",
          out);
}

/* False with the reason in err; *help when that is all that was asked for. */
static bool parse_options(int argc, char **argv, struct options *options, bool *help,
                          struct err *err)
{
    static const struct option known[] = {
        { "png", required_argument, NULL, 'p' },
        { "heat", required_argument, NULL, 'e' },
        { "help", no_argument, NULL, 'h' },
        { 0 },
    };
    *options = (struct options){ .output = NULL };
    optind = 1;
    for (int option; (option = getopt_long(argc, argv, "ho:", known, NULL)) != -1;) {
        switch (option) {
        case 'o':
            options->output = optarg;
            break;
        case 'p':
            options->png = optarg;
            break;
        case 'e':
            options->heat = optarg;
            break;
        case 'h':
            *help = true;
            return true;
        default: /* getopt has said what is wrong */
            return err_set(err, ERR_ARGUMENT, "see pathfarm merge --help");
        }
    }
    options->paths = argv + optind;
    options->count = argc - optind;
    if (options->count < 2)
        return err_set(err, ERR_ARGUMENT, "at least two pictures are needed");
    if (options->output == NULL)
        return err_set(err, ERR_ARGUMENT, "where to? -o OUT.exr is missing");
    return true;
}

/* "OUT.png" of "OUT.exr"; the caller's to free. */
static char *png_beside(const char *output)
{
    const char *slash = strrchr(output, '/');
    const char *dot = strrchr(slash == NULL ? output : slash, '.');
    size_t stem = dot == NULL || dot == output ? strlen(output) : (size_t)(dot - output);
    char *png = NULL;
    return asprintf(&png, "%.*s.png", (int)stem, output) < 0 ? NULL : png;
}

/* What was asked for, in a line, for the metadata; the caller's to free. */
static char *command_of(const struct options *options)
{
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    if (out == NULL)
        return NULL;
    fputs("pathfarm merge", out);
    for (int i = 0; i < options->count; i++)
        fprintf(out, " %s", options->paths[i]);
    fprintf(out, " -o %s", options->output);
    return fclose(out) == 0 ? text : NULL;
}

static struct image *join(const struct options *options, const char *command, struct err *err)
{
    struct image *joined = NULL;
    struct merge *merge = merge_new();
    if (merge == NULL) {
        err_set(err, ERR_MEMORY, "no memory to merge pictures in");
        return NULL;
    }
    for (int i = 0; i < options->count; i++) {
        struct image *image = exr_image_read(options->paths[i], err);
        bool added = image != NULL && merge_add(merge, image, options->paths[i], err);
        image_free(image);
        if (!added)
            goto done;
    }
    joined = merge_take(merge, command, BUILD, err);

done:
    merge_free(merge);
    return joined;
}

int cmd_merge(int argc, char **argv)
{
    struct err err = { 0 };
    struct options options;
    struct image *image = NULL;
    bool help = false;
    if (!parse_options(argc, argv, &options, &help, &err)) {
        fprintf(stderr, "pathfarm merge: %s\n", err.text);
        return IMPOSSIBLE;
    }
    if (help) {
        usage(stdout);
        return DONE;
    }

    char *command = command_of(&options);
    char *png = options.png != NULL ? strdup(options.png) : png_beside(options.output);
    if (command == NULL || png == NULL)
        err_set(&err, ERR_MEMORY, "out of memory");
    else if (strcmp(png, options.output) == 0)
        err_set(&err, ERR_ARGUMENT, "-o names the EXR; --png names the PNG");
    else
        image = join(&options, command, &err);
    bool written = image != NULL && exr_image_write(image, options.output, &err) &&
                   png_preview_write(image, png, &err) &&
                   (options.heat == NULL || heat_write(image, options.heat, &err));
    if (written)
        fprintf(stderr, "%s, %s: %s samples per pixel of %s pictures\n", options.output, png,
                image_attribute(image, "pathfarm.spp"), image_attribute(image, "pathfarm.merged"));
    else
        fprintf(stderr, "pathfarm merge: %s\n", err.text);
    image_free(image);
    free(png);
    free(command);
    return written ? DONE : err.code == ERR_ARGUMENT ? IMPOSSIBLE : FAILED;
}
