#include "worker/kernel/texture.h"

#include "common/elem.h"
#include "common/err.h"
#include "worker/kernel/noise.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI_D 3.14159265358979323846

/* One texture of a tree; child[i] is 1 + the step that has its value, or 0 */
struct step {
    uint32_t texture;
    uint8_t child[3];
};

struct program {
    uint32_t first, count; /* of steps; the last is the texture itself */
    bool uses_p;
};

struct level {
    const uint8_t *texels;
    int32_t width, height;
};

struct texture_set {
    const struct scene *scene;
    struct program *programs; /* one for each texture */
    struct step *steps;
    uint32_t *first_level; /* of each picture */
    struct level *levels;
    float linear[256], srgb[256]; /* what an 8-bit value means */
};

static float lesser(float a, float b)
{
    return a < b ? a : b;
}

static float greater(float a, float b)
{
    return a > b ? a : b;
}

static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const float a[3], const float b[3], float out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static float length(const float a[3])
{
    return sqrtf(dot(a, a));
}

/* ---- opening */

static bool uses_p(const struct texture *texture)
{
    return texture->kind != TEXTURE_CONSTANT && texture->mapping != MAPPING_UV;
}

/*
 * The steps of the tree of `root` into `steps`, in the order of the array, which has children
 * first. `wanted` is scratch of a flag per texture, all clear before and after. Returns their
 * number, or TEXTURE_STEPS + 1 when there are too many.
 */
static uint32_t program_make(const struct scene *scene, uint32_t root, uint8_t *wanted,
                             struct step *steps, bool *needs_p)
{
    uint32_t members[TEXTURE_STEPS], count = 0;
    bool fits = true;
    members[count++] = root;
    wanted[root] = 1;
    for (uint32_t i = 0; i < count && fits; i++)
        for (int c = 0; c < 3 && fits; c++) {
            uint32_t child = scene->textures[members[i]].child[c];
            if (child == 0 || wanted[child - 1])
                continue;
            fits = count < TEXTURE_STEPS;
            if (fits) {
                wanted[child - 1] = 1;
                members[count++] = child - 1;
            }
        }
    for (uint32_t i = 0; i < count; i++)
        wanted[members[i]] = 0;
    if (!fits)
        return TEXTURE_STEPS + 1;

    /* Few, so insertion is quick */
    for (uint32_t i = 1; i < count; i++)
        for (uint32_t k = i; k > 0 && members[k - 1] > members[k]; k--) {
            uint32_t other = members[k];
            members[k] = members[k - 1];
            members[k - 1] = other;
        }
    *needs_p = false;
    for (uint32_t i = 0; i < count; i++) {
        const struct texture *texture = &scene->textures[members[i]];
        *needs_p |= uses_p(texture);
        steps[i] = (struct step){ .texture = members[i] };
        for (int c = 0; c < 3; c++)
            for (uint32_t k = 0; texture->child[c] != 0 && k < i; k++)
                if (members[k] == texture->child[c] - 1)
                    steps[i].child[c] = (uint8_t)(k + 1);
    }
    return count;
}

static bool programs_open(struct texture_set *set, struct err *err)
{
    const struct scene *scene = set->scene;
    uint32_t n = scene->texture_count;
    size_t capacity = 0, used = 0;
    uint8_t *wanted = calloc((size_t)n + 1, 1);
    set->programs = calloc((size_t)n + 1, sizeof(*set->programs));
    if (wanted == NULL || set->programs == NULL)
        goto no_memory;
    for (uint32_t i = 0; i < n; i++) {
        if (used + TEXTURE_STEPS > capacity) {
            capacity = 2 * (used + TEXTURE_STEPS);
            struct step *grown = realloc(set->steps, capacity * sizeof(*grown));
            if (grown == NULL)
                goto no_memory;
            set->steps = grown;
        }
        struct program *program = &set->programs[i];
        program->first = (uint32_t)used;
        program->count = program_make(scene, i, wanted, set->steps + used, &program->uses_p);
        if (program->count > TEXTURE_STEPS || used > UINT32_MAX - TEXTURE_STEPS) {
            free(wanted);
            return err_set(err, ERR_SCENE, "texture %u is made of more than %d others", i,
                           TEXTURE_STEPS - 1);
        }
        used += program->count;
    }
    free(wanted);
    return true;

no_memory:
    free(wanted);
    return err_set(err, ERR_MEMORY, "no memory for %u textures", n);
}

static bool pictures_open(struct texture_set *set, struct err *err)
{
    static const size_t texel_size[] = { 1, 1, 2, 4 };
    const struct scene *scene = set->scene;
    size_t levels = 0;
    for (uint32_t i = 0; i < scene->picture_count; i++)
        levels += scene->pictures[i].levels;
    set->first_level = calloc((size_t)scene->picture_count + 1, sizeof(*set->first_level));
    set->levels = calloc(levels + 1, sizeof(*set->levels));
    if (set->first_level == NULL || set->levels == NULL || levels > UINT32_MAX)
        return err_set(err, ERR_MEMORY, "no memory for %u pictures", scene->picture_count);

    struct level *level = set->levels;
    for (uint32_t i = 0; i < scene->picture_count; i++) {
        const struct scene_picture *picture = &scene->pictures[i];
        const uint8_t *texels = scene->texels + (size_t)picture->first_block * TEXEL_BLOCK;
        set->first_level[i] = (uint32_t)(level - set->levels);
        for (uint32_t l = 0; l < picture->levels; l++, level++) {
            uint32_t width = picture->width >> l, height = picture->height >> l;
            level->width = (int32_t)(width > 0 ? width : 1);
            level->height = (int32_t)(height > 0 ? height : 1);
            level->texels = texels;
            texels += (size_t)level->width * (size_t)level->height * picture->channels *
                      texel_size[picture->texel];
        }
    }
    return true;
}

struct texture_set *texture_set_open(const struct scene *scene, struct err *err)
{
    struct texture_set *set = calloc(1, sizeof(*set));
    if (set == NULL) {
        err_set(err, ERR_MEMORY, "no memory for textures");
        return NULL;
    }
    set->scene = scene;
    for (int i = 0; i < 256; i++) {
        double v = i / 255.0;
        set->linear[i] = (float)v;
        set->srgb[i] = (float)(v <= 0.04045 ? v / 12.92 : elem_pow((v + 0.055) / 1.055, 2.4));
    }
    if (!programs_open(set, err) || !pictures_open(set, err)) {
        texture_set_close(set);
        return NULL;
    }
    return set;
}

void texture_set_close(struct texture_set *set)
{
    if (set == NULL)
        return;
    free(set->programs);
    free(set->steps);
    free(set->first_level);
    free(set->levels);
    free(set);
}

bool texture_uses_p(const struct texture_set *set, uint32_t index)
{
    return set->programs[index].uses_p;
}

/* ---- from the point to texture coordinates */

/* s and t, and how far each goes along the footprint */
struct coordinates {
    float st[2], width[2];
};

void texture_gradients(const struct texture_point *point, float du[3], float dv[3])
{
    float n[3];
    cross(point->dpdu, point->dpdv, n);
    float n2 = dot(n, n);
    cross(point->dpdv, n, du);
    cross(n, point->dpdu, dv);
    float scale = n2 > 0 ? 1 / n2 : 0;
    for (int axis = 0; axis < 3; axis++) {
        du[axis] *= scale;
        dv[axis] *= scale;
    }
}

/* How much s changes over the footprint when its gradient in space is g; what points out of the
 * surface does not count */
static float along_surface(const struct texture_point *point, const float g[3])
{
    float out = dot(g, point->n);
    float along[3];
    for (int axis = 0; axis < 3; axis++)
        along[axis] = g[axis] - point->n[axis] * out;
    return point->width * length(along);
}

static void to_texture_space(const struct texture *texture, const struct texture_point *point,
                             float q[3])
{
    const float *m = texture->map;
    for (int row = 0; row < 3; row++)
        q[row] = dot(m + 4 * row, point->p) + m[4 * row + 3];
}

/* The gradient in the world of what has gradient `g` in texture space */
static void to_world_gradient(const struct texture *texture, const float g[3], float out[3])
{
    const float *m = texture->map;
    for (int axis = 0; axis < 3; axis++)
        out[axis] = m[axis] * g[0] + m[4 + axis] * g[1] + m[8 + axis] * g[2];
}

/* Spherical and cylindrical coordinates, both of an angle around z */
static void round_coordinates(const struct texture *texture, const struct texture_point *point,
                              struct coordinates *at)
{
    float q[3];
    to_texture_space(texture, point, q);
    float r2 = q[0] * q[0] + q[1] * q[1];
    double phi = elem_atan2((double)q[1], (double)q[0]);
    float d_phi[3] = { -q[1] / r2, q[0] / r2, 0 }, d_other[3] = { 0, 0, 1 };
    int angle = 0; /* which of s and t it is */
    if (texture->mapping == MAPPING_SPHERICAL) {
        angle = 1;
        float length2 = r2 + q[2] * q[2], r = sqrtf(r2);
        double cosine = length2 > 0 ? (double)(q[2] / sqrtf(length2)) : 1;
        cosine = cosine < -1 ? -1 : cosine > 1 ? 1 : cosine;
        at->st[0] = (float)(elem_acos(cosine) / PI_D);
        at->st[1] = (float)((phi < 0 ? phi + 2 * PI_D : phi) / (2 * PI_D));
        float scale = (float)(1 / PI_D) / length2;
        d_other[0] = q[0] * q[2] / r * scale;
        d_other[1] = q[1] * q[2] / r * scale;
        d_other[2] = -r * scale;
    } else {
        at->st[0] = (float)((phi + PI_D) / (2 * PI_D));
        at->st[1] = q[2];
    }
    if (point->width > 0) {
        float g[3];
        to_world_gradient(texture, d_phi, g);
        at->width[angle] = along_surface(point, g) * (float)(0.5 / PI_D);
        to_world_gradient(texture, d_other, g);
        at->width[1 - angle] = along_surface(point, g);
    }
}

static struct coordinates coordinates_of(const struct texture *texture,
                                         const struct texture_point *point)
{
    const float *m = texture->map;
    struct coordinates at = { { 0, 0 }, { 0, 0 } };
    switch (texture->mapping) {
    case MAPPING_UV:
        for (int i = 0; i < 2; i++)
            at.st[i] = m[3 * i] * point->uv[0] + m[3 * i + 1] * point->uv[1] + m[3 * i + 2];
        if (point->width > 0) {
            float du[3], dv[3], g[3];
            texture_gradients(point, du, dv);
            for (int i = 0; i < 2; i++) {
                for (int axis = 0; axis < 3; axis++)
                    g[axis] = m[3 * i] * du[axis] + m[3 * i + 1] * dv[axis];
                at.width[i] = point->width * length(g);
            }
        }
        break;
    case MAPPING_PLANAR:
        for (int i = 0; i < 2; i++) {
            at.st[i] = dot(m + 4 * i, point->p) + m[4 * i + 3];
            at.width[i] = along_surface(point, m + 4 * i);
        }
        break;
    case MAPPING_POINT: { /* of a texture of two dimensions: the first two of the three */
        float q[3];
        to_texture_space(texture, point, q);
        for (int i = 0; i < 2; i++) {
            at.st[i] = q[i];
            at.width[i] = along_surface(point, m + 4 * i);
        }
        break;
    }
    default:
        round_coordinates(texture, point, &at);
    }
    /* Numbers that are none would have no texel; a footprint of no size is that of a pole */
    for (int i = 0; i < 2; i++) {
        at.st[i] = fabsf(at.st[i]) <= 3.4e38f ? at.st[i] : 0;
        at.width[i] = at.width[i] < 1e30f ? at.width[i] : 1e30f;
    }
    return at;
}

/* ---- pictures */

float texture_half(uint16_t bits)
{
    uint32_t sign = (uint32_t)(bits & 0x8000) << 16, exponent = bits >> 10 & 31,
             mantissa = bits & 0x3ff;
    float value;
    if (exponent == 0) { /* built from integers, as render threads take denormals for zero */
        value = (float)mantissa * 0x1p-24f;
        return sign ? -value : value;
    }
    uint32_t word = sign | (exponent == 31 ? 0x7f800000u : (exponent + 112) << 23) | mantissa << 13;
    memcpy(&value, &word, sizeof(value));
    return value;
}

/* What is read of every texel of a picture */
struct channels {
    uint32_t first, count; /* count 0: the alpha of a picture that has none, 1 */
    const float *table;    /* what 8 bits mean */
};

static struct channels channels_of(const struct texture_set *set, const struct texture *texture,
                                   const struct scene_picture *picture)
{
    uint32_t channels = picture->channels;
    bool grey = channels < 3, has_alpha = channels == 2 || channels == 4;
    bool srgb = picture->texel == TEXEL_U8_SRGB && texture->channel != 3;
    struct channels read = { .first = 0, .count = 1, .table = srgb ? set->srgb : set->linear };
    if (texture->channel == 3) {
        read.first = channels - 1;
        read.count = has_alpha;
    } else if (!grey) {
        read.first = texture->channel == SCENE_NONE ? 0 : texture->channel;
        read.count = texture->channel == SCENE_NONE ? 3 : 1;
    }
    return read;
}

static void texel_add(const struct scene_picture *picture, const struct level *level,
                      const struct channels *read, int32_t x, int32_t y, float weight, float sum[3])
{
    size_t first = ((size_t)y * (size_t)level->width + (size_t)x) * picture->channels + read->first;
    switch (picture->texel) {
    case TEXEL_U8:
    case TEXEL_U8_SRGB:
        for (uint32_t c = 0; c < read->count; c++)
            sum[c] += weight * read->table[level->texels[first + c]];
        break;
    case TEXEL_HALF:
        for (uint32_t c = 0; c < read->count; c++) {
            uint16_t bits;
            memcpy(&bits, level->texels + 2 * (first + c), sizeof(bits));
            sum[c] += weight * texture_half(bits);
        }
        break;
    default:
        for (uint32_t c = 0; c < read->count; c++) {
            float value;
            memcpy(&value, level->texels + 4 * (first + c), sizeof(value));
            sum[c] += weight * value;
        }
    }
    if (read->count == 0)
        sum[0] += weight;
}

/* What is left of s without its whole part, with its sign; floats from 2^23 on are whole */
static float fraction(float s)
{
    return fabsf(s) < 0x1p23f ? s - (float)(int32_t)s : 0;
}

/* The coordinate moved to where the texels are: [0, 1], or a little around it where wrapping is
 * left to the texels' numbers. Any float comes out in range (NUMERICS H17). */
static float wrap_coordinate(uint32_t wrap, float s)
{
    switch (wrap) {
    case WRAP_REPEAT:
        s = fraction(s);
        return s < 0 ? s + 1 : s;
    case WRAP_MIRROR:
        s = fabsf(2 * fraction(0.5f * s));
        return s > 1 ? 2 - s : s;
    case WRAP_CLAMP:
        return lesser(greater(s, 0), 1);
    default:
        return lesser(greater(s, -2), 3);
    }
}

/* Texel number i of a row of `size`, or -1 where there is nothing. One step beyond an end is
 * enough: the coordinate was wrapped before. */
static int32_t wrap_texel(uint32_t wrap, int32_t i, int32_t size)
{
    if (i >= 0 && i < size)
        return i;
    switch (wrap) {
    case WRAP_REPEAT:
        return i < 0 ? size - 1 : 0;
    case WRAP_BLACK:
        return -1;
    default:
        return i < 0 ? 0 : size - 1;
    }
}

static int32_t floor_of(float x)
{
    int32_t i = (int32_t)x;
    return (float)i > x ? i - 1 : i;
}

static void level_at(const struct texture *texture, const struct scene_picture *picture,
                     const struct level *level, const struct channels *read, const float st[2],
                     float sum[3])
{
    float x = st[0] * (float)level->width, y = st[1] * (float)level->height;
    const uint32_t *wrap = texture->wrap;
    sum[0] = sum[1] = sum[2] = 0;
    if (texture->flags & TEXTURE_NEAREST) {
        int32_t i = wrap_texel(wrap[0], floor_of(x), level->width);
        int32_t k = wrap_texel(wrap[1], floor_of(y), level->height);
        if (i >= 0 && k >= 0)
            texel_add(picture, level, read, i, k, 1, sum);
        return;
    }
    x -= 0.5f;
    y -= 0.5f;
    int32_t x0 = floor_of(x), y0 = floor_of(y);
    float fx = x - (float)x0, fy = y - (float)y0;
    const float share_x[2] = { 1 - fx, fx }, share_y[2] = { 1 - fy, fy };
    for (int dy = 0; dy < 2; dy++) {
        int32_t k = wrap_texel(wrap[1], y0 + dy, level->height);
        for (int dx = 0; dx < 2; dx++) {
            int32_t i = wrap_texel(wrap[0], x0 + dx, level->width);
            float weight = share_x[dx] * share_y[dy];
            if (i >= 0 && k >= 0 && weight != 0)
                texel_add(picture, level, read, i, k, weight, sum);
        }
    }
}

/*
 * Levels are chosen by the footprint in texels, as pbrt-v4 does: a level's texel is as wide as
 * twice the footprint. Between two, the share is linear in the width rather than its logarithm.
 */
static void picture_at(const struct texture_set *set, const struct texture *texture,
                       const struct coordinates *at, float rgb[3])
{
    const struct scene_picture *picture = &set->scene->pictures[texture->picture];
    const struct level *levels = set->levels + set->first_level[texture->picture];
    float st[2] = { wrap_coordinate(texture->wrap[0], at->st[0]),
                    wrap_coordinate(texture->wrap[1], 1 - at->st[1]) };
    float width = 2 * greater(at->width[0] * (float)picture->width,
                              at->width[1] * (float)picture->height);
    uint32_t last = picture->levels - 1, l = 0;
    while (l < last && width >= 2) {
        width *= 0.5f;
        l++;
    }
    struct channels read = channels_of(set, texture, picture);
    level_at(texture, picture, levels + l, &read, st, rgb);
    if (l < last && width > 1 && !(texture->flags & TEXTURE_NEAREST)) {
        float share = width - 1, coarse[3];
        level_at(texture, picture, levels + l + 1, &read, st, coarse);
        for (int c = 0; c < 3; c++)
            rgb[c] = (1 - share) * rgb[c] + share * coarse[c];
    }
    if (read.count < 3)
        rgb[1] = rgb[2] = rgb[0];
}

/* ---- textures of a formula */

/* The square wave that is 1 from 0 to 1 and -1 from 1 to 2, twice integrated (and periodic) */
static double square_wave_integral(double x)
{
    double half = x * 0.5, y = half - floor(half) - 0.5;
    return y * (1 - 2 * fabs(y));
}

/* That wave seen through a triangle filter of radius r. At most one edge lies within a radius below
 * 1/2, and gives a form without cancellation. */
static double filtered_wave(float x_float, float r_float)
{
    double x = (double)x_float, r = (double)r_float;
    if (r >= 0.5) {
        if (r > 1e4) /* what is left of the wave is less than 1e-8 */
            return 0;
        return (square_wave_integral(x + r) - 2 * square_wave_integral(x) +
                square_wave_integral(x - r)) /
               (r * r);
    }
    double here = fmod(floor(x), 2) == 0 ? 1 : -1;
    double edge = x - floor(x); /* to the edge below; the one above is at 1 - edge */
    if (edge > 0.5)
        edge = 1 - edge;
    if (edge >= r)
        return here;
    double beyond = 1 - edge / r;
    return here * (1 - beyond * beyond); /* a share of beyond^2 / 2 has the other sign */
}

/* Two directions along the surface, unit and at right angles */
static void tangents(const float n[3], float a[3], float b[3])
{
    float sign = copysignf(1, n[2]);
    float k = -1 / (sign + n[2]), c = n[0] * n[1] * k;
    a[0] = 1 + sign * n[0] * n[0] * k;
    a[1] = sign * c;
    a[2] = -sign * n[0];
    b[0] = c;
    b[1] = sign + n[1] * n[1] * k;
    b[2] = -n[1];
}

/* The footprint's two axes in texture space */
static void axes_in_texture_space(const struct texture *texture, const struct texture_point *point,
                                  float axes[2][3])
{
    float world[2][3];
    tangents(point->n, world[0], world[1]);
    for (int i = 0; i < 2; i++)
        for (int row = 0; row < 3; row++)
            axes[i][row] = point->width * dot(texture->map + 4 * row, world[i]);
}

/* Share of child 1 */
static float checkerboard_at(const struct texture *texture, const struct texture_point *point)
{
    if (texture->flags & TEXTURE_THREE_SPACE) {
        float q[3], axes[2][3];
        to_texture_space(texture, point, q);
        axes_in_texture_space(texture, point, axes);
        double product = 1;
        for (int i = 0; i < 3; i++) {
            float r = 1.5f * greater(fabsf(axes[0][i]), fabsf(axes[1][i]));
            product *= filtered_wave(q[i], r);
        }
        return (float)(0.5 - 0.5 * product);
    }
    struct coordinates at = coordinates_of(texture, point);
    return (float)(0.5 - 0.5 * filtered_wave(at.st[0], 1.5f * at.width[0]) *
                             filtered_wave(at.st[1], 1.5f * at.width[1]));
}

/* The longer squared axis of the footprint times `scale` */
static float footprint2(const struct texture *texture, const struct texture_point *point,
                        float scale)
{
    float axes[2][3];
    axes_in_texture_space(texture, point, axes);
    return scale * scale * greater(dot(axes[0], axes[0]), dot(axes[1], axes[1]));
}

/* pbrt-v4's marble: a cubic spline through nine colours, which a sine of noise runs along */
static void marble_at(const struct texture *texture, const struct texture_point *point,
                      float rgb[3])
{
    static const float colors[9][3] = {
        { .58f, .58f, .6f }, { .58f, .58f, .6f }, { .58f, .58f, .6f },
        { .5f, .5f, .5f },   { .6f, .59f, .58f }, { .58f, .58f, .6f },
        { .58f, .58f, .6f }, { .2f, .2f, .33f },  { .58f, .58f, .6f },
    };
    enum { SEGMENTS = 6 };
    float q[3];
    to_texture_space(texture, point, q);
    for (int axis = 0; axis < 3; axis++)
        q[axis] *= texture->scale;
    float noise = noise_fbm(q, footprint2(texture, point, texture->scale), texture->omega,
                            texture->octaves);
    double wave = elem_sin(fmod((double)(q[1] + texture->variation * noise), 2 * PI_D));
    float t = (float)(0.5 + 0.5 * wave);
    t = t > 0 ? lesser(t, 1) * SEGMENTS : 0; /* also where it is not a number */
    int first = (int)t < SEGMENTS ? (int)t : SEGMENTS - 1;
    t -= (float)first;
    float s = 1 - t;
    for (int c = 0; c < 3; c++)
        rgb[c] = 1.5f * (s * s * s * colors[first][c] + 3 * s * s * t * colors[first + 1][c] +
                         3 * s * t * t * colors[first + 2][c] + t * t * t * colors[first + 3][c]);
}

static float noises_at(const struct texture *texture, const struct texture_point *point)
{
    float q[3];
    to_texture_space(texture, point, q);
    float width2 = footprint2(texture, point, 1);
    switch (texture->kind) {
    case TEXTURE_FBM:
        return noise_fbm(q, width2, texture->omega, texture->octaves);
    case TEXTURE_WRINKLED:
        return noise_turbulence(q, width2, texture->omega, texture->octaves);
    default: { /* waves on water: their height, times how strong the wind blows there */
        float far[3] = { 0.1f * q[0], 0.1f * q[1], 0.1f * q[2] };
        float wind = noise_fbm(far, 0.01f * width2, 0.5f, 3);
        return fabsf(wind) * noise_fbm(q, width2, 0.5f, 6);
    }
    }
}

/* ---- one step */

/* (1 - t) a + t b, exactly a at 0 and b at 1 */
static void mix(const float a[3], const float b[3], const float t[3], float rgb[3])
{
    for (int c = 0; c < 3; c++)
        rgb[c] = t[c] == 0 ? a[c] : t[c] == 1 ? b[c] : (1 - t[c]) * a[c] + t[c] * b[c];
}

static void mix_by(const float a[3], const float b[3], float t, float rgb[3])
{
    mix(a, b, (const float[3]){ t, t, t }, rgb);
}

static void fill(float value, float rgb[3])
{
    rgb[0] = rgb[1] = rgb[2] = value;
}

static void copy(const float from[3], float rgb[3])
{
    memcpy(rgb, from, 3 * sizeof(float));
}

static void step_at(const struct texture_set *set, const struct texture *texture,
                    const struct texture_point *point, const float *const value[3], float rgb[3])
{
    switch (texture->kind) {
    case TEXTURE_IMAGE: {
        struct coordinates at = coordinates_of(texture, point);
        picture_at(set, texture, &at, rgb);
        for (int c = 0; c < 3; c++)
            rgb[c] *= texture->scale;
        break;
    }
    case TEXTURE_SCALE:
        for (int c = 0; c < 3; c++)
            rgb[c] = value[0][c] * value[1][c];
        break;
    case TEXTURE_MIX:
        mix(value[0], value[1], value[2], rgb);
        break;
    case TEXTURE_CHECKERBOARD:
        mix_by(value[0], value[1], checkerboard_at(texture, point), rgb);
        break;
    case TEXTURE_BILERP: {
        struct coordinates at = coordinates_of(texture, point);
        float s = at.st[0], t = at.st[1];
        for (int c = 0; c < 3; c++)
            rgb[c] = (1 - s) * ((1 - t) * texture->value[0][c] + t * texture->value[1][c]) +
                     s * ((1 - t) * texture->value[2][c] + t * texture->value[3][c]);
        break;
    }
    case TEXTURE_FBM:
    case TEXTURE_WRINKLED:
    case TEXTURE_WINDY:
        fill(noises_at(texture, point), rgb);
        break;
    case TEXTURE_DOTS: {
        struct coordinates at = coordinates_of(texture, point);
        copy(noise_in_dot(at.st[0], at.st[1]) ? value[0] : value[1], rgb);
        break;
    }
    case TEXTURE_MARBLE:
        marble_at(texture, point, rgb);
        break;
    case TEXTURE_VERTEX_COLOR:
        if (texture->channel == SCENE_NONE)
            copy(point->color, rgb);
        else
            fill(point->color[texture->channel], rgb);
        break;
    case TEXTURE_DIRECTION: /* child 0 where the surface faces along d, as pbrt-v4 */
        mix_by(value[1], value[0], fabsf(dot(point->n, texture->value[2])), rgb);
        break;
    case TEXTURE_STEP:
        for (int c = 0; c < 3; c++)
            rgb[c] = value[0][c] >= value[1][c] ? 1 : 0;
        break;
    default:
        copy(value[0], rgb);
    }
    if (texture->flags & TEXTURE_INVERT)
        for (int c = 0; c < 3; c++)
            rgb[c] = greater(1 - rgb[c], 0);
}

void texture_at(const struct texture_set *set, uint32_t index, const struct texture_point *point,
                float rgb[3])
{
    float values[TEXTURE_STEPS][3];
    const struct program *program = &set->programs[index];
    for (uint32_t i = 0; i < program->count; i++) {
        const struct step *step = &set->steps[program->first + i];
        const struct texture *texture = &set->scene->textures[step->texture];
        const float *value[3];
        for (int c = 0; c < 3; c++)
            value[c] = step->child[c] != 0 ? values[step->child[c] - 1] : texture->value[c];
        step_at(set, texture, point, value, values[i]);
    }
    copy(values[program->count - 1], rgb);
}
