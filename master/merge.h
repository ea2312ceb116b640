/*
 * Pictures of one job with different seeds, joined: as good as one job of all their samples. They
 * are added one after the other, so that only one of them need be in memory.
 *
 * They must be of one scene (digest, and with it camera, sampler and depth), one resolution, one
 * crop and one set of channels; their seeds must differ, or the same samples would count twice.
 *
 * What becomes of the channels, with n_i the samples of picture i in a pixel:
 *   R G B A      sum n_i m_i / sum n_i
 *   stderr.*     the pictures are independent, so with weights w_i = n_i / sum n
 *                    stderr^2 = sum w_i^2 stderr_i^2.
 *                Unknown (infinite) where one of them is. Degrees of freedom are those of
 *                Satterthwaite (1946) and Welch (1947),
 *                    (sum a_i)^2 / sum (a_i^2 / dof_i),  a_i = w_i^2 stderr_i^2,
 *                with a_i added up over the picture, where it is hardly noise: for equal samples
 *                and noise the sum of the dof_i.
 *   samples      added
 *   depth, position, normal, ... (averages over first hits): weighted by the samples that hit:
 *                n_i times alpha where there is alpha, else n_i; and 0 where the picture shows no
 *                hit, that is 0 in all of these channels
 *   Cryptomattes coverages of the same identity are averaged with the replicates as weights, since
 *                each counts as many samples of a replicate, and ranked again; of more than
 *                MERGE_IDS identities in a pixel those of the pictures before are dropped that
 *                cover least
 * Sums are in double and in the order of the pictures. The metadata list the seeds, add samples,
 * replicates and core-seconds, and keep what is true of all; ledgers and the estimates of single
 * pictures' errors are dropped.
 *
 * One thread at a time.
 */
#ifndef MASTER_MERGE_H
#define MASTER_MERGE_H

#include <stdbool.h>

struct err;
struct image;
struct merge;

#define MERGE_IDS 12 /* identities of a pixel that are kept on the way to six ranks */

/* NULL when memory runs out. merge_free(NULL) does nothing. */
struct merge *merge_new(void);
void merge_free(struct merge *merge);

/* Add a picture, as exr_image_read gives it. False: ERR_ARGUMENT with what does not fit to the
 * pictures before (`name` is this one's), or ERR_MEMORY; then it can only be freed. */
bool merge_add(struct merge *merge, const struct image *image, const char *name, struct err *err);

/* The picture of all that were added, at least one; the caller owns it. `command` and `build` go
 * into its metadata. NULL: ERR_MEMORY. */
struct image *merge_take(struct merge *merge, const char *command, const char *build,
                         struct err *err);

#endif
