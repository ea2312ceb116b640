#include "master/pbrt_media.h"

#include "master/measured_media.h"
#include "master/pbrt_args.h"
#include "master/pbrt_color.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define COUNT(a) (sizeof(a) / sizeof((a)[0]))

static const struct pbrt_name kinds[] = {
    { "homogeneous", 0, NAME_OURS, NULL },
    { "cloud", 0, NAME_LATER, NULL },
    { "nanovdb", 0, NAME_LATER, NULL },
    { "rgbgrid", 0, NAME_LATER, NULL },
    { "uniformgrid", 0, NAME_LATER, NULL },
    { "heterogeneous", 0, NAME_OLD, "in pbrt-v4 it is \"uniformgrid\"" },
};

struct pbrt_medium {
    struct pbrt_token name; /* where it came up first */
    struct medium medium;
    bool defined;
    uint32_t in_scene; /* 1 + index among the scene's media, or 0 */
};

void pbrt_media_free(struct pbrt_media *media)
{
    growing_free(&media->named);
}

static struct pbrt_medium *named_at(struct pbrt_reader *reader, uint32_t named)
{
    return (struct pbrt_medium *)reader->media.named.data + named - 1;
}

/* The medium of that name, new or not; 0 for "", which is vacuum */
static bool find_or_add(struct pbrt_reader *reader, const struct pbrt_token *name, uint32_t *named)
{
    struct growing *all = &reader->media.named;
    *named = 0;
    if (name->length == 0)
        return true;
    for (uint32_t i = 1; i <= all->count; i++) {
        const struct pbrt_token *other = &named_at(reader, i)->name;
        if (other->length == name->length && memcmp(other->text, name->text, name->length) == 0) {
            *named = i;
            return true;
        }
    }
    struct pbrt_medium *added = growing_add(all, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = (struct pbrt_medium){ .name = *name };
    *named = (uint32_t)all->count;
    return true;
}

/* --- MakeNamedMedium ---------------------------------------------------------------------- */

/* The measured coefficients that "preset" names; false when there is none */
static bool read_preset(struct pbrt_params *params, double sigma_a[3], double sigma_s[3])
{
    const struct pbrt_token *preset = pbrt_params_string(params, "preset");
    if (preset == NULL || preset->length == 0)
        return false;
    const char *names[64];
    size_t count = measured_media_count < COUNT(names) ? measured_media_count : COUNT(names);
    for (size_t i = 0; i < count; i++) {
        names[i] = measured_media[i].name;
        if (!pbrt_token_is(preset, names[i]))
            continue;
        memcpy(sigma_a, measured_media[i].sigma_a, 3 * sizeof(double));
        memcpy(sigma_s, measured_media[i].sigma_s, 3 * sizeof(double));
        return true;
    }
    pbrt_params_fail(params, pbrt_params_find(params, "preset"),
                     "no measured medium \"%.*s\"; the nearest is \"%s\"",
                     (int)(preset->length < 64 ? preset->length : 64), preset->text,
                     pbrt_names_nearest_of(names, count, preset->text, preset->length));
    return false;
}

static void read_homogeneous(struct pbrt_params *params, struct medium *medium)
{
    /* pbrt's default is whole milk, in 1/mm */
    double sigma_a[3] = { 0.0011, 0.0024, 0.014 }, sigma_s[3] = { 2.55, 3.21, 3.77 };
    double Le[3] = { 0, 0, 0 };
    if (read_preset(params, sigma_a, sigma_s)) { /* nothing else is asked, as in pbrt */
        pbrt_params_ignore(params, "sigma_a");
        pbrt_params_ignore(params, "sigma_s");
    } else {
        pbrt_color(params, "sigma_a", COLOR_DENSITY, sigma_a);
        pbrt_color(params, "sigma_s", COLOR_DENSITY, sigma_s);
    }
    pbrt_color(params, "Le", COLOR_LIGHT, Le);
    double Le_scale = pbrt_params_float(params, "Lescale", 1);
    double scale = pbrt_params_float(params, "scale", 1), g = pbrt_params_float(params, "g", 0);
    if (!(scale >= 0) || !(Le_scale >= 0))
        pbrt_params_fail(params, NULL, "a scale below 0 is not possible");
    if (!(fabs(g) <= 1))
        pbrt_params_fail(params, pbrt_params_find(params, "g"), "g is %g; -1 to 1 is possible", g);
    for (int c = 0; c < 3; c++) {
        medium->sigma_a[c] = (float)(sigma_a[c] * scale);
        medium->sigma_s[c] = (float)(sigma_s[c] * scale);
        medium->Le[c] = (float)(Le[c] * Le_scale);
        if (!isfinite(medium->sigma_a[c] + medium->sigma_s[c]) || !isfinite(medium->Le[c]))
            pbrt_params_fail(params, NULL, "a number of the medium is beyond float32");
    }
    medium->g = (float)g;
}

bool pbrt_media_define(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_params *params = &reader->params;
    struct pbrt_token name;
    uint32_t named;
    if (!pbrt_args_string(reader, directive, &name) ||
        !pbrt_params_read(params, "MakeNamedMedium", &name,
                          &reader->stack.defaults[TARGET_MEDIUM]) ||
        !find_or_add(reader, &name, &named))
        return false;
    if (named == 0)
        return pbrt_report_error(reader, &name.pos, "\"\" is vacuum, and no medium");
    struct pbrt_medium *medium = named_at(reader, named);
    if (medium->defined)
        return pbrt_report_error(reader, &name.pos, "a second medium \"%.*s\"",
                                 (int)(name.length < 100 ? name.length : 100), name.text);
    medium->defined = true;

    const struct pbrt_token *type = pbrt_params_string(params, "type");
    const struct pbrt_name *kind;
    if (type == NULL && !params->failed)
        pbrt_params_fail(params, NULL, "MakeNamedMedium wants \"string type\"");
    if (params->failed || !pbrt_names_choose(reader, "medium", kinds, COUNT(kinds), type, &kind))
        return false;
    if (kind == NULL)
        return true; /* lenient, and noted: it is as clear as vacuum */
    read_homogeneous(params, &medium->medium);
    return pbrt_params_done(params);
}

/* --- Using them --------------------------------------------------------------------------- */

bool pbrt_media_interface(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_state *state = &reader->state;
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name) ||
        !find_or_add(reader, &name, &state->inside) ||
        !pbrt_lexer_peek(reader->lexer, &name, reader->err))
        return false;
    state->outside = state->inside; /* a single name is for both sides */
    if (name.kind != TOKEN_STRING)
        return true;
    return pbrt_lexer_next(reader->lexer, &name, reader->err) &&
           find_or_add(reader, &name, &state->outside);
}

bool pbrt_media_resolve(struct pbrt_reader *reader, uint32_t named, uint32_t *in_scene)
{
    *in_scene = 0;
    if (named == 0)
        return true;
    struct pbrt_medium *medium = named_at(reader, named);
    struct growing *media = &reader->build->media;
    if (medium->in_scene == 0) {
        if (growing_add(media, 1, sizeof(struct medium)) == NULL)
            return pbrt_report_no_memory(reader);
        medium->in_scene = (uint32_t)media->count;
    }
    *in_scene = medium->in_scene;
    return true;
}

bool pbrt_media_finish(struct pbrt_reader *reader)
{
    for (uint32_t i = 1; i <= reader->media.named.count; i++) {
        const struct pbrt_medium *medium = named_at(reader, i);
        const struct pbrt_token *name = &medium->name;
        if (!medium->defined)
            return pbrt_report_error(reader, &name->pos, "no medium \"%.*s\" is defined anywhere",
                                     (int)(name->length < 100 ? name->length : 100), name->text);
        if (medium->in_scene != 0)
            ((struct medium *)reader->build->media.data)[medium->in_scene - 1] = medium->medium;
    }
    return true;
}

void pbrt_media_note(struct pbrt_reader *reader, const struct scene *scene)
{
    bool far = false;
    for (uint32_t i = 0; i < scene->light_count; i++)
        far |= scene->lights[i].kind == LIGHT_SKY || scene->lights[i].kind == LIGHT_DISTANT;
    if (far && scene->settings.camera_medium != 0)
        pbrt_report_note(reader, &reader->view.pos,
                         "the camera stands in a medium: light from infinity does not come through "
                         "it, as in pbrt, unless a surface ends it");
}
