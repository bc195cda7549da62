/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/contour.h"

#include "tests/check.h"
#include "tests/register/draw.h"

enum { SIDE = 96, RUNS = 60 };

static float value[SIDE * SIDE];
static struct gsn_plane plane = { SIDE, SIDE, value };

/* What is wrong with a mark. */
struct fault {
    double lobes;   /* standard deviation of the lobes 2, 3 and 4, in radii */
    double cut;     /* a segment beyond this many radii is missing; 0: none */
    double debris;  /* radius of what touches it, in radii */
    double hole;    /* radius of a pale hole, in radii */
    double squeeze; /* one axis shorter by this share */
};

static double disc_at(double x, double y, double radius, double s)
{
    return 0.5 * erfc((hypot(x, y) - radius) / (s * M_SQRT2));
}

static void draw_faulty(struct gsn_point c, double radius, double contrast, struct fault fault,
                        struct draw_chance *chance)
{
    const double toward = draw_uniform(chance, 0, 2 * M_PI), ux = cos(toward), uy = sin(toward);
    double lobe[3][2];

    for (int m = 0; m < 3; m++)
        for (int k = 0; k < 2; k++)
            lobe[m][k] = fault.lobes * draw_normal(chance);
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        const double x = (double)(i % SIDE) + 0.5 - c.x, y = (double)(i / SIDE) + 0.5 - c.y;
        const double t = atan2(y, x), along = x * ux + y * uy, across = y * ux - x * uy;
        double edge = radius, a;

        for (int m = 0; m < 3; m++)
            edge += radius * (lobe[m][0] * cos((m + 2) * t) + lobe[m][1] * sin((m + 2) * t));
        a = disc_at(along / (1 - fault.squeeze), across, edge, 1.2);
        a *= 1 - disc_at(x, y, fault.hole * radius, 0.7) * (fault.hole > 0);
        if (fault.cut > 0)
            a *= 0.5 * erfc((along - fault.cut * radius) / (0.8 * M_SQRT2));
        if (fault.debris > 0) {
            const double far = (0.9 + fault.debris) * radius;

            a = fmax(a, disc_at(x - far * ux, y - far * uy, fault.debris * radius, 1.2));
        }
        value[i] = (float)(contrast * a);
    }
}

/* Root mean square error per coordinate over many such marks, in noise of sd; what they claim. */
static double error_of(struct fault fault, double radius, double contrast, double sd,
                       double *ret_claimed, double *ret_worst)
{
    struct draw_chance chance = { 11 };
    double squares = 0, claimed = 0;

    *ret_worst = 0;
    for (int n = 0; n < RUNS; n++) {
        const struct gsn_point c = { draw_uniform(&chance, 47, 49), draw_uniform(&chance, 47, 49) };
        const struct gsn_point start = { c.x + draw_uniform(&chance, -2, 2),
                                         c.y + draw_uniform(&chance, -2, 2) };
        struct gsn_error err = { 0 };
        struct gsn_fiducial mark;

        draw_faulty(c, radius, contrast, fault, &chance);
        draw_noise(&plane, &chance, sd);
        CHECK_OK(
            gsn_contour_fit(&plane, start, radius * draw_uniform(&chance, 0.85, 1.15), &mark, &err),
            err);
        CHECK(mark.found);
        squares += pow(mark.px.x - c.x, 2) + pow(mark.px.y - c.y, 2);
        claimed += mark.cov_xx + mark.cov_yy;
        *ret_worst = fmax(*ret_worst, hypot(mark.px.x - c.x, mark.px.y - c.y));
    }
    *ret_claimed = sqrt(claimed / (2 * RUNS));
    print_message("  rms %.4f, claimed %.4f, worst %.4f px\n", sqrt(squares / (2 * RUNS)),
                  *ret_claimed, *ret_worst);
    return sqrt(squares / (2 * RUNS));
}

/* DOMAIN.md 3.3. */
static double bound(double radius, double s, double q)
{
    return q * sqrt(2 * s / (sqrt(M_PI) * radius));
}

TEST(a_lobed_outline_costs_next_to_nothing)
{
    static const double radii[] = { 7, 9, 16 };

    for (size_t k = 0; k < sizeof radii / sizeof *radii; k++) {
        double claimed, worst;
        const double error =
            error_of((struct fault){ .lobes = 0.03 }, radii[k], 1, 0.03, &claimed, &worst);

        CHECK(error < 1.4 * bound(radii[k], 1.2, 0.03));
        CHECK(claimed / error > 0.85 && claimed / error < 1.5);
    }
}

TEST(an_ellipse_is_centred)
{
    double claimed, worst;

    CHECK(error_of((struct fault){ .squeeze = 0.1 }, 16, 1, 0.03, &claimed, &worst) <
          1.4 * bound(16, 1.2, 0.03));
}

/* A beam that meets the block aslant, or is not round itself: aspect 1.6. */
TEST(an_oval_is_centred_as_well_as_a_disc_and_says_how_well)
{
    double claimed, worst;
    const double error =
        error_of((struct fault){ .squeeze = 0.375 }, 16, 1, 0.03, &claimed, &worst);

    CHECK(error < 1.5 * bound(16, 1.2, 0.03) && worst < 0.05);
    CHECK(claimed / error > 0.5 && claimed / error < 2);
}

/* Three sectors in four of an oval lie near a circle beside its middle, pixels away. */
TEST(an_oval_is_not_taken_for_a_circle_beside_its_middle)
{
    const double radii[] = { 6.5, 7, 8, 10, 14, 18 }, squeezes[] = { 0.25, 0.3, 0.35 };
    double claimed, worst;

    for (size_t r = 0; r < sizeof radii / sizeof *radii; r++)
        for (size_t k = 0; k < 3; k++) {
            (void)error_of((struct fault){ .lobes = 0.01, .squeeze = squeezes[k] }, radii[r], 1,
                           0.02, &claimed, &worst);
            CHECK(worst < 0.2);
        }
}

/* Case 23: a third of the rim is gone, and what is left says where the centre is and how badly it
 * is known. */
TEST(a_mark_that_lost_an_arc_is_where_the_rest_puts_it)
{
    double claimed, whole_claimed, worst;
    const double whole =
        error_of((struct fault){ .lobes = 0.01 }, 16, 1, 0.03, &whole_claimed, &worst);
    const double error =
        error_of((struct fault){ .lobes = 0.01, .cut = 0.45 }, 16, 1, 0.03, &claimed, &worst);

    CHECK(error < 0.2 && worst < 1);
    CHECK(claimed > 2 * whole_claimed && error > whole);
    CHECK(claimed / error > 0.5 && claimed / error < 2);
}

TEST(debris_that_touches_a_mark_is_outvoted)
{
    double claimed, worst;
    const double error =
        error_of((struct fault){ .lobes = 0.02, .debris = 0.5 }, 16, 1, 0.03, &claimed, &worst);

    CHECK(error < 0.06 && worst < 0.25);
    CHECK(claimed / error > 0.5 && claimed / error < 2);
}

/* DOMAIN.md section 1: a burn may go through. */
TEST(a_hole_in_a_mark_is_not_its_edge)
{
    double claimed, worst;

    CHECK(error_of((struct fault){ .hole = 0.4 }, 16, 1, 0.03, &claimed, &worst) <
          1.4 * bound(16, 1.2, 0.03));
}

TEST(a_faint_mark_is_found_as_well_as_its_noise_lets_it)
{
    double claimed, worst;

    CHECK(error_of((struct fault){ .lobes = 0.02 }, 16, 0.2, 0.05, &claimed, &worst) <
          1.5 * bound(16, 1.2, 0.25));
}

/* Adds the mean of white noise over 5 by 5 pixels: of standard deviation sd, alike over some
 * pixels. */
static void draw_texture(struct draw_chance *chance, double sd)
{
    enum { WIDE = SIDE + 4 };
    static double white[WIDE * WIDE];

    for (size_t i = 0; i < WIDE * WIDE; i++)
        white[i] = draw_normal(chance) * sd / 5;
    for (size_t i = 0; i < SIDE * SIDE; i++)
        for (size_t k = 0; k < 25; k++)
            value[i] += (float)white[(i / SIDE + k / 5) * WIDE + i % SIDE + k % 5];
}

/* A faint disc lets the tissue's texture through, alike over some pixels: its edge is off by more
 * than noise of that size would move it. */
TEST(a_faint_mark_in_texture_knows_that_it_is_measured_worse)
{
    struct draw_chance chance = { 12 };
    double squares = 0, claimed = 0;

    for (int n = 0; n < RUNS; n++) {
        const struct gsn_point c = { draw_uniform(&chance, 47, 49), draw_uniform(&chance, 47, 49) };
        struct gsn_error err = { 0 };
        struct gsn_fiducial mark;

        draw_faulty(c, 16, 0.5, (struct fault){ .lobes = 0.02 }, &chance);
        draw_noise(&plane, &chance, 0.02);
        draw_texture(&chance, 0.03);
        CHECK_OK(gsn_contour_fit(&plane, (struct gsn_point){ 48, 48 }, 16, &mark, &err), err);
        CHECK(mark.found);
        squares += pow(mark.px.x - c.x, 2) + pow(mark.px.y - c.y, 2);
        claimed += mark.cov_xx + mark.cov_yy;
    }
    print_message("  rms %.4f, claimed %.4f px\n", sqrt(squares / (2 * RUNS)),
                  sqrt(claimed / (2 * RUNS)));
    CHECK(claimed / squares > 0.7 * 0.7 && claimed / squares < 1.4 * 1.4);
}

/* From half a radius off the edge the tissue of one side is darker: that says nothing of the edge.
 */
TEST(tissue_that_is_another_further_out_does_not_pull_the_mark)
{
    const double radius = 16;
    struct draw_chance chance = { 5 };
    double pull = 0;

    for (int n = 0; n < RUNS; n++) {
        const struct gsn_point c = { draw_uniform(&chance, 47, 49), draw_uniform(&chance, 47, 49) };
        struct gsn_error err = { 0 };
        struct gsn_fiducial mark;

        draw_faulty(c, radius, 1, (struct fault){ .lobes = 0.01 }, &chance);
        for (size_t i = 0; i < SIDE * SIDE; i++) {
            const double x = (double)(i % SIDE) + 0.5 - c.x, y = (double)(i / SIDE) + 0.5 - c.y;

            value[i] += x > 0 ? (float)(0.15 * (1 - disc_at(x, y, 1.5 * radius, 1.2))) : 0.0F;
        }
        draw_noise(&plane, &chance, 0.03);
        CHECK_OK(gsn_contour_fit(&plane, c, radius, &mark, &err), err);
        CHECK(mark.found);
        pull += (mark.px.x - c.x) / RUNS;
    }
    print_message("  pulled by %.4f px\n", pull);
    CHECK(fabs(pull) < 0.25 * bound(radius, 1.2, 0.03));
}

TEST(what_has_no_round_edge_is_no_mark)
{
    struct draw_chance chance = { 3 };
    struct gsn_error err = { 0 };
    struct gsn_fiducial mark;

    draw_fill(&plane, 0);
    draw_box(&plane, 20, 44, 60, 8, 1);
    draw_noise(&plane, &chance, 0.03);
    CHECK_OK(gsn_contour_fit(&plane, (struct gsn_point){ 48, 48 }, 16, &mark, &err), err);
    CHECK(!mark.found && mark.px.x == 0);
    draw_fill(&plane, 0);
    draw_noise(&plane, &chance, 0.03);
    CHECK_OK(gsn_contour_fit(&plane, (struct gsn_point){ 48, 48 }, 16, &mark, &err), err);
    CHECK(!mark.found);
}

static int fit_once(struct gsn_error *err)
{
    struct draw_chance chance = { 1 };
    struct gsn_fiducial mark;

    draw_faulty((struct gsn_point){ 48, 48 }, 12, 1, (struct fault){ 0 }, &chance);
    return gsn_contour_fit(&plane, (struct gsn_point){ 48, 48 }, 12, &mark, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(fit_once(&err), err);
}
