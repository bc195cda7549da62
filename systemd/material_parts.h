/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of a specimen's material share: material.c gathers it, with what it has of panels
 * (material_panels.c), files that the job names (material_files.c), its baseline
 * (material_baseline.c), and where all of it came from (material_provenance.c). Private to these
 * files. All fail with GSN_E_NOMEM, and as the store does. */
#ifndef GSN_SYSTEMD_MATERIAL_PARTS_H
#define GSN_SYSTEMD_MATERIAL_PARTS_H

#include "storage/attachment.h"
#include "storage/catalog.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "systemd/candidates.h"
#include "systemd/specimen_job.h"

#include <jansson.h>

struct gsn_material {
    struct gsn_store *store;
    struct gsn_specimen specimen;
    struct gsn_specimen_row *row;
    struct gsn_protocol *protocol;
    struct gsn_panel_rows *panels;
    struct gsn_section_rows *sections;
    struct gsn_decision_rows *decided;
    struct gsn_candidate_rows *candidates;
    struct gsn_attachment_rows *attachments;
    struct gsn_specimen_panel *panel;
    struct gsn_panel_section *section; /* of all panels, panel by panel */
    struct gsn_specimen_input *input;
    struct gsn_specimen_decision *decision;
    char (*pose)[16];                /* "pose 2", for the decisions that choose one */
    const char **calibration_sha256; /* its entries are the attachments' */
    struct gsn_mask *region;
    struct gsn_grid *volume;
    char *definition, *dyes; /* of the baseline */
    struct gsn_specimen_control *control;
    json_t *baseline_keys;
    char *inputs;
    struct gsn_digest key, own_key;
};

/* Of panels that claim one number and show one glass the better scan is used; of others all are
 * held. Lists the panels anew. decoder: as for gsn_decode_apart(). */
int gsn_material_settle_duplicates(struct gsn_material *m, struct gsn_decoder *decoder,
                                   struct gsn_error *err);
/* Refuses panels that lack their turn (panel_job.h). */
int gsn_material_check_turns(const struct gsn_material *m, struct gsn_error *err);
/* The panels and their sections as they were logged. */
int gsn_material_take_panels(struct gsn_material *m, struct gsn_error *err);
/* Reads every file that the job names. */
int gsn_material_take_files(struct gsn_material *m, struct gsn_error *err);
/* The mean of the baseline's specimens, and the keys of their runs. */
int gsn_material_take_baseline(struct gsn_material *m, struct gsn_error *err);
/* What people decided, for the report. */
int gsn_material_take_decisions(struct gsn_material *m, struct gsn_error *err);
/* All inputs by name and hash. */
int gsn_material_list_inputs(struct gsn_material *m, struct gsn_error *err);
/* The keys of what has been taken so far: with the baseline and without it. */
int gsn_material_make_keys(struct gsn_material *m, struct gsn_error *err);

#endif
