#include "master/scene_emission.h"

#include "common/direction_map.h"
#include "common/elem.h"
#include "common/scene.h"

#include <math.h>

#define DEPTH_MAX   8   /* of products within products */
#define SIDES_MAX   32  /* points along a side of a triangle */
#define SIDES_LEAST 2   /* the same without a budget */
#define FAR_AWAY    1e9 /* texture coordinates beyond have no texels */

static bool is_picture(const struct texture *texture)
{
    return texture->kind == TEXTURE_IMAGE && texture->mapping == MAPPING_UV;
}

/* Where (u, v) is in the picture, in texels from its top left corner; not wrapped */
static void place_in(const struct scene *scene, const struct texture *texture, const double uv[2],
                     double at[2])
{
    const struct scene_picture *picture = &scene->pictures[texture->picture];
    const float *m = texture->map;
    double s = (double)m[0] * uv[0] + (double)m[1] * uv[1] + (double)m[2];
    double t = (double)m[3] * uv[0] + (double)m[4] * uv[1] + (double)m[5];
    at[0] = fmin(fmax(s, -FAR_AWAY), FAR_AWAY) * picture->width;
    at[1] = (1 - fmin(fmax(t, -FAR_AWAY), FAR_AWAY)) * picture->height;
}

/* A texel's number in a row of `size`; false where there is none */
static bool wrap(uint32_t how, double place, uint32_t size, uint32_t *index)
{
    double i = floor(place), n = size;
    if (how == WRAP_BLACK && !(i >= 0 && i < n))
        return false;
    if (how == WRAP_REPEAT)
        i -= n * floor(i / n);
    if (how == WRAP_MIRROR) {
        i -= 2 * n * floor(i / (2 * n));
        i = i < n ? i : 2 * n - 1 - i;
    }
    *index = (uint32_t)fmin(fmax(i, 0), n - 1);
    return true;
}

static void texel(const struct scene *scene, const struct texture *texture, double x, double y,
                  double rgb[3])
{
    const struct scene_picture *picture = &scene->pictures[texture->picture];
    uint32_t i, k;
    rgb[0] = rgb[1] = rgb[2] = 0;
    if (!wrap(texture->wrap[0], x, picture->width, &i) ||
        !wrap(texture->wrap[1], y, picture->height, &k))
        return;
    direction_map_texel(picture, scene->texels, i, k, rgb);
    for (int c = 0; c < 3; c++)
        rgb[c] *= (double)texture->scale;
}

static void value_at(const struct scene *scene, uint32_t index, const double uv[2], int depth,
                     double rgb[3])
{
    const struct texture *texture = &scene->textures[index];
    bool product = texture->kind == TEXTURE_SCALE && depth < DEPTH_MAX;
    rgb[0] = rgb[1] = rgb[2] = 1;
    if (texture->flags & TEXTURE_INVERT)
        return;
    if (is_picture(texture)) {
        double at[2];
        place_in(scene, texture, uv, at);
        texel(scene, texture, at[0], at[1], rgb);
    }
    for (int i = 0; i < 2 && (product || texture->kind == TEXTURE_CONSTANT); i++) {
        double factor[3];
        for (int c = 0; c < 3; c++)
            factor[c] = (double)texture->value[i][c];
        if (texture->child[i] != 0)
            value_at(scene, texture->child[i] - 1, uv, depth + 1, factor);
        for (int c = 0; c < 3 && (product || i == 0); c++)
            rgb[c] *= factor[c];
    }
}

/* The texels that a triangle lies on, those that are interpolated with them included */
static void box_in(const struct scene *scene, const struct texture *texture, const double uv[3][2],
                   double low[2], double high[2])
{
    for (int i = 0; i < 3; i++) {
        double at[2];
        place_in(scene, texture, uv[i], at);
        for (int k = 0; k < 2; k++) {
            low[k] = i == 0 ? at[k] : fmin(low[k], at[k]);
            high[k] = i == 0 ? at[k] : fmax(high[k], at[k]);
        }
    }
    for (int k = 0; k < 2; k++) {
        low[k] = floor(low[k] - 1);
        high[k] = floor(high[k] + 1);
    }
}

static bool picture_is_black(const struct scene *scene, const struct texture *texture,
                             const double low[2], const double high[2], double *budget)
{
    double rgb[3];
    if (!((high[0] - low[0] + 1) * (high[1] - low[1] + 1) <= *budget))
        return false;
    for (double y = low[1]; y <= high[1]; y++)
        for (double x = low[0]; x <= high[0]; x++) {
            texel(scene, texture, x, y, rgb);
            *budget -= 1;
            if (rgb[0] > 0 || rgb[1] > 0 || rgb[2] > 0)
                return false;
        }
    return true;
}

/* Is it black all over the triangle? And how many texels wide is that, in its finest picture? */
static bool is_black(const struct scene *scene, uint32_t index, const double uv[3][2], int depth,
                     double *budget, double *texels)
{
    const struct texture *texture = &scene->textures[index];
    if (texture->flags & TEXTURE_INVERT)
        return false;
    if (is_picture(texture)) {
        double low[2], high[2];
        box_in(scene, texture, uv, low, high);
        *texels = fmax(*texels, fmax(high[0] - low[0], high[1] - low[1]));
        return picture_is_black(scene, texture, low, high, budget);
    }
    bool black = false;
    for (int i = 0; i < 2 && texture->kind == TEXTURE_SCALE && depth < DEPTH_MAX; i++)
        black |= texture->child[i] != 0 &&
                 is_black(scene, texture->child[i] - 1, uv, depth + 1, budget, texels);
    return black;
}

bool scene_emission_triangle(const struct scene *scene, uint32_t texture, const double uv[3][2],
                             double *budget, double mean[3])
{
    double texels = 1;
    mean[0] = mean[1] = mean[2] = 0;
    if (is_black(scene, texture, uv, 0, budget, &texels))
        return false;
    /* n^2 small triangles, at their middles: those that point up, then those that point down */
    int n = (int)fmin(ceil(texels), *budget > 0 ? SIDES_MAX : SIDES_LEAST);
    *budget -= n * n;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 2 * (n - i) - 1; k++) {
            bool down = k >= n - i;
            double third = down ? 2.0 / 3 : 1.0 / 3;
            double a = (i + third) / n, b = ((down ? k - (n - i) : k) + third) / n, at[2], rgb[3];
            for (int axis = 0; axis < 2; axis++)
                at[axis] = uv[0][axis] * (1 - a - b) + uv[1][axis] * a + uv[2][axis] * b;
            value_at(scene, texture, at, 0, rgb);
            for (int c = 0; c < 3; c++)
                mean[c] += rgb[c] / ((double)n * n);
        }
    return true;
}

void scene_emission_quadric(const struct scene *scene, uint32_t texture,
                            const struct quadric *quadric, double mean[3])
{
    const int n = SIDES_MAX;
    const double pi = 3.14159265358979323846;
    double hole = (double)quadric->inner_radius / (double)quadric->radius;
    mean[0] = mean[1] = mean[2] = 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) {
            /* Evenly in area: along z of a sphere, in the square of a disk's radius */
            double share = (k + 0.5) / n, rgb[3];
            double r = sqrt(hole * hole + (1 - hole * hole) * share);
            double v = quadric->kind == QUADRIC_SPHERE ? 1 - elem_acos(2 * share - 1) / pi
                                                       : (1 - r) / (1 - hole);
            const double uv[2] = { (i + 0.5) / n, v };
            value_at(scene, texture, uv, 0, rgb);
            for (int c = 0; c < 3; c++)
                mean[c] += rgb[c] / ((double)n * n);
        }
}
