#include "master/pbrt.h"

#include "common/effects.h"
#include "common/err.h"
#include "common/scene.h"
#include "master/number.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PI         3.14159265358979323846
#define COUNT(a)   (sizeof(a) / sizeof((a)[0]))
#define NOTES_MOST 200  /* different notes that are kept */
#define STACK_MOST 4096 /* AttributeBegins inside each other */

struct pbrt_system {
    const char *name;
    size_t length;
    struct transform transform;
};

/* --- Reporting ---------------------------------------------------------------------------- */

bool pbrt_no_memory(struct pbrt_reader *reader)
{
    return err_set(reader->err, ERR_MEMORY, "no memory to read the scene");
}

bool pbrt_fail(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
{
    char text[768];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    return err_set(reader->err, ERR_SCENE, "%s:%d:%d: %s", pos->path, pos->line, pos->column, text);
}

static void add_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *text)
{
    struct pbrt_note *notes = reader->notes.data;
    for (size_t i = 0; i < reader->notes.count; i++)
        if (strcmp(notes[i].text, text) == 0) {
            notes[i].count++;
            return;
        }
    if (reader->notes.count == NOTES_MOST)
        return;
    char *copy = strdup(text);
    struct pbrt_note *added = copy != NULL ? growing_add(&reader->notes, 1, sizeof(*added)) : NULL;
    if (added == NULL) {
        free(copy); /* a note is not worth failing for */
        return;
    }
    *added = (struct pbrt_note){ copy, *pos, 1 };
}

void pbrt_note(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
{
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    add_note(reader, pos, text);
}

bool pbrt_later(struct pbrt_reader *reader, const struct source_pos *pos, const char *format, ...)
{
    char what[400], text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(what, sizeof(what), format, args);
    va_end(args);
    if (!reader->lenient)
        return err_set(reader->err, ERR_UNSUPPORTED, "%s:%d:%d: %s is not supported yet", pos->path,
                       pos->line, pos->column, what);
    snprintf(text, sizeof(text), "%s is not supported yet; the picture lacks it", what);
    add_note(reader, pos, text);
    reader->warnings++;
    return true;
}

bool pbrt_name(struct pbrt_reader *reader, const char *kind, const struct pbrt_name *names,
               size_t count, const struct pbrt_token *token, const struct pbrt_name **found)
{
    const struct pbrt_name *name = pbrt_names_find(names, count, token);
    int length = (int)(token->length < 100 ? token->length : 100);
    *found = NULL;
    if (name == NULL)
        return pbrt_fail(reader, &token->pos, "unknown %s \"%.*s\"; the nearest is \"%s\"", kind,
                         length, token->text, pbrt_names_nearest(names, count, token));
    if (name->state == NAME_OLD)
        return pbrt_fail(reader, &token->pos, "%s \"%s\" is of pbrt-v3: %s", kind, name->text,
                         name->hint);
    if (name->state == NAME_LATER)
        return pbrt_later(reader, &token->pos, "%s \"%s\"", kind, name->text);
    *found = name;
    return true;
}

/* --- Tokens of a directive ---------------------------------------------------------------- */

static bool next_string(struct pbrt_reader *reader, const struct pbrt_token *directive,
                        struct pbrt_token *token)
{
    if (!pbrt_lexer_next(reader->lexer, token, reader->err))
        return false;
    if (token->kind != TOKEN_STRING)
        return pbrt_fail(reader, &token->pos, "%.*s wants a name in quotes here",
                         (int)directive->length, directive->text);
    return true;
}

/* `count` numbers, in brackets or without */
static bool next_numbers(struct pbrt_reader *reader, const struct pbrt_token *directive, int count,
                         double *values)
{
    struct pbrt_token token;
    if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
        return false;
    bool bracket = token.kind == TOKEN_OPEN;
    for (int i = 0; i < count; i++) {
        if ((i > 0 || bracket) && !pbrt_lexer_next(reader->lexer, &token, reader->err))
            return false;
        if (token.kind != TOKEN_WORD ||
            !number_parse(token.text, token.text + token.length, &values[i]))
            return pbrt_fail(reader, &token.pos, "%.*s wants %d numbers", (int)directive->length,
                             directive->text, count);
        if (!isfinite(values[i]))
            return pbrt_fail(reader, &token.pos, "\"%.*s\" is not a finite number",
                             (int)token.length, token.text);
    }
    if (!bracket)
        return true;
    if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
        return false;
    if (token.kind != TOKEN_CLOSE)
        return pbrt_fail(reader, &token.pos, "%.*s wants %d numbers and then a ]",
                         (int)directive->length, directive->text, count);
    return true;
}

/* --- Transforms --------------------------------------------------------------------------- */

static bool set_ctm(struct pbrt_reader *reader, const struct pbrt_token *directive,
                    const struct transform *ctm)
{
    struct transform inverse;
    if (reader->state.only_end_time)
        return true;
    if (!transform_invert(ctm, &inverse))
        return pbrt_fail(reader, &directive->pos,
                         "after this %.*s the transform cannot be inverted: it flattens space",
                         (int)directive->length, directive->text);
    reader->state.ctm = *ctm;
    return true;
}

static bool concat(struct pbrt_reader *reader, const struct pbrt_token *directive,
                   const struct transform *transform)
{
    struct transform ctm = transform_mul(&reader->state.ctm, transform);
    return set_ctm(reader, directive, &ctm);
}

static bool on_identity(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform identity = transform_identity();
    return set_ctm(reader, directive, &identity);
}

static bool on_translate(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[3];
    if (!next_numbers(reader, directive, 3, v))
        return false;
    struct transform translate = transform_translate(v[0], v[1], v[2]);
    return concat(reader, directive, &translate);
}

static bool on_scale(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[3];
    if (!next_numbers(reader, directive, 3, v))
        return false;
    struct transform scale = transform_scale(v[0], v[1], v[2]);
    return concat(reader, directive, &scale);
}

static bool on_rotate(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[4];
    struct transform rotation;
    if (!next_numbers(reader, directive, 4, v))
        return false;
    if (!transform_rotate(fmod(v[0], 360) * (PI / 180), v + 1, &rotation))
        return pbrt_fail(reader, &directive->pos, "Rotate wants an axis that is not zero");
    return concat(reader, directive, &rotation);
}

static bool on_look_at(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[9];
    struct transform look;
    if (!next_numbers(reader, directive, 9, v))
        return false;
    if (!transform_look_at(v, v + 3, v + 6, &look))
        return pbrt_fail(reader, &directive->pos,
                         "LookAt's eye, target and up vector do not span a view");
    return concat(reader, directive, &look);
}

/* The sixteen numbers stand column by column */
static bool next_matrix(struct pbrt_reader *reader, const struct pbrt_token *directive,
                        struct transform *matrix)
{
    double v[16];
    if (!next_numbers(reader, directive, 16, v))
        return false;
    for (int i = 0; i < 16; i++)
        matrix->m[i % 4][i / 4] = v[i];
    if (!transform_is_affine(matrix))
        return pbrt_later(reader, &directive->pos, "a projective transform") &&
               pbrt_fail(reader, &directive->pos, "the last row of a matrix must be 0 0 0 1");
    return true;
}

static bool on_transform(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform matrix;
    return next_matrix(reader, directive, &matrix) && set_ctm(reader, directive, &matrix);
}

static bool on_concat(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform matrix;
    return next_matrix(reader, directive, &matrix) && concat(reader, directive, &matrix);
}

static struct pbrt_system *find_system(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    struct pbrt_system *systems = reader->systems.data;
    for (size_t i = 0; i < reader->systems.count; i++)
        if (systems[i].length == name->length &&
            memcmp(systems[i].name, name->text, name->length) == 0)
            return &systems[i];
    return NULL;
}

static bool on_coordinate_system(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!next_string(reader, directive, &name))
        return false;
    struct pbrt_system *system = find_system(reader, &name);
    if (system == NULL)
        system = growing_add(&reader->systems, 1, sizeof(*system));
    if (system == NULL)
        return pbrt_no_memory(reader);
    *system = (struct pbrt_system){ name.text, name.length, reader->state.ctm };
    return true;
}

static bool on_coord_sys_transform(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!next_string(reader, directive, &name))
        return false;
    struct pbrt_system *system = find_system(reader, &name);
    if (system != NULL)
        return set_ctm(reader, directive, &system->transform);
    if (pbrt_token_is(&name, "camera"))
        return set_ctm(reader, directive, &reader->camera_space);
    if (pbrt_token_is(&name, "world"))
        return on_identity(reader, directive);
    return pbrt_fail(reader, &name.pos, "no coordinate system \"%.*s\"", (int)name.length,
                     name.text);
}

static bool on_reverse_orientation(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    (void)directive;
    reader->state.reverse_orientation = !reader->state.reverse_orientation;
    return true;
}

static bool on_active_transform(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token which;
    if (!pbrt_lexer_next(reader->lexer, &which, reader->err))
        return false;
    if (!pbrt_token_is(&which, "All") && !pbrt_token_is(&which, "StartTime") &&
        !pbrt_token_is(&which, "EndTime"))
        return pbrt_fail(reader, &which.pos, "ActiveTransform is All, StartTime or EndTime");
    reader->state.only_end_time = pbrt_token_is(&which, "EndTime");
    return pbrt_token_is(&which, "All") ||
           pbrt_later(reader, &directive->pos, "motion (ActiveTransform)");
}

static bool on_transform_times(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[2];
    return next_numbers(reader, directive, 2, v); /* nothing moves between them */
}

/* --- The attribute stack ------------------------------------------------------------------ */

struct pbrt_frame {
    struct pbrt_state state;
    struct source_pos pos;
};

static bool on_attribute_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->stack.count == STACK_MOST)
        return pbrt_fail(reader, &directive->pos, "more than %d AttributeBegins inside each other",
                         STACK_MOST);
    struct pbrt_frame *frame = growing_add(&reader->stack, 1, sizeof(*frame));
    if (frame == NULL)
        return pbrt_no_memory(reader);
    for (int i = 0; i < TARGETS; i++) {
        reader->state.defaults[i].items = reader->defaults[i].items.count;
        reader->state.defaults[i].numbers = reader->defaults[i].numbers.count;
        reader->state.defaults[i].strings = reader->defaults[i].strings.count;
    }
    *frame = (struct pbrt_frame){ reader->state, directive->pos };
    return true;
}

static bool on_attribute_end(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->stack.count == 0)
        return pbrt_fail(reader, &directive->pos, "AttributeEnd without an AttributeBegin");
    const struct pbrt_frame *frame = (struct pbrt_frame *)reader->stack.data +
                                     --reader->stack.count;
    reader->state = frame->state;
    for (int i = 0; i < TARGETS; i++) {
        reader->defaults[i].items.count = reader->state.defaults[i].items;
        reader->defaults[i].numbers.count = reader->state.defaults[i].numbers;
        reader->defaults[i].strings.count = reader->state.defaults[i].strings;
    }
    return true;
}

static bool on_attribute(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    static const struct pbrt_name targets[] = {
        { "shape", TARGET_SHAPE, NAME_OURS, NULL },
        { "light", TARGET_LIGHT, NAME_OURS, NULL },
        { "material", TARGET_MATERIAL, NAME_OURS, NULL },
        { "medium", TARGET_MEDIUM, NAME_OURS, NULL },
        { "texture", TARGET_TEXTURE, NAME_OURS, NULL },
    };
    struct pbrt_token target;
    const struct pbrt_name *found;
    return next_string(reader, directive, &target) &&
           pbrt_name(reader, "target of Attribute", targets, COUNT(targets), &target, &found) &&
           pbrt_params_read(&reader->params, "Attribute", &target, NULL) &&
           pbrt_params_append(&reader->defaults[found->value], &reader->params);
}

static bool on_object_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!next_string(reader, directive, &name) ||
        !pbrt_later(reader, &directive->pos, "instancing (ObjectBegin)") ||
        !on_attribute_begin(reader, directive))
        return false;
    struct source_pos *object = growing_add(&reader->objects, 1, sizeof(*object));
    if (object == NULL)
        return pbrt_no_memory(reader);
    *object = directive->pos;
    return true;
}

static bool on_object_end(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->objects.count == 0)
        return pbrt_fail(reader, &directive->pos, "ObjectEnd without an ObjectBegin");
    reader->objects.count--;
    return on_attribute_end(reader, directive);
}

static bool on_object_instance(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    return next_string(reader, directive, &name) &&
           pbrt_later(reader, &directive->pos, "instancing (ObjectInstance)");
}

/* --- Directives with parameters ----------------------------------------------------------- */

static bool typed(struct pbrt_reader *reader, const struct pbrt_token *directive, int target,
                  struct pbrt_token *type)
{
    char name[32];
    snprintf(name, sizeof(name), "%.*s", (int)directive->length, directive->text);
    return next_string(reader, directive, type) &&
           pbrt_params_read(&reader->params, name, type,
                            target < TARGETS ? &reader->defaults[target] : NULL);
}

#define TYPED(function, target, handler)                                                 \
    static bool function(struct pbrt_reader *reader, const struct pbrt_token *directive) \
    {                                                                                    \
        struct pbrt_token type;                                                          \
        return typed(reader, directive, (target), &type) && handler(reader, &type);      \
    }

TYPED(on_camera, TARGETS, pbrt_view_camera)
TYPED(on_film, TARGETS, pbrt_view_film)
TYPED(on_filter, TARGETS, pbrt_view_filter)
TYPED(on_sampler, TARGETS, pbrt_view_sampler)
TYPED(on_integrator, TARGETS, pbrt_view_integrator)
TYPED(on_material, TARGET_MATERIAL, pbrt_materials_set)
TYPED(on_make_named_material, TARGET_MATERIAL, pbrt_materials_define)
TYPED(on_light, TARGET_LIGHT, pbrt_lights_add)
TYPED(on_area_light, TARGET_LIGHT, pbrt_lights_area)
TYPED(on_shape, TARGET_SHAPE, pbrt_shapes_add)
#undef TYPED

static bool on_accelerator(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token type;
    if (!typed(reader, directive, TARGETS, &type))
        return false;
    pbrt_note(reader, &directive->pos, "Accelerator \"%.*s\" is not used: Embree builds its own",
              (int)type.length, type.text);
    return true;
}

static bool on_named_material(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    return next_string(reader, directive, &name) && pbrt_materials_use(reader, &name);
}

static bool on_color_space(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    static const struct pbrt_name spaces[] = {
        { "srgb", 0, NAME_OURS, NULL },
        { "aces2065-1", 0, NAME_LATER, NULL },
        { "dci-p3", 0, NAME_LATER, NULL },
        { "rec2020", 0, NAME_LATER, NULL },
    };
    struct pbrt_token name;
    const struct pbrt_name *found;
    return next_string(reader, directive, &name) &&
           pbrt_name(reader, "color space", spaces, COUNT(spaces), &name, &found);
}

static bool on_option(struct pbrt_reader *reader, const struct pbrt_token *directive)
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
    if (!next_string(reader, directive, &name))
        return false;
    const char *space = memchr(name.text, ' ', name.length); /* "bool wavefront" */
    if (space != NULL) {
        name.length -= (size_t)(space + 1 - name.text);
        name.text = space + 1;
    }
    if (!pbrt_name(reader, "option", options, COUNT(options), &name, &found) ||
        !pbrt_lexer_next(reader->lexer, &value, reader->err))
        return false;
    bool bracket = value.kind == TOKEN_OPEN;
    if (bracket && !pbrt_lexer_next(reader->lexer, &value, reader->err))
        return false;
    if (value.kind != TOKEN_WORD && value.kind != TOKEN_STRING)
        return pbrt_fail(reader, &value.pos, "Option wants a value");
    bool on = !pbrt_token_is(&value, "false");
    if (bracket &&
        (!pbrt_lexer_next(reader->lexer, &value, reader->err) || value.kind != TOKEN_CLOSE))
        return pbrt_fail(reader, &value.pos, "Option wants one value");
    return found->value == HARMLESS || !on ||
           pbrt_later(reader, &name.pos, "option \"%s\"", found->text);
}

static bool on_include(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!next_string(reader, directive, &name))
        return false;
    const char *path = pbrt_lexer_resolve(reader->lexer, &name);
    if (path == NULL)
        return pbrt_fail(reader, &name.pos, "no file can be read from here");
    return pbrt_lexer_open(reader->lexer, path, &name.pos, reader->err);
}

/* Texture "name" "type" "class" parameters */
static bool on_texture(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name, type, class;
    return next_string(reader, directive, &name) && next_string(reader, directive, &type) &&
           next_string(reader, directive, &class) &&
           pbrt_later(reader, &directive->pos, "Texture") &&
           pbrt_params_read(&reader->params, "Texture", &class, NULL);
}

static bool on_named_medium(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    return next_string(reader, directive, &name) &&
           pbrt_later(reader, &directive->pos, "MakeNamedMedium") &&
           pbrt_params_read(&reader->params, "MakeNamedMedium", &name, NULL);
}

static bool on_medium_interface(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!next_string(reader, directive, &name) ||
        !pbrt_later(reader, &directive->pos, "MediumInterface") ||
        !pbrt_lexer_peek(reader->lexer, &name, reader->err))
        return false;
    return name.kind != TOKEN_STRING || pbrt_lexer_next(reader->lexer, &name, reader->err);
}

static bool on_world_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->in_world)
        return pbrt_fail(reader, &directive->pos, "a second WorldBegin");
    reader->in_world = true;
    reader->state.only_end_time = false;
    return on_identity(reader, directive);
}

/* --- All directives ----------------------------------------------------------------------- */

enum place { ANYWHERE, BEFORE_WORLD, IN_WORLD };

static const struct directive {
    const char *name;
    enum place place;
    bool (*read)(struct pbrt_reader *reader, const struct pbrt_token *directive);
    const char *old; /* pbrt-v3's: what pbrt-v4 says instead */
} directives[] = {
    { "Accelerator", BEFORE_WORLD, on_accelerator, NULL },
    { "ActiveTransform", ANYWHERE, on_active_transform, NULL },
    { "AreaLightSource", IN_WORLD, on_area_light, NULL },
    { "Attribute", ANYWHERE, on_attribute, NULL },
    { "AttributeBegin", IN_WORLD, on_attribute_begin, NULL },
    { "AttributeEnd", IN_WORLD, on_attribute_end, NULL },
    { "Camera", BEFORE_WORLD, on_camera, NULL },
    { "ColorSpace", ANYWHERE, on_color_space, NULL },
    { "ConcatTransform", ANYWHERE, on_concat, NULL },
    { "CoordinateSystem", ANYWHERE, on_coordinate_system, NULL },
    { "CoordSysTransform", ANYWHERE, on_coord_sys_transform, NULL },
    { "Film", BEFORE_WORLD, on_film, NULL },
    { "Identity", ANYWHERE, on_identity, NULL },
    { "Import", IN_WORLD, on_include, NULL },
    { "Include", ANYWHERE, on_include, NULL },
    { "Integrator", BEFORE_WORLD, on_integrator, NULL },
    { "LightSource", IN_WORLD, on_light, NULL },
    { "LookAt", ANYWHERE, on_look_at, NULL },
    { "MakeNamedMaterial", IN_WORLD, on_make_named_material, NULL },
    { "MakeNamedMedium", ANYWHERE, on_named_medium, NULL },
    { "Material", IN_WORLD, on_material, NULL },
    { "MediumInterface", ANYWHERE, on_medium_interface, NULL },
    { "NamedMaterial", IN_WORLD, on_named_material, NULL },
    { "ObjectBegin", IN_WORLD, on_object_begin, NULL },
    { "ObjectEnd", IN_WORLD, on_object_end, NULL },
    { "ObjectInstance", IN_WORLD, on_object_instance, NULL },
    { "Option", BEFORE_WORLD, on_option, NULL },
    { "PixelFilter", BEFORE_WORLD, on_filter, NULL },
    { "Renderer", ANYWHERE, NULL, "Integrator" },
    { "ReverseOrientation", IN_WORLD, on_reverse_orientation, NULL },
    { "Rotate", ANYWHERE, on_rotate, NULL },
    { "Sampler", BEFORE_WORLD, on_sampler, NULL },
    { "Scale", ANYWHERE, on_scale, NULL },
    { "Shape", IN_WORLD, on_shape, NULL },
    { "SurfaceIntegrator", ANYWHERE, NULL, "Integrator" },
    { "Texture", IN_WORLD, on_texture, NULL },
    { "Transform", ANYWHERE, on_transform, NULL },
    { "TransformBegin", ANYWHERE, NULL, "AttributeBegin" },
    { "TransformEnd", ANYWHERE, NULL, "AttributeEnd" },
    { "TransformTimes", ANYWHERE, on_transform_times, NULL },
    { "Translate", ANYWHERE, on_translate, NULL },
    { "VolumeIntegrator", ANYWHERE, NULL, "Integrator" },
    { "WorldBegin", ANYWHERE, on_world_begin, NULL },
    { "WorldEnd", ANYWHERE, NULL, "nothing: the world ends with the file" },
};

static bool unknown_directive(struct pbrt_reader *reader, const struct pbrt_token *token)
{
    const char *names[COUNT(directives)];
    size_t count = 0;
    for (size_t i = 0; i < COUNT(directives); i++)
        if (directives[i].old == NULL)
            names[count++] = directives[i].name;
    int length = (int)(token->length < 64 ? token->length : 64);
    return pbrt_fail(reader, &token->pos, "unknown directive \"%.*s\"; the nearest is \"%s\"",
                     length, token->text,
                     pbrt_names_nearest_of(names, count, token->text, token->length));
}

static bool read_directive(struct pbrt_reader *reader, const struct pbrt_token *token)
{
    if (token->kind != TOKEN_WORD)
        return pbrt_fail(reader, &token->pos, "a directive is wanted here, not %s%.*s%s",
                         token->kind == TOKEN_STRING ? "the string \"" : "",
                         (int)(token->length < 64 ? token->length : 64), token->text,
                         token->kind == TOKEN_STRING ? "\"" : "");
    for (size_t i = 0; i < COUNT(directives); i++) {
        const struct directive *directive = &directives[i];
        if (!pbrt_token_is(token, directive->name))
            continue;
        if (directive->old != NULL)
            return pbrt_fail(reader, &token->pos, "%s is of pbrt-v3: pbrt-v4 has %s",
                             directive->name, directive->old);
        if (directive->place == BEFORE_WORLD && reader->in_world)
            return pbrt_fail(reader, &token->pos, "%s must come before WorldBegin",
                             directive->name);
        if (directive->place == IN_WORLD && !reader->in_world)
            return pbrt_fail(reader, &token->pos, "%s must come after WorldBegin", directive->name);
        return directive->read(reader, token);
    }
    return unknown_directive(reader, token);
}

static bool read_all(struct pbrt_reader *reader)
{
    struct pbrt_token token;
    for (;;) {
        if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
            return false;
        if (token.kind == TOKEN_END)
            break;
        if (!read_directive(reader, &token))
            return false;
    }
    if (reader->stack.count > 0) {
        const struct pbrt_frame *frames = reader->stack.data;
        return pbrt_fail(reader, &frames[reader->stack.count - 1].pos,
                         "this block is not closed at the end of the file");
    }
    if (!reader->in_world)
        return pbrt_fail(reader, &token.pos, "the scene has no WorldBegin");
    return true;
}

/* --- The scene ---------------------------------------------------------------------------- */

static bool reader_open(struct pbrt_reader *reader, bool lenient, struct err *err)
{
    *reader = (struct pbrt_reader){ .err = err, .lenient = lenient };
    reader->lexer = pbrt_lexer_new();
    reader->build = scene_build_new();
    reader->camera_space = transform_identity();
    reader->state.ctm = transform_identity();
    reader->state.emitter = SCENE_NONE;
    reader->params.reader = reader;
    for (int i = 0; i < TARGETS; i++)
        reader->defaults[i].reader = reader;
    if (reader->lexer == NULL || reader->build == NULL)
        return pbrt_no_memory(reader);
    pbrt_view_defaults(&reader->view);
    /* pbrt's default filter; ours of scene_new is the plain box */
    reader->build->scene->settings.filter = (struct filter_spec){ .kind = FILTER_GAUSSIAN,
                                                                  .radius = { 1.5f, 1.5f },
                                                                  .sigma = 0.5f };
    return pbrt_materials_start(reader);
}

static void reader_close(struct pbrt_reader *reader)
{
    struct pbrt_note *notes = reader->notes.data;
    for (size_t i = 0; i < reader->notes.count; i++)
        free(notes[i].text);
    growing_free(&reader->notes);
    growing_free(&reader->systems);
    growing_free(&reader->stack);
    growing_free(&reader->objects);
    pbrt_params_free(&reader->params);
    for (int i = 0; i < TARGETS; i++)
        pbrt_params_free(&reader->defaults[i]);
    growing_free(&reader->materials);
    growing_free(&reader->material_names);
    growing_free(&reader->mix_names);
    growing_free(&reader->coats);
    scene_build_free(reader->build);
    pbrt_lexer_free(reader->lexer);
}

static void note_counts(struct pbrt_reader *reader, const struct build_counts *counts,
                        const struct scene *scene, const char *name)
{
    const struct source_pos pos = { name, 0, 0 };
    if (counts->degenerate_triangles > 0)
        pbrt_note(reader, &pos, "%llu triangles without area were left out",
                  (unsigned long long)counts->degenerate_triangles);
    if (scene->light_count == 0)
        pbrt_note(reader, &pos, "the scene has no light: the picture will be black");
    if (scene->triangle_count == 0 && scene->quadric_count == 0)
        pbrt_note(reader, &pos, "the scene has no shape");
}

/* As lines; positions and counts are written out */
static void hand_over_notes(const struct pbrt_reader *reader, struct pbrt_notes *out)
{
    const struct pbrt_note *notes = reader->notes.data;
    out->warnings = reader->warnings;
    out->lines = reader->notes.count > 0 ? calloc(reader->notes.count, sizeof(char *)) : NULL;
    for (size_t i = 0; out->lines != NULL && i < reader->notes.count; i++) {
        char where[32] = "", times[48] = "";
        if (notes[i].pos.line > 0)
            snprintf(where, sizeof(where), ":%d:%d", notes[i].pos.line, notes[i].pos.column);
        if (notes[i].count > 1)
            snprintf(times, sizeof(times), " (%llu times)", (unsigned long long)notes[i].count);
        if (asprintf(&out->lines[out->count], "%s%s: %s%s", notes[i].pos.path, where, notes[i].text,
                     times) >= 0)
            out->count++;
    }
}

static struct scene *finish(struct pbrt_reader *reader, const char *name)
{
    struct build_counts counts;
    if (!pbrt_view_finish(reader))
        return NULL;
    struct scene *scene = scene_build_finish(reader->build, &counts, reader->err);
    if (scene != NULL)
        note_counts(reader, &counts, scene, name);
    return scene;
}

static struct scene *read_from(const char *path, const char *text, size_t length, const char *name,
                               const struct pbrt_options *options, struct pbrt_notes *notes,
                               struct err *err)
{
    struct pbrt_reader reader;
    struct scene *scene = NULL;
    if (reader_open(&reader, options != NULL && options->lenient, err)) {
        bool opened = path != NULL ? pbrt_lexer_open(reader.lexer, path, NULL, err)
                                   : pbrt_lexer_open_text(reader.lexer, text, length, name, err);
        if (opened && read_all(&reader))
            scene = finish(&reader, path != NULL ? path : name != NULL ? name : "text");
    }
    if (notes != NULL) {
        *notes = (struct pbrt_notes){ 0 };
        hand_over_notes(&reader, notes);
    }
    reader_close(&reader);
    return scene;
}

struct scene *pbrt_read(const char *path, const struct pbrt_options *options,
                        struct pbrt_notes *notes, struct err *err)
{
    return read_from(path, NULL, 0, NULL, options, notes, err);
}

struct scene *pbrt_read_text(const char *text, size_t length, const char *name,
                             const struct pbrt_options *options, struct pbrt_notes *notes,
                             struct err *err)
{
    return read_from(NULL, text, length, name, options, notes, err);
}

void pbrt_notes_free(struct pbrt_notes *notes)
{
    for (size_t i = 0; i < notes->count; i++)
        free(notes->lines[i]);
    free(notes->lines);
    *notes = (struct pbrt_notes){ 0 };
}

/* --- Changes afterwards ------------------------------------------------------------------- */

bool pbrt_set_crop(struct scene *scene, const double crop[4], struct err *err)
{
    struct scene_settings *settings = &scene->settings;
    const uint32_t size[4] = { settings->width, settings->width, settings->height,
                               settings->height };
    uint32_t pixels[4];
    for (int i = 0; i < 4; i++) {
        if (!(crop[i] >= 0 && crop[i] <= 1))
            return err_set(err, ERR_ARGUMENT, "a crop window of %g is outside 0 to 1", crop[i]);
        pixels[i] = (uint32_t)ceil(crop[i] * size[i] - 1e-6); /* a fraction may be rounded */
    }
    if (pixels[0] >= pixels[1] || pixels[2] >= pixels[3])
        return err_set(err, ERR_ARGUMENT, "the crop window %g %g %g %g holds no pixel", crop[0],
                       crop[1], crop[2], crop[3]);
    memcpy(settings->crop, pixels, sizeof(pixels));
    return true;
}

/* Stretch [low, high] about its middle to a length */
static void stretch(float side[2], double length)
{
    double middle = ((double)side[0] + side[1]) / 2;
    double half = side[1] >= side[0] ? length / 2 : -length / 2;
    side[0] = (float)(middle - half);
    side[1] = (float)(middle + half);
}

bool pbrt_set_resolution(struct scene *scene, uint32_t width, uint32_t height, struct err *err)
{
    struct scene_settings *settings = &scene->settings;
    float *screen = settings->camera.screen;
    if (width < 1 || width > 65536 || height < 1 || height > 65536)
        return err_set(err, ERR_ARGUMENT, "a resolution of %ux%u is outside 1..65536", width,
                       height);
    double crop[4];
    for (int i = 0; i < 4; i++)
        crop[i] = (double)settings->crop[i] / (i < 2 ? settings->width : settings->height);

    double x = fabs((double)screen[1] - screen[0]), y = fabs((double)screen[3] - screen[2]);
    double shape = (double)settings->width / settings->height;
    if (fabs(x - y * shape) <= 1e-5 * x) {
        double shorter = fmin(x, y), aspect = (double)width / height;
        stretch(screen, aspect > 1 ? shorter * aspect : shorter);
        stretch(screen + 2, aspect > 1 ? shorter : shorter / aspect);
    }
    settings->width = width;
    settings->height = height;
    if (pbrt_set_crop(scene, crop, NULL))
        return true;
    const uint32_t all[4] = { 0, width, 0, height }; /* the window fell between pixels */
    memcpy(settings->crop, all, sizeof(all));
    return true;
}
