/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_ladder.h"

#include "pipeline/core/mem.h"

#include <assert.h>

const double gsn_ladder_variance[GSN_LADDER_LEVELS] = { 1, 5, 21, 85 };

/* Cells between the taps of a level. */
static size_t apart_of(size_t level)
{
    return (size_t)1 << level;
}

int gsn_mark_ladder_init(struct gsn_mark_ladder *ladder, const struct gsn_mark_field *field,
                         size_t rungs, struct gsn_error *err)
{
    const size_t width = field->width, beside = 4 * apart_of(rungs);
    struct gsn_mark_ladder own = { .field = field, .run = gsn_mark_rows_best(), .rungs = rungs };
    const size_t plane = 8 * apart_of(rungs) * width, near = GSN_LADDER_NEAR * width;

    assert(rungs >= 1 && rungs <= GSN_LADDER_RUNGS);

    /* The last level is made of rows up to 2 * apart above and below; by then the first has got
     * nearly 4 * apart ahead of it. */
    own.kept = 8 * apart_of(rungs);
    own.room = gsn_alloc(((rungs + 1) * plane + rungs * near + width + beside) * sizeof *own.room);
    if (!own.room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t k = 0; k <= rungs; k++)
        own.level[k] = own.room + k * plane;
    for (size_t k = 0; k < rungs; k++)
        own.rung[k] = own.room + (rungs + 1) * plane + k * near;
    own.margin = own.room + (rungs + 1) * plane + rungs * near;
    *ladder = own;
    return GSN_OK;
}

void gsn_mark_ladder_done(struct gsn_mark_ladder *ladder)
{
    gsn_free(ladder->room);
}

static const float *source_row(const struct gsn_mark_ladder *ladder, size_t level, size_t y)
{
    return level == 0 ? ladder->field->od + y * ladder->field->width
                      : gsn_mark_ladder_level(ladder, level - 1, y);
}

/* One row of a blur. */
static void blur(const struct gsn_mark_ladder *ladder, size_t level, size_t y)
{
    const size_t width = ladder->field->width, last = ladder->field->height - 1;
    const size_t apart = apart_of(level);
    float *row = ladder->margin + 2 * apart;
    const float *from[5];

    for (size_t k = 0; k < 5; k++) {
        const size_t down = y + k * apart;

        from[k] = source_row(ladder, level,
                             down < 2 * apart          ? 0
                             : down - 2 * apart < last ? down - 2 * apart
                                                       : last);
    }
    ladder->run->blend(from, width, row);
    for (size_t i = 1; i <= 2 * apart; i++) {
        row[-(ptrdiff_t)i] = row[0];
        row[width - 1 + i] = row[width - 1];
    }
    for (size_t k = 0; k < 5; k++)
        from[k] = ladder->margin + k * apart;
    ladder->run->blend(from, width, ladder->level[level] + (y & (ladder->kept - 1)) * width);
}

/* Works a level out up to a row, and those below it as far as it takes. */
static void climb(struct gsn_mark_ladder *ladder, size_t level, size_t y)
{
    const size_t last = ladder->field->height - 1, to = y < last ? y : last;

    if (level > 0)
        climb(ladder, level - 1, to + 2 * apart_of(level));
    for (; ladder->done[level] <= to; ladder->done[level]++)
        blur(ladder, level, ladder->done[level]);
}

void gsn_mark_ladder_climb(struct gsn_mark_ladder *ladder, size_t y)
{
    const size_t width = ladder->field->width, rungs = ladder->rungs;
    const size_t from = ladder->done[rungs];

    climb(ladder, rungs, y + 1);
    for (size_t row = from; row < ladder->done[rungs]; row++)
        for (size_t k = 0; k < rungs; k++)
            ladder->run->less(gsn_mark_ladder_level(ladder, k, row),
                              gsn_mark_ladder_level(ladder, k + 1, row), width,
                              ladder->rung[k] + (row & (GSN_LADDER_NEAR - 1)) * width);
}
