/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the operator states about a specimen: job.json, read once and checked key by key.
 *
 * The keys are documented in docs/user/job.md. Lengths are micrometres in the block frame. */
#ifndef GSN_SPECIMEN_PROTOCOL_H
#define GSN_SPECIMEN_PROTOCOL_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/specimen/region.h"
#include "pipeline/stain/calibration.h"

/* ---- calibration panels: which file, for which panels, and what its patches hold, row by row ----
 */

enum { GSN_MOST_PATCHES = 48 };

struct gsn_protocol_patch {
    enum gsn_patch_kind kind;
    double density;      /* of a standard */
    unsigned row, place; /* 1-based */
};

struct gsn_protocol_calibration {
    char *file; /* owned, as is the next */
    size_t panel_count;
    unsigned *panel; /* 1-based; NULL: all panels */
    size_t patch_count;
    struct gsn_protocol_patch patch[GSN_MOST_PATCHES]; /* by row, then place */
};

/* The one of these that a panel was stained with, or NULL. */
const struct gsn_protocol_calibration *
gsn_protocol_calibration_of(const struct gsn_protocol_calibration *calibrations, size_t count,
                            unsigned panel);

/* Whether it holds standards of a known density. */
int gsn_protocol_calibration_has_standards(const struct gsn_protocol_calibration *calibration);

/* ---- regions that are measured beside the main one ---- */

enum { GSN_MOST_REGIONS = 8 };

/* name: 1 to 40 letters, digits, - and _ of ASCII. */
struct gsn_protocol_region {
    char *name; /* owned */
    struct gsn_region region;
};

enum gsn_kind { GSN_KIND_SECTIONS, GSN_KIND_VOLUME, GSN_KIND_TILE };

enum gsn_protocol_order { GSN_PROTOCOL_ROW, GSN_PROTOCOL_COLUMN, GSN_PROTOCOL_SNAKE };

enum gsn_protocol_transfer {
    GSN_PROTOCOL_TRANSFER_UNKNOWN,
    GSN_PROTOCOL_LINEAR,
    GSN_PROTOCOL_SRGB
};

enum gsn_protocol_dyes {
    GSN_PROTOCOL_DYES_NONE,
    GSN_PROTOCOL_DYES_BUILTIN,
    GSN_PROTOCOL_DYES_ESTIMATE
};

enum gsn_spacing_unit { GSN_SPACING_UNSAID, GSN_SPACING_UM, GSN_SPACING_MM };

enum gsn_protocol_strain {
    GSN_PROTOCOL_STRAIN_REPORTED, /* the default */
    GSN_PROTOCOL_STRAIN_RIGID,
    GSN_PROTOCOL_STRAIN_CORRECTED,
    GSN_PROTOCOL_STRAIN_TISSUE,
};

enum gsn_protocol_registration {
    GSN_PROTOCOL_MARKS_AND_TISSUE, /* the default */
    GSN_PROTOCOL_MARKS,
    GSN_PROTOCOL_TISSUE,
};

struct gsn_protocol {
    enum gsn_kind kind;
    char *specimen, *study, *group, *animal; /* never NULL; "" when not stated */
    char *baseline;                          /* specimen or group; "" when not stated */
    double week;                             /* NaN when not stated */
    double px_um;                            /* of the scan; 0 when not stated */
    double level;     /* of a slide: which of its levels is read; NaN when not stated */
    double target_um; /* of a slide: the coarsest level of at most this; 0 when not stated */
    double interval_um;
    double voxel_um; /* of the stack, in the plane of a section; 0: the finest panel's pixel */
    unsigned panels, rows, columns, sections;
    enum gsn_protocol_order order;
    enum gsn_protocol_transfer transfer;
    enum gsn_protocol_strain strain;             /* what becomes of a section's own stretch */
    enum gsn_protocol_registration registration; /* by what the sections are laid */
    unsigned frame_panel, frame_slot; /* the section whose panel's picture is the block frame, both
                                         1-based; 0: not stated, or not by tissue alone */
    struct gsn_region region;
    size_t named_count; /* at most GSN_MOST_REGIONS; 0 for a tile */
    struct gsn_protocol_region *named; /* owned, in the order of the job; NULL when there is none */
    struct gsn_region reference_tissue; /* a shape; GSN_REGION_NONE: the stain is not normalised */
    struct gsn_region collagen_free;    /* a shape of tissue that holds none; NONE: not stated */
    double reference_density;           /* what that tissue's density is taken to be */
    size_t calibration_count;
    struct gsn_protocol_calibration *calibration; /* owned; NULL when none is stated */
    char *batch;                                  /* of the stain; "" when not stated */
    char *stained, *scanned;                      /* dates as YYYY-MM-DD; "" when not stated */
    double days_to_scan;                          /* between them; NaN when not both are stated */
    double yellow_to_red[2];                      /* limits of the batch; 0: not stated */
    int has_markers;
    struct gsn_point markers_um[3];
    size_t threshold_count;
    double threshold[8];
    double tolerance; /* of the fit, in density units; 0: the pipeline's default */
    char *file;       /* kind volume: the volume; kind tile: the picture; else NULL */
    char *reference;  /* kind tile: the mask to compare with; else NULL */
    enum gsn_protocol_dyes dyes;
    int has_white;
    double white[3]; /* tile without blank glass: the light of the empty slide, 0..1 codes */
    char *unknown;   /* keys that are not ours, quoted and with commas; NULL when there is none */
    const char
        *unknown_near; /* the key that the first of them was meant to be; NULL: none is near */
    enum gsn_spacing_unit spacing_unit; /* of volumes and masks whose header states none */
};

/* gives. Fails with GSN_E_INPUT naming the key and what is allowed; GSN_E_NOMEM. */
int gsn_protocol_parse(const char *json, size_t size, struct gsn_protocol **ret_protocol,
                       struct gsn_error *err);
void gsn_protocol_free(struct gsn_protocol *protocol);
GSN_DEFINE_AUTO(gsn_protocol);

/* The number of slots of all stated panels, or the stated sections when that is less. */
unsigned gsn_protocol_sections(const struct gsn_protocol *protocol);

/* The layout as the register's own record. */
struct gsn_layout gsn_protocol_layout(const struct gsn_protocol *protocol);

#endif
