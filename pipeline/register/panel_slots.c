/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_parts.h"

#include <math.h>
#include <stdlib.h>

static const double MARGIN_UM = 150;
/* Where to cut two sections apart is clear when the neck is narrow, in sizes of a section, and both
 * have about the area of one: two discs that share a chord of 0.3 of their width dispute a fortieth
 * of it. */
static const double NECK = 0.3, PARTED = 0.3;
/* Share of a section that may lie outside the grid before it counts as lost. */
static const double LOST_LEAST = 0.02;

/* The box of one slot with its margin, kept out of the other half of the way to a neighbour. */
static void frame(const struct gsn_panel_work *panel, size_t place, double px_um,
                  struct gsn_slot *slot)
{
    const struct gsn_part *own = &panel->held[place];
    const int step = panel->cells.step;
    const int right = panel->cells.width * step, bottom = panel->cells.height * step;
    const int margin = (int)(MARGIN_UM / px_um);
    const int reach = margin / step + 1;
    int x0 = own->x0 * step - margin, x1 = own->x1 * step + margin;
    int y0 = own->y0 * step - margin, y1 = own->y1 * step + margin;

    for (size_t other = 0; other < panel->places; other++) {
        const struct gsn_part *next = &panel->held[other];
        const int beside = next->y0 - reach < own->y1 + reach && own->y0 - reach < next->y1 + reach;
        const int below = next->x0 - reach < own->x1 + reach && own->x0 - reach < next->x1 + reach;

        if (other == place || next->area == 0)
            continue;
        if (beside && own->x1 <= next->x0 && x1 > (own->x1 + next->x0) * step / 2)
            x1 = (own->x1 + next->x0) * step / 2;
        if (beside && next->x1 <= own->x0 && x0 < (own->x0 + next->x1) * step / 2)
            x0 = (own->x0 + next->x1) * step / 2;
        if (below && own->y1 <= next->y0 && y1 > (own->y1 + next->y0) * step / 2)
            y1 = (own->y1 + next->y0) * step / 2;
        if (below && next->y1 <= own->y0 && y0 < (own->y0 + next->y1) * step / 2)
            y0 = (own->y0 + next->y1) * step / 2;
    }
    slot->x = x0 > 0 ? x0 : 0;
    slot->y = y0 > 0 ? y0 : 0;
    slot->width = (x1 < right ? x1 : right) - slot->x;
    slot->height = (y1 < bottom ? y1 : bottom) - slot->y;
}

/* What is lost is not seen, or cannot be told from a label it was cut off from: a section that
 * lacks some is taken to have been as large as the others. */
static double lost_of(const struct gsn_panel_work *panel, size_t place)
{
    const struct gsn_part *held = &panel->held[place];
    const struct gsn_panel_unit *unit = &panel->units->unit[panel->unit[place]];
    const int at_border = held->x0 == 0 || held->y0 == 0 || held->x1 == panel->cells.width ||
                          held->y1 == panel->cells.height;
    const int beyond = unit->cut && panel->seat[unit->beside].place == GSN_NO_PLACE;
    const double lost = 1 - (double)held->area / panel->section_area;

    return (at_border || beyond) && lost >= LOST_LEAST ? lost : 0;
}

static int is_whole(const struct gsn_panel_work *panel, size_t unit)
{
    return fabs(gsn_panel_share(panel, &panel->units->unit[unit]) - 1) <= PARTED;
}

/* A section that was cut off from another one. */
static void describe_cut(const struct gsn_panel_work *panel, const struct gsn_layout *layout,
                         size_t own, struct gsn_slot *slot)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[own];
    const int beside = panel->seat[unit->beside].place;

    if (!unit->cut || unit->beside == own || beside == GSN_NO_PLACE)
        return;
    slot->parted = unit->neck <= NECK * sqrt(panel->section_area) && is_whole(panel, own) &&
                   is_whole(panel, unit->beside);
    slot->touching = !slot->parted;
    slot->touched = gsn_panel_slot_at(layout, beside);
    for (int k = 0; k < 2; k++) {
        slot->cut_px[k].x = unit->end[k].x * panel->cells.step;
        slot->cut_px[k].y = unit->end[k].y * panel->cells.step;
    }
}

void gsn_panel_fill_slots(const struct gsn_panel_work *panel, const struct gsn_layout *layout,
                          double px_um, struct gsn_slot *ret_slots)
{
    const int step = panel->cells.step;

    for (unsigned i = 0; i < panel->places; i++) {
        struct gsn_slot *slot = &ret_slots[i];
        const struct gsn_part *held;
        struct gsn_point centre;
        size_t place, unit;

        *slot = (struct gsn_slot){ .slot = i };
        gsn_panel_place(layout, i, &slot->row, &slot->column);
        place = (size_t)slot->row * layout->columns + slot->column;
        held = &panel->held[place];
        if (held->area == 0)
            continue;
        unit = panel->unit[place];
        slot->found = 1;
        slot->lost = lost_of(panel, place);
        describe_cut(panel, layout, unit, slot);
        slot->doubtful = panel->seat[unit].other != GSN_NO_PLACE;
        slot->rival = slot->doubtful ? gsn_panel_slot_at(layout, panel->seat[unit].other) : 0;
        slot->area_px = (double)held->area * step * step;
        centre = gsn_part_centre(held);
        slot->centre_px = (struct gsn_point){ centre.x * step, centre.y * step };
        frame(panel, place, px_um, slot);
    }
}

static int by_area(const void *a, const void *b)
{
    const struct gsn_scrap *p = a, *q = b;

    if (p->area_px != q->area_px)
        return p->area_px < q->area_px ? 1 : -1;
    return p->y != q->y ? (p->y > q->y) - (p->y < q->y) : (p->x > q->x) - (p->x < q->x);
}

int gsn_panel_list_scraps(const struct gsn_panel_work *panel, struct gsn_scrap **ret_scraps,
                          size_t *ret_count, struct gsn_error *err)
{
    const int step = panel->cells.step;
    gsn_auto_mem(struct gsn_scrap) scraps = gsn_alloc_array(panel->units->count, sizeof *scraps);
    size_t count = 0;

    if (!scraps)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    for (size_t i = 0; i < panel->units->count; i++) {
        const struct gsn_panel_unit *unit = &panel->units->unit[i];
        const struct gsn_part *p = &unit->part;
        int inside;

        if (panel->seat[i].place != GSN_NO_PLACE || p->area == 0 ||
            gsn_panel_is_dust(&panel->pieces->component[unit->piece], &panel->cells))
            continue;
        inside = gsn_panel_grid_place(&panel->grid, gsn_part_centre(p)) != GSN_NO_PLACE;
        if (inside && gsn_panel_is_hair(panel, unit))
            continue;
        scraps[count++] = (struct gsn_scrap){ .x = p->x0 * step,
                                              .y = p->y0 * step,
                                              .width = (p->x1 - p->x0) * step,
                                              .height = (p->y1 - p->y0) * step,
                                              .area_px = (double)p->area * step * step,
                                              .inside_grid = inside };
    }
    if (count > 0)
        qsort(scraps, count, sizeof *scraps, by_area);
    *ret_scraps = count > 0 ? gsn_steal(&scraps) : NULL;
    *ret_count = count;
    return GSN_OK;
}
