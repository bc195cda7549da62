/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_field.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/mark_ladder.h"

#include <assert.h>
#include <math.h>
#include <string.h>

const double gsn_mark_radius_least_um = 40, gsn_mark_radius_most_um = 150;
const double gsn_mark_contrast_least = 0.05;

static const double CELL_UM = 25;
enum { RUNGS = GSN_LADDER_RUNGS, RADII = 14, LATER = 64 };
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

/* A spot of a further rung than the first. */
struct later {
    struct gsn_mark spot;
    size_t rung;
};

struct search {
    struct gsn_mark_ladder ladder;
    double answer[RADII][RUNGS]; /* of a disc of contrast 1, by its radius */
    double radius[RADII];        /* cells */
    struct gsn_mark *spots;      /* the strongest so far, strongest first */
    size_t count, most;
    struct later *later; /* row by row: the first rung's spots are weighed before them */
    size_t later_count, later_room;
};

/* Where a rung of the ladder is looked at: a cell that is not at the picture's edge. */
struct look {
    const struct gsn_mark_ladder *ladder;
    size_t x, y, rung;
};

/* The answer dx and dy cells beside it. */
static double answer(const struct look *at, int dx, int dy)
{
    const size_t x = at->x + (size_t)dx, y = at->y + (size_t)dy;

    return (double)gsn_mark_ladder_level(at->ladder, at->rung, y)[x] -
           (double)gsn_mark_ladder_level(at->ladder, at->rung + 1, y)[x];
}

static void tabulate(struct search *search, double cell_um)
{
    /* A cell's mean blurs, too. */
    const double cell = 1.0 / 12;

    for (int i = 0; i < RADII; i++) {
        const double radius =
            gsn_mark_radius_least_um / cell_um *
            pow(gsn_mark_radius_most_um / gsn_mark_radius_least_um, (double)i / (RADII - 1));

        search->radius[i] = radius;
        for (size_t k = 0; k < RUNGS; k++)
            search->answer[i][k] =
                exp(-radius * radius / (2 * (gsn_ladder_variance[k + 1] + cell))) -
                exp(-radius * radius / (2 * (gsn_ladder_variance[k] + cell)));
    }
}

/* Whether no neighbour answers more strongly; of equals the first counts. */
static int is_peak(const struct look *at)
{
    const double own = answer(at, 0, 0);

    for (int k = 0; k < 9; k++) {
        const double other = answer(at, k % 3 - 1, k / 3 - 1);

        if (k != 4 && (other > own || (other == own && k < 4)))
            return 0;
    }
    return 1;
}

/* Whether a peak is a ridge: by the second differences of its surroundings, whose determinant is
 * small beside the square of their trace. */
static int is_ridge(const struct look *at)
{
    const double own = answer(at, 0, 0);
    const double xx = answer(at, -1, 0) - 2 * own + answer(at, 1, 0);
    const double yy = answer(at, 0, -1) - 2 * own + answer(at, 0, 1);
    const double xy =
        0.25 * (answer(at, -1, -1) - answer(at, 1, -1) - answer(at, -1, 1) + answer(at, 1, 1));

    return (xx + yy) * (xx + yy) * LINE > (1 + LINE) * (1 + LINE) * (xx * yy - xy * xy);
}

/* How far a peak lies from its cell's centre, cells, by the parabola through three answers. */
static double offset(double before, double at, double after)
{
    const double bend = before - 2 * at + after;

    return bend < 0 ? fmin(fmax(0.5 * (before - after) / bend, -0.5), 0.5) : 0;
}

/* The disc that answers most nearly as this place does. */
static struct gsn_mark disc_at(const struct search *search, const struct look *at)
{
    const struct gsn_mark_field *field = search->ladder.field;
    const double dx = offset(answer(at, -1, 0), answer(at, 0, 0), answer(at, 1, 0));
    const double dy = offset(answer(at, 0, -1), answer(at, 0, 0), answer(at, 0, 1));
    const double cell = field->cell_px;
    double own[RUNGS] = { 0 };
    struct gsn_mark mark = { .px = { field->origin_px.x + ((double)at->x + 0.5 + dx) * cell,
                                     field->origin_px.y + ((double)at->y + 0.5 + dy) * cell },
                             .score = -1,
                             .cov_xx = cell * cell / 12,
                             .cov_yy = cell * cell / 12,
                             .found = 1 };

    for (size_t k = 0; k < search->ladder.rungs; k++)
        own[k] = answer(&(struct look){ at->ladder, at->x, at->y, k }, 0, 0);
    for (int i = 0; i < RADII; i++) {
        double both = 0, all = 0, disc = 0, score;

        for (size_t k = 0; k < search->ladder.rungs; k++) {
            both += own[k] * search->answer[i][k];
            all += own[k] * own[k];
            disc += search->answer[i][k] * search->answer[i][k];
        }
        score = both > 0 ? both * both / (all * disc) : 0;
        if (score > mark.score) {
            mark.score = score;
            mark.radius_px = search->radius[i] * cell;
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

static int keep_later(struct search *search, const struct gsn_mark *spot, size_t rung,
                      struct gsn_error *err)
{
    if (search->later_count == search->later_room) {
        const size_t room = search->later_room ? 2 * search->later_room : LATER;
        struct later *more = gsn_realloc_array(search->later, room, sizeof *more);

        if (!more)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
        search->later = more;
        search->later_room = room;
    }
    search->later[search->later_count++] = (struct later){ *spot, rung };
    return GSN_OK;
}

/* What may be a spot, at a cell whose answer none of the four beside it surpasses. */
static int consider(struct search *search, const struct look *at, struct gsn_error *err)
{
    struct gsn_mark spot;

    if (!is_peak(at) || is_ridge(at))
        return GSN_OK;
    spot = disc_at(search, at);
    if (!(spot.contrast >= gsn_mark_contrast_least))
        return GSN_OK;
    if (at->rung > 0)
        return keep_later(search, &spot, at->rung, err);
    keep(search->spots, &search->count, search->most, &spot);
    return GSN_OK;
}

/* A row's cells but the first and the last; peak has room for them and for a word more. */
static int search_row(struct search *search, size_t y, size_t rung, uint8_t *peak,
                      struct gsn_error *err)
{
    const struct gsn_mark_ladder *ladder = &search->ladder;
    const size_t count = ladder->field->width - 2;
    const float *at[3];

    for (size_t k = 0; k < 3; k++)
        at[k] = gsn_mark_ladder_rung(ladder, rung, y - 1 + k) + 1;
    ladder->run->peaks(at, count, (float)(RESPONSE * gsn_mark_contrast_least), peak);
    for (size_t first = 0; first < count; first += sizeof(uint64_t)) {
        uint64_t any;

        /* Few cells are peaks: most words are none. */
        memcpy(&any, peak + first, sizeof any);
        for (size_t i = first; any && i < first + sizeof any && i < count; i++) {
            const int r =
                peak[i] ? consider(search, &(struct look){ ladder, i + 1, y, rung }, err) : GSN_OK;

            if (r < 0)
                return r;
        }
    }
    return GSN_OK;
}

static int search_rows(struct search *search, struct gsn_error *err)
{
    const struct gsn_mark_field *field = search->ladder.field;
    gsn_auto_mem(uint8_t) peak = gsn_alloc_array(field->width + sizeof(uint64_t), 1);
    int r = GSN_OK;

    if (!peak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t y = 1; field->width > 2 && y + 1 < field->height; y++) {
        gsn_mark_ladder_climb(&search->ladder, y);
        for (size_t rung = 0; r >= 0 && rung < search->ladder.rungs; rung++)
            r = search_row(search, y, rung, peak, err);
        if (r < 0)
            return r;
    }
    for (size_t rung = 1; rung < search->ladder.rungs; rung++)
        for (size_t i = 0; i < search->later_count; i++)
            if (search->later[i].rung == rung)
                keep(search->spots, &search->count, search->most, &search->later[i].spot);
    return GSN_OK;
}

int gsn_mark_field_spots(const struct gsn_mark_field *field, double px_um, size_t most,
                         struct gsn_mark *ret_spots, size_t *ret_count, struct gsn_error *err)
{
    const double cell_um = field->cell_px * px_um;
    const size_t rungs = gsn_mark_radius_most_um / cell_um > THIRD_RUNG ? 3 : 2;
    gsn_auto_mem(struct gsn_mark) spots = gsn_alloc(most * sizeof *spots);
    struct search search = { .spots = spots, .most = most };
    int r;

    assert(most > 0 && ret_spots && ret_count);

    if (field->width * field->height == 0) {
        *ret_count = 0;
        return GSN_OK;
    }
    if (!spots)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    r = gsn_mark_ladder_init(&search.ladder, field, rungs, err);
    if (r < 0)
        return r;
    tabulate(&search, cell_um);
    r = search_rows(&search, err);
    gsn_free(search.later);
    gsn_mark_ladder_done(&search.ladder);
    if (r < 0)
        return r;
    memcpy(ret_spots, spots, search.count * sizeof *spots);
    *ret_count = search.count;
    return GSN_OK;
}
