/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Blurs of a reduced picture, each about twice as wide as the one before, and their differences.
 *
 * B3 splines: the kernel 1 4 6 4 1, spread by 1, 2, 4 and 8 cells. Rows are worked out as they are
 * asked for, from the first to the last, and only those that others need are kept: whole planes
 * would cost more in memory touched for the first time than in arithmetic. Edges repeat. Private to
 * pipeline/register. */
#ifndef GSN_REGISTER_MARK_LADDER_H
#define GSN_REGISTER_MARK_LADDER_H

#include "pipeline/register/mark_field.h"
#include "pipeline/register/mark_rows.h"

enum { GSN_LADDER_LEVELS = 4, GSN_LADDER_RUNGS = GSN_LADDER_LEVELS - 1 };
/* Rows of a difference that are at hand; a power of two. */
enum { GSN_LADDER_NEAR = 4 };
/* By which the levels blur, cells squared. */
extern const double gsn_ladder_variance[GSN_LADDER_LEVELS];

struct gsn_mark_ladder {
    const struct gsn_mark_field *field;
    const struct gsn_mark_rows *run;
    size_t rungs;                    /* differences, one less than levels */
    size_t kept;                     /* rows of a level that are at hand: a power of two */
    size_t done[GSN_LADDER_LEVELS];  /* rows of each level so far */
    float *level[GSN_LADDER_LEVELS]; /* kept rows */
    float *rung[GSN_LADDER_RUNGS];   /* level k less level k + 1 */
    float *margin;                   /* a row, and what repeats on either side */
    float *room;                     /* all of the above */
};

/* borrows: field, as long as the ladder is used. Fails with GSN_E_NOMEM. */
int gsn_mark_ladder_init(struct gsn_mark_ladder *ladder, const struct gsn_mark_field *field,
                         size_t rungs, struct gsn_error *err);
void gsn_mark_ladder_done(struct gsn_mark_ladder *ladder);

/* Makes rows y - 1, y and y + 1 available, of what there are; y never falls. */
void gsn_mark_ladder_climb(struct gsn_mark_ladder *ladder, size_t y);

static inline const float *gsn_mark_ladder_level(const struct gsn_mark_ladder *ladder, size_t level,
                                                 size_t y)
{
    return ladder->level[level] + (y & (ladder->kept - 1)) * ladder->field->width;
}

static inline const float *gsn_mark_ladder_rung(const struct gsn_mark_ladder *ladder, size_t rung,
                                                size_t y)
{
    return ladder->rung[rung] + (y & (GSN_LADDER_NEAR - 1)) * ladder->field->width;
}

#endif
