/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Laws of the whole theory (docs/MATH.md) that belong to no file of the product alone. */
#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/spline.h"

#include <string.h>

static const size_t SMALL[3] = { 2, 2, 2 };

/* gives: the spline that is 1 wherever the functions sum to one. */
static struct gsn_spline *one_on(const struct gsn_dms *space)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 1;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    return spline;
}

/* A grid of sixteenths has points on all mesh planes, edges and vertices of the cubes. */
TEST(the_functions_sum_to_one_within_1e_13_on_a_voxel_grid_in_the_mesh_planes)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0, degree, 0.05, GSN_DMS_SHARED);
        gsn_auto(gsn_spline) one = one_on(space);
        size_t hint = 0;

        for (int i = 0; i < 32 * 32 * 32; i += 3) {
            const double u[3] = { i % 32 / 16.0, i / 32 % 32 / 16.0, i / 1024 / 16.0 };
            double sum;

            CHECK(gsn_spline_eval(one, u, &hint, &sum, NULL) == GSN_OK);
            CHECK_NEAR(sum, 1, 1e-13);
            if (i % 7 == 0)
                CHECK_NEAR(formula_at(space, gsn_spline_controls(one), u, NULL), 1, 1e-13);
        }
    }
}

static double mean_over(const struct gsn_spline *spline, const double cell[4][3])
{
    struct gsn_error err = { 0 };
    double mean = NAN;

    CHECK_OK(gsn_spline_cell_mean(spline, cell, &mean, &err), err);
    return mean;
}

/* With all knots of a vertex on it the functions sum to one inside the domain and to nothing
 * outside: the mean of 1 is the share of the cell inside. Beyond a face the corner that sticks out
 * is a smaller copy of the cell. */
TEST(the_mean_of_one_is_the_share_of_the_cell_in_the_domain)
{
    const double inside[4][3] = {
        { 0.1, 0.2, 0.1 }, { 1.9, 0.3, 0.4 }, { 0.7, 1.8, 0.2 }, { 0.6, 0.9, 1.7 }
    };
    const double across[4][3] = {
        { 1.5, 0.5, 0.5 }, { 2.5, 0.5, 0.5 }, { 1.5, 1.1, 0.5 }, { 1.5, 0.5, 0.9 }
    };
    const double around[4][3] = { { -1, -1, -1 }, { 9, -1, -1 }, { -1, 9, -1 }, { -1, -1, 9 } };
    const double beyond[4][3] = { { 3, 0, 0 }, { 4, 0, 0 }, { 3, 1, 0 }, { 3, 0, 1 } };

    for (unsigned degree = 1; degree <= 2; degree++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0, degree, 0, GSN_DMS_SHARED);
        gsn_auto(gsn_spline) one = one_on(space);

        CHECK_NEAR(mean_over(one, inside), 1, 1e-12);
        CHECK_NEAR(mean_over(one, across), 0.875, 1e-12);
        CHECK_NEAR(mean_over(one, around), 8 / (1000 / 6.0), 1e-12);
        CHECK_NEAR(mean_over(one, beyond), 0, 0);
    }
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_SHARED);
        gsn_auto(gsn_spline) one = one_on(space);

        CHECK_NEAR(mean_over(one, inside), 1, degree == 3 ? 1e-9 : 1e-10);
    }
}

TEST(the_order_of_a_cells_corners_does_not_matter)
{
    const double tolerance[4] = { 0, 1e-12, 1e-10, 1e-7 };
    uint64_t seed = 111;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);
        double cell[4][3], first;

        for (int i = 0; i < 12; i++)
            cell[i / 3][i % 3] = 2.4 * draw(&seed) - 0.2;
        first = mean_over(spline, (const double(*)[3])cell);
        for (unsigned i = 0; i < 256; i++) {
            const unsigned order[4] = { i & 3, i >> 2 & 3, i >> 4 & 3, i >> 6 };
            double turned[4][3];

            if ((1u << order[0] | 1u << order[1] | 1u << order[2] | 1u << order[3]) != 15)
                continue;
            for (int k = 0; k < 4; k++)
                memcpy(turned[k], cell[order[k]], sizeof turned[k]);
            CHECK_NEAR(mean_over(spline, (const double(*)[3])turned), first, tolerance[degree]);
        }
    }
}
