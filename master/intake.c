#include "master/intake.h"

#include "common/err.h"
#include "master/film.h"
#include "master/image.h"
#include "master/tile_plan.h"

#include <stdlib.h>

#define HELD_ROUNDS 16 /* at least the scheduler's ROUNDS_AHEAD */

struct held {
    struct node_id node;
    struct node_sums *sums;
    struct held *next;
};

struct intake {
    struct job_spec spec;
    struct film *film;
    intake_round_fn *on_round;
    void *owner;
    unsigned ended;                 /* rounds that the film holds */
    bool stopped;                   /* ... for good */
    struct held *held[HELD_ROUNDS]; /* round r at r % HELD_ROUNDS, for r > ended */
    struct estimate *estimate;
    struct image *picture;
    struct ledger_row *rows;
    size_t row_count;
};

struct intake *intake_new(const struct job_spec *spec, struct film *film, intake_round_fn *on_round,
                          void *owner)
{
    struct intake *in = calloc(1, sizeof(*in));
    if (in == NULL)
        return NULL;
    in->spec = *spec;
    in->film = film;
    in->on_round = on_round;
    in->owner = owner;
    in->estimate = estimate_new();
    in->picture = film_image_new(film);
    if (in->estimate == NULL || in->picture == NULL ||
        !estimate_begin(in->estimate, spec->replicates)) {
        intake_free(in);
        return NULL;
    }
    return in;
}

void intake_free(struct intake *in)
{
    if (in == NULL)
        return;
    for (unsigned r = 0; r < HELD_ROUNDS; r++) {
        while (in->held[r] != NULL) {
            struct held *held = in->held[r];
            in->held[r] = held->next;
            node_sums_free(held->sums);
            free(held);
        }
    }
    estimate_free(in->estimate);
    image_free(in->picture);
    free(in->rows);
    free(in);
}

bool intake_check(const struct intake *in, const struct node_id *node, const struct node_sums *sums,
                  struct err *err)
{
    uint64_t samples = ((uint64_t)in->spec.leaf_samples * sums->pixel_count) << node->level;
    if (sums->stats.samples != samples)
        return err_set(err, ERR_MESSAGE, "a node of %llu samples came with %llu",
                       (unsigned long long)samples, (unsigned long long)sums->stats.samples);
    return true;
}

/* The film takes it, or it is a bug: the scheduler accepts every node once, and only the job's. */
static bool give(struct intake *in, const struct node_id *node, struct node_sums *sums,
                 struct err *err)
{
    enum film_result result = film_accept(in->film, node, sums);
    if (result == FILM_ADDED || result == FILM_SEALED)
        return true;
    node_sums_free(sums);
    if (result == FILM_NO_MEMORY)
        return err_set(err, ERR_MEMORY, "the master has no memory for its film");
    return err_set(err, ERR_INTERNAL,
                   "the film calls tile %u, replicate %u, level %u, index %llu %s", node->tile,
                   node->replicate, node->level, (unsigned long long)node->index,
                   result == FILM_DUPLICATE ? "a duplicate" : "foreign");
}

static bool hold(struct intake *in, unsigned round, const struct node_id *node,
                 struct node_sums *sums, struct err *err)
{
    struct held *held = round - in->ended < HELD_ROUNDS ? malloc(sizeof(*held)) : NULL;
    if (held == NULL) {
        node_sums_free(sums);
        return err_set(err, ERR_MEMORY, "the master has no memory for early results");
    }
    *held = (struct held){ *node, sums, in->held[round % HELD_ROUNDS] };
    in->held[round % HELD_ROUNDS] = held;
    return true;
}

/* Give the film what waited for this round; what fails is still taken off the list. */
static bool release(struct intake *in, unsigned round, struct err *err)
{
    bool ok = true;
    struct held *next = in->held[round % HELD_ROUNDS];
    in->held[round % HELD_ROUNDS] = NULL;
    while (next != NULL) {
        struct held *held = next;
        next = held->next;
        if (ok)
            ok = give(in, &held->node, held->sums, err);
        else
            node_sums_free(held->sums);
        free(held);
    }
    return ok;
}

bool intake_add(struct intake *in, const struct node_id *node, struct node_sums *sums,
                struct err *err)
{
    unsigned round;
    if (in->stopped) {
        node_sums_free(sums);
        return true;
    }
    if (!tile_plan_job_round(film_plan(in->film), node, &round) || round < in->ended) {
        node_sums_free(sums);
        return err_set(err, ERR_INTERNAL, "a node that no open round has was accepted");
    }
    if (round > in->ended)
        return hold(in, round, node, sums, err);
    if (!give(in, node, sums, err))
        return false;
    while (film_round_complete(in->film, in->ended)) {
        in->on_round(in->owner, in->ended);
        in->ended++;
        if (in->stopped)
            break;
        if (!release(in, in->ended, err))
            return false;
    }
    return true;
}

void intake_stop(struct intake *in)
{
    in->stopped = true;
}

bool intake_end_round(struct intake *in, double wall_s, double core_s, struct err *err)
{
    if (!film_has_picture(in->film))
        return true;
    struct ledger_row *rows = realloc(in->rows, (in->row_count + 1) * sizeof(*rows));
    if (rows == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the accuracy ledger");
    in->rows = rows;
    if (!film_image(in->film, in->picture, in->estimate, err))
        return false;
    struct node_stats stats;
    film_stats(in->film, &stats);
    struct accuracy accuracy = estimate_result(in->estimate);
    rows[in->row_count++] = ledger_row_of(film_rounds(in->film) - 1, film_spp(in->film), wall_s,
                                          core_s, &accuracy, &stats);
    return true;
}

const struct image *intake_picture(const struct intake *in)
{
    return in->row_count == 0 ? NULL : in->picture;
}

const struct ledger_row *intake_ledger(const struct intake *in, size_t *count)
{
    *count = in->row_count;
    return in->rows;
}
