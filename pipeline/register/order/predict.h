/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the sections around a place predict of it: a straight line through them, cell by cell; the
 * noise that sets a section apart from that line; and how far the change between two sections runs
 * along the change that the sections around both predict. */
#ifndef GSN_REGISTER_ORDER_PREDICT_H
#define GSN_REGISTER_ORDER_PREDICT_H

#include "pipeline/register/order/align.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A sum of sections with weights: a straight line through those around a place, taken
 * somewhere. */
struct gsn_sequence_line {
    size_t count, at[GSN_SEQUENCE_AROUND];
    double weight[GSN_SEQUENCE_AROUND];
};

/* Least squares through the sections around place i without i and j, taken at z. */
struct gsn_sequence_line gsn_sequence_line_at(const double *z, size_t n, size_t i, size_t j,
                                              double at);
/* Sum of its squared weights: its noise, in sections'. */
double gsn_sequence_line_noise(const struct gsn_sequence_line *line);

/* What the planes of a line predict of the place that it belongs to, of every step-th cell; of all
 * cells, three on one side are held to their middle. A cell that some of them do not know is the
 * others' on that side: it was filled from beside, and would predict of what lies there now that
 * it lies right. Clears told where no plane of a side knows it. */
void gsn_sequence_predict(const struct gsn_sequence_tissue *tissue,
                          const struct gsn_sequence_line *line, size_t place, size_t step,
                          float *ret_value, unsigned char *predictable);

/* What sets a section apart from the line through its neighbours, cell by cell, in the median.
 * Fails with GSN_E_NOMEM. */
int gsn_sequence_learn_noise(struct gsn_sequence_tissue *tissue, struct gsn_error *err);

/* The change from the plane at place i to that at place j, i < j, along the change that the
 * sections around predict, both in standard errors. In each other's places the two would show
 * the contrary. Errors are told from what squares of cells say each for itself; nothing is shown
 * and nothing predicted where all rests on a few of them. */
struct gsn_sequence_change {
    double shown, predicted;
    double first, second; /* how far the one lies before the middle, and the other behind it */
};
struct gsn_sequence_change gsn_sequence_change_between(const struct gsn_sequence_tissue *tissue,
                                                       size_t i, size_t j);

#ifdef __cplusplus
}
#endif
#endif
