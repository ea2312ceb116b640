/*
 * Numbers in scene text: decimal, correctly rounded, whatever the locale. Fast for the short ones
 * that meshes are made of.
 */
#ifndef MASTER_NUMBER_H
#define MASTER_NUMBER_H

#include <stdbool.h>

/* The whole of [begin, end) must be one number (signs, digits, point, exponent; "inf" and "nan"
 * too, for callers to refuse with a better reason). False when it is not. Pure. */
bool number_parse(const char *begin, const char *end, double *value);

#endif
