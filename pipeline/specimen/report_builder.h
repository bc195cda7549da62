/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From what was measured to what is said: the warnings with their evidence, the exclusions with
 * their reasons, the loss against the baseline. process.h puts the parts together. */
#ifndef GSN_SPECIMEN_REPORT_BUILDER_H
#define GSN_SPECIMEN_REPORT_BUILDER_H

#include "pipeline/core/hash.h"
#include "pipeline/export/page_model.h"
#include "pipeline/measure/loss.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/stack/gap_interpolation.h"
#include "pipeline/report/report.h"
#include "pipeline/specimen/analysis.h"
#include "pipeline/specimen/reconstruction.h"
#include "pipeline/specimen/region_pictures.h"
#include "pipeline/specimen/specimen.h"
#include "pipeline/specimen/tile.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"

/* What there is to say; members that do not apply are NULL. */
struct gsn_report_inputs {
    const struct gsn_specimen *specimen;
    const struct gsn_reconstruction *reconstruction;
    const struct gsn_analysis *analysis;
    const struct gsn_mask *region;     /* of the analysis; NULL: no map of the loss is made */
    const struct gsn_page_model *page; /* the analysis's model for the viewer, or NULL */
    const struct gsn_tile *tile;
    struct gsn_gap_interpolation
        bridge;           /* what was bridged before the analysis; region 0: no sections */
    const char *withheld; /* the sentence why there is no analysis, or NULL */
    unsigned threads;     /* 0: all */
};

/* How the baseline would read in this specimen's stain, by tissue outside of the region that nobody
 * treated. scale: or NULL. Fails with GSN_E_STAIN when there is no baseline with a result, the
 * panels were not levelled, or too little tissue is alike. */
int gsn_stain_link(const struct gsn_specimen *specimen, const struct gsn_scale *scale,
                   struct gsn_batch_calibration *ret_link, struct gsn_error *err);

/* ---- the report while it is written: what its parts share (report_*.c) ---- */

enum { GSN_BUILDER_ROWS = 96, GSN_BUILDER_FLAGS = 16 };

/* Between the dyes and the batch that was stained with them. */
#define GSN_BUILDER_IN_BATCH ", batch "

/* What the matter of a warning costs, as far as it is known: points of the loss (standard error;
 * INFINITY where there is no loss for it), and sections that are not used. */
struct gsn_builder_cost {
    double points;
    size_t sections;
};

/* The report's records and the texts they borrow. */
struct gsn_builder {
    struct gsn_report report;
    char **text; /* owned */
    size_t text_count, text_room;
    const char **warning;          /* what costs most first */
    struct gsn_builder_cost *cost; /* of each of them */
    size_t warning_count;
    struct gsn_report_exclusion *exclusion;
    size_t exclusion_count;
    struct gsn_report_section *section;
    const char *(*flag)[GSN_BUILDER_FLAGS];
    struct gsn_report_candidate (*candidate)[GSN_CANDIDATES];
    struct gsn_report_decision *decision;
    struct gsn_report_panel *panel;
    struct gsn_report_volume volume[GSN_ANALYSIS_THRESHOLDS];
    struct gsn_report_picture picture[GSN_ANALYSIS_PICTURES];
    struct gsn_report_value measure[GSN_BUILDER_ROWS], parameter[GSN_BUILDER_ROWS];
    struct gsn_report_named named[GSN_MOST_REGIONS];
    struct gsn_report_input *input, output[GSN_SPECIMEN_FILES];
    struct gsn_digest output_is[GSN_SPECIMEN_FILES];
    struct gsn_report_registration registration;
    struct gsn_report_fit fit;
    struct gsn_report_units units;
    struct gsn_report_tile tile;
    struct gsn_report_model model;
    struct gsn_report_aligned aligned;
    struct gsn_report_glass glass;
    struct gsn_report_loss_map loss_map;
    struct gsn_report_picture loss_picture[GSN_LOSS_PICTURES];
    struct gsn_png_picture loss_png[GSN_LOSS_PICTURES]; /* their bytes owned */
    int linked; /* whether untreated tissue tells how the baseline was stained */
    struct gsn_batch_calibration link;
    struct gsn_hue_edge edge; /* of both specimens' colours, where the loss was narrowed by it */
    size_t edge_panels;       /* that show it; 0: the loss was not */
    int by_colours;           /* whether the loss is one whose vectors nobody measured */
    double loss_by_colour;    /* standard error of the loss that it leaves, per cent */
    int out_of_memory;
};

/* Room for a report of so many. Fails with GSN_E_NOMEM, and then nothing is to be freed. */
int gsn_builder_init(struct gsn_builder *d, size_t sections, size_t panels, size_t inputs,
                     size_t decisions, struct gsn_error *err);
void gsn_builder_done(struct gsn_builder *d);

/* A text that lives as long as the report; "" when memory runs out, which is noted. */
const char *gsn_builder_say(struct gsn_builder *d, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* sentence lives as long as the draft. Warnings are kept by what they cost, points before sections;
 * those that cost alike, or of which nothing is known, in the order in which they come. */
void gsn_builder_warn(struct gsn_builder *d, const char *sentence);
void gsn_builder_warn_cost(struct gsn_builder *d, struct gsn_builder_cost cost,
                           const char *sentence);
void gsn_builder_value(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                       const char *unit);
void gsn_builder_text(struct gsn_report_value *rows, size_t *count, const char *name,
                      const char *text);

/* report_sections.c: sections, panels, registration, and what was odd about them. */
void gsn_builder_sections(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* glass_page.c: the page of large sections, kept as a file of the run; comes after the sections.
 * Fails with GSN_E_NOMEM. */
int gsn_builder_glass(const struct gsn_report_inputs *e, struct gsn_builder *d,
                      struct gsn_specimen_result *result, struct gsn_error *err);

/* report_sections.c: the poses a person may choose from, what people decided and what became of
 * it. Comes after the sections. */
void gsn_builder_choices(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* report_figures.c: the region, its volumes and MicroUnits; whether its volumes have the
 * baseline's scale (after the loss); what was bridged (after the figures); a single tile. */
void gsn_builder_figures(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_check_volumes(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_bridge(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_tile(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* report_stain.c: by which stain the figures are, how it compares with the baseline's, and what
 * that leaves open. */
void gsn_builder_find_link(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_evenness(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_link(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_compression(const struct gsn_report_inputs *e, struct gsn_builder *d);
void gsn_builder_definition(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* The baseline as it would read in this specimen's stain, and what that leaves open on both sides.
 */
void gsn_builder_link_sides(const struct gsn_report_inputs *e, const struct gsn_builder *d,
                            struct gsn_loss_side *control, struct gsn_loss_side *treated);

/* Standard error of the mean density by what the stain leaves open; 0: not known. Of its own scale
 * it leaves out what all panels have in common. */
double gsn_builder_own_scale_error(const struct gsn_report_inputs *e);
double gsn_builder_density_error(const struct gsn_report_inputs *e);

/* The set of dye vectors that the figures stand on: the panels' own; "" when there is none. */
const char *gsn_builder_dyes(const struct gsn_report_inputs *e);
const char *gsn_builder_tissue_name(unsigned tissue);

/* Standard error of a loss by vectors that calibration panels tell, per cent. */
double gsn_builder_loss_by_vectors(const struct gsn_report_inputs *e,
                                   const struct gsn_loss_side *control,
                                   const struct gsn_loss_side *treated);

/* The table of the dye vectors that colours are read by: the first panel's. NULL: none is open. */
const struct gsn_dyes *gsn_builder_table(const struct gsn_report_inputs *e);

/* Whether calibration panels tell the vectors of all panels. */
int gsn_builder_calibrated(const struct gsn_report_inputs *e);

/* report_loss.c: the loss, or why there is none. */
void gsn_builder_loss(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* loss_map.c: where it was lost, cell by cell, or why that is not known; after the loss. Adds
 * base-cells.csv to the result. There is an analysis. Fails with GSN_E_NOMEM and as the pictures'
 * parts do. */
int gsn_builder_loss_map(const struct gsn_report_inputs *e, struct gsn_builder *d,
                         struct gsn_specimen_result *result, struct gsn_error *err);

/* The first cause of what why says: the panels that gave nothing, by cause,
 * then why. No longer than a run's row keeps. */
const char *gsn_builder_headline(const struct gsn_report_inputs *e, struct gsn_builder *d,
                                 const char *why);

/* The same of why nothing could be told of the region; NULL: it could. */
const char *gsn_builder_withheld(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* Whether two sentences say the same of two panels or sections: alike but for words with digits. */
int gsn_builder_same_reason(const char *a, const char *b);

/* report_stain.c: the panels' dye vectors that are not the built-in ones and how well they
 * are known; what the calibration panels say, and where the slides say otherwise. */
void gsn_builder_vectors(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* report_figures.c: what the figures depend on, in words. */
void gsn_builder_parameters(const struct gsn_report_inputs *e, struct gsn_builder *d);

/* ---- what the poses of a stack say to a person ---- */

enum { GSN_POSE_SENTENCES = 8 };

/* One sentence for each thing to say about the whole stack; their number. */
size_t gsn_pose_sentences(const struct gsn_pose_summary *summary,
                          const struct gsn_strain_common *panel, enum gsn_strain_mode mode,
                          double interval_um,
                          char ret_sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE]);

/* What became of sections that were to be laid by their tissue. */
void gsn_refinement_sentence(const struct gsn_refinement *refinement,
                             char ret_sentence[GSN_POSE_SENTENCE]);

/* Why a section whose marks contradict the stack is held, with the three poses on two marks. */
void gsn_pose_reason(const struct gsn_pose *pose, char ret_sentence[GSN_POSE_SENTENCE]);

/* What is between a section's marks and its neighbours' tissue; state: what became of it. */
void gsn_tissue_sentence(const struct gsn_section *section, enum gsn_section_state state,
                         char ret_sentence[GSN_POSE_SENTENCE]);

#endif
