/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The truth as tables: sections.csv, markers.csv and defects.csv, and at the levels that are
 * handled decoys.csv and warp_kNNN.csv. */
#ifndef GSN_PHANTOM_TABLES_H
#define GSN_PHANTOM_TABLES_H

#include "pipeline/phantom/section.h"

#ifdef __cplusplus
extern "C" {
#endif

/* extent is by section. */
int gsn_phantom_tables_write(const struct gsn_phantom_plan *plan,
                             const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                             const char *folder, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
