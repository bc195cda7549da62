/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The mean of a spline over a tetrahedron of its mesh: that of its polynomial, and what the seams
 * of the faces around add. */
#include "pipeline/model/seam.h"
#include "pipeline/model/spline_internal.h"

#include <string.h>

/* Whether a plane of the prism has the whole cell beyond it. */
static int misses(const struct gsn_prism *prism, const double (*corner)[3])
{
    double d[4][3];

    for (int k = 0; k < 4; k++)
        gsn_subtract(corner[k], prism->origin, d[k]);
    for (int i = 0; i < 5; i++) {
        int beyond = 0;

        for (int k = 0; k < 4; k++)
            beyond += gsn_dot(prism->inside[i], d[k]) + prism->inside[i][3] < 0;
        if (beyond == 4)
            return 1;
    }
    return 0;
}

/* What the faces that belong to one tetrahedron add to the integral over the cell. */
static double faces_of(const struct gsn_spline *spline, size_t tet, const double (*corner)[3])
{
    double sum = 0;

    for (unsigned k = 0; k < 4; k++) {
        struct gsn_prism prism;
        struct gsn_seam seam;

        if (!gsn_prism_init(spline->space, tet, k, &prism) || misses(&prism, corner))
            continue;
        gsn_seam_init(&seam, spline->space, &prism, spline->control);
        sum += gsn_seam_integral(&seam, corner);
    }
    return sum;
}

int gsn_spline_tet_mean(const struct gsn_spline *spline, size_t tet, double *ret_mean,
                        struct gsn_error *err)
{
    const struct gsn_tets *mesh = spline->space->mesh;
    const size_t functions = gsn_dms_functions(spline->space);
    double corner[4][3], mean = 0, seams = 0;
    struct gsn_ascent ascent;
    struct gsn_box box;

    if (tet >= mesh->tet_count)
        return gsn_fail(err, GSN_E_INPUT, "tetrahedron %zu of %zu", tet, mesh->tet_count);
    for (size_t f = 0; f < functions; f++)
        mean += spline->bernstein[tet * functions + f];
    for (int k = 0; k < 4; k++)
        memcpy(corner[k], mesh->vertex[mesh->tet[tet][k]], sizeof corner[k]);
    box = gsn_box_around((const double(*)[3])corner, 4);
    gsn_ascent_begin(&ascent);
    do {
        (void)gsn_boxtree_meeting(spline->space->tree, &box, gsn_ascent_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            seams += faces_of(spline, ascent.item[i], (const double(*)[3])corner);
    } while (gsn_ascent_next(&ascent));
    *ret_mean = mean / (double)functions + seams / gsn_tets_volume(mesh, tet);
    return GSN_OK;
}
