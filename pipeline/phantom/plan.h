/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The plan of a specimen: which it is, at which level of difficulty, and how its sections lie on
 * the panels; planning.h makes one.
 *
 * Panels are numbered from 1, slots from 0 row by row, sections k from 0. Panel pixels have their
 * centres at +0.5. A plan is a plain value: everything drawn at random for the poses is in it. */
#ifndef GSN_PHANTOM_PLAN_H
#define GSN_PHANTOM_PLAN_H

#include "pipeline/core/error.h"
#include "pipeline/phantom/defect.h"
#include "pipeline/phantom/geometry.h"
#include "pipeline/phantom/random.h"
#include "pipeline/phantom/stain.h"
#include "pipeline/phantom/variant.h"
#include "pipeline/phantom/warp.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_PHANTOM_SECTIONS = 60,
    GSN_PHANTOM_COLUMNS = 4,
    GSN_PHANTOM_ROWS = 3,
    GSN_PHANTOM_SLOTS = GSN_PHANTOM_COLUMNS * GSN_PHANTOM_ROWS,
    GSN_PHANTOM_PANELS = GSN_PHANTOM_SECTIONS / GSN_PHANTOM_SLOTS,
    /* Those above are the usual layout; a variant may have 4 to 24 slots. */
    GSN_PHANTOM_SLOTS_MOST = 24,
    GSN_PHANTOM_PANELS_MOST = GSN_PHANTOM_SECTIONS / 4,
    GSN_PHANTOM_DEFECTS_MOST = 240
};

#define GSN_PHANTOM_STUDY "GVP-D"

/* One column of the table of levels; angles in degrees, lengths in um, shares 0..1. */
struct gsn_phantom_level {
    const char *name;
    double turn_within_deg, turn_sd_deg, half_turn_share, flip_share;
    double jitter_um, size_sd, axis_sd, warp_rms_um;
    double mark_missing_share, mark_wander_um;
    int decoys_most;
    double ln_red_sd, ln_yellow_sd, dye_turn_deg, white_sd;
    double ramp, illumination, noise_sd, texture;
    int defects_least, defects_most, missing_least, missing_most; /* in 12 sections */
    int handled;           /* poses, marks and stain vary, and the grain turns with its section */
    int awkward;           /* files come in as gsn_phantom_delivery_draw() says */
    const char *extension; /* of the panel files, without the dot */
    int quality;           /* of JPEG */
};

struct gsn_phantom_specimen {
    const char *name, *group, *animal;
    int week;
    double depth;                 /* A */
    double red_gain, yellow_gain; /* of the stain */
    int draws_as;                 /* whose random numbers it shares */
    const char *baseline;         /* what its loss is measured against; NULL for a control */
    int sections;
    double bone_gain;   /* of this animal, against the block */
    double usual_px_um; /* what it is scanned with when nothing else is asked for */
};

/* One laser mark in one section, as burnt: its centre in the block, and an ellipse of this mean
 * radius, ratio of axes and direction of the longer. */
struct gsn_phantom_mark {
    int missing;
    struct gsn_point centre;
    double radius_um, ratio, turn;
};

/* What may be taken for a mark and is none. */
enum gsn_phantom_decoy_kind {
    GSN_PHANTOM_DEBRIS, /* round and dark, without the pale ring */
    GSN_PHANTOM_PIGMENT,
    GSN_PHANTOM_NUCLEI,
    GSN_PHANTOM_INK_DOT,
    GSN_PHANTOM_BUBBLE_RIM,
    GSN_PHANTOM_DECOY_KINDS
};

/* It lies on the panel, um from the upper left corner. */
struct gsn_phantom_decoy {
    enum gsn_phantom_decoy_kind kind;
    struct gsn_point at_um;
    double radius_um;
};

/* k is the section that belongs in the slot; shows the one that was mounted there, -1 for none. */
struct gsn_phantom_section {
    int k, panel, slot, flip, shows;
    double z_um, theta, sx, sy;
    struct gsn_point centre_px;
    struct gsn_affine to_panel; /* m: block um -> panel px */
    struct gsn_phantom_mark mark[GSN_PHANTOM_MARKS];
    int decoys;
    struct gsn_phantom_decoy decoy[GSN_PHANTOM_DECOYS_MOST];
};

/* One panel's stain and glass. The gains are those of the specimen and of the batch together. */
struct gsn_phantom_batch {
    double red_gain, yellow_gain;
    double dye[GSN_PHANTOM_DYES][3]; /* unit vectors R, G, B */
    double white[3];
};

/* One file as the scanner delivers it. */
struct gsn_phantom_file {
    int panel;        /* from 1 */
    int again;        /* a second scan of a panel that was delivered already */
    int orientation;  /* of EXIF: 1 upright, 3, 6, 8 */
    int bits, passes; /* per sample; times the picture went through JPEG */
    double kept;      /* share of its bytes that came through */
    double tag_um;    /* the pixel size it states */
    const char *extension;
};

struct gsn_phantom_plan {
    struct gsn_phantom_specimen specimen; /* as the variant has it, and so the level */
    struct gsn_phantom_level level;
    struct gsn_phantom_variant variant; /* its text is the caller's */
    int sections, panels;               /* of the arrays below only so many count */
    int slots;                          /* of a panel */
    uint64_t seed;
    double px_um;
    uint32_t width, height; /* of a panel */
    struct gsn_phantom_section section[GSN_PHANTOM_SECTIONS];
    struct gsn_phantom_batch batch[GSN_PHANTOM_PANELS_MOST];
    int files, missing_panel; /* a panel that is not delivered; 0 for none */
    struct gsn_phantom_file file[GSN_PHANTOM_PANELS_MOST + 1];
    size_t defects;
    struct gsn_phantom_defect defect[GSN_PHANTOM_DEFECTS_MOST];
};

/* The specimens "S00".."S04", and those of the study: animals N1..N4 (controls), S1..S4 and U1..U4
 * in week 8, T2, T4 and T8 along time. By name, with or without "GVP-D-", NULL for a name nobody
 * defined; and by number, the study's following each other from GSN_PHANTOM_STUDY_FIRST on. */
enum { GSN_PHANTOM_STUDY_FIRST = 5, GSN_PHANTOM_SPECIMENS = 20 };
const struct gsn_phantom_specimen *gsn_phantom_specimen_find(const char *name);
const struct gsn_phantom_specimen *gsn_phantom_specimen_at(int i);

/* Whether marks, decoys and stain differ from section to section and panel to panel, so that the
 * truth has to say them: at the levels that are handled, and in every variant. */
int gsn_phantom_plan_varies(const struct gsn_phantom_plan *plan);

/* A stream of random numbers for the n-th thing of its kind in this specimen. */
struct gsn_phantom_random gsn_phantom_plan_random(const struct gsn_phantom_plan *plan,
                                                  enum gsn_phantom_stream stream, int n,
                                                  uint32_t minor);

/* Draws the warp n(p) of what lies in the slot of section k; all 0 at levels without one. */
void gsn_phantom_plan_warp(const struct gsn_phantom_plan *plan, int k,
                           struct gsn_phantom_warp *ret_warp);

/* X(p) without n(p): the material point (um, in the block's x and y) that a panel pixel shows. */
struct gsn_point gsn_phantom_material(const struct gsn_phantom_section *section, double px_um,
                                      struct gsn_point p);

/* Its inverse, m: p = c + R(theta) diag(sx, sy) Flip X / px_um. */
struct gsn_affine gsn_phantom_panel_map(const struct gsn_phantom_section *section, double px_um);

/* A length as whole pixels, at least 0 and at most so many. */
uint32_t gsn_phantom_to_px(double um, double px_um, uint32_t most);

/* Where a slot lies on a panel, in um from the upper left corner of its picture. */
struct gsn_point gsn_phantom_slot_centre_um(const struct gsn_phantom_plan *plan, int slot);

/* How wide the scanner's black bed shows around the panel. */
double gsn_phantom_frame_um(const struct gsn_phantom_plan *plan);

/* Half the pitch of the slots, 4 mm. */
extern const double gsn_phantom_slot_half_um;

#ifdef __cplusplus
}
#endif
#endif
