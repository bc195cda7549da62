/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/section_order.h"

#include "pipeline/register/order/sequence.h"
#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/specimen/flags.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { SECTIONS = 24, WIDE = 280, HIGH = 230, CELL = 5, AGAIN = 8 };

static struct gsn_section sections[SECTIONS];
static struct gsn_section_density shown[SECTIONS];
static struct gsn_densities densities = { .section_count = SECTIONS, .section = shown };
static struct gsn_plane *planes[SECTIONS];
/* A panel for each section. */
static const struct gsn_protocol single = { .rows = 1, .columns = 1 };

static void forget(void)
{
    memset(shown, 0, sizeof shown);
    densities.misordered[0] = '\0';
}

/* Each section on a panel of its own, 20 um a pixel: what all share, and a grain of 100 um that
 * each has for itself; section 8 is section 7 again, stained a tenth darker. */
static struct gsn_poses make_stack(void)
{
    struct draw_chance chance = { 5 };

    memset(sections, 0, sizeof sections);
    forget();
    for (unsigned k = 0; k < SECTIONS; k++) {
        struct gsn_error err = { 0 };
        float grain[HIGH / CELL][WIDE / CELL];

        sections[k] = (struct gsn_section){
            .panel = k + 1,
            .seen = { .serial = k, .width = WIDE, .height = HIGH },
            .posed = 1,
            .pose = { .panel_to_block_um = { 20, 0, -1600, 0, 20, -1200 } },
            .state = GSN_SECTION_USED,
        };
        CHECK_OK(gsn_plane_new(WIDE, HIGH, &planes[k], &err), err);
        for (int v = 0; v < HIGH / CELL; v++)
            for (int u = 0; u < WIDE / CELL; u++)
                grain[v][u] = (float)(0.05 * draw_normal(&chance));
        for (int i = 0; i < WIDE * HIGH; i++) {
            const int x = i % WIDE, y = i / WIDE;

            planes[k]->value[i] = (float)(0.5 + 0.2 * sin(0.06 * x + 0.04 * k) * cos(0.05 * y)) +
                                  grain[y / CELL][x / CELL];
        }
    }
    for (int i = 0; i < WIDE * HIGH; i++)
        planes[AGAIN]->value[i] = 1.1f * planes[AGAIN - 1]->value[i];
    return (struct gsn_poses){ .section_count = SECTIONS, .section = sections };
}

static void free_planes(void)
{
    for (unsigned k = 0; k < SECTIONS; k++)
        gsn_plane_free(planes[k]);
}

static int look(struct gsn_poses *a, struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) cells = NULL;
    int r = gsn_section_planes_new(a, GSN_SEQUENCE_CELL_UM, &cells, err);

    for (unsigned k = 0; r >= 0 && k < SECTIONS; k++)
        gsn_section_planes_add(cells, a, k, planes[k], 1);
    return r < 0 ? r : gsn_section_order_examine(cells, &single, a, &densities, ret_sequence, err);
}

/* Case 31: both candidates are named, and both stay as they are. */
TEST(a_section_that_is_there_twice_is_flagged_and_left_alone)
{
    struct gsn_poses a = make_stack();
    gsn_auto(gsn_sequence) sequence = NULL;
    struct gsn_error err = { 0 };
    char sentence[GSN_POSE_SENTENCE];

    CHECK_OK(look(&a, &sequence, &err), err);
    for (size_t i = 0; i < sequence->count; i++)
        print_message("  %d %u %u %.2f\n", (int)sequence->finding[i].kind, sequence->finding[i].a,
                      sequence->finding[i].b, sequence->finding[i].evidence);
    CHECK(sequence->count == 1 && sequence->finding[0].kind == GSN_SEQUENCE_DUPLICATE);
    for (unsigned k = 0; k < SECTIONS; k++) {
        CHECK(strcmp(text_of(&shown[k].flags).text, k == AGAIN       ? "same-as-8.1?"
                                                    : k == AGAIN - 1 ? "same-as-9.1?"
                                                                     : "") == 0);
        CHECK(sections[k].state == GSN_SECTION_USED && sections[k].seen.serial == k);
    }
    gsn_section_order_sentence(&sequence->finding[0], 12, sentence);
    CHECK(strstr(sentence, "sections 1.8 and 1.9 look like one section, mounted or scanned twice"));
    free_planes();
}

/* ---- another order of all -------------------------------------------------------------------- */

/* Three panels of two rows of four, read row by row: at[s] is where in the block the section with
 * serial s was cut, and what all show moves on with it. */
static struct gsn_poses make_read(const unsigned at[SECTIONS], double per_section)
{
    struct draw_chance chance = { 7 };

    memset(sections, 0, sizeof sections);
    forget();
    for (unsigned k = 0; k < SECTIONS; k++) {
        struct gsn_error err = { 0 };

        sections[k] = (struct gsn_section){
            .panel = k / 8 + 1,
            .seen = { .serial = k, .slot = k % 8, .width = WIDE, .height = HIGH },
            .posed = 1,
            .pose = { .panel_to_block_um = { 20, 0, -1600, 0, 20, -1200 } },
            .state = GSN_SECTION_USED,
        };
        CHECK_OK(gsn_plane_new(WIDE, HIGH, &planes[k], &err), err);
        for (int i = 0; i < WIDE * HIGH; i++)
            planes[k]->value[i] = (float)(0.5 +
                                          0.2 * sin(0.06 * (i % WIDE) + per_section * at[k]) *
                                              cos(0.05 * (i / WIDE)) +
                                          0.05 * draw_normal(&chance));
    }
    return (struct gsn_poses){ .section_count = SECTIONS, .section = sections };
}

TEST(an_order_that_the_tissue_contradicts_is_named_with_the_likely_one)
{
    static const struct {
        unsigned at[SECTIONS];
        double per_section;
        const char *says;
    } cases[] = {
        { { 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23 },
          0.1,
          NULL },
        { { 0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11, 15, 14, 13, 12, 16, 17, 18, 19, 23, 22, 21, 20 },
          0.1,
          "by \"order\": \"snake\", where \"row\" is stated: put it right in job.json" },
        { { 0, 2, 4, 6, 1, 3, 5, 7, 8, 10, 12, 14, 9, 11, 13, 15, 16, 18, 20, 22, 17, 19, 21, 23 },
          0.1,
          "by \"order\": \"column\", where \"row\" is stated" },
        { { 7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10, 9, 8, 23, 22, 21, 20, 19, 18, 17, 16 },
          0.1,
          "as if all panels lay turned by half, so that sections count backwards" },
        /* Sections that do not differ contradict nothing. */
        { { 0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11, 15, 14, 13, 12, 16, 17, 18, 19, 23, 22, 21, 20 },
          0,
          NULL },
    };
    static const struct gsn_protocol rows = { .rows = 2, .columns = 4, .order = GSN_PROTOCOL_ROW };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct gsn_poses a = make_read(cases[i].at, cases[i].per_section);
        gsn_auto(gsn_section_planes) cells = NULL;
        gsn_auto(gsn_sequence) sequence = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_section_planes_new(&a, GSN_SEQUENCE_CELL_UM, &cells, &err), err);
        for (unsigned k = 0; k < SECTIONS; k++)
            gsn_section_planes_add(cells, &a, k, planes[k], 1);
        CHECK_OK(gsn_section_order_examine(cells, &rows, &a, &densities, &sequence, &err), err);
        print_message("  %s\n", densities.misordered);
        if (cases[i].says ? !strstr(densities.misordered, cases[i].says)
                          : densities.misordered[0] != '\0')
            fail_msg("case %zu: %s", i, densities.misordered);
        for (size_t k = 0; cases[i].says && k < sequence->count; k++)
            CHECK(sequence->finding[k].kind != GSN_SEQUENCE_SWAP);
        free_planes();
    }
}

/* ---- a held section ------------------------------------------------------------------------ */

enum { SLIDE = 340 };

/* Glass beside a lobed outline. */
static void cut_out(struct gsn_plane *plane)
{
    for (int i = 0; i < WIDE * HIGH; i++) {
        const double x = i % WIDE - WIDE / 2.0, y = i / WIDE - HIGH / 2.0;

        if (hypot(x / (WIDE / 2 - 10), y / (HIGH / 2 - 10)) > 1 + 0.07 * cos(3 * atan2(y, x)))
            plane->value[i] = 0;
    }
}

/* Section k as it lies on its slide, turned by a quarter and some: beside a fold in the middle,
 * which hides 320 um and is masked, one half lies 320 um nearer. */
static struct gsn_plane *folded(unsigned k)
{
    struct gsn_plane *slide = NULL;
    struct gsn_error err = { 0 };
    const double angle = 1.9;

    CHECK_OK(gsn_plane_new(SLIDE, SLIDE, &slide, &err), err);
    for (int i = 0; i < SLIDE * SLIDE; i++) {
        const double u = i % SLIDE - SLIDE / 2.0, v = i / SLIDE - SLIDE / 2.0;
        const double along = cos(angle) * u - sin(angle) * v;
        const int x = (int)floor(WIDE / 2.0 + along + (along > 10 ? 16 : 0));
        const int y = (int)floor(HIGH / 2.0 + sin(angle) * u + cos(angle) * v);
        const int there = x >= 0 && y >= 0 && x < WIDE && y < HIGH;

        slide->value[i] = there ? planes[k]->value[y * WIDE + x] : 0;
        if (there && fabs(along - 10) < 6)
            slide->value[i] = NAN;
    }
    return slide;
}

/* All laid but one, which its marks do not lay. */
static int look_beside(struct gsn_poses *a, unsigned held, struct gsn_sequence **ret_sequence,
                       struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) cells = NULL;
    gsn_auto(gsn_plane) slide = folded(held);
    int r;

    sections[held].state = GSN_SECTION_HELD;
    sections[held].posed = 0;
    r = gsn_section_planes_new(a, GSN_SEQUENCE_CELL_UM, &cells, err);
    for (unsigned k = 0; r >= 0 && k < SECTIONS; k++)
        gsn_section_planes_add(cells, a, k, planes[k], 1);
    if (r >= 0)
        r = gsn_section_planes_hold(cells, held, slide, 1, 20, err);
    return r < 0 ? r : gsn_section_order_examine(cells, &single, a, &densities, ret_sequence, err);
}

TEST(a_folded_section_that_is_held_is_named_with_its_second_mount_that_is_laid)
{
    for (int first = 1; first >= 0; first--) {
        const unsigned held = first ? AGAIN - 1 : AGAIN;
        struct gsn_poses a = make_stack();
        gsn_auto(gsn_sequence) sequence = NULL;
        struct gsn_error err = { 0 };
        char sentence[GSN_POSE_SENTENCE], said[120];

        for (unsigned k = 0; k < SECTIONS; k++)
            cut_out(planes[k]);
        CHECK_OK(look_beside(&a, held, &sequence, &err), err);
        CHECK(sequence->count == 1 && sequence->finding[0].kind == GSN_SEQUENCE_EXCLUDED_DUPLICATE);
        for (unsigned k = 0; k < SECTIONS; k++) {
            CHECK(strcmp(text_of(&shown[k].flags).text, k == AGAIN       ? "same-as-8.1?"
                                                        : k == AGAIN - 1 ? "same-as-9.1?"
                                                                         : "") == 0);
            CHECK(sections[k].state == (k == held ? GSN_SECTION_HELD : GSN_SECTION_USED));
        }
        gsn_section_order_sentence(&sequence->finding[0], 12, sentence);
        CHECK(strstr(sentence,
                     "sections 1.8 and 1.9 look like one section, mounted or scanned twice"));
        (void)snprintf(said, sizeof said,
                       "section 1.%u is held and 1.%u is used: if 1.%u is the one that "
                       "belongs where it is, 1.%u lies in the place of another",
                       held + 1, 2 * AGAIN - held, held + 1, 2 * AGAIN - held);
        CHECK(strstr(sentence, said) && !strstr(sentence, "both are used"));
        free_planes();
    }
}

TEST(a_held_section_beside_its_own_neighbours_is_left_alone)
{
    struct gsn_poses a = make_stack();
    gsn_auto(gsn_sequence) sequence = NULL;
    struct gsn_error err = { 0 };

    for (unsigned k = 0; k < SECTIONS; k++)
        cut_out(planes[k]);
    CHECK_OK(look_beside(&a, AGAIN - 3, &sequence, &err), err);
    CHECK(sequence->count == 1 && sequence->finding[0].kind == GSN_SEQUENCE_DUPLICATE);
    CHECK(shown[AGAIN - 3].flags.count == 0);
    free_planes();
}

TEST(of_two_held_mounts_one_may_be_used_and_both_are_said_to_be_held)
{
    const struct gsn_sequence_finding finding = { .kind = GSN_SEQUENCE_EXCLUDED_DUPLICATE,
                                                  .a = 3,
                                                  .b = 4,
                                                  .evidence = 0.52,
                                                  .usual = 0.24,
                                                  .held = { 1, 1 } };
    char sentence[GSN_POSE_SENTENCE];

    gsn_section_order_sentence(&finding, 12, sentence);
    CHECK(strcmp(sentence,
                 "sections 1.4 and 1.5 look like one section, mounted or scanned twice: the "
                 "best quarter of their texture agrees to 52 %, that of neighbours to "
                 "24 %; both are held: use one of them at most: look at both") == 0);
}

/* Pixels of 5 um, every other row of them given; the first ten columns are masked. */
TEST(a_held_section_is_seen_in_cells_of_its_own)
{
    struct gsn_poses a = make_stack();
    gsn_auto(gsn_section_planes) cells = NULL;
    gsn_auto(gsn_plane) slide = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_section_planes_new(&a, 40, &cells, &err), err);
    CHECK_OK(gsn_plane_new(30, 12, &slide, &err), err);
    for (int i = 0; i < 30 * 12; i++)
        slide->value[i] = i % 30 < 10 ? NAN : (float)(i % 30);
    CHECK_OK(gsn_section_planes_hold(NULL, 2, slide, 2, 5, &err), err);
    CHECK_OK(gsn_section_planes_hold(cells, 2, slide, 2, 5, &err), err);
    CHECK(cells->held_count == 1 && cells->held[0].section == 2);
    CHECK(cells->held[0].cell_um == 20);
    CHECK(cells->held[0].columns == 8 && cells->held[0].rows == 7);
    for (size_t y = 0; y < 6; y++) {
        const float *row = cells->held[0].density + y * 8;

        CHECK(isnan(row[0]) && isnan(row[1]));
        for (int x = 3; x < 7; x++)
            CHECK(fabs((double)row[x] - (4 * x + 1.5)) < 1e-5);
    }
    for (size_t x = 0; x < 8; x++)
        CHECK(cells->held[0].density[6 * 8 + x] == 0);
    free_planes();
}

/* Case 30. */
TEST(a_swap_is_a_proposal_in_words)
{
    const struct gsn_sequence_finding finding = {
        .kind = GSN_SEQUENCE_SWAP, .a = 17, .b = 18, .evidence = 9.25
    };
    char sentence[GSN_POSE_SENTENCE];

    gsn_section_order_sentence(&finding, 12, sentence);
    CHECK(strcmp(sentence,
                 "sections 2.6 and 2.7 look swapped: each is more like those around the other's "
                 "place than those around its own, by 9.2 standard errors together; nothing was "
                 "moved: look at both") == 0);
}

TEST(what_the_tissue_cannot_show_is_said_with_what_it_would_cost)
{
    const struct gsn_sequence all = { .reach = 1, .duplicates_known = 1 }, none = { 0 },
                              some = { .shown = { 0.62, 0.97, 1 },
                                       .reach = 3,
                                       .unseen = 0.0069,
                                       .duplicates_known = 1 };
    char sentence[GSN_POSE_SENTENCE];

    CHECK(!gsn_section_order_blind_to_swaps(&all, sentence) && sentence[0] == '\0');
    CHECK(!gsn_section_order_blind_to_duplicates(&all, sentence) && sentence[0] == '\0');
    CHECK(gsn_section_order_blind_to_swaps(&some, sentence));
    CHECK(strcmp(sentence, "a swap of two sections nearer than 3 to each other may not show in "
                           "their tissue (expected to show: 62 % of swaps of neighbours, 97 % two "
                           "apart, 100 % three apart): their order rests on numbers and slots "
                           "alone; it would carry at most 0.69 % of all density to the other "
                           "place") == 0);
    CHECK(gsn_section_order_blind_to_swaps(&none, sentence));
    CHECK(strcmp(sentence, "a swap of two sections may not show in their tissue: their order "
                           "rests on numbers and slots alone") == 0);
    CHECK(gsn_section_order_blind_to_duplicates(&none, sentence));
    CHECK(strcmp(sentence, "a section mounted or scanned twice would not show: neighbours share "
                           "all that could set one apart") == 0);
}

/* Most of section 0 is masked, and section 1 is narrower than the stack's frame. */
TEST(what_is_masked_is_not_known_and_what_no_box_reaches_is_glass)
{
    struct gsn_poses a = make_stack();
    gsn_auto(gsn_section_planes) cells = NULL;
    struct gsn_error err = { 0 };
    size_t middle, right;

    sections[1].seen.width = WIDE / 2;
    for (int i = 0; i < WIDE * HIGH; i++)
        if (i % WIDE >= WIDE / 4)
            planes[0]->value[i] = NAN;
    CHECK_OK(gsn_section_planes_new(&a, 25, &cells, &err), err);
    CHECK(cells->cell_um == 25 && cells->columns == WIDE * 20 / 25 + 1);
    gsn_section_planes_add(cells, &a, 0, planes[0], 1);
    planes[1]->width = WIDE / 2;
    gsn_section_planes_add(cells, &a, 1, planes[1], 1);
    gsn_section_planes_settle(cells);
    middle = cells->rows / 2 * cells->columns + WIDE * 20 / 25 / 2 + 4;
    right = middle + WIDE * 20 / 25 / 4;
    CHECK(isnan(cells->density[middle]) && isnan(cells->density[right]));
    CHECK(cells->density[cells->rows * cells->columns + right] == 0);
    CHECK(cells->density[cells->rows / 2 * cells->columns + 8] > 0);
    planes[1]->width = WIDE;
    free_planes();
}

/* Pixels of 40 um would leave holes in cells of 25. */
TEST(cells_are_no_narrower_than_the_coarsest_pixel)
{
    struct gsn_poses a = make_stack();
    gsn_auto(gsn_section_planes) cells = NULL;
    struct gsn_error err = { 0 };

    for (unsigned k = 0; k < SECTIONS; k++)
        sections[k].pose.panel_to_block_um = (struct gsn_affine){ 40, 0, 0, 0, 40, 0 };
    CHECK_OK(gsn_section_planes_new(&a, 25, &cells, &err), err);
    CHECK(fabs(cells->cell_um - 40) < 1e-9);
    gsn_section_planes_add(cells, &a, 0, planes[0], 1);
    gsn_section_planes_settle(cells);
    for (size_t y = 1; y + 2 < cells->rows; y++)
        for (size_t x = 1; x + 2 < cells->columns; x++)
            CHECK(cells->density[y * cells->columns + x] > 0);
    free_planes();
}

TEST(a_specimen_without_laid_sections_has_no_order)
{
    struct gsn_poses a = { .section_count = 1, .section = sections };
    struct gsn_section_planes *cells = NULL;
    struct gsn_error err = { 0 };

    memset(sections, 0, sizeof sections);
    CHECK_OK(gsn_section_planes_new(&a, GSN_SEQUENCE_CELL_UM, &cells, &err), err);
    CHECK(cells == NULL);
}

static int look_once(struct gsn_error *err)
{
    struct gsn_poses a = { .section_count = SECTIONS, .section = sections };
    gsn_auto(gsn_sequence) sequence = NULL;

    return look(&a, &sequence, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    (void)make_stack();
    CHECK_EVERY_OOM(look_once(&err), err);
    free_planes();
}

static struct gsn_plane *slide_of_last;

/* The first alone is laid: nothing is compared. */
static int hold_once(struct gsn_error *err)
{
    struct gsn_poses a = { .section_count = SECTIONS, .section = sections };
    gsn_auto(gsn_section_planes) cells = NULL;
    gsn_auto(gsn_sequence) sequence = NULL;
    int r = gsn_section_planes_new(&a, GSN_SEQUENCE_CELL_UM, &cells, err);

    if (r >= 0)
        r = gsn_section_planes_hold(cells, SECTIONS - 1, slide_of_last, 1, 20, err);
    return r < 0 ? r : gsn_section_order_examine(cells, &single, &a, &densities, &sequence, err);
}

TEST(running_out_of_memory_for_a_held_section_leaks_nothing)
{
    struct gsn_error err = { 0 };

    (void)make_stack();
    slide_of_last = folded(SECTIONS - 1);
    sections[SECTIONS - 1].state = GSN_SECTION_HELD;
    for (unsigned k = 1; k + 1 < SECTIONS; k++)
        sections[k].state = GSN_SECTION_MISSING;
    CHECK_EVERY_OOM(hold_once(&err), err);
    gsn_plane_free(slide_of_last);
    free_planes();
}
