#include "master/gltf_lights.h"

#include "common/elem.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <string.h>

#define PI              3.14159265358979323846
#define LUMENS_PER_WATT 683.0
#define INTENSITY_MOST  1e15

bool gltf_lights_start(struct gltf_reader *reader)
{
    struct gltf_item root = gltf_json_root(reader);
    struct gltf_item asset = gltf_json_child(reader, &root, "asset");
    const char *generator = gltf_json_text(reader, &asset, "generator");
    bool blender = generator != NULL && strstr(generator, "glTF Blender I/O") != NULL;
    reader->lights.unit = blender ? 1 / LUMENS_PER_WATT : 1;
    return !reader->failed;
}

static bool read_cone(struct gltf_reader *reader, const struct gltf_item *item, struct light *light)
{
    struct gltf_item spot = gltf_json_child(reader, item, "spot");
    double inner = gltf_json_number(reader, &spot, "innerConeAngle", 0, 0, PI);
    double outer = gltf_json_number(reader, &spot, "outerConeAngle", PI / 4, 0, PI);
    if (reader->failed)
        return false;
    if (!(inner <= outer && outer > 0))
        return gltf_report_error(reader, item->where, "cones of %g and %g are not possible", inner,
                                 outer);
    light->cos_falloff_start = (float)elem_cos(inner);
    light->cos_falloff_end = (float)elem_cos(outer);
    return true;
}

static bool read_light(struct gltf_reader *reader, const struct gltf_item *item,
                       struct light *light)
{
    const char *type = gltf_json_text(reader, item, "type");
    double rgb[3] = { 1, 1, 1 };
    gltf_json_numbers(reader, item, "color", 0, INTENSITY_MOST, rgb, 3);
    double intensity = gltf_json_number(reader, item, "intensity", 1, 0, INTENSITY_MOST);
    if (reader->failed || type == NULL)
        return gltf_report_error(reader, item->where, "it has no type");
    if (strcmp(type, "point") == 0)
        light->kind = LIGHT_POINT;
    else if (strcmp(type, "spot") == 0)
        light->kind = LIGHT_SPOT;
    else if (strcmp(type, "directional") == 0)
        light->kind = LIGHT_DISTANT;
    else
        return gltf_report_error(reader, item->where, "there is no light \"%s\"", type);
    if (gltf_json_has(item, "range"))
        gltf_report_note(reader, item->where, "\"range\" is not applied: light goes on forever");
    for (int c = 0; c < 3; c++)
        light->radiance[c] = (float)(rgb[c] * intensity * reader->lights.unit);
    return light->kind != LIGHT_SPOT || read_cone(reader, item, light);
}

bool gltf_lights_add(struct gltf_reader *reader, const struct gltf_item *node,
                     const struct transform *to_world)
{
    struct gltf_item here = gltf_json_extension(reader, node, "KHR_lights_punctual");
    struct gltf_item root = gltf_json_root(reader);
    if (reader->failed || here.json == NULL)
        return !reader->failed;
    struct gltf_item all = gltf_json_extension(reader, &root, "KHR_lights_punctual");
    uint32_t index = gltf_json_index(reader, &here, "light");
    struct gltf_item item = gltf_json_entry(reader, &all, "lights", index);
    struct build_light built = { .light = { .quadric = SCENE_NONE } };
    if (reader->failed || !read_light(reader, &item, &built.light))
        return false;

    /* Light goes along -z of the node */
    double length = 0;
    for (int axis = 0; axis < 3; axis++) {
        built.position[axis] = to_world->m[axis][3];
        length += to_world->m[axis][2] * to_world->m[axis][2];
    }
    if (!(length > 0) || !isfinite(length)) {
        if (built.light.kind != LIGHT_POINT)
            return gltf_report_error(reader, node->where, "its light is scaled to nothing");
        length = 1;
    }
    for (int axis = 0; axis < 3; axis++)
        built.light.direction[axis] = (float)(-to_world->m[axis][2] / sqrt(length));
    if (built.light.radiance[0] == 0 && built.light.radiance[1] == 0 &&
        built.light.radiance[2] == 0)
        return true;
    gltf_report_note(reader, "", "lights of intensity 1 count as %s",
                     reader->lights.unit == 1 ? "1 W/sr or W/m^2"
                                              : "1/683 W/sr or W/m^2, as Blender means it");
    struct build_light *added = growing_add(&reader->build->lights, 1, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    *added = built;
    return true;
}

static bool any_emitter(const struct scene_build *build)
{
    const struct build_mesh *meshes = build->meshes.data;
    for (size_t i = 0; i < build->meshes.count; i++)
        if (meshes[i].place.emitter != SCENE_NONE)
            return true;
    return false;
}

void gltf_lights_finish(struct gltf_reader *reader)
{
    if (reader->build->lights.count > 0 || any_emitter(reader->build))
        return;
    gltf_report_note(reader, "", "there is no light: a sky of radiance 1 stands in");
    for (int c = 0; c < 3; c++)
        reader->build->scene->settings.sky[c] = 1;
}
