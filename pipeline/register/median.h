/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The median, for estimates that a few wrong sections must not move. */
#ifndef GSN_REGISTER_MEDIAN_H
#define GSN_REGISTER_MEDIAN_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Sorts value, which holds count > 0 finite numbers; the mean of the middle two when even. */
double gsn_median(double *value, size_t count);

#ifdef __cplusplus
}
#endif
#endif
