/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From what was measured to what is said: the verdict, the warnings with their evidence, the
 * exclusions with their reasons, the loss against the baseline; then the report's bytes. */
#ifndef GSN_PIPELINE_SUMMARY_H
#define GSN_PIPELINE_SUMMARY_H

#include "pipeline/account.h"
#include "pipeline/assembly.h"
#include "pipeline/register/stack/gap_interpolation.h"
#include "pipeline/specimen.h"
#include "pipeline/tile.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What there is to say; members that do not apply are NULL. */
struct gsn_evidence {
    const struct gsn_specimen *specimen;
    const struct gsn_assembly *assembly;
    const struct gsn_account *account;
    const struct gsn_tile *tile;
    struct gsn_gap_interpolation
        bridge;           /* what was bridged before the account; region 0: no sections */
    const char *withheld; /* the sentence why there is no account, or NULL */
};

/* How the baseline would read in this specimen's stain, by tissue outside of the region that nobody
 * treated. Fails with GSN_E_STAIN when there is no baseline with a result, the
 * panels were not levelled, or too little tissue is alike. */
int gsn_stain_link(const struct gsn_specimen *specimen, const struct gsn_assembly *assembly,
                   struct gsn_batch_calibration *ret_link, struct gsn_error *err);

/* Fills json, html, measures, definition, dyes, withheld and message of result. borrows: evidence.
 * Fails with GSN_E_NOMEM. */
int gsn_summarise(const struct gsn_evidence *evidence, struct gsn_specimen_result *result,
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
