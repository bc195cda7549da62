/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"
#include "pipeline/phantom/stain.h"

/* The dyes of the specification, normalised. */
static double dye(double r, double g, double b, int channel)
{
    const double v[3] = { r, g, b };

    return v[channel] / sqrt(r * r + g * g + b * b);
}

static double plain_density(double red, double yellow, double nuclear, int c)
{
    return red * dye(.239, .716, .655, c) + yellow * dye(.357, .326, .875, c) +
           nuclear * dye(.52, .60, .61, c);
}

/* Three fifths bone and two fifths marrow at the edge of the tissue, in the lesion. */
static struct gsn_phantom_field mixture(void)
{
    return (struct gsn_phantom_field){
        .tissue = 0.9,
        .layer = { [GSN_PHANTOM_BONE] = 0.6, [GSN_PHANTOM_MARR] = 0.4 },
        .lesion = 0.5,
        .intact = 0.7,
        .lost = 0.3,
    };
}

static void check_density(const struct gsn_phantom_stain *stain,
                          const struct gsn_phantom_local *local, double red, double yellow,
                          double nuclear)
{
    const struct gsn_phantom_field field = mixture();
    double od[3];

    gsn_phantom_optical_density(&field, stain, local, od);
    for (int c = 0; c < 3; c++)
        CHECK_NEAR(od[c], plain_density(red, yellow, nuclear, c), 1e-12);
}

TEST(dyes_follow_the_density_that_the_lesion_leaves)
{
    const struct gsn_phantom_stain stain = { 1, 1, 0, 0.5, NULL };
    const struct gsn_phantom_local local = { .nuclei = 0 };
    const double D = 0.7 - 0.5 * 0.3;

    check_density(&stain, &local, .62 * D, .34 * .9 * (1 - .55 * D), 0);
}

TEST(gains_ramp_texture_and_nuclei_each_act_once)
{
    const struct gsn_phantom_stain stain = { 1.15, 0.8, 0.05, 0, NULL };
    const struct gsn_phantom_local local = { 1.3, -0.4, 0.25, 2 };
    const double amp = 0.6 * .25 + 0.4 * .45;

    check_density(&stain, &local, 1.15 * .62 * .7 * (1 + amp * 1.3) * (1 + 2 * .05 * .25),
                  .8 * .34 * .9 * (1 - .55 * .7) * (1 - amp * .4), .45 * 2 / 6);
}

/* Dyes along the axes make each channel the amount of one dye. */
TEST(a_batch_brings_its_own_dyes)
{
    static const double axes[GSN_PHANTOM_DYES][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };
    const struct gsn_phantom_stain stain = { 1, 1, 0, 0, axes };
    const struct gsn_phantom_local local = { .nuclei = 3 };
    const struct gsn_phantom_field field = mixture();
    double od[3];

    gsn_phantom_optical_density(&field, &stain, &local, od);
    CHECK_NEAR(od[0], .62 * .7, 1e-12);
    CHECK_NEAR(od[1], .34 * .9 * (1 - .55 * .7), 1e-12);
    CHECK_NEAR(od[2], .45 / 2, 1e-12);
}

TEST(texture_and_nuclei_are_limited)
{
    const struct gsn_phantom_stain stain = { 1, 1, 0, 0, NULL };
    const struct gsn_phantom_local local = { -4, -4, 0, 9 };

    check_density(&stain, &local, .62 * .7 * .05, .34 * .9 * (1 - .55 * .7) * .05, .45);
}

TEST(cells_gather_where_bone_is_lost)
{
    const struct gsn_phantom_field field = mixture();

    CHECK_NEAR(gsn_phantom_nuclei_mean(&field, 0), 6 * .9 * (.6 * .02 + .4 * .35), 1e-12);
    CHECK_NEAR(gsn_phantom_nuclei_mean(&field, .8),
               6 * .9 * (.6 * .02 + .4 * .35 + .35 * .8 * .5 * .6), 1e-12);
}

TEST(a_mark_is_a_dark_disc_in_a_bleached_ring)
{
    double inside[3] = { .3, .4, .5 }, edge[3] = { .3, .4, .5 };
    double ring[3] = { .3, .4, .5 }, beyond[3] = { .3, .4, .5 };

    gsn_phantom_burn(gsn_phantom_burning(), 0, inside);
    gsn_phantom_burn(gsn_phantom_burning(), 75, edge);
    gsn_phantom_burn(gsn_phantom_burning(), 95, ring);
    gsn_phantom_burn(gsn_phantom_burning(), 130, beyond);
    for (int c = 0; c < 3; c++) {
        const double before = beyond[c], mark = 1.15 * dye(.50, .60, .63, c);

        CHECK_NEAR(before, .3 + .1 * c, 1e-12);
        CHECK_NEAR(inside[c], mark, 1e-12);
        /* On the rim a = 1/2 and h = 1/2. */
        CHECK_NEAR(edge[c], before * (1 - .65 / 2) / 2 + mark / 2, 1e-12);
        CHECK_NEAR(ring[c], .35 * before, 1e-12);
    }
}
