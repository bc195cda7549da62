/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_field.h"

#include <assert.h>
#include <math.h>
#include <string.h>

const double gsn_mark_radius_least_um = 40, gsn_mark_radius_most_um = 150;
const double gsn_mark_contrast_least = 0.05;

static const double CELL_UM = 25;
/* The kernel 1 4 6 4 1, spread by 1, 2, 4 and 8 cells, blurs with variances of 1, 5, 21 and 85. */
enum { LEVELS = 4, RUNGS = LEVELS - 1, RADII = 14 };
static const double VARIANCE[LEVELS] = { 1, 5, 21, 85 };
/* Above this radius in cells the third rung answers more strongly than the second. */
static const double THIRD_RUNG = 6.2;
/* Half of what a disc of the best radius answers, of its contrast. */
static const double RESPONSE = 0.25;
/* A peak this many times sharper across than along is part of a line: a hair, ink, an edge of
 * glass. A mark that such a line touches stays below. */
static const double LINE = 6;

size_t gsn_mark_field_step(double px_um)
{
    return (size_t)fmax(floor(CELL_UM / px_um), 1);
}

static size_t clamp(ptrdiff_t at, size_t count)
{
    return at < 0 ? 0 : (size_t)at < count ? (size_t)at : count - 1;
}

static void blend(const float *restrict a, const float *restrict b, const float *restrict c,
                  const float *restrict d, const float *restrict e, float *restrict onto,
                  size_t count)
{
    for (size_t i = 0; i < count; i++)
        onto[i] = 0.0625f * (a[i] + e[i]) + 0.25f * (b[i] + d[i]) + 0.375f * c[i];
}

/* One blur, its taps apart cells away from each other; edges repeat. row holds width + 4 apart. */
static void blur(const float *from, size_t width, size_t height, size_t apart, float *row,
                 float *onto)
{
    const ptrdiff_t step = (ptrdiff_t)apart;

    for (size_t y = 0; y < height; y++) {
        const ptrdiff_t at = (ptrdiff_t)y;
        float *line = onto + y * width;

        blend(from + clamp(at - 2 * step, height) * width, from + clamp(at - step, height) * width,
              from + y * width, from + clamp(at + step, height) * width,
              from + clamp(at + 2 * step, height) * width, row + 2 * apart, width);
        for (size_t i = 0; i < 2 * apart; i++) {
            row[i] = row[2 * apart];
            row[2 * apart + width + i] = row[2 * apart + width - 1];
        }
        blend(row, row + apart, row + 2 * apart, row + 3 * apart, row + 4 * apart, line, width);
    }
}

struct ladder {
    const struct gsn_mark_field *field;
    size_t rungs;
    float *level[LEVELS];
    double answer[RADII][RUNGS]; /* of a disc of contrast 1, by its radius */
    double radius[RADII];        /* cells */
};

static double answer_at(const struct ladder *ladder, size_t at, size_t rung)
{
    return (double)ladder->level[rung][at] - (double)ladder->level[rung + 1][at];
}

static void tabulate(struct ladder *ladder, double cell_um)
{
    /* A cell's mean blurs, too. */
    const double cell = 1.0 / 12;

    for (int i = 0; i < RADII; i++) {
        const double radius =
            gsn_mark_radius_least_um / cell_um *
            pow(gsn_mark_radius_most_um / gsn_mark_radius_least_um, (double)i / (RADII - 1));

        ladder->radius[i] = radius;
        for (size_t k = 0; k < RUNGS; k++)
            ladder->answer[i][k] = exp(-radius * radius / (2 * (VARIANCE[k + 1] + cell))) -
                                   exp(-radius * radius / (2 * (VARIANCE[k] + cell)));
    }
}

/* Whether no neighbour answers more strongly; of equals the first counts. */
static int is_peak(const struct ladder *ladder, size_t at, size_t rung)
{
    const double own = answer_at(ladder, at, rung);
    const size_t width = ladder->field->width;

    for (size_t k = 0; k < 9; k++) {
        const double other = answer_at(ladder, at + (k / 3) * width + k % 3 - width - 1, rung);

        if (k != 4 && (other > own || (other == own && k < 4)))
            return 0;
    }
    return 1;
}

/* Whether a peak is a ridge: by the second differences of its surroundings, whose determinant is
 * small beside the square of their trace. */
static int is_ridge(const struct ladder *ladder, size_t at, size_t rung)
{
    const size_t width = ladder->field->width;
    const double own = answer_at(ladder, at, rung);
    const double xx = answer_at(ladder, at - 1, rung) - 2 * own + answer_at(ladder, at + 1, rung);
    const double yy =
        answer_at(ladder, at - width, rung) - 2 * own + answer_at(ladder, at + width, rung);
    const double xy =
        0.25 * (answer_at(ladder, at - width - 1, rung) - answer_at(ladder, at - width + 1, rung) -
                answer_at(ladder, at + width - 1, rung) + answer_at(ladder, at + width + 1, rung));

    return (xx + yy) * (xx + yy) * LINE > (1 + LINE) * (1 + LINE) * (xx * yy - xy * xy);
}

/* How far a peak lies from its cell's centre, cells, by the parabola through three answers. */
static double offset(double before, double at, double after)
{
    const double bend = before - 2 * at + after;

    return bend < 0 ? fmin(fmax(0.5 * (before - after) / bend, -0.5), 0.5) : 0;
}

/* The disc that answers most nearly as this place does. */
static struct gsn_mark disc_at(const struct ladder *ladder, size_t at, size_t rung)
{
    const struct gsn_mark_field *field = ladder->field;
    const size_t width = field->width;
    const double dx = offset(answer_at(ladder, at - 1, rung), answer_at(ladder, at, rung),
                             answer_at(ladder, at + 1, rung));
    const double dy = offset(answer_at(ladder, at - width, rung), answer_at(ladder, at, rung),
                             answer_at(ladder, at + width, rung));
    const double cell = field->cell_px;
    struct gsn_mark mark = { .px = { field->origin_px.x + ((double)(at % width) + 0.5 + dx) * cell,
                                     field->origin_px.y +
                                         ((double)(at / width) + 0.5 + dy) * cell },
                             .score = -1,
                             .cov_xx = cell * cell / 12,
                             .cov_yy = cell * cell / 12,
                             .found = 1 };

    for (int i = 0; i < RADII; i++) {
        double both = 0, own = 0, disc = 0, score;

        for (size_t k = 0; k < ladder->rungs; k++) {
            const double a = answer_at(ladder, at, k);

            both += a * ladder->answer[i][k];
            own += a * a;
            disc += ladder->answer[i][k] * ladder->answer[i][k];
        }
        score = both > 0 ? both * both / (own * disc) : 0;
        if (score > mark.score) {
            mark.score = score;
            mark.radius_px = ladder->radius[i] * cell;
            mark.contrast = both / disc;
        }
    }
    return mark;
}

/* Of equal contrast, the rounder one is rather a mark. */
static double strength(const struct gsn_mark *spot)
{
    return spot->contrast * spot->score;
}

/* Keeps the strongest most spots, strongest first; of two within a radius the stronger stays. */
static void keep(struct gsn_mark *kept, size_t *count, size_t most, const struct gsn_mark *spot)
{
    size_t at, n = 0;

    for (size_t i = 0; i < *count; i++) {
        const double dx = kept[i].px.x - spot->px.x, dy = kept[i].px.y - spot->px.y;
        const double near = fmax(kept[i].radius_px, spot->radius_px);

        if (dx * dx + dy * dy < near * near) {
            if (strength(&kept[i]) >= strength(spot))
                return;
            continue;
        }
        kept[n++] = kept[i];
    }
    *count = n;
    if (n == most && strength(&kept[n - 1]) >= strength(spot))
        return;
    at = n == most ? n - 1 : (*count)++;
    for (; at > 0 && strength(&kept[at - 1]) < strength(spot); at--)
        kept[at] = kept[at - 1];
    kept[at] = *spot;
}

static size_t find_spots(const struct ladder *ladder, struct gsn_mark *ret_spots, size_t most)
{
    const size_t width = ladder->field->width, height = ladder->field->height;
    const float least = (float)(RESPONSE * gsn_mark_contrast_least);
    size_t count = 0;

    for (size_t rung = 0; rung < ladder->rungs; rung++) {
        const float *near = ladder->level[rung], *far = ladder->level[rung + 1];

        for (size_t y = 1; y + 1 < height; y++) {
            for (size_t at = y * width + 1; at < y * width + width - 1; at++) {
                struct gsn_mark spot;

                if (near[at] - far[at] < least || !is_peak(ladder, at, rung) ||
                    is_ridge(ladder, at, rung))
                    continue;
                spot = disc_at(ladder, at, rung);
                if (spot.contrast >= gsn_mark_contrast_least)
                    keep(ret_spots, &count, most, &spot);
            }
        }
    }
    return count;
}

int gsn_mark_field_spots(const struct gsn_mark_field *field, double px_um, size_t most,
                         struct gsn_mark *ret_spots, size_t *ret_count, struct gsn_error *err)
{
    const size_t cells = field->width * field->height;
    const double cell_um = field->cell_px * px_um;
    struct ladder ladder = { .field = field,
                             .rungs = gsn_mark_radius_most_um / cell_um > THIRD_RUNG ? 3 : 2 };
    gsn_auto_mem(float) values = NULL;
    gsn_auto_mem(float) row = NULL;
    const float *from = field->od;

    assert(most > 0 && ret_spots && ret_count);

    if (cells == 0) {
        *ret_count = 0;
        return GSN_OK;
    }
    values = gsn_alloc(cells * ladder.rungs * sizeof *values);
    row = gsn_alloc((field->width + 32) * sizeof *row);
    if (!values || !row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    tabulate(&ladder, cell_um);
    for (size_t k = 0; k <= ladder.rungs; k++) {
        /* The cells themselves are not asked for again: the second blur takes their place. */
        ladder.level[k] = k == 1 ? field->od : values + cells * (k == 0 ? 0 : k - 1);
        blur(from, field->width, field->height, (size_t)1 << k, row, ladder.level[k]);
        from = ladder.level[k];
    }
    *ret_count = find_spots(&ladder, ret_spots, most);
    return GSN_OK;
}
