/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which boxes hold this point, which meet this box? A grid of bins over axis-parallel boxes. */
#ifndef GSN_MODEL_BINS_H
#define GSN_MODEL_BINS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_box {
    double low[3], high[3]; /* closed */
};

struct gsn_bins;

/* gives: the grid, about one bin per box; copies the boxes. Fails with GSN_E_NOMEM. */
int gsn_bins_new(const struct gsn_box *box, size_t count, struct gsn_bins **ret_bins,
                 struct gsn_error *err);
void gsn_bins_free(struct gsn_bins *bins);
GSN_DEFINE_AUTO(gsn_bins);

/* borrowed: the box around all boxes, and one of them. */
const struct gsn_box *gsn_bins_bounds(const struct gsn_bins *bins);

const struct gsn_box *gsn_bins_box(const struct gsn_bins *bins, size_t box);

/* borrowed: a list, ascending, that has every box with u inside (and others). Returns its
 * length. */
size_t gsn_bins_at(const struct gsn_bins *bins, const double u[3], const uint32_t **ret_list);

/* Calls visit once for every box that meets the given one, in no particular but always the same
 * order. A visit that returns other than 0 ends that; its answer is returned, else 0. */
int gsn_bins_meeting(const struct gsn_bins *bins, const struct gsn_box *box,
                     int (*visit)(void *context, uint32_t box), void *context);

#ifdef __cplusplus
}
#endif
#endif
