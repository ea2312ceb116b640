#include "master/accuracy_setup.h"

#include "common/effects.h"
#include "common/err.h"
#include "common/job.h"
#include "common/scene.h"
#include "master/options.h"

#include <stdio.h>
#include <string.h>

#define WITHOUT_LIGHTS "--no-light-sampling"

/* A new way of rendering is a row; accuracy_page.c has the titles of the groups. */
const struct accuracy_setup accuracy_setup_table[] = {
    { "default",
      "default",
      "Owen-scrambled Sobol points, everything switched on, four replicates",
      { "--sampler", "sobol" },
      0 },
    { "independent",
      "sampler",
      "independent random numbers: no stratification",
      { "--sampler", "independent" },
      0 },
    { "stratified",
      "sampler",
      "a jittered grid in every pair of dimensions",
      { "--sampler", "stratified" },
      0 },
    { "halton", "sampler", "scrambled Halton points", { "--sampler", "halton" }, 0 },
    { "hammersley", "sampler", "scrambled Hammersley points", { "--sampler", "hammersley" }, 0 },
    { "no-light-sampling",
      "technique",
      "no explicit light sampling: paths find lights themselves",
      { "--sampler", "sobol", WITHOUT_LIGHTS },
      TECHNIQUE_LIGHT_SAMPLING },
    { "no-mis",
      "technique",
      "light sampling alone, where it can; no weights of two techniques",
      { "--sampler", "sobol", "--no-mis" },
      TECHNIQUE_MIS },
    { "no-roulette",
      "technique",
      "no Russian roulette: every path goes on to the depth limit",
      { "--sampler", "sobol", "--no-roulette" },
      TECHNIQUE_ROULETTE },
    { "plain",
      "technique",
      "independent numbers and no light sampling: the textbook's path tracer",
      { "--sampler", "independent", WITHOUT_LIGHTS },
      TECHNIQUE_LIGHT_SAMPLING },
    { "replicates-1",
      "replicates",
      "one long sequence, and no error estimate: what the estimate's price is held against",
      { "--sampler", "sobol", "--replicates", "1" },
      0 },
    { "replicates-2",
      "replicates",
      "two replicates: longer sequences, a vaguer error estimate",
      { "--sampler", "sobol", "--replicates", "2" },
      0 },
    { "replicates-8",
      "replicates",
      "eight replicates: shorter sequences, a surer error estimate",
      { "--sampler", "sobol", "--replicates", "8" },
      0 },
    { "everything",
      "kernel",
      "the kernel that can do everything, in place of the scene's own",
      { "--sampler", "sobol", "--kernel", "everything" },
      0 },
};
const size_t accuracy_setup_count = sizeof(accuracy_setup_table) / sizeof(accuracy_setup_table[0]);
_Static_assert(sizeof(accuracy_setup_table) / sizeof(accuracy_setup_table[0]) <=
                   ACCURACY_SETUPS_MAX,
               "room for all in lists");

/* One name of the list among the rows; false when there is no such row */
static bool mark(const char *name, size_t length, bool *wanted)
{
    for (size_t i = 0; i < accuracy_setup_count; i++) {
        const char *known = accuracy_setup_table[i].name;
        if (strlen(known) == length && strncmp(known, name, length) == 0)
            return wanted[i] = true;
    }
    return false;
}

static bool no_such(const char *name, size_t length, struct err *err)
{
    const char *names[ACCURACY_SETUPS_MAX + 1] = { NULL };
    char text[64];
    for (size_t i = 0; i < accuracy_setup_count; i++)
        names[i] = accuracy_setup_table[i].name;
    snprintf(text, sizeof(text), "%.*s", (int)length, name);
    const char *nearest = options_nearest(text, names);
    if (nearest == NULL)
        return err_set(err, ERR_ARGUMENT, "there is no configuration \"%s\"", text);
    return err_set(err, ERR_ARGUMENT, "there is no configuration \"%s\"; the nearest is %s", text,
                   nearest);
}

bool accuracy_setup_choose(const char *list, const struct accuracy_setup *chosen[], size_t *count,
                           struct err *err)
{
    bool wanted[ACCURACY_SETUPS_MAX] = { true };
    for (const char *at = list; at != NULL;) {
        const char *comma = strchr(at, ',');
        size_t length = comma == NULL ? strlen(at) : (size_t)(comma - at);
        if (!mark(at, length, wanted))
            return no_such(at, length, err);
        at = comma == NULL ? NULL : comma + 1;
    }
    *count = 0;
    for (size_t i = 0; i < accuracy_setup_count; i++)
        if (list == NULL || wanted[i])
            chosen[(*count)++] = &accuracy_setup_table[i];
    return true;
}

const char *accuracy_setup_refusal(const struct accuracy_setup *setup, const struct scene *scene)
{
    if ((setup->techniques_off & TECHNIQUE_LIGHT_SAMPLING) &&
        (scene->settings.effects & FX_DELTA_LIGHT))
        return "the scene has lights that no path finds by itself";
    return NULL;
}
