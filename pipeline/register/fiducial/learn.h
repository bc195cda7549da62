/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the sections of a stack teach about its marks: their appearance, how far sections stretch,
 * what the tissue around them looks like, and which kind of burn they are. */
#ifndef GSN_REGISTER_FIDUCIAL_LEARN_H
#define GSN_REGISTER_FIDUCIAL_LEARN_H

#include "pipeline/core/error.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fills the learnt half of prior from the sections whose three marks are clear; leaves it as it is
 * when fewer than 3 are. Fails with GSN_E_NOMEM. */
int gsn_fiducials_learn(const struct gsn_fiducial_candidates *sections, size_t count,
                        struct gsn_triangle_prior *prior, struct gsn_error *err);

/* Which kind of burn the stack has, of gsn_burns. sections: those of the whole stack searched
 * for each kind, count of each, the ordinary kind first. mark_um: the triangle, or NULL where
 * nobody states it. The kind with which most sections show three marks, at least half of all and
 * more than the ordinary kind shows; among those within a tenth of the most, the one whose marks
 * lie most nearly as the triangle does. 0 where no other kind does better than the ordinary. Fails
 * with GSN_E_NOMEM. */
int gsn_fiducials_choose_burn(const struct gsn_fiducial_candidates *sections, size_t count,
                              const struct gsn_point *mark_um, unsigned *ret_burn,
                              struct gsn_error *err);

/* Whether that is worth asking: fewer than two in three sections show three marks of the ordinary
 * kind, or those that do are nearly too small or too large for it. Fails with GSN_E_NOMEM. */
int gsn_fiducials_are_odd(const struct gsn_fiducial_candidates *sections, size_t count,
                          const struct gsn_point *mark_um, int *ret_odd, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
