#include "master/pbrt_objects.h"

#include "master/pbrt_args.h"
#include "master/pbrt_curved.h"
#include "master/pbrt_reader.h"

#include <stdlib.h>
#include <string.h>

struct pbrt_object {
    struct pbrt_token name;
    uint32_t group; /* of scene_build */
    uint64_t curved_lights;
};

void pbrt_objects_free(struct pbrt_objects *objects)
{
    growing_free(&objects->named);
}

/* --- Names -------------------------------------------------------------------------------- */

static const struct pbrt_object *find(const struct pbrt_objects *objects,
                                      const struct pbrt_token *name)
{
    /* The latest first: instances tend to follow their object */
    const struct pbrt_object *object = objects->named.data;
    for (size_t i = objects->named.count; i-- > 0;)
        if (object[i].name.length == name->length &&
            memcmp(object[i].name.text, name->text, name->length) == 0)
            return &object[i];
    return NULL;
}

static bool unknown(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    const struct pbrt_object *objects = reader->objects.named.data;
    const struct pbrt_token *nearest = NULL;
    char text[64];
    size_t best = SIZE_MAX;
    for (size_t i = 0; i < reader->objects.named.count; i++) {
        const struct pbrt_token *other = &objects[i].name;
        size_t length = other->length < sizeof(text) ? other->length : sizeof(text) - 1;
        memcpy(text, other->text, length);
        text[length] = '\0';
        size_t distance = pbrt_names_distance(text, name->text, name->length);
        if (distance < best) {
            best = distance;
            nearest = other;
        }
    }
    int length = (int)(name->length < 100 ? name->length : 100);
    if (nearest == NULL)
        return pbrt_report_error(reader, &name->pos, "no object \"%.*s\": there is none at all",
                                 length, name->text);
    return pbrt_report_error(reader, &name->pos, "no object \"%.*s\"; the nearest is \"%.*s\"",
                             length, name->text,
                             (int)(nearest->length < 100 ? nearest->length : 100), nearest->text);
}

/* --- Directives --------------------------------------------------------------------------- */

bool pbrt_objects_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_objects *objects = &reader->objects;
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    if (objects->open)
        return pbrt_report_error(reader, &directive->pos, "ObjectBegin inside of an object");
    if (find(objects, &name) != NULL)
        return pbrt_report_error(reader, &name.pos, "a second object \"%.*s\"",
                                 (int)(name.length < 100 ? name.length : 100), name.text);
    struct pbrt_object *object = growing_add(&objects->named, 1, sizeof(*object));
    if (object == NULL)
        return pbrt_report_no_memory(reader);
    *object = (struct pbrt_object){ .name = name };
    if (!pbrt_state_attribute_begin(reader, directive))
        return false;
    objects->open = true;
    objects->frame = reader->stack.frames.count;
    objects->curved_lights = 0;
    scene_build_group_begin(reader->build);
    return scene_build_group_name(reader->build, name.text, name.length, reader->err);
}

bool pbrt_objects_end(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_objects *objects = &reader->objects;
    if (!objects->open)
        return pbrt_report_error(reader, &directive->pos, "ObjectEnd without an ObjectBegin");
    if (reader->stack.frames.count != objects->frame)
        return pbrt_report_error(reader, &directive->pos,
                                 "an AttributeBegin inside of the object is not closed");
    struct pbrt_object *object = (struct pbrt_object *)objects->named.data + objects->named.count -
                                 1;
    scene_build_group_end(reader->build, &object->group);
    object->curved_lights = objects->curved_lights;
    objects->open = false;
    return pbrt_state_attribute_end(reader, directive);
}

bool pbrt_objects_instance(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    struct pbrt_token name;
    if (!pbrt_args_string(reader, directive, &name))
        return false;
    if (reader->objects.open)
        return pbrt_report_error(reader, &directive->pos, "ObjectInstance inside of an object");
    const struct pbrt_object *object = find(&reader->objects, &name);
    if (object == NULL)
        return unknown(reader, &name);
    const struct pbrt_state *state = &reader->state;
    if (!pbrt_curved_instance(reader, object->curved_lights, &name.pos))
        return false;
    return scene_build_add_moving(reader->build, object->group, &state->ctm,
                                  pbrt_state_moves(state) ? &state->ctm_end : NULL, &name.pos,
                                  reader->err);
}

bool pbrt_objects_may_close(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (!reader->objects.open || reader->stack.frames.count != reader->objects.frame)
        return true;
    return pbrt_report_error(reader, &directive->pos, "AttributeEnd where ObjectEnd is wanted");
}

bool pbrt_objects_inside(const struct pbrt_objects *objects)
{
    return objects->open;
}
