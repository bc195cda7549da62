/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the regions of a panel (segment.h) are assigned to the slots of a regular grid (grid.h).
 *
 * Steps of gsn_panel_split(). 1. Components of tissue, and the area that sections share. 2.
 * Regions: components that hold several sections are cut, torn ones joined. 3. The grid is fitted
 * to all regions that have the size and the shape of a section. 4. What is too small or too odd for
 * that may still be the section of its slot; a fragment goes with the nearest section. 5. Boxes
 * with a margin of 150 um that no neighbour's half of the way is in, shares that are lost beyond
 * the border, and where a cut is doubtful; what is left over is listed.
 *
 * Fails as the grid does. */
#include "pipeline/register/panel/slots.h"

#include "pipeline/register/panel/grid.h"
#include "pipeline/register/panel/segment.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

/* In sizes of a section: a smaller component this near to a section is a part of it. */
static const double NEAR = 0.25;

struct cells {
    int width, height, step; /* step: panel pixels per cell */
    double um;               /* size of a cell */
};

struct panel {
    struct cells cells;
    struct gsn_components *components;
    const uint8_t *thin; /* of each component: nowhere wider than a thread */
    double section_area; /* cells */
    struct gsn_panel_regions *regions;
    struct gsn_panel_grid grid;
    struct gsn_slot_assignment *assigned; /* of each region */
    size_t places;                        /* rows * columns */
    struct gsn_part *held;                /* places: what was given to each */
    size_t *region;                       /* places: the region that is its section */
};

void gsn_panel_place(const struct gsn_layout *layout, unsigned slot, unsigned *ret_row,
                     unsigned *ret_column)
{
    assert(slot < layout->rows * layout->columns);

    if (layout->order == GSN_ORDER_COLUMN) {
        *ret_row = slot % layout->rows;
        *ret_column = slot / layout->rows;
        return;
    }
    *ret_row = slot / layout->columns;
    *ret_column = slot % layout->columns;
    if (layout->order == GSN_ORDER_SNAKE && *ret_row % 2 == 1)
        *ret_column = layout->columns - 1 - *ret_column;
}

unsigned gsn_panel_serial(unsigned panel_number, unsigned slot, const struct gsn_layout *layout)
{
    assert(panel_number >= 1);

    return (panel_number - 1) * layout->rows * layout->columns + slot;
}

/* Row by row; GSN_NO_PLACE for GSN_SLOT_UNSAID. */
static int place_of_slot(const struct gsn_layout *layout, unsigned slot)
{
    unsigned row, column;

    if (slot == GSN_SLOT_UNSAID)
        return GSN_NO_PLACE;
    gsn_panel_place(layout, slot, &row, &column);
    return (int)(row * layout->columns + column);
}

static unsigned slot_at_place(const struct gsn_layout *layout, int place)
{
    for (unsigned slot = 0; slot < layout->rows * layout->columns; slot++) {
        unsigned row, column;

        gsn_panel_place(layout, slot, &row, &column);
        if ((int)(row * layout->columns + column) == place)
            return slot;
    }
    return 0;
}

/* ---- regions to slots -------------------------------------------------------------------------
 */

/* Sections are at most this many times as long as wide; pen strokes and frames are longer. */
static const double LONGEST = 5;

/* In areas of a typical section. */
static const double SECTION_LEAST = 0.3; /* less is a scrap */
static const double GRID_LEAST = 0.4;    /* takes part in the fit of the grid */

/* A thin thing longer than so many threads is a hair or the edge of a coverslip. */
static const double HAIR = 5;

static int is_long(const struct gsn_part *part)
{
    const int width = part->x1 - part->x0, height = part->y1 - part->y0;

    return width > LONGEST * height || height > LONGEST * width;
}

/* A hair, a scratch, the edge of a coverslip. */
static int is_hair(const struct panel *panel, const struct gsn_panel_region *region)
{
    const double longest =
        hypot(region->part.x1 - region->part.x0, region->part.y1 - region->part.y0);

    return panel->thin[region->component] && longest * panel->cells.um > HAIR * GSN_PANEL_THREAD_UM;
}

/* Of a section's area. */
static double share_of_section(const struct panel *panel, const struct gsn_panel_region *region)
{
    return (double)region->part.area / panel->section_area;
}

/* Whether a region takes part in the fit of the grid. */
static int is_candidate(const struct panel *panel, const struct gsn_panel_region *region)
{
    return share_of_section(panel, region) >= GRID_LEAST &&
           (region->cut ||
            (share_of_section(panel, region) <= GSN_PANEL_SAME_AREA && !is_long(&region->part)));
}

/* Fits the grid to all regions that look like sections, and assigns these their slots. Fails with
 * GSN_E_INPUT, GSN_E_WITHHELD, GSN_E_NOMEM. */
static int fit_grid(struct panel *panel, const struct gsn_layout *layout, int first,
                    struct gsn_error *err)
{
    gsn_auto_mem(unsigned) slot = gsn_alloc_array(panel->places, sizeof *slot);
    const size_t most = panel->regions->count;
    gsn_auto_mem(struct gsn_point) centre = gsn_alloc_array(most, sizeof *centre);
    gsn_auto_mem(struct gsn_slot_assignment) assigned = gsn_alloc_array(most, sizeof *assigned);
    gsn_auto_mem(char) loose = gsn_alloc_array(most, 1);
    gsn_auto_mem(size_t) of = gsn_alloc_array(most, sizeof *of);
    const struct gsn_grid_prior prior = { .rows = layout->rows,
                                          .columns = layout->columns,
                                          .size = sqrt(panel->section_area),
                                          .width = panel->cells.width,
                                          .height = panel->cells.height,
                                          .slot = slot,
                                          .loose = loose,
                                          .first = first };
    size_t count = 0;
    int r;

    if (!slot || !centre || !assigned || !loose || !of)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (unsigned i = 0; i < panel->places; i++)
        slot[place_of_slot(layout, i)] = i;
    for (size_t i = 0; i < most; i++) {
        panel->assigned[i] = (struct gsn_slot_assignment){ GSN_NO_PLACE, GSN_NO_PLACE };
        if (!is_candidate(panel, &panel->regions->region[i]))
            continue;
        centre[count] = gsn_part_centre(&panel->regions->region[i].part);
        loose[count] = (char)panel->regions->region[i].cut;
        of[count++] = i;
    }
    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "nothing on this panel has the shape of a section: look at the picture");
    r = gsn_panel_grid_fit(centre, count, &prior, &panel->grid, assigned, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        panel->assigned[of[i]] = assigned[i];
    return r;
}

static void assign_region(struct panel *panel, size_t region, int place)
{
    panel->assigned[region].place = place;
    panel->region[place] = region;
    gsn_part_add(&panel->held[place], &panel->regions->region[region].part);
}

/* What is too small or too odd to tell where the grid is may still be the section of its slot. */
static void assign_section(struct panel *panel, size_t i)
{
    const struct gsn_panel_region *region = &panel->regions->region[i];
    int place;

    if (region->part.area == 0 || panel->assigned[i].place != GSN_NO_PLACE || region->cut ||
        share_of_section(panel, region) < SECTION_LEAST || is_long(&region->part) ||
        is_hair(panel, region))
        return;
    place = gsn_panel_grid_place(&panel->grid, gsn_part_centre(&region->part));
    if (place != GSN_NO_PLACE && panel->held[place].area == 0)
        assign_region(panel, i, place);
}

/* A piece torn off a section goes with the nearest. */
static void assign_fragment(struct panel *panel, size_t i)
{
    const struct gsn_panel_region *region = &panel->regions->region[i];
    double least = NEAR * sqrt(panel->section_area);
    int home = GSN_NO_PLACE;

    if (region->part.area == 0 || panel->assigned[i].place != GSN_NO_PLACE || region->cut ||
        share_of_section(panel, region) >= GRID_LEAST || is_hair(panel, region) ||
        gsn_segment_is_dust(&panel->components->component[region->component], panel->cells.um))
        return;
    for (size_t place = 0; place < panel->places; place++) {
        double apart;

        if (panel->held[place].area == 0)
            continue;
        apart =
            gsn_part_distance(&region->part, &panel->regions->region[panel->region[place]].part);
        if (apart < least) {
            least = apart;
            home = (int)place;
        }
    }
    if (home == GSN_NO_PLACE)
        return;
    panel->assigned[i].place = home;
    gsn_part_add(&panel->held[home], &region->part);
}

/* Gives every place what belongs there. */
static void assign_regions(struct panel *panel)
{
    for (size_t i = 0; i < panel->regions->count; i++)
        if (panel->assigned[i].place != GSN_NO_PLACE)
            assign_region(panel, i, panel->assigned[i].place);
    for (size_t i = 0; i < panel->regions->count; i++)
        assign_section(panel, i);
    for (size_t i = 0; i < panel->regions->count; i++)
        assign_fragment(panel, i);
}

/* ---- what is told of each slot ----------------------------------------------------------------
 */

static const double MARGIN_UM = 150;
/* Where to cut two sections apart is clear when the neck is narrow, in sizes of a section, and both
 * have about the area of one: two discs that share a chord of 0.3 of their width dispute a fortieth
 * of it. */
static const double NECK = 0.3, PARTED = 0.3;

/* Share of a section that may lie outside the grid before it counts as lost. */
static const double LOST_LEAST = 0.02;

/* The box of one slot with its margin, kept out of the other half of the way to a neighbour. */
static void frame_slot(const struct panel *panel, size_t place, double px_um, struct gsn_slot *slot)
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
static double share_lost(const struct panel *panel, size_t place)
{
    const struct gsn_part *held = &panel->held[place];
    const struct gsn_panel_region *region = &panel->regions->region[panel->region[place]];
    const int at_border = held->x0 == 0 || held->y0 == 0 || held->x1 == panel->cells.width ||
                          held->y1 == panel->cells.height;
    const int beyond = region->cut && panel->assigned[region->beside].place == GSN_NO_PLACE;
    const double lost = 1 - (double)held->area / panel->section_area;

    return (at_border || beyond) && lost >= LOST_LEAST ? lost : 0;
}

static int is_whole(const struct panel *panel, size_t region)
{
    return fabs(share_of_section(panel, &panel->regions->region[region]) - 1) <= PARTED;
}

/* A section that was cut off from another one. */
static void describe_cut(const struct panel *panel, const struct gsn_layout *layout, size_t own,
                         struct gsn_slot *slot)
{
    const struct gsn_panel_region *region = &panel->regions->region[own];
    const int beside = panel->assigned[region->beside].place;

    if (!region->cut || region->beside == own || beside == GSN_NO_PLACE)
        return;
    slot->parted = region->neck <= NECK * sqrt(panel->section_area) && is_whole(panel, own) &&
                   is_whole(panel, region->beside);
    slot->touching = !slot->parted;
    slot->touched = slot_at_place(layout, beside);
    for (int k = 0; k < 2; k++) {
        slot->cut_px[k].x = region->end[k].x * panel->cells.step;
        slot->cut_px[k].y = region->end[k].y * panel->cells.step;
    }
}

/* panel_slots.c */
static void fill_slots(const struct panel *panel, const struct gsn_layout *layout, double px_um,
                       struct gsn_slot *ret_slots)
{
    const int step = panel->cells.step;

    for (unsigned i = 0; i < panel->places; i++) {
        struct gsn_slot *slot = &ret_slots[i];
        const struct gsn_part *held;
        struct gsn_point centre;
        size_t place, region;

        *slot = (struct gsn_slot){ .slot = i };
        gsn_panel_place(layout, i, &slot->row, &slot->column);
        place = (size_t)slot->row * layout->columns + slot->column;
        held = &panel->held[place];
        if (held->area == 0)
            continue;
        region = panel->region[place];
        slot->found = 1;
        slot->lost = share_lost(panel, place);
        describe_cut(panel, layout, region, slot);
        slot->doubtful = panel->assigned[region].other != GSN_NO_PLACE;
        slot->rival = slot->doubtful ? slot_at_place(layout, panel->assigned[region].other) : 0;
        slot->area_px = (double)held->area * step * step;
        centre = gsn_part_centre(held);
        slot->centre_px = (struct gsn_point){ centre.x * step, centre.y * step };
        frame_slot(panel, place, px_um, slot);
    }
}

static int by_area(const void *a, const void *b)
{
    const struct gsn_scrap *p = a, *q = b;

    if (p->area_px != q->area_px)
        return p->area_px < q->area_px ? 1 : -1;
    return p->y != q->y ? (p->y > q->y) - (p->y < q->y) : (p->x > q->x) - (p->x < q->x);
}

/* gives: the regions above dust size that were not taken; between the slots, no hairs. Fails with
 * GSN_E_NOMEM. */
static int list_scraps(const struct panel *panel, struct gsn_scrap **ret_scraps, size_t *ret_count,
                       struct gsn_error *err)
{
    const int step = panel->cells.step;
    gsn_auto_mem(struct gsn_scrap) scraps = gsn_alloc_array(panel->regions->count, sizeof *scraps);
    size_t count = 0;

    if (!scraps)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the components of a panel");
    for (size_t i = 0; i < panel->regions->count; i++) {
        const struct gsn_panel_region *region = &panel->regions->region[i];
        const struct gsn_part *p = &region->part;
        int inside;

        if (panel->assigned[i].place != GSN_NO_PLACE || p->area == 0 ||
            gsn_segment_is_dust(&panel->components->component[region->component], panel->cells.um))
            continue;
        inside = gsn_panel_grid_place(&panel->grid, gsn_part_centre(p)) != GSN_NO_PLACE;
        if (inside && is_hair(panel, region))
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

/* Everything after the components are known. */
static int find_sections(struct panel *panel, const struct gsn_layout *layout, double px_um,
                         int first, struct gsn_slot *ret_slots, struct gsn_scrap **ret_scraps,
                         size_t *ret_scrap_count, struct gsn_error *err)
{
    gsn_auto(gsn_panel_regions) regions = NULL;
    gsn_auto_mem(struct gsn_slot_assignment) assigned = NULL;
    gsn_auto_mem(struct gsn_part) held = gsn_alloc_array(panel->places, sizeof *held);
    gsn_auto_mem(size_t) region = gsn_alloc_array(panel->places, sizeof *region);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0;
    int r = gsn_segment_regions(panel->components, panel->section_area, GSN_PANEL_SAME_AREA,
                                NEAR * sqrt(panel->section_area), &regions, err);

    if (r < 0)
        return r;
    assigned = gsn_alloc_array(regions->count, sizeof *assigned);
    if (!assigned || !held || !region)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the components of a panel");
    panel->regions = regions;
    panel->assigned = assigned;
    panel->held = held;
    panel->region = region;
    r = fit_grid(panel, layout, first, err);
    if (r < 0)
        return r;
    assign_regions(panel);
    if (ret_scraps && ret_scrap_count) {
        r = list_scraps(panel, &scraps, &scrap_count, err);
        if (r < 0)
            return r;
        *ret_scraps = gsn_steal(&scraps);
        *ret_scrap_count = scrap_count;
    }
    fill_slots(panel, layout, px_um, ret_slots);
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
    gsn_auto(gsn_components) components = NULL;
    gsn_auto_mem(uint8_t) thin = NULL;
    struct panel panel = { 0 };
    int r;

    assert(tissue && tissue->width > 0 && tissue->height > 0 && step > 0);
    assert(layout && layout->rows > 0 && layout->columns > 0 && ret_slots);
    assert(first == GSN_SLOT_UNSAID || first < layout->rows * layout->columns);

    if (!(px_um > 0 && isfinite(px_um)))
        return gsn_fail(err, GSN_E_INPUT, "a pixel of %g um: the panel cannot be split", px_um);
    panel.cells = (struct cells){ .width = (int)tissue->width,
                                  .height = (int)tissue->height,
                                  .step = (int)step,
                                  .um = px_um * step };
    r = gsn_segment_tissue(tissue, panel.cells.um, &components, &thin, err);
    if (r < 0)
        return r;
    panel.components = components;
    panel.thin = thin;
    panel.section_area = gsn_segment_section_area(components, panel.cells.um);
    panel.places = (size_t)layout->rows * layout->columns;
    if (panel.section_area == 0) {
        leave_empty(layout, ret_slots);
        return GSN_OK;
    }
    return find_sections(&panel, layout, px_um, place_of_slot(layout, first), ret_slots, ret_scraps,
                         ret_scrap_count, err);
}
