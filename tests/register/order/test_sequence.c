/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/order/sequence.h"

#include "tests/check.h"
#include "pipeline/phantom/geometry.h"
#include "tests/register/draw.h"
#include "tests/register/mounted.h"

#include <string.h>

/* The middle of the phantom's block (PHANTOM.md section 1), with a margin to lay it askew. */
enum {
    SECTIONS = 30,
    FIRST = 15, /* of the block's: where there is root and lesion */
    COLUMNS = 112,
    ROWS = 88,
    CELLS = COLUMNS * ROWS,
    MARGIN = 6,
    WIDE = COLUMNS + 2 * MARGIN,
    HIGH = ROWS + 2 * MARGIN,
    PATCH = 4
};

/* Of the density: of each cell, the texture by which a section is known, and of squares of PATCH
 * cells. */
static const double GRAIN = 0.15, PATCHES = 0.08;
static float block[SECTIONS + 1][WIDE * HIGH];

static void fill_block(void)
{
    if (block[0][WIDE * HIGH / 2] != 0)
        return;
    for (int k = 0; k <= SECTIONS; k++)
        for (int i = 0; i < WIDE * HIGH; i++) {
            const struct gsn_vec3 at = { (i % WIDE + 0.5 - WIDE / 2.0) * GSN_SEQUENCE_CELL_UM,
                                         (i / WIDE + 0.5 - HIGH / 2.0) * GSN_SEQUENCE_CELL_UM,
                                         12 + 24 * (FIRST + k) };
            struct gsn_phantom_field field;

            gsn_phantom_field_at(gsn_phantom_geometry(), at, &field);
            block[k][i] = (float)gsn_phantom_density(&field, 0.37);
        }
}

/* The block's density between cells. */
static double cell_at(int k, double x, double y)
{
    const double u = fmin(fmax(x + MARGIN, 0), WIDE - 1.001),
                 v = fmin(fmax(y + MARGIN, 0), HIGH - 1.001);
    const int i = (int)u, j = (int)v;
    const float *at = &block[k][j * WIDE + i];

    return (1 - (v - j)) * ((1 - (u - i)) * (double)at[0] + (u - i) * (double)at[1]) +
           (v - j) * ((1 - (u - i)) * (double)at[WIDE] + (u - i) * (double)at[WIDE + 1]);
}

static float seen[SECTIONS][CELLS];
static struct gsn_sequence_plane planes[SECTIONS];

/* One section: registered with an error of 20 um, stretched by half a percent, warped by 13 um,
 * stained by a tenth more or less, with grain and a tear. slant: how far, in cells, all lies
 * further on in the next section. */
static void see(float *cells, int k, double slant, struct draw_chance *chance)
{
    double lay[6], wave[4][COLUMNS];
    float patch[CELLS / (PATCH * PATCH)];
    const double stain = exp(0.1 * draw_normal(chance));
    const int torn = (int)draw_uniform(chance, 0, CELLS - 80);

    for (int i = 0; i < 6; i++)
        lay[i] = (i < 2 ? 0.6 : 0.005) * draw_normal(chance);
    for (int i = 0; i < 4; i++) {
        const double phase = draw_uniform(chance, 0, 6.28);

        for (int at = 0; at < COLUMNS; at++)
            wave[i][at] = sin((at - (i & 1 ? ROWS : COLUMNS) / 2.0) / 16 + phase);
    }
    for (int c = 0; c < CELLS / (PATCH * PATCH); c++)
        patch[c] = (float)(PATCHES * draw_normal(chance));
    for (int c = 0; c < CELLS; c++) {
        const int i = c % COLUMNS, j = c / COLUMNS;
        const double u = i - COLUMNS / 2.0, v = j - ROWS / 2.0;
        const double x = i + slant * (k - SECTIONS / 2) + lay[0] + lay[2] * u + lay[3] * v +
                         0.4 * wave[0][i] * wave[1][j];
        const double y = j + lay[1] + lay[4] * u + lay[5] * v + 0.4 * wave[2][i] * wave[3][j];

        cells[c] = (float)(stain * cell_at(k, x, y) *
                           (1 + (double)patch[j / PATCH * (COLUMNS / PATCH) + i / PATCH] +
                            GRAIN * draw_normal(chance)));
    }
    for (int c = torn; c < torn + 60; c++)
        cells[c] = NAN;
}

/* Section k once more: stretched by 3 % about the middle, warped by up to 60 um, stained and
 * scanned anew. */
static void mount_again(float *cells, int k, struct draw_chance *chance)
{
    const double phase = draw_uniform(chance, 0, 6.28), stain = exp(0.2 * draw_normal(chance));

    for (int c = 0; c < CELLS; c++) {
        const double x = c % COLUMNS, y = c / COLUMNS;
        const double u = x + 0.03 * (x - COLUMNS / 2.0) + 1.8 * sin(y / 20 + phase);
        const double v = y + 0.03 * (y - ROWS / 2.0) + 1.8 * cos(x / 20 + phase);
        const int i = (int)fmin(fmax(u, 0), COLUMNS - 2), j = (int)fmin(fmax(v, 0), ROWS - 2);
        const double fx = fmin(fmax(u - i, 0), 1), fy = fmin(fmax(v - j, 0), 1);
        const float *at = seen[k] + j * COLUMNS + i;
        const double value = (1 - fy) * ((1 - fx) * (double)at[0] + fx * (double)at[1]) +
                             fy * ((1 - fx) * (double)at[COLUMNS] + fx * (double)at[COLUMNS + 1]);

        cells[c] = (float)(stain * value * (1 + 0.05 * draw_normal(chance)));
    }
}

/* As a drawing without grain, registered and stained alike: what sets its sections apart from
 * straight lines is the curvature of the block, which neighbours share. */
static void see_without_grain(int step)
{
    fill_block();
    for (int k = 0; k < SECTIONS; k++) {
        for (int c = 0; c < CELLS; c++)
            seen[k][c] = (float)cell_at(k, c % COLUMNS, c / COLUMNS) *
                         (1 + 0.001f * (float)((k * step) % 3));
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k] };
    }
}

static void see_slanted(double slant, struct draw_chance *chance)
{
    fill_block();
    for (int k = 0; k < SECTIONS; k++) {
        see(seen[k], k, slant, chance);
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k] };
    }
}

static void see_all(struct draw_chance *chance)
{
    see_slanted(0, chance);
}

static struct gsn_sequence *examined(size_t count)
{
    struct gsn_sequence *found = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_sequence_examine(planes, count, COLUMNS, ROWS, &found, &err), err);
    return found;
}

static int has(const struct gsn_sequence *s, enum gsn_sequence_kind kind, unsigned a, unsigned b)
{
    for (size_t i = 0; i < s->count; i++)
        if (s->finding[i].kind == kind && s->finding[i].a == a && s->finding[i].b == b)
            return 1;
    return 0;
}

TEST(a_stack_in_order_has_nothing_to_propose)
{
    struct draw_chance chance = { 1 };
    const size_t trials = mounted_trials(3);
    size_t proposals = 0;
    double shown = 0;

    for (size_t t = 0; t < trials; t++) {
        see_all(&chance);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        proposals += s->count;
        shown += s->shown[0] / (double)trials;
    }
    print_message("  %zu proposals in %zu stacks; %.0f %% of neighbours' swaps would show\n",
                  proposals, trials, 100 * shown);
    CHECK((double)proposals <= 0.02 * (double)trials + 0.5);
}

/* Two sections drawn from all, in each other's places, alone in their stack. */
static void swap_any(struct draw_chance *chance, unsigned ret_at[2])
{
    do {
        ret_at[0] = (unsigned)draw_uniform(chance, 0, SECTIONS);
        ret_at[1] = (unsigned)draw_uniform(chance, 0, SECTIONS);
    } while (ret_at[0] >= ret_at[1] ||
             (ret_at[1] == ret_at[0] + 1 && (ret_at[0] == 0 || ret_at[1] == SECTIONS - 1)));
    planes[ret_at[0]].density = seen[ret_at[1]];
    planes[ret_at[1]].density = seen[ret_at[0]];
}

/* Case 30. Of swaps of two sections so far apart as the stack says that they show, 19 of 20 are
 * named, and whatever the distance no others. The long run: GIESON_TRIALS=1000
 * build/bench/tests/test_register_order_sequence. */
TEST(swapped_sections_are_named_from_as_far_apart_as_is_said_and_nothing_else)
{
    struct draw_chance chance = { 2 };
    const size_t trials = mounted_trials(20);
    size_t made = 0, found = 0, near = 0, others = 0;
    double reach = 0;

    for (size_t t = 0; t < trials; t++) {
        unsigned at[2];

        see_all(&chance);
        gsn_auto(gsn_sequence) before = examined(SECTIONS);
        swap_any(&chance, at);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);
        const size_t is = has(s, GSN_SEQUENCE_SWAP, at[0], at[1]) != 0;
        const int told = before->reach > 0 && at[1] - at[0] >= before->reach;

        reach += before->reach / (double)trials;
        made += (size_t)told;
        found += told ? is : 0;
        near += told ? 0 : is;
        others += s->count - is;
    }
    print_message(
        "  %zu of %zu swaps found as far apart as is said (%.1f), %zu nearer ones of %zu; "
        "%zu other proposals\n",
        found, made, reach, near, trials - made, others);
    CHECK(2 * made > trials && (double)found >= 0.95 * (double)made);
    CHECK((double)others <= 0.02 * (double)trials);
}

/* Far from each other and at the ends, where only one side speaks; the block slants, so that all
 * moves on from section to section. */
TEST(sections_from_either_end_are_told_in_a_block_that_slants)
{
    static const unsigned pair[][2] = {
        { 1, SECTIONS - 1 }, { 0, SECTIONS - 2 }, { 1, SECTIONS - 2 }, { 2, SECTIONS - 3 }
    };
    const double slant = 0.3;
    struct draw_chance chance = { 77 };

    for (size_t t = 0; t < sizeof pair / sizeof *pair; t++) {
        const unsigned a = pair[t][0], b = pair[t][1];

        see_slanted(slant, &chance);
        planes[a].density = seen[b];
        planes[b].density = seen[a];
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        CHECK(has(s, GSN_SEQUENCE_SWAP, a, b));
        CHECK(s->count == 1);
    }
}

/* Of a torn section nothing is known over half of the frame. Whatever stands in for it there does
 * not speak for those beside it, in whichever order they lie. */
TEST(what_a_torn_section_lacks_says_nothing_of_those_beside_it)
{
    struct draw_chance chance = { 21 };
    size_t found = 0, others = 0;

    for (unsigned t = 0; t < 6; t++) {
        const unsigned torn = t & 1 ? 0 : SECTIONS - 1, a = torn ? 2 : 1;
        const unsigned b = torn ? SECTIONS - 2 : SECTIONS - 3;

        see_all(&chance);
        for (int c = 0; c < CELLS; c++)
            if (c % COLUMNS < COLUMNS / 2)
                seen[torn][c] = NAN;
        planes[a].density = seen[b];
        planes[b].density = seen[a];
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        found += has(s, GSN_SEQUENCE_SWAP, a, b) != 0;
        others += s->count;
    }
    others -= found;
    print_message("  %zu of 6 swaps found, %zu other proposals\n", found, others);
    CHECK(found == 6 && others == 0);
}

/* Case 31: the slot of section a + 1 holds a second mount of section a. */
TEST(a_section_mounted_twice_is_found)
{
    struct draw_chance chance = { 3 };
    const size_t trials = mounted_trials(4);
    size_t found = 0, others = 0;

    for (size_t t = 0; t < trials; t++) {
        const unsigned a = (unsigned)draw_uniform(&chance, 0, SECTIONS - 1);

        see_all(&chance);
        mount_again(seen[a + 1], (int)a, &chance);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        found += has(s, GSN_SEQUENCE_DUPLICATE, a, a + 1) != 0;
        for (size_t i = 0; i < s->count; i++)
            others += s->finding[i].kind == GSN_SEQUENCE_SWAP;
    }
    print_message("  %zu of %zu duplicates found, %zu swaps proposed\n", found, trials, others);
    CHECK((double)found >= 0.99 * (double)trials);
    CHECK((double)others <= 0.02 * (double)trials);
}

/* The second mount lies far from the first: both are named, whatever lies between. */
TEST(a_section_mounted_twice_is_found_across_the_stack)
{
    struct draw_chance chance = { 9 };

    for (unsigned t = 0; t < 4; t++) {
        const unsigned a = t & 1 ? 0 : 10, b = t & 2 ? SECTIONS - 1 : 20;

        see_all(&chance);
        mount_again(seen[b], (int)a, &chance);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        CHECK(has(s, GSN_SEQUENCE_DUPLICATE, a, b));
    }
}

/* A swap of a section that is there twice, or of one beside it: [2 1 2 0 ...], say. The two mounts
 * are named, and where the swap is of neither, it or none. */
TEST(beside_a_section_mounted_twice_no_wrong_pair_is_named)
{
    static const unsigned pair[][2] = {
        { 0, 3 }, { 1, 3 }, { 2, 4 }, { 3, 4 }, { 0, 2 }, { 1, 4 }
    };
    const size_t pairs = sizeof pair / sizeof *pair, trials = 2 * pairs;
    struct draw_chance chance = { 31 };
    size_t found = 0, others = 0, duplicates = 0;

    for (size_t t = 0; t < trials; t++) {
        const unsigned first = t < pairs ? 0 : SECTIONS / 2;
        const unsigned a = first + pair[t % pairs][0], b = first + pair[t % pairs][1];

        see_all(&chance);
        mount_again(seen[first + 3], (int)first + 2, &chance);
        planes[a].density = seen[b];
        planes[b].density = seen[a];
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        for (size_t i = 0; i < s->count; i++) {
            const int swap = s->finding[i].kind == GSN_SEQUENCE_SWAP;

            duplicates += (size_t)!swap;
            others += (size_t)swap;
        }
        found += has(s, GSN_SEQUENCE_SWAP, a, b) != 0;
    }
    others -= found;
    print_message("  %zu of %zu swaps found, %zu other proposals\n", found, trials, others);
    CHECK(duplicates == trials);
    CHECK(others == 0);
}

TEST(sections_without_detail_of_their_own_are_not_called_duplicates)
{
    see_without_grain(1);
    gsn_auto(gsn_sequence) s = examined(SECTIONS);

    for (size_t i = 0; i < s->count; i++)
        print_message("  %u %u %.2f\n", s->finding[i].a, s->finding[i].b, s->finding[i].evidence);
    CHECK(s->count == 0 && !s->duplicates_known);
}

TEST(a_gap_in_the_numbers_is_no_fault)
{
    struct draw_chance chance = { 5 };

    for (int t = 0; t < 4; t++) {
        see_all(&chance);
        memmove(&planes[10], &planes[12], (SECTIONS - 12) * sizeof planes[0]);
        gsn_auto(gsn_sequence) s = examined(SECTIONS - 2);

        CHECK(s->count == 0);
    }
}

TEST(sections_that_do_not_differ_are_not_told)
{
    struct draw_chance chance = { 6 };

    fill_block();
    for (int k = 0; k < SECTIONS; k++) {
        see(seen[k], SECTIONS / 2, 0, &chance);
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k] };
    }
    gsn_auto(gsn_sequence) s = examined(SECTIONS);

    CHECK(s->reach == 0 && s->count == 0);
    CHECK(s->shown[0] < 0.1 && s->shown[2] < 0.1);
}

TEST(numbers_that_do_not_rise_are_refused)
{
    struct draw_chance chance = { 7 };
    struct gsn_sequence *found = NULL;
    struct gsn_error err = { 0 };

    see_all(&chance);
    planes[4].serial = 3;
    CHECK(gsn_sequence_examine(planes, SECTIONS, COLUMNS, ROWS, &found, &err) == GSN_E_INPUT);
    CHECK(found == NULL);
    CHECK(strcmp(err.text, "section 4 comes after section 4: serial numbers must rise") == 0);
    planes[4].serial = 4;
    gsn_auto(gsn_sequence) few = examined(5);

    CHECK(few->count == 0 && few->reach == 0 && !few->duplicates_known);
}

static int examine_once(struct gsn_error *err)
{
    gsn_auto(gsn_sequence) found = NULL;

    return gsn_sequence_examine(planes, 12, COLUMNS, ROWS, &found, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct draw_chance chance = { 8 };
    struct gsn_error err = { 0 };

    see_all(&chance);
    CHECK_EVERY_OOM(examine_once(&err), err);
}
