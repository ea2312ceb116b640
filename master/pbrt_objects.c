#include "master/pbrt_objects.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

void pbrt_objects_free(struct pbrt_objects *objects)
{
    growing_free(&objects->open);
}

bool pbrt_objects_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name) ||
        !pbrt_report_later(reader, &directive->pos, "instancing (ObjectBegin)") ||
        !pbrt_state_attribute_begin(reader, directive))
        return false;
    struct source_pos *object = growing_add(&reader->objects.open, 1, sizeof(*object));
    if (object == NULL)
        return pbrt_report_no_memory(reader);
    *object = directive->pos;
    return true;
}

bool pbrt_objects_end(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->objects.open.count == 0)
        return pbrt_report_error(reader, &directive->pos, "ObjectEnd without an ObjectBegin");
    reader->objects.open.count--;
    return pbrt_state_attribute_end(reader, directive);
}

bool pbrt_objects_instance(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    return pbrt_args_string(reader, directive, &name) &&
           pbrt_report_later(reader, &directive->pos, "instancing (ObjectInstance)");
}

bool pbrt_objects_inside(const struct pbrt_objects *objects)
{
    return objects->open.count > 0;
}
