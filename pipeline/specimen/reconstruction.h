/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From the panels of one specimen to one stack in the block frame: the records of its stages. */
#ifndef GSN_SPECIMEN_RECONSTRUCTION_H
#define GSN_SPECIMEN_RECONSTRUCTION_H

#include "pipeline/specimen/density_stack.h"
#include "pipeline/specimen/normalisation.h"
#include "pipeline/specimen/poses.h"

struct gsn_reconstruction {
    struct gsn_mask *region; /* owned; NULL when the job states none or it was not found */
    char no_region[480];     /* why the stated band could not be found, or empty */
    struct gsn_calibrations calibrations;
    struct gsn_poses poses;
    struct gsn_densities densities;
    struct gsn_scale scale;
};

/* gives. Sections and panels that cannot be used are states, not failures.
 * Fails with GSN_E_NOMEM, GSN_E_IO, GSN_E_INPUT (a region that misses the stack). */
int gsn_reconstruct(const struct gsn_specimen *specimen, const struct gsn_specimen_options *options,
                    struct gsn_reconstruction **ret_reconstruction, struct gsn_error *err);
void gsn_reconstruction_free(struct gsn_reconstruction *reconstruction);
GSN_DEFINE_AUTO(gsn_reconstruction);

#endif
