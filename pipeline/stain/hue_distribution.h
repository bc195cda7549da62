/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The colours of a panel's tissue as a distribution over hue, and its edge: what tissue without
 * collagen looks like.
 *
 * Hue is the share of each channel in the optical density of a cell of tissue; amounts of dye drop
 * out of it, and mixtures lie on straight lines between what they are mixed of. */
#ifndef GSN_STAIN_HUE_DISTRIBUTION_H
#define GSN_STAIN_HUE_DISTRIBUTION_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- the histogram ----------------------------------------------------------------------- */

/* It is small enough to be handed on to the specimens that are compared with this one. */

/* The colours of a panel's tissue, counted: a histogram over hue, small enough to be handed on to
 * the specimens that are compared with this one.
 *
 * Hue is the share of each channel in the optical density of a cell of tissue; amounts of dye drop
 * out of it, and mixtures lie on straight lines between what they are mixed of. */

/* Bins of hue: shares of green and of blue from these on, so far apart. All stains of three dyes
 * lie inside; a degree of hue is some four bins. */
#define GSN_CLOUD_SHARE 0.004

#define GSN_CLOUD_LEAST_GREEN 0.15

#define GSN_CLOUD_LEAST_BLUE 0.10

enum { GSN_CLOUD_GREENS = 112, GSN_CLOUD_BLUES = 160 };

/* What is paler than this (R + G + B) is too pale to have a hue. */
#define GSN_CLOUD_LEAST_OD 0.25

/* Cells of one hue. */
struct gsn_cloud_bin {
    uint32_t at;  /* green * GSN_CLOUD_BLUES + blue */
    double cells; /* how many */
    double od;    /* mean R + G + B of them */
};

/* The cloud of one panel. */
struct gsn_cloud_panel {
    unsigned panel;            /* its number, 1-based */
    double noise;              /* variance of a cell's optical density at density 0, one channel */
    int lossy;                 /* whether it went through JPEG, whose colours run over */
    struct gsn_cloud_bin *bin; /* owned; in order of at */
    size_t bins;
};

struct gsn_cloud {
    struct gsn_cloud_panel *panel; /* owned */
    size_t panels;
};

/* gives: panels without bins. Fails with GSN_E_NOMEM. */
int gsn_cloud_new(size_t panels, struct gsn_cloud **ret_cloud, struct gsn_error *err);

void gsn_cloud_free(struct gsn_cloud *cloud);

GSN_DEFINE_AUTO(gsn_cloud);

/* Counts the cells of one panel while they pass. Opaque. */
struct gsn_cloud_tally;

/* gives. Fails with GSN_E_NOMEM. */
int gsn_cloud_tally_new(struct gsn_cloud_tally **ret_tally, struct gsn_error *err);

void gsn_cloud_tally_free(struct gsn_cloud_tally *tally);

GSN_DEFINE_AUTO(gsn_cloud_tally);

/* One cell, or so many alike; what is too pale or no colour of a stain is passed over. */
void gsn_cloud_tally_add(struct gsn_cloud_tally *tally, const double od[3], double cells);

/* The panel takes what was counted, and the tally is empty again. Fails with GSN_E_NOMEM. */
int gsn_cloud_tally_take(struct gsn_cloud_tally *tally, struct gsn_cloud_panel *panel,
                         struct gsn_error *err);

/* R, G and B optical density in the middle of a bin, at its mean total. */
void gsn_cloud_bin_od(const struct gsn_cloud_bin *bin, double ret_od[3]);

/* ---- the edge ---------------------------------------------------------------------------- */

/* What tissue without collagen looks like, in the one mixture that a loss depends on, as the
 * tissue's own colours bound it.
 *
 * Of treated tissue take away so much of the control's that no collagen is left: what remains has
 * the colour of tissue without collagen, and how much had to be taken away is the loss. No table of
 * stain vectors says where that is, but the tissue does: no cell holds less than no collagen, so
 * the line in hue from the control through the treated tissue leaves the cloud of all cells no
 * later than at that colour. Cells at the end of the cloud may hold collagen all the same, so the
 * loss found is the largest that it can be, and what the purest cells hold is to be taken off it.
 */

/* What tissue without collagen looks like, in the one mixture that a loss depends on, as the
 * tissue's own colours bound it.
 *
 * Of treated tissue take away so much of the control's that no collagen is left: what remains has
 * the colour of tissue without collagen, and how much had to be taken away is the loss. No table of
 * dye vectors says where that is, but the tissue does: no cell holds less than no collagen, so the
 * line in hue from the control through the treated tissue leaves the cloud of all cells no later
 * than at that colour. Cells at the end of the cloud may hold collagen all the same, so the loss
 * found is the largest that it can be, and what the purest cells hold is to be taken off it. */

/* Cells of one hue. */
struct gsn_hue_edge_point {
    double hue[3]; /* shares of R, G and B; they sum to 1 */
    double cells;
    double variance[3]; /* of each share, by the noise of the scan */
};

/* Optical density in amounts of three colours: of the control's tissue, of what remains once
 * collagen is gone, and of what lies across to both; each in R + G + B of it. The first is 0 on the
 * edge of the cloud. */
struct gsn_hue_edge {
    double frame[3][3]; /* rows: what an amount takes of R, G and B */
    double remains[3];  /* the hue of the second */
    double vertex; /* how wide the foremost cells are spread, from half a per cent of them to 5 %,
                      control's tissue over what remains: tissue without collagen has one hue */
    double cells;  /* that the edge rests on */
};

/* control, treated: mean optical density of the two. Fails with GSN_E_STAIN when the line between
 * them does not leave the cloud where it has cells enough, or there is no line; GSN_E_NOMEM. */
int gsn_hue_edge_find(const struct gsn_hue_edge_point *point, size_t points,
                      const double control[3], const double treated[3],
                      struct gsn_hue_edge *ret_edge, struct gsn_error *err);

/* Where other cells, of one panel for instance, have their edge: control's tissue over what
 * remains. Fails with GSN_E_STAIN when fewer than 300 cells are near it; GSN_E_NOMEM. */
int gsn_hue_edge_of(const struct gsn_hue_edge *edge, const struct gsn_hue_edge_point *point,
                    size_t points, double *ret_at, struct gsn_error *err);

/* Treated over control, 1 - loss, when the purest cells hold so much of the control's tissue. */
double gsn_hue_edge_ratio(const struct gsn_hue_edge *edge, const double control[3],
                          const double treated[3], double purest);

#ifdef __cplusplus
}
#endif

#endif
