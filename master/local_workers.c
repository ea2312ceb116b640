#include "master/local_workers.h"

#include <dirent.h>
#include <errno.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#define ARGUMENTS_MAX 64
#define QUICK_DEATHS  3
#define RESTART_MS    200 /* doubled after every quick death */

struct place {
    struct local_workers *local;
    unsigned number;
    pid_t pid; /* 0: empty */
    unsigned quick_deaths;
    bool given_up;
    uv_timer_t restart;
};

struct local_workers {
    uv_loop_t *loop;
    struct local_settings settings;
    struct local_events events;
    void *owner;
    char program[4096];
    char *extra; /* $PATHFARM_WORKER_ARGS, cut into words */
    char *arguments[ARGUMENTS_MAX];
    char port_text[32], threads_text[16];
    char *cache_text;
    uv_signal_t child;
    uv_timer_t grace;
    bool stopping;
    unsigned open_handles;
    struct place places[];
};

static void say(struct local_workers *local, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
static void say(struct local_workers *local, const char *format, ...)
{
    char line[1024];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof(line), format, args);
    va_end(args);
    if (!local->stopping)
        local->events.say(local->owner, line);
}

/* ---- the command line */

static bool find_program(struct local_workers *local, struct err *err)
{
    const char *named = getenv("PATHFARM_WORKER");
    size_t size = sizeof(local->program);
    if (named != NULL && named[0] != '\0') {
        snprintf(local->program, size, "%s", named);
    } else {
        ssize_t length = readlink("/proc/self/exe", local->program, size - 1);
        if (length < 0)
            return err_set(err, ERR_IO, "cannot tell where this program is: %s", strerror(errno));
        local->program[length] = '\0';
        char *slash = strrchr(local->program, '/');
        size_t folder = (size_t)(slash + 1 - local->program);
        snprintf(slash + 1, size - folder, "pathfarm-worker");
    }
    if (access(local->program, X_OK) != 0)
        return err_set(err, ERR_IO, "%s: %s; $PATHFARM_WORKER can say where the worker is",
                       local->program, strerror(errno));
    return true;
}

static bool make_arguments(struct local_workers *local, struct err *err)
{
    const struct local_settings *s = &local->settings;
    unsigned n = 0;
    snprintf(local->port_text, sizeof(local->port_text), "127.0.0.1:%u", s->port);
    snprintf(local->threads_text, sizeof(local->threads_text), "%u", s->threads);
    local->arguments[n++] = local->program;
    local->arguments[n++] = local->port_text;
    local->arguments[n++] = "--once";
    local->arguments[n++] = "--threads";
    local->arguments[n++] = local->threads_text;
    if (s->no_cache) {
        local->arguments[n++] = "--no-cache";
    } else if (s->cache_dir != NULL) {
        local->cache_text = strdup(s->cache_dir);
        if (local->cache_text == NULL)
            return err_set(err, ERR_MEMORY, "no memory for a command line");
        local->arguments[n++] = "--cache";
        local->arguments[n++] = local->cache_text;
    }
    if (s->verbose)
        local->arguments[n++] = "--verbose";

    const char *extra = getenv("PATHFARM_WORKER_ARGS");
    if (extra == NULL)
        return true;
    local->extra = strdup(extra);
    if (local->extra == NULL)
        return err_set(err, ERR_MEMORY, "no memory for a command line");
    char *save;
    for (char *word = strtok_r(local->extra, " ", &save); word != NULL;
         word = strtok_r(NULL, " ", &save)) {
        if (n == ARGUMENTS_MAX - 1)
            return err_set(err, ERR_ARGUMENT, "PATHFARM_WORKER_ARGS has too many words");
        local->arguments[n++] = word;
    }
    return true;
}

/* ---- processes */

static void on_restart(uv_timer_t *timer);

/* fork and exec rather than uv_spawn, which has no place for the two calls before exec. */
static bool spawn(struct place *place, struct err *err)
{
    struct local_workers *local = place->local;
    pid_t parent = getpid();
    pid_t pid = fork();
    if (pid < 0)
        return err_set(err, ERR_IO, "cannot start a worker: %s", strerror(errno));
    if (pid == 0) {
        sigset_t none;
        sigemptyset(&none);
        sigprocmask(SIG_SETMASK, &none, NULL);
        /* Ctrl-C goes to the master, which lets its workers go once it has what it needs */
        setpgid(0, 0);
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (getppid() != parent)
            _exit(127); /* the master died before prctl */
        execv(local->program, local->arguments);
        _exit(127);
    }
    place->pid = pid;
    return true;
}

static int fault_of(int status)
{
    if (!WIFSIGNALED(status))
        return 0;
    switch (WTERMSIG(status)) {
    case SIGSEGV:
    case SIGBUS:
    case SIGILL:
    case SIGFPE:
    case SIGABRT:
    case SIGSYS:
        return WTERMSIG(status);
    default:
        return 0; /* somebody else's doing: killed, or out of memory */
    }
}

static void describe(int status, char *text, size_t size)
{
    if (WIFSIGNALED(status))
        snprintf(text, size, "died of signal %d (%s)", WTERMSIG(status),
                 strsignal(WTERMSIG(status)));
    else if (WEXITSTATUS(status) == 127)
        snprintf(text, size, "could not be run");
    else
        snprintf(text, size, "ended with status %d", WEXITSTATUS(status));
}

static void give_up(struct place *place, const char *how)
{
    struct local_workers *local = place->local;
    place->given_up = true;
    for (unsigned i = 0; i < local->settings.count; i++) {
        if (!local->places[i].given_up)
            return;
    }
    struct err why;
    err_set(&why, ERR_RENDER,
            "the local workers keep ending before they render anything: the last %s", how);
    local->events.on_hopeless(local->owner, &why);
}

static void on_child_gone(struct place *place, int status)
{
    struct local_workers *local = place->local;
    pid_t pid = place->pid;
    char how[128];
    place->pid = 0;
    describe(status, how, sizeof(how));
    if (local->stopping)
        return;
    place->quick_deaths = local->events.was_useful(local->owner, pid) ? 0 : place->quick_deaths + 1;
    say(local, "local worker %u (process %d) %s", place->number + 1, (int)pid, how);
    local->events.on_exit(local->owner, pid, fault_of(status));
    if (local->stopping)
        return;
    if (place->quick_deaths >= QUICK_DEATHS)
        give_up(place, how);
    else
        uv_timer_start(&place->restart, on_restart, (uint64_t)RESTART_MS << place->quick_deaths, 0);
}

static void on_restart(uv_timer_t *timer)
{
    struct place *place = timer->data;
    struct err err;
    if (!spawn(place, &err)) {
        say(place->local, "%s", err.text);
        place->quick_deaths++;
        give_up(place, err.text);
    }
}

/* ---- ending */

static void on_handle_closed(uv_handle_t *handle)
{
    struct local_workers *local = handle->data;
    if (--local->open_handles > 0)
        return;
    free(local->cache_text);
    free(local->extra);
    free(local);
}

static void on_place_closed(uv_handle_t *handle)
{
    struct place *place = handle->data;
    handle->data = place->local;
    on_handle_closed(handle);
}

static bool all_reaped(const struct local_workers *local)
{
    for (unsigned i = 0; i < local->settings.count; i++) {
        if (local->places[i].pid != 0)
            return false;
    }
    return true;
}

static void close_if_reaped(struct local_workers *local)
{
    if (!local->stopping || !all_reaped(local) || uv_is_closing((uv_handle_t *)&local->child))
        return;
    uv_close((uv_handle_t *)&local->child, on_handle_closed);
    uv_close((uv_handle_t *)&local->grace, on_handle_closed);
    for (unsigned i = 0; i < local->settings.count; i++)
        uv_close((uv_handle_t *)&local->places[i].restart, on_place_closed);
}

static void on_child_signal(uv_signal_t *handle, int number)
{
    struct local_workers *local = handle->data;
    (void)number;
    for (unsigned i = 0; i < local->settings.count; i++) {
        struct place *place = &local->places[i];
        int status;
        if (place->pid != 0 && waitpid(place->pid, &status, WNOHANG) == place->pid)
            on_child_gone(place, status);
    }
    close_if_reaped(local);
}

static void on_grace_over(uv_timer_t *timer)
{
    struct local_workers *local = timer->data;
    for (unsigned i = 0; i < local->settings.count; i++) {
        if (local->places[i].pid != 0)
            kill(local->places[i].pid, SIGKILL);
    }
}

void local_workers_stop(struct local_workers *local, unsigned grace_ms)
{
    local->stopping = true;
    for (unsigned i = 0; i < local->settings.count; i++)
        uv_timer_stop(&local->places[i].restart);
    uv_timer_start(&local->grace, on_grace_over, grace_ms, 0);
    close_if_reaped(local);
}

struct local_workers *local_workers_start(uv_loop_t *loop, const struct local_settings *settings,
                                          const struct local_events *events, void *owner,
                                          struct err *err)
{
    struct local_workers *local = calloc(1,
                                         sizeof(*local) + settings->count * sizeof(struct place));
    if (local == NULL) {
        err_set(err, ERR_MEMORY, "no memory for local workers");
        return NULL;
    }
    local->loop = loop;
    local->settings = *settings;
    local->events = *events;
    local->owner = owner;
    if (!find_program(local, err) || !make_arguments(local, err)) {
        free(local->cache_text);
        free(local->extra);
        free(local);
        return NULL;
    }

    uv_signal_init(loop, &local->child);
    uv_timer_init(loop, &local->grace);
    local->child.data = local->grace.data = local;
    local->open_handles = 2 + settings->count;
    uv_signal_start(&local->child, on_child_signal, SIGCHLD);
    bool ok = true;
    for (unsigned i = 0; i < settings->count; i++) {
        struct place *place = &local->places[i];
        place->local = local;
        place->number = i;
        uv_timer_init(loop, &place->restart);
        place->restart.data = place;
        ok = ok && spawn(place, err);
    }
    if (!ok) {
        local_workers_stop(local, 0);
        return NULL;
    }
    return local;
}

/* ---- who is it? */

/* The socket's inode, by its line in /proc/net/tcp; 0 when there is none. */
static unsigned long socket_inode(unsigned local_port, unsigned remote_port)
{
    FILE *table = fopen("/proc/net/tcp", "re");
    if (table == NULL)
        return 0;
    char line[512];
    unsigned long found = 0;
    while (found == 0 && fgets(line, sizeof(line), table) != NULL) {
        unsigned from_port, to_port;
        unsigned long inode;
        if (sscanf(line, " %*u: %*8x:%4x %*8x:%4x %*x %*x:%*x %*x:%*x %*x %*u %*u %lu", &from_port,
                   &to_port, &inode) == 3 &&
            from_port == local_port && to_port == remote_port)
            found = inode;
    }
    fclose(table);
    return found;
}

static bool holds_socket(pid_t pid, unsigned long inode)
{
    char folder[64], wanted[64];
    snprintf(folder, sizeof(folder), "/proc/%d/fd", (int)pid);
    snprintf(wanted, sizeof(wanted), "socket:[%lu]", inode);
    DIR *dir = opendir(folder);
    if (dir == NULL)
        return false;
    bool found = false;
    const struct dirent *entry;
    while (!found && (entry = readdir(dir)) != NULL) {
        char target[64];
        ssize_t length = readlinkat(dirfd(dir), entry->d_name, target, sizeof(target) - 1);
        if (length > 0) {
            target[length] = '\0';
            found = strcmp(target, wanted) == 0;
        }
    }
    closedir(dir);
    return found;
}

pid_t local_workers_pid(const struct local_workers *local, const char *peer_address)
{
    const char *colon = strrchr(peer_address, ':');
    unsigned port = colon == NULL ? 0 : (unsigned)strtoul(colon + 1, NULL, 10);
    unsigned long inode = socket_inode(port, local->settings.port);
    for (unsigned i = 0; inode != 0 && i < local->settings.count; i++) {
        if (local->places[i].pid != 0 && holds_socket(local->places[i].pid, inode))
            return local->places[i].pid;
    }
    return -1;
}
