/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include <string.h>

enum { SIDE = GSN_SEQUENCE_SIDE, STRIP = 32 };

/* A section's density is off the middle one of three on its side by no more than this, in standard
 * deviations of its noise. */
static const double MOST = 3;

/* Planes on one side of a place; fewer than three: the last again, with no weight. */
struct side {
    const float *value[SIDE];
    const unsigned char *known[SIDE];
    float much[SIDE];
    size_t count;
};

/* The planes of a line from the first on that lie on its side of a place. */
static struct side take_side(const struct gsn_sequence_tissue *t,
                             const struct gsn_sequence_line *line, size_t first, size_t place)
{
    const size_t cells = t->columns * t->rows;
    struct side s = { .count = 0 };

    for (size_t k = 0; k < SIDE; k++) {
        const size_t i = first + k;
        const int is = i < line->count && (line->at[i] > place) == (line->at[first] > place);
        const size_t plane = t->place[line->at[is ? i : first + s.count - 1]];

        s.value[k] = t->value + plane * cells;
        s.known[k] = t->known + plane * cells;
        s.much[k] = is ? (float)line->weight[i] : 0;
        s.count += (size_t)is;
    }
    return s;
}

/* Cells that are worked out together, and one in so many. */
struct strip {
    size_t first, count, step;
};

static int all_known(const struct side *s, struct strip at)
{
    const unsigned char *a = s->known[0] + at.first, *b = s->known[1] + at.first,
                        *d = s->known[2] + at.first;
    unsigned char all = 1;

    for (size_t c = 0; c < (at.count - 1) * at.step + 1; c++)
        all &= a[c] & b[c] & d[c];
    return all;
}

static void copy(const struct side *s, struct strip at, float ret_value[SIDE][STRIP])
{
    for (size_t k = 0; k < SIDE; k++)
        for (size_t c = 0; c < at.count; c++)
            ret_value[k][c] = s->value[k][at.first + c * at.step];
}

/* A cell that some planes do not know is the others' mean there. */
static void mend_cell(const unsigned char known[SIDE], float value[SIDE][STRIP], size_t c,
                      unsigned char *told)
{
    float sum = 0, count = 0;

    for (size_t k = 0; k < SIDE; k++) {
        sum += known[k] ? value[k][c] : 0;
        count += known[k];
    }
    for (size_t k = 0; k < SIDE && count > 0; k++)
        value[k][c] = known[k] ? value[k][c] : sum / count;
    *told = count > 0 ? *told : 0;
}

static void mend(const struct side *s, struct strip at, float value[SIDE][STRIP],
                 unsigned char *told)
{
    for (size_t c = 0; c < at.count; c++) {
        const size_t i = at.first + c * at.step;
        const unsigned char known[SIDE] = { s->known[0][i], s->known[1][i], s->known[2][i] };

        if (!(known[0] & known[1] & known[2]))
            mend_cell(known, value, c, &told[c]);
    }
}

static void add(const struct side *s, const float *const value[SIDE], size_t count,
                float *restrict sum)
{
    for (size_t k = 0; k < s->count; k++)
        for (size_t c = 0; c < count; c++)
            sum[c] += s->much[k] * value[k][c];
}

/* Three held to their middle. */
static void add_held(const struct side *s, const float *const value[SIDE], const float *deviation,
                     size_t count, float *restrict sum)
{
    const float *a = value[0], *b = value[1], *d = value[2];

    for (size_t c = 0; c < count; c++) {
        const float most = (float)MOST * deviation[c];
        const float mid =
            gsn_sequence_greatest(gsn_sequence_least(a[c], b[c]),
                                  gsn_sequence_least(gsn_sequence_greatest(a[c], b[c]), d[c]));

        sum[c] += s->much[0] * (mid + gsn_sequence_clip(a[c] - mid, most)) +
                  s->much[1] * (mid + gsn_sequence_clip(b[c] - mid, most)) +
                  s->much[2] * (mid + gsn_sequence_clip(d[c] - mid, most));
    }
}

static void add_strip(const struct gsn_sequence_tissue *t, const struct side *s, struct strip at,
                      float *sum, unsigned char *told)
{
    const int all = all_known(s, at);
    const float *value[SIDE];
    float room[SIDE][STRIP];

    if (!all || at.step > 1)
        copy(s, at, room);
    if (!all)
        mend(s, at, room, told);
    for (size_t k = 0; k < SIDE; k++)
        value[k] = !all || at.step > 1 ? room[k] : s->value[k] + at.first;
    if (s->count == SIDE && at.step == 1)
        add_held(s, value, t->deviation + at.first, at.count, sum);
    else
        add(s, value, at.count, sum);
}

void gsn_sequence_foretell(const struct gsn_sequence_tissue *t,
                           const struct gsn_sequence_line *line, size_t place, size_t step,
                           float *ret_value, unsigned char *told)
{
    const size_t count = (t->columns * t->rows + step - 1) / step;

    memset(ret_value, 0, count * sizeof *ret_value);
    for (size_t from = 0; from < line->count;) {
        const struct side side = take_side(t, line, from, place);

        for (size_t c = 0; c < count; c += STRIP)
            add_strip(t, &side,
                      (struct strip){ c * step, count - c < STRIP ? count - c : STRIP, step },
                      ret_value + c, told + c);
        from += side.count;
    }
}
