#include "master/pbrt_environments.h"

#include "common/direction_map.h"
#include "common/elem.h"
#include "master/pbrt_reader.h"

#include <math.h>

#define PI 3.14159265358979323846

/* A light's picture while it is read */
struct chart {
    const struct scene_picture *picture;
    const uint8_t *texels;
    uint32_t layout;
    double to_light[9];   /* up to a scale, before a projection's field of view */
    double half_width[2]; /* projection: of the picture at z = 1 */
};

bool pbrt_environments_read(struct pbrt_reader *reader, const struct pbrt_token *filename,
                            bool single, uint32_t *index)
{
    const struct picture_wish how = { .encoding = ENCODING_AS_FOUND, .single = single };
    const char *path = pbrt_lexer_resolve(reader->lexer, filename);
    if (path == NULL)
        return pbrt_report_error(reader, &filename->pos, "no file can be read from here");
    if (!scene_pictures_read(&reader->pictures, reader->build, path, &how, index, reader->err))
        return err_wrap(reader->err, "%s:%d:%d", filename->pos.path, filename->pos.line,
                        filename->pos.column);
    if (reader->pictures.mended > 0)
        pbrt_report_note(reader, &filename->pos,
                         "%llu texels of this light are negative or not finite, and were mended",
                         (unsigned long long)reader->pictures.mended);
    return true;
}

/* Which layout the picture has */
static bool choose_layout(struct pbrt_reader *reader, const struct pbrt_environment *wish,
                          struct chart *chart)
{
    uint32_t width = chart->picture->width, height = chart->picture->height;
    if (wish->kind == PBRT_PROJECTION) {
        chart->layout = ENVIRONMENT_PROJECTION;
        return true;
    }
    if (width == height) {
        chart->layout = ENVIRONMENT_SQUARE;
        return true;
    }
    if (width != 2 * height)
        return pbrt_report_error(reader, &wish->filename->pos,
                                 "a light's picture is square, with pbrt-v4's mapping of equal "
                                 "areas, or twice as wide as high; this one has %ux%u texels",
                                 width, height);
    chart->layout = ENVIRONMENT_LAT_LONG;
    pbrt_report_note(reader, &wish->filename->pos,
                     "this picture is twice as wide as high and read as latitude and longitude; "
                     "pbrt-v4 would want it square, with its mapping of equal areas");
    return true;
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* a minus its part along the unit vector n, as a unit vector */
static void straighten(double a[3], const double n[3], const double m[3])
{
    double along_n = dot(a, n), along_m = dot(a, m);
    for (int i = 0; i < 3; i++)
        a[i] -= along_n * n[i] + along_m * m[i];
    double length = sqrt(dot(a, a));
    for (int i = 0; i < 3; i++)
        a[i] /= length;
}

/*
 * The current transform, from the world to the light. A scale in it means nothing: only directions
 * count. Matrices that files hold with a few digits are rounded to the rotation they stand for.
 */
static bool turn(struct pbrt_reader *reader, const struct pbrt_environment *wish,
                 struct chart *chart)
{
    struct transform inverse;
    double rows[3][3], lengths[3], nothing[3] = { 0, 0, 0 };
    bool good = transform_invert(&reader->state.ctm, &inverse);
    for (int i = 0; good && i < 3; i++) {
        for (int j = 0; j < 3; j++)
            rows[i][j] = inverse.m[i][j];
        lengths[i] = sqrt(dot(rows[i], rows[i]));
        good = lengths[i] > 0 && isfinite(lengths[i]);
    }
    for (int i = 0; good && i < 3; i++) {
        int k = (i + 1) % 3;
        good = fabs(lengths[i] / lengths[k] - 1) < 1e-3 &&
               fabs(dot(rows[i], rows[k])) < 1e-3 * lengths[i] * lengths[k];
    }
    if (!good)
        return pbrt_report_error(reader, &wish->filename->pos,
                                 "the transform stretches this light's picture; only rotations, "
                                 "mirror images and one scale for all are possible");
    straighten(rows[0], nothing, nothing);
    straighten(rows[1], rows[0], nothing);
    straighten(rows[2], rows[0], rows[1]);

    /* pbrt-v4 exchanges y and z for goniometric lights, and turns projections upside down */
    static const struct {
        int row[3];
        double sign[3];
    } orders[] = {
        [PBRT_INFINITE] = { { 0, 1, 2 }, { 1, 1, 1 } },
        [PBRT_GONIOMETRIC] = { { 0, 2, 1 }, { 1, 1, 1 } },
        [PBRT_PROJECTION] = { { 0, 1, 2 }, { 1, -1, 1 } },
    };
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            chart->to_light[3 * i + j] = orders[wish->kind].sign[i] *
                                         rows[orders[wish->kind].row[i]][j];
    return true;
}

/* A projection fills its field of view along the picture's shorter side */
static bool widen(struct pbrt_reader *reader, const struct pbrt_environment *wish,
                  struct chart *chart)
{
    if (!(wish->fov > 0 && wish->fov < PI))
        return pbrt_report_error(reader, &wish->filename->pos,
                                 "a field of view of %g degrees is not possible",
                                 wish->fov * (180 / PI));
    double tangent = elem_tan(wish->fov / 2);
    double aspect = (double)chart->picture->width / chart->picture->height;
    chart->half_width[0] = tangent * fmax(aspect, 1);
    chart->half_width[1] = tangent * fmax(1 / aspect, 1);
    for (int i = 0; i < 6; i++)
        chart->to_light[i] /= chart->half_width[i / 3];
    return true;
}

/* The solid angle of texel (x, y), and its cosine with +z */
static double texel_omega(const struct chart *chart, uint32_t x, uint32_t y, double *cosine)
{
    double width = chart->picture->width, height = chart->picture->height, w[3];
    direction_map_direction(chart->layout, (x + 0.5) / width, (y + 0.5) / height, w);
    *cosine = w[2];
    if (chart->layout != ENVIRONMENT_PROJECTION)
        return direction_map_omega(chart->layout, chart->picture->width, chart->picture->height, y);
    double X = w[0] * chart->half_width[0], Y = w[1] * chart->half_width[1];
    double d2 = 1 + X * X + Y * Y;
    *cosine = 1 / sqrt(d2);
    return 4 * chart->half_width[0] * chart->half_width[1] / (width * height) / (d2 * sqrt(d2));
}

/* The mean over all directions, and the illuminance of a surface that faces +z */
static void measure(const struct chart *chart, double mean[3], double *illuminance)
{
    static const double weight[3] = { 0.2126, 0.7152, 0.0722 };
    mean[0] = mean[1] = mean[2] = *illuminance = 0;
    for (uint32_t y = 0; y < chart->picture->height; y++)
        for (uint32_t x = 0; x < chart->picture->width; x++) {
            double rgb[3], cosine, omega = texel_omega(chart, x, y, &cosine);
            direction_map_texel(chart->picture, chart->texels, x, y, rgb);
            mean[0] += rgb[0] * (omega / (4 * PI));
            mean[1] += rgb[1] * (omega / (4 * PI));
            mean[2] += rgb[2] * (omega / (4 * PI));
            *illuminance += dot(rgb, weight) * fmax(cosine, 0) * omega;
        }
}

bool pbrt_environments_add(struct pbrt_reader *reader, const struct pbrt_environment *wish,
                           struct light *light)
{
    struct scene_build *build = reader->build;
    uint32_t index;
    if (!pbrt_environments_read(reader, wish->filename, wish->kind == PBRT_GONIOMETRIC, &index))
        return false;
    struct chart chart = { .picture = (const struct scene_picture *)build->pictures.data + index,
                           .texels = build->texels.data };
    if (!choose_layout(reader, wish, &chart) || !turn(reader, wish, &chart))
        return false;
    if (wish->kind == PBRT_PROJECTION && !widen(reader, wish, &chart))
        return false;

    double mean[3], illuminance, scale = 1;
    measure(&chart, mean, &illuminance);
    if (wish->wanted > 0) {
        /* pbrt-v4 counts the upper half of the picture as half of its solid angle */
        double power = 4 * PI * (0.2126 * mean[0] + 0.7152 * mean[1] + 0.0722 * mean[2]);
        double has = wish->kind == PBRT_INFINITE ? illuminance / 2 : power;
        scale = has > 0 ? wish->wanted / has : 0;
    }
    struct environment *added = growing_add(&build->environments, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = (struct environment){ .picture = index, .layout = chart.layout };
    for (int i = 0; i < 9; i++)
        added->to_light[i] = (float)chart.to_light[i];
    for (int c = 0; c < 3; c++) {
        added->scale[c] = (float)(wish->scale[c] * scale);
        light->radiance[c] = (float)(mean[c] * wish->scale[c] * scale);
        if (!isfinite(added->scale[c]) || !isfinite(light->radiance[c]))
            return pbrt_report_error(reader, &wish->filename->pos,
                                     "the light's numbers are too large");
    }
    light->environment = (uint32_t)build->environments.count;
    return true;
}
