/*
 * Plots as SVG: lines, markers and error bars over linear or logarithmic axes, and sets of points
 * in a square. A plot is a value: describe it in a struct and write it; nothing is kept.
 *
 * The SVG stands alone (a file of its own) or inline in a page (page.h): no ids, no style sheet,
 * no references. Axes and text take the colour of the text around them (black in a file), series
 * have colours that can be told apart on white and on black, and markers of different shapes.
 *
 * Numbers that are not finite are left out, and so are those that a logarithmic axis cannot show;
 * a line is interrupted there. What lies beyond the ends of an axis is cut off. The bytes depend
 * on the arguments alone.
 */
#ifndef MASTER_PLOT_H
#define MASTER_PLOT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct plot_axis {
    const char *label; /* what it shows, with its unit; NULL: nothing, and no ticks either */
    bool log;
    double low, high; /* ends of the axis; both 0: as the data want it */
};

enum plot_style {
    PLOT_LINE = 1,
    PLOT_DASHED = 2,  /* instead of a solid line: theory, a level to compare with */
    PLOT_MARKERS = 4, /* a shape at each point: the colour's own */
    PLOT_DOTS = 8,    /* small dots: for hundreds of points */
    PLOT_GREY = 16,   /* the colour of the text, and not one of the series' colours */
    PLOT_SAME = 32,   /* colour and marker of the series before: its theory, its fit */
};

struct plot_series {
    const char *name; /* in the legend; NULL: not there */
    unsigned style;   /* enum plot_style, or-ed */
    size_t count;
    const double *x, *y;
    const double *error; /* half the length of the error bars, along y; NULL: no bars */
};

struct plot {
    const char *title; /* for those who cannot see it, and above it unless untitled */
    struct plot_axis x, y;
    const struct plot_series *series;
    size_t series_count;
    bool square;   /* the area inside the axes, for points of a square */
    bool untitled; /* the title stands elsewhere: in a caption */
};

/* Write <svg>...</svg>. Failures are the stream's (ferror). */
void plot_write(const struct plot *plot, FILE *out);

#endif
