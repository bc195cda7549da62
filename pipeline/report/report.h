/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What one run found out, as a page for people and as JSON for scripts.
 *
 * The conductor fills plain records; this folder turns them into bytes and looks nothing up. The
 * same record gives the same bytes: no date, no locale, no address. A double that is NaN is a
 * figure that does not exist: null in JSON, a dash on the page. Texts are UTF-8 and may hold
 * anything; NULL is taken as empty. Everything is borrowed for the length of a call. */
#ifndef GSN_REPORT_REPORT_H
#define GSN_REPORT_REPORT_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_report_kind {
    GSN_REPORT_SPECIMEN, /* panels of sections */
    GSN_REPORT_VOLUME,   /* an imported volume: no panels, no sections */
    GSN_REPORT_TILE,     /* one picture of stained tissue */
};

enum gsn_report_verdict {
    GSN_REPORT_FINE,     /* "reported" */
    GSN_REPORT_WARNED,   /* "reported with warnings" */
    GSN_REPORT_WITHHELD, /* "withheld" */
};

/* One file in memory; no picture when size is 0. */
struct gsn_report_png {
    const uint8_t *bytes;
    size_t size;
    unsigned width, height;
};

struct gsn_report_region {
    double volume_mm3;
    double mean_density;
    double coverage;         /* share of the region with data, 0..1 */
    const char *description; /* how it is laid, or the mask's file name */
};

/* A region that is measured beside the main one; what is not known is NaN or NULL. */
struct gsn_report_named {
    const char *name;
    struct gsn_report_region region;
    double density_error; /* standard error of the mean density, by stain and white */
    double loss_percent, loss_lower, loss_upper, loss_points;
    const char *loss_interval, *loss_reason; /* as of the report */
    double baseline_mean, baseline_volume_mm3;
    const char *verdict_reason; /* why its figures are withheld; NULL: they are not */
    size_t warnings;            /* of its own report */
    const char *page;           /* which lies beside this one */
};

/* The volume of {s > threshold} in the region, s being the fitted model, lies between these two:
 * they are guaranteed for the model, and say nothing of how far it is from the tissue. */
struct gsn_report_volume {
    double threshold, lower_mm3, upper_mm3;
    double estimate_mm3;                           /* of the tissue (measure/tissue_volume.h) */
    double interval_lower_mm3, interval_upper_mm3; /* of it, 95 %; NaN all three: withheld */
};

/* Tissue of one section that was not measured, for one reason. */
struct gsn_report_masked {
    const char *reason; /* a word: "fold", "void", ... */
    double area_mm2;
    double region_share; /* of the section's part of the region, 0..1 */
};

enum { GSN_REPORT_REASONS = 16 };

/* One pose that a section may have. */
struct gsn_report_candidate {
    struct gsn_point marker_px[3];
    int marker_found[3];
    int flipped, rotated180;
    double share; /* how likely, of those listed, 0..1 */
    int laid;     /* whether panel_to_block_um is known */
    struct gsn_affine panel_to_block_um;
    double predicted_tre_um;
    const char *differs; /* one short text */
    struct gsn_report_png picture;
};

struct gsn_report_section {
    unsigned serial;      /* 0-based, over the whole specimen */
    double z_um;          /* interval * (serial + 0.5) */
    unsigned panel;       /* 1-based */
    unsigned slot;        /* 0-based, in the order of mounting */
    unsigned row, column; /* 0-based place on the panel, for the contact sheet */
    /* "used", "doubtful", "held", "empty", "missing" have a symbol of their own; others a dot. */
    const char *state;
    int flipped, rotated180;
    const char *const *flags; /* flag_count short texts */
    size_t flag_count;
    struct gsn_point marker_px[3]; /* panel pixels; meaningless where not found */
    int marker_found[3];
    double residual_um[3];
    struct gsn_point onto_um[3]; /* where the common triangle has each mark found, block frame */
    struct gsn_point off_um[3];  /* from there to where the section's lies */
    double tissue_apart_um;      /* from where its neighbours' tissue lays it; NaN: not compared */
    double tissue_limit_um;      /* up to which that is usual in this stack */
    int posed;                   /* whether panel_to_block_um and predicted_tre_um are known */
    struct gsn_affine panel_to_block_um;
    double predicted_tre_um;              /* over the region */
    int strained;                         /* whether the section's stretch is known */
    double strain_percent[2], strain_deg; /* longer along that direction, and across it */
    struct gsn_report_png thumbnail;
    struct gsn_report_png aligned; /* as its pose lays it; as gsn_report_aligned says */
    /* As gsn_report_glass says; size 0: none. */
    struct gsn_report_png glass, masked_map, density_map;
    double outline_mm2, masked_mm2; /* reasons overlap, so their areas may sum to more */
    double region_masked;           /* share of the section's part of the region, 0..1 */
    struct gsn_report_masked masked[GSN_REPORT_REASONS];
    size_t masked_count;
    const struct gsn_report_candidate *candidates; /* candidate_count poses to choose from */
    size_t candidate_count;
    unsigned chosen;        /* the number from 1 that a person chose; 0: none */
    unsigned compared_with; /* the section outlined in their pictures, serial from 1; 0: none */
    const char *command;    /* that chooses, without the number; NULL: none */
};

/* What a person decided. */
struct gsn_report_decision {
    unsigned panel, slot; /* both 1-based; slot 0: the panel as a whole */
    const char *answer, *actor, *reason;
    const char *time;   /* "2026-11-22 13:40 UTC" */
    const char *effect; /* what became of it; empty where the answer says it */
};

struct gsn_report_panel {
    unsigned number; /* 1-based */
    const char *file, *sha256, *state, *message;
    unsigned rows, columns;
    double white[3]; /* codes 0..255 */
    double glass;    /* share of blank glass, 0..1 */
};

struct gsn_report_registration {
    double fle_um;          /* localisation error of one mark, from the whole stack */
    double rms_residual_um; /* of the marks */
    double worst_residual_um;
    double mean_tre_um, worst_tre_um; /* predicted */
    unsigned sections_posed, sections_expected;
    const char *by;       /* "marks", "tissue" or "marks+tissue" */
    double comparison_um; /* by tissue alone: error of one comparison of neighbours; NaN: by marks,
                             and by tissue alone the first three are NaN */
};

struct gsn_report_fit {
    size_t tets, unknowns, samples;
    size_t empty_tets;        /* without a sample */
    size_t tets_in_tolerance; /* of those with samples: an empty one is within nothing */
    double rms, worst;        /* of the residuals, in density */
    double smoothing, tolerance;
    unsigned degree;
};

/* Mean densities of the tetrahedra, the micro-units. */
struct gsn_report_units {
    double first, last; /* range of the histogram, in density */
    const size_t *bin;  /* bin_count counts of equal width */
    size_t bin_count;
    double smallest, median, largest;
};

/* The loss cell by cell on the mesh that specimens share. */
struct gsn_report_loss_map {
    double edge_um; /* of a cube; each has six cells */
    size_t cells;
    double shared;            /* of this region's volume that both have, 0..1 */
    double low, median, high; /* 5, 50 and 95 % of the baseline's collagen lost no more, per cent */
    double noise;             /* standard error of one cell by sections, typical; NaN: not known */
    const struct gsn_report_picture *pictures;
    size_t picture_count;
};

/* For kind "tile": the collagen map, and its comparison with a mask where one was given. */
struct gsn_report_tile {
    double area_fraction; /* collagen of tissue */
    double mean_density;
    double mean_lower,
        mean_upper;   /* 95 %: white, detail and dye vectors, not the stain's strength */
    double red_share; /* red of all dye in the tissue, whatever the stain's strength */
    double threshold;
    int compared;
    const char *mask_name;
    double dice, map_fraction, mask_fraction; /* the fractions are of the whole picture */
    double false_positive, false_negative;
};

struct gsn_report_picture {
    const char *id; /* short, unique; a key in report.json */
    const char *title, *caption;
    struct gsn_report_png png;
};

/* The model as the page's viewer reads it (pipeline/export/page_model.h). */
struct gsn_report_model {
    const uint8_t *bytes;
    size_t size;
    size_t cells, of; /* in it, of so many with tissue of the region */
    double apart_um;  /* corners nearer than this were drawn together; 0: none were */
    const char *unit; /* of its values */
};

struct gsn_report_exclusion {
    const char *what, *reason;
};

struct gsn_report_input {
    const char *name, *sha256;
    size_t size;
};

/* The file of that page, beside the report's. */
#define GSN_REPORT_GLASS_FILE "sections.html"

/* The large pictures of sections, for the page beside the report. All show the same square of the
 * block from corner_um on. A mask is grey: 0, or 1 + a reason's number. A map of the density is RGB
 * over a frame of its own: red 0 where it is not known, else 1 to 255 from low to high; green 0
 * outside of the region. */
struct gsn_report_glass {
    struct gsn_point corner_um, density_corner_um;
    double um_per_px, masked_um_per_px;
    struct gsn_point density_um_per_px;
    double density_low, density_high;
    const char *const *reasons; /* reason_count words for what is masked */
    size_t reason_count;
};

/* The square of the block that all aligned pictures of sections show. */
struct gsn_report_aligned {
    struct gsn_point corner_um;
    double um_per_px;
};

/* A row of the table of measures or of the parameters. */
struct gsn_report_value {
    const char *name;
    double value;     /* NaN: not known, unless text is given */
    const char *unit; /* "mm3", "um", "" */
    const char *text; /* instead of the number, where it is not one */
};

struct gsn_report {
    const char *specimen, *study, *group, *animal, *week;
    enum gsn_report_kind kind;
    enum gsn_report_verdict verdict;
    const char *verdict_reason; /* one sentence; may be empty when fine */

    const char *baseline;      /* name of the specimen or group; empty when there is none */
    const char *baseline_page; /* a relative link to its report; NULL: it is a group */
    double loss_percent;       /* relative per cent of the baseline's density; NaN: withheld */
    double loss_points;        /* difference of the mean densities in points of density (0..100) */
    double loss_lower, loss_upper; /* its interval, per cent, where loss_interval says of what */
    const char *loss_interval; /* "95 %, stain, white and sections"; NULL: no interval is known */
    const char *loss_reason;   /* why it is withheld */
    const struct gsn_report_loss_map *loss_map; /* NULL: none */
    const char *loss_map_reason; /* why not, where there is a loss; NULL: there is a map, or none is
                                    expected */
    double baseline_mean;        /* density */
    double baseline_volume_mm3;  /* of its region, where that has another size; 0: it has not */
    double zero_density; /* that no collagen reads as, from which both are counted; NaN: 0 */

    const char *density_name;            /* "collagen-equivalent density" */
    const char *density_version;         /* "van-gieson-gvp-1" */
    struct gsn_report_value area_figure; /* the area figure with its own name and unit */

    struct gsn_report_region region;
    const struct gsn_report_named *named; /* named_count further regions */
    size_t named_count;
    const struct gsn_report_volume *volumes;
    size_t volume_count;
    const struct gsn_report_section *sections; /* every slot, in serial order */
    size_t section_count;
    const struct gsn_report_panel *panels;
    size_t panel_count;
    const struct gsn_report_decision *decisions;
    size_t decision_count;
    const struct gsn_report_registration *registration; /* NULL: none was done */
    const struct gsn_report_fit *fit;                   /* NULL: none was done */
    const struct gsn_report_units *units;               /* NULL: none */
    const struct gsn_report_tile *tile;                 /* NULL unless the kind is tile */
    const struct gsn_report_model *model;               /* NULL: none */
    const struct gsn_report_aligned *aligned;           /* NULL: no section has such a picture */
    const struct gsn_report_glass *glass;               /* likewise */
    const struct gsn_report_picture *pictures;
    size_t picture_count;
    const char *const *warnings;
    size_t warning_count;
    const struct gsn_report_exclusion *exclusions;
    size_t exclusion_count;
    const struct gsn_report_value *measures; /* further rows for the table */
    size_t measure_count;

    const char *version; /* of gieson */
    const char *key;     /* the run's: a hash of inputs, parameters and version */
    const struct gsn_report_input *inputs;
    size_t input_count;
    const struct gsn_report_input *outputs; /* files kept beside this report */
    size_t output_count;
    const struct gsn_report_value *parameters;
    size_t parameter_count;
};

/* give: the bytes, and a zero byte behind them that is not counted. docs/user/report.md is the
 * schema of the first; the second is one HTML file that fetches nothing. Bytes of a text that are
 * not UTF-8 become U+FFFD. Fail with GSN_E_NOMEM. */
int gsn_report_json(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err);
int gsn_report_html(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err);

/* gives: the page of large pictures that lies beside the report, likewise; borrows report->glass,
 * which must be there. */
int gsn_report_glass_page(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                          struct gsn_error *err);

/* gives: the page on paper (A4), as a PDF. Fails with GSN_E_NOMEM, and with GSN_E_NOTFOUND where
 * the fonts are missing. */
int gsn_report_pdf(const struct gsn_report *report, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
