/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections of a specimen and how they lie in the block: what the first stage returns, and all
 * later ones read.
 *
 * poses.c lists the sections and solves the stack by marks, tissue_poses.c by the tissue of
 * neighbours, and tissue_refinement.c moves sections on where the job asks for it. */
#ifndef GSN_SPECIMEN_POSES_H
#define GSN_SPECIMEN_POSES_H

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/tissue/pose_check.h"
#include "pipeline/register/tissue/pose_graph.h"
#include "pipeline/specimen/calibration_panel.h"
#include "pipeline/specimen/region.h"
#include "pipeline/specimen/section_flags.h"
#include "pipeline/specimen/specimen.h"

/* Bytes of a sentence about poses. */
enum { GSN_POSE_SENTENCE = 480 };

enum gsn_section_state {
    GSN_SECTION_USED,
    GSN_SECTION_DOUBTFUL, /* used, on two marks: a person should look */
    GSN_SECTION_HELD,     /* not used: its place is not known well enough */
    GSN_SECTION_MISSING,  /* expected, but not there or on a refused panel */
    GSN_SECTION_EMPTY,
};

/* Where its neighbours' tissue places a section, perhaps too roughly for a pose. */
struct gsn_tissue_place {
    int known;
    struct gsn_affine panel_to_block_um;
    double error_um; /* predicted, root mean square over its tissue */
};

/* The stack where the job places it by tissue alone. */
struct gsn_by_tissue {
    int done;
    size_t frame; /* the section whose panel's picture, pixels times their size, is the block */
    struct gsn_tissue_summary summary; /* lengths um */
};

/* One slot, found or not. */
struct gsn_section {
    unsigned panel; /* 1-based */
    struct gsn_panel_section seen;
    int posed;
    struct gsn_pose pose;
    enum gsn_section_state state;
    struct gsn_tissue_finding finding; /* whether its neighbours' tissue bears out its marks */
    struct gsn_tissue_place place;     /* of one that its marks do not place */
    struct gsn_section_flags flags;    /* begin with those of seen */
    struct gsn_candidates candidates;  /* as the stack places them */
};

/* The marks of a section as they are known by now. */
struct gsn_section_marks {
    struct gsn_fiducial mark[GSN_FIDUCIALS];
};

/* What became of the sections that were to be placed by their tissue. */
struct gsn_refinement {
    int done;
    size_t sections, compared; /* that have a pose, and whose tissue told something of it */
    double radius_um;          /* of the disc that was compared */
    double moved_um;           /* root mean square over the region and all sections */
    double area_mean, area_sd; /* of what the tissue added to the sections' area, shares of it */
    double factor[2];          /* errors against the stated: of the marks, of the comparisons */
    char why[240];             /* why not done, or empty */
};

struct gsn_poses {
    size_t section_count;
    struct gsn_section *section; /* owned; by serial, then panel and slot */
    int solved; /* whether there is a block frame: of the stack's triangle, or by tissue */
    struct gsn_pose_summary summary; /* of the marks; 0 where none was asked for */
    struct gsn_by_tissue by_tissue;
    struct gsn_strain_common panel_stretch; /* what the scan did to all sections alike */
    enum gsn_strain_mode strain_mode;       /* the protocol's */
    struct gsn_block_box extent;            /* of the posed sections before they were refined */
    struct gsn_refinement refinement;       /* where the mode is GSN_STRAIN_TISSUE */
    char unsolved[600];                     /* why not, or empty */
};

/* The sections that the job expects or that came, in their order, without poses; fills what is
 * there zeroed. Fails with GSN_E_NOMEM. */
int gsn_poses_list(const struct gsn_specimen *specimen, struct gsn_poses *poses,
                   struct gsn_error *err);
void gsn_poses_done(struct gsn_poses *poses);

/* gives: the marks of all sections as their panels show them. Fails with GSN_E_NOMEM. */
int gsn_poses_marks(const struct gsn_poses *poses, struct gsn_section_marks **ret_marks,
                    struct gsn_error *err);

/* How many sections the block has, the last that was listed counted from the first serial number.
 */
unsigned gsn_poses_length(const struct gsn_poses *poses);
/* "used", "doubtful", "held", "missing", "empty". */
const char *gsn_section_state_name(enum gsn_section_state state);

/* ---- by marks (poses.c) ---- */

/* Poses of all sections together by their marks, where the job asks for marks. A stack that cannot
 * be solved is a state, with a sentence. */
int gsn_poses_by_fiducials(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                           struct gsn_poses *poses, struct gsn_error *err);
/* Gives a section with three marks the ways to place it on two of them, and that on all. */
void gsn_candidates_offer_marks(const struct gsn_specimen *specimen,
                                const struct gsn_pose_options *options,
                                const struct gsn_poses *poses, struct gsn_section *section);

/* ---- by tissue (tissue_poses.c) ----
 *
 * Sections that their marks place are held against the tissue of their neighbours
 * (register/tissue/pose_check.h), and those that marks do not place are placed by it
 * (register/tissue/pose_graph.h).
 *
 * A section that its marks place elsewhere than its neighbours' tissue does is flagged
 * "tissue-disagrees" and treated as one without marks, unless a person chose them.
 *
 * A section with no mark, with marks that could be others or that contradict the stack is placed
 * where the sections around it put it, which their marks hold. It is used, flagged "by-tissue", as
 * one that a person should look at; where tissue cannot tell either it stays held. Of spots that
 * could be one mark or another, those are its marks that place it as its tissue does, when no
 * others come near; the pose stays the tissue's. Two spots that leave more than one pose open are
 * asked about: where the tissue surely lies elsewhere, they were not the section's marks. */

/* Places what it can; needs a stack that the marks solved, and does nothing otherwise. The panels
 * are opened once more, made small. Fails with GSN_E_NOMEM, GSN_E_IO and as gsn_scan_survey() does.
 */
int gsn_poses_by_tissue(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options, const struct gsn_mask *region,
                        struct gsn_poses *poses, struct gsn_error *err);
/* How many were placed so. */
size_t gsn_poses_count_by_tissue(const struct gsn_poses *poses);
/* On an opened panel, the marks of the sections that their tissue has placed: spots that lie where
 * it puts a mark and look like the panel's others, into ret_marks, one for each section; those of
 * others stay. The pose stays the tissue's. Fails as gsn_fiducial_search_panel(). */
int gsn_fiducials_by_tissue(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                            unsigned panel, const struct gsn_poses *poses,
                            struct gsn_section_marks *ret_marks, struct gsn_error *err);

/* ---- refined by tissue (tissue_refinement.c) ---- */

/* Where the job asks for it, opens every panel and moves the sections on by what their tissue has
 * in common with their neighbours'. That it cannot be done is a state, with a sentence. */
int gsn_poses_refine(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, const struct gsn_mask *region,
                     struct gsn_calibrations *calibrations, struct gsn_poses *poses,
                     struct gsn_error *err);

#endif
