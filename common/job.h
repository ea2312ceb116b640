/*
 * What a job is, besides its scene: the numbers that decide the bits. Carried in the bundle; its
 * digest, with the scene's, names the job.
 */
#ifndef COMMON_JOB_H
#define COMMON_JOB_H

#include "common/sumtree.h"

#include <stdbool.h>
#include <stdint.h>

struct filter_spec;
struct scene;

struct job_spec {
    uint64_t seed;
    uint32_t replicates;   /* K, fixed for the life of the job */
    uint32_t leaf_samples; /* B: samples per pixel in a leaf, a power of two */
    uint64_t
        planned_samples; /* samples per pixel of one replicate, for samplers that need it; else 0 */
    uint32_t channel_count; /* of a node's layers: aov_channel_count(aovs) */
    uint32_t depth_cap;     /* scattering events after which a path is cut and counted */
    uint32_t kernel;        /* 0: chosen by the effect mask; 1: "everything" */
    uint32_t max_lanes;     /* active lanes, 1..8; 8 except in tests */
    uint32_t aovs;          /* layers besides radiance, a bit each: common/aov.h */
    uint32_t reserved[2];   /* zero */
    uint32_t pilot_rounds;  /* of K sequences more that only plan (master/tile_plan.h); 0: none */
    uint32_t pilot_weight;  /* of their mean in the picture, in 65536ths: fixed beforehand */
};

/* Tiles cover the crop window row by row; those at the right and bottom edges are cut. */
struct tile_rect {
    uint32_t x, y, width, height; /* pixels of the full image */
};

uint32_t tile_count(const struct scene *scene);
struct tile_rect tile_rect(const struct scene *scene, uint32_t tile);

/*
 * Choose K and B for `spp` samples per pixel with `replicates` wanted (0: the default, 4). K
 * shrinks when fewer than 2K samples are asked for, B when a replicate gets fewer than 4.
 * Returns the spp rounded up to whole rounds of all replicates.
 */
uint64_t job_shape(uint64_t spp, uint32_t replicates, struct job_spec *spec);

/*
 * The same for filters with negative lobes, whose strata fill with every fourth sample: B is 4
 * always, and K shrinks until each replicate gets four samples. job_in_fours says which need it.
 */
uint64_t job_shape_in_fours(uint64_t spp, uint32_t replicates, struct job_spec *spec);
bool job_in_fours(const struct filter_spec *filter);

/* Sample sequences of the job: its K replicates and, with a pilot, as many for that. */
uint32_t job_sequences(const struct job_spec *spec);
double job_pilot_weight(const struct job_spec *spec);

/*
 * Give a shaped job of `spp` samples per pixel a pilot: a power of two leaves of each sequence
 * more, as many as a 32nd of the samples are, or one. What they show is in the picture with a
 * quarter of their share of the samples: short sequences are worse than their share of a long one.
 * spp 0, when nobody knows how many there will be: one leaf of weight 0. False, and no pilot, when
 * one leaf is more than a sixteenth, or a single replicate could not tell the error.
 */
bool job_shape_pilot(uint64_t spp, struct job_spec *spec);

/* Rounds that reach `spp` samples per pixel with the K and B a job has, and the spp after them: of
 * tiles with a factor of 1, and without the pilot's, where there is one. */
unsigned job_rounds(const struct job_spec *spec, uint64_t spp);
uint64_t job_samples(const struct job_spec *spec, unsigned rounds);

#endif
