/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What tissue without collagen looks like, in the one mixture that a loss depends on, as the
 * tissue's own colours bound it.
 *
 * Of treated tissue take away so much of the control's that no collagen is left: what remains has
 * the colour of tissue without collagen, and how much had to be taken away is the loss. No table of
 * dye vectors says where that is, but the tissue does: no cell holds less than no collagen, so the
 * line in hue from the control through the treated tissue leaves the cloud of all cells no later
 * than at that colour. Cells at the end of the cloud may hold collagen all the same, so the loss
 * found is the largest that it can be, and what the purest cells hold is to be taken off it. */
#ifndef GSN_STAIN_EDGE_H
#define GSN_STAIN_EDGE_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Cells of one hue. */
struct gsn_edge_point {
    double hue[3]; /* shares of R, G and B; they sum to 1 */
    double cells;
    double variance[3]; /* of each share, by the noise of the scan */
};

/* Optical density in amounts of three colours: of the control's tissue, of what remains once
 * collagen is gone, and of what lies across to both; each in R + G + B of it. The first is 0 on the
 * edge of the cloud. */
struct gsn_edge {
    double frame[3][3]; /* rows: what an amount takes of R, G and B */
    double remains[3];  /* the hue of the second */
    double vertex; /* how wide the foremost cells are spread, from half a per cent of them to 5 %,
                      control's tissue over what remains: tissue without collagen has one hue */
    double cells; /* that the edge rests on */
};

/* control, treated: mean optical density of the two. Fails with GSN_E_STAIN when the line between
 * them does not leave the cloud where it has cells enough, or there is no line; GSN_E_NOMEM. */
int gsn_edge_find(const struct gsn_edge_point *point, size_t points, const double control[3],
                  const double treated[3], struct gsn_edge *ret_edge, struct gsn_error *err);

/* Where other cells, of one panel for instance, have their edge: control's tissue over what
 * remains. Fails with GSN_E_STAIN when fewer than 300 cells are near it; GSN_E_NOMEM. */
int gsn_edge_of(const struct gsn_edge *edge, const struct gsn_edge_point *point, size_t points,
                double *ret_at, struct gsn_error *err);

/* Treated over control, 1 - loss, when the purest cells hold so much of the control's tissue. */
double gsn_edge_ratio(const struct gsn_edge *edge, const double control[3], const double treated[3],
                      double purest);

#ifdef __cplusplus
}
#endif
#endif
