#include "master/plot.h"

#include "common/elem.h"
#include "master/markup.h"

#include <math.h>
#include <stdint.h>

#define WIDTH        640
#define HEIGHT       380 /* of the plot without its legend */
#define SQUARE       300
#define SQUARE_EDGE  8 /* around a square without ticks */
#define FONT         13
#define LEGEND_LINE  19
#define LEGEND_SHORT 34 /* names up to here, and two of them fit beside each other */

/* Colours of middling lightness, for white paper and black, in an order that tells neighbours
 * apart; and the marker that goes with each. */
static const char *const COLOURS[] = { "#3b82c4", "#c8741a", "#2f9e6e",
                                       "#d1495b", "#8e6bbf", "#218f98" };
enum { COLOUR_COUNT = sizeof(COLOURS) / sizeof(COLOURS[0]) };

/* Where an axis' ends lie: in its numbers, or their decadic logarithms */
struct span {
    double low, high;
};

struct canvas {
    const struct plot *plot;
    FILE *out;
    struct span x, y;
    double left, top, width, height; /* of the area inside the axes */
};

static double decades(double value)
{
    return elem_log(value) * 0.43429448190325182765; /* 1 / ln 10 */
}

/* 10^exponent; exact where a double can be, so that ticks are round numbers */
static double power_of_ten(int exponent)
{
    double power = 1, factor = 10;
    for (unsigned left = (unsigned)(exponent < 0 ? -exponent : exponent); left > 0; left >>= 1) {
        power *= left & 1 ? factor : 1;
        factor *= factor;
    }
    return exponent < 0 ? 1 / power : power;
}

/* A number as its axis counts; NaN where the axis cannot show it. (Between 1e300 and its opposite
 * there is still a distance.) */
static double on_axis(const struct plot_axis *axis, double value)
{
    if (!isfinite(value) || (axis->log ? value <= 0 : fabs(value) > 1e300))
        return NAN;
    return axis->log ? decades(value) : value;
}

/* ---- the ends of an axis */

static void widen(struct span *span, double value)
{
    if (value < span->low)
        span->low = value;
    if (value > span->high)
        span->high = value;
}

/* The smallest span around all points that both axes can show, their error bars included */
static struct span span_of_data(const struct plot *plot, bool of_y)
{
    struct span span = { INFINITY, -INFINITY };
    for (size_t s = 0; s < plot->series_count; s++) {
        const struct plot_series *series = &plot->series[s];
        for (size_t i = 0; i < series->count; i++) {
            double x = on_axis(&plot->x, series->x[i]), y = on_axis(&plot->y, series->y[i]);
            if (isnan(x) || isnan(y))
                continue;
            widen(&span, of_y ? y : x);
            if (!of_y || series->error == NULL || isnan(series->error[i]))
                continue;
            for (int side = -1; side <= 1; side += 2) {
                double end = on_axis(&plot->y, series->y[i] + side * series->error[i]);
                if (!isnan(end))
                    widen(&span, end);
            }
        }
    }
    return span;
}

static struct span span_of(const struct plot *plot, const struct plot_axis *axis)
{
    if (axis->low != axis->high)
        return (struct span){ on_axis(axis, axis->low), on_axis(axis, axis->high) };
    struct span span = span_of_data(plot, axis == &plot->y);
    if (!(span.low <= span.high))
        return (struct span){ 0, 1 };
    double room = span.high > span.low ? .04 * (span.high - span.low)
                  : axis->log          ? .3
                                       : .5 + .1 * fabs(span.low);
    /* An axis of positive numbers that comes near 0 begins there */
    bool from_zero = !axis->log && span.low >= 0 && span.low < .25 * span.high;
    return (struct span){ from_zero ? 0 : span.low - room, span.high + room };
}

static double at(const struct span *span, double value)
{
    double share = (value - span->low) / (span->high - span->low);
    return share < -20 ? -20 : share > 20 ? 20 : share; /* cut off by the area's edge anyhow */
}

static double place_x(const struct canvas *c, double x)
{
    return c->left + c->width * at(&c->x, x);
}

static double place_y(const struct canvas *c, double y)
{
    return c->top + c->height * (1 - at(&c->y, y));
}

/* ---- ticks */

/* A line across at a labelled tick, or a short mark at one without */
static void draw_tick(const struct canvas *c, bool of_y, double where, const char *label)
{
    double slack = 1e-6 * ((of_y ? c->y.high : c->x.high) - (of_y ? c->y.low : c->x.low));
    const struct span *span = of_y ? &c->y : &c->x;
    if (where < span->low - slack || where > span->high + slack)
        return;
    double right = c->left + c->width, bottom = c->top + c->height;
    const char *faint = label == NULL ? "" : " stroke-opacity=\".18\"";
    if (of_y) {
        double y = place_y(c, where);
        fprintf(c->out, "<path d=\"M%.1f %.1fH%.1f\" stroke=\"currentColor\"%s/>\n", c->left, y,
                label == NULL ? c->left + 4 : right, faint);
        if (label == NULL)
            return;
        fprintf(c->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">", c->left - 6,
                y + FONT * .35);
    } else {
        double x = place_x(c, where);
        fprintf(c->out, "<path d=\"M%.1f %.1fV%.1f\" stroke=\"currentColor\"%s/>\n", x, bottom,
                label == NULL ? bottom - 4 : c->top, faint);
        if (label == NULL)
            return;
        fprintf(c->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">", x, bottom + 17);
    }
    markup_write(c->out, label, MARKUP_SVG);
    fputs("</text>\n", c->out);
}

/* Steps of 1, 2 or 5 times a power of ten, some six of them */
static void draw_linear_ticks(const struct canvas *c, bool of_y)
{
    const struct span *span = of_y ? &c->y : &c->x;
    double rough = (span->high - span->low) / (of_y ? 6 : 8);
    if (!(rough > 0) || !isfinite(rough))
        return;
    double step = power_of_ten((int)floor(decades(rough)));
    if (!(step > 0)) /* so small that powers of ten end */
        return;
    double times = rough / step;
    step *= times < 1.5 ? 1 : times < 3.5 ? 2 : times < 7.5 ? 5 : 10;
    int64_t first = (int64_t)ceil(span->low / step - 1e-6);
    for (int64_t k = first; k < first + 20; k++) {
        char label[32];
        snprintf(label, sizeof(label), "%.10g", k * step);
        draw_tick(c, of_y, k * step, label);
    }
}

/* Powers of ten; in between 2 and 5 where there are few of them */
static void draw_log_ticks(const struct canvas *c, bool of_y)
{
    const struct span *span = of_y ? &c->y : &c->x;
    double range = span->high - span->low;
    if (!(range > 0) || range > 700)
        return;
    int low = (int)floor(span->low), high = (int)ceil(span->high);
    int stride = (high - low) / (of_y ? 8 : 10) + 1;
    bool plain = low >= -4 && high <= 5; /* 0.001 and 1000 are read faster than powers */
    for (int exponent = low; exponent <= high; exponent++) {
        char label[32];
        for (int digit = 1; digit < 10; digit++) {
            bool named = digit == 1 ? exponent % stride == 0
                                    : range < 2.2 && (digit == 2 || digit == 5);
            if (digit > 1 && range > 7)
                break;
            if (plain)
                snprintf(label, sizeof(label), "%.10g",
                         exponent < 0 ? digit / power_of_ten(-exponent)
                                      : digit * power_of_ten(exponent));
            else if (digit == 1)
                snprintf(label, sizeof(label), "10^{%d}", exponent);
            else
                snprintf(label, sizeof(label),
                         "%d\xc2\xb7"
                         "10^{%d}", /* a dot in the middle */
                         digit, exponent);
            draw_tick(c, of_y, exponent + decades(digit), named ? label : NULL);
        }
    }
}

static void draw_axis(const struct canvas *c, const struct plot_axis *axis, bool of_y)
{
    if (axis->label == NULL)
        return;
    if (axis->log)
        draw_log_ticks(c, of_y);
    else
        draw_linear_ticks(c, of_y);
    double x = c->left + c->width / 2, y = c->top + c->height + 38;
    if (of_y) {
        x = 16;
        y = c->top + c->height / 2;
    }
    fprintf(c->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\"", x, y);
    if (of_y)
        fprintf(c->out, " transform=\"rotate(-90 %.1f %.1f)\"", x, y);
    putc('>', c->out);
    markup_write(c->out, axis->label, MARKUP_SVG);
    fputs("</text>\n", c->out);
}

/* ---- series */

static const char *colour_of(const struct plot_series *series, unsigned colour)
{
    return series->style & PLOT_GREY ? "currentColor" : COLOURS[colour % COLOUR_COUNT];
}

/* The shape that goes with a colour, about (x, y) */
static void draw_marker(FILE *out, unsigned colour, const char *name, double x, double y)
{
    static const char *const SHAPES[COLOUR_COUNT] = {
        "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0z",
        "m-3.6-3.6h7.2v7.2h-7.2z",
        "m0-4.6l4.4 7.8h-8.8z",
        "m0-5l5 5l-5 5l-5-5z",
        "m-4-4l8 8m0-8l-8 8",
        "m0-5v10m-5-5h10",
    };
    fprintf(out, "<path d=\"M%.1f %.1f%s\" fill=\"%s\" stroke=\"%s\" stroke-width=\"%s\"/>\n", x, y,
            SHAPES[colour % COLOUR_COUNT], name, name, colour % COLOUR_COUNT > 3 ? "2" : "1");
}

static void draw_line(const struct canvas *c, const struct plot_series *series, const char *colour)
{
    fprintf(c->out, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"%s\"%s d=\"", colour,
            series->style & PLOT_DASHED ? "1.3" : "1.8",
            series->style & PLOT_DASHED ? " stroke-dasharray=\"6 4\"" : "");
    bool drawing = false;
    for (size_t i = 0; i < series->count; i++) {
        double x = on_axis(&c->plot->x, series->x[i]), y = on_axis(&c->plot->y, series->y[i]);
        bool seen = !isnan(x) && !isnan(y);
        if (seen)
            fprintf(c->out, "%c%.1f %.1f", drawing ? 'L' : 'M', place_x(c, x), place_y(c, y));
        drawing = seen;
    }
    fputs("\"/>\n", c->out);
}

static void draw_errors(const struct canvas *c, const struct plot_series *series,
                        const char *colour)
{
    fprintf(c->out, "<path fill=\"none\" stroke=\"%s\" d=\"", colour);
    for (size_t i = 0; i < series->count; i++) {
        double x = on_axis(&c->plot->x, series->x[i]);
        double top = on_axis(&c->plot->y, series->y[i] + series->error[i]);
        double bottom = on_axis(&c->plot->y, series->y[i] - series->error[i]);
        if (isnan(x) || isnan(top))
            continue;
        /* Where a logarithm has no lower end the bar goes on to the axis */
        double y = isnan(bottom) ? c->top + c->height : place_y(c, bottom);
        fprintf(c->out, "M%.1f %.1fh6m-3 0V%.1fm-3 0h6", place_x(c, x) - 3, place_y(c, top), y);
    }
    fputs("\"/>\n", c->out);
}

static void draw_points(const struct canvas *c, const struct plot_series *series, unsigned colour)
{
    const char *name = colour_of(series, colour);
    bool dots = series->style & PLOT_DOTS;
    if (dots) /* one path, round ends of lines without length: short, for there may be thousands */
        fprintf(c->out,
                "<path fill=\"none\" stroke=\"%s\" stroke-width=\"%s\" stroke-linecap=\"round\" "
                "d=\"",
                name, series->count > 600 ? "2.4" : "3.6");
    for (size_t i = 0; i < series->count; i++) {
        double x = on_axis(&c->plot->x, series->x[i]), y = on_axis(&c->plot->y, series->y[i]);
        if (isnan(x) || isnan(y))
            continue;
        if (dots)
            fprintf(c->out, "M%.1f %.1fh0", place_x(c, x), place_y(c, y));
        else
            draw_marker(c->out, colour, name, place_x(c, x), place_y(c, y));
    }
    if (dots)
        fputs("\"/>\n", c->out);
}

static void draw_series(const struct canvas *c, const struct plot_series *series, unsigned colour)
{
    const char *name = colour_of(series, colour);
    if (series->style & (PLOT_LINE | PLOT_DASHED))
        draw_line(c, series, name);
    if (series->error != NULL)
        draw_errors(c, series, name);
    if (series->style & (PLOT_MARKERS | PLOT_DOTS))
        draw_points(c, series, colour);
}

/* ---- the legend */

static unsigned legend_columns(const struct plot *plot)
{
    for (size_t i = 0; i < plot->series_count; i++) {
        const char *name = plot->series[i].name;
        size_t length = 0; /* of characters: the later bytes of one are 10...... */
        for (; name != NULL && *name != '\0'; name++)
            length += (*name & 0xc0) != 0x80;
        if (length > LEGEND_SHORT)
            return 1;
    }
    return plot->square ? 1 : 2;
}

static size_t legend_lines(const struct plot *plot)
{
    size_t names = 0;
    for (size_t i = 0; i < plot->series_count; i++)
        names += plot->series[i].name != NULL;
    unsigned columns = legend_columns(plot);
    return (names + columns - 1) / columns;
}

/* The colour of a series, and *next for the one after it */
static unsigned take_colour(const struct plot_series *series, unsigned *next)
{
    if (series->style & PLOT_SAME)
        return *next > 0 ? *next - 1 : 0;
    return series->style & PLOT_GREY ? 0 : (*next)++;
}

static void draw_legend(const struct canvas *c, double top)
{
    unsigned next = 0, columns = legend_columns(c->plot), entry = 0;
    for (size_t i = 0; i < c->plot->series_count; i++) {
        const struct plot_series *series = &c->plot->series[i];
        unsigned own = take_colour(series, &next);
        if (series->name == NULL)
            continue;
        double x = c->left + entry % columns * (c->width / columns);
        double y = top + entry / columns * (double)LEGEND_LINE;
        const char *name = colour_of(series, own);
        if (series->style & (PLOT_LINE | PLOT_DASHED))
            fprintf(c->out, "<path d=\"M%.1f %.1fh26\" stroke=\"%s\" stroke-width=\"1.8\"%s/>\n", x,
                    y, name, series->style & PLOT_DASHED ? " stroke-dasharray=\"6 4\"" : "");
        if (series->style & PLOT_MARKERS)
            draw_marker(c->out, own, name, x + 13, y);
        if (series->style & PLOT_DOTS)
            fprintf(c->out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"2\" fill=\"%s\"/>\n", x + 13, y,
                    name);
        fprintf(c->out, "<text x=\"%.1f\" y=\"%.1f\">", x + 33, y + FONT * .35);
        markup_write(c->out, series->name, MARKUP_SVG);
        fputs("</text>\n", c->out);
        entry++;
    }
}

/* ---- the whole */

static void draw_title(const struct plot *plot, FILE *out, double x)
{
    if (plot->untitled || plot->title == NULL)
        return;
    fprintf(out, "<text x=\"%.1f\" y=\"18\" text-anchor=\"middle\" font-weight=\"bold\">", x);
    markup_write(out, plot->title, MARKUP_SVG);
    fputs("</text>\n", out);
}

/* The area inside the axes: as large as ticks and titles allow */
static void lay_out(struct canvas *c)
{
    const struct plot *plot = c->plot;
    double right = SQUARE_EDGE, bottom = SQUARE_EDGE;
    c->left = SQUARE_EDGE;
    c->top = plot->untitled || plot->title == NULL ? SQUARE_EDGE : 28;
    if (plot->y.label != NULL)
        c->left = 74;
    if (plot->x.label != NULL) {
        right = 16; /* half of the last label */
        bottom = 48;
    }
    c->width = plot->square ? SQUARE : WIDTH - c->left - right;
    c->height = plot->square ? SQUARE : HEIGHT - c->top - bottom;
}

void plot_write(const struct plot *plot, FILE *out)
{
    struct canvas c = { .plot = plot, .out = out };
    c.x = span_of(plot, &plot->x);
    c.y = span_of(plot, &plot->y);
    lay_out(&c);
    double legend = c.top + c.height + (plot->x.label != NULL ? 60 : 22);
    size_t lines = legend_lines(plot);
    double width = c.left + c.width + (plot->x.label != NULL ? 16 : SQUARE_EDGE);
    double height = lines > 0               ? legend + (double)lines * LEGEND_LINE - 6
                    : plot->x.label != NULL ? c.top + c.height + 48
                                            : c.top + c.height + SQUARE_EDGE;

    fprintf(out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %.0f %.0f\" role=\"img\" "
            "font-family=\"system-ui,sans-serif\" font-size=\"%d\" fill=\"currentColor\">\n<title>",
            width, height, FONT);
    markup_write(out, plot->title != NULL ? plot->title : "plot", MARKUP_PLAIN);
    fputs("</title>\n", out);
    draw_title(plot, out, c.left + c.width / 2);
    draw_axis(&c, &plot->x, false);
    draw_axis(&c, &plot->y, true);

    /* A viewport of its own cuts off what lies outside, without a clip path that needs an id */
    fprintf(out,
            "<svg x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" "
            "viewBox=\"%.1f %.1f %.1f %.1f\">\n",
            c.left, c.top, c.width, c.height, c.left, c.top, c.width, c.height);
    unsigned next = 0;
    for (size_t i = 0; i < plot->series_count; i++)
        draw_series(&c, &plot->series[i], take_colour(&plot->series[i], &next));
    fputs("</svg>\n", out);
    fprintf(out,
            "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"none\" "
            "stroke=\"currentColor\" stroke-opacity=\".6\"/>\n",
            c.left, c.top, c.width, c.height);
    draw_legend(&c, legend);
    fputs("</svg>\n", out);
}
