/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The steps that gsn_panel_split() is made of; for its files alone. Areas are in cells of the
 * reduced panel. */
#ifndef GSN_REGISTER_PANEL_PARTS_H
#define GSN_REGISTER_PANEL_PARTS_H

#include "pipeline/register/panel.h"
#include "pipeline/register/panel_grid.h"
#include "pipeline/register/panel_units.h"
#include "pipeline/register/split.h"

#ifdef __cplusplus
extern "C" {
#endif

/* In areas of a typical section: pieces alike within this factor vote for each other. */
#define GSN_PANEL_SAME_AREA 1.6
/* What joins two sections and is thinner than this is no tissue of theirs. */
#define GSN_PANEL_THREAD_UM 250.0
/* In sizes of a section: a smaller piece this near to a section is a part of it. */
#define GSN_PANEL_NEAR 0.25

struct gsn_panel_cells {
    int width, height, step; /* step: panel pixels per cell */
    double um;               /* size of a cell */
};

struct gsn_panel_work {
    struct gsn_panel_cells cells;
    struct gsn_components *pieces;
    const uint8_t *thin; /* of each piece: nowhere wider than a thread */
    double section_area; /* cells */
    struct gsn_panel_units *units;
    struct gsn_panel_grid grid;
    struct gsn_panel_seat *seat; /* of each unit */
    size_t places;               /* rows * columns */
    struct gsn_part *held;       /* places: what was given to each */
    size_t *unit;                /* places: the unit that is its section */
};

/* panel_layout.c */

/* Row by row; GSN_NO_PLACE for GSN_SLOT_UNSAID. */
int gsn_panel_place_of(const struct gsn_layout *layout, unsigned slot);
unsigned gsn_panel_slot_at(const struct gsn_layout *layout, int place);

/* panel_pieces.c */

/* gives: what on the panel is darker than glass, in pieces, and which are thin. Fails with
 * GSN_E_NOMEM. */
int gsn_panel_pieces_find(const struct gsn_plane *tissue, double cell_um,
                          struct gsn_components **ret_pieces, uint8_t **ret_thin,
                          struct gsn_error *err);
int gsn_panel_is_dust(const struct gsn_component *piece, const struct gsn_panel_cells *cells);
/* The area that sections share: the size class of pieces that covers most of the panel. A label may
 * be larger than a section, and print is more numerous, but neither covers as much. 0: there is
 * nothing but dust. */
double gsn_panel_section_area(const struct gsn_components *pieces,
                              const struct gsn_panel_cells *cells);

/* panel_seats.c */

/* A hair, a scratch, the edge of a coverslip. */
int gsn_panel_is_hair(const struct gsn_panel_work *panel, const struct gsn_panel_unit *unit);
/* Of a section's area. */
double gsn_panel_share(const struct gsn_panel_work *panel, const struct gsn_panel_unit *unit);
/* Lays the grid on all units that look like sections, and gives these their seats. Fails with
 * GSN_E_INPUT, GSN_E_WITHHELD, GSN_E_NOMEM. */
int gsn_panel_lay_grid(struct gsn_panel_work *panel, const struct gsn_layout *layout, int first,
                       struct gsn_error *err);
/* Gives every place what belongs there. */
void gsn_panel_deal_out(struct gsn_panel_work *panel);

/* panel_slots.c */

void gsn_panel_fill_slots(const struct gsn_panel_work *panel, const struct gsn_layout *layout,
                          double px_um, struct gsn_slot *ret_slots);
/* gives: the units above dust size that were not taken; between the slots, no hairs. Fails with
 * GSN_E_NOMEM. */
int gsn_panel_list_scraps(const struct gsn_panel_work *panel, struct gsn_scrap **ret_scraps,
                          size_t *ret_count, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
