/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Deals out to a planned specimen what goes wrong with it: lost sections, marks that are missing or
 * misshapen, decoys and defects. */
#ifndef GSN_PHANTOM_MISHAP_H
#define GSN_PHANTOM_MISHAP_H

#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fills in marks, decoys and defects, and takes sections away; the sections must lie already. At
 * levels that are not handled the marks are perfect and nothing else happens, but for what a
 * variant wants. */
void gsn_phantom_mishaps_draw(struct gsn_phantom_plan *plan);

#ifdef __cplusplus
}
#endif
#endif
