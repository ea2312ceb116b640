#include "master/cmd_accuracy.h"

#include "common/err.h"
#include "common/scene.h"
#include "master/accuracy_csv.h"
#include "master/accuracy_page.h"
#include "master/accuracy_peers.h"
#include "master/accuracy_run.h"
#include "master/atomic_file.h"
#include "master/job_setup.h"
#include "master/options.h"

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#define SIDE        128 /* the longer one, unless --resolution says more */
#define QUICK_SIDE  32
#define SEEDS       4
#define QUICK_SEEDS 2
#define CORE_S      2
#define QUICK_CORE  0.1
#define MULTIPLE    16
#define RENDER_MAX  24 /* arguments of render */

struct options {
    const char *scene, *folder, *configs, *reference;
    double core_s; /* 0: the default */
    unsigned seeds, multiple;
    bool quick;
    struct accuracy_peers peers;

    /* What goes on to every render, and to the reading of the scene here */
    const char *render[RENDER_MAX + 1];
    size_t render_count;
    bool sized; /* --resolution is among them */
};

static void usage(FILE *out)
{
    fputs("Usage: pathfarm accuracy SCENE [-o DIR] [OPTIONS]\n"
          "\n"
          "Renders the scene in many ways at equal core-seconds, measures each against an\n"
          "independent reference, and writes DIR/accuracy.html, accuracy.svg and accuracy.csv.\n"
          "\n"
          "  -o DIR              where to (.)\n"
          "  --configs NAME,...  which ways (all); the default is always among them:\n",
          out);
    for (size_t i = 0; i < accuracy_setup_count; i++)
        fprintf(out, "                        %-18s %s\n", accuracy_setup_table[i].name,
                accuracy_setup_table[i].what);
    fprintf(out,
            "  --core-seconds S    processor time of the longest render of each (%d)\n"
            "  --seeds N           pictures at each number of samples (%d)\n"
            "  --reference FILE    an EXR of the same size, with another seed; without it one is\n"
            "                      rendered\n"
            "  --multiple N        samples of that one, in those of the longest render (%d)\n"
            "  --peer NAME=S,E     another renderer's core-seconds and relMSE; several add up\n"
            "  --peers FILE.csv    the same, a line each: NAME,core_seconds,relmse\n"
            "  --quick             small, and seconds: to see that it works\n"
            "  --resolution WxH    of the pictures (the longer side %d)\n"
            "  --max-depth N, --camera NAME, --lenient, --workers N, --threads N\n"
            "                      as of pathfarm render, for all pictures\n"
            "\n"
            "Exit status: 0 done, 1 a render failed, 2 the arguments or the scene are wrong.\n",
            CORE_S, SEEDS, MULTIPLE, SIDE);
}

/* ---- options */

static bool parse_whole(const char *name, const char *text, unsigned low, unsigned high,
                        unsigned *out, struct err *err)
{
    char *end;
    unsigned long value = strtoul(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || *end != '\0' || value < low || value > high)
        return err_set(err, ERR_ARGUMENT, "--%s: \"%s\" is not a whole number from %u to %u", name,
                       text, low, high);
    *out = (unsigned)value;
    return true;
}

static bool parse_core_s(const char *text, double *out, struct err *err)
{
    char *end;
    *out = strtod(text, &end);
    if (end == text || *end != '\0' || !(*out > 0 && *out < 1e6))
        return err_set(err, ERR_ARGUMENT, "--core-seconds: \"%s\" is not a number above 0", text);
    return true;
}

/* An option of render: to be checked where it is used */
static bool hand_on(struct options *o, const char *name, const char *value, struct err *err)
{
    if (o->render_count + 2 > RENDER_MAX)
        return err_set(err, ERR_ARGUMENT, "too many options");
    o->render[o->render_count++] = name;
    if (value != NULL)
        o->render[o->render_count++] = value;
    return true;
}

static bool parse_options(int argc, char **argv, struct options *o, bool *help, struct err *err)
{
    enum {
        CONFIGS,
        CORES,
        SEED_COUNT,
        REFERENCE,
        TIMES,
        PEER,
        PEERS,
        QUICK,
        RESOLUTION,
        DEPTH,
        CAMERA,
        LENIENT,
        WORKERS,
        THREADS
    };
    static const struct option known[] = {
        { "configs", required_argument, NULL, CONFIGS },
        { "core-seconds", required_argument, NULL, CORES },
        { "seeds", required_argument, NULL, SEED_COUNT },
        { "reference", required_argument, NULL, REFERENCE },
        { "multiple", required_argument, NULL, TIMES },
        { "peer", required_argument, NULL, PEER },
        { "peers", required_argument, NULL, PEERS },
        { "quick", no_argument, NULL, QUICK },
        { "resolution", required_argument, NULL, RESOLUTION },
        { "max-depth", required_argument, NULL, DEPTH },
        { "camera", required_argument, NULL, CAMERA },
        { "lenient", no_argument, NULL, LENIENT },
        { "workers", required_argument, NULL, WORKERS },
        { "threads", required_argument, NULL, THREADS },
        { "help", no_argument, NULL, 'h' },
        { 0 },
    };
    *o = (struct options){ .folder = ".", .multiple = MULTIPLE };
    optind = 1;
    bool fine = true;
    for (int option; fine && (option = getopt_long(argc, argv, "ho:", known, NULL)) != -1;) {
        switch (option) {
        case 'o':
            o->folder = optarg;
            break;
        case CONFIGS:
            o->configs = optarg;
            break;
        case CORES:
            fine = parse_core_s(optarg, &o->core_s, err);
            break;
        case SEED_COUNT:
            fine = parse_whole("seeds", optarg, 2, ACCURACY_SEEDS_MAX, &o->seeds, err);
            break;
        case REFERENCE:
            o->reference = optarg;
            break;
        case TIMES:
            fine = parse_whole("multiple", optarg, 1, 4096, &o->multiple, err);
            break;
        case PEER:
            fine = accuracy_peers_add(&o->peers, optarg, err) || err_wrap(err, "--peer");
            break;
        case PEERS:
            fine = accuracy_peers_read(&o->peers, optarg, err) || err_wrap(err, "--peers");
            break;
        case QUICK:
            o->quick = true;
            break;
        case RESOLUTION:
            o->sized = true;
            fine = hand_on(o, "--resolution", optarg, err);
            break;
        case DEPTH:
            fine = hand_on(o, "--max-depth", optarg, err);
            break;
        case CAMERA:
            fine = hand_on(o, "--camera", optarg, err);
            break;
        case LENIENT:
            fine = hand_on(o, "--lenient", NULL, err);
            break;
        case WORKERS:
            fine = hand_on(o, "--workers", optarg, err);
            break;
        case THREADS:
            fine = hand_on(o, "--threads", optarg, err);
            break;
        case 'h':
            *help = true;
            return true;
        default: /* getopt has said what is wrong */
            return err_set(err, ERR_ARGUMENT, "see pathfarm accuracy --help");
        }
    }
    if (!fine)
        return false;
    if (argc - optind != 1)
        return err_set(err, ERR_ARGUMENT, "one scene is needed; see pathfarm accuracy --help");
    o->scene = argv[optind];
    if (o->seeds == 0)
        o->seeds = o->quick ? QUICK_SEEDS : SEEDS;
    if (o->core_s == 0)
        o->core_s = o->quick ? QUICK_CORE : CORE_S;
    return true;
}

/* ---- the scene */

/* As the renders will read it; their arguments are checked on the way */
static bool read_scene(const struct options *o, struct job_setup *setup, struct err *err)
{
    char *argv[RENDER_MAX + 3] = { (char *)"render" };
    int argc = 1;
    for (size_t i = 0; i < o->render_count; i++)
        argv[argc++] = (char *)(uintptr_t)o->render[i];
    argv[argc++] = (char *)(uintptr_t)o->scene;
    struct render_options options;
    return options_parse(argc, argv, false, &options, err) == OPTIONS_GO &&
           job_setup_open(&options, setup, err);
}

/* A size at which many pictures are made soon, in the shape that the scene asks for. The text must
 * live as long as the options. */
static bool choose_size(struct options *o, const struct scene *scene, char *text, size_t size,
                        struct err *err)
{
    const struct scene_settings *s = &scene->settings;
    const uint32_t longer = s->width > s->height ? s->width : s->height;
    const double side = o->quick ? QUICK_SIDE : SIDE;
    const double scale = fmin(side / longer, 1);
    snprintf(text, size, "%.0fx%.0f", fmax(round(s->width * scale), 1),
             fmax(round(s->height * scale), 1));
    return hand_on(o, "--resolution", text, err);
}

/* ---- what is left behind */

static bool write_stream(const char *path, const struct accuracy_study *study,
                         const struct accuracy_peers *peers,
                         void (*write)(const struct accuracy_study *, const struct accuracy_peers *,
                                       FILE *),
                         struct err *err)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (out == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %s", path);
    write(study, peers, out);
    bool whole = !ferror(out);
    if (fclose(out) != 0 || !whole) {
        free(text);
        return err_set(err, ERR_MEMORY, "no memory for %s", path);
    }
    bool written = atomic_file_write(path, text, size, err);
    free(text);
    return written;
}

static bool write_all(const struct options *o, const struct accuracy_study *study,
                      const char *command, struct err *err)
{
    const struct accuracy_facts facts = { o->scene, command, o->core_s };
    char path[4096 + 32];
    snprintf(path, sizeof(path), "%s/accuracy.csv", o->folder);
    if (!write_stream(path, study, &o->peers, accuracy_csv_write, err))
        return false;
    snprintf(path, sizeof(path), "%s/accuracy.svg", o->folder);
    if (!write_stream(path, study, &o->peers, accuracy_page_plot, err))
        return false;
    snprintf(path, sizeof(path), "%s/accuracy.html", o->folder);
    if (!accuracy_page_write(study, &o->peers, &facts, path, err))
        return false;
    fprintf(stderr, "%s\n", path);
    return true;
}

static bool make_folder(const char *folder, struct err *err)
{
    if (strlen(folder) > 4096)
        return err_set(err, ERR_ARGUMENT, "-o: the name is too long");
    if (mkdir(folder, 0777) == 0 || errno == EEXIST)
        return true;
    return err_set(err, ERR_ARGUMENT, "%s: %s", folder, strerror(errno));
}

/* "pathfarm accuracy ..." again; the caller's to free */
static char *command_text(int argc, char **argv)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (out == NULL)
        return NULL;
    fputs("pathfarm", out);
    for (int i = 0; i < argc; i++)
        fprintf(out, " %s", argv[i]);
    return fclose(out) == 0 ? text : NULL;
}

/* Everything after the options. 0, 1 or 2; but for 0, err says why. */
static int run(struct options *o, const char *command, struct err *err)
{
    static const uint64_t CROPS[2][ACCURACY_CROPS_MAX] = { { 1, 4, 64, 1024 }, { 1, 4, 64 } };
    const struct accuracy_setup *setups[ACCURACY_SETUPS_MAX];
    size_t setup_count;
    struct job_setup setup;
    struct accuracy_study study;
    char size[48];
    int status = 2;
    if (!accuracy_setup_choose(o->configs, setups, &setup_count, err) ||
        !read_scene(o, &setup, err))
        return status;
    if (!make_folder(o->folder, err) ||
        (!o->sized && !choose_size(o, setup.scene, size, sizeof(size), err)))
        goto done;

    const char *arguments[RENDER_MAX + 2] = { o->scene };
    memcpy(arguments + 1, o->render, o->render_count * sizeof(arguments[0]));
    const struct accuracy_plan plan = {
        .arguments = arguments,
        .scene = setup.scene,
        .setups = setups,
        .setup_count = setup_count,
        .seeds = o->seeds,
        .core_s = o->core_s,
        .multiple = o->multiple,
        .reference_path = o->reference,
        .crop_spp = CROPS[o->quick],
    };
    if (accuracy_run(&plan, &study, err)) {
        status = write_all(o, &study, command, err) ? 0 : 1;
        accuracy_run_free(&study);
    } else if (err->code != ERR_ARGUMENT) {
        status = 1;
    }

done:
    job_setup_close(&setup);
    return status;
}

int cmd_accuracy(int argc, char **argv)
{
    struct options options;
    struct err err = { 0 };
    bool help = false;
    int status = 2;
    char *command = command_text(argc, argv); /* before getopt moves words about */
    if (command == NULL)
        err_set(&err, ERR_MEMORY, "no memory");
    else if (parse_options(argc, argv, &options, &help, &err))
        status = help ? 0 : run(&options, command, &err);
    if (help)
        usage(stdout);
    if (status != 0)
        fprintf(stderr, "pathfarm accuracy: %s\n", err.text);
    free(command);
    return status;
}
