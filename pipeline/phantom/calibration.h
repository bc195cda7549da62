/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The calibration panels: for every batch of stain a glass with five patches of known density, and
 * below them one patch of each dye alone. */
#ifndef GSN_PHANTOM_CALIBRATION_H
#define GSN_PHANTOM_CALIBRATION_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/plan.h"
#include "pipeline/phantom/stain.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PHANTOM_PATCHES = 5 };

/* A patch is even: no layers, no nuclei, no grain, no ramp; F is 1. */
struct gsn_phantom_patch {
    double density;
    uint32_t x, y, width, height; /* pixels of the panel */
};

/* 3 x 3 mm of D = 0, .25, .5, .75, 1, from left to right. */
struct gsn_phantom_patch gsn_phantom_patch_of(const struct gsn_phantom_plan *plan, int i);

/* 3 x 3 mm of red, yellow and nuclear dye, from left to right below the others: as much of each as
 * tissue that is full of it holds. */
struct gsn_phantom_patch gsn_phantom_dye_patch_of(const struct gsn_phantom_plan *plan,
                                                  enum gsn_phantom_dye dye);
/* The optical density of patch i in a batch, from 1. */
void gsn_phantom_patch_od(const struct gsn_phantom_plan *plan, int batch, int i, double ret_od[3]);

/* gives: the panel of a batch, from 1, or, as 0, of the bath that they are drawn from, with patches
 * of its dyes only; 8-bit RGB, with the batch's white, the light and the noise of its
 * level, and the label "C01". Fails with GSN_E_NOMEM. borrows: plan. */
int gsn_phantom_calibration_draw(const struct gsn_phantom_plan *plan, int batch, unsigned threads,
                                 struct gsn_image **ret_image, struct gsn_error *err);

/* Writes all of them into folder/calibration, and folder/truth/calibration.csv and
 * calibration_dyes.csv; at levels that are not handled all batches are alike, and none is written.
 * Those that a variant's job.json states are written into folder, as PNG. folder/truth must be
 * there. */
int gsn_phantom_calibration_write(const struct gsn_phantom_plan *plan, unsigned threads,
                                  const char *folder, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
