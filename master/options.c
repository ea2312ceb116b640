#include "master/options.h"

#include "common/aov.h"
#include "common/err.h"
#include "common/scene.h"
#include "common/sumtree.h"
#include "proto/channel.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- values */

static bool parse_count(const char *text, uint64_t low, uint64_t high, uint64_t *out,
                        struct err *err)
{
    char *end;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || *end != '\0' || errno != 0 || value < low || value > high)
        return err_set(err, ERR_ARGUMENT, "\"%s\" is not a whole number from %llu to %llu", text,
                       (unsigned long long)low, (unsigned long long)high);
    *out = value;
    return true;
}

static bool parse_u32(const char *text, uint32_t low, uint32_t high, uint32_t *out, struct err *err)
{
    uint64_t value;
    if (!parse_count(text, low, high, &value, err))
        return false;
    *out = (uint32_t)value;
    return true;
}

/* "90", "90s", "1.5m", "2h" in seconds. */
static bool parse_seconds(const char *text, double *out, struct err *err)
{
    char *end;
    double value = strtod(text, &end);
    double unit = *end == '\0' || strcmp(end, "s") == 0 ? 1
                  : strcmp(end, "m") == 0               ? 60
                  : strcmp(end, "h") == 0               ? 3600
                                                        : 0;
    if (end == text || unit == 0 || !isfinite(value) || value <= 0 || value * unit > 1e9)
        return err_set(err, ERR_ARGUMENT, "\"%s\" is not a time like 90, 90s, 1.5m or 2h", text);
    *out = value * unit;
    return true;
}

static bool parse_numbers(const char *text, const char *between, double *numbers, unsigned count,
                          const char *like, struct err *err)
{
    const char *at = text;
    for (unsigned i = 0; i < count; i++) {
        char *end;
        numbers[i] = strtod(at, &end);
        bool last = i + 1 == count;
        if (end == at || !isfinite(numbers[i]) ||
            (last ? *end != '\0' : *end == '\0' || strchr(between, *end) == NULL))
            return err_set(err, ERR_ARGUMENT, "\"%s\" is not of the form %s", text, like);
        at = end + 1;
    }
    return true;
}

/* ---- options: a parser each; `value` is NULL for those that take none */

#define PARSER(name) \
    static bool set_##name(struct render_options *o, const char *value, struct err *err)
#define COUNT_PARSER(name, field, low, high)                    \
    PARSER(name)                                                \
    {                                                           \
        return parse_u32(value, (low), (high), &o->field, err); \
    }
#define TEXT_PARSER(name, field) \
    PARSER(name)                 \
    {                            \
        (void)err;               \
        o->field = value;        \
        return true;             \
    }
#define FLAG_PARSER(name, field) \
    PARSER(name)                 \
    {                            \
        (void)value;             \
        (void)err;               \
        o->field = true;         \
        return true;             \
    }

PARSER(resolution)
{
    double size[2];
    if (!parse_numbers(value, "xX", size, 2, "WIDTHxHEIGHT, as in 1920x1080", err))
        return false;
    for (int i = 0; i < 2; i++) {
        if (size[i] < 1 || size[i] > 65536 || size[i] != floor(size[i]))
            return err_set(err, ERR_ARGUMENT, "\"%s\": sides are whole numbers from 1 to 65536",
                           value);
    }
    o->width = (uint32_t)size[0];
    o->height = (uint32_t)size[1];
    return true;
}

PARSER(crop)
{
    if (!parse_numbers(value, ",", o->crop, 4, "x0,x1,y0,y1", err))
        return false;
    for (int i = 0; i < 4; i++) {
        if (o->crop[i] < 0)
            return err_set(err, ERR_ARGUMENT, "\"%s\": a crop window begins at 0", value);
    }
    if (o->crop[0] >= o->crop[1] || o->crop[2] >= o->crop[3])
        return err_set(err, ERR_ARGUMENT, "\"%s\" is an empty crop window", value);
    o->has_crop = true;
    return true;
}

PARSER(spp)
{
    return parse_count(value, 1, (uint64_t)1 << 40, &o->spp, err);
}

PARSER(time)
{
    return parse_seconds(value, &o->time_s, err);
}

/* A number above zero that is not absurd. */
static bool parse_positive(const char *text, double most, double *out, struct err *err)
{
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value > 0 && value <= most))
        return err_set(err, ERR_ARGUMENT, "\"%s\" is not a number above 0, up to %g", text, most);
    *out = value;
    return true;
}

PARSER(error)
{
    return parse_positive(value, 1e6, &o->relmse, err);
}

PARSER(budget_core_hours)
{
    return parse_positive(value, 1e9, &o->core_hours, err);
}

PARSER(seed)
{
    return parse_count(value, 0, UINT64_MAX, &o->seed, err);
}

PARSER(sampler)
{
    static const char *const NAMES[] = {
#define X(name, number, text) text,
        SAMPLER_MAP(X)
#undef X
            NULL
    };
    static const int KINDS[] = {
#define X(name, number, text) number,
        SAMPLER_MAP(X)
#undef X
    };
    for (int i = 0; NAMES[i] != NULL; i++) {
        if (strcmp(value, NAMES[i]) == 0) {
            o->sampler = KINDS[i];
            return true;
        }
    }
    const char *nearest = options_nearest(value, NAMES);
    return err_set(err, ERR_ARGUMENT, "there is no sampler \"%s\"; %s%s", value,
                   nearest == NULL ? "there are sobol, independent, stratified, halton, hammersley"
                                   : "the nearest is ",
                   nearest == NULL ? "" : nearest);
}

PARSER(max_depth)
{
    o->has_max_depth = true;
    return parse_u32(value, 0, 65536, &o->max_depth, err);
}

PARSER(listen)
{
    o->listens = true;
    return channel_parse_address(value, o->listen_host, sizeof(o->listen_host), &o->listen_port,
                                 err);
}

PARSER(tev)
{
    o->has_tev = true;
    return channel_parse_address(value, o->tev_host, sizeof(o->tev_host), &o->tev_port, err);
}

PARSER(png)
{
    if (strlen(value) >= sizeof(o->png))
        return err_set(err, ERR_ARGUMENT, "the name is too long");
    memcpy(o->png, value, strlen(value) + 1);
    return true;
}

PARSER(write_every)
{
    return parse_seconds(value, &o->write_every_s, err);
}

/* "NAME,..."; several options add up */
PARSER(aov)
{
    static const char *const NAMES[] = {
#define X(name, bit, text, channels) [bit] = text,
        AOV_MAP(X)
#undef X
            NULL
    };
    for (const char *at = value; at != NULL;) {
        char name[32];
        const char *comma = strchr(at, ',');
        size_t length = comma == NULL ? strlen(at) : (size_t)(comma - at);
        snprintf(name, sizeof(name), "%.*s", (int)length, at);
        at = comma == NULL ? NULL : comma + 1;

        unsigned aov = 0;
        while (aov < AOV_COUNT && strcmp(name, NAMES[aov]) != 0)
            aov++;
        if (aov < AOV_COUNT) {
            o->aovs |= 1u << aov;
            continue;
        }
        const char *nearest = options_nearest(name, NAMES);
        return err_set(err, ERR_ARGUMENT, "there is no layer \"%s\"; %s%s", name,
                       nearest == NULL ? "there are alpha, depth, position, normal, "
                                         "geometric_normal, albedo, motion, object, material"
                                       : "the nearest is ",
                       nearest == NULL ? "" : nearest);
    }
    return true;
}

PARSER(exr_type)
{
    if (strcmp(value, "float") != 0 && strcmp(value, "half") != 0)
        return err_set(err, ERR_ARGUMENT, "\"%s\" is neither float nor half", value);
    o->exr.half = value[0] == 'h';
    return true;
}

PARSER(exr_compression)
{
#define X(name, number, text)                \
    if (strcmp(value, text) == 0) {          \
        o->exr.packing = EXR_PACKING_##name; \
        return true;                         \
    }
    EXR_PACKING_MAP(X)
#undef X
    return err_set(err, ERR_ARGUMENT, "\"%s\" is none of zip, zips, piz, rle, none", value);
}

PARSER(kernel)
{
    if (strcmp(value, "auto") != 0 && strcmp(value, "everything") != 0)
        return err_set(err, ERR_ARGUMENT, "\"%s\" is neither auto nor everything", value);
    o->everything = value[0] == 'e';
    return true;
}

PARSER(lease_nodes)
{
    double range[2];
    if (!parse_numbers(value, ",:", range, 2, "MIN,MAX", err))
        return false;
    if (range[0] < 1 || range[0] > range[1] || range[1] > 1e15)
        return err_set(err, ERR_ARGUMENT, "\"%s\": 1 <= MIN <= MAX <= 1e15 is wanted", value);
    o->lease_leaves_min = (uint64_t)range[0];
    o->lease_leaves_max = (uint64_t)range[1];
    return true;
}

PARSER(not_yet)
{
    (void)o;
    (void)value;
    return err_set(err, ERR_UNSUPPORTED, "not supported yet");
}

TEXT_PARSER(output, output)
TEXT_PARSER(camera, camera)
TEXT_PARSER(report, report)
TEXT_PARSER(ledger, ledger)
TEXT_PARSER(heat, heat)
TEXT_PARSER(keys, keys)
TEXT_PARSER(cache, cache)
FLAG_PARSER(adaptive, adaptive)
FLAG_PARSER(no_cache, no_cache)
FLAG_PARSER(lenient, lenient)
FLAG_PARSER(quiet, quiet)
FLAG_PARSER(verbose, verbose)
COUNT_PARSER(workers, workers, 0, 1024)
COUNT_PARSER(threads, threads, 1, 4096)
COUNT_PARSER(replicates, replicates, 1, 256)
COUNT_PARSER(lanes, lanes, 1, 8)
COUNT_PARSER(lease_ms, lease_ms, 1, 3600000)
COUNT_PARSER(leases_in_flight, leases_in_flight, 1, 64)
COUNT_PARSER(heartbeat_ms, heartbeat_ms, 10, 600000)
COUNT_PARSER(dead_after_ms, dead_after_ms, 100, 86400000)
COUNT_PARSER(stall_ms, stall_ms, 100, 86400000)

static const struct option {
    const char *name, *argument; /* NULL: takes none */
    bool (*parse)(struct render_options *o, const char *value, struct err *err);
    const char *help; /* NULL: not listed */
} OPTIONS[] = {
    { "-o", "OUT.exr", set_output, "the picture; a PNG of the same name goes beside it" },
    { "--png", "FILE", set_png, "write the PNG there instead" },
    { "--resolution", "WxH", set_resolution, "size of the full picture" },
    { "--crop", "X0,X1,Y0,Y1", set_crop,
      "render a part: fractions if all four are at most 1, else pixels" },
    { "--camera", "NAME", set_camera, "which camera of a glTF file (the first)" },
    { "--spp", "N", set_spp, "samples per pixel, rounded up to a whole round" },
    { "--error", "X", set_error, "until the estimated relMSE of the picture is at most X" },
    { "--time", "T", set_time, "as many rounds as fit into T (90, 90s, 1.5m, 2h)" },
    { "--budget-core-hours", "H", set_budget_core_hours,
      "as many rounds as cost at most H hours of one core; of several limits the first ends it" },
    { "--adaptive", NULL, set_adaptive,
      "a pilot decides which tiles get more of the samples, and which fewer" },
    { "--seed", "N", set_seed, "another seed gives an independent picture (0)" },
    { "--sampler", "NAME", set_sampler, "sobol, independent, stratified, halton or hammersley" },
    { "--replicates", "K", set_replicates,
      "independent sample sequences, from which the error is told (4)" },
    { "--max-depth", "N", set_max_depth, "cut paths after N scattering events; counted" },
    { "--workers", "N", set_workers, "local worker processes (1); 0 needs --listen" },
    { "--threads", "N", set_threads, "render threads of each (all cores / workers)" },
    { "--listen", "ADDR:PORT", set_listen, "let workers of other machines join, at any time" },
    { "--keys", "DIR", set_keys, "the farm's keys, from `pathfarm keygen`" },
    { "--cache", "DIR", set_cache, "where local workers keep scenes" },
    { "--no-cache", NULL, set_no_cache, "local workers keep no scenes" },
    { "--report", "FILE", set_report, "what was done, as JSON" },
    { "--ledger", "FILE.csv", set_ledger, "what every round cost, and how wrong it was" },
    { "--heat", "FILE.png", set_heat, "the relative standard error of every pixel, in colours" },
    { "--write-every", "T", set_write_every, "refresh all but the report while rendering" },
    { "--tev", "HOST:PORT", set_tev, "show the picture in a tev viewer while rendering" },
    { "--aov", "NAME,...", set_aov,
      "more layers: alpha, depth, position, normal, geometric_normal, albedo, motion, object, "
      "material" },
    { "--exr-type", "half|float", set_exr_type,
      "half: 16 bits, but for positions, depths, motions and ids (float)" },
    { "--exr-compression", "NAME", set_exr_compression, "zip (default), zips, piz, rle or none" },
    { "--lenient", NULL, set_lenient, "warn about what the scene asks for in vain" },
    { "--quiet", NULL, set_quiet, "no progress" },
    { "--verbose", NULL, set_verbose, "what workers do" },
    { "--kernel", "auto|everything", set_kernel, "the kernel variant (auto); same bits" },
    { "--lanes", "1..8", set_lanes, "active lanes of the kernel (8); same bits" },
    { "--lease-ms", "MS", set_lease_ms, "work that is handed out at once (1000)" },
    { "--lease-nodes", "MIN,MAX", set_lease_nodes, "the same in leaves, whatever the speed" },
    { "--leases-in-flight", "N", set_leases_in_flight, "leases a worker has at once (3)" },
    { "--heartbeat-ms", "MS", set_heartbeat_ms, "how often either side says something (1000)" },
    { "--dead-after-ms", "MS", set_dead_after_ms, "silence after which it is gone (20000)" },
    { "--stall-ms", "MS", set_stall_ms,
      "time without progress after which its work is given to others (30000)" },
    { "--paths", "EXPR", set_not_yet, NULL },
    { "--integrator", "NAME", set_not_yet, NULL },
    { "--store", "FILE", set_not_yet, NULL },
};
#define OPTION_COUNT (sizeof(OPTIONS) / sizeof(OPTIONS[0]))

void options_help(void)
{
    for (size_t i = 0; i < OPTION_COUNT; i++) {
        char left[64];
        if (OPTIONS[i].help == NULL)
            continue;
        snprintf(left, sizeof(left), "%s %s", OPTIONS[i].name,
                 OPTIONS[i].argument == NULL ? "" : OPTIONS[i].argument);
        printf("  %-26s %s\n", left, OPTIONS[i].help);
    }
}

/* Letters to change, add, drop or swap to make one of the other; large for long texts. */
static size_t distance(const char *a, const char *b)
{
    enum { LONGEST = 40 };
    size_t rows = strlen(a), columns = strlen(b);
    size_t table[LONGEST + 1][LONGEST + 1];
    if (rows > LONGEST || columns > LONGEST)
        return SIZE_MAX;
    for (size_t i = 0; i <= rows; i++)
        table[i][0] = i;
    for (size_t j = 0; j <= columns; j++)
        table[0][j] = j;
    for (size_t i = 1; i <= rows; i++) {
        for (size_t j = 1; j <= columns; j++) {
            size_t best = table[i - 1][j - 1] + (a[i - 1] != b[j - 1]);
            size_t drop = table[i - 1][j] + 1, add = table[i][j - 1] + 1;
            best = drop < best ? drop : best;
            best = add < best ? add : best;
            if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] &&
                table[i - 2][j - 2] + 1 < best)
                best = table[i - 2][j - 2] + 1;
            table[i][j] = best;
        }
    }
    return table[rows][columns];
}

const char *options_nearest(const char *text, const char *const *names)
{
    const char *nearest = NULL;
    size_t least = strlen(text) / 2 + 1;
    for (; *names != NULL; names++) {
        size_t d = distance(text, *names);
        if (d < least) {
            least = d;
            nearest = *names;
        }
    }
    return nearest;
}

static bool unknown_option(const char *word, struct err *err)
{
    const char *names[OPTION_COUNT + 1] = { NULL };
    for (size_t i = 0; i < OPTION_COUNT; i++)
        names[i] = OPTIONS[i].name;
    const char *nearest = options_nearest(word, names);
    if (nearest == NULL)
        return err_set(err, ERR_ARGUMENT, "there is no option %s", word);
    return err_set(err, ERR_ARGUMENT, "there is no option %s; the nearest is %s", word, nearest);
}

/* "--name value" or "--name=value"; *at is moved past what was used. */
static bool parse_option(int argc, char **argv, int *at, struct render_options *out,
                         struct err *err)
{
    const char *word = argv[(*at)++];
    const char *equals = strncmp(word, "--", 2) == 0 ? strchr(word, '=') : NULL;
    size_t length = equals == NULL ? strlen(word) : (size_t)(equals - word);
    for (size_t i = 0; i < OPTION_COUNT; i++) {
        const struct option *option = &OPTIONS[i];
        if (strlen(option->name) != length || strncmp(option->name, word, length) != 0)
            continue;
        const char *value = equals == NULL ? NULL : equals + 1;
        if (option->argument == NULL && value != NULL)
            return err_set(err, ERR_ARGUMENT, "%s takes no value", option->name);
        if (option->argument != NULL && value == NULL) {
            if (*at >= argc)
                return err_set(err, ERR_ARGUMENT, "%s wants %s", option->name, option->argument);
            value = argv[(*at)++];
        }
        return option->parse(out, value, err) || err_wrap(err, "%s", option->name);
    }
    return unknown_option(word, err);
}

static bool check_together(struct render_options *o, bool needs_output, struct err *err)
{
    if (o->scene == NULL)
        return err_set(err, ERR_ARGUMENT, "which scene? pathfarm render SCENE -o OUT.exr");
    if (o->output == NULL && needs_output)
        return err_set(err, ERR_ARGUMENT, "where to? -o OUT.exr is missing");
    if (o->workers == 0 && !o->listens && needs_output)
        return err_set(err, ERR_ARGUMENT, "--workers 0 without --listen: nobody would render");
    if (o->keys != NULL && !o->listens)
        return err_set(err, ERR_ARGUMENT, "--keys without --listen: nobody to show them to");
    if (o->output != NULL && o->png[0] == '\0') {
        const char *slash = strrchr(o->output, '/');
        const char *dot = strrchr(slash == NULL ? o->output : slash, '.');
        size_t stem = dot == NULL || dot == o->output ? strlen(o->output)
                                                      : (size_t)(dot - o->output);
        if (stem + sizeof(".png") > sizeof(o->png))
            return err_set(err, ERR_ARGUMENT, "-o: the name is too long");
        snprintf(o->png, sizeof(o->png), "%.*s.png", (int)stem, o->output);
        if (strcmp(o->png, o->output) == 0)
            return err_set(err, ERR_ARGUMENT, "-o names the EXR; --png names the PNG");
    }
    return true;
}

enum options_result options_parse(int argc, char **argv, bool needs_output,
                                  struct render_options *out, struct err *err)
{
    *out = (struct render_options){ .workers = 1,
                                    .sampler = -1,
                                    .lanes = 8,
                                    .lease_leaves_min = 1,
                                    .lease_leaves_max = UINT64_MAX };
    for (int at = 1; at < argc;) {
        if (strcmp(argv[at], "--help") == 0 || strcmp(argv[at], "-h") == 0)
            return OPTIONS_HELP;
        if (argv[at][0] == '-' && argv[at][1] != '\0') {
            if (!parse_option(argc, argv, &at, out, err))
                return OPTIONS_WRONG;
        } else if (out->scene != NULL) {
            err_set(err, ERR_ARGUMENT, "two scenes: %s and %s", out->scene, argv[at]);
            return OPTIONS_WRONG;
        } else {
            out->scene = argv[at++];
        }
    }
    return check_together(out, needs_output, err) ? OPTIONS_GO : OPTIONS_WRONG;
}
