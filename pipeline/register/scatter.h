/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The typical spread of vectors of three among which some are grossly wrong. */
#ifndef GSN_REGISTER_SCATTER_H
#define GSN_REGISTER_SCATTER_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Fewer vectors do not tell a covariance of six numbers from chance. */
enum { GSN_SCATTER_LEAST = 12 };

struct gsn_scatter_vector {
    double v[3];
    double square; /* v' C^-1 v, by gsn_scatter() */
    int inlier;    /* by gsn_scatter(): square is not beyond 0.1 % */
};

/* The covariance about 0: Tyler's estimator, which no distance moves and a third of wrong vectors
 * does not break, then that of the vectors within the 0.1 % limit, corrected for what the limit
 * cuts off. scratch has room for count numbers; count is at least GSN_SCATTER_LEAST. 0, or -1 where
 * the vectors have no spread in some direction. */
int gsn_scatter(struct gsn_scatter_vector *vectors, size_t count, double *scratch,
                double ret_covariance[3][3]);

#ifdef __cplusplus
}
#endif
#endif
