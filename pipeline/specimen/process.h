/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The conductor: takes what is known of a specimen through every stage to its report.
 *
 *     sections:  marks -> poses -> density of each panel -> stack -> analysis -> report
 *     volume:    voxels -> analysis -> report
 *     tile:      picture -> dyes -> collagen map -> report
 *
 * The same inputs give the same bytes, whatever the number of threads. */
#ifndef GSN_SPECIMEN_PROCESS_H
#define GSN_SPECIMEN_PROCESS_H

#include "pipeline/specimen/report_builder.h"
#include "pipeline/specimen/specimen.h"

/* gives. A specimen whose evidence is too thin has a result too: withheld, with a report that names
 * the evidence and the next action. Fails with GSN_E_NOMEM, GSN_E_IO, GSN_E_PROCESS, GSN_E_FIT. */
int gsn_specimen_process(const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options,
                         struct gsn_specimen_result **ret_result, struct gsn_error *err);

/* Fills json, html, measures, definition, dyes, withheld and message of result. borrows: inputs.
 * Fails with GSN_E_NOMEM. */
int gsn_report_build(const struct gsn_report_inputs *evidence, struct gsn_specimen_result *result,
                     struct gsn_error *err);

#endif
