/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: multi-scale blob detection: peaks of the a-trous wavelet's details (wavelet.h), which are
 * differences of smoothed pictures, as differences of Gaussians are (Lindeberg, IJCV 30, 79, 1998).
 *
 * Steps of gsn_blobs_find(). 1. What a disc of contrast 1 answers at each scale is tabulated for 14
 * radii. 2. Row by row, cells that no neighbour surpasses are peaks; ridges are dropped by the
 * ratio of their second differences (Lowe, IJCV 60, 91, 2004, section 4.1). 3. The radius is that
 * whose answers are most nearly the peak's, and contrast and score follow from the same least
 * squares.
 * 4. Of two within a radius the stronger stays; the finest scale's come first.
 *
 * Fails when memory runs out; finding nothing is no failure. Cost: the wavelet's, and little more,
 * since few cells are peaks. */
#include "pipeline/register/fiducial/blob.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/fiducial/wavelet.h"

#include <assert.h>
#include <math.h>
#include <string.h>

const double gsn_burn_radius_min_um = 40, gsn_burn_radius_max_um = 150;
const double gsn_blob_contrast_min = 0.05;

static const double CELL_UM = 25;
enum { SCALES = GSN_WAVELET_SCALES, RADII = 14, LATER = 64 };
/* Above this radius in cells the third scale answers more strongly than the second. */
static const double THIRD_SCALE = 6.2;
/* Half of what a disc of the best radius answers, of its contrast. */
static const double RESPONSE = 0.25;
/* A peak this many times sharper across than along is part of a line: a hair, ink, an edge of
 * glass. A mark that such a line touches stays below. */
static const double LINE = 6;

size_t gsn_blob_cell_px(double px_um)
{
    return (size_t)fmax(floor(CELL_UM / px_um), 1);
}

/* A blob of a further scale than the first. */
struct later {
    struct gsn_fiducial blob;
    size_t scale;
};

struct search {
    const struct gsn_blob_field *field;
    struct gsn_wavelet wavelet;
    double answer[RADII][SCALES]; /* of a disc of contrast 1, by its radius */
    double radius[RADII];         /* cells */
    struct gsn_fiducial *blobs;   /* the strongest so far, strongest first */
    size_t count, most;
    struct later *later; /* row by row: the first scale's blobs are weighed before them */
    size_t later_count, later_room;
};

/* Where a scale of the wavelet is looked at: a cell that is not at the picture's edge. */
struct place {
    const struct gsn_wavelet *wavelet;
    size_t x, y, scale;
};

/* The answer dx and dy cells beside it. */
static double answer_at(const struct place *at, int dx, int dy)
{
    const size_t x = at->x + (size_t)dx, y = at->y + (size_t)dy;

    return (double)gsn_wavelet_level(at->wavelet, at->scale, y)[x] -
           (double)gsn_wavelet_level(at->wavelet, at->scale + 1, y)[x];
}

static void tabulate_answers(struct search *search, double cell_um)
{
    /* A cell's mean blurs, too. */
    const double cell = 1.0 / 12;

    for (int i = 0; i < RADII; i++) {
        const double radius =
            gsn_burn_radius_min_um / cell_um *
            pow(gsn_burn_radius_max_um / gsn_burn_radius_min_um, (double)i / (RADII - 1));

        search->radius[i] = radius;
        for (size_t k = 0; k < SCALES; k++)
            search->answer[i][k] =
                exp(-radius * radius / (2 * (gsn_wavelet_variance[k + 1] + cell))) -
                exp(-radius * radius / (2 * (gsn_wavelet_variance[k] + cell)));
    }
}

/* Whether no neighbour answers more strongly; of equals the first counts. */
static int is_peak(const struct place *at)
{
    const double own = answer_at(at, 0, 0);

    for (int k = 0; k < 9; k++) {
        const double other = answer_at(at, k % 3 - 1, k / 3 - 1);

        if (k != 4 && (other > own || (other == own && k < 4)))
            return 0;
    }
    return 1;
}

/* Whether a peak is a ridge: by the second differences of its surroundings, whose determinant is
 * small beside the square of their trace. */
static int is_ridge(const struct place *at)
{
    const double own = answer_at(at, 0, 0);
    const double xx = answer_at(at, -1, 0) - 2 * own + answer_at(at, 1, 0);
    const double yy = answer_at(at, 0, -1) - 2 * own + answer_at(at, 0, 1);
    const double xy = 0.25 * (answer_at(at, -1, -1) - answer_at(at, 1, -1) - answer_at(at, -1, 1) +
                              answer_at(at, 1, 1));

    return (xx + yy) * (xx + yy) * LINE > (1 + LINE) * (1 + LINE) * (xx * yy - xy * xy);
}

/* How far a peak lies from its cell's centre, cells, by the parabola through three answers. */
static double peak_offset(double before, double at, double after)
{
    const double bend = before - 2 * at + after;

    return bend < 0 ? fmin(fmax(0.5 * (before - after) / bend, -0.5), 0.5) : 0;
}

/* The disc that answers most nearly as this place does. */
static struct gsn_fiducial fit_disc(const struct search *search, const struct place *at)
{
    const struct gsn_blob_field *field = search->field;
    const double dx = peak_offset(answer_at(at, -1, 0), answer_at(at, 0, 0), answer_at(at, 1, 0));
    const double dy = peak_offset(answer_at(at, 0, -1), answer_at(at, 0, 0), answer_at(at, 0, 1));
    const double cell = field->cell_px;
    double own[SCALES] = { 0 };
    struct gsn_fiducial mark = { .px = { field->origin_px.x + ((double)at->x + 0.5 + dx) * cell,
                                         field->origin_px.y + ((double)at->y + 0.5 + dy) * cell },
                                 .score = -1,
                                 .cov_xx = cell * cell / 12,
                                 .cov_yy = cell * cell / 12,
                                 .found = 1 };

    for (size_t k = 0; k < search->wavelet.scales; k++)
        own[k] = answer_at(&(struct place){ at->wavelet, at->x, at->y, k }, 0, 0);
    for (int i = 0; i < RADII; i++) {
        double both = 0, all = 0, disc = 0, score;

        for (size_t k = 0; k < search->wavelet.scales; k++) {
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
static double strength_of(const struct gsn_fiducial *blob)
{
    return blob->contrast * blob->score;
}

/* Keeps the strongest most blobs, strongest first; of two within a radius the stronger stays. */
static void keep_strongest(struct gsn_fiducial *kept, size_t *count, size_t most,
                           const struct gsn_fiducial *blob)
{
    size_t at, n = 0;

    for (size_t i = 0; i < *count; i++) {
        const double dx = kept[i].px.x - blob->px.x, dy = kept[i].px.y - blob->px.y;
        const double near = fmax(kept[i].radius_px, blob->radius_px);

        if (dx * dx + dy * dy < near * near) {
            if (strength_of(&kept[i]) >= strength_of(blob))
                return;
            continue;
        }
        kept[n++] = kept[i];
    }
    *count = n;
    if (n == most && strength_of(&kept[n - 1]) >= strength_of(blob))
        return;
    at = n == most ? n - 1 : (*count)++;
    for (; at > 0 && strength_of(&kept[at - 1]) < strength_of(blob); at--)
        kept[at] = kept[at - 1];
    kept[at] = *blob;
}

static int keep_later(struct search *search, const struct gsn_fiducial *blob, size_t scale,
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
    search->later[search->later_count++] = (struct later){ *blob, scale };
    return GSN_OK;
}

/* What may be a blob, at a cell whose answer none of the four beside it surpasses. */
static int add_peak(struct search *search, const struct place *at, struct gsn_error *err)
{
    struct gsn_fiducial blob;

    if (!is_peak(at) || is_ridge(at))
        return GSN_OK;
    blob = fit_disc(search, at);
    if (!(blob.contrast >= gsn_blob_contrast_min))
        return GSN_OK;
    if (at->scale > 0)
        return keep_later(search, &blob, at->scale, err);
    keep_strongest(search->blobs, &search->count, search->most, &blob);
    return GSN_OK;
}

static inline float larger_of(float a, float b)
{
    return a > b ? a : b;
}

/* 1 where a cell of the middle one of three rows is neither below least nor below any of the four
 * cells beside it, else 0. Of each row one cell before at and one after count is read. */
static void mark_peaks(const float *const at[3], size_t count, float least, uint8_t *restrict to)
{
    const float *restrict above = at[0], *restrict below = at[2];
    const float *before = at[1] - 1, *own = at[1], *after = at[1] + 1;

    for (size_t i = 0; i < count; i++) {
        const float most = larger_of(
            larger_of(larger_of(above[i], below[i]), larger_of(before[i], after[i])), least);

        to[i] = own[i] >= most;
    }
}

/* A row's cells but the first and the last; peak has room for them and for a word more. */
static int search_row(struct search *search, size_t y, size_t scale, uint8_t *peak,
                      struct gsn_error *err)
{
    const struct gsn_wavelet *wavelet = &search->wavelet;
    const size_t count = wavelet->width - 2;
    const float *at[3];

    for (size_t k = 0; k < 3; k++)
        at[k] = gsn_wavelet_detail(wavelet, scale, y - 1 + k) + 1;
    mark_peaks(at, count, (float)(RESPONSE * gsn_blob_contrast_min), peak);
    for (size_t first = 0; first < count; first += sizeof(uint64_t)) {
        uint64_t any;

        /* Few cells are peaks: most words are none. */
        memcpy(&any, peak + first, sizeof any);
        for (size_t i = first; any && i < first + sizeof any && i < count; i++) {
            const int r = peak[i]
                              ? add_peak(search, &(struct place){ wavelet, i + 1, y, scale }, err)
                              : GSN_OK;

            if (r < 0)
                return r;
        }
    }
    return GSN_OK;
}

static int search_rows(struct search *search, struct gsn_error *err)
{
    const struct gsn_blob_field *field = search->field;
    gsn_auto_mem(uint8_t) peak = gsn_alloc_array(field->width + sizeof(uint64_t), 1);
    int r = GSN_OK;

    if (!peak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t y = 1; field->width > 2 && y + 1 < field->height; y++) {
        gsn_wavelet_advance(&search->wavelet, y);
        for (size_t scale = 0; r >= 0 && scale < search->wavelet.scales; scale++)
            r = search_row(search, y, scale, peak, err);
        if (r < 0)
            return r;
    }
    for (size_t scale = 1; scale < search->wavelet.scales; scale++)
        for (size_t i = 0; i < search->later_count; i++)
            if (search->later[i].scale == scale)
                keep_strongest(search->blobs, &search->count, search->most, &search->later[i].blob);
    return GSN_OK;
}

int gsn_blobs_find(const struct gsn_blob_field *field, double px_um, size_t most,
                   struct gsn_fiducial *ret_blobs, size_t *ret_count, struct gsn_error *err)
{
    const double cell_um = field->cell_px * px_um;
    const size_t scales = gsn_burn_radius_max_um / cell_um > THIRD_SCALE ? 3 : 2;
    gsn_auto_mem(struct gsn_fiducial) blobs = gsn_alloc(most * sizeof *blobs);
    struct search search = { .field = field, .blobs = blobs, .most = most };
    int r;

    assert(most > 0 && ret_blobs && ret_count);

    if (field->width * field->height == 0) {
        *ret_count = 0;
        return GSN_OK;
    }
    if (!blobs)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    r = gsn_wavelet_init(&search.wavelet, field->od, field->width, field->height, scales, err);
    if (r < 0)
        return r;
    tabulate_answers(&search, cell_um);
    r = search_rows(&search, err);
    gsn_free(search.later);
    gsn_wavelet_done(&search.wavelet);
    if (r < 0)
        return r;
    memcpy(ret_blobs, blobs, search.count * sizeof *blobs);
    *ret_count = search.count;
    return GSN_OK;
}
