/*
 * The ray tracer of the lecture, as the slides tell it: spheres and parallelograms, one ray after
 * another, colours in double. It is for the lecture's pictures only, which need ways of working
 * that nobody renders with (uniform directions, trees of rays), and for reading.
 *
 * A surface is the slides' mixture: a diffuse part kd, and a specular part ks that is a Phong lobe
 * about the mirror direction (exponent n; infinite: a mirror). f = kd / pi + ks (n + 2) / (2 pi)
 * cos^n(angle to the mirror direction).
 */
#ifndef MASTER_LECTURE_CASTER_H
#define MASTER_LECTURE_CASTER_H

#include "master/lecture.h"

struct image;

/* Three coordinates or colours, and a fourth number that nobody uses: + - * / work elementwise */
typedef double lecture_vec __attribute__((vector_size(32)));
#define LECTURE_VEC(x, y, z) ((lecture_vec){ (x), (y), (z), 0 })

struct caster_surface {
    lecture_vec kd, ks, emission;
    double exponent;
    double checks; /* side of the squares of a checkerboard in x and z, every other one black; 0:
                      none */
};

struct caster_object {
    bool sphere;
    double radius;
    lecture_vec at;   /* centre, or corner */
    lecture_vec u, v; /* sides of a parallelogram; its front is where u x v points */
    struct caster_surface surface;
};

struct caster_scene {
    const struct caster_object *objects;
    unsigned object_count;
    int light; /* the parallelogram that is sampled as the light; -1: none */
    lecture_vec (*sky)(lecture_vec d);
    lecture_vec eye, target;
    double tan_half_fov;
};

/* How to trace. Zeroed: path tracing by the surfaces' own directions, without light sampling, and
 * with Russian roulette that survives by the surface's reflectance. */
struct caster_how {
    bool light_sampling; /* explicit: a ray to the light at each diffuse reflection; not with
                            uniform */
    bool uniform; /* directions uniform over the hemisphere, whatever the surface (no mirrors) */
    unsigned branches;  /* rays that each hit sends on; 0: one. More: distribution ray tracing */
    unsigned max_depth; /* reflections after which nothing follows; 0: no end */
    double survival;    /* of Russian roulette at each reflection; 0: the surface's reflectance */
};

#define CASTER_DEPTHS 16
struct caster_counts {
    uint64_t rays[CASTER_DEPTHS]; /* by reflections before them; the last entry holds the rest */
    uint64_t shadow_rays;
    uint64_t diffuse, specular; /* reflections, by the part that was chosen */
};

/* Light along the ray from `o` in direction `d` (a unit vector), after `depth` reflections */
lecture_vec lecture_caster_radiance(const struct caster_scene *scene, const struct caster_how *how,
                                    lecture_vec o, lecture_vec d, unsigned depth,
                                    struct lecture_dice *dice, struct caster_counts *counts);

/*
 * One reflection at a surface with normal n towards `wo` (both unit vectors): a direction and the
 * weight f cos / pdf, by the slides' rule: diffuse with probability p = kd / (kd + ks) of the sums
 * over colours. False for a black surface, where that would be 0 / 0, and below the surface.
 * *diffuse tells which part was chosen.
 */
bool lecture_caster_reflect(const struct caster_surface *surface, lecture_vec n, lecture_vec wo,
                            struct lecture_dice *dice, lecture_vec *wi, lecture_vec *weight,
                            bool *diffuse);

/* A unit vector about n: uniform over the hemisphere (density 1 / 2 pi), or by the cosine */
lecture_vec lecture_caster_uniform(lecture_vec n, struct lecture_dice *dice);
lecture_vec lecture_caster_cosine(lecture_vec n, struct lecture_dice *dice);

/* ---- pictures */

struct caster_film {
    unsigned width, height;
    uint64_t samples; /* per pixel so far */
    double *sums;     /* three for each pixel */
};

/* NULL sums when memory runs out. */
struct caster_film lecture_caster_film(unsigned width, unsigned height);
void lecture_caster_film_free(struct caster_film *film);

/* Add samples to every pixel. `seed` belongs to the film: other films need others. */
void lecture_caster_expose(struct caster_film *film, const struct caster_scene *scene,
                           const struct caster_how *how, uint64_t samples, uint64_t seed,
                           struct caster_counts *counts);

/* The ray of a pixel: first two numbers of `dice` for the place in it; direction of unit length */
lecture_vec lecture_caster_camera(const struct caster_scene *scene, const struct caster_film *film,
                                  unsigned x, unsigned y, struct lecture_dice *dice);

/* The mean, as a picture; NULL when memory runs out. */
struct image *lecture_caster_image(const struct caster_film *film);
double lecture_caster_mean(const struct caster_film *film); /* over pixels and colours */
/* Root mean square error of one of two films of the same picture with numbers of their own: their
 * distance over the square root of 2. */
double lecture_caster_rmse(const struct caster_film *a, const struct caster_film *b);

#endif
