#include "master/pbrt_media.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

bool pbrt_media_define(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    return pbrt_args_string(reader, directive, &name) &&
           pbrt_report_later(reader, &directive->pos, "MakeNamedMedium") &&
           pbrt_params_read(&reader->params, "MakeNamedMedium", &name, NULL);
}

bool pbrt_media_interface(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name) ||
        !pbrt_report_later(reader, &directive->pos, "MediumInterface") ||
        !pbrt_lexer_peek(reader->lexer, &name, reader->err))
        return false;
    return name.kind != TOKEN_STRING || pbrt_lexer_next(reader->lexer, &name, reader->err);
}
