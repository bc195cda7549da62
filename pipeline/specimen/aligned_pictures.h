/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections as they lie in the block, all of the same square of it: each as a small picture of
 * the report, which a person scrolls through to see whether a registration is to be believed, and
 * as a large one of the page beside it, with what of it is not measured.
 *
 * Panels are opened one after the other, so what each shows is gathered as it comes. The small ones
 * are coded at the end, when it is known how well all of them can be kept in what they may weigh
 * together; the large ones at once, for together they are too many pixels to hold. */
#ifndef GSN_SPECIMEN_ALIGNED_PICTURES_H
#define GSN_SPECIMEN_ALIGNED_PICTURES_H

#include "pipeline/specimen/density_stack.h"
#include "pipeline/specimen/scan.h"

/* Bytes of all small pictures together, so that a page with them stays below 3 MB; and about how
 * many all large ones take. */
enum { GSN_ALIGNED_BYTES = 360000, GSN_GLASS_BYTES = 9000000 };

/* Opaque. */
struct gsn_aligned_pictures;

/* gives: room for the pictures; NULL when fewer than two sections are used. Fails with
 * GSN_E_NOMEM. */
int gsn_aligned_pictures_new(const struct gsn_poses *poses,
                             struct gsn_aligned_pictures **ret_pictures, struct gsn_error *err);
void gsn_aligned_pictures_free(struct gsn_aligned_pictures *pictures);
GSN_DEFINE_AUTO(gsn_aligned_pictures);

/* Takes what an opened panel of this number shows, and codes the large pictures into the stack's
 * sections; pictures may be NULL. Does not depend on threads. Fails with GSN_E_NOMEM. */
int gsn_aligned_pictures_look(struct gsn_aligned_pictures *pictures, const struct gsn_poses *poses,
                              const struct gsn_scan *scan, unsigned panel, unsigned threads,
                              struct gsn_densities *densities, struct gsn_error *err);

/* Codes what of the panel's sections is not measured into the stack's; pictures may be NULL. Fails
 * with GSN_E_NOMEM. */
int gsn_aligned_pictures_mask(const struct gsn_aligned_pictures *pictures,
                              const struct gsn_poses *poses,
                              const struct gsn_artefact_labels *labels, unsigned panel,
                              struct gsn_densities *densities, struct gsn_error *err);

/* Codes the small ones into the stack's sections; pictures may be NULL. Fails with GSN_E_NOMEM. */
int gsn_aligned_pictures_code(const struct gsn_aligned_pictures *pictures,
                              struct gsn_densities *densities, struct gsn_error *err);

#endif
