/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The three laser marks of a section: fiducials, burnt through the block parallel to the cutting
 * direction.
 *
 * Char absorbs red light and the dyes hardly do, so marks are looked for in the optical density
 * (log10) of the red channel: dark round blobs (blob.h), each then localised by the fit of a
 * blurred disc (localise.h). Which blobs are the marks, and which is which, is told by the side
 * lengths of the triangle, which turning and mirroring leave alone (correspondence.h). Positions
 * are in panel pixels with centres at +0.5, triangles in micrometres.
 *
 * The order of work over a stack: gsn_fiducials_detect() for each section (detect.h); where the
 * protocol gives no triangle, gsn_fiducials_vote_triangle() over all of them (triangle.h);
 * gsn_fiducials_learn() over all of them (learn.h); gsn_fiducials_match() for each
 * (correspondence.h); gsn_fiducials_detect_like() and another choice where marks are missing. */
#ifndef GSN_REGISTER_FIDUCIAL_FIDUCIAL_H
#define GSN_REGISTER_FIDUCIAL_FIDUCIAL_H

#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_FIDUCIALS = 3,
    GSN_FIDUCIAL_CANDIDATES = 96,
    GSN_THUMBNAIL_SIDE = 40,
    GSN_FIDUCIAL_HYPOTHESES = 4,
    GSN_APPEARANCE_CLASSES = 8,
    GSN_BURNS = 7
};

/* What a laser leaves. All marks of a block are alike, so a stack is searched for one kind. */
struct gsn_burn {
    double scale; /* 1: radii of 40 to 150 um are looked for; otherwise so many times that */
    int holes;    /* burnt through: light in a dark rim. Dark discs are found as well. */
};

/* From 14 um to 450, of holes with their rim to 675, the ordinary kind first. */
extern const struct gsn_burn gsn_burns[GSN_BURNS];
/* Discs of 20 to 300 um radius are found where that is so many pixels or more, holes where it is
 * twice as many; smaller ones may be missed. */
#define GSN_FIDUCIAL_MIN_UM 20.0
#define GSN_FIDUCIAL_MIN_PX 2.0

struct gsn_fiducial {
    struct gsn_point px;
    double radius_px;
    double contrast;               /* optical density of the disc above the tissue around it */
    double cov_xx, cov_xy, cov_yy; /* of px, in px^2, from the fit's residuals */
    double score; /* 0..1: the share of the picture's variance around it that the fit explains */
    int found;    /* 0: no acceptable mark, everything else is 0 */
};

/* Optical density from afar: GSN_THUMBNAIL_SIDE by GSN_THUMBNAIL_SIDE square cells, NaN where there
 * is none. In pixels of the section, or in um where it is what sections have in common. */
struct gsn_tissue_thumbnail {
    double cell;             /* side of a cell; 0: no picture */
    struct gsn_point origin; /* corner of the first cell */
    float value[GSN_THUMBNAIL_SIDE * GSN_THUMBNAIL_SIDE];
};

/* Every blob of one section that may be a mark, the likeliest first. */
struct gsn_fiducial_candidates {
    double px_um;
    unsigned burn;              /* what was looked for, of gsn_burns */
    struct gsn_point tissue_px; /* centre of the section's tissue */
    struct gsn_tissue_thumbnail map;
    size_t count;
    struct gsn_fiducial mark[GSN_FIDUCIAL_CANDIDATES];
};

/* What is known of the triangle before looking at a section. */
struct gsn_triangle_prior {
    struct gsn_point
        mark_um[GSN_FIDUCIALS]; /* marks 1..3, in the block frame when the protocol gives
                               them, otherwise in a frame of the triangle's own */
    /* Learnt from the stack; all 0 as long as nothing is known. */
    int learnt;
    unsigned burn;              /* of gsn_burns: 0, or what the sections were searched for */
    struct gsn_point tissue_um; /* centre of the tissue, same frame */
    double tissue_sd_um;        /* its scatter per axis from section to section */
    double contrast, radius_um; /* of the typical mark */
    struct gsn_tissue_thumbnail tissue; /* what the sections have in common */
    double stretch_um; /* how far an ordinary section's marks lie from a rigid triangle */
    /* By classes of unlikeness (appearance.h); 0: nothing is known of them. */
    double alike[GSN_APPEARANCE_CLASSES]; /* share of the marks that are at least as unlike */
    double
        chance[GSN_APPEARANCE_CLASSES]; /* blobs per um^2 that are no marks and at most as unlike */
    double area_um2;                    /* in which those were counted, of one section */
    double marked; /* share of the sections that have marks at all; 0: not known */
};

#ifdef __cplusplus
}
#endif
#endif
