/*
 * Slides on light: sampling a BRDF, distribution ray tracing and its trees, path tracing, glossy
 * surfaces, sampling the light, too few samples.
 */
#ifndef MASTER_LECTURE_LIGHT_H
#define MASTER_LECTURE_LIGHT_H

#include "master/lecture.h"
#include "master/lecture_caster.h"

/* A closed room with coloured walls, a light in the ceiling and two spheres: diffuse ones on a
 * diffuse floor, or glossy ones on a glossy floor. Valid for the program's life. */
struct caster_scene lecture_light_room(bool glossy);

/* Two films of the same picture with numbers of their own: one to show, both to tell the error. */
struct lecture_pair {
    struct caster_film film[2];
    struct caster_counts counts; /* of both */
};
struct lecture_pair lecture_light_pair(const struct caster_scene *scene,
                                       const struct caster_how *how, unsigned size,
                                       uint64_t samples, uint64_t seed);
/* More samples of the same pair */
void lecture_light_more(struct lecture_pair *pair, const struct caster_scene *scene,
                        const struct caster_how *how, uint64_t samples, uint64_t seed);
void lecture_light_pair_free(struct lecture_pair *pair);
double lecture_light_rmse(const struct lecture_pair *pair);
double lecture_light_mean(const struct lecture_pair *pair);
/* Standard error of that mean; as if colours erred together, so rather too large */
double lecture_light_mean_error(const struct lecture_pair *pair);
/* Rays of all kinds for each path or tree */
double lecture_light_rays(const struct lecture_pair *pair);
/* The first film with a caption "LABEL: error 0.0123" */
void lecture_light_show(struct page *page, const struct lecture_pair *pair, const char *label);

/*
 * Rays of the trees of `count` camera rays into the middle of the picture, with `branches` at each
 * hit and `depth` reflections; per camera ray, by reflections before them.
 */
void lecture_light_tree(const struct caster_scene *scene, unsigned branches, unsigned depth,
                        uint64_t count, struct lecture_dice dice, double rays[CASTER_DEPTHS]);

void lecture_light_write(struct lecture *lecture);

#endif
