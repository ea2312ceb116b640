/*
 * The tables of coated materials on their way into a scene: what coat.h and common/sheen.h compute,
 * laid out as struct material wants it, and computed once for coats that are equal.
 */
#ifndef MASTER_SCENE_COATS_H
#define MASTER_SCENE_COATS_H

#include "master/growing.h"

#include <stdbool.h>
#include <stdint.h>

struct err;
struct material;
struct scene_build;

/* What was computed already; zero-initialised at first. Lives as long as the reader. */
struct scene_coats {
    struct growing known;
    uint32_t sheen; /* 1 + first row of the table of all sheens, or 0 */
    bool similar;   /* the last material got the tables of a coat that is only like its own */
};
#define SCENE_COATS_SIMILAR "so many different coats share tables: their energy is approximate"
void scene_coats_free(struct scene_coats *coats);

/*
 * Give a MATERIAL_COAT or MATERIAL_COATED_CONDUCTOR that is complete but for them its tables: those
 * of its width, or of many (MATERIAL_COATS) when its roughness has a texture. A scene with more
 * than a hundred different coats, or half that over metal, gets tables of similar ones, and
 * `similar` says so: their lobes stay as wide as they are, the energy in them is approximate.
 */
bool scene_coats_add(struct scene_coats *coats, struct scene_build *build,
                     struct material *material, double thickness, struct err *err);

/* Lay a sheen over a material: in this colour, as wide as common/sheen.h allows. */
bool scene_coats_add_sheen(struct scene_coats *coats, struct scene_build *build,
                           struct material *material, const double color[3], double alpha,
                           struct err *err);

#endif
