/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A finer mesh of the same domain: longest-edge bisection. */
#ifndef GSN_MODEL_BISECTION_H
#define GSN_MODEL_BISECTION_H

#include "pipeline/model/tets.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: a refinement in which no tetrahedron inside tetrahedron t is larger than max_um3[t] (0: no
 * limit). Each tetrahedron of it lies inside one of the mesh, so the domain, its boundary and every
 * inner face stay; the order is that of gsn_domain_order(). Source: Rivara 1997.
 * borrows: max_um3, one for each tetrahedron. Fails with GSN_E_INPUT on a limit that is no volume,
 * GSN_E_LIMIT beyond 2^24 tetrahedra, GSN_E_NOMEM. */
int gsn_tets_bisect(const struct gsn_tets *mesh, const double *max_um3, struct gsn_tets **ret_mesh,
                    struct gsn_error *err);

/* The same in another order: the vertices of the mesh come first, as they were, new ones behind. */
int gsn_tets_bisect_behind(const struct gsn_tets *mesh, const double *max_um3,
                           struct gsn_tets **ret_mesh, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
