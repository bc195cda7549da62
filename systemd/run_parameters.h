/* SPDX-License-Identifier: AGPL-3.0-or-later */
#ifndef GSN_SYSTEMD_RUN_PARAMETERS_H
#define GSN_SYSTEMD_RUN_PARAMETERS_H

#include "pipeline/specimen.h"
#include "storage/result.h"

/* What the figures of a run mean, kept beside them as JSON for the runs that compare with it later.
 */

/* gives; NULL: out of memory. */
char *gsn_run_parameters(const char *own_key, const struct gsn_specimen_result *result);

/* A text of a run's parameters ("definition", "dyes", "own_key"), or "" where an older version
 * wrote none. gives; NULL: out of memory. */
char *gsn_run_parameter(const struct gsn_run_row *run, const char *name);

/* Where each of its panels puts density 0; returns their number, 0 where an older version told
 * none. */
size_t gsn_run_panel_zeros(const struct gsn_run_row *run, double ret_zero[GSN_LEVEL_PANELS]);

#endif
