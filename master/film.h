/*
 * The film: what the master has received of one job. Per pair (tile, replicate) it keeps the sums
 * of the sealed rounds as a binary counter (common/sumtree.h) and a fold for each round that is
 * still coming in. Which worker sent what, in what order and in what pieces, leaves no trace in it.
 *
 * Rounds, where nothing else is said, are the job's: master/tile_plan.h says which of its own
 * rounds a pair finishes in each. A pair's own round is sealed when every leaf of it arrived and
 * all rounds before it are sealed; later rounds may come in early and wait. At the ends of rounds a
 * pair holds at most four sums, which is what film_memory_bytes counts; sums below open rounds come
 * on top and are the scheduler's to bound (film_held).
 *
 * Ownership: the film owns the sums it accepted. Thread: one at a time (the master's event loop).
 */
#ifndef MASTER_FILM_H
#define MASTER_FILM_H

#include "common/job.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct estimate;
struct film;
struct image;
struct scene;
struct tile_plan;

/* Bytes a film of this job needs at the end of a round; computed, nothing is allocated. */
uint64_t film_memory_bytes(const struct scene *scene, const struct job_spec *spec);

/*
 * An empty film that accepts `rounds` rounds. Fails with ERR_LIMIT when it would need more than
 * limit_bytes (0: no limit). Copies what it needs of scene and spec. film_free(NULL) does nothing.
 */
struct film *film_new(const struct scene *scene, const struct job_spec *spec, unsigned rounds,
                      uint64_t limit_bytes, struct err *err);
void film_free(struct film *film);

/*
 * Take the memory that the sums of `rounds` rounds will need now, touch it, and hand it back to
 * malloc, which is told to keep it, for all threads: a job that cannot fit fails at its start and
 * not after days, and from then on the memory of the process stays flat. So whatever else is large
 * and lives as long as the job (its pictures) must be allocated before: later it would come out of
 * what was taken here. False: ERR_MEMORY.
 */
bool film_take_memory(const struct film *film, unsigned rounds, struct err *err);

/* Extending a job: accept this many rounds from now on. Never below what came in already. */
void film_extend(struct film *film, unsigned rounds);

/* How the job's samples are distributed. With a pilot, only its nodes are accepted until
 * film_make_plan, which wants its rounds complete. `rounds`: all of the job, 0 where nobody knows.
 * False: ERR_MEMORY. */
const struct tile_plan *film_plan(const struct film *film);
bool film_make_plan(struct film *film, unsigned rounds, struct err *err);
/* Has every pixel samples that the picture shows? Not during a pilot. */
bool film_has_picture(const struct film *film);

enum film_result {
    FILM_ADDED,     /* taken */
    FILM_SEALED,    /* taken, and it completed a round of its pair (or several): film_pair_rounds */
    FILM_DUPLICATE, /* some leaf of that range is here already */
    FILM_FOREIGN,   /* not a node of this job, or of another shape or sample count than the job's */
    FILM_NO_MEMORY
};

/*
 * Take one node's sums. ADDED and SEALED: the film owns `sums` from now on; else the caller keeps
 * them, and the film is as before. `sums->stats.samples` must be the node's leaves x B x pixels.
 */
enum film_result film_accept(struct film *film, const struct node_id *id, struct node_sums *sums);

/* What film_accept would say to well-formed sums of this node: ADDED, DUPLICATE or FOREIGN. */
enum film_result film_check(const struct film *film, const struct node_id *id);

uint32_t film_tiles(const struct film *film);
uint32_t film_tile_pixels(const struct film *film, uint32_t tile);
unsigned film_pair_rounds(const struct film *film, uint32_t tile, uint32_t replicate); /* own */
unsigned film_rounds(const struct film *film); /* sealed by every pair */
bool film_round_complete(const struct film *film, unsigned round);
/* Samples per pixel of film_rounds(), of all replicates: the mean of the layer `samples`. */
uint64_t film_spp(const struct film *film);
size_t film_held(const struct film *film); /* sums waiting below open rounds */

/* Counters of everything sealed so far. */
void film_stats(const struct film *film, struct node_stats *total);

/* An image for film_image, with all its channels and windows, in memory that is there and not only
 * promised; NaN until it is read. NULL when memory runs out. */
struct image *film_image_new(const struct film *film);

/*
 * Read the picture of all sealed rounds; tiles may be at different rounds between two complete
 * ones. `image` (or NULL) has the crop window's size; its channels are added, or overwritten when
 * it has them already:
 *   R G B                     (1/K) * sum over replicates, in order, of (sum / n), in double
 *   stderr.R stderr.G stderr.B  standard error of that, from the replicate means (K-1 degrees of
 *                             freedom); +inf, "unknown", below two replicates and where
 *                             non-finite samples were lost
 *   samples                   per pixel, of all replicates, without a pilot's
 *   A depth.Z ...             the layers of the job (master/layers.h)
 * and its data and display windows set. With a pilot of weight w, a replicate's mean is that of a
 * pilot's sequence times w plus that of its own samples times 1 - w, in R, G and B; other layers
 * are of the main samples alone. `estimate` (or NULL) gets the error estimate of the same picture.
 * One pass over the sums. False: ERR_MEMORY, or an image of another size.
 */
bool film_image(const struct film *film, struct image *image, struct estimate *estimate,
                struct err *err);

#endif
