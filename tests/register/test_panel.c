/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <stdlib.h>
#include <string.h>

/* A panel as PHANTOM.md section 4 has it, at 40 um: 4 x 3 slots of 8 mm, label strip at the left.
 */
enum { WIDTH = 920, HEIGHT = 624, SLOTS = 12 };
static const double PX = 40;
static const struct gsn_layout LAYOUT = { 3, 4, GSN_ORDER_ROW };
static const double FIRST_X = 205, FIRST_Y = 107.5, PITCH = 200;

static float value[WIDTH * HEIGHT];
static struct gsn_plane panel = { WIDTH, HEIGHT, value };

static struct gsn_point centre_of(unsigned slot)
{
    return (struct gsn_point){ FIRST_X + PITCH * (slot % 4), FIRST_Y + PITCH * (slot / 4) };
}

/* 5.2 x 4.1 mm of tissue, turned, with texture. */
static void draw_section(struct gsn_point at, double angle)
{
    draw_ellipse(&panel, at, 65, 51, angle, 0.6);
}

static void draw_glass(uint64_t seed)
{
    struct draw_chance chance = { seed };

    draw_fill(&panel, 0);
    draw_noise(&panel, &chance, 0.02);
}

/* Print: lines of letters and a code of modules. */
static void draw_label(void)
{
    for (int i = 0; i < 12; i++)
        draw_box(&panel, 10 + 5 * i, 40, 3, 8, 2.5);
    for (int i = 0; i < 100; i++) {
        if (i * 7 % 5 < 3)
            draw_box(&panel, 14 + 5 * (i % 10), 80 + 5 * (i / 10), 5, 5, 2.5);
    }
}

static void draw_slots(unsigned present, double jitter)
{
    struct draw_chance chance = { present };

    for (unsigned i = 0; i < SLOTS; i++) {
        struct gsn_point at = centre_of(i);
        const double angle = draw_uniform(&chance, -0.3, 0.3);

        at.x += draw_uniform(&chance, -jitter, jitter);
        at.y += draw_uniform(&chance, -jitter, jitter);
        if (present & (1u << i))
            draw_section(at, angle);
    }
}

static int split(struct gsn_slot *slots, struct gsn_scrap **scraps, size_t *count,
                 struct gsn_error *err)
{
    return gsn_panel_split(&panel, 1, &LAYOUT, PX, slots, scraps, count, err);
}

static void check_slots(const struct gsn_slot *slots, unsigned present, double jitter)
{
    for (unsigned i = 0; i < SLOTS; i++) {
        const struct gsn_slot *s = &slots[i];
        const struct gsn_point at = centre_of(i);

        CHECK(s->slot == i && s->row == i / 4 && s->column == i % 4);
        CHECK(s->found == (int)((present >> i) & 1));
        if (!s->found) {
            CHECK(s->width == 0 && s->area_px == 0);
            continue;
        }
        CHECK_NEAR(s->centre_px.x, at.x, jitter + 1);
        CHECK_NEAR(s->centre_px.y, at.y, jitter + 1);
        CHECK_NEAR(s->area_px, M_PI * 65 * 51, 0.04 * M_PI * 65 * 51);
        CHECK(s->x >= 0 && s->y >= 0 && s->x + s->width <= WIDTH && s->y + s->height <= HEIGHT);
        CHECK(s->x < s->centre_px.x - 60 && s->x + s->width > s->centre_px.x + 60);
        CHECK(s->width < 150 && s->height < 130 && !s->touching);
    }
}

TEST(twelve_sections_are_twelve_slots)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    for (int jitter = 0; jitter <= 20; jitter += 5) {
        draw_glass(1);
        draw_label();
        draw_slots(0xfff, jitter);
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_slots(slots, 0xfff, jitter);
    }
}

TEST(empty_slots_stay_empty)
{
    /* One gone; a whole column; a whole row; a corner; only a cross; every second one. */
    const unsigned present[] = { 0xfdf, 0xddd, 0xeee, 0x0ff, 0xff0, 0x7ff, 0x4f4, 0x5a5, 0xf00 };

    for (size_t k = 0; k < sizeof present / sizeof *present; k++) {
        struct gsn_slot slots[SLOTS];
        struct gsn_error err = { 0 };

        draw_glass(k);
        draw_label();
        draw_slots(present[k], 5);
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_slots(slots, present[k], 5);
    }
}

TEST(a_grid_that_cannot_be_told_is_refused_and_nothing_is_touched)
{
    /* A single section; and a panel so wide that three columns fit twice. */
    static float wide_value[WIDTH * HEIGHT];
    const struct gsn_plane wide = { HEIGHT, WIDTH, wide_value };
    const struct gsn_layout upright = { 4, 3, GSN_ORDER_ROW };
    struct gsn_slot slots[SLOTS];
    struct gsn_scrap *scraps = NULL;
    size_t count = 55;
    struct gsn_error err = { 0 };

    memset(slots, 0x5a, sizeof slots);
    draw_glass(2);
    draw_slots(0x020, 0);
    CHECK(split(slots, &scraps, &count, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "cannot be told"));

    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT; i++)
        wide_value[i] = 0;
    for (int k = 0; k < 9; k++) {
        struct gsn_plane turned = wide;
        const struct gsn_point at = { 107.5 + 200 * (k % 3), 260 + 200 * (k / 3) };

        draw_ellipse(&turned, at, 51, 65, 0, 0.6);
    }
    CHECK(gsn_panel_split(&wide, 1, &upright, PX, slots, &scraps, &count, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "only 3 of 4 rows hold tissue, and which ones cannot be told from their "
                           "place") == 0);
    CHECK(slots[0].slot == 0x5a5a5a5a && scraps == NULL && count == 55);
}

TEST(too_many_columns_are_refused)
{
    struct gsn_slot slots[6];
    const struct gsn_layout narrow = { 3, 2, GSN_ORDER_ROW };
    struct gsn_error err = { 0 };

    draw_glass(3);
    draw_slots(0xfff, 0);
    CHECK(gsn_panel_split(&panel, 1, &narrow, PX, slots, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "tissue lies in 4 columns, the protocol says 2") == 0);
}

TEST(a_scrap_between_the_slots_and_the_label_outside_are_told_apart)
{
    struct gsn_slot slots[SLOTS];
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t count = 0, inside = 0;
    struct gsn_error err = { 0 };

    draw_glass(4);
    draw_label();
    draw_slots(0xfdf, 0);
    /* In slot 5, which is empty. */
    draw_ellipse(&panel, centre_of(5), 12, 10, 0, 0.6);
    CHECK_OK(split(slots, &scraps, &count, &err), err);
    check_slots(slots, 0xfdf, 0);
    CHECK(count > 1);
    for (size_t i = 0; i < count; i++) {
        CHECK(i == 0 || scraps[i].area_px <= scraps[i - 1].area_px);
        CHECK(scraps[i].inside_grid || scraps[i].x + scraps[i].width < 90);
        if (!scraps[i].inside_grid)
            continue;
        inside++;
        CHECK(abs(scraps[i].x + scraps[i].width / 2 - 405) < 4);
        CHECK_NEAR(scraps[i].area_px, M_PI * 120, 40);
    }
    CHECK(inside == 1);
}

TEST(a_label_larger_than_a_section_is_no_section)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(5);
    draw_box(&panel, 0, 0, 80, HEIGHT, 0.8);
    draw_slots(0xfff, 5);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    check_slots(slots, 0xfff, 5);
}

TEST(a_torn_section_is_one_section)
{
    struct gsn_slot slots[SLOTS];
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t count = 1;
    struct gsn_error err = { 0 };

    draw_glass(6);
    draw_slots(0xfff, 0);
    /* A gap of 0.4 mm through slot 2, off its middle. */
    draw_box(&panel, 630, 50, 10, 120, 0);
    CHECK_OK(split(slots, &scraps, &count, &err), err);
    CHECK(slots[2].found && !slots[2].touching && count == 0);
    CHECK(slots[2].x < 545 && slots[2].x + slots[2].width > 665);
}

TEST(a_section_that_touches_its_neighbour_is_cut_at_the_border)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(7);
    draw_slots(0xf9f, 0);
    draw_section((struct gsn_point){ 405 + 38, FIRST_Y + PITCH }, 0);
    draw_section((struct gsn_point){ 605 - 38, FIRST_Y + PITCH }, 0);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    for (unsigned i = 0; i < SLOTS; i++)
        CHECK(slots[i].found && slots[i].touching == (i == 5 || i == 6));
    CHECK(abs(slots[5].x + slots[5].width - 505) <= 2);
    CHECK(abs(slots[6].x - 505) <= 2);
}

TEST(boxes_do_not_reach_into_a_neighbours_tissue)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(8);
    draw_slots(0xf9f, 0);
    /* 4 px apart, so that margins of 150 um would not fit. */
    draw_section((struct gsn_point){ 505 - 67, FIRST_Y + PITCH }, 0);
    draw_section((struct gsn_point){ 505 + 67, FIRST_Y + PITCH }, 0);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    CHECK(slots[5].found && slots[6].found && !slots[5].touching);
    CHECK(slots[5].x + slots[5].width <= 506 && slots[6].x >= 504);
    CHECK(slots[5].x + slots[5].width > 503);
}

TEST(glass_or_dust_alone_is_refused)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(9);
    CHECK(split(slots, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "there is no tissue on the panel") == 0);
    draw_fill(&panel, 0.3);
    CHECK(split(slots, NULL, NULL, &err) == GSN_E_INPUT);
    draw_fill(&panel, 0);
    draw_box(&panel, 100, 100, 2, 2, 1);
    CHECK(split(slots, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "there is nothing but dust on the panel") == 0);
    draw_fill(&panel, NAN);
    CHECK(split(slots, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(gsn_panel_split(&panel, 1, &LAYOUT, 0, slots, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(gsn_panel_split(&panel, 1, &LAYOUT, NAN, slots, NULL, NULL, &err) == GSN_E_INPUT);
}

TEST(the_order_of_mounting_is_data)
{
    const struct gsn_layout column = { 3, 4, GSN_ORDER_COLUMN }, snake = { 3, 4, GSN_ORDER_SNAKE };
    unsigned row, col;

    gsn_panel_place(&LAYOUT, 6, &row, &col);
    CHECK(row == 1 && col == 2);
    gsn_panel_place(&column, 6, &row, &col);
    CHECK(row == 0 && col == 2);
    gsn_panel_place(&snake, 4, &row, &col);
    CHECK(row == 1 && col == 3);
    gsn_panel_place(&snake, 8, &row, &col);
    CHECK(row == 2 && col == 0);
    CHECK(gsn_panel_serial(1, 0, &LAYOUT) == 0 && gsn_panel_serial(3, 5, &LAYOUT) == 29);
}

TEST(a_snake_is_split_as_a_snake)
{
    const struct gsn_layout snake = { 3, 4, GSN_ORDER_SNAKE };
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(10);
    draw_slots(0xf7f, 0);
    CHECK_OK(gsn_panel_split(&panel, 1, &snake, PX, slots, NULL, NULL, &err), err);
    /* Place 7 (row 1, column 3) is the fifth to be mounted. */
    for (unsigned i = 0; i < SLOTS; i++)
        CHECK(slots[i].slot == i && slots[i].found == (i != 4));
    CHECK_NEAR(slots[5].centre_px.x, 605, 1);
}

static int split_once(struct gsn_error *err)
{
    struct gsn_slot slots[SLOTS];
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t count = 0;

    return split(slots, &scraps, &count, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    draw_glass(11);
    draw_label();
    draw_slots(0xfff, 0);
    CHECK_EVERY_OOM(split_once(&err), err);
}
