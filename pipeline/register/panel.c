/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel.h"

#include "pipeline/register/panel_parts.h"

#include <assert.h>
#include <math.h>

/* Everything after the pieces are known. */
static int find_sections(struct gsn_panel_work *panel, const struct gsn_layout *layout,
                         double px_um, int first, struct gsn_slot *ret_slots,
                         struct gsn_scrap **ret_scraps, size_t *ret_scrap_count,
                         struct gsn_error *err)
{
    gsn_auto(gsn_panel_units) units = NULL;
    gsn_auto_mem(struct gsn_panel_seat) seat = NULL;
    gsn_auto_mem(struct gsn_part) held = gsn_alloc_array(panel->places, sizeof *held);
    gsn_auto_mem(size_t) unit = gsn_alloc_array(panel->places, sizeof *unit);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0;
    int r = gsn_panel_units_find(panel->pieces, panel->section_area, GSN_PANEL_SAME_AREA,
                                 GSN_PANEL_NEAR * sqrt(panel->section_area), &units, err);

    if (r < 0)
        return r;
    seat = gsn_alloc_array(units->count, sizeof *seat);
    if (!seat || !held || !unit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    panel->units = units;
    panel->seat = seat;
    panel->held = held;
    panel->unit = unit;
    r = gsn_panel_lay_grid(panel, layout, first, err);
    if (r < 0)
        return r;
    gsn_panel_deal_out(panel);
    if (ret_scraps && ret_scrap_count) {
        r = gsn_panel_list_scraps(panel, &scraps, &scrap_count, err);
        if (r < 0)
            return r;
        *ret_scraps = gsn_steal(&scraps);
        *ret_scrap_count = scrap_count;
    }
    gsn_panel_fill_slots(panel, layout, px_um, ret_slots);
    return GSN_OK;
}

static void leave_empty(const struct gsn_layout *layout, struct gsn_slot *ret_slots)
{
    for (unsigned i = 0; i < layout->rows * layout->columns; i++) {
        ret_slots[i] = (struct gsn_slot){ .slot = i };
        gsn_panel_place(layout, i, &ret_slots[i].row, &ret_slots[i].column);
    }
}

int gsn_panel_split(const struct gsn_plane *tissue, unsigned step, const struct gsn_layout *layout,
                    double px_um, unsigned first, struct gsn_slot *ret_slots,
                    struct gsn_scrap **ret_scraps, size_t *ret_scrap_count, struct gsn_error *err)
{
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto_mem(uint8_t) thin = NULL;
    struct gsn_panel_work panel = { 0 };
    int r;

    assert(tissue && tissue->width > 0 && tissue->height > 0 && step > 0);
    assert(layout && layout->rows > 0 && layout->columns > 0 && ret_slots);
    assert(first == GSN_SLOT_UNSAID || first < layout->rows * layout->columns);

    if (!(px_um > 0 && isfinite(px_um)))
        return gsn_fail(err, GSN_E_INPUT, "a pixel of %g um: the panel cannot be split", px_um);
    panel.cells = (struct gsn_panel_cells){ .width = (int)tissue->width,
                                            .height = (int)tissue->height,
                                            .step = (int)step,
                                            .um = px_um * step };
    r = gsn_panel_pieces_find(tissue, panel.cells.um, &pieces, &thin, err);
    if (r < 0)
        return r;
    panel.pieces = pieces;
    panel.thin = thin;
    panel.section_area = gsn_panel_section_area(pieces, &panel.cells);
    panel.places = (size_t)layout->rows * layout->columns;
    if (panel.section_area == 0) {
        leave_empty(layout, ret_slots);
        return GSN_OK;
    }
    return find_sections(&panel, layout, px_um, gsn_panel_place_of(layout, first), ret_slots,
                         ret_scraps, ret_scrap_count, err);
}
