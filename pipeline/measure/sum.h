/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A sum that does not lose what it adds: value + rest (Neumaier 1974). Starts as { 0 }. */
#ifndef GSN_MEASURE_SUM_H
#define GSN_MEASURE_SUM_H

#include <math.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_sum {
    double value, rest;
};

static inline void gsn_sum_add(struct gsn_sum *sum, double value)
{
    const double total = sum->value + value;

    if (fabs(sum->value) >= fabs(value))
        sum->rest += (sum->value - total) + value;
    else
        sum->rest += (value - total) + sum->value;
    sum->value = total;
}

#ifdef __cplusplus
}
#endif
#endif
