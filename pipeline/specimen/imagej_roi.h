/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Selections of ImageJ and Fiji (.roi, or several in RoiSet.zip) as features of GeoJSON. */
#ifndef GSN_SPECIMEN_IMAGEJ_ROI_H
#define GSN_SPECIMEN_IMAGEJ_ROI_H

#include "pipeline/core/error.h"

#include <jansson.h>
#include <stddef.h>

/* Whether the bytes begin as such a file does. */
int gsn_imagej_roi_is(const void *bytes, size_t size);

/* gives: a FeatureCollection as drawn_region.c reads it: a feature for each selection, in the order
 * of the file, in pixels from the outer corner of the first; its slice is its plane, its group,
 * where it has one, its classification. What has no area is a feature of a type without one.
 * planes: of the stack; in one of several a selection has to say its slice.
 *
 * Fails with GSN_E_INPUT, naming the file, the selection and what is wrong with it; GSN_E_NOMEM. */
int gsn_imagej_roi_read(const char *file, const void *bytes, size_t size, size_t planes,
                        json_t **ret_features, struct gsn_error *err);

#endif
