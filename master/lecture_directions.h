/*
 * Slides on sampling directions and lights: the hemisphere three ways, a convex polygon three ways,
 * and the mixture of diffuse and specular reflection.
 */
#ifndef MASTER_LECTURE_DIRECTIONS_H
#define MASTER_LECTURE_DIRECTIONS_H

#include "master/lecture.h"
#include "master/lecture_caster.h"

enum lecture_hemisphere {
    LECTURE_HEMISPHERE_REJECTION,
    LECTURE_HEMISPHERE_SPHERICAL, /* theta = 2 pi r1, phi = acos(r2): the slide's names */
    LECTURE_HEMISPHERE_COSINE,
    LECTURE_HEMISPHERE_CUBE, /* rejection forgotten: normalise(x, y, z) of every point */
    LECTURE_HEMISPHERE_COUNT
};

/* A direction about the z axis; *tries: how many points it took. */
lecture_vec lecture_directions_hemisphere(enum lecture_hemisphere how, struct lecture_dice *dice,
                                          unsigned *tries);

/* What n directions of one way look like */
struct lecture_hemisphere_result {
    double tries;          /* per direction */
    double numbers;        /* random numbers per direction */
    double mean_z;         /* uniform: 1/2; by the cosine: 2/3 */
    double p;              /* chi-square test of z and of the turn against the density it claims */
    double integral;       /* estimate of the integral of the cosine over the hemisphere: pi */
    double integral_error; /* its standard error */
};
struct lecture_hemisphere_result lecture_directions_measure(enum lecture_hemisphere how, uint64_t n,
                                                            struct lecture_dice dice);

#define LECTURE_CORNERS 8
struct lecture_polygon {
    unsigned corners;
    double at[LECTURE_CORNERS][2]; /* convex, counter-clockwise */
};

enum lecture_in_polygon {
    LECTURE_POLYGON_RECTANGLE,    /* of the bounding rectangle, those inside */
    LECTURE_POLYGON_BARYCENTRIC,  /* weights in [0, 1], kept if their sum is within 0.02 of 1 */
    LECTURE_POLYGON_TRIANGULATED, /* a triangle of the fan by its area, and a point of it */
    LECTURE_POLYGON_COUNT
};

/* A point of the polygon; *tries: how many were drawn. */
void lecture_directions_polygon(enum lecture_in_polygon how, const struct lecture_polygon *polygon,
                                struct lecture_dice *dice, double point[2], uint64_t *tries);

struct lecture_polygon_result {
    double acceptance; /* points kept of those drawn */
    double inner; /* share of points in the polygon shrunk about its centroid to half its area */
    double p;     /* chi-square test over cells of known areas */
};
struct lecture_polygon_result
lecture_directions_measure_polygon(enum lecture_in_polygon how,
                                   const struct lecture_polygon *polygon, uint64_t n,
                                   struct lecture_dice dice);

/* Area of the polygon over that of its bounding rectangle */
double lecture_directions_share(const struct lecture_polygon *polygon);

/* Of n sets of barycentric weights as doubles, how many sum to exactly 1? */
uint64_t lecture_directions_exact_sums(unsigned corners, uint64_t n, struct lecture_dice dice);

void lecture_directions_write(struct lecture *lecture);

#endif
