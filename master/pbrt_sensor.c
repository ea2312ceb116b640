#include "master/pbrt_sensor.h"

#include "master/color_space.h"
#include "master/pbrt_reader.h"

#include <math.h>
#include <string.h>

#define COUNT(a)          (sizeof(a) / sizeof((a)[0]))
#define SENSOR_WHITE      6500 /* kelvin: that of named cameras unless they say */
#define MIXING_WORTH_NOTE 0.005

static const struct pbrt_name sensors[] = {
    { "cie1931", 0, NAME_OURS, NULL },
    { "canon_eos_100d", 1, NAME_OURS, NULL },
    { "canon_eos_1dx_mkii", 1, NAME_OURS, NULL },
    { "canon_eos_200d", 1, NAME_OURS, NULL },
    { "canon_eos_200d_mkii", 1, NAME_OURS, NULL },
    { "canon_eos_5d", 1, NAME_OURS, NULL },
    { "canon_eos_5d_mkii", 1, NAME_OURS, NULL },
    { "canon_eos_5d_mkiii", 1, NAME_OURS, NULL },
    { "canon_eos_5d_mkiv", 1, NAME_OURS, NULL },
    { "canon_eos_5ds", 1, NAME_OURS, NULL },
    { "canon_eos_m", 1, NAME_OURS, NULL },
    { "hasselblad_l1d_20c", 1, NAME_OURS, NULL },
    { "nikon_d810", 1, NAME_OURS, NULL },
    { "nikon_d850", 1, NAME_OURS, NULL },
    { "sony_ilce_6400", 1, NAME_OURS, NULL },
    { "sony_ilce_7m3", 1, NAME_OURS, NULL },
    { "sony_ilce_7rm3", 1, NAME_OURS, NULL },
    { "sony_ilce_9", 1, NAME_OURS, NULL },
};

void pbrt_sensor_start(struct pbrt_sensor *sensor)
{
    *sensor = (struct pbrt_sensor){ .brightness = 1, .gains = { 1, 1, 1 } };
}

static double positive(struct pbrt_params *params, const char *name, double otherwise)
{
    double value = pbrt_params_float(params, name, otherwise);
    if (value > 0 && value <= 1e12)
        return value;
    pbrt_params_fail(params, pbrt_params_find(params, name), "\"%s\" of %g", name, value);
    return otherwise;
}

static void read_balance(struct pbrt_params *params, bool camera, struct pbrt_sensor *sensor)
{
    double kelvin = pbrt_params_float(params, "whitebalance", 0), mixing;
    if (kelvin == 0 && camera)
        kelvin = SENSOR_WHITE;
    if (kelvin == 0)
        return;
    if (!color_space_balance(kelvin, sensor->gains, &mixing))
        pbrt_params_fail(params, pbrt_params_find(params, "whitebalance"),
                         "a white balance of %g K is outside 1667 to 25000 K", kelvin);
    else if (mixing > MIXING_WORTH_NOTE && !params->failed)
        pbrt_report_note(params->reader, &params->pos,
                         "white balance is a gain of each channel; pbrt's mixes up to %.1f %% of "
                         "one channel into another",
                         100 * mixing);
}

void pbrt_sensor_read(struct pbrt_params *params, struct pbrt_sensor *sensor)
{
    struct pbrt_reader *reader = params->reader;
    pbrt_sensor_start(sensor);
    const struct pbrt_token *name = pbrt_params_string(params, "sensor");
    const struct pbrt_name *found = &sensors[0];
    if (name != NULL && !params->failed &&
        !pbrt_names_choose(reader, "film sensor", sensors, COUNT(sensors), name, &found)) {
        params->failed = true;
        return;
    }
    if (found->value == 1)
        pbrt_report_note(reader, &name->pos,
                         "sensor \"%s\" renders with the colours of \"cie1931\"", found->text);
    read_balance(params, found->value == 1, sensor);
    sensor->brightness = positive(params, "iso", 100) / 100;

    /* Early pbrt-v4 asked for these */
    const struct pbrt_param *time = pbrt_params_find(params, "exposuretime");
    const struct pbrt_param *ratio = pbrt_params_find(params, "imagingratio");
    sensor->own_exposure = time != NULL || ratio != NULL;
    sensor->brightness *= positive(params, "exposuretime", 1);
    if (ratio != NULL)
        sensor->brightness = positive(params, "imagingratio", 1);

    const struct pbrt_param *most = pbrt_params_find(params, "maxcomponentvalue");
    pbrt_params_float(params, "maxcomponentvalue", INFINITY);
    if (most != NULL)
        pbrt_report_note(reader, &most->pos,
                         "\"maxcomponentvalue\" is not used: cutting off bright samples makes the "
                         "picture too dark");
}

static void scale(float rgb[3], const double gains[3])
{
    for (int c = 0; c < 3; c++)
        rgb[c] = (float)((double)rgb[c] * gains[c]);
}

void pbrt_sensor_finish(struct pbrt_reader *reader)
{
    const struct pbrt_sensor *sensor = &reader->view.sensor;
    const double *shutter = reader->view.shutter;
    struct scene_build *build = reader->build;
    double time = sensor->own_exposure ? 1 : shutter[1] - shutter[0], gains[3];
    for (int c = 0; c < 3; c++)
        gains[c] = sensor->gains[c] * sensor->brightness * time;
    if (gains[0] == 1 && gains[1] == 1 && gains[2] == 1)
        return;
    struct emitter *emitters = build->emitters.data;
    for (size_t i = 0; i < build->emitters.count; i++)
        for (int c = 0; c < 3; c++)
            emitters[i].radiance[c] *= gains[c];
    struct build_light *lights = build->lights.data;
    for (size_t i = 0; i < build->lights.count; i++)
        scale(lights[i].light.radiance, gains);
    struct environment *environments = build->environments.data;
    for (size_t i = 0; i < build->environments.count; i++)
        scale(environments[i].scale, gains);
    struct medium *media = build->media.data;
    for (size_t i = 0; i < build->media.count; i++)
        scale(media[i].Le, gains);
    scale(build->scene->settings.sky, gains);
}
