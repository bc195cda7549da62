/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline.h"

#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/dms_internal.h"

#include <string.h>

static const size_t SMALL[3] = { 2, 2, 2 };

static void polynomial_hessian(const struct polynomial *p, const double u[3], double ret[6])
{
    memset(ret, 0, 6 * sizeof *ret);
    for (int j = 0; p->degree > 1 && j < 20; j++) {
        const double *a = p->slope[j];
        const double f = p->weight[j] * p->degree * (p->degree - 1) *
                         pow(gsn_dot(a, u) + p->constant[j], p->degree - 2.0);
        int n = 0;

        for (int r = 0; r < 3; r++) {
            for (int c = r; c < 3; c++)
                ret[n++] += f * a[r] * a[c];
        }
    }
}

/* In slivers, thin by a factor of thin, second derivatives are as large as the square of that. */
static void check_polynomial(struct gsn_dms *made, unsigned degree, double thin)
{
    uint64_t seed = 71;
    gsn_auto(gsn_dms) space = made;
    const struct polynomial p = draw_polynomial(degree, &seed);
    gsn_auto_mem(double) control = polynomial_controls(&p, space);
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_error err = { 0 };
    size_t hint = 0;

    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    for (size_t i = 0; i < 4 * gsn_dms_mesh(space)->tet_count; i++) {
        double u[3], own[6], truth[6];

        draw_in_skins(gsn_dms_mesh(space), i / 4, &seed, u);
        polynomial_hessian(&p, u, truth);
        CHECK(gsn_spline_hessian(spline, u, &hint, own) == GSN_OK);
        for (int k = 0; k < 6; k++)
            CHECK_NEAR(own[k], truth[k], 1e-8 / (thin * thin));
    }
}

TEST(a_polynomial_has_its_own_second_derivatives_in_cores_and_skins)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        check_polynomial(shrunk_space(SMALL, 0.2, degree, 1, GSN_DMS_SHARED), degree, 1);
        check_polynomial(shrunk_space(SMALL, 0.2, degree, 1, GSN_DMS_OWN), degree, 1);
        check_polynomial(shrunk_space(SMALL, 0.2, degree, 0, GSN_DMS_SHARED), degree, 1);
        check_polynomial(shrunk_space(SMALL, 0.2, degree, 0, GSN_DMS_OWN), degree, 1);
        check_polynomial(flat_space(SMALL, 0.2, degree, 1e-4, GSN_DMS_SHARED), degree, 1e-4);
    }
}

static double slope_at(const struct gsn_dms *space, const struct gsn_spline *spline,
                       const double u[3], int along, double step, int of)
{
    const double v[3] = { u[0] + (along == 0 ? step : 0), u[1] + (along == 1 ? step : 0),
                          u[2] + (along == 2 ? step : 0) };
    double gradient[3];

    (void)formula_at(space, gsn_spline_controls(spline), v, gradient);
    return gradient[of];
}

/* For degree 2 they jump at knot planes: where the two halves of a difference disagree, one lies
 * between. */
TEST(second_derivatives_are_the_limit_of_differences_of_the_gradient)
{
    const double h = 1e-6;
    uint64_t seed = 73;

    for (unsigned degree = 2; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.2, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);
        size_t hint = 0, compared = 0, all = 0;

        for (size_t i = 0; i < gsn_dms_mesh(space)->tet_count; i++) {
            double u[3], own[6], largest = 1;
            int n = 0;

            draw_in_skins(gsn_dms_mesh(space), i, &seed, u);
            CHECK(gsn_spline_hessian(spline, u, &hint, own) == GSN_OK);
            for (int k = 0; k < 6; k++)
                largest = fmax(largest, fabs(own[k]));
            for (int r = 0; r < 3; r++) {
                for (int c = r; c < 3; c++, n++) {
                    const double here = slope_at(space, spline, u, c, 0, r);
                    const double up = (slope_at(space, spline, u, c, h, r) - here) / h;
                    const double down = (here - slope_at(space, spline, u, c, -h, r)) / h;

                    all++;
                    if (fabs(up - down) > 1e-2 * largest)
                        continue;
                    compared++;
                    CHECK_NEAR(own[n], (up + down) / 2, 1e-2 * largest);
                }
            }
        }
        CHECK(compared > 0.95 * (double)all);
    }
}

TEST(where_there_is_no_data_there_are_no_second_derivatives)
{
    const double strange[5][3] = {
        { NAN, 1, 1 }, { 1, INFINITY, 1 }, { 1, 1, -1e300 }, { 1e9, 1e9, 1e9 }, { 1, 1, 2.001 }
    };
    uint64_t seed = 75;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, 2, 0.05, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);

    for (int i = 0; i < 5; i++) {
        double own[6] = { 99, 99, 99, 99, 99, 99 };
        size_t hint = 7;

        CHECK(gsn_spline_hessian(spline, strange[i], &hint, own) == GSN_DMS_OUTSIDE);
        for (int k = 0; k < 6; k++)
            CHECK(own[k] == 99);
        CHECK(hint == 7);
    }
}
