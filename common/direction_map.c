#include "common/direction_map.h"

#include "common/elem.h"
#include "common/scene.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846

static double from_srgb(double c)
{
    return c <= 0.04045 ? c / 12.92 : elem_pow((c + 0.055) / 1.055, 2.4);
}

static double from_half(uint16_t bits)
{
    int exponent = bits >> 10 & 31;
    double fraction = bits & 1023;
    double value = exponent == 0 ? fraction * 0x1p-24 : (fraction + 1024) * 0x1p-25;
    for (int i = 0; i < exponent; i++)
        value *= exponent == 31 ? (double)INFINITY : 2;
    return bits >> 15 ? -value : value;
}

static double channel(uint32_t kind, const uint8_t *texels, size_t index)
{
    uint16_t half;
    float wide;
    switch (kind) {
    case TEXEL_U8:
        return texels[index] / 255.0;
    case TEXEL_U8_SRGB:
        return from_srgb(texels[index] / 255.0);
    case TEXEL_HALF:
        memcpy(&half, texels + 2 * index, sizeof(half));
        return from_half(half);
    default:
        memcpy(&wide, texels + 4 * index, sizeof(wide));
        return (double)wide;
    }
}

bool direction_map_texel(const struct scene_picture *picture, const uint8_t *texels, uint32_t x,
                         uint32_t y, double rgb[3])
{
    size_t index = ((size_t)y * picture->width + x) * picture->channels;
    bool sound = true;
    texels += (size_t)picture->first_block * TEXEL_BLOCK;
    for (size_t c = 0; c < 3; c++) {
        double value = channel(picture->texel, texels, index + (picture->channels >= 3 ? c : 0));
        bool good = value >= 0 && isfinite(value);
        rgb[c] = good ? value : 0;
        sound = sound && good;
    }
    return sound;
}

double direction_map_omega(uint32_t layout, uint32_t width, uint32_t height, uint32_t y)
{
    if (layout != ENVIRONMENT_LAT_LONG)
        return 4 * PI / ((double)width * height);
    /* cos a - cos b, as a product: nothing cancels at the poles */
    double half_step = PI / (2.0 * height);
    return 2 * PI / width * 2 * elem_sin(half_step) * elem_sin((2.0 * y + 1) * half_step);
}

/* Clarberg's octahedron of equal areas (2008): the inner square is z >= 0, its corners are folded
 * outwards to be z <= 0 */
static void from_square(double s, double t, double w[3])
{
    double u = 2 * s - 1, v = 2 * t - 1, au = fabs(u), av = fabs(v);
    bool below = au + av > 1;
    double r = below ? 2 - (au + av) : au + av;
    double phi = r > 0 ? ((av - au) / r + 1) * (PI / 4) : PI / 4;
    double across = r * sqrt(2 - r * r);
    w[0] = copysign(across * elem_cos(phi), u);
    w[1] = copysign(across * elem_sin(phi), v);
    w[2] = below ? r * r - 1 : 1 - r * r;
}

void direction_map_direction(uint32_t layout, double s, double t, double w[3])
{
    if (layout == ENVIRONMENT_SQUARE) {
        from_square(s, t, w);
    } else if (layout == ENVIRONMENT_LAT_LONG) {
        double across = elem_sin(PI * t);
        w[0] = across * elem_cos(2 * PI * s);
        w[1] = across * elem_sin(2 * PI * s);
        w[2] = elem_cos(PI * t);
    } else {
        w[0] = 2 * s - 1;
        w[1] = 2 * t - 1;
        w[2] = 1;
    }
}
