/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the patches of a calibration panel are: dark pieces of even colour and of about one area,
 * in rows. */
#ifndef GSN_PIPELINE_CALIBRATION_PATCHES_H
#define GSN_PIPELINE_CALIBRATION_PATCHES_H

#include "pipeline/scan.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stated_calibration.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: ret_boxes, one for each stated patch, in panel pixels: the part of it that its rim does
 * not reach. borrows: everything. Fails with GSN_E_STAIN where the glass does not show the rows of
 * patches that are stated, GSN_E_NOMEM. */
int gsn_calibration_patches_find(const struct gsn_scan *scan,
                                 const struct gsn_stated_calibration *stated,
                                 struct gsn_pixel_box *ret_boxes, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
