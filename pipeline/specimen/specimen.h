/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is known of a specimen, and what comes of it: the records that all stages read and that the
 * conductor (process.h) gives.
 *
 * They know no store: the caller brings bytes and rows, and keeps what comes back. */
#ifndef GSN_SPECIMEN_SPECIMEN_H
#define GSN_SPECIMEN_SPECIMEN_H

#include "pipeline/core/grid.h"
#include "pipeline/core/progress.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/specimen/panel_analysis.h"
#include "pipeline/specimen/protocol.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"

/* A panel as it was logged; sections come from gsn_panel_analyse(), possibly in an earlier process.
 * A panel that was refused or is held has none. All borrowed. */
struct gsn_specimen_panel {
    unsigned number; /* 1-based; 0: unknown */
    const char *file, *sha256, *state, *message;
    size_t size;
    double px_um;                   /* as examined; 0 without sections */
    struct gsn_orientation upright; /* as examined: whoever opens it again turns it alike */
    size_t section_count;
    const struct gsn_panel_section *section;
};

/* A file that the figures rest on, for the provenance. */
struct gsn_specimen_input {
    const char *name, *sha256;
    size_t size;
};

/* What a person decided about a panel or one of its slots; for the report. */
struct gsn_specimen_decision {
    unsigned panel, slot; /* both 1-based; slot 0: the panel as a whole */
    const char *answer, *actor, *reason;
    int64_t time;
    int is_pose; /* whether it chose a pose */
};

struct gsn_model; /* pipeline/model/model_file.h */

/* What one specimen of a baseline hands on beside its figures. */
struct gsn_specimen_control {
    struct gsn_control_tissues tissues;
    double yellow[GSN_CONTROL_TISSUES]; /* of them, OD; NaN: not seen */
    double region_od[3];                /* mean R, G and B of its region; NaN: not known */
    double free_od[3];                  /* of its stated tissue without collagen; NaN: none */
    double free_panels;                 /* that it lies in; 0: not known */
    struct gsn_cloud *cloud;            /* of its tissue; NULL: not known */
    double plane_error;                 /* as of struct gsn_analysis; NaN: not known */
    const struct gsn_model *model;      /* fitted to it; NULL: not at hand, and why not */
    const char *model_lacks;            /* the sentence; NULL: it was not asked for */
};

/* The control's figures; name is "" when the job states no baseline. */
struct gsn_specimen_baseline {
    const char *name;
    size_t specimens; /* with a result; more than one for a group; 0: none yet */
    size_t withheld;  /* that were run and have no figure */
    size_t lacking;   /* of those: that state no region of the name that is asked for */
    double mean_density, volume_mm3;
    double mean_density_error; /* standard error of the mean by stain and white; 0: not known */
    double own_scale_error;    /* that without what its stain as a whole may be off by */
    double section_error;      /* of the mean, by what each section errs by itself; 0: not known */
    /* Of the specimen of which least is known: shares of its region that were not measured, and
     * that were neither measured nor bridged. */
    double unmeasured, unknown;
    /* That nobody treated; NaN: not known of every one of the specimens. */
    struct gsn_control_tissues tissues;
    struct gsn_vector_scatter
        turns; /* of its panels' dye vectors, where they were taken as exact */
    const struct gsn_specimen_control *control; /* each of the specimens */
    const char *definition, *dyes;
    const char *region; /* the rule of their regions; "": not known, or not one */
    const char *page;   /* a link from this run's folder to its last report; NULL: a group */
};

/* One of the protocol's named regions. */
struct gsn_specimen_region {
    const struct gsn_mask *mask;           /* of a mask file or of outlines, or NULL */
    const char *drawn;                     /* of outlines: where they were drawn; or NULL */
    struct gsn_specimen_baseline baseline; /* of the regions of that name */
};

struct gsn_specimen {
    const struct gsn_protocol *protocol;
    size_t panel_count;
    const struct gsn_specimen_panel *panel;  /* in order of number */
    const struct gsn_mask *region;           /* of a mask file or of outlines, or NULL */
    const char *region_drawn;                /* of outlines: where they were drawn; or NULL */
    const struct gsn_specimen_region *named; /* as many as the protocol names, in its order */
    const char *part; /* the name of the region that this is one of; NULL: the specimen itself */
    const struct gsn_grid *volume;         /* kind volume */
    const char *picture_sha256;            /* kind tile */
    const char *reference_sha256;          /* kind tile, may be NULL */
    const char *const *calibration_sha256; /* one for each that the protocol states, in its order;
                                               an entry is NULL where the file did not come */
    struct gsn_specimen_baseline baseline;
    size_t input_count;
    const struct gsn_specimen_input *input;
    size_t decision_count;
    const struct gsn_specimen_decision *decision;
    const char *key; /* hash of inputs, parameters and version */

    /* Opens an object whose bytes have been checked. gives: a descriptor to close(). */
    int (*open)(void *context, const char *sha256, int *ret_fd, struct gsn_error *err);
    void *context;
};

struct gsn_decoder; /* pipeline/decode/apart.h */

struct gsn_specimen_options {
    const char *mesher;          /* path of gieson-mesh */
    struct gsn_decoder *decoder; /* NULL: as for gsn_decode_apart() */
    unsigned threads;            /* 0: all */
    const struct gsn_progress *progress;
};

struct gsn_specimen_pose {
    unsigned panel, slot, serial; /* panel 1-based, the others 0-based */
    struct gsn_pose pose;
};

/* The poses to choose from of one section. */
struct gsn_specimen_candidates {
    unsigned panel, slot; /* panel 1-based, slot 0-based */
    struct gsn_candidates list;
};

/* What the stain of one panel was. */
struct gsn_specimen_stain {
    unsigned panel;
    struct gsn_dyes_fit fit; /* covariance 0: taken as exact */
    double white[3];
};

struct gsn_specimen_measure {
    const char *name, *unit;
    double value, lower, upper; /* NaN where there is none */
};

/* A file that is kept beside the report: "colour.nrrd", the stack in true colour (sections),
 * "model.vtkhdf", the fitted spline (model/model_file.h; where there is a fit), "base-cells.csv",
 * density and loss on the mesh that specimens share (export/cells_file.h; likewise),
 * "sections.html", the sections large (where they have poses), "report.pdf", the page on paper, and
 * of each named region "region-NAME.html" and "region-NAME.json", the report
 * of a job that had it alone. */
struct gsn_specimen_file {
    char name[64];
    uint8_t *bytes; /* owned */
    size_t size;
};

enum { GSN_SPECIMEN_MEASURES = 32, GSN_SPECIMEN_FILES = 5 + 2 * GSN_MOST_REGIONS };

struct gsn_specimen_result {
    int withheld;      /* 1: no figure could be given, the report says why */
    char message[480]; /* why withheld, or empty */
    char *json, *html; /* owned */
    size_t json_size, html_size;
    size_t file_count;
    struct gsn_specimen_file file[GSN_SPECIMEN_FILES];
    char definition[96], dyes[48], region[200];
    size_t pose_count;
    struct gsn_specimen_pose *pose; /* owned */
    size_t candidates_count;
    struct gsn_specimen_candidates *candidates; /* owned */
    size_t stain_count;
    struct gsn_specimen_stain *stain;    /* owned */
    struct gsn_specimen_control colours; /* for those whose baseline it is; cloud owned */
    size_t measure_count;
    struct gsn_specimen_measure measure[GSN_SPECIMEN_MEASURES];
    /* What its report says of the loss. */
    char loss_reason[480];
    const char *loss_interval; /* literal; NULL: none is known */
    double baseline_mean, baseline_volume_mm3;
    size_t warning_count;
    char name[44];     /* of the named region that it is of; empty: of the main one */
    size_t part_count; /* named regions, in the protocol's order */
    struct gsn_specimen_result *part[GSN_MOST_REGIONS]; /* owned; without files, html and json */
};

/* The panel of this number that has sections; NULL when there is none. Borrowed. */
const struct gsn_specimen_panel *gsn_specimen_find_panel(const struct gsn_specimen *specimen,
                                                         unsigned number);

/* The value of a measure of the result, or NaN; ret_row: or NULL. */
double gsn_specimen_result_measure(const struct gsn_specimen_result *result, const char *name,
                                   const struct gsn_specimen_measure **ret_row);

/* Between the name of a region and that of a measure of it, where a store has both in one. */
enum { GSN_SPECIMEN_IN_REGION = '/' };

/* The measure by which a tissue's density is handed on: its value, and 95 % to either side. */
const char *gsn_specimen_tissue_measure(unsigned tissue);
/* That by which the covariance of two tissues' densities is. */
const char *gsn_specimen_tissues_measure(unsigned tissue, unsigned other);

void gsn_specimen_result_free(struct gsn_specimen_result *result);
GSN_DEFINE_AUTO(gsn_specimen_result);

#endif
