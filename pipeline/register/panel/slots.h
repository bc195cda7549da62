/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which component of a scanned panel is which section.
 *
 * The slots of a panel form a regular grid, declared by the protocol as rows, columns and the order
 * of mounting; the grid's place, pitch and turn are estimated from the tissue found
 * (grid.h), so that a label strip beside it and lost sections do no harm. Lengths and boxes
 * are in panel pixels, x right and y down. An empty slot stays empty: sections are never moved up
 * (a closed gap costs 9.6 % of volume). */
#ifndef GSN_REGISTER_PANEL_SLOTS_H
#define GSN_REGISTER_PANEL_SLOTS_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"

#include <limits.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Slot 0 is always at the top left. Snake: rows in turn, every second one from right to left. */
enum gsn_order { GSN_ORDER_ROW, GSN_ORDER_COLUMN, GSN_ORDER_SNAKE };

struct gsn_layout {
    unsigned rows, columns;
    enum gsn_order order;
};

struct gsn_slot {
    unsigned slot;        /* 0-based, in the order of mounting */
    unsigned row, column; /* 0-based */
    int found;            /* 0: the slot is empty and everything below is 0 */
    int touching;         /* grown together with another section, and where to cut is doubtful */
    int parted;           /* cut off from another section at a narrow neck */
    unsigned touched;     /* that slot, where touching or parted; else 0 */
    struct gsn_point
        cut_px[2];  /* where touching or parted: ends of the line to cut along, else 0 */
    int doubtful;   /* it lies between two slots */
    unsigned rival; /* the other of them, where doubtful; else 0 */
    double lost;    /* share of the tissue that lies beyond the slots (over the label or the
                       frame) or off the picture; 0 when it is whole */
    int x, y, width, height; /* box around the tissue with a margin of up to 150 um, inside the
                                panel and never beyond half the way to a neighbour's tissue */
    double area_px;
    struct gsn_point centre_px; /* centre of area of the tissue */
};

/* A piece that belongs to no slot: print on the label, a scrap between sections. */
struct gsn_scrap {
    int x, y, width, height;
    double area_px;
    int inside_grid; /* lies among the slots, so it may be tissue; 0: outside, such as a label */
};

/* The row and column of a slot. The caller guarantees slot < rows * columns. */
void gsn_panel_place(const struct gsn_layout *layout, unsigned slot, unsigned *ret_row,
                     unsigned *ret_column);

/* 0-based serial number of the section in a slot (0-based) of a panel (1-based). */
unsigned gsn_panel_serial(unsigned panel_number, unsigned slot, const struct gsn_layout *layout);

/* Finds the sections of one panel.
 *
 * tissue is the panel in cells of step x step of its pixels, px_um the size of such a pixel
 * (reduce.h): the sum of the optical densities of the three channels or their like, about 0
 * on glass; NaN counts as glass. first: the slot of the section nearest to the top left, reading
 * row by row, where a person has said so; GSN_SLOT_UNSAID else. ret_slots receives rows * columns
 * entries, ordered by slot.
 * gives: ret_scraps, largest first (NULL when there are none); both it and ret_scrap_count may be
 * NULL. Glass and dust alone leave every slot empty. Fails with GSN_E_WITHHELD when
 * the grid cannot be told from the pieces present (the sentence names the two best), GSN_E_INPUT
 * when the layout has no room for them, GSN_E_NOMEM. */
#define GSN_SLOT_UNSAID UINT_MAX
int gsn_panel_split(const struct gsn_plane *tissue, unsigned step, const struct gsn_layout *layout,
                    double px_um, unsigned first, struct gsn_slot *ret_slots,
                    struct gsn_scrap **ret_scraps, size_t *ret_scrap_count, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
