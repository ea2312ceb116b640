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

static const struct pbrt_name integrators[] = {
    { "path", 0, NAME_OURS, NULL },
    { "volpath", 0, NAME_OURS, NULL },
    { "simplepath", 0, NAME_OURS, NULL },
    { "simplevolpath", 0, NAME_OURS, NULL },
    { "randomwalk", 0, NAME_OURS, NULL },
    { "ambientocclusion", 0, NAME_LATER, NULL },
    { "bdpt", 0, NAME_LATER, NULL },
    { "function", 0, NAME_LATER, NULL },
    { "lightpath", 0, NAME_LATER, NULL },
    { "mlt", 0, NAME_LATER, NULL },
    { "sppm", 0, NAME_LATER, NULL },
    { "ao", 0, NAME_OLD, "in pbrt-v4 it is \"ambientocclusion\"" },
    { "directlighting", 0, NAME_OLD, "write \"path\" with \"integer maxdepth\" 1" },
    { "whitted", 0, NAME_OLD, "in pbrt-v4 there is \"path\"" },
};

bool pbrt_settings_integrator(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "integrator", integrators, COUNT(integrators), type, &found))
        return false;
    int64_t depth = pbrt_params_integer(params, "maxdepth", -1);
    if (pbrt_params_find(params, "maxdepth") != NULL && (depth < 0 || depth >= SCENE_NONE))
        pbrt_params_fail(params, pbrt_params_find(params, "maxdepth"), "a depth of %lld",
                         (long long)depth);
    reader->build->scene->settings.max_depth = depth >= 0 ? (uint32_t)depth : SCENE_NONE;
    if (pbrt_params_bool(params, "regularize", false))
        pbrt_params_later(params, "regularize");
    static const char *const same_picture[] = { "lightsampler", "lightsampling", "samplelights",
                                                "samplebsdf", "rrthreshold" };
    for (size_t i = 0; i < COUNT(same_picture); i++)
        pbrt_params_ignore(params, same_picture[i]);
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

bool pbrt_settings_option(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    enum { HARMLESS, CHANGES };
    static const struct pbrt_name options[] = {
        { "disabletexturefiltering", HARMLESS, NAME_OURS, NULL },
        { "disablewavelengthjitter", HARMLESS, NAME_OURS, NULL },
        { "displacementedgescale", HARMLESS, NAME_OURS, NULL },
        { "msereferenceimage", HARMLESS, NAME_OURS, NULL },
        { "msereferenceout", HARMLESS, NAME_OURS, NULL },
        { "pixelstats", HARMLESS, NAME_OURS, NULL },
        { "rendercoordsys", HARMLESS, NAME_OURS, NULL },
        { "seed", HARMLESS, NAME_OURS, NULL },
        { "wavefront", HARMLESS, NAME_OURS, NULL },
        { "disablepixeljitter", CHANGES, NAME_OURS, NULL },
        { "forcediffuse", CHANGES, NAME_OURS, NULL },
    };
    struct pbrt_token name, value;
    const struct pbrt_name *found;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    const char *space = memchr(name.text, ' ', name.length); /* "bool wavefront" */
    if (space != NULL) {
        name.length -= (size_t)(space + 1 - name.text);
        name.text = space + 1;
    }
    if (!pbrt_names_choose(reader, "option", options, COUNT(options), &name, &found) ||
        !pbrt_lexer_next(reader->lexer, &value, reader->err))
        return false;
    bool bracket = value.kind == TOKEN_OPEN;
    if (bracket && !pbrt_lexer_next(reader->lexer, &value, reader->err))
        return false;
    if (value.kind != TOKEN_WORD && value.kind != TOKEN_STRING)
        return pbrt_report_error(reader, &value.pos, "Option wants a value");
    bool on = !pbrt_token_is(&value, "false");
    if (bracket &&
        (!pbrt_lexer_next(reader->lexer, &value, reader->err) || value.kind != TOKEN_CLOSE))
        return pbrt_report_error(reader, &value.pos, "Option wants one value");
    return found->value == HARMLESS || !on ||
           pbrt_report_later(reader, &name.pos, "option \"%s\"", found->text);
}
