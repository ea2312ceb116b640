/*
 * pathfarm-worker HOST:PORT: renders for a master until it is told to stop.
 */
#include "common/err.h"
#include "proto/cache.h"
#include "proto/channel.h"
#include "proto/keys.h"
#include "worker/journal.h"
#include "worker/profile.h"
#include "worker/renderer.h"
#include "worker/session.h"

#include <getopt.h>
#include <limits.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <uv.h>

#define THREADS_MAX 4096

static const char usage[] =
    "usage: pathfarm-worker HOST:PORT [options]\n"
    "\n"
    "Connects to a pathfarm master, renders what it leases out, and comes back when the\n"
    "connection is lost. SIGTERM hands back what was not begun, finishes the rest, and ends;\n"
    "a second one ends at once.\n"
    "\n"
    "  --threads N          render threads (one per core this process may use)\n"
    "  --keys DIR           keys from \"pathfarm keygen\"; without them the master must be on\n"
    "                       this host\n"
    "  --cache DIR          where scenes are kept ($XDG_CACHE_HOME/pathfarm or\n"
    "                       ~/.cache/pathfarm)\n"
    "  --no-cache           keep none\n"
    "  --cache-quota BYTES  what the cache may take (16G)\n"
    "  --max-memory BYTES   what this process may take (what is free)\n"
    "  --outbox N           results held until the master has them safe (4096)\n"
    "  --renderer NAME      embree, or simulated: noise without rays, for tests of a farm\n"
    "  --once               end with the first connection instead of reconnecting\n"
    "  --verbose            say more\n"
    "  --version, --help\n"
    "\n"
    "BYTES may end in K, M, G or T. Exit status: 0 after a goodbye or SIGTERM, 1 when a\n"
    "connection failed with --once, 2 when the arguments are wrong.\n";

struct arguments {
    struct session_options session;
    char host[256];
    const char *keys_dir;
    char cache_dir[PATH_MAX];
    bool no_cache, verbose;
};

static bool parse_number(const char *text, uint64_t min, uint64_t max, uint64_t *number)
{
    char *end;
    if (text[0] < '0' || text[0] > '9')
        return false;
    unsigned long long value = strtoull(text, &end, 10);
    if (*end != '\0' || value < min || value > max)
        return false;
    *number = value;
    return true;
}

static bool parse_bytes(const char *text, uint64_t *bytes)
{
    static const char suffixes[] = "KMGT";
    char digits[32];
    size_t length = strlen(text);
    const char *suffix = length > 0 ? strchr(suffixes, text[length - 1]) : NULL;
    unsigned shift = suffix != NULL ? 10 * (unsigned)(suffix - suffixes + 1) : 0;
    if (suffix != NULL)
        length--;
    if (length >= sizeof(digits))
        return false;
    memcpy(digits, text, length);
    digits[length] = '\0';
    if (!parse_number(digits, 1, UINT64_MAX >> shift, bytes))
        return false;
    *bytes <<= shift;
    return true;
}

static unsigned usable_cores(void)
{
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof(set), &set) == 0)
        return (unsigned)CPU_COUNT(&set);
    long cores = sysconf(_SC_NPROCESSORS_ONLN); /* more than a cpu_set_t has room for */
    return cores < 1 ? 1 : cores > THREADS_MAX ? THREADS_MAX : (unsigned)cores;
}

static const struct renderer_class *renderer_named(const char *name)
{
    static const struct renderer_class *const classes[] = { &renderer_embree, &renderer_simulated };
    for (size_t i = 0; i < sizeof(classes) / sizeof(classes[0]); i++)
        if (strcmp(classes[i]->name, name) == 0)
            return classes[i];
    return NULL;
}

enum {
    THREADS = 1,
    KEYS,
    CACHE,
    NO_CACHE,
    CACHE_QUOTA,
    MAX_MEMORY,
    OUTBOX,
    RENDERER,
    ONCE,
    VERBOSE,
    VERSION,
    HELP
};

static const struct option long_options[] = {
    { "threads", required_argument, NULL, THREADS },
    { "keys", required_argument, NULL, KEYS },
    { "cache", required_argument, NULL, CACHE },
    { "no-cache", no_argument, NULL, NO_CACHE },
    { "cache-quota", required_argument, NULL, CACHE_QUOTA },
    { "max-memory", required_argument, NULL, MAX_MEMORY },
    { "outbox", required_argument, NULL, OUTBOX },
    { "renderer", required_argument, NULL, RENDERER },
    { "once", no_argument, NULL, ONCE },
    { "verbose", no_argument, NULL, VERBOSE },
    { "version", no_argument, NULL, VERSION },
    { "help", no_argument, NULL, HELP },
    { NULL, 0, NULL, 0 },
};

/* One option; false when its argument is wrong. */
static bool take_option(struct arguments *arguments, int option, const char *value)
{
    struct session_options *session = &arguments->session;
    uint64_t number;
    switch (option) {
    case THREADS:
        if (!parse_number(value, 1, THREADS_MAX, &number))
            return false;
        session->threads = (unsigned)number;
        return true;
    case KEYS:
        arguments->keys_dir = value;
        return true;
    case CACHE:
        arguments->no_cache = false;
        return value[0] != '\0' &&
               (size_t)snprintf(arguments->cache_dir, sizeof(arguments->cache_dir), "%s", value) <
                   sizeof(arguments->cache_dir);
    case NO_CACHE:
        arguments->no_cache = true;
        return true;
    case CACHE_QUOTA:
        return parse_bytes(value, &session->cache_quota);
    case MAX_MEMORY:
        return parse_bytes(value, &session->max_memory);
    case OUTBOX:
        if (!parse_number(value, 1, 1u << 24, &number))
            return false;
        session->outbox_results = number;
        return true;
    case RENDERER:
        return (session->renderer = renderer_named(value)) != NULL;
    case ONCE:
        session->once = true;
        return true;
    case VERBOSE:
        arguments->verbose = true;
        return true;
    case VERSION:
        printf("pathfarm-worker %s\n", PATHFARM_VERSION);
        exit(0);
    default:
        fputs(usage, stdout);
        exit(0);
    }
}

/* False after saying what is wrong. */
static bool parse_arguments(struct arguments *arguments, int argc, char **argv)
{
    struct err err;
    int option, index = 0;
    while ((option = getopt_long(argc, argv, "", long_options, &index)) != -1) {
        if (option == '?')
            return false; /* getopt_long has said what */
        if (!take_option(arguments, option, optarg)) {
            journal_say(JOURNAL_PROBLEM, "--%s: \"%s\" will not do", long_options[index].name,
                        optarg);
            return false;
        }
    }
    if (optind + 1 != argc) {
        journal_say(JOURNAL_PROBLEM, "one argument is wanted, the master's HOST:PORT; see --help");
        return false;
    }
    if (!channel_parse_address(argv[optind], arguments->host, sizeof(arguments->host),
                               &arguments->session.port, &err)) {
        journal_say(JOURNAL_PROBLEM, "%s", err.text);
        return false;
    }
    arguments->session.host = arguments->host;
    return true;
}

struct worker {
    struct session *session;
    uv_signal_t terminate, interrupt;
    bool stopping;
    int status;
};

static void on_signal(uv_signal_t *signal, int number)
{
    struct worker *worker = signal->data;
    if (worker->stopping)
        _exit(128 + number); /* asked twice: whoever asks does not want to wait */
    worker->stopping = true;
    session_drain(worker->session);
}

static void on_end(void *owner, int status)
{
    struct worker *worker = owner;
    worker->status = status;
    uv_close((uv_handle_t *)&worker->terminate, NULL);
    uv_close((uv_handle_t *)&worker->interrupt, NULL);
}

static int run(const struct session_options *options)
{
    uv_loop_t loop;
    struct worker worker = { 0 };
    struct err err;
    int status = uv_loop_init(&loop);
    if (status != 0) {
        journal_say(JOURNAL_PROBLEM, "event loop: %s", uv_strerror(status));
        return 1;
    }
    worker.session = session_new(&loop, options, on_end, &worker, &err);
    if (worker.session == NULL) {
        journal_say(JOURNAL_PROBLEM, "%s", err.text);
        return 1;
    }
    uv_signal_init(&loop, &worker.terminate);
    uv_signal_init(&loop, &worker.interrupt);
    worker.terminate.data = worker.interrupt.data = &worker;
    uv_signal_start(&worker.terminate, on_signal, SIGTERM);
    uv_signal_start(&worker.interrupt, on_signal, SIGINT);
    uv_run(&loop, UV_RUN_DEFAULT);
    session_free(worker.session);
    uv_loop_close(&loop);
    return worker.status;
}

int main(int argc, char **argv)
{
    struct arguments arguments = { .session = session_options_default() };
    struct session_options *session = &arguments.session;
    struct profile profile;
    struct keys *keys = NULL;
    struct err err;

    session->threads = usable_cores();
    session->renderer = &renderer_embree;
    if (!parse_arguments(&arguments, argc, argv))
        return 2;
    enum journal_level level = session->once ? JOURNAL_PROBLEM : JOURNAL_NEWS;
    journal_open(arguments.verbose ? JOURNAL_DETAIL : level, NULL);
    if (arguments.keys_dir != NULL &&
        (keys = keys_load(arguments.keys_dir, ROLE_WORKER, &err)) == NULL) {
        journal_say(JOURNAL_PROBLEM, "%s", err.text);
        return 2;
    }
    session->keys = keys;

    char *cache_dir = arguments.cache_dir;
    if (!arguments.no_cache &&
        (cache_dir[0] != '\0' || cache_default_dir(cache_dir, sizeof(arguments.cache_dir))))
        session->cache_dir = cache_dir;

    if (!profile_take(session->renderer, &profile, &err)) {
        journal_say(JOURNAL_PROBLEM, "%s", err.text);
        keys_free(keys);
        return 1;
    }
    session->profile = &profile;
    journal_say(JOURNAL_DETAIL, "%u threads, numeric profile \"%s\"", session->threads,
                profile.text);
    int status = run(session);
    keys_free(keys);
    return status;
}
