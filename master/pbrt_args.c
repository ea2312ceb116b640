#include "master/pbrt_args.h"

#include "master/number.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <stdio.h>

bool pbrt_args_string(struct pbrt_reader *reader, const struct pbrt_token *directive,
                      struct pbrt_token *token)
{
    if (!pbrt_lexer_next(reader->lexer, token, reader->err))
        return false;
    if (token->kind != TOKEN_STRING)
        return pbrt_report_error(reader, &token->pos, "%.*s wants a name in quotes here",
                                 (int)directive->length, directive->text);
    return true;
}

bool pbrt_args_numbers(struct pbrt_reader *reader, const struct pbrt_token *directive, int count,
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
            return pbrt_report_error(reader, &token.pos, "%.*s wants %d numbers",
                                     (int)directive->length, directive->text, count);
        if (!isfinite(values[i]))
            return pbrt_report_error(reader, &token.pos, "\"%.*s\" is not a finite number",
                                     (int)token.length, token.text);
    }
    if (!bracket)
        return true;
    if (!pbrt_lexer_next(reader->lexer, &token, reader->err))
        return false;
    if (token.kind != TOKEN_CLOSE)
        return pbrt_report_error(reader, &token.pos, "%.*s wants %d numbers and then a ]",
                                 (int)directive->length, directive->text, count);
    return true;
}

bool pbrt_args_typed(struct pbrt_reader *reader, const struct pbrt_token *directive,
                     enum pbrt_target target, struct pbrt_token *type)
{
    char name[32];
    snprintf(name, sizeof(name), "%.*s", (int)directive->length, directive->text);
    return pbrt_args_string(reader, directive, type) &&
           pbrt_params_read(&reader->params, name, type, &reader->stack.defaults[target]);
}
