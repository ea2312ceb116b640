#include "master/pbrt_textures.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

bool pbrt_textures_define(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name, type, class;
    return pbrt_args_string(reader, directive, &name) &&
           pbrt_args_string(reader, directive, &type) &&
           pbrt_args_string(reader, directive, &class) &&
           pbrt_report_later(reader, &directive->pos, "Texture") &&
           pbrt_params_read(&reader->params, "Texture", &class, NULL);
}
