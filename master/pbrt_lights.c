#include "master/pbrt_lights.h"

#include "common/direction_map.h"
#include "common/elem.h"
#include "master/pbrt_color.h"
#include "master/pbrt_environments.h"
#include "master/pbrt_reader.h"
#include "master/vector.h"

#include <math.h>
#include <string.h>

#define PI       3.14159265358979323846
#define COUNT(a) (sizeof(a) / sizeof((a)[0]))

/* Point lights of the scene model with an environment, which is their picture */
enum { GONIOMETRIC = LIGHT_KINDS, PROJECTION };

static const struct pbrt_name kinds[] = {
    { "point", LIGHT_POINT, NAME_OURS, NULL },
    { "spot", LIGHT_SPOT, NAME_OURS, NULL },
    { "distant", LIGHT_DISTANT, NAME_OURS, NULL },
    { "infinite", LIGHT_SKY, NAME_OURS, NULL },
    { "goniometric", GONIOMETRIC, NAME_OURS, NULL },
    { "projection", PROJECTION, NAME_OURS, NULL },
    { "exinfinite", 0, NAME_OLD, "in pbrt-v4 it is \"infinite\"" },
    { "diffuse", 0, NAME_OLD, "that is an AreaLightSource" },
};

static const struct pbrt_name area_kinds[] = {
    { "diffuse", 0, NAME_OURS, NULL },
    { "area", 0, NAME_OLD, "in pbrt-v4 it is \"diffuse\"" },
};

/* A colour of light, white unless given, times "scale" */
static void read_light(struct pbrt_params *params, const char *name, double rgb[3])
{
    rgb[0] = rgb[1] = rgb[2] = 1;
    pbrt_color(params, name, COLOR_LIGHT, rgb);
    double scale = pbrt_params_float(params, "scale", 1);
    if (scale < 0)
        pbrt_params_fail(params, pbrt_params_find(params, "scale"), "a scale of %g", scale);
    for (int c = 0; c < 3; c++)
        rgb[c] *= scale;
}

static void scale_to(double rgb[3], double wanted, double unit)
{
    for (int c = 0; c < 3; c++)
        rgb[c] *= wanted / unit;
}

static void read_spot(struct pbrt_params *params, struct light *light, double *unit_power)
{
    double angle = pbrt_params_float(params, "coneangle", 30);
    double delta = pbrt_params_float(params, "conedeltaangle", 5);
    if (!(angle > 0 && angle <= 180 && delta >= 0 && delta <= angle)) {
        pbrt_params_fail(params, NULL,
                         "a cone of %g degrees with a falloff of %g degrees is not possible", angle,
                         delta);
        return;
    }
    double end = elem_cos(angle * (PI / 180)), start = elem_cos((angle - delta) * (PI / 180));
    light->cos_falloff_start = (float)start;
    light->cos_falloff_end = (float)end;
    *unit_power = 2 * PI * ((1 - start) + (start - end) / 2);
}

/* "from" and "to" as a unit direction of travel in the world */
static void read_direction(struct pbrt_params *params, const struct transform *ctm, double from[3],
                           float direction[3])
{
    double to[3] = { 0, 0, 1 }, way[3];
    pbrt_params_point(params, "to", to);
    for (int i = 0; i < 3; i++)
        way[i] = to[i] - from[i];
    transform_vector(ctm, way, way);
    struct vec unit;
    if (!vec_unit(vec_at(way), &unit)) {
        pbrt_params_fail(params, NULL, "\"from\" and \"to\" of a light are the same point");
        return;
    }
    direction[0] = (float)unit.x;
    direction[1] = (float)unit.y;
    direction[2] = (float)unit.z;
}

static bool add_sky(struct pbrt_reader *reader, const double rgb[3])
{
    float *sky = reader->build->scene->settings.sky;
    for (int c = 0; c < 3; c++)
        sky[c] = (float)(sky[c] + rgb[c]);
    return true;
}

static double cosine(struct vec a, struct vec b)
{
    return vec_dot(a, b) / sqrt(vec_dot(a, a) * vec_dot(b, b));
}

/* The rectangle that the light comes through, in world space whatever the current transform is. As
 * in pbrt-v4 it comes from the side where p03 x p01 points to. */
static void read_portal(struct pbrt_params *params, bool pictured, struct build_light *built)
{
    const struct pbrt_param *portal = pbrt_params_find(params, "portal");
    size_t count;
    const double *points = pbrt_params_array(params, "portal", PARAM_POINT3, &count);
    if (portal == NULL || points == NULL)
        return;
    if (!pictured || count != 4) {
        pbrt_params_fail(params, portal,
                         pictured ? "a portal has four points"
                                  : "a portal wants \"string filename\"");
        return;
    }
    struct vec edge[4];
    memcpy(built->portal, points, sizeof(built->portal));
    for (int i = 0; i < 4; i++)
        edge[i] = vec_sub(vec_at(built->portal[(i + 1) % 4]), vec_at(built->portal[i]));
    bool good = true;
    for (int i = 0; i < 4; i++)
        good = good && fabs(cosine(edge[i], edge[(i + 1) % 4])) <= 1e-3;
    good = good && cosine(edge[0], edge[2]) <= 1e-3 - 1 && cosine(edge[1], edge[3]) <= 1e-3 - 1;
    if (!good)
        pbrt_params_fail(params, portal, "a portal is a rectangle, corner after corner");
    built->has_portal = good;
}

/* What "infinite" says besides its colour: a picture instead of it, and where it shines through */
static void read_infinite(struct pbrt_params *params, struct pbrt_environment *picture,
                          struct build_light *built)
{
    const struct pbrt_param *old = pbrt_params_find(params, "mapname");
    if (old != NULL)
        pbrt_params_fail(params, old, "\"mapname\" is pbrt-v3's: in pbrt-v4 it is \"filename\"");
    picture->filename = pbrt_params_string(params, "filename");
    read_portal(params, picture->filename != NULL, built);
    const struct pbrt_param *colour = pbrt_params_find(params, "L");
    if (picture->filename != NULL && colour != NULL)
        pbrt_params_fail(params, colour, "an infinite light has a picture or a colour, not both");
}

static void read_picture(struct pbrt_params *params, struct pbrt_environment *picture)
{
    picture->filename = pbrt_params_string(params, "filename");
    if (picture->filename == NULL && !params->failed)
        pbrt_params_fail(params, NULL, "%s wants \"string filename\"", params->owner);
    if (picture->kind == PBRT_PROJECTION)
        picture->fov = pbrt_params_float(params, "fov", 90) * (PI / 180);
}

bool pbrt_lights_add(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "light", kinds, COUNT(kinds), type, &found))
        return false;
    if (found == NULL)
        return true;

    if (pbrt_state_moves(&reader->state) &&
        !pbrt_report_later(reader, &type->pos, "a light that moves"))
        return false;
    bool pictured = found->value == GONIOMETRIC || found->value == PROJECTION;
    struct pbrt_environment picture = { .kind = found->value == GONIOMETRIC  ? PBRT_GONIOMETRIC
                                                : found->value == PROJECTION ? PBRT_PROJECTION
                                                                             : PBRT_INFINITE };
    struct build_light built = { .light = { .kind = pictured ? LIGHT_POINT : (uint32_t)found->value,
                                            .quadric = SCENE_NONE } };
    struct light *light = &built.light;
    const struct transform *ctm = &reader->state.ctm;
    double rgb[3], from[3] = { 0, 0, 0 }, unit_power = 4 * PI;
    bool delta = light->kind == LIGHT_POINT || light->kind == LIGHT_SPOT;
    read_light(params, delta ? "I" : "L", rgb);
    if (light->kind != LIGHT_SKY && !pictured)
        pbrt_params_point(params, "from", from);
    if (light->kind == LIGHT_SPOT)
        read_spot(params, light, &unit_power);
    if (light->kind == LIGHT_SPOT || light->kind == LIGHT_DISTANT)
        read_direction(params, ctm, from, light->direction);
    if (light->kind == LIGHT_SKY)
        read_infinite(params, &picture, &built);
    if (pictured)
        read_picture(params, &picture);
    double wanted = pbrt_params_float(params, delta ? "power" : "illuminance", 0);
    if (picture.filename != NULL)
        picture.wanted = wanted;
    else if (wanted > 0)
        scale_to(rgb, wanted, delta ? unit_power : light->kind == LIGHT_SKY ? PI : 1);
    if (delta)
        transform_point(ctm, from, built.position);
    if (!pbrt_params_done(params))
        return false;
    for (int i = 0; i < 3; i++) {
        light->radiance[i] = (float)rgb[i];
        if (!isfinite(light->radiance[i]) || !isfinite(built.position[i]))
            return pbrt_report_error(reader, &type->pos, "the light's numbers are too large");
        picture.scale[i] = rgb[i];
    }
    if (rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0)
        return true;
    if (picture.filename != NULL && !pbrt_environments_add(reader, &picture, light))
        return false;
    if (light->kind == LIGHT_SKY && light->environment == 0)
        return add_sky(reader, rgb);
    struct build_light *added = growing_add(&reader->build->lights, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = built;
    return true;
}

static double mean_luminance(const struct scene_build *build, uint32_t index)
{
    const struct scene_picture *picture = (const struct scene_picture *)build->pictures.data +
                                          index;
    double sum = 0;
    for (uint32_t y = 0; y < picture->height; y++)
        for (uint32_t x = 0; x < picture->width; x++) {
            double rgb[3];
            direction_map_texel(picture, build->texels.data, x, y, rgb);
            sum += 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        }
    return sum / ((double)picture->width * picture->height);
}

/* The picture that a surface shows by its own light: its texels in place of "L" */
static bool read_emission(struct pbrt_reader *reader, const struct pbrt_token *filename,
                          struct emitter *emitter)
{
    struct texture texture = { .kind = TEXTURE_IMAGE,
                               .mapping = MAPPING_UV,
                               .map = { [0] = 1, [4] = 1 },
                               .wrap = { WRAP_CLAMP, WRAP_CLAMP },
                               .channel = SCENE_NONE,
                               .scale = 1 };
    if (!pbrt_environments_read(reader, filename, false, &texture.picture))
        return false;
    double bright = mean_luminance(reader->build, texture.picture);
    if (!(bright > 0))
        emitter->radiance[0] = emitter->radiance[1] = emitter->radiance[2] = 0;
    else /* pbrt-v4 takes the mean of the whole picture, wherever the shape shows which part */
        emitter->power /= bright;
    struct texture *added = growing_add(&reader->build->textures, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = texture;
    emitter->texture = (uint32_t)reader->build->textures.count;
    return true;
}

bool pbrt_lights_area(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    struct pbrt_params *params = &reader->params;
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "area light", area_kinds, COUNT(area_kinds), type, &found))
        return false;
    struct emitter emitter = { .pos = type->pos };
    read_light(params, "L", emitter.radiance);
    emitter.two_sided = pbrt_params_bool(params, "twosided", false);
    emitter.power = fmax(0, pbrt_params_float(params, "power", 0));
    const struct pbrt_token *filename = pbrt_params_string(params, "filename");
    const struct pbrt_param *colour = pbrt_params_find(params, "L");
    if (filename != NULL && colour != NULL)
        pbrt_params_fail(params, colour, "an area light has a picture or a colour, not both");
    if (!pbrt_params_done(params) ||
        (filename != NULL && !read_emission(reader, filename, &emitter)))
        return false;
    struct growing *emitters = &reader->build->emitters;
    reader->state.emitter = (uint32_t)emitters->count;
    struct emitter *added = growing_add(emitters, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = emitter;
    return true;
}
