/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel.h"

#include "pipeline/register/panel_grid.h"
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

/* In areas of a typical section. */
static const double SAME_AREA = 1.6;     /* pieces alike within this factor vote for each other */
static const double SECTION_LEAST = 0.3; /* less is a scrap */
static const double GRID_LEAST = 0.4;    /* takes part in laying the grid */
static const double OVERRUN = 0.25;      /* more than this in a second slot: sections touch */
/* In sizes of a section: a smaller piece this near to a section is a part of it. */
static const double NEAR = 0.25;

struct cells {
    int width, height, step; /* step: panel pixels per cell */
    double um;               /* size of a cell */
};

/* The part of one piece in one slot, in cells; [x0, x1) by [y0, y1). */
struct part {
    size_t area;
    int x0, y0, x1, y1;
    double sum_x, sum_y;
};

struct panel {
    struct cells cells;
    struct gsn_components *pieces;
    double section_area; /* cells */
    struct gsn_panel_axis columns, rows;
    size_t places;      /* rows * columns; place = row * columns + column */
    struct part *parts; /* pieces->count x (places + 1); the last is what lies outside the grid */
    struct part *held;  /* places: what was given to each */
    int *touching;      /* places */
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

static int find_pieces(const struct gsn_plane *tissue, struct gsn_components **ret_pieces,
                       struct gsn_error *err)
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
    if (apart < TISSUE_LEAST)
        return gsn_fail(err, GSN_E_INPUT, "there is no tissue on the panel");
    for (size_t i = 0; i < count; i++)
        mask[i] = value[i] >= threshold;
    return gsn_split_pieces(mask, (int)tissue->width, (int)tissue->height, ret_pieces, err);
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
        if (sum > most) {
            most = sum;
            area = sum / (double)alike;
        }
    }
    return area;
}

/* The centres of the pieces that are one section each, along x or y, in cells. */
static size_t centres_of(const struct panel *panel, int along_x, double *ret_centre)
{
    size_t count = 0;

    for (size_t i = 0; i < panel->pieces->count; i++) {
        const struct gsn_component *piece = &panel->pieces->piece[i];
        const double share = (double)piece->area / panel->section_area;

        if (share >= GRID_LEAST && share <= SAME_AREA)
            ret_centre[count++] = along_x ? piece->cx : piece->cy;
    }
    return count;
}

static int lay_grid(struct panel *panel, const struct gsn_layout *layout, struct gsn_error *err)
{
    const double size = sqrt(panel->section_area);
    gsn_auto_mem(double) centre = gsn_alloc_array(panel->pieces->count, sizeof *centre);
    int by_x, by_y;

    if (!centre)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    by_x = gsn_panel_axis_fit(centre, centres_of(panel, 1, centre), layout->columns, size,
                              panel->cells.width, 0, "column", &panel->columns, err);
    by_y = gsn_panel_axis_fit(centre, centres_of(panel, 0, centre), layout->rows, size,
                              panel->cells.height, by_x < 0 ? 0 : panel->columns.pitch, "row",
                              &panel->rows, by_x < 0 ? NULL : err);
    /* A single column may borrow its pitch from the rows. */
    if (by_x < 0 && by_y >= 0)
        by_x = gsn_panel_axis_fit(centre, centres_of(panel, 1, centre), layout->columns, size,
                                  panel->cells.width, panel->rows.pitch, "column", &panel->columns,
                                  err);
    return by_x < 0 ? by_x : by_y;
}

static void add_to(struct part *sum, const struct part *part)
{
    if (part->area == 0)
        return;
    if (sum->area == 0) {
        *sum = *part;
        return;
    }
    sum->area += part->area;
    sum->sum_x += part->sum_x;
    sum->sum_y += part->sum_y;
    sum->x0 = part->x0 < sum->x0 ? part->x0 : sum->x0;
    sum->y0 = part->y0 < sum->y0 ? part->y0 : sum->y0;
    sum->x1 = part->x1 > sum->x1 ? part->x1 : sum->x1;
    sum->y1 = part->y1 > sum->y1 ? part->y1 : sum->y1;
}

static struct part *part_of(const struct panel *panel, size_t piece, size_t place)
{
    return &panel->parts[piece * (panel->places + 1) + place];
}

/* Adds the part of a run that lies in one column of the grid. */
static void add_span(struct panel *panel, const struct gsn_piece_run *run, int row, int column,
                     int x0, int x1)
{
    const size_t place =
        row < 0 || column < 0 ? panel->places : (size_t)row * panel->columns.lines + (size_t)column;
    const double length = x1 - x0;
    const struct part span = { .area = (size_t)(x1 - x0),
                               .x0 = x0,
                               .y0 = run->y,
                               .x1 = x1,
                               .y1 = run->y + 1,
                               .sum_x = length * 0.5 * (x0 + x1),
                               .sum_y = length * (run->y + 0.5) };

    add_to(part_of(panel, (size_t)run->piece, place), &span);
}

/* Cuts every piece along the borders of the slots; column is that of each x. */
static void cut_pieces(struct panel *panel, const int *column)
{
    for (size_t i = 0; i < panel->pieces->run_count; i++) {
        const struct gsn_piece_run *run = &panel->pieces->run[i];
        const int row = gsn_panel_axis_line(&panel->rows, run->y + 0.5);

        for (int x = run->x0; x < run->x1;) {
            int end = x + 1;

            while (end < run->x1 && column[end] == column[x])
                end++;
            add_span(panel, run, row, column[x], x, end);
            x = end;
        }
    }
}

/* Where most of a piece lies; panel->places when outside the grid. */
static size_t home_of(const struct panel *panel, size_t piece)
{
    size_t home = panel->places;

    for (size_t place = 0; place < panel->places; place++) {
        if (part_of(panel, piece, place)->area > part_of(panel, piece, home)->area)
            home = place;
    }
    return home;
}

/* Gives a piece of section size to its slot, or its parts to theirs when it spans several. Whether
 * it was taken. */
static int give_section(struct panel *panel, size_t piece)
{
    const double area = (double)panel->pieces->piece[piece].area;
    const size_t home = home_of(panel, piece);
    size_t large = 0;

    if (home == panel->places || area < SECTION_LEAST * panel->section_area)
        return 0;
    for (size_t place = 0; place < panel->places; place++)
        large += (double)part_of(panel, piece, place)->area >= OVERRUN * panel->section_area;
    for (size_t place = 0; place <= panel->places; place++) {
        const struct part *part = part_of(panel, piece, place);
        const int own =
            place < panel->places && (double)part->area >= OVERRUN * panel->section_area;

        add_to(&panel->held[large > 1 && own ? place : home], part);
        if (large > 1 && own)
            panel->touching[place] = 1;
    }
    return 1;
}

static int is_near(const struct gsn_component *piece, const struct part *held, double reach)
{
    return held->area > 0 && piece->x < held->x1 + reach &&
           piece->x + piece->width > held->x0 - reach && piece->y < held->y1 + reach &&
           piece->y + piece->height > held->y0 - reach;
}

/* A piece torn off a section goes with it. */
static int give_fragment(struct panel *panel, size_t piece)
{
    const struct gsn_component *whole = &panel->pieces->piece[piece];
    const size_t home = home_of(panel, piece);
    const double reach = NEAR * sqrt(panel->section_area);

    if (home == panel->places || !is_near(whole, &panel->held[home], reach) ||
        is_dust(whole, &panel->cells))
        return 0;
    for (size_t place = 0; place <= panel->places; place++)
        add_to(&panel->held[home], part_of(panel, piece, place));
    return 1;
}

/* The box of one slot with its margin, kept out of the other half of the way to a neighbour. */
static void frame(const struct panel *panel, size_t place, double px_um, struct gsn_slot *slot)
{
    const struct part *own = &panel->held[place];
    const int step = panel->cells.step;
    const int right = panel->cells.width * step, bottom = panel->cells.height * step;
    const int margin = (int)(MARGIN_UM / px_um);
    const int reach = margin / step + 1;
    int x0 = own->x0 * step - margin, x1 = own->x1 * step + margin;
    int y0 = own->y0 * step - margin, y1 = own->y1 * step + margin;

    for (size_t other = 0; other < panel->places; other++) {
        const struct part *next = &panel->held[other];
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

static void fill_slots(const struct panel *panel, const struct gsn_layout *layout, double px_um,
                       struct gsn_slot *ret_slots)
{
    const int step = panel->cells.step;

    for (unsigned i = 0; i < panel->places; i++) {
        struct gsn_slot *slot = &ret_slots[i];
        const struct part *held;
        size_t place;

        *slot = (struct gsn_slot){ .slot = i };
        gsn_panel_place(layout, i, &slot->row, &slot->column);
        place = (size_t)slot->row * layout->columns + slot->column;
        held = &panel->held[place];
        if (held->area == 0)
            continue;
        slot->found = 1;
        slot->touching = panel->touching[place];
        slot->area_px = (double)held->area * step * step;
        slot->centre_px.x = held->sum_x / (double)held->area * step;
        slot->centre_px.y = held->sum_y / (double)held->area * step;
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

/* gives: the pieces above dust size that were not taken. */
static int list_scraps(const struct panel *panel, const char *taken, struct gsn_scrap **ret_scraps,
                       size_t *ret_count, struct gsn_error *err)
{
    const int step = panel->cells.step;
    gsn_auto_mem(struct gsn_scrap) scraps = gsn_alloc_array(panel->pieces->count, sizeof *scraps);
    size_t count = 0;

    if (!scraps)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    for (size_t i = 0; i < panel->pieces->count; i++) {
        const struct gsn_component *p = &panel->pieces->piece[i];

        if (taken[i] || is_dust(p, &panel->cells))
            continue;
        scraps[count++] = (struct gsn_scrap){ .x = p->x * step,
                                              .y = p->y * step,
                                              .width = p->width * step,
                                              .height = p->height * step,
                                              .area_px = (double)p->area * step * step,
                                              .inside_grid = home_of(panel, i) < panel->places };
    }
    if (count > 0)
        qsort(scraps, count, sizeof *scraps, by_area);
    *ret_scraps = count > 0 ? gsn_steal(&scraps) : NULL;
    *ret_count = count;
    return GSN_OK;
}

/* Everything after the grid is known. */
static int deal_out(struct panel *panel, const struct gsn_layout *layout, double px_um,
                    struct gsn_slot *ret_slots, struct gsn_scrap **ret_scraps,
                    size_t *ret_scrap_count, struct gsn_error *err)
{
    const size_t pieces = panel->pieces->count;
    gsn_auto_mem(struct part) parts = gsn_alloc_array(pieces * (panel->places + 1), sizeof *parts);
    gsn_auto_mem(struct part) held = gsn_alloc_array(panel->places, sizeof *held);
    gsn_auto_mem(int) touching = gsn_alloc_array(panel->places, sizeof *touching);
    gsn_auto_mem(int) column = gsn_alloc_array((size_t)panel->cells.width, sizeof *column);
    gsn_auto_mem(char) taken = gsn_alloc_array(pieces, 1);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0;

    if (!parts || !held || !touching || !column || !taken)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    panel->parts = parts;
    panel->held = held;
    panel->touching = touching;
    for (int x = 0; x < panel->cells.width; x++)
        column[x] = gsn_panel_axis_line(&panel->columns, x + 0.5);
    cut_pieces(panel, column);
    for (size_t i = 0; i < pieces; i++)
        taken[i] = (char)give_section(panel, i);
    for (size_t i = 0; i < pieces; i++)
        taken[i] = (char)(taken[i] || give_fragment(panel, i));
    if (ret_scraps && ret_scrap_count) {
        const int r = list_scraps(panel, taken, &scraps, &scrap_count, err);

        if (r < 0)
            return r;
        *ret_scraps = gsn_steal(&scraps);
        *ret_scrap_count = scrap_count;
    }
    fill_slots(panel, layout, px_um, ret_slots);
    return GSN_OK;
}

int gsn_panel_split(const struct gsn_plane *tissue, unsigned step, const struct gsn_layout *layout,
                    double px_um, struct gsn_slot *ret_slots, struct gsn_scrap **ret_scraps,
                    size_t *ret_scrap_count, struct gsn_error *err)
{
    gsn_auto(gsn_components) pieces = NULL;
    struct panel panel = { 0 };
    int r;

    assert(tissue && tissue->width > 0 && tissue->height > 0 && step > 0);
    assert(layout && layout->rows > 0 && layout->columns > 0 && ret_slots);

    if (!(px_um > 0 && isfinite(px_um)))
        return gsn_fail(err, GSN_E_INPUT, "a pixel of %g um: the panel cannot be split", px_um);
    panel.cells = (struct cells){ .width = (int)tissue->width,
                                  .height = (int)tissue->height,
                                  .step = (int)step,
                                  .um = px_um * step };
    r = find_pieces(tissue, &pieces, err);
    if (r < 0)
        return r;
    panel.pieces = pieces;
    panel.section_area = section_area(pieces, &panel.cells);
    if (panel.section_area == 0)
        return gsn_fail(err, GSN_E_INPUT, "there is nothing but dust on the panel");
    panel.places = (size_t)layout->rows * layout->columns;
    r = lay_grid(&panel, layout, err);
    if (r < 0)
        return r;
    return deal_out(&panel, layout, px_um, ret_slots, ret_scraps, ret_scrap_count, err);
}
