/*
 * An expectation that prints what it got, what it wanted, and where. Files that use it include
 * cmocka.h.
 */
#ifndef TESTS_EXPECT_H
#define TESTS_EXPECT_H

#include <math.h>

#define EXPECT_NEAR(got, want, tolerance)                                                      \
    do {                                                                                       \
        double got_ = (double)(got), want_ = (double)(want), by_ = (double)(tolerance);        \
        if (!(fabs(got_ - want_) <= by_))                                                      \
            fail_msg("%s:%d: %s is %.10g, want %.10g +- %.3g", __FILE__, __LINE__, #got, got_, \
                     want_, by_);                                                              \
    } while (0)

#endif
