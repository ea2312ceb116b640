#include "master/render_run.h"

#include "common/err.h"
#include "master/exr.h"
#include "master/image.h"

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <jansson.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#define NAME_SIZE 4096

struct render_run {
    struct sigaction before[2]; /* what signals did before */
    char program[NAME_SIZE], folder[NAME_SIZE];
    char picture[NAME_SIZE + 32], report[NAME_SIZE + 32], cache[NAME_SIZE + 32],
        said[NAME_SIZE + 32]; /* in the folder */
};

/* ---- signals */

static const int numbers[] = { SIGINT, SIGTERM };
enum { NUMBERS = sizeof(numbers) / sizeof(numbers[0]) };

static volatile sig_atomic_t rendering, stopped; /* the process that signals are passed on to */

static void pass_on(int number)
{
    stopped = number;
    if (rendering > 0)
        kill((pid_t)rendering, number);
}

/* ---- the folder */

struct render_run *render_run_open(struct err *err)
{
    struct render_run *run = calloc(1, sizeof(*run));
    if (run == NULL) {
        err_set(err, ERR_MEMORY, "no memory for renders");
        return NULL;
    }
    if (readlink("/proc/self/exe", run->program, sizeof(run->program) - 1) < 0) {
        err_set(err, ERR_IO, "cannot tell where this program is: %s", strerror(errno));
        goto fail;
    }
    const char *place = getenv("TMPDIR");
    if (place == NULL || place[0] == '\0')
        place = "/tmp";
    int length = snprintf(run->folder, sizeof(run->folder), "%s/pathfarm-XXXXXX", place);
    if (length >= (int)sizeof(run->folder) || mkdtemp(run->folder) == NULL) {
        err_set(err, ERR_IO, "%s: no temporary folder there: %s", place, strerror(errno));
        goto fail;
    }
    snprintf(run->picture, sizeof(run->picture), "%s/picture.exr", run->folder);
    snprintf(run->report, sizeof(run->report), "%s/report.json", run->folder);
    snprintf(run->cache, sizeof(run->cache), "%s/cache", run->folder);
    snprintf(run->said, sizeof(run->said), "%s/said", run->folder);
    stopped = 0;
    const struct sigaction passing = { .sa_handler = pass_on };
    for (int i = 0; i < NUMBERS; i++)
        sigaction(numbers[i], &passing, &run->before[i]);
    return run;

fail:
    free(run);
    return NULL;
}

static int remove_one(const char *path, const struct stat *status, int kind, struct FTW *walk)
{
    (void)status;
    (void)kind;
    (void)walk;
    remove(path); /* what cannot be removed stays: nothing depends on it */
    return 0;
}

void render_run_close(struct render_run *run)
{
    if (run == NULL)
        return;
    for (int i = 0; i < NUMBERS; i++)
        sigaction(numbers[i], &run->before[i], NULL);
    nftw(run->folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
    free(run);
}

/* ---- the process */

/* In the child: never returns. Its words go to the file `said`. */
static void become_render(const struct render_run *run, const char *const *arguments, pid_t parent)
{
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent)
        _exit(1);
    int said = open(run->said, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (said < 0 || dup2(said, STDOUT_FILENO) < 0 || dup2(said, STDERR_FILENO) < 0)
        _exit(1);
    execv(run->program, (char *const *)(uintptr_t)arguments);
    _exit(1);
}

/* The wait status of the render */
static bool run_process(const struct render_run *run, const char *const *arguments, int *status,
                        struct err *err)
{
    if (stopped != 0)
        return err_set(err, ERR_CANCELLED, "stopped by signal %d (%s)", (int)stopped,
                       strsignal(stopped));
    pid_t parent = getpid(), pid = fork();
    if (pid == 0)
        become_render(run, arguments, parent);
    if (pid < 0)
        return err_set(err, ERR_IO, "no process for a render: %s", strerror(errno));
    rendering = pid;
    if (stopped != 0) /* while there was no process to pass it on to */
        kill(pid, SIGTERM);
    pid_t ended;
    do
        ended = waitpid(pid, status, 0);
    while (ended < 0 && errno == EINTR);
    rendering = 0;
    return ended == pid || err_set(err, ERR_IO, "lost sight of a render: %s", strerror(errno));
}

/* The last line that the render said */
static void last_words(const struct render_run *run, char *text, size_t size)
{
    char line[512];
    snprintf(text, size, "it said nothing");
    FILE *file = fopen(run->said, "r");
    if (file == NULL)
        return;
    while (fgets(line, sizeof(line), file) != NULL) {
        line[strcspn(line, "\n")] = '\0';
        if (line[0] != '\0')
            snprintf(text, size, "%s", line);
    }
    fclose(file);
}

/* ---- the report */

static uint64_t report_count(const json_t *object, const char *key)
{
    json_int_t value = json_integer_value(json_object_get(object, key));
    return value < 0 ? 0 : (uint64_t)value;
}

static bool read_report(const struct render_run *run, struct render_facts *facts, struct err *err)
{
    json_error_t why;
    json_t *root = json_load_file(run->report, 0, &why);
    if (root == NULL)
        return err_set(err, ERR_INTERNAL, "a report that is none: %s", why.text);
    const json_t *truncated = json_object_get(root, "truncated");
    const json_t *lost = json_object_get(root, "nonfinite_samples");
    *facts = (struct render_facts){
        .spp = report_count(root, "spp"),
        .replicates = (uint32_t)report_count(root, "replicates"),
        .core_s = json_number_value(json_object_get(root, "core_seconds")),
        .wall_s = json_number_value(json_object_get(root, "wall_seconds")),
        .truncated_paths = report_count(truncated, "paths"),
        .truncated_energy = json_number_value(json_object_get(truncated, "energy_per_path")),
        .nonfinite = report_count(lost, "nan") + report_count(lost, "infinite") +
                     report_count(lost, "negative"),
    };
    json_decref(root);
    return true;
}

struct image *render_run_picture(struct render_run *run, const char *const *arguments,
                                 struct render_facts *facts, struct err *err)
{
    const char *const added[] = { "-o",      run->picture, "--report", run->report,
                                  "--cache", run->cache,   "--quiet" };
    const char *all[RENDER_RUN_ARGUMENTS + sizeof(added) / sizeof(added[0]) + 3] = { run->program,
                                                                                     "render" };
    size_t count = 2;
    for (size_t i = 0; arguments[i] != NULL; i++) {
        if (i == RENDER_RUN_ARGUMENTS) {
            err_set(err, ERR_INTERNAL, "too many arguments for a render");
            return NULL;
        }
        all[count++] = arguments[i];
    }
    for (size_t i = 0; i < sizeof(added) / sizeof(added[0]); i++)
        all[count++] = added[i];
    unlink(run->picture);
    unlink(run->report);

    int status;
    if (!run_process(run, all, &status, err))
        return NULL;
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
        char words[512];
        last_words(run, words, sizeof(words));
        err_set(err, WIFEXITED(status) && WEXITSTATUS(status) == 2 ? ERR_ARGUMENT : ERR_RENDER,
                "%s", words);
        return NULL;
    }
    struct image *picture = exr_image_read(run->picture, err);
    if (picture == NULL)
        return NULL;
    if (!read_report(run, facts, err)) {
        image_free(picture);
        return NULL;
    }
    return picture;
}
