/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: morphological closing and opening by reconstruction (Serra 1982; Vincent 1993), connected
 * components (pipeline/imaging).
 * Steps: (1) the mask in a frame of empty cells is closed with a cross, so things along the border
 * do not grow; (2) its components; (3) where threads are asked for, the mask is worn down by
 * crosses and squares in turn, as an octagon does, so that a thread counts the same whichever way
 * it runs, and grown back inside itself by two cells more, which gives back the outline; what is
 * then missing of a component that has a wide place was a thread of it; (4) the components of what
 * is left. */
#include "pipeline/register/split.h"

#include <assert.h>
#include <string.h>

#include "pipeline/imaging/morphology.h"

enum { FRAME = 2 };
/* Structuring elements by their radius: 5 and 9 cells. */
static const double CROSS = 1, SQUARE = 1.5;

/* A mask in its frame. */
struct framed {
    uint32_t width, height; /* with the frame */
    uint8_t *cell;
};

static size_t cells_of(const struct framed *mask)
{
    return (size_t)mask->width * mask->height;
}

/* The row of the mask itself that is y. */
static uint8_t *row_of(const struct framed *mask, uint32_t y)
{
    return mask->cell + (size_t)(y + FRAME) * mask->width + FRAME;
}

static int find_pieces(const struct framed *mask, struct gsn_components **ret_pieces,
                       struct gsn_error *err)
{
    const uint32_t width = mask->width - 2 * FRAME, height = mask->height - 2 * FRAME;
    gsn_auto_mem(uint8_t) bare = gsn_alloc((size_t)width * height);

    if (!bare)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (uint32_t y = 0; y < height; y++)
        memcpy(bare + (size_t)y * width, row_of(mask, y), width);
    return gsn_components_find(bare, width, height, ret_pieces, err);
}

/* wide becomes the cells of mask that are wider than a thread, and two more around them. */
static int widen(const struct framed *mask, unsigned thread, uint8_t *wide, struct gsn_error *err)
{
    const unsigned turns = (thread + 1) / 2;
    int r = GSN_OK;

    for (unsigned i = 0; r >= 0 && i < turns; i++)
        r = gsn_erode(wide, mask->width, mask->height, i % 2 ? SQUARE : CROSS, err);
    for (unsigned i = 0; r >= 0 && i < turns + 2; i++) {
        r = gsn_dilate(wide, mask->width, mask->height, CROSS, err);
        for (size_t k = 0; k < cells_of(mask); k++)
            wide[k] &= mask->cell[k];
    }
    return r;
}

/* The place in the frame of a pixel of a component. */
static size_t place_of(const struct framed *mask, const struct gsn_components *pieces, size_t pixel)
{
    return (size_t)(pixel / pieces->width + FRAME) * mask->width + pixel % pieces->width + FRAME;
}

/* gives: for each component whether it has no wide place. NULL: no memory. */
static uint8_t *find_thin(const struct gsn_components *pieces, const struct framed *mask,
                          const uint8_t *wide)
{
    uint8_t *thin = gsn_alloc_array(pieces->count, 1);

    for (size_t i = 0; thin && i < pieces->count; i++) {
        const uint32_t *pixel = pieces->pixel + pieces->component[i].first;
        int any = 0;

        for (size_t k = 0; k < pieces->component[i].area; k++)
            any |= wide[place_of(mask, pieces, pixel[k])];
        thin[i] = !any;
    }
    return thin;
}

/* Takes the threads out of the mask that hang on something wide; the pieces that are left. */
static int cut_threads(struct framed *mask, unsigned thread, struct gsn_components **pieces,
                       uint8_t **ret_thin, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) wide = gsn_memdup(mask->cell, cells_of(mask));
    gsn_auto_mem(uint8_t) thin = NULL;
    int r = wide ? widen(mask, thread, wide, err) : GSN_OK;

    if (r < 0)
        return r;
    thin = wide ? find_thin(*pieces, mask, wide) : NULL;
    if (!thin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (size_t i = 0; i < (*pieces)->count; i++) {
        const uint32_t *pixel = (*pieces)->pixel + (*pieces)->component[i].first;

        for (size_t k = 0; !thin[i] && k < (*pieces)->component[i].area; k++) {
            const size_t at = place_of(mask, *pieces, pixel[k]);

            mask->cell[at] = wide[at];
        }
    }
    gsn_components_free(*pieces);
    *pieces = NULL;
    r = find_pieces(mask, pieces, err);
    if (r < 0)
        return r;
    *ret_thin = find_thin(*pieces, mask, wide);
    return *ret_thin ? GSN_OK
                     : gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
}

int gsn_split_pieces(const uint8_t *mask, uint32_t width, uint32_t height, unsigned thread,
                     struct gsn_components **ret_pieces, uint8_t **ret_thin,
                     struct gsn_error *err)
{
    struct framed framed = { .width = width + 2 * FRAME, .height = height + 2 * FRAME };
    gsn_auto_mem(uint8_t) cell = gsn_alloc_array(framed.width, framed.height);
    gsn_auto_mem(uint8_t) thin = NULL;
    gsn_auto(gsn_components) pieces = NULL;
    int r;

    assert(mask && width > 0 && height > 0 && ret_pieces);

    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    framed.cell = cell;
    for (uint32_t y = 0; y < height; y++)
        memcpy(row_of(&framed, y), mask + (size_t)y * width, width);
    r = gsn_dilate(cell, framed.width, framed.height, CROSS, err);
    if (r >= 0)
        r = gsn_erode(cell, framed.width, framed.height, CROSS, err);
    if (r >= 0)
        r = find_pieces(&framed, &pieces, err);
    if (r >= 0 && thread > 0)
        r = cut_threads(&framed, thread, &pieces, &thin, err);
    if (r >= 0 && !thin) {
        thin = gsn_alloc_array(pieces->count, 1);
        if (!thin)
            r = gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    }
    if (r < 0)
        return r;
    if (ret_thin)
        *ret_thin = gsn_steal(&thin);
    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
}
