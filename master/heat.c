#include "master/heat.h"

#include "common/err.h"
#include "master/image.h"
#include "master/png.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EPSILON 0.01 /* relMSE's, in the denominator */

static const uint8_t UNKNOWN[3] = { 0, 200, 200 };

/* ---- values */

/* The pixel's part of the relMSE; NaN when it is unknown. */
static float relative_square(const float *const planes[6], size_t p)
{
    double sum = 0;
    for (int c = 0; c < 3; c++) {
        double value = planes[c][p], error = planes[3 + c][p];
        sum += error * error / (value * value + EPSILON) / 3;
    }
    return isfinite(sum) ? (float)sum : NAN;
}

bool heat_values(const struct image *image, float *values, struct err *err)
{
    static const char *const NAMES[6] = { "R", "G", "B", "stderr.R", "stderr.G", "stderr.B" };
    const float *planes[6];
    for (int i = 0; i < 6; i++) {
        planes[i] = image_channel(image, NAMES[i]);
        if (planes[i] == NULL)
            return err_set(err, ERR_ARGUMENT, "no channel %s, which a heat map needs", NAMES[i]);
    }
    uint32_t width = image->width, height = image->height;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            double sum = 0;
            unsigned count = 0;
            for (uint32_t v = y > 0 ? y - 1 : 0; v <= y + 1 && v < height; v++)
                for (uint32_t u = x > 0 ? x - 1 : 0; u <= x + 1 && u < width; u++) {
                    float square = relative_square(planes, (size_t)v * width + u);
                    sum += isnan(square) ? 0 : (double)square;
                    count += !isnan(square);
                }
            size_t p = (size_t)y * width + x;
            values[p] = isnan(relative_square(planes, p)) ? NAN : (float)sqrt(sum / count);
        }
    return true;
}

/* ---- colours */

void heat_color(float value, uint8_t rgb[3])
{
    /* Each is lighter than the one before: in grey, it is still a scale */
    static const uint8_t STOPS[][3] = {
        { 0, 0, 0 }, { 70, 10, 120 }, { 190, 35, 75 }, { 250, 145, 20 }, { 255, 250, 200 },
    };
    enum { LAST = sizeof(STOPS) / sizeof(STOPS[0]) - 1 };
    if (isnan(value)) {
        memcpy(rgb, UNKNOWN, sizeof(UNKNOWN));
        return;
    }
    double place = value > 0 ? log((double)value / HEAT_LOWEST) / log(HEAT_HIGHEST / HEAT_LOWEST)
                             : 0;
    place = LAST * fmin(fmax(place, 0), 1);
    int below = place < LAST ? (int)place : LAST - 1;
    for (int c = 0; c < 3; c++)
        rgb[c] = (uint8_t)(STOPS[below][c] +
                           (place - below) * (STOPS[below + 1][c] - STOPS[below][c]) + 0.5);
}

/* ---- the scale: a bar of colours, and its labels in letters of 5 x 7 */

#define GLYPH_WIDTH  5
#define GLYPH_HEIGHT 7
#define BAR_HEIGHT   8
#define LEGEND       (BAR_HEIGHT + GLYPH_HEIGHT + 6)
#define NARROWEST    200 /* for the labels */

/* Rows of a letter, the top one first; its left column is bit 4. */
static const struct {
    char letter;
    uint8_t rows[GLYPH_HEIGHT];
} GLYPHS[] = {
    { '0', { 14, 17, 19, 21, 25, 17, 14 } }, { '1', { 4, 12, 4, 4, 4, 4, 14 } },
    { '.', { 0, 0, 0, 0, 0, 12, 12 } },      { '%', { 24, 25, 2, 4, 8, 19, 3 } },
    { 'u', { 0, 0, 17, 17, 17, 19, 13 } },   { 'n', { 0, 0, 22, 25, 17, 17, 17 } },
    { 'k', { 16, 16, 18, 20, 24, 20, 18 } }, { 'o', { 0, 0, 14, 17, 17, 17, 14 } },
    { 'w', { 0, 0, 17, 17, 21, 21, 10 } },
};

struct canvas {
    uint8_t *rgb;
    uint32_t width, height;
};

static void put(const struct canvas *canvas, int64_t x, int64_t y, const uint8_t rgb[3])
{
    if (x >= 0 && y >= 0 && x < canvas->width && y < canvas->height)
        memcpy(canvas->rgb + 3 * ((size_t)y * canvas->width + (size_t)x), rgb, 3);
}

static void put_text(const struct canvas *canvas, int64_t x, int64_t y, const char *text)
{
    static const uint8_t WHITE[3] = { 255, 255, 255 };
    for (; *text != '\0'; text++, x += GLYPH_WIDTH + 1)
        for (size_t g = 0; g < sizeof(GLYPHS) / sizeof(GLYPHS[0]); g++)
            for (int i = 0; GLYPHS[g].letter == *text && i < GLYPH_WIDTH * GLYPH_HEIGHT; i++)
                if (GLYPHS[g].rows[i / GLYPH_WIDTH] >> (GLYPH_WIDTH - 1 - i % GLYPH_WIDTH) & 1)
                    put(canvas, x + i % GLYPH_WIDTH, y + i / GLYPH_WIDTH, WHITE);
}

static int64_t text_width(const char *text)
{
    return (int64_t)strlen(text) * (GLYPH_WIDTH + 1) - 1;
}

/* The bar takes what the box of the unknown leaves; labels that would not fit beside each other are
 * left out. */
static void put_legend(const struct canvas *canvas, int64_t top)
{
    static const char *const LABELS[] = { "0.1%", "1%", "10%", "100%" };
    const char *unknown = "unknown";
    int64_t box = text_width(unknown) + 2;
    int64_t bar = (int64_t)canvas->width - box - 6, labels_y = top + BAR_HEIGHT + 3;
    for (int64_t x = 0; x < bar; x++) {
        double place = bar > 1 ? (double)x / (double)(bar - 1) : 0;
        uint8_t rgb[3];
        heat_color((float)(HEAT_LOWEST * pow(HEAT_HIGHEST / HEAT_LOWEST, place)), rgb);
        for (int64_t y = 0; y < BAR_HEIGHT; y++)
            put(canvas, x, top + y, rgb);
    }
    for (int64_t x = 0; x < box; x++)
        for (int64_t y = 0; y < BAR_HEIGHT; y++)
            put(canvas, (int64_t)canvas->width - box + x, top + y, UNKNOWN);
    if (bar < 12)
        return;
    put_text(canvas, (int64_t)canvas->width - box + 1, labels_y, unknown);

    int64_t end = -1, last = bar - text_width(LABELS[3]);
    for (int i = 0; i < 4; i++) {
        int64_t x = (bar - 1) * i / 3 - text_width(LABELS[i]) / 2;
        x = x < 0 ? 0 : x > last && i == 3 ? last : x;
        bool fits = x > end + 2 && (i == 3 || i == 0 || x + text_width(LABELS[i]) < last - 2);
        if (!fits && i > 0)
            continue;
        put_text(canvas, x, labels_y, LABELS[i]);
        end = x + text_width(LABELS[i]);
    }
}

bool heat_write(const struct image *image, const char *path, struct err *err)
{
    bool written = false;
    uint32_t width = image->display_width;
    struct canvas canvas = { .width = width < NARROWEST ? NARROWEST : width,
                             .height = image->display_height + 2 + LEGEND };
    float *values = malloc((size_t)image->width * image->height * sizeof(float));
    if (values == NULL)
        return err_set(err, ERR_MEMORY, "%s: out of memory", path);
    canvas.rgb = calloc((size_t)3 * canvas.width, canvas.height);
    if (canvas.rgb == NULL) {
        err_set(err, ERR_MEMORY, "%s: out of memory", path);
        goto fail_canvas;
    }
    if (!heat_values(image, values, err)) {
        err_wrap(err, "%s", path);
        goto fail_values;
    }
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            uint8_t rgb[3];
            heat_color(values[(size_t)y * image->width + x], rgb);
            int64_t to_y = (int64_t)image->data_y + y;
            if (to_y < image->display_height)
                put(&canvas, (int64_t)image->data_x + x, to_y, rgb);
        }
    put_legend(&canvas, (int64_t)image->display_height + 2);
    written = png_bytes_write(canvas.rgb, canvas.width, canvas.height, path, err);

fail_values:
    free(canvas.rgb);
fail_canvas:
    free(values);
    return written;
}
