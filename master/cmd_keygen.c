#include "master/cmd_keygen.h"

#include "common/err.h"
#include "proto/keys.h"

#include <getopt.h>
#include <stdbool.h>
#include <stdio.h>

static void usage(FILE *out)
{
    fputs("Usage: pathfarm keygen [OPTIONS] FOLDER\n"
          "\n"
          "Makes the keys and certificates of a farm in FOLDER: master, worker and user.\n"
          "A worker's machine needs worker.key, worker.crt and master.crt, and nothing else.\n"
          "\n"
          "  --overwrite  replace keys that are there already\n",
          out);
}

int cmd_keygen(int argc, char **argv)
{
    static const struct option known[] = {
        { "overwrite", no_argument, NULL, 'o' },
        { "help", no_argument, NULL, 'h' },
        { 0 },
    };
    bool overwrite = false;
    optind = 1;
    for (int option; (option = getopt_long(argc, argv, "h", known, NULL)) != -1;) {
        switch (option) {
        case 'o':
            overwrite = true;
            break;
        case 'h':
            usage(stdout);
            return 0;
        default:
            usage(stderr);
            return 2;
        }
    }
    if (argc - optind != 1) {
        usage(stderr);
        return 2;
    }

    struct err err = { 0 };
    const char *folder = argv[optind];
    if (!keys_generate(folder, overwrite, &err)) {
        fprintf(stderr, "pathfarm keygen: %s\n", err.text);
        return 1;
    }
    printf("Keys of master, worker and user are in %s.\n"
           "Copy worker.key, worker.crt and master.crt to each worker's machine, by a way that\n"
           "nobody else can read; master.key stays with the master.\n",
           folder);
    return 0;
}
