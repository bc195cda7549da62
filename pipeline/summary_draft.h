/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report of one specimen while it is written: what the parts of the summary share. Private to
 * summary*.c. */
#ifndef GSN_PIPELINE_SUMMARY_DRAFT_H
#define GSN_PIPELINE_SUMMARY_DRAFT_H

#include "pipeline/core/hash.h"
#include "pipeline/measure/loss.h"
#include "pipeline/report/report.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/summary.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_DRAFT_ROWS = 96 };

/* Between the dyes and the batch that was stained with them. */
#define GSN_DRAFT_IN_BATCH ", batch "

/* The report's records and the texts they borrow. */
struct gsn_draft {
    struct gsn_report report;
    char **text; /* owned */
    size_t text_count, text_room;
    const char **warning;
    size_t warning_count;
    struct gsn_report_exclusion *exclusion;
    size_t exclusion_count;
    struct gsn_report_section *section;
    const char *(*flag)[16];
    struct gsn_report_candidate (*candidate)[GSN_CANDIDATES];
    struct gsn_report_decision *decision;
    struct gsn_report_panel *panel;
    struct gsn_report_volume volume[GSN_ACCOUNT_THRESHOLDS];
    struct gsn_report_picture picture[GSN_ACCOUNT_PICTURES];
    struct gsn_report_value measure[GSN_DRAFT_ROWS], parameter[GSN_DRAFT_ROWS];
    struct gsn_report_input *input, output[GSN_SPECIMEN_FILES];
    struct gsn_digest output_is[GSN_SPECIMEN_FILES];
    struct gsn_report_registration registration;
    struct gsn_report_fit fit;
    struct gsn_report_units units;
    struct gsn_report_tile tile;
    int linked; /* whether untreated tissue tells how the baseline was stained */
    struct gsn_batch_calibration link;
    struct gsn_hue_edge edge; /* of both specimens' colours, where the loss was narrowed by it */
    size_t edge_panels;    /* that show it; 0: the loss was not */
    int by_colours;        /* whether the loss is one whose vectors nobody measured */
    double loss_by_colour; /* standard error of the loss that it leaves, per cent */
    int out_of_memory;
};

/* Fails with GSN_E_NOMEM, and then nothing is to be freed. */
int gsn_draft_init(struct gsn_draft *d, size_t sections, size_t panels, size_t inputs,
                   size_t decisions, struct gsn_error *err);
void gsn_draft_done(struct gsn_draft *d);

/* A text that lives as long as the draft; "" when memory runs out, which is noted. */
const char *gsn_draft_say(struct gsn_draft *d, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
/* sentence lives as long as the draft. */
void gsn_draft_warn(struct gsn_draft *d, const char *sentence);
void gsn_draft_value(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                     const char *unit);
void gsn_draft_text(struct gsn_report_value *rows, size_t *count, const char *name,
                    const char *text);

/* summary_sections.c: sections, panels, registration, and what was odd about them. */
void gsn_draft_assembly(const struct gsn_evidence *e, struct gsn_draft *d);

/* summary_choices.c: the poses a person may choose from, what people decided and what became of
 * it. Comes after the sections. */
void gsn_draft_choices(const struct gsn_evidence *e, struct gsn_draft *d);

/* summary_figures.c: the region, its volumes and MicroUnits; whether its volumes have the baseline's scale (after the loss);
 * what was bridged (after the figures);
 * a single tile. */
void gsn_draft_figures(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_check_volumes(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_bridge(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_tile(const struct gsn_evidence *e, struct gsn_draft *d);

/* summary_stain.c: by which stain the figures are, how it compares with the baseline's, and what
 * that leaves open. */
void gsn_draft_find_link(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_evenness(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_link(const struct gsn_evidence *e, struct gsn_draft *d);
void gsn_draft_definition(const struct gsn_evidence *e, struct gsn_draft *d);
/* The baseline as it would read in this specimen's stain, and what that leaves open on both sides.
 */
void gsn_draft_link_sides(const struct gsn_evidence *e, const struct gsn_draft *d,
                          struct gsn_loss_side *control, struct gsn_loss_side *treated);
/* Standard error of the mean density by what the stain leaves open; 0: not known. Of its own scale
 * it leaves out what all panels have in common. */
double gsn_draft_own_scale_error(const struct gsn_evidence *e);
double gsn_draft_density_error(const struct gsn_evidence *e);
/* The set of dye vectors that the figures stand on: the panels' own; "" when there is none. */
const char *gsn_draft_dyes(const struct gsn_evidence *e);
const char *gsn_draft_tissue_name(unsigned tissue);

/* Standard error of a loss by vectors that calibration panels tell, per cent. */
double gsn_draft_loss_by_vectors(const struct gsn_evidence *e, const struct gsn_loss_side *control,
                                 const struct gsn_loss_side *treated);
/* The table of the dye vectors that colours are read by: the first panel's. NULL: none is open. */
const struct gsn_dyes *gsn_draft_table(const struct gsn_evidence *e);
/* Whether calibration panels tell the vectors of all panels. */
int gsn_draft_calibrated(const struct gsn_evidence *e);

/* summary_colour.c: a loss whose dye vectors nobody measured, by the colours of both specimens'
 * tissue; why it cannot be given, or NULL. */
const char *gsn_draft_narrow(const struct gsn_evidence *e, struct gsn_draft *d,
                             const struct gsn_loss_side *control,
                             const struct gsn_loss_side *treated, struct gsn_loss *loss);

/* summary_loss.c: the loss, or why there is none. */
void gsn_draft_loss(const struct gsn_evidence *e, struct gsn_draft *d);

/* summary_headline.c: the first cause of what why says: the panels that gave nothing, by cause,
 * then why. No longer than a run's row keeps. */
const char *gsn_draft_headline(const struct gsn_evidence *e, struct gsn_draft *d, const char *why);
/* The same of why nothing could be told of the region; NULL: it could. */
const char *gsn_draft_withheld(const struct gsn_evidence *e, struct gsn_draft *d);
/* Whether two sentences say the same of two panels or sections: alike but for words with digits. */
int gsn_draft_same_reason(const char *a, const char *b);

/* summary_calibration.c: the panels' dye vectors that are not the built-in ones and how well they
 * are known; what the calibration panels say, and where the slides say otherwise. */
void gsn_draft_vectors(const struct gsn_evidence *e, struct gsn_draft *d);

/* summary_parameters.c: what the figures depend on, in words. */
void gsn_draft_parameters(const struct gsn_evidence *e, struct gsn_draft *d);

#ifdef __cplusplus
}
#endif
#endif
