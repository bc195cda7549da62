/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel.h"

#include "pipeline/register/panel_grid.h"
#include "pipeline/register/panel_units.h"
#include "pipeline/register/split.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

static const double MARGIN_UM = 150;
/* Anything smaller is dust. */
static const double DUST_UM = 200;
/* The tissue's mean must stand this far above the glass, in optical density. */
static const double TISSUE_LEAST = 0.05;
enum { BINS = 256 };
/* Density above which all is simply dark: ink must not pull the threshold up. */
static const double DARKEST = 1.0;

/* Pieces alike speak louder than one: two sections that grew together cover as much as two alone.
 */
static const double ALONE = 0.8;
/* Sections are at most this many times as long as wide; pen strokes and frames are longer. */
static const double LONGEST = 5;
/* In areas of a typical section. */
static const double SAME_AREA = 1.6;     /* pieces alike within this factor vote for each other */
static const double SECTION_LEAST = 0.3; /* less is a scrap */
static const double GRID_LEAST = 0.4;    /* takes part in laying the grid */
/* What joins two sections and is thinner than this is no tissue of theirs. */
static const double THREAD_UM = 250;
/* A thin thing longer than so many threads is a hair or the edge of a coverslip. */
static const double HAIR = 5;
/* Where to cut two sections apart is clear when the neck is narrow, in sizes of a section, and both
 * have about the area of one: two discs that share a chord of 0.3 of their width dispute a fortieth
 * of it. */
static const double NECK = 0.3, PARTED = 0.3;
/* Share of a section that may lie outside the grid before it counts as lost. */
static const double LOST_LEAST = 0.02;
/* In sizes of a section: a smaller piece this near to a section is a part of it. */
static const double NEAR = 0.25;

struct cells {
    int width, height, step; /* step: panel pixels per cell */
    double um;               /* size of a cell */
};

struct panel {
    struct cells cells;
    struct gsn_components *pieces;
    double section_area; /* cells */
    struct gsn_panel_units *units;
    struct gsn_panel_grid grid;
    struct gsn_panel_seat *seat; /* of each unit */
    size_t places;               /* rows * columns */
    struct gsn_part *held;       /* places: what was given to each */
    size_t *unit;                /* places: the unit that is its section */
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

static int place_of(const struct gsn_layout *layout, unsigned slot)
{
    unsigned row, column;

    if (slot == GSN_SLOT_UNSAID)
        return GSN_NO_PLACE;
    gsn_panel_place(layout, slot, &row, &column);
    return (int)(row * layout->columns + column);
}

/* Masked cells and what is brighter than glass count as glass. */
static void clip(const struct gsn_plane *tissue, float *ret_value)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    const float most = (float)DARKEST;

    for (size_t i = 0; i < count; i++) {
        const float value = tissue->value[i];

        ret_value[i] = value > 0 ? value < most ? value : most : 0;
    }
}

/* Otsu's threshold between glass and tissue; ret_apart is the distance of their means. */
static double threshold_of(const float *value, size_t count, double *ret_apart)
{
    size_t histogram[BINS] = { 0 }, below = 0, best = 0;
    double all = 0, sum = 0, most = -1;

    for (size_t i = 0; i < count; i++) {
        const unsigned bin = (unsigned)(value[i] * (float)(BINS / DARKEST));

        histogram[bin < BINS ? bin : BINS - 1]++;
    }
    for (size_t b = 0; b < BINS; b++)
        all += (double)histogram[b] * ((double)b + 0.5);
    *ret_apart = 0;
    for (size_t b = 0; b + 1 < BINS; b++) {
        double apart, between;

        below += histogram[b];
        sum += (double)histogram[b] * ((double)b + 0.5);
        if (below == 0 || below == count)
            continue;
        apart = (all - sum) / (double)(count - below) - sum / (double)below;
        between = (double)below * (double)(count - below) * apart * apart;
        if (between > most) {
            most = between;
            best = b;
            *ret_apart = apart / BINS * DARKEST;
        }
    }
    return (double)(best + 1) / BINS * DARKEST;
}

static int find_pieces(const struct gsn_plane *tissue, double cell_um,
                       struct gsn_components **ret_pieces, struct gsn_error *err)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    gsn_auto_mem(float) value = gsn_alloc(count * sizeof *value);
    gsn_auto_mem(uint8_t) mask = gsn_alloc(count);
    double apart;
    float threshold;

    if (!value || !mask)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    clip(tissue, value);
    threshold = (float)threshold_of(value, count, &apart);
    for (size_t i = 0; i < count; i++)
        mask[i] = apart >= TISSUE_LEAST && value[i] >= threshold;
    return gsn_split_pieces(mask, (int)tissue->width, (int)tissue->height,
                            (unsigned)(THREAD_UM / cell_um), ret_pieces, err);
}

static int is_dust(const struct gsn_component *piece, const struct cells *cells)
{
    return (double)piece->area * cells->um * cells->um < DUST_UM * DUST_UM;
}

/* The area that sections share: the size class of pieces that covers most of the panel. A label may
 * be larger than a section, and print is more numerous, but neither covers as much. */
static double section_area(const struct gsn_components *pieces, const struct cells *cells)
{
    double most = 0, area = 0;

    for (size_t i = 0; i < pieces->count; i++) {
        const double own = (double)pieces->piece[i].area;
        double sum = 0;
        size_t alike = 0;

        if (is_dust(&pieces->piece[i], cells))
            continue;
        for (size_t k = 0; k < pieces->count; k++) {
            const double other = (double)pieces->piece[k].area;

            if (other <= SAME_AREA * own && own <= SAME_AREA * other) {
                sum += other;
                alike++;
            }
        }
        if (alike == 1)
            sum *= ALONE;
        if (sum > most) {
            most = sum;
            area = alike == 1 ? own : sum / (double)alike;
        }
    }
    return area;
}

static int is_long(const struct gsn_part *part)
{
    const int width = part->x1 - part->x0, height = part->y1 - part->y0;

    return width > LONGEST * height || height > LONGEST * width;
}

/* A hair, a scratch, the edge of a coverslip. */
static int is_hair(const struct panel *panel, const struct gsn_panel_unit *unit)
{
    const double longest = hypot(unit->part.x1 - unit->part.x0, unit->part.y1 - unit->part.y0);

    return panel->pieces->piece[unit->piece].thin && longest * panel->cells.um > HAIR * THREAD_UM;
}

static double share_of(const struct panel *panel, const struct gsn_panel_unit *unit)
{
    return (double)unit->part.area / panel->section_area;
}

/* Whether a unit takes part in laying the grid. */
static int is_candidate(const struct panel *panel, const struct gsn_panel_unit *unit)
{
    return share_of(panel, unit) >= GRID_LEAST &&
           (unit->cut || (share_of(panel, unit) <= SAME_AREA && !is_long(&unit->part)));
}

/* Lays the grid on all units that look like sections, and gives these their slots. */
static int lay_grid(struct panel *panel, const struct gsn_layout *layout, int first,
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
        slot[place_of(layout, i)] = i;
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

static int give(struct panel *panel, size_t unit, int place)
{
    panel->seat[unit].place = place;
    panel->unit[place] = unit;
    gsn_part_add(&panel->held[place], &panel->units->unit[unit].part);
    return 1;
}

/* What is too small or too odd to tell where the grid is may still be the section of its slot. */
static void give_section(struct panel *panel, size_t i)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[i];
    int place;

    if (unit->part.area == 0 || panel->seat[i].place != GSN_NO_PLACE || unit->cut ||
        share_of(panel, unit) < SECTION_LEAST || is_long(&unit->part) || is_hair(panel, unit))
        return;
    place = gsn_panel_grid_place(&panel->grid, gsn_part_centre(&unit->part));
    if (place != GSN_NO_PLACE && panel->held[place].area == 0)
        (void)give(panel, i, place);
}

/* A piece torn off a section goes with the nearest. */
static void give_fragment(struct panel *panel, size_t i)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[i];
    double least = NEAR * sqrt(panel->section_area);
    int home = GSN_NO_PLACE;

    if (unit->part.area == 0 || panel->seat[i].place != GSN_NO_PLACE || unit->cut ||
        share_of(panel, unit) >= GRID_LEAST || is_hair(panel, unit) ||
        is_dust(&panel->pieces->piece[unit->piece], &panel->cells))
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

/* The box of one slot with its margin, kept out of the other half of the way to a neighbour. */
static void frame(const struct panel *panel, size_t place, double px_um, struct gsn_slot *slot)
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
static double lost_of(const struct panel *panel, size_t place)
{
    const struct gsn_part *held = &panel->held[place];
    const struct gsn_panel_unit *unit = &panel->units->unit[panel->unit[place]];
    const int at_border = held->x0 == 0 || held->y0 == 0 || held->x1 == panel->cells.width ||
                          held->y1 == panel->cells.height;
    const int beyond = unit->cut && panel->seat[unit->beside].place == GSN_NO_PLACE;
    const double lost = 1 - (double)held->area / panel->section_area;

    return (at_border || beyond) && lost >= LOST_LEAST ? lost : 0;
}

static unsigned slot_at(const struct gsn_layout *layout, int place)
{
    for (unsigned slot = 0; slot < layout->rows * layout->columns; slot++) {
        unsigned row, column;

        gsn_panel_place(layout, slot, &row, &column);
        if ((int)(row * layout->columns + column) == place)
            return slot;
    }
    return 0;
}

static int is_whole(const struct panel *panel, size_t unit)
{
    return fabs(share_of(panel, &panel->units->unit[unit]) - 1) <= PARTED;
}

/* A section that was cut off from another one. */
static void describe_cut(const struct panel *panel, const struct gsn_layout *layout, size_t own,
                         struct gsn_slot *slot)
{
    const struct gsn_panel_unit *unit = &panel->units->unit[own];
    const int beside = panel->seat[unit->beside].place;

    if (!unit->cut || unit->beside == own || beside == GSN_NO_PLACE)
        return;
    slot->parted = unit->neck <= NECK * sqrt(panel->section_area) && is_whole(panel, own) &&
                   is_whole(panel, unit->beside);
    slot->touching = !slot->parted;
    slot->touched = slot_at(layout, beside);
    for (int k = 0; k < 2; k++) {
        slot->cut_px[k].x = unit->end[k].x * panel->cells.step;
        slot->cut_px[k].y = unit->end[k].y * panel->cells.step;
    }
}

static void fill_slots(const struct panel *panel, const struct gsn_layout *layout, double px_um,
                       struct gsn_slot *ret_slots)
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
        slot->rival = slot->doubtful ? slot_at(layout, panel->seat[unit].other) : 0;
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

/* gives: the units above dust size that were not taken; between the slots, no hairs. */
static int list_scraps(const struct panel *panel, struct gsn_scrap **ret_scraps, size_t *ret_count,
                       struct gsn_error *err)
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
            is_dust(&panel->pieces->piece[unit->piece], &panel->cells))
            continue;
        inside = gsn_panel_grid_place(&panel->grid, gsn_part_centre(p)) != GSN_NO_PLACE;
        if (inside && is_hair(panel, unit))
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

static void deal_out(struct panel *panel)
{
    for (size_t i = 0; i < panel->units->count; i++)
        if (panel->seat[i].place != GSN_NO_PLACE)
            (void)give(panel, i, panel->seat[i].place);
    for (size_t i = 0; i < panel->units->count; i++)
        give_section(panel, i);
    for (size_t i = 0; i < panel->units->count; i++)
        give_fragment(panel, i);
}

/* Everything after the pieces are known. */
static int find_sections(struct panel *panel, const struct gsn_layout *layout, double px_um,
                         int first, struct gsn_slot *ret_slots, struct gsn_scrap **ret_scraps,
                         size_t *ret_scrap_count, struct gsn_error *err)
{
    gsn_auto(gsn_panel_units) units = NULL;
    gsn_auto_mem(struct gsn_panel_seat) seat = NULL;
    gsn_auto_mem(struct gsn_part) held = gsn_alloc_array(panel->places, sizeof *held);
    gsn_auto_mem(size_t) unit = gsn_alloc_array(panel->places, sizeof *unit);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0;
    int r = gsn_panel_units_find(panel->pieces, panel->section_area, SAME_AREA,
                                 NEAR * sqrt(panel->section_area), &units, err);

    if (r < 0)
        return r;
    seat = gsn_alloc_array(units->count, sizeof *seat);
    if (!seat || !held || !unit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    panel->units = units;
    panel->seat = seat;
    panel->held = held;
    panel->unit = unit;
    r = lay_grid(panel, layout, first, err);
    if (r < 0)
        return r;
    deal_out(panel);
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
    gsn_auto(gsn_components) pieces = NULL;
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
    r = find_pieces(tissue, panel.cells.um, &pieces, err);
    if (r < 0)
        return r;
    panel.pieces = pieces;
    panel.section_area = section_area(pieces, &panel.cells);
    panel.places = (size_t)layout->rows * layout->columns;
    if (panel.section_area == 0) {
        leave_empty(layout, ret_slots);
        return GSN_OK;
    }
    return find_sections(&panel, layout, px_um, place_of(layout, first), ret_slots, ret_scraps,
                         ret_scrap_count, err);
}
