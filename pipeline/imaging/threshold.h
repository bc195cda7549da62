/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where a histogram parts into two classes. */
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

#ifdef __cplusplus
}
#endif
#endif
