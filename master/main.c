/* The `pathfarm` program: its commands, in a table. */
#include "master/cmd_accuracy.h"
#include "master/cmd_compare.h"
#include "master/cmd_keygen.h"
#include "master/cmd_lecture.h"
#include "master/cmd_plan.h"
#include "master/cmd_render.h"
#include "master/cmd_selftest.h"
#include "master/options.h"

#include <stdio.h>
#include <string.h>

#define COMMAND_MAP(X)                                                                    \
    X(render, "SCENE -o OUT.exr", "render a scene, here and on workers that join")        \
    X(plan, "SCENE", "what rendering a scene would involve, without doing it")            \
    X(compare, "A.exr B.exr", "how far picture A is from the reference B")                \
    X(accuracy, "SCENE", "what accuracy costs in time: techniques and samplers compared") \
    X(keygen, "DIR", "make the keys of a farm")                                           \
    X(lecture, "", "the lecture on path tracing, run: a page of experiments")             \
    X(selftest, "", "check this machine's arithmetic")

static const struct command {
    const char *name, *arguments, *help;
    int (*run)(int argc, char **argv);
} COMMANDS[] = {
#define X(name, arguments, help) { #name, arguments, help, cmd_##name },
    COMMAND_MAP(X)
#undef X
};

static const char *const NAMES[] = {
#define X(name, arguments, help) #name,
    COMMAND_MAP(X)
#undef X
        "--help",
    "--version", NULL
};

static void print_help(FILE *out)
{
    fprintf(out, "pathfarm renders a scene on one machine or many, with the same bits on all.\n\n");
    for (size_t i = 0; i < sizeof(COMMANDS) / sizeof(COMMANDS[0]); i++)
        fprintf(out, "  pathfarm %-9s%-17s %s\n", COMMANDS[i].name, COMMANDS[i].arguments,
                COMMANDS[i].help);
    fprintf(out, "\nEach command says more with --help.\n");
}

int main(int argc, char **argv)
{
    const char *name = argc > 1 ? argv[1] : "";
    if (strcmp(name, "--version") == 0) {
        printf("pathfarm %s\n", PATHFARM_VERSION);
        return 0;
    }
    if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0 || strcmp(name, "help") == 0) {
        print_help(stdout);
        return 0;
    }
    for (size_t i = 0; i < sizeof(COMMANDS) / sizeof(COMMANDS[0]); i++) {
        if (strcmp(name, COMMANDS[i].name) == 0)
            return COMMANDS[i].run(argc - 1, argv + 1);
    }
    if (name[0] == '\0') {
        print_help(stderr);
        return 2;
    }
    const char *nearest = options_nearest(name, NAMES);
    fprintf(stderr, "pathfarm: there is no command \"%s\"", name);
    if (nearest != NULL)
        fprintf(stderr, "; the nearest is \"%s\"", nearest);
    fprintf(stderr, "; see pathfarm --help\n");
    return 2;
}
