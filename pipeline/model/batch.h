/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline at many points. Far quicker a point than one at a time: neighbours in space are located
 * one from the other and share what their tetrahedron and their faces need. */
#ifndef GSN_MODEL_BATCH_H
#define GSN_MODEL_BATCH_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* s at count points in any order, and its gradients per um unless ret_gradient is NULL; NaN where
 * there is no data: outside the mesh, at coordinates that are not finite. The same bits for any
 * number of threads (0: as many as the process may use) and any instruction set. Fails with
 * GSN_E_NOMEM, the outputs untouched. */
int gsn_spline_eval_many(const struct gsn_spline *spline, const double (*at)[3], size_t count,
                         unsigned threads, double *ret_value, double (*ret_gradient)[3],
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
