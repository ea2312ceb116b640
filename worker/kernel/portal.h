/*
 * A sky's portal (struct light): the rectangle that it shines through, and directions through it by
 * what shines there. After Bitterli, Novak and Jarosz, "Portal-Masked Environment Map Sampling"
 * (2015), with sines in place of angles.
 *
 * A direction (x, y, z), with x and y along the portal's sides and z from where it shines to where
 * it comes from, lies at s = x / sqrt(x^2 + z^2), t = y / sqrt(y^2 + z^2). There the portal is an
 * upright rectangle wherever it is seen from. A table of sums over cells of s and t so gives the
 * light that comes through, and chooses from it, in a few steps. Some of every cell's weight is for
 * its solid angle alone: what the cells are too coarse for is found all the same.
 *
 * Scalar, in double, of + - * / and sqrt: both instruction sets get the same bits.
 */
#ifndef WORKER_KERNEL_PORTAL_H
#define WORKER_KERNEL_PORTAL_H

#include <stdbool.h>
#include <stdint.h>

struct environment_table;
struct err;
struct scene;

struct portal {
    uint32_t size;     /* cells along s and along t */
    double *sums;      /* (size + 1)^2: of the cells' weights before row j and column i */
    double axes[3][3]; /* x, y, z in the world */
    double corner[2][3];
};

/* That of the environment's light, whose table is complete. portal_close also closes what is all
 * zeros or failed to open. */
bool portal_open(struct portal *portal, const struct scene *scene,
                 const struct environment_table *table, struct err *err);
void portal_close(struct portal *portal);

/* A unit direction from p through the portal, by (u, v) in [0, 1), and its density per solid angle;
 * false where p is not in front of it. */
bool portal_sample(const struct portal *portal, const float p[3], float u, float v, float w[3],
                   float *pdf);

/* That density; 0 where the ray from p along w does not pass the portal, and nowhere else. */
float portal_pdf(const struct portal *portal, const float p[3], const float w[3]);

#endif
