/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/register/median.h"

#include <math.h>
#include <string.h>

/* Two mounts share this much of their detail at least, and this much more than neighbours of this
 * stack do, in standard deviations of what neighbours share. */
static const double SAME = 0.42, SAME_DEVIATIONS = 5;
/* What two mounts of a section share when each is laid and stained for itself. Where the limit is
 * above, neighbours share so much that nothing could tell a section that is there twice. */
static const double TWO_MOUNTS = 0.6;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;

/* What sets a section apart. At the ends of the stack the lines reach beyond what they go through,
 * and their error would count as detail. */
static double detail(const struct gsn_sequence_stack *s, size_t i, double usual)
{
    return i < 2 || i + 2 >= s->n ? fmin(s->own[i], usual) : s->own[i];
}

/* What sets plane i apart from the line through its neighbours, times plane j's. */
static double product(const struct gsn_sequence_stack *s, size_t i, size_t j)
{
    const struct gsn_sequence_line a = gsn_sequence_line_at(s->z, s->n, i, j, s->z[i]),
                                   b = gsn_sequence_line_at(s->z, s->n, j, i, s->z[j]);

    return s->gram[i * s->n + j] - gsn_sequence_line_plane(s, &a, j) -
           gsn_sequence_line_plane(s, &b, i) + gsn_sequence_line_line(s, &a, &b);
}

/* Share of what sets two sections apart from their neighbours that they have in common: 1 for the
 * same picture, about 0 for two sections with grain of their own. Both what is left when one is
 * taken from the other and what goes with the other must say so: a section in a wrong place has
 * much that sets it apart, and differs little from those it belongs to; the last two at either end
 * share the error of one line, and differ. */
static double shared(const struct gsn_sequence_stack *s, size_t i, size_t j, double usual)
{
    const double *gram = s->gram;
    const double apart = gram[i * s->n + i] + gram[j * s->n + j] - 2 * gram[i * s->n + j];
    const double both = detail(s, i, usual) + detail(s, j, usual);

    if (!(both > 0) || !(s->own[i] > 0) || !(s->own[j] > 0))
        return 0;
    return fmin(1 - apart / both, product(s, i, j) / sqrt(s->own[i] * s->own[j]));
}

/* What only two mounts of one section share in this stack: neighbours of a stack without detail of
 * its own share whatever bends their tissue away from a straight line. */
static double limit(const struct gsn_sequence_stack *s, double usual, double *room)
{
    const size_t pairs = s->n - 1;
    double median;

    for (size_t i = 0; i < pairs; i++)
        room[i] = shared(s, i, i + 1, usual);
    median = gsn_median(room, pairs);
    for (size_t i = 0; i < pairs; i++)
        room[i] = fabs(shared(s, i, i + 1, usual) - median);
    return fmax(SAME, median + SAME_DEVIATIONS * MAD_TO_SD * gsn_median(room, pairs));
}

void gsn_sequence_find_duplicates(const struct gsn_sequence_stack *s,
                                  const struct gsn_sequence_plane *planes,
                                  struct gsn_sequence *found)
{
    double *room = s->room, usual, least;

    memcpy(room, s->own, s->n * sizeof *room);
    usual = gsn_median(room, s->n);
    least = limit(s, usual, room);
    found->twice_told = least <= TWO_MOUNTS;
    for (size_t i = 0; i < s->n && found->twice_told; i++)
        for (size_t j = i + 1; j < s->n && found->count < s->n; j++) {
            const double share = shared(s, i, j, usual);

            if (share > least)
                found->finding[found->count++] = (struct gsn_sequence_finding){
                    GSN_SEQUENCE_DUPLICATE, planes[i].serial, planes[j].serial, share, 0, 0
                };
        }
}
