/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Otsu's threshold: where a histogram, or a set of values, parts into two classes. */
#ifndef GSN_IMAGING_THRESHOLD_H
#define GSN_IMAGING_THRESHOLD_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The number of bins, 1 or more, that belong to the lower of the two classes whose variance between
 * them is largest (Otsu 1979). Of equally good cuts, as there are between classes that an empty
 * stretch parts, it is the middle one. ret_apart, unless NULL: the distance of the classes' means,
 * in bins; 0 where all lies in one bin. bins is 2 or more. */
size_t gsn_otsu_cut(const size_t *histogram, size_t bins, double *ret_apart);

/* The value that splits `values` (sorted or not, none NaN) into these two classes, in 512 steps
 * between the smallest and the largest; NaN when count is 0. */
double gsn_otsu(const float *values, size_t count);

#ifdef __cplusplus
}
#endif
#endif
