/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The steps of panel_grid.h: lines that may be along each axis, a grid and the slots that the
 * centres take in it, and which of the grids it is. Private to pipeline/register. */
#ifndef GSN_REGISTER_PANEL_GRID_PARTS_H
#define GSN_REGISTER_PANEL_GRID_PARTS_H

#include "pipeline/register/panel_grid.h"

/* Sections would overlap below this pitch, in sizes of a section. */
#define GSN_GRID_PITCH_LEAST 0.9
/* Axes that are kept of each direction. */
enum { GSN_GRID_AXES = 12 };

struct gsn_grid_problem {
    const struct gsn_point *centre;
    size_t count;
    const struct gsn_panel_ground *ground;
    double hand; /* what a section is off its slot's centre, along each axis */
};

/* Evenly spaced lines in one direction. */
struct gsn_grid_axis {
    double first, pitch, cost;
};

struct gsn_grid_answer {
    struct gsn_panel_grid grid;
    double cost;
    int *place; /* one for each centre */
};

/* ---- panel_grid_axis.c: along one axis ------------------------------------------------------ */

/* The best few that put the centres into different lines, best first; their number. */
size_t gsn_grid_axes(const struct gsn_grid_problem *p, int along_x,
                     struct gsn_grid_axis kept[GSN_GRID_AXES]);

/* ---- panel_grid_seats.c: the grid and the slots --------------------------------------------- */

/* What it costs that a centre is no section's. */
double gsn_grid_stranger_cost(const struct gsn_grid_problem *p, size_t i);
/* What it costs that centre i lies in a place. */
double gsn_grid_seat_cost(const struct gsn_grid_problem *p, const struct gsn_panel_grid *grid,
                          size_t i, int place);
/* From a first guess to the grid and the assignment that suit each other. Fails with GSN_E_NOMEM.
 */
int gsn_grid_settle(const struct gsn_grid_problem *p, struct gsn_grid_answer *a,
                    struct gsn_error *err);

/* ---- panel_grid_choose.c: which of them ----------------------------------------------------- */

/* The best of the answers, and where it is in doubt. Fails as gsn_panel_grid_fit() does. */
int gsn_grid_choose(const struct gsn_grid_problem *p, const struct gsn_grid_answer *answers,
                    size_t number, struct gsn_panel_grid *ret_grid, struct gsn_panel_seat *ret_seat,
                    struct gsn_error *err);

#endif
