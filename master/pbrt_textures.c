#include "master/pbrt_textures.h"

#include "master/number.h"
#include "master/pbrt_args.h"
#include "master/pbrt_color.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define COUNT(a)    (sizeof(a) / sizeof((a)[0]))
#define PARTS_MAX   64 /* that one texture is made of; bounds the work for one point of a surface */
#define OCTAVES_MAX 64

struct pbrt_texture {
    const char *name; /* not terminated; NULL: a normal map, which has none */
    size_t name_length;
    bool spectrum;
    struct texture texture; /* as in the scene, but that children are definitions */
    double value[4][3];     /* what stands where it has no child */
    double map[12];
    unsigned parts; /* with those of its children */

    /* TEXTURE_IMAGE */
    const char *path;
    struct source_pos path_pos;
    struct picture_wish wish;

    uint32_t in_scene; /* 1 + index, or 0 */
};

void pbrt_textures_free(struct pbrt_textures *textures)
{
    growing_free(&textures->definitions);
}

static struct pbrt_texture *definitions(const struct pbrt_reader *reader)
{
    return reader->textures.definitions.data;
}

/* Add it, and return 1 + its place; 0 when memory runs out */
static uint32_t add_definition(struct pbrt_reader *reader, const struct pbrt_texture *definition)
{
    struct growing *all = &reader->textures.definitions;
    struct pbrt_texture *added = growing_add(all, 1, sizeof(*added));
    if (added == NULL) {
        pbrt_report_no_memory(reader);
        return 0;
    }
    *added = *definition;
    return (uint32_t)all->count;
}

/* --- Names -------------------------------------------------------------------------------- */

static const char *type_name(bool spectrum)
{
    return spectrum ? "spectrum" : "float";
}

static const struct pbrt_texture *find_name(const struct pbrt_reader *reader,
                                            const struct pbrt_token *name, bool spectrum)
{
    const struct pbrt_texture *all = definitions(reader);
    for (size_t i = 0; i < reader->textures.definitions.count; i++)
        if (all[i].name != NULL && all[i].spectrum == spectrum &&
            all[i].name_length == name->length &&
            memcmp(all[i].name, name->text, name->length) == 0)
            return &all[i];
    return NULL;
}

static bool no_such_texture(struct pbrt_reader *reader, const struct pbrt_token *name,
                            bool spectrum)
{
    if (find_name(reader, name, !spectrum) != NULL)
        return pbrt_report_error(
            reader, &name->pos, "\"%.*s\" is a %s texture, and a %s texture is wanted here",
            (int)name->length, name->text, type_name(!spectrum), type_name(spectrum));

    /* The first few hundred are enough to be helpful */
    char texts[256][48];
    const char *list[256];
    size_t count = 0;
    const struct pbrt_texture *all = definitions(reader);
    for (size_t i = 0; i < reader->textures.definitions.count && count < COUNT(list); i++) {
        if (all[i].spectrum != spectrum || all[i].name == NULL)
            continue;
        size_t length = all[i].name_length < sizeof(texts[0]) ? all[i].name_length
                                                              : sizeof(texts[0]) - 1;
        memcpy(texts[count], all[i].name, length);
        texts[count][length] = '\0';
        list[count] = texts[count];
        count++;
    }
    if (count == 0)
        return pbrt_report_error(reader, &name->pos,
                                 "no texture \"%.*s\": no %s texture has been named",
                                 (int)name->length, name->text, type_name(spectrum));
    return pbrt_report_error(reader, &name->pos, "no %s texture \"%.*s\"; the nearest is \"%s\"",
                             type_name(spectrum), (int)name->length, name->text,
                             pbrt_names_nearest_of(list, count, name->text, name->length));
}

/* --- Parameters that may be textures ------------------------------------------------------ */

uint32_t pbrt_textures_take(struct pbrt_params *params, const char *name, bool spectrum)
{
    const struct pbrt_token *token = pbrt_params_texture(params, name);
    if (token == NULL || params->failed)
        return 0;
    const struct pbrt_texture *found = find_name(params->reader, token, spectrum);
    if (found == NULL) {
        params->failed = !no_such_texture(params->reader, token, spectrum);
        return 0;
    }
    bool varies = found->texture.kind != TEXTURE_CONSTANT;
    pbrt_params_replace(params, name, spectrum ? PARAM_RGB : PARAM_FLOAT, found->value[0],
                        varies     ? 0
                        : spectrum ? 3
                                   : 1);
    return varies ? (uint32_t)(found - definitions(params->reader)) + 1 : 0;
}

/* --- Mappings ----------------------------------------------------------------------------- */

static bool texture_from_world(struct pbrt_params *params, struct transform *out)
{
    const struct transform *ctm = &params->reader->state.ctm;
    if (transform_is_affine(ctm) && transform_invert(ctm, out))
        return true;
    pbrt_params_fail(params, NULL, "a texture's space must be affine");
    return false;
}

/* The point itself, for textures of three dimensions and mappings of points */
static void map_point(struct pbrt_params *params, enum texture_mapping mapping,
                      struct pbrt_texture *definition)
{
    struct transform m;
    definition->texture.mapping = mapping;
    if (!texture_from_world(params, &m))
        return;
    for (int i = 0; i < 12; i++)
        definition->map[i] = m.m[i / 4][i % 4];
}

static void map_planar(struct pbrt_params *params, struct pbrt_texture *definition)
{
    double v[2][3] = { { 1, 0, 0 }, { 0, 1, 0 } };
    pbrt_params_point(params, "v1", v[0]);
    pbrt_params_point(params, "v2", v[1]);
    double delta[2] = { pbrt_params_float(params, "udelta", 0),
                        pbrt_params_float(params, "vdelta", 0) };
    struct transform m;
    definition->texture.mapping = MAPPING_PLANAR;
    if (!texture_from_world(params, &m))
        return;
    for (int row = 0; row < 2; row++)
        for (int column = 0; column < 4; column++) {
            double sum = column == 3 ? delta[row] : 0;
            for (int axis = 0; axis < 3; axis++)
                sum += v[row][axis] * m.m[axis][column];
            definition->map[4 * row + column] = sum;
        }
}

static void map_uv(struct pbrt_params *params, struct pbrt_texture *definition)
{
    definition->texture.mapping = MAPPING_UV;
    definition->map[0] = pbrt_params_float(params, "uscale", 1);
    definition->map[4] = pbrt_params_float(params, "vscale", 1);
    definition->map[2] = pbrt_params_float(params, "udelta", 0);
    definition->map[5] = pbrt_params_float(params, "vdelta", 0);
}

/* A choice among names; `otherwise` when there is none, or none that we have and we are lenient */
static int choose(struct pbrt_params *params, const char *name, const char *kind,
                  const struct pbrt_name *names, size_t count, int otherwise)
{
    const struct pbrt_token *token = pbrt_params_string(params, name);
    const struct pbrt_name *found;
    if (token == NULL || params->failed)
        return otherwise;
    if (!pbrt_names_choose(params->reader, kind, names, count, token, &found)) {
        params->failed = true;
        return otherwise;
    }
    return found != NULL ? found->value : otherwise;
}

static void read_mapping(struct pbrt_params *params, struct pbrt_texture *definition)
{
    static const struct pbrt_name mappings[] = {
        { "uv", MAPPING_UV, NAME_OURS, NULL },
        { "planar", MAPPING_PLANAR, NAME_OURS, NULL },
        { "spherical", MAPPING_SPHERICAL, NAME_OURS, NULL },
        { "cylindrical", MAPPING_CYLINDRICAL, NAME_OURS, NULL },
    };
    int mapping = choose(params, "mapping", "texture mapping", mappings, COUNT(mappings),
                         MAPPING_UV);
    if (mapping == MAPPING_UV)
        map_uv(params, definition);
    else if (mapping == MAPPING_PLANAR)
        map_planar(params, definition);
    else
        map_point(params, (enum texture_mapping)mapping, definition);
}

/* --- Classes ------------------------------------------------------------------------------ */

/* A colour or a number, not a texture */
static void read_value(struct pbrt_params *params, struct pbrt_texture *definition, int i,
                       const char *name, bool spectrum, double otherwise)
{
    double *value = definition->value[i];
    value[0] = value[1] = value[2] = otherwise;
    if (spectrum)
        pbrt_color(params, name, COLOR_REFLECTANCE, value);
    else
        value[0] = value[1] = value[2] = pbrt_params_float(params, name, otherwise);
}

/* A texture, or a value in its place */
static void read_child(struct pbrt_params *params, struct pbrt_texture *definition, int i,
                       const char *name, bool spectrum, double otherwise)
{
    uint32_t *child = &definition->texture.child[i];
    *child = pbrt_textures_take(params, name, spectrum);
    read_value(params, definition, i, name, spectrum, otherwise);
    if (*child != 0)
        definition->parts += definitions(params->reader)[*child - 1].parts;
    if (definition->parts > PARTS_MAX)
        pbrt_params_fail(params, NULL, "this texture is made of more than %d textures", PARTS_MAX);
}

static void read_encoding(struct pbrt_params *params, struct picture_wish *wish)
{
    static const char gamma[] = "gamma ";
    const size_t length = sizeof(gamma) - 1;
    const struct pbrt_token *token = pbrt_params_string(params, "encoding");
    if (token == NULL)
        return;
    if (pbrt_token_is(token, "sRGB")) {
        wish->encoding = ENCODING_SRGB;
    } else if (pbrt_token_is(token, "linear")) {
        wish->encoding = ENCODING_LINEAR;
    } else if (token->length > length && memcmp(token->text, gamma, length) == 0 &&
               number_parse(token->text + length, token->text + token->length, &wish->gamma) &&
               wish->gamma > 0 && wish->gamma <= 100) {
        wish->encoding = ENCODING_GAMMA;
    } else {
        pbrt_params_fail(params, pbrt_params_find(params, "encoding"),
                         "\"%.*s\" is no encoding: there are \"sRGB\", \"linear\" and \"gamma "
                         "2.2\"",
                         (int)token->length, token->text);
    }
}

static void read_file_name(struct pbrt_params *params, const char *name,
                           struct pbrt_texture *definition)
{
    const struct pbrt_token *token = pbrt_params_string(params, name);
    if (token == NULL || params->failed)
        return;
    definition->path_pos = token->pos;
    definition->path = pbrt_lexer_resolve(params->reader->lexer, token);
    if (definition->path == NULL)
        pbrt_params_fail(params, pbrt_params_find(params, name), "no file can be read from here");
}

static void read_image(struct pbrt_params *params, struct pbrt_texture *definition)
{
    static const struct pbrt_name wraps[] = {
        { "repeat", WRAP_REPEAT, NAME_OURS, NULL },
        { "clamp", WRAP_CLAMP, NAME_OURS, NULL },
        { "black", WRAP_BLACK, NAME_OURS, NULL },
        { "octahedralsphere", 0, NAME_LATER, NULL },
    };
    enum { POINT, BILINEAR, TRILINEAR, ELLIPTIC };
    static const struct pbrt_name filters[] = {
        { "point", POINT, NAME_OURS, NULL },         { "bilinear", BILINEAR, NAME_OURS, NULL },
        { "trilinear", TRILINEAR, NAME_OURS, NULL }, { "ewa", ELLIPTIC, NAME_OURS, NULL },
        { "EWA", ELLIPTIC, NAME_OURS, NULL },
    };
    struct texture *texture = &definition->texture;
    read_file_name(params, "filename", definition);
    if (definition->path == NULL)
        pbrt_params_fail(params, NULL, "an imagemap wants \"string filename\"");
    int wrap = choose(params, "wrap", "wrap mode", wraps, COUNT(wraps), WRAP_REPEAT);
    int filter = choose(params, "filter", "texture filter", filters, COUNT(filters), BILINEAR);
    texture->wrap[0] = texture->wrap[1] = (uint32_t)wrap;
    if (filter == POINT)
        texture->flags |= TEXTURE_NEAREST;
    if (filter == ELLIPTIC)
        pbrt_report_note(params->reader, &params->pos,
                         "textures are filtered trilinearly, not elliptically");
    texture->scale = (float)pbrt_params_float(params, "scale", 1);
    if (pbrt_params_bool(params, "invert", false))
        texture->flags |= TEXTURE_INVERT;
    read_encoding(params, &definition->wish);
    pbrt_params_ignore(params, "maxanisotropy"); /* of the elliptic filter */
    definition->wish.pyramid = true;
    definition->wish.single = definition->wish.keep_negative = !definition->spectrum;
    texture->channel = definition->spectrum ? SCENE_NONE : 0;
    read_mapping(params, definition);
}

static void read_checkerboard(struct pbrt_params *params, struct pbrt_texture *definition)
{
    int64_t dimension = pbrt_params_integer(params, "dimension", 2);
    read_child(params, definition, 0, "tex1", definition->spectrum, 1);
    read_child(params, definition, 1, "tex2", definition->spectrum, 0);
    if (dimension == 3) {
        definition->texture.flags |= TEXTURE_THREE_SPACE;
        map_point(params, MAPPING_POINT, definition);
    } else if (dimension == 2) {
        read_mapping(params, definition);
    } else {
        pbrt_params_fail(params, pbrt_params_find(params, "dimension"),
                         "a checkerboard has 2 or 3 dimensions, not %lld", (long long)dimension);
    }
}

static void read_noise(struct pbrt_params *params, struct pbrt_texture *definition)
{
    struct texture *texture = &definition->texture;
    map_point(params, MAPPING_POINT, definition);
    if (texture->kind == TEXTURE_WINDY)
        return;
    int64_t octaves = pbrt_params_integer(params, "octaves", 8);
    if (octaves < 1 || octaves > OCTAVES_MAX)
        pbrt_params_fail(params, pbrt_params_find(params, "octaves"),
                         "%lld octaves are outside 1 to %d", (long long)octaves, OCTAVES_MAX);
    texture->octaves = (uint32_t)octaves;
    texture->omega = (float)pbrt_params_float(params, "roughness", 0.5);
    if (texture->kind != TEXTURE_MARBLE)
        return;
    texture->scale = (float)pbrt_params_float(params, "scale", 1);
    texture->variation = (float)pbrt_params_float(params, "variation", 0.2);
}

/* A direction in the world, unit */
static void read_direction(struct pbrt_params *params, struct pbrt_texture *definition)
{
    double way[3] = { 0, 1, 0 };
    pbrt_params_point(params, "dir", way);
    transform_vector(&params->reader->state.ctm, way, way);
    double length = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
    if (!(length > 0) || !isfinite(length))
        pbrt_params_fail(params, pbrt_params_find(params, "dir"), "\"dir\" has no direction");
    for (int axis = 0; axis < 3; axis++)
        definition->value[2][axis] = way[axis] / length;
}

static void read_class(struct pbrt_params *params, struct pbrt_texture *definition)
{
    bool spectrum = definition->spectrum;
    switch (definition->texture.kind) {
    case TEXTURE_CONSTANT:
        read_value(params, definition, 0, "value", spectrum, 1);
        break;
    case TEXTURE_IMAGE:
        read_image(params, definition);
        break;
    case TEXTURE_SCALE:
        read_child(params, definition, 0, "tex", spectrum, 1);
        read_child(params, definition, 1, "scale", false, 1);
        break;
    case TEXTURE_MIX:
        read_child(params, definition, 0, "tex1", spectrum, 0);
        read_child(params, definition, 1, "tex2", spectrum, 1);
        read_child(params, definition, 2, "amount", false, 0.5);
        break;
    case TEXTURE_CHECKERBOARD:
        read_checkerboard(params, definition);
        break;
    case TEXTURE_BILERP:
        read_value(params, definition, 0, "v00", spectrum, 0);
        read_value(params, definition, 1, "v01", spectrum, 1);
        read_value(params, definition, 2, "v10", spectrum, 0);
        read_value(params, definition, 3, "v11", spectrum, 1);
        read_mapping(params, definition);
        break;
    case TEXTURE_DOTS:
        read_child(params, definition, 0, "inside", spectrum, 1);
        read_child(params, definition, 1, "outside", spectrum, 0);
        read_mapping(params, definition);
        break;
    case TEXTURE_DIRECTION:
        read_child(params, definition, 0, "tex1", spectrum, 0);
        read_child(params, definition, 1, "tex2", spectrum, 1);
        read_direction(params, definition);
        break;
    default:
        read_noise(params, definition);
    }
}

/* --- What does not vary ------------------------------------------------------------------- */

static bool is_number(const struct pbrt_texture *definition, int i, double value)
{
    const double *v = definition->value[i];
    return definition->texture.child[i] == 0 && v[0] == value && v[1] == value && v[2] == value;
}

/* Become child i, or the value in its place */
static void become(const struct pbrt_reader *reader, struct pbrt_texture *definition, int i)
{
    struct pbrt_texture child = { .texture = { .kind = TEXTURE_CONSTANT }, .parts = 1 };
    memcpy(child.value[0], definition->value[i], sizeof(child.value[0]));
    if (definition->texture.child[i] != 0)
        child = definitions(reader)[definition->texture.child[i] - 1];
    child.name = definition->name;
    child.name_length = definition->name_length;
    child.spectrum = definition->spectrum;
    *definition = child;
}

static void fold_scale(const struct pbrt_reader *reader, struct pbrt_texture *definition)
{
    const uint32_t *child = definition->texture.child;
    if (child[0] == 0 && child[1] == 0)
        for (int c = 0; c < 3; c++)
            definition->value[0][c] *= definition->value[1][c];
    for (int i = 0; i < 2; i++) {
        double factor = definition->value[i][0];
        if (!is_number(definition, i, factor))
            continue;
        const struct texture *other = child[1 - i] != 0
                                          ? &definitions(reader)[child[1 - i] - 1].texture
                                          : NULL;
        if (child[1 - i] != 0 && factor == 1) {
            become(reader, definition, 1 - i);
            return;
        }
        if (other != NULL && other->kind == TEXTURE_IMAGE && !(other->flags & TEXTURE_INVERT)) {
            become(reader, definition, 1 - i);
            definition->texture.scale = (float)(definition->texture.scale * factor);
            definition->in_scene = 0;
            return;
        }
    }
    if (child[0] == 0 && child[1] == 0)
        become(reader, definition, 0);
}

/* A texture that is the same everywhere becomes a constant, one that is another becomes that */
static void fold(const struct pbrt_reader *reader, struct pbrt_texture *definition)
{
    const uint32_t *child = definition->texture.child;
    double *a = definition->value[0], *b = definition->value[1];
    double amount = definition->value[2][0];
    bool numbers = child[0] == 0 && child[1] == 0;
    switch (definition->texture.kind) {
    case TEXTURE_SCALE:
        fold_scale(reader, definition);
        break;
    case TEXTURE_MIX:
        if (is_number(definition, 2, 0) || is_number(definition, 2, 1)) {
            become(reader, definition, amount == 1);
        } else if (numbers && child[2] == 0) {
            for (int c = 0; c < 3; c++)
                a[c] = a[c] * (1 - amount) + b[c] * amount;
            become(reader, definition, 0);
        }
        break;
    case TEXTURE_CHECKERBOARD:
    case TEXTURE_DOTS:
    case TEXTURE_DIRECTION:
        if (numbers && memcmp(a, b, sizeof(definition->value[0])) == 0)
            become(reader, definition, 0);
        break;
    default:
        break;
    }
}

/* --- Definitions -------------------------------------------------------------------------- */

static const struct pbrt_name classes[] = {
    { "constant", TEXTURE_CONSTANT, NAME_OURS, NULL },
    { "imagemap", TEXTURE_IMAGE, NAME_OURS, NULL },
    { "scale", TEXTURE_SCALE, NAME_OURS, NULL },
    { "mix", TEXTURE_MIX, NAME_OURS, NULL },
    { "directionmix", TEXTURE_DIRECTION, NAME_OURS, NULL },
    { "checkerboard", TEXTURE_CHECKERBOARD, NAME_OURS, NULL },
    { "bilerp", TEXTURE_BILERP, NAME_OURS, NULL },
    { "dots", TEXTURE_DOTS, NAME_OURS, NULL },
    { "fbm", TEXTURE_FBM, NAME_OURS, NULL },
    { "wrinkled", TEXTURE_WRINKLED, NAME_OURS, NULL },
    { "windy", TEXTURE_WINDY, NAME_OURS, NULL },
    { "marble", TEXTURE_MARBLE, NAME_OURS, NULL },
    { "ptex", 0, NAME_LATER, NULL },
    { "uv", 0, NAME_OLD, "pbrt-v4 has no such texture" },
};

static const struct pbrt_name types[] = {
    { "float", false, NAME_OURS, NULL },
    { "spectrum", true, NAME_OURS, NULL },
    { "color", 0, NAME_OLD, "in pbrt-v4 it is \"spectrum\"" },
};

static bool has_type(uint32_t kind, bool spectrum)
{
    bool noise = kind == TEXTURE_FBM || kind == TEXTURE_WRINKLED || kind == TEXTURE_WINDY;
    return spectrum ? !noise : kind != TEXTURE_MARBLE;
}

bool pbrt_textures_define(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_params *params = &reader->params;
    struct pbrt_token name, type, class;
    const struct pbrt_name *found_type, *found;
    if (!pbrt_args_string(reader, directive, &name) ||
        !pbrt_args_string(reader, directive, &type) ||
        !pbrt_args_typed(reader, directive, TARGET_TEXTURE, &class) ||
        !pbrt_names_choose(reader, "type of texture", types, COUNT(types), &type, &found_type) ||
        !pbrt_names_choose(reader, "texture", classes, COUNT(classes), &class, &found))
        return false;
    struct pbrt_texture definition = {
        .name = name.text, .name_length = name.length, .spectrum = found_type->value, .parts = 1
    };
    struct texture *texture = &definition.texture;
    if (find_name(reader, &name, definition.spectrum) != NULL)
        return pbrt_report_error(reader, &name.pos, "%s texture \"%.*s\" is defined twice",
                                 type_name(definition.spectrum), (int)name.length, name.text);
    *texture = (struct texture){ .kind = TEXTURE_CONSTANT, .channel = SCENE_NONE, .scale = 1 };
    if (found == NULL) { /* lenient, and noted already: grey */
        for (int c = 0; c < 3; c++)
            definition.value[0][c] = 0.5;
        return add_definition(reader, &definition) != 0;
    }
    texture->kind = (uint32_t)found->value;
    if (!has_type(texture->kind, definition.spectrum))
        return pbrt_report_error(reader, &class.pos, "there is no %s texture \"%s\", but a %s one",
                                 type_name(definition.spectrum), found->text,
                                 type_name(!definition.spectrum));
    read_class(params, &definition);
    if (!pbrt_params_done(params))
        return false;
    fold(reader, &definition);
    return add_definition(reader, &definition) != 0;
}

uint32_t pbrt_textures_normal_map(struct pbrt_params *params, const char *name)
{
    struct pbrt_texture definition = {
        .texture = { .kind = TEXTURE_IMAGE,
                     .mapping = MAPPING_UV,
                     .channel = SCENE_NONE,
                     .scale = 1 },
        .map = { [0] = 1, [4] = 1 },
        .parts = 1,
        .wish = { .encoding = ENCODING_LINEAR, .pyramid = true, .keep_negative = true }
    };
    read_file_name(params, name, &definition);
    if (definition.path == NULL)
        return 0;
    uint32_t added = add_definition(params->reader, &definition);
    params->failed = params->failed || added == 0;
    return added;
}

/* --- Into the scene ----------------------------------------------------------------------- */

static bool read_picture(struct pbrt_reader *reader, struct pbrt_texture *definition)
{
    const struct source_pos *pos = &definition->path_pos;
    if (!scene_pictures_read(&reader->pictures, reader->build, definition->path, &definition->wish,
                             &definition->texture.picture, reader->err))
        return err_wrap(reader->err, "%s:%d:%d", pos->path, pos->line, pos->column);
    if (reader->pictures.mended > 0)
        pbrt_report_note(reader, pos, "%s: %llu texels that are no colour were clamped",
                         definition->path, (unsigned long long)reader->pictures.mended);
    if (reader->pictures.other_primaries)
        pbrt_report_note(reader, pos,
                         "%s: its colours are taken as linear sRGB, though it says "
                         "that they are not",
                         definition->path);
    return true;
}

static bool add_to_scene(struct pbrt_reader *reader, const struct texture *texture,
                         const double map[12], uint32_t *in_scene)
{
    struct growing *textures = &reader->build->textures;
    struct texture *added = growing_add(textures, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = *texture;
    *in_scene = (uint32_t)textures->count;
    for (int i = 0; i < 12; i++)
        added->map[i] = (float)map[i];
    if (texture->mapping == MAPPING_UV)
        return true;
    struct build_texture_space *space = growing_add(&reader->build->texture_spaces, 1,
                                                    sizeof(*space));
    if (space == NULL)
        return pbrt_report_no_memory(reader);
    space->texture = *in_scene - 1;
    memcpy(space->map, map, sizeof(space->map));
    return true;
}

/* No deeper than PARTS_MAX, for each level is a part */
bool pbrt_textures_resolve(struct pbrt_reader *reader, uint32_t *texture)
{
    if (*texture == 0)
        return true;
    struct pbrt_texture *definition = &definitions(reader)[*texture - 1];
    if (definition->in_scene == 0) {
        struct texture resolved = definition->texture;
        for (int i = 0; i < 3; i++)
            if (!pbrt_textures_resolve(reader, &resolved.child[i]))
                return false;
        if (resolved.kind == TEXTURE_IMAGE) {
            if (!read_picture(reader, definition))
                return false;
            resolved.picture = definition->texture.picture;
        }
        for (int i = 0; i < 12; i++)
            resolved.value[i / 3][i % 3] = (float)definition->value[i / 3][i % 3];
        if (!add_to_scene(reader, &resolved, definition->map, &definition->in_scene))
            return false;
    }
    *texture = definition->in_scene;
    return true;
}

bool pbrt_textures_resolve_number(struct pbrt_reader *reader, double value, uint32_t *texture)
{
    static const double nowhere[12];
    struct texture constant = { .kind = TEXTURE_CONSTANT, .channel = SCENE_NONE, .scale = 1 };
    for (int c = 0; c < 3; c++)
        constant.value[0][c] = (float)value;
    return add_to_scene(reader, &constant, nowhere, texture);
}

/* A picture without its smaller versions is what every footprint sees. Noises still leave out what
 * a footprint hides. */
void pbrt_textures_finish(struct pbrt_reader *reader)
{
    struct scene_picture *pictures = reader->build->pictures.data;
    for (size_t i = 0; reader->textures.unfiltered && i < reader->build->pictures.count; i++)
        pictures[i].levels = 1;
}
