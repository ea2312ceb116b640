#include "master/pbrt_settings.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

#include <string.h>

#define COUNT(a)    (sizeof(a) / sizeof((a)[0]))
#define STRATA_MOST 65536 /* along one axis of a pixel */

/* --- Sampler ------------------------------------------------------------------------------ */

static const struct pbrt_name samplers[] = {
    { "sobol", SAMPLER_SOBOL, NAME_OURS, NULL },
    { "independent", SAMPLER_INDEPENDENT, NAME_OURS, NULL },
    { "stratified", SAMPLER_STRATIFIED, NAME_OURS, NULL },
    { "halton", SAMPLER_HALTON, NAME_OURS, NULL },
    { "hammersley", SAMPLER_HAMMERSLEY, NAME_OURS, NULL },
    { "zsobol", SAMPLER_SOBOL, NAME_LATER, NULL },
    { "paddedsobol", SAMPLER_SOBOL, NAME_LATER, NULL },
    { "pmj02bn", SAMPLER_SOBOL, NAME_LATER, NULL },
    { "random", 0, NAME_OLD, "in pbrt-v4 it is \"independent\"" },
    { "lowdiscrepancy", 0, NAME_OLD, "in pbrt-v4 there is \"paddedsobol\"" },
    { "02sequence", 0, NAME_OLD, "in pbrt-v4 there is \"paddedsobol\"" },
    { "zerotwosequence", 0, NAME_OLD, "in pbrt-v4 there is \"paddedsobol\"" },
    { "maxmindist", 0, NAME_OLD, "in pbrt-v4 there is \"pmj02bn\"" },
};

bool pbrt_settings_sampler(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found = pbrt_names_find(samplers, COUNT(samplers), type);
    if (found != NULL && found->state == NAME_LATER)
        pbrt_report_note(reader, &type->pos, "sampler \"%s\" renders as \"sobol\"", found->text);
    else if (!pbrt_names_choose(reader, "sampler", samplers, COUNT(samplers), type, &found))
        return false;

    struct scene_settings *settings = &reader->build->scene->settings;
    settings->sampler = (uint32_t)found->value;
    int64_t spp = 0;
    if (settings->sampler == SAMPLER_STRATIFIED) {
        const struct pbrt_param *x = pbrt_params_find(params, "xsamples");
        int64_t nx = pbrt_params_integer(params, "xsamples", 4);
        int64_t ny = pbrt_params_integer(params, "ysamples", 4);
        bool given = x != NULL || pbrt_params_find(params, "ysamples") != NULL;
        if (nx < 1 || ny < 1 || nx > STRATA_MOST || ny > STRATA_MOST / 2)
            pbrt_params_fail(params, x, "%lld x %lld samples are not possible", (long long)nx,
                             (long long)ny);
        spp = given ? nx * ny : 0;
        if (!pbrt_params_bool(params, "jitter", true))
            pbrt_params_later(params, "jitter");
    }
    int64_t asked = pbrt_params_integer(params, "pixelsamples", 0);
    if (asked < 0 || asked > UINT32_MAX / 2 ||
        (asked == 0 && pbrt_params_find(params, "pixelsamples") != NULL))
        pbrt_params_fail(params, pbrt_params_find(params, "pixelsamples"),
                         "%lld samples per pixel are not possible", (long long)asked);
    settings->sampler_spp = (uint32_t)(asked > 0 ? asked : spp);

    const struct pbrt_token *randomization = pbrt_params_string(params, "randomization");
    static const char *const known[] = { "none", "permutedigits", "fastowen", "owen" };
    if (randomization != NULL) {
        bool valid = false;
        for (size_t i = 0; i < COUNT(known); i++)
            valid = valid || pbrt_token_is(randomization, known[i]);
        if (!valid)
            pbrt_params_fail(params, pbrt_params_find(params, "randomization"),
                             "unknown randomization \"%.*s\"; the nearest is \"%s\"",
                             (int)randomization->length, randomization->text,
                             pbrt_names_nearest_of(known, COUNT(known), randomization->text,
                                                   randomization->length));
        else if (pbrt_token_is(randomization, "none"))
            pbrt_report_note(reader, &randomization->pos,
                             "samplers are randomised always, or the error would be unknown");
    }
    if (pbrt_params_find(params, "seed") != NULL) {
        pbrt_params_integer(params, "seed", 0);
        pbrt_report_note(reader, &type->pos,
                         "the sampler's seed is not used: the job has one (--seed)");
    }
    return pbrt_params_done(params);
}

/* --- Integrator --------------------------------------------------------------------------- */

enum { OUR_OWN, ANOTHER_WAY }; /* to the same picture */

static const struct pbrt_name integrators[] = {
    { "path", OUR_OWN, NAME_OURS, NULL },
    { "volpath", OUR_OWN, NAME_OURS, NULL },
    { "simplepath", OUR_OWN, NAME_OURS, NULL },
    { "simplevolpath", OUR_OWN, NAME_OURS, NULL },
    { "randomwalk", OUR_OWN, NAME_OURS, NULL },
    { "bdpt", ANOTHER_WAY, NAME_OURS, NULL },
    { "lightpath", ANOTHER_WAY, NAME_OURS, NULL },
    { "mlt", ANOTHER_WAY, NAME_OURS, NULL },
    { "sppm", ANOTHER_WAY, NAME_OURS, NULL },
    { "ambientocclusion", 0, NAME_LATER, NULL },
    { "function", 0, NAME_LATER, NULL },
    { "ao", 0, NAME_OLD, "in pbrt-v4 it is \"ambientocclusion\"" },
    { "directlighting", 0, NAME_OLD, "write \"path\" with \"integer maxdepth\" 1" },
    { "whitted", 0, NAME_OLD, "in pbrt-v4 there is \"path\"" },
};

/* What decides how pbrt finds its light, not how much there is */
static void ignore_ways(struct pbrt_params *params)
{
    static const char *const names[] = { "lightsampler",
                                         "samplelights",
                                         "samplebsdf",
                                         "rrthreshold",
                                         "mutationsperpixel",
                                         "largestepprobability",
                                         "sigma",
                                         "bootstrapsamples",
                                         "chains",
                                         "photonsperiteration",
                                         "radius",
                                         "seed" };
    static const char *const pictures[] = { "visualizestrategies", "visualizeweights" };
    for (size_t i = 0; i < COUNT(names); i++)
        pbrt_params_ignore(params, names[i]);
    for (size_t i = 0; i < COUNT(pictures); i++)
        if (pbrt_params_bool(params, pictures[i], false))
            pbrt_params_later(params, pictures[i]);
}

bool pbrt_settings_integrator(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "integrator", integrators, COUNT(integrators), type, &found))
        return false;
    if (found != NULL && found->value == ANOTHER_WAY)
        pbrt_report_note(reader, &type->pos, "integrator \"%s\" renders as \"path\"", found->text);
    int64_t depth = pbrt_params_integer(params, "maxdepth", -1);
    if (pbrt_params_find(params, "maxdepth") != NULL && (depth < 0 || depth >= SCENE_NONE))
        pbrt_params_fail(params, pbrt_params_find(params, "maxdepth"), "a depth of %lld",
                         (long long)depth);
    if (depth < 0)
        pbrt_report_note(reader, &type->pos,
                         "paths are as long as they are; pbrt, without \"maxdepth\", stops at 5");
    reader->build->scene->settings.max_depth = depth >= 0 ? (uint32_t)depth : SCENE_NONE;
    if (pbrt_params_bool(params, "regularize", false))
        pbrt_report_note(reader, &type->pos,
                         "\"regularize\" is not used: blurring reflections seen in reflections "
                         "saves noise and changes the picture");
    ignore_ways(params);
    if (found == NULL) /* lenient: another integrator's parameters */
        for (size_t i = 0; i < params->items.count; i++)
            ((struct pbrt_param *)params->items.data)[i].used = true;
    return pbrt_params_done(params);
}

/* --- Accelerator and Option --------------------------------------------------------------- */

bool pbrt_settings_accelerator(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token type;
    if (!pbrt_args_typed(reader, directive, TARGET_NONE, &type))
        return false;
    pbrt_report_note(reader, &directive->pos,
                     "Accelerator \"%.*s\" is not used: Embree builds its own", (int)type.length,
                     type.text);
    return true;
}

enum {
    HARMLESS, /* or of no use here */
    NO_PIXEL_JITTER,
    NO_TEXTURE_FILTER,
    FORCE_DIFFUSE,
    SEED
};

static const struct pbrt_name options[] = {
    { "disablepixeljitter", NO_PIXEL_JITTER, NAME_OURS, NULL },
    { "disabletexturefiltering", NO_TEXTURE_FILTER, NAME_OURS, NULL },
    { "forcediffuse", FORCE_DIFFUSE, NAME_OURS, NULL },
    { "seed", SEED, NAME_OURS, NULL },
    { "disablewavelengthjitter", HARMLESS, NAME_OURS, NULL },
    { "displacementedgescale", HARMLESS, NAME_OURS, NULL },
    { "msereferenceimage", HARMLESS, NAME_OURS, NULL },
    { "msereferenceout", HARMLESS, NAME_OURS, NULL },
    { "pixelstats", HARMLESS, NAME_OURS, NULL },
    { "rendercoordsys", HARMLESS, NAME_OURS, NULL },
    { "wavefront", HARMLESS, NAME_OURS, NULL },
};

/* The one value that follows, in brackets or not */
static bool option_value(struct pbrt_reader *reader, struct pbrt_token *value)
{
    struct pbrt_token close;
    if (!pbrt_lexer_next(reader->lexer, value, reader->err))
        return false;
    bool bracket = value->kind == TOKEN_OPEN;
    if (bracket && !pbrt_lexer_next(reader->lexer, value, reader->err))
        return false;
    if (value->kind != TOKEN_WORD && value->kind != TOKEN_STRING)
        return pbrt_report_error(reader, &value->pos, "Option wants a value");
    if (bracket && !pbrt_lexer_next(reader->lexer, &close, reader->err))
        return false;
    return !bracket || close.kind == TOKEN_CLOSE ||
           pbrt_report_error(reader, &close.pos, "Option wants one value");
}

static bool set_option(struct pbrt_reader *reader, const struct pbrt_name *option,
                       const struct pbrt_token *name, const struct pbrt_token *value)
{
    bool *flag = option->value == NO_PIXEL_JITTER     ? &reader->view.no_jitter
                 : option->value == NO_TEXTURE_FILTER ? &reader->textures.unfiltered
                 : option->value == FORCE_DIFFUSE     ? &reader->materials.diffuse
                                                      : NULL;
    if (flag != NULL) {
        *flag = pbrt_token_is(value, "true");
        if (!*flag && !pbrt_token_is(value, "false"))
            return pbrt_report_error(reader, &value->pos, "option \"%s\" is true or false",
                                     option->text);
        if (*flag && option->value == FORCE_DIFFUSE)
            pbrt_report_note(reader, &name->pos,
                             "\"forcediffuse\": the albedo of a material is its textured "
                             "reflectance, or its mean over all directions; in pbrt it is that of "
                             "the direction it is seen from");
    } else if (option->value == SEED) {
        pbrt_report_note(reader, &name->pos, "the seed is not used: the job has one (--seed)");
    } else if (!pbrt_token_is(value, "false")) {
        pbrt_report_note(reader, &name->pos, "option \"%s\" is of no use here", option->text);
    }
    return true;
}

bool pbrt_settings_option(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name, value;
    const struct pbrt_name *found;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    const char *space = memchr(name.text, ' ', name.length); /* "bool wavefront" */
    if (space != NULL) {
        name.length -= (size_t)(space + 1 - name.text);
        name.text = space + 1;
    }
    return pbrt_names_choose(reader, "option", options, COUNT(options), &name, &found) &&
           option_value(reader, &value) && set_option(reader, found, &name, &value);
}
