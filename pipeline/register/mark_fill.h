/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Makes a hole with a dark rim into a dark disc: a laser that burns through leaves light inside a
 * charred rim.
 *
 * Every value is raised to the lowest level over which a way leads from it to the plane's edge:
 * morphological reconstruction by erosion (Vincent, IEEE Trans. Image Process. 2, 176, 1993), with
 * ways along rows and columns. It is done between the two halves of a closing with 3 x 3 cells, so
 * that a rim of less than a cell holds, and one with a gap of two. */
#ifndef GSN_REGISTER_MARK_FILL_H
#define GSN_REGISTER_MARK_FILL_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* In place. Ways lead through NaN, which stays. Fails with GSN_E_NOMEM. */
int gsn_mark_fill(float *value, size_t width, size_t height, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
