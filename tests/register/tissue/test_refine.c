/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue/refine.h"

#include "pipeline/core/mem.h"
#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

/* A block of straight and slanted cylinders, light on dark or dark on light, in which every section
 * has fibres of its own: white noise, as strong as the cylinders stand out. */
enum { SIDE = 64, COUNT = 40, CYLINDERS = 24, PARTS = GSN_REFINE_PARTS };

static const double CELL = 32, UNIT = 600;
/* Standard deviations of the parts that the marks leave open. */
static const double OPEN[PARTS] = { 8, 8, 3, 3, 3, 3 };

struct drawn {
    double wide; /* the moves are so many times OPEN; 0: once */
    double
        bent; /* um by which a section is bent, per axis, root mean square over the unit's disc */
    double rough; /* noise of the right half over that of the left; 0: 1 */
    float *density;
    double truth[COUNT][PARTS];
    struct gsn_refine_section section[COUNT];
    struct gsn_refine_stack stack;
};

struct cylinder {
    double x, y, r, value;
};

/* Density of the block at a point of the section's own place. slant: um a section to the right. */
static double block_at(const struct cylinder *c, double x, double y)
{
    double sum = 0;

    for (size_t i = 0; i < CYLINDERS; i++) {
        const double d = (c[i].r - hypot(x - c[i].x, y - c[i].y)) / 24;

        sum += c[i].value / (1 + exp(-2 * d));
    }
    return sum;
}

/* Per axis: twice as wide as high, saddle and bowl; none of them holds a part of a move over the
 * disc whose mean square radius is the unit's. */
static void draw_bend(struct draw_chance *chance, double bent, double ret_bend[2][3])
{
    const double mean_square[3] = { 1.0 / 6, 2.0 / 3, 1.0 / 3 };

    for (size_t axis = 0; axis < 2; axis++)
        for (size_t i = 0; i < 3; i++)
            ret_bend[axis][i] = bent / sqrt(3 * mean_square[i]) * draw_normal(chance);
}

static double bend_at(const double bend[3], double u, double v)
{
    return bend[0] * u * v + bend[1] * (u * u - v * v) + bend[2] * (u * u + v * v - 1);
}

static void draw(struct drawn *to, uint64_t seed, double noise, double slant, double contrast)
{
    struct draw_chance chance = { seed };
    struct cylinder c[CYLINDERS];

    to->density = gsn_alloc_array((size_t)COUNT * SIDE * SIDE, sizeof *to->density);
    for (size_t i = 0; i < CYLINDERS; i++)
        c[i] = (struct cylinder){ draw_uniform(&chance, -1000, 1000),
                                  draw_uniform(&chance, -1000, 1000),
                                  draw_uniform(&chance, 60, 200), contrast * (i % 2 ? 1 : -1) };
    for (size_t k = 0; k < COUNT; k++) {
        float *plane = to->density + k * SIDE * SIDE;
        const double *m = to->truth[k], wide = to->wide > 0 ? to->wide : 1;
        double bend[2][3] = { { 0 } };

        to->section[k] = (struct gsn_refine_section){ .serial = (unsigned)k, .density = plane };
        for (size_t p = 0; p < PARTS; p++) {
            to->truth[k][p] = wide * OPEN[p] * draw_normal(&chance);
            to->section[k].prior[p][p] = wide * wide * OPEN[p] * OPEN[p];
        }
        if (to->bent > 0)
            draw_bend(&chance, to->bent, bend);
        for (size_t i = 0; i < (size_t)SIDE * SIDE; i++) {
            const double x = CELL * ((double)(i % SIDE) - 0.5 * (SIDE - 1));
            const double y = CELL * ((double)(i / SIDE) - 0.5 * (SIDE - 1));
            const double u = x / UNIT, v = y / UNIT;
            const double dx =
                m[0] - m[2] * v + m[3] * u + m[4] * u + m[5] * v + bend_at(bend[0], u, v);
            const double dy =
                m[1] + m[2] * u + m[3] * v - m[4] * v + m[5] * u + bend_at(bend[1], u, v);
            const double grain =
                i % SIDE < SIDE / 2 || !(to->rough > 0) ? noise : noise * to->rough;

            plane[i] = (float)(block_at(c, x - dx - slant * (double)k, y - dy) +
                               grain * draw_normal(&chance));
        }
    }
    to->stack = (struct gsn_refine_stack){ .centre = { 0, 0 },
                                           .cell_um = CELL,
                                           .unit_um = UNIT,
                                           .side = SIDE,
                                           .count = COUNT,
                                           .section = to->section };
}

/* Of the moves found, over the true ones: 1 where they are followed in full. */
static double followed(const struct drawn *d, const struct gsn_refined *r, size_t first,
                       size_t last)
{
    double both = 0, square = 0;

    for (size_t k = first; k <= last; k++)
        for (size_t p = 0; p < 2; p++) {
            both += r[k].move[p] * d->truth[k][p];
            square += d->truth[k][p] * d->truth[k][p];
        }
    return both / square;
}

static double rms(const struct drawn *d, const struct gsn_refined *r, size_t part)
{
    double sum = 0;

    for (size_t k = 0; k < COUNT; k++) {
        const double e = (r ? r[k].move[part] : 0) - d->truth[k][part];

        sum += e * e / COUNT;
    }
    return sqrt(sum);
}

/* Of errors over what is printed: 1 where that is right. */
static double against_printed(const struct drawn *d, const struct gsn_refined *r)
{
    double sum = 0;

    for (size_t k = 0; k < COUNT; k++)
        for (size_t p = 0; p < PARTS; p++) {
            const double e = r[k].move[p] - d->truth[k][p];

            sum += e * e / r[k].covariance[p][p] / (COUNT * PARTS);
        }
    return sqrt(sum);
}

TEST(moves_are_found_within_the_printed_error)
{
    struct gsn_refined refined[COUNT];
    struct gsn_refine_summary summary;
    struct gsn_error err = { 0 };
    struct drawn d = { 0 };

    draw(&d, 7, 1, 0, 1);
    CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
    CHECK(summary.compared == COUNT - 2); /* the two ends have neighbours on one side only */
    CHECK(summary.finest_um > 2 * CELL && summary.finest_um < 1000);
    CHECK(rms(&d, refined, 0) < 0.6 * rms(&d, NULL, 0));
    CHECK(rms(&d, refined, 1) < 0.6 * rms(&d, NULL, 1));
    CHECK_NEAR(against_printed(&d, refined), 1, 0.25);
    CHECK_NEAR(summary.prior_factor, 1, 0.35);
    gsn_free(d.density);
}

/* Moves as wide as the rims that show them: rims that lie off are no debris. The comparisons err by
 * a tenth of the moves, so a hundredth of them is left with the marks. */
TEST(wide_moves_are_followed_in_full)
{
    struct gsn_refined refined[COUNT];
    struct gsn_refine_summary summary;
    struct gsn_error err = { 0 };
    struct drawn d = { .wide = 2.5 };

    draw(&d, 7, 0.3, 0, 1);
    CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
    CHECK(followed(&d, refined, 4, COUNT - 5) > 0.96);
    gsn_free(d.density);
}

enum { DRAWINGS = 3 };

/* Of several drawings: their errors over what is printed. */
static double all_against_printed(double bent, double stated, double rough, double noise)
{
    double sum = 0;

    for (uint64_t seed = 1; seed <= DRAWINGS; seed++) {
        struct gsn_refined refined[COUNT];
        struct gsn_refine_summary summary;
        struct gsn_error err = { 0 };
        struct drawn d = { .bent = bent, .rough = rough };
        double ratio;

        draw(&d, seed, noise, 0, 1);
        d.stack.bent_um2 = stated * stated;
        CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
        ratio = against_printed(&d, refined);
        sum += ratio * ratio / DRAWINGS;
        gsn_free(d.density);
    }
    return sqrt(sum);
}

/* What no move follows makes the moves less certain, as much as is stated. */
TEST(moves_of_bent_sections_are_as_uncertain_as_is_printed)
{
    CHECK_NEAR(all_against_printed(5, 5, 0, 0.1), 1, 0.25);
}

/* The right half is four times as noisy as the left. */
TEST(where_tissue_is_coarse_it_counts_for_no_more_than_it_tells)
{
    CHECK_NEAR(all_against_printed(0, 0, 4, 0.7), 1, 0.1);
}

/* Marks that say so keep a slanted block slanted: 3 um a section are 117 um in all, which marks of
 * 8 um each tell from none to 8 / sqrt(sum of k^2) = 0.11 um a section. */
TEST(a_block_that_slants_is_not_set_upright)
{
    struct gsn_refined refined[COUNT];
    struct gsn_refine_summary summary;
    struct gsn_error err = { 0 };
    struct drawn d = { 0 };
    double slope = 0, second = 0;

    draw(&d, 7, 1, 3, 1);
    CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
    for (size_t k = 0; k < COUNT; k++) {
        const double z = (double)k - 0.5 * (COUNT - 1);

        slope += z * (refined[k].move[0] - d.truth[k][0]);
        second += z * z;
    }
    CHECK_NEAR(slope / second, 0, 0.4);
    CHECK(rms(&d, refined, 0) < 0.6 * rms(&d, NULL, 0));
    gsn_free(d.density);
}

TEST(without_anything_in_common_nothing_moves)
{
    for (uint64_t seed = 1; seed <= 6; seed++) {
        struct gsn_refined refined[COUNT];
        struct gsn_refine_summary summary;
        struct gsn_error err = { 0 };
        struct drawn d = { 0 };

        draw(&d, seed, 1, 0, 0);
        CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
        CHECK(summary.compared == 0 && summary.finest_um == 0);
        for (size_t k = 0; k < COUNT; k++) {
            CHECK(!refined[k].compared);
            for (size_t p = 0; p < PARTS; p++) {
                CHECK_NEAR(refined[k].move[p], 0, 1e-9);
                CHECK_NEAR(refined[k].covariance[p][p], OPEN[p] * OPEN[p], 1e-6);
            }
        }
        gsn_free(d.density);
    }
}

/* A third of one section is covered: by something dark, or masked. */
static void cover(struct drawn *d, size_t k, float value)
{
    for (size_t i = 0; i < (size_t)SIDE * SIDE; i++)
        if (i % SIDE < 0.45 * SIDE && i / SIDE > 0.2 * SIDE && i / SIDE < 0.7 * SIDE)
            d->density[k * SIDE * SIDE + i] = value;
}

TEST(what_covers_a_section_does_not_move_it)
{
    struct gsn_refined clear[COUNT], refined[COUNT];
    struct gsn_refine_summary summary;
    struct gsn_error err = { 0 };
    const float covers[2] = { NAN, 12 };
    struct drawn d = { 0 };

    draw(&d, 7, 1, 0, 1);
    CHECK_OK(gsn_refine_solve(&d.stack, 1, clear, &summary, &err), err);
    for (size_t c = 0; c < 2; c++) {
        cover(&d, 20, covers[c]);
        CHECK_OK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err), err);
        for (size_t k = 16; k <= 24; k++)
            for (size_t p = 0; p < 2; p++)
                CHECK(fabs(refined[k].move[p] - d.truth[k][p]) <
                      3 * sqrt(clear[k].covariance[p][p]));
    }
    gsn_free(d.density);
}

/* A point that a section of this move shows there lies, by its map, where it is. */
TEST(the_map_undoes_the_move)
{
    const struct gsn_refine_stack stack = { .centre = { 400, 600 }, .unit_um = UNIT };
    const double move[PARTS] = { 5, -3, 2, 4, -1, 3 };
    const struct gsn_affine map = gsn_refine_map(&stack, move);

    for (int i = 0; i < 4; i++) {
        const double x = 400 + (i % 2 ? 700 : -300), y = 600 + (i / 2 ? 500 : -800);
        const double u = (x - 400) / UNIT, v = (y - 600) / UNIT;
        const struct gsn_point shown = { x + 5 - 2 * v + 4 * u - u + 3 * v,
                                         y - 3 + 2 * u + 4 * v + v + 3 * u };
        const struct gsn_point p = gsn_affine_apply(&map, shown);

        CHECK_NEAR(p.x, x, 1e-9);
        CHECK_NEAR(p.y, y, 1e-9);
    }
}

TEST(threads_do_not_matter)
{
    struct gsn_refined one[COUNT], four[COUNT];
    struct gsn_refine_summary summary;
    struct gsn_error err = { 0 };
    struct drawn d = { 0 };

    memset(one, 0, sizeof one);
    memset(four, 0, sizeof four);
    draw(&d, 7, 1, 0, 1);
    CHECK_OK(gsn_refine_solve(&d.stack, 1, one, &summary, &err), err);
    CHECK_OK(gsn_refine_solve(&d.stack, 4, four, &summary, &err), err);
    CHECK(memcmp(one, four, sizeof one) == 0);
    gsn_free(d.density);
}

TEST(what_cannot_be_solved_is_refused)
{
    struct gsn_refined refined[COUNT], untouched[COUNT];
    struct gsn_refine_summary summary = { .compared = 77 };
    struct gsn_error err = { 0 };
    struct drawn d = { 0 };
    struct gsn_refine_stack stack;

    memset(refined, 0x5a, sizeof refined);
    memcpy(untouched, refined, sizeof refined);
    draw(&d, 7, 1, 0, 1);
    stack = d.stack;
    stack.side = 8;
    CHECK(gsn_refine_solve(&stack, 1, refined, &summary, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "8 cells a side are too few"));
    stack = d.stack;
    stack.cell_um = 0;
    CHECK(gsn_refine_solve(&stack, 1, refined, &summary, &err) == GSN_E_INPUT);
    stack = d.stack;
    stack.bent_um2 = -4;
    CHECK(gsn_refine_solve(&stack, 1, refined, &summary, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "bent by -4 um2"));
    d.section[5].serial = 4;
    CHECK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "section 5 comes after section 5"));
    d.section[5].serial = 5;
    d.section[5].prior[2][2] = -1;
    CHECK(gsn_refine_solve(&d.stack, 1, refined, &summary, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "section 6 beforehand is no covariance"));
    CHECK(memcmp(refined, untouched, sizeof refined) == 0 && summary.compared == 77);
    gsn_free(d.density);
}

static int solve_some(struct drawn *d, struct gsn_error *err)
{
    struct gsn_refined refined[COUNT];
    struct gsn_refine_summary summary;

    return gsn_refine_solve(&d->stack, 1, refined, &summary, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct drawn d = { 0 };

    draw(&d, 7, 1, 0, 1);
    /* The middle of the picture, of a few sections. */
    d.stack.side = 16;
    d.stack.count = 6;
    CHECK_EVERY_OOM(solve_some(&d, &err), err);
    gsn_free(d.density);
}
