/*
 * The layers of common/aov.h as planes of the picture, tile by tile, for the film. In the file:
 *   A                     alpha: the mean over the samples, filtered as R, G and B
 *   depth.Z               along the camera's forward axis from the camera's plane
 *   position.X .Y .Z      in world space
 *   normal.X ...          of shading; geometric_normal.X ... of the surface; unit on average only
 *   albedo.R .G .B
 *   motion.X .Y           pixels, from the opening of the shutter to its closing; y downwards
 *   CryptoObject00.R ...  Cryptomatte (Friedman and Jones 2015): three layers of two ranks each
 *   CryptoMaterial00.R ...
 * All but A and the Cryptomattes are averages over the samples that hit something, 0 where none
 * did. Coverages of the Cryptomattes count the first AOV_ID_SAMPLES samples of every replicate.
 * Positions, depths, motions and identities are exact channels: float32 in every file.
 *
 * Owned by the film, and used by one thread at a time.
 */
#ifndef MASTER_LAYERS_H
#define MASTER_LAYERS_H

#include <stdbool.h>
#include <stdint.h>

struct err;
struct image;
struct job_spec;
struct layers;
struct node_sums;
struct scene;
struct tile_rect;

/* For the layers of spec->aovs, of which there is at least one; copies what it needs. NULL when
 * memory runs out. layers_free(NULL) does nothing. */
struct layers *layers_new(const struct scene *scene, const struct job_spec *spec);
void layers_free(struct layers *layers);

/* Give the image the planes and attributes it lacks. False: out of memory. */
bool layers_prepare(const struct layers *layers, struct image *image);

/* A tile: begin, add what every replicate has (in order), write where `at` says, in the image. */
void layers_tile_begin(struct layers *layers, uint32_t pixel_count);
void layers_tile_add(struct layers *layers, const struct node_sums *sums, uint64_t samples);
void layers_tile_write(const struct layers *layers, const struct tile_rect *at,
                       struct image *image);

#endif
