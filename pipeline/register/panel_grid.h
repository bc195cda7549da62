/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the rows and columns of a panel run, from the centres of the sections found on it.
 *
 * Each axis is solved alone: the centres fall into lines, the lines onto a regular grid. Where
 * whole lines are empty the grid may be placed in more than one way; it is decided only when
 * exactly one keeps all slots on the panel. Any one unit of length. */
#ifndef GSN_REGISTER_PANEL_GRID_H
#define GSN_REGISTER_PANEL_GRID_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_panel_axis {
    unsigned lines;
    double first, pitch; /* centre of line 0; distance of neighbouring lines */
};

/* centre: count positions, sorted in place. size: that of a section. length: that of the panel.
 * pitch: of the other axis, or 0; used where only one line has sections. what: "row" or "column".
 * Fails with GSN_E_INPUT when the grid cannot be told; then *ret_axis is untouched. */
int gsn_panel_axis_fit(double *centre, size_t count, unsigned lines, double size, double length,
                       double pitch, const char *what, struct gsn_panel_axis *ret_axis,
                       struct gsn_error *err);

/* The line nearest to a position, or -1 beyond half a pitch outside the grid. */
int gsn_panel_axis_line(const struct gsn_panel_axis *axis, double position);

#ifdef __cplusplus
}
#endif
#endif
