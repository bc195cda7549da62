/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Spots that a hasty eye takes for laser marks. */
#ifndef GSN_PHANTOM_DECOY_H
#define GSN_PHANTOM_DECOY_H

#include "pipeline/phantom/overlay.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Draws decoy number i of section k. What its parts are follows from the plan. */
void gsn_phantom_decoy_draw(const struct gsn_phantom_plan *plan, int k, int i,
                            const struct gsn_phantom_glass *glass);

const char *gsn_phantom_decoy_name(enum gsn_phantom_decoy_kind kind);

#ifdef __cplusplus
}
#endif
#endif
