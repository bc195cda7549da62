/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the slots of a panel are, from the centres of the sections found on it.
 *
 * The declared layout is the model: so many rows and columns, one pitch along each, one small turn
 * of the whole, at most one section in a slot. Place, pitch, turn and the assignment of sections to
 * slots are found together, as those with the least total cost; a section may lie up to half a
 * pitch off, and slots may be empty. Costs are in nats (logarithms of odds): the squared distance
 * of a section from its slot's centre in units of what a hand is off, and what is known of panels
 * beforehand. What another grid explains nearly as well is not decided here. Any one unit of
 * length, y down. */
#ifndef GSN_REGISTER_PANEL_GRID_H
#define GSN_REGISTER_PANEL_GRID_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_panel_grid {
    unsigned rows, columns;
    struct gsn_point first; /* centre of the slot at the top left */
    double pitch_x, pitch_y;
    double turn; /* radians, clockwise as seen */
};

/* A place is row * columns + column. */
enum { GSN_NO_PLACE = -1 };

/* What became of one centre. */
struct gsn_slot_assignment {
    int place; /* GSN_NO_PLACE: it belongs to no slot */
    int other; /* where it could lie nearly as well, or GSN_NO_PLACE when its slot is clear */
};

/* What the grid is laid on. */
struct gsn_grid_prior {
    unsigned rows, columns;
    double size;          /* of a section */
    double width, height; /* of the picture */
    const unsigned *slot; /* what people call each place: its number less one */
    const char *loose; /* one for each centre: 1 where it may well be no section, such as a part of
                          a label; NULL for none */
    int first;         /* the place of the section nearest to the top left, reading row by row,
                          where a person has said so; else GSN_NO_PLACE */
};

/* ret_assigned: one for each centre. Fails with GSN_E_WITHHELD when two grids explain the centres
 * nearly as well (the sentence names both), GSN_E_INPUT when the layout has no room for them,
 * GSN_E_NOMEM. */
int gsn_panel_grid_fit(const struct gsn_point *centre, size_t count,
                       const struct gsn_grid_prior *prior, struct gsn_panel_grid *ret_grid,
                       struct gsn_slot_assignment *ret_assigned, struct gsn_error *err);

/* The place whose centre is nearest, or GSN_NO_PLACE beyond half a pitch outside the grid. */
int gsn_panel_grid_place(const struct gsn_panel_grid *grid, struct gsn_point at);

#ifdef __cplusplus
}
#endif
#endif
