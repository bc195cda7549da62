/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A plain folder of section pictures, one section a picture, registered by its three marks; by the
 * tissue of its neighbours where it has none and the caller agrees (register/tissue/pose_graph.h).
 *
 * This needs no protocol, no store and no panels. The frame is that of the marks the caller states,
 * or else the mean triangle's (pose.h). Lengths are um when the pixel size is stated, otherwise
 * pixels; then burns are looked for as if a pixel were GSN_FOLDER_PX_UM wide. */
#ifndef GSN_FOLDER_REGISTER_FOLDER_H
#define GSN_FOLDER_REGISTER_FOLDER_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/tre.h"
#include "pipeline/register/tissue/pose_graph.h"

#define GSN_FOLDER_PX_UM 5.0
#define GSN_FOLDER_ELLIPSES 5

struct gsn_decoder; /* pipeline/decode/apart.h */

struct gsn_folder_options {
    struct gsn_decoder *decoder;  /* NULL: decode in this process */
    double px_um;                 /* 0: not stated, lengths are pixels */
    const struct gsn_point *mark; /* the three marks in the frame wanted, or NULL */
    double radius; /* the error is given over a disc of this radius about the frame's origin; 0: at
                      the marks' own distance */
    int by_tissue; /* sections that marks do not lay are laid by the tissue of their neighbours; all
                      of them where fewer than half have marks and none were stated, for then what
                      looks like marks may be chance. Without any marks the frame is the picture of
                      the section in the middle */
};

/* 95 of 100 errors at a point of the frame are inside. Pixels, along the frame's axes. */
struct gsn_folder_ellipse {
    struct gsn_point at; /* caller's unit */
    struct gsn_ellipse px;
};

struct gsn_folder_section {
    char *file;                    /* name without the folder */
    enum gsn_pose_state state;     /* by its marks */
    int by_tissue;                 /* the pose is that of its tissue */
    unsigned from;                 /* then: sections to the nearest that is held by marks, or to the
                                      one whose picture is the frame */
    struct gsn_affine frame_to_px; /* pixel centres at whole numbers: the first pixel is (0, 0) */
    double error_px;               /* predicted, root mean square over the disc; with the marks'
                                      doubt where they disagree; over the tissue when laid
                                      by it, drift included */
    struct gsn_folder_ellipse ellipse[GSN_FOLDER_ELLIPSES]; /* at the frame's origin and on the
                      disc's rim along the axes; 0 when laid by tissue */
    double rms_px;                                          /* what is left at the marks */
    double score, runner_up; /* likelihood of the marks chosen, and of the best other choice */
    int flipped;
    char flags[96];   /* words with one space between, or empty */
    char reason[480]; /* why there is no pose; empty when there is one */
};

struct gsn_folder_stack {
    size_t count;
    struct gsn_folder_section *section; /* in the order of the names, numbers as numbers */
    struct gsn_pose_summary summary;    /* of the sections with a pose; in the caller's unit */
    double fle_px;                      /* localisation error of a mark, root mean square */
    size_t by_tissue;
    struct gsn_tissue_summary tissue; /* lengths px; 0 when nothing was laid by tissue */
    double cpu_ms; /* of one section, everything but reading and decoding: median of the search and
                      its share of what is done for all */
};

/* Registers every picture of the folder dir. Pictures that cannot be read, or show no marks, are in
 * the answer with a reason. gives: ret_stack. Fails with GSN_E_NOTFOUND, GSN_E_IO; GSN_E_INPUT when
 * there is no picture; GSN_E_MARKERS when the sections agree on no triangle and may not be laid by
 * tissue, or the marks stated are degenerate; GSN_E_NOMEM. */
int gsn_folder_register(const char *dir, const struct gsn_folder_options *options,
                        struct gsn_folder_stack **ret_stack, struct gsn_error *err);
void gsn_folder_stack_free(struct gsn_folder_stack *stack);
GSN_DEFINE_AUTO(gsn_folder_stack);

#endif
