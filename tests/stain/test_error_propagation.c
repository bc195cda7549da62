/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/unmixing.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <math.h>
#include <string.h>

#define RAD (M_PI / 180)

/* What a tissue of this collagen density holds: yellow makes room for red. */
struct tissue {
    double density, nuclei;
};

static void densities_of(const struct tissue *tissue, const struct gsn_dyes *dyes, double ret_od[3])
{
    const double amount[3] = { dyes->full_red_od * tissue->density,
                               0.34 * (1 - 0.55 * tissue->density), 0.45 * tissue->nuclei };

    for (int c = 0; c < 3; c++)
        ret_od[c] =
            amount[0] * dyes->red[c] + amount[1] * dyes->yellow[c] + amount[2] * dyes->dark[c];
}

static double red_by(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS],
                     const double od[3])
{
    const struct gsn_dyes turned = gsn_dyes_rotated(dyes, turn);
    struct gsn_error err = { 0 };
    struct gsn_unmixer mix;

    CHECK_OK(gsn_unmixer_init(&mix, &turned, &err), err);

    double amount = 0;

    for (int k = 0; k < 3; k++) {
        const double *v = k == 0 ? turned.red : k == 1 ? turned.yellow : turned.dark;

        for (int c = 0; c < 3; c++)
            amount += mix.inverse[7][0][k] * v[c] * od[c];
    }
    return amount / dyes->full_red_od;
}

static struct gsn_vector_error turned_of(const struct tissue *tissue)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_vector_error turned = { 0 };
    struct gsn_error err = { 0 };
    double od[3];

    densities_of(tissue, &dyes, od);
    CHECK_OK(gsn_vector_error_add(&turned, &dyes, od, 1, &err), err);
    return turned;
}

TEST(red_moves_with_each_turn_as_unmixing_with_turned_vectors_says)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct tissue bone = { 0.8, 0.2 };
    const struct gsn_vector_error turned = turned_of(&bone);
    double od[3];

    densities_of(&bone, &dyes, od);
    CHECK_NEAR(turned.red, 0.8, 1e-9);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        double there[2][GSN_DYE_ROTATIONS] = { { 0 } };

        there[0][m] = -1e-4;
        there[1][m] = 1e-4;
        CHECK_NEAR(turned.by_turn[m],
                   (red_by(&dyes, there[1], od) - red_by(&dyes, there[0], od)) / 2e-4, 1e-5);
    }
}

TEST(tissue_that_is_added_twice_is_the_mean_by_weight)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct tissue parts[] = { { 0.8, 0 }, { 0.2, 0.1 } };
    const struct gsn_vector_error one = turned_of(&parts[0]), other = turned_of(&parts[1]);
    struct gsn_vector_error both = { 0 };
    struct gsn_error err = { 0 };

    for (int k = 0; k < 2; k++) {
        double od[3];

        densities_of(&parts[k], &dyes, od);
        CHECK_OK(gsn_vector_error_add(&both, &dyes, od, k ? 30 : 10, &err), err);
    }
    CHECK_NEAR(both.red, 0.35, 1e-9);
    CHECK_NEAR(both.weight, 40, 0);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        CHECK_NEAR(both.by_turn[m], 0.25 * one.by_turn[m] + 0.75 * other.by_turn[m], 1e-9);
}

/* All vectors, each to either way, by this much. */
static void spread(double deviation, double ret[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    memset(ret, 0, sizeof(double[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS]));
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        ret[m][m] = deviation * deviation;
}

static struct gsn_vector_error_left left_of(const struct tissue *untreated, size_t count,
                                            const struct tissue *region, double deviation)
{
    struct gsn_vector_error tissue[3] = { { 0 } };
    const struct gsn_vector_error of_region = turned_of(region);
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS];

    for (size_t k = 0; k < count; k++)
        tissue[k] = turned_of(&untreated[k]);
    spread(deviation, covariance);
    return gsn_vector_error_left_of(tissue, 3, &of_region, covariance);
}

static const struct tissue UNTREATED[] = { { 0.88, 0 }, { 0.2, 0 }, { 0.55, 0 } };

/* Yellow that makes room for red in proportion lies on the line; nuclei that a lesion brings do
 * not. */
TEST(what_lies_on_the_line_of_untreated_tissue_is_taken_out)
{
    const struct tissue pale = { 0.5, 0 }, inflamed = { 0.5, 0.25 };
    const struct gsn_vector_error_left clean = left_of(UNTREATED, 3, &pale, 3 * RAD);
    const struct gsn_vector_error_left lesion = left_of(UNTREATED, 3, &inflamed, 3 * RAD);

    CHECK(clean.known && lesion.known);
    CHECK_NEAR(clean.off, 0, 1e-12);
    CHECK_NEAR(gsn_vector_error_of_loss(&clean, 1), 0, 1e-6);
    CHECK(gsn_vector_error_of_loss(&clean, 0.6) > 0.01); /* zero itself is not known */
    CHECK(gsn_vector_error_of_loss(&lesion, 1) > 0.05);
}

/* The line of untreated tissue as unmixed with turned vectors, and a treated density off it: the
 * ratio to what an untreated 0.84 reads. */
static double ratio_with(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS],
                         const struct tissue *region)
{
    double x = 0, y = 0, xx = 0, xy = 0, od[3];

    for (int k = 0; k < 3; k++) {
        const double there = UNTREATED[k].density;
        double here;

        densities_of(&UNTREATED[k], dyes, od);
        here = red_by(dyes, turn, od);
        x += there / 3;
        y += here / 3;
        xx += there * there / 3;
        xy += there * here / 3;
    }
    const double gain = (xy - x * y) / (xx - x * x);

    densities_of(region, dyes, od);
    return red_by(dyes, turn, od) / (y + gain * (0.84 - x));
}

/* Tissue off the line, and tissue of which so much was lost that zero counts as much. */
TEST(the_error_is_what_turned_vectors_do_to_a_ratio)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct tissue regions[] = { { 0.53, 0.2 }, { 0.3, 0.02 } };
    const double none[GSN_DYE_ROTATIONS] = { 0 }, deviation = 0.2 * RAD;
    enum { DRAWS = 4000 };

    for (int k = 0; k < 2; k++) {
        const double ratio = ratio_with(&dyes, none, &regions[k]);
        const struct gsn_vector_error_left left = left_of(UNTREATED, 3, &regions[k], deviation);
        struct dice dice = { 3 };
        double squares = 0;

        CHECK_NEAR(ratio, regions[k].density / 0.84, 1e-9);
        for (int i = 0; i < DRAWS; i++) {
            double turn[GSN_DYE_ROTATIONS], off;

            for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
                turn[m] = deviation * dice_normal(&dice);
            off = ratio_with(&dyes, turn, &regions[k]) / ratio - 1;
            squares += off * off / DRAWS;
        }
        /* A deviation by 4000 draws is known to 1.1 %. */
        CHECK_NEAR(gsn_vector_error_of_loss(&left, ratio) / sqrt(squares), 1, 0.04);
    }
}

TEST(without_a_line_nothing_is_known)
{
    const struct tissue alike[] = { { 0.5, 0 }, { 0.52, 0.1 } }, region = { 0.5, 0 };
    const struct gsn_vector_error none = { 0 };
    struct gsn_vector_error tissue[2] = { turned_of(&UNTREATED[0]), turned_of(&UNTREATED[1]) };
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS];

    spread(0.05, covariance);
    CHECK(!left_of(UNTREATED, 1, &region, 0.05).known);
    CHECK(!left_of(alike, 2, &region, 0.05).known);
    CHECK(left_of(UNTREATED, 2, &region, 0.05).known);
    CHECK(!gsn_vector_error_left_of(tissue, 2, &none, covariance).known);
}

TEST(vectors_in_one_plane_are_refused)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_vector_error turned = { .red = 7, .weight = 2 };
    struct gsn_error err = { 0 };

    memcpy(dyes.dark, dyes.red, sizeof dyes.dark);
    CHECK(gsn_vector_error_add(&turned, &dyes, (const double[3]){ 0.1, 0.3, 0.3 }, 1, &err) ==
          GSN_E_STAIN);
    CHECK(strstr(err.text, "lie in one plane") != NULL);
    CHECK_NEAR(turned.red, 7, 0);
    CHECK_NEAR(turned.weight, 2, 0);
}

/* The zero of the line through three tissues, by least squares. */
static double zero_of(const double density[3], const double red[3])
{
    const double x = (density[0] + density[1] + density[2]) / 3;
    const double y = (red[0] + red[1] + red[2]) / 3;
    double xx = 0, xy = 0;

    for (int k = 0; k < 3; k++) {
        xx += (density[k] - x) * (density[k] - x);
        xy += (density[k] - x) * (red[k] - y);
    }
    return y - xy / xx * x;
}

/* 400 baths, each of which turns all vectors by a degree either way: from where they put density 0
 * the degree is told. */
TEST(what_baths_turn_by_is_told_by_where_they_put_density_zero)
{
    enum { BATHS = 400 };
    static const struct tissue kind[3] = { { 0.85, 0.02 }, { 0.2, 0.1 }, { 0.55, 0 } };
    static const double density[3] = { 0.85, 0.2, 0.55 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_vector_error tissue[3];
    struct gsn_vector_scatter scatter;
    struct dice dice = { 81 };
    double squares = 0;

    for (int k = 0; k < 3; k++)
        tissue[k] = turned_of(&kind[k]);
    for (int i = 0; i < BATHS; i++) {
        double turn[GSN_DYE_ROTATIONS], red[3], od[3];

        for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
            turn[m] = RAD * dice_normal(&dice);
        for (int k = 0; k < 3; k++) {
            densities_of(&kind[k], &dyes, od);
            red[k] = red_by(&dyes, turn, od);
        }
        squares += pow(zero_of(density, red), 2) / BATHS;
    }
    scatter = gsn_vector_scatter_of(tissue, 3, squares, BATHS);
    CHECK_NEAR(sqrt(scatter.variance) / RAD, 1, 0.1);
    CHECK_NEAR(scatter.freedom, BATHS, 0);
    CHECK_NEAR(gsn_vector_scatter_deviation(&scatter) / RAD, 1, 0.1);
    scatter = gsn_vector_scatter_of(tissue, 1, squares, BATHS); /* no line through one */
    CHECK(scatter.freedom == 0 && gsn_vector_scatter_deviation(&scatter) == 0);
}

TEST(few_panels_may_turn_by_more_than_they_show_and_two_specimens_show_more)
{
    const struct gsn_vector_scatter none = { 0 }, few = { 4e-4, 2 }, more = { 1e-4, 4 };
    const struct gsn_vector_scatter both = gsn_vector_scatter_pool(&few, &more);

    CHECK_NEAR(gsn_vector_scatter_deviation(&few), 0.02 * sqrt(3), 1e-12);
    CHECK_NEAR(gsn_vector_scatter_deviation(&more), 0.01 * sqrt(2), 1e-12);
    CHECK_NEAR(both.variance, 2e-4, 1e-15);
    CHECK_NEAR(both.freedom, 6, 0);
    CHECK(gsn_vector_scatter_pool(&none, &more).variance == more.variance);
    CHECK(gsn_vector_scatter_pool(&none, &none).freedom == 0);
}
