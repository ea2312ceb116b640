#include "master/pbrt_color.h"

#include "master/pbrt_reader.h"
#include "master/spectrum.h"

#include <math.h>
#include <string.h>

/* Numbers of the current ColorSpace; what sRGB cannot show loses its negative part */
static void from_rgb(struct pbrt_params *params, const struct pbrt_param *param,
                     enum pbrt_color_kind kind, double rgb[3])
{
    if (param->number_count != 3) {
        pbrt_params_fail(params, param, "an rgb colour has three numbers, not %zu",
                         param->number_count);
        return;
    }
    memcpy(rgb, pbrt_params_numbers(params, param), 3 * sizeof(double));
    enum color_space space = params->reader->state.color_space;
    if (space == COLOR_SRGB || param->linear || rgb[0] < 0 || rgb[1] < 0 || rgb[2] < 0)
        return;
    color_space_to_srgb(space, kind != COLOR_LIGHT, rgb, rgb);
    double largest = fmax(rgb[0], fmax(rgb[1], rgb[2]));
    for (int c = 0; c < 3; c++) {
        if (rgb[c] < -1e-4 * largest)
            pbrt_report_note(params->reader, &param->pos,
                             "a colour more saturated than sRGB can show is shown less so");
        rgb[c] = fmax(rgb[c], 0);
    }
}

static void from_blackbody(struct pbrt_params *params, const struct pbrt_param *param,
                           enum pbrt_color_kind kind, double rgb[3])
{
    double kelvin = pbrt_params_numbers(params, param)[0];
    if (param->number_count != 1 || kind != COLOR_LIGHT)
        pbrt_params_fail(params, param,
                         kind == COLOR_LIGHT ? "a blackbody has one temperature in kelvin"
                                             : "a blackbody is a light, not a surface");
    else if (!spectrum_blackbody(kelvin, rgb))
        pbrt_params_fail(params, param, "a blackbody of %g K is outside 100 to 1e6 K", kelvin);
}

static void from_pairs(struct pbrt_params *params, const struct pbrt_param *param,
                       enum pbrt_color_kind kind, double rgb[3])
{
    const double *pairs = pbrt_params_numbers(params, param);
    size_t count = param->number_count / 2;
    if (param->number_count % 2 != 0) {
        pbrt_params_fail(params, param, "a spectrum is a list of wavelengths and values, in pairs");
        return;
    }
    for (size_t i = 0; i < count; i++)
        if (pairs[2 * i] < 0 || (i > 0 && pairs[2 * i] <= pairs[2 * i - 2]) ||
            pairs[2 * i + 1] < 0) {
            pbrt_params_fail(params, param,
                             "the wavelengths of a spectrum must ascend, and no value be negative");
            return;
        }
    if (kind == COLOR_REFLECTANCE)
        spectrum_reflectance(pairs, count, rgb);
    else if (kind == COLOR_INDEX || kind == COLOR_DENSITY)
        spectrum_index(pairs, count, rgb);
    else if (!spectrum_light(pairs, count, rgb))
        pbrt_params_fail(params, param, "this spectrum has no light in the visible range");
}

static void from_name(struct pbrt_params *params, const struct pbrt_param *param,
                      enum pbrt_color_kind kind, double rgb[3])
{
    const struct pbrt_token *token = pbrt_params_tokens(params, param);
    char name[64];
    size_t length = token->length < sizeof(name) ? token->length : sizeof(name) - 1;
    memcpy(name, token->text, length);
    name[length] = '\0';

    double ior;
    if (param->string_count != 1) {
        pbrt_params_fail(params, param, "one name of a spectrum is wanted");
    } else if (kind == COLOR_INDEX && spectrum_metal(name, rgb)) {
        return;
    } else if (kind == COLOR_INDEX && spectrum_glass(name, &ior)) {
        rgb[0] = rgb[1] = rgb[2] = ior;
        pbrt_report_note(params->reader, &token->pos,
                         "%s: the index of refraction at 588 nm is used for all colours", name);
    } else if (kind == COLOR_LIGHT && spectrum_illuminant(name, rgb)) {
        return;
    } else if (memchr(token->text, '.', token->length) != NULL ||
               strncmp(name, "stdillum-", 9) == 0) {
        if (!params->failed)
            params->failed = !pbrt_report_later(params->reader, &token->pos, "the spectrum \"%s\"",
                                                name);
    } else {
        size_t count = 0;
        while (spectrum_names[count] != NULL)
            count++;
        pbrt_params_fail(params, param, "no spectrum \"%s\" here; the nearest is \"%s\"", name,
                         pbrt_names_nearest_of(spectrum_names, count, name, length));
    }
}

/* Reflectances lie in [0, 1], as pbrt clamps them; light and indices are not negative */
static void check_range(struct pbrt_params *params, const struct pbrt_param *param,
                        enum pbrt_color_kind kind, double rgb[3])
{
    for (int c = 0; c < 3; c++) {
        if (rgb[c] < 0 || rgb[c] > 1e30) {
            pbrt_params_fail(params, param, "a colour of %g is not possible here", rgb[c]);
            return;
        }
        if (kind == COLOR_REFLECTANCE && rgb[c] > 1) {
            if (rgb[c] > 1 + 1e-6)
                pbrt_report_note(params->reader, &param->pos,
                                 "a reflectance above 1 is taken as 1");
            rgb[c] = 1;
        }
    }
}

bool pbrt_color(struct pbrt_params *params, const char *name, enum pbrt_color_kind kind,
                double rgb[3])
{
    const struct pbrt_param *param = pbrt_params_find(params, name);
    if (param == NULL || params->failed)
        return false;
    double color[3] = { 0, 0, 0 };
    bool known = true;
    switch (param->type) {
    case PARAM_RGB:
        from_rgb(params, param, kind, color);
        break;
    case PARAM_BLACKBODY:
        from_blackbody(params, param, kind, color);
        break;
    case PARAM_SPECTRUM:
        if (param->string_count > 0 && param->number_count == 0) {
            unsigned long long warnings = params->reader->report.warnings;
            from_name(params, param, kind, color);
            known = warnings == params->reader->report.warnings;
        } else if (param->string_count == 0) {
            from_pairs(params, param, kind, color);
        } else {
            pbrt_params_fail(params, param, "a spectrum is either a name or numbers");
        }
        break;
    case PARAM_TEXTURE:
        params->failed = !pbrt_report_later(params->reader, &param->pos, "a texture for \"%s\"",
                                            name);
        return false;
    case PARAM_FLOAT:
        if (kind == COLOR_INDEX && param->number_count == 1) {
            color[0] = color[1] = color[2] = pbrt_params_numbers(params, param)[0];
            break;
        }
        /* fall through */
    default:
        pbrt_params_fail(params, param, "\"rgb %s\" or \"spectrum %s\" is wanted here", name, name);
    }
    if (params->failed || !known)
        return false;
    check_range(params, param, kind, color);
    memcpy(rgb, color, sizeof(color));
    return !params->failed;
}
