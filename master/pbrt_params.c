#include "master/pbrt_params.h"

#include "common/err.h"
#include "master/number.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define PARAMS_MAX 256 /* in one list */

static const struct {
    const char *name;
    enum pbrt_param_type type;
} type_names[] = {
    { "float", PARAM_FLOAT },         { "integer", PARAM_INTEGER }, { "point2", PARAM_POINT2 },
    { "point3", PARAM_POINT3 },       { "point", PARAM_POINT3 },    { "vector2", PARAM_VECTOR2 },
    { "vector3", PARAM_VECTOR3 },     { "vector", PARAM_VECTOR3 },  { "normal", PARAM_NORMAL },
    { "normal3", PARAM_NORMAL },      { "bool", PARAM_BOOL },       { "string", PARAM_STRING },
    { "texture", PARAM_TEXTURE },     { "rgb", PARAM_RGB },         { "spectrum", PARAM_SPECTRUM },
    { "blackbody", PARAM_BLACKBODY }, { "color", PARAM_RGB },
};
#define TYPE_NAMES (sizeof(type_names) / sizeof(type_names[0]))

static const char *type_text(enum pbrt_param_type type)
{
    for (size_t i = 0; i < TYPE_NAMES; i++)
        if (type_names[i].type == type)
            return type_names[i].name;
    return "?";
}

static const struct pbrt_param *items(const struct pbrt_params *params)
{
    return params->items.data;
}

void pbrt_params_free(struct pbrt_params *params)
{
    growing_free(&params->items);
    growing_free(&params->numbers);
    growing_free(&params->strings);
}

/* --- Reading ------------------------------------------------------------------------------ */

/* "type name" between the quotes */
static bool parse_declaration(struct pbrt_params *params, const struct pbrt_token *token,
                              struct pbrt_param *param)
{
    const char *at = token->text, *end = token->text + token->length;
    while (at < end && (*at == ' ' || *at == '\t'))
        at++;
    const char *type = at;
    while (at < end && *at != ' ' && *at != '\t')
        at++;
    size_t type_length = (size_t)(at - type);
    while (at < end && (*at == ' ' || *at == '\t'))
        at++;
    const char *name = at;
    while (end > name && (end[-1] == ' ' || end[-1] == '\t'))
        end--;
    if (type_length == 0 || name == end)
        return pbrt_report_error(params->reader, &token->pos,
                                 "\"%.*s\" is not a parameter: a type and a name are wanted, as in "
                                 "\"float fov\"",
                                 (int)token->length, token->text);
    *param = (struct pbrt_param){ .name = name,
                                  .name_length = (size_t)(end - name),
                                  .pos = token->pos,
                                  .first_number = params->numbers.count,
                                  .first_string = params->strings.count };
    for (size_t i = 0; i < TYPE_NAMES; i++)
        if (strlen(type_names[i].name) == type_length &&
            memcmp(type_names[i].name, type, type_length) == 0) {
            param->type = type_names[i].type;
            return true;
        }
    const char *names[TYPE_NAMES];
    for (size_t i = 0; i < TYPE_NAMES; i++)
        names[i] = type_names[i].name;
    return pbrt_report_error(
        params->reader, &token->pos, "unknown parameter type \"%.*s\"; the nearest is \"%s\"",
        (int)type_length, type, pbrt_names_nearest_of(names, TYPE_NAMES, type, type_length));
}

static bool add_number(struct pbrt_params *params, const struct pbrt_param *param,
                       const struct pbrt_token *token)
{
    double value;
    if (param->type == PARAM_BOOL) {
        value = pbrt_token_is(token, "true");
        if (value == 0 && !pbrt_token_is(token, "false"))
            return pbrt_report_error(params->reader, &token->pos,
                                     "\"%.*s\" is neither true nor false", (int)token->length,
                                     token->text);
    } else if (!number_parse(token->text, token->text + token->length, &value)) {
        return pbrt_report_error(params->reader, &token->pos, "\"%.*s\" is not a number",
                                 (int)(token->length < 64 ? token->length : 64), token->text);
    }
    if (!isfinite(value))
        return pbrt_report_error(params->reader, &token->pos, "\"%.*s\" is not a finite number",
                                 (int)token->length, token->text);
    if (param->type == PARAM_INTEGER && (value != floor(value) || fabs(value) > 0x1p53))
        return pbrt_report_error(params->reader, &token->pos, "\"%.*s\" is not an integer",
                                 (int)token->length, token->text);
    double *added = growing_add(&params->numbers, 1, sizeof(double));
    if (added == NULL)
        return pbrt_report_no_memory(params->reader);
    *added = value;
    return true;
}

static bool add_value(struct pbrt_params *params, struct pbrt_param *param,
                      const struct pbrt_token *token)
{
    bool wants_string = param->type == PARAM_STRING || param->type == PARAM_TEXTURE ||
                        (param->type == PARAM_SPECTRUM && token->kind == TOKEN_STRING);
    if (wants_string != (token->kind == TOKEN_STRING) &&
        !(param->type == PARAM_BOOL && token->kind == TOKEN_STRING)) /* pbrt-v3's "true" */
        return pbrt_report_error(params->reader, &token->pos, "parameter \"%s %.*s\" wants %s",
                                 type_text(param->type), (int)param->name_length, param->name,
                                 wants_string ? "a string in quotes" : "a number, not a string");
    if (!wants_string)
        return add_number(params, param, token);
    struct pbrt_token *added = growing_add(&params->strings, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(params->reader);
    *added = *token;
    return true;
}

static bool read_values(struct pbrt_params *params, struct pbrt_param *param)
{
    struct pbrt_reader *reader = params->reader;
    struct pbrt_token token;
    if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
        return false;
    if (token.kind == TOKEN_OPEN) {
        for (;;) {
            if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
                return false;
            if (token.kind == TOKEN_CLOSE)
                break;
            if (token.kind == TOKEN_END || token.kind == TOKEN_OPEN)
                return pbrt_report_error(reader, &param->pos,
                                         "the values of \"%.*s\" have no closing bracket",
                                         (int)param->name_length, param->name);
            if (!add_value(params, param, &token))
                return false;
        }
    } else if (token.kind == TOKEN_END || token.kind == TOKEN_CLOSE) {
        return pbrt_report_error(reader, &param->pos, "parameter \"%.*s\" has no value",
                                 (int)param->name_length, param->name);
    } else if (!add_value(params, param, &token)) {
        return false;
    }
    param->number_count = params->numbers.count - param->first_number;
    param->string_count = params->strings.count - param->first_string;
    if (param->number_count + param->string_count == 0)
        return pbrt_report_error(reader, &param->pos, "parameter \"%.*s\" has no value",
                                 (int)param->name_length, param->name);
    return true;
}

static struct pbrt_param *find(const struct pbrt_params *params, const char *name, size_t length)
{
    for (size_t i = 0; i < params->items.count; i++) {
        struct pbrt_param *param = (struct pbrt_param *)params->items.data + i;
        if (param->name_length == length && memcmp(param->name, name, length) == 0)
            return param;
    }
    return NULL;
}

static bool append(struct pbrt_params *params, const struct pbrt_params *from, size_t index,
                   bool used)
{
    struct pbrt_param param = items(from)[index];
    const double *numbers = pbrt_params_numbers(from, &param);
    const struct pbrt_token *strings = pbrt_params_tokens(from, &param);
    param.first_number = params->numbers.count;
    param.first_string = params->strings.count;
    param.used = used;
    struct pbrt_param *item = growing_add(&params->items, 1, sizeof(param));
    double *to_numbers = growing_add(&params->numbers, param.number_count, sizeof(double));
    struct pbrt_token *to_strings = growing_add(&params->strings, param.string_count,
                                                sizeof(struct pbrt_token));
    if (item == NULL || to_numbers == NULL || to_strings == NULL)
        return pbrt_report_no_memory(params->reader);
    *item = param;
    if (numbers != NULL)
        memcpy(to_numbers, numbers, param.number_count * sizeof(double));
    if (strings != NULL)
        memcpy(to_strings, strings, param.string_count * sizeof(struct pbrt_token));
    return true;
}

bool pbrt_params_append(struct pbrt_params *params, const struct pbrt_params *from)
{
    for (size_t i = 0; i < from->items.count; i++)
        if (!append(params, from, i, false))
            return false;
    return true;
}

/* The last of a name wins, so that an Attribute inside another does. Nobody need ask for them. */
static bool add_defaults(struct pbrt_params *params, const struct pbrt_params *defaults)
{
    for (size_t i = defaults->items.count; i-- > 0;) {
        const struct pbrt_param *param = &items(defaults)[i];
        if (find(params, param->name, param->name_length) == NULL &&
            !append(params, defaults, i, true))
            return false;
    }
    return true;
}

bool pbrt_params_read(struct pbrt_params *params, const char *directive,
                      const struct pbrt_token *type, const struct pbrt_params *defaults)
{
    struct pbrt_reader *reader = params->reader;
    params->items.count = params->numbers.count = params->strings.count = 0;
    params->asked_count = 0;
    params->failed = false;
    params->pos = type->pos;
    snprintf(params->owner, sizeof(params->owner), "%s \"%.*s\"", directive,
             (int)(type->length < 40 ? type->length : 40), type->text);
    for (;;) {
        struct pbrt_token token;
        if (!pbrt_lexer_peek(reader->lexer, &token, reader->err))
            return false;
        if (token.kind != TOKEN_STRING)
            return defaults == NULL || add_defaults(params, defaults);
        struct pbrt_param param;
        if (!pbrt_lexer_next(reader->lexer, &token, reader->err) ||
            !parse_declaration(params, &token, &param))
            return false;
        if (find(params, param.name, param.name_length) != NULL)
            return pbrt_report_error(reader, &param.pos, "parameter \"%.*s\" is given twice",
                                     (int)param.name_length, param.name);
        if (params->items.count == PARAMS_MAX)
            return pbrt_report_error(reader, &param.pos, "more than %d parameters", PARAMS_MAX);
        if (!read_values(params, &param))
            return false;
        struct pbrt_param *added = growing_add(&params->items, 1, sizeof(param));
        if (added == NULL)
            return pbrt_report_no_memory(reader);
        *added = param;
    }
}

/* --- Looking up --------------------------------------------------------------------------- */

const double *pbrt_params_numbers(const struct pbrt_params *params, const struct pbrt_param *param)
{
    return param->number_count > 0 ? (const double *)params->numbers.data + param->first_number
                                   : NULL;
}

const struct pbrt_token *pbrt_params_tokens(const struct pbrt_params *params,
                                            const struct pbrt_param *param)
{
    return param->string_count > 0
               ? (const struct pbrt_token *)params->strings.data + param->first_string
               : NULL;
}

/* What parameters of pbrt-v3 became, which converters leave behind; NULL: nothing */
static const struct {
    const char *old, *now;
} old_names[] = {
    { "Kd", "reflectance" },
    { "Kr", "reflectance" },
    { "Ks", NULL },
    { "Kt", "transmittance" },
    { "bsdffile", "filename" },
    { "bumpmap", "displacement" },
    { "index", "eta" },
    { "lightsamplestrategy", "lightsampler" },
    { "mapname", "filename" },
    { "namedmaterial1", "materials" },
    { "namedmaterial2", "materials" },
    { "nlevels", "levels" },
    { "nsamples", NULL },
    { "opacity", NULL },
    { "samples", NULL },
    { "shadowalpha", NULL },
    { "st", "uv" },
    { "trilinear", "filter" },
    { "xwidth", "xradius" },
    { "ywidth", "yradius" },
};

/* Is the parameter's name one of pbrt-v3? Then text continues a sentence about it. */
static bool was_renamed(const struct pbrt_param *param, char *text, size_t size)
{
    for (size_t i = 0; i < sizeof(old_names) / sizeof(old_names[0]); i++) {
        const char *old = old_names[i].old, *now = old_names[i].now;
        if (strlen(old) != param->name_length || memcmp(old, param->name, param->name_length) != 0)
            continue;
        snprintf(text, size, "of pbrt-v3: in pbrt-v4 %s%s%s",
                 now != NULL ? "it is \"" : "there is none", now != NULL ? now : "",
                 now != NULL ? "\"" : "");
        return true;
    }
    return false;
}

/* What is missing may be there under its old name */
static void add_old_name(const struct pbrt_params *params, char *text, size_t size)
{
    char was[80];
    size_t length = strlen(text);
    for (size_t i = 0; i < params->items.count; i++) {
        const struct pbrt_param *param = &items(params)[i];
        if (param->used || !was_renamed(param, was, sizeof(was)))
            continue;
        snprintf(text + length, size - length, "; \"%.*s\" is %s", (int)param->name_length,
                 param->name, was);
        return;
    }
}

void pbrt_params_fail(struct pbrt_params *params, const struct pbrt_param *param,
                      const char *format, ...)
{
    if (params->failed)
        return;
    params->failed = true;
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    if (param == NULL)
        add_old_name(params, text, sizeof(text));
    pbrt_report_error(params->reader, param != NULL ? &param->pos : &params->pos, "%s", text);
}

const struct pbrt_param *pbrt_params_find(struct pbrt_params *params, const char *name)
{
    if (params->asked_count < PBRT_ASKED_MAX)
        params->asked[params->asked_count++] = name;
    struct pbrt_param *param = find(params, name, strlen(name));
    if (param != NULL)
        param->used = true;
    return param;
}

/* Find it and check its type; NULL when absent or wrong. A texture is for later. */
static const struct pbrt_param *find_typed(struct pbrt_params *params, const char *name,
                                           enum pbrt_param_type type)
{
    const struct pbrt_param *param = pbrt_params_find(params, name);
    if (param == NULL || params->failed)
        return NULL;
    if (param->type == PARAM_TEXTURE && type != PARAM_TEXTURE) {
        params->failed = !pbrt_report_later(params->reader, &param->pos, "a texture for \"%s\"",
                                            name);
        return NULL;
    }
    /* Points are points, whatever the file calls them */
    bool same = param->type == type ||
                ((type == PARAM_POINT3 || type == PARAM_NORMAL) &&
                 (param->type == PARAM_POINT3 || param->type == PARAM_VECTOR3 ||
                  param->type == PARAM_NORMAL)) ||
                (type == PARAM_POINT2 && param->type == PARAM_VECTOR2);
    if (!same) {
        pbrt_params_fail(params, param, "\"%s %s\" is wanted here, not \"%s %s\"", type_text(type),
                         name, type_text(param->type), name);
        return NULL;
    }
    return param;
}

static const struct pbrt_param *find_single(struct pbrt_params *params, const char *name,
                                            enum pbrt_param_type type)
{
    const struct pbrt_param *param = find_typed(params, name, type);
    if (param != NULL && param->number_count + param->string_count != 1) {
        pbrt_params_fail(params, param, "\"%s %s\" wants one value, not %zu", type_text(type), name,
                         param->number_count + param->string_count);
        return NULL;
    }
    return param;
}

double pbrt_params_float(struct pbrt_params *params, const char *name, double otherwise)
{
    const struct pbrt_param *param = find_single(params, name, PARAM_FLOAT);
    return param != NULL ? pbrt_params_numbers(params, param)[0] : otherwise;
}

int64_t pbrt_params_integer(struct pbrt_params *params, const char *name, int64_t otherwise)
{
    const struct pbrt_param *param = find_single(params, name, PARAM_INTEGER);
    return param != NULL ? (int64_t)pbrt_params_numbers(params, param)[0] : otherwise;
}

bool pbrt_params_bool(struct pbrt_params *params, const char *name, bool otherwise)
{
    const struct pbrt_param *param = find_single(params, name, PARAM_BOOL);
    return param != NULL ? pbrt_params_numbers(params, param)[0] != 0 : otherwise;
}

const struct pbrt_token *pbrt_params_string(struct pbrt_params *params, const char *name)
{
    const struct pbrt_param *param = find_single(params, name, PARAM_STRING);
    return param != NULL ? pbrt_params_tokens(params, param) : NULL;
}

const struct pbrt_token *pbrt_params_strings(struct pbrt_params *params, const char *name,
                                             size_t *count)
{
    const struct pbrt_param *param = find_typed(params, name, PARAM_STRING);
    *count = param != NULL ? param->string_count : 0;
    return param != NULL ? pbrt_params_tokens(params, param) : NULL;
}

const double *pbrt_params_array(struct pbrt_params *params, const char *name,
                                enum pbrt_param_type type, size_t *groups)
{
    size_t size = type == PARAM_POINT2 ? 2 : type == PARAM_POINT3 || type == PARAM_NORMAL ? 3 : 1;
    const struct pbrt_param *param = find_typed(params, name, type);
    *groups = 0;
    if (param == NULL)
        return NULL;
    if (param->number_count % size != 0) {
        pbrt_params_fail(params, param, "\"%s %s\" wants groups of %zu numbers and has %zu numbers",
                         type_text(type), name, size, param->number_count);
        return NULL;
    }
    *groups = param->number_count / size;
    return pbrt_params_numbers(params, param);
}

void pbrt_params_point(struct pbrt_params *params, const char *name, double point[3])
{
    size_t count;
    const double *values = pbrt_params_array(params, name, PARAM_POINT3, &count);
    if (values != NULL && count != 1)
        pbrt_params_fail(params, find(params, name, strlen(name)), "\"point3 %s\" wants one point",
                         name);
    else if (values != NULL)
        memcpy(point, values, 3 * sizeof(double));
}

/* Take a parameter without making its name one to suggest */
static const struct pbrt_param *take(struct pbrt_params *params, const char *name)
{
    struct pbrt_param *param = find(params, name, strlen(name));
    if (param != NULL)
        param->used = true;
    return param;
}

const struct pbrt_token *pbrt_params_texture(struct pbrt_params *params, const char *name)
{
    const struct pbrt_param *param = find(params, name, strlen(name));
    if (param == NULL || param->type != PARAM_TEXTURE)
        return NULL;
    take(params, name);
    if (param->string_count != 1)
        pbrt_params_fail(params, param, "\"texture %s\" wants one name", name);
    return pbrt_params_tokens(params, param);
}

void pbrt_params_replace(struct pbrt_params *params, const char *name, enum pbrt_param_type type,
                         const double *numbers, size_t count)
{
    struct pbrt_param *param = find(params, name, strlen(name));
    double *added = growing_add(&params->numbers, count, sizeof(double));
    if (added == NULL) {
        params->failed = true;
        pbrt_report_no_memory(params->reader);
        return;
    }
    if (count > 0)
        memcpy(added, numbers, count * sizeof(double));
    else
        param->name_length = 0; /* no name is empty, so nobody finds it */
    param->type = type;
    param->first_number = params->numbers.count - count;
    param->number_count = count;
    param->string_count = 0;
    param->used = true;
    param->linear = true;
}

void pbrt_params_later(struct pbrt_params *params, const char *name)
{
    const struct pbrt_param *param = take(params, name);
    if (param != NULL && !params->failed)
        params->failed = !pbrt_report_later(params->reader, &param->pos, "parameter \"%s\" of %s",
                                            name, params->owner);
}

void pbrt_params_ignore(struct pbrt_params *params, const char *name)
{
    take(params, name);
}

/* What may be meant by a name that nobody asked for */
static void hint(const struct pbrt_params *params, const struct pbrt_param *param, char *text,
                 size_t size)
{
    char was[80];
    const char *nearest = pbrt_names_nearest_of(params->asked, params->asked_count, param->name,
                                                param->name_length);
    text[0] = '\0';
    if (was_renamed(param, was, sizeof(was)))
        snprintf(text, size, "; it is %s", was);
    else if (nearest != NULL)
        snprintf(text, size, "; the nearest is \"%s\"", nearest);
}

bool pbrt_params_done(struct pbrt_params *params)
{
    for (size_t i = 0; !params->failed && i < params->items.count; i++) {
        const struct pbrt_param *param = &items(params)[i];
        if (param->used)
            continue;
        char text[400], meant[128];
        hint(params, param, meant, sizeof(meant));
        snprintf(text, sizeof(text), "unknown parameter \"%.*s\" of %s%s",
                 (int)(param->name_length < 64 ? param->name_length : 64), param->name,
                 params->owner, meant);
        if (params->reader->report.lenient) {
            params->reader->report.warnings++;
            pbrt_report_note(params->reader, &param->pos, "%s; ignored", text);
        } else {
            pbrt_params_fail(params, param, "%s", text);
        }
    }
    return !params->failed;
}
