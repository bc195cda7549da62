/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/order/sequence.h"

#include "pipeline/register/order/findings.h"
#include "pipeline/register/order/predict.h"

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

struct swaps {
    size_t made, found, others;
    double shown; /* as told by the stacks in order, NEAR apart and more */
};

/* A swap in each half of a stack, or one where they are farther apart than that: anywhere but of
 * the last two at either end, which sequence.h does not tell. */
static struct swaps swap_and_look(unsigned least, unsigned most, size_t trials)
{
    struct draw_chance chance = { 2 + least };
    struct swaps all = { 0 };
    const unsigned count = 2 * most < SECTIONS / 2 ? 2 : 1, part = SECTIONS / count;

    for (size_t t = 0; t < trials; t++) {
        unsigned at[2][2];
        size_t found = 0;

        see_all(&chance);
        gsn_auto(gsn_sequence) before = examined(SECTIONS);

        all.shown += before->shown[least < GSN_SEQUENCE_NEAR ? least - 1 : GSN_SEQUENCE_NEAR - 1] /
                     (double)trials;
        for (unsigned i = 0; i < count; i++) {
            const unsigned far = (unsigned)draw_uniform(&chance, least, most + 1);

            at[i][0] =
                i * part + (unsigned)draw_uniform(&chance, far == 1, part - far - (far == 1));
            at[i][1] = at[i][0] + far;
            planes[at[i][0]].density = seen[at[i][1]];
            planes[at[i][1]].density = seen[at[i][0]];
        }
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        for (unsigned i = 0; i < count; i++)
            found += has(s, GSN_SEQUENCE_SWAP, at[i][0], at[i][1]) != 0;
        all.made += count;
        all.found += found;
        all.others += s->count - found;
    }
    print_message("  %u to %u apart: %zu of %zu found, %.0f %% told, %zu other proposals\n", least,
                  most, all.found, all.made, 100 * all.shown, all.others);
    return all;
}

/* Case 30. docs/user/register.md says what share shows on registered planes. The long run:
 * GIESON_TRIALS=1000 build/bench/tests/test_register_order_sequence. */
TEST(swapped_sections_are_proposed_and_nothing_else)
{
    const size_t trials = mounted_trials(2);
    const struct swaps near = swap_and_look(1, 1, trials), two = swap_and_look(2, 3, trials),
                       far = swap_and_look(4, 24, 2 * trials);

    CHECK((double)near.found >= 0.75 * (double)near.made);
    CHECK((double)two.found >= 0.75 * (double)two.made);
    CHECK((double)far.found >= 0.95 * (double)far.made);
    CHECK((double)(near.others + two.others + far.others) <= 0.05 * (double)near.made);
}

/* A slanting block moves on from section to section, and a section among strangers at the other end
 * is registered onto them: only registered again where it belongs does it show the contrary of what
 * is predicted there, and not a third of it; and only when those around are registered again, too,
 * do all fit better by six standard errors, half of which the evidence counts. */
TEST(sections_from_either_end_are_laid_again_where_they_belong)
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
        CHECK(s->finding[0].against > 0.5 * s->finding[0].predicted);
        CHECK(s->finding[0].evidence - s->finding[0].against > 3);
    }
}

/* Of a torn section nothing is known over half of the frame. Whatever stands in for it there does
 * not speak for those beside it, in whichever order they lie. */
TEST(what_a_torn_section_lacks_says_nothing_of_those_beside_it)
{
    struct draw_chance chance = { 21 };
    size_t found = 0, others = 0;

    for (unsigned t = 0; t < 6; t++) {
        const unsigned torn = t & 1 ? 0 : SECTIONS - 1, a = torn ? SECTIONS - 4 : 1;

        see_all(&chance);
        for (int c = 0; c < CELLS; c++)
            if (c % COLUMNS < COLUMNS / 2)
                seen[torn][c] = NAN;
        planes[a].density = seen[a + 2];
        planes[a + 2].density = seen[a];
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        found += has(s, GSN_SEQUENCE_SWAP, a, a + 2) != 0;
        others += s->count;
    }
    others -= found;
    print_message("  %zu of 6 swaps found, %zu other proposals\n", found, others);
    CHECK(found == 6 && others == 0);
}

/* Of a line through seven planes: each lacks a tenth of its cells, where some other value stands.
 */
static void foretell_with(float stand_in, float ret_value[CELLS], unsigned char told[CELLS])
{
    enum { PLANES = 7, PLACE = 3 };
    static float value[PLANES * CELLS], deviation[CELLS];
    static unsigned char known[PLANES * CELLS];
    size_t place[PLANES];
    double z[PLANES];
    struct draw_chance chance = { 41 };
    const struct gsn_sequence_tissue t = { .n = PLANES,
                                           .columns = COLUMNS,
                                           .rows = ROWS,
                                           .z = z,
                                           .place = place,
                                           .value = value,
                                           .known = known,
                                           .deviation = deviation };

    for (int k = 0; k < PLANES; k++) {
        z[k] = k;
        place[k] = (size_t)k;
    }
    for (int c = 0; c < PLANES * CELLS; c++) {
        const float own = 5 + (float)(c / CELLS) + (float)(0.01 * draw_normal(&chance));

        known[c] = draw_uniform(&chance, 0, 1) > 0.1;
        value[c] = known[c] ? own : stand_in;
    }
    for (int c = 0; c < CELLS; c++)
        deviation[c] = 1;
    memset(told, 1, CELLS);
    const struct gsn_sequence_line line = gsn_sequence_line_at(z, PLANES, PLACE, PLACE, PLACE);

    gsn_sequence_predict(&t, &line, PLACE, 1, ret_value, told);
}

/* A straight line through all planes but one, of which a side of three that lacks one of them is
 * off by no more than its weight times how far that lies from the others. */
TEST(what_stands_in_for_cells_that_a_section_lacks_is_not_looked_at)
{
    static float low[CELLS], high[CELLS];
    static unsigned char told[CELLS], told_too[CELLS];
    size_t count = 0;

    foretell_with(-100, low, told);
    foretell_with(100, high, told_too);
    for (int c = 0; c < CELLS; c++) {
        CHECK(told[c] == told_too[c]);
        count += told[c];
        if (told[c]) {
            CHECK(low[c] == high[c]);
            CHECK(fabs((double)low[c] - 8) < 1.1);
        }
    }
    CHECK(count > 0.99 * CELLS && count < CELLS);
}

static struct gsn_sequence_finding named(enum gsn_sequence_kind kind, unsigned a, unsigned b,
                                         double evidence)
{
    return (struct gsn_sequence_finding){ .kind = kind, .a = a, .b = b, .evidence = evidence };
}

/* 0 and 3 changed places, and 2 and 3 are one section: 2 1 2 0. Without the first mount 1 and 3
 * seem to have changed places, without the second 0 and 3 do, which leaves the mounts side by side.
 */
TEST(the_swap_that_leaves_two_mounts_side_by_side_stands)
{
    static const float cell[1] = { 1 };
    const struct gsn_sequence_plane four[] = { { 0, cell }, { 1, cell }, { 2, cell }, { 3, cell } };
    struct gsn_sequence_finding own[4] = { named(GSN_SEQUENCE_DUPLICATE, 0, 2, 0.6),
                                           named(GSN_SEQUENCE_SWAP, 2, 3, 9) },
                                others[] = { named(GSN_SEQUENCE_SWAP, 0, 3, 2) };
    struct gsn_sequence found = { .count = 2, .finding = own };
    const struct gsn_sequence other = { .count = 1, .finding = others };
    char out[4], room[3];

    gsn_sequence_leave_out(four, &found, 0, out, 4);
    CHECK(out[0] && !out[1] && !out[2] && !out[3]);
    gsn_sequence_leave_out(four, &found, 1, out, 4);
    CHECK(!out[0] && !out[1] && out[2] && !out[3]);
    CHECK(!gsn_sequence_is_settled(four, &found));
    own[1] = named(GSN_SEQUENCE_SWAP, 1, 3, 9);
    gsn_sequence_agree(four, &other, &found, room);
    CHECK(found.count == 2);
    CHECK(has(&found, GSN_SEQUENCE_SWAP, 0, 3) && has(&found, GSN_SEQUENCE_DUPLICATE, 0, 2));
    own[0] = named(GSN_SEQUENCE_DUPLICATE, 0, 1, 0.6);
    found.count = 1;
    CHECK(gsn_sequence_is_settled(four, &found));
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

/* The long run: GIESON_TRIALS=10000 build/bench/tests/test_register_order_sequence. */
TEST(any_two_sections_in_each_others_places_are_proposed)
{
    enum { FAR = GSN_SEQUENCE_NEAR + 1 };
    struct draw_chance chance = { 12 };
    const size_t trials = mounted_trials(6);
    size_t made[FAR] = { 0 }, found[FAR] = { 0 }, all = 0, others = 0;

    for (size_t t = 0; t < trials; t++) {
        unsigned at[2];

        see_all(&chance);
        swap_any(&chance, at);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);
        const size_t is = has(s, GSN_SEQUENCE_SWAP, at[0], at[1]) != 0;
        const unsigned apart = at[1] - at[0] < FAR ? at[1] - at[0] : FAR;

        made[apart - 1]++;
        found[apart - 1] += is;
        all += is;
        others += s->count - is;
    }
    print_message(
        "  %zu of %zu swaps found (%.2f %%): neighbours %zu of %zu, two apart %zu of %zu, "
        "three %zu of %zu, farther %zu of %zu; %zu other proposals\n",
        all, trials, 100 * (double)all / (double)trials, found[0], made[0], found[1], made[1],
        found[2], made[2], found[3], made[3], others);
    CHECK((double)all >= 0.99 * (double)trials);
    CHECK((double)others <= 0.02 * (double)trials);
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

/* A swap of a section that is there twice, or of one beside it: [2 1 2 0 ...], say. The pair is
 * named, or none; the two mounts are named all the same. */
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
    CHECK(others == 0 && 4 * found >= 3 * trials);
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
