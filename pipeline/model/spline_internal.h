/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of the spline share behind spline.h. */
#ifndef GSN_MODEL_SPLINE_INTERNAL_H
#define GSN_MODEL_SPLINE_INTERNAL_H

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/spline.h"

struct gsn_spline {
    const struct gsn_dms *space;
    double *control;
    double *bernstein; /* of the polynomial of each tetrahedron, functions per tetrahedron */
};

/* The control values of one tetrahedron in the order of its functions. */
static inline void gsn_spline_gather(const struct gsn_spline *spline, size_t tet,
                                     double ret_control[GSN_DMS_MAX_FUNCTIONS])
{
    const uint32_t *id = gsn_dms_control_ids(spline->space, tet);

    for (size_t f = 0; f < gsn_dms_functions(spline->space); f++)
        ret_control[f] = spline->control[id[f]];
}

#endif
