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

/* What the colours of its tissue were: region_od, yellow and cloud, which is given; not known (NaN,
 * NULL) where an older version told none. Fails with GSN_E_NOMEM. */
int gsn_run_colours(const struct gsn_run_row *run, struct gsn_specimen_control *colours,
                    struct gsn_error *err);

#endif
