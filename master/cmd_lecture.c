#include "master/cmd_lecture.h"

#include "common/err.h"
#include "master/lecture.h"
#include "master/page.h"

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

static void usage(FILE *out)
{
    fputs("Usage: pathfarm lecture [OPTIONS]\n"
          "\n"
          "Runs the experiments of J. Kautz's lecture \"Introduction to Path Tracing\" and writes\n"
          "tables, plots and pictures as one HTML page that needs nothing else.\n"
          "\n"
          "  -o, --output FILE.html  where to (lecture.html)\n"
          "      --seed N            other random numbers; the same ones give the same page (0)\n"
          "      --quick             few samples: seconds instead of a minute\n"
          "  -q, --quiet             say nothing unless it goes wrong\n"
          "\n"
          "Exit status: 0; 1 when the page cannot be written; 2 when arguments are wrong.\n",
          out);
}

struct options {
    const char *output;
    uint64_t seed;
    bool quick, quiet, help;
};

static bool parse_seed(const char *text, uint64_t *seed)
{
    char *end;
    errno = 0;
    *seed = strtoull(text, &end, 10);
    return *text >= '0' && *text <= '9' && *end == '\0' && errno == 0;
}

static bool parse_options(int argc, char **argv, struct options *options)
{
    static const struct option known[] = {
        { "output", required_argument, NULL, 'o' }, { "seed", required_argument, NULL, 's' },
        { "quick", no_argument, NULL, 'f' },        { "quiet", no_argument, NULL, 'q' },
        { "help", no_argument, NULL, 'h' },         { 0 },
    };
    *options = (struct options){ .output = "lecture.html" };
    optind = 1;
    for (int option; (option = getopt_long(argc, argv, "o:qh", known, NULL)) != -1;) {
        switch (option) {
        case 'o':
            options->output = optarg;
            break;
        case 's':
            if (!parse_seed(optarg, &options->seed)) {
                fprintf(stderr, "pathfarm lecture: --seed wants a whole number, not \"%s\"\n",
                        optarg);
                return false;
            }
            break;
        case 'f':
            options->quick = true;
            break;
        case 'q':
            options->quiet = true;
            break;
        case 'h':
            options->help = true;
            return true;
        default:
            usage(stderr);
            return false;
        }
    }
    if (optind < argc) {
        fprintf(stderr, "pathfarm lecture: \"%s\" is no option; see --help\n", argv[optind]);
        return false;
    }
    return true;
}

int cmd_lecture(int argc, char **argv)
{
    struct options options;
    if (!parse_options(argc, argv, &options))
        return 2;
    if (options.help) {
        usage(stdout);
        return 0;
    }
    struct err err = { 0 };
    struct lecture lecture = { .seed = options.seed, .quick = options.quick };
    if (!lecture_make(&lecture, &err)) {
        fprintf(stderr, "pathfarm lecture: %s\n", err.text);
        return 1;
    }
    bool saved = page_save(lecture.page, options.output, &err);
    page_free(lecture.page);
    if (!saved) {
        fprintf(stderr, "pathfarm lecture: %s\n", err.text);
        return 1;
    }
    if (!options.quiet)
        printf("%s\n", options.output);
    return 0;
}
