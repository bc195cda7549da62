/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The end of truth.json: every value that was drawn for this specimen. */
#ifndef GSN_PHANTOM_RECORD_H
#define GSN_PHANTOM_RECORD_H

#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Adds "sections", "markers" and "defects", and where sections and panels vary "panels", and the
 * closing brace. */
void gsn_phantom_record_drawn(const struct gsn_phantom_plan *plan, struct gsn_phantom_buffer *text);

#ifdef __cplusplus
}
#endif
#endif
