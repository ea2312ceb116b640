#include "master/pbrt_transforms.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846

struct pbrt_space {
    const char *name;
    size_t length;
    struct transform transform, end;
};

void pbrt_transforms_start(struct pbrt_spaces *spaces)
{
    spaces->camera = spaces->camera_end = transform_identity();
    spaces->times[1] = 1;
}

void pbrt_transforms_free(struct pbrt_spaces *spaces)
{
    growing_free(&spaces->named);
}

/* --- The current transform ---------------------------------------------------------------- */

/* The transforms at the start and the end of a motion, as far as ActiveTransform means them */
static bool set_ctms(struct pbrt_reader *reader, const struct pbrt_token *directive,
                     const struct transform *ctm, const struct transform *ctm_end)
{
    struct pbrt_state *state = &reader->state;
    struct transform inverse;
    if ((!state->fixed_start && !transform_invert(ctm, &inverse)) ||
        (!state->fixed_end && !transform_invert(ctm_end, &inverse)))
        return pbrt_report_error(
            reader, &directive->pos,
            "after this %.*s the transform cannot be inverted: it flattens space",
            (int)directive->length, directive->text);
    if (!state->fixed_start)
        state->ctm = *ctm;
    if (!state->fixed_end)
        state->ctm_end = *ctm_end;
    return true;
}

static bool set_ctm(struct pbrt_reader *reader, const struct pbrt_token *directive,
                    const struct transform *ctm)
{
    return set_ctms(reader, directive, ctm, ctm);
}

static bool concat(struct pbrt_reader *reader, const struct pbrt_token *directive,
                   const struct transform *transform)
{
    struct transform ctm = transform_mul(&reader->state.ctm, transform);
    struct transform ctm_end = transform_mul(&reader->state.ctm_end, transform);
    return set_ctms(reader, directive, &ctm, &ctm_end);
}

bool pbrt_transforms_active(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token which;
    (void)directive;
    if (!pbrt_lexer_next(reader->lexer, &which, reader->err))
        return false;
    if (!pbrt_token_is(&which, "All") && !pbrt_token_is(&which, "StartTime") &&
        !pbrt_token_is(&which, "EndTime"))
        return pbrt_report_error(reader, &which.pos,
                                 "ActiveTransform is All, StartTime or EndTime");
    reader->state.fixed_start = pbrt_token_is(&which, "EndTime");
    reader->state.fixed_end = pbrt_token_is(&which, "StartTime");
    return true;
}

bool pbrt_transforms_times(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[2];
    if (!pbrt_args_numbers(reader, directive, 2, v))
        return false;
    if (reader->in_world)
        return pbrt_report_error(reader, &directive->pos,
                                 "TransformTimes must come before WorldBegin");
    if (!(v[0] < v[1]))
        return pbrt_report_error(reader, &directive->pos,
                                 "TransformTimes wants a start before its end, not %g and %g", v[0],
                                 v[1]);
    memcpy(reader->spaces.times, v, sizeof(v));
    return true;
}

/* --- Directives that change it ------------------------------------------------------------ */

bool pbrt_transforms_identity(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform identity = transform_identity();
    return set_ctm(reader, directive, &identity);
}

bool pbrt_transforms_translate(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[3];
    if (!pbrt_args_numbers(reader, directive, 3, v))
        return false;
    struct transform translate = transform_translate(v[0], v[1], v[2]);
    return concat(reader, directive, &translate);
}

bool pbrt_transforms_scale(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[3];
    if (!pbrt_args_numbers(reader, directive, 3, v))
        return false;
    struct transform scale = transform_scale(v[0], v[1], v[2]);
    return concat(reader, directive, &scale);
}

bool pbrt_transforms_rotate(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[4];
    struct transform rotation;
    if (!pbrt_args_numbers(reader, directive, 4, v))
        return false;
    if (!transform_rotate(fmod(v[0], 360) * (PI / 180), v + 1, &rotation))
        return pbrt_report_error(reader, &directive->pos, "Rotate wants an axis that is not zero");
    return concat(reader, directive, &rotation);
}

bool pbrt_transforms_look_at(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    double v[9];
    struct transform look;
    if (!pbrt_args_numbers(reader, directive, 9, v))
        return false;
    if (!transform_look_at(v, v + 3, v + 6, &look))
        return pbrt_report_error(reader, &directive->pos,
                                 "LookAt's eye, target and up vector do not span a view");
    return concat(reader, directive, &look);
}

/* The sixteen numbers stand column by column */
static bool next_matrix(struct pbrt_reader *reader, const struct pbrt_token *directive,
                        struct transform *matrix)
{
    double v[16];
    if (!pbrt_args_numbers(reader, directive, 16, v))
        return false;
    for (int i = 0; i < 16; i++)
        matrix->m[i % 4][i / 4] = v[i];
    if (!transform_is_affine(matrix))
        return pbrt_report_later(reader, &directive->pos, "a projective transform") &&
               pbrt_report_error(reader, &directive->pos,
                                 "the last row of a matrix must be 0 0 0 1");
    return true;
}

bool pbrt_transforms_set(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform matrix;
    return next_matrix(reader, directive, &matrix) && set_ctm(reader, directive, &matrix);
}

bool pbrt_transforms_concat(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct transform matrix;
    return next_matrix(reader, directive, &matrix) && concat(reader, directive, &matrix);
}

/* --- Named coordinate systems ------------------------------------------------------------- */

static struct pbrt_space *find_space(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    struct pbrt_space *systems = reader->spaces.named.data;
    for (size_t i = 0; i < reader->spaces.named.count; i++)
        if (systems[i].length == name->length &&
            memcmp(systems[i].name, name->text, name->length) == 0)
            return &systems[i];
    return NULL;
}

bool pbrt_transforms_name(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    struct pbrt_space *system = find_space(reader, &name);
    if (system == NULL)
        system = growing_add(&reader->spaces.named, 1, sizeof(*system));
    if (system == NULL)
        return pbrt_report_no_memory(reader);
    *system = (struct pbrt_space){ name.text, name.length, reader->state.ctm,
                                   reader->state.ctm_end };
    return true;
}

bool pbrt_transforms_recall(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    struct pbrt_space *system = find_space(reader, &name);
    if (system != NULL)
        return set_ctms(reader, directive, &system->transform, &system->end);
    if (pbrt_token_is(&name, "camera"))
        return set_ctms(reader, directive, &reader->spaces.camera, &reader->spaces.camera_end);
    if (pbrt_token_is(&name, "world"))
        return pbrt_transforms_identity(reader, directive);
    return pbrt_report_error(reader, &name.pos, "no coordinate system \"%.*s\"", (int)name.length,
                             name.text);
}
