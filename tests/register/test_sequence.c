/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence.h"

#include "tests/check.h"
#include "tests/phantom/geometry.h"
#include "tests/register/draw.h"
#include "tests/register/mounted.h"

#include <string.h>

/* The phantom's block (PHANTOM.md section 1) at 50 um, seen in cells of 100 um. */
enum { SECTIONS = 60, COLUMNS = 56, ROWS = 44, CELLS = COLUMNS * ROWS, FINE = 4 * CELLS };

static const double GRAIN = 0.08; /* of the density, in each cell */
static float block[SECTIONS + 1][FINE];

static void fill_block(void)
{
    if (block[0][FINE / 2] != 0)
        return;
    for (int k = 0; k <= SECTIONS; k++)
        for (int i = 0; i < FINE; i++) {
            const struct gsn_vec3 at = { (i % (2 * COLUMNS) + 0.5 - COLUMNS) * 50,
                                         (i / (2 * COLUMNS) + 0.5 - ROWS) * 50, 12 + 24 * k };
            struct gsn_phantom_field field;

            gsn_phantom_field_at(at, &field);
            block[k][i] = (float)gsn_phantom_density(&field, 0.37);
        }
}

/* The mean over a cell of two by two, whose corner lies between the fine ones. */
static double cell_at(int k, double x, double y)
{
    const double fx = fmin(fmax(x, 0), 2 * COLUMNS - 3.001),
                 fy = fmin(fmax(y, 0), 2 * ROWS - 3.001);
    const int i = (int)fx, j = (int)fy;
    const double wx[3] = { 1 - (fx - i), 1, fx - i }, wy[3] = { 1 - (fy - j), 1, fy - j };
    double sum = 0;

    for (int b = 0; b < 3; b++)
        for (int a = 0; a < 3; a++)
            sum += wx[a] * wy[b] * (double)block[k][(j + b) * 2 * COLUMNS + i + a] / 4;
    return sum;
}

static float seen[SECTIONS][CELLS];
static struct gsn_sequence_plane planes[SECTIONS];

enum {
    DETAIL_COLUMNS = GSN_SEQUENCE_FINER * COLUMNS,
    DETAIL_ROWS = GSN_SEQUENCE_FINER * ROWS,
    DETAILS = DETAIL_COLUMNS * DETAIL_ROWS
};

static const double TEXTURE = 0.15; /* of the density, in each cell of 33 um */
static float detail[SECTIONS][DETAILS], again[DETAILS];

static void fill_detail(void)
{
    struct draw_chance chance = { 10 };

    for (int k = 0; k < SECTIONS && detail[SECTIONS - 1][DETAILS / 2] == 0; k++)
        for (int c = 0; c < DETAILS; c++) {
            const double x = (c % DETAIL_COLUMNS + 0.5) * 2 / 3,
                         y = (c / DETAIL_COLUMNS + 0.5) * 2 / 3;

            detail[k][c] = block[k][(int)y * 2 * COLUMNS + (int)x] *
                           (float)fmax(1 + TEXTURE * draw_normal(&chance), 0);
        }
}

/* Section k once more: stretched by 3 % about the middle, warped by up to 60 um, stained and
 * scanned anew. */
static void mount_again(int k, struct draw_chance *chance)
{
    const double phase = draw_uniform(chance, 0, 6.28), stain = exp(0.2 * draw_normal(chance));

    fill_detail();
    for (int c = 0; c < DETAILS; c++) {
        const double x = c % DETAIL_COLUMNS, y = c / DETAIL_COLUMNS;
        const double u = x + 0.03 * (x - DETAIL_COLUMNS / 2.0) + 1.8 * sin(y / 20 + phase);
        const double v = y + 0.03 * (y - DETAIL_ROWS / 2.0) + 1.8 * cos(x / 20 + phase);
        const int i = (int)fmin(fmax(u, 0), DETAIL_COLUMNS - 2),
                  j = (int)fmin(fmax(v, 0), DETAIL_ROWS - 2);
        const double fx = fmin(fmax(u - i, 0), 1), fy = fmin(fmax(v - j, 0), 1);
        const float *at = detail[k] + j * DETAIL_COLUMNS + i;
        const double value =
            (1 - fy) * ((1 - fx) * (double)at[0] + fx * (double)at[1]) +
            fy * ((1 - fx) * (double)at[DETAIL_COLUMNS] + fx * (double)at[DETAIL_COLUMNS + 1]);

        again[c] = (float)(stain * value * (1 + 0.05 * draw_normal(chance)));
    }
}

/* One section: laid with an error of 12 um, stained by a tenth more or less, grain of 8 % in each
 * cell, and a tear. */
static void see(float *cells, int k, struct draw_chance *chance)
{
    const double dx = 0.24 * draw_normal(chance), dy = 0.24 * draw_normal(chance);
    const double stain = exp(0.1 * draw_normal(chance));
    const int torn = (int)draw_uniform(chance, 0, CELLS - 30);

    for (int c = 0; c < CELLS; c++) {
        const double x = 2 * (c % COLUMNS) + dx, y = 2 * (c / COLUMNS) + dy;

        cells[c] = (float)(stain * cell_at(k, x, y) * (1 + GRAIN * draw_normal(chance)));
    }
    for (int c = torn; c < torn + 20; c++)
        cells[c] = NAN;
}

/* As a drawing without grain, laid and stained alike: what sets its sections apart from straight
 * lines is the curvature of the block, which neighbours share. */
static void see_without_grain(int step)
{
    static float smooth[SECTIONS][DETAILS];

    fill_block();
    for (int k = 0; k < SECTIONS; k++) {
        for (int c = 0; c < CELLS; c++)
            seen[k][c] = (float)cell_at(k, 2 * (c % COLUMNS), 2 * (c / COLUMNS)) *
                         (1 + 0.001f * (float)((k * step) % 3));
        for (int c = 0; c < DETAILS; c++)
            smooth[k][c] = (float)cell_at(k, (c % DETAIL_COLUMNS + 0.5) * 2 / 3,
                                          (c / DETAIL_COLUMNS + 0.5) * 2 / 3);
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k], smooth[k] };
    }
}

static void see_all(struct draw_chance *chance)
{
    fill_block();
    fill_detail();
    for (int k = 0; k < SECTIONS; k++) {
        see(seen[k], k, chance);
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k], detail[k] };
    }
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
    const size_t trials = mounted_trials(8);
    size_t proposals = 0, told = 0;
    double change = 0;

    for (size_t t = 0; t < trials; t++) {
        see_all(&chance);
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        proposals += s->count;
        change = s->change;
        told += s->reach == 1;
    }
    print_message("  %zu proposals in %zu stacks; change over noise %.2f, %zu told\n", proposals,
                  trials, change, told);
    CHECK((double)proposals <= 0.01 * (double)trials + 0.5);
}

/* How many swaps at this distance are found; everything else that is proposed is counted too. */
static size_t swaps_found(unsigned least, unsigned most, size_t trials, size_t *ret_others)
{
    struct draw_chance chance = { 2 + least };
    size_t found = 0;

    for (size_t t = 0; t < trials; t++) {
        const unsigned far = (unsigned)draw_uniform(&chance, least, most + 1);
        /* The last two at either end are not told apart, as sequence.c says. */
        const unsigned a = (unsigned)draw_uniform(&chance, 1, SECTIONS - 1 - far), b = a + far;

        see_all(&chance);
        planes[a].density = seen[b];
        planes[b].density = seen[a];
        planes[a].detail = detail[b];
        planes[b].detail = detail[a];
        gsn_auto(gsn_sequence) s = examined(SECTIONS);
        const size_t this = has(s, GSN_SEQUENCE_SWAP, a, b) != 0;

        found += this;
        *ret_others += s->count - this;
    }
    return found;
}

/* Case 30. Neighbours are laid 12 um askew each, as far as tissue changes over five sections: what
 * is left of the difference does not always tell which is which, and then nothing is proposed. */
TEST(swapped_sections_are_proposed_and_nothing_else)
{
    const size_t trials = mounted_trials(10);
    size_t others = 0;
    const size_t near = swaps_found(1, 1, trials, &others),
                 far = swaps_found(2, 20, trials, &others);

    print_message("  of %zu swaps each: %zu of neighbours found, %zu of others, %zu other "
                  "proposals\n",
                  trials, near, far, others);
    CHECK((double)near >= 0.85 * (double)trials);
    CHECK((double)far >= 0.99 * (double)trials);
    CHECK((double)others <= 0.02 * (double)trials + 1);
}

/* Case 31: the slot of section a + 1 holds a second mount of section a. */
TEST(a_section_mounted_twice_is_found)
{
    struct draw_chance chance = { 3 };
    const size_t trials = mounted_trials(10);
    size_t found = 0, others = 0;

    for (size_t t = 0; t < trials; t++) {
        const unsigned a = (unsigned)draw_uniform(&chance, 0, SECTIONS - 1);

        see_all(&chance);
        see(seen[a + 1], (int)a, &chance);
        mount_again((int)a, &chance);
        planes[a + 1].detail = again;
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
        const unsigned a = t & 1 ? 0 : 20, b = t & 2 ? SECTIONS - 1 : 40;

        see_all(&chance);
        mount_again((int)a, &chance);
        planes[b].detail = again;
        gsn_auto(gsn_sequence) s = examined(SECTIONS);

        CHECK(has(s, GSN_SEQUENCE_DUPLICATE, a, b));
    }
}

TEST(sections_without_detail_of_their_own_are_not_called_duplicates)
{
    see_without_grain(1);
    gsn_auto(gsn_sequence) s = examined(SECTIONS);

    for (size_t i = 0; i < s->count; i++)
        print_message("  %u %u %.2f\n", s->finding[i].a, s->finding[i].b, s->finding[i].evidence);
    CHECK(s->count == 0 && !s->twice_told);
}

TEST(a_gap_in_the_numbers_is_no_fault)
{
    struct draw_chance chance = { 5 };

    for (int t = 0; t < 4; t++) {
        see_all(&chance);
        memmove(&planes[20], &planes[22], (SECTIONS - 22) * sizeof planes[0]);
        gsn_auto(gsn_sequence) s = examined(SECTIONS - 2);

        CHECK(s->count == 0);
    }
}

TEST(sections_that_do_not_differ_are_not_told)
{
    struct draw_chance chance = { 6 };

    fill_block();
    fill_detail();
    for (int k = 0; k < SECTIONS; k++) {
        see(seen[k], 30, &chance);
        planes[k] = (struct gsn_sequence_plane){ (unsigned)k, seen[k], detail[k] };
    }
    gsn_auto(gsn_sequence) s = examined(SECTIONS);

    CHECK(s->reach != 1 && s->count == 0);
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

    CHECK(few->count == 0 && few->reach == 0 && !few->twice_told);
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
