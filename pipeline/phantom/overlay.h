/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What lies on the glass, drawn into the optical density of a whole panel after its sections. */
#ifndef GSN_PHANTOM_OVERLAY_H
#define GSN_PHANTOM_OVERLAY_H

#include "pipeline/phantom/panel.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Decoys, then hairs, bubbles, edges and pens, then defocus, of a panel, from 1. borrows: plan,
 * glass. Fails with GSN_E_NOMEM. */
int gsn_phantom_overlay_draw(const struct gsn_phantom_plan *plan, int panel,
                             const struct gsn_phantom_glass *glass, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
