/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Vertices and tetrahedra in the order of space: neighbours in space are neighbours in memory, and
 * a mesh has one order whoever made it. */
#ifndef GSN_MODEL_DOMAIN_ORDER_H
#define GSN_MODEL_DOMAIN_ORDER_H

#include "pipeline/model/tetgen_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Sorts vertices, and tetrahedra by their centroids, by Morton code over the bounding box (21 bits
 * an axis, equal codes in the old order), and each tetrahedron's corners ascending. The caller
 * guarantees finite coordinates and corners in range. Fails with GSN_E_NOMEM. */
int gsn_domain_order(struct gsn_soup *soup, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
