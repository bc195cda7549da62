/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/seam.h"

#include "tests/check.h"
#include "tests/model/golden.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/spline.h"

#include <stdio.h>
#include <string.h>

/* s and its gradient by the identity of seam.h, from every face of the mesh. */
static int eval(const struct gsn_dms *space, const struct gsn_spline *spline, const double u[3],
                double *ret_value, double ret_slope[3])
{
    const double *at[3] = { &u[0], &u[1], &u[2] };
    double *slope[3] = { &ret_slope[0], &ret_slope[1], &ret_slope[2] };
    double bernstein[GSN_DMS_MAX_FUNCTIONS], lambda[4];
    struct gsn_frame frame;
    const uint32_t *v;
    size_t home;

    if (gsn_dms_locate(space, u, 0, &home) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    v = space->mesh->tet[home];
    gsn_frame_init(&frame, space->mesh->vertex[v[0]], space->mesh->vertex[v[1]],
                   space->mesh->vertex[v[2]], space->mesh->vertex[v[3]]);
    gsn_frame_at(&frame, u, lambda);
    gsn_spline_bernstein(spline, home, bernstein);
    *ret_value = gsn_bernstein_at(space->degree, bernstein, &frame, lambda, ret_slope);
    for (size_t t = 0; t < space->mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            struct gsn_prism prism;
            struct gsn_seam seam;
            int unclear;

            if (!gsn_prism_init(space, t, k, &prism))
                continue;
            unclear = gsn_prism_at(&prism, u);
            if (unclear < 0)
                continue;
            gsn_seam_init(&seam, space, &prism, gsn_spline_controls(spline));
            gsn_seam_add(&seam, (unsigned)unclear, at, 1, ret_value, slope);
        }
    }
    return GSN_OK;
}

static double largest_slope(const struct golden_table *spline)
{
    double largest = 0;

    for (size_t i = 0; i < spline->rows; i++) {
        for (int c = 0; c < 3; c++)
            largest = fmax(largest, fabs(golden_row(spline, i)[3 + c]));
    }
    return largest;
}

static void check_golden(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table exact = golden_read(golden, "spline");
    const double steepest = largest_slope(&exact);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(golden->space, golden->control, &spline, &err), err);
    for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
        if (!gsn_kernels_for((enum gsn_isa)isa))
            continue;
        gsn_dms_use(golden->space, gsn_kernels_for((enum gsn_isa)isa));
        for (size_t p = 0; p < points.rows; p++) {
            const double *row = golden_row(&exact, p);
            double value, slope[3];

            if (eval(golden->space, spline, golden_row(&points, p) + 2, &value, slope) != GSN_OK)
                continue;
            if (fabs(value - row[2]) > 1e-12)
                printf("%s isa %d point %zu %s: %.17g %.17g\n", golden->folder, isa, p,
                       points.kind[p], value, row[2]);
            CHECK_NEAR(value, row[2], 1e-12);
            for (int c = 0; c < 3; c++) {
                if (fabs(slope[c] - row[3 + c]) > 1e-10 * steepest)
                    printf("%s isa %d point %zu %s slope: %.17g %.17g\n", golden->folder, isa, p,
                           points.kind[p], slope[c], row[3 + c]);
                CHECK_NEAR(slope[c], row[3 + c], 1e-10 * steepest);
            }
        }
    }
    gsn_spline_free(spline);
    golden_done(&points);
    golden_done(&exact);
}

TEST(the_seams_complete_the_polynomials_to_the_exact_spline)
{
    golden_each(check_golden);
}
