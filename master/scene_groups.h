/*
 * What finishing a scene does about groups and instances; part of scene_build, whose header tells
 * the rules. Called in this order, each once.
 */
#ifndef MASTER_SCENE_GROUPS_H
#define MASTER_SCENE_GROUPS_H

#include "master/scene_bounds.h"

/* Before anything is placed: dissolve groups that need not be one, copy what emits into the world,
 * drop what nothing shows, and choose each group's origin. */
bool scene_groups_prepare(struct scene_build *build, struct err *err);

/* Add all instances, wherever they move. */
void scene_groups_add_bounds(const struct scene_build *build, struct scene_bounds *bounds);

/* The origin of a group, from 1 on. */
const double *scene_groups_center(const struct scene_build *build, uint32_t group);

/* A motion of the finished scene from transforms of the file; *motion is 1 + its index. */
bool scene_groups_add_motion(struct scene_build *build, const struct transform *start,
                             const struct transform *end, const struct source_pos *pos,
                             uint32_t *motion, struct err *err);

/* After all shapes are placed and lights made: sort meshes by group, without the empty ones
 * (quadrics were sorted beforehand), and make the arrays of groups and instances. */
bool scene_groups_finish(struct scene_build *build, struct err *err);

#endif
