/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel/slots.h"

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
    return gsn_panel_split(&panel, 1, &LAYOUT, PX, GSN_SLOT_UNSAID, slots, scraps, count, err);
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

/* The scanner's bed, or its lid, along one side, two or all. */
TEST(a_dark_bed_around_the_panel_is_no_section)
{
    enum { BED = 30 };
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    for (unsigned sides = 1; sides < 16; sides++) {
        draw_glass(1);
        draw_slots(0x2d3, 5);
        if (sides & 1)
            draw_box(&panel, 0, 0, WIDTH, BED, 2.5);
        if (sides & 2)
            draw_box(&panel, 0, 0, BED, HEIGHT, 2.5);
        if (sides & 4)
            draw_box(&panel, 0, HEIGHT - BED, WIDTH, BED, 2.5);
        if (sides & 8)
            draw_box(&panel, WIDTH - BED, 0, BED, HEIGHT, 2.5);
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_slots(slots, 0x2d3, 5);
    }
}

/* Half a pitch is 100 pixels. Each section is drawn as it lies, and its slot is known. */
static void check_places(const struct gsn_slot *slots, const struct gsn_point *at, unsigned present)
{
    for (unsigned i = 0; i < SLOTS; i++) {
        CHECK(slots[i].found == (int)((present >> i) & 1));
        if (!slots[i].found || slots[i].doubtful)
            continue;
        CHECK_NEAR(slots[i].centre_px.x, at[i].x, 4);
        CHECK_NEAR(slots[i].centre_px.y, at[i].y, 4);
    }
}

/* Sections mounted up to 1.4 mm off, turned any way, a quarter of the panels with lost ones: none
 * comes into a neighbour's slot. */
TEST(sections_mounted_badly_lie_in_their_slots)
{
    struct draw_chance chance = { 77 };

    for (int k = 0; k < 40; k++) {
        const unsigned present = k % 2 ? 0xfff : 0xfff & ~(1u << (k % 12)) & ~(1u << (5 * k % 12));
        struct gsn_point at[SLOTS];
        struct gsn_slot slots[SLOTS];
        struct gsn_error err = { 0 };

        draw_glass((uint64_t)k);
        draw_label();
        for (unsigned i = 0; i < SLOTS; i++) {
            at[i] = centre_of(i);
            at[i].x += draw_uniform(&chance, -35, 35);
            at[i].y += draw_uniform(&chance, -35, 35);
            if (present & (1u << i))
                draw_section(at[i], draw_uniform(&chance, -M_PI, M_PI));
        }
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_places(slots, at, present);
    }
}

/* The whole panel a little askew in the holder, about its middle. */
TEST(a_panel_that_lies_askew_is_split_along_its_own_rows)
{
    for (int deg = -4; deg <= 4; deg += 4) {
        const double c = cos(deg * M_PI / 180), s = sin(deg * M_PI / 180);
        struct gsn_point at[SLOTS];
        struct gsn_slot slots[SLOTS];
        struct gsn_error err = { 0 };

        draw_glass(15);
        for (unsigned i = 0; i < SLOTS; i++) {
            const double x = centre_of(i).x - 505, y = centre_of(i).y - 307.5;

            at[i] = (struct gsn_point){ 505 + c * x - s * y, 307.5 + s * x + c * y };
            if (i != 6)
                draw_section(at[i], 0.2 * i);
        }
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_places(slots, at, 0xfff & ~(1u << 6));
    }
}

/* Half way between slot 5, which is empty, and its own: a person decides. */
TEST(a_section_between_two_slots_is_doubtful)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(16);
    draw_slots(0xf9f, 0);
    draw_section((struct gsn_point){ 605 - 97, FIRST_Y + PITCH }, 0);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    CHECK(slots[5].found != slots[6].found);
    for (unsigned i = 0; i < SLOTS; i++)
        CHECK(slots[i].doubtful == (slots[i].found && (i == 5 || i == 6)));
    CHECK(slots[6].found ? slots[6].rival == 5 : slots[5].rival == 6);

    /* A quarter of a pitch off is no doubt. */
    draw_glass(16);
    draw_slots(0xf9f, 0);
    draw_section((struct gsn_point){ 605 - 50, FIRST_Y + PITCH }, 0);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    CHECK(slots[6].found && !slots[5].found && !slots[6].doubtful);
}

/* What cannot be told can be said. */
TEST(the_slot_of_the_first_section_settles_the_grid)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };
    const unsigned said[] = { 5, 6, 9 };

    draw_glass(2);
    draw_slots(0x020, 0);
    for (size_t k = 0; k < 2; k++) {
        const int r = gsn_panel_split(&panel, 1, &LAYOUT, PX, said[k], slots, NULL, NULL, &err);

        CHECK_OK(r, err);
        for (unsigned i = 0; i < SLOTS; i++)
            CHECK(slots[i].found == (i == said[k]));
    }
}

/* Case 25. */
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
    CHECK(split(slots, &scraps, &count, &err) == GSN_E_WITHHELD);
    CHECK(strstr(err.text, "cannot be told"));

    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT; i++)
        wide_value[i] = 0;
    for (int k = 0; k < 9; k++) {
        struct gsn_plane turned = wide;
        const struct gsn_point at = { 107.5 + 200 * (k % 3), 260 + 200 * (k / 3) };

        draw_ellipse(&turned, at, 51, 65, 0, 0.6);
    }
    CHECK(gsn_panel_split(&wide, 1, &upright, PX, GSN_SLOT_UNSAID, slots, &scraps, &count, &err) ==
          GSN_E_WITHHELD);
    assert_string_equal(
        err.text,
        "the sections found (9) fit 4 x 3 slots in two ways, and which cannot be told: the "
        "first of them lies in slot 1 or in slot 4; look at the glass and say in which");
    CHECK(slots[0].slot == 0x5a5a5a5a && scraps == NULL && count == 55);
}

TEST(too_many_columns_are_refused)
{
    struct gsn_slot slots[6];
    const struct gsn_layout narrow = { 3, 2, GSN_ORDER_ROW };
    struct gsn_error err = { 0 };

    draw_glass(3);
    draw_slots(0xfff, 0);
    CHECK(gsn_panel_split(&panel, 1, &narrow, PX, GSN_SLOT_UNSAID, slots, NULL, NULL, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "of 12 sections found fit no slot of a layout of 3 x 2: correct "
                           "\"layout\" in job.json"));
}

/* Case 26. */
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

/* Case 27. */
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
    /* The proposed cut is the chord between the two ellipses: x = 505, y = +- 51 sqrt(1 - t^2)
     * with t = 62 / 65. */
    CHECK(slots[5].touched == 6 && slots[6].touched == 5 && slots[4].touched == 0);
    for (int k = 0; k < 2; k++) {
        const double half = 51 * sqrt(1 - 62.0 * 62.0 / (65.0 * 65.0));

        CHECK_NEAR(slots[5].cut_px[k].x, 505, 3);
        CHECK_NEAR(fabs(slots[5].cut_px[k].y - FIRST_Y - PITCH), half, 3);
        CHECK_NEAR(slots[5].cut_px[k].x, slots[6].cut_px[k].x, 1e-9);
    }
}

/* Case 27. Two that kiss are cut at the neck: half the chord of their ellipses with t = 64 / 65 is
 * 9 pixels, 0.36 mm, so the neck is a sixth of a section's size. */
TEST(sections_that_only_just_touch_are_parted_and_not_held)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(17);
    draw_slots(0xf9f, 0);
    draw_section((struct gsn_point){ 505 - 64, FIRST_Y + PITCH }, 0);
    draw_section((struct gsn_point){ 505 + 64, FIRST_Y + PITCH }, 0);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    for (unsigned i = 0; i < SLOTS; i++)
        CHECK(slots[i].found && !slots[i].touching && slots[i].parted == (i == 5 || i == 6));
    CHECK(slots[5].touched == 6 && slots[6].touched == 5);
    CHECK_NEAR(slots[5].cut_px[0].x, 505, 4);
    CHECK_NEAR(slots[5].centre_px.x, 505 - 64, 2);
    CHECK_NEAR(slots[6].centre_px.x, 505 + 64, 2);
}

/* Case 28: a dark line across the panel joins nothing and makes no box larger. */
TEST(the_edge_of_a_coverslip_joins_no_sections)
{
    struct gsn_slot slots[SLOTS];
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    struct gsn_error err = { 0 };
    size_t count = 0;

    draw_glass(18);
    draw_slots(0xfff, 0);
    draw_box(&panel, 90, 300, 830, 2, 0.7);
    draw_box(&panel, 90, 408, 830, 2, 0.7); /* between the rows: touches nothing */
    CHECK_OK(split(slots, &scraps, &count, &err), err);
    check_slots(slots, 0xfff, 0);
    CHECK(count == 0);
}

/* A hair over two sections is no reason to hold them. */
TEST(sections_joined_by_a_thread_are_two_sections)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(14);
    draw_slots(0xfff, 0);
    draw_box(&panel, 405, 305, 400, 3, 0.6); /* 120 um, through slots 5, 6 and 7 */
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    for (unsigned i = 0; i < SLOTS; i++)
        CHECK(slots[i].found && !slots[i].touching && slots[i].touched == 0);
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

/* Case 45. */
TEST(glass_or_dust_alone_leaves_every_slot_empty)
{
    const double even[] = { 0, 0.3, NAN };
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_glass(9);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    check_slots(slots, 0, 0);
    for (size_t i = 0; i < 3; i++) {
        draw_fill(&panel, even[i]);
        CHECK_OK(split(slots, NULL, NULL, &err), err);
        check_slots(slots, 0, 0);
    }
    draw_fill(&panel, 0);
    draw_box(&panel, 100, 100, 2, 2, 1);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    check_slots(slots, 0, 0);
}

TEST(a_pixel_without_a_size_is_refused)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    draw_fill(&panel, 0);
    CHECK(gsn_panel_split(&panel, 1, &LAYOUT, 0, GSN_SLOT_UNSAID, slots, NULL, NULL, &err) ==
          GSN_E_INPUT);
    CHECK(gsn_panel_split(&panel, 1, &LAYOUT, NAN, GSN_SLOT_UNSAID, slots, NULL, NULL, &err) ==
          GSN_E_INPUT);
    CHECK(strcmp(err.text, "a pixel of nan um: the panel cannot be split") == 0);
}

/* Case 28: over the frame at the bottom, and over what lies on the label. */
TEST(the_share_of_a_section_beyond_the_edge_is_told)
{
    struct gsn_slot slots[SLOTS];
    struct gsn_error err = { 0 };

    /* The picture ends 22.5 pixels below the middle of the last row: of an ellipse with a half axis
     * of 51 the share (acos t - t sqrt(1 - t^2)) / pi = 0.229 is lost, t = 22.5 / 51. */
    const struct gsn_plane cut = { WIDTH, 530, value };

    draw_glass(12);
    draw_slots(0x0ff, 0);
    draw_section((struct gsn_point){ 405, FIRST_Y + 2 * PITCH }, 0);
    CHECK_OK(gsn_panel_split(&cut, 1, &LAYOUT, PX, GSN_SLOT_UNSAID, slots, NULL, NULL, &err), err);
    for (unsigned i = 0; i < 8; i++)
        CHECK(slots[i].found && slots[i].lost == 0);
    CHECK(slots[9].found && slots[9].y + slots[9].height == 530);
    CHECK_NEAR(slots[9].lost, 0.229, 0.04);

    draw_glass(13);
    draw_slots(0xfef, 0);
    draw_section((struct gsn_point){ 205 - 50, FIRST_Y + PITCH }, 0);
    draw_box(&panel, 0, 200, 100, 220, 0.6);
    CHECK_OK(split(slots, NULL, NULL, &err), err);
    /* 50 of its 65 pixels to the left of the grid's border at x = 105 are not told from the label:
     * (acos t - t sqrt(1 - t^2)) / pi with t = 50 / 65. */
    CHECK(slots[4].found && slots[4].x > 90);
    CHECK_NEAR(slots[4].lost, 0.0655, 0.04);
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
    CHECK_OK(gsn_panel_split(&panel, 1, &snake, PX, GSN_SLOT_UNSAID, slots, NULL, NULL, &err), err);
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
