/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where two sections that grew together on the glass are to be cut apart.
 *
 * A person decides; this proposes the straight line between the centres of their slots that runs
 * through the least tissue. */
#ifndef GSN_REGISTER_PANEL_CUT_H
#define GSN_REGISTER_PANEL_CUT_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/register/split.h"

#ifdef __cplusplus
extern "C" {
#endif

/* centre: of the two slots, in cells. ret_end: where the line enters and leaves the piece; both at
 * one place when it has no tissue there. ret_width: how many cells of tissue the line runs through.
 * Fails with GSN_E_NOMEM. */
int gsn_panel_cut(const struct gsn_components *pieces, size_t piece,
                  const struct gsn_point centre[2], struct gsn_point ret_end[2], double *ret_width,
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
