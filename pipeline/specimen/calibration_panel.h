/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A calibration panel, read: its patches found where the job says they are, checked, and turned
 * into dye vectors and the strength of the stain. */
#ifndef GSN_SPECIMEN_CALIBRATION_PANEL_H
#define GSN_SPECIMEN_CALIBRATION_PANEL_H

#include "pipeline/specimen/scan.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"

struct gsn_calibration_panel {
    const struct gsn_protocol_calibration *stated; /* borrowed */
    enum gsn_light light;
    double white[3]; /* of its glass, codes 0..255 */
    size_t patch_count;
    struct gsn_patch patch[GSN_MOST_PATCHES];
    int has_dyes; /* whether patches of single dyes were stated; else it tells the strength alone */
    struct gsn_dyes_fit fit;
};

/* What a slide was unmixed with because of its calibration panel, and what the slide says itself.
 */
struct gsn_calibrated {
    const struct gsn_calibration_panel *panel; /* borrowed; NULL: none is stated for this slide */
    int compared;                              /* whether the slide's own vectors could be told */
    struct gsn_dyes_apart apart;               /* of those and the calibration's */
    char why[200];                             /* why not compared */
    double white_od;                           /* furthest that the two glasses are apart */
    struct gsn_stain_gain gain;                /* by its standards; sections 0: it has none */
    double zero; /* what its standards of density 0 read; NaN: there is none */
};

/* gives. Fails as gsn_scan_open() and gsn_calibration_dyes() do, and with GSN_E_STAIN when the
 * glass is not white or is overexposed, when not all stated patches are found in their rows, and
 * when one is clipped; the sentence names the file and the patch. borrows: stated, for as long as
 * the panel is used. */
int gsn_calibration_panel_read(struct gsn_decoder *decoder, int picture_fd,
                               const struct gsn_protocol *protocol,
                               const struct gsn_protocol_calibration *stated,
                               struct gsn_calibration_panel **ret_panel, struct gsn_error *err);
void gsn_calibration_panel_free(struct gsn_calibration_panel *panel);
GSN_DEFINE_AUTO(gsn_calibration_panel);

struct gsn_specimen;
struct gsn_specimen_options;

/* The calibration panels of a job; each is read when a panel first needs it. */
struct gsn_calibrations {
    size_t count;
    struct gsn_calibration_panel **panel; /* owned; NULL as long as no panel needed it */
};

/* Fails with GSN_E_NOMEM. */
int gsn_calibrations_init(const struct gsn_specimen *specimen,
                          struct gsn_calibrations *calibrations, struct gsn_error *err);
void gsn_calibrations_done(struct gsn_calibrations *calibrations);

/* Whether every panel with sections has standards of a known density, so that all are on one scale.
 */
int gsn_calibrations_have_standards(const struct gsn_specimen *specimen);

/* The dye vectors of an opened panel: its calibration panel's, where one is stated. tissue: as for
 * gsn_scan_dyes(). ret_calibrated is zeroed where none is. Fails as gsn_calibration_panel_read()
 * and gsn_scan_dyes(). */
int gsn_calibration_find_dyes(const struct gsn_specimen *specimen,
                              const struct gsn_specimen_options *options,
                              const struct gsn_scan *scan, const struct gsn_image *tissue,
                              unsigned panel, struct gsn_calibrations *calibrations,
                              struct gsn_dyes_fit *ret_fit, struct gsn_calibrated *ret_calibrated,
                              struct gsn_error *err);

#endif
