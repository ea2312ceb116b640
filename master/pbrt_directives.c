#include "master/pbrt_directives.h"

#include "master/pbrt_args.h"
#include "master/pbrt_lights.h"
#include "master/pbrt_reader.h"
#include "master/pbrt_settings.h"
#include "master/pbrt_shapes.h"
#include "master/pbrt_textures.h"

#define COUNT(a) (sizeof(a) / sizeof((a)[0]))

typedef bool pbrt_directive(struct pbrt_reader *reader, const struct pbrt_token *token);

/* The next directive is the file's first */
static bool on_include(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    const char *path = pbrt_lexer_resolve(reader->lexer, name);
    if (path == NULL)
        return pbrt_report_error(reader, &name->pos, "no file can be read from here");
    return pbrt_lexer_open(reader->lexer, path, &name->pos, reader->err);
}

static bool on_import(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    return on_include(reader, name) && pbrt_state_import(reader, name);
}

static bool on_world_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->in_world)
        return pbrt_report_error(reader, &directive->pos, "a second WorldBegin");
    reader->in_world = true;
    reader->state.fixed_start = reader->state.fixed_end = false;
    return pbrt_transforms_identity(reader, directive);
}

/* --- The table ---------------------------------------------------------------------------- */

enum place { ANYWHERE, BEFORE_WORLD, IN_WORLD };

/* One of `plain`, `named`, `typed` and `old` is set */
static const struct directive {
    const char *name;
    enum place place;
    pbrt_directive *plain;     /* reads what follows the word, which it gets */
    pbrt_directive *named;     /* gets the name in quotes that follows */
    pbrt_directive *typed;     /* gets the type in quotes; its parameters were read */
    enum pbrt_target defaults; /* of `typed`: what Attribute calls it */
    const char *old;           /* pbrt-v3's: what pbrt-v4 says instead */
} directives[] = {
    { "Accelerator", BEFORE_WORLD, .plain = pbrt_settings_accelerator },
    { "ActiveTransform", ANYWHERE, .plain = pbrt_transforms_active },
    { "AreaLightSource", IN_WORLD, .typed = pbrt_lights_area, .defaults = TARGET_LIGHT },
    { "Attribute", ANYWHERE, .plain = pbrt_state_attribute },
    { "AttributeBegin", IN_WORLD, .plain = pbrt_state_attribute_begin },
    { "AttributeEnd", IN_WORLD, .plain = pbrt_state_attribute_end },
    { "Camera", BEFORE_WORLD, .typed = pbrt_view_camera },
    { "ColorSpace", ANYWHERE, .plain = pbrt_state_color_space },
    { "ConcatTransform", ANYWHERE, .plain = pbrt_transforms_concat },
    { "CoordinateSystem", ANYWHERE, .plain = pbrt_transforms_name },
    { "CoordSysTransform", ANYWHERE, .plain = pbrt_transforms_recall },
    { "Film", BEFORE_WORLD, .typed = pbrt_view_film },
    { "Identity", ANYWHERE, .plain = pbrt_transforms_identity },
    { "Import", IN_WORLD, .named = on_import },
    { "Include", ANYWHERE, .named = on_include },
    { "Integrator", BEFORE_WORLD, .typed = pbrt_settings_integrator },
    { "LightSource", IN_WORLD, .typed = pbrt_lights_add, .defaults = TARGET_LIGHT },
    { "LookAt", ANYWHERE, .plain = pbrt_transforms_look_at },
    { "MakeNamedMaterial", IN_WORLD, .typed = pbrt_materials_define, .defaults = TARGET_MATERIAL },
    { "MakeNamedMedium", ANYWHERE, .plain = pbrt_media_define },
    { "Material", IN_WORLD, .typed = pbrt_materials_set, .defaults = TARGET_MATERIAL },
    { "MediumInterface", ANYWHERE, .plain = pbrt_media_interface },
    { "NamedMaterial", IN_WORLD, .named = pbrt_materials_use },
    { "ObjectBegin", IN_WORLD, .plain = pbrt_objects_begin },
    { "ObjectEnd", IN_WORLD, .plain = pbrt_objects_end },
    { "ObjectInstance", IN_WORLD, .plain = pbrt_objects_instance },
    { "Option", BEFORE_WORLD, .plain = pbrt_settings_option },
    { "PixelFilter", BEFORE_WORLD, .typed = pbrt_view_filter },
    { "Renderer", ANYWHERE, .old = "Integrator" },
    { "ReverseOrientation", IN_WORLD, .plain = pbrt_state_reverse_orientation },
    { "Rotate", ANYWHERE, .plain = pbrt_transforms_rotate },
    { "Sampler", BEFORE_WORLD, .typed = pbrt_settings_sampler },
    { "Scale", ANYWHERE, .plain = pbrt_transforms_scale },
    { "Shape", IN_WORLD, .typed = pbrt_shapes_add, .defaults = TARGET_SHAPE },
    { "SurfaceIntegrator", ANYWHERE, .old = "Integrator" },
    { "Texture", IN_WORLD, .plain = pbrt_textures_define },
    { "Transform", ANYWHERE, .plain = pbrt_transforms_set },
    { "TransformBegin", ANYWHERE, .old = "AttributeBegin" },
    { "TransformEnd", ANYWHERE, .old = "AttributeEnd" },
    { "TransformTimes", ANYWHERE, .plain = pbrt_transforms_times },
    { "Translate", ANYWHERE, .plain = pbrt_transforms_translate },
    { "VolumeIntegrator", ANYWHERE, .old = "Integrator" },
    { "WorldBegin", ANYWHERE, .plain = on_world_begin },
    { "WorldEnd", ANYWHERE, .old = "nothing: the world ends with the file" },
};

/* --- Carrying them out -------------------------------------------------------------------- */

static bool unknown_directive(struct pbrt_reader *reader, const struct pbrt_token *token)
{
    const char *names[COUNT(directives)];
    size_t count = 0;
    for (size_t i = 0; i < COUNT(directives); i++)
        if (directives[i].old == NULL)
            names[count++] = directives[i].name;
    int length = (int)(token->length < 64 ? token->length : 64);
    return pbrt_report_error(
        reader, &token->pos, "unknown directive \"%.*s\"; the nearest is \"%s\"", length,
        token->text, pbrt_names_nearest_of(names, count, token->text, token->length));
}

static bool carry_out(struct pbrt_reader *reader, const struct directive *directive,
                      const struct pbrt_token *token)
{
    struct pbrt_token quoted;
    if (directive->plain != NULL)
        return directive->plain(reader, token);
    if (directive->named != NULL)
        return pbrt_args_string(reader, token, &quoted) && directive->named(reader, &quoted);
    return pbrt_args_typed(reader, token, directive->defaults, &quoted) &&
           directive->typed(reader, &quoted);
}

static bool read_directive(struct pbrt_reader *reader, const struct pbrt_token *token)
{
    if (token->kind != TOKEN_WORD)
        return pbrt_report_error(reader, &token->pos, "a directive is wanted here, not %s%.*s%s",
                                 token->kind == TOKEN_STRING ? "the string \"" : "",
                                 (int)(token->length < 64 ? token->length : 64), token->text,
                                 token->kind == TOKEN_STRING ? "\"" : "");
    for (size_t i = 0; i < COUNT(directives); i++) {
        const struct directive *directive = &directives[i];
        if (!pbrt_token_is(token, directive->name))
            continue;
        if (directive->old != NULL)
            return pbrt_report_error(reader, &token->pos, "%s is of pbrt-v3: pbrt-v4 has %s",
                                     directive->name, directive->old);
        if (directive->place == BEFORE_WORLD && reader->in_world)
            return pbrt_report_error(reader, &token->pos, "%s must come before WorldBegin",
                                     directive->name);
        if (directive->place == IN_WORLD && !reader->in_world)
            return pbrt_report_error(reader, &token->pos, "%s must come after WorldBegin",
                                     directive->name);
        return carry_out(reader, directive, token);
    }
    return unknown_directive(reader, token);
}

bool pbrt_directives_run(struct pbrt_reader *reader)
{
    struct pbrt_token token;
    for (;;) {
        if (!pbrt_lexer_next(reader->lexer, &token, reader->err) || !pbrt_state_end_imports(reader))
            return false;
        if (token.kind == TOKEN_END)
            break;
        if (!read_directive(reader, &token))
            return false;
    }
    if (!pbrt_state_closed(reader))
        return false;
    if (!reader->in_world)
        return pbrt_report_error(reader, &token.pos, "the scene has no WorldBegin");
    return true;
}
