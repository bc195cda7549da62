/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the tissue around the marks looks like from afar: what tells apart ways to lay a section
 * that its marks leave open.
 *
 * Two marks lie as well after half a turn, and mirrored. Which it is, outline and layers of the
 * tissue say: a section's optical density in cells of a fortieth of its size is compared with the
 * mean of those sections whose three marks are clear. The measure is 1 - r^2 with the correlation
 * coefficient r, so that a paler or thicker section is like another one. */
#ifndef GSN_REGISTER_FIDUCIAL_THUMBNAIL_H
#define GSN_REGISTER_FIDUCIAL_THUMBNAIL_H

#include "pipeline/core/error.h"
#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/rigid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Averages the cells of a field. borrows: field, which must not have been searched yet. */
void gsn_thumbnail_take(const struct gsn_blob_field *field, struct gsn_tissue_thumbnail *ret_map);

/* The mean of sections laid by motions (um to block, mirrored first where mirrored[i]); used[i]
 * says which take part. ret_tissue.cell is 0 when none of them has a picture. Fails with
 * GSN_E_NOMEM. */
int gsn_thumbnail_mean(const struct gsn_fiducial_candidates *sections,
                       const struct gsn_rigid *motions, const int *mirrored, const int *used,
                       size_t count, struct gsn_point centre_um,
                       struct gsn_tissue_thumbnail *ret_tissue, struct gsn_error *err);

/* 0..1: how little of the section, laid so, is like the mean. 1 where there is nothing to compare.
 */
double gsn_thumbnail_dissimilarity(const struct gsn_fiducial_candidates *section,
                                   const struct gsn_tissue_thumbnail *tissue,
                                   const struct gsn_rigid *motion, int mirrored);

#ifdef __cplusplus
}
#endif
#endif
