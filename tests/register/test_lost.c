/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel/slots.h"

#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/mounted.h"

#include <string.h>

/* Panels of the phantom's make (PHANTOM.md section 4) in cells of 100 um, drawn at random: layout
 * and order of mounting, pitch, place and turn of the grid, size and shape of the sections, label
 * or none, dirt. From one to four sections of each are lost. */
enum { MOST_ROWS = 4, MOST_COLUMNS = 5, MOST_SLOTS = MOST_ROWS * MOST_COLUMNS };
enum { MOST_WIDTH = 520, MOST_HEIGHT = 420, MOST_LOST = 4 };
static const double CELL_UM = 100;

struct drawn {
    struct gsn_layout layout;
    unsigned number; /* of the panel */
    double jitter_um;
    int lost[MOST_SLOTS];            /* by place: row by row */
    struct gsn_point at[MOST_SLOTS]; /* cells, by place */
};

static float value[MOST_WIDTH * MOST_HEIGHT];
static struct gsn_plane panel = { 0, 0, value };

static unsigned draw_whole(struct draw_chance *chance, unsigned from, unsigned to)
{
    return from + (unsigned)draw_uniform(chance, 0, to - from + 1);
}

static void draw_dirt(struct draw_chance *chance)
{
    const unsigned crumbs = draw_whole(chance, 0, 6);

    for (unsigned i = 0; i < crumbs; i++) {
        const struct gsn_point at = { draw_uniform(chance, 4, panel.width - 4.0),
                                      draw_uniform(chance, 4, panel.height - 4.0) };

        draw_ellipse(&panel, at, draw_uniform(chance, 0.6, 3), draw_uniform(chance, 0.6, 3), 0,
                     0.7);
    }
}

/* Print and the modules of a code, in the strip at the left. */
static void draw_label(struct draw_chance *chance)
{
    for (int i = 0; i < 5; i++)
        draw_box(&panel, 5 + 4 * i, 20, 2, 4, 2.5);
    for (int i = 0; i < 64; i++)
        if (draw_uniform(chance, 0, 1) < 0.6)
            draw_box(&panel, 6 + 2 * (i % 8), 40 + 2 * (i / 8), 2, 2, 2.5);
}

static void lose_some(struct drawn *d, struct draw_chance *chance)
{
    const unsigned slots = d->layout.rows * d->layout.columns;

    memset(d->lost, 0, sizeof d->lost);
    for (unsigned left = draw_whole(chance, 1, MOST_LOST); left > 0;) {
        const unsigned place = draw_whole(chance, 0, slots - 1);

        left -= !d->lost[place];
        d->lost[place] = 1;
    }
}

static void draw_panel(struct drawn *d, struct draw_chance *chance)
{
    static const double jitters[] = { 600, 1300 }; /* the phantom's, levels L2 and L3 */
    const double pitch = draw_uniform(chance, 75, 90), turn = draw_uniform(chance, -0.035, 0.035);
    const double length = draw_uniform(chance, 22, 28), breadth = draw_uniform(chance, 16, 22);
    const struct gsn_point first = { draw_uniform(chance, 72, 92), draw_uniform(chance, 38, 56) };

    d->layout =
        (struct gsn_layout){ draw_whole(chance, 2, MOST_ROWS), draw_whole(chance, 3, MOST_COLUMNS),
                             (enum gsn_order)draw_whole(chance, 0, 2) };
    d->number = draw_whole(chance, 1, 20);
    d->jitter_um = jitters[draw_whole(chance, 0, 1)];
    lose_some(d, chance);
    panel.width = (uint32_t)(first.x + pitch * (d->layout.columns - 1) + 55);
    panel.height = (uint32_t)(first.y + pitch * (d->layout.rows - 1) + 55);
    draw_fill(&panel, 0);
    for (unsigned i = 0; i < d->layout.rows * d->layout.columns; i++) {
        const double x = pitch * (i % d->layout.columns), y = pitch * (i / d->layout.columns);
        const double off = d->jitter_um / CELL_UM;

        d->at[i].x = first.x + x * cos(turn) - y * sin(turn) + draw_uniform(chance, -off, off);
        d->at[i].y = first.y + x * sin(turn) + y * cos(turn) + draw_uniform(chance, -off, off);
        if (!d->lost[i])
            draw_ellipse(&panel, d->at[i], length * draw_uniform(chance, 0.9, 1.1),
                         breadth * draw_uniform(chance, 0.9, 1.1), 0.3 * draw_normal(chance), 0.6);
    }
    draw_dirt(chance);
    if (draw_uniform(chance, 0, 1) < 0.75)
        draw_label(chance);
    for (size_t i = 0; i < (size_t)panel.width * panel.height; i++)
        value[i] += (float)draw_uniform(chance, -0.03, 0.03);
}

/* The number that a place has when sections are mounted in this order, told without the product's
 * own walk. */
static unsigned number_of(const struct drawn *d, unsigned place)
{
    const unsigned rows = d->layout.rows, columns = d->layout.columns;
    const unsigned row = place / columns, column = place % columns;
    const unsigned before = (d->number - 1) * rows * columns;

    if (d->layout.order == GSN_ORDER_COLUMN)
        return before + column * rows + row;
    if (d->layout.order == GSN_ORDER_SNAKE && row % 2)
        return before + row * columns + (columns - 1 - column);
    return before + row * columns + column;
}

struct tally {
    size_t panels, refused, lost, told, asked, missed;
    size_t present, shifted, doubtful, gone; /* gone: there, but called lost */
};

/* A person is asked about the whole panel, or about a section between two slots. */
static void count_slots(const struct drawn *d, const struct gsn_slot *slots, struct tally *t)
{
    const unsigned count = d->layout.rows * d->layout.columns;

    for (unsigned place = 0; place < count; place++) {
        const unsigned own = number_of(d, place);
        const struct gsn_slot *s = NULL;

        for (unsigned i = 0; i < count; i++)
            if (gsn_panel_serial(d->number, slots[i].slot, &d->layout) == own)
                s = &slots[i];
        CHECK(s);
        if (d->lost[place]) {
            t->told += !s->found;
            t->asked += s->found && s->doubtful;
            t->missed += s->found && !s->doubtful;
            continue;
        }
        t->gone += !s->found;
        t->doubtful += s->found && s->doubtful;
        t->shifted += s->found && !s->doubtful &&
                      hypot(s->centre_px.x - d->at[place].x, s->centre_px.y - d->at[place].y) > 10;
    }
}

static struct tally lose(size_t trials, uint64_t seed)
{
    struct draw_chance chance = { seed };
    struct tally t = { 0 };

    while (t.lost < trials) {
        struct gsn_slot slots[MOST_SLOTS];
        struct gsn_error err = { 0 };
        struct drawn d;
        size_t lost = 0;
        int r;

        draw_panel(&d, &chance);
        for (unsigned i = 0; i < d.layout.rows * d.layout.columns; i++)
            lost += d.lost[i] != 0;
        r = gsn_panel_split(&panel, 1, &d.layout, CELL_UM, GSN_SLOT_UNSAID, slots, NULL, NULL,
                            &err);
        t.panels++;
        t.lost += lost;
        t.present += d.layout.rows * d.layout.columns - lost;
        /* Which slots they are cannot be told, or too few of them are left to tell a grid. */
        if (r == GSN_E_WITHHELD || r == GSN_E_INPUT) {
            t.refused++;
            t.asked += lost;
            continue;
        }
        CHECK_OK(r, err);
        count_slots(&d, slots, &t);
    }
    return t;
}

/* Case 29. The long run: GIESON_TRIALS=10000 build/bench/tests/test_register_lost. */
TEST(a_lost_section_leaves_its_slot_empty_and_moves_no_other)
{
    const struct tally t = lose(mounted_trials(2000), 1);

    print_message("  %zu sections lost from %zu panels: %zu told by their empty slots (%.2f %%), "
                  "%zu asked about (%zu panels refused), %zu missed\n",
                  t.lost, t.panels, t.told, 100 * (double)t.told / (double)t.lost, t.asked,
                  t.refused, t.missed);
    print_message("  of %zu that are there: %zu in another's place, %zu doubtful, %zu called "
                  "lost\n",
                  t.present, t.shifted, t.doubtful, t.gone);
    CHECK(t.shifted == 0 && t.missed == 0 && t.gone == 0);
    CHECK((double)t.told >= 0.99 * (double)t.lost);
}

/* Three of six, askew and apart: with sections 9.7 mm from each other the third column, which is
 * empty, comes near the border, and the other grid has half of that pitch. */
TEST(few_sections_far_apart_do_not_draw_the_grid_together)
{
    static const struct gsn_point at[] = { { 78, 57 }, { 77, 135 }, { 175, 143 } };
    const struct gsn_layout layout = { 2, 3, GSN_ORDER_ROW };
    struct draw_chance chance = { 3 };
    struct gsn_slot slots[6];
    struct gsn_error err = { 0 };

    panel.width = 302;
    panel.height = 192;
    draw_fill(&panel, 0);
    for (int i = 0; i < 3; i++)
        draw_ellipse(&panel, at[i], 29, 18, 0.1 * i, 0.6);
    draw_noise(&panel, &chance, 0.02);
    CHECK_OK(gsn_panel_split(&panel, 1, &layout, CELL_UM, GSN_SLOT_UNSAID, slots, NULL, NULL, &err),
             err);
    CHECK(slots[0].found && slots[3].found && slots[4].found);
    CHECK(!slots[1].found && !slots[2].found && !slots[5].found);
}
