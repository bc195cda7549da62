/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One stained section, drawn on a sheet of its own that covers part of a panel. */
#ifndef GSN_PHANTOM_SECTION_H
#define GSN_PHANTOM_SECTION_H

#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The pixels of a section that are at least half tissue. */
struct gsn_phantom_extent {
    uint32_t x, y, width, height;
    size_t area_px;
};

/* Pixels x0 <= x < x1, y0 <= y < y1 of a panel. */
struct gsn_phantom_window {
    uint32_t x0, y0, x1, y1;
};

/* Optical density, R, G, B per pixel of the window; NULL for an empty slot. Starts as { 0 }. */
struct gsn_phantom_sheet {
    struct gsn_phantom_window window;
    float *od;
    struct gsn_phantom_extent extent;
};

void gsn_phantom_sheet_done(struct gsn_phantom_sheet *sheet);

/* Draws what lies in the slot of section k. Fails with GSN_E_NOMEM. borrows: plan. */
int gsn_phantom_section_draw(const struct gsn_phantom_plan *plan, int k,
                             struct gsn_phantom_sheet *ret_sheet, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
