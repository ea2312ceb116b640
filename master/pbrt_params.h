/*
 * Parameter lists: "type name" followed by a value or by values in brackets. Part of the pbrt
 * reader.
 *
 * A list remembers its first failure and which parameters were asked for, so that a directive reads
 * like its manual: look up what there is to look up, then pbrt_params_done says whether all was
 * well, and that nothing was written that nobody asked for.
 */
#ifndef MASTER_PBRT_PARAMS_H
#define MASTER_PBRT_PARAMS_H

#include "master/growing.h"
#include "master/pbrt_lexer.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct pbrt_reader;

enum pbrt_param_type {
    PARAM_FLOAT,
    PARAM_INTEGER,
    PARAM_POINT2,
    PARAM_POINT3,
    PARAM_VECTOR2,
    PARAM_VECTOR3,
    PARAM_NORMAL,
    PARAM_BOOL,
    PARAM_STRING,
    PARAM_TEXTURE,
    PARAM_RGB,
    PARAM_SPECTRUM, /* numbers, or the name of one */
    PARAM_BLACKBODY,
    PARAM_TYPES
};

struct pbrt_param {
    enum pbrt_param_type type;
    const char *name; /* not terminated */
    size_t name_length;
    struct source_pos pos;
    size_t first_number, number_count;
    size_t first_string, string_count;
    bool used;
    bool linear; /* a colour that is linear sRGB already, whatever ColorSpace says */
};

#define PBRT_ASKED_MAX 64

struct pbrt_params {
    struct pbrt_reader *reader;
    struct growing items;   /* struct pbrt_param */
    struct growing numbers; /* double */
    struct growing strings; /* struct pbrt_token */
    char owner[64];         /* `Film "rgb"`, for messages */
    struct source_pos pos;
    const char *asked[PBRT_ASKED_MAX];
    unsigned asked_count;
    bool failed; /* the reader's err is set */
};

/* Forget the list and read the parameters that follow in the text; then add what `defaults` has
 * besides (Attribute; NULL: nothing), which nobody need ask for. */
bool pbrt_params_read(struct pbrt_params *params, const char *directive,
                      const struct pbrt_token *type, const struct pbrt_params *defaults);
void pbrt_params_free(struct pbrt_params *params);

/* Append a copy of `from` (Attribute). */
bool pbrt_params_append(struct pbrt_params *params, const struct pbrt_params *from);

/* Single values; `otherwise` when the parameter is absent. Numbers are finite. */
double pbrt_params_float(struct pbrt_params *params, const char *name, double otherwise);
int64_t pbrt_params_integer(struct pbrt_params *params, const char *name, int64_t otherwise);
bool pbrt_params_bool(struct pbrt_params *params, const char *name, bool otherwise);
const struct pbrt_token *pbrt_params_string(struct pbrt_params *params, const char *name);
void pbrt_params_point(struct pbrt_params *params, const char *name, double point[3]);

/* The name of the texture that the parameter is; NULL when it is absent or something else. */
const struct pbrt_token *pbrt_params_texture(struct pbrt_params *params, const char *name);

/* From now on the parameter, which is there, has these numbers; without any it is gone. */
void pbrt_params_replace(struct pbrt_params *params, const char *name, enum pbrt_param_type type,
                         const double *numbers, size_t count);

/* Whole arrays, NULL when absent; they last until the next list is read. `groups` counts points,
 * not coordinates; a remainder is an error. */
const double *pbrt_params_array(struct pbrt_params *params, const char *name,
                                enum pbrt_param_type type, size_t *groups);
const struct pbrt_token *pbrt_params_strings(struct pbrt_params *params, const char *name,
                                             size_t *count);

/* The parameter by name, whatever its type; NULL when absent. Marks it as used. */
const struct pbrt_param *pbrt_params_find(struct pbrt_params *params, const char *name);
const double *pbrt_params_numbers(const struct pbrt_params *params, const struct pbrt_param *param);
const struct pbrt_token *pbrt_params_tokens(const struct pbrt_params *params,
                                            const struct pbrt_param *param);

/* Fail (or, when lenient, note) if the parameter is there: pbrt knows it and we do not yet. */
void pbrt_params_later(struct pbrt_params *params, const char *name);
/* Accept and ignore a parameter that does not change the picture. */
void pbrt_params_ignore(struct pbrt_params *params, const char *name);
/* Record a failure at a parameter; printf style. */
void pbrt_params_fail(struct pbrt_params *params, const struct pbrt_param *param,
                      const char *format, ...) __attribute__((format(printf, 3, 4)));

/* Was all well, and everything asked for? */
bool pbrt_params_done(struct pbrt_params *params);

#endif
