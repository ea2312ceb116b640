/*
 * `pathfarm accuracy` as a table for programs: RFC 4180, a row per rung of every curve and per
 * point of a peer; what is not known is empty. Columns keep their names; new ones come last.
 */
#ifndef MASTER_ACCURACY_CSV_H
#define MASTER_ACCURACY_CSV_H

#include <stdio.h>

struct accuracy_peers;
struct accuracy_study;

/* Failures are the stream's (ferror). */
void accuracy_csv_write(const struct accuracy_study *study, const struct accuracy_peers *peers,
                        FILE *out);

#endif
