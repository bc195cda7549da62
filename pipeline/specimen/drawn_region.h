/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A region that a person drew on sections of the exported stack: outlines in GeoJSON, as QuPath
 * writes them, or selections of ImageJ, made a mask.
 *
 * A point is in pixels of the stack, (0, 0) the outer corner of its first pixel: x pixels are
 * origin_um.x + (x - 0.5) step_um.x in the block. plane.z of a geometry is the plane of the stack,
 * from 0. */
#ifndef GSN_SPECIMEN_DRAWN_REGION_H
#define GSN_SPECIMEN_DRAWN_REGION_H

#include "pipeline/core/error.h"
#include "pipeline/core/grid.h"
#include "pipeline/specimen/region.h"

#include <stddef.h>

/* Most bytes that a file of outlines may have. */
enum { GSN_DRAWN_MOST_BYTES = 64 << 20, GSN_DRAWN_SENTENCE = 240 };

/* gives: the mask on the stack of the region, which is of the kind GSN_REGION_DRAWN; and a sentence
 * on where it was drawn. Fails with GSN_E_INPUT, naming the file, what is wrong with it and where,
 * and with GSN_E_NOMEM. borrows: region, text. */
int gsn_drawn_region_read(const struct gsn_region *region, const char *text, size_t size,
                          struct gsn_mask **ret_mask, char ret_sentence[GSN_DRAWN_SENTENCE],
                          struct gsn_error *err);

#endif
