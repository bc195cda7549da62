/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/split.h"

#include <assert.h>
#include <string.h>

void gsn_components_free(struct gsn_components *pieces)
{
    if (!pieces)
        return;
    gsn_free(pieces->piece);
    gsn_free(pieces->run);
    gsn_free(pieces);
}

/* The mask in a frame: dilated and eroded within it, things along the border do not grow. */
enum { FRAME = 2 };

struct framed {
    size_t width, height; /* with the frame */
    uint8_t *cell;
};

static int frame(const uint8_t *mask, size_t width, size_t height, struct framed *ret)
{
    *ret = (struct framed){ .width = width + 2 * FRAME, .height = height + 2 * FRAME };
    ret->cell = gsn_alloc_array(ret->width, ret->height);
    for (size_t y = 0; ret->cell && y < height; y++)
        memcpy(ret->cell + (y + FRAME) * ret->width + FRAME, mask + y * width, width);
    return ret->cell ? GSN_OK : GSN_E_NOMEM;
}

/* A cell and its four neighbours, all but the outermost ring. */
static void grow(const struct framed *from, uint8_t *restrict to)
{
    const size_t w = from->width;

    for (size_t y = 1; y + 1 < from->height; y++) {
        const uint8_t *c = from->cell + y * w;

        for (size_t x = 1; x + 1 < w; x++)
            to[y * w + x] = c[x] | c[x - 1] | c[x + 1] | c[x - w] | c[x + w];
    }
}

static void shrink(const struct framed *from, uint8_t *restrict to)
{
    const size_t w = from->width;

    for (size_t y = FRAME; y + FRAME < from->height; y++) {
        const uint8_t *c = from->cell + y * w;

        for (size_t x = FRAME; x + FRAME < w; x++)
            to[y * w + x] = c[x] & c[x - 1] & c[x + 1] & c[x - w] & c[x + w];
    }
}

/* As shrink(), with the diagonal neighbours too; the frame counts as outside. */
static void shrink_square(const struct framed *from, uint8_t *restrict to)
{
    const size_t w = from->width;

    for (size_t y = 1; y + 1 < from->height; y++) {
        const uint8_t *c = from->cell + y * w;

        for (size_t x = 1; x + 1 < w; x++)
            to[y * w + x] = c[x] & c[x - 1] & c[x + 1] & c[x - w] & c[x + w] & c[x - w - 1] &
                            c[x - w + 1] & c[x + w - 1] & c[x + w + 1];
    }
}

static size_t count_runs(const struct framed *mask)
{
    size_t count = 0;

    for (size_t i = 1; i < mask->width * mask->height; i++)
        count += mask->cell[i] & !mask->cell[i - 1];
    return count;
}

/* The first run of a set of runs; halves the way on each visit. */
static int root_of(struct gsn_piece_run *run, int i)
{
    while (run[i].piece != i) {
        run[i].piece = run[run[i].piece].piece;
        i = run[i].piece;
    }
    return i;
}

static void join(struct gsn_piece_run *run, int i, int k)
{
    const int a = root_of(run, i), b = root_of(run, k);

    run[a > b ? a : b].piece = a > b ? b : a;
}

/* Finds the runs of row y from index first on and joins them to those of the row above, which
 * begin at above. Returns the index behind them. */
static int take_row(const struct framed *mask, int y, struct gsn_piece_run *run, int above,
                    int first)
{
    const uint8_t *row = mask->cell + (size_t)(y + FRAME) * mask->width;
    const uint8_t *const end = row + mask->width;
    int next = first, k = above;

    for (const uint8_t *at = memchr(row, 1, mask->width); at;) {
        const uint8_t *stop = memchr(at, 0, (size_t)(end - at)); /* the frame is 0 */
        const int x0 = (int)(at - row) - FRAME, x1 = (int)(stop - row) - FRAME;

        run[next] = (struct gsn_piece_run){ .y = y, .x0 = x0, .x1 = x1, .piece = next };
        while (k < first && run[k].x1 < x0)
            k++;
        for (int j = k; j < first && run[j].x0 <= x1; j++)
            join(run, next, j);
        next++;
        at = memchr(stop, 1, (size_t)(end - stop));
    }
    return next;
}

static void add_run(struct gsn_component *piece, const struct gsn_piece_run *run)
{
    const int length = run->x1 - run->x0;
    const int right =
        piece->area && piece->x + piece->width > run->x1 ? piece->x + piece->width : run->x1;

    if (!piece->area)
        *piece = (struct gsn_component){ .x = run->x0, .y = run->y };
    piece->x = run->x0 < piece->x ? run->x0 : piece->x;
    piece->width = right - piece->x;
    piece->height = run->y + 1 - piece->y;
    piece->area += (size_t)length;
    piece->cx += length * 0.5 * (run->x0 + run->x1); /* sums until all runs are in */
    piece->cy += length * (run->y + 0.5);
}

/* Numbers the pieces by their first runs and sums them up. */
static int number(struct gsn_components *pieces, struct gsn_error *err)
{
    struct gsn_piece_run *run = pieces->run;
    int count = 0;

    for (int i = 0; i < (int)pieces->run_count; i++)
        pieces->count += run[i].piece == i;
    pieces->piece = gsn_alloc_array(pieces->count, sizeof *pieces->piece);
    if (!pieces->piece)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    /* A parent comes before its children, so it has its number already. */
    for (int i = 0; i < (int)pieces->run_count; i++) {
        run[i].piece = run[i].piece == i ? count++ : run[run[i].piece].piece;
        add_run(&pieces->piece[run[i].piece], &run[i]);
    }
    for (size_t i = 0; i < pieces->count; i++) {
        pieces->piece[i].cx /= (double)pieces->piece[i].area;
        pieces->piece[i].cy /= (double)pieces->piece[i].area;
    }
    return GSN_OK;
}

static int find_pieces(const struct framed *mask, int height, struct gsn_components **ret_pieces,
                       struct gsn_error *err)
{
    gsn_auto(gsn_components) pieces = gsn_alloc_array(1, sizeof *pieces);
    int above = 0, first = 0, r;

    if (pieces) {
        pieces->run_count = count_runs(mask);
        pieces->run = gsn_alloc_array(pieces->run_count, sizeof *pieces->run);
    }
    if (!pieces || !pieces->run)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (int y = 0; y < height; y++) {
        const int next = take_row(mask, y, pieces->run, above, first);

        above = first;
        first = next;
    }
    r = number(pieces, err);
    if (r < 0)
        return r;
    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
}

static void swap(uint8_t **a, uint8_t **b)
{
    uint8_t *const kept = *a;

    *a = *b;
    *b = kept;
}

/* The cells of mask that are wider than a thread, and two more around them, which gives back the
 * outline; in wide. Squares and crosses in turn wear a mask down as an octagon does, so a thread
 * counts the same whichever way it runs. */
static void widen(const struct framed *mask, unsigned thread, uint8_t **wide, uint8_t **spare)
{
    const size_t cells = mask->width * mask->height;
    const unsigned turns = (thread + 1) / 2;
    struct framed now = *mask;

    for (unsigned i = 0; i < turns; i++) {
        memset(*spare, 0, cells);
        (i % 2 ? shrink_square : shrink)(&now, *spare);
        swap(wide, spare);
        now.cell = *wide;
    }
    for (unsigned i = 0; i < turns + 2; i++) {
        memset(*spare, 0, cells);
        grow(&now, *spare);
        for (size_t k = 0; k < cells; k++)
            (*spare)[k] &= mask->cell[k];
        swap(wide, spare);
        now.cell = *wide;
    }
}

/* Marks the pieces of the mask that have no wide place. */
static void mark_thin(struct gsn_components *pieces, const struct framed *mask, const uint8_t *wide)
{
    for (size_t i = 0; i < pieces->count; i++)
        pieces->piece[i].thin = 1;
    for (size_t i = 0; i < pieces->run_count; i++) {
        const struct gsn_piece_run *run = &pieces->run[i];
        const uint8_t *row = wide + (size_t)(run->y + FRAME) * mask->width + FRAME;

        if (memchr(row + run->x0, 1, (size_t)(run->x1 - run->x0)))
            pieces->piece[run->piece].thin = 0;
    }
}

/* Takes the threads out of the mask that hang on something wide. */
static int cut_threads(struct framed *mask, int height, unsigned thread,
                       struct gsn_components **pieces, struct gsn_error *err)
{
    const size_t cells = mask->width * mask->height;
    gsn_auto_mem(uint8_t) wide = gsn_alloc(cells);
    gsn_auto_mem(uint8_t) spare = gsn_alloc(cells);
    int r;

    if (!wide || !spare)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    memcpy(wide, mask->cell, cells);
    widen(mask, thread, &wide, &spare);
    mark_thin(*pieces, mask, wide);
    for (size_t i = 0; i < (*pieces)->run_count; i++) {
        const struct gsn_piece_run *run = &(*pieces)->run[i];
        const size_t at = (size_t)(run->y + FRAME) * mask->width + FRAME + (size_t)run->x0;

        if (!(*pieces)->piece[run->piece].thin)
            memcpy(mask->cell + at, wide + at, (size_t)(run->x1 - run->x0));
    }
    gsn_components_free(*pieces);
    *pieces = NULL;
    r = find_pieces(mask, height, pieces, err);
    if (r >= 0)
        mark_thin(*pieces, mask, wide);
    return r;
}

int gsn_split_pieces(const uint8_t *mask, int width, int height, unsigned thread,
                     struct gsn_components **ret_pieces, struct gsn_error *err)
{
    struct framed framed;
    gsn_auto_mem(uint8_t) one = NULL;
    gsn_auto_mem(uint8_t) other = NULL;
    gsn_auto(gsn_components) pieces = NULL;
    int r;

    assert(mask && width > 0 && height > 0 && ret_pieces);

    if (frame(mask, (size_t)width, (size_t)height, &framed) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    one = framed.cell;
    other = gsn_alloc_array(framed.width, framed.height);
    if (!other)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    grow(&framed, other);
    framed.cell = other;
    shrink(&framed, one);
    framed.cell = one;
    r = find_pieces(&framed, height, &pieces, err);
    if (r >= 0 && thread > 0)
        r = cut_threads(&framed, height, thread, &pieces, err);
    if (r < 0)
        return r;
    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
}
