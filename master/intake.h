/*
 * From accepted results to the film. The film is given one round after the other: nodes of later
 * rounds wait here until every pair has finished the one before, so that whenever a round ends the
 * film holds exactly that round, whatever came early, and its row in the accuracy ledger is a
 * function of the job alone. The scheduler bounds how much can wait (early_max). Once intake_stop
 * was called the film keeps the rounds that had ended, and whatever else comes is dropped.
 *
 * Used from the event loop only.
 */
#ifndef MASTER_INTAKE_H
#define MASTER_INTAKE_H

#include "common/job.h"
#include "master/ledger.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct film;
struct image;
struct intake;

/* When a round ended; the film holds exactly the rounds up to it. */
typedef void intake_round_fn(void *owner, unsigned round);

/* Takes the memory of the picture and its estimate. The film must outlive it. NULL when memory runs
 * out. intake_free(NULL) does nothing. */
struct intake *intake_new(const struct job_spec *spec, struct film *film, intake_round_fn *on_round,
                          void *owner);
void intake_free(struct intake *intake);

/* Are these the sums of that node of this job? ERR_MESSAGE says what not. */
bool intake_check(const struct intake *intake, const struct node_id *node,
                  const struct node_sums *sums, struct err *err);

/* Sums that passed intake_check, of a node that was accepted for the first time. Takes them over,
 * whatever happens. False: ERR_MEMORY, or ERR_INTERNAL when the film does not want them. */
bool intake_add(struct intake *intake, const struct node_id *node, struct node_sums *sums,
                struct err *err);

/* No further round: the last one that ended was the job's last. For on_round. */
void intake_stop(struct intake *intake);

/* For on_round: take the picture of the round that ended, and add its row, unless it is a pilot's.
 * False: ERR_MEMORY. */
bool intake_end_round(struct intake *intake, double wall_s, double core_s, struct err *err);
/* The picture of the last round that ended, without metadata; NULL before the first. */
const struct image *intake_picture(const struct intake *intake);
const struct ledger_row *intake_ledger(const struct intake *intake, size_t *count);

#endif
