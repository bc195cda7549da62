/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Makes the plan of a specimen: poses, stains, files, and what goes wrong with it: lost sections,
 * marks that are missing or misshapen, decoys and defects. At levels that are not handled the marks
 * are perfect and nothing goes wrong, but for what a variant wants. */
#ifndef GSN_PHANTOM_PLANNING_H
#define GSN_PHANTOM_PLANNING_H

#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Plans a specimen at level "L0".."L3", 4 to 48 um/px, 0 for what is usual. Fails with
 * GSN_E_NOTFOUND for a name nobody defined, GSN_E_LIMIT for the pixel size, GSN_E_NOMEM. */
int gsn_phantom_plan_make(const char *specimen, const char *level, uint64_t seed, double px_um,
                          struct gsn_phantom_plan *ret_plan, struct gsn_error *err);
/* The same, of a variant. keeps: its text. Fails with GSN_E_LIMIT too when its lesion is deeper
 * than there is tissue, or its block fills no panel. */
int gsn_phantom_plan_make_variant(const char *specimen, const char *level, uint64_t seed,
                                  double px_um, const struct gsn_phantom_variant *variant,
                                  struct gsn_phantom_plan *ret_plan, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
