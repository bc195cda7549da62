/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_parts.h"

#include <math.h>

/* Sections are at most this many times as long as wide; pen strokes and frames are longer. */
static const double LONGEST = 5;
/* In areas of a typical section. */
static const double SECTION_LEAST = 0.3; /* less is a scrap */
static const double GRID_LEAST = 0.4;    /* takes part in laying the grid */
/* A thin thing longer than so many threads is a hair or the edge of a coverslip. */
static const double HAIR = 5;

static int is_long(const struct gsn_part *part)
{
    const int width = part->x1 - part->x0, height = part->y1 - part->y0;

    return width > LONGEST * height || height > LONGEST * width;
}

int gsn_panel_is_hair(const struct gsn_panel_work *panel, const struct gsn_panel_unit *unit)
{
    const double longest = hypot(unit->part.x1 - unit->part.x0, unit->part.y1 - unit->part.y0);

    return panel->thin[unit->piece] &&
           longest * panel->cells.um > HAIR * GSN_PANEL_THREAD_UM;
}

double gsn_panel_share(const struct gsn_panel_work *panel, const struct gsn_panel_unit *unit)
{
    return (double)unit->part.area / panel->section_area;
}

/* Whether a unit takes part in laying the grid. */
static int is_candidate(const struct gsn_panel_work *panel, const struct gsn_panel_unit *unit)
{
    return gsn_panel_share(panel, unit) >= GRID_LEAST &&
           (unit->cut ||
            (gsn_panel_share(panel, unit) <= GSN_PANEL_SAME_AREA && !is_long(&unit->part)));
}

int gsn_panel_lay_grid(struct gsn_panel_work *panel, const struct gsn_layout *layout, int first,
                       struct gsn_error *err)
{
    gsn_auto_mem(unsigned) slot = gsn_alloc_array(panel->places, sizeof *slot);
    const size_t most = panel->units->count;
    gsn_auto_mem(struct gsn_point) centre = gsn_alloc_array(most, sizeof *centre);
    gsn_auto_mem(struct gsn_panel_seat) seat = gsn_alloc_array(most, sizeof *seat);
    gsn_auto_mem(char) loose = gsn_alloc_array(most, 1);
    gsn_auto_mem(size_t) of = gsn_alloc_array(most, sizeof *of);
    const struct gsn_panel_ground ground = { .rows = layout->rows,
                                             .columns = layout->columns,
                                             .size = sqrt(panel->section_area),
                                             .width = panel->cells.width,
                                             .height = panel->cells.height,
                                             .slot = slot,
                                             .loose = loose,
                                             .first = first };
    size_t count = 0;
    int r;

    if (!slot || !centre || !seat || !loose || !of)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (unsigned i = 0; i < panel->places; i++)
        slot[gsn_panel_place_of(layout, i)] = i;
    for (size_t i = 0; i < most; i++) {
        panel->seat[i] = (struct gsn_panel_seat){ GSN_NO_PLACE, GSN_NO_PLACE };
        if (!is_candidate(panel, &panel->units->unit[i]))
            continue;
        centre[count] = gsn_part_centre(&panel->units->unit[i].part);
        loose[count] = (char)panel->units->unit[i].cut;
        of[count++] = i;
    }
    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "nothing on this panel has the shape of a section: look at the picture");
    r = gsn_panel_grid_fit(centre, count, &ground, &panel->grid, seat, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        panel->seat[of[i]] = seat[i];
    return r;
}

static void give(struct gsn_panel_work *panel, size_t unit, int place)
{
    panel->seat[unit].place = place;
    panel->unit[place] = unit;
    gsn_part_add(&panel->held[place], &panel->units->unit[unit].part);
}

/* What is too small or too odd to tell where the grid is may still be the section of its slot. */
static void give_section(struct gsn_panel_work *panel, size_t i)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[i];
    int place;

    if (unit->part.area == 0 || panel->seat[i].place != GSN_NO_PLACE || unit->cut ||
        gsn_panel_share(panel, unit) < SECTION_LEAST || is_long(&unit->part) ||
        gsn_panel_is_hair(panel, unit))
        return;
    place = gsn_panel_grid_place(&panel->grid, gsn_part_centre(&unit->part));
    if (place != GSN_NO_PLACE && panel->held[place].area == 0)
        give(panel, i, place);
}

/* A piece torn off a section goes with the nearest. */
static void give_fragment(struct gsn_panel_work *panel, size_t i)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[i];
    double least = GSN_PANEL_NEAR * sqrt(panel->section_area);
    int home = GSN_NO_PLACE;

    if (unit->part.area == 0 || panel->seat[i].place != GSN_NO_PLACE || unit->cut ||
        gsn_panel_share(panel, unit) >= GRID_LEAST || gsn_panel_is_hair(panel, unit) ||
        gsn_panel_is_dust(&panel->pieces->component[unit->piece], &panel->cells))
        return;
    for (size_t place = 0; place < panel->places; place++) {
        double apart;

        if (panel->held[place].area == 0)
            continue;
        apart = gsn_part_distance(&unit->part, &panel->units->unit[panel->unit[place]].part);
        if (apart < least) {
            least = apart;
            home = (int)place;
        }
    }
    if (home == GSN_NO_PLACE)
        return;
    panel->seat[i].place = home;
    gsn_part_add(&panel->held[home], &unit->part);
}

void gsn_panel_deal_out(struct gsn_panel_work *panel)
{
    for (size_t i = 0; i < panel->units->count; i++)
        if (panel->seat[i].place != GSN_NO_PLACE)
            give(panel, i, panel->seat[i].place);
    for (size_t i = 0; i < panel->units->count; i++)
        give_section(panel, i);
    for (size_t i = 0; i < panel->units->count; i++)
        give_fragment(panel, i);
}
