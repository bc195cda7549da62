/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/mem.h"
#include "pipeline/register/fiducial/detect.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/panel/slots.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <stdlib.h>
#include <string.h>

/* ---- holes are filled -------------------------------------------------------------------- */

enum { GRID = 9 };

static void fill(float *value)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_fill_dark_rims(value, GRID, GRID, &err), err);
}

/* A square rim of 5 x 5 cells about the middle. */
static void draw_rim(float *value, float level)
{
    for (int k = -2; k <= 2; k++) {
        value[(4 + k) * GRID + 2] = value[(4 + k) * GRID + 6] = level;
        value[2 * GRID + 4 + k] = value[6 * GRID + 4 + k] = level;
    }
}

TEST(a_hole_is_filled_to_the_level_of_its_rim)
{
    float value[GRID * GRID] = { 0 };

    draw_rim(value, 1);
    value[4 * GRID + 4] = -3;
    fill(value);
    for (int y = 0; y < GRID; y++)
        for (int x = 0; x < GRID; x++)
            CHECK(value[y * GRID + x] == (abs(y - 4) <= 2 && abs(x - 4) <= 2));
}

/* The lowest of the way's highest neighbours. */
TEST(a_rim_with_a_low_side_holds_as_much_as_that)
{
    float value[GRID * GRID] = { 0 };

    draw_rim(value, 1);
    for (int y = 2; y <= 6; y++)
        value[y * GRID + 2] = 0.5F;
    fill(value);
    CHECK(value[4 * GRID + 4] == 0.5F && value[4 * GRID + 6] == 1 && value[4 * GRID + 2] == 0.5F);
}

TEST(a_gap_of_two_cells_holds_and_of_three_does_not)
{
    float two[GRID * GRID] = { 0 }, three[GRID * GRID] = { 0 }, masked[GRID * GRID] = { 0 };

    draw_rim(two, 1);
    two[3 * GRID + 2] = two[4 * GRID + 2] = 0;
    fill(two);
    CHECK(two[4 * GRID + 4] == 1 && two[0] == 0);
    draw_rim(three, 1);
    draw_rim(masked, 1);
    for (int y = 3; y <= 5; y++) {
        three[y * GRID + 2] = 0;
        masked[y * GRID + 2] = NAN;
    }
    fill(three);
    fill(masked);
    CHECK(three[4 * GRID + 4] == 0 && masked[4 * GRID + 4] == 0 && isnan(masked[4 * GRID + 2]));
}

/* What is filled stays as it is, and nothing is lowered. */
TEST(filling_twice_is_filling_once)
{
    float once[GRID * GRID], twice[GRID * GRID];
    struct draw_chance chance = { 3 };

    for (int i = 0; i < GRID * GRID; i++)
        once[i] = (float)draw_normal(&chance);
    memcpy(twice, once, sizeof twice);
    fill(once);
    for (int i = 0; i < GRID * GRID; i++)
        CHECK(once[i] >= twice[i]);
    memcpy(twice, once, sizeof twice);
    fill(twice);
    CHECK(memcmp(once, twice, sizeof once) == 0);
}

/* ---- burns of all sizes ------------------------------------------------------------------ */

static const struct gsn_point TRIANGLE[GSN_FIDUCIALS] = { { -1150, -700 },
                                                          { 950, -900 },
                                                          { -550, 1000 } };
enum { SECTIONS = 4, WIDE_UM = 4200, FINE = 6 };

struct drawn {
    double px_um, radius_um;
    int hole, marks;
    uint64_t seed;
};

static struct gsn_point place_of(const struct drawn *drawn, int section, int mark)
{
    const double angle = 1.1 * section + 0.3, c = cos(angle), s = sin(angle);
    const double middle = 0.5 * WIDE_UM / drawn->px_um;
    const struct gsn_point um = TRIANGLE[mark];

    return (struct gsn_point){ middle + (c * um.x - s * um.y) / drawn->px_um,
                               middle + (s * um.x + c * um.y) / drawn->px_um };
}

/* The share of a pixel that an oval covers, seen through optics that blur by a pixel either way. */
static double cover(double x, double y, double a, double b, double turned)
{
    double in = 0;

    for (int k = 0; k < FINE * FINE; k++) {
        const double u = x + 2 * (k % FINE + 0.5) / FINE - 1;
        const double v = y + 2 * (k / FINE + 0.5) / FINE - 1;
        const double along = u * cos(turned) + v * sin(turned);
        const double across = v * cos(turned) - u * sin(turned);

        in += along * along / (a * a) + across * across / (b * b) < 1;
    }
    return in / (FINE * FINE);
}

/* Char of density 0.7 in tissue; a hole is of glass, with a rim of a quarter of the radius. Light
 * adds up, so a pixel that shows both has the density of their mean light. */
static void burn(struct gsn_plane *plane, const struct drawn *drawn, struct gsn_point at,
                 struct draw_chance *chance)
{
    const double aspect = sqrt(draw_uniform(chance, 1, 1.6)), turned = draw_uniform(chance, 0, 3);
    const double radius = drawn->radius_um / drawn->px_um * draw_uniform(chance, 0.95, 1.05);
    const double a = radius * aspect, b = radius / aspect, inner = drawn->hole ? 0.75 : 0;

    for (int y = (int)(at.y - a) - 2; y < at.y + a + 2; y++) {
        for (int x = (int)(at.x - a) - 2; x < at.x + a + 2; x++) {
            float *value = &plane->value[(size_t)y * plane->width + (size_t)x];
            const double dx = x + 0.5 - at.x, dy = y + 0.5 - at.y;
            const double all = cover(dx, dy, a, b, turned);
            const double light = inner > 0 ? cover(dx, dy, inner * a, inner * b, turned) : 0;

            *value = (float)-log10((1 - all) * pow(10, -(double)*value) +
                                   (all - light) * pow(10, -0.7) + light);
        }
    }
}

static void draw(const struct drawn *drawn, int section, struct gsn_plane *plane)
{
    struct draw_chance chance = { drawn->seed + (uint64_t)section };
    const double side = plane->width;

    draw_fill(plane, 0.15);
    for (int n = 0; n < 300; n++) {
        const struct gsn_point at = { draw_uniform(&chance, 0, side),
                                      draw_uniform(&chance, 0, side) };
        const double size = draw_uniform(&chance, 15, 90) / drawn->px_um;

        draw_ellipse(plane, at, size, 0.3 * size, draw_uniform(&chance, 0, 3),
                     0.015 * draw_normal(&chance));
    }
    for (int m = 0; m < drawn->marks; m++)
        burn(plane, drawn, place_of(drawn, section, m), &chance);
    draw_noise(plane, &chance, 0.015);
}

/* All kinds of burns in all sections, as gsn_fiducials_choose_burn() wants them. */
static void search(const struct drawn *drawn, struct gsn_fiducial_candidates *ret_sections)
{
    const uint32_t side = (uint32_t)(WIDE_UM / drawn->px_um);
    gsn_auto_mem(float) value = gsn_alloc_array((size_t)side * side, sizeof *value);
    struct gsn_plane plane = { side, side, value };
    const struct gsn_density_source density = draw_density(&plane);
    const struct gsn_slot slot = {
        .found = 1, .width = (int)side, .height = (int)side, .centre_px = { 0.5 * side, 0.5 * side }
    };
    struct gsn_error err = { 0 };

    CHECK(value);
    for (int i = 0; i < SECTIONS; i++) {
        draw(drawn, i, &plane);
        for (unsigned k = 0; k < GSN_BURNS; k++)
            CHECK_OK(gsn_fiducials_detect_burn(&density, &slot, drawn->px_um, k,
                                               &ret_sections[k * SECTIONS + (unsigned)i], &err),
                     err);
    }
}

/* How many sections show their three marks, and how many anything else. */
struct tally {
    int right, wrong;
    unsigned burn;
};

static struct tally find(const struct drawn *drawn)
{
    static struct gsn_fiducial_candidates sections[GSN_BURNS * SECTIONS];
    struct gsn_triangle_prior prior = { 0 };
    struct gsn_error err = { 0 };
    struct tally tally = { 0 };
    const struct gsn_fiducial_candidates *of;

    search(drawn, sections);
    CHECK_OK(gsn_fiducials_choose_burn(sections, SECTIONS, TRIANGLE, &tally.burn, &err), err);
    of = sections + tally.burn * SECTIONS;
    memcpy(prior.mark_um, TRIANGLE, sizeof prior.mark_um);
    CHECK_OK(gsn_fiducials_learn(of, SECTIONS, &prior, &err), err);
    for (int i = 0; i < SECTIONS; i++) {
        struct gsn_fiducial mark[GSN_FIDUCIALS];
        int found = 0, near = 0;

        gsn_fiducials_match(&of[i], &prior, mark, NULL, NULL, NULL);
        for (int m = 0; m < GSN_FIDUCIALS; m++) {
            const struct gsn_point at = place_of(drawn, i, m);

            found += mark[m].found;
            near += mark[m].found && hypot(mark[m].px.x - at.x, mark[m].px.y - at.y) <
                                         0.25 * drawn->radius_um / drawn->px_um;
        }
        tally.right += near == GSN_FIDUCIALS;
        tally.wrong += found > near;
    }
    return tally;
}

static void check_all_found(double px_um, const double *radius_um, size_t count, int hole)
{
    for (size_t i = 0; i < count; i++) {
        const struct drawn drawn = { px_um, radius_um[i], hole, GSN_FIDUCIALS, 5 + i };
        const struct tally tally = find(&drawn);

        print_message("  %g um at %g um a pixel%s: %d of %d, %d wrong, kind %u\n", radius_um[i],
                      px_um, hole ? ", holes" : "", tally.right, SECTIONS, tally.wrong, tally.burn);
        CHECK(tally.right == SECTIONS && tally.wrong == 0);
    }
}

TEST(discs_of_any_radius_are_found_from_two_pixels_on)
{
    static const double all[] = { 20, 40, 75, 150, 300 };

    check_all_found(6, all, 5, 0);
    check_all_found(10.58, all + 1, 4, 0);
    check_all_found(24, all + 2, 3, 0);
}

TEST(holes_are_found_from_four_pixels_on)
{
    static const double all[] = { 20, 40, 75, 150, 300 };

    check_all_found(6, all + 1, 4, 1);
    check_all_found(10.58, all + 2, 3, 1);
    check_all_found(24, all + 3, 2, 1);
}

TEST(marks_that_are_too_small_to_see_are_not_guessed)
{
    for (int hole = 0; hole < 2; hole++) {
        const struct drawn drawn = { 24, 20, hole, GSN_FIDUCIALS, 77 };
        const struct tally tally = find(&drawn);

        CHECK(tally.wrong == 0);
    }
}

TEST(sections_without_marks_have_none_of_any_kind)
{
    const struct drawn drawn = { 10.58, 75, 0, 0, 9 };
    const struct tally tally = find(&drawn);

    CHECK(tally.burn == 0 && tally.right == 0 && tally.wrong == 0);
}

TEST(ordinary_marks_are_of_the_ordinary_kind_and_nothing_else_is_asked)
{
    static struct gsn_fiducial_candidates sections[GSN_BURNS * SECTIONS];
    const struct drawn drawn = { 10.58, 75, 0, GSN_FIDUCIALS, 21 },
                       large = { 10.58, 300, 0, 3, 22 };
    struct gsn_error err = { 0 };
    unsigned burn = 7;
    int odd = 7;

    search(&drawn, sections);
    CHECK_OK(gsn_fiducials_are_odd(sections, SECTIONS, TRIANGLE, &odd, &err), err);
    CHECK_OK(gsn_fiducials_choose_burn(sections, SECTIONS, TRIANGLE, &burn, &err), err);
    CHECK(odd == 0 && burn == 0);
    search(&large, sections);
    CHECK_OK(gsn_fiducials_are_odd(sections, SECTIONS, TRIANGLE, &odd, &err), err);
    CHECK(odd == 1);
}

static int fill_once(struct gsn_error *err)
{
    float value[GRID * GRID] = { 0 };

    return gsn_fill_dark_rims(value, GRID, GRID, err);
}

static int burn_once(struct gsn_error *err)
{
    static struct gsn_fiducial_candidates sections[GSN_BURNS * SECTIONS];
    unsigned burn = 7;
    int odd = 7, r = gsn_fiducials_are_odd(sections, SECTIONS, NULL, &odd, err);

    CHECK(r >= 0 || odd == 7);
    if (r >= 0)
        r = gsn_fiducials_choose_burn(sections, SECTIONS, NULL, &burn, err);
    CHECK(r >= 0 || burn == 7);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(fill_once(&err), err);
    CHECK_EVERY_OOM(burn_once(&err), err);
}
