/*
 * Slides on random numbers: sets of points in the unit square, how evenly they lie, and the
 * difference it makes in a picture.
 */
#ifndef MASTER_LECTURE_POINTS_H
#define MASTER_LECTURE_POINTS_H

#include "master/lecture.h"

#define LECTURE_POINTS_MAP(X) /* name, and what it is called */ \
    X(RANDOM, "random")                                         \
    X(STRATIFIED, "stratified")                                 \
    X(HALTON, "Halton")                                         \
    X(HAMMERSLEY, "Hammersley")                                 \
    X(SOBOL, "Sobol")                                           \
    X(SLIDE_HALTON, "Halton of the slide")                      \
    X(SLIDE_HAMMERSLEY, "Hammersley of the slide")

enum lecture_points {
#define X(name, text) LECTURE_POINTS_##name,
    LECTURE_POINTS_MAP(X)
#undef X
        LECTURE_POINTS_COUNT
};

/*
 * The first n points of a set, n <= 2^31: those of common/sampler.h, scrambled by seed and run, or
 * the slide's own, which are the same for every seed. `purpose` (enum sample_purpose, one that is
 * 2-D and occurs at the camera or the first vertex) tells apart sets that are used together.
 */
void lecture_points_fill(enum lecture_points kind, unsigned purpose, uint64_t seed, uint64_t run,
                         uint32_t n, double (*points)[2]);

/* The digits of i in a base, mirrored at the point: the slide's Halton(index, base), with digits as
 * integers and one division. And as C reads the slide: with integer division, or in float. */
double lecture_points_halton(uint32_t index, uint32_t base);
double lecture_points_halton_integers(uint32_t index, uint32_t base);
float lecture_points_halton_float(uint32_t index, uint32_t base);

/*
 * Star discrepancy, exactly: the largest difference, over all boxes from the origin, between a
 * box's area and its share of the points. O(n^2); NaN when memory runs out. And its root mean
 * square over all such boxes, by Warnock's formula.
 */
double lecture_points_star(const double (*points)[2], uint32_t n);
double lecture_points_l2(const double (*points)[2], uint32_t n);

void lecture_points_write(struct lecture *lecture);

#endif
